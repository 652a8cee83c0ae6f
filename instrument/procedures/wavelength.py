"""Wavelength check: absorption bands of a certified standard, found by tuning the filter across them."""

from __future__ import annotations

from datetime import date
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from instrument.angles import FloatArray
from instrument.errors import InputError
from instrument.forms import Form, read_form
from instrument.procedures.reading import beyond, relative_error
from instrument.procedures.results import Finding, Quantity
from instrument.procedures.room import Room

#: Example certificate of a laboratory that brings one.
EXAMPLE = "wavelength_standard.toml"


class Band(Form):
    """One absorption band: the wavelength of its minimum and its standard uncertainty, and how far to scan (nm)."""

    wavelength: Annotated[float, Field(gt=0)]
    u: Annotated[float, Field(ge=0)]
    reach: Annotated[float, Field(gt=0)] = 12.0


class WavelengthStandard(Form):
    """Certificate of a wavelength standard: a tile doped with holmium, erbium or another rare earth.

    Wavelengths of minima are those that a filter of the instrument's bandwidth sees.
    """

    version: Literal[1] = 1
    identity: Annotated[str, Field(min_length=1)]
    valid_from: date
    valid_until: date
    band: Annotated[tuple[Band, ...], Field(min_length=1)]

    @model_validator(mode="after")
    def _consistent(self) -> WavelengthStandard:
        if self.valid_until < self.valid_from:
            raise ValueError(f"valid_until ({self.valid_until}) lies before valid_from ({self.valid_from})")
        return self


def wavelength_check(
    room: Room,
    standard: Path | None = None,
    step: float = 1.5,
    allowed: float = 0.15,
    samples: int = 9,
    accept_expired: bool = False,
) -> Finding:
    """Find the bands of a wavelength standard and compare with its certificate.

    The standard's readings are divided by those of the reference at the same wavelengths, so that source and detector
    do not shift a minimum; a Gaussian on a sloping ground is fitted to each band.

    Parameters
    ----------
    standard
        Certificate.
    step
        Of the scan, nm.
    allowed
        Standard uncertainty of the wavelength scale, nm (0.15 nm in the paper's Table II).
    accept_expired
        Go on with a certificate that is not valid today; said in the result.

    Raises
    ------
    InputError
        If the certificate is wrong or not valid, or the filter does not reach a band.
    """
    path = standard or (room.files / EXAMPLE if room.files else None)
    if path is None or not path.is_file():
        raise InputError("--standard: missing; expected the certificate of a wavelength standard")
    certificate = read_form(path, WavelengthStandard)
    if objection := _not_valid(certificate, room.clock.now().date()):
        if not accept_expired:
            raise InputError(f"{path}: {objection}; --accept-expired goes on, and the result says so")
        room.notes.append(f"{certificate.identity}: {objection}; accepted by the operator")
    grids = [
        np.arange(band.wavelength - band.reach, band.wavelength + band.reach + step / 2, step)
        for band in certificate.band
    ]
    room.station.light.check_range(float(nm) for grid in grids for nm in grid)
    room.home()
    spectra: dict[str, list[tuple[FloatArray, FloatArray]]] = {}
    for what in ("reference", "wavelength_standard"):
        room.mount(what)
        room.light()
        spectra[what] = [_spectrum(room, grid, samples) for grid in grids]
    values: dict[str, Quantity] = {}
    wrong, readings = [], []
    for band, grid, white, seen in zip(
        certificate.band, grids, spectra["reference"], spectra["wavelength_standard"], strict=True
    ):
        ratio = seen[0] / white[0]
        centre, u = _minimum(grid, ratio, ratio * np.hypot(seen[1], white[1]), band.wavelength)
        error, u_error = band.wavelength - centre, float(np.hypot(u, band.u))
        room.say(f"{band.wavelength:g} nm: {error:+.3f} ± {u_error:.3f} nm")
        values[f"error at {band.wavelength:g} nm"] = Quantity(value=error, u=u_error, unit="nm")
        readings.append({"band": band.wavelength, "shown": grid.tolist(), "ratio": ratio.tolist()})
        if beyond(error, u_error, allowed):
            wrong.append(f"{error:+.2f} nm at {band.wavelength:g} nm")
    return Finding(
        verdict="failed" if wrong else "passed",
        summary=("true less shown wavelength: " + "; ".join(wrong))
        if wrong
        else f"every band within {2 * allowed:g} nm",
        values=values,
        advice=("calibrate the filter's wavelength scale",) if wrong else (),
        readings=tuple(readings),
        subject=certificate.identity,
    )


def _not_valid(certificate: WavelengthStandard, today: date) -> str:
    if today > certificate.valid_until:
        return f"expired on {certificate.valid_until}"
    if today < certificate.valid_from:
        return f"valid from {certificate.valid_from} on only"
    return ""


def _spectrum(room: Room, grid: FloatArray, samples: int) -> tuple[FloatArray, FloatArray]:
    """Photocurrents at the reference geometry and their relative standard errors, shape (wavelength,)."""
    currents, errors = [], []
    for wavelength in grid:
        room.go_to_reference(round(float(wavelength), 3))
        burst, _ = room.station.read(samples)
        currents.append(burst.current)
        errors.append(relative_error(burst))
    return np.array(currents), np.array(errors)


def _minimum(grid: FloatArray, ratio: FloatArray, u: FloatArray, guess: float) -> tuple[float, float]:
    """Middle of a band (nm) and its standard error, from a Gaussian on a sloping ground.

    Raises
    ------
    InputError
        If there is no band.
    """
    from scipy.optimize import least_squares

    def residuals(parameters: FloatArray) -> FloatArray:
        level, slope, depth, centre, width = parameters
        ground = level * (1 + slope * (grid - guess))
        return np.asarray((ground * (1 - depth * np.exp(-0.5 * ((grid - centre) / width) ** 2)) - ratio) / u)

    start = (float(ratio.max()), 0.0, 1 - float(ratio.min() / ratio.max()), float(grid[np.argmin(ratio)]), 4.0)
    fit = least_squares(residuals, start, x_scale="jac")
    depth, centre = float(fit.x[2]), float(fit.x[3])
    if not fit.success or depth < 0.02 or not grid[0] <= centre <= grid[-1]:
        raise InputError(f"no absorption band around {guess:g} nm; is the wavelength standard on the stage?")
    slopes = np.asarray(fit.jac, dtype=float)
    covariance = np.linalg.pinv(slopes.T @ slopes)
    chi_square = 2 * float(fit.cost) / max(len(grid) - len(start), 1)
    return centre, float(np.sqrt(covariance[3, 3] * max(chi_square, 1.0)))

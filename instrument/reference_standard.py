"""The reference standard and its certificate: who it is, until when it holds, and what it reflects.

``facility.toml`` names the certificate (``reference.certificate``); a run folder holds it inside a ``facility.toml`` of
its own. Form and meaning: ``docs/calibration.md``.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from datetime import date
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator

from instrument.forms import Form

if TYPE_CHECKING:
    from instrument.facility import Facility

Positive = Annotated[float, Field(gt=0)]
#: Where the header of a journal keeps what an operator accepted of a certificate.
ACCEPTED = "reference_objections"
#: Two angles of the same geometry may differ by so much, degree.
SAME_ANGLE = 0.05


class CertifiedFactor(Form):
    """One line of a certificate: nm, degree, reflectance factor and its absolute standard uncertainty (k = 1)."""

    wavelength: Positive
    illumination_zenith: float = 0.0
    sensor_zenith: float
    value: Positive
    u: Annotated[float, Field(ge=0)]


class ReferenceStandard(Form):
    """A certificate.

    The reflectance factor is taken to depend on the two zenith angles and the wavelength only.
    """

    version: Literal[1] = 1
    identity: Annotated[str, Field(min_length=1)]
    issuer: str = ""
    number: str = ""
    valid_from: date
    valid_until: date
    reflectance_factor: Annotated[tuple[CertifiedFactor, ...], Field(min_length=1)]

    @model_validator(mode="after")
    def _consistent(self) -> ReferenceStandard:
        if self.valid_until < self.valid_from:
            raise ValueError(f"valid_until ({self.valid_until}) lies before valid_from ({self.valid_from})")
        keys = [(f.wavelength, f.illumination_zenith, f.sensor_zenith) for f in self.reflectance_factor]
        twice = next((key for key in keys if keys.count(key) > 1), None)
        if twice is not None:
            raise ValueError(f"two values at {twice[0]:g} nm, illumination {twice[1]:g}, sensor zenith {twice[2]:g}")
        return self

    def wavelengths(self) -> tuple[float, ...]:
        """Every wavelength of the certificate, nm, ascending."""
        return tuple(sorted({factor.wavelength for factor in self.reflectance_factor}))


@dataclass(frozen=True)
class FactorAt:
    """Reflectance factor in one geometry at one wavelength, its relative standard uncertainty, and what is amiss."""

    value: float
    u_relative: float
    objections: tuple[str, ...] = ()


def factor_at(
    standard: ReferenceStandard, wavelength: float, illumination_zenith: float, sensor_zenith: float
) -> FactorAt:
    """What a certificate says of a geometry.

    Between certified wavelengths, and between certified sensor zeniths of the same illumination, values are
    interpolated linearly and the larger uncertainty counts. Beyond them the nearest value stands, with an objection.

    Parameters
    ----------
    wavelength
        nm.
    illumination_zenith, sensor_zenith
        Degree; the sign of the sensor zenith does not matter.
    """
    lines = [f for f in standard.reflectance_factor if _same(f.illumination_zenith, illumination_zenith)]
    objections = []
    if not lines:
        known = sorted({f.illumination_zenith for f in standard.reflectance_factor})
        nearest = min(known, key=lambda angle: abs(abs(angle) - abs(illumination_zenith)))
        objections.append(
            f"illumination zenith {illumination_zenith:g} is not certified (found {', '.join(f'{a:g}' for a in known)})"
        )
        lines = [f for f in standard.reflectance_factor if f.illumination_zenith == nearest]
    zeniths = sorted({abs(f.sensor_zenith) for f in lines})
    low, high, outside = _neighbours(zeniths, abs(sensor_zenith), SAME_ANGLE)
    if outside:
        objections.append(
            f"sensor zenith {sensor_zenith:g} is not certified (found {zeniths[0]:g} to {zeniths[-1]:g} degrees)"
        )
    ends = []
    for zenith in (low, high):
        curve = sorted((f.wavelength, f.value, f.u / f.value) for f in lines if abs(f.sensor_zenith) == zenith)
        value, relative, beyond = _along(curve, wavelength)
        if beyond and not any("nm" in objection for objection in objections):
            objections.append(f"{wavelength:g} nm is not certified (found {curve[0][0]:g} to {curve[-1][0]:g} nm)")
        ends.append((value, relative))
    share = 0.0 if high == low else (abs(sensor_zenith) - low) / (high - low)
    share = min(max(share, 0.0), 1.0)
    value = (1 - share) * ends[0][0] + share * ends[1][0]
    used = [end[1] for end, weight in zip(ends, (1 - share, share), strict=True) if weight > 0]
    return FactorAt(value, max(used), tuple(objections))


def objections(
    standard: ReferenceStandard,
    today: date,
    wavelengths: Iterable[float],
    illumination_zenith: float,
    sensor_zenith: float,
) -> list[str]:
    """Why a certificate does not cover what is to be measured; empty where it does.

    Parameters
    ----------
    today
        Of the measurement; the last day of validity counts as valid.
    wavelengths
        nm.
    illumination_zenith, sensor_zenith
        Of the reference reading, degree.
    """
    found = []
    if today > standard.valid_until:
        found.append(f"expired on {standard.valid_until} ({(today - standard.valid_until).days} days ago)")
    if today < standard.valid_from:
        found.append(f"is valid from {standard.valid_from} on only")
    for wavelength in sorted(set(wavelengths)):
        found += factor_at(standard, wavelength, illumination_zenith, sensor_zenith).objections
    return list(dict.fromkeys(found))


def _same(first: float, second: float) -> bool:
    return math.isclose(abs(first), abs(second), abs_tol=SAME_ANGLE)


def _neighbours(known: list[float], wanted: float, slack: float) -> tuple[float, float, bool]:
    """The two known values around a wanted one; both the nearest, and True, where it lies outside."""
    nearest = min(known, key=lambda value: abs(value - wanted))
    if abs(nearest - wanted) <= slack:
        return nearest, nearest, False
    below, above = [v for v in known if v < wanted], [v for v in known if v > wanted]
    if not below or not above:
        return nearest, nearest, True
    return below[-1], above[0], False


def _along(curve: list[tuple[float, float, float]], wavelength: float) -> tuple[float, float, bool]:
    """Value and relative uncertainty at a wavelength, and whether it lies beyond the curve."""
    low, high, outside = _neighbours([nm for nm, _, _ in curve], wavelength, 1e-3)
    value = np.interp(wavelength, [nm for nm, _, _ in curve], [value for _, value, _ in curve])
    return float(value), max(relative for nm, _, relative in curve if nm in (low, high)), outside


def at_wavelength(facility: Facility, wavelength: float) -> Facility:
    """A facility whose reference is what its certificate says at a wavelength (nm); the same one without certificate.

    The certificate's uncertainty takes the place of ``reference.u_relative`` and of the budget's row
    ``reference_material``. What the certificate does not cover is taken from its nearest line: whoever starts a scan is
    asked about that before (:func:`objections`).
    """
    standard = facility.reference.standard
    if standard is None:
        return facility
    known = facility.reference
    factor = factor_at(standard, wavelength, known.illumination_zenith, known.sensor_zenith)
    reference = known.model_copy(update={"reflectance_factor": factor.value, "u_relative": factor.u_relative})
    budget = facility.budget.model_copy(update={"reference_material": factor.u_relative})
    return facility.model_copy(update={"reference": reference, "budget": budget})


def described_reference(header: Mapping[str, Any], standard: ReferenceStandard | None) -> dict[str, str]:
    """Global attributes of a run file that say which standard it was scaled with, and what was amiss with it."""
    if standard is None:
        return {}
    attributes = {
        "reference_standard": standard.identity,
        "reference_certificate": " ".join(filter(None, (standard.issuer, standard.number))),
        "reference_valid_until": str(standard.valid_until),
        "reference_objections": "; ".join(header.get(ACCEPTED, ())),
    }
    return {name: value for name, value in attributes.items() if value}

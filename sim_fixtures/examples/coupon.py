"""A run over the witness coupon, as the simulated instrument would have recorded it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray as xr

from instrument.angles import FloatArray
from instrument.artifact import ArtifactDimensions, ArtifactForm, Holes
from instrument.facility import Budget, Budgeted, Facility
from instrument.plan import Plan
from sim_fixtures.reality import Imperfections, Reality

_START = np.datetime64("2026-03-02T08:00:00", "ns")
PACE_S = 3600.0 / 162.0  # the paper's 162 points an hour
REFERENCE_CURRENT = 1.01e-6  # A a reflectance factor of 1 gives at the reference geometry
GAINS = (1e6, 1e7)  # V/A
LOW_SIGNAL = 0.25  # V; below this the higher gain is used
DARK, U_DARK = 2e-4, 5e-5  # V
RESOLUTION = 1e-6  # V, of the voltmeter
REFERENCE_NOISE = 3e-4  # relative, a reading
_MOUNTING = 2  # the artifact's own is 0
_ANOTHER_DAY = 1_000_003  # between the seeds of this run and of the artifact's: their stability is not shared

#: Rows of the budget as variables of the run file, and their correlation over points (None: not stated).
COMPONENTS: dict[str, tuple[str, str | None]] = {
    "measurement_noise": ("noise", "random"),
    "instrument_stability": ("stability", None),
    "wavelength": ("wavelength", "systematic"),
    "straylight": ("straylight", "systematic"),
    "detector_linearity": ("linearity", "systematic"),
    "beam_and_placement": ("placement", "systematic"),
    "illumination_zenith": ("illumination_zenith", "systematic"),
    "sensor_zenith": ("sensor_zenith", "systematic"),
    "sensor_azimuth": ("sensor_azimuth", "systematic"),
    "surface_level": ("surface_level", "systematic"),
    "polarization": ("polarization", "systematic"),
    "reference_material": ("reference", "systematic"),
}


def flat_sample() -> ArtifactDimensions:
    """A coated plate of 50 x 50 mm without holes."""
    none = np.zeros(0)
    return ArtifactDimensions(ArtifactForm(), Holes(none, none, none, none, none, none), None, Path("witness coupon"))


def coupon_run(facility: Facility, plan: Plan, seed: int) -> xr.Dataset:
    """Measure the witness coupon.

    Parameters
    ----------
    facility, plan
        The instrument, and the points (Table III).
    seed
        Of the instrument's errors, the placement, the stability and the noise.

    Returns
    -------
    Dataset
        The run file of the data contract, all variables.
    """
    wrong = Imperfections.within_budget(facility, seed, _MOUNTING)
    reality = Reality(facility, flat_sample(), wrong, seed + _ANOTHER_DAY, rays=16384)
    points = Points.of(plan)
    generator = np.random.default_rng((seed, 6))
    flux, scale = _fluxes(reality, points)
    noise = relative_budget(facility.budget, "measurement_noise", points) * np.sqrt(plan.samples)
    signal, dark, gain = _readings(generator, flux, noise, plan.samples)
    reference = _reference(reality, generator, plan.samples)
    stated = facility.reference.reflectance_factor
    current = (signal.mean(axis=1) - dark) / gain
    unit = np.mean((reference["signal"].mean(axis=1) - reference["dark"]) / reference["gain"]) / stated
    return run_dataset(facility, plan, points, (signal, dark, gain), reference, current / unit / scale)


@dataclass(frozen=True)
class Points:
    """Angles (degree) and wavelengths (nm) of a plan, shape (point,) each, in the order of measurement."""

    wavelength: FloatArray
    illumination_zenith: FloatArray
    illumination_azimuth: FloatArray
    sensor_zenith: FloatArray
    sensor_azimuth: FloatArray

    @classmethod
    def of(cls, plan: Plan) -> Points:
        names = cls.__dataclass_fields__
        return cls(*(np.array([getattr(point, name) for point in plan.points], dtype=float) for name in names))


def relative_budget(budget: Budget, row: str, points: Points) -> FloatArray:
    """A row of the budget at every point, relative (data contract, section Facility)."""
    given: Budgeted | str = getattr(budget, row)
    if isinstance(given, str):  # what is left to samples or slopes has no number; files made here go without
        given = 0.0
    best, worst = given if isinstance(given, tuple) else (given, given)
    progress = (np.abs(points.sensor_zenith) / 80.0) ** (1 if row == "detector_linearity" else 2)
    if row == "illumination_zenith":
        progress = np.abs(points.illumination_zenith) / 60.0
    return np.asarray(best + (worst - best) * progress, dtype=np.float64)


def _fluxes(reality: Reality, points: Points) -> tuple[FloatArray, FloatArray]:
    geometries = list(zip(points.illumination_zenith, points.sensor_zenith, points.sensor_azimuth, strict=True))
    flux = [reality.flux("sample", *g, w) for g, w in zip(geometries, points.wavelength, strict=True)]
    return np.array(flux), np.array([reality.normalisation(*geometry) for geometry in geometries])


def _readings(
    generator: np.random.Generator, flux: FloatArray, noise: FloatArray, samples: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Voltages (point, sample), dark voltages and gains (point,)."""
    current = flux * REFERENCE_CURRENT
    gain = np.where(current * GAINS[0] < LOW_SIGNAL, GAINS[1], GAINS[0])
    dark = DARK + U_DARK * generator.standard_normal(len(flux))
    # Heavier tails than normal, as speckle and the odd disturbance make them; the factor restores the variance.
    deviation = generator.standard_t(6, (len(flux), samples)) * np.sqrt(4.0 / 6.0)
    signal = DARK + (current * gain)[:, None] * (1.0 + noise[:, None] * deviation)
    return np.round(signal / RESOLUTION) * RESOLUTION, np.round(dark / RESOLUTION) * RESOLUTION, gain


def _reference(reality: Reality, generator: np.random.Generator, samples: int) -> dict[str, FloatArray]:
    form = reality.facility.reference
    azimuth = np.array(form.sensor_azimuth)
    zenith = np.full(len(azimuth), form.sensor_zenith)
    flux = reality.flux_many("reference", form.illumination_zenith, zenith, azimuth)
    signal, dark, gain = _readings(generator, flux, np.full(len(azimuth), REFERENCE_NOISE), samples)
    return {"sensor_azimuth": azimuth, "signal": signal, "dark": dark, "gain": gain}


def run_dataset(
    facility: Facility,
    plan: Plan,
    points: Points,
    readings: tuple[FloatArray, FloatArray, FloatArray],
    reference: dict[str, FloatArray],
    brf: FloatArray,
) -> xr.Dataset:
    """The run file of readings: signal (point, sample), dark and gain (point,), the reference's by name."""
    signal, dark, gain = readings
    count = len(brf)
    coordinates: dict[str, tuple[str, FloatArray, dict[str, str]]] = {
        name: ("point", getattr(points, name), {"units": "nm" if name == "wavelength" else "degree"})
        for name in points.__dataclass_fields__
    }
    step = np.timedelta64(round(PACE_S * 1e3), "ms")
    before = _START - np.timedelta64(20, "m") + np.arange(len(reference["gain"])) * np.timedelta64(1, "m")
    data = xr.Dataset(
        {
            "signal": (("point", "sample"), signal, {"units": "V", "long_name": "detector voltage"}),
            "dark": ("point", dark, {"units": "V"}),
            "gain": ("point", gain, {"units": "V A-1", "long_name": "transimpedance gain"}),
            "reference_signal": (("reference", "sample"), reference["signal"], {"units": "V"}),
            "reference_sensor_azimuth": ("reference", reference["sensor_azimuth"], {"units": "degree"}),
            "reference_gain": ("reference", reference["gain"], {"units": "V A-1"}),
            "reference_dark": ("reference", reference["dark"], {"units": "V"}),
            "reference_time": ("reference", before),
            "brf": ("point", brf, {"units": "1", "long_name": "bidirectional reflectance factor"}),
        },
        coords={**coordinates, "time": ("point", _START + np.arange(count) * step)},
        attrs={
            "Conventions": "CF-1.11",
            "title": plan.title,
            "reference_reflectance_factor": facility.reference.reflectance_factor,
            "reference_illumination_zenith": facility.reference.illumination_zenith,
            "reference_sensor_zenith": facility.reference.sensor_zenith,
            "scan_direction": plan.direction,
        },
    )
    return _with_flags(_with_uncertainties(data, facility.budget, points))


def _with_uncertainties(data: xr.Dataset, budget: Budget, points: Points) -> xr.Dataset:
    brf = np.abs(data["brf"].values)
    squares = np.zeros_like(brf)
    for row, (name, form) in COMPONENTS.items():
        values = relative_budget(budget, row, points) * brf
        squares += values**2
        attributes: dict[str, object] = {
            "units": "1",
            "long_name": f"standard uncertainty (k=1) of brf: {name}",
            "pdf_shape": "gaussian",
        }
        if form is not None:
            attributes |= {
                "err_corr_1_dim": "point",
                "err_corr_1_form": form,
                "err_corr_1_params": np.zeros(0),
                "err_corr_1_units": np.zeros(0),
            }
        data[f"u_brf_{name}"] = ("point", values, attributes)
    data["brf"].attrs["unc_comps"] = [f"u_brf_{name}" for name, _ in COMPONENTS.values()]
    data["u_brf"] = (
        "point",
        np.sqrt(squares),
        {"units": "1", "long_name": "combined standard uncertainty (k=1) of brf"},
    )
    return data


def _with_flags(data: xr.Dataset) -> xr.Dataset:
    data["quality_flag"] = (
        "point",
        np.zeros(data.sizes["point"], dtype=np.int8),
        {"flag_masks": np.array([1, 2, 4, 8], dtype=np.int8), "flag_meanings": "saturated overload shadowed repeated"},
    )
    return data

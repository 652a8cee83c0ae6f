"""The control sample: a piece that never changes, measured often. Its chart: :mod:`instrument.procedures.chart`."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from instrument.calibration import Photocurrent, brf_from_readings
from instrument.errors import InputError
from instrument.procedures.chart import chart_of, judge
from instrument.procedures.reading import relative_error
from instrument.procedures.results import Finding, Quantity, read_results
from instrument.procedures.room import Room
from instrument.reference_standard import at_wavelength

PROCEDURE = "control-sample"
#: Illumination zenith, sensor zenith, sensor azimuth: degree.
GEOMETRIES = ((0.0, 15.0, 0.0), (0.0, 45.0, 90.0), (45.0, 0.0, 0.0), (30.0, -45.0, 0.0))


def control_sample(
    room: Room, subject: str, wavelength: float = 500.0, samples: int = 9, results: Path | None = None
) -> Finding:
    """Measure reflectance factors of the control sample against the reference, and hold them against its chart.

    Parameters
    ----------
    subject
        Which control sample: the name under which its results are kept.
    results
        Folder of the results so far.

    Raises
    ------
    InputError
        If the sample has no name.
    """
    if not subject.strip():
        raise InputError("--sample: missing; expected the name of the control sample")
    room.home()
    known = room.facility.reference
    room.mount("reference")
    room.light()
    reference = [
        _reading(room, known.illumination_zenith, known.sensor_zenith, azimuth, wavelength, samples)
        for azimuth in known.sensor_azimuth
    ]
    room.mount("control_sample")
    room.light()
    points = [_reading(room, *geometry, wavelength, samples) for geometry in GEOMETRIES]
    calibrated = brf_from_readings(
        at_wavelength(room.facility, wavelength),
        [g[0] for g in GEOMETRIES],
        [g[1] for g in GEOMETRIES],
        [g[2] for g in GEOMETRIES],
        _currents(points),
        known.sensor_azimuth,
        _currents(reference),
    )
    values = {
        name_of(geometry, wavelength): Quantity(value=float(brf), u=float(error), unit="1")
        for geometry, brf, error in zip(GEOMETRIES, calibrated.brf, calibrated.standard_error, strict=True)
    }
    before = read_results(results, PROCEDURE, subject) if results else []
    verdicts = {
        name: judge(chart_of(before, name, room.facility.budget, (datetime.now(UTC), quantity.value)))
        for name, quantity in values.items()
    }
    acts = [f"{name}: {verdict.reason}" for name, verdict in verdicts.items() if verdict.level == "act"]
    warnings = [f"{name}: {verdict.reason}" for name, verdict in verdicts.items() if verdict.level == "warn"]
    room.notes += warnings
    state = "out of control: " + "; ".join(acts) if acts else "in control"
    if warnings and not acts:
        state = "warning: " + "; ".join(warnings)
    return Finding(
        verdict="failed" if acts else "passed",
        summary=f"{subject}: {state} ({len(before)} results before)",
        values=values,
        advice=("repeat it; then look at reference, control sample and alignment before measuring",) if acts else (),
        subject=subject,
    )


def name_of(geometry: tuple[float, float, float], wavelength: float) -> str:
    """Name of a geometry in results: ``brf 500 nm 0/45/90`` (illumination zenith, sensor zenith, azimuth)."""
    return f"brf {wavelength:g} nm " + "/".join(f"{angle:g}" for angle in geometry)


def _reading(
    room: Room, illumination: float, zenith: float, azimuth: float, wavelength: float, samples: int
) -> tuple[float, float]:
    room.go(illumination, zenith, azimuth, wavelength)
    burst, _ = room.station.read(samples)
    return burst.current, burst.current * relative_error(burst)


def _currents(readings: list[tuple[float, float]]) -> Photocurrent:
    current, error = np.array(readings).T
    if not math.isfinite(float(np.sum(current))):
        raise InputError("a reading is no number")
    return Photocurrent(current, error)

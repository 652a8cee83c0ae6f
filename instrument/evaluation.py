"""From one reading to a reflectance factor, while the scan runs. ``run.nc`` is computed anew from the journal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from instrument.budget import combined, point_budget
from instrument.calibration import Photocurrent, brf_from_readings, calibration_numbers, photocurrent
from instrument.errors import InputError
from instrument.events import Geometry
from instrument.facility import Facility


class Evaluator:
    """Knows the reference readings, and what a reading means against them.

    The reflectance factor is proportional to the photocurrent: what one ampere means at each point of the plan is
    computed for all of them at once, when the first point of a wavelength is read. Readings of the last calibration
    count, by the rule that ``run.nc`` is made with.
    """

    def __init__(self, facility: Facility, points: Sequence[Geometry]) -> None:
        self._facility, self._points = facility, points
        self._references: list[dict[str, Any]] = []
        self._per_ampere: dict[Geometry, float] = {}

    def add_reference(self, index: int, geometry: Geometry, record: Mapping[str, Any]) -> None:
        """Take in one reading of the reference sample (a record of the journal)."""
        self._references.append({**record, "index": index, "geometry": geometry})
        self._per_ampere.clear()

    def brf(self, geometry: Geometry, record: Mapping[str, Any]) -> tuple[float, float]:
        """Reflectance factor of a reading at a point of the plan, and its combined standard uncertainty.

        Raises
        ------
        InputError
            If no reference was read at this wavelength.
        """
        if geometry not in self._per_ampere:
            self._prepare(geometry.wavelength)
        reading = photocurrent([record["signal"]], [record["dark"]], [record["gain"]])
        brf = self._per_ampere[geometry] * float(reading.current[0])
        parts = point_budget(self._facility.budget, [geometry.illumination_zenith], [geometry.sensor_zenith], [brf])
        return brf, float(combined(parts)[0])

    def _prepare(self, wavelength: float) -> None:
        numbers = calibration_numbers(reading["index"] for reading in self._references)
        readings = [
            reading
            for number, reading in zip(numbers, self._references, strict=True)
            if number == numbers[-1] and reading["geometry"].wavelength == wavelength
        ]
        if not readings:
            raise InputError(f"no reading of the reference at {wavelength:g} nm; the reflectance factor is unknown")
        points = [point for point in self._points if point.wavelength == wavelength]
        one_ampere = Photocurrent(np.ones(len(points)), np.zeros(len(points)))
        calibrated = brf_from_readings(
            self._facility,
            [point.illumination_zenith for point in points],
            [point.sensor_zenith for point in points],
            [point.sensor_azimuth for point in points],
            one_ampere,
            [reading["geometry"].sensor_azimuth for reading in readings],
            photocurrent(*([reading[key] for reading in readings] for key in ("signal", "dark", "gain"))),
            illumination_azimuth=[point.illumination_azimuth for point in points],
        )
        self._per_ampere.update(zip(points, calibrated.brf.tolist(), strict=True))

"""From one reading to a reflectance factor, while the scan runs. ``run.nc`` is computed anew from the journal."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from typing import Any

import numpy as np

from instrument.budget import combined, point_budget
from instrument.calibration import Photocurrent, brf_from_readings, photocurrent
from instrument.errors import InputError
from instrument.events import Geometry
from instrument.facility import Facility


class Evaluator:
    """Knows the reference readings, and what a reading means against them.

    The reflectance factor is proportional to the photocurrent: what one ampere means at each point of the plan is
    computed for all of them at once, when the first point of a wavelength is read.
    """

    def __init__(self, facility: Facility, points: Sequence[Geometry]) -> None:
        self._facility, self._points = facility, points
        self._azimuth: dict[float, list[float]] = defaultdict(list)
        self._current: dict[float, list[float]] = defaultdict(list)
        self._error: dict[float, list[float]] = defaultdict(list)
        self._per_ampere: dict[Geometry, float] = {}

    def add_reference(self, geometry: Geometry, record: dict[str, Any]) -> None:
        """Take in one reading of the reference sample (a record of the journal)."""
        reading = photocurrent([record["signal"]], [record["dark"]], [record["gain"]])
        self._azimuth[geometry.wavelength].append(geometry.sensor_azimuth)
        self._current[geometry.wavelength].append(float(reading.current[0]))
        self._error[geometry.wavelength].append(float(reading.standard_error[0]))
        self._per_ampere.clear()

    def brf(self, geometry: Geometry, record: dict[str, Any]) -> tuple[float, float]:
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
        if not self._current[wavelength]:
            raise InputError(f"no reading of the reference at {wavelength:g} nm; the reflectance factor is unknown")
        points = [point for point in self._points if point.wavelength == wavelength]
        one_ampere = Photocurrent(np.ones(len(points)), np.zeros(len(points)))
        calibrated = brf_from_readings(
            self._facility,
            [point.illumination_zenith for point in points],
            [point.sensor_zenith for point in points],
            [point.sensor_azimuth for point in points],
            one_ampere,
            self._azimuth[wavelength],
            Photocurrent(np.array(self._current[wavelength]), np.array(self._error[wavelength])),
            illumination_azimuth=[point.illumination_azimuth for point in points],
        )
        self._per_ampere.update(zip(points, calibrated.brf.tolist(), strict=True))

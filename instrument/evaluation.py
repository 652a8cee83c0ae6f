"""From one reading to a reflectance factor, while the scan runs. ``run.nc`` is computed anew from the journal."""

from __future__ import annotations

from collections import defaultdict
from typing import Any

import numpy as np

from instrument.budget import combined, point_budget
from instrument.calibration import Photocurrent, brf_from_readings, photocurrent
from instrument.errors import InputError
from instrument.events import Geometry
from instrument.facility import Facility


class Evaluator:
    """Knows the reference readings, and what a reading means against them."""

    def __init__(self, facility: Facility) -> None:
        self._facility = facility
        self._azimuth: dict[float, list[float]] = defaultdict(list)
        self._current: dict[float, list[float]] = defaultdict(list)
        self._error: dict[float, list[float]] = defaultdict(list)

    def add_reference(self, geometry: Geometry, record: dict[str, Any]) -> None:
        """Take in one reading of the reference sample (a record of the journal)."""
        reading = photocurrent([record["signal"]], [record["dark"]], [record["gain"]])
        self._azimuth[geometry.wavelength].append(geometry.sensor_azimuth)
        self._current[geometry.wavelength].append(float(reading.current[0]))
        self._error[geometry.wavelength].append(float(reading.standard_error[0]))

    def brf(self, geometry: Geometry, record: dict[str, Any]) -> tuple[float, float]:
        """Reflectance factor of a reading and its combined standard uncertainty.

        Raises
        ------
        InputError
            If no reference was read at this wavelength.
        """
        wavelength = geometry.wavelength
        if not self._current[wavelength]:
            raise InputError(f"no reading of the reference at {wavelength:g} nm; the reflectance factor is unknown")
        calibrated = brf_from_readings(
            self._facility,
            [geometry.illumination_zenith],
            [geometry.sensor_zenith],
            [geometry.sensor_azimuth],
            photocurrent([record["signal"]], [record["dark"]], [record["gain"]]),
            self._azimuth[wavelength],
            Photocurrent(np.array(self._current[wavelength]), np.array(self._error[wavelength])),
            illumination_azimuth=[geometry.illumination_azimuth],
        )
        brf = calibrated.brf
        parts = point_budget(self._facility.budget, [geometry.illumination_zenith], [geometry.sensor_zenith], brf)
        return float(brf[0]), float(combined(parts)[0])

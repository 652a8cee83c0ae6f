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
from instrument.monitor import normalised
from instrument.quality.slopes import ANGLES, AngleTerm, Slope, angle_terms
from instrument.reference_standard import at_wavelength


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
        self._monitored = False
        #: Relative angle terms by row, as far as the flux alone tells them: neighbours are not measured yet.
        self._flux_terms: dict[Geometry, dict[str, float]] = {}

    def add_reference(self, index: int, geometry: Geometry, record: Mapping[str, Any]) -> None:
        """Take in one reading of the reference sample (a record of the journal)."""
        self._references.append({**record, "index": index, "geometry": geometry})
        self._per_ampere.clear()

    def brf(self, geometry: Geometry, record: Mapping[str, Any]) -> tuple[float, float]:
        """Reflectance factor of a reading at a point of the plan, and its combined standard uncertainty.

        Angle terms that the budget leaves to the slope lack that of the reflectance factor until the run is made.

        Raises
        ------
        InputError
            If no reference was read at this wavelength.
        """
        if geometry not in self._per_ampere:
            self._prepare(_light(geometry))
        budget = at_wavelength(self._facility, geometry.wavelength).budget
        noise = budget.measurement_noise == "samples"
        dark = [record["dark_signal"]] if noise and record.get("dark_signal") else None
        reading = photocurrent([record["signal"]], [record["dark"]], [record["gain"]], dark)
        if self._monitored and "monitor" in record:
            reading = normalised(reading, np.array([record["monitor"]]))
        brf = self._per_ampere[geometry] * float(reading.current[0])
        found = {row: brf * share for row, share in self._flux_terms[geometry].items()}
        if noise:
            found["measurement_noise"] = brf * float(reading.standard_error[0] / reading.current[0])
        parts = point_budget(budget, [geometry.illumination_zenith], [geometry.sensor_zenith], [brf], found)
        return brf, float(combined(parts)[0])

    def _prepare(self, light: tuple[float, str]) -> None:
        numbers = calibration_numbers(reading["index"] for reading in self._references)
        readings = [
            reading
            for number, reading in zip(numbers, self._references, strict=True)
            if number == numbers[-1] and _light(reading["geometry"]) == light
        ]
        if not readings:
            name = f"{light[0]:g} nm" + (f", polarisation {light[1]}" if light[1] else "")
            raise InputError(f"no reading of the reference at {name}; the reflectance factor is unknown")
        points = [point for point in self._points if _light(point) == light]
        one_ampere = Photocurrent(np.ones(len(points)), np.zeros(len(points)))
        calibrated = brf_from_readings(
            at_wavelength(self._facility, light[0]),
            [point.illumination_zenith for point in points],
            [point.sensor_zenith for point in points],
            [point.sensor_azimuth for point in points],
            one_ampere,
            [reading["geometry"].sensor_azimuth for reading in readings],
            self._reference_current(readings),
            illumination_azimuth=[point.illumination_azimuth for point in points],
        )
        self._per_ampere.update(zip(points, calibrated.brf.tolist(), strict=True))
        terms = {row: term.signed.tolist() for row, term in self._angle_terms(points).items()}
        for number, point in enumerate(points):
            self._flux_terms[point] = {row: values[number] for row, values in terms.items()}

    def _reference_current(self, readings: Sequence[Mapping[str, Any]]) -> Photocurrent:
        current = photocurrent(*([reading[key] for reading in readings] for key in ("signal", "dark", "gain")))
        self._monitored = all("monitor" in reading for reading in readings)
        return normalised(current, np.array([r["monitor"] for r in readings]) if self._monitored else None)

    def _angle_terms(self, points: Sequence[Geometry]) -> dict[str, AngleTerm]:
        names = (*ANGLES, "illumination_azimuth")
        columns = {name: np.array([getattr(point, name) for point in points]) for name in names}
        flat = Slope(np.zeros(len(points)), np.ones(len(points), dtype=bool))
        return angle_terms(self._facility, columns, np.ones(len(points)), dict.fromkeys(ANGLES, flat))


def _light(geometry: Geometry) -> tuple[float, str]:
    """What a reading of the reference must share with a point: wavelength and polarisation."""
    return geometry.wavelength, geometry.polarization or ""

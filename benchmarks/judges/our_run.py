"""A run file for judges of files: two planes at two illuminations, noise from samples, angle terms from slopes."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from instrument.dataset import build_run, write_run
from instrument.exchange.documents import to_line
from instrument.exchange.following import documents
from instrument.facility import Facility, read_facility
from instrument.journal import Journal
from instrument.lambertian import lambertian_flux
from sim_fixtures.examples import example_files

_GAIN, _DARK = 1e6, 2e-4


def write_example(path: Path) -> Path:
    """Make the file; the sample's reflectance factor has a valley on the normal, so slopes differ in sign."""
    facility, header, points, references = _example()
    write_run(build_run(header, points, references, facility), path)
    return path


def write_documents(folder: Path) -> Path:
    """The same measurement as a journal, and as the documents of its run (``run.jsonl``)."""
    _, header, points, references = _example()
    with Journal.create(folder, header) as journal:
        for record in references:
            journal.record("reference", **record)
        for record in points:
            journal.record("point", **record | {"readback": {"sensor_zenith": record["geometry"]["sensor_zenith"]}})
        end = points[-1]["time"] + timedelta(seconds=20)
        journal.record("state", time=end, old="point", new="finished")
        journal.record("ended", time=end, outcome="finished", reason="")
    path = folder / "run.jsonl"
    path.write_text("".join(f"{to_line(document)}\n" for document in documents(folder)), encoding="utf-8")
    return path


def _example() -> tuple[Facility, dict[str, Any], list[dict[str, Any]], list[dict[str, Any]]]:
    """Facility, header, points and references of the measurement."""
    known = read_facility(example_files().facility)
    budget = known.budget.model_copy(
        update={"measurement_noise": "samples", "illumination_zenith": "slope", "sensor_zenith": "slope"}
    )
    facility = known.model_copy(update={"budget": budget})
    random, begin = np.random.default_rng(1), datetime(2026, 3, 2, 8, tzinfo=UTC)

    def record(index: int, illumination: float, zenith: float, azimuth: float, brf: float) -> dict[str, Any]:
        flux = float(lambertian_flux(facility, illumination, zenith, azimuth))
        angles = {"illumination_zenith": illumination, "sensor_zenith": zenith, "sensor_azimuth": azimuth}
        return {
            "index": index,
            "geometry": angles | {"wavelength": 500.0, "illumination_azimuth": 0.0},
            "time": begin + timedelta(seconds=20 * index),
            "signal": (_DARK + 1e-6 * _GAIN * brf * flux * (1 + 0.01 * random.standard_normal(9))).tolist(),
            "dark": _DARK,
            "dark_signal": (_DARK + 1e-5 * random.standard_normal(9)).tolist(),
            "gain": _GAIN,
        }

    references = [record(number, 0.0, 15.0, 45.0 * number, 0.99) for number in range(4)]
    grid = [(i, z, a) for i in (0.0, 15.0) for a in (60.0, 90.0) for z in np.arange(-60.0, 61.0, 10.0).tolist()]
    points = [record(4 + n, i, z, a, 0.4 + 1e-4 * z**2 + 1e-3 * i) for n, (i, z, a) in enumerate(grid)]
    header = {
        "created": begin,
        "title": "two planes at two illuminations",
        "plan": "",
        "facility": example_files().facility.read_text(encoding="utf-8"),
        "samples": 9,
        "scan_direction": "unidirectional",
        "points": len(points),
        "software_version": "judged",
    }
    return facility, header, points, references

"""Facilities, journals and runs that several tests of records share."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from instrument.__main__ import main
from instrument.events import Geometry
from instrument.facility import Facility
from instrument.forms import parse_form, parse_toml
from instrument.journal import Journal
from instrument.lambertian import lambertian_flux

SHARED = Path(__file__).parents[2].parent / "shared"
START = datetime(2026, 3, 2, 8, 0, tzinfo=UTC)
FACILITY = """
name = "three arms"
[beam]
diameter = 10.8
radius_1_e2 = 8.0
[sensor]
target_diameter = 10.8
mirror_diameter = 10.8
mirror_distance = 204.7
[arms]
sensor_azimuth = [0.0, 180.0]
[sample]
[reference]
reflectance_factor = 0.99
u_relative = 0.005
[budget]
measurement_noise = [0.0051, 0.0070]
instrument_stability = 0.0082
wavelength = 0.0002
straylight = 0.0001
detector_linearity = [0.0010, 0.0018]
beam_and_placement = 0.0020
illumination_zenith = [0.0021, 0.0038]
sensor_zenith = [0.0010, 0.0052]
sensor_azimuth = [0.0020, 0.0058]
surface_level = 0.0014
polarization = 0.0010
reference_material = 0.0050
"""
PLAN = """
version = 1
title = "four points"
[[grid]]
wavelength = [500.0]
illumination_zenith = [0.0]
sensor_azimuth = [0.0]
sensor_zenith = [60.0, 30.0, -30.0, -60.0]
"""


def facility() -> Facility:
    """The paper's instrument."""
    return parse_form(parse_toml(FACILITY, "facility.toml"), Facility, "facility.toml")


def header(**changes: Any) -> dict[str, Any]:
    """The header of a run over :data:`PLAN`."""
    return {
        "created": START,
        "title": "four points",
        "plan": PLAN,
        "facility": FACILITY,
        "samples": 9,
        "scan_direction": "unidirectional",
        "points": 4,
        "software_version": "0.0.test",
    } | changes


def geometry(sensor_zenith: float, **changes: Any) -> Geometry:
    """A geometry at normal illumination."""
    known = {"wavelength": 500.0, "illumination_zenith": 0.0, "sensor_azimuth": 0.0, "sensor_zenith": sensor_zenith}
    return Geometry(**(known | changes))


def reading(at: Geometry, brf: float, seconds: float, *, light: float = 1e-6, **changes: Any) -> dict[str, Any]:
    """What the ideal instrument records of a sample with one reflectance factor; nine samples scatter by 1e-3."""
    gain, dark = 1e6, 2e-4
    flux = float(
        lambertian_flux(
            facility(),
            at.illumination_zenith,
            at.sensor_zenith,
            at.sensor_azimuth,
            illumination_azimuth=at.illumination_azimuth,
        )
    )
    ripple = 1 + 1e-3 * np.array([-2.0, -1.0, 0.0, 1.0, 2.0, 1.5, -1.5, 0.5, -0.5])
    return {
        "geometry": at,
        "time": START + timedelta(seconds=seconds),
        "signal": (dark + light * brf * flux * gain * ripple).tolist(),
        "dark": dark,
        "gain": gain,
    } | changes


def references(journal: Journal, seconds: float = 0.0, light: float = 1e-6, wavelength: float = 500.0) -> None:
    """The four reference readings."""
    for index, azimuth in enumerate((0.0, 45.0, 90.0, 135.0)):
        at = geometry(15.0, sensor_azimuth=azimuth, wavelength=wavelength)
        journal.record("reference", index=index, **reading(at, 0.99, seconds + index, light=light))


def four_points(run_dir: Path, brf: tuple[float, ...] = (0.3, 0.4, 0.5, 0.6), **changes: Any) -> Path:
    """A run folder with plan, facility and journal of a finished scan; without ``run.nc``."""
    run_dir.mkdir(exist_ok=True)
    (run_dir / "plan.toml").write_text(PLAN)
    (run_dir / "facility.toml").write_text(FACILITY)
    with Journal.create(run_dir, header(**changes)) as journal:
        references(journal)
        for index, (zenith, value) in enumerate(zip((60.0, 30.0, -30.0, -60.0), brf, strict=True)):
            readback = {"illumination_zenith": 0.001, "sensor_azimuth": 0.002, "sensor_zenith": zenith + 0.003}
            journal.record(
                "point",
                index=index,
                **reading(geometry(zenith), value, 60.0 + 20 * index),
                readback=readback,
                source_power=0.5,
                environment={"temperature": (23.1, "degC")},
            )
    return run_dir


def minimal_run(points: int = 3) -> xr.Dataset:
    """The least that is a run: the coordinates, brf and u_brf."""
    zenith = np.linspace(10.0, 70.0, points)
    columns = {
        "wavelength": (np.full(points, 500.0), "nm"),
        "illumination_zenith": (np.zeros(points), "degree"),
        "illumination_azimuth": (np.zeros(points), "degree"),
        "sensor_zenith": (zenith, "degree"),
        "sensor_azimuth": (np.full(points, 90.0), "degree"),
        "brf": (np.linspace(0.4, 0.5, points), "1"),
        "u_brf": (np.full(points, 0.005), "1"),
    }
    dataset = xr.Dataset({name: ("point", values, {"units": unit}) for name, (values, unit) in columns.items()})
    return dataset.set_coords(list(columns)[:5])


def status(*words: object) -> int:
    """Exit status of a command."""
    try:
        return main([str(word) for word in words])
    except SystemExit as end:
        return int(end.code or 0)

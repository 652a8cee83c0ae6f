"""Light on plates with chamfers and over tilted floors."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from traced_samples import artifact, columns, facility

from instrument.lambertian import lambertian_flux
from twin.artifact import Surface, build_mesh
from twin.material import lambertian
from twin.optics import lay_out
from twin.tracer import UNRESTRICTED, Tracer, mean_and_error

REAL = facility(profile="gaussian", mirror=10.8)
PLAN = columns([0, 15, 30, 30, 15], [40.0, -65, 80, -30, 5], [45.0, 50, 60, 120, 75])
CHAMFERED = artifact().changed(edge_chamfer=0.3)


@pytest.mark.slow
@pytest.mark.parametrize(
    "sample", [CHAMFERED, CHAMFERED.changed(block_tilt_x=2.0, block_tilt_y=-1.5)], ids=["level", "tilted"]
)
def test_openings_with_chamfers_agree_with_sight_lines_over_the_whole_target(sample: Any) -> None:
    tracer = Tracer(build_mesh(sample, 32), lambertian(0.8))
    layout, table = lay_out(REAL, PLAN), np.zeros(5, int)
    assert np.all(tracer.prepare(layout, table).through)
    value, error = mean_and_error(tracer.radiance(layout, table, 4096, seed=1))
    whole, whole_error = mean_and_error(tracer.radiance(layout, table, 16384, seed=2, mixture=UNRESTRICTED))
    z = (value - whole) / np.hypot(error, whole_error)
    assert np.max(np.abs(z)) < 5
    assert np.mean(z**2) < 1 + 4 * np.sqrt(2.5 / 5)
    assert np.all(error < 0.02 * value)


def test_the_chamfer_counts_as_wall_and_leaves_less_of_the_top() -> None:
    """Black walls and floor: what shines, seen along the normal, is the target less the widened hole."""
    radius, width = 2.5, 0.5
    sample = artifact([(0.0, 0.0, 2 * radius)], plate=1.0, depth=1.5).changed(edge_chamfer=width)
    dark = dict.fromkeys((Surface.UNDERSIDE, Surface.SPACER, Surface.FLOOR, Surface.HOLE_WALL), 0.0)
    tracer = Tracer(build_mesh(sample, 128), lambertian(0.5), surface_factor=dark)
    disc = facility("unbounded", shape="horizontal_disc", target=10.0)
    plan = columns(0.0, [0.0], 0.0)
    layout = lay_out(disc, plan)
    flux = lambertian_flux(disc, np.zeros(1), np.zeros(1), np.zeros(1), illumination_azimuth=np.zeros(1))
    value, error = mean_and_error(tracer.radiance(layout, np.zeros(1, int), 8192, seed=1) / flux[:, None])
    expected = 0.5 * (1 - (radius + width) ** 2 / 25)
    assert value[0] == pytest.approx(expected, abs=5 * error[0] + 1e-6)


@pytest.mark.slow
def test_white_furnace_with_chamfers() -> None:
    """White walls under uniform light from everywhere look white, by reciprocity over the light's directions."""
    tracer = Tracer(build_mesh(CHAMFERED, 32), lambertian(1.0))
    random = np.random.default_rng(11)
    count = 300
    cosine = np.sqrt((np.arange(count) + random.uniform(0, 1, count)) / count)
    narrow = facility("unbounded", shape="horizontal_disc", target=7.2)
    zenith = np.rad2deg(np.arccos(cosine))
    plan = columns(zenith, np.full(count, 25.0), np.full(count, 33.0), random.uniform(0, 360, count))
    flux = lambertian_flux(
        narrow,
        plan["illumination_zenith"],
        plan["sensor_zenith"],
        plan["sensor_azimuth"],
        illumination_azimuth=plan["illumination_azimuth"],
    )
    radiance = tracer.radiance(lay_out(narrow, plan), np.zeros(count, int), 64, seed=1)
    values = radiance / flux[:, None]
    # Of the directions, and of the randomisations, whose light all directions share.
    spread = np.hypot(*(values.mean(axis=axis).std(ddof=1) / np.sqrt(values.shape[1 - axis]) for axis in (0, 1)))
    assert abs(values.mean() - 1.0) < 4 * spread + 1e-4
    assert spread < 0.04

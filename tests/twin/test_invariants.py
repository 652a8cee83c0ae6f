"""What any true tracer must keep, whatever the sample: reciprocity when beam and sensor change places, and energy."""

from __future__ import annotations

import numpy as np
import pytest
from traced_samples import artifact, columns, facility

from twin.artifact import build_mesh
from twin.material import lambertian
from twin.optics import lay_out
from twin.tracer import Tracer, mean_and_error

#: Few holes, irregular, so that no symmetry helps.
HOLES = [(0.5, 0.3, 3.0), (4.0, -1.5, 2.2), (-3.2, 2.4, 2.6), (-1.0, -4.0, 1.8), (2.5, 4.5, 2.4)]


@pytest.mark.parametrize(("first", "second", "azimuth"), [(0.0, 50.0, 30.0), (35.0, -60.0, 75.0)])
def test_beam_and_sensor_may_change_places(first: float, second: float, azimuth: float) -> None:
    """A narrow beam and a wide sensor, exchanged: the same power from the one's disc into the other's."""
    tracer = Tracer(build_mesh(artifact(HOLES)), lambertian(0.85))
    narrow, wide = 4.0, 12.0
    table = np.zeros(1, dtype=np.int64)
    there = lay_out(facility(narrow, target=wide), columns(first, [second], azimuth))
    back = lay_out(facility(wide, target=narrow), columns(second, [first], 0.0, azimuth))
    (one,), (u_one,) = mean_and_error(tracer.radiance(there, table, 16384, seed=1))
    (two,), (u_two,) = mean_and_error(tracer.radiance(back, table, 16384, seed=2))
    ratio = (wide / narrow) ** 2
    assert np.hypot(ratio * u_one, u_two) < 0.006 * two
    assert abs(ratio * one - two) < 4 * np.hypot(ratio * u_one, u_two)


def test_a_white_sample_gives_back_all_light() -> None:
    """Radiance from everywhere the light comes out, over the hemisphere; a closed cavity keeps nothing."""
    tracer = Tracer(build_mesh(artifact(HOLES)), lambertian(1.0))
    nodes, weights = np.polynomial.legendre.leggauss(8)
    squared, step = (nodes + 1) / 2, 12
    zenith = np.rad2deg(np.arcsin(np.sqrt(squared)))
    azimuth = (np.arange(step) + 0.5) * 360.0 / step
    zeniths, azimuths = (a.ravel() for a in np.meshgrid(zenith, azimuth, indexing="ij"))
    beam, target = 8.0, 44.0
    layout = lay_out(facility(beam, shape="horizontal_disc", target=target), columns(20.0, zeniths, azimuths))
    table = np.zeros(len(layout), dtype=np.int64)
    values = tracer.radiance(layout, table, 1024, seed=5)
    share = np.repeat(weights / 2 / step, step)
    # The beam's power arrives undiminished by the slant; the target sees it spread over its own area.
    mean, error = mean_and_error((share[:, None] * values).sum(axis=0)[None] * (target / beam) ** 2)
    assert error[0] < 0.015
    assert abs(mean[0] - 1) < 4 * error[0] + 0.003

from __future__ import annotations

import numpy as np
import pytest
from traced_samples import columns, facility

from instrument.angles import direction
from twin.optics import Setup, lay_out, lit_footprint


def test_the_nominal_layout_is_the_laboratory_frame() -> None:
    layout = lay_out(facility(mirror=10.8), columns([30.0, 15.0], [40.0, -20.0], [60.0, 45.0]))
    np.testing.assert_allclose(layout.light, direction([30.0, 15.0], 0.0), atol=1e-15)
    np.testing.assert_allclose(layout.view, direction([40.0, -20.0], [60.0, 45.0]), atol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(layout.along, axis=1), 5.4)
    np.testing.assert_allclose(np.sum(layout.along * layout.view, axis=1), 0.0, atol=1e-12)
    np.testing.assert_allclose(layout.inverse_distance, 1 / 204.7)


def test_a_tilted_sample_sees_the_instrument_turned_the_other_way() -> None:
    layout = lay_out(facility(), columns(0.0, [10.0], 0.0), Setup(tilt_y_deg=10.0))
    # Turned by +10 degrees about y the normal points to (sin 10, 0, cos 10): along the view.
    np.testing.assert_allclose(layout.view[0], [0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(layout.light[0], direction(-10.0, 0.0), atol=1e-12)


def test_tilt_about_x_is_right_handed() -> None:
    layout = lay_out(facility(), columns(0.0, [10.0], 90.0), Setup(tilt_x_deg=-10.0))
    np.testing.assert_allclose(layout.view[0], [0, 0, 1], atol=1e-12)


def test_a_raised_and_shifted_sample_sees_the_optical_centre_below_and_aside() -> None:
    layout = lay_out(facility(), columns(20.0, [10.0], 0.0), Setup(height_mm=0.5, offset_x_mm=0.2, offset_y_mm=-0.3))
    np.testing.assert_allclose(layout.target[0], [-0.2, 0.3, -0.5])
    np.testing.assert_allclose(layout.beam[0], [-0.2, 0.3, -0.5])


def test_a_turned_sample_sees_light_and_sensor_from_a_smaller_azimuth() -> None:
    layout = lay_out(facility(), columns(20.0, [30.0], 70.0), Setup(sample_azimuth_deg=10.0))
    np.testing.assert_allclose(layout.view[0], direction(30.0, 60.0), atol=1e-12)
    np.testing.assert_allclose(layout.light[0], direction(20.0, -10.0), atol=1e-12)


def test_run_out_moves_the_target_towards_growing_zenith() -> None:
    layout = lay_out(facility(), columns(20.0, [30.0], 0.0), Setup(sensor_runout_mm=0.5))
    np.testing.assert_allclose(layout.target[0], 0.5 * direction(120.0, 0.0), atol=1e-12)


def test_zero_errors_add_to_the_signed_zenith() -> None:
    layout = lay_out(facility(), columns(20.0, [-30.0], 50.0), Setup(sensor_zenith_deg=0.5, sensor_azimuth_deg=1.0))
    np.testing.assert_allclose(layout.view[0], direction(-29.5, 51.0), atol=1e-15)


def test_values_may_differ_from_point_to_point() -> None:
    layout = lay_out(facility(), columns(20.0, [10.0, 20.0], 0.0), Setup(sensor_zenith_deg=np.array([0.1, -0.1])))
    np.testing.assert_allclose(layout.view, direction([10.1, 19.9], 0.0), atol=1e-15)


@pytest.mark.parametrize(("ill", "sen", "phi"), [(0, 0, 0), (30, 60, 60), (15, -80, 130), (45, 45, 0)])
def test_the_lit_footprint_holds_every_sight_line_that_meets_the_beam(ill: float, sen: float, phi: float) -> None:
    layout = lay_out(facility(), columns(float(ill), [float(sen)], float(phi)))
    footprint = lit_footprint(layout, np.array([2.0]), margin_mm=0.0)
    random = np.random.default_rng(4)
    angle, radius, depth = (
        random.uniform(0, 2 * np.pi, 500),
        np.sqrt(random.uniform(0, 1, 500)),
        random.uniform(0, 2, 500),
    )
    light, u, v = layout.light[0], layout.light_u[0], layout.light_v[0]
    cross = 5.4 * (radius * np.cos(angle))[:, None] * u + 5.4 * (radius * np.sin(angle))[:, None] * v
    lit = cross - light * ((cross[:, 2] + depth) / light[2])[:, None]  # points of the beam at z = -depth
    np.testing.assert_allclose(lit[:, 2], -depth)
    place = np.stack([lit @ layout.along[0] / 5.4**2, lit @ layout.across[0] / 5.4**2], axis=1)
    q = (place - footprint.centre[0]) @ footprint.inverse[0].T
    sweep = footprint.sweep[0]
    along, aside = q @ sweep, q @ np.array([-sweep[1], sweep[0]])
    assert np.all(np.abs(aside) <= 1 + 1e-9)
    assert np.all((along >= -1 - 1e-9) & (along <= 1 + footprint.length[0] + 1e-9))

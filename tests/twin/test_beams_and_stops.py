"""Structured beams and field stops in the tracing kernel: against the quadrature, and its two ways of tracing."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from traced_samples import artifact, columns, facility, flat

from instrument.beam_image import BeamImage
from instrument.facility import Beam, Facility, Sensor
from instrument.plane_flux import plane_flux
from twin.artifact import build_mesh
from twin.material import lambertian
from twin.optics import Setup, lay_out
from twin.tracer import UNRESTRICTED, Tracer, mean_and_error

_U = np.arange(-9.0, 9.01, 0.25)
#: A beam with a slope, a hot spot and a shadow, so that nothing about it is symmetric.
IMAGE = BeamImage(
    (1 + _U[None] / 20 + _U[:, None] / 40)
    * (0.6 + np.exp(-((_U[None] - 2) ** 2 + (_U[:, None] + 1) ** 2)))
    * np.where(np.hypot(_U[None] + 2, _U[:, None] - 3) < 1.5, 0.3, 1.0),
    (0.25, 0.25),
    (-9.0, -9.0),
)
ELLIPSE = {"radius_1_e2": 7.0, "radius_1_e2_across": 4.0, "diameter_across": 8.0, "orientation": 30.0}
STOP = {"field_stop_diameter": 8.0, "field_stop_edge": 1.5, "field_stop_distance": 30.0}


def instrument(*, beam: dict[str, Any] | None = None, sensor: dict[str, Any] | None = None) -> Facility:
    known = facility(profile="gaussian", mirror=10.8)
    changes = {
        "beam": Beam.model_validate(known.beam.model_dump() | (beam or {})),
        "sensor": Sensor.model_validate(known.sensor.model_dump() | (sensor or {})),
    }
    return known.model_copy(update=changes)


def pictured() -> Facility:
    known = facility(mirror=10.8)
    beam = Beam(diameter=10.8, profile="image", image="beam.npy", pixel_pitch=0.25, orientation=20.0)
    return known.model_copy(update={"beam": beam.with_picture(IMAGE)})


CASES = {
    "picture": pictured(),
    "soft stop": instrument(sensor=STOP),
    "ellipse and hard stop": instrument(beam=ELLIPSE, sensor={"field_stop_diameter": 7.0}),
}
#: The quadrature between pixels is less exact than that of a smooth profile.
TOLERANCE = {"picture": 2e-4, "soft stop": 3e-5, "ellipse and hard stop": 3e-5}
GEOMETRIES = columns([0.0, 40.0, -30.0], [20.0, -55.0, 50.0], [0.0, 60.0, 130.0])


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("mixture", [None, UNRESTRICTED], ids=["by plate", "by target"])
def test_a_flat_lambertian_sample_reads_the_flux_of_the_quadrature(name: str, mixture: Any) -> None:
    """Nominal, and with the instrument off and the sample tilted."""
    tracer = Tracer(build_mesh(flat()), lambertian(1.0))
    for setup in (Setup(), Setup(tilt_x_deg=1.5, beam_x_mm=0.5, sensor_runout_mm=-0.4, stop_radius_mm=0.2)):
        layout = lay_out(CASES[name], GEOMETRIES, setup)
        table = np.zeros(len(layout), dtype=np.int64)
        brf, error = mean_and_error(tracer.radiance(layout, table, 8192, seed=3, mixture=mixture))
        expected = plane_flux(layout)
        assert np.all(error < 4e-3 * expected)
        np.testing.assert_array_less(np.abs(brf - expected), 4.5 * error + TOLERANCE[name] * expected)


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_both_ways_of_tracing_a_pierced_plate_agree(name: str) -> None:
    tracer = Tracer(build_mesh(artifact()), lambertian(0.9))
    layout = lay_out(CASES[name], GEOMETRIES, Setup())
    table = np.zeros(len(layout), dtype=np.int64)
    first, u_first = mean_and_error(tracer.radiance(layout, table, 4096, seed=3))
    second, u_second = mean_and_error(tracer.radiance(layout, table, 16384, seed=4, mixture=UNRESTRICTED))
    assert np.all(np.hypot(u_first, u_second) < 0.01 * first)
    np.testing.assert_array_less(np.abs(first - second), 4.0 * np.hypot(u_first, u_second))


def test_a_twin_keeps_two_pictures_apart() -> None:
    tracer = Tracer(build_mesh(artifact()), lambertian(0.9))
    known = pictured()
    mirrored = BeamImage(np.ascontiguousarray(IMAGE.values[:, ::-1]), IMAGE.pitch, IMAGE.first)
    other = known.model_copy(update={"beam": known.beam.with_picture(mirrored)})
    table = np.zeros(3, dtype=np.int64)
    one, two, again = (tracer.radiance(lay_out(of, GEOMETRIES), table, 512, seed=3) for of in (known, other, known))
    np.testing.assert_array_equal(one, again)
    assert np.all(np.abs(one.mean(axis=1) / two.mean(axis=1) - 1) > 1e-3)

"""Effects that belong to no library: a diagnosis should see the gap and say that it does not know the cause."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from instrument.angles import FloatArray
from sim_fixtures.cases.effects import Parameters, effect, either_sign, growing
from sim_fixtures.cases.world import Moments, World

P = Mapping[str, float]


@effect(
    "moving_ghost",
    growing(fraction=0.025, start_deg=(-60.0, 60.0), ratio_of_motion=(-2.0, 2.0), width_deg=(5.0, 14.0)),
    20.0,
    fixed=("start_deg", "ratio_of_motion", "width_deg"),
    optical=False,
    outside=True,
)
def moving_ghost(world: World, p: P) -> World:
    """A reflex between lenses whose place in sensor zenith moves with the illumination arm."""

    def law(at: Moments, flux: FloatArray) -> FloatArray:
        centre = p["start_deg"] + p["ratio_of_motion"] * at.illumination_zenith
        return np.asarray(flux + p["fraction"] * np.exp(-(((at.sensor_zenith - centre) / p["width_deg"]) ** 2)))

    return world.with_law(law)


@effect(
    "holder_glint",
    growing(fraction=0.05, zenith_deg=(25.0, 75.0), azimuth_deg=(0.0, 360.0), width_deg=(8.0, 20.0)),
    20.0,
    fixed=("zenith_deg", "azimuth_deg", "width_deg"),
    optical=False,
    outside=True,
)
def holder_glint(world: World, p: P) -> World:
    """A shiny screw of the holder throws light into one direction of the room."""

    def law(at: Moments, flux: FloatArray) -> FloatArray:
        zenith, azimuth = np.deg2rad(p["zenith_deg"]), np.deg2rad(p["azimuth_deg"])
        seen, turn = np.deg2rad(at.sensor_zenith), np.deg2rad(at.sensor_azimuth)
        cosine = np.cos(zenith) * np.cos(seen) + np.sin(zenith) * np.sin(seen) * np.cos(turn - azimuth)
        narrow = np.deg2rad(p["width_deg"])
        return np.asarray(flux + p["fraction"] * np.exp((cosine - 1.0) / narrow**2))

    return world.with_law(law)


def _slope(generator: np.random.Generator) -> Parameters:
    turn = generator.uniform(0.0, 2.0 * np.pi)
    return {"x_deg": float(2.5 * np.cos(turn)), "y_deg": float(2.5 * np.sin(turn))}


@effect("floor_wedge", _slope, 1.8, outside=True)
def floor_wedge(world: World, p: P) -> World:
    """The block under the plate lies askew; the plate itself is level."""
    slope = np.tan(np.deg2rad([p["x_deg"], p["y_deg"]]))
    return world.with_shape(floor_slope_x=float(slope[0]), floor_slope_y=float(slope[1]))


@effect("hole_ellipticity", growing(ratio=1.25, axis_deg=(0.0, 180.0)), 2.5, fixed=("axis_deg",), outside=True)
def hole_ellipticity(world: World, p: P) -> World:
    """Holes are longer than wide, at equal area."""
    return world.with_shape(hole_elongation=p["ratio"] - 1.0, hole_axis_deg=p["axis_deg"])


@effect("hole_taper", either_sign(delta_mm=0.06), 4.0, outside=True)
def hole_taper(world: World, p: P) -> World:
    """Holes widen or narrow downwards: radius at the underside less that at the top."""
    return world.with_shape(hole_taper_mm=p["delta_mm"])


@effect(
    "contamination",
    growing(fraction=-0.08, x_mm=(-3.0, 3.0), y_mm=(-3.0, 3.0), radius_mm=(1.5, 3.5)),
    10.0,
    fixed=("x_mm", "y_mm", "radius_mm"),
    outside=True,
)
def contamination(world: World, p: P) -> World:
    """A fingerprint on the plate."""
    return world.with_coating(
        stain=max(p["fraction"], -1.0), stain_x_mm=p["x_mm"], stain_y_mm=p["y_mm"], stain_radius_mm=p["radius_mm"]
    )


@effect("directional_response", either_sign(exponent=0.02), 20.0, optical=False, outside=True)
def directional_response(world: World, p: P) -> World:
    """The fibre's coupling changes with the attitude of the arm, as a power of the cosine of the sensor zenith."""

    def law(at: Moments, flux: FloatArray) -> FloatArray:
        return np.asarray(flux * np.cos(np.deg2rad(at.sensor_zenith)) ** p["exponent"])

    return world.with_law(law)


@effect(
    "cable_torsion",
    growing(fraction=0.035, periods=(2.2, 5.0), phase_deg=(0.0, 360.0)),
    12.0,
    fixed=("periods", "phase_deg"),
    optical=False,
    outside=True,
)
def cable_torsion(world: World, p: P) -> World:
    """The fibre loses light as the azimuth twists it, several times over its travel."""

    def law(at: Moments, flux: FloatArray) -> FloatArray:
        phase = np.deg2rad(p["periods"] * at.sensor_azimuth * 2.0 + p["phase_deg"])
        return np.asarray(flux * (1.0 - p["fraction"] * 0.5 * (1.0 + np.cos(phase))))

    return world.with_law(law)


def _jump(generator: np.random.Generator) -> Parameters:
    sign = 1.0 if generator.random() < 0.5 else -1.0
    return {"fraction": 0.02 * sign, "progress": float(generator.uniform(0.2, 0.8))}


@effect("source_jump", _jump, 12.0, fixed=("progress",), optical=False, outside=True)
def source_jump(world: World, p: P) -> World:
    """The source hops to another mode at some time of the run."""

    def law(at: Moments, flux: FloatArray) -> FloatArray:
        return np.asarray(flux * (1.0 + p["fraction"] * (at.progress > p["progress"])))

    return world.with_law(law)


@effect("wall_reflectance", either_sign(ratio=0.15), 4.0, outside=True)
def wall_reflectance(world: World, p: P) -> World:
    """The coating is thin on the walls of the holes alone."""
    return world.with_coating(wall_scale=p["ratio"])


@effect(
    "mains_beat",
    growing(fraction=0.018, period_points=(3.5, 30.0), phase_deg=(0.0, 360.0)),
    12.0,
    fixed=("period_points", "phase_deg"),
    optical=False,
    outside=True,
)
def mains_beat(world: World, p: P) -> World:
    """Mains and sampling beat against each other: a wave in the order of the points."""

    def law(at: Moments, flux: FloatArray) -> FloatArray:
        phase = 2.0 * np.pi * at.order / p["period_points"] + np.deg2rad(p["phase_deg"])
        return np.asarray(flux * (1.0 + p["fraction"] * np.sin(phase) * (at.order >= 0)))

    return world.with_law(law)


@effect("azimuth_scale", either_sign(fraction=0.06), 4.0, outside=True)
def azimuth_scale(world: World, p: P) -> World:
    """A wrong gear ratio of the azimuth: its degree is too long or too short."""
    return world.with_arm(azimuth_scale=p["fraction"])


@effect("zenith_scale", either_sign(fraction=0.006), 8.0, outside=True)
def zenith_scale(world: World, p: P) -> World:
    """A wrong gear ratio of the sensor zenith."""
    return world.with_arm(zenith_scale=p["fraction"])


@effect("forward_lobe", either_sign(ratio=0.8), 1.2, outside=True)
def forward_lobe(world: World, p: P) -> World:
    """The artifact's coating scatters forward otherwise than the coupon's."""
    return world.with_coating(forward_scale=p["ratio"])


def _switching(generator: np.random.Generator) -> Parameters:
    return {"fraction": -0.025, "pattern": float(generator.integers(1, 2**31)), "stay": float(generator.uniform(6, 25))}


@effect("random_telegraph", _switching, 10.0, fixed=("pattern", "stay"), optical=False, outside=True)
def random_telegraph(world: World, p: P) -> World:
    """The source switches between two powers at random times; ``stay`` is the mean number of points between them."""

    def law(at: Moments, flux: FloatArray) -> FloatArray:
        generator = np.random.default_rng(int(p["pattern"]))
        low = np.cumsum(generator.random(len(at.order)) < 1.0 / p["stay"]) % 2 * (at.order >= 0)
        return np.asarray(flux * (1.0 + p["fraction"] * low))

    return world.with_law(law)


@effect(
    "settling",
    growing(fraction=-0.08, points=(10.0, 40.0)),
    12.0,
    fixed=("points",),
    optical=False,
    outside=True,
)
def settling(world: World, p: P) -> World:
    """The detector's cooler settles again after every change of the illumination."""

    def law(at: Moments, flux: FloatArray) -> FloatArray:
        if np.all(at.order < 0):
            return flux
        fresh = np.concatenate([[True], np.diff(at.illumination_zenith) != 0])
        since = at.order - np.maximum.accumulate(np.where(fresh, at.order, 0.0))
        return np.asarray(flux * (1.0 + p["fraction"] * np.exp(-since / p["points"])))

    return world.with_law(law)

"""Effects of the artifact and its coating: names and parameters of the data contract, in physics of this package."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sim_fixtures.cases.effects import effect, either_sign, growing
from sim_fixtures.cases.world import World

P = Mapping[str, float]
#: Radius of a rounding that takes as much off an edge as a 45 degree chamfer of width 1: (1 - pi/4) r^2 = 1/2.
ROUNDING = float(np.sqrt(0.5 / (1.0 - np.pi / 4.0)))


@effect("retroreflection", growing(amplitude=0.06, width_deg=(5.0, 12.0)), 12.0, fixed=("width_deg",))
def retroreflection(world: World, p: P) -> World:
    """Coherent backscatter of the coating, on every face and after every reflection."""
    return world.with_coating(retro_amplitude=p["amplitude"], retro_width_deg=p["width_deg"])


@effect("specular_lobe", growing(amplitude=0.03, roughness=(0.15, 0.45)), 8.0, fixed=("roughness",))
def specular_lobe(world: World, p: P) -> World:
    """Glossy facets on the coating."""
    return world.with_coating(glossy_amplitude=p["amplitude"], glossy_slope=p["roughness"])


@effect("anisotropy", growing(amplitude=0.03, axis_deg=(0.0, 180.0)), 8.0, fixed=("axis_deg",))
def anisotropy(world: World, p: P) -> World:
    """Grain of the horizontal faces; it acts on the way in as on the way out."""
    return world.with_coating(grain=p["amplitude"], grain_axis_deg=p["axis_deg"])


@effect("translucency", growing(length_mm=0.08, fraction=(0.4, 0.9)), 8.0, fixed=("fraction",))
def translucency(world: World, p: P) -> World:
    """Light diffuses inside the coating, around edges too."""
    return world.with_coating(diffusion_length_mm=p["length_mm"], diffusion_share=p["fraction"])


@effect("cavity_reflectance", either_sign(ratio=0.07), 6.0)
def cavity_reflectance(world: World, p: P) -> World:
    """Floor, underside and spacer reflect otherwise than the coupon."""
    return world.with_coating(cavity_scale=p["ratio"])


@effect("reflectance_scale", either_sign(ratio=0.009), 12.0)
def reflectance_scale(world: World, p: P) -> World:
    """Every face reflects otherwise than the coupon."""
    return world.with_coating(scale=p["ratio"])


@effect("hole_diameter", either_sign(delta_mm=0.06), 6.0)
def hole_diameter(world: World, p: P) -> World:
    """Every hole is wider or narrower."""
    return world.with_shape(hole_diameter_mm=p["delta_mm"])


@effect("plate_thickness", either_sign(delta_mm=0.15), 5.0)
def plate_thickness(world: World, p: P) -> World:
    """The plate is thicker or thinner; its top and the floor stay."""
    return world.with_shape(plate_thickness_mm=p["delta_mm"])


@effect("cavity_depth", either_sign(delta_mm=0.18), 6.0)
def cavity_depth(world: World, p: P) -> World:
    """The floor lies deeper or higher."""
    return world.with_shape(cavity_depth_mm=p["delta_mm"])


@effect("edge_chamfer", growing(delta_mm=0.06), 6.0)
def edge_chamfer(world: World, p: P) -> World:
    """The upper edges are rounded, and miss as much as a chamfer of the given width would."""
    return world.with_shape(rim_radius_mm=ROUNDING * p["delta_mm"])

"""What else can lie on the stage: pieces that calibration procedures look at.

Each is described by what it does to the reading of the reference standard in the same geometry. The edge target is
integrated over the plane point by point, with the beam's own profile.
"""

from __future__ import annotations

import math

import numpy as np

from instrument.facility import Facility
from sim_fixtures.bench.flux import Geometry, Mounted
from sim_fixtures.bench.troubles import Troubles

#: Absorption bands of the wavelength standard: centre (nm), depth, and standard deviation (nm) of the profile as a
#: filter of the instrument's bandwidth sees it.
BANDS = ((486.9, 0.45, 4.2), (521.3, 0.62, 4.6), (653.6, 0.55, 5.1))
#: Reflectance factor of the control sample over that of the reference.
CONTROL = 0.62
#: What pieces other than the sample look like: the reference, changed.
PIECES = ("reference", "sample", "control_sample", "wavelength_standard", "edge_target")
_GRID = 301


def flux_geometry(geometry: Geometry) -> Geometry:
    """The geometry whose flux the optical model is asked for."""
    base: Mounted = "sample" if geometry.mounted == "sample" else "reference"
    return geometry._replace(mounted=base)


def factor(geometry: Geometry, facility: Facility, troubles: Troubles) -> float:
    """Reading of what lies on the stage over that of an untilted reference (of the sample: over itself).

    Parameters
    ----------
    geometry
        True geometry.
    """
    if geometry.mounted == "sample":
        return 1.0
    result = _tilted(geometry, troubles.stage_tilt_deg)
    if geometry.mounted == "control_sample":
        result *= CONTROL * (1 + troubles.control_change)
    elif geometry.mounted == "wavelength_standard":
        result *= band_reflectance(geometry.wavelength)
    elif geometry.mounted == "edge_target":
        result *= _white_part(geometry, facility, troubles.sensor_runout_mm)
    return result


def band_reflectance(wavelength: float) -> float:
    """Reflectance of the wavelength standard over that of the reference."""
    return 0.93 * math.prod(
        1 - depth * math.exp(-0.5 * ((wavelength - centre) / width) ** 2) for centre, depth, width in BANDS
    )


def wavelength_certificate() -> str:
    """Certificate of the wavelength standard, in the form of ``docs/calibration.md``."""
    bands = "".join(f"\n[[band]]\nwavelength = {centre}\nu = 0.05\nreach = 14.0\n" for centre, _, _ in BANDS)
    return (
        "# The wavelength standard of the simulated laboratory.\nversion = 1\n"
        'identity = "simulated rare-earth tile WS-1"\nvalid_from = 2026-01-01\nvalid_until = 2035-12-31\n' + bands
    )


def _tilted(geometry: Geometry, tilt: float) -> float:
    """A Lambertian surface that leans towards azimuth 0: cosine to the sensor over that of the level one."""
    if tilt == 0.0:
        return 1.0
    zenith, azimuth, lean = (math.radians(a) for a in (geometry.sensor_zenith, geometry.sensor_azimuth, tilt))
    level = math.cos(zenith)
    return (math.sin(lean) * math.sin(zenith) * math.cos(azimuth) + math.cos(lean) * level) / level


def _white_part(geometry: Geometry, facility: Facility, runout: float) -> float:
    """Share of the light that the white half (x > 0) sends to the sensor, by summing over a grid of the plane."""
    beam, radius = facility.beam, facility.sensor.target_diameter / 2
    illumination, zenith, azimuth = (math.radians(a) for a in geometry[1:4])
    reach = 1.6 * radius / max(math.cos(zenith), 0.2)
    ticks = (np.arange(_GRID) + 0.5) / _GRID * 2 * reach - reach
    x, y = np.meshgrid(ticks, ticks, indexing="ij")
    across = np.hypot(x * math.cos(illumination), y)
    light = np.ones_like(x)
    if beam.diameter != "unbounded":
        light *= across < beam.diameter / 2
    if beam.profile == "gaussian" and beam.radius_1_e2 is not None:
        light *= np.exp(-2 * (across / beam.radius_1_e2) ** 2)
    along = x * math.cos(azimuth) + y * math.sin(azimuth)
    sideways = -x * math.sin(azimuth) + y * math.cos(azimuth)

    def seen(displacement: float) -> np.ndarray:
        return light * (np.hypot(along * math.cos(zenith) - displacement, sideways) < radius)

    return float(np.sum(seen(runout)[x > 0]) / np.sum(seen(0.0)))

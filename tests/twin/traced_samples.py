"""Samples, instruments and outside references that the tests of the ray tracer share."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
import xarray as xr

from instrument.artifact import ArtifactDimensions, ArtifactForm, Holes
from instrument.facility import Facility

SHARED = Path(__file__).resolve().parents[3] / "shared"
#: The paper's artifact with every hole in its nominal place.
REGULAR = (np.arange(12) - 5.5) * 3.6


def shared_file(*parts: str) -> Path:
    """A file of the outside references; the test is skipped where it is missing."""
    path = SHARED.joinpath(*parts)
    if not path.exists():
        pytest.skip(f"the outside reference {'/'.join(parts)} is not beside the checkout")
    return path


def reference_run(name: str) -> xr.Dataset:
    with xr.open_dataset(shared_file("reference", name), engine="h5netcdf") as data:
        return data.load()


def facility(
    beam: float | Literal["unbounded"] = 10.8,
    *,
    profile: Literal["tophat", "gaussian"] = "tophat",
    shape: Literal["disc", "horizontal_disc"] = "disc",
    mirror: float = 0.0,
    target: float = 10.8,
    divergence: float = 0.0,
) -> Facility:
    return Facility.model_validate(
        {
            "name": "test bench",
            "beam": {
                "diameter": beam,
                "profile": profile,
                "radius_1_e2": 8.0 if profile == "gaussian" else None,
                "divergence": divergence,
            },
            "sensor": {"target_diameter": target, "target_shape": shape, "mirror_diameter": mirror},
            "arms": {},
            "sample": {},
            "reference": {"reflectance_factor": 0.99, "u_relative": 0.005},
            "budget": {},
        }
    )


def artifact(
    holes: Any = None, *, plate: float = 1.13, depth: float = 3.26, spacer: float = 4.0, diameter: float = 2.55
) -> ArtifactDimensions:
    """Plate with holes at the rows (x, y, diameter); by default the paper's regular lattice."""
    if holes is None:
        holes = [(x, y, diameter) for x in REGULAR for y in REGULAR]
    x, y, d = np.asarray(holes, dtype=float).reshape(-1, 3).T
    zero = np.zeros(len(x))
    form = ArtifactForm(plate_thickness=plate, cavity_depth=depth, spacer_edge=spacer)
    return ArtifactDimensions(form, Holes(x, y, d, zero, zero, zero), None, Path("artifact.toml"))


def flat() -> ArtifactDimensions:
    return artifact(np.zeros((0, 3)))


def columns(theta_ill: Any, theta_sen: Any, phi_sen: Any, phi_ill: Any = 0.0) -> dict[str, Any]:
    arrays = np.broadcast_arrays(
        500.0, np.atleast_1d(theta_ill).astype(float), phi_ill, np.asarray(theta_sen, float), np.asarray(phi_sen, float)
    )
    names = ("wavelength", "illumination_zenith", "illumination_azimuth", "sensor_zenith", "sensor_azimuth")
    return {name: np.array(a, dtype=float) for name, a in zip(names, arrays, strict=True)}


def columns_of(run: xr.Dataset) -> dict[str, Any]:
    return columns(run.theta_ill.values, run.theta_sen.values, run.phi_sen.values)


def not_retroreflection(run: xr.Dataset) -> np.ndarray:
    """Points off exact retro-reflection, where a source at a finite distance differs from a parallel beam."""
    ill, sen, phi = run.theta_ill.values, run.theta_sen.values, run.phi_sen.values
    return ~((sen == ill) & ((phi == 0) | (ill == 0)))

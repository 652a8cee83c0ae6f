# %% [markdown]
# # Add a reflection model
# A model is a function from settings to a table of the BRDF; the ray tracer knows no other form, so any model costs it
# the same. This one is Minnaert's: a Lambertian surface whose brightness changes with the cosines of both zeniths,
# BRDF = reflectance/pi (cos i cos o)^(k - 1), reciprocal by its form.

# %%
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

import sim_fixtures.examples
from instrument import Geometry, read_artifact, read_facility
from instrument.forms import Form, parse_form
from twin import Material, Twin, lambertian
from twin.reflection_models import Origin


class MinnaertSettings(Form):
    """Its keys in material.toml; unknown keys and wrong values are refused with the file's name."""

    reflectance: Annotated[float, Field(gt=0, le=1)]
    k: Annotated[float, Field(ge=0.5, le=1.5)] = 1.0


def minnaert_model(settings: Mapping[str, Any], origin: Origin) -> Material:
    """The table: BRDF in 1/sr over cos(emergent zenith), azimuth difference and cos(incident zenith)."""
    given = parse_form(dict(settings), MinnaertSettings, origin.where)
    cosines, around = np.linspace(0.05, 1.0, 20), np.array([0.0, 2 * np.pi])
    table = given.reflectance / np.pi * np.outer(cosines, cosines) ** (given.k - 1)
    brdf = np.repeat(table[None, :, None, :], len(around), axis=2)
    return Material(cosines, around, cosines, brdf, name=f"Minnaert, k = {given.k:g}")


# %% [markdown]
# Installed with an entry point, `material.toml` can name it for all surfaces or for some:
#
# ```toml
# [project.entry-points."goniotwin.reflection_models"]
# minnaert = "our_models:minnaert_model"
# ```
#
# ```toml
# [default]
# model = "minnaert"
# reflectance = 0.6
# k = 1.1
# ```
#
# From a program it is simply called.

# %%
origin = Origin(Path("."), "this example")
flat = minnaert_model({"reflectance": 0.6}, origin)
limb = minnaert_model({"reflectance": 0.6, "k": 1.1}, origin)
print(flat.describe())
print("reflectance for incidence at 0 and 60 degrees:", np.round(limb.directional_reflectance([1.0, 0.5]), 3))

# %% [markdown]
# With k = 1 it has to be Lambertian: the plate under it, predicted with the same random numbers, reads the same.

# %%
files = Path(sim_fixtures.examples.__file__).parent
facility, artifact = read_facility(files / "facility.toml"), read_artifact(files / "artifact.toml")
points = [
    Geometry(wavelength=500.0, illumination_zenith=15.0, sensor_azimuth=90.0, sensor_zenith=z) for z in (20.0, 60.0)
]
brf = {
    name: Twin(facility, artifact, material).predict(points, samples=4096)["brf"].values
    for name, material in (("Lambertian", lambertian(0.6)), ("k = 1", flat), ("k = 1.1", limb))
}
for name, values in brf.items():
    print(f"{name:10s}", np.round(values, 4))

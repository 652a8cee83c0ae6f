# %% [markdown]
# # Propagate uncertainties
# What the uncertainties of dimensions, coating and instrument make of a prediction, and which of them matters where.

# %%
from pathlib import Path

import sim_fixtures.examples
from instrument import Geometry
from twin import propagate, state_vector_from_files

files = Path(sim_fixtures.examples.__file__).parent
state = state_vector_from_files(files / "facility.toml", files / "artifact.toml", files / "material.nc")
print(f"{len(state)} uncertain inputs from {len(state.sources)} sources")
for note in state.notes:
    print("note:", note)

# %% [markdown]
# Two geometries, by sensitivities: finite differences of the twin with common random numbers, from which the ray
# tracer's noise is removed. `draws=500` would sample all inputs at once instead, `workers=2` use two processes.

# %%
points = [
    Geometry(wavelength=500.0, illumination_zenith=15.0, sensor_azimuth=90.0, sensor_zenith=zenith)
    for zenith in (20.0, 70.0)
]
found = propagate(state, points, standard_error=0.005, tolerance=0.3)
for point in range(len(points)):
    brf, u = (float(found[name][point]) for name in ("brf", "u_brf"))
    print(f"zenith {float(found['sensor_zenith'][point]):g}: BRF {brf:.4f} ± {u:.4f} ({100 * u / brf:.1f} %)")

# %% [markdown]
# Where it comes from: shares of the variance, the largest first; and the sensitivities to single inputs.

# %%
share = found["variance_share"].isel(point=-1)
for source in share.sortby(share, ascending=False)["source"].values[:5]:
    print(f"{100 * float(share.sel(source=source)):5.1f} %  {source}")
slopes = found["sensitivity"].isel(point=-1, parameter=slice(8))
for name, slope, unit in zip(slopes["parameter"].values, slopes.values, slopes["parameter_units"].values, strict=True):
    print(f"{slope:+.4f} per {unit}  {name}")

# %% [markdown]
# # Predict a plan
# The twin of an instrument with a sample: made from three files, asked for any geometries.

# %%
from pathlib import Path

import numpy as np

import sim_fixtures.examples
from instrument import Geometry
from twin import Setup, Twin

files = Path(sim_fixtures.examples.__file__).parent
twin = Twin.from_files(files / "facility.toml", files / "artifact.toml", files / "material.nc", seed=1)

# %% [markdown]
# Geometries are commanded ones: nm and degrees, the zenith signed. `standard_error` is the ray tracer's own relative
# error to reach at every point; the number of sight lines follows from it.

# %%
zeniths = (-60.0, -30.0, 30.0, 60.0)
points = [Geometry(wavelength=500.0, illumination_zenith=15.0, sensor_azimuth=90.0, sensor_zenith=z) for z in zeniths]
nominal = twin.predict(points, standard_error=0.003)
for zenith, brf, error in zip(zeniths, nominal["brf"].values, nominal["u_brf_monte_carlo"].values, strict=True):
    print(f"zenith {zenith:+5.1f}  BRF {brf:.4f} ± {error:.4f} (ray tracing alone)")

# %% [markdown]
# What if the sensor arm stands half a degree off? A `Setup` holds what may be wrong. The flux is then that of the true
# geometry, divided by that of the commanded one, as in a measurement: far out the reading changes with the tangent of
# the zenith. The same random numbers serve both predictions, so that their noise cancels from the ratio.

# %%
off = twin.predict(points, standard_error=0.003, setup=Setup(sensor_zenith_deg=0.5))
change = off["brf"].values / nominal["brf"].values - 1
tangent = -np.tan(np.deg2rad(zeniths)) * np.deg2rad(0.5)
for zenith, whole, cosine in zip(zeniths, change, tangent, strict=True):
    print(f"zenith {zenith:+5.1f}  {100 * whole:+.2f} %, of which {100 * cosine:+.2f} % by the cosine of the view")

# %% [markdown]
# # Diagnose a run
# A run of the simulated laboratory with something wrong, and the question what it is. The simulated physics shares no
# code with the twin.

# %%
from pathlib import Path
from tempfile import mkdtemp

import sim_fixtures.examples
from instrument import read_artifact, read_facility, read_plan, write_run
from sim_fixtures.cases import make_case
from sim_fixtures.reality import EXAMPLE_COATING
from twin import Bench, Inputs, diagnose, read_observation
from twin.content import cache_folder
from twin.diagnosis.effects import effect

files = Path(sim_fixtures.examples.__file__).parent
folder = Path(mkdtemp(prefix="goniotwin-example-"))
(folder / "plan.toml").write_text(
    """
version = 1
title = "two planes"
[[grid]]
wavelength = [500.0]
illumination_zenith = [15.0]
sensor_azimuth = [75.0, 105.0]
sensor_zenith = { start = 75.0, stop = -75.0, step = -15.0 }
""",
    encoding="utf-8",
)

# %% [markdown]
# The zero of the sensor's zenith is 1.5 degrees off. Nobody tells the diagnosis.

# %%
facility = read_facility(files / "facility.toml")
run, truth = make_case(
    facility,
    read_artifact(files / "artifact.toml"),
    EXAMPLE_COATING,
    read_plan(folder / "plan.toml", facility),
    {"sensor_zenith_offset": {"angle_deg": 1.5}},
    seed=5,
    rays=4096,
)
write_run(run, folder / "run.nc")
print(f"gap over uncertainty, root mean square: {truth.gap_over_u:.1f}")

# %% [markdown]
# A bench prepares runs of one configuration: it predicts them and renders what every effect does to them. Results are
# kept in the user's cache folder, so that a second run of the same plan needs no ray. The whole library takes minutes
# the first time; here five effects stand for it.

# %%
bench = Bench(Inputs(files / "facility.toml", files / "artifact.toml", files / "material.nc"), cache_folder())
names = ("sensor_zenith_offset", "stray_light", "polarization", "source_drift", "reference_scale")
prepared = bench.prepare(read_observation(folder / "run.nc"), effects=[effect(name) for name in names])
found = diagnose(prepared)

# %%
print(f"consistent: {found.consistency.consistent} (p = {found.consistency.p_value:.1e})")
for region in found.where:
    print("where:", region.description)
print("verdict:", found.decision.verdict)
for named in found.decision.named:
    print(f"  {named.effect}: probability {named.probability:.3f}, values {named.values}, u {named.u}")
print(f"gap on slices held out: {100 * found.gap.heldout_before:.2f} % -> {100 * found.gap.heldout_after:.2f} %")

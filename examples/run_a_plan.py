# %% [markdown]
# # Run a plan
# A scan from a program: the same session that the command line and the window use. The laboratory is the simulated one,
# a process of its own that speaks the wire protocols of real devices; with `devices=Path("devices.toml")` in place of
# `simulate=True` the same lines drive an instrument.

# %%
from pathlib import Path
from tempfile import mkdtemp

from instrument import Event, ScanRequest, ScanSession, read_run, rebuild_run

folder = Path(mkdtemp(prefix="goniotwin-example-"))
(folder / "plan.toml").write_text(
    """
version = 1
title = "three points"
[[grid]]
wavelength = [500.0]
illumination_zenith = [0.0]
sensor_azimuth = [90.0]
sensor_zenith = [40.0, 0.0, -40.0]
""",
    encoding="utf-8",
)

# %% [markdown]
# Zenith 0 under illumination from zenith 0 is retro-reflection: the detector's head would stand in the beam. The plan
# leaves that point out and says so. The simulated clock may run fast; `twin=False` measures without predicting.

# %%
request = ScanRequest(plan=folder / "plan.toml", simulate=True, speed=200.0, twin=False, out=folder / "run")
measured: list[float] = []


def listen(event: Event) -> None:
    """Called with everything that happens, on a thread of its own: it can neither delay nor break the scan."""
    if event.kind == "point_measured":
        measured.append(event.brf)
        print(f"zenith {event.geometry.sensor_zenith:+5.1f}  BRF {event.brf:.4f} ± {event.u_brf:.4f}")


with ScanSession(request) as session:
    session.subscribe(listen)
    for blocked in session.plan.blocked:
        print(f"left out: zenith {blocked.geometry.sensor_zenith:g}, {blocked.reason}")
    session.start()
    ended = session.wait()
assert ended is not None
print(f"{ended.done} of {ended.total} points measured: {ended.outcome}")

# %% [markdown]
# The run file is an xarray dataset with labelled axes; every row of the uncertainty budget is a variable of its own.
# The journal is the source of truth: the run file can be made of it again.

# %%
run = read_run(session.run_dir / "run.nc")
print(run[["brf", "u_brf"]])
print("components:", ", ".join(run["brf"].attrs["unc_comps"]))
again = rebuild_run(session.run_dir)
assert (again["brf"] == run["brf"]).all()

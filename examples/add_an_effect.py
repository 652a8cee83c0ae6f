# %% [markdown]
# # Add an effect
# An effect is one class. This one is a detector that is not warm when the scan begins. It acts on the reading, so it
# needs no rendering; effects on the scene return a `Variation` instead (`SceneEffect`), effects of the sensor arm an
# angle (`ZenithEffect`).

# %%
from pathlib import Path

import numpy as np
import xarray as xr

import sim_fixtures.examples
from instrument import read_facility
from instrument.angles import FloatArray
from twin.diagnosis.acquisition import Acquisition, acquisition_of
from twin.diagnosis.effects import Parameter, ReadingEffect, library
from twin.diagnosis.observation import observe


class DetectorWarmUp(ReadingEffect):
    """Responsivity that settles: 1 + fraction exp(-p/share), p from 0 to 1 over the run."""

    name = "detector_warm_up"
    title = "detector not warm at the start"
    parameters = (
        Parameter("fraction", "1", typical=0.03, cap=(-0.3, 0.3)),
        Parameter("share", "1", typical=0.1, cap=(0.02, 0.3), nominal=0.1, shape=True),
    )
    needs = ("progress",)  # a run without times is told that this was not looked for
    confused_with = ("source_drift",)
    separated_by = "the first slice read again at the end"

    def reading(self, run: Acquisition, brf: FloatArray, values: FloatArray) -> FloatArray:
        """What is read where brf is right."""
        assert run.progress is not None
        fraction, share = values[..., :1], values[..., 1:]
        return np.asarray(brf * (1 + fraction * np.exp(-run.progress / share)))


# %% [markdown]
# Another package makes it part of the library by an entry point in its `pyproject.toml`; a module in
# `twin/diagnosis/effects/` is found by itself:
#
# ```toml
# [project.entry-points."goniotwin.effects"]
# detector_warm_up = "our_effects:DetectorWarmUp"
# ```
#
# Without installing anything it can be handed to the bench: `bench.prepare(run, effects=[*library().values(),
# DetectorWarmUp()])`. What follows looks at what it does to a run of 24 points without any gap.

# %%
zeniths = np.linspace(75.0, -75.0, 24)
table = {name: ("point", np.zeros(24)) for name in ("illumination_azimuth", "sensor_azimuth")}
table |= {"wavelength": ("point", np.full(24, 500.0)), "illumination_zenith": ("point", np.full(24, 30.0))}
table["sensor_zenith"] = ("point", zeniths)
times = np.datetime64("2026-03-02T08:00", "ns") + np.arange(24) * np.timedelta64(22, "s")
data = {"brf": ("point", np.full(24, 0.5)), "u_brf": ("point", np.full(24, 0.005))}
run = observe(xr.Dataset(data, table | {"time": ("point", times)}), "24 points")
facility = read_facility(Path(sim_fixtures.examples.__file__).parent / "facility.toml")
acquisition = acquisition_of(run, facility)

warming = DetectorWarmUp()
read = warming.reading(acquisition, run.brf, np.array([0.03, 0.1]))
for zenith, value in zip(zeniths[:4], read[:4], strict=True):
    print(f"zenith {zenith:+5.1f}  reads {value:.4f} where {run.brf[0]:.4f} is right")
print(
    f"the library has {len(library())} effects, {warming.name} is {'in' if warming.name in library() else 'not in'} it"
)

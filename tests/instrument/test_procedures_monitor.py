"""The monitor photodiode: read beside the detector, and what of the source's changes it takes out of a scan."""

from __future__ import annotations

from pathlib import Path

import pytest

from drivers.errors import CommunicationError, DeviceFault
from drivers.interfaces import Reading
from instrument.dataset import read_run
from instrument.monitor import MonitoredDetector
from instrument.request import ScanRequest
from instrument.session import ScanSession
from instrument.settings import ScanSettings
from sim_fixtures.laboratory import start_simulated

PLAN = """
version = 1
title = "monitor"
[[grid]]
wavelength = [500.0]
illumination_zenith = [0.0]
sensor_azimuth = [90.0]
sensor_zenith = { start = 10.0, stop = 35.0, step = 5.0 }
"""


class Meter:
    """Reads what it is given, once each."""

    name, full_scale = "meter", 10.0

    def __init__(self, *bursts: tuple[float, ...] | Exception) -> None:
        self.bursts = list(bursts)

    def identify(self) -> str:
        return "meter"

    def make_safe(self) -> None: ...

    def close(self) -> None: ...

    def read(self, samples: int) -> Reading:
        burst = self.bursts.pop(0)
        if isinstance(burst, Exception):
            raise burst
        return Reading(burst)


def test_each_burst_has_the_monitor_s_reading_of_its_own_time():
    pair = MonitoredDetector(Meter((1.0, 2.0), (0.1, 0.2)), Meter((0.25,), (3.0, 5.0), (3.5,)))
    assert pair.zero() == 0.25
    bright, dark = pair.read(2), pair.read(2)
    assert pair.beside(bright.samples) == {"monitor": 3.75}
    assert pair.beside(dark.samples) == {"monitor": 3.25}
    assert pair.beside((9.0, 9.0)) == {}


def test_a_monitor_without_light_is_no_monitor():
    pair = MonitoredDetector(Meter((1.0,)), Meter((0.004,)))
    with pytest.raises(DeviceFault, match="no light"):
        pair.beside(pair.read(1).samples)


def test_a_lost_reply_of_the_monitor_is_not_passed_over():
    pair = MonitoredDetector(Meter((1.0,)), Meter(CommunicationError("monitor", "no reply", "")))
    with pytest.raises(CommunicationError, match="monitor"):
        pair.read(1)


def test_a_source_that_grows_brighter_changes_nothing_with_a_monitor(tmp_path: Path):
    """The sample reflects 0.5 of a reference of 0.99; the source gains 100 % an hour after the reference was read."""
    (tmp_path / "room").mkdir()
    (tmp_path / "plan.toml").write_text(PLAN)
    last = {}
    settings = ScanSettings(dwell=20.0, disk_reserve=0.0, emission_while_mounting=True)
    with start_simulated(tmp_path / "room", speed=400.0, flux="lambertian") as laboratory:
        laboratory.control("trouble", name="drift_per_hour", value=1.0)
        for name in ("devices", "devices-monitor"):
            request = ScanRequest(
                plan=tmp_path / "plan.toml",
                devices=laboratory.inputs.devices.with_name(f"{name}.toml"),
                facility=laboratory.inputs.facility,
                out=tmp_path / name,
                twin=False,
            )
            with ScanSession(request, operator=laboratory.operator, settings=settings) as session:
                session.start()
                end = session.wait(120.0)
            assert end is not None
            assert (end.outcome, end.done) == ("finished", 6)
            run = read_run(tmp_path / name / "run.nc")
            last[name] = float(run["brf"].values[-2:].mean())
            assert ("monitor" in run.variables) == (name == "devices-monitor")
    # Noise is 0.4 % for the mean of two; the laboratory's cosine is the ideal flux of this beam within 0.3 %.
    assert last["devices-monitor"] == pytest.approx(0.5, rel=0.015)
    assert last["devices"] > 1.025 * last["devices-monitor"]

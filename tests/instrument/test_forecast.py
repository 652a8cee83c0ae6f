"""The estimated duration of a scan against the time that the simulated laboratory takes for it."""

from __future__ import annotations

from pathlib import Path

import pytest
from scan_stage import FACILITY, stage
from virtual_laboratory import VirtualLaboratory

from instrument.events import ScanEnded, ScanStarted
from instrument.facility import Facility
from instrument.plan import PlanForm, make_plan
from instrument.prompts import Prompt
from instrument.settings import MotionSettings, ScanSettings

GRID = {"wavelength": [500.0], "illumination_zenith": [0.0], "sensor_azimuth": [0.0], "sensor_zenith": [40.0, 30.0]}
ZENITHS = {"start": 60.0, "stop": -60.0, "step": -40.0}


def facility(**arms: object) -> Facility:
    return FACILITY.model_copy(update={"arms": FACILITY.arms.model_copy(update=arms)})


class SlowHands:
    """A person who takes as long as the settings expect, and does what is asked for."""

    def __init__(self, bench: VirtualLaboratory, seconds: float) -> None:
        self._bench, self._seconds = bench, seconds
        self.done: list[str] = []

    def mount(self, what: str) -> None:
        self._bench.clock.sleep(self._seconds)
        self._bench.mount(what)

    def reply(self, prompt: Prompt) -> None:
        self.done.append(prompt.key)
        if prompt.key.startswith("turn:"):
            self._bench.clock.sleep(self._seconds)


def durations(
    tmp_path: Path,
    parts: list[dict],
    settings: ScanSettings,
    at: Facility = FACILITY,
    edit: dict[str, dict[str, object]] | None = None,
    **keys: object,
) -> tuple[float, float]:
    """Estimated and simulated duration, s."""
    form = PlanForm.model_validate({"version": 1, "part": [GRID | part for part in parts], **keys})
    (tmp_path / "lab").mkdir()
    (tmp_path / "run").mkdir()
    bench = VirtualLaboratory(tmp_path / "lab", at, edit)
    try:
        s = stage(tmp_path / "run", make_plan(form, at, "plan.toml"), bench, settings, at)  # type: ignore[arg-type]
        s.engine._steps._operator = SlowHands(bench, settings.hands)
        end = s.run(120.0)
        assert end.outcome == "finished", end.reason
    finally:
        bench.close()
    (began,), (ended,) = s.events(ScanStarted), s.events(ScanEnded)
    return began.duration_s, (ended.time - began.time).total_seconds()


#: Fewer looks at moving arms than usual: each is a question on a wire.
MOTION = MotionSettings(poll=0.4)
USUAL = ScanSettings(disk_reserve=0.0, motion=MOTION)
BRISK = ScanSettings(disk_reserve=0.0, dwell=0.0, motion=MOTION)


@pytest.mark.parametrize(
    ("parts", "settings", "keys"),
    [
        pytest.param([{"sensor_zenith": ZENITHS, "sensor_azimuth": [90.0]}], USUAL, {}, id="dwell"),
        pytest.param([{"sensor_zenith": ZENITHS, "sensor_azimuth": [0.0, 90.0]}], BRISK, {}, id="moves"),
        pytest.param([{"wavelength": [500.0, 600.0]}], BRISK, {}, id="filters"),
        pytest.param([{}], BRISK, {"samples": 100}, id="averaging"),
    ],
)
def test_the_estimate_is_within_five_percent(
    tmp_path: Path, parts: list[dict], settings: ScanSettings, keys: dict
) -> None:
    estimated, simulated = durations(tmp_path, parts, settings, **keys)
    assert estimated == pytest.approx(simulated, rel=0.05)


def test_approaches_from_one_side_count(tmp_path: Path) -> None:
    edit = {"sensor_zenith": {"approach": "rising", "backlash": 3.0}}
    parts = [{"sensor_zenith": ZENITHS, "sensor_azimuth": [90.0]}]
    estimated, simulated = durations(tmp_path, parts, BRISK, edit=edit)
    assert estimated == pytest.approx(simulated, rel=0.05)


def test_stages_count(tmp_path: Path) -> None:
    at = facility(sample_rotation=(-180.0, 180.0), polarizer=(0.0, 90.0))
    parts = [{"sample_rotation": [0.0, 120.0], "polarization": ["s", "mean"]}]
    estimated, simulated = durations(tmp_path, parts, BRISK, at)
    assert estimated == pytest.approx(simulated, rel=0.05)


def test_repetitions_of_the_reference_count(tmp_path: Path) -> None:
    at = FACILITY.model_copy(update={"reference": FACILITY.reference.model_copy(update={"repeat_minutes": 1.0})})
    estimated, simulated = durations(tmp_path, [{"sensor_zenith": ZENITHS}], USUAL, at)
    assert estimated == pytest.approx(simulated, rel=0.05)


def test_hands_that_turn_the_sample_and_change_it_count(tmp_path: Path) -> None:
    at = facility(illumination_azimuth=(-90.0, 90.0))
    parts = [{"illumination_zenith": [20.0], "illumination_azimuth": azimuth} for azimuth in (0.0, 30.0)]
    settings = BRISK.model_copy(update={"hands": 90.0, "warm_up": 30.0})
    estimated, simulated = durations(tmp_path, parts, settings, at)
    assert simulated > 4 * 120.0  # the reference, the sample, and two azimuths
    assert estimated == pytest.approx(simulated, rel=0.05)

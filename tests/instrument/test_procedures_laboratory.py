"""Procedures on the wires of the simulated laboratory: a sound one passes, each fault is found with its size.

Sizes of the faults are what the laboratory was told; the procedures know nothing of them.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from drivers.errors import DeviceError
from instrument.control import AbortAsked, HaltAsked
from instrument.errors import InputError
from instrument.procedures.alignment import STEPS, alignment
from instrument.procedures.control_sample import control_sample, name_of
from instrument.procedures.dark import dark_level
from instrument.procedures.gain_ratio import gain_ratios
from instrument.procedures.intersection import intersection
from instrument.procedures.linearity import linearity
from instrument.procedures.results import CalibrationResult, Finding, Quantity, store
from instrument.procedures.room import Room, RoomRequest, open_room
from instrument.procedures.run import carry_out
from instrument.procedures.warm_up import warm_up
from instrument.procedures.wavelength import wavelength_check
from instrument.prompts import Prompt
from sim_fixtures.laboratory import SimulatedLaboratory, start_simulated

REQUEST = RoomRequest(simulate=True, who="a test")


@pytest.fixture(scope="module")
def laboratory(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SimulatedLaboratory]:
    with start_simulated(tmp_path_factory.mktemp("room"), speed=1000.0, flux="lambertian") as running:
        yield running


@pytest.fixture
def run(laboratory: SimulatedLaboratory) -> Iterator[Callable[..., Finding]]:
    """Run a procedure with faults; afterwards the laboratory is safe, and sound again."""
    broken: set[str] = set()

    def carry(work: Callable[[Room], Finding], **faults: float) -> Finding:
        for name, value in faults.items():
            broken.add(name)
            laboratory.control("trouble", name=name, value=value)
        with open_room(REQUEST, laboratory=laboratory) as room:
            return work(room)

    yield carry
    for name in broken:
        laboratory.control("trouble", name=name, value=600.0 if name == "warm_up_time_s" else 0.0)
    assert_safe(laboratory)


def assert_safe(laboratory: SimulatedLaboratory) -> None:
    state = laboratory.control("state")
    assert not state["emission"]
    assert not state["shutter_open"]
    assert not any(axis["moving"] for axis in state["axes"].values())


def test_gain_ratios_of_a_sound_amplifier_and_of_one_whose_middle_range_is_off(run):
    assert run(partial(gain_ratios, repeats=1)).verdict == "passed"
    finding = run(partial(gain_ratios, repeats=1), gain_error_1e6=0.01)
    assert finding.verdict == "failed"
    assert finding.values["departure 1e6/1e5"].value == pytest.approx(0.01, abs=5e-4)
    assert finding.values["departure 1e7/1e6"].value == pytest.approx(1 / 1.01 - 1, abs=5e-4)
    assert "gains = [100000, 1.01" in finding.advice[0]


@pytest.mark.parametrize("way", ["channels", "apertures"])
def test_a_nonlinear_detector_is_found_with_its_size(run, laboratory: SimulatedLaboratory, way: str):
    finding = run(partial(linearity, way=way, levels=2, repeats=1), nonlinearity=0.008)
    assert finding.verdict == "failed"
    found = finding.values["departure at full scale"]
    assert found.u is not None
    assert found.value == pytest.approx(0.008, abs=max(3 * found.u, 3e-4))
    assert laboratory.control("state")["apertures"] == {"a": True, "b": True}


def test_a_linear_detector_passes_and_only_the_usual_line_of_the_filter_is_left_open(run, laboratory):
    amplitudes = []

    def work(room: Room) -> Finding:
        finding = linearity(room, levels=2, repeats=1)
        selector: Any = room.laboratory.selector
        amplitudes.extend(selector.channel_amplitude(number) for number in range(8))
        return finding

    assert run(work).verdict == "passed"
    assert amplitudes == [1.0] + [0.0] * 7


def test_light_through_the_closed_shutter_and_an_offset_are_told_apart(run):
    sound = run(dark_level)
    assert sound.verdict == "passed"
    leaking = run(dark_level, light_leak_v=0.002)
    assert leaking.verdict == "failed"
    assert leaking.values["leak 1e6"].value == pytest.approx(0.002, abs=1e-5)
    offset = run(dark_level, light_leak_v=0.0, dark_offset_v=0.01)
    assert offset.verdict == "passed"
    assert offset.values["dark 1e6"].value - sound.values["dark 1e6"].value == pytest.approx(0.01, abs=1e-5)
    assert run(dark_level, dark_offset_v=0.9).verdict == "failed"


def test_the_warm_up_ends_when_the_light_is_stable_and_not_before(run):
    finding = run(partial(warm_up, limit=0.02, interval=30.0, window=6), warm_up_share=0.05, warm_up_time_s=300.0)
    assert finding.verdict == "passed"
    # The slope a/T exp(-t/T) has fallen to 2 % an hour after T ln(a 3600/(T 0.02)) s, in the middle of the window.
    assert finding.values["warm-up time"].value > 300.0 * 3.4
    assert abs(finding.values["slope"].value) < 0.02
    hasty = run(partial(warm_up, limit=0.02, interval=10.0, window=4, longest=60.0), drift_per_hour=0.5)
    assert hasty.verdict == "failed"


def test_a_control_sample_that_has_changed_leaves_its_chart(run, laboratory: SimulatedLaboratory, tmp_path: Path):
    measure = partial(control_sample, subject="tile 4", results=tmp_path)
    finding = run(measure)
    # Over the reference of 0.99 it reflects 0.62 (sim_fixtures.bench.pieces), at any angle.
    name = name_of((0.0, 45.0, 90.0), 500.0)
    assert finding.values[name].value == pytest.approx(0.62 * 0.99, rel=1e-3)
    for _ in range(2):
        with open_room(REQUEST, laboratory=laboratory) as room:
            store(carry_out(room, "control-sample", measure, {}), tmp_path)
    assert run(measure).verdict == "passed"
    dirty = run(measure, control_change=-0.04)
    assert dirty.verdict == "failed"
    assert "-4.0" in dirty.summary


@pytest.mark.slow
def test_the_two_ways_and_the_edge_tell_offset_tilt_and_runout(run):
    finding = run(partial(intersection, repeats=1, edge=False), sensor_zenith_offset_deg=0.8)
    assert finding.values["sensor zenith offset"].value == pytest.approx(0.8, abs=0.02)
    assert finding.values["stage tilt"].value == pytest.approx(0.0, abs=0.02)
    assert finding.verdict == "failed"
    finding = run(
        partial(intersection, repeats=1), sensor_zenith_offset_deg=0.0, sensor_runout_mm=0.4, stage_tilt_deg=-0.4
    )
    assert finding.values["stage tilt"].value == pytest.approx(-0.4, abs=0.02)
    assert finding.values["sensor axis distance"].value == pytest.approx(0.4, abs=0.02)


@pytest.mark.slow
def test_a_shifted_wavelength_scale_is_found(run):
    assert run(partial(wavelength_check, step=4.0)).verdict == "passed"
    finding = run(partial(wavelength_check, step=4.0), wavelength_error_nm=0.8)
    assert finding.verdict == "failed"
    for quantity in finding.values.values():
        assert quantity.value == pytest.approx(0.8, abs=0.06)


def test_an_expired_wavelength_standard_is_refused_unless_accepted(run, laboratory, tmp_path: Path):
    certificate = tmp_path / "old.toml"
    text = (laboratory.inputs.devices.parent / "wavelength_standard.toml").read_text()
    certificate.write_text(text.replace("2035-12-31", "2026-02-01"))
    with pytest.raises(InputError, match=r"expired on 2026-02-01; --accept-expired"):
        run(partial(wavelength_check, standard=certificate))


def test_a_procedure_ends_safely_when_a_person_gives_up_or_the_light_goes_out(run, laboratory):
    class Impatient:
        def reply(self, prompt: Prompt) -> None:
            raise KeyboardInterrupt

    with pytest.raises(AbortAsked, match="given up at"), open_room(REQUEST, Impatient(), laboratory=laboratory) as room:
        gain_ratios(room)
    assert_safe(laboratory)

    def interrupted(room: Room) -> Finding:
        room.say = lambda text: laboratory.control("open_interlock")
        return gain_ratios(room, repeats=1)

    try:
        with pytest.raises(DeviceError, match="interlock"):
            run(interrupted)
    finally:
        laboratory.control("close_interlock")
    assert_safe(laboratory)


def test_a_procedure_can_be_aborted_while_it_waits_for_a_person(laboratory):
    class Slow:
        def __init__(self) -> None:
            self.asked = threading.Event()

        def reply(self, prompt: Prompt) -> None:
            self.asked.set()
            threading.Event().wait(20.0)

    slow = Slow()

    def aborted() -> None:
        with open_room(REQUEST, slow, laboratory=laboratory) as room:
            threading.Thread(target=lambda: slow.asked.wait(20.0) and room.controls.abort("a test")).start()
            gain_ratios(room)

    with pytest.raises(AbortAsked, match="a test"):
        aborted()
    assert_safe(laboratory)


@pytest.mark.parametrize(("number", "end"), [(signal.SIGQUIT, HaltAsked), (signal.SIGTERM, AbortAsked)])
def test_an_arm_under_way_is_stopped_as_a_procedure_is_halted_or_ended(laboratory, number: int, end: type[Exception]):
    under_way = []

    def ended() -> None:
        with open_room(REQUEST, laboratory=laboratory) as room:
            room.home()
            room.light()
            laboratory.control("stall", axis="sensor_zenith")  # it moves until it is stopped
            axis: Any = room.laboratory.sensor_zenith
            start_move = axis.start_move

            def start_and_signal(target: float) -> None:
                start_move(target)
                under_way.append(laboratory.control("state")["axes"]["sensor_zenith"]["moving"])
                signal.raise_signal(number)

            axis.start_move = start_and_signal
            room.go(0.0, 50.0, 90.0, 500.0)

    with pytest.raises(end):
        ended()
    assert under_way == [True]
    assert_safe(laboratory)


class Aligner:
    """Answers the steps of the alignment with given numbers, and looks at the laboratory meanwhile."""

    def __init__(self, laboratory: SimulatedLaboratory, numbers: dict[str, Any]) -> None:
        self.laboratory, self.numbers = laboratory, numbers
        self.seen: dict[str, dict[str, Any]] = {}

    def reply(self, prompt: Prompt) -> float | str | None:
        key = prompt.key.removeprefix("align:")
        self.seen[key] = self.laboratory.control("state")
        return None if prompt.kind == "confirm" else self.numbers[key]


def test_the_alignment_leads_through_its_steps_and_keeps_every_answer(laboratory):
    numbers = {"level": 12.5, "height": 0.05, "distance": 600.0, "back-x": 0.0, "back-y": 20.0, "centre": "yes"}
    person = Aligner(laboratory, numbers)
    with open_room(REQUEST, person, laboratory=laboratory) as room:
        result = carry_out(room, "alignment", alignment, {})
    # Half the angle of the back reflection, by hand: atan(20/600)/2 = 0.955 degree, far more than u_tilt of 0.1.
    assert result.values["tilt across"].value == pytest.approx(0.9546, abs=1e-3)
    assert result.values["micrometer"].value == 12.5
    assert result.verdict == "failed"
    assert [answer.key for answer in result.answers if answer.key != "start-source"] == [s.prompt.key for s in STEPS]
    assert {answer.who for answer in result.answers} == {"a test"}
    # Light on the stage only for steps that look at it, and faintly then.
    open_at = {key for key, state in person.seen.items() if state["shutter_open"]}
    assert open_at == {"back-x", "back-y", "centre"}
    assert all(person.seen[key]["power"] < 0.05 for key in open_at)
    assert person.seen["centre"]["axes"]["illumination_zenith"]["position"] == pytest.approx(60.0, abs=0.05)
    assert_safe(laboratory)


def test_a_result_says_with_what_it_was_made(laboratory, tmp_path: Path):
    with open_room(replace(REQUEST, who="J. Doe"), laboratory=laboratory) as room:
        result = carry_out(room, "dark-level", lambda room: dark_level(room, samples=9, leak=False), {"samples": 9})
    assert result.who == "J. Doe"
    assert "Keysight" in result.instrument["devices"]["detector"]
    assert result.settings == {"samples": 9}
    assert isinstance(result, CalibrationResult)
    assert isinstance(result.values["dark 1e5"], Quantity)

"""Readings: the right gain, light and dark, and nothing saturated averaged silently."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from fake_bench import FULL_CURRENT, Bench
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.errors import CommunicationError, DeviceFault
from drivers.interfaces import Reading
from instrument.acquisition import Acquisition, Burst, NoLight, Overloaded
from instrument.control import Controls
from instrument.run_schema import REPEATED
from instrument.settings import AcquisitionSettings


class Meter:
    def __init__(self, current: float = 0.4e-6, **changes: float) -> None:
        self.bench = Bench()
        self.bench.mounted, self.bench.source.on = "sample", True
        self.bench.reflectance["sample"] = current / FULL_CURRENT
        self.notes: list[str] = []
        self.acquisition = self._with(AcquisitionSettings(**changes))

    def take(self, how: AcquisitionSettings) -> Burst:
        return self._with(how).measure(9)

    def _with(self, how: AcquisitionSettings) -> Acquisition:
        bench = self.bench
        return Acquisition(
            bench.detector,
            bench.amplifier,
            bench.shutter,
            bench.clock,
            Controls(bench.clock),
            self.notes.append,
            how,
        )


def test_a_reading_has_nine_samples_with_light_and_a_mean_without() -> None:
    meter = Meter()
    burst = meter.acquisition.measure(9)
    assert len(burst.samples) == 9
    assert burst.dark == pytest.approx(meter.bench.detector.offset, abs=1e-4)
    assert burst.current == pytest.approx(0.4e-6, rel=1e-3)
    assert burst.quality_flag == 0
    assert not meter.bench.shutter.opened


@settings(max_examples=40, deadline=None)
@given(exponent=st.floats(-8.5, -3.3))
def test_the_gain_suits_any_light_that_the_amplifier_can_take(exponent: float) -> None:
    current = 10.0**exponent
    meter = Meter(current)
    burst = meter.acquisition.measure(9)
    assert burst.quality_flag == 0
    assert burst.current == pytest.approx(current, rel=0.01)
    assert max(burst.samples) < 0.9 * meter.bench.detector.full_scale + 1e-2
    at_highest = burst.gain == max(meter.bench.amplifier.gains)
    assert at_highest or max(burst.samples) > 0.05 * meter.bench.detector.full_scale - 1e-2


def test_a_gain_that_suits_is_kept() -> None:
    meter = Meter()
    meter.acquisition.measure(9)
    before, meter.notes[:] = meter.bench.detector.bursts, []
    meter.acquisition.measure(9)
    assert meter.bench.detector.bursts - before == 2
    assert meter.notes == []


def test_a_reading_over_the_top_is_taken_anew_at_a_lower_gain() -> None:
    meter = Meter(0.4e-6)
    assert meter.acquisition.measure(9).gain == 1e7
    meter.bench.reflectance["sample"] *= 50
    burst = meter.acquisition.measure(9)
    assert (burst.gain, burst.quality_flag) == (1e5, 0)
    assert any("overload" in note for note in meter.notes)


def test_more_light_than_the_lowest_gain_takes_is_no_reading() -> None:
    meter = Meter(1e-1)
    with pytest.raises(Overloaded, match="lowest gain"):
        meter.acquisition.measure(9)
    assert not meter.bench.shutter.opened


def test_saturation_at_the_lowest_gain_is_no_reading() -> None:
    meter = Meter(1.1e-3)
    with pytest.raises(Overloaded, match=r"saturated, 11 V of 10 V, at the lowest gain \(10000 V/A\)"):
        meter.acquisition.measure(9)
    assert not meter.bench.shutter.opened


def test_one_clipped_sample_of_nine_is_never_averaged_in() -> None:
    """At any gain the burst is taken anew, lower; at the lowest one there is no reading."""
    meter = Meter(0.4e-6)
    assert meter.acquisition.measure(9).gain == 1e7
    honest = meter.bench.detector.read

    def spiking(samples: int) -> Reading:
        volts = list(honest(samples).samples)
        if meter.bench.shutter.opened and meter.bench.amplifier.gain() > 1e5:
            volts[4] = 10.0
        return Reading(tuple(volts))

    meter.bench.detector.read = spiking  # type: ignore[method-assign]
    burst = meter.acquisition.measure(9)
    assert burst.gain == 1e5
    assert max(burst.samples) < 0.1
    assert burst.current == pytest.approx(0.4e-6, rel=0.02)
    meter.bench.amplifier.gains = (1e7,)
    with pytest.raises(Overloaded, match="saturated, 10 V of 10 V"):
        meter.acquisition.measure(9)


def test_the_overload_line_of_the_amplifier_counts() -> None:
    """Though every number looks good: gain after gain is given up, and the lowest one makes no reading either."""
    meter = Meter()
    meter.bench.amplifier.overload = lambda: meter.bench.shutter.opened  # type: ignore[method-assign]
    with pytest.raises(Overloaded, match="overload at the lowest gain"):
        meter.acquisition.measure(9)
    meter.bench.amplifier.overload = lambda: meter.bench.shutter.opened and meter.bench.amplifier.gain() > 1e6
    burst = meter.acquisition.measure(9)
    assert (burst.gain, burst.quality_flag) == (1e6, 0)


@pytest.mark.parametrize("level", [9.2, 0.46, 0.92])
def test_noise_about_a_threshold_does_not_make_the_gain_change_to_and_fro(level: float) -> None:
    """At 0.9 and at 0.05 of full scale, where the gain changes, and where it then arrives."""
    meter = Meter((level - 0.002) / 1e7)
    meter.bench.detector.noise = 0.05
    gains = [meter.acquisition.measure(9).gain for _ in range(40)]
    assert sum(a != b for a, b in itertools.pairwise(gains)) <= 1


def test_an_amplifier_that_settles_slowly_is_waited_for() -> None:
    """After a change of gain 30 % are missing, and a third of that ten samples later."""
    meter = Meter(0.4e-6)
    bench = meter.bench
    taken = [0]
    exact, set_gain = bench.detector.read, bench.amplifier.set_gain

    def select(gain: float) -> None:
        set_gain(gain)
        taken[0] = 0

    def read(samples: int) -> Reading:
        missing = 0.3 * np.exp(-(taken[0] + np.arange(samples)) / 9.0)
        taken[0] += samples
        return Reading(tuple(np.array(exact(samples).samples) * (1 - missing)))

    bench.amplifier.set_gain, bench.detector.read = select, read  # type: ignore[method-assign]
    assert meter.take(AcquisitionSettings(settling_attempts=9)).current == pytest.approx(0.4e-6, rel=2e-3)
    assert [note[:20] for note in meter.notes] == ["gain 10000 -> 1e+07 "]
    bench.amplifier.set_gain(1e4)
    assert meter.take(AcquisitionSettings(settling_attempts=2)).current < 0.97 * 0.4e-6
    assert meter.notes[-1].startswith("the volts still drift by")


def test_an_outlier_is_noted_and_kept() -> None:
    meter = Meter(0.4e-6)
    meter.acquisition.measure(9)
    honest = meter.bench.detector.read

    def disturbed(samples: int) -> Reading:
        volts = list(honest(samples).samples)
        volts[6] += 0.01
        return Reading(tuple(volts))

    meter.bench.detector.read, meter.notes[:] = disturbed, []  # type: ignore[method-assign]
    burst = meter.acquisition.measure(9)
    assert [note.split(" is an outlier")[0] for note in meter.notes] == [
        "sample 7 of 9 with light",
        "sample 7 of 9 in the dark",
    ]
    assert burst.samples[6] == pytest.approx(4.012, abs=1e-3)
    assert burst.current * burst.gain == pytest.approx(np.mean(burst.samples) - np.mean(burst.dark_samples))


def test_an_overload_in_the_dark_is_a_fault() -> None:
    meter = Meter()
    meter.bench.amplifier.overload = lambda: not meter.bench.shutter.opened  # type: ignore[method-assign]
    with pytest.raises(DeviceFault, match="shutter closed"):
        meter.acquisition.measure(9)


def test_a_lost_reading_is_asked_for_again_and_flagged() -> None:
    meter = Meter()
    meter.acquisition.measure(9)
    meter.bench.detector.lost_replies = 1
    assert meter.acquisition.measure(9).quality_flag == REPEATED
    assert meter.acquisition.measure(9).quality_flag == 0


def test_a_meter_that_stays_mute_is_an_error_with_the_shutter_closed() -> None:
    meter = Meter()
    meter.acquisition.measure(9)
    meter.bench.detector.lost_replies = 3
    with pytest.raises(CommunicationError):
        meter.acquisition.measure(9)
    assert not meter.bench.shutter.opened


def test_a_shutter_that_does_not_close_is_a_fault() -> None:
    meter = Meter()
    meter.bench.shutter.stuck = True
    with pytest.raises(DeviceFault, match="shutter"):
        meter.acquisition.measure(9)


def test_the_standard_error_is_that_of_the_mean() -> None:
    burst = Burst((1.0, 1.2, 0.8, 1.1, 0.9), dark=0.5, gain=1e6, quality_flag=0)
    scatter = math.sqrt(sum((v - 1.0) ** 2 for v in burst.samples) / 4 / 5)
    assert burst.current == pytest.approx(0.5e-6)
    assert burst.relative_standard_error == pytest.approx(scatter / 0.5)
    assert math.isnan(Burst((1.0,), 0.0, 1e6, 0).relative_standard_error)


@pytest.mark.parametrize("offset", [0.0, 0.002])
def test_an_open_shutter_that_makes_no_difference_is_no_reading(offset: float) -> None:
    meter = Meter(0.0)
    meter.bench.detector.noise, meter.bench.detector.offset = 0.0, offset
    with pytest.raises(NoLight, match="with the shutter open"):
        meter.acquisition.measure(9)
    assert not meter.bench.shutter.opened

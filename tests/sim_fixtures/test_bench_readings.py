"""What the bench reads: light path, noise, gain, saturation, and that a run repeats by its seed."""

from __future__ import annotations

import math
import threading
import time

import numpy as np
import pytest

from instrument.facility import Facility
from sim_fixtures.bench import Bench, ManualClock, lambertian_flux
from sim_fixtures.bench.detector import Electronics, gain_of_code, output_voltage
from sim_fixtures.bench.flux import FluxAhead, Geometry
from sim_fixtures.bench.light import Source

LOW_NOISE_1E6, LOW_NOISE_1E7 = 11, 12


def ready(bench: Bench, clock: ManualClock) -> Bench:
    """Homed, lit, shutter open, gain 1e6."""
    for axis in bench.axes.values():
        axis.home()
    bench.source.reset_interlock()
    bench.source.power = 0.6
    assert bench.source.switch(True)
    bench.selector.rf_on, bench.selector.amplitudes[0] = True, 1.0
    bench.shutter.command(True)
    bench.amplifier.select(LOW_NOISE_1E6)
    clock.advance(20.0)
    return bench


def go(bench: Bench, clock: ManualClock, **angles: float) -> None:
    for name, angle in angles.items():
        bench.axes[name].move(angle, 20.0, 10.0)
    clock.advance(30.0)


@pytest.fixture
def clock():
    return ManualClock()


@pytest.fixture
def make_bench(facility: Facility, clock: ManualClock):
    made = []

    def make(seed: int = 1, flux=lambertian_flux) -> Bench:
        made.append(Bench(facility, flux, clock, seed))
        return ready(made[-1], clock)

    yield make
    for bench in made:
        bench.close()


def test_the_reference_gives_about_one_volt_at_normal_power(make_bench, clock):
    bench = make_bench()
    go(bench, clock, sensor_zenith=15.0)
    mean = np.mean(bench.measure(9, 0.2))
    assert mean == pytest.approx(0.99 + 2e-4, rel=5e-4)


@pytest.mark.parametrize("what", ["emission", "shutter", "rf", "amplitude"])
def test_without_any_link_of_the_light_path_only_the_offset_is_left(make_bench, clock, what):
    bench = make_bench()
    if what == "emission":
        bench.source.switch(False)
    elif what == "shutter":
        bench.shutter.command(False)
    elif what == "rf":
        bench.selector.rf_on = False
    else:
        bench.selector.amplitudes[0] = 0.0
    clock.advance(1.0)
    volts = np.array(bench.measure(50, 0.2))
    assert volts.mean() == pytest.approx(2e-4, abs=3e-6)
    assert 2e-6 < volts.std() < 1e-5


def test_the_shutter_takes_its_time(make_bench, clock):
    bench = make_bench()
    bench.shutter.command(False)
    assert bench.shutter.is_open()
    clock.advance(0.06)
    assert not bench.shutter.is_open()


@pytest.mark.parametrize(("zenith", "relative"), [(0.0, 0.0051), (40.0, 0.005575), (-80.0, 0.0070)])
def test_the_mean_of_nine_scatters_as_the_budget_says(make_bench, clock, zenith, relative):
    bench = make_bench()
    bench.mount("sample")
    go(bench, clock, sensor_zenith=zenith)
    volts = np.array(bench.measure(9 * 800, 0.2)).reshape(-1, 9)
    signal = 0.5 * math.cos(math.radians(zenith)) / math.cos(math.radians(15.0))
    # 800 means know their standard deviation to 2.5 %.
    assert volts.mean(axis=1).std() / signal == pytest.approx(relative, rel=0.1)
    assert volts.mean() - 2e-4 == pytest.approx(signal, rel=5 * relative / math.sqrt(800))


def test_the_reference_scatters_by_three_in_ten_thousand(make_bench, clock):
    bench = make_bench()
    go(bench, clock, sensor_zenith=15.0)
    volts = np.array(bench.measure(2000, 0.2))
    assert volts.std() / volts.mean() == pytest.approx(3e-4, rel=0.1)


def _scan(bench: Bench, clock: ManualClock, zeniths: list[float]) -> dict[float, list[float]]:
    bench.mount("sample")
    readings = {}
    for zenith in zeniths:
        go(bench, clock, sensor_zenith=zenith)
        readings[zenith] = bench.measure(9, 0.2)
    return readings


def test_a_seed_repeats_whatever_the_timing_and_the_order(make_bench, clock):
    first = _scan(make_bench(seed=3), clock, [10.0, 20.0, -30.0])
    clock.advance(1234.5)
    second = _scan(make_bench(seed=3), clock, [-30.0, 20.0, 10.0])
    assert first == second


def test_another_seed_and_another_pass_read_differently(make_bench, clock):
    bench = make_bench(seed=3)
    first = _scan(bench, clock, [10.0])
    assert _scan(bench, clock, [10.0]) != first
    assert _scan(make_bench(seed=4), clock, [10.0]) != first


def test_too_much_gain_saturates_and_raises_the_overload_line(make_bench, clock):
    bench = make_bench()
    bench.source.power = 1.0
    bench.amplifier.select(LOW_NOISE_1E7)
    clock.advance(1.0)
    assert bench.measure(3, 0.2) == [10.0] * 3
    assert bench.overload()
    bench.amplifier.select(LOW_NOISE_1E6)
    clock.advance(1.0)
    assert not bench.overload()


def test_a_change_of_gain_settles(make_bench, clock):
    bench = make_bench()
    bench.amplifier.select(LOW_NOISE_1E7)
    assert bench.amplifier.effective_gain() == pytest.approx(1e6)
    clock.advance(0.02 * math.log(2.0))
    assert bench.amplifier.effective_gain() == pytest.approx(5.5e6)
    clock.advance(0.2)
    assert bench.amplifier.effective_gain() == 1e7


def test_gain_codes_of_the_amplifier():
    assert [gain_of_code(code) for code in (0, 6, 8, 10, 14)] == [1e5, 1e11, 1e3, 1e5, 1e9]


def test_output_clips_at_saturation():
    electronics = Electronics()
    assert output_voltage(1e-6, 1e6, electronics) == pytest.approx(1.0 + 2e-4)
    assert output_voltage(1.0, 1e6, electronics) == 10.0


def test_a_cancelled_burst_ends_early(facility, clock):
    cancelled = threading.Event()
    bench = Bench(facility, lambertian_flux, clock, 1)
    cancelled.set()
    assert bench.measure(9, 0.2, cancelled) == []
    bench.close()


def test_an_unknown_thing_cannot_be_mounted(make_bench):
    with pytest.raises(ValueError, match="expected 'reference' or 'sample'"):
        make_bench().mount("cat")  # type: ignore[arg-type]


def test_the_flux_of_the_target_is_computed_while_the_arm_moves(make_bench, clock):
    asked: list[tuple] = []
    computed = threading.Event()

    def flux(*geometry):
        asked.append(geometry)
        computed.set()
        return lambertian_flux(*geometry)

    bench = make_bench(flux=flux)
    bench.mount("sample")
    time.sleep(0.1)
    asked.clear()
    computed.clear()
    bench.axes["illumination_zenith"].move(30.0, 20.0, 10.0)
    bench.axes["sensor_zenith"].move(-45.0, 20.0, 10.0)
    assert computed.wait(5.0)
    clock.advance(30.0)
    bench.measure(9, 0.2)
    assert asked == [("sample", 30.0, -45.0, 0.0, 500.0)]


def test_readings_wait_for_a_computation_under_way_and_share_it():
    gate, calls = threading.Event(), []

    def slow(*geometry):
        calls.append(geometry)
        gate.wait(5.0)
        return 0.25

    ahead = FluxAhead(slow)
    geometry = Geometry("sample", 0.0, 10.0, 0.0, 500.0)
    results: list[float] = []
    threads = [threading.Thread(target=lambda: results.append(ahead.value(geometry))) for _ in range(4)]
    for thread in threads:
        thread.start()
    time.sleep(0.05)
    assert results == []
    gate.set()
    for thread in threads:
        thread.join(5.0)
    ahead.close()
    assert results == [0.25] * 4
    assert len(calls) == 1


def test_a_failed_computation_reaches_whoever_asks():
    def broken(*geometry):
        raise ArithmeticError("no light")

    ahead = FluxAhead(broken)
    ahead.expect(Geometry("sample", 0.0, 10.0, 0.0, 500.0))
    time.sleep(0.1)
    with pytest.raises(ArithmeticError, match="no light"):
        ahead.value(Geometry("sample", 0.0, 10.0, 0.0, 500.0))
    with pytest.raises(ArithmeticError, match="no light"):
        ahead.value(Geometry("sample", 0.0, 20.0, 0.0, 500.0))
    ahead.close()


class WallClock:
    """A wall clock in hand."""

    now = 100.0

    def __call__(self) -> float:
        return self.now


def test_the_watchdog_switches_the_emission_off_unless_it_is_fed():
    wall = WallClock()
    source = Source(wall=wall)
    source.reset_interlock()
    source.contact()
    source.watchdog = 5.0
    source.switch(True)
    for _ in range(4):
        wall.now += 4.9
        source.contact()
    assert source.emitting()
    wall.now += 5.1
    source.contact()  # too late: it has bitten
    assert not source.emitting()
    assert source.watchdog_trips == 1


def test_the_door_switches_the_emission_off_and_asks_for_a_reset():
    source = Source()
    source.reset_interlock()
    source.switch(True)
    source.open_interlock()
    assert not source.emitting()
    source.reset_interlock()
    assert not source.switch(True)
    source.close_interlock()
    assert not source.switch(True)
    source.reset_interlock()
    assert source.switch(True)

"""A wavelength that the filter cannot select is found before anything moves."""

from __future__ import annotations

from pathlib import Path

from fake_bench import Bench, FakeSelector
from scan_stage import plan_of, stage

from instrument.errors import InputError


class BoundedFilter(FakeSelector):
    """A filter that says what it reaches."""

    def __init__(self, lower: float, upper: float) -> None:
        super().__init__()
        self.reach = lower, upper

    def wavelength_range(self) -> tuple[float, float]:
        return self.reach


def bench_with(lower: float, upper: float) -> Bench:
    bench = Bench()
    bench.selector = BoundedFilter(lower, upper)
    return bench


def test_a_wavelength_outside_the_filter_ends_the_scan_before_anything_moves(tmp_path: Path) -> None:
    plan = plan_of()
    wavelength = plan.points[0].wavelength
    s = stage(tmp_path, plan, bench_with(wavelength + 0.5, 900.0))
    end = s.run()
    assert end.outcome == "faulted"
    assert isinstance(s.engine.error, InputError)
    assert f"found {wavelength:g} nm; the filter reaches {wavelength + 0.5:g} to 900 nm" in end.reason
    assert all(axis.commands == [] for axis in s.bench.axes.values())
    assert s.bench.selector.nm == 0.0


def test_a_wavelength_at_the_end_of_the_range_is_measured(tmp_path: Path) -> None:
    plan = plan_of()
    s = stage(tmp_path, plan, bench_with(plan.points[0].wavelength, 900.0))
    assert s.run().outcome == "finished"

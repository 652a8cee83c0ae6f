"""Readings over time: nothing that sticks out is lost, and ranges rest while values fit."""

from __future__ import annotations

import numpy as np
import pytest

from gui.traces import Trace, roomy


def test_a_long_curve_is_thinned_and_keeps_what_sticks_out() -> None:
    trace = Trace(2)
    values = np.sin(np.arange(5000) / 100)
    values[[1234, 4321]] = 9.0, -9.0
    for part in np.array_split(np.stack([np.arange(5000.0), values], axis=1), 7):
        trace.extend(map(tuple, part))
    x, y = trace.outline(1)
    assert len(x) == len(y) == 600
    assert np.all(np.diff(x) >= 0)
    assert (x[0], x[-1]) == (0.0, 4999.0)
    assert (y.max(), y.min()) == (9.0, -9.0)
    assert abs(x[np.argmax(y)] - 1234) < 17  # within its interval of 5000 / 300 rows
    found = trace.nearest(1233.6)
    assert found is not None
    assert found.tolist() == [1234.0, 9.0]


def test_a_short_curve_is_drawn_as_it_is_and_can_be_forgotten() -> None:
    trace = Trace(2)
    trace.extend([(0.0, 1.0), (1.0, 3.0)])
    trace.extend([])
    assert [each.tolist() for each in trace.outline(1)] == [[0.0, 1.0], [1.0, 3.0]]
    trace.clear()
    assert trace.nearest(0.0) is None
    assert len(trace.rows) == 0


def test_the_oldest_readings_are_forgotten_where_there_are_too_many() -> None:
    trace = Trace(1)
    for start in range(0, 50_000, 5_000):
        trace.extend((float(number),) for number in range(start, start + 5_000))
    kept = trace.rows[:, 0]
    assert len(kept) <= 20_000
    assert kept.tolist() == list(np.arange(50_000 - len(kept), 50_000.0))  # the newest, none missing
    assert len(kept) >= 5_000
    trace.extend((float(number),) for number in range(20_000))
    assert trace.rows[:, 0].tolist() == list(np.arange(20_000.0))


def test_a_range_rests_while_the_values_fit_and_follows_when_they_do_not() -> None:
    shown = roomy(0.0, 10.0, None, 0.1)
    assert shown == pytest.approx((-1.0, 11.0))
    assert roomy(0.0, 10.9, shown, 0.1) == shown
    assert roomy(0.0, 11.1, shown, 0.1) == pytest.approx((-1.11, 12.21))
    assert roomy(4.0, 6.0, shown, 0.1) == pytest.approx((3.8, 6.2))  # less than a third of what is shown
    assert roomy(7.0, 7.0, None, 0.5) == pytest.approx((6.7, 7.3))  # values that do not differ
    assert roomy(0.0, 10.0, None, 0.1, ahead=0.2) == pytest.approx((-1.0, 13.0))

"""What a person sees of a scan at a terminal."""

from __future__ import annotations

import io
from datetime import UTC, datetime

import pytest
from rich.console import Console

from instrument.events import Geometry, Message, PointAnnotated, PointMeasured, PointSkipped, ScanStarted
from instrument.scan_display import ScanDisplay, duration, point_line, score

NOW = datetime(2026, 1, 1, tzinfo=UTC)


def geometry(index: int) -> Geometry:
    return Geometry(wavelength=500.0, illumination_zenith=15.0, sensor_zenith=-5.0 * index, sensor_azimuth=75.0)


def measured(index: int, brf: float = 0.4, flag: int = 0) -> PointMeasured:
    return PointMeasured(
        time=NOW,
        index=index,
        geometry=geometry(index),
        brf=brf,
        u_brf=0.004,
        signal=(1.0,) * 9,
        dark=0.0,
        gain=1e6,
        quality_flag=flag,
        done=index + 1,
        total=20,
        time_left_s=100.0,
    )


def predicted(index: int, brf: float = 0.405) -> PointAnnotated:
    return PointAnnotated(time=NOW, index=index, source="twin", values={"brf": brf, "u_brf": 0.003})


class Screen:
    def __init__(self, predicted: bool = True) -> None:
        self.file = io.StringIO()
        self.display = ScanDisplay(Console(file=self.file, width=200), predicted=predicted)
        self.display.show(
            ScanStarted(
                time=NOW,
                run_dir="r",
                title="a plan",
                points=tuple(geometry(i) for i in range(20)),
                duration_s=7200.0,
                clock_speed=2.0,
            )
        )

    def lines(self) -> list[str]:
        return [line for line in self.file.getvalue().splitlines() if line.strip()]


def test_a_line_says_geometry_value_prediction_and_score() -> None:
    line = point_line(measured(3), {"brf": 0.405, "u_brf": 0.003}, 20)
    assert " ".join(line.split()) == (
        "4/20 500.0 nm ill +15.0 azimuth 75.0 zenith -15.0 BRF 0.4000 ± 0.0040 twin 0.4050 ± 0.0030 t' +1.00"
    )


def test_the_score_is_positive_where_the_prediction_lies_above() -> None:
    assert score(measured(0), {"brf": 0.405, "u_brf": 0.003}) == pytest.approx(1.0)
    assert score(measured(0), {"brf": 0.392}) == pytest.approx(-2.0)


def test_a_flag_is_shown() -> None:
    assert point_line(measured(0, flag=1), None, 20).endswith("flag 1")


def test_the_start_says_how_much_and_how_long() -> None:
    assert Screen().lines() == ["a plan: 20 points, about 1:00:00"]


def test_a_line_waits_for_its_prediction_and_keeps_its_place() -> None:
    screen = Screen()
    for event in (measured(0), measured(1), predicted(1)):
        screen.display.show(event)
    assert len(screen.lines()) == 1
    screen.display.show(predicted(0))
    assert [line.split("/")[0].strip() for line in screen.lines()[1:]] == ["1", "2"]
    assert all("t'" in line for line in screen.lines()[1:])


def test_a_prediction_that_came_first_is_used() -> None:
    screen = Screen()
    screen.display.show(predicted(0))
    screen.display.show(measured(0))
    assert "t' +1.00" in screen.lines()[-1]


def test_lines_do_not_wait_for_ever() -> None:
    screen = Screen()
    for index in range(12):
        screen.display.show(measured(index))
    assert len(screen.lines()) == 1 + 4
    screen.display.close()
    assert len(screen.lines()) == 1 + 12


def test_without_an_observer_a_line_comes_at_once() -> None:
    screen = Screen(predicted=False)
    screen.display.show(measured(0))
    assert "BRF  0.4000" in screen.lines()[-1]


def test_a_skipped_point_and_a_message_are_told_with_reason_and_advice() -> None:
    screen = Screen()
    screen.display.show(measured(0))
    screen.display.show(PointSkipped(time=NOW, index=1, geometry=geometry(1), reason="sensor_zenith: stalled"))
    screen.display.show(Message(time=NOW, level="error", text="the [twin] failed", advice="wait"))
    assert "not measured: sensor_zenith: stalled" in screen.lines()[-2]
    assert screen.lines()[-1] == "the [twin] failed (wait)"
    assert screen.lines()[1].startswith(" 1/20")


@pytest.mark.parametrize(
    ("seconds", "text"), [(0, "0:00"), (59.6, "1:00"), (3599, "59:59"), (7325, "2:02:05"), (-3, "0:00")]
)
def test_durations_read_like_a_clock(seconds: float, text: str) -> None:
    assert duration(seconds) == text

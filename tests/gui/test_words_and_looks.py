"""Plain language: every state has a name and advice, every number is written as a person writes it."""

from __future__ import annotations

import pytest

from gui import words
from gui.looks import LOOKS, actions
from gui.points import PlaneKey, Point
from gui.scores import Score
from instrument.events import Geometry
from instrument.states import FINAL, TRANSITIONS, State


@pytest.mark.parametrize("state", list(State))
def test_every_state_says_what_happens_and_what_to_do(state: State) -> None:
    look = LOOKS[state]
    assert look.title
    assert look.text.endswith(".")


def test_no_two_states_that_need_different_actions_look_the_same() -> None:
    seen: dict[tuple[str, str], State] = {}
    for state, look in LOOKS.items():
        other = seen.setdefault((look.title, look.sign), state)
        assert actions(state, True) == actions(other, True)


@pytest.mark.parametrize("state", list(State))
def test_halt_can_be_asked_for_in_every_state_in_which_something_runs(state: State) -> None:
    assert actions(state, connected=True).halt == (state not in FINAL)


@pytest.mark.parametrize("state", list(State))
def test_only_what_the_engine_allows_is_offered(state: State) -> None:
    offered = actions(state, connected=True)
    assert offered.pause == (State.PAUSING in TRANSITIONS[state])
    assert offered.abort == (State.ABORTING in TRANSITIONS[state])
    assert not offered.start


@pytest.mark.parametrize("state", list(State))
def test_without_a_session_only_a_start_is_offered(state: State) -> None:
    offered = actions(state, connected=False)
    assert not any((offered.pause, offered.resume, offered.abort, offered.halt))
    assert offered.start == (state is State.IDLE or state in FINAL)


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (-3, "0 s"),
        (0, "0 s"),
        (59.4, "59 s"),
        (61, "1 min 01 s"),
        (599, "9 min 59 s"),
        (600, "10 min"),
        (3599, "60 min"),
        (3600, "1 h 00 min"),
        (7500, "2 h 05 min"),
    ],
)
def test_durations_are_said_as_a_person_says_them(seconds: float, text: str) -> None:
    assert words.duration(seconds) == text


def test_numbers_have_a_true_minus_and_their_decimals() -> None:
    assert words.number(-0.12345) == "−0.1235"
    assert words.number(float("nan")) == "not a number"
    assert words.angle(-7.5) == "−7.5°"


@pytest.mark.parametrize(
    ("amperes", "text"), [(1.654233e-6, "1.654 µA"), (3.1e-8, "31.00 nA"), (-2e-11, "−20.00 pA"), (0.0, "0.000 pA")]
)
def test_currents_are_written_with_four_digits(amperes: float, text: str) -> None:
    assert words.current(amperes) == text


def test_a_plane_is_named_by_what_its_points_share() -> None:
    plane = PlaneKey(500.0, 15.0, 0.0, 50.0)
    assert words.plane_title(plane) == "500 nm, illumination zenith 15°, sensor azimuth 50°"
    assert "illumination azimuth 30°" in words.plane_title(plane._replace(illumination_azimuth=30.0))


def test_a_point_tells_all_that_is_known_of_it() -> None:
    geometry = Geometry(wavelength=500.0, illumination_zenith=0.0, sensor_zenith=-35.0, sensor_azimuth=0.0)
    point = Point(0, geometry, brf=0.3412, u_brf=0.0045, simulated=0.3398, u_simulated=0.0003)
    scored = words.point_values(Point(0, geometry, 0.3412, 0.0045, score=Score(-0.004, -0.31, "good")))
    assert words.point_values(point) == ("sensor zenith −35°   measured 0.3412 ± 0.0045   simulated 0.3398 ± 0.0003")
    assert "t′ −0.31 (good)" in scored
    assert "not measured: stalled" in words.point_values(Point(0, geometry, skipped="stalled"))

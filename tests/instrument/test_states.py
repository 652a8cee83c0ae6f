"""The table of states, and a machine that keeps to it whatever it is asked."""

from __future__ import annotations

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from instrument.states import EARLY_ENDS, FINAL, TRANSITIONS, IllegalTransition, State, StateMachine


def test_every_state_stands_in_the_table() -> None:
    assert set(TRANSITIONS) == set(State)


def test_every_state_can_be_reached_from_idle() -> None:
    reached, frontier = {State.IDLE}, [State.IDLE]
    while frontier:
        fresh = TRANSITIONS[frontier.pop()] - reached
        reached |= fresh
        frontier += fresh
    assert reached == set(State)


@pytest.mark.parametrize("state", sorted(FINAL))
def test_nothing_follows_a_final_state(state: State) -> None:
    assert TRANSITIONS[state] == frozenset()


@pytest.mark.parametrize("state", sorted(set(State) - FINAL - {State.ABORTING, State.FAULTING}))
def test_every_working_state_can_end_early(state: State) -> None:
    assert TRANSITIONS[state] >= EARLY_ENDS


def test_an_abort_that_goes_wrong_becomes_a_fault_but_no_fault_becomes_an_abort() -> None:
    assert State.FAULTING in TRANSITIONS[State.ABORTING]
    assert State.ABORTING not in TRANSITIONS[State.FAULTING]


def test_nothing_is_measured_before_homing_reference_and_movement() -> None:
    for state, targets in TRANSITIONS.items():
        if State.MEASURING in targets:
            assert state is State.MOVING
        if State.REFERENCING in targets:
            assert state in {State.MOUNTING, State.REFERENCING, State.PAUSED, State.SUSPENDED}


def test_a_watcher_that_fails_leaves_the_state_as_it_was() -> None:
    def full_disk(old: State, new: State, reason: str) -> None:
        raise OSError("no space left")

    later: list[State] = []
    machine = StateMachine(full_disk, lambda old, new, reason: later.append(new))
    with pytest.raises(OSError, match="no space"):
        machine.to(State.CONNECTING)
    assert machine.state is State.IDLE
    assert later == []


def test_the_error_names_what_would_be_allowed() -> None:
    with pytest.raises(IllegalTransition, match=r"from state idle to measuring; allowed: .*connecting"):
        StateMachine().to(State.MEASURING)


class AnyOrder(RuleBasedStateMachine):
    """Asks for any state at any time; the machine goes exactly where the table says, and tells of every step."""

    def __init__(self) -> None:
        super().__init__()
        self.told: list[tuple[State, State, str]] = []
        self.machine = StateMachine(lambda old, new, reason: self.told.append((old, new, reason)))
        self.expected = State.IDLE

    @rule(new=st.sampled_from(State), reason=st.text(max_size=5))
    def ask_for_any(self, new: State, reason: str) -> None:
        before = len(self.told)
        if new in TRANSITIONS[self.expected]:
            self.machine.to(new, reason)
            assert self.told[-1] == (self.expected, new, reason)
            self.expected = new
        else:
            with pytest.raises(IllegalTransition):
                self.machine.to(new, reason)
            assert len(self.told) == before

    @precondition(lambda self: TRANSITIONS[self.expected])
    @rule(data=st.data())
    def go_on(self, data: st.DataObject) -> None:
        new = data.draw(st.sampled_from(sorted(TRANSITIONS[self.expected])))
        self.machine.to(new)
        self.expected = new

    @invariant()
    def the_told_steps_join(self) -> None:
        assert self.machine.state is self.expected
        assert self.machine.ended == (self.expected in FINAL)
        steps = [State.IDLE, *(new for _, new, _ in self.told)]
        assert [old for old, _, _ in self.told] == steps[:-1]


TestAnyOrder = AnyOrder.TestCase
TestAnyOrder.settings = settings(max_examples=25, stateful_step_count=30, deadline=None)

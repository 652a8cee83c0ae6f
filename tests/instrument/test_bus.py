"""Events reach every listener in one order, and no listener can hold up the publisher."""

from __future__ import annotations

import threading
import time
from datetime import UTC, datetime

from instrument.bus import EventBus
from instrument.events import Event, Message, PointAnnotated, ScanStarted, StateChanged


def message(text: str) -> Message:
    return Message(time=datetime.now(UTC), level="info", text=text)


def annotation(index: int) -> PointAnnotated:
    return PointAnnotated(time=datetime.now(UTC), index=index, source="twin", values={"brf": 0.5})


def test_every_listener_sees_everything_in_one_order() -> None:
    bus, seen = EventBus(), ([], [])
    for listener in seen:
        bus.subscribe(listener.append)
    threads = [
        threading.Thread(target=lambda n=n: [bus.publish(message(f"{n}-{i}")) for i in range(200)]) for n in range(4)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert bus.drain(10.0)
    assert seen[0] == seen[1] == list(bus.history)
    assert len(bus.history) == 800
    bus.close()


def test_a_late_listener_catches_up_before_it_goes_on() -> None:
    bus, seen = EventBus(), []
    bus.publish(message("early"))
    bus.subscribe(seen.append)
    bus.publish(message("late"))
    assert bus.drain()
    assert [event.text for event in seen] == ["early", "late"]
    only_new: list[Event] = []
    bus.subscribe(only_new.append, replay=False)
    bus.publish(message("now"))
    assert bus.drain()
    assert [event.text for event in only_new] == ["now"]
    bus.close()


def test_a_slow_listener_does_not_hold_up_the_publisher() -> None:
    bus, gate, seen = EventBus(), threading.Event(), []
    bus.subscribe(lambda event: gate.wait(10.0), "slow")
    bus.subscribe(seen.append, "quick")
    for i in range(100):
        bus.publish(message(str(i)))
    assert not bus.drain(0.05)  # the slow one still waits: nobody waited for it
    gate.set()
    assert bus.drain(10.0)
    assert len(seen) == 100
    bus.close()


def test_a_failing_listener_is_reported_once_and_detached() -> None:
    bus, seen, calls = EventBus(), [], []

    def fail(event: Event) -> None:
        calls.append(event)
        raise ValueError("no twin today")

    subscription = bus.subscribe(fail, "the twin")
    bus.subscribe(seen.append)
    bus.publish(message("one"))
    bus.publish(message("two"))
    assert bus.drain(10.0)
    while len(seen) < 3:
        time.sleep(0.005)
    bus.publish(message("three"))
    assert bus.drain(10.0)
    assert len(calls) == 1
    assert isinstance(subscription.failure, ValueError)
    reports = [event for event in seen if isinstance(event, Message) and event.level == "error"]
    assert len(reports) == 1
    assert "the twin failed" in reports[0].text
    assert "no twin today" in reports[0].text
    bus.close()


def test_what_a_listener_publishes_reaches_all_and_itself() -> None:
    bus, seen, own = EventBus(), [], []

    def twin(event: Event) -> None:
        own.append(event)
        if isinstance(event, StateChanged):
            bus.publish(annotation(7))

    bus.subscribe(twin, "twin")
    bus.subscribe(seen.append)
    bus.publish(StateChanged(time=datetime.now(UTC), old="idle", new="connecting"))
    assert bus.drain(10.0)
    assert [event.kind for event in seen] == ["state_changed", "point_annotated"]
    assert own == seen
    assert bus.latest(PointAnnotated) == seen[1]
    assert bus.latest(Message) is None
    bus.close()


def test_an_unsubscribed_listener_finishes_what_it_has_and_gets_nothing_more() -> None:
    bus, seen = EventBus(), []
    subscription = bus.subscribe(lambda event: (time.sleep(0.01), seen.append(event)))
    for i in range(5):
        bus.publish(message(str(i)))
    assert bus.unsubscribe(subscription)
    bus.publish(message("after"))
    assert [event.text for event in seen] == ["0", "1", "2", "3", "4"]


def test_closing_names_who_does_not_return() -> None:
    bus, gate = EventBus(), threading.Event()
    bus.subscribe(lambda event: gate.wait(10.0), "stuck")
    bus.publish(message("x"))
    assert bus.close(timeout=0.05) == ("stuck",)
    gate.set()


def test_a_long_scan_is_replayed_in_part_and_says_so() -> None:
    bus = EventBus(kept=10)
    started = ScanStarted(time=datetime.now(UTC), run_dir="run", title="long", points=(), duration_s=0.0)
    bus.publish(started)
    for index in range(50):
        bus.publish(annotation(index))
    late: list[Event] = []
    bus.subscribe(late.append)
    assert bus.drain(10.0)
    assert late[0] == started
    assert isinstance(late[1], Message)
    assert "41 earlier events are left out" in late[1].text
    assert [event.index for event in late[2:]] == list(range(40, 50))  # type: ignore[union-attr]
    assert bus.latest(ScanStarted) == started
    assert len(bus.history) == 10
    bus.close()

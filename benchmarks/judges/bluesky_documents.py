"""event-model on the documents of a run: its JSON schemas, its router, its packing into pages."""

from __future__ import annotations

import json
import sys
from collections import Counter
from typing import Any

import event_model
from protocol import Judge


class Counted(event_model.DocumentRouter):
    """What a consumer of documents is made of."""

    def __init__(self) -> None:
        super().__init__()
        self.found: Counter[str] = Counter()

    def start(self, doc: dict[str, Any]) -> dict[str, Any]:
        self.found["start"] += 1
        return doc

    def descriptor(self, doc: dict[str, Any]) -> dict[str, Any]:
        self.found["descriptor"] += 1
        return doc

    def event(self, doc: dict[str, Any]) -> dict[str, Any]:
        self.found["event"] += 1
        return doc

    def stop(self, doc: dict[str, Any]) -> dict[str, Any]:
        self.found["stop"] += 1
        return doc


def main() -> None:
    judge = Judge("event-model", "reads the documents of a run")
    with open(sys.argv[2], encoding="utf-8") as file:
        found = [json.loads(line) for line in file]
    trial(judge, found)
    judge.done()


def trial(judge: Judge, found: list[tuple[str, dict[str, Any]]]) -> None:
    for name in ("start", "descriptor", "event", "stop"):
        validator = event_model.schema_validators[event_model.DocumentNames[name]]
        of_name = [document for kind, document in found if kind == name]
        judge.check(
            f"every {name} against its schema",
            lambda validator=validator, of_name=of_name: [
                error.message for document in of_name for error in validator.iter_errors(document)
            ],
            lambda errors, of_name=of_name: errors == [] and len(of_name) > 0,
        )
    counted = Counted()
    judge.check(
        "its router takes them all",
        lambda: [counted(name, document) for name, document in found] and dict(counted.found),
        lambda counts: counts == dict(Counter(name for name, _ in found)),
    )
    stop = found[-1][1]
    streams = {d["uid"]: d["name"] for kind, d in found if kind == "descriptor"}
    events = Counter(streams[d["descriptor"]] for kind, d in found if kind == "event")
    judge.check("events of each stream", lambda: stop["num_events"], lambda said: said == dict(events))
    primary = [d for kind, d in found if kind == "event" and streams[d["descriptor"]] == "primary"]
    judge.check(
        "packed into a page and unpacked",
        lambda: list(event_model.unpack_event_page(event_model.pack_event_page(*primary))),
        lambda again: [event["data"] for event in again] == [event["data"] for event in primary],
    )


if __name__ == "__main__":
    main()

"""A run as documents of Bluesky's event model: complete, linked, the same for a running and a finished one."""

import json
from collections import Counter
from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from example_runs import START, four_points, geometry, header, reading, references, status

from instrument.dataset import rebuild_run
from instrument.errors import InputError
from instrument.exchange.documents import Document
from instrument.exchange.following import documents, followed
from instrument.journal import JOURNAL_NAME, Journal

#: Required keys of event-model's JSON schemas; ``filled`` and the rest are optional.
REQUIRED = {
    "start": {"uid", "time"},
    "descriptor": {"uid", "time", "run_start", "data_keys"},
    "event": {"uid", "time", "descriptor", "seq_num", "data", "timestamps"},
    "stop": {"uid", "time", "run_start", "exit_status"},
}
DTYPES = {"string": str, "number": float, "integer": int, "array": list, "boolean": bool}


def end(journal: Journal, outcome: str = "finished", reason: str = "") -> None:
    time = START + timedelta(minutes=9)
    journal.record("state", time=time, old="point", new=outcome, reason=reason)
    journal.record("ended", time=time, outcome=outcome, reason=reason, measured=4, skipped=0, not_reached=0)


@pytest.fixture
def run(tmp_path: Path) -> Path:
    folder = four_points(tmp_path / "run", record={"sample": "plate 3"})
    with Journal.reopen(folder) as journal:
        end(journal)
    return folder


def of(name: str, found: list[Document]) -> list[dict[str, Any]]:
    return [document for kind, document in found if kind == name]


def check_linked(found: list[Document]) -> None:
    """What the model asks for: keys, links, counts, values of the kind that the descriptor states."""
    start = found[0][1]
    assert [kind for kind, _ in found].count("start") == 1
    descriptors: dict[str, dict[str, Any]] = {}
    counts: Counter[str] = Counter()
    for kind, document in found:
        assert REQUIRED[kind] <= set(document), kind
        if kind == "descriptor":
            descriptors[document["uid"]] = document
        if kind in ("descriptor", "stop"):
            assert document["run_start"] == start["uid"]
        if kind == "event":
            keys = descriptors[document["descriptor"]]["data_keys"]
            stream = descriptors[document["descriptor"]]["name"]
            counts[stream] += 1
            assert document["seq_num"] == counts[stream]
            assert set(document["data"]) == set(document["timestamps"]) == set(keys)
            for name, value in document["data"].items():
                assert type(value) is DTYPES[keys[name]["dtype"]], name
                assert list(np.shape(value)) == keys[name]["shape"]
        if kind == "stop":
            assert document["num_events"] == counts
    uids = [document["uid"] for _, document in found]
    assert len(set(uids)) == len(uids)


def test_a_finished_run_gives_linked_documents_with_units_and_values(run: Path) -> None:
    found = json.loads(json.dumps(list(documents(run)), allow_nan=False))
    check_linked(found)
    start, stop = of("start", found)[0], of("stop", found)[0]
    assert (start["sample"], start["num_points"]) == ("plate 3", 4)
    assert start["time"] == START.timestamp()
    assert (stop["exit_status"], stop["time"]) == ("success", (START + timedelta(minutes=9)).timestamp())
    assert stop["num_events"] == {"reference": 4, "primary": 4, "state": 1, "result": 4}
    primary = next(d for d in of("descriptor", found) if d["name"] == "primary")
    units = {name: key.get("units") for name, key in primary["data_keys"].items()}
    assert (units["signal"], units["gain"], units["sensor_zenith"], units["wavelength"]) == (
        "V",
        "V A-1",
        "degree",
        "nm",
    )
    assert (units["readback_sensor_zenith"], units["environment_temperature"]) == ("degree", "degC")
    assert primary["data_keys"]["signal"]["shape"] == [9]


def test_the_results_are_those_of_the_run_file(run: Path) -> None:
    found = list(documents(run))
    place = {d["uid"]: d["name"] for d in of("descriptor", found)}
    results = [event["data"] for event in of("event", found) if place[event["descriptor"]] == "result"]
    expected = rebuild_run(run)
    for name in ("brf", "u_brf", "u_brf_reference"):
        assert [result[name] for result in results] == expected[name].values.tolist()
    assert [result["index"] for result in results] == [0, 1, 2, 3]


def test_a_run_that_is_followed_gives_the_documents_of_the_finished_one(tmp_path: Path) -> None:
    """Line by line, and once with half a line on the disk."""
    whole = four_points(tmp_path / "whole")
    with Journal.reopen(whole) as journal:
        end(journal)
    lines = (whole / JOURNAL_NAME).read_bytes().splitlines(keepends=True)
    running = tmp_path / "running"
    running.mkdir()
    path = running / JOURNAL_NAME
    path.write_bytes(lines[0])
    pieces = [lines[1], lines[2] + lines[3][:40], lines[3][40:], *lines[4:]]
    waits, expected = 0, list(documents(whole))

    def write_more(seconds: float) -> None:
        nonlocal waits
        waits += 1
        with path.open("ab") as handle:
            handle.write(pieces.pop(0))

    found = []
    for document in followed(running, wait=write_more):
        found.append(document)
        # What was told so far is the beginning of what the finished run tells.
        assert document == expected[len(found) - 1]
    assert len(found) == len(expected)
    check_linked(found)
    assert waits == len(lines) - 1


def test_a_run_that_has_not_ended_has_no_stop_and_one_that_went_on_has_one(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    with Journal.create(folder, header()) as journal:
        references(journal)
        journal.record("point", index=0, **reading(geometry(60.0), 0.3, 60.0))
        assert of("stop", list(documents(folder))) == []
        end(journal, "aborted", "asked by a person")
        stop = of("stop", list(documents(folder)))[0]
        assert (stop["exit_status"], stop["reason"]) == ("abort", "asked by a person")
        journal.record("point", index=1, **reading(geometry(30.0), 0.4, 80.0))
        assert of("stop", list(documents(folder))) == []
        end(journal, "faulted")
    found = list(documents(folder))
    check_linked(found)
    assert [stop["exit_status"] for stop in of("stop", found)] == ["fail"]


def test_points_that_say_more_than_those_before_get_a_descriptor_of_their_own(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    with Journal.create(folder, header()) as journal:
        journal.record("point", index=0, **reading(geometry(60.0), 0.3, 60.0))
        more = {"environment": {"air.pressure/hPa": (1013.0, "hPa")}, "source_power": 0.5}
        journal.record("point", index=1, **reading(geometry(30.0), 0.4, 80.0), **more)
        journal.record("skipped", index=2, geometry=geometry(-30.0), time=START, reason="stage stuck")
    found = list(documents(folder))
    check_linked(found)
    names = [set(d["data_keys"]) for d in of("descriptor", found) if d["name"] == "primary"]
    assert names[1] - names[0] == {"environment_air_pressure_hPa", "source_power"}
    assert of("event", found)[-1]["data"]["reason"] == "stage stuck"


def test_a_journal_that_was_changed_or_is_none_is_named(run: Path, tmp_path: Path) -> None:
    journal = run / JOURNAL_NAME
    good = journal.read_bytes()
    journal.write_bytes(good.replace(b'"gain":1000000.0', b'"gain":1000001.0', 1))
    with pytest.raises(InputError, match="line 2: the line, or one before it, was changed"):
        list(documents(run))
    journal.write_bytes(good.replace(b'"version":1', b'"version":2', 1))
    with pytest.raises(InputError, match="journal version 2; this program reads version 1"):
        list(documents(run))
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="no such file; expected the journal of a run"):
        list(documents(tmp_path / "empty"))

    def cut(seconds: float) -> None:
        journal.write_bytes(good[:100])

    journal.write_bytes(good[: good.index(b"\n") + 1])
    with pytest.raises(InputError, match="has become shorter"):
        list(followed(run, wait=cut))


def test_the_command_writes_a_line_a_document(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "run.jsonl"
    assert status("exchange", "documents", run, out) == 0
    lines = [json.loads(line) for line in out.read_text().splitlines()]
    assert [line[0] for line in (lines[0], lines[-1])] == ["start", "stop"]
    assert status("exchange", "documents", run, out) == 2
    assert "exists already" in capsys.readouterr().err
    assert status("exchange", "documents", run, "--follow") == 0
    assert [json.loads(line) for line in capsys.readouterr().out.splitlines()] == lines

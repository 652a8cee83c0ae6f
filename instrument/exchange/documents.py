"""A run as documents of Bluesky's event model: start, descriptor, event, stop; finished, or while it is measured.

Every document is made of one line of the journal, in the order of its lines, and its names (uids) of the digests of the
journal's chain: a run that is followed while it is measured gives the same documents as the finished one, and the same
run gives them every time. Streams: ``reference`` and ``primary`` (the points) with what was read; ``skipped`` and
``state``; and, when the run has ended, ``result`` with the reflectance factors, which only the whole run can give.
Source of the forms: event-model 1.24, JSON schemas ``run_start``, ``event_descriptor``, ``event``, ``run_stop``.
"""

from __future__ import annotations

import json
import uuid
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from typing import Any

import numpy as np
import xarray as xr

from instrument.run_check import component_names
from instrument.run_schema import RUN

Document = tuple[str, dict[str, Any]]
_OUTCOMES = {"finished": "success", "aborted": "abort", "halted": "abort", "faulted": "fail"}
_GEOMETRY_UNITS = {"wavelength": "nm", "repetition": "", "polarization": ""}
_NAMESPACE = uuid.uuid5(uuid.NAMESPACE_OID, "goniotwin documents")
#: What a plot or a table of somebody else's program shows first, by stream.
_HINTS = {
    "primary": ["signal_mean"],
    "reference": ["signal_mean"],
    "result": ["brf", "u_brf"],
    "skipped": ["reason"],
    "state": ["new"],
}
#: What a run file has along its points that goes into ``result``.
_RESULT = ("brf", "u_brf", "quality_flag")


class Documents:
    """Turns the lines of one journal into documents, one after the other."""

    def __init__(self) -> None:
        self._start = ""
        self._descriptors: dict[str, tuple[tuple[str, ...], str]] = {}
        self._counts: dict[str, int] = {}
        self._chain = ""
        self.ended = False

    def line(self, record: Mapping[str, Any], chain: str) -> Iterator[Document]:
        """Documents of a record of the journal; none for kinds that have no place in the model.

        Parameters
        ----------
        record
            As read, without its ``chain``.
        chain
            Digest of the line.
        """
        self._chain = chain
        kind = record["kind"]
        if kind == "header":
            yield self._started(record)
        elif kind in ("point", "reference"):
            yield from self._event("primary" if kind == "point" else kind, record["time"], *_reading(record))
        elif kind == "skipped":
            data = _geometry(record["geometry"])
            values = {"index": (record["index"], ""), "reason": (record["reason"], "")} | data
            yield from self._event(kind, record["time"], values, "journal")
        elif kind == "state":
            values = {name: (record.get(name, ""), "") for name in ("old", "new", "reason")}
            yield from self._event(kind, record["time"], values, "journal")
        elif kind == "ended":
            self.ended = True

    def result(self, run: xr.Dataset) -> Iterator[Document]:
        """Documents of the reflectance factors that the whole run gives; before :meth:`stop`."""
        names = [*_RESULT, *component_names(run)]
        for point in range(run.sizes["point"]):
            time = f"{np.datetime_as_string(run['time'].values[point], unit='us')}Z"
            values = {"index": (int(run["plan_index"].values[point]), "")}
            for name in names:
                known = run[name].values[point]
                unit = RUN[name].unit if name in RUN else "1"
                values[name] = (known.item(), unit or "")
            yield from self._event("result", time, values, "run.nc", salt=str(point))

    def stop(self, ended: Mapping[str, Any]) -> Document:
        """The last document, of the journal's record ``ended``."""
        outcome = str(ended.get("outcome", ""))
        return "stop", {
            "uid": self._uid("stop"),
            "time": _seconds(ended["time"]),
            "run_start": self._start,
            "exit_status": _OUTCOMES.get(outcome, "fail"),
            "reason": str(ended.get("reason", "")) or outcome,
            "num_events": dict(self._counts),
        }

    def _uid(self, what: str) -> str:
        return str(uuid.uuid5(_NAMESPACE, f"{self._chain}:{what}"))

    def _started(self, header: Mapping[str, Any]) -> Document:
        self._start = self._uid("start")
        said = {name: text for name, text in header.get("record", {}).items() if text}
        document: dict[str, Any] = {
            "uid": self._start,
            "time": _seconds(header["created"]),
            "plan_name": "goniotwin scan",
            "title": header.get("title", ""),
            "plan": header["plan"],
            "facility": header["facility"],
            "num_points": header["points"],
            "scan_direction": header["scan_direction"],
            "software_version": header["software_version"],
            "hints": {"dimensions": [[["sensor_zenith"], "primary"]]},
        }
        return "start", document | said

    def _event(
        self, stream: str, time: str, values: Mapping[str, tuple[Any, str]], source: str, *, salt: str = ""
    ) -> Iterator[Document]:
        """An event, before it the descriptor of its stream where the quantities are not those of the last one."""
        form = tuple(f"{name}:{np.shape(value)}" for name, (value, _) in values.items())
        if self._descriptors.get(stream, ((), ""))[0] != form:
            uid = self._uid(f"descriptor {stream}{salt}")
            self._descriptors[stream] = (form, uid)
            keys = {name: _data_key(value, unit, source) for name, (value, unit) in values.items()}
            yield (
                "descriptor",
                {
                    "uid": uid,
                    "time": _seconds(time),
                    "run_start": self._start,
                    "name": stream,
                    "data_keys": keys,
                    "object_keys": {"goniotwin": list(keys)},
                    "hints": {"goniotwin": {"fields": _HINTS[stream]}},
                    "configuration": {"goniotwin": {"data": {}, "timestamps": {}, "data_keys": {}}},
                },
            )
        self._counts[stream] = self._counts.get(stream, 0) + 1
        stamp = _seconds(time)
        yield (
            "event",
            {
                "uid": self._uid(f"event {stream}{salt}"),
                "time": stamp,
                "descriptor": self._descriptors[stream][1],
                "seq_num": self._counts[stream],
                "data": {name: value for name, (value, _) in values.items()},
                "timestamps": dict.fromkeys(values, stamp),
                "filled": {},
            },
        )


def _reading(record: Mapping[str, Any]) -> tuple[dict[str, tuple[Any, str]], str]:
    """Quantities of a point or of a reading of the reference: value and unit by name."""
    signal = list(record["signal"])
    values: dict[str, tuple[Any, str]] = {"index": (record["index"], "")} | _geometry(record["geometry"])
    values |= {
        "signal": (signal, "V"),
        "signal_mean": (float(np.mean(signal)), "V"),
        "dark": (record["dark"], "V"),
        "gain": (record["gain"], "V A-1"),
        "quality_flag": (record.get("quality_flag", 0), ""),
    }
    values |= {f"readback_{axis}": (angle, "degree") for axis, angle in record.get("readback", {}).items()}
    if record.get("source_power") is not None:
        values["source_power"] = (record["source_power"], "")
    if record.get("wavelength_readback") is not None:
        values["wavelength_readback"] = (record["wavelength_readback"], "nm")
    for name, (value, unit) in record.get("environment", {}).items():
        values[f"environment_{name}"] = (value, unit)
    # Neither a point nor a stroke may stand in the name of a quantity.
    return {name.replace(".", "_").replace("/", "_"): entry for name, entry in values.items()}, "journal"


def _geometry(geometry: Mapping[str, Any]) -> dict[str, tuple[Any, str]]:
    return {name: (value, _GEOMETRY_UNITS.get(name, "degree")) for name, value in geometry.items()}


def _data_key(value: Any, unit: str, source: str) -> dict[str, Any]:
    """What kind a quantity is of, in the words of the model."""
    kinds = {bool: "boolean", int: "integer", float: "number", str: "string", list: "array"}
    key: dict[str, Any] = {"source": source, "dtype": kinds[type(value)], "shape": list(np.shape(value))}
    return key | ({"units": unit} if unit else {})


def _seconds(time: str) -> float:
    moment = datetime.fromisoformat(time)
    return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()


def to_line(document: Document) -> str:
    """One line, as Bluesky's own writer of JSON lines has it: a list of name and document."""
    return json.dumps(document, allow_nan=False)

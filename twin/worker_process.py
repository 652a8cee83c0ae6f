"""The process in which ray tracing happens: ``python -m twin.worker_process``.

It reads requests from standard input and answers on standard output, one JSON object a line; the client is
:mod:`twin.worker`. First comes ``{"open": {...}}`` with the paths, answered by ``{"ready": {...}}`` or
``{"failed": ...}``; then any number of ``{"id", "geometries", "standard_error", "samples", "seed"}``, each answered by
``{"id", "brf", "u_brf", "u_brf_monte_carlo", "attributes"}`` or ``{"id", "failed": ...}``, or of
``{"id", "uncertainty": geometries}``, answered by ``{"id", "u_brf_inputs", "contains", "notes"}``. When standard input
ends, because the client closed it or died, the process ends at once, in the middle of a computation too.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import queue
import signal
import sys
import threading
import traceback
from pathlib import Path
from typing import Any, BinaryIO

Json = dict[str, Any]


def main() -> None:
    """Serve requests until standard input ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the client's business: it decides when to stop
    channel = _claim_standard_output()
    requests: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    threading.Thread(target=_read_requests, args=(requests,), name="requests", daemon=True).start()
    settings = json.loads(requests.get())["open"]
    _lower_priority(settings["niceness"])
    twin = _open(settings, channel)
    while twin is not None:
        _reply(channel, _answer(twin, json.loads(requests.get())))


def _claim_standard_output() -> BinaryIO:
    """Keep the pipe for replies and send everything else that is printed, by native libraries too, to standard
    error: one stray line would break the protocol."""
    channel = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    return channel


def _read_requests(requests: queue.SimpleQueue[bytes]) -> None:
    for line in sys.stdin.buffer:
        requests.put(line)
    os._exit(0)  # the client is gone: nobody waits for the computation, and its threads cannot be asked to stop


def _lower_priority(niceness: int) -> None:
    if niceness and hasattr(os, "nice"):
        os.nice(niceness)


def _limit_threads(threads: int) -> None:
    """Leave cores to the scan. Dr.Jit is imported by the twin, after it has chosen an LLVM library."""
    if "drjit" in sys.modules:
        sys.modules["drjit"].set_thread_count(threads)


def _open(settings: Json, channel: BinaryIO) -> Any:
    """Build the twin; None if that failed, which the client then knows."""
    try:
        module, _, attribute = settings["factory"].partition(":")
        factory: Any = importlib.import_module(module)
        for part in attribute.split("."):
            factory = getattr(factory, part)
        twin = factory(Path(settings["facility"]), Path(settings["artifact"]), Path(settings["material"]))
        _limit_threads(settings["threads"])
    except Exception as error:  # noqa: BLE001 (the client reports it; there is nobody else to tell)
        _reply(channel, _failure(error))
        return None
    _reply(channel, {"ready": {"pid": os.getpid()}})
    return twin


def _answer(twin: Any, request: Json) -> Json:
    try:
        from instrument.events import Geometry

        if "uncertainty" in request:
            known = twin.uncertainty([Geometry.model_validate(geometry) for geometry in request["uncertainty"]])
            answer = {"u_brf_inputs": known.u.tolist(), "contains": known.contains, "notes": list(known.notes)}
            return {"id": request["id"], **answer}
        geometries = [Geometry.model_validate(geometry) for geometry in request["geometries"]]
        wanted = {name: request[name] for name in ("standard_error", "samples", "seed")}
        result = twin.predict(geometries, **wanted)
        columns = {name: result[name].values.tolist() for name in ("brf", "u_brf", "u_brf_monte_carlo")}
        return {"id": request["id"], **columns, "attributes": _plain(result.attrs)}
    except Exception as error:  # noqa: BLE001 (one bad request must not end the process; the client reports it)
        return {"id": request["id"], **_failure(error)}


def _failure(error: Exception) -> Json:
    from instrument.errors import InputError

    traceback.print_exc(file=sys.stderr)
    text = str(error) if isinstance(error, InputError) else f"{type(error).__name__}: {error}"
    return {"failed": text, "bad_input": isinstance(error, InputError)}


def _plain(attributes: Json) -> Json:
    """Attributes of a dataset as JSON can hold them."""
    return {name: value.tolist() if hasattr(value, "tolist") else value for name, value in attributes.items()}


def _reply(channel: BinaryIO, message: Json) -> None:
    # A closed pipe means that the client is gone; the reading thread ends the process then.
    with contextlib.suppress(BrokenPipeError):
        channel.write(json.dumps(message).encode() + b"\n")
        channel.flush()


if __name__ == "__main__":
    main()

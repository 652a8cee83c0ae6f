"""Process of the simulated laboratory: ``python -m sim_fixtures.serve --folder DIR ...``.

Prints one line of JSON once every device answers: ``{"ports": {...}, "meter": PORT, ... "control": PORT}``. Ends when
its standard input is closed or its parent has gone, so that it never outlives the program that started it.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import sys
import threading
from pathlib import Path

from instrument.artifact import read_artifact
from instrument.facility import Facility, read_facility
from sim_fixtures.bench import Bench, BenchClock, FluxFunction, lambertian_flux
from sim_fixtures.control import ControlServer
from sim_fixtures.room import Room

#: Wall-clock seconds between looks at the parent.
_WATCH = 0.5


def main(arguments: list[str] | None = None) -> None:
    """Serve until told to end."""
    options = _parser().parse_args(arguments)
    parent, ended = os.getppid(), threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: ended.set())
    threading.Thread(target=_wait_for_end_of_input, args=(ended,), daemon=True).start()
    facility = read_facility(options.facility)
    flux = flux_function(options.flux, facility, options.artifact, options.seed)
    bench = Bench(facility, flux, BenchClock(options.speed), options.seed)
    room = Room(bench, options.folder)
    control = ControlServer(room)
    endpoints = room.endpoints
    ports = {name: str(path) for name, path in endpoints.ports.items()}
    meters = {"meter": endpoints.meter, "monitor": endpoints.monitor}
    print(json.dumps({"ports": ports, **meters, "control": control.port}), flush=True)
    while not ended.wait(_WATCH) and os.getppid() == parent:
        pass
    control.close()
    room.close()


def flux_function(kind: str, facility: Facility, artifact: Path, seed: int) -> FluxFunction:
    """What the detector sees: ``reality`` of the artifact, or a plain Lambertian sample (``lambertian``)."""
    if kind == "lambertian":
        return lambertian_flux
    from sim_fixtures.reality import Imperfections, Reality

    reality = Reality(facility, read_artifact(artifact), Imperfections.within_budget(facility, seed), seed)
    # A fresh machine compiles the model here rather than while a meter's reply is due.
    for mounted in ("reference", "sample"):
        reality.flux(mounted, facility.reference.illumination_zenith, facility.reference.sensor_zenith, 0.0)
    return reality.flux


def _wait_for_end_of_input(ended: threading.Event) -> None:
    while os.read(sys.stdin.fileno(), 1024):
        pass
    ended.set()


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m sim_fixtures.serve", description=__doc__)
    parser.add_argument("--folder", type=Path, required=True, help="receives the names of the serial lines")
    parser.add_argument("--facility", type=Path, required=True)
    parser.add_argument("--artifact", type=Path, required=True)
    parser.add_argument("--speed", type=float, default=1.0, help="laboratory seconds a wall-clock second")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--flux", choices=("reality", "lambertian"), default="reality")
    return parser


if __name__ == "__main__":
    main()

"""The laboratory called ``simulated`` (entry-point group ``goniotwin.laboratories``)."""

from __future__ import annotations

import json
import select
import subprocess
import sys
import time
from pathlib import Path
from types import TracebackType
from typing import Any

from instrument.artifact import read_artifact
from instrument.errors import InputError
from instrument.facility import read_facility
from instrument.laboratories import Inputs
from instrument.operators import Mounted
from instrument.prompts import Prompt
from sim_fixtures.connections import add_monitor, write_alternative, write_devices
from sim_fixtures.control import ControlClient

#: Wall-clock seconds within which the process must answer; a first start compiles the optical model.
START_TIMEOUT = 600.0
_LOG = "laboratory.log"


class SimulatedOperator:
    """Hands of the simulated laboratory: changes the sample at once, and answers prompts with what is usual."""

    def __init__(self, control: ControlClient) -> None:
        self._control = control

    def mount(self, what: Mounted) -> None:
        """Put the reference or the sample on the stage."""
        self._control("mount", what=what)

    def reply(self, prompt: Prompt) -> float | str | None:
        """Do what a prompt asks for; numbers are the middle of what makes sense, choices the first."""
        about, _, what = prompt.key.partition(":")
        if about == "mount":
            self._control("mount", what=what)
        elif about == "turn":
            self._control("turn", azimuth=float(what))
        elif about == "apertures":
            self._control("apertures", a="a" in what, b="b" in what)
        if prompt.kind == "choice":
            return prompt.choices[0]
        if prompt.kind == "number":
            return ((prompt.lower or 0.0) + (prompt.upper or 0.0)) / 2
        return None


class SimulatedLaboratory:
    """A running laboratory; made by :func:`start_simulated`. A context manager that ends it.

    Attributes
    ----------
    inputs
        Files of the laboratory; ``inputs.devices`` says how to connect.
    operator
        Changes the sample.
    endpoints
        Pseudo-terminal of each line, and the TCP port of the meter and of the control channel.
    """

    def __init__(self, inputs: Inputs, process: subprocess.Popen[bytes], endpoints: dict[str, Any]) -> None:
        self.inputs, self.endpoints = inputs, endpoints
        self._process = process
        self._client = ControlClient(endpoints["control"])
        self.operator = SimulatedOperator(self._client)

    @property
    def pid(self) -> int:
        """Process that serves the devices."""
        return self._process.pid

    def control(self, action: str, **arguments: Any) -> Any:
        """Act on the room (see :class:`sim_fixtures.room.Room`): ``state``, ``stall``, ``drop_replies`` ...

        Raises
        ------
        ValueError
            If there is no such action, or an argument is wrong.
        """
        return self._client(action, **arguments)

    def close(self) -> None:
        """End the process. May be repeated."""
        self._client.close()
        end_process(self._process)

    def __enter__(self) -> SimulatedLaboratory:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def start_simulated(
    folder: Path,
    *,
    speed: float = 1.0,
    seed: int = 1,
    artifact: Path | None = None,
    facility: Path | None = None,
    flux: str = "reality",
) -> SimulatedLaboratory:
    """Start the laboratory's process (a :class:`~instrument.laboratories.LaboratoryFactory`).

    Parameters
    ----------
    folder
        Exists; receives ``devices.toml``, the names of the serial lines and the example files.
    speed
        Laboratory seconds a wall-clock second.
    seed
        Of every random draw.
    artifact, facility
        What lies on the stage, and the instrument, where not the examples.
    flux
        ``reality``, or ``lambertian`` for a plain sample that needs no computation.

    Raises
    ------
    InputError
        If ``speed`` or a file is wrong.
    RuntimeError
        If the process does not start; quotes its last words.
    """
    if not speed > 0:
        raise InputError(f"speed: found {speed}; expected a positive number")
    inputs = _write_inputs(folder.resolve(), seed, artifact, facility)
    instrument = read_facility(inputs.facility)
    read_artifact(inputs.artifact)
    process = _start(folder.resolve(), inputs, speed, seed, flux)
    try:
        endpoints = _wait_until_ready(process, folder / _LOG)
        for name, write in (("devices.toml", write_devices), ("devices-esp301.toml", write_alternative)):
            write(folder / name, endpoints["ports"], endpoints["meter"], speed, instrument)
        add_monitor(folder / "devices.toml", folder / "devices-monitor.toml", endpoints["monitor"])
        return SimulatedLaboratory(inputs, process, endpoints)
    except BaseException:
        end_process(process)
        raise


def _write_inputs(folder: Path, seed: int, artifact: Path | None, facility: Path | None) -> Inputs:
    from sim_fixtures.bench.pieces import wavelength_certificate
    from sim_fixtures.examples import write_examples

    examples = write_examples(folder, seed, facility)
    (folder / "wavelength_standard.toml").write_text(wavelength_certificate(), encoding="utf-8")
    return Inputs(
        devices=folder / "devices.toml",
        facility=examples.facility,
        artifact=artifact or examples.artifact,
        material=examples.material,
        plan=examples.plan,
    )


def _start(folder: Path, inputs: Inputs, speed: float, seed: int, flux: str) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "sim_fixtures.serve", "--folder", str(folder), "--flux", flux]
    command += ["--speed", repr(float(speed)), "--seed", str(seed)]
    command += ["--facility", str(inputs.facility), "--artifact", str(inputs.artifact)]
    with (folder / _LOG).open("wb") as log:
        # A session of its own: Ctrl-C at the terminal is for the scan, which ends the laboratory last.
        return subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log, start_new_session=True
        )


def _wait_until_ready(process: subprocess.Popen[bytes], log: Path) -> dict[str, Any]:
    assert process.stdout is not None
    deadline, received = time.monotonic() + START_TIMEOUT, b""
    while b"\n" not in received and time.monotonic() < deadline:
        ready, _, _ = select.select([process.stdout], [], [], 0.2)
        if not ready:
            continue
        piece = process.stdout.read1()  # type: ignore[attr-defined]
        if not piece:
            break
        received += piece
    if b"\n" not in received:
        words = log.read_text(errors="replace").strip().splitlines()[-5:]
        raise RuntimeError(
            "the simulated laboratory did not start: " + ("; ".join(words) or f"it said nothing in {START_TIMEOUT:g} s")
        )
    return dict(json.loads(received))


def end_process(process: subprocess.Popen[bytes]) -> None:
    """End the laboratory's process: ask, then insist."""
    for stream in (process.stdin, process.stdout):
        if stream is not None:
            stream.close()
    try:
        process.wait(timeout=5.0)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait(timeout=5.0)

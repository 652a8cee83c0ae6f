"""Two programs never drive one instrument."""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from drivers.configuration import endpoints, parse_devices
from drivers.lock import InstrumentBusy, InstrumentLock, lock_directory

HOLD = """
import sys
from pathlib import Path
from drivers.lock import InstrumentLock
with InstrumentLock(["/dev/ttyUSB0"], Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.read()
"""


def test_the_second_lock_is_refused_and_names_the_holder(tmp_path: Path) -> None:
    with InstrumentLock(["a", "b"], tmp_path):
        with pytest.raises(InstrumentBusy, match=f"b: in use by process {os.getpid()} on "):
            InstrumentLock(["b", "c"], tmp_path).acquire()
        with InstrumentLock(["c"], tmp_path):
            pass
    with InstrumentLock(["b", "c"], tmp_path):
        pass


def test_another_process_is_kept_out_and_its_death_frees_the_instrument(tmp_path: Path) -> None:
    holder = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(tmp_path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    with holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "held\n"
        lock = InstrumentLock(["/dev/ttyUSB0"], tmp_path)
        with pytest.raises(InstrumentBusy, match=f"process {holder.pid} "):
            lock.acquire()
        holder.kill()
        holder.wait()
        with lock:
            pass


def test_a_link_to_a_wire_is_that_wire(tmp_path: Path) -> None:
    wire, link = tmp_path / "tty", tmp_path / "arms"
    wire.touch()
    link.symlink_to(wire)
    with InstrumentLock([str(wire)], tmp_path), pytest.raises(InstrumentBusy):
        InstrumentLock([str(link)], tmp_path).acquire()


def test_a_lock_that_was_refused_holds_nothing(tmp_path: Path) -> None:
    with InstrumentLock(["z"], tmp_path):
        with pytest.raises(InstrumentBusy):
            InstrumentLock(["a", "z"], tmp_path).acquire()
        with InstrumentLock(["a"], tmp_path):
            pass


def test_what_a_dead_program_left_behind_blocks_nobody(tmp_path: Path) -> None:
    lock = InstrumentLock(["a"], tmp_path)
    lock.path("a").write_text("not json")
    with lock:
        assert f'"pid": {os.getpid()}' in lock.path("a").read_text()
    assert lock.path("a").read_text() == ""


def test_the_directory_can_be_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GONIOTWIN_LOCK_DIR", str(tmp_path / "locks"))
    assert lock_directory() == tmp_path / "locks"
    with InstrumentLock(["a"]):
        assert list((tmp_path / "locks").iterdir())


def test_endpoints_name_each_wire_once() -> None:
    text = """
version = 1
[lines.arms]
kind = "serial"
port = "/dev/ttyUSB0"
[lines.meter]
kind = "visa"
resource = "TCPIP::192.168.0.3::5025::SOCKET"
[lines.io]
kind = "modbus-tcp"
host = "192.168.0.4"
[devices]
"""
    form = parse_devices(tomllib.loads(text))
    assert sorted(endpoints(form)) == ["/dev/ttyUSB0", "192.168.0.4:502", "TCPIP::192.168.0.3::5025::SOCKET"]


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("localhost:5025", "127.0.0.1:5025"),
        ("LocalHost:5025", "127.0.0.1:5025"),
        ("127.0.1.1:502", "localhost:502"),
        ("::1:502", "localhost:502"),
        ("Meter.lab.fi:5025", "meter.lab.fi:5025"),
        ("TCPIP0::localhost::5025::SOCKET", "TCPIP::127.0.0.1::5025::socket"),
        ("gpib::3::INSTR", "GPIB0::3::INSTR"),
    ],
)
def test_one_wire_under_two_names_is_locked_once(tmp_path: Path, one: str, other: str) -> None:
    with InstrumentLock([one], tmp_path), pytest.raises(InstrumentBusy):
        InstrumentLock([other], tmp_path).acquire()


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("localhost:5025", "localhost:5026"),
        ("localhost.lab.fi:502", "localhost:502"),
        ("1127.0.0.1:502", "127.0.0.1:502"),
        ("10.127.0.0.1:502", "127.0.0.1:502"),
        ("my-localhost:502", "localhost:502"),
        ("GPIB0::3::INSTR", "GPIB1::3::INSTR"),
    ],
)
def test_two_wires_are_not_taken_for_one(tmp_path: Path, one: str, other: str) -> None:
    with InstrumentLock([one], tmp_path), InstrumentLock([other], tmp_path):
        pass

"""The worked example of docs/adding_a_device.md, taken from the page and installed as an outside package."""

from __future__ import annotations

import re
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
import tomli_w

from drivers.check import check_devices
from drivers.configuration import connect, parse_devices, read_devices
from drivers.errors import CommunicationError, ConfigurationError, DeviceFault
from drivers.interfaces import Shutter
from sim_fixtures.devices.faults import Faults
from sim_fixtures.devices.wire import SerialLine
from sim_fixtures.laboratory import SimulatedLaboratory

PAGE = (Path(__file__).parents[2] / "docs" / "adding_a_device.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", PAGE, flags=re.MULTILINE | re.DOTALL)


class ShutterServer:
    """The other end, from the page's first paragraph."""

    def __init__(self) -> None:
        self.opened = self.stuck = False
        self.request_lost = lambda _: False

    def feed(self, data: bytes) -> list[bytes]:
        return [self._answer(command) for command in data.split(b"\n") if command and not self.request_lost(command)]

    def _answer(self, command: bytes) -> bytes:
        if command in (b"O", b"C") and not self.stuck:
            self.opened = command == b"O"
        return b"open\n" if self.opened else b"closed\n"


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The module and its registration, as pip would leave them."""
    (tmp_path / "acme_shutter.py").write_text(blocks("python")[0], encoding="utf-8")
    registered = tomllib.loads(blocks("toml")[0])["project"]["entry-points"]["goniotwin.devices"]
    info = tmp_path / "acme_shutter-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: acme-shutter\nVersion: 1.0\n", encoding="utf-8")
    lines = [f"{name} = {value}" for name, value in registered.items()]
    (info / "entry_points.txt").write_text("\n".join(["[goniotwin.devices]", *lines, ""]), encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    yield
    sys.modules.pop("acme_shutter", None)


@pytest.fixture
def server(tmp_path: Path) -> Iterator[tuple[ShutterServer, SerialLine]]:
    """The shutter on a wire."""
    line, shutter = SerialLine(tmp_path / "acme.tty", Faults()), ShutterServer()
    line.serve(shutter)  # type: ignore[arg-type]
    yield shutter, line
    line.close()


@pytest.fixture
def room(simulation: SimulatedLaboratory, server: tuple[ShutterServer, SerialLine], tmp_path: Path) -> Path:
    """The simulated laboratory's connections with the page's shutter in place of its own."""
    data = tomllib.loads(simulation.inputs.devices.read_text(encoding="utf-8"))
    example = tomllib.loads(blocks("toml")[1])
    data["lines"] |= example["lines"]
    data["lines"]["acme"] |= {"port": str(server[1].link), "timeout": 2.0}
    data["devices"] |= example["devices"]
    file = tmp_path / "devices.toml"
    file.write_text(tomli_w.dumps(data), encoding="utf-8")
    return file


@pytest.mark.usefixtures("package")
def test_the_example_is_found_checked_and_works(room: Path, server: tuple[ShutterServer, SerialLine]) -> None:
    shutter, line = server
    result = next(result for result in check_devices(read_devices(room)) if result.role == "shutter")
    assert (result.identity, result.state, result.problem) == ("ACME SH-1, closed", "closed", "")
    laboratory = connect(room)
    try:
        assert isinstance(laboratory.shutter, Shutter)
        laboratory.shutter.open()
        assert shutter.opened
        line.faults.set("drop", 1)
        laboratory.shutter.make_safe()
        assert not shutter.opened
        shutter.stuck = True
        with pytest.raises(DeviceFault, match="does not open"):
            laboratory.shutter.open()
        line.faults.set("corrupt", 1)
        with pytest.raises(CommunicationError, match="expected open or closed"):
            laboratory.shutter.is_open()
    finally:
        laboratory.close()


@pytest.mark.usefixtures("package")
def test_its_options_are_checked_like_any_others(room: Path) -> None:
    data = tomllib.loads(room.read_text(encoding="utf-8"))
    data["devices"]["shutter"]["travel_tme"] = 1.0
    form = parse_devices(data, "room.toml")
    with pytest.raises(ConfigurationError, match=r"room.toml: devices.shutter.travel_tme: unknown key"):
        check_devices(form)


def test_without_the_package_the_driver_is_unknown(room: Path) -> None:
    with pytest.raises(ConfigurationError, match="found 'acme-shutter'; expected one of"):
        read_devices(room)

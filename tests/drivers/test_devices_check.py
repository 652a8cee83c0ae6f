"""``goniotwin devices check`` on the simulated laboratory."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from drivers.check import check_devices
from drivers.configuration import connect, endpoints, read_devices
from drivers.errors import ConfigurationError
from drivers.interfaces import ROLES
from drivers.lock import InstrumentBusy, InstrumentLock
from instrument.devices_command import check
from instrument.errors import InputError


@pytest.fixture
def app() -> typer.Typer:
    """The command alone."""
    made = typer.Typer()
    made.command()(check)
    return made


def test_check_says_who_answered_and_how_they_are(devices: Path) -> None:
    results = {result.role: result for result in check_devices(read_devices(devices))}
    assert set(results) == set(ROLES)
    assert all(result.ok for result in results.values()), results
    assert "Oriental Motor AZ" in results["illumination_zenith"].identity
    assert "closed" in results["shutter"].state


def test_the_command_writes_json_and_succeeds(devices: Path, app: typer.Typer, tmp_path: Path) -> None:
    out = tmp_path / "check.json"
    outcome = CliRunner().invoke(app, ["--devices", str(devices), "--json", str(out)])
    assert outcome.exit_code == 0, outcome.output
    content = json.loads(out.read_text())
    assert content["ok"]
    assert {device["role"] for device in content["devices"]} == set(ROLES)


def test_one_mute_device_fails_the_check_and_the_others_are_still_tried(
    devices: Path, app: typer.Typer, tmp_path: Path
) -> None:
    file, out = tmp_path / "devices.toml", tmp_path / "check.json"
    file.write_text(devices.read_text().replace("address = 2\n", "address = 9\n"))
    outcome = CliRunner().invoke(app, ["--devices", str(file), "--json", str(out)])
    assert outcome.exit_code == 3, outcome.output
    failed = [device for device in json.loads(out.read_text())["devices"] if not device["ok"]]
    assert len(failed) == 1
    assert "no reply" in failed[0]["problem"]
    assert f"sensor_zenith: {file}:" in outcome.output  # one line that can be copied
    assert "devices.sensor_zenith.address = 9: expected Newport SMC100 at address 9" in outcome.output


def test_a_wrong_file_is_one_message(app: typer.Typer, tmp_path: Path) -> None:
    outcome = CliRunner().invoke(app, ["--devices", str(tmp_path / "nothing.toml")])
    assert isinstance(outcome.exception, ConfigurationError)  # status 2: tests/instrument/test_cli.py
    assert "nothing.toml: No such file or directory" in str(outcome.exception)


def test_what_is_no_json_is_kept_and_no_device_is_asked(app: typer.Typer, tmp_path: Path) -> None:
    file = tmp_path / "devices.toml"
    file.write_text("form = 1\n")
    outcome = CliRunner().invoke(app, ["--devices", str(file), "--json", str(file)])
    assert isinstance(outcome.exception, InputError)
    assert "devices.toml: exists already and is no JSON file" in str(outcome.exception)
    assert file.read_text() == "form = 1\n"


def test_devices_that_another_program_holds_are_told(devices: Path, app: typer.Typer, tmp_path: Path) -> None:
    out = tmp_path / "check.json"
    laboratory = connect(devices)
    outcome = CliRunner().invoke(app, ["--devices", str(devices), "--json", str(out)])
    laboratory.close()
    assert outcome.exit_code == 3, outcome.output
    problems = {device["role"]: device["problem"] for device in json.loads(out.read_text())["devices"]}
    assert "in use by another program" in problems["sensor_zenith"]


def test_nothing_is_asked_under_a_scan_that_uses_the_devices(devices: Path, app: typer.Typer) -> None:
    """Asking the meter who it is sets it up anew, in the middle of a burst."""
    with InstrumentLock(endpoints(read_devices(devices))):
        outcome = CliRunner().invoke(app, ["--devices", str(devices)])
    assert isinstance(outcome.exception, InstrumentBusy)
    assert "in use by process" in str(outcome.exception)

"""What the wiring guide, the data contract and the method say, held against the program."""

from __future__ import annotations

import re
import tomllib
from importlib.metadata import entry_points

import pytest
from pages import DOCS

from drivers.configuration import parse_devices
from drivers.interfaces import ROLES
from drivers.lines import ModbusSerialLineForm, SerialLineForm, VisaLineForm
from instrument.budget import COMPONENTS
from instrument.run_schema import FLAG_MASKS, GLOBALS, RUN, SCAN_DIRECTIONS
from twin import metrics
from twin.diagnosis.effects import library

DRIVERS = {point.name: point.load() for point in entry_points(group="goniotwin.devices")}


def page(name: str) -> str:
    return (DOCS / f"{name}.md").read_text(encoding="utf-8")


def test_every_driver_of_the_program_is_wired_in_the_guide() -> None:
    assert set(re.findall(r'driver = "([\w-]+)"', page("wiring"))) == set(DRIVERS)


@pytest.mark.parametrize("row", re.findall(r"^\| `devices\.toml` \| (.*) \|$", page("wiring"), re.MULTILINE))
def test_the_keys_of_the_guide_are_those_of_the_drivers(row: str) -> None:
    named = re.findall(r'driver = "([\w-]+)"', row)
    known = {"driver", "line", "kind"} | {key for name in named for key in DRIVERS[name].options.model_fields}
    for form in (SerialLineForm, ModbusSerialLineForm, VisaLineForm):
        known |= set(form.model_fields)
    kinds = {
        kind for words in re.findall(r"kind (`[\w-]+`(?: or `[\w-]+`)*)", row) for kind in re.findall(r"[\w-]+", words)
    }
    kinds -= {"or"}
    assert not set(re.findall(r"`([\w-]+)(?: = [^`]*)?`", row)) - known - kinds
    assert kinds <= {kind for name in named for kind in DRIVERS[name].line_kinds}


def test_the_example_of_connections_is_accepted_and_has_every_role() -> None:
    text = (DOCS / "devices.example.toml").read_text(encoding="utf-8")
    form = parse_devices(tomllib.loads(text), "devices.example.toml")
    assert set(ROLES) <= set(form.devices)


def test_the_run_file_of_the_page_is_that_of_the_program() -> None:
    section = page("data_contract").split("## Run file", 1)[1].split("\n## ", 1)[0]
    found: dict[str, tuple[str, str]] = {}
    for names, dims, unit in re.findall(r"^\| (`.*?) \| ([\w, ]*) \|([^|]*)\|", section, re.MULTILINE):
        listed = re.findall(r"`(\w+)`", names)
        units = (
            [u.strip() for u in unit.split(",")]
            if len(unit.split(",")) == len(listed)
            else [unit.strip()] * len(listed)
        )
        found |= {name: (dims, u) for name, u in zip(listed, units, strict=True)}
    components = set(COMPONENTS.values())
    assert set(found) - components == set(RUN) - components
    for name, (dims, unit) in found.items():
        assert tuple(dims.split(", ")) == RUN[name].dims, name
        if RUN[name].unit is not None:
            assert unit == RUN[name].unit, name
    assert all(f"`{name}`" in section for name in (*GLOBALS, *SCAN_DIRECTIONS))
    assert FLAG_MASKS == (1, 2, 4, 8)
    assert "1 saturated, 2 overload, 4 shadowed, 8 repeated" in section


def test_rows_of_the_budget_have_the_components_that_the_page_says() -> None:
    text = " ".join(page("data_contract").split("Rows of the budget", 1)[1].split("\n\n", 1)[0].split())
    said = dict(re.findall(r"`(\w+)` (?:is )?`(u_brf_\w+)`", text))
    assert said == {row: name for row, name in COMPONENTS.items() if name != f"u_brf_{row}"}


def test_the_method_has_every_equation_of_the_paper_and_table_five() -> None:
    text = page("method")
    for number in range(1, 10):
        assert f"({number})" in text
    good, acceptable = (f"{100 * limit:g}" for limit in metrics.RELATIVE_DIFFERENCE_LIMITS)
    assert f"below {good} % | {good} to {acceptable} %" in text
    good, acceptable = (f"{limit:g}" for limit in metrics.T_LIMITS)
    assert f"below {good} | {good} to {acceptable} |" in text
    good, acceptable = (f"{100 * limit:g}" for limit in metrics.LEVEL_OF_AGREEMENT_LIMITS)
    assert f"{good} % or more | {good} to {acceptable} %" in text


def test_the_tutorial_counts_the_effects_of_the_library() -> None:
    assert "some forty effects" in " ".join(page("tutorial").split())
    assert 36 <= len(library()) <= 48

"""Files are data: nothing in a plan, a configuration or a run makes the program run code or leave its folder."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from example_runs import FACILITY, PLAN, facility

from drivers.configuration import parse_devices, planned
from drivers.errors import ConfigurationError
from instrument.errors import InputError
from instrument.facility import read_facility
from instrument.plan import read_plan
from instrument.plan_text import self_contained
from instrument.run_folder import copy_plan, make_run_folder

ROOT = Path(__file__).parents[2]
ROOMS = ("drivers", "instrument", "twin", "gui", "sim_fixtures")
FORBIDDEN_MODULES = {"pickle", "cPickle", "marshal", "shelve", "dill", "cloudpickle", "joblib", "yaml", "code"}
FORBIDDEN_CALLS = {"eval", "exec", "compile", "__import__"}


def sources() -> Iterator[tuple[Path, ast.AST]]:
    for room in ROOMS:
        for path in sorted((ROOT / room).rglob("*.py")):
            yield path.relative_to(ROOT), ast.parse(path.read_text(encoding="utf-8"))


def violations(tree: ast.AST) -> Iterator[str]:
    """What could run code that stands in a file."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names = {alias.name.split(".")[0] for alias in node.names}
            yield from (f"import {name}" for name in names & FORBIDDEN_MODULES)
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            if node.module.split(".")[0] in FORBIDDEN_MODULES:
                yield f"from {node.module}"
        elif isinstance(node, ast.Call):
            function, keywords = node.func, {keyword.arg: keyword.value for keyword in node.keywords}
            if isinstance(function, ast.Name) and function.id in FORBIDDEN_CALLS:
                yield function.id
            if isinstance(function, ast.Attribute) and function.attr in ("system", "popen") and _is(function, "os"):
                yield f"os.{function.attr}"
            for name in ("shell", "allow_pickle"):
                if name in keywords and not (isinstance(keywords[name], ast.Constant) and not keywords[name].value):
                    yield name
            loads = isinstance(function, ast.Attribute) and function.attr == "load" and _is(function, "np")
            if loads and "allow_pickle" not in keywords:
                yield "np.load without allow_pickle=False"


def _is(function: ast.Attribute, module: str) -> bool:
    return isinstance(function.value, ast.Name) and function.value.id == module


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ("import pickle", ["import pickle"]),
        ("from yaml import load", ["from yaml"]),
        ("eval(text)", ["eval"]),
        ("import os\nos.system(x)", ["os.system"]),
        ("subprocess.run(x, shell=True)", ["shell"]),
        ("np.load(p)", ["np.load without allow_pickle=False"]),
        ("np.load(p, allow_pickle=False)", []),
        ("re.compile('x')", []),
    ],
)
def test_the_search_for_code_finds_what_it_looks_for(source: str, found: list[str]) -> None:
    assert list(violations(ast.parse(source))) == found


def test_no_room_can_run_code_from_a_file() -> None:
    assert [f"{path}: {what}" for path, tree in sources() for what in violations(tree)] == []


class Bomb:
    """Writes a file when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[object, tuple[object, ...]]:
        return (Path.touch, (self.path,))


def test_a_pickle_in_place_of_a_picture_is_refused_and_not_opened(tmp_path: Path) -> None:
    with (tmp_path / "beam.npy").open("wb") as file:
        np.save(file, np.array([[Bomb(tmp_path / "ran")]], dtype=object), allow_pickle=True)
    text = FACILITY.replace("radius_1_e2 = 8.0", 'profile = "image"\nimage = "beam.npy"\npixel_pitch = 0.1')
    (tmp_path / "facility.toml").write_text(text)
    with pytest.raises(InputError, match=r"beam\.npy"):
        read_facility(tmp_path / "facility.toml")
    assert not (tmp_path / "ran").exists()
    np.load(tmp_path / "beam.npy", allow_pickle=True)  # the file does do what it threatens
    assert (tmp_path / "ran").exists()


def test_code_in_a_plan_is_text(tmp_path: Path) -> None:
    code = f"__import__('pathlib').Path('{tmp_path / 'ran'}').touch()"
    (tmp_path / "plan.toml").write_text(PLAN.replace('"four points"', f'"{code}"'))
    assert read_plan(tmp_path / "plan.toml", facility()).title == code
    (tmp_path / "p.csv").write_text("wavelength,illumination_zenith,sensor_azimuth,sensor_zenith\n500,0,0,=1+30\n")
    with pytest.raises(InputError, match=r"found '=1\+30'; expected a number"):
        read_plan(tmp_path / "p.csv", facility())
    assert not (tmp_path / "ran").exists()


def test_a_driver_is_one_that_is_installed_and_no_name_of_code() -> None:
    devices = {"illumination_zenith": {"driver": "os:system", "line": "a"}}
    line = {"kind": "serial", "port": "/dev/null", "baudrate": 9600}
    form = parse_devices({"version": 1, "lines": {"a": line}, "devices": devices})
    with pytest.raises(ConfigurationError):
        planned(form)


def test_the_title_of_a_plan_chooses_no_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "plan.toml").write_text(PLAN.replace('"four points"', '"../../elsewhere"'))
    folder = make_run_folder(None, tmp_path / "plan.toml")
    assert folder.parent == tmp_path / "runs"


def test_the_plan_of_a_run_folder_names_no_file(tmp_path: Path) -> None:
    (tmp_path / "sub").mkdir()
    (tmp_path / "run").mkdir()
    head = "wavelength,illumination_zenith,sensor_azimuth,sensor_zenith\n"
    (tmp_path / "sub" / "points.csv").write_text(head + "500,0,0,30\n")
    (tmp_path / "plan.toml").write_text('version = 1\n[[part]]\ntable = "sub/points.csv"\n')
    kept = copy_plan(tmp_path / "plan.toml", tmp_path / "run")
    assert [path.name for path in (tmp_path / "run").iterdir()] == ["plan.toml"]
    assert "points.csv" not in kept.read_text()
    assert self_contained(kept) == kept.read_text()
    assert len(read_plan(kept, facility())) == 1


def test_a_run_folder_whose_plan_names_a_file_elsewhere_is_refused(tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    (tmp_path / "secret.csv").write_text("not for you\n")
    (tmp_path / "run" / "plan.toml").write_text('version = 1\n[[part]]\ntable = "../secret.csv"\n')
    with pytest.raises(InputError) as caught:
        read_plan(tmp_path / "run" / "plan.toml", facility())
    assert "not for you" not in str(caught.value)
    assert "expected a file in the folder of the plan" in str(caught.value)

"""Empty, truncated, foreign and future files, of every kind the program reads: named, status 2, never changed."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

from instrument.__main__ import main
from sim_fixtures.examples import example_files

FILES = example_files()
DOCS = Path(__file__).parents[2] / "docs"
GEOMETRY = "wavelength,illumination_zenith,illumination_azimuth,sensor_zenith,sensor_azimuth"
#: What stands in files that are no copies of the examples.
TEXTS = {
    "run.csv": f"{GEOMETRY},brf,u_brf\n500,0,0,40,45,0.6,0.01\n500,15,0,-60,50,0.6,0.01\n",
    "plan.csv": f"{GEOMETRY}\n500,0,0,30,45\n500,0,0,31,45\n",
    "table.csv": "lambda,i,azimuth,e,r\n550,0,0,30,0.9\n550,0,0,40,0.9\n",
    "mapping.toml": 'form = "column mapping"\nversion = 1\n\n[columns]\nwavelength = { column = "lambda" }\n'
    'illumination_zenith = { column = "i" }\nillumination_azimuth = { column = "azimuth" }\n'
    'sensor_zenith = { column = "e" }\nsensor_azimuth = { constant = 0 }\n'
    'brf = { column = "r" }\nu_brf = { constant = 0.01 }\n',
    "metadata.toml": 'form = "BiRD metadata"\nversion = 1\n\n[sample]\nname = "plate"\n',
    "material.toml": '[default]\nmodel = "lambertian"\nreflectance = 0.6\n',
    "corrections.toml": 'form = "corrections"\nversion = 1\n\n[[effects]]\neffect = "sample_height"\n'
    "parameters = { height_mm = 1.0 }\n",
    "diagnosis.json": '{"verdict": "none", "consistency": {"consistent": true}, "gap": {"before": 1.0}}\n',
    "bird.json": '{"metadata": {"schema": "https://example.org/bird_1.0.json"}, "data": {"theta_i": []}}\n',
}
COPIES = {
    "run.nc": FILES.material,
    "prediction.nc": FILES.material,
    "material.nc": FILES.material,
    "facility.toml": FILES.facility,
    "artifact.toml": FILES.artifact,
    "artifact_holes.csv": FILES.artifact.parent / "artifact_holes.csv",
    "plan.toml": FILES.plan,
    "devices.toml": DOCS / "devices.example.toml",
}
THREE = ("--artifact", "artifact.toml", "--material", "material.toml", "--facility", "facility.toml")
IMPORT = ("exchange", "import", "table.csv", "out.nc", "--columns", "mapping.toml")
#: The command that reads a kind of file.
COMMANDS: dict[str, tuple[str, ...]] = {
    "run.nc": ("budget", "run.nc"),
    "run.csv": ("budget", "run.csv"),
    "prediction.nc": ("compare", "run.nc", "prediction.nc"),
    "diagnosis.json": ("report", "run.nc", "--diagnosis", "diagnosis.json", "--out", "out.html"),
    "corrections.toml": ("predict", "plan.toml", *THREE, "--corrections", "corrections.toml", "--out", "out.nc"),
    "facility.toml": ("plan", "plan.toml", "--facility", "facility.toml"),
    "artifact.toml": ("artifact", "show", "artifact.toml"),
    "artifact_holes.csv": ("artifact", "show", "artifact.toml"),
    "material.nc": ("material", "check", "material.nc"),
    "material.toml": ("material", "check", "material.toml"),
    "plan.toml": ("plan", "plan.toml"),
    "plan.csv": ("plan", "plan.csv"),
    "devices.toml": ("devices", "check", "--devices", "devices.toml"),
    "bird.json": ("exchange", "import", "bird.json", "out.nc"),
    "table.csv": IMPORT,
    "mapping.toml": IMPORT,
    "metadata.toml": ("exchange", "bird", "run.nc", "out.json", "--metadata", "metadata.toml"),
}
#: Forms that state no version refuse what they do not know.
UNKNOWN = {
    "facility.toml": b"version = 2\n",
    "artifact.toml": b"version = 2\n",
    "material.toml": b"version = 2\n",
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("files")
    for name, text in TEXTS.items():
        (made / name).write_text(text)
    for name, source in COPIES.items():
        shutil.copy(source, made / name)
    return made


def damaged(content: bytes, name: str, how: str) -> bytes:
    if how == "future":
        later = UNKNOWN.get(name, b"") + re.sub(rb"\bversion = 1\b|_1\.0\.json", _next, content)
        assert later != content
        return later
    foreign = {"text": b"Dear colleague,\nour values are below.\n", "picture": b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR" * 9}
    # In the middle of a line: a table that ends with one of its lines is a table.
    return foreign.get(how, content[: int(0.48 * len(content))] if how == "cut" else b"")


def _next(match: re.Match[bytes]) -> bytes:
    return match[0].replace(b"1", b"9", 1)


def cases() -> list[tuple[str, str]]:
    versioned = [
        name for name in COMMANDS if name in UNKNOWN or b"version = 1" in _content(name) or name == "bird.json"
    ]
    return [(name, how) for name in COMMANDS for how in ("empty", "cut", "text", "picture")] + [
        (name, "future") for name in versioned
    ]


def _content(name: str) -> bytes:
    return TEXTS[name].encode() if name in TEXTS else COPIES[name].read_bytes()


@pytest.mark.parametrize(("name", "how"), cases())
def test_a_file_that_is_none_is_named_and_kept(
    name: str, how: str, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(folder)
    file, before = folder / name, sorted(folder.iterdir())
    whole = file.read_bytes()
    content = damaged(whole, name, how)
    file.write_bytes(content)
    try:
        assert main(COMMANDS[name]) == 2
        said = capsys.readouterr().err
        assert said.startswith("goniotwin: ")
        assert name in said
        assert file.read_bytes() == content
        assert sorted(folder.iterdir()) == before
    finally:
        file.write_bytes(whole)

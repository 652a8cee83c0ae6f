"""Every example runs as it stands, warnings are errors, and says what it promises."""

from __future__ import annotations

import contextlib
import io
import re
import runpy
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pages import DOCS, HOME

EXAMPLES = HOME / "examples"


def run(name: str, folder: Path) -> tuple[dict[str, Any], str]:
    """What an example leaves in its namespace, and what it prints; what it writes goes into ``folder``."""
    said = io.StringIO()
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(said):
        patch.setattr(tempfile, "tempdir", str(folder))
        patch.chdir(folder)
        left = runpy.run_path(str(EXAMPLES / f"{name}.py"))
    return left, said.getvalue()


def test_every_example_is_run_here_and_listed_in_the_page() -> None:
    files = {file.stem for file in EXAMPLES.glob("*.py")}
    page = (DOCS / "library.md").read_text(encoding="utf-8")
    assert files == set(re.findall(r"^\| \[(\w+)\.py\]", page, re.MULTILINE))
    assert all(f"test_{stem}" in globals() for stem in files)


@pytest.mark.parametrize("file", sorted(EXAMPLES.glob("*.py")), ids=lambda file: file.stem)
def test_cells_begin_with_words(file: Path) -> None:
    cells = re.split(r"^# %%", file.read_text(encoding="utf-8"), flags=re.MULTILINE)
    assert cells[0] == ""
    assert cells[1].startswith(" [markdown]\n# # ")
    assert len(cells) >= 5


@pytest.mark.slow
def test_run_a_plan(tmp_path: Path) -> None:
    left, said = run("run_a_plan", tmp_path)
    assert "left out: zenith 0" in said
    assert "2 of 2 points measured: finished" in said
    assert left["measured"] == pytest.approx(left["run"]["brf"].values)
    assert (left["folder"] / "run" / "run.nc").is_file()


@pytest.mark.slow
def test_predict(tmp_path: Path) -> None:
    left, _ = run("predict", tmp_path)
    # The pattern of the holes changes too; signs and size are those of the cosine.
    assert np.sign(left["change"]).tolist() == [1, 1, -1, -1]
    assert np.all(np.abs(left["change"] - left["tangent"]) < 0.01)


@pytest.mark.slow
def test_propagate(tmp_path: Path) -> None:
    left, said = run("propagate", tmp_path)
    share = left["found"]["variance_share"]
    assert share.sum("source").values == pytest.approx(1.0)
    assert np.all(left["found"]["u_brf"] > left["found"]["u_brf_inputs"])
    assert "sensor zenith" in said


@pytest.mark.slow
@pytest.mark.timeout(900)  # of the wall clock, on a busy machine
def test_diagnose(tmp_path: Path) -> None:
    left, _ = run("diagnose", tmp_path)
    found = left["found"]
    assert not found.consistency.consistent
    assert found.decision.verdict == "effects"
    (named,) = found.decision.named
    assert named.effect == "sensor_zenith_offset"
    assert named.values[0] == pytest.approx(1.5, abs=0.4)
    assert found.gap.heldout_after < 0.6 * found.gap.heldout_before


def test_add_a_device(tmp_path: Path) -> None:
    _, said = run("add_a_device", tmp_path)
    assert said == "ACME T-1 21.17 degree Celsius\nafter a lost reply: 21.17 degree Celsius\n"


def test_add_an_effect(tmp_path: Path) -> None:
    left, said = run("add_an_effect", tmp_path)
    progress = np.arange(24) / 23
    assert left["read"] == pytest.approx(0.5 * (1 + 0.03 * np.exp(-10 * progress)))
    assert "detector_warm_up is not in it" in said


@pytest.mark.slow
def test_add_a_reflection_model(tmp_path: Path) -> None:
    left, _ = run("add_a_reflection_model", tmp_path)
    brf = left["brf"]
    assert brf["k = 1"] == pytest.approx(brf["Lambertian"], rel=1e-5)
    # Integral of 2 r mu^k nu^(k - 1) over mu: 2 r nu^(k - 1)/(k + 1), but for the grid.
    expected = 2 * 0.6 * np.array([1.0, 0.5]) ** 0.1 / 2.1
    assert left["limb"].directional_reflectance([1.0, 0.5]) == pytest.approx(expected, rel=2e-3)

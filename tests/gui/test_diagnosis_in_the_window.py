"""A diagnosis from the first click to the next plan, with the program's own ray tracer."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from PySide6.QtCore import QUrl
from PySide6.QtGui import QDesktopServices
from pytestqt.qtbot import QtBot
from window_stage import Stage

from gui.setup import Setup
from instrument.dataset import write_run
from instrument.facility import read_facility
from instrument.plan import read_plan
from twin.corrections import read_corrections

EXAMPLES = Path(__file__).parents[2] / "sim_fixtures" / "examples"
TRUE_DEG = 1.5
#: What the ray tracer says of a small plate with the sensor's zenith off by 1.5 degrees, with 0.4 % of noise and 0.6 %
#: a slice: azimuths 0, 60 and 120, zeniths from 70 downwards in steps of 14 degrees, without retro-reflection.
BRF = (
    "0.4667 0.47174 0.46758 0.47851 0.40975 0.40027 0.44418 0.46905 0.40214 0.41368 0.41908 0.45614 0.42097 0.42171"
    " 0.42851 0.41248 0.39694 0.39483 0.39304 0.45115 0.42192 0.36445 0.41489 0.38058 0.38294 0.38919 0.40716 0.42971"
    " 0.43321 0.42762 0.49992 0.48188"
)
UNCERTAINTY = {"noise": 0.004, "stability": 0.006, "reference": 0.005}  # relative
#: The program with a library of two effects: rendering all of them takes four times as long.
FEW = """
from instrument.__main__ import main
from twin.diagnosis import responses
from twin.diagnosis.effects import effect
responses.library = lambda: {name: effect(name) for name in ("sensor_zenith_offset", "backlash")}
main()
"""


@pytest.fixture
def run(tmp_path: Path) -> Path:
    folder = tmp_path / "run"
    folder.mkdir()
    shutil.copy(EXAMPLES / "facility.toml", folder)
    rows = [f"{n},{x},{y},2.55,0,0,0" for n, (x, y) in enumerate(product((-7.2, -3.6, 0, 3.6, 7.2), repeat=2))]
    (folder / "holes.csv").write_text("\n".join(["hole,x_mm,y_mm,diameter_mm,u_x_mm,u_y_mm,u_diameter_mm", *rows]))
    (folder / "artifact.toml").write_text(
        'holes = "holes.csv"\noutline = [30.0, 30.0]\nplate_thickness = 1.13\ncavity_depth = 3.26\n'
    )
    (folder / "material.toml").write_text('[default]\nmodel = "lambertian"\nreflectance = 0.6\n')
    write_run(measured(), folder / "run.nc")
    return folder


def measured() -> xr.Dataset:
    zeniths = np.arange(70.0, -71.0, -14.0)
    points = [(azimuth, zenith) for azimuth in (0.0, 60.0, 120.0) for zenith in zeniths]
    azimuth, zenith = np.array([point for point in points if point != (0.0, 28.0)]).T
    degrees = {
        "illumination_zenith": 30.0,
        "illumination_azimuth": 0.0,
        "sensor_zenith": zenith,
        "sensor_azimuth": azimuth,
    }
    coords: dict[str, Any] = {"wavelength": ("point", np.full(32, 500.0), {"units": "nm"})}
    coords |= {name: ("point", value + np.zeros(32), {"units": "degree"}) for name, value in degrees.items()}
    seconds = np.datetime64("2026-01-01") + np.arange(32) * np.timedelta64(22, "s")
    coords["time"] = ("point", seconds.astype("datetime64[ns]"))
    brf = np.array(BRF.split(), dtype=float)
    parts = {f"u_brf_{name}": share * brf for name, share in UNCERTAINTY.items()}
    values = {"brf": brf, "u_brf": np.sqrt(sum(np.square(part) for part in parts.values())), **parts}
    variables: dict[str, Any] = {name: ("point", value, {"units": "1"}) for name, value in values.items()}
    variables["brf"][2]["unc_comps"] = list(parts)
    return xr.Dataset(variables, coords)


@pytest.mark.slow
@pytest.mark.timeout(280)
def test_a_run_is_understood_corrected_and_followed_up(
    make_stage: Callable[..., Stage], qtbot: QtBot, run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "few_effects.py").write_text(FEW)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")]))
    opened: list[QUrl] = []
    monkeypatch.setattr(QDesktopServices, "openUrl", opened.append)
    for name in ("diagnosis.html", "corrected-twin.toml"):
        (run / name).write_text("of an earlier diagnosis, which this one replaces")
    window = make_stage(setup=Setup(simulate=True, runs=tmp_path)).window
    window.show_page("understand")
    page: Any = window.page("understand")
    start = page._child.run
    monkeypatch.setattr(
        page._child, "run", lambda module, words: start("few_effects", [*words, "--cache", str(tmp_path / "c")])
    )
    page.line.setText(str(run))
    page.line.editingFinished.emit()
    assert page.headline.isHidden()
    page.begin.click()
    qtbot.waitUntil(page.stop.isEnabled, timeout=20_000)
    assert not page.begin.isEnabled()
    qtbot.waitUntil(lambda: page.state.text().startswith(("Done in", "⚠")), timeout=250_000)
    assert page.state.text().startswith("Done in"), page.state.text()
    # Where, which, how far
    assert page.verdict.text() == "A cause is found"
    assert "every azimuth, illumination zenith 30 degrees" in page.where.text()
    row = [page.effects.item(0, column).text() for column in range(4)]
    assert {row[0], row[3]} == {"sensor zenith offset", "backlash"}  # this run cannot tell them apart
    assert float(row[1].removeprefix("> ")) > 0.9
    assert "Slices held out: 3." in page.far.text()
    # The report, the corrected twin, the next plan
    page.report.click()
    assert opened == [QUrl.fromLocalFile(str((run / "diagnosis.html").resolve()))]
    assert (run / "diagnosis.html").read_text().startswith("<!DOCTYPE html>")
    page.apply.click()
    assert window.setup.request().corrections == (run / "corrected-twin.toml").resolve()
    [effect] = read_corrections(run / "corrected-twin.toml").effects
    if effect.effect == "sensor_zenith_offset":
        assert effect.parameters["angle_deg"] == pytest.approx(TRUE_DEG, abs=0.8)  # three standard uncertainties
    assert "in the opposite direction" in page.next.text()
    page.load.click()
    assert window.stack.currentWidget() is window.page("setup")
    assert window.setup.plan is not None
    plan = read_plan(window.setup.plan, read_facility(run / "facility.toml"))
    zeniths = [point.sensor_zenith for point in plan.points]
    assert zeniths == sorted(zeniths)  # the run went downwards
    assert len(zeniths) == 10

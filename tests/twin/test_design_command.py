"""``goniotwin design`` on the command line, small."""

from __future__ import annotations

import json
import pickle
from dataclasses import dataclass
from pathlib import Path

import pytest

from instrument.__main__ import main
from instrument.facility import UNKNOWN_FACILITY
from instrument.plan import read_plan
from sim_fixtures.examples import example_files
from twin import cluster
from twin.design import command, pattern
from twin.design.scan_plan import write_plan


@dataclass
class Result:
    status: object
    output: str


@pytest.fixture
def call(capsys, monkeypatch):
    """Run ``goniotwin design`` as from a shell, on a coarse hemisphere."""
    coarse = pattern.Cells.of(15.0, 45.0)
    monkeypatch.setattr(pattern.Cells, "of", classmethod(lambda cls, *_: coarse))

    def run(*arguments: object) -> Result:
        try:
            status = main(["design", *map(str, arguments)])
        except SystemExit as end:
            status = end.code
        return Result(status, "".join(capsys.readouterr()))

    return run


ARTIFACT = example_files().artifact
QUICK = ("--illumination", "15", "--standard-error", "0.05")


def is_picture(path: Path) -> bool:
    return path.read_bytes().startswith(b"\x89PNG") and path.stat().st_size > 10_000


def test_pattern_and_plan_of_an_artifact_alone(call, tmp_path) -> None:
    done = call(ARTIFACT, *QUICK, "--planes", "3", "--out", tmp_path / "new" / "design")
    assert done.status in (0, None), done.output
    out = tmp_path / "new" / "design"
    assert is_picture(out / "pattern.png")
    plan = read_plan(out / "plan.toml", UNKNOWN_FACILITY)
    assert {point.sensor_azimuth for point in plan.points} >= {0.0}
    assert len({point.sensor_azimuth for point in plan.points}) == 3
    found = json.loads((out / "design.json").read_text())
    (candidate,) = found["candidates"]
    assert 0.3 < candidate["hemispherical_reflectance"]["15"] < 0.42
    assert candidate["signal"]["structure_over_budget"] is None
    assert "separation" not in candidate
    assert found["plan"]["points"] == len(plan.points)
    assert "name a --facility" in done.output or "needs a --facility" in done.output


def sent(value):
    return pickle.loads(pickle.dumps(value))  # noqa: S301 (our own)


def test_candidates_are_judged_where_it_is_asked_for(call, tmp_path, monkeypatch) -> None:
    """On a cluster or in processes: what is sent there, and what comes back, survives the way."""
    asked = []

    def elsewhere(function, items, *, address, workers, done):
        asked.append((len(items), address, workers))
        function, items = sent((function, items))
        return [sent(function(item)) for item in items]

    monkeypatch.setattr(cluster, "spread", elsewhere)
    place = ("--dask", "tcp://host:8786", "--workers", "3")
    done = call(ARTIFACT, *QUICK, "--planes", "1", "--out", tmp_path, *place)
    assert done.status in (0, None), done.output
    assert asked == [(1, "tcp://host:8786", 3)]
    assert is_picture(tmp_path / "pattern.png")


@pytest.mark.slow
def test_sweep_with_a_facility(call, tmp_path, monkeypatch) -> None:
    settings = command._settings

    def coarse(*arguments):
        return settings(*arguments).__class__(
            illumination_zenith=(15.0,), planes=2, standard_error=0.05, samples=16, zenith_step=40.0, azimuth_step=60.0
        )

    monkeypatch.setattr(command, "_settings", coarse)
    done = call(
        ARTIFACT, "--facility", example_files().facility, "--sweep", "hole_diameter=2.2,2.8", "--out", tmp_path,
        "--json", tmp_path / "result.json",
    )  # fmt: skip
    assert done.status in (0, None), done.output
    assert all(is_picture(tmp_path / name) for name in ("pattern.png", "sweep.png", "sweep_patterns.png"))
    candidates = json.loads((tmp_path / "result.json").read_text())["candidates"]
    assert [candidate["changes"] for candidate in candidates] == [{}, {"hole_diameter": 2.2}, {"hole_diameter": 2.8}]
    nominal, narrow, wide = (candidate["hemispherical_reflectance"]["15"] for candidate in candidates)
    assert narrow > nominal > wide
    effects = candidates[0]["separation"]["effects"]
    assert len(effects) == 9
    assert all(row["distinct"] <= row["detectable"] * 1.000001 for row in effects.values())
    assert read_plan(tmp_path / "plan.toml", UNKNOWN_FACILITY).points


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--sweep", "size=1:2:3"), "expected one of hole_diameter"),
        (("--sweep", "hole_diameter=2:3"), "start:stop:count"),
        (("--sweep", "hole_diameter=3.5:3.9:3"), "overlap"),
        (("--illumination", "0,steep"), "angles in degree"),
        (("--illumination", "95"), "below 90"),
        (("--illumination", "15,15"), "different angles"),
        (("--standard-error", "0"), "--standard-error"),
        (("--reflectance", "1.5"), "--reflectance"),
        (("--json", "no/such/folder/x.json"), "no folder"),
        (("--facility", "nowhere.toml"), "nowhere.toml"),
    ],
)
def test_bad_input_is_explained_before_any_work(call, tmp_path, arguments, says, monkeypatch) -> None:
    monkeypatch.setattr(command, "_judge_all", lambda *_: pytest.fail("work began"))
    done = call(ARTIFACT, *arguments, "--out", tmp_path / "out")
    assert done.status == 2
    assert done.output.startswith("goniotwin: ")
    assert says in done.output


def test_an_out_that_is_a_file_is_explained(call, tmp_path) -> None:
    (tmp_path / "taken").write_text("")
    done = call(ARTIFACT, "--out", tmp_path / "taken")
    assert done.status == 2
    assert "taken: is a file; expected a folder" in done.output


def test_an_illumination_beyond_the_arm_is_explained(call, tmp_path) -> None:
    text = example_files().facility.read_text().replace(
        "illumination_zenith = [-90.0, 90.0]", "illumination_zenith = [-20.0, 20.0]"
    )  # fmt: skip
    (tmp_path / "facility.toml").write_text(text)
    done = call(ARTIFACT, "--facility", tmp_path / "facility.toml", "--out", tmp_path)
    assert done.status == 2
    assert "30 degrees" in done.output
    assert "-20 to 20" in done.output


def test_the_plan_stays_within_the_arms(tmp_path) -> None:
    arms = UNKNOWN_FACILITY.arms.model_copy(update={"sensor_zenith": (-62.0, 47.0)})
    limited = UNKNOWN_FACILITY.model_copy(update={"arms": arms})
    plan = write_plan(
        tmp_path / "p.toml", limited, [(0.0, 45.0), (30.0, 0.0), (30.0, 15.0)], title="t", wavelength=500.0
    )
    zeniths = {point.sensor_zenith for point in plan.points}
    assert (min(zeniths), max(zeniths)) == (-60.0, 45.0)
    assert {(p.illumination_zenith, p.sensor_azimuth) for p in plan.points} == {(0.0, 45.0), (30.0, 0.0), (30.0, 15.0)}

"""Sets of cases on disk: what lies where, what is promised, and that making them goes on where it stopped."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest
import xarray as xr

from instrument.errors import InputError
from sim_fixtures.case_commands import composition_of
from sim_fixtures.cases import FAMILIES, known_effects
from sim_fixtures.cases.composition import Composition, orders
from sim_fixtures.cases.sealed import open_labels, write_sealed_set
from sim_fixtures.examples import ExampleFiles, example_files, write_examples

SMALL = Composition(none=1, single=1, double=1, outside=1, effects=("stray_light", "gain_step"))
PLAN = """version = 1
[[grid]]
wavelength = [500.0]
illumination_zenith = [15.0]
sensor_azimuth = [0.0, 90.0]
sensor_zenith = { start = -60.0, stop = 60.0, step = 30.0 }
"""


@pytest.fixture
def files(tmp_path: Path) -> ExampleFiles:
    """The example inputs with a plan of ten points."""
    folder = tmp_path / "inputs"
    folder.mkdir()
    written = write_examples(folder)
    written.plan.write_text(PLAN)
    return written


def test_a_set_has_what_was_asked_for_in_an_order_that_tells_nothing() -> None:
    composition = Composition(none=16, single=144, double=20, outside=30)
    made = orders(composition, 5)
    assert made == orders(composition, 5)
    assert made != orders(composition, 6)
    assert Counter(order.kind for order in made) == {"none": 16, "single": 144, "double": 20, "outside": 30}
    library = [name for name, one in known_effects().items() if not one.outside]
    singles = Counter((order.effects[0], order.severity) for order in made if order.kind == "single")
    assert singles == {(name, severity): 1 for name in library for severity in composition.severities}
    assert Counter(o.noise_family for o in made if o.kind == "none") == dict.fromkeys(FAMILIES, 2)
    assert all(len(set(o.effects)) == 2 for o in made if o.kind == "double")
    assert all(known_effects()[o.effects[0]].outside for o in made if o.kind == "outside")
    kinds = [order.kind for order in made]
    assert kinds != sorted(kinds)
    assert len({order.seed for order in made}) == composition.size
    assert {order.scan_direction for order in made} == {"unidirectional", "serpentine"}


@pytest.mark.parametrize("cases", [4, 5, 17, 70, 380])
def test_a_set_has_the_size_asked_for(cases: int) -> None:
    composition = Composition.of_size(cases)
    assert composition.size == cases
    assert min(composition.none, composition.single, composition.double, composition.outside) > 0


def test_the_final_set_has_the_numbers_of_the_trial() -> None:
    final = Composition.of_size(380)
    assert (final.none, final.single, final.double, final.outside) == (80, 200, 40, 60)


def test_numbers_and_severities_of_a_set_can_be_chosen() -> None:
    chosen = composition_of(140, "40,100,0,0", [2.0])
    assert (chosen.none, chosen.single, chosen.double, chosen.outside) == (40, 100, 0, 0)
    assert {order.severity for order in orders(chosen, 7) if order.kind == "single"} == {2.0}


@pytest.mark.parametrize(
    ("counts", "severity", "message"),
    [
        ("40,100,0", None, "found '40,100,0'; expected four whole numbers"),
        ("40,a,0,0", None, "found '40,a,0,0'; expected four whole numbers"),
        ("4,2,0,0", None, r"found 4,2,0,0 \(6 cases\) with --cases 140"),
        (None, [2.0, -1.0], "--severity: found -1; expected more than 0"),
    ],
)
def test_numbers_that_make_no_set_are_refused(counts: str | None, severity: list[float] | None, message: str) -> None:
    with pytest.raises(InputError, match=message):
        composition_of(140, counts, severity)


def test_fewer_cases_than_kinds_are_refused() -> None:
    with pytest.raises(ValueError, match="at least 4"):
        Composition.of_size(3)


def test_a_set_is_sealed_kept_and_opened(tmp_path: Path, files: ExampleFiles) -> None:
    folder, labels = tmp_path / "set", tmp_path / "labels"
    done: list[str] = []
    made = write_sealed_set(folder, labels, 4, SMALL, files=files, rays=256, progress=done.append)
    assert done == ["case0001", "case0002", "case0003", "case0004"]
    assert {path.name for path in (folder / "common").iterdir()} == {
        "facility.toml",
        "artifact.toml",
        "artifact_holes.csv",
        "material.nc",
    }
    runs = sorted((folder / "cases").iterdir())
    assert [path.name for path in runs] == [f"{name}.nc" for name in done]
    assert (folder / "labels.sha256").read_text() == f"{made.digest}  labels.json\n"
    assert made.digest == hashlib.sha256((labels / "labels.json").read_bytes()).hexdigest()
    opened = open_labels(folder, labels)
    assert Counter(label["kind"] for label in opened.values()) == {"none": 1, "single": 1, "double": 1, "outside": 1}

    # What a run says must not depend on what is wrong with it.
    attributes = []
    for path in runs:
        with xr.open_dataset(path) as run:
            attributes.append({k: v for k, v in run.attrs.items() if k != "scan_direction"})
            assert run.sizes["point"] == 10
    assert all(one == attributes[0] for one in attributes)
    words = [{word for word in known_effects() if word.encode() in path.read_bytes()} for path in runs]
    assert all(found == {"polarization"} for found in words)  # a row of the budget has that name

    before = {path: path.read_bytes() for path in runs}
    runs[2].unlink()
    again: list[str] = []
    assert write_sealed_set(folder, labels, 4, SMALL, files=files, rays=256, progress=again.append) == made
    assert again == ["case0003"]
    with xr.open_dataset(runs[2]) as run:
        (tmp_path / "old.nc").write_bytes(before[runs[2]])
        with xr.open_dataset(tmp_path / "old.nc") as old:
            xr.testing.assert_identical(run.load(), old.load())


def test_changed_labels_are_found_out(tmp_path: Path, files: ExampleFiles) -> None:
    folder, labels = tmp_path / "set", tmp_path / "labels"
    write_sealed_set(folder, labels, 4, SMALL, files=files, rays=256)
    path = labels / "labels.json"
    content = json.loads(path.read_text())
    content["labels"]["case0001"]["kind"] = "none" if content["labels"]["case0001"]["kind"] != "none" else "single"
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match="SHA-256"):
        open_labels(folder, labels)
    path.unlink()
    with pytest.raises(InputError, match="not found"):
        open_labels(folder, labels)


def test_another_set_in_the_same_place_is_refused(tmp_path: Path, files: ExampleFiles) -> None:
    folder, labels = tmp_path / "set", tmp_path / "labels"
    write_sealed_set(folder, labels, 4, SMALL, files=files, rays=256)
    with pytest.raises(InputError, match="another set"):
        write_sealed_set(folder, labels, 5, SMALL, files=files, rays=256)
    with pytest.raises(InputError, match="another set"):
        write_sealed_set(folder, labels, 4, replace(SMALL, none=2), files=files, rays=256)


def test_labels_among_the_runs_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="among the runs"):
        write_sealed_set(tmp_path / "set", tmp_path / "set" / "labels", 4, SMALL, files=example_files())

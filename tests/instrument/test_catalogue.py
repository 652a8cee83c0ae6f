"""The catalogue says what the folders say, remembers it, finds runs, and is never the only one to know."""

import json
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest
from example_runs import START, four_points, geometry, header, reading, references, status

import instrument.catalogue.store as store
from instrument.catalogue.entry import read_entry
from instrument.catalogue.search import Query, condition, moment
from instrument.catalogue.store import CATALOGUE_NAME, Catalogue
from instrument.dataset import rebuild_run, write_run
from instrument.errors import InputError
from instrument.journal import JOURNAL_NAME, Journal


def run_folder(path: Path, **changes: object) -> Path:
    """A finished run with its run file, and what a comparison and a diagnosis leave beside it."""
    path.parent.mkdir(exist_ok=True)
    four_points(path, **changes)
    with Journal.reopen(path) as journal:
        journal.record("ended", time=START, outcome="finished", reason="", measured=4, skipped=0, not_reached=0)
    return path


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three runs, made once; for tests that change nothing."""
    folder = tmp_path_factory.mktemp("made") / "data"
    folder.mkdir()
    first = run_folder(folder / "first", record={"sample": "Plate 3", "operator": "Ada", "project": "holes"})
    write_run(rebuild_run(first), first / "run.nc")
    (first / "comparison.json").write_text('{"global": {"relative_rmse": 0.021, "level_of_agreement": 0.87}}')
    effect = {"effect": "sample_tilt", "probability": 0.9}
    (first / "diagnosis.json").write_text(json.dumps({"verdict": "effects", "effects": [effect]}))
    late = START.replace(month=7)
    run_folder(folder / "deep" / "second", created=late, title="Coupon", record={"sample": "coupon"})
    four_points(folder / "third", title="cut off")
    (folder / "nothing").mkdir()
    Catalogue(folder).search()
    return folder


@pytest.fixture
def data(made: Path, tmp_path: Path) -> Path:
    """The same with its catalogue, to be changed."""
    return Path(shutil.copytree(made, tmp_path / "data"))


def names(folder: Path, **query: object) -> list[str]:
    return [entry.name for entry in Catalogue(folder).search(Query(**query))]  # type: ignore[arg-type]


def test_a_row_says_what_the_folder_says(made: Path) -> None:
    first, third, second = Catalogue(made).search()
    assert (first.name, second.name, third.name) == ("first", "deep/second", "third")
    assert (first.outcome, first.measured, first.planned, first.wavelengths) == ("finished", 4, 4, "500")
    assert (first.sample, first.operator, first.project) == ("Plate 3", "Ada", "holes")
    assert (first.relative_rmse, first.level_of_agreement, first.rms_t) == (0.021, 0.87, None)
    assert (first.verdict, first.probability) == ("effects: sample_tilt", 0.9)
    # The budget of the example, added up for the best and the worst geometry: 1.2 to 1.4 %.
    assert first.median_relative_u == pytest.approx(0.0126, abs=0.0005)
    assert second.median_relative_u is None
    assert third.outcome == "interrupted"


@pytest.mark.parametrize(
    ("query", "found"),
    [
        ({"sample": "plate"}, ["first"]),
        ({"operator": "ADA"}, ["first"]),
        ({"plan": "coupon"}, ["deep/second"]),
        ({"verdict": "tilt"}, ["first"]),
        ({"state": "interrupted"}, ["third"]),
        ({"state": "finish"}, []),
        ({"since": moment("2026-03-03", "--since")}, ["deep/second"]),
        ({"until": moment("2026-03-02", "--until", end=True)}, ["first", "third"]),
        ({"until": moment("2026-03-02T08:00", "--until", end=True)}, []),
        ({"wavelength": 500.0}, ["first", "third", "deep/second"]),
        ({"wavelength": 50.0}, []),
        ({"conditions": [condition("relative_rmse<0.03")]}, ["first"]),
        ({"conditions": [condition("relative_rmse < 0.02")]}, []),
        ({"conditions": [condition("completeness>=1"), condition("probability>0.5")]}, ["first"]),
        ({"plan": "'; DROP TABLE runs; --"}, []),
    ],
)
def test_runs_are_found(made: Path, query: dict[str, object], found: list[str]) -> None:
    assert names(made, **query) == found


@pytest.mark.parametrize("text", ["relative_rmse", "rmse<1", "relative_rmse<a", "name=1", "rms_t<1; DROP"])
def test_a_condition_that_is_none_is_named(text: str) -> None:
    with pytest.raises(InputError, match="--where: "):
        condition(text)


def test_what_is_unchanged_is_not_read_again(data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = Catalogue(data).search()
    read: list[str] = []

    def counted(folder: Path, name: str) -> object:
        read.append(name)
        return read_entry(folder, name)

    monkeypatch.setattr(store, "read_entry", counted)
    assert Catalogue(data).search() == before
    assert read == []
    (data / "first" / "comparison.json").write_text('{"global": {"relative_rmse": 0.5}}')
    with Journal.reopen(data / "third") as journal:
        journal.record("ended", time=START, outcome="aborted", reason="", measured=4, skipped=0, not_reached=0)
    (data / "deep" / "second" / JOURNAL_NAME).unlink()
    after = {entry.name: entry for entry in Catalogue(data).search()}
    assert sorted(read) == ["first", "third"]
    assert after["first"].relative_rmse == 0.5
    assert after["third"].outcome == "aborted"
    assert "deep/second" not in after
    assert len(Catalogue(data).search(rebuild=True)) == 2
    assert read.count("first") == 2


def damage(file: Path, how: str) -> None:
    if how == "foreign":
        file.write_text("my notes")
    elif how == "damaged":
        file.write_bytes(file.read_bytes()[:100] + b"\xff" * 4000)
    elif how == "older":
        with closing(sqlite3.connect(file)) as database:
            database.execute("ALTER TABLE runs DROP COLUMN verdict")
            database.execute("PRAGMA user_version = 1")
    elif how == "another's":
        with closing(sqlite3.connect(file)) as database:
            database.execute("PRAGMA user_version = 0")
    else:
        with closing(sqlite3.connect(file)) as database:
            database.execute("PRAGMA user_version = 99")


@pytest.mark.parametrize("how", ["foreign", "damaged", "older", "newer", "another's"])
def test_whatever_is_wrong_with_the_file_the_folders_are_read(data: Path, how: str) -> None:
    known = Catalogue(data).search()
    file = data / CATALOGUE_NAME
    damage(file, how)
    content = file.read_bytes() if how in ("foreign", "newer", "another's") else b""
    assert Catalogue(data).search() == known
    if content:  # what is not ours, or of a newer program, stays as it is
        assert file.read_bytes() == content


def test_a_data_folder_that_cannot_be_written_is_read_all_the_same(data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    connect = sqlite3.connect

    def refuse(file: str | Path, **options: float) -> sqlite3.Connection:
        if file != ":memory:":
            raise sqlite3.OperationalError("attempt to write a readonly database")
        return connect(file, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(sqlite3, "connect", refuse)
    (data / CATALOGUE_NAME).unlink()
    assert len(Catalogue(data).search()) == 3
    assert not (data / CATALOGUE_NAME).exists()


def test_damaged_folders_are_listed_with_what_is_the_matter(data: Path) -> None:
    journal = data / "third" / JOURNAL_NAME
    journal.write_bytes(journal.read_bytes().replace(b"cut off", b"cut 0ff", 1))
    (data / "first" / "comparison.json").write_text("{")
    found = {entry.name: entry for entry in Catalogue(data).search()}
    assert found["third"].outcome == "damaged"
    assert "line 1: the line, or one before it, was changed" in found["third"].problem
    assert found["first"].outcome == "finished"
    assert "comparison.json: not JSON" in found["first"].problem


def test_a_run_that_a_program_is_writing_is_running(tmp_path: Path) -> None:
    folder = tmp_path / "data" / "now"
    folder.mkdir(parents=True)
    with Journal.create(folder, header()) as journal:
        references(journal)
        journal.record("point", index=0, **reading(geometry(60.0), 0.3, 60.0))
        assert names(tmp_path / "data", state="running") == ["now"]
    assert names(tmp_path / "data", state="running") == []
    assert names(tmp_path / "data", state="interrupted") == ["now"]


def test_the_command_lists_what_a_search_finds(data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = data.parent / "found.json"
    words = ("--sample", "plate", "--since", "2026-03-01", "--where", "relative_rmse<0.03", "--json", out)
    assert status("runs", "list", data, *words) == 0
    assert [run["folder"] for run in json.loads(out.read_text())] == [f"{data}/first"]
    assert "2.10" in capsys.readouterr().out
    assert status("runs", "list", data, "--state", "halted") == 0
    assert "that the search holds for" in capsys.readouterr().out
    assert status("runs", "list", data, "--since", "yesterday") == 2
    assert "--since: found 'yesterday'; expected a date" in capsys.readouterr().err

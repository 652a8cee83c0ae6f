"""Runs on a store: brought once, brought again when they change, listed, verified, never replaced unasked."""

import json
import uuid
from pathlib import Path

import fsspec
import pytest
from example_runs import four_points, status

from instrument.dataset import rebuild_run, write_run
from instrument.errors import InputError
from instrument.exchange.stores import brought, pull, push
from instrument.journal import JOURNAL_NAME


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    run = four_points(tmp_path_factory.mktemp("here") / "plate", record={"sample": "plate 3"})
    write_run(rebuild_run(run), run / "run.nc")
    (run / "figures").mkdir()
    (run / "figures" / "plane.png").write_bytes(b"picture")
    return run


@pytest.fixture
def url(folder: Path) -> str:
    """The run on a store in memory, under a name of its own."""
    address = f"memory://laboratory-{uuid.uuid4().hex}/plate"
    push(folder, address)
    return address


def store_of(url: str) -> tuple[fsspec.AbstractFileSystem, str]:
    return fsspec.core.url_to_fs(url)


def test_a_run_comes_back_as_it_was(folder: Path, url: str, tmp_path: Path) -> None:
    assert pull(url, tmp_path / "back") == 5
    for path in (path for path in folder.rglob("*") if path.is_file()):
        assert (tmp_path / "back" / path.relative_to(folder)).read_bytes() == path.read_bytes()
    with pytest.raises(InputError, match="exists already and is not an empty folder"):
        pull(url, tmp_path / "back")


def test_every_command_that_reads_a_run_takes_a_url(
    folder: Path, url: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert status("runs", "show", url) == 0
    assert url in capsys.readouterr().out
    assert status("exchange", "csv", f"{url}/run.nc", tmp_path / "a.csv") == 0
    assert len((tmp_path / "a.csv").read_text().splitlines()) == 5
    assert status("runs", "list", url.rsplit("/", 1)[0], "--sample", "plate", "--json", tmp_path / "list.json") == 0
    assert [run["folder"] for run in json.loads((tmp_path / "list.json").read_text())] == [url]
    assert not (brought(url) / "figures").exists()


def test_a_file_is_brought_again_when_it_has_changed_and_only_then(url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    store, root = store_of(url)
    copy = brought(url)
    assert (copy / "run.nc").exists()
    fetched: list[str] = []
    get_file = type(store).get_file

    def counted(self: fsspec.AbstractFileSystem, remote: str, local: str, **options: object) -> None:
        fetched.append(remote.rsplit("/", 1)[1])
        get_file(self, remote, local, **options)

    monkeypatch.setattr(type(store), "get_file", counted)
    assert brought(url) == copy
    assert fetched == []
    store.pipe_file(f"{root}/{JOURNAL_NAME}", b"something else")
    store.rm_file(f"{root}/run.nc")
    brought(url)
    assert fetched == [JOURNAL_NAME]
    assert (copy / JOURNAL_NAME).read_bytes() == b"something else"
    assert not (copy / "run.nc").exists()


def test_a_run_that_is_gone_from_the_store_is_gone_from_the_list(
    folder: Path, url: str, capsys: pytest.CaptureFixture[str]
) -> None:
    data = url.rsplit("/", 1)[0]
    push(folder, f"{data}/second")
    assert status("runs", "list", data) == 0
    assert "second" in capsys.readouterr().out
    store, root = store_of(url)
    store.rm(root, recursive=True)
    assert status("runs", "list", data) == 0
    said = capsys.readouterr().out
    assert "second" in said
    assert "plate " not in said.replace("plate 3", "")


def test_nothing_on_a_store_is_replaced_without_force(folder: Path, url: str) -> None:
    with pytest.raises(InputError, match="exists already; choose another name, or replace its files with --force"):
        push(folder, url)
    assert push(folder, url, force=True) == 5
    with pytest.raises(InputError, match=r"expected a URL like s3://bucket/runs/name"):
        push(folder, "runs/plate")


def test_a_damaged_run_is_pulled_and_named(url: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    store, root = store_of(url)
    content = store.cat_file(f"{root}/plan.toml")
    store.pipe_file(f"{root}/plan.toml", content + b"\n# changed")
    assert status("exchange", "pull", url, tmp_path / "back") == 1
    assert "plan.toml: changed since the run was started" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("url", "said"),
    [
        ("memory://nothing-there/run", "no such run in the store"),
        ("nosuch://bucket/run", "Protocol not known: nosuch"),
        ("s3://bucket/run", "[Ii]nstall s3fs"),
    ],
)
def test_what_cannot_be_read_is_named_with_its_url(url: str, said: str) -> None:
    with pytest.raises(InputError, match=f"{url}: .*{said}"):
        brought(url)


def test_a_path_of_this_machine_is_itself(tmp_path: Path) -> None:
    assert brought(str(tmp_path)) == tmp_path
    assert brought("runs/odd:name") == Path("runs/odd:name")
    assert brought(f"file://{tmp_path}").is_dir()

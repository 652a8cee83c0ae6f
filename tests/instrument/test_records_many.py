"""Many runs at once: folders and stores of them, verified and compared, here and on a cluster."""

import json
import shutil
import uuid
from pathlib import Path

import pytest
from example_runs import four_points, status

from instrument.dataset import rebuild_run, write_run
from instrument.errors import InputError
from instrument.exchange.many import run_folders, verify_all
from instrument.exchange.stores import push


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two runs as they were measured, and one that was changed."""
    folder = tmp_path_factory.mktemp("data")
    for name, factor in (("a", 1.0), ("b", 1.01)):
        four_points(folder / name, brf=tuple(factor * brf for brf in (0.3, 0.4, 0.5, 0.6)))
        write_run(rebuild_run(folder / name), folder / name / "run.nc")
    shutil.copytree(folder / "a", folder / "laboratory" / "c")
    (folder / "laboratory" / "c" / "plan.toml").write_text("version = 1\n")
    (folder / "notes").mkdir()
    return folder


@pytest.fixture
def url(data: Path) -> str:
    """The first two on a store in memory."""
    address = f"memory://many-{uuid.uuid4().hex}"
    for name in ("a", "b"):
        push(data / name, f"{address}/{name}")
    return address


def test_a_folder_or_a_store_stands_for_the_runs_in_it(data: Path, url: str) -> None:
    assert run_folders([str(data)]) == [str(data / name) for name in ("a", "b", "laboratory/c")]
    assert run_folders([str(data / "b"), url + "/"]) == [str(data / "b"), f"{url}/a", f"{url}/b"]
    assert run_folders([f"{url}/b"]) == [f"{url}/b"]
    with pytest.raises(InputError, match=r"/b: named twice"):
        run_folders([url, f"{url}/b"])
    with pytest.raises(InputError, match="no such run in the store"):
        run_folders([f"{url}/none"])


def test_every_run_is_verified_and_the_changed_one_is_named(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert status("runs", "verify", data, "--json", tmp_path / "v.json") == 1
    assert "2 of 3 runs are as they were measured" in capsys.readouterr().out
    found = {Path(one["folder"]).name: one for one in json.loads((tmp_path / "v.json").read_text())}
    assert {name: one["passed"] for name, one in found.items()} == {"a": True, "b": True, "c": False}
    assert [check["name"] for check in found["c"]["checks"] if not check["passed"]] == ["plan.toml"]
    assert status("runs", "verify", data / "a", data / "b") == 0


def test_what_is_no_run_fails_among_others_and_is_refused_alone(data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert status("runs", "verify", data / "notes") == 2
    capsys.readouterr()
    assert status("runs", "verify", data / "a", data / "notes") == 1
    assert "holds no journal.jsonl" in " ".join(capsys.readouterr().out.split())


def test_every_run_is_compared_with_the_first(
    data: Path, url: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ("runs", "compare", data / "a", f"{url}/b", data / "laboratory" / "c", "--json", tmp_path / "c.json")
    assert status(*words) == 1
    assert "1.0100" in capsys.readouterr().out
    other, same = json.loads((tmp_path / "c.json").read_text())
    assert other["mean_ratio"] == pytest.approx(1.01)
    assert "holds the same measurement" in same["problem"]


@pytest.mark.slow
@pytest.mark.filterwarnings("default")
def test_a_cluster_gives_the_same(data: Path, url: str) -> None:
    distributed = pytest.importorskip("distributed", reason="needs the extra: pip install 'goniotwin[cluster]'")
    runs = run_folders([str(data), url])
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None, protocol="tcp"
    ) as cluster:
        there = verify_all(runs, address=cluster.scheduler_address)
    assert there == verify_all(runs)
    assert [result.passed for result in there] == [True, True, False, True, True]

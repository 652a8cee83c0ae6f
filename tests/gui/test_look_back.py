"""The page Look back on real runs: what the catalogue finds, and what can be done with it."""

from __future__ import annotations

import shutil
import sys
import time
from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import pytest
from PySide6.QtCore import QSettings, Qt
from pytestqt.qtbot import QtBot

from gui.comparison import score
from gui.model import ScanModel
from gui.pages.base import Desk
from gui.pages.runs import RunsPage
from gui.past_runs import PastRun, figures_of, past_runs
from gui.run_table import RunTable
from gui.setup import Setup
from gui.theme import LIGHT
from instrument.catalogue.entry import Entry
from instrument.journal import Journal

sys.path.insert(0, str(Path(__file__).parents[1] / "instrument"))  # journals and run folders
from example_runs import START, four_points


@pytest.fixture(scope="module")
def laboratory(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a finished run and one that was cut off, as the journal writes them, and a folder that is none."""
    folder = tmp_path_factory.mktemp("look-back")
    whole = four_points(folder / "whole", title="Two directions", record={"sample": "Plate 3", "operator": "Ada"})
    with Journal.reopen(whole) as journal:
        journal.record("ended", time=START, outcome="finished", reason="", measured=4, skipped=0, not_reached=0)
    (whole / "comparison.json").write_text('{"global": {"relative_rmse": 0.021}}')
    cut = four_points(folder / "cut", created=START - timedelta(days=1), record={"sample": "Plate 3"})
    lines = (cut / "journal.jsonl").read_bytes().splitlines(keepends=True)
    kept = next(number for number, line in enumerate(lines) if b'"kind":"point"' in line)
    (cut / "journal.jsonl").write_bytes(b"".join(lines[: kept + 1]))
    (folder / "nothing").mkdir()
    return folder


@pytest.fixture
def page(laboratory: Path, tmp_path: Path, qtbot: QtBot) -> RunsPage:
    settings, model = QSettings(str(tmp_path / "settings.ini"), QSettings.Format.IniFormat), ScanModel(score)
    page = RunsPage(Desk(model, Setup(simulate=True, runs=laboratory), settings, LIGHT, feed=model.apply))
    qtbot.addWidget(page)
    page.show()
    page.enter()
    qtbot.waitUntil(lambda: page.table.rowCount() == 2, timeout=30_000)
    return page


def shown(page: RunsPage) -> list[str]:
    return sorted(run.folder.name for run in page.table.runs)


def text(page: RunsPage, row: int, head: str) -> str:
    model = page.table.model()
    heads = [model.headerData(n, Qt.Orientation.Horizontal) for n in range(model.columnCount())]
    return str(model.index(row, heads.index(head)).data())


def test_runs_stand_in_the_list_with_plan_date_state_and_figure(page: RunsPage) -> None:
    row = [run.folder.name for run in page.table.runs].index("whole")
    said = [text(page, row, head) for head in ("Title", "Points", "State", "Operator", "Sample", "Difference")]
    assert said == ["Two directions", "4 of 4", "finished", "Ada", "Plate 3", "2.1 %"]
    assert text(page, row, "Started (UTC)") == page.table.runs[row].row.created[:16].replace("T", " ")
    assert text(page, 1 - row, "State") == "interrupted"
    assert page.where.text().endswith("2 runs")


def test_a_search_finds_by_state_sample_date_and_figure_of_merit(page: RunsPage, qtbot: QtBot) -> None:
    def finds(*names: str) -> None:
        qtbot.waitUntil(lambda: shown(page) == sorted(names) and not page._list.busy, timeout=30_000)

    search = page.search
    search.state.setCurrentIndex(search.state.findData("interrupted"))
    finds("cut")
    search.state.setCurrentIndex(0)
    finds("cut", "whole")
    search.fields["sample"].setText("plate 4")
    finds()
    search.fields["sample"].setText("plate 3")
    finds("cut", "whole")
    search.figure.setCurrentIndex(search.figure.findData("relative_rmse"))
    search.fields["bound"].setText("0.03")
    finds("whole")
    search.fields["bound"].setText("0.02")
    finds()
    search.fields["bound"].setText("")
    finds("cut", "whole")
    search.fields["until"].setText("2001-01-01")
    finds()


def test_a_wrong_date_is_marked_where_it_is_and_the_list_stays(page: RunsPage, qtbot: QtBot) -> None:
    field = page.search.fields["since"]
    field.setText("yesterday")
    qtbot.waitUntil(lambda: bool(field.property("wrong")), timeout=30_000)
    assert "expected a date like" in page.problem.text()
    assert page.table.rowCount() == 2
    field.setText("2001-01-01")
    qtbot.waitUntil(lambda: not field.property("wrong"), timeout=30_000)
    assert page.problem.text() == ""
    page.search.fields["bound"].setText("0.03")  # of which figure?
    qtbot.waitUntil(lambda: bool(page.search.fields["bound"].property("wrong")), timeout=30_000)


def test_what_can_be_done_depends_on_what_is_chosen(page: RunsPage, qtbot: QtBot) -> None:
    names = [run.folder.name for run in page.table.runs]
    enabled = lambda: {name for name, button in page.buttons.items() if button.isEnabled()}  # noqa: E731
    page.table.selectRow(names.index("whole"))
    assert enabled() == {"open", "diagnose", "report", "folder"}
    page.table.selectRow(names.index("cut"))
    assert enabled() == {"open", "resume", "diagnose", "report", "folder"}
    page.table.selectAll()
    assert enabled() == {"compare"}
    page._compare()
    qtbot.waitUntil(lambda: hasattr(page, "comparison"), timeout=30_000)
    assert len(page.comparison.model.points) == 1
    page.comparison.close()
    page.table.selectRow(names.index("whole"))
    page._open_run()
    qtbot.waitUntil(lambda: page.model.measured == 4, timeout=30_000)
    assert page.model.title == "Two directions"


def test_a_run_that_is_being_written_cannot_be_resumed(laboratory: Path, tmp_path: Path) -> None:
    shutil.copytree(laboratory, tmp_path / "runs")
    assert {run.folder.name: run.resumable for run in past_runs(tmp_path / "runs")} == {"cut": True, "whole": False}
    with Journal.reopen(tmp_path / "runs" / "cut") as journal:
        journal.record("note", text="it goes on")
        busy = {run.folder.name: run for run in past_runs(tmp_path / "runs")}
        assert busy["cut"].row.outcome == "running"
        assert not busy["cut"].resumable


def test_figures_of_an_export_are_not_the_runs_own(tmp_path: Path) -> None:
    for name in ("figures/a.png", "b.png", "export-1/c.png"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(b"")
    assert [path.name for path in figures_of(tmp_path)] == ["b.png", "a.png"]


def test_ten_thousand_runs_are_listed_and_sorted_without_holding_the_window_up(qtbot: QtBot) -> None:
    row = Entry(created="2026-03-02T08:00:00Z", title="x", planned=9, outcome="finished")
    runs = [PastRun(Path("r"), replace(row, name=f"{n:05d}", measured=(7 * n) % 10_000)) for n in range(10_000)]
    table = RunTable(lambda: LIGHT)
    qtbot.addWidget(table)
    table.show()
    began = time.thread_time()
    table.put(runs)
    table.grab()
    listed = time.thread_time() - began
    table.sortByColumn(2, Qt.SortOrder.DescendingOrder)
    assert table.rowCount() == 10_000
    assert [run.row.measured for run in table.runs[:3]] == [9999, 9998, 9997]
    assert listed < 0.25  # an item for each cell took 1.5 s

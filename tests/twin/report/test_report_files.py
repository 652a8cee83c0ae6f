"""What a report is written to: nothing outside the file, nothing unsaid, nothing replaced."""

from __future__ import annotations

import csv
import hashlib
import json
import re
import shutil
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from example_runs import PLAN, four_points, header, minimal_run, status
from report_samples import pair, sketch

from gui.diagnosis_words import how_far_of
from instrument.amending import amend
from instrument.journal import Journal
from instrument.run_build import rebuild_run
from instrument.run_write import write_prediction, write_run
from twin.report.build import build_report
from twin.report.document import Document, Points, Section, Table, Words
from twin.report.output import write_figures
from twin.report.paper import column_widths, drawable, pdf_of, wrapped
from twin.report.sources import Named, read_sources
from twin.report.web import html_of

EVIL = "<script>alert('x')</script> & $a_1^2$"


class Page(HTMLParser):
    """Tags, references and text of a page; complains about tags that are not closed."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[str] = []
        self.references: list[str] = []
        self.words = ""
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.references += [value for name, value in attrs if name in ("src", "href", "data", "srcset", "action")]
        if tag not in ("meta", "img"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words += data


def names(document: Document) -> set[str]:
    return {one.name for one in (*document.plots(), *document.tables())}


def reasons(document: Document) -> dict[str, str]:
    return {one.what: one.why for one in document.left_out()}


@pytest.fixture(scope="module")
def page(document) -> str:
    return html_of(sketch(document))


def test_a_page_refers_to_nothing_outside_itself(document, page):
    found = Page(page)
    assert all(reference.startswith(("#s", "data:image/png;base64,")) for reference in found.references)
    assert not re.search(r"url\(|@import|<link|<script", page)
    assert found.tags.count("img") == len(document.plots()) == 11


def test_every_counterpart_is_there_or_left_out_with_a_reason(document, page):
    words = Page(page).words
    for number in range(10, 21):
        assert f"Counterpart of Fig. {number}." in words
    for number in ("I", "III", "IV", "V", "VI"):
        assert f"Counterpart of Table {number}." in words
    why = reasons(document)["Table II: uncertainty budget of the measurement"]
    assert why == "no uncertainty components; u_brf alone makes no budget"
    assert f"Left out: Table II: uncertainty budget of the measurement. Reason: {why}." in words


def test_a_bare_run_says_what_its_report_cannot_have(tmp_path):
    write_run(minimal_run(), tmp_path / "bare.csv")
    document = build_report(read_sources(Named(tmp_path / "bare.csv")))
    assert {plot.name for plot in document.plots()} == {"fig_12_sample_maps", "fig_19_sample_all"}
    assert set(reasons(document)) == {
        "Table I: dimensions of the sample",
        "Table III, Figs. 10, 11 and 18: measurement of the material",
        "Table II: uncertainty budget of the measurement",
        "Fig. 20: the simulation of every plane",
        "Tables V and VI, Figs. 13 to 17: measurement beside simulation",
        "diagnosis",
        "reference history",
        "interruptions, resumptions, notes and amendments",
        "flags",
        "verification of the run folder",
    }
    last = document.sections[-1].blocks[0]
    assert isinstance(last, Table)
    assert {row[0] for row in last.rows} == set(reasons(document))


def test_a_run_without_a_usable_point_says_so(tmp_path):
    write_run(minimal_run().assign(quality_flag=("point", np.ones(3, dtype=np.int8))), tmp_path / "run.nc")
    document = build_report(read_sources(Named(tmp_path / "run.nc")))
    assert document.plots() == []
    assert "flagged" in reasons(document)["Table IV, Figs. 12 and 19: measurement of the sample"]


def test_a_measured_zero_costs_the_comparison_alone(files, tmp_path):
    run, _ = pair()
    run["brf"].values[4] = 0.0
    write_run(run, tmp_path / "run.nc")
    document = build_report(read_sources(Named(tmp_path / "run.nc", files / "prediction.nc")))
    assert {"fig_12_sample_maps", "fig_20_simulation_all"} <= names(document)
    assert "found 0" in reasons(document)["Tables V and VI, Figs. 13 to 17: measurement beside simulation"]


def test_a_flat_sample_is_the_material(files, tmp_path):
    (tmp_path / "artifact.toml").write_text("plate_thickness = 5.0\n")
    named = Named(files / "run.nc", artifact=tmp_path / "artifact.toml")
    document = build_report(read_sources(named))
    assert {"fig_10_material_maps", "fig_18_material_all", "table_03_material_space"} <= names(document)
    assert "fig_12_sample_maps" not in names(document)
    assert "flat" in reasons(document)["Table IV, Figs. 12 and 19: measurement of the sample"]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    said = {"operator": EVIL, "sample": "plate 7"}
    run = four_points(tmp_path / "run", record=said)
    write_run(rebuild_run(run), run / "run.nc")
    return run


def test_words_of_people_stay_words(folder):
    amend(folder, {"sample": "<b>plate 8"}, by="B. <i>", reason='"wrong" label')
    document = build_report(read_sources(Named(folder)))
    text = html_of(sketch(document))
    assert "<script" not in text
    assert "<b>" not in text
    found = Page(text)
    assert EVIL in found.words
    assert "<b>plate 8" in found.words
    amended = next(table for table in document.tables() if table.name == "amendments")
    assert [list(row[1:]) for row in amended.rows] == [["B. <i>", "sample", "plate 7", "<b>plate 8", '"wrong" label']]


def test_a_run_folder_tells_its_digests_and_what_was_changed(folder):
    (folder / "plan.toml").write_text(PLAN + "\n")
    found = {table.name: table for table in build_report(read_sources(Named(folder))).tables()}
    digest = hashlib.sha256((folder / "run.nc").read_bytes()).hexdigest()
    assert ["run", "run.nc", digest] in found["digests"].rows
    assert {row[1] for row in found["digests"].rows} >= {"journal.jsonl", "plan.toml", "facility.toml"}
    verified = {row[0]: row[1] for row in found["verification"].rows}
    assert verified.pop("plan.toml") == "bad"
    assert set(verified.values()) == {"good"}


def test_a_running_scan_has_a_report_without_a_run_file(folder):
    (folder / "run.nc").unlink()
    sources = read_sources(Named(folder))
    assert sources.run.sizes["point"] == 4
    assert "journal" in sources.run_origin


def test_a_scan_without_a_point_has_a_report_of_its_course(tmp_path):
    with Journal.create(tmp_path, header(record={"operator": "A. Muster"})):
        pass
    document = build_report(read_sources(Named(tmp_path)))
    assert document.plots() == []
    assert "no point was measured" in reasons(document)["Table IV, Figs. 12 and 19: measurement of the sample"]
    assert "record" in names(document)


def test_figures_stand_beside_the_data_behind_them(document, tmp_path):
    few = Document("few", "", [Section("one", [document.plots()[0], document.tables()[0]])])
    write_figures(few, tmp_path / "figures")
    plot = document.plots()[0]
    content = json.loads((tmp_path / "figures" / "contents.json").read_text())
    (entry,) = content["figures"]
    assert (entry["name"], entry["counterpart"]) == ("fig_12_sample_maps", "Fig. 12")
    starts = {"png": b"\x89PNG", "svg": b"<?xml", "pdf": b"%PDF"}
    for file in entry["files"]:
        assert (tmp_path / "figures" / file).read_bytes().startswith(starts[file.rpartition(".")[2]])
    with (tmp_path / "figures" / entry["data"]).open() as handle:
        rows = list(csv.DictReader(handle))
    assert [float(row["brf"]) for row in rows] == plot.data["brf"].tolist()
    assert [float(row["sensor_zenith"]) for row in rows] == plot.data["sensor_zenith"].tolist()
    assert {path.name for path in (tmp_path / "figures").iterdir()} == {
        *entry["files"],
        entry["data"],
        "contents.json",
        f"{document.tables()[0].name}.csv",
    }


def test_a_figure_without_room_waits_for_the_next_sheet(document):
    # A sheet has 10.2 inch for text; eight lines of words take 1.3, a high figure with its caption more than 9.
    blocks = [Points(["a word"] * 8), document.plots()[0], Words("a word")]
    few = Document(EVIL, "", [Section("one", blocks)])
    assert len(re.findall(rb"/Type /Page\b", pdf_of(sketch(few, 6.0)))) == 1
    content = pdf_of(sketch(few, 8.7))
    assert content.startswith(b"%PDF")
    assert len(re.findall(rb"/Type /Page\b", content)) == 2
    assert pdf_of(sketch(few, 8.7)) == content


def test_text_is_broken_where_the_line_ends():
    lines = wrapped("a word and " + "x" * 300, 9.0, "normal", 3.0)
    assert lines[0] == "a word and"
    assert "".join(lines[1:]) == "x" * 300
    assert len(wrapped("x" * 300, 9.0, "normal", 6.0)) < len(lines) - 1


def test_wide_columns_give_way_to_narrow_ones():
    table = Table("t", "", ["a", "b"], [["1", "word " * 100]])
    narrow, wide = column_widths(table)
    assert narrow == pytest.approx(0.32, abs=0.01)
    assert narrow + wide + 0.12 == pytest.approx(7.1, abs=0.01)


def test_characters_without_a_picture_become_squares():
    assert drawable("5 µm Ω \N{CJK UNIFIED IDEOGRAPH-6E2C}\t.") == "5 µm Ω \N{WHITE SQUARE} ."


def test_a_gist_stands_first(document):
    first = document.sections[0].blocks[0]
    assert isinstance(first, Words)
    assert first.text.startswith("Simulation and measurement differ by 3.17 % on average over 15 points")


@pytest.fixture
def named(files, tmp_path):
    for name in ("run.nc", "prediction.nc"):
        shutil.copy(files / name, tmp_path / name)
    return tmp_path


def refused(capsys, *words: object) -> str:
    assert status("report", *words) == 2
    return " ".join(capsys.readouterr().err.split())


def test_nothing_is_replaced_unless_asked(named, capsys, monkeypatch):
    monkeypatch.setattr("twin.report.output.html_of", lambda document: "new")
    (named / "run-report.html").write_text("old")
    assert "--force" in refused(capsys, named / "run.nc")
    assert (named / "run-report.html").read_text() == "old"
    assert status("report", named / "run.nc", "--force") == 0
    assert (named / "run-report.html").read_text() == "new"
    (named / "figures").mkdir()
    (named / "figures" / "mine.txt").write_text("")
    assert "is not empty" in refused(
        capsys, named / "run.nc", "--out", named / "other.html", "--figures", named / "figures"
    )
    assert not (named / "other.html").exists()


def test_outputs_are_named_by_what_they_are(named, capsys):
    assert "expected .pdf" in refused(capsys, named / "run.nc", "--pdf", named / "report.html")
    assert "there is no folder" in refused(capsys, named / "run.nc", "--out", named / "none" / "report.html")
    assert "no such file" in refused(capsys, named / "none.nc")


def test_damaged_and_foreign_files_are_refused(named, capsys):
    whole = (named / "run.nc").read_bytes()
    (named / "half.nc").write_bytes(whole[: len(whole) // 2])
    assert "damaged or truncated" in refused(capsys, named / "half.nc")
    (named / "text.nc").write_text("not a run")
    assert "not a netCDF-4 file" in refused(capsys, named / "text.nc")
    (named / "empty").mkdir()
    assert "expected a run folder" in refused(capsys, named / "empty")
    assert not list(named.glob("*.html"))


def test_a_journal_of_the_future_is_refused(folder, capsys):
    lines = (folder / "journal.jsonl").read_bytes().split(b"\n")
    first = json.loads(lines[0]) | {"version": 2}
    (folder / "journal.jsonl").write_bytes(b"\n".join([json.dumps(first).encode(), *lines[1:]]))
    assert "version 2; this program reads version 1" in refused(capsys, folder)


def test_a_prediction_of_other_points_is_refused(named, capsys):
    other = minimal_run().assign(u_brf_monte_carlo=("point", np.full(3, 0.001), {"units": "1"}))
    other["wavelength"] = other["wavelength"] + 100
    write_prediction(other, named / "other.nc")
    assert "predicts none of the 15 measured points" in refused(capsys, named / "run.nc", named / "other.nc")


DIAGNOSIS = {
    "consistency": {"consistent": False, "p_value": 1e-9, "dark_uncertainty": 0.012},
    "where": [{"points": [12, 13], "description": "sensor zenith <above> 60 degrees", "strength": 6.1}],
    "verdict": "effects",
    "effects": [
        {
            "effect": "sensor_zenith_offset",
            "class": ["sensor_zenith_offset", "backlash"],
            "probability": 0.97,
            "parameters": {"angle_deg": {"value": 0.5234, "u": 0.0612}},
        }
    ],
    "ranking": [{"effect": "sensor_zenith_offset", "class": ["sensor_zenith_offset", "backlash"], "probability": 0.97}],
    "gap": {
        "rms_before": 0.023,
        "rms_after": 0.011,
        "heldout_rms_before": 0.022,
        "heldout_rms_after": 0.012,
        "shrink": 0.49,
        "shrink_interval": [0.41, 0.56],
        "removable": 0.53,
    },
    "next_scan": [
        {"description": "again", "separates": [["a", "b"]] * 9, "gain_nats": 18.4, "duration_s": 750, "plan": "..."}
    ],
    "from the future": 1,
}


@pytest.mark.parametrize(
    ("withheld", "said", "unsaid"),
    [
        (None, "1.20 % after what was found is added", "No correction is offered"),
        (0.025, "with it those slices would differ by 2.50 %", "after what was found is added"),
    ],
)
def test_a_correction_that_is_withheld_is_said(named, withheld: float | None, said: str, unsaid: str):
    told = DIAGNOSIS | {"gap": {**DIAGNOSIS["gap"], "heldout_rms_withheld": withheld}}
    (named / "diagnosis.json").write_text(json.dumps(told))
    document = build_report(read_sources(Named(named / "run.nc", diagnosis=named / "diagnosis.json")))
    text = repr(document)
    assert said in text
    assert unsaid not in text
    in_the_window = " ".join(how_far_of(told))
    assert ("it would leave 2.50 %" in in_the_window) == (withheld is not None)
    assert ("after what was found is added" in in_the_window) == (withheld is None)


def test_a_diagnosis_is_told(named):
    (named / "diagnosis.json").write_text(json.dumps(DIAGNOSIS))
    document = build_report(read_sources(Named(named / "run.nc", diagnosis=named / "diagnosis.json")))
    found = {table.name: table for table in document.tables()}
    # Both to the second digit of the uncertainty.
    effect = ["sensor zenith offset", "0.970", "angle_deg", "0.523", "0.061", "not stated"]
    assert [list(row) for row in found["diagnosis_effects"].rows] == [effect]
    assert list(found["diagnosis_effect_ranking"].rows[0]) == ["sensor zenith offset", "0.970", "backlash"]
    told = "a from b; a from b; a from b; and 6 more pairs"
    assert list(found["diagnosis_next_scan"].rows[0]) == ["again", told, "18.4", "12.5"]
    plots = {plot.name: plot for plot in document.plots()}
    located = plots["diagnosis_where"].data
    assert np.flatnonzero(located["strength"]).tolist() == [12, 13]
    assert located["sensor_azimuth"][12] == 130.0
    shown = plots["diagnosis_gap"].figure().axes[0].containers[0]
    assert [bar.get_width() for bar in shown] == pytest.approx([2.2, 1.2, 2.2 * 0.47])
    assert plots["diagnosis_gap"].data["rms_relative_difference"] == pytest.approx([0.022, 0.012, 0.022 * 0.47])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"verdict": "perhaps"}, "verdict"),
        ({"gap": {}}, "gap.rms_before"),
        ({"where": [{"points": [15], "description": "", "strength": 1.0}]}, "diagnosis of another run"),
        ({"ranking": [{"effect": "a", "probability": 2}]}, "ranking.0.probability"),
    ],
)
def test_a_foreign_diagnosis_is_refused(named, capsys, change, message):
    (named / "d.json").write_text(json.dumps(DIAGNOSIS | change))
    assert message in refused(capsys, named / "run.nc", "--diagnosis", named / "d.json")


def test_what_is_no_diagnosis_is_refused(named, capsys):
    (named / "d.json").write_text("[1, 2")
    assert "not JSON" in refused(capsys, named / "run.nc", "--diagnosis", named / "d.json")
    (named / "d.json").write_text("[1, 2]")
    assert "found list" in refused(capsys, named / "run.nc", "--diagnosis", named / "d.json")
    (named / "d.json").write_text("{}")
    assert "verdict: missing" in refused(capsys, named / "run.nc", "--diagnosis", named / "d.json")


def test_the_diagnosis_of_another_file_is_pointed_out(named):
    made = {"made_with": {"inputs": {"run": {"file": "other.nc", "sha256": "0" * 64}}}}
    (named / "d.json").write_text(json.dumps(DIAGNOSIS | made))
    document = build_report(read_sources(Named(named / "run.nc", diagnosis=named / "d.json")))
    said = [block.text for section in document.sections for block in section.blocks if isinstance(block, Words)]
    assert any(text.startswith("Attention: the diagnosis was made of other.nc") for text in said)

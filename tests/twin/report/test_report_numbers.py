"""Numbers in tables and figures of a report, against values worked out by hand."""

from __future__ import annotations

import csv
import io

import numpy as np
import pytest
from example_runs import four_points, geometry, header, reading, references
from report_samples import U_MEASURED, dataset, geometries

from instrument.journal import Journal, read_journal
from instrument.run_build import rebuild_run
from twin.report.course import alike, interruptions, reference_columns
from twin.report.document import csv_of
from twin.report.facets import by_light, by_plane, mirrored_rows
from twin.report.uncertain import budget_blocks
from twin.report.words import listed


def table(document, name):
    return next(one for one in document.tables() if one.name == name)


def row(found, start):
    return next(list(cells) for cells in found.rows if cells[0] == start)


def plot(document, name):
    return next(one for one in document.plots() if one.name == name)


def test_metrics_of_planes_and_of_table_six(document):
    # dR* is 3, -1.5 and 5 %, so t' = 1.5, -0.75 and 2.5; with k = 0.8 n' is 0.73401, 0.94062 and 0.26599:
    # Phi(0.625) - Phi(-4.375), Phi(1.5625) - Phi(-3.4375), Phi(-0.625) - Phi(-5.625).
    cells = row(table(document, "planes"), "ill. 15°, azimuth 50°")
    assert cells[1:6] == ["3", "3.17", "0.0348", "1.74", "0.65"]
    assert cells[6:] == ["33/33/33", "33/33/33", "0/67/33"]
    six = table(document, "table_06_agreement")
    assert row(six, "level of agreement (global)") == ["level of agreement (global)", "0.65", "0.86", "0.60"]
    assert row(six, "relative RMSE (in-plane)") == ["relative RMSE (in-plane)", "0.035", "0.026", "0.19"]


def test_limits_of_table_five(document):
    assert table(document, "table_05_categories").rows == [
        ["|ΔR*| / %", "0 - 2", "2 - 4", "4+"],
        ["|t'|", "0 - 1", "1 - 2", "2+"],
        ["n' / %", "95+", "95 - 50", "50 - 0"],
    ]


def test_dimensions_of_table_one(document):
    found = table(document, "table_01_dimensions")
    # Diameters 2.0, 2.2, 2.4, 2.6: standard deviation 0.26; u 0.01 three times and 0.03.
    assert row(found, "mean hole diameter")[1:] == ["2.3000", "0.26", "0.015", "mm"]
    # Two spacings of 4 and two of 4.2; both ends of one know their place to 2 um on average.
    assert row(found, "mean hole centre spacing")[1:] == ["4.1000", "0.12", "0.0028", "mm"]
    assert row(found, "hole plate thickness")[1:] == ["1", "", "0.02", "mm"]
    assert row(found, "top of hole plate to top of block")[1:] == ["3", "", "0.03", "mm"]


def test_measured_space_of_table_four(document):
    found = table(document, "table_04_sample_space")
    assert row(found, "sensor azimuth at illumination zenith 0°")[1] == "0, 90°"
    assert row(found, "sensor azimuth at illumination zenith 15°")[1] == "0, 50, 130°"
    assert row(found, "points measured")[1] == "15"
    assert row(found, "combined standard uncertainty")[1] == "1.20 %"


def test_a_budget_is_that_of_table_two(tmp_path):
    run = rebuild_run(four_points(tmp_path / "run"))
    found = next(block for block in budget_blocks(run) if hasattr(block, "rows"))
    # a + (b - a)(zenith/80)^2 at 30 and 60 degrees.
    assert row(found, "measurement noise")[1:] == ["0.54", "0.58", "0.62", "random", "∞"]
    assert row(found, "instrument stability")[1:5] == ["0.82", "0.82", "0.82", "not stated"]
    greatest = np.sqrt(
        np.sum(np.square([0.616875, 0.82, 0.02, 0.01, 0.16, 0.2, 0.21, 0.33625, 0.41375, 0.14, 0.1, 0.5]))
    )
    assert row(found, "combined (k = 1)")[3] == f"{greatest:.2f}"


@pytest.mark.parametrize(
    ("values", "said"),
    [
        (np.arange(-80, 81, 5), "-80 to 80 in steps of 5"),
        ([0, 45, 90, 135], "0, 45, 90, 135"),
        ([0, 50, 75, 105, 130], "0, 50, 75, 105, 130"),
        (np.arange(20) ** 2, "20 values from 0 to 361"),
    ],
)
def test_values_of_a_plan_in_short(values, said):
    assert listed(values) == said


def rows_alike(run, plane, **settings):
    return mirrored_rows(run, by_plane(run)[plane], **settings).tolist()


def test_mirror_images_lie_on_the_other_side_of_the_plane_of_incidence():
    run = dataset(geometries(), brf=np.ones(15))
    # Illumination 15: (40, azimuth 50) is mirrored into (-40, azimuth 130); -30 has no counterpart.
    assert rows_alike(run, 3, isotropic=False) == [14, -1, 12]
    assert rows_alike(run, 4, isotropic=False) == [11, -1, 9]
    assert rows_alike(run, 2, isotropic=False) == [-1, -1, -1]  # in the plane of incidence


def test_at_normal_incidence_a_plane_has_two_equal_halves():
    run = dataset(geometries(), brf=np.ones(15))
    assert rows_alike(run, 0, isotropic=False) == [2, -1, 0]
    assert rows_alike(run, 1, isotropic=True) == [5, -1, 3]


def test_a_turned_array_of_holes_has_no_mirror_in_the_plane_of_incidence():
    run = dataset(geometries(), brf=np.ones(15)).assign_coords(sample_rotation=("point", np.full(15, 30.0)))
    assert rows_alike(run, 3, isotropic=False) == [-1, -1, -1]
    assert rows_alike(run, 3, isotropic=True) == [14, -1, 12]
    diagonal = run.assign_coords(sample_rotation=("point", np.full(15, 45.0)))
    assert rows_alike(diagonal, 3, isotropic=False) == [14, -1, 12]


def test_panels_are_named_by_what_differs():
    run = dataset([(500, 0, 0, 10, 0), (600, 0, 0, 10, 0), (500, 0, 0, 10, 90)], brf=np.ones(3))
    assert [facet.title for facet in by_light(run)] == ["500 nm, ill. 0°", "600 nm, ill. 0°"]
    assert [facet.rows.tolist() for facet in by_light(run)] == [[0, 2], [1]]


def test_the_table_behind_a_figure_has_every_digit():
    columns = {
        "time": np.array(["2026-03-02T08:00:00"], "datetime64[ns]"),
        "x": [0.1 + 0.2],
        "y": [np.nan],
        "z": ["a,b"],
    }
    assert list(csv.reader(io.StringIO(csv_of(columns).decode()))) == [
        ["time", "x", "y", "z"],
        ["2026-03-02T08:00:00.000Z", "0.30000000000000004", "", "a,b"],
    ]


def test_columns_of_different_length_make_no_table():
    with pytest.raises(ValueError, match="shorter"):
        csv_of({"a": [1, 2], "b": [1]})


def two_calibrations(folder):
    folder.mkdir()
    with Journal.create(folder, header()) as journal:
        references(journal)
        journal.record("point", index=0, **reading(geometry(60.0), 0.5, 60.0))
        references(journal, 100.0, light=1.02e-6)
        journal.record("point", index=1, **reading(geometry(30.0), 0.5, 160.0, light=1.02e-6))
    return folder


def test_levels_of_the_reference_are_relative_to_their_mean(tmp_path):
    columns, names = reference_columns(rebuild_run(two_calibrations(tmp_path / "run")))
    assert names == ["500 nm"]
    assert columns["set"].tolist() == [0] * 4 + [1] * 4
    assert columns["level"] == pytest.approx([1 / 1.01] * 4 + [1.02 / 1.01] * 4, rel=1e-6)


def test_interruptions_tell_rests_deaths_and_resumptions(tmp_path):
    folder = tmp_path / "run"
    folder.mkdir()
    start = "2026-03-02T08:00:{:02d}Z"

    def state(old, new, second, reason=""):
        journal.record("state", time=start.format(second), old=old, new=new, reason=reason)

    with Journal.create(folder, header()) as journal:
        state("idle", "connecting", 1)
        state("moving", "suspended", 5, "the interlock is open")
        state("suspended", "moving", 9)
        references(journal, 10.0)
        state("idle", "connecting", 30)
        state("measuring", "aborting", 40, "by hand")
        state("aborting", "aborted", 41, "by hand")
    rows = interruptions(read_journal(folder))
    assert [(cells[1], cells[2]) for cells in rows] == [
        ("suspended", "the interlock is open"),
        ("program ended", "without a word, while moving"),
        ("resumed", ""),
        ("aborted", "by hand"),
    ]
    assert (rows[0][0], rows[0][3]) == ("2026-03-02 08:00:05", "2026-03-02 08:00:09")
    assert rows[1][0] == "2026-03-02 08:00:13"  # the last reading of the reference


def test_a_scan_without_an_end_is_said_to_have_none(tmp_path):
    folder = tmp_path / "run"
    folder.mkdir()
    with Journal.create(folder, header()) as journal:
        journal.record("state", time="2026-03-02T08:00:01Z", old="idle", new="connecting", reason="")
    assert [cells[1] for cells in interruptions(read_journal(folder))] == ["no end recorded"]


def test_notes_that_differ_in_numbers_are_told_once():
    assert alike(["gain 1e+06 -> 1e+07 V/A", "on the stage", "gain 1e+07 -> 1e+06 V/A"]) == [
        "gain 1e+06 -> 1e+07 V/A (the first of 2 that differ in numbers at most)",
        "on the stage",
    ]


def drawn(axes, name):
    return [container for axis in axes for container in axis.containers if container.get_label() == name]


def test_curves_show_the_data_behind_them(document):
    one = plot(document, "fig_19_sample_all")
    axes = one.figure().axes
    assert len(axes) == 5
    shown = drawn(axes, "baseline")
    assert sorted(np.concatenate([c.lines[0].get_ydata() for c in shown])) == sorted(one.data["brf"])
    bars = np.concatenate([np.ptp(np.array(c.lines[2][0].get_segments())[:, :, 1], axis=1) / 2 for c in shown])
    assert bars == pytest.approx(np.full(15, U_MEASURED))
    alike_ = np.concatenate([c.lines[0].get_ydata() for c in drawn(axes, "symmetric")])
    assert len(alike_) == np.isfinite(one.data["brf_symmetric"]).sum() == 8


def test_the_principal_plane_is_in_the_plane_of_incidence(document):
    one = plot(document, "fig_11_material_principal_plane")
    assert set(one.data["sensor_azimuth"]) == {0.0}
    axis = one.figure().axes[0]
    points = np.concatenate([np.stack(c.lines[0].get_data(), axis=-1) for c in axis.containers])
    wanted = np.stack([one.data["sensor_zenith"], one.data["brf"]], axis=-1)
    assert sorted(map(tuple, points)) == sorted(map(tuple, wanted))


def test_measured_and_simulated_values_are_the_comparison(document):
    one = plot(document, "fig_13_planes")
    panels = [axis for axis in one.figure().axes if axis.get_title(loc="left")]
    assert [axis.get_title(loc="left") for axis in panels][3] == "ill. 15°, azimuth 50°"
    lines = [line for axis in panels for line in axis.get_lines() if line.get_label() == "simulated, $k$ = 1, 2"]
    simulated = np.concatenate([line.get_ydata() for line in lines])
    assert sorted(simulated[np.isfinite(simulated)]) == sorted(one.data["simulated"])
    second = plot(document, "fig_14_differences")
    points = [
        y
        for axis in second.figure().axes
        for line in axis.get_lines()
        if line.get_marker() in ("o", "s", "^")
        for y in line.get_ydata()
    ]
    assert sorted(points) == pytest.approx(sorted(100 * second.data["relative_difference"]))


def test_maps_are_coloured_by_their_data(document):
    one = plot(document, "fig_12_sample_maps")
    panels = [axis for axis in one.figure().axes if axis.get_title()][:2]
    coloured = [collection for axis in panels for collection in axis.collections]
    assert np.concatenate([c.get_array() for c in coloured]).tolist() == one.data["brf"].tolist()
    # A cell lies around its point: the first is at zenith 40, azimuth 0.
    corners = coloured[0].get_paths()[0].vertices
    assert corners[:, 0].min() < 40 < corners[:, 0].max()
    assert corners[:, 1].min() < 0 < corners[:, 1].max()


def test_metric_maps_are_coloured_and_marked_by_their_data(document):
    one = plot(document, "fig_15_metrics")
    assert one.data["t_category"].tolist() == [1, 0, 2] * 5
    axes = [axis for axis in one.figure().axes if axis.get_title()]
    # Good ones first, then acceptable and poor ones, each with a marker of its own.
    found = [collection.get_array() for collection in axes[0].collections if collection.get_array() is not None]
    assert [values.tolist() for values in found] == [pytest.approx([value] * 2) for value in (-1.5, 3.0, 5.0)]


def test_bars_are_as_long_as_their_data(document):
    one = plot(document, "fig_16_categories")
    axes = one.figure().axes
    assert one.data["relative_difference_acceptable"] == [1] * 5
    found = {container.get_label(): container for container in axes[0].containers}
    assert [bar.get_width() for bar in found["acceptable"]] == one.data["relative_difference_acceptable"]
    second = plot(document, "fig_17_means")
    assert second.data["in_plane"] == [1, 0, 1, 0, 0]
    widths = [bar.get_width() for bars in second.figure().axes[0].containers for bar in bars]
    assert sorted(widths) == sorted(second.data["mean_absolute_relative_difference_percent"])
    assert widths[0] == pytest.approx(9.5 / 3)

"""Scores of diagnoses against labels, by hand."""

from __future__ import annotations

import json
import math
from dataclasses import asdict

import numpy as np
import pytest

from instrument.__main__ import main
from twin.diagnosis.observation import Observation
from twin.diagnosis.trial import Row, Score, Truth, figures, interval, score, summary


def truth(*effects: str, outside: bool = False, severity: float = 2.0, where: tuple[int, ...] = ()) -> Truth:
    return Truth(effects, outside, severity, "slice", where)


def found(verdict: str, *classes: tuple[str, ...], probability: float = 0.97, where: tuple[int, ...] = ()) -> dict:
    entries = [{"effect": c[0], "class": list(c), "probability": probability, "parameters": {}} for c in classes]
    return {
        "verdict": verdict,
        "effects": entries if verdict == "effects" else [],
        "ranking": entries,
        "where": [{"points": list(where), "description": "", "strength": 1.0}],
        "gap": {"shrink": 0.5},
    }


def right(label: Truth, diagnosis: dict) -> bool:
    return score("case", label, diagnosis).right


@pytest.mark.parametrize(
    ("label", "diagnosis", "expected"),
    [
        (truth(), found("none"), True),
        (truth(), found("effects", ("tilt",)), False),
        (truth(), found("undecided", ("tilt",)), False),
        (truth("tilt"), found("effects", ("tilt",)), True),
        (truth("tilt"), found("effects", ("wedge", "tilt")), True),
        (truth("tilt"), found("effects", ("drift",)), False),
        (truth("tilt"), found("undecided", ("tilt",)), False),
        (truth("tilt"), found("effects", ("drift",), ("tilt",)), False),
        (truth("tilt", "drift"), found("effects", ("drift",), ("tilt",)), True),
        (truth("tilt", "drift"), found("effects", ("tilt",)), False),
        (truth("tilt", "drift"), found("effects", ("tilt", "drift")), False),
        (truth("tilt", "drift"), found("effects", ("tilt", "drift"), ("tilt",)), True),
        (truth("stain", outside=True), found("unknown"), True),
        (truth("stain", outside=True), found("effects", ("stain",)), False),
    ],
)
def test_a_diagnosis_is_right_where_it_says_what_was_wrong(label, diagnosis, expected):
    assert right(label, diagnosis) is expected


def test_regions_overlap_by_intersection_over_union():
    one = score("case", truth("tilt", where=(1, 2, 3)), found("effects", ("tilt",), where=(2, 3, 4, 5)))
    assert one.overlap == pytest.approx(2 / 5)
    assert score("case", truth(), found("none")).overlap is None


@pytest.mark.parametrize(
    ("relative", "left"),
    [
        # Of a change of 0.03, -0.04 half is taken away, all, none, and the same in the wrong direction.
        ((0.015, -0.02), 0.5),
        ((0.03, -0.04), 0.0),
        ((0.0, 0.0), None),
        ((-0.03, 0.04), 2.0),
    ],
)
def test_correction_is_held_against_the_true_change(relative: tuple[float, float], left: float | None):
    label = Truth(("tilt",), False, 2.0, "slice", (), gap=(0.03, 0.5, -0.04))
    diagnosis = found("effects", ("tilt",)) | {"correction": {"points": [0, 2], "relative": list(relative)}}
    one = score("case", label, diagnosis)
    assert one.left == pytest.approx(left)
    row = summary([one])["corrections that lie farther from the true change than none"][0]
    assert (row.successes, row.trials) == ((left or 0) > 1, left is not None)


def test_any_correction_of_a_sound_run_goes_away_from_the_truth():
    label = Truth((), False, 0.0, "slice", (), gap=(0.0, 0.0))
    one = score(
        "case", label, found("effects", ("tilt",)) | {"correction": {"points": [0, 1], "relative": [0.01, 0.0]}}
    )
    assert (one.left, one.farther) == (None, True)
    json.dumps(asdict(one), allow_nan=False)


def test_claims_are_counted_effect_by_effect():
    label = truth("tilt", "drift")
    rows = summary(
        [
            score("half", label, found("effects", ("tilt",))),
            score("both", label, found("effects", ("drift",), ("tilt",))),
            score("one wrong", label, found("effects", ("tilt",), ("stain",))),
            score("unsure", label, found("effects", ("stain",), probability=0.8)),
        ]
    )["confident claims right"]
    assert [(row.successes, row.trials) for row in rows] == [(4, 5), (1, 3)]
    outside = score("outside", truth("tilt", outside=True), found("effects", ("tilt",)))
    assert outside.claims == (False,)


def test_corrections_that_were_withheld_are_counted():
    kept, offered = found("effects", ("tilt",)), found("effects", ("tilt",))
    kept["gap"] = {"shrink": 0.0, "heldout_rms_withheld": 0.03}
    offered["gap"] = {"shrink": 0.5, "heldout_rms_withheld": None}
    row = summary([score("case", truth("tilt"), one) for one in (kept, offered)])["corrections withheld, as they would"]
    assert (row[0].successes, row[0].trials) == (1, 2)


def test_intervals_are_those_of_clopper_and_pearson():
    # No success in n: the upper end is 1 - (0.025)^(1/n).
    assert interval(0, 30) == (0.0, pytest.approx(1 - 0.025 ** (1 / 30)))
    assert interval(30, 30) == (pytest.approx(0.025 ** (1 / 30)), 1.0)
    # The table of the design note: 15 of 300 is 2.8 to 8.1 %.
    assert interval(15, 300) == (pytest.approx(0.028, abs=5e-4), pytest.approx(0.081, abs=5e-4))
    assert interval(0, 0) == (0.0, 1.0)


def test_tables_count_by_kind_severity_and_noise():
    scores: list[Score] = [
        score("a", truth(severity=0.0), found("none")),
        score("b", truth(severity=0.0), found("effects", ("tilt",))),
        score("c", truth("tilt", severity=1.0), found("effects", ("tilt",))),
        score("d", truth("tilt", severity=2.0), found("effects", ("drift",), probability=0.6)),
        score("e", truth("stain", outside=True), found("effects", ("tilt",))),
    ]
    tables = summary(scores)
    assert tables["right, by kind"] == [
        Row("none", 1, 2), Row("single", 1, 2), Row("double", 0, 0), Row("outside", 0, 1)
    ]  # fmt: skip
    bands = {row.label: (row.successes, row.trials) for row in tables["one effect: class right, by severity"]}
    assert bands == {"below 0.75": (0, 0), "0.75 to 1.5": (1, 1), "1.5 to 3": (0, 1), "above 3": (0, 0)}
    assert tables["confident claims right"] == [
        Row("effects named above 0.9", 1, 3),
        Row("whole answers, the first above it", 1, 3),
    ]
    assert tables["outside the library: wrongly confident"] == [Row("all", 1, 1)]


def test_kept_diagnoses_are_scored_against_a_file_of_labels(tmp_path):
    """Nothing is diagnosed again: one that is there already is kept."""
    runs, out = tmp_path / "runs", tmp_path / "out"
    (out / "diagnoses").mkdir(parents=True)
    runs.mkdir()
    for name, diagnosis in {"one": found("effects", ("tilt",)), "sound": found("none")}.items():
        (runs / f"{name}.nc").write_bytes(b"not read")
        (out / "diagnoses" / f"{name}.json").write_text(json.dumps(diagnosis))
    labels = tmp_path / "truth.json"
    one = {"effects": ["tilt"], "gap_over_u": 2.0, "kind": "slice", "where": [1]}
    labels.write_text(json.dumps({"one": one, "sound": {"effects": [], "kind": "global"}}))
    target = tmp_path / "scores.json"
    arguments = ["--runs", runs, "--common", tmp_path, "--labels", labels, "--out", out, "--json", target]
    with pytest.raises(SystemExit) as end:
        main(["blind-check", *map(str, arguments)])
    assert end.value.code == 0
    cases = json.loads(target.read_text())["cases"]
    assert [(case["name"], case["right"], case["overlap"]) for case in cases] == [
        ("one", True, 0.0),
        ("sound", True, None),
    ]
    assert [case["truth"]["family"] for case in cases] == ["slice", "global"]


def test_an_interval_holds_the_truth_within_two_standard_uncertainties() -> None:
    label = Truth.of({"effects": {"tilt": {"x_deg": 0.5, "y_deg": -0.2}}})
    diagnosis = found("effects", ("tilt",))
    diagnosis["effects"][0]["parameters"] = {"x_deg": {"value": 0.4, "u": 0.06}, "y_deg": {"value": 0.1, "u": 0.06}}
    assert score("case", label, diagnosis).covered == (True, False)
    diagnosis["effects"][0]["effect"] = "wedge"
    assert score("case", label, diagnosis).covered == ()


def test_the_shrink_that_the_truth_allows_is_that_of_a_prediction_of_the_noise_free_reading() -> None:
    # Readings 10 % and 20 % above the noise-free ones, of which noise alone leaves 3 %: sqrt(2.5e-2 - 9e-4) remain of
    # sqrt(0.16 - 9e-4).
    run = Observation("run", np.array([0, 2]), {}, np.array([1.0, 1.0]), np.array([0.01, 0.01]), {})
    label = Truth.of({"effects": ["tilt"], "brf_true": [0.9, 7.0, 0.8]})
    diagnosis = found("effects", ("tilt",))
    diagnosis["gap"] |= {"rms_before": 0.4, "heldout_rms_before": 0.5, "removable": 0.94}
    expected = 1 - math.sqrt((0.025 - 0.0009) / (0.16 - 0.0009))
    scored = score("case", label, diagnosis, run)
    assert scored.allowed == pytest.approx(expected)
    assert figures([scored])["held-out shrink over what the truth allows, median"] == pytest.approx(0.5 / expected)
    assert score("case", label, diagnosis).allowed is None

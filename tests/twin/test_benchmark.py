"""The benchmark: its arithmetic on made-up results, and one measurement for real, small."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "benchmarks"))

import bench_tracer  # noqa: E402
import report  # noqa: E402

GRAZING = np.array([True, False, False])


def test_efficiency_does_not_depend_on_how_long_one_calculates() -> None:
    mean, error = np.ones((1, 3)), np.full((1, 3), 0.01)
    short = bench_tracer.efficiency_of(mean, error, np.full((1, 3), 4.0))
    long = bench_tracer.efficiency_of(mean, error / 10, np.full((1, 3), 400.0))
    np.testing.assert_allclose(short, 2.0)
    np.testing.assert_allclose(long, short)


def test_spread_is_half_the_range_over_repeats() -> None:
    error = np.array([[0.01, 0.02, 0.02], [0.03, 0.02, 0.02]])
    found = bench_tracer.figures_of(np.ones((2, 3)), error, np.ones((2, 1)), GRAZING)
    assert found["grazing_spread"] == pytest.approx(1.0)
    assert found["median_spread"] == pytest.approx(0.0)
    assert found["median"] == pytest.approx(2.0)


def results_with_bias(bias: float) -> dict:
    generator = np.random.default_rng(5)
    truth, error = np.linspace(0.2, 0.8, 200), 0.001
    mean = truth * (1 + bias) + error * generator.standard_normal((2, 200)) * np.sqrt(2)
    found = {"mean": mean, "error": np.full((2, 200), error * np.sqrt(2))}
    return bench_tracer.agreement(found, truth, np.zeros(200), np.ones(200, dtype=bool))


def test_agreement_is_judged_with_the_error_of_all_repeats() -> None:
    found = results_with_bias(0.0)
    assert bench_tracer.sound(found)
    assert 0.7 < found["chi_square"] < 1.3


@pytest.mark.parametrize("bias", [0.002, -0.002])
def test_a_biased_program_is_not_sound(bias: float) -> None:
    assert not bench_tracer.sound(results_with_bias(bias))


def test_report_replaces_what_stands_between_its_markers(tmp_path: Path) -> None:
    path = tmp_path / "performance.md"
    path.write_text(f"# Performance\n\nbefore\n\n{report.BEGIN}\nold\n{report.END}\n\nafter\n")
    results = json.loads((ROOT / "benchmarks" / "results.json").read_text())
    report.write_report(results, path)
    text = path.read_text()
    assert text.startswith("# Performance\n\nbefore\n")
    assert text.endswith("\n\nafter\n")
    assert "old" not in text
    report.write_report(results, path)
    assert path.read_text() == text


def test_document_shows_the_committed_results() -> None:
    results = json.loads((ROOT / "benchmarks" / "results.json").read_text())
    assert report.tables(results) in (ROOT / "docs" / "performance.md").read_text()
    assert f"Size of the run: {results['size']}" in report.tables(results)
    assert results["comparison"]["agrees"]


def test_report_says_so_when_programs_do_not_agree() -> None:
    results = json.loads((ROOT / "benchmarks" / "results.json").read_text())
    results["comparison"]["agrees"] = False
    assert "THEY DO NOT AGREE" in report.tables(results)


@pytest.mark.slow
def test_a_change_of_one_parameter_compiles_nothing(tmp_path: Path) -> None:
    settings = tmp_path / "settings.json"
    settings.write_text(json.dumps({"every": 130, "standard_error": 0.05}))
    done = subprocess.run(
        [sys.executable, str(ROOT / "benchmarks" / "measures.py"), "change", str(settings)],
        capture_output=True, text=True, check=True, env=os.environ | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    found = json.loads(done.stdout.splitlines()[-1])
    assert len(found) == 6
    assert all(change["launched"] > 0 and change["compiled"] == 0 for change in found.values())

"""What procedures make of numbers: expectations by hand, or from arithmetic of another kind."""

from __future__ import annotations

import math
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scan_stage import FACILITY

from drivers.errors import DeviceFault
from instrument.errors import InputError
from instrument.facility import Beam, Budget, Sensor
from instrument.procedures.chart import BASELINE, chart_of, draw, judge
from instrument.procedures.intersection import edge_sensitivity, flux_slope
from instrument.procedures.linearity import _finding
from instrument.procedures.reading import Level, beyond, gain_name, least_squares, mean_of, mean_of_repeats
from instrument.procedures.results import CalibrationResult, Quantity
from instrument.procedures.warm_up import slope_of
from instrument.procedures.wavelength import _minimum
from sim_fixtures.bench.flux import Geometry
from sim_fixtures.bench.pieces import factor
from sim_fixtures.bench.troubles import Troubles

NARROW = FACILITY.model_copy(update={"beam": Beam(diameter=12.0, profile="gaussian", radius_1_e2=8.0)})


@pytest.mark.parametrize(
    ("value", "u", "unit", "text"),
    [
        (10.00029, 0.00051, "1", "10.00029 ± 0.00051"),
        (2.0163e-4, 5.4e-7, "V", "(2.0163 ± 0.0054)e-4 V"),
        (12345.6, 32.0, "s", "12346 ± 32 s"),
        (3.5, None, "mm", "3.5 mm"),
    ],
)
def test_a_quantity_is_written_with_two_digits_of_its_uncertainty(value, u, unit, text):
    assert str(Quantity(value=value, u=u, unit=unit)) == text


def test_gains_have_short_names():
    assert [gain_name(g) for g in (1e5, 1.01e6, 1e10)] == ["1e5", "1.01e6", "1e10"]


def test_a_mean_of_repeats_takes_the_larger_of_scatter_and_own_errors():
    # Scatter of 1, 2, 3 is 1: standard error 1/sqrt(3).
    assert mean_of_repeats([1.0, 2.0, 3.0], [0.1] * 3) == (pytest.approx(2.0), pytest.approx(1 / math.sqrt(3)))
    assert mean_of_repeats([2.0, 2.0], [0.3, 0.4])[1] == pytest.approx(0.25)


def test_an_overload_has_no_mean():
    with pytest.raises(DeviceFault, match="overload"):
        mean_of([1.0, 9.9e37])


def test_least_squares_of_a_line_agrees_with_numpy():
    x = np.linspace(0, 1, 9)
    y = 2 + 3 * x + np.random.default_rng(1).standard_normal(9) * 0.1
    found, covariance, _ = least_squares(np.stack([np.ones(9), x], axis=1), y, np.full(9, 0.5))
    np.testing.assert_allclose(found[::-1], np.polyfit(x, y, 1))
    # The errors are stated five times too large: they are not made smaller for that.
    assert covariance[1, 1] == pytest.approx(0.25 / np.sum((x - x.mean()) ** 2))


def test_a_departure_counts_from_twice_its_uncertainty_and_what_is_allowed():
    assert not beyond(0.99, 0.3, 0.4)
    assert beyond(-1.01, 0.3, 0.4)


def added(response, levels=(4.0, 2.0, 1.0), noise=1e-5) -> list[list[Level]]:
    """Levels of A, B (0.8 of A) and both as a detector with this response reads them."""
    rows = []
    for light in levels:
        volts = [response(part) for part in (light, 0.8 * light, 1.8 * light)]
        rows.append([Level(v, noise * v, 0.0, 1e6, 0.0) for v in volts])
    return rows


@given(st.floats(-0.01, 0.01))
def test_flux_addition_finds_a_quadratic_response(share: float):
    """V = L (1 + share L/10), so that L is V - (share/10) V^2 to first order."""
    room = SimpleNamespace(laboratory=SimpleNamespace(detector=SimpleNamespace(full_scale=10.0)), facility=FACILITY)
    finding = _finding(room, added(lambda light: light * (1 + share * light / 10)), 1e6, 3)  # type: ignore[arg-type]
    found = finding.values["departure at full scale"].value
    assert found == pytest.approx(share, rel=0.05, abs=1e-9)


def test_flux_addition_is_blind_to_the_scale_of_the_light():
    room = SimpleNamespace(laboratory=SimpleNamespace(detector=SimpleNamespace(full_scale=10.0)), facility=FACILITY)
    finding = _finding(room, added(lambda light: 0.37 * light), 1e6, 3)  # type: ignore[arg-type]
    assert finding.verdict == "passed"
    assert abs(finding.values["departure at full scale"].value) < 1e-12


def test_the_slope_of_a_fading_exponential_is_that_at_the_middle_of_the_window():
    times = np.arange(10) * 60.0
    levels = [Level(1 + 0.05 * math.exp(-t / 600), 1e-6, 0.0, 1e6, t) for t in times]
    # d ln V/dt at the middle of the window (270 s), by hand: -a/T exp(-t/T)/(1 + a exp(-t/T)), an hour.
    decay = 0.05 * math.exp(-270 / 600)
    assert slope_of(levels).per_hour == pytest.approx(-3600 / 600 * decay / (1 + decay), rel=0.03)


def test_a_slope_that_noise_could_hide_is_not_called_stable():
    noisy = [Level(1.0, 1e-3, 0.0, 1e6, t * 60.0) for t in range(10)]
    slope = slope_of(noisy)
    assert abs(slope.per_hour) < 1e-9
    assert not slope.surely_below(0.005)
    assert slope.surely_below(0.5)


@given(st.floats(-2.0, 2.0), st.floats(-0.004, 0.004))
def test_the_middle_of_a_band_is_found_on_a_sloping_ground(shift: float, slope: float):
    grid = np.arange(509.0, 534.0, 1.5)
    x = grid - 521.3 - shift
    ratio = 0.93 * (1 + slope * x) * (1 - 0.6 * np.exp(-0.5 * (x / 4.6) ** 2))
    centre, _ = _minimum(grid, ratio, 1e-4 * ratio, 521.3)
    assert centre == pytest.approx(521.3 + shift, abs=0.01)


def test_where_there_is_no_band_nothing_is_found():
    grid = np.arange(509.0, 534.0, 1.5)
    ratio = 0.99 + 1e-4 * np.random.default_rng(3).standard_normal(grid.size)
    with pytest.raises(InputError, match="no absorption band"):
        _minimum(grid, ratio, np.full(grid.size, 1e-4), 521.3)


def test_the_edge_moves_the_light_as_summing_over_the_plane_says():
    """The laboratory's own sum over a grid, with the sensor's axis 0.2 mm off to either side."""
    seen = []
    for runout in (0.2, -0.2):
        geometry = Geometry("edge_target", 60.0, 0.0, 0.0, 500.0)
        seen.append(factor(geometry, NARROW, Troubles(sensor_runout_mm=runout)))
    measured = (seen[0] - seen[1]) / (seen[0] + seen[1]) / 0.2
    assert edge_sensitivity(NARROW, 60.0) == pytest.approx(measured, rel=0.02)


def test_a_uniform_wide_beam_s_edge_sensitivity_is_that_of_a_half_disc():
    wide = FACILITY.model_copy(update={"beam": Beam(diameter="unbounded", profile="tophat")})
    # A half disc of radius R holds pi R^2/2 and gains 2 R for each mm: 4/(pi R).
    assert edge_sensitivity(wide, 0.0) == pytest.approx(4 / (math.pi * 5.4), rel=1e-4)


def test_a_beam_inside_the_field_says_nothing_about_the_edge():
    small = FACILITY.model_copy(update={"beam": Beam(diameter=4.0, profile="tophat")})
    with pytest.raises(InputError, match="no light falls on the rim"):
        edge_sensitivity(small, 60.0)


def test_a_narrow_beam_s_flux_falls_as_the_cosine():
    narrow = FACILITY.model_copy(
        update={"beam": Beam(diameter=1.0, profile="tophat"), "sensor": Sensor(target_diameter=10.8)}
    )
    zenith = np.array([30.0, 60.0])
    np.testing.assert_allclose(flux_slope(narrow, zenith), -np.tan(np.deg2rad(zenith)) * math.pi / 180, rtol=1e-3)


NOW = datetime(2026, 11, 22, tzinfo=UTC)


def series(values: list[float]) -> list[CalibrationResult]:
    return [
        CalibrationResult(
            procedure="control-sample",
            subject="tile",
            taken=NOW + timedelta(days=day),
            verdict="passed",
            summary="",
            values={"brf": Quantity(value=value, unit="1")},
        )
        for day, value in enumerate(values)
    ]


STEADY = [1.0, 1.01, 0.99, 1.0, 1.01, 0.99, 1.0, 1.01, 0.99, 1.0]


def test_the_first_ten_results_make_the_limits():
    chart = chart_of(series([*STEADY, 5.0]), "brf", Budget())
    assert chart.baseline == BASELINE
    assert chart.middle == pytest.approx(np.mean(STEADY))
    assert chart.sigma == pytest.approx(np.std(STEADY, ddof=1))


def test_a_short_series_is_held_against_the_stated_stability():
    chart = chart_of(series([1.0, 1.02]), "brf", Budget(instrument_stability=0.01), (NOW, 1.05))
    assert (chart.middle, chart.sigma) == (pytest.approx(1.01), pytest.approx(0.0101))
    assert judge(chart).level == "act"
    assert judge(chart_of(series([1.0]), "brf", Budget(), (NOW, 3.0))).reason == "no limits yet"


SIGMA = float(np.std(STEADY, ddof=1))


@pytest.mark.parametrize(
    ("deviations", "level"),
    [
        ([0.5], "in control"),
        ([2.5], "warn"),
        ([3.5], "act"),
        ([-3.5], "act"),
        ([2.5, 0.0, 2.5], "act"),
        ([2.5, 0.0, 0.0, 2.5], "warn"),
        ([-2.5, 2.5], "warn"),
        ([0.2] * 8, "warn"),
        ([0.2] * 7 + [-0.2], "in control"),
        ([3.5, 0.1], "in control"),
    ],
)
def test_the_rules_of_the_chart(deviations: list[float], level: str):
    values = STEADY + [float(np.mean(STEADY)) + SIGMA * one for one in deviations]
    assert judge(chart_of(series(values), "brf", Budget())).level == level


def test_the_picture_of_a_chart_is_drawn(tmp_path: Path):
    draw([chart_of(series([*STEADY, 1.02]), "brf", Budget())], tmp_path / "chart.png", "control sample tile")
    assert (tmp_path / "chart.png").read_bytes().startswith(b"\x89PNG")

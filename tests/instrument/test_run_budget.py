"""The budget of a run: where its rows come from, how their errors belong together, how well they are known."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from example_runs import FACILITY, PLAN, facility, four_points, geometry, header, reading
from scipy import stats
from typer.testing import CliRunner

from instrument.__main__ import build
from instrument.budget import combined
from instrument.dataset import component_names, read_run, rebuild_run, write_run
from instrument.errors import InputError
from instrument.facility import Facility
from instrument.forms import parse_form, parse_toml
from instrument.journal import Journal
from instrument.quality.budget_slopes import predicted_slopes, with_slopes
from instrument.run_archive import verify

SLOPES = FACILITY.replace("[arms]", "[arms]\nu_sensor_zenith = 0.25").replace("sensor_zenith = [0.0010, 0.0052]\n", "")
SAMPLES = FACILITY.replace("measurement_noise = [0.0051, 0.0070]", 'measurement_noise = "samples"')
RIPPLE = np.array([-2.0, -1.0, 0.0, 1.0, 2.0, 1.5, -1.5, 0.5, -0.5])


def run_folder(folder: Path, text: str, brf: tuple[float, ...] = (0.3, 0.4, 0.4, 0.3), dark: float = 1e-5) -> Path:
    """Four references and four points at normal illumination; nine dark samples that scatter by ``dark`` V."""
    folder.mkdir(exist_ok=True)
    (folder / "plan.toml").write_text(PLAN)
    (folder / "facility.toml").write_text(text)
    without_light = (2e-4 + dark * RIPPLE).tolist()
    with Journal.create(folder, header(facility=text)) as journal:
        for index, azimuth in enumerate((0.0, 45.0, 90.0, 135.0)):
            at = geometry(15.0, sensor_azimuth=azimuth)
            journal.record("reference", index=index, **reading(at, 0.99, index), dark_signal=without_light)
        for index, (zenith, value) in enumerate(zip((30.0, 20.0, -20.0, -30.0), brf, strict=True)):
            at = geometry(zenith)
            journal.record("point", index=index, **reading(at, value, 60 + index), dark_signal=without_light)
    return folder


def test_an_angle_without_a_number_counts_with_its_slope(tmp_path: Path) -> None:
    """By hand: brf falls by 0.01 a degree outwards, and the flux with the cosine of the sensor's zenith."""
    run = rebuild_run(run_folder(tmp_path, SLOPES))
    expected = 0.25 * (0.01 + np.array([0.3, 0.4]) * np.tan(np.deg2rad([30.0, 20.0])) * np.pi / 180)
    assert run["u_brf_sensor_zenith"].values == pytest.approx([*expected, *expected[::-1]], rel=2e-3)
    assert run["u_brf_sensor_azimuth"].values[0] == pytest.approx(0.3 * (0.002 + 0.0038 * (30 / 80) ** 2))
    components = {name: run[name].values for name in component_names(run)}
    np.testing.assert_allclose(run["u_brf"], combined(components))


def test_errors_of_an_angle_are_opposite_on_the_two_sides(tmp_path: Path) -> None:
    """The obsarray convention: a matrix variable that ``err_corr_1_params`` names."""
    folder = run_folder(tmp_path, SLOPES)
    write_run(rebuild_run(folder), folder / "run.nc")
    run = read_run(folder / "run.nc")
    attributes = run["u_brf_sensor_zenith"].attrs
    assert attributes["err_corr_1_form"] == "err_corr_matrix"
    assert attributes["err_corr_1_dim"] == "point"
    matrix = run[str(np.atleast_1d(attributes["err_corr_1_params"])[0])].values
    assert matrix.tolist() == [[1, 1, -1, -1]] * 2 + [[-1, -1, 1, 1]] * 2
    assert verify(folder).passed


def test_noise_from_the_samples_carries_that_of_the_dark_readings(tmp_path: Path) -> None:
    """Light ripples by 1e-3, the dark by 1 mV: nine samples each; degrees of freedom by Welch and Satterthwaite."""
    run = rebuild_run(run_folder(tmp_path, SAMPLES, dark=1e-3))
    error = RIPPLE.std(ddof=1) / 3
    volts = run["signal"].values.mean(axis=1) - 2e-4
    light, dark = 1e-3 * error, 1e-3 * error / volts
    assert run["u_brf_noise"].values == pytest.approx(run["brf"].values * np.hypot(light, dark))
    freedom = (light**2 + dark**2) ** 2 / (light**4 / 8 + dark**4 / 8)
    assert run["brf_noise_degrees_of_freedom"].values == pytest.approx(freedom)
    assert np.all((freedom > 8) & (freedom < 16))
    # What the reference readings scatter is common to all points.
    total = run["brf_standard_error"].values
    assert np.hypot(run["u_brf_noise"], run["u_brf_reference_noise"]).values == pytest.approx(total)
    assert run["u_brf_reference_noise"].attrs["err_corr_1_form"] == "systematic"
    assert "u_brf_reference_noise" in component_names(run)


def test_degrees_of_freedom_of_a_row_reach_the_coverage_factor(tmp_path: Path) -> None:
    """Only stability is not known exactly: nu_eff = 6 (u_c/u_stability)^4, k from Student's distribution."""
    text = FACILITY + '[degrees_of_freedom]\ninstrument_stability = 6\n[correlation]\ninstrument_stability = "random"\n'
    run = rebuild_run(run_folder(tmp_path, text))
    freedom = 6 * (run["u_brf"].values / run["u_brf_stability"].values) ** 4
    assert run["brf_effective_degrees_of_freedom"].values == pytest.approx(freedom)
    factor = stats.t.ppf((1 + 0.954499736) / 2, freedom)
    assert run["brf_coverage_factor"].values == pytest.approx(factor)
    assert run["brf_expanded_uncertainty"].values == pytest.approx(factor * run["u_brf"].values)
    assert run["brf_expanded_uncertainty"].attrs["coverage_probability"] == pytest.approx(0.9545)
    assert run["u_brf_stability"].attrs["err_corr_1_form"] == "random"


def test_a_budget_that_is_known_exactly_has_k_2(tmp_path: Path) -> None:
    run = rebuild_run(four_points(tmp_path))
    assert np.isinf(run["brf_effective_degrees_of_freedom"].values).all()
    assert run["brf_coverage_factor"].values == pytest.approx([2.0] * 4)


def test_what_was_recorded_without_dark_samples_is_read_as_before(tmp_path: Path) -> None:
    run = rebuild_run(four_points(tmp_path))
    assert "dark_signal" not in run
    assert run["outliers"].values.tolist() == [0] * 4


def test_outliers_are_counted_and_kept(tmp_path: Path) -> None:
    with Journal.create(tmp_path, header()) as journal:
        at = geometry(15.0)
        journal.record("reference", index=0, **reading(at, 0.99, 0.0))
        disturbed = reading(geometry(40.0), 0.5, 10.0)
        disturbed["signal"][3] *= 1.05
        journal.record("point", index=0, **disturbed)
        journal.record("point", index=1, **reading(geometry(30.0), 0.5, 20.0))
    run = rebuild_run(tmp_path)
    assert run["outliers"].values.tolist() == [1, 0]
    assert run["signal"].values[0].tolist() == disturbed["signal"]
    assert run["brf"].values[0] / run["brf"].values[1] == pytest.approx(1 + 0.05 * (1 + 1e-3) / 9, rel=1e-4)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("[correlation]\nwavelength = 'partly'", "correlation.wavelength"),
        ("[degrees_of_freedom]\nwavelength = 0", "degrees_of_freedom.wavelength"),
        ("[degrees_of_freedom]\nlamp = 3", "degrees_of_freedom.lamp: unknown key"),
    ],
)
def test_wrong_statements_are_named(line: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        parse_form(parse_toml(FACILITY + line, "f.toml"), Facility, "f.toml")


def test_a_predicted_slope_takes_the_place_of_a_measured_one(tmp_path: Path) -> None:
    """With a sensitivity the whole response is the prediction's; without, the slope of its brf, and the flux."""
    run = rebuild_run(run_folder(tmp_path, SLOPES))
    known = parse_form(parse_toml(SLOPES, "f.toml"), Facility, "f.toml")
    names = ["wavelength", "illumination_zenith", "illumination_azimuth", "sensor_zenith", "sensor_azimuth"]
    prediction = run[[*names, "brf"]].isel(point=[3, 1, 0, 2])
    bare = with_slopes(run, known, prediction)
    assert bare["u_brf_sensor_zenith"].values == pytest.approx(run["u_brf_sensor_zenith"].values)
    assert bare["u_brf_sensor_zenith"].attrs["source"].startswith("predicted slope of brf and flux")
    response = np.array([0.04, -0.02, -0.03, 0.01])
    prediction["sensitivity"] = (("point", "parameter"), response[:, None])
    prediction = prediction.assign_coords(parameter=["sensor zenith"])
    told = with_slopes(run, known, prediction)
    assert told["u_brf_sensor_zenith"].values == pytest.approx(0.25 * np.array([0.03, 0.02, 0.01, 0.04]))
    with pytest.raises(InputError, match=r"lacks 1 of 4 points of the run; the first: .*sensor_zenith 30"):
        predicted_slopes(run, known, prediction.isel(point=[0, 1, 3]))


def test_without_an_uncertain_angle_there_is_nothing_to_do(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="all are 0"):
        with_slopes(rebuild_run(four_points(tmp_path)), facility())


def command(*words: str) -> str:
    result = CliRunner(env={"COLUMNS": "160"}).invoke(build(list(words)), list(words))
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.output


def table(output: str) -> dict[str, list[str]]:
    rows = (line.strip("│").split("│") for line in output.splitlines() if line.startswith("│"))
    return {cells[0].strip(): [cell.strip() for cell in cells[1:]] for cells in rows}


def stored(folder: Path, run: xr.Dataset) -> str:
    write_run(run, folder / "run.nc")
    return str(folder)


def test_the_command_prints_the_budget_as_table_ii_has_it(tmp_path: Path) -> None:
    """At 60 and 30 degrees: what the rows of the paper's table are there."""
    folder = four_points(tmp_path)
    rows = table(command("budget", stored(folder, rebuild_run(folder))))
    assert rows["measurement noise"] == ["0.54 to 0.62", "0.58", "random", "∞"]
    assert rows["instrument stability"] == ["0.82", "0.82", "not stated", "∞"]
    assert rows["reference material"][2] == "systematic"
    low, high = (
        np.sqrt(sum(np.square(part)))
        for part in zip(
            *(
                (a + (b - a) * (30 / 80) ** p, a + (b - a) * (60 / 80) ** p)
                for a, b, p in (
                    (0.51, 0.70, 2),
                    (0.82, 0.82, 2),
                    (0.02, 0.02, 2),
                    (0.01, 0.01, 2),
                    (0.10, 0.18, 1),
                    (0.20, 0.20, 2),
                    (0.21, 0.21, 2),
                    (0.10, 0.52, 2),
                    (0.20, 0.58, 2),
                    (0.14, 0.14, 2),
                    (0.10, 0.10, 2),
                    (0.50, 0.50, 2),
                )
            ),
            strict=True,
        )
    )
    assert rows["combined (k = 1)"][0] == f"{low:.2f} to {high:.2f}"
    assert rows["expanded (k = 2.00, 95.45 %)"][0] == f"{2 * low:.2f} to {2 * high:.2f}"


def test_one_point_has_a_budget_of_its_own(tmp_path: Path) -> None:
    folder = four_points(tmp_path)
    name = stored(folder, rebuild_run(folder))
    output = command("budget", name, "--point", "1", "--json", str(tmp_path / "b.json"))
    assert "point 1, 500 nm, illumination zenith 0, sensor azimuth 0, sensor zenith 30: brf 0.4" in output
    content: dict[str, Any] = json.loads((tmp_path / "b.json").read_text())
    assert content["effective_degrees_of_freedom"] == [None] * 3
    assert [row["variable"] for row in content["components"]][:2] == ["u_brf_noise", "u_brf_stability"]
    with pytest.raises(InputError, match="expected 0 to 3"):
        command("budget", name, "--point", "4")


def test_a_stated_angle_term_that_the_slope_exceeds_is_pointed_out(tmp_path: Path) -> None:
    text = FACILITY.replace("[arms]", "[arms]\nu_sensor_zenith = 0.25")
    folder = run_folder(tmp_path, text)
    name = stored(folder, rebuild_run(folder))
    assert "sensor zenith: by the slope of what was measured 0.25 degrees make" in command("budget", name)
    output = command("budget", name, "--slopes", "--out", str(tmp_path / "other.nc"))
    assert table(output)["sensor zenith"][0] == "0.78 to 1.08"
    other = read_run(tmp_path / "other.nc")
    by_slope = rebuild_run(run_folder(tmp_path / "by slope", SLOPES))
    assert other["u_brf"].values == pytest.approx(by_slope["u_brf"].values)


def test_a_file_without_components_has_no_budget(tmp_path: Path) -> None:
    run = rebuild_run(four_points(tmp_path))
    bare = run[["brf", "u_brf"]]
    bare["brf"].attrs.pop("unc_comps")
    write_run(bare, tmp_path / "bare.nc")
    with pytest.raises(InputError, match="no uncertainty components"):
        command("budget", str(tmp_path / "bare.nc"))

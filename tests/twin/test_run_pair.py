"""Two runs beside each other: what cancels in their ratio, what adds up, which points belong together."""

import json
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from instrument.dataset import write_run
from instrument.errors import InputError
from instrument.run_budget import correlated
from twin.run_pair import compare_runs
from twin.run_pair_command import compare_pair

#: Relative components: noise, the reference, stability (of which nobody states the correlation).
NOISE, REFERENCE, STABILITY = 0.003, 0.005, 0.008


def run(
    factor: float = 1.0,
    zenith: tuple[float, ...] = (-60.0, -20.0, 20.0, 60.0),
    reference: float = REFERENCE,
    **attrs: str,
) -> xr.Dataset:
    brf = factor * np.array([0.4, 0.5, 0.6, 0.7])[: len(zenith)]
    known = {"wavelength": 500.0, "illumination_zenith": 10.0, "illumination_azimuth": 0.0, "sensor_azimuth": 30.0}
    columns = {name: np.full(len(zenith), value) for name, value in known.items()} | {"sensor_zenith": np.array(zenith)}
    dataset = xr.Dataset({name: ("point", values) for name, values in columns.items()})
    dataset["brf"] = ("point", brf)
    parts = (("noise", NOISE, "random"), ("reference", reference, "systematic"), ("stability", STABILITY, None))
    for name, u, form in parts:
        dataset[f"u_brf_{name}"] = ("point", u * brf, correlated(form))
    dataset["u_brf"] = ("point", brf * np.sqrt(NOISE**2 + reference**2 + STABILITY**2))
    dataset["brf"].attrs["unc_comps"] = [f"u_brf_{name}" for name, *_ in parts]
    for name in dataset.variables:
        dataset[name].attrs.setdefault(
            "units", {"wavelength": "nm"}.get(str(name), "degree" if name in columns else "1")
        )
    dataset.attrs = {"facility": "arms"} | attrs
    return dataset.set_coords(list(columns))


def test_what_both_have_alike_cancels_and_the_rest_adds_up() -> None:
    found = compare_runs(run(), run(1.02))
    assert found.shared == ("u_brf_reference",)
    u = 1.02 * np.sqrt(2) * np.hypot(NOISE, STABILITY)
    np.testing.assert_allclose(found.points["ratio"], 1.02)
    np.testing.assert_allclose(found.points["u_ratio"], u)
    np.testing.assert_allclose(found.points["t"], 0.02 / u)
    # Noise of four points averages; stability, of which nobody says how it correlates, does not.
    assert found.u_mean_ratio == pytest.approx(1.02 * np.sqrt(2 * (NOISE**2 / 4 + STABILITY**2)))


def test_a_shared_error_of_another_size_cancels_in_part() -> None:
    points = compare_runs(run(), run(reference=0.009)).points
    np.testing.assert_allclose(points["u_shared"], 0.004)
    np.testing.assert_allclose(points["u_independent"], np.sqrt(2) * np.hypot(NOISE, STABILITY))


def test_runs_of_different_facilities_share_the_standard_they_name_or_nothing() -> None:
    other = compare_runs(run(), run(facility="another"))
    assert other.shared == ()
    np.testing.assert_allclose(other.points["u_ratio"], np.sqrt(2 * (NOISE**2 + REFERENCE**2 + STABILITY**2)))
    standard = {"reference_standard": "S1"}
    same = compare_runs(run(**standard), run(facility="another", **standard))
    assert same.shared == ("u_brf_reference",)
    assert any("but the reference standard" in note for note in same.notes)


def test_a_person_decides_otherwise() -> None:
    assert compare_runs(run(), run(), independent=["reference"]).shared == ()
    assert compare_runs(run(), run(), shared=["u_brf_stability"]).shared == ("u_brf_reference", "u_brf_stability")
    with pytest.raises(InputError, match="component weather: not in both runs; found u_brf_noise"):
        compare_runs(run(), run(), shared=["weather"])
    with pytest.raises(InputError, match="everything is taken to be common"):
        compare_runs(run(), run(), shared=["noise", "stability"])


def test_points_belong_together_by_direction_and_flagged_ones_to_nobody() -> None:
    b = run().isel(point=[3, 1, 0])
    # Zenith -60 at azimuth 30 is 60 at 210.
    b["sensor_zenith"].values[2], b["sensor_azimuth"].values[2] = 60.0, 210.0
    b["quality_flag"] = ("point", np.array([0, 1, 0], dtype=np.int8))
    found = compare_runs(run(), b)
    assert found.points["row_a"].values.tolist() == [0, 3]
    assert found.points["row_b"].values.tolist() == [2, 0]
    assert (found.only_a, found.only_b) == (2, 0)
    with pytest.raises(InputError, match="no geometry in common; the first has 500 nm, illumination zenith 10"):
        compare_runs(run(), run(zenith=(1.0, 2.0)))


def test_points_in_other_light_do_not_match() -> None:
    light = {"polarization": ("point", np.array([1, 2, 1, 2], dtype=np.int8))}
    other = {"polarization": ("point", np.array([1, 1, 1, 2], dtype=np.int8))}
    assert compare_runs(run().assign(light), run().assign(other)).points["row_a"].values.tolist() == [0, 2, 3]


def test_errors_that_raise_one_point_and_lower_another_leave_the_mean_alone() -> None:
    def slanted() -> xr.Dataset:
        dataset = run()
        sign = np.array([-1.0, -1.0, 1.0, 1.0])
        # The slope's own error is each run's: the matrix tells that it averages out over the planes' two sides.
        dataset["u_brf_stability"].attrs = correlated("err_corr_matrix", "matrix")
        dataset["matrix"] = (("point", "point_2"), np.outer(sign, sign))
        return dataset

    found = compare_runs(slanted(), slanted(), independent=["stability", "reference"], shared=[])
    assert found.u_mean_ratio == pytest.approx(np.sqrt(2 * (NOISE**2 / 4 + REFERENCE**2)))
    fewer = compare_runs(slanted(), slanted().isel(point=[0, 1]), independent=["stability", "reference"])
    assert fewer.u_mean_ratio == pytest.approx(np.sqrt(2 * (NOISE**2 / 2 + REFERENCE**2 + STABILITY**2)))


def test_runs_that_differ_as_their_uncertainties_say_have_a_t_of_one() -> None:
    random = np.random.default_rng(4)
    zenith = tuple(np.linspace(-80, 80, 400).tolist())

    def noisy() -> xr.Dataset:
        dataset = run(zenith=zenith[:4]).isel(point=np.zeros(400, dtype=int))
        dataset = dataset.assign_coords(sensor_zenith=("point", np.array(zenith), {"units": "degree"}))
        error = 1 + np.hypot(NOISE, STABILITY) * random.standard_normal(400)
        return dataset.assign(brf=dataset["brf"] * error)

    found = compare_runs(noisy(), noisy())
    assert found.rms_t == pytest.approx(1.0, abs=0.1)


def test_a_run_without_components_shares_nothing() -> None:
    plain = run().drop_vars(["u_brf_noise", "u_brf_reference", "u_brf_stability"])
    plain["brf"].attrs.clear()
    found = compare_runs(plain, run())
    np.testing.assert_allclose(found.points["u_ratio"], np.sqrt(2 * (NOISE**2 + REFERENCE**2 + STABILITY**2)))
    assert any("no uncertainty components" in note for note in found.notes)


def test_the_command_says_it_and_writes_every_point(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = [tmp_path / "a.nc", tmp_path / "b.nc"]
    write_run(run(), files[0])
    write_run(run(1.02), files[1])
    compare_pair(str(files[0]), [str(files[1])], json_file=tmp_path / "pair.json")
    said = capsys.readouterr().out
    assert "B/A = 1.0200" in said
    assert "the same error in both: reference" in said
    assert len(json.loads((tmp_path / "pair.json").read_text())["matched"]) == 4

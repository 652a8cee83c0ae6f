"""From the journal to the run file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from example_runs import facility, four_points, geometry, header, reading, references

from instrument.budget import combined
from instrument.dataset import build_run, component_names, rebuild_run
from instrument.errors import InputError
from instrument.journal import Journal, read_journal


def test_the_run_holds_what_was_measured(tmp_path: Path) -> None:
    run = rebuild_run(four_points(tmp_path))
    np.testing.assert_allclose(run["brf"], [0.3, 0.4, 0.5, 0.6], rtol=1e-6)
    assert run["sensor_zenith"].values.tolist() == [60, 30, -30, -60]
    assert run["readback_sensor_zenith"].values == pytest.approx([60.003, 30.003, -29.997, -59.997])
    assert run["source_power"].values.tolist() == [0.5] * 4
    assert run["environment_temperature"].attrs["units"] == "degC"
    assert run["signal"].shape == (4, 9)
    assert run["time"].values[1] == np.datetime64("2026-03-02T08:01:20")
    assert run["reference_time"].values[3] == np.datetime64("2026-03-02T08:00:03")
    assert run.attrs["reference_reflectance_factor"] == 0.99
    assert run.attrs["facility"] == facility_text(tmp_path)
    assert run.attrs["journal_digest"] == read_journal(tmp_path).digest


def facility_text(run_dir: Path) -> str:
    return (run_dir / "facility.toml").read_text()


def test_components_add_up_and_the_samples_speak_for_themselves(tmp_path: Path) -> None:
    run = rebuild_run(four_points(tmp_path))
    components = {name: run[name].values for name in component_names(run)}
    assert len(components) == 12
    np.testing.assert_allclose(run["u_brf"], combined(components))
    # The nine samples of the example scatter by a known amount, in the points and in the four references.
    ripple = 1e-3 * np.array([-2.0, -1.0, 0.0, 1.0, 2.0, 1.5, -1.5, 0.5, -0.5])
    expected = ripple.std(ddof=1) / 3 * np.sqrt(1 + 1 / 4)
    np.testing.assert_allclose(run["brf_standard_error"] / run["brf"], expected, rtol=2e-3)


def test_rows_stand_in_time_order_whatever_their_index(tmp_path: Path) -> None:
    with Journal.create(tmp_path, header()) as journal:
        references(journal)
        for index, seconds in ((2, 10.0), (0, 20.0), (3, 30.0)):
            journal.record("point", index=index, **reading(geometry(20.0 + index), 0.5, seconds))
    run = rebuild_run(tmp_path)
    assert run["plan_index"].values.tolist() == [2, 0, 3]
    assert np.all(np.diff(run["time"].values) > np.timedelta64(0))


def test_every_wavelength_has_its_own_reference(tmp_path: Path) -> None:
    with Journal.create(tmp_path, header()) as journal:
        for number, (wavelength, light) in enumerate(((500.0, 1e-6), (700.0, 4e-6))):
            at = geometry(15.0, wavelength=wavelength)
            journal.record("reference", index=number, **reading(at, 0.99, number, light=light))
        for index, (wavelength, light) in enumerate(((500.0, 1e-6), (700.0, 4e-6))):
            at = geometry(40.0, wavelength=wavelength)
            journal.record("point", index=index, **reading(at, 0.5, 10.0 + index, light=light))
    run = rebuild_run(tmp_path)
    np.testing.assert_allclose(run["brf"], [0.5, 0.5], rtol=1e-6)
    assert run["reference_wavelength"].values.tolist() == [500.0, 700.0]


def test_a_new_calibration_serves_the_points_after_it(tmp_path: Path) -> None:
    with Journal.create(tmp_path, header()) as journal:
        references(journal, seconds=0.0, light=1e-6)
        journal.record("point", index=0, **reading(geometry(40.0), 0.5, 10.0, light=1e-6))
        references(journal, seconds=100.0, light=2e-6)
        journal.record("point", index=1, **reading(geometry(40.0), 0.5, 110.0, light=2e-6))
    run = rebuild_run(tmp_path)
    np.testing.assert_allclose(run["brf"], [0.5, 0.5], rtol=1e-6)
    assert run["reference_set"].values.tolist() == [0] * 4 + [1] * 4
    assert run["point_reference_set"].values.tolist() == [0, 1]


def test_a_readback_that_some_point_lacks_is_left_out(tmp_path: Path) -> None:
    with Journal.create(tmp_path, header()) as journal:
        references(journal)
        journal.record("point", index=0, **reading(geometry(40.0), 0.5, 10.0), readback={"sensor_zenith": 40.0})
        journal.record("point", index=1, **reading(geometry(30.0), 0.5, 20.0))
    assert "readback_sensor_zenith" not in rebuild_run(tmp_path)


def test_flags_reach_the_file(tmp_path: Path) -> None:
    with Journal.create(tmp_path, header()) as journal:
        references(journal)
        journal.record("point", index=0, **reading(geometry(40.0), 0.5, 10.0), quality_flag=9)
    run = rebuild_run(tmp_path)
    assert run["quality_flag"].values.tolist() == [9]
    assert run["quality_flag"].dtype == np.int8


def test_records_need_not_come_from_a_file() -> None:
    record = {"index": 0} | reading(geometry(40.0), 0.5, 10.0)
    known = [{"index": 0} | reading(geometry(15.0), 0.99, 0.0)]
    plain = [row | {"geometry": row["geometry"].model_dump()} for row in (record, *known)]
    run = build_run(header(), plain[:1], plain[1:], facility())
    np.testing.assert_allclose(run["brf"], [0.5], rtol=1e-6)
    assert "journal_digest" not in run.attrs


def test_what_does_not_suffice_is_said(tmp_path: Path) -> None:
    with Journal.create(tmp_path, header()) as journal:
        with pytest.raises(InputError, match="no point was measured"):
            rebuild_run(tmp_path)
        journal.record("point", index=0, **reading(geometry(40.0), 0.5, 10.0))
        with pytest.raises(InputError, match="no reference reading"):
            rebuild_run(tmp_path)
        references(journal, seconds=100.0)
        with pytest.raises(InputError, match=r"point 0, .*before the first reference"):
            rebuild_run(tmp_path)


def test_a_wavelength_without_reference_is_named(tmp_path: Path) -> None:
    with Journal.create(tmp_path, header()) as journal:
        references(journal)
        journal.record("point", index=0, **reading(geometry(40.0, wavelength=600.0), 0.5, 10.0))
    with pytest.raises(InputError, match="no reference reading at 600 nm"):
        rebuild_run(tmp_path)


def test_samples_of_different_number_are_refused(tmp_path: Path) -> None:
    with Journal.create(tmp_path, header()) as journal:
        references(journal)
        journal.record("point", index=0, **reading(geometry(40.0), 0.5, 10.0))
        journal.record("point", index=1, **(reading(geometry(30.0), 0.5, 20.0) | {"signal": [0.1, 0.2]}))
    with pytest.raises(InputError, match="points have between 2 and 9 samples"):
        rebuild_run(tmp_path)


def test_a_broken_facility_in_the_header_is_named(tmp_path: Path) -> None:
    with Journal.create(tmp_path, header(facility="name = 3")) as journal:
        references(journal)
        journal.record("point", index=0, **reading(geometry(40.0), 0.5, 10.0))
    with pytest.raises(InputError, match="header: facility"):
        rebuild_run(tmp_path)


def test_every_component_says_how_its_errors_belong_together(tmp_path: Path) -> None:
    """Noise is new at every point, the rest moves all points together; of stability nobody knows."""
    run = rebuild_run(four_points(tmp_path))
    forms = {name: run[name].attrs.get("err_corr_1_form") for name in run["brf"].attrs["unc_comps"]}
    assert len(forms) == 12
    assert forms.pop("u_brf_noise") == "random"
    assert forms.pop("u_brf_stability") is None
    assert set(forms.values()) == {"systematic"}
    assert {run[name].attrs["err_corr_1_dim"] for name in forms} == {"point"}
    assert all(len(run[name].attrs["err_corr_1_params"]) == 0 for name in forms)

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tomli_w
import xarray as xr
from traced_samples import artifact, columns, facility, flat

from instrument.__main__ import main
from instrument.dataset import read_prediction
from instrument.errors import InputError
from instrument.events import Geometry
from twin.material import Material, lambertian
from twin.optics import Setup
from twin.prediction import Twin

REAL = facility(profile="gaussian", mirror=10.8)


@pytest.fixture(scope="module")
def twin() -> Twin:
    return Twin(REAL, artifact(), lambertian(0.6))


def geometry(ill: float, sen: float, phi: float, wavelength: float = 500.0) -> Geometry:
    return Geometry(wavelength=wavelength, illumination_zenith=ill, sensor_zenith=sen, sensor_azimuth=phi)


POINTS = [geometry(0, 40, 45), geometry(15, -60, 50), geometry(30, 75, 120)]


def test_a_prediction_has_the_form_of_the_data_contract(twin: Twin, tmp_path: Path) -> None:
    from instrument.dataset import write_prediction

    prediction = twin.predict(POINTS, standard_error=0.01)
    assert set(prediction.data_vars) == {"brf", "u_brf", "u_brf_monte_carlo"}
    assert "Monte Carlo" in prediction.attrs["u_brf_contains"] or "ray tracer" in prediction.attrs["u_brf_contains"]
    assert prediction.attrs["material"] == twin.material.describe()
    np.testing.assert_array_equal(prediction.u_brf, prediction.u_brf_monte_carlo)
    write_prediction(prediction, tmp_path / "prediction.nc")
    again = read_prediction(tmp_path / "prediction.nc")
    np.testing.assert_array_equal(again.brf, prediction.brf)
    np.testing.assert_array_equal(again.sensor_zenith, [40, -60, 75])


def test_the_requested_standard_error_is_reached(twin: Twin) -> None:
    prediction = twin.predict(POINTS, standard_error=0.004)
    assert float((prediction.u_brf_monte_carlo / prediction.brf).max()) <= 0.004


def test_a_finer_prediction_agrees_with_a_coarser_one(twin: Twin) -> None:
    coarse, fine = twin.predict(POINTS, standard_error=0.02, seed=5), twin.predict(POINTS, standard_error=0.002, seed=6)
    assert np.all(np.abs(coarse.brf - fine.brf) < 5 * np.hypot(coarse.u_brf, fine.u_brf))
    assert fine.attrs["sight_lines"] > coarse.attrs["sight_lines"]


def test_a_point_alone_is_predicted_as_within_a_plan(twin: Twin) -> None:
    together = twin.predict(POINTS, samples=2048)
    alone = twin.predict(POINTS[1:2], samples=2048)
    assert float(alone.brf[0]) == pytest.approx(float(together.brf[1]), rel=1e-6)


def test_a_dataset_keeps_its_coordinates(twin: Twin) -> None:
    run = xr.Dataset(coords={name: ("point", value) for name, value in columns(15.0, [20.0, 30.0], 50.0).items()})
    run = run.assign_coords(time=("point", np.array(["2024-01-01", "2024-01-02"], dtype="datetime64[ns]")))
    prediction = twin.predict(run, samples=256)
    assert list(prediction.time.values) == list(run.time.values)


def test_nothing_to_predict_is_an_empty_prediction(twin: Twin) -> None:
    assert twin.predict([], standard_error=0.01).sizes["point"] == 0


def test_a_flat_lambertian_sample_reads_its_reflectance() -> None:
    prediction = Twin(REAL, flat(), lambertian(0.8)).predict(POINTS, standard_error=0.001)
    assert np.all(np.abs(prediction.brf - 0.8) < 5 * prediction.u_brf)


def test_a_change_of_the_instrument_that_the_reference_shares_cancels() -> None:
    """A wider iris lets more light in, on the reference as well: a flat sample reads the same at normal view."""
    twin = Twin(facility(profile="gaussian", target=30.0), flat(), lambertian(0.8))
    prediction = twin.predict([geometry(0, 15, 0)], samples=2**16, setup=Setup(beam_radius_mm=0.5))
    assert float(prediction.brf[0]) == pytest.approx(0.8, rel=2e-3)


def test_a_raised_sample_leaves_the_field_of_view() -> None:
    """Raised by h, the lit spot wanders by h sin(zenith) across the target: inside it nothing changes."""
    thin = Twin(facility(2.0), flat(), lambertian(0.8))
    inside, outside = (
        float(thin.predict([geometry(0, 75, 45)], samples=2**15, setup=Setup(height_mm=h)).brf[0]) for h in (5.0, 6.0)
    )
    assert inside == pytest.approx(0.8, rel=5e-3)
    assert outside == 0.0


@pytest.mark.parametrize(
    ("point", "message"),
    [
        (geometry(0, 90, 45), "sensor_zenith: found 90 degrees"),
        (geometry(-90, 10, 45), "illumination_zenith: found -90 degrees"),
    ],
)
def test_grazing_geometries_are_refused(twin: Twin, point: Geometry, message: str) -> None:
    with pytest.raises(InputError, match=message):
        twin.predict([point])


def test_a_wavelength_without_a_table_is_refused() -> None:
    plain = lambertian(0.5)
    material = Material(
        plain.cos_o, plain.phi_rad, plain.cos_i, plain.brdf, wavelengths=np.array([500.0]), name="coupon"
    )
    with pytest.raises(InputError, match="a prediction at 600 nm"):
        Twin(REAL, flat(), material).predict([geometry(0, 10, 45, 600.0)])


@pytest.mark.parametrize("standard_error", [0.0, -1.0, None])
def test_a_standard_error_that_cannot_be_reached_is_refused(twin: Twin, standard_error: float | None) -> None:
    with pytest.raises(InputError, match="standard_error"):
        twin.predict(POINTS, standard_error=standard_error)


def test_a_single_point_reaches_the_standard_error_that_was_asked_for(twin: Twin) -> None:
    for point in POINTS:
        predicted = twin.predict([point], standard_error=0.001)
        assert float(predicted.u_brf_monte_carlo[0]) <= 0.001 * float(predicted.brf[0])


@pytest.mark.slow
def test_errors_of_an_adaptive_prediction_are_honest(twin: Twin) -> None:
    """68 and 95 % are covered and nothing is off, although the numbers of sight lines follow from the noise."""
    plan = columns([0, 15, 30, 30], [50.0, -25, 75, 5], [45.0, 50, 60, 120])
    truth = twin.estimate(plan, samples=2**16, seed=999)  # 0.05 %: a fifteenth of what is judged
    runs = [twin.estimate(plan, standard_error=0.01, seed=seed) for seed in range(100)]
    gap = np.array([run.brf - truth.brf for run in runs])
    z = gap / np.hypot([run.standard_error for run in runs], truth.standard_error)
    assert np.mean(np.abs(z) < 1) == pytest.approx(0.683, abs=0.07)  # three standard deviations
    assert np.mean(np.abs(z) < 2) == pytest.approx(0.954, abs=0.033)
    assert np.mean(z**2) == pytest.approx(1.0, abs=0.22)
    assert np.abs(np.mean(z)) < 4 / np.sqrt(z.size)
    assert max(float(np.max(run.standard_error / run.brf)) for run in runs) < 0.0105


class TestCommand:
    @pytest.fixture
    def files(self, tmp_path: Path) -> dict[str, Path]:
        from sim_fixtures import examples

        folder = Path(examples.__file__).parent
        plan = tmp_path / "plan.toml"
        text = (folder / "table_iv.toml").read_text()
        plan.write_text(text)
        return {"plan": plan, **{name: folder / f"{name}.toml" for name in ("facility", "artifact")}}

    def run(self, *arguments: object) -> int:
        """Exit status, in this process."""
        try:
            return main(["predict", *map(str, arguments)])
        except SystemExit as end:
            return int(end.code or 0)

    def refusal(self, capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
        """What is said of input that ends with status 2."""
        assert self.run(*arguments) == 2
        return capsys.readouterr().err

    def test_a_run_is_predicted_into_a_file(
        self, files: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        data = columns(15.0, [20.0, -40.0], 50.0)
        run = xr.Dataset(
            {"brf": ("point", [0.4, 0.4], {"units": "1"}), "u_brf": ("point", [0.004, 0.004], {"units": "1"})},
            coords={
                name: ("point", value, {"units": "nm" if name == "wavelength" else "degree"})
                for name, value in data.items()
            },
        )
        run.to_netcdf(tmp_path / "run.nc", engine="h5netcdf")
        table = tmp_path / "table.nc"
        plain = lambertian(0.5)
        xr.Dataset(
            {"brdf": (("cos_theta_o", "phi_d", "cos_theta_i"), plain.brdf[0], {"units": "sr^-1"})},
            coords={
                "cos_theta_o": plain.cos_o,
                "phi_d": ("phi_d", plain.phi_rad, {"units": "rad"}),
                "cos_theta_i": plain.cos_i,
            },
        ).to_netcdf(table, engine="h5netcdf")
        status = self.run(
            tmp_path / "run.nc", "--artifact", files["artifact"], "--material", table, "--facility", files["facility"],
            "--out", tmp_path / "prediction.nc", "--standard-error", "0.01",
        )  # fmt: skip
        said = capsys.readouterr()
        assert status == 0, said.err
        assert "2 points" in said.out
        prediction = read_prediction(tmp_path / "prediction.nc")
        assert np.all((prediction.brf > 0.1) & (prediction.brf < 0.5))

    def test_bad_input_is_one_line_and_status_2(
        self, files: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        said = self.refusal(
            capsys, files["plan"], "--artifact", files["artifact"], "--material", tmp_path / "absent.nc",
            "--facility", files["facility"], "--out", tmp_path / "prediction.nc",
        )  # fmt: skip
        assert "absent.nc: no such file" in said
        assert said.count("\n") == 1
        assert not (tmp_path / "prediction.nc").exists()

    def test_an_artifact_with_an_impossible_cavity_is_refused(
        self, files: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        (tmp_path / "holes.csv").write_text("hole,x_mm,y_mm,diameter_mm,u_x_mm,u_y_mm,u_diameter_mm\n0,0,0,2,0,0,0\n")
        content = {"holes": "holes.csv", "plate_thickness": 3.0, "cavity_depth": 2.0}
        (tmp_path / "artifact.toml").write_text(tomli_w.dumps(content))
        said = self.refusal(
            capsys, files["plan"], "--artifact", tmp_path / "artifact.toml", "--material", tmp_path / "absent.nc",
            "--facility", files["facility"], "--out", tmp_path / "prediction.nc",
        )  # fmt: skip
        assert "cavity_depth: found 2 mm" in said

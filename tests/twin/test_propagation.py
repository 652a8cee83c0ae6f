from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from test_state_vector import RANDOM, SYSTEMATIC, coupon, uncertain
from traced_samples import artifact, columns, facility, flat

from instrument.__main__ import main
from instrument.dataset import read_prediction, write_prediction
from instrument.events import Geometry
from twin.budget_table import budget_table
from twin.coupon import from_coupon
from twin.material import lambertian
from twin.propagation import Propagation, by_draws, by_sensitivities, squares
from twin.propagation_dataset import RAY_TRACER, propagate
from twin.propagation_designs import BothWays, Together, designs
from twin.propagation_render import PlanRenderer, measurement_function, punpy_inputs
from twin.state_vector import StateVector, state_vector

#: A beam of 2 mm well inside the field of view: the reading goes with the cosine of the view alone.
NARROW = facility(2.0, target=30.0)
#: A field of view of 2 mm well inside an even beam: the reading goes with the cosine of the illumination alone.
WIDE = facility(60.0, target=2.0)
BRF = 0.8
ZENITHS = np.array([0.0, 30.0, 60.0, -60.0, 75.0])


def slopes(state: StateVector, label: str, ill: float, sen: np.ndarray, phi: float = 0.0) -> np.ndarray:
    """Relative sensitivity to an angle, 1/rad."""
    renderer = PlanRenderer(state, columns(ill, sen, phi), seed=3)
    result = by_sensitivities(renderer, tolerance=0.02)
    return result.sensitivity[label] / BRF / np.deg2rad(1.0)


class TestClosedForms:
    """A flat Lambertian sample, whose readings are products of cosines."""

    def test_an_error_of_the_sensor_zenith_shows_as_minus_tan_zenith_less_that_of_the_reference(self) -> None:
        state = state_vector(uncertain(NARROW, arms={"u_sensor_zenith": 0.2}), flat(), lambertian(BRF))
        expected = -np.tan(np.deg2rad(ZENITHS)) + np.tan(np.deg2rad(15.0))
        np.testing.assert_allclose(slopes(state, "sensor zenith", 0.0, ZENITHS, 45.0), expected, rtol=0.02, atol=0.01)

    def test_an_error_of_the_illumination_zenith_shows_as_minus_tan_zenith(self) -> None:
        state = state_vector(uncertain(WIDE, arms={"u_illumination_zenith": 0.2}), flat(), lambertian(BRF))
        sen = np.array([0.0, 20.0])
        np.testing.assert_allclose(
            slopes(state, "illumination zenith", 40.0, sen, 90.0), -np.tan(np.deg2rad(40)), atol=0.01
        )

    def test_a_tilt_turns_the_sample_towards_the_view(self) -> None:
        state = state_vector(uncertain(NARROW, sample={"u_tilt": 0.2}), flat(), lambertian(BRF))
        expected = np.tan(np.deg2rad(ZENITHS))
        np.testing.assert_allclose(slopes(state, "sample tilt y", 20.0, ZENITHS), expected, rtol=0.02, atol=0.01)
        np.testing.assert_allclose(slopes(state, "sample tilt x", 20.0, ZENITHS, 90.0), -expected, rtol=0.02, atol=0.01)
        np.testing.assert_allclose(slopes(state, "sample tilt x", 20.0, ZENITHS), 0.0, atol=0.01)

    def test_a_systematic_error_of_the_coupon_passes_unchanged_and_is_common_to_all_points(self) -> None:
        run = coupon(reference=(0.005, SYSTEMATIC))
        state = state_vector(NARROW, flat(), from_coupon(run, "coupon"), run)
        result = by_sensitivities(PlanRenderer(state, columns(0.0, ZENITHS, 45.0), seed=3))
        np.testing.assert_allclose(result.u, 0.003, rtol=0.03)
        np.testing.assert_allclose(result.correlation(), 1.0, atol=0.01)
        assert result.curvature.get("material reference", 0.0) < 1e-2

    def test_a_random_error_of_the_coupon_stays_with_the_points_that_use_it(self) -> None:
        """At a node of the table the reading is the mean of the coupon's points there: both mirror azimuths or one."""
        run = coupon(noise=(0.01, RANDOM))
        state = state_vector(NARROW, flat(), from_coupon(run, "coupon"), run)
        points = columns([0.0, 30.0], [25.0, 25.0], [0.0, 90.0])
        table = state.nominal_material
        result = by_sensitivities(PlanRenderer(state, points, seed=3), rows=64)
        expected = []
        for ill, sen, phi in ((0.0, 25.0, 0.0), (30.0, 25.0, 90.0)):
            cosines, azimuth = np.cos(np.deg2rad([sen, ill])), np.deg2rad(phi)
            change = []
            for point in range(run.sizes["point"]):
                error = np.zeros(run.sizes["point"])
                error[point] = 0.006
                other = state.material(error)
                change.append(
                    np.pi
                    * float(
                        other.evaluate(cosines[0], azimuth, cosines[1])
                        - table.evaluate(cosines[0], azimuth, cosines[1])
                    )
                )
            expected.append(np.sqrt(np.sum(np.square(change))))
        np.testing.assert_allclose(result.u, expected, rtol=0.3)


def test_many_parameters_of_one_source_add_up_as_squares() -> None:
    """A weighing design of more parameters than rows is right in the mean over its signs; of fewer, exactly."""
    generator = np.random.default_rng(2)
    for count, repeats, tolerance in ((20, 1, 1e-12), (100, 200, 0.05)):
        slope = generator.normal(size=count)
        state = StateVector(*fake_state(count))
        found = []
        for seed in range(repeats):
            (design,) = designs(state, seed)
            assert isinstance(design, Together)
            differences = np.array([value @ slope for value in design.values])
            effects = design.effects(np.repeat(differences[:, None, None], 8, axis=2))
            found.append(float(squares(effects)[0][0]))
            if count == 20:
                assert [float(s[0, 0]) for s in design.slopes(effects).values()] == pytest.approx(slope)
        assert np.mean(found) == pytest.approx(np.sum(slope**2), rel=tolerance)


def fake_state(count: int) -> tuple:
    from twin.optics import Setup
    from twin.state_vector import Block, Inputs

    block = Block("many", tuple(map(str, range(count))), "many", "1", np.zeros(count), np.ones(count), lambda i, _: i)
    return facility(), Inputs(Setup(), flat()), lambertian(0.5), (block,)


def test_linear_and_quadratic_effects_of_a_normal_parameter_give_its_exact_variance() -> None:
    """y = a z + b z^2 with standard normal z: mean b, variance a^2 + 2 b^2."""
    step, a, b = np.sqrt(3.0), 0.3, -0.2
    differences = np.array([a * z + b * z**2 for z in (step, -step)])[:, None, None] * np.ones((1, 1, 8))
    design = BothWays("p", "p", [], 2.0)
    effects, curved = design.effects(differences), design.curved(differences)
    assert squares(np.concatenate([effects, curved]))[0] == pytest.approx(a**2 + 2 * b**2)
    assert curved.mean() == pytest.approx(np.sqrt(2) * b)
    assert design.slopes(effects)["p"] == pytest.approx(a / 2)


def test_monte_carlo_noise_does_not_count_as_uncertainty() -> None:
    generator = np.random.default_rng(1)
    true = np.array([0.0, 1.0, 3.0])
    noisy = true[None, :, None] + generator.normal(scale=2.0, size=(4000, 3, 8))
    variance, noise = squares(noisy)
    np.testing.assert_allclose(variance / 4000, true**2, atol=0.1)
    np.testing.assert_allclose(noise / 4000, 4.0 / 8, rtol=0.05)


def test_the_correlation_is_one_of_a_covariance() -> None:
    generator = np.random.default_rng(1)
    factor = generator.normal(size=(30, 3))
    noise = np.full(30, 0.5)
    result = Propagation(
        {"all": np.sum(factor**2, axis=1)}, np.hstack([factor, np.sqrt(0.5) * np.eye(30)]), noise, noise, noise
    )
    correlation = result.correlation()
    expected = factor @ factor.T
    length = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(correlation, expected / length / length[:, None], atol=1e-9)


PLATE = artifact([(x, y, 2.55) for x in (-5.4, -1.8, 1.8, 5.4) for y in (-5.4, -1.8, 1.8, 5.4)])


@pytest.fixture(scope="module")
def whole() -> StateVector:
    """Every kind of parameter at once, on a plate of few holes."""
    from dataclasses import replace

    run = coupon(noise=(0.01, RANDOM), stability=(0.01, {}), reference=(0.005, SYSTEMATIC))
    u = np.full(len(PLATE.holes), 0.01)
    holes = replace(PLATE.holes, u_x=u, u_y=u, u_diameter=2 * u)
    form = PLATE.form.model_copy(update={"u_plate_thickness": 0.04, "u_cavity_depth": 0.02})
    known = uncertain(
        facility(profile="gaussian", mirror=10.8),
        arms={"u_illumination_zenith": 0.25, "u_sensor_zenith": 0.25, "u_sensor_azimuth": 0.25},
        sample={"u_tilt": 0.1, "u_offset": 0.1, "u_height": 0.1, "u_azimuth": 0.25},
        beam={"u_divergence": 0.05, "u_diameter": 0.02},
    )
    return state_vector(known, replace(PLATE, form=form, holes=holes), from_coupon(run, "coupon"), run)


PLAN = columns([0.0, 0.0, 15.0, 30.0], [20.0, -50.0, 70.0, 40.0], [45.0, 90.0, 50.0, 120.0])


@pytest.fixture(scope="module")
def varied(whole: StateVector) -> Propagation:
    """By sensitivities."""
    return by_sensitivities(PlanRenderer(whole, PLAN, seed=2), tolerance=0.05)


@pytest.fixture(scope="module")
def drawn(whole: StateVector) -> Propagation:
    """By 150 draws, with other random numbers of the ray tracer, whose noise is little beside the scatter of 150."""
    return by_draws(PlanRenderer(whole, PLAN, seed=77), draws=150, samples=2**11, seed=31)


@pytest.mark.slow
def test_sensitivities_and_draws_agree(varied: Propagation, drawn: Propagation) -> None:
    error = np.hypot(varied.u_error, drawn.u_error)
    assert np.all(np.abs(varied.u / drawn.u - 1) < 4 * error)
    np.testing.assert_allclose(varied.correlation(), drawn.correlation(), atol=0.35)


@pytest.mark.slow
def test_the_stated_uncertainty_covers_truths_drawn_from_the_inputs(varied: Propagation, drawn: Propagation) -> None:
    off = drawn.factor * np.sqrt(drawn.factor.shape[1] - 1) + drawn.mean_shift[:, None]
    score = np.abs(off) / varied.u[:, None]
    # 150 truths: the shares scatter by 3.8 and 1.8 % at a point.
    assert score.shape == (4, 150)
    assert np.all(np.abs(np.mean(score < 1, axis=1) - 0.683) < 0.14)
    assert np.all(np.mean(score < 2, axis=1) > 0.89)


def test_a_prediction_carries_its_budget(whole: StateVector, tmp_path: Path) -> None:
    points = [
        Geometry(wavelength=500.0, illumination_zenith=0.0, sensor_zenith=z, sensor_azimuth=45.0) for z in (20.0, 60.0)
    ]
    prediction = propagate(whole, points, standard_error=0.01, tolerance=0.5)
    np.testing.assert_allclose(prediction.variance_share.sum("source"), 1.0)
    np.testing.assert_allclose(prediction.u_brf, np.hypot(prediction.u_brf_inputs, prediction.u_brf_monte_carlo))
    assert list(prediction.source.values)[-1] == RAY_TRACER
    slope = prediction.sensitivity.sel(parameter="material reference").values
    assert np.all((slope > 0.005 * prediction.brf.values) & (slope < 0.0075 * prediction.brf.values))
    write_prediction(prediction, tmp_path / "prediction.nc")
    again = read_prediction(tmp_path / "prediction.nc")
    matrix = again[again.u_brf_inputs.attrs["err_corr_1_params"]]
    np.testing.assert_allclose(np.diag(matrix), 1.0, rtol=1e-6)
    table = budget_table(prediction, whole)
    assert [str(cell) for cell in table.columns[0].cells] == [*prediction.source.values, "combined"]


def test_the_measurement_function_takes_the_blocks_of_the_vector(whole: StateVector) -> None:
    renderer = PlanRenderer(whole, columns(0.0, [20.0], 45.0), seed=2)
    f = measurement_function(renderer, 1024)
    nominal, u = punpy_inputs(whole)
    assert f(*nominal) == pytest.approx(renderer.render([whole.nominal], 1024)[0].mean(axis=-1))
    reference = [block.name for block in whole.blocks].index("material reference")
    nominal[reference] = nominal[reference] + 2 * u[reference]
    assert f(*nominal) > renderer.render([whole.nominal], 1024)[0].mean(axis=-1)
    with pytest.raises(ValueError, match="inputs: found shapes"):
        f(*nominal[:-1])


@pytest.mark.slow
def test_the_command_prints_the_budget_and_writes_the_shares(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    examples = Path(__file__).parents[2] / "sim_fixtures" / "examples"
    (tmp_path / "flat.toml").write_text("block_thickness = 5.0\n")
    (tmp_path / "run.csv").write_text(
        "wavelength,illumination_zenith,illumination_azimuth,sensor_zenith,sensor_azimuth,brf,u_brf\n"
        "500,0,0,40,45,0.6,0.01\n500,15,0,-60,50,0.6,0.01\n"
    )
    files = ["--artifact", tmp_path / "flat.toml", "--material", examples / "material.nc"]
    files += ["--facility", examples / "facility.toml", "--out", tmp_path / "prediction.nc"]
    with pytest.raises(SystemExit, match="0"):
        main(["predict", *map(str, [tmp_path / "run.csv", *files]), "--standard-error", "0.01", "--uncertainty"])
    said = capsys.readouterr().out
    for row in ("sensor zenith", "material stability", "ray tracer", "combined"):
        assert row in said
    assert "correlation not stated, taken as slice" in said
    prediction = read_prediction(tmp_path / "prediction.nc")
    assert np.all(prediction.u_brf > prediction.u_brf_monte_carlo)
    assert "material noise" in prediction.source.values


def test_an_evaluation_does_not_depend_on_its_company(whole: StateVector) -> None:
    """Alone, with others of its dimensions in one launch, or after other dimensions: the same numbers."""
    renderer = PlanRenderer(whole, columns(0.0, [20.0, -50.0], 45.0), seed=2)
    shape = np.concatenate([np.full(len(block), block.changes_shape) for block in whole.blocks])
    drawn = whole.draw(3, 4)
    values = [whole.nominal, *drawn[:2], *np.where(shape, whole.nominal, drawn[2:])]
    together = renderer.render(values, 256)
    assert renderer.alike(values) == ([0, 3, 4], [1, 2])
    for value, expected in zip(values, together, strict=True):
        np.testing.assert_allclose(renderer.render([value], 256)[0], expected, rtol=1e-9)


def test_no_other_value_of_an_input_compiles_anything(whole: StateVector) -> None:
    """The plan again with another value of one kind of input after the other: kernels run, and all are known."""
    import drjit as dr

    renderer = PlanRenderer(whole, PLAN, seed=2)
    renderer.render([whole.nominal], 64)
    for block, place in whole.slices():
        if block.name == "beam divergence":
            continue  # the nominal beam is parallel: one that diverges has kernels of its own
        value = whole.nominal.copy()
        value[place] += 2 * block.standard_uncertainty
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            renderer.render([value], 64)
            kernels = dr.kernel_history([dr.KernelType.JIT])
        assert len(kernels) >= 3, block.name
        assert all(kernel["cache_hit"] for kernel in kernels), block.name

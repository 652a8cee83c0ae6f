"""How noise of the ray tracer is kept out of propagated uncertainties, and what is said about what remains."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest
from traced_samples import facility, flat

from instrument.angles import FloatArray
from twin.material import lambertian
from twin.optics import Setup
from twin.propagation import by_sensitivities
from twin.propagation_result import jackknife_error, left_out, squares, variance_error
from twin.state_vector import Block, Inputs, StateVector
from twin.tracer import RANDOMISATIONS


def test_leaving_one_out_is_the_estimate_from_the_others() -> None:
    effects = np.random.default_rng(4).normal(size=(3, 5, 8))
    for r in range(8):
        np.testing.assert_allclose(left_out(effects)[r], squares(np.delete(effects, r, axis=-1))[0])


@pytest.mark.parametrize("common", [False, True])
def test_the_stated_error_of_a_variance_is_its_scatter(common: bool) -> None:
    """Noise that all components have in common adds up, other noise by its squares: both as stated."""
    generator = np.random.default_rng(5)
    true, trials = np.full(9, 0.5), 4000
    noise = generator.normal(scale=0.4, size=(1 if common else len(true), trials, RANDOMISATIONS))
    effects = true[:, None, None] + noise
    variance, _ = squares(effects)
    stated = np.sqrt(np.mean(variance_error(effects) ** 2))
    assert np.mean(variance) == pytest.approx(np.sum(true**2), rel=0.01)
    assert stated == pytest.approx(np.std(variance), rel=0.1)


def test_an_estimate_that_no_randomisation_changes_has_no_error() -> None:
    np.testing.assert_array_equal(jackknife_error(np.ones((RANDOMISATIONS, 3))), 0.0)


@dataclass
class NoisyPlan:
    """A renderer of a known linear response; one point is so noisy that many sight lines are needed for it alone."""

    state: StateVector
    slope: FloatArray
    noise: FloatArray
    seed: int = 1
    asked: list[tuple[int, int]] = field(default_factory=list)
    batch: int = 16

    @property
    def points(self) -> int:
        return len(self.slope)

    def take(self, chosen: np.ndarray, *, seed: int) -> NoisyPlan:
        return NoisyPlan(self.state, self.slope[chosen], self.noise[chosen], seed, self.asked)

    def alike(self, values: list[FloatArray]) -> tuple[list[int], list[int]]:
        return list(range(len(values))), []

    def render(self, values: list[FloatArray], samples: int) -> FloatArray:
        self.asked.append((self.points, samples))
        own = np.random.default_rng([self.seed, samples])
        scatter = (
            own.normal(size=(2, self.points, RANDOMISATIONS)) * self.noise[:, None] * np.sqrt(RANDOMISATIONS / samples)
        )
        z = np.array(values)[:, 0, None, None]
        return 1.0 + scatter[0] + z * (self.slope[:, None] + scatter[1])


def test_a_noisy_point_is_rendered_again_alone() -> None:
    one = Block("p", ("p",), "p", "1", np.zeros(1), np.ones(1), lambda inputs, _: inputs)
    state = StateVector(facility(), Inputs(Setup(), flat()), lambertian(0.5), (one,))
    noise = np.full(12, 0.01)
    noise[7] = 3.0
    plan = NoisyPlan(state, np.full(12, 0.1), noise)
    found = by_sensitivities(plan, tolerance=0.1)  # type: ignore[arg-type]
    assert plan.asked[0][0] == 12
    assert {points for points, _ in plan.asked[1:]} == {1}
    assert [samples for _, samples in plan.asked] == sorted({samples for _, samples in plan.asked})
    # Without that its uncertainty, 0.1, would come out with an error of 3/sqrt(256) = 0.19.
    assert found.u[7] == pytest.approx(0.1, abs=4 * 3.0 / np.sqrt(plan.asked[-1][1]))
    assert found.sensitivity["p"][7] == pytest.approx(0.1, abs=4 * 3.0 / np.sqrt(plan.asked[-1][1]))
    np.testing.assert_allclose(np.delete(found.u, 7), 0.1, rtol=0.05)

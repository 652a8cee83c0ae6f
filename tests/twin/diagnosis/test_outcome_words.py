"""Numbers as they are said, and what was computed of suspected causes."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from twin.diagnosis.effects import effect
from twin.diagnosis.joint import dimmed
from twin.diagnosis.outcome import corrections_of, in_words, parameters
from twin.rounding import chance_of, with_u


@pytest.mark.parametrize(
    ("value", "u", "said"),
    [
        (0.450099, 0.0824, ("0.450", "0.082")),
        (0.450099, 0.0996, ("0.45", "0.10")),
        (1234.56, 250.0, ("1230", "250")),
        (-0.000123, 0.000045, ("-0.000123", "0.000045")),
        (12.34, 1.0, ("12.3", "1.0")),
        (0.5, 0.0, ("0.5", "0")),
    ],
)
def test_value_has_the_digits_of_its_uncertainty(value: float, u: float, said: tuple[str, str]):
    assert with_u(value, u) == said


@pytest.mark.parametrize(
    ("probability", "said"), [(1.0, "> 0.999"), (0.0, "< 0.001"), (0.9994, "0.999"), (0.0206, "0.021"), (0.5, "0.500")]
)
def test_no_probability_is_said_to_be_certain(probability: float, said: str):
    assert chance_of(probability) == said


def test_dimmed_light_weakens_a_nonlinearity_by_its_power_and_nothing_else():
    import numpy as np

    values = np.array([[0.08, 1.0], [0.08, 2.0], [0.08, 0.5]])
    np.testing.assert_allclose(dimmed("detector_nonlinearity", values, 0.25)[:, 0], [0.02, 0.005, 0.04])
    np.testing.assert_array_equal(dimmed("stray_light", values, 0.25), values)


@pytest.mark.parametrize(
    ("name", "values", "said"),
    [
        # The response's own error, 12 % of the change: 0.12 * 0.1.
        ("reflectance_scale", (1.1,), {"ratio": 0.012}),
        # Another law of like form, 30 %: of a width the zero is at 0, not at the nominal 10 degrees.
        ("retroreflection", (0.1, 12.0), {"amplitude": 0.03, "width_deg": 3.6}),
        # A direction knows no proportion, but from its nominal value.
        ("anisotropy", (0.1, 0.0), {"amplitude": 0.012, "axis_deg": 0.0}),
    ],
)
def test_parameters_are_as_uncertain_as_the_law_they_assume(
    name: str, values: tuple[float, ...], said: dict[str, float]
):
    one = effect(name)
    some = one.parameters[: len(values)]
    response = SimpleNamespace(effect=one, parameters=some)
    diagnosis = SimpleNamespace(prepared=SimpleNamespace(responses=SimpleNamespace(found={name: response})))
    named = SimpleNamespace(effect=name, values=values, u=(0.0,) * len(values))
    found = parameters(diagnosis, named)  # type: ignore[arg-type]
    assert {key: entry["u"] for key, entry in found.items()} == pytest.approx(said)


@pytest.mark.parametrize(("withheld", "effects", "said"), [(None, 1, "32 % less"), (0.031, 0, "3.10 % once corrected")])
def test_effect_whose_correction_is_withheld_is_named_and_not_corrected_for(
    withheld: float | None, effects: int, said: str
):
    one = effect("dark_offset")
    response = SimpleNamespace(effect=one, parameters=one.parameters)
    named = SimpleNamespace(
        effect="dark_offset", members=("dark_offset",), probability=0.99, values=(0.01,), u=(0.001,)
    )
    gap = SimpleNamespace(
        heldout_before=0.025, heldout_after=0.017, plain_shrink=0.32, removable=0.4, shrink=0.9,
        interval=(0.7, 1.0), withheld=withheld,
    )  # fmt: skip
    diagnosis = SimpleNamespace(
        prepared=SimpleNamespace(
            responses=SimpleNamespace(found={"dark_offset": response}),
            problem=SimpleNamespace(run=SimpleNamespace(name="run.nc")),
        ),
        decision=SimpleNamespace(verdict="effects", named=(named,), ranking=(named,)),
        posterior=SimpleNamespace(hypotheses=(), probability=()),
        where=(), gap=gap, proposals=(),
    )  # fmt: skip
    assert len(corrections_of(diagnosis).effects) == effects  # type: ignore[arg-type]
    text = " ".join(in_words(diagnosis))  # type: ignore[arg-type]
    assert "dark_offset" in text
    assert said in text

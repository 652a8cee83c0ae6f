"""The page on the diagnosis: its effect works, its keys are those of the output, its commands exist."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from synthetic_runs import effects as formulas
from synthetic_runs import errors, grid, nominal, observed, problem, with_change

from twin.diagnosis import effects, posterior
from twin.diagnosis.acquisition import Acquisition, travel_direction
from twin.diagnosis.diagnose import diagnose
from twin.diagnosis.effects import Effect
from twin.diagnosis.outcome import to_dict
from twin.diagnosis.preparation import Prepared
from twin.diagnosis.response import ComputedResponse
from twin.diagnosis.responses import Responses
from twin.diagnosis.verdict import decide

PAGE = (Path(__file__).parents[3] / "docs" / "diagnosis.md").read_text()
COLUMNS = grid({0.0: (0.0, 90.0), 30.0: (0.0, 60.0)}, 10.0)


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", PAGE, flags=re.DOTALL)


@pytest.fixture
def warm_up(monkeypatch: pytest.MonkeyPatch) -> Effect:
    """The page's effect, installed as the page's entry point says."""
    (source,), (entry,) = blocks("python"), re.findall(r'= "(our_effects):(\w+)"', PAGE)
    module = ModuleType(entry[0])
    monkeypatch.setitem(sys.modules, entry[0], module)
    exec(compile(source, "docs/diagnosis.md", "exec"), vars(module))
    installed = SimpleNamespace(name="x", value=":".join(entry), load=lambda: getattr(module, entry[1]))
    monkeypatch.setattr(effects, "entry_points", lambda group: [installed] if group == "goniotwin.effects" else [])
    return effects.library.__wrapped__()["detector_warm_up"]


def acquisition(progress: np.ndarray | None) -> Acquisition:
    order = np.arange(len(COLUMNS["wavelength"]))
    return Acquisition(
        COLUMNS,
        np.ones(len(order)),
        15.0,
        np.array([0.0]),
        np.maximum(order - 1, 0),
        travel_direction(COLUMNS, order),
        progress,
    )


def response(effect: Effect) -> ComputedResponse:
    run = acquisition(observed(COLUMNS).progress)
    return ComputedResponse(effect, effect.parameters, run, nominal(COLUMNS))


def test_effect_of_the_page_does_what_it_says(warm_up: Effect):
    found = response(warm_up).relative(np.array([[0.1, 0.2]]))[0]
    assert found[0] == pytest.approx(0.1)
    assert found[-1] == pytest.approx(0.1 * np.exp(-5.0))


def test_effect_of_the_page_is_ruled_out_without_times(warm_up: Effect):
    assert warm_up.missing(acquisition(None)) == ("progress",)


def test_effect_of_the_page_is_named_in_a_run_that_has_it(warm_up: Effect):
    own = response(warm_up)
    rest = [formulas(COLUMNS)[name] for name in ("tilt", "stray")]
    change = own.log_ratio(np.array([[0.15, 0.15]]))[0] + errors(COLUMNS, "independent, 1 times the budget", seed=3)
    decision = decide(with_change(problem(observed(COLUMNS), [own, *rest]), change).posterior())
    assert [named.effect for named in decision.named] == ["detector_warm_up"]
    np.testing.assert_allclose(decision.named[0].values, [0.15, 0.15], atol=0.05)


def test_keys_of_the_page_are_those_of_the_output(warm_up: Effect):
    own = response(warm_up)
    change = own.log_ratio(np.array([[0.15, 0.15]]))[0] + errors(COLUMNS, "independent, 1 times the budget", seed=3)
    given = with_change(problem(observed(COLUMNS), [own]), change)
    found = to_dict(diagnose(Prepared(given, Responses({own.name: own}, {}), {})))
    found["parity"] = []  # added by the command
    told = {key for row in re.findall(r"^\| (`[^|]*`) \|", PAGE, flags=re.MULTILINE) for key in _keys(row)}
    assert told >= _tops(found)
    for key in told:
        top, _, rest = key.partition(".")
        assert top in found, key
        value: Any = found[top]
        if rest and not (isinstance(value, list) and not value):
            assert rest in (value[0] if isinstance(value, list) else value), key
    assert found["verdict"] == "effects"
    assert set(found["effects"][0]["parameters"]) == {"fraction", "share"}


def _keys(row: str) -> list[str]:
    return [key.replace("[]", "") for key in re.findall(r"`([^`]+)`", row) if key != "diagnosis.json"]


def _tops(found: dict[str, Any]) -> set[str]:
    """Every key that the output has, with those one level below where there are any."""
    below = {
        f"{top}.{key}"
        for top, value in found.items()
        if top in ("consistency", "where", "probabilities", "effects", "gap")
        for key in (value[0] if isinstance(value, list) else value)
    }
    alone = {top for top, value in found.items() if top not in {key.partition(".")[0] for key in below}}
    return below | alone


def test_priors_of_the_page_are_those_used():
    (said,) = re.findall(r"\*\*Explanations\.\*\*(.*?)\n\n", PAGE, flags=re.DOTALL)
    for name, value in posterior.PRIOR.items():
        assert re.search(rf"\b{re.escape(f'{value:g}')}\b", said), name
    assert sum(posterior.PRIOR.values()) == pytest.approx(1.0)

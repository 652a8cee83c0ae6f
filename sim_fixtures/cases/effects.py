"""The form of an effect, and where effects are found.

An effect is registered where it is written: a function of a world and its parameters under a name, with a draw of its
direction (parameters of amplitude one) and what belongs to an amplitude. Modules are named in
:func:`known_effects`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from importlib import import_module
from typing import Final

import numpy as np

from sim_fixtures.cases.world import World

Parameters = dict[str, float]
Apply = Callable[[World, Mapping[str, float]], World]
Draw = Callable[[np.random.Generator], Parameters]

_MODULES: Final = ("pose_effects", "sample_effects", "signal_effects", "outside_effects")


@dataclass(frozen=True)
class Effect:
    """What can be wrong.

    Attributes
    ----------
    name
        Of the data contract; of this package for effects outside it.
    apply
        The world with the effect.
    draw
        Parameters at amplitude one.
    cap
        Largest amplitude that is physically possible.
    about
        The same parameters without effect, where these are not 0; only parameters that grow with the amplitude.
    fixed
        Parameters that do not grow with the amplitude.
    optical
        The light has to be traced anew.
    outside
        Part of no library: a diagnosis should say that it does not know.
    """

    name: str
    apply: Apply
    draw: Draw
    cap: float
    about: Mapping[str, float] = field(default_factory=dict)
    fixed: frozenset[str] = frozenset()
    optical: bool = True
    outside: bool = False

    def scaled(self, drawn: Mapping[str, float], amplitude: float) -> Parameters:
        """Parameters at an amplitude, of those at one."""
        result = {}
        for name, value in drawn.items():
            about = self.about.get(name, 1.0 if name.startswith("ratio") else 0.0)
            result[name] = float(value if name in self.fixed else about + amplitude * (value - about))
        return result


_REGISTER: Final[dict[str, Effect]] = {}


def effect(
    name: str,
    draw: Draw,
    cap: float,
    *,
    fixed: tuple[str, ...] = (),
    optical: bool = True,
    outside: bool = False,
) -> Callable[[Apply], Apply]:
    """Register a function as an effect; arguments as :class:`Effect`."""

    def register(apply: Apply) -> Apply:
        _REGISTER[name] = Effect(name, apply, draw, cap, {}, frozenset(fixed), optical, outside)
        return apply

    return register


@lru_cache(maxsize=1)
def known_effects() -> dict[str, Effect]:
    """All effects by name."""
    for module in _MODULES:
        import_module(f"sim_fixtures.cases.{module}")
    return dict(_REGISTER)


def either_sign(**values: float) -> Draw:
    """Parameters of which all change sign together, at random."""

    def draw(generator: np.random.Generator) -> Parameters:
        sign = 1.0 if generator.random() < 0.5 else -1.0
        return {k: (1.0 + sign * v if k.startswith("ratio") else sign * v) for k, v in values.items()}

    return draw


def growing(**values: float | tuple[float, float]) -> Draw:
    """Parameters as given; pairs are drawn evenly between their ends."""

    def draw(generator: np.random.Generator) -> Parameters:
        return {k: float(generator.uniform(*v)) if isinstance(v, tuple) else v for k, v in values.items()}

    return draw


def any_way(size: float, first: str, second: str) -> Draw:
    """Two components of a vector of given size in a random direction."""

    def draw(generator: np.random.Generator) -> Parameters:
        turn = generator.uniform(0.0, 2.0 * np.pi)
        return {first: float(size * np.cos(turn)), second: float(size * np.sin(turn))}

    return draw

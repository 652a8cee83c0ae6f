"""What a set of cases is made of: how many of which kind, in an order that tells nothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import cycle, islice
from typing import Final, Literal

import numpy as np

from instrument.plan import Direction
from sim_fixtures.cases.effects import known_effects
from sim_fixtures.cases.families import FAMILIES

Kind = Literal["none", "single", "double", "outside"]
#: Shares of a set of which only the size is given: those of the final one (380 cases).
_SHARES: Final[dict[Kind, float]] = {"none": 80 / 380, "single": 200 / 380, "double": 40 / 380, "outside": 60 / 380}
#: Share of runs that sweep back and forth; half of those with backlash, which shows in no other.
_SERPENTINE: Final = 0.25
_NO_STABILITY: Final = "none"


@dataclass(frozen=True)
class Composition:
    """Numbers of cases by kind, and the severities that are asked for.

    Attributes
    ----------
    none
        Sound runs, evenly over the families of instability.
    single
        Runs with one effect, evenly over effects and then over ``severities``.
    double
        Runs with two effects at ``double_severity`` each.
    outside
        Runs with an effect of no library, evenly over them and then over ``outside_severities``.
    effects
        Names of the effects for single and double; all of the library where empty.
    """

    none: int
    single: int
    double: int
    outside: int
    severities: tuple[float, ...] = (0.5, 1.0, 2.0, 4.0)
    double_severity: float = 2.0
    outside_severities: tuple[float, ...] = (2.0, 4.0)
    effects: tuple[str, ...] = ()

    @classmethod
    def of_size(cls, cases: int) -> Composition:
        """A set of given size in the shares of the final trial.

        Raises
        ------
        ValueError
            If ``cases`` is less than 4.
        """
        if cases < len(_SHARES):
            raise ValueError(f"a set needs at least {len(_SHARES)} cases, one of each kind; found {cases}")
        counts = {kind: max(1, round(share * cases)) for kind, share in _SHARES.items()}
        counts["single"] += cases - sum(counts.values())
        return cls(counts["none"], counts["single"], counts["double"], counts["outside"])

    @property
    def size(self) -> int:
        """Number of cases."""
        return self.none + self.single + self.double + self.outside


@dataclass(frozen=True)
class Order:
    """One case to be made: its number from 1, kind, seed and what :meth:`CaseMaker.make` is given."""

    number: int
    kind: Kind
    seed: int
    effects: tuple[str, ...]
    severity: float | None
    noise_family: str
    scan_direction: Direction

    @property
    def name(self) -> str:
        """Of the case, as in the file's name."""
        return f"case{self.number:04d}"


def orders(composition: Composition, seed: int) -> list[Order]:
    """The cases of a set, shuffled.

    Raises
    ------
    KeyError
        If an effect is unknown.
    """
    generator = np.random.default_rng((seed, 21))
    known = known_effects()
    library = [known[name].name for name in composition.effects] or [e.name for e in known.values() if not e.outside]
    beyond = [one.name for one in known.values() if one.outside]
    wanted: list[tuple[Kind, tuple[str, ...], float | None, str]] = [
        ("none", (), None, family) for family in islice(cycle(FAMILIES), composition.none)
    ]
    singles = _spread(library, composition.severities, composition.single, generator)
    outsiders = _spread(beyond, composition.outside_severities, composition.outside, generator)
    unstable = [family for family in FAMILIES if family != _NO_STABILITY]
    wanted += [("single", (name,), severity, str(generator.choice(unstable))) for name, severity in singles]
    for _ in range(composition.double):
        pair = tuple(str(name) for name in generator.choice(library, 2, replace=False))
        wanted.append(("double", pair, composition.double_severity, str(generator.choice(unstable))))
    wanted += [("outside", (name,), severity, str(generator.choice(unstable))) for name, severity in outsiders]
    seeds = np.random.SeedSequence((seed, 22)).generate_state(len(wanted))
    result = []
    for number, index in enumerate(generator.permutation(len(wanted)), start=1):
        kind, effects, severity, family = wanted[index]
        back_and_forth = generator.random() < (0.5 if "backlash" in effects else _SERPENTINE)
        direction: Direction = "serpentine" if back_and_forth else "unidirectional"
        result.append(Order(number, kind, int(seeds[index]), effects, severity, family, direction))
    return result


def _spread(
    names: Sequence[str], severities: Sequence[float], count: int, generator: np.random.Generator
) -> list[tuple[str, float]]:
    """Every name as often as any other, and for each name the severities in turn, from a random one on."""
    result: list[tuple[str, float]] = []
    first = {name: int(generator.integers(len(severities))) for name in names}
    for turn in range(-(-count // max(len(names), 1))):
        order = [names[i] for i in generator.permutation(len(names))]
        result += [(name, severities[(first[name] + turn) % len(severities)]) for name in order]
    return result[:count]

"""Scores diagnoses against what was really wrong: by kind, by severity, by effect, with confidence intervals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import permutations
from typing import Any, Literal

import numpy as np

from twin.diagnosis.gap import shrink_of
from twin.diagnosis.observation import Observation
from twin.diagnosis.trial_reliability import Bin, bins, expected_calibration_error

Kind = Literal["none", "single", "double", "outside"]
#: A wrong claim with more probability than this is a confident one.
CONFIDENT = 0.9
_LEVEL = 0.95
#: Standard uncertainties on either side of a value within which the truth should lie so often.
_COVERAGE = 1.96


@dataclass(frozen=True)
class Truth:
    """What was wrong in a run.

    Attributes
    ----------
    effects
        Names; empty for a sound run.
    outside
        Whether the cause is in no library.
    severity
        Of the noise-free gap.
    family
        How the stability of the run was correlated.
    where
        Points whose gap exceeds the uncertainty.
    gap
        Noise-free relative change of every point; empty where it is not known.
    parameters
        Of each effect; empty where they are not known.
    brf
        That would be read without noise and instability, effect included; empty where it is not known.
    """

    effects: tuple[str, ...]
    outside: bool
    severity: float
    family: str
    where: tuple[int, ...]
    gap: tuple[float, ...] = ()
    parameters: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    brf: tuple[float, ...] = ()

    @property
    def kind(self) -> Kind:
        """What is asked of the diagnosis."""
        if self.outside:
            return "outside"
        return "none" if not self.effects else "single" if len(self.effects) == 1 else "double"

    @classmethod
    def of(cls, label: Mapping[str, Any]) -> Truth:
        """From the label of a case: names under ``effects``, and ``gap_over_u``, ``where``, ``delta`` where known."""
        outside, effects = label.get("outside") or (), label["effects"]
        return cls(
            tuple(effects),
            bool(outside),
            float(label.get("gap_over_u") or 0.0),
            str(label.get("noise_family", label.get("kind", ""))),
            tuple(int(point) for point in label.get("where") or ()),
            tuple(float(value) for value in label.get("delta") or ()),
            effects if isinstance(effects, Mapping) else {},
            tuple(float(value) for value in label.get("brf_true") or ()),
        )


@dataclass(frozen=True)
class Score:
    """One case: what was true and what was found.

    Attributes
    ----------
    right
        Sound run called none; class of the effect, or of both, named; a cause outside the library called unknown.
    first
        Whether the class of one true effect stands first, whatever else is said.
    among_three
        Whether every true effect is in the first three classes of the ranking.
    confident
        Whether effects were named with a probability above :data:`CONFIDENT`.
    probability
        Of the first named effect, 0 without one.
    overlap
        Intersection over union of found and true region; None where there is neither.
    shrink
        On held-out slices.
    allowed
        Shrink that the truth itself reaches; None where it is not known.
    covered
        Whether the 95 % interval of each parameter of an effect that was named by its own name holds the truth.
    stated, stated_right
        Probability of the most probable answer (none, unknown, or the first class), and whether it is right.
    local
        Whether the gap is larger than the uncertainty at less than half of the points.
    withheld
        Whether effects were named and their correction was not offered.
    claims
        Of each effect that was named with a probability above :data:`CONFIDENT`: whether one of its class is there.
    left
        What an offered correction leaves of the true change, as a ratio of root mean squares. None where nothing is
        corrected, nothing is to be corrected, or the truth is not known.
    farther
        Whether an offered correction lies farther from the true change than none; None where nothing is corrected or
        the truth is not known.
    """

    name: str
    truth: Truth
    verdict: str
    named: tuple[str, ...]
    right: bool
    first: bool
    among_three: bool
    confident: bool
    probability: float
    overlap: float | None
    shrink: float
    covered: tuple[bool, ...] = ()
    allowed: float | None = None
    stated: float = 0.0
    stated_right: bool = False
    local: bool = False
    withheld: bool = False
    claims: tuple[bool, ...] = ()
    left: float | None = None
    farther: bool | None = None


def score(name: str, truth: Truth, found: Mapping[str, Any], run: Observation | None = None) -> Score:
    """Score a diagnosis, the content of a ``diagnosis.json``.

    Parameters
    ----------
    run
        The measurement; without it the shrink that the truth allows is not known.
    """
    verdict, named = str(found["verdict"]), list(found["effects"])
    classes = [set(entry["class"]) for entry in named]
    listed = [set(entry["class"]) for entry in found["ranking"][:3]]
    first = verdict == "effects" and bool(classes) and bool(classes[0] & set(truth.effects)) and not truth.outside
    if truth.kind == "double":
        right = verdict == "effects" and _matched(truth.effects, classes)
    else:
        right = {"none": verdict == "none", "single": first, "outside": verdict == "unknown"}[truth.kind]
    probability = float(named[0]["probability"]) if named else 0.0
    true = set() if truth.outside else set(truth.effects)
    left, farther = _left(truth, found.get("correction", {}))
    located = {point for region in found["where"] for point in region["points"]}
    stated, stated_right = _statement(truth, found)
    return Score(
        name,
        truth,
        verdict,
        tuple(entry["effect"] for entry in named),
        right,
        first,
        all(any(effect in members for members in listed) for effect in truth.effects),
        verdict == "effects" and probability > CONFIDENT,
        probability,
        _overlap(located, set(truth.where)),
        float(found["gap"]["shrink"]),
        _covered(truth.parameters, named),
        None if run is None or not truth.brf else _allowed(truth, found["gap"], run),
        stated,
        stated_right,
        run is not None and 0 < len(truth.where) < len(run) / 2,
        found["gap"].get("heldout_rms_withheld") is not None,
        tuple(bool(set(entry["class"]) & true) for entry in named if entry["probability"] > CONFIDENT),
        left,
        farther,
    )


def _statement(truth: Truth, found: Mapping[str, Any]) -> tuple[float, bool]:
    """Probability of the most probable answer, and whether that answer is right; of two effects either one is."""
    others = found.get("probabilities", {})
    answers = [
        (float(others.get("none", 0.0)), truth.kind == "none"),
        (float(others.get("unknown", 0.0)), truth.kind == "outside"),
    ]
    for entry in found["ranking"][:1]:
        answers.append(
            (float(entry["probability"]), not truth.outside and bool(set(entry["class"]) & set(truth.effects)))
        )
    return max(answers, key=lambda answer: answer[0])


def _allowed(truth: Truth, gap: Mapping[str, Any], run: Observation) -> float:
    """Shrink of the gap if the prediction were the noise-free reading."""
    after = float(np.sqrt(np.mean((np.array(truth.brf)[run.rows] / run.brf - 1) ** 2)))
    left = (1 - gap["removable"]) * gap["heldout_rms_before"]
    return shrink_of(gap["rms_before"], after, left**2)


def _left(truth: Truth, correction: Mapping[str, Any]) -> tuple[float | None, bool | None]:
    """Share of the true change that a correction leaves, and whether it leaves more than there was; both relative."""
    points, found = list(correction.get("points", ())), np.array(correction.get("relative", ()))
    if not truth.gap or not np.any(found):
        return None, None
    true = np.array(truth.gap)[points]
    was, is_left = (float(np.sqrt(np.mean(change**2))) for change in (true, true - found))
    return (is_left / was if was > 0 else None), is_left > was


def _covered(true: Mapping[str, Mapping[str, float]], named: Sequence[Mapping[str, Any]]) -> tuple[bool, ...]:
    """By parameter; one that both the truth and the diagnosis know."""
    return tuple(
        abs(entry["value"] - true[effect["effect"]][name]) <= _COVERAGE * entry["u"]
        for effect in named
        for name, entry in effect["parameters"].items()
        if name in true.get(effect["effect"], {})
    )


def _matched(effects: Sequence[str], classes: Sequence[set[str]]) -> bool:
    """Whether each effect has a class of its own."""
    ways = permutations(classes, len(effects))
    return any(all(effect in members for effect, members in zip(effects, way, strict=True)) for way in ways)


def _overlap(found: set[int], true: set[int]) -> float | None:
    union = found | true
    return len(found & true) / len(union) if union else None


def interval(successes: int, trials: int) -> tuple[float, float]:
    """Confidence interval of a share (Clopper and Pearson), 95 %."""
    from scipy.stats import beta

    if not trials:
        return 0.0, 1.0
    tail = (1 - _LEVEL) / 2
    low = float(beta.ppf(tail, successes, trials - successes + 1)) if successes else 0.0
    high = float(beta.ppf(1 - tail, successes + 1, trials - successes)) if successes < trials else 1.0
    return low, high


@dataclass(frozen=True)
class Row:
    """A share with its interval."""

    label: str
    successes: int
    trials: int

    @property
    def share(self) -> float:
        """Point estimate, NaN of nothing."""
        return self.successes / self.trials if self.trials else float("nan")

    def text(self) -> str:
        """For people."""
        low, high = interval(self.successes, self.trials)
        return f"{self.successes}/{self.trials} = {self.share:.2f} [{low:.2f}, {high:.2f}]"


#: Severities that are told together: 0.75 to 1.5 is about 1.
_BANDS = (("below 0.75", 0.0, 0.75), ("0.75 to 1.5", 0.75, 1.5), ("1.5 to 3", 1.5, 3.0), ("above 3", 3.0, np.inf))


def summary(scores: Sequence[Score]) -> dict[str, list[Row]]:
    """Tables of a trial: by kind, by severity and effect of single ones, false alarms by family of the noise."""
    kinds = ("none", "single", "double", "outside")
    single = [s for s in scores if s.truth.kind == "single"]
    claims = [s for s in scores if s.confident]
    return {
        "right, by kind": [_row(kind, [s for s in scores if s.truth.kind == kind]) for kind in kinds],
        "one effect: class right, by severity": [
            _row(label, [s for s in single if low <= s.truth.severity < high]) for label, low, high in _BANDS
        ],
        "one effect: class among the first three, by severity": [
            Row(label, *_count([s.among_three for s in single if low <= s.truth.severity < high]))
            for label, low, high in _BANDS
        ],
        "one effect: class right, by effect": [
            _row(name, [s for s in single if s.truth.effects == (name,)])
            for name in sorted({s.truth.effects[0] for s in single})
        ],
        "sound runs called none, by noise": [
            _row(family, [s for s in scores if s.truth.kind == "none" and s.truth.family == family])
            for family in sorted({s.truth.family for s in scores if s.truth.kind == "none"})
        ],
        "two effects: one of them first": [
            Row("all", *_count([s.first for s in scores if s.truth.kind == "double"])),
        ],
        "confident claims right": [
            Row(f"effects named above {CONFIDENT:g}", *_count([claim for s in claims for claim in s.claims])),
            Row("whole answers, the first above it", *_count([s.right for s in claims])),
        ],
        "95 % intervals of parameters that hold the truth": [
            Row("all", *_count([hit for s in scores for hit in s.covered])),
        ],
        "outside the library: wrongly confident": [
            Row("all", *_count([s.confident for s in scores if s.truth.kind == "outside"])),
        ],
        "corrections that make the held-out gap larger": [
            Row("all", *_count([s.shrink < 0 for s in scores if s.verdict == "effects"])),
        ],
        "corrections withheld, as they would": [
            Row("all", *_count([s.withheld for s in scores if s.verdict == "effects"])),
        ],
        "corrections that lie farther from the true change than none": [
            Row("all", *_count([s.farther for s in scores if s.verdict == "effects" and s.farther is not None])),
        ],
    }


def figures(scores: Sequence[Score]) -> dict[str, float]:
    """Figures of a trial: medians over cases with one effect or two that were named right, error of the calibration."""
    right = [s for s in scores if s.right and s.truth.effects and not s.truth.outside]
    ratios = [s.shrink / s.allowed for s in right if s.allowed]
    overlaps = [s.overlap for s in right if s.overlap is not None and s.local]
    calibration = expected_calibration_error(reliability(scores))
    return {"expected calibration error": calibration} | {
        label: float(np.median(values))
        for label, values in (
            ("held-out shrink over what the truth allows, median", ratios),
            ("local effects: located region over the true one, intersection over union, median", overlaps),
        )
        if values
    }


def reliability(scores: Sequence[Score]) -> list[Bin]:
    """Probabilities stated in a trial beside the share that was right."""
    return bins([s.stated for s in scores], [s.stated_right for s in scores])


def _row(label: str, scores: Sequence[Score]) -> Row:
    return Row(label, *_count([s.right for s in scores]))


def _count(flags: Sequence[bool]) -> tuple[int, int]:
    return sum(flags), len(flags)

"""Several runs diagnosed together: one cause with the same parameters in all of them.

What belongs to a run is its own: noise and stability, the scale of its reference, and the placement of the sample
unless it stayed on its mount. What belongs to the twin is shared: errors of coupon and dimensions, of the arms' zeros
and of the reflection model. Effects of time and order are computed run by run.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from instrument.angles import FloatArray
from instrument.errors import InputError
from twin.diagnosis.coupon_run import prepare_coupon, shared_errors
from twin.diagnosis.covariance import Structure, smooth_gap, structures
from twin.diagnosis.effects import Effect
from twin.diagnosis.fit import Component
from twin.diagnosis.observation import Observation
from twin.diagnosis.preparation import Bench, Prepared, Told, low_rank, model_error
from twin.diagnosis.problem import Problem
from twin.diagnosis.responses import Responses
from twin.diagnosis.turned import alike
from twin.diagnosis.white_reference import prepare_white

#: Labels of the budget's columns that are of one run, by how they begin: the first always, the second unless the sample
#: stayed on its mount.
OF_A_RUN = ("scale",)
OF_A_MOUNTING = ("sample_tilt ", "sample_offset ", "sample_height ", "sample_azimuth ")
#: Effects whose parameters belong to one run.
_OWN_PARAMETERS = ("session_scale",)
#: How reasons begin that are about what a run records, not about sample or instrument.
_UNRECORDED = "the run says nothing"


@dataclass(frozen=True)
class JointResponse:
    """An effect in several runs, one after the other.

    Attributes
    ----------
    parts
        Its response in each run.
    own
        Every run has parameters of its own; otherwise they are shared.
    light
        Share of the first run's light in each run, from the readings of the reference; 1 where not given.
    """

    parts: tuple[Any, ...]
    own: bool = False
    light: tuple[float, ...] = ()

    @property
    def effect(self) -> Effect:
        """The effect."""
        found: Effect = self.parts[0].effect
        return found

    @property
    def name(self) -> str:
        """Of the effect."""
        return str(self.parts[0].name)

    @property
    def catalogued(self) -> bool:
        """Of the effect."""
        return bool(self.parts[0].catalogued)

    @property
    def shapes(self) -> int:
        """Of the effect."""
        return int(self.parts[0].shapes)

    @property
    def form_error(self) -> float:
        """Of the effect."""
        return float(self.parts[0].form_error)

    @property
    def parameters(self) -> tuple[Any, ...]:
        """Shared ones, or those of every run, named after it."""
        if not self.own:
            return tuple(self.parts[0].parameters)
        numbered = enumerate(self.parts, start=1)
        return tuple(replace(p, name=f"run{number}_{p.name}") for number, part in numbered for p in part.parameters)

    def log_ratio(self, values: FloatArray) -> FloatArray:
        """Logarithm of the readings with the effect over those without, shape (n, point)."""
        if not self.own:
            light = self.light or (1.0,) * len(self.parts)
            pairs = zip(self.parts, light, strict=True)
            return np.concatenate([part.log_ratio(dimmed(self.name, values, share)) for part, share in pairs], axis=1)
        ends = np.cumsum([len(part.parameters) for part in self.parts])[:-1]
        split = np.split(values, ends, axis=1)
        return np.concatenate([part.log_ratio(v) for part, v in zip(self.parts, split, strict=True)], axis=1)

    def derivative(self) -> FloatArray:
        """Derivative of the logarithm at the nominal values, shape (parameter, point)."""
        rows = [part.derivative() for part in self.parts]
        return np.asarray(block_diag(*rows)) if self.own else np.concatenate(rows, axis=1)


def dimmed(name: str, values: FloatArray, light: float) -> FloatArray:
    """Parameters that an effect has with less light, shape (value, parameter).

    A response 1 + fraction (s^power - 1)/power relative to a reference that is dimmed too has, to first order, the
    fraction light^power of it. A voltage is seen by the smaller current of the reference.
    """
    if name != "detector_nonlinearity" or light == 1.0:
        return values
    return np.stack([values[:, 0] * light ** values[:, 1], values[:, 1]], axis=1)


def light_of(parts: Sequence[Any]) -> tuple[float, ...]:
    """Share of the first run's light in each, from the reference's photocurrents; 1 where a run does not say."""
    currents = [getattr(getattr(part, "run", None), "reference_current", None) or 0.0 for part in parts]
    if min(currents) <= 0:
        return (1.0,) * len(parts)
    return tuple(float(current / currents[0]) for current in currents)


def prepare_jointly(
    bench: Bench,
    runs: Sequence[Observation],
    *,
    coupon: Sequence[Observation] = (),
    white: Sequence[Observation] = (),
    same_mounting: bool = False,
    told: Told | None = None,
) -> Prepared:
    """Make several runs of one configuration ready to be diagnosed as one.

    Parameters
    ----------
    coupon, white
        Runs of the flat coupon, and of the white reference, in place of the sample.
    """
    tell = told or (lambda what, share: None)
    samples: list[Prepared] = []
    flat = bench.flat() if coupon else None
    number = len(runs) + len(coupon)

    def steps(before: int) -> Told:
        return lambda what, share: tell(f"run {before + 1} of {number}: {what}", (before + share) / number)

    for run in runs:
        samples.append(bench.prepare(run, steps(len(samples))))
    known = samples[0].responses.found.values()
    parts = list(samples)
    if flat is not None:
        for run in coupon:
            steps(len(parts))("what every effect does to the coupon", 0.0)
            parts.append(prepare_coupon(flat, run, known))
    sample = _all([part.problem.run for part in samples])
    shared, rest = _errors_of_the_twin(bench, sample, _all([part.problem.run for part in parts[len(runs) :]]))
    # Errors of the coupon and of the reflection model are none of the white reference's.
    more = sum(len(run) for run in white)
    shared, rest = np.pad(shared, ((0, more), (0, 0))), np.pad(rest, (0, more))
    parts += [prepare_white(bench, run, [response.effect for response in known]) for run in white]
    return replace(join(parts, shared, rest, same_mounting=same_mounting), inputs=bench.inputs)


def _all(runs: Sequence[Observation]) -> Observation | None:
    """All points of several runs; None of no run."""
    if len(runs) < 2:
        return runs[0] if runs else None
    return joined(runs)


def _errors_of_the_twin(
    bench: Bench, sample: Observation | None, coupon: Observation | None
) -> tuple[FloatArray, FloatArray]:
    """What errors of dimensions, material and reflection model do to all predictions: shared columns, and the rest."""
    if sample is None:
        raise InputError("found no run of the sample; expected at least one")
    if coupon is None:
        factor, rest = low_rank(bench.input_covariance(sample))
        return np.concatenate([factor, model_error(sample)], axis=1), rest
    both = joined([sample, coupon])
    return np.concatenate([shared_errors(bench, sample, coupon), model_error(both)], axis=1), np.zeros(len(both))


def join(
    parts: Sequence[Prepared], shared: FloatArray, rest: FloatArray | float = 0.0, *, same_mounting: bool = False
) -> Prepared:
    """One problem of several prepared runs.

    Parameters
    ----------
    shared, shape (point, column)
        Relative change of all runs' predictions by one standard uncertainty of each error of the twin.
    rest, shape (point,)
        Relative variance of the prediction's own error that ``shared`` leaves.
    """
    problems = [part.problem for part in parts]
    run = joined([problem.run for problem in problems])
    own = OF_A_RUN if same_mounting else OF_A_RUN + OF_A_MOUNTING
    labelled = joined_columns([part.budget for part in parts], [len(p.run) for p in problems], own)
    budget = np.concatenate([np.stack(list(labelled.values()), axis=1), shared], axis=1)
    found, ruled_out = joined_responses([part.responses for part in parts])
    u_nominal = np.sqrt(np.concatenate([p.u_nominal for p in problems]) ** 2 + rest)
    problem = Problem(
        run,
        np.concatenate([p.nominal for p in problems]),
        u_nominal,
        budget,
        joined_structures([structures(p.run) for p in problems]),
        joined_gaps([p.run for p in problems], run),
        [Component.of(response, run.relative_u) for response in found.values()],
    )
    responses: Any = found
    return Prepared(problem, Responses(responses, ruled_out), labelled)


def joined(runs: Sequence[Observation]) -> Observation:
    """The points of all runs, one run after the other; rows and seconds go on counting.

    What not all runs state is left out.
    """
    if len(runs) < 2:
        raise InputError(f"found {len(runs)} run; expected at least two to diagnose jointly")
    starts = np.concatenate([[0], np.cumsum([int(run.rows.max()) + 1 for run in runs])[:-1]])
    components = set.intersection(*(set(run.components) for run in runs))
    timed = all(run.seconds is not None for run in runs)
    seconds, end = [], 0.0
    for run in runs if timed else ():
        assert run.seconds is not None
        seconds.append(run.seconds - run.seconds.min() + end)
        end = float(seconds[-1].max()) + 1.0
    columns = alike([run.columns for run in runs])
    notes = [f"{run.name}: {note}" for run in runs for note in run.notes]
    dropped = sorted({name for run in runs for name in run.components} - components)
    if dropped:
        notes.append(f"{', '.join(dropped)}: not stated by all runs, so not told from the combined uncertainty")
    return Observation(
        ", ".join(run.name for run in runs),
        np.concatenate([run.rows + start for run, start in zip(runs, starts, strict=True)]),
        {name: np.concatenate([part[name] for part in columns]) for name in columns[0]},
        np.concatenate([run.brf for run in runs]),
        np.concatenate([run.u_brf for run in runs]),
        {name: np.concatenate([run.components[name] for run in runs]) for name in sorted(components)},
        np.concatenate(seconds) if timed else None,
        notes=tuple(dict.fromkeys(notes)),
    )


def joined_columns(
    parts: Sequence[dict[str, FloatArray]], counts: Sequence[int], own: tuple[str, ...]
) -> dict[str, FloatArray]:
    """Columns of the budget for all points: shared ones one below the other, own ones each in its run alone."""
    result: dict[str, FloatArray] = {}
    for label in dict.fromkeys(label for part in parts for label in part):
        pieces = [part.get(label, np.zeros(count)) for part, count in zip(parts, counts, strict=True)]
        if not label.startswith(own):
            result[label] = np.concatenate(pieces)
            continue
        for number, piece in enumerate(pieces):
            alone = [piece if k == number else np.zeros(count) for k, count in enumerate(counts)]
            result[f"{label}, run {number + 1}"] = np.concatenate(alone)
    return result


def joined_structures(parts: Sequence[list[Structure]]) -> list[Structure]:
    """The same kind of correlation in every run, none between runs.

    A run that states no stability has one structure, which serves with every kind of the others.
    """
    longest = max(parts, key=len)
    by_name = [{s.name: s for s in part} for part in parts]
    found = []
    for one in longest:
        chosen = [
            names.get(one.name) or (part[0] if len(part) == 1 else None)
            for names, part in zip(by_name, parts, strict=False)
        ]
        blocks = [s.covariance for s in chosen if s is not None]
        if len(blocks) == len(parts):
            found.append(Structure(one.name, one.weight, np.asarray(block_diag(*blocks))))
    total = sum(s.weight for s in found)
    return [Structure(s.name, s.weight / total, s.covariance) for s in found]


def joined_gaps(runs: Sequence[Observation], together: Observation) -> list[tuple[str, FloatArray]]:
    """Unknown gaps: alike in like directions of all runs; in time each run for itself."""
    own = [dict(smooth_gap(run)) for run in runs]
    return [
        (name, np.asarray(block_diag(*(gaps[name] for gaps in own))) if "time" in name else shape)
        for name, shape in smooth_gap(together)
    ]


def joined_responses(parts: Sequence[Responses]) -> tuple[dict[str, JointResponse], dict[str, str]]:
    """Effects that every run can show, and why others are left out."""
    ruled_out: dict[str, str] = {}
    for number, part in enumerate(parts, start=1):
        for name, reason in part.ruled_out.items():
            text = f"run {number}: {reason}" if reason.startswith(_UNRECORDED) else reason
            ruled_out.setdefault(name, text)
    found = {}
    for name in parts[0].found:
        if name not in ruled_out:
            some = tuple(part.found[name] for part in parts)
            found[name] = JointResponse(some, name in _OWN_PARAMETERS, light_of(some))
    return found, ruled_out

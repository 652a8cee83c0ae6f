"""Which slice, read once more and in another way, would tell effects apart that a run cannot.

Only slices of the run itself are considered: what every effect does there is known, so nothing is rendered.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from instrument.angles import FloatArray
from twin.diagnosis.acquisition import Acquisition, acquisition_of
from twin.diagnosis.covariance import INDEPENDENT, structures
from twin.diagnosis.fit import Fit
from twin.diagnosis.observation import Observation
from twin.diagnosis.responses import AnyResponse
from twin.diagnosis.verdict import TOLD_APART

if TYPE_CHECKING:
    from instrument.facility import Facility
    from twin.diagnosis.diagnose import Diagnosis
    from twin.diagnosis.problem import Problem

#: Slices of fewer points are not proposed.
_FEWEST = 5
#: Share of the light of a dimmed scan.
_DIMMED = 0.25
#: Seconds a point takes where a run has no times: the dwell that ``goniotwin plan`` assumes, and the way.
_SECONDS = 22.0
#: Effects whose parameters are those of one run: in another they are others.
_OF_A_RUN = ("session_scale", "source_drift", "source_jump")
#: Effects of which it is not known what they become with less light: the gain ranges may change.
_NOT_DIMMED = ("gain_step",)
#: Probability of a second effect from which the first is to be told, where nothing is named.
_RIVAL = 0.05
IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class Scan:
    """A slice of a run that is read again.

    Attributes
    ----------
    description
        In words.
    rows
        Numbers of its points in the run, in the order in which they are read.
    light
        Share of the run's light.
    """

    description: str
    rows: IntArray
    light: float = 1.0


@dataclass(frozen=True)
class Proposal:
    """A scan, and what it is worth.

    Attributes
    ----------
    separates
        Pairs of effects that it is expected to tell apart.
    gain_nats
        Least expected gain of evidence for the true one of each of these pairs, whichever of the two it is.
    duration_s
        Estimated.
    """

    scan: Scan
    separates: tuple[tuple[str, str], ...]
    gain_nats: float
    duration_s: float


def proposals(diagnosis: Diagnosis, facility: Facility, most: int = 3) -> list[Proposal]:
    """Scans of one slice that tell apart what the run cannot; the largest gain an hour first."""
    problem, found = diagnosis.prepared.problem, diagnosis.prepared.responses.found
    fits = {h.names[0]: h.fit for h in diagnosis.posterior.hypotheses if len(h.names) == 1 and not h.unknown and h.fit}
    wanted = [pair for pair in unresolved(diagnosis) if all(name in fits for name in pair)]
    if not wanted:
        return []
    structure = fits[wanted[0][0]].best
    result = []
    for scan in candidates(problem.run):
        pairs, gains, weigh = [], [], None
        for one, other in wanted:
            if scan.light < 1 and {one, other} & set(_NOT_DIMMED):
                continue
            weigh = weigh or _Weighing.of(problem, scan, structure, facility)
            gain = min(
                weigh.gain((found[true], fits[true]), (found[false], fits[false]))
                for true, false in ((one, other), (other, one))
            )
            if gain >= TOLD_APART:
                pairs.append((one, other))
                gains.append(gain)
        if pairs:
            result.append(Proposal(scan, tuple(pairs), min(gains), duration(problem.run, scan)))
    return sorted(result, key=lambda p: (-len(p.separates), -p.gain_nats / p.duration_s))[:most]


def unresolved(diagnosis: Diagnosis) -> list[tuple[str, str]]:
    """Pairs of effects of which the run does not say which it is."""
    decision = diagnosis.decision
    classes = decision.named or decision.ranking[:1]
    pairs = [(named.effect, other) for named in classes for other in named.members[1:]]
    if decision.verdict == "undecided" and len(decision.ranking) > 1 and decision.ranking[1].probability > _RIVAL:
        pairs.append((decision.ranking[0].effect, decision.ranking[1].effect))
    return pairs


def candidates(run: Observation) -> Iterator[Scan]:
    """Some slices again: as they were, in the opposite direction, with less light."""
    order = np.arange(len(run)) if run.seconds is None else np.argsort(run.seconds, kind="stable")
    for plane in _planes(run):
        rows = order[run.plane[order] == plane]
        zenith = run.columns["sensor_zenith"][rows]
        if len(rows) < _FEWEST:
            continue
        light, azimuth = (run.columns[name][rows[0]] for name in ("illumination_zenith", "sensor_azimuth"))
        where = f"the slice at illumination zenith {light:g}, sensor azimuth {azimuth:g} degrees again"
        yield Scan(f"{where}, in the opposite direction ({zenith[-1]:g} to {zenith[0]:g})", rows[::-1])
        yield Scan(f"{where}, with a quarter of the light", rows, _DIMMED)
        yield Scan(f"{where}, as it was", rows)


def _planes(run: Observation) -> list[int]:
    """Of each illumination the plane of incidence and the one most across it, or those nearest to them."""
    _, first = np.unique(run.plane, return_index=True)
    across = np.abs(np.sin(np.deg2rad(run.columns["sensor_azimuth"] - run.columns["illumination_azimuth"])[first]))
    light = run.illumination[first]
    chosen = []
    for one in np.unique(light):
        planes = np.flatnonzero(light == one)
        chosen += [planes[np.argmin(across[planes])], planes[np.argmax(across[planes])]]
    return list(dict.fromkeys(int(p) for p in chosen))


def duration(run: Observation, scan: Scan) -> float:
    """Seconds that a scan takes, from the usual time between points of the run."""
    each = _SECONDS
    if run.seconds is not None and len(run) > 1:
        each = float(np.median(np.diff(np.sort(run.seconds))))
    return len(scan.rows) * max(each, 1.0)


def read_again(run: Observation, scan: Scan) -> Observation:
    """What the scan would give if nothing were wrong; a detector's noise stays where the light is less."""
    chosen = run.take(scan.rows)
    components = dict(chosen.components)
    if INDEPENDENT in components:
        components[INDEPENDENT] = components[INDEPENDENT] / scan.light
    return replace(
        chosen,
        components=components,
        seconds=None if run.seconds is None else np.arange(len(chosen)) * duration(run, scan) / len(chosen),
        signal_v=None if chosen.signal_v is None else chosen.signal_v * scan.light,
        reference_v=None if chosen.reference_v is None else chosen.reference_v * scan.light,
    )


@dataclass(frozen=True)
class _Weighing:
    """The errors of a run and of a scan after it.

    Attributes
    ----------
    alone, both
        Factors of the covariance of the run, and of run and scan; what the budget allows is the same in both.
    """

    problem: Problem
    scan: Scan
    acquisition: Acquisition
    alone: FloatArray
    both: FloatArray

    @classmethod
    def of(cls, problem: Problem, scan: Scan, structure: int, facility: Facility) -> _Weighing:
        first = problem.members[structure].covariance
        observation = read_again(problem.run, scan)
        name = problem.structures[structure].name
        own = next((s.covariance for s in structures(observation) if s.name == name), None)
        if own is None:
            own = np.diag(observation.relative_u**2)
        systematic = problem.budget @ problem.budget.T + np.diag(problem.u_nominal**2)
        cross = systematic[:, scan.rows]
        both = np.block([[first, cross], [cross.T, own + systematic[np.ix_(scan.rows, scan.rows)]]])
        return cls(problem, scan, acquisition_of(observation, facility), _factor(first), _factor(both))

    def gain(self, true: tuple[AnyResponse, Fit], false: tuple[AnyResponse, Fit]) -> float:
        """Expected gain of evidence for the true effect from the scan, the false one refitted to both."""
        (one, fit_one), (other, fit_other) = true, false
        run_one, scan_one = self._tables(one, fit_one.values[None])
        run_other, scan_other = self._tables(other, fit_other.values[None])
        slopes = self._slopes(other, fit_other.values)
        difference = np.concatenate([run_one - run_other, scan_one - scan_other], axis=1)[0]
        count = len(self.problem.run)
        with_scan = _misfit(self.both, difference, slopes)
        return 0.5 * max(0.0, with_scan - _misfit(self.alone, difference[:count], slopes[:, :count]))

    def _tables(self, response: AnyResponse, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Logarithmic ratios in the run and in the scan, shape (value, point)."""
        here = response.log_ratio(values)
        if response.name in _OF_A_RUN:
            return here, np.zeros((len(values), len(self.scan.rows)))
        again = response.again(self.acquisition, self.scan.rows)
        return here, again.log_ratio(dimmed(response.name, values, self.scan.light))

    def _slopes(self, response: AnyResponse, values: FloatArray) -> FloatArray:
        """Derivatives in run and scan, side by side, shape (parameter, point)."""
        rows = []
        for number, parameter in enumerate(response.parameters):
            step = 0.02 * abs(parameter.typical)
            ends = np.repeat(values[None], 2, axis=0)
            ends[0, number] = min(values[number] + step, parameter.cap[1])
            ends[1, number] = max(values[number] - step, parameter.cap[0])
            here, there = self._tables(response, ends)
            width = max(ends[0, number] - ends[1, number], 1e-300)
            rows.append(np.concatenate([here[0] - here[1], there[0] - there[1]]) / width)
        return np.array(rows)


def dimmed(name: str, values: FloatArray, light: float) -> FloatArray:
    """Parameters that an effect has with less light, shape (value, parameter).

    A response 1 + fraction (s^power - 1)/power relative to a reference that is dimmed too has, to first order, the
    fraction light^power of it. A voltage is seen by the smaller current of the reference.
    """
    if name != "detector_nonlinearity":
        return values
    return np.stack([values[:, 0] * light ** values[:, 1], values[:, 1]], axis=1)


def _factor(covariance: FloatArray) -> FloatArray:
    return np.asarray(linalg.cholesky(covariance, lower=True, check_finite=False))


def _misfit(factor: FloatArray, difference: FloatArray, slopes: Sequence[FloatArray] | FloatArray) -> float:
    """Whitened square of what is left of a difference when the parameters behind the slopes are free."""
    white = linalg.solve_triangular(factor, np.column_stack([difference, *slopes]), lower=True, check_finite=False)
    solution = np.linalg.lstsq(white[:, 1:], white[:, 0], rcond=None)[0]
    rest = white[:, 0] - white[:, 1:] @ solution
    return float(rest @ rest)

"""How much a scan is expected to say about which explanation of a run is the right one.

The mutual information between explanation and new readings, given the run, by Monte Carlo. Readings are drawn with the
effects' full responses; explanations are weighed with a normal predictive distribution each. Weights other than the
exact ones can only lose information, so the result is a lower bound (Barber and Agakov, The IM algorithm, NIPS 2003).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import linalg

from instrument.angles import FloatArray
from twin.diagnosis.amplitude import Parameter, log_sum
from twin.diagnosis.covariance import smooth_gap, structures
from twin.diagnosis.joint import dimmed
from twin.diagnosis.next_explanations import Explanation, Member, entropy, factor_of
from twin.diagnosis.next_scans import Scan
from twin.diagnosis.next_stage import Stage, read_again, taken_again
from twin.diagnosis.observation import Observation
from twin.diagnosis.problem import Problem
from twin.diagnosis.response import AnyResponse
from twin.diagnosis.turned import alike

#: Draws of the new readings for each explanation.
DRAWS = 48
#: Effects whose parameters are those of one run: in another they are others, of the same size.
OF_A_RUN = ("session_scale", "source_drift", "source_jump")
#: Effects of which it is not known what they become with less light: the gain ranges may change.
NOT_DIMMED = ("gain_step",)


@dataclass(frozen=True)
class Worth:
    """What a scan is expected to say.

    Attributes
    ----------
    information
        Expected fall of the entropy over the explanations, nats.
    right
        Expected probability of the right explanation afterwards.
    gains, shape (explanation, explanation)
        Expected gain of evidence for the first, if it is right, over the second, nats.
    """

    information: float
    right: float
    gains: FloatArray


class Outlook:
    """A run, its explanations, and scans that may follow.

    Parameters
    ----------
    problem
        The run, whose points are the first of ``stage``.
    stages
        Geometries that may be read; the first points of the first stage are the run's.
    seed
        Of the draws, the same for every scan: differences between scans are not of luck.
    """

    def __init__(
        self, problem: Problem, stages: Sequence[Stage], leading: Sequence[Explanation], seed: int = 5
    ) -> None:
        self.problem, self.stages, self.leading, self._seed = problem, tuple(stages), list(leading), seed
        self._here: dict[Member, FloatArray] = {}

    @property
    def entropy(self) -> float:
        """Of the explanations, nats."""
        return entropy(self.leading)

    @cached_property
    def budgets(self) -> tuple[tuple[FloatArray, FloatArray], ...]:
        """Of each stage columns that run and scan share, in the same order, and those of a scan alone."""
        labels, width = self.stages[0].shared_labels, self.stages[0].unlabelled.shape[1]
        return tuple((stage.shared(labels, width), stage.own(labels)) for stage in self.stages)

    @property
    def of_run(self) -> int:
        """Points of the run."""
        return self.stages[0].of_run

    def factor(self, member: Member) -> FloatArray:
        """Lower triangular factor of the run's covariance under a structure and a gap of unknown cause."""
        if member not in self._here:
            structure, gap = member
            budget = np.concatenate([part[: self.of_run] for part in self.budgets[0]], axis=1)
            covariance = self.problem.structures[structure].covariance + budget @ budget.T
            covariance = covariance + np.diag(self.problem.u_nominal**2)
            if gap is not None:
                spread = gap[1] * self.problem.run.relative_u
                covariance = covariance + self.problem.gaps[gap[0]][1] * np.outer(spread, spread)
            self._here[member] = factor_of(covariance)
        return self._here[member]

    def worth(self, scan: Scan, draws: int = DRAWS) -> Worth | None:
        """What a scan is expected to say; None where it is not known what an effect becomes in it."""
        known = self.stages[scan.stage].responses
        if any(not set(one.names) <= set(known) for one in self.leading):
            return None
        if scan.light < 1 and any(set(one.names) & set(NOT_DIMMED) for one in self.leading):
            return None
        seen = _Seen(self, scan)
        views = [seen.view(one) for one in self.leading]
        generator = np.random.default_rng(self._seed)
        p = np.array([one.probability for one in self.leading])
        gains = np.zeros((len(p), len(p)))
        information = right = 0.0
        for number, view in enumerate(views):
            readings = view.draw(generator, draws)
            log_density = np.stack([other.log_density(readings) for other in views], axis=1)
            log_joint = log_density + np.log(p)
            after = log_joint[:, number] - np.asarray(log_sum(log_joint, axis=1))
            information += p[number] * float(np.mean(after) - np.log(p[number]))
            right += p[number] * float(np.mean(np.exp(after)))
            gains[number] = np.mean(log_density[:, [number]] - log_density, axis=0)
        return Worth(float(np.clip(information, 0.0, self.entropy)), right, gains)


@dataclass
class _Predictive:
    """Readings of a scan under one structure: normal about a mean."""

    share: float
    mean: FloatArray
    factor: FloatArray
    own_factor: FloatArray
    carry: FloatArray


@dataclass
class _View:
    """An explanation's predictions of a scan."""

    seen: _Seen
    explanation: Explanation
    predictive: list[_Predictive]

    def log_density(self, readings: FloatArray) -> FloatArray:
        """Of logarithmic readings, shape (draw, point); shape (draw,)."""
        found = []
        for one in self.predictive:
            white = linalg.solve_triangular(one.factor, (readings - one.mean).T, lower=True, check_finite=False)
            log_det = np.sum(np.log(np.diag(one.factor)))
            found.append(np.log(one.share) - 0.5 * np.sum(white**2, axis=0) - log_det)
        return np.asarray(log_sum(np.stack(found), axis=0))

    def draw(self, generator: np.random.Generator, count: int) -> FloatArray:
        """Logarithmic readings with the full response, shape (draw, point)."""
        here, there = self.seen.drawn(self.explanation, generator, count)
        shares = np.array([one.share for one in self.predictive])
        which = generator.choice(len(shares), size=count, p=shares / shares.sum())
        noise = generator.standard_normal((count, there.shape[1]))
        residual = self.seen.outlook.problem.residual
        readings = np.empty_like(there)
        for number, one in enumerate(self.predictive):
            mine = which == number
            mean = there[mine] + (residual - here[mine]) @ one.carry.T
            readings[mine] = mean + noise[mine] @ one.own_factor.T
        return readings


class _Seen:
    """A scan, ready to be looked at by explanations."""

    def __init__(self, outlook: Outlook, scan: Scan) -> None:
        self.outlook, self.scan = outlook, scan
        self.stage = stage = outlook.stages[scan.stage]
        self.observation = read_again(stage, scan.rows, scan.light)
        self._acquisition = taken_again(stage, scan.rows, scan.light)
        self._structures = {s.name: s.covariance for s in structures(self.observation)}
        self._responses: dict[str, AnyResponse] = {}
        rows = scan.rows
        shared, own = outlook.budgets[scan.stage]
        self._cross = shared[rows] @ outlook.budgets[0][0][: outlook.of_run].T
        self._systematic = shared[rows] @ shared[rows].T + own[rows] @ own[rows].T + np.diag(stage.u_nominal[rows] ** 2)
        self._conditional: dict[Member, tuple[FloatArray, FloatArray]] = {}

    def view(self, explanation: Explanation) -> _View:
        """An explanation's predictive distribution of the scan's logarithmic readings over the nominal ones."""
        here, there, slopes_here, slopes_there, anew = self._linearised(explanation)
        predictive = []
        for member, share in explanation.members:
            carry, covariance = self._given_run(member)
            mean = there + carry @ (self.outlook.problem.residual - here)
            left = slopes_there - carry @ slopes_here
            spread = left @ explanation.covariance @ left.T + anew @ anew.T if len(explanation.values) else 0.0
            predictive.append(
                _Predictive(share, mean, factor_of(covariance + spread), factor_of(covariance), carry),
            )
        return _View(self, explanation, predictive)

    def _given_run(self, member: Member) -> tuple[FloatArray, FloatArray]:
        """Regression of the scan's errors on the run's, shape (scan, run), and the covariance that it leaves."""
        structure, gap = member
        if member not in self._conditional:
            name = self.outlook.problem.structures[structure].name
            own = self._structures.get(name, np.diag(self.observation.relative_u**2))
            cross, alone = self._cross, own + self._systematic
            if gap is not None:
                of_gap, of_cross = self._gap(*gap)
                cross, alone = cross + of_cross, alone + of_gap
            factor = self.outlook.factor(member)
            white = linalg.solve_triangular(factor, cross.T, lower=True, check_finite=False)
            carry = linalg.solve_triangular(factor, white, lower=True, trans="T", check_finite=False).T
            self._conditional[member] = np.asarray(carry), alone - white.T @ white
        return self._conditional[member]

    def _gap(self, number: int, size: float) -> tuple[FloatArray, FloatArray]:
        """Covariance of a gap of unknown cause in the scan, and between scan and run."""
        run, count = self.outlook.problem.run, len(self.scan.rows)
        together = _behind(self.observation, run)
        name, shape = smooth_gap(together)[number]
        spread = size * np.concatenate([self.observation.relative_u, run.relative_u])
        covariance = shape * np.outer(spread, spread)
        cross = covariance[:count, count:]
        # What comes with time is not the same in another scan, and another sample need not have it.
        return covariance[:count, :count], np.zeros_like(cross) if "time" in name or self.stage.sample else cross

    def response(self, name: str) -> AnyResponse:
        """Of an effect in the scan."""
        if name not in self._responses:
            self._responses[name] = self.stage.responses[name].again(self._acquisition, self.scan.rows)
        return self._responses[name]

    def _parts(self, explanation: Explanation) -> list[tuple[str, slice]]:
        ends = np.cumsum(explanation.sizes)
        return [
            (name, slice(int(end) - size, int(end)))
            for name, size, end in zip(explanation.names, explanation.sizes, ends, strict=True)
        ]

    def tables(self, explanation: Explanation, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Logarithmic ratios in the run and in the scan at values of shape (n, parameter); shape (n, point) each."""
        here = np.zeros((len(values), self.outlook.of_run))
        there = np.zeros((len(values), len(self.scan.rows)))
        for name, part in self._parts(explanation):
            here = here + self.outlook.problem.component(name).signature.log_ratio(values[:, part])
            if name not in OF_A_RUN:
                there = there + self.response(name).log_ratio(dimmed(name, values[:, part], self.scan.light))
        return here, there

    def _linearised(
        self, explanation: Explanation
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
        """Ratios at the fit in run and scan, their slopes (point, parameter), and what is drawn anew in the scan."""
        values = explanation.values
        low, high, steps = self._limits(explanation)
        up, down = np.minimum(values + steps, high), np.maximum(values - steps, low)
        rows = np.repeat(values[None], 2 * len(values) + 1, axis=0)
        for axis in range(len(values)):
            rows[1 + 2 * axis, axis], rows[2 + 2 * axis, axis] = up[axis], down[axis]
        here, there = self.tables(explanation, rows)
        width = np.maximum(up - down, 1e-300)
        slopes = [(table[1::2] - table[2::2]).T / width for table in (here, there)]
        return here[0], there[0], slopes[0], slopes[1], self._anew(explanation)

    def _limits(self, explanation: Explanation) -> tuple[FloatArray, FloatArray, FloatArray]:
        parameters = [
            p for name in explanation.names for p in self.outlook.problem.component(name).signature.parameters
        ]
        low, high = (np.array([p.cap[end] for p in parameters]) for end in (0, 1))
        return low, high, np.array([0.02 * abs(p.typical) for p in parameters])

    def _anew(self, explanation: Explanation) -> FloatArray:
        """Columns of what effects that belong to one run may do in another: as large as in this, either way."""
        columns = [np.zeros((len(self.scan.rows), 0))]
        for name, part in self._parts(explanation):
            if name not in OF_A_RUN:
                continue
            found, there = self.outlook.problem.component(name).signature, self.response(name)
            size = _size(found.parameters, explanation.values[part])
            sized = [number for number, p in enumerate(there.parameters) if not p.shape]
            shapes = [(n, p.name) for n, p in enumerate(there.parameters) if p.shape]
            fitted = {p.name: v for p, v in zip(found.parameters, explanation.values[part], strict=True)}
            alone = np.tile([p.nominal for p in there.parameters], (len(sized), 1))
            for number, shape in shapes:
                alone[:, number] = fitted[shape]
            for row, number in enumerate(sized):
                alone[row, number] += size * there.parameters[number].typical
            columns.append(there.log_ratio(alone).T)
        return np.concatenate(columns, axis=1)

    def drawn(
        self, explanation: Explanation, generator: np.random.Generator, count: int
    ) -> tuple[FloatArray, FloatArray]:
        """Logarithmic ratios in run and scan at parameters drawn from what the run leaves of them."""
        if not len(explanation.values):
            return self.tables(explanation, np.zeros((count, 0)))
        low, high, _ = self._limits(explanation)
        spread, vectors = np.linalg.eigh(explanation.covariance)
        factor = vectors * np.sqrt(np.maximum(spread, 0.0))
        values = explanation.values + generator.standard_normal((count, len(spread))) @ factor.T
        here, there = self.tables(explanation, np.clip(values, low, high))
        anew = self._anew(explanation)
        return here, there + generator.standard_normal((count, anew.shape[1])) @ anew.T


def _size(parameters: Sequence[Parameter], values: FloatArray) -> float:
    """Root mean square of parameters in typical amplitudes, shapes left out."""
    sized = [(v - p.nominal) / p.typical for p, v in zip(parameters, values, strict=True) if not p.shape]
    return float(np.sqrt(np.mean(np.square(sized))))


def _behind(scan: Observation, run: Observation) -> Observation:
    """Points of a scan, and behind them those of a run, as far as gaps of unknown cause look at them."""
    here, there = alike([scan.columns, run.columns])
    columns = {name: np.concatenate([column, there[name]]) for name, column in here.items()}
    both = [np.concatenate([one, other]) for one, other in ((scan.brf, run.brf), (scan.u_brf, run.u_brf))]
    return Observation("", np.arange(len(both[0])), columns, both[0], both[1], {})

"""Which scan to take next: feasible ones by what they are expected to say about the causes, an hour.

Without asking for more only slices of the run are weighed, read again in several ways: what every effect does there is
known, so nothing is rendered. :func:`further` adds planes and illumination angles that the run lacks, a turned sample,
the white reference and the coupon.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from instrument.errors import InputError
from instrument.output import write_result
from twin.diagnosis.next_explanations import Explanation, entropy, explanations, known_of
from twin.diagnosis.next_information import Outlook, Worth
from twin.diagnosis.next_plan import duration_of, plan_columns, plan_text
from twin.diagnosis.next_scans import Scan, other_geometries, scans
from twin.diagnosis.next_stage import Stage, coupon_stage, white_stage, wider
from twin.diagnosis.nuisance import ROWS, STATED
from twin.diagnosis.verdict import TOLD_APART

if TYPE_CHECKING:
    from instrument.facility import Facility
    from twin.diagnosis.diagnose import Diagnosis
    from twin.diagnosis.preparation import Bench

__all__ = ["Proposal", "further", "proposals", "unresolved", "weighed", "write_plans"]

#: Less than this is not worth a scan, nats; and runs as sure as that need none.
_LEAST = 0.05
#: Slices of one scan at most, and how many are tried beside it.
_SLICES, _TRIED = 3, 6
#: Probability of a second effect from which the first is to be told, where nothing is named.
_RIVAL = 0.05
_SECONDS_AN_HOUR = 3600.0
#: How a plan of a diagnosis begins.
_HEADING = "# Expected information"
_DIMMED_REMARK = (
    "Source at a quarter of its power, or a filter of density 0.6 in the beam, for the reference and for all points."
)
_OTHER_REMARK = "The {} on the stage in place of the sample."


@dataclass(frozen=True)
class Proposal:
    """A scan, and what it is worth.

    Attributes
    ----------
    separates
        Pairs of explanations that it is expected to tell apart.
    gain_nats
        Least expected gain of evidence for the true one of each of these pairs, whichever of the two it is; of the
        most probable pair where it tells none apart for sure.
    information_nats
        Expected fall of the entropy over the explanations.
    right
        Expected probability of the right explanation afterwards.
    duration_s
        By the forecast of the instrument, reference included.
    plan
        Text of a plan file.
    """

    scan: Scan
    separates: tuple[tuple[str, str], ...]
    gain_nats: float
    information_nats: float
    right: float
    duration_s: float
    plan: str

    @property
    def rate(self) -> float:
        """Nats an hour."""
        return self.information_nats / self.duration_s * _SECONDS_AN_HOUR


def proposals(diagnosis: Diagnosis, facility: Facility, most: int = 3) -> list[Proposal]:
    """Scans of the run's own slices that say most an hour, of each kind the best."""
    return ranked(outlook_of(diagnosis, [Stage.of(diagnosis.prepared, facility)]), facility, most)


def further(diagnosis: Diagnosis, bench: Bench, most: int = 8) -> list[Proposal]:
    """The same with geometries that the run lacks, the white reference, and the flat coupon of a sample with holes.

    At new geometries the effects of the leading explanations and of the budget are rendered, once for a configuration.
    """
    problem = diagnosis.prepared.problem
    leading = explanations(diagnosis.posterior, problem)
    if entropy(leading) < _LEAST:
        return []
    named = {name for one in leading for name in one.names} | {name for row in ROWS.values() for name in row}
    shown = [part for name, part in diagnosis.prepared.responses.found.items() if name in named | set(STATED)]
    effects = [part.effect for part in shown]
    other = other_geometries(problem.run, bench.facility.arms)
    stages = [wider(bench, problem.run, other, effects), white_stage(bench, problem.run, effects)]
    if len(bench.artifact.holes):
        stages.append(coupon_stage(bench, problem.run, shown))
    return ranked(outlook_of(diagnosis, stages), bench.facility, most)


def outlook_of(diagnosis: Diagnosis, stages: Sequence[Stage]) -> Outlook:
    """The leading explanations of a diagnosed run before the geometries of some stages."""
    problem = diagnosis.prepared.problem
    leading = known_of(explanations(diagnosis.posterior, problem), list(stages[0].responses))
    return Outlook(problem, stages, leading)


def ranked(outlook: Outlook, facility: Facility, most: int) -> list[Proposal]:
    """The best scan of each kind, the most informative an hour first; the best one grown while that pays."""
    if outlook.entropy < _LEAST:
        return []
    single = sorted(weighed(outlook, facility, scans(outlook.stages)), key=lambda p: -p.rate)
    single = [proposal for proposal in single if proposal.information_nats >= _LEAST]
    if not single:
        return []
    grown = _grown(outlook, facility, single[0], single[1 : 1 + _TRIED])
    best: dict[str, Proposal] = {}
    for proposal in [grown, *single]:
        best.setdefault(proposal.scan.kind, proposal)
    return sorted(best.values(), key=lambda p: -p.rate)[:most]


def _grown(outlook: Outlook, facility: Facility, first: Proposal, others: Sequence[Proposal]) -> Proposal:
    """The scan with further slices, as long as each adds to what is said an hour."""
    best, left = first, [o for o in others if (o.scan.light, o.scan.stage) == (first.scan.light, first.scan.stage)]
    for _ in range(_SLICES - 1):
        joined = [best.scan.joined(other.scan) for other in left]
        found = max(weighed(outlook, facility, joined), key=lambda p: p.rate, default=best)
        if found.rate <= best.rate:
            break
        best = found
    return best


def weighed(outlook: Outlook, facility: Facility, some: Iterable[Scan]) -> list[Proposal]:
    """What each of some scans is worth; those that the instrument cannot carry out are left out."""
    found = []
    for scan in some:
        stage = outlook.stages[scan.stage]
        columns = {name: column[scan.rows] for name, column in stage.observation.columns.items()}
        remark = _DIMMED_REMARK if scan.light < 1 else _OTHER_REMARK.format(stage.sample) if stage.sample else ""
        text = plan_text(f"next: {scan.description}", plan_columns(columns, facility.arms), remark)
        try:
            duration = duration_of(text, facility)
        except InputError:
            # Beyond an arm, or where the arms are kept out: not a feasible scan.
            continue
        worth = outlook.worth(scan)
        if worth is not None:
            found.append(_proposal(scan, worth, outlook.leading, duration, text))
    return found


def _proposal(scan: Scan, worth: Worth, leading: Sequence[Explanation], duration: float, text: str) -> Proposal:
    least = np.minimum(worth.gains, worth.gains.T)
    pairs = [(i, j) for i in range(len(leading)) for j in range(i + 1, len(leading)) if least[i, j] >= TOLD_APART]
    gain = min((least[i, j] for i, j in pairs), default=least[0, 1] if len(leading) > 1 else 0.0)
    names = tuple((leading[i].label, leading[j].label) for i, j in pairs)
    return Proposal(scan, names, max(0.0, float(gain)), worth.information, worth.right, duration, text)


def write_plans(found: Sequence[Proposal], folder: Path) -> list[Path]:
    """Write the plans as ``plan-1.toml`` and so on, the best first; the folder is made, those of a diagnosis there go.

    Raises
    ------
    InputError
        As :func:`check_plans`; nothing is written then.
    """
    check_plans(folder)
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"plan-{number}.toml" for number in range(1, len(found) + 1)]
    for path, proposal in zip(paths, found, strict=True):
        write_result(path, (_heading(proposal) + proposal.plan).encode())
    for earlier in _numbered(folder):
        # A plan of another diagnosis would be taken for the next best of this one.
        if earlier not in paths:
            earlier.unlink()
    return paths


def check_plans(folder: Path) -> None:
    """Refuse a folder in which a plan that no diagnosis wrote bears the name of one, before any work.

    Raises
    ------
    InputError
        Naming the file.
    """
    for plan in _numbered(folder):
        if not plan.read_bytes().startswith(_HEADING.encode()):
            raise InputError(f"{plan}: is no plan of a diagnosis; expected another folder, or another name for it")


def _numbered(folder: Path) -> list[Path]:
    return [plan for plan in sorted(folder.glob("plan-*.toml")) if plan.stem.removeprefix("plan-").isdigit()]


def _heading(proposal: Proposal) -> str:
    return (
        f"{_HEADING} {proposal.information_nats:.2f} nats in {proposal.duration_s / 60:.0f} min"
        f" ({proposal.rate:.2f} nats an hour).\n"
    )


def unresolved(diagnosis: Diagnosis) -> list[tuple[str, str]]:
    """Pairs of effects of which the run does not say which it is."""
    decision = diagnosis.decision
    classes = decision.named or [first for first in decision.ranking[:1] if first.probability > _RIVAL]
    pairs = [(named.effect, other) for named in classes for other in named.members[1:]]
    if decision.verdict == "undecided" and len(decision.ranking) > 1 and decision.ranking[1].probability > _RIVAL:
        pairs.append((decision.ranking[0].effect, decision.ranking[1].effect))
    return pairs

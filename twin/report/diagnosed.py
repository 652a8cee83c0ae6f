"""The diagnosis of a run, as ``diagnosis.json`` has it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.figure import FigureBase

from twin.diagnosis.report_figures import GAP_HEIGHT, gap_bars, ranking_bars, ranking_height
from twin.report.document import Block, Plot, Points, Table, Words
from twin.report.facets import Facet, by_light, geometry
from twin.report.maps import Scale, draw_maps, map_height
from twin.report.measured import in_parts, part
from twin.report.sources import DiagnosisFile
from twin.rounding import chance_of, with_u

_LEADS = {
    "none": "Measurement and simulation agree: no gap beyond the budget.",
    "effects": "Measurement and simulation differ, and the cause is named.",
    "unknown": "Measurement and simulation differ, and no effect of the library explains it.",
    "undecided": "Measurement and simulation differ, or may; this run does not decide why.",
}
#: Pairs of effects that are written out.
_TOLD = 3
#: Effects of the ranking that are drawn.
_DRAWN = 8


def diagnosis_blocks(found: DiagnosisFile, run: xr.Dataset | None, run_digest: str) -> list[Block]:
    """Everything that the diagnosis says.

    Parameters
    ----------
    run_digest
        SHA-256 of the run file of this report, to be held against that of the diagnosis.
    """
    blocks: list[Block] = [Words(_LEADS[found.verdict], "verdict")]
    if (other := _other_run(found, run_digest)) is not None:
        blocks.append(Words(other))
    blocks += [Points(_consistency(found)), *_effects(found), *_ranking(found), *_where(found, run), *_gap(found)]
    if found.next_scan:
        rows = [
            [
                scan.description,
                _pairs(scan.separates),
                _one_decimal(scan.gain_nats),
                _one_decimal(scan.duration_s / 60),
            ]
            for scan in found.next_scan
        ]
        header = ["scan", "tells apart", "expected gain / nats", "duration / min"]
        blocks.append(Table("diagnosis_next_scan", "What to measure next.", header, rows, (2, 3)))
    if found.ruled_out:
        rows = [[name.replace("_", " "), why] for name, why in found.ruled_out.items()]
        blocks.append(
            Table("diagnosis_not_looked_for", "Effects that were not looked for.", ["effect", "reason"], rows)
        )
    return blocks


def _other_run(found: DiagnosisFile, run_digest: str) -> str | None:
    known = found.made_with.get("inputs")
    entry = known.get("run") if isinstance(known, dict) else None
    if not isinstance(entry, dict) or not run_digest or entry.get("sha256") == run_digest:
        return None
    return (
        f"Attention: the diagnosis was made of {entry.get('file')} with the digest {str(entry.get('sha256'))[:16]}...,"
        f" and the run file of this report has {run_digest[:16]}...: it was amended since, or is another run."
    )


def _consistency(found: DiagnosisFile) -> list[str]:
    c = found.consistency
    lines = [
        (
            f"Measured and simulated values {'agree' if c.consistent else 'do not agree'} within their uncertainties"
            f" (p = {c.p_value:.2g}, an upper limit whatever the correlation of the errors)."
        ),
        (
            "To explain the difference without any effect the budget would have to be larger by"
            f" {100 * c.dark_uncertainty:.2f} % (relative, k = 1, in quadrature)."
            if c.dark_uncertainty > 0
            else "The budget lacks nothing to explain the difference."
        ),
    ]
    if found.probabilities:
        said = ", ".join(f"{name}: {chance_of(value)}" for name, value in _explained(found).items())
        lines.append(f"Probability that nothing of the library is the cause: {said}.")
    return lines


def _effects(found: DiagnosisFile) -> list[Block]:
    rows = []
    for one in found.effects:
        for name, entry in one.parameters.items():
            value, u = with_u(entry.get("value", math.nan), entry.get("u", math.nan))
            budget = f"{entry['budget']:.3g}" if "budget" in entry else "not stated"
            rows.append([one.effect.replace("_", " "), chance_of(one.probability), name, value, u, budget])
    if not rows:
        return []
    header = ["effect", "probability", "parameter", "value", "u (k = 1)", "budget (k = 1)"]
    return [Table("diagnosis_effects", "Effects that are named, with refitted parameters.", header, rows, (1, 3, 4, 5))]


def _ranking(found: DiagnosisFile) -> list[Block]:
    if not found.ranking:
        return []
    rows = [
        [one.effect.replace("_", " "), chance_of(one.probability), ", ".join(_others(one.members)) or "-"]
        for one in found.ranking
    ]
    names = [*_explained(found), *(one.effect.replace("_", " ") for one in found.ranking[:_DRAWN])]
    chances = [*found.probabilities.values(), *(one.probability for one in found.ranking[:_DRAWN])]
    draw = partial(_draw_ranking, names=names, chances=chances)
    caption = (
        "Probabilities of the explanations. Of a class the probability is that the cause is one of it; two effects may"
        " be there at once, so that numbers need not add up to 1."
    )
    return [
        Plot("diagnosis_ranking", caption, ranking_height(names), draw, {"explanation": names, "probability": chances}),
        Table(
            "diagnosis_effect_ranking",
            "Effects by probability.",
            ["effect", "probability", "cannot be told from"],
            rows,
            (1,),
        ),
    ]


def _explained(found: DiagnosisFile) -> dict[str, float]:
    """Probabilities of what is no effect."""
    words = {"none": "no gap", "unknown": "unknown cause"}
    return {words.get(name, name): value for name, value in found.probabilities.items()}


def _others(members: tuple[str, ...]) -> list[str]:
    return [name.replace("_", " ") for name in members[1:]]


def _draw_ranking(figure: FigureBase, names: list[str], chances: list[float]) -> None:
    ranking_bars(figure, names, chances)


def _where(found: DiagnosisFile, run: xr.Dataset | None) -> list[Block]:
    if not found.where:
        return [Words("The gap is nowhere larger than the uncertainty, once noise is taken off.")]
    lines = [f"{r.description}: {r.strength:.1f} standard uncertainties, {len(r.points)} points." for r in found.where]
    blocks: list[Block] = [Words("Where the gap, free of noise, exceeds the standard uncertainty:"), Points(lines)]
    if run is None:
        return blocks
    located = np.zeros(run.sizes["point"])
    for region in found.where:
        located[list(region.points)] = np.maximum(located[list(region.points)], region.strength)
    data = geometry(run) | {"strength": located}
    top = float(located.max()) or 1.0

    def plot(chosen: Any, stem: str, said: str) -> Plot:
        own, moved = part(data, chosen)
        scale = Scale("strength of the gap / standard uncertainties (0: not located)", "OrRd", (0.0, top))
        draw = partial(_draw_where, data=own, facets=moved, scale=scale)
        return Plot(stem, said, map_height(len(chosen)), draw, own)

    caption = "Where the gap was located: cells are coloured by the strength of their region."
    return [*blocks, *in_parts(by_light(run), 9, "diagnosis_where", caption, plot)]


def _draw_where(figure: FigureBase, data: dict[str, np.ndarray], facets: list[Facet], scale: Scale) -> None:
    draw_maps(figure, data, facets, "strength", scale)


def _gap(found: DiagnosisFile) -> list[Block]:
    gap = found.gap
    left = gap.heldout_rms_before * (1 - gap.removable)
    data = {
        "what": ["held-out slices, before", "held-out slices, after", "noise and budget alone"],
        "rms_relative_difference": [gap.heldout_rms_before, gap.heldout_rms_after, left],
    }
    low, high = gap.shrink_interval
    unseen = "Root mean square relative difference on slices that took no part in choice or fit:"
    if gap.heldout_rms_withheld is not None:
        lines = [
            f"{unseen} {100 * gap.heldout_rms_before:.2f} %; over all points {100 * gap.rms_before:.2f} %.",
            (
                "No correction is offered for what was found: with it those slices would differ by"
                f" {100 * gap.heldout_rms_withheld:.2f} %."
            ),
        ]
    else:
        lines = [
            (
                f"{unseen} {100 * gap.heldout_rms_before:.2f} % before, {100 * gap.heldout_rms_after:.2f} % after what"
                f" was found is added; over all points {100 * gap.rms_before:.2f} % and {100 * gap.rms_after:.2f} %."
            ),
        ]
    if gap.heldout_rms_withheld is None and found.verdict != "none":
        lines.append(
            f"Without noise and budget the gap shrinks by {100 * gap.shrink:.0f} % (expected before looking:"
            f" {100 * low:.0f} to {100 * high:.0f} %); noise and budget let {100 * gap.removable:.0f} % of the whole go"
            " at most."
        )
    draw = partial(_draw_gap, before=gap.heldout_rms_before, after=gap.heldout_rms_after, left=left)
    caption = "The gap on slices held out, and what noise and budget alone leave."
    return [Points(lines), Plot("diagnosis_gap", caption, GAP_HEIGHT, draw, data)]


def _draw_gap(figure: FigureBase, before: float, after: float, left: float) -> None:
    gap_bars(figure, before, after, left)


def _pairs(pairs: Sequence[Sequence[str]]) -> str:
    """The first pairs that a scan tells apart, and how many more."""
    told = "; ".join(" from ".join(name.replace("_", " ") for name in pair) for pair in pairs[:_TOLD])
    return f"{told}; and {len(pairs) - _TOLD} more pairs" if len(pairs) > _TOLD else told


def _one_decimal(value: float) -> str:
    return f"{value:.1f}" if math.isfinite(value) else "-"

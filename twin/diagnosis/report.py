"""The diagnosis for people: one HTML file with the verdict first and everything it rests on below."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from instrument.output import write_result
from twin import html_page
from twin.diagnosis import parity_only
from twin.diagnosis.diagnose import Diagnosis
from twin.diagnosis.outcome import advice, made_with, parameters, verdict_in_words, withheld, withheld_in_words
from twin.diagnosis.parity import Parity
from twin.diagnosis.posterior import PRIOR
from twin.diagnosis.report_figures import (
    MOST_MAPS,
    MOST_PLANES,
    Sides,
    draw_gap,
    draw_maps,
    draw_planes,
    draw_ranking,
    illuminations,
    summary,
)
from twin.diagnosis.verdict import TOLD_APART, Named
from twin.html_page import bullets, heading, paragraph, picture, table
from twin.rounding import chance_of, with_u

#: Effects of the ranking that are listed.
_LISTED = 10


def write_report(diagnosis: Diagnosis, symmetries: Sequence[Parity], file: Path) -> None:
    """Write the report; as :func:`instrument.output.write_result`."""
    write_result(file, report(diagnosis, symmetries).encode())


def report(diagnosis: Diagnosis, symmetries: Sequence[Parity]) -> str:
    """The report as HTML, complete in itself."""
    run = diagnosis.prepared.problem.run
    parts = [
        paragraph(_said(diagnosis), "verdict"),
        paragraph(f"{len(run)} points of {_names(run.name)}.", "faint"),
        *_gap(diagnosis),
        *_maps(diagnosis),
        *_where(diagnosis),
        *_ranking(diagnosis),
        *_parameters(diagnosis),
        *_shrink(diagnosis),
        *_symmetries(symmetries),
        *_next(diagnosis),
        *_ruled_out(diagnosis),
        heading("What the file lacks"),
        bullets(run.notes) or paragraph("Nothing: everything that a test could use is there."),
        *_made_with(diagnosis),
    ]
    return html_page.page(f"Diagnosis of {_names(run.name)}", [part for part in parts if part])


def _made_with(diagnosis: Diagnosis) -> list[str]:
    """Program and files, so that the diagnosis can be made again."""
    made = made_with(diagnosis)
    rows = [[what, one["file"], one["sha256"]] for what, one in made["inputs"].items()]
    return [heading("Made with"), paragraph(made["program"]), table(["", "file", "SHA-256"], rows) if rows else ""]


def _names(joined: str) -> str:
    """Files of the runs without their folders."""
    return ", ".join(Path(name).name for name in joined.split(", "))


def _said(diagnosis: Diagnosis) -> str:
    lead = {
        "none": "Measurement and simulation agree.",
        "effects": "Measurement and simulation differ, and the cause is named:",
        "unknown": "Measurement and simulation differ, and the cause is not known.",
        "undecided": "This run does not decide.",
    }[diagnosis.decision.verdict]
    return " ".join([lead, *verdict_in_words(diagnosis)])


def _gap(diagnosis: Diagnosis) -> list[str]:
    """Is there a gap?"""
    found = diagnosis.consistency
    verdict = "agree within their uncertainties" if found.consistent else "do not agree within their uncertainties"
    chance = f"at most {found.p_value:.2g}" if found.p_value < 1 else "1 (no sign of a gap)"
    lines = [
        (
            f"Measurement and simulation {verdict}: probability {chance} that a sound run looks so, whatever the"
            " correlation of its errors."
        ),
        (
            f"Chi-square over points, with the full covariance: {found.chi_square:.2f}. About 1 says that the scatter"
            " is as large as stated; a pattern may still hide in it."
        ),
    ]
    if found.dark_uncertainty > 0:
        lines.append(
            f"The budget would have to be larger by {100 * found.dark_uncertainty:.2f} % (relative, k = 1, in"
            " quadrature) to explain the difference without any effect."
        )
    else:
        lines.append("The budget lacks nothing to explain the difference.")
    posterior = diagnosis.posterior
    lines.append(
        f"Probability of no gap {chance_of(posterior.none)}, of a gap that no effect of the library explains"
        f" {chance_of(posterior.unknown)}. Before looking they were {PRIOR['none']:g} and {PRIOR['unknown']:g}, that of"
        f" one effect {PRIOR['one']:g}, of two {PRIOR['two']:g}."
    )
    return [heading("Is there a gap?"), bullets(lines), _structures(diagnosis)]


def _structures(diagnosis: Diagnosis) -> str:
    """How the errors are correlated, as far as the run tells under the leading explanation."""
    members, fit = diagnosis.prepared.problem.members, diagnosis.decision.leading.fit
    if fit is None:
        return ""
    weight = np.exp(fit.by_structure + np.array([m.log_weight for m in members]) - fit.log_evidence)
    best = np.argsort(-weight)[:5]
    rows = [[members[k].name, f"{weight[k]:.2f}"] for k in best if weight[k] > 0.01]
    text = "What the run says of how noise and stability are correlated, the leading explanation taken off:"
    return paragraph(text) + table(["structure of the errors", "probability"], rows, [1])


def sides_of(diagnosis: Diagnosis) -> Sides:
    """The run beside the predictions before and after."""
    problem = diagnosis.prepared.problem
    measured, nominal = problem.run.brf, problem.nominal
    corrected = nominal * np.exp(diagnosis.correction)
    u = np.sqrt(problem.run.relative_u**2 + problem.u_nominal**2)
    return Sides(problem.run, (nominal - measured) / measured, (corrected - measured) / measured, u)


def _maps(diagnosis: Diagnosis) -> list[str]:
    sides = sides_of(diagnosis)
    groups = illuminations(sides.run)
    rows = [
        [title, str(len(points)), f"{summary(sides.before, points):.2f}", f"{summary(sides.after, points):.2f}"]
        for title, points in groups
    ]
    after = "after" if diagnosis.decision.leading.names else "after (no effect is added)"
    more = f" The first {MOST_MAPS} of {len(groups)} illuminations are drawn." if len(groups) > MOST_MAPS else ""
    planes = int(sides.run.plane.max()) + 1
    more_planes = f" The first {MOST_PLANES} of {planes} planes are drawn." if planes > MOST_PLANES else ""
    names = " and ".join(diagnosis.decision.leading.names) or "nothing"
    return [
        heading("Before and after"),
        paragraph(f"After means: with the leading explanation ({names}) added to the simulation and fitted."),
        table(["", "points", "before / %", f"{after} / %"], rows, [1, 2, 3]),
        picture(
            draw_maps(sides, score=False),
            f"Relative difference over the sensor's direction; from the centre: its zenith. Star: light.{more}",
        ),
        picture(draw_maps(sides, score=True), f"The same over the combined standard uncertainty (t').{more}"),
        picture(
            draw_planes(sides),
            "Every plane with the bands of one and two combined standard uncertainties; circles before, crosses after."
            + more_planes,
        ),
    ]


def _where(diagnosis: Diagnosis) -> list[str]:
    lines = [
        f"{region.description}: {region.strength:.1f} u, {len(region.points)} points" for region in diagnosis.where
    ]
    if not lines:
        return [heading("Where"), paragraph("Nowhere: no gap is larger than the uncertainty once noise is taken off.")]
    text = (
        "Points where the gap that the leading explanation sees, free of noise, is larger than the combined standard"
        " uncertainty u of the run:"
    )
    return [heading("Where"), paragraph(text), bullets(lines)]


def _ranking(diagnosis: Diagnosis) -> list[str]:
    found = diagnosis.prepared.responses.found
    ranking = diagnosis.decision.ranking[:_LISTED]
    names = ["no gap", "unknown cause", *(named.effect for named in ranking[:6])]
    chances = [diagnosis.posterior.none, diagnosis.posterior.unknown, *(n.probability for n in ranking[:6])]
    rows = [
        [n.effect, found[n.effect].effect.title, chance_of(n.probability), ", ".join(n.members[1:]) or "-"]
        for n in ranking
    ]
    return [
        heading("Which effect"),
        picture(draw_ranking(names, chances), "Probabilities of the explanations."),
        table(["effect", "meaning", "probability", "cannot be told from"], rows, [2]),
        paragraph(
            "Of a class, the probability is that the cause is one of it. Two effects may be there at once: the numbers"
            " of effects need not add up to 1.",
            "faint",
        ),
    ]


def _parameters(diagnosis: Diagnosis) -> list[str]:
    """Refitted parameters against their budget."""
    named = diagnosis.decision.named or diagnosis.decision.ranking[:2]
    rows = [row for one in named for row in _parameter_rows(diagnosis, one)]
    if not rows:
        return []
    said = "" if diagnosis.decision.named else " None of these is named; the values hold if it were the cause."
    return [
        heading("Refitted parameters"),
        table(
            ["effect", "parameter", "value", "u (k = 1)", "budget (k = 1)", "against budget"],
            rows,
            [2, 3, 4],
        ),
        paragraph(f"What is added to the nominal configuration; ratios and shapes as they stand.{said}", "faint"),
    ]


def _parameter_rows(diagnosis: Diagnosis, named: Named) -> list[list[str]]:
    found = {p.name: p for p in diagnosis.prepared.responses.found[named.effect].parameters}
    rows = []
    for name, entry in parameters(diagnosis, named).items():
        budget, against = "not stated", "-"
        if "budget" in entry:
            budget = f"{entry['budget']:.3g}"
            times = abs(entry["value"] - found[name].nominal) / entry["budget"]
            against = f"{times:.1f} times" + (": beyond it" if times > 2 else ": within twice")
        unit = found[name].unit
        label = name if unit in ("1", "") else f"{name} ({unit})"
        rows.append([named.effect, label, *with_u(entry["value"], entry["u"]), budget, against])
    return rows


def _shrink(diagnosis: Diagnosis) -> list[str]:
    gap = diagnosis.gap
    left = gap.heldout_before * (1 - gap.removable)
    lines = [
        (
            f"Expected before looking at the held-out slices, from the others: without noise and budget the gap shrinks"
            f" by {100 * gap.interval[0]:.0f} to {100 * gap.interval[1]:.0f} % (90 % interval)."
        ),
        (
            f"Measured on slices that took no part in choice or fit: {100 * gap.shrink:.0f} %. The whole goes"
            f" from {100 * gap.heldout_before:.2f} % to {100 * gap.heldout_after:.2f} % (root mean square), which is"
            f" {100 * gap.plain_shrink:.0f} % less; noise and budget let {100 * gap.removable:.0f} % go at most."
        ),
        (
            f"For comparison only, over all points including the fitted ones: {100 * gap.before:.2f} % to"
            f" {100 * gap.after:.2f} %."
        ),
    ]
    if withheld(diagnosis):
        lines.insert(0, withheld_in_words(gap))
    chosen = [" and ".join(names) or "nothing" for names in gap.chosen]
    if chosen:
        lines.append(f"Chosen without each group of slices: {'; '.join(chosen)}.")
    if diagnosis.decision.verdict == "none":
        lines.insert(
            0, "No gap was found: there is nothing to shrink, and the numbers only say that nothing was harmed."
        )
    return [
        heading("How far the gap shrinks"),
        picture(
            draw_gap(gap.heldout_before, gap.heldout_after, left), "The gap on slices held out, and what noise leaves."
        ),
        bullets(lines),
    ]


def _symmetries(symmetries: Sequence[Parity]) -> list[str]:
    if not symmetries:
        return []
    return [
        heading("Symmetries of the run, without any simulation"),
        bullets(parity_only.in_words(tuple(symmetries))),
    ]


def _next(diagnosis: Diagnosis) -> list[str]:
    rows = [
        [
            p.scan.description,
            _pairs(p.separates),
            f"{p.information_nats:.2f}",
            f"{p.duration_s / 60:.0f}",
            f"{p.rate:.1f}",
            f"{p.right:.2f}",
        ]
        for p in diagnosis.proposals
    ]
    others = [f"{one['description']}: tells {_pairs(one['separates'])}" for one in advice(diagnosis)]
    parts = [heading("Next scan")]
    if rows:
        text = "Feasible scans, by what they are expected to say about the cause, an hour:"
        parts += [
            paragraph(text),
            table(["scan", "tells", "information / nats", "min", "nats / h", "right cause then"], rows, [2, 3, 4, 5]),
        ]
    if others:
        parts += [paragraph("What else would, as the library knows it; not computed for this run:"), bullets(others)]
    return parts if len(parts) > 1 else [*parts, paragraph("Nothing has to be told apart: no scan is proposed.")]


def _pairs(pairs: Sequence[Sequence[str]]) -> str:
    return "; ".join(" from ".join(pair) for pair in pairs)


def _ruled_out(diagnosis: Diagnosis) -> list[str]:
    found, out = diagnosis.prepared.responses.found, diagnosis.prepared.responses.ruled_out
    rows = [[name, f"{behind:.1f}" if np.isfinite(behind) else "-", why] for name, behind, why in _behind(diagnosis)]
    parts = [heading("What was ruled out, and why")]
    if out:
        parts += [
            paragraph("Effects that were not looked for:"),
            table(["effect", "reason"], [[name, reason] for name, reason in sorted(out.items())]),
        ]
    if rows:
        text = (
            f"Of {len(found)} effects looked for, those alone explain the run worse than the leading explanation by so"
            f" many nats of evidence ({TOLD_APART:g} nats are odds of 20 to 1; fewer rule nothing out):"
        )
        parts += [paragraph(text), table(["effect", "nats behind", ""], rows, [1])]
    return parts


def _behind(diagnosis: Diagnosis) -> list[tuple[str, float, str]]:
    """Name, evidence behind the leading explanation in nats, and what that means; the nearest first."""
    leading = diagnosis.decision.leading
    # Beside a smooth gap of unknown cause an effect stands with another evidence than that of its own fit.
    alone = {
        h.names[0]: h.log_evidence
        for h in diagnosis.posterior.hypotheses
        if len(h.names) == 1 and h.fit is not None and h.log_evidence == h.fit.log_evidence
    }
    rows = []
    for name in diagnosis.prepared.responses.found:
        if name in leading.names:
            continue
        if name not in alone:
            rows.append((name, np.inf, "its physical limits leave nothing that this run could show"))
            continue
        behind = leading.log_evidence - alone[name]
        rows.append((name, behind, "not ruled out" if behind < TOLD_APART else "ruled out as the only cause"))
    return sorted(rows, key=lambda row: row[1])

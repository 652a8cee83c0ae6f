"""The diagnosis in the form of the data contract (``diagnosis.json``), and the predictions before and after."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from instrument.angles import FloatArray
from twin.corrections import Correction, Corrections
from twin.diagnosis.diagnose import Diagnosis
from twin.diagnosis.effects import Parameter
from twin.diagnosis.followup import unresolved
from twin.diagnosis.gap import Gap
from twin.diagnosis.unknown import RESPONSE_ERROR
from twin.diagnosis.verdict import Named
from twin.rounding import chance_of, with_u

#: Effects that are listed in the ranking.
_LISTED = 12


def to_dict(diagnosis: Diagnosis) -> dict[str, Any]:
    """The diagnosis as JSON, keys as in the data contract, section Diagnosis."""
    rows, gap, consistency = diagnosis.prepared.problem.run.rows, diagnosis.gap, diagnosis.consistency
    return {
        "consistency": {
            "consistent": consistency.consistent,
            "p_value": consistency.p_value,
            "dark_uncertainty": consistency.dark_uncertainty,
            "chi_square_per_point": consistency.chi_square,
        },
        "where": [
            {"points": rows[r.points].tolist(), "description": r.description, "strength": r.strength}
            for r in diagnosis.where
        ],
        "verdict": diagnosis.decision.verdict,
        "probabilities": {"none": diagnosis.posterior.none, "unknown": diagnosis.posterior.unknown},
        "effects": [{**_ranked(n), "parameters": parameters(diagnosis, n)} for n in diagnosis.decision.named],
        "ranking": [_ranked(n) for n in diagnosis.decision.ranking[:_LISTED]],
        "gap": {
            "rms_before": gap.before,
            "rms_after": gap.after,
            "heldout_rms_before": gap.heldout_before,
            "heldout_rms_after": gap.heldout_after,
            "shrink": gap.shrink,
            "shrink_interval": list(gap.interval),
            "plain_shrink": gap.plain_shrink,
            "removable": gap.removable,
            "heldout_gain_nats": gap.gain,
            "heldout_rms_withheld": gap.withheld if withheld(diagnosis) else None,
        },
        "next_scan": next_scans(diagnosis),
        "advice": advice(diagnosis),
        "made_with": made_with(diagnosis),
        "ruled_out": diagnosis.prepared.responses.ruled_out,
        "notes": list(diagnosis.prepared.problem.run.notes),
    }


def _ranked(named: Named) -> dict[str, Any]:
    return {"effect": named.effect, "class": list(named.members), "probability": named.probability}


def made_with(diagnosis: Diagnosis) -> dict[str, Any]:
    """Program and files, by name and digest, that the diagnosis was made with."""
    names = diagnosis.prepared.problem.run.name.split(", ")
    runs = {"run" if len(names) == 1 else f"run {n}": Path(name) for n, name in enumerate(names, start=1)}
    files = {what: path / "run.nc" if path.is_dir() else path for what, path in runs.items()}
    inputs = diagnosis.prepared.inputs
    if inputs is not None:
        files |= {"facility": inputs.facility, "artifact": inputs.artifact, "material": inputs.material}
    digests = {
        what: {"file": path.name, "sha256": hashlib.sha256(path.read_bytes()).hexdigest()}
        for what, path in files.items()
        if path.is_file()
    }
    return {"program": f"goniotwin {version('goniotwin')}", "inputs": digests}


def parameters(diagnosis: Diagnosis, named: Named) -> dict[str, dict[str, float]]:
    """Refitted parameters with their standard uncertainties, and what the budget states of them.

    The uncertainty of a fit takes the twin's response to the effect for exact, and its law for the true one; what they
    are wrong by changes the parameters in proportion.
    """
    response = diagnosis.prepared.responses.found[named.effect]
    error = max(RESPONSE_ERROR, response.effect.form_error)
    return {
        p.name: {"value": float(value), "u": float(np.hypot(u, error * _size(p, value)))}
        | ({"budget": p.budget} if p.budget > 0 else {})
        for p, value, u in zip(response.parameters, named.values, named.u, strict=True)
    }


def _size(parameter: Parameter, value: float) -> float:
    """What an error in proportion is in proportion to: a width or a length has its zero at 0, whatever is nominal."""
    return value if parameter.shape and parameter.cap[0] > 0 else value - parameter.nominal


def next_scans(diagnosis: Diagnosis) -> list[dict[str, Any]]:
    """Scans that are expected to tell apart what the run cannot, the most informative an hour first."""
    return [
        {
            "description": p.scan.description,
            "separates": [list(pair) for pair in p.separates],
            "gain_nats": p.gain_nats,
            "duration_s": p.duration_s,
            "information_nats": p.information_nats,
            "information_per_hour": p.rate,
            "probability_after": p.right,
            "plan": p.plan,
        }
        for p in diagnosis.proposals
    ]


def advice(diagnosis: Diagnosis) -> list[dict[str, Any]]:
    """What else would tell apart the effects of a class, as the library knows it: other scans, other means."""
    found = diagnosis.prepared.responses.found
    scans: dict[str, list[list[str]]] = {}
    for one, other in unresolved(diagnosis):
        for name in (one, other):
            if found[name].effect.separated_by:
                scans.setdefault(found[name].effect.separated_by, []).append([one, other])
    return [{"description": text, "separates": pairs} for text, pairs in scans.items()]


def next_in_words(diagnosis: Diagnosis) -> list[str]:
    """What to measure next, one sentence each."""
    lines = [
        f"Next scan: {p.scan.description}; {p.duration_s / 60:.0f} min, expected information"
        f" {p.information_nats:.2f} nats ({p.rate:.1f} an hour), the right cause then at {p.right:.2f}."
        for p in diagnosis.proposals
    ]
    told = {pair for p in diagnosis.proposals for pair in p.separates}
    left = [pair for pair in unresolved(diagnosis) if pair not in told and pair[::-1] not in told]
    for text in advice(diagnosis):
        pairs = [tuple(pair) for pair in text["separates"] if tuple(pair) in left]
        if pairs:
            lines.append(f"To tell {_pairs(pairs)}: {text['description']}.")
    return lines


def _pairs(pairs: Sequence[Sequence[str]]) -> str:
    return ", ".join(" from ".join(pair) for pair in pairs)


def withheld(diagnosis: Diagnosis) -> bool:
    """Whether effects are named whose correction would make the held-out slices differ more."""
    return diagnosis.gap.withheld is not None and bool(diagnosis.decision.named)


def corrections_of(diagnosis: Diagnosis) -> Corrections:
    """The named effects as a corrections file has them; empty where none is named, or the correction is withheld."""
    effects = []
    for named in () if withheld(diagnosis) else diagnosis.decision.named:
        found = parameters(diagnosis, named)
        values = {name: entry["value"] for name, entry in found.items()}
        effects.append(
            Correction(effect=named.effect, parameters=values, u={name: entry["u"] for name, entry in found.items()})
        )
    runs = tuple(Path(name).name for name in diagnosis.prepared.problem.run.name.split(", "))
    return Corrections(form="corrections", version=1, found_in=runs, effects=tuple(effects))


def predictions(diagnosis: Diagnosis) -> xr.Dataset:
    """Nominal and corrected predictions of every usable point, in the prediction format."""
    problem = diagnosis.prepared.problem
    corrected = problem.nominal * np.exp(diagnosis.correction)
    u = problem.nominal * np.sqrt(problem.u_nominal**2 + np.sum(problem.budget**2, axis=1))
    units = {"wavelength": "nm"}
    coords = {name: ("point", c, {"units": units.get(name, "degree")}) for name, c in problem.run.columns.items()}
    monte_carlo = problem.nominal * problem.u_nominal
    return xr.Dataset(
        {
            "brf": _variable(corrected, "bidirectional reflectance factor, corrected for what was found"),
            "brf_nominal": _variable(problem.nominal, "bidirectional reflectance factor of the nominal twin"),
            "brf_corrected": _variable(corrected, "bidirectional reflectance factor, corrected for what was found"),
            "u_brf": _variable(u, "combined standard uncertainty (k=1) of brf, inputs within their budget"),
            "u_brf_monte_carlo": _variable(monte_carlo, "standard error of the ray tracer (k=1)"),
        },
        coords=coords,
        attrs={"Conventions": "CF-1.11", "title": "predicted reflectance factors before and after the diagnosis"},
    )


def _variable(values: FloatArray, long_name: str) -> tuple[str, FloatArray, dict[str, str]]:
    return "point", values, {"units": "1", "long_name": long_name}


def verdict_in_words(diagnosis: Diagnosis) -> list[str]:
    """The verdict alone, one sentence each."""
    decision, posterior = diagnosis.decision, diagnosis.posterior
    found = diagnosis.prepared.responses.found
    lines = []
    if decision.verdict == "none":
        lines.append(f"No gap beyond the budget (probability {chance_of(posterior.none)}).")
    elif decision.verdict == "unknown":
        lines.append(f"A gap that no effect of the library explains (probability {chance_of(posterior.unknown)}).")
    elif decision.verdict == "undecided":
        best = ", ".join(f"{n.effect} ({n.probability:.2f})" for n in decision.ranking[:3])
        lines.append(
            f"Undecided: no gap {posterior.none:.2f}, unknown {posterior.unknown:.2f}; most probable effects {best}."
        )
    for named in decision.named if decision.verdict == "effects" else ():
        title = found[named.effect].effect.title
        values = ", ".join(
            f"{name} {' +- '.join(with_u(entry['value'], entry['u']))}"
            for name, entry in parameters(diagnosis, named).items()
        )
        text = f"{title} ({named.effect}): probability {chance_of(named.probability)}; {values}"
        if len(named.members) > 1:
            text += f"; this run cannot tell it from {', '.join(named.members[1:])}"
        lines.append(text + ".")
    return lines


def withheld_in_words(gap: Gap) -> str:
    """Why a correction is not offered."""
    assert gap.withheld is not None
    return (
        f"No correction: held-out slices differ by {100 * gap.heldout_before:.2f} % as they are and by"
        f" {100 * gap.withheld:.2f} % once corrected, as errors that many points share outweigh the effect. The effect"
        " and its parameters stand."
    )


def in_words(diagnosis: Diagnosis) -> Sequence[str]:
    """What was found, one sentence each."""
    decision, gap = diagnosis.decision, diagnosis.gap
    lines = verdict_in_words(diagnosis)
    lines += [f"{region.description} ({region.strength:.1f} u)." for region in diagnosis.where]
    if withheld(diagnosis):
        lines.append(withheld_in_words(gap))
    elif decision.verdict != "none":
        lines += [
            (
                f"Held-out slices: relative difference {100 * gap.heldout_before:.2f} % before,"
                f" {100 * gap.heldout_after:.2f} % after: {100 * gap.plain_shrink:.0f} % less; noise and budget let"
                f" {100 * gap.removable:.0f} % go at most."
            ),
            (
                f"Without noise and budget the gap shrinks by {100 * gap.shrink:.0f} % (expected from the other slices:"
                f" {100 * gap.interval[0]:.0f} to {100 * gap.interval[1]:.0f} %)."
            ),
        ]
    return lines + next_in_words(diagnosis)

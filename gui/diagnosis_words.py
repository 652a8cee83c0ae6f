"""``diagnosis.json`` in the words of the page Understand."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from gui.words import MINUS
from twin.rounding import chance_of, with_u

_VERDICTS = {
    "none": ("check", "good", "No gap beyond the uncertainties", "Nothing needs to be changed."),
    "effects": ("lens", "hold", "A cause is found", "Read what it is, how sure that is, and what to do next."),
    "unknown": (
        "warning",
        "bad",
        "A gap that no known effect explains",
        "Look at where it is, and at the instrument: something is there that the library does not hold.",
    ),
    "undecided": ("warning", "hold", "Several causes are possible", "The next scan below tells them apart."),
}
_UNITS = {"deg": "°", "mm": "mm", "nm": "nm", "um": "µm"}


@dataclass(frozen=True)
class Verdict:
    """The headline: sign, tone, what was found, what follows."""

    sign: str
    tone: str
    title: str
    text: str


def verdict_of(found: dict[str, Any]) -> Verdict:
    """The headline of a diagnosis."""
    known = _VERDICTS.get(str(found.get("verdict")))
    if known is None:
        return Verdict("ring", "quiet", f"Verdict: {found.get('verdict')}", "")
    probabilities = found.get("probabilities", {})
    said = [f"{name} {chance_of(value)}" for name, value in probabilities.items() if isinstance(value, int | float)]
    return Verdict(*known[:3], f"{known[3]} Probabilities: {', '.join(said)}." if said else known[3])


def where_of(found: dict[str, Any]) -> list[str]:
    """Where the gap is."""
    return [
        f"{region.get('description', '')} ({len(region.get('points', []))} points,"
        f" {region.get('strength', 0.0):.1f} standard uncertainties)"
        for region in found.get("where", [])
    ] or ["Nowhere beyond the uncertainties."]


def which_of(found: dict[str, Any]) -> list[tuple[str, str, str, str]]:
    """Rows of the table of effects: name, probability, size, what it cannot be told from."""
    named = {entry["effect"]: entry for entry in found.get("effects", [])}
    rows = []
    for entry in found.get("ranking", []):
        name = entry["effect"]
        parameters = named.get(name, {}).get("parameters", {})
        size = ", ".join(_size(key, p["value"], p["u"]) for key, p in parameters.items())
        others = ", ".join(other.replace("_", " ") for other in entry.get("class", [])[1:])
        rows.append((name.replace("_", " "), chance_of(entry["probability"]), size, others))
    return rows


def _size(key: str, value: float, u: float) -> str:
    """A parameter with its unit, which its name ends with: ``angle_deg``, ``height_mm``."""
    name, _, end = key.rpartition("_")
    unit = _UNITS.get(end) if name else None
    words = (name if unit else key).replace("_", " ")
    told = " ± ".join(with_u(value, u)).replace("-", MINUS)
    return f"{words} {told}{f' {unit}' if unit else ''}"


def how_far_of(found: dict[str, Any]) -> list[str]:
    """How far the gap shrinks."""
    gap = found.get("gap", {})
    lines = []
    withheld = gap.get("heldout_rms_withheld")
    if withheld is not None:
        lines.append(
            f"Slices held out: {100 * gap['heldout_rms_before']:.2f} %. No correction is offered: it would leave"
            f" {100 * withheld:.2f} %."
        )
    elif "heldout_rms_before" in gap:
        lines.append(
            f"Slices held out: {100 * gap['heldout_rms_before']:.2f} % before,"
            f" {100 * gap['heldout_rms_after']:.2f} % after what was found is added."
        )
    if withheld is None and gap.get("shrink_interval") and found.get("verdict") != "none":
        low, high = gap["shrink_interval"]
        lines.append(
            f"The gap shrinks by {100 * gap.get('shrink', 0.0):.0f} % (expected {100 * low:.0f} to {100 * high:.0f} %)."
        )
    consistency = found.get("consistency", {})
    if "p_value" in consistency:
        sound = "agree" if consistency.get("consistent") else "do not agree"
        lines.append(
            f"Measured and simulated values {sound} within their uncertainties (p = {consistency['p_value']:.2g})."
        )
    return lines


def next_of(found: dict[str, Any]) -> list[str]:
    """What to measure next."""
    lines = []
    for scan in found.get("next_scan", []):
        pairs = scan.get("separates", [])
        told = ", ".join(f"{a.replace('_', ' ')} from {b.replace('_', ' ')}" for a, b in pairs[:3])
        more = f" and {len(pairs) - 3} more pairs" if len(pairs) > 3 else ""
        lines.append(f"Measure {scan.get('description', '')}: it tells {told}{more}." if told else scan["description"])
    return lines or ["Nothing more is needed to tell causes apart."]


def next_plan_of(found: dict[str, Any]) -> str:
    """The plan (TOML) that a diagnosis proposes; empty where it proposes none."""
    for scan in found.get("next_scan", []):
        if isinstance(scan.get("plan"), str):
            return str(scan["plan"])
    return ""

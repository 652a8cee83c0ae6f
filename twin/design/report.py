"""The result of a design study as tables for people."""

from __future__ import annotations

from rich.console import Console
from rich.table import Table

from instrument.plan import Plan
from twin.design.separation import EFFECTS
from twin.design.study import Judgement, separation_json


def print_study(found: list[Judgement], best: Judgement, plan: Plan | None, facility_named: bool) -> None:
    """Scores of all candidates; of the best one every effect, and its plan."""
    console = Console(highlight=False)
    table = Table(title="Candidates")
    table.add_column("candidate", min_width=14)
    for heading in ("reflectance", "structure / %", "of it measurable / %", "over budget", "separation"):
        # As wide as the longest word: 80 columns hold them all, whole.
        table.add_column(heading, justify="right", min_width=max(map(len, heading.split())))
    for judgement in found:
        reflectance = float(judgement.pattern["hemispherical_reflectance"].values[0])
        over, apart = judgement.signal.over_budget, judgement.separation
        table.add_row(
            judgement.candidate.name,
            f"{reflectance:.3f}",
            f"{100 * judgement.signal.structure:.1f}",
            f"{100 * judgement.signal.share:.1f}",
            "-" if over is None else f"{over:.1f}",
            "-" if apart is None else f"{apart.score:.2f}",
        )
    console.print(table)
    if best.separation is not None:
        console.print(_effects(best))
    elif facility_named:
        console.print("No separation: the facility has no budget to weigh effects with; planes follow the structure.")
    else:
        console.print("No separation: it needs a --facility with its budget; planes follow the structure.")
    if plan is not None:
        console.print(f"plan for {best.candidate.name}: {len(best.planes)} planes, {len(plan.points)} points")


def _effects(judgement: Judgement) -> Table:
    assert judgement.separation is not None
    sizes = {effect.name: f"{effect.size:g} {effect.unit}" for effect in EFFECTS}
    table = Table(title=f"What a scan of {judgement.candidate.name} tells, in standard deviations")
    for heading in ("effect", "size", "alone", "among the others", "most alike", "angle"):
        table.add_column(heading, justify="left" if heading in ("effect", "most alike") else "right", overflow="fold")
    for name, row in separation_json(judgement.separation)["effects"].items():
        table.add_row(
            name.replace("_", " "),
            sizes[name],
            f"{row['detectable']:.1f}",
            f"{row['distinct']:.1f}",
            row["nearest"].replace("_", " "),
            f"{row['angle_to_nearest']:.0f}°",
        )
    return table

"""``goniotwin diagnose``: why a run and its simulation differ."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from twin.diagnosis.diagnose import Diagnosis
    from twin.diagnosis.preparation import Inputs


def diagnose_command(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="A run file (.nc, .csv) or run folder.")],
    artifact: Annotated[Path | None, typer.Option(help="artifact.toml of the sample.", show_default=False)] = None,
    material: Annotated[Path | None, typer.Option(help="Coupon run, or table of the BRDF.", show_default=False)] = None,
    facility: Annotated[Path | None, typer.Option(help="facility.toml of the instrument.", show_default=False)] = None,
    json: Annotated[
        Path | None, typer.Option(help="Write the diagnosis here, for programs.", show_default=False)
    ] = None,
    prediction: Annotated[
        Path | None, typer.Option(help="Write nominal and corrected predictions here (.nc).", show_default=False)
    ] = None,
    cache: Annotated[
        Path | None, typer.Option(help="Folder for renderings; by default the user's.", show_default=False)
    ] = None,
) -> None:
    """Say where a run and its simulation differ, which effect causes it, and how far the gap shrinks once it is added."""
    from instrument.output import check_writable

    for file in (json, prediction):
        if file is not None:
            check_writable(file)
    inputs = _inputs(run, {"facility": facility, "artifact": artifact, "material": material})
    diagnosis = _diagnose(run, inputs, cache)
    _tell(diagnosis)
    _write(diagnosis, json, prediction)


def _inputs(run: Path, named: dict[str, Path | None]) -> Inputs:
    """Files of the twin: those named, else those that the scan left in its run folder."""
    from instrument.errors import InputError
    from twin.compare_command import kept_input
    from twin.diagnosis.preparation import Inputs

    if run.is_dir():
        named = {name: path or kept_input(run, name) for name, path in named.items()}
    missing = [f"--{name}" for name, path in named.items() if path is None]
    if missing:
        raise InputError(f"{', '.join(missing)} missing; expected the files that the twin is made from")
    return Inputs(**{name: path for name, path in named.items() if path is not None})


def _diagnose(run: Path, inputs: Inputs, cache: Path | None) -> Diagnosis:
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    from rich.console import Console
    from twin.diagnosis.diagnose import diagnose
    from twin.diagnosis.observation import read_observation
    from twin.diagnosis.preparation import Bench
    from twin.diagnosis.renders import default_cache

    observation = read_observation(run)
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("reading", total=1.0)
        prepared = Bench(inputs, cache or default_cache()).prepare(
            observation, lambda what, share: bar.update(task, description=what, completed=0.6 * share)
        )
        return diagnose(prepared, lambda what, share: bar.update(task, description=what, completed=0.6 + 0.4 * share))


def _tell(diagnosis: Diagnosis) -> None:
    from rich.console import Console
    from rich.table import Table

    from twin.diagnosis.outcome import in_words

    console = Console()
    for line in in_words(diagnosis):
        console.print(line, markup=False, highlight=False)
    table = Table("effect", "probability", "cannot be told from", title="Ranking")
    for named in diagnosis.decision.ranking[:6]:
        table.add_row(named.effect, f"{named.probability:.3f}", ", ".join(named.members[1:]) or "-")
    console.print(table)
    for note in diagnosis.prepared.problem.run.notes:
        console.print(f"{Path(diagnosis.prepared.problem.run.name).name}: {note}", markup=False, highlight=False)
    for effect, reason in diagnosis.prepared.responses.ruled_out.items():
        console.print(f"not looked for: {effect} ({reason})", markup=False, highlight=False)


def _write(diagnosis: Diagnosis, json: Path | None, prediction: Path | None) -> None:
    from instrument.dataset import write_prediction
    from instrument.output import write_json
    from twin.diagnosis.outcome import predictions, to_dict

    if json is not None:
        write_json(json, to_dict(diagnosis))
        typer.echo(f"written: {json}")
    if prediction is not None:
        write_prediction(predictions(diagnosis), prediction)
        typer.echo(f"written: {prediction}")

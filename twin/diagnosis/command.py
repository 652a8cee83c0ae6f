"""``goniotwin diagnose``: why a run and its simulation differ."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from instrument.options import Force

if TYPE_CHECKING:
    from collections.abc import Sequence

    from twin.diagnosis.diagnose import Diagnosis
    from twin.diagnosis.parity import Parity
    from twin.diagnosis.preparation import Inputs


def diagnose_command(
    runs: Annotated[
        list[Path], typer.Argument(metavar="RUN...", help="Run files (.nc, .csv) or run folders; several count as one.")
    ],
    artifact: Annotated[Path | None, typer.Option(help="artifact.toml of the sample.", show_default=False)] = None,
    material: Annotated[Path | None, typer.Option(help="Coupon run, or table of the BRDF.", show_default=False)] = None,
    facility: Annotated[Path | None, typer.Option(help="facility.toml of the instrument.", show_default=False)] = None,
    json: Annotated[
        Path | None, typer.Option(help="Write the diagnosis here, for programs.", show_default=False)
    ] = None,
    prediction: Annotated[
        Path | None, typer.Option(help="Write nominal and corrected predictions here (.nc).", show_default=False)
    ] = None,
    report: Annotated[
        Path | None, typer.Option(help="Write the diagnosis here, for people (.html).", show_default=False)
    ] = None,
    save_twin: Annotated[
        Path | None,
        typer.Option(help="Write the named effects here (.toml), for --corrections.", show_default=False),
    ] = None,
    plans: Annotated[
        Path | None,
        typer.Option(
            help="Folder for plan-1.toml and so on: the scans that would say most an hour, other planes and"
            " illumination angles among them.",
            show_default=False,
        ),
    ] = None,
    cache: Annotated[
        Path | None, typer.Option(help="Folder for renderings; by default the user's.", show_default=False)
    ] = None,
    columns: Annotated[
        Path | None,
        typer.Option(
            help="Mapping (TOML) of the columns of another laboratory's table; tests its symmetries.",
            show_default=False,
        ),
    ] = None,
    symmetry: Annotated[
        str, typer.Option(help="Of the sample when turned: isotropic, fourfold, twofold or mirror (none but that).")
    ] = "fourfold",
    same_mounting: Annotated[
        bool, typer.Option("--same-mounting", help="Several runs: the sample stayed on its mount between them.")
    ] = False,
    coupon: Annotated[
        list[Path] | None,
        typer.Option(help="Run of the flat coupon in place of the sample; counts with the others.", show_default=False),
    ] = None,
    white: Annotated[
        list[Path] | None,
        typer.Option(
            help="Run of the white reference in place of the sample; counts with the others.", show_default=False
        ),
    ] = None,
    wavelength: Annotated[
        float | None, typer.Option(help="Test the symmetries at this wavelength alone, nm.", show_default=False)
    ] = None,
    force: Force = False,
) -> None:
    """Say where a run and its simulation differ, which effect causes it, and how far the gap shrinks once it is added.

    Without --artifact, --material and --facility the run's symmetries alone are tested, which needs no simulation.
    """
    _check_outputs(json, (prediction, report, save_twin), plans, force)
    inputs = _inputs(runs[0], {"facility": facility, "artifact": artifact, "material": material})
    if inputs is None or columns is not None:
        outputs = {"--prediction": prediction, "--report": report, "--save-twin": save_twin, "--plans": plans}
        _check_alone(outputs, inputs, columns)
        _symmetries_alone(runs, columns, symmetry, wavelength, json)
        return
    beside = {"coupon": coupon or [], "white": white or []}
    diagnosis = _diagnose(runs, inputs, cache, same_mounting, beside, other_scans=plans is not None)
    found = _parity(runs, symmetry, wavelength)
    # Files first: whoever reads the words may stop reading.
    written = _write(diagnosis, found, json, prediction)
    if save_twin is not None:
        written.append(_save_twin(diagnosis, save_twin))
    if plans is not None:
        written += _write_plans(diagnosis, plans)
    if report is not None:
        from twin.diagnosis.report import write_report

        write_report(diagnosis, found, report)
        written.append(f"written: {report}")
    _tell(diagnosis, found)
    for line in written:
        typer.echo(line)


def _check_outputs(json: Path | None, files: Sequence[Path | None], plans: Path | None, force: bool) -> None:
    """Before any work: what cannot be written, or would replace something."""
    from instrument.output import check_json, check_new, check_new_folder

    check_json(json)
    for file in files:
        if file is not None:
            check_new(file, force)
    if plans is not None:
        from twin.diagnosis.followup import check_plans

        check_new_folder(plans, force)
        check_plans(plans)


def _save_twin(diagnosis: Diagnosis, file: Path) -> str:
    from twin.corrections import write_corrections
    from twin.diagnosis.outcome import corrections_of, withheld

    found = corrections_of(diagnosis)
    write_corrections(found, file)
    nothing = "no effect, as its correction is withheld" if withheld(diagnosis) else "no effect, as none is named"
    named = ", ".join(one.effect for one in found.effects) or nothing
    return f"written: {file} ({named})"


def _write_plans(diagnosis: Diagnosis, folder: Path) -> list[str]:
    from twin.diagnosis.followup import write_plans

    written = write_plans(diagnosis.proposals, folder)
    return [f"written: {path}" for path in written] or [f"no plan in {folder}: no scan would say more about the cause"]


def _check_alone(outputs: dict[str, Path | None], inputs: Inputs | None, columns: Path | None) -> None:
    from instrument.errors import InputError

    if inputs is not None:
        raise InputError(f"--columns {columns}: tests symmetries alone; expected no --artifact, --material, --facility")
    asked = [name for name, path in outputs.items() if path is not None]
    if asked:
        raise InputError(f"{', '.join(asked)}: need a twin; expected --artifact, --material and --facility")


def _symmetries_alone(
    runs: list[Path], columns: Path | None, symmetry: str, wavelength: float | None, json: Path | None
) -> None:
    from instrument.output import write_json
    from twin.diagnosis.parity_only import in_words, read_table, symmetries_of, to_dict

    results, notes = [], []
    for run in runs:
        observation = read_table(run, columns)
        found = symmetries_of(observation, symmetry, wavelength)
        typer.echo(f"{run.name}: {len(observation)} points; no twin is named, so only symmetries are tested")
        for line in in_words(found):
            typer.echo(line)
        for note in observation.notes:
            typer.echo(f"{run.name}: {note}")
        results += [{"run": run.name, **entry} for entry in to_dict(found)]
        notes += [f"{run.name}: {note}" for note in observation.notes]
    if json is not None:
        write_json(json, {"parity": results, "notes": notes})
        typer.echo(f"written: {json}")


def _parity(runs: list[Path], symmetry: str, wavelength: float | None) -> tuple[Parity, ...]:
    from twin.diagnosis.observation import LEAST_FOLLOWING, LEAST_POINTS, read_observation
    from twin.diagnosis.parity_only import symmetries_of

    read = [read_observation(run, LEAST_FOLLOWING if k else LEAST_POINTS) for k, run in enumerate(runs)]
    return tuple(one for run in read for one in symmetries_of(run, symmetry, wavelength))


def _inputs(run: Path, named: dict[str, Path | None]) -> Inputs | None:
    """Files of the twin: those named, else those that the scan left in its run folder; None where there are none."""
    from instrument.errors import InputError
    from twin.compare_command import kept_input
    from twin.diagnosis.preparation import Inputs

    if run.is_dir():
        named = {name: path or kept_input(run, name) for name, path in named.items()}
    if not any(named.values()):
        return None
    missing = [f"--{name}" for name, path in named.items() if path is None]
    if missing:
        raise InputError(f"{', '.join(missing)} missing; expected the files that the twin is made from")
    return Inputs(**{name: path for name, path in named.items() if path is not None})


def _diagnose(
    runs: list[Path],
    inputs: Inputs,
    cache: Path | None,
    same_mounting: bool,
    beside: dict[str, list[Path]],
    *,
    other_scans: bool,
) -> Diagnosis:
    from dataclasses import replace

    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    from twin.content import cache_folder
    from twin.diagnosis.diagnose import diagnose
    from twin.diagnosis.followup import further
    from twin.diagnosis.joint import prepare_jointly
    from twin.diagnosis.observation import LEAST_FOLLOWING, LEAST_POINTS, read_observation
    from twin.diagnosis.preparation import Bench

    observations = [read_observation(run, LEAST_FOLLOWING if k else LEAST_POINTS) for k, run in enumerate(runs)]
    others = {what: [read_observation(run, LEAST_FOLLOWING) for run in files] for what, files in beside.items()}
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("reading", total=1.0)
        bench = Bench(inputs, cache or cache_folder())

        def told(what: str, share: float) -> None:
            bar.update(task, description=what, completed=0.6 * share)

        if len(observations) == 1 and not any(others.values()):
            prepared = bench.prepare(observations[0], told)
        else:
            prepared = prepare_jointly(bench, observations, **others, same_mounting=same_mounting, told=told)
        found = diagnose(prepared, lambda what, share: bar.update(task, description=what, completed=0.6 + 0.4 * share))
        if other_scans:
            bar.update(task, description="what other scans would say")
            found = replace(found, proposals=tuple(further(found, bench)))
        return found


def _tell(diagnosis: Diagnosis, symmetries: tuple[Parity, ...]) -> None:
    from rich.console import Console
    from rich.table import Table

    from twin.diagnosis import parity_only
    from twin.diagnosis.outcome import in_words

    console = Console()
    for line in [*in_words(diagnosis), *parity_only.in_words(symmetries)]:
        console.print(line, markup=False, highlight=False)
    table = Table("effect", "probability", "cannot be told from", title="Ranking")
    for named in diagnosis.decision.ranking[:6]:
        table.add_row(named.effect, f"{named.probability:.3f}", ", ".join(named.members[1:]) or "-")
    console.print(table)
    for note in diagnosis.prepared.problem.run.notes:
        console.print(f"{Path(diagnosis.prepared.problem.run.name).name}: {note}", markup=False, highlight=False)
    for effect, reason in diagnosis.prepared.responses.ruled_out.items():
        console.print(f"not looked for: {effect} ({reason})", markup=False, highlight=False)


def _write(
    diagnosis: Diagnosis, symmetries: tuple[Parity, ...], json: Path | None, prediction: Path | None
) -> list[str]:
    """Write what is asked for, and say which files that were."""
    from instrument.dataset import write_prediction
    from instrument.output import write_json
    from twin.diagnosis import parity_only
    from twin.diagnosis.outcome import predictions, to_dict

    if json is not None:
        write_json(json, to_dict(diagnosis) | {"parity": parity_only.to_dict(symmetries)})
    if prediction is not None:
        write_prediction(predictions(diagnosis), prediction)
    return [f"written: {path}" for path in (json, prediction) if path is not None]

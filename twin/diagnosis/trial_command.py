"""``goniotwin blind-check``: how often the diagnosis is right, on cases whose effect it is not told."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from collections.abc import Sequence

    from twin.diagnosis.trial import Score, Truth
    from twin.diagnosis.trial_reliability import Bin


#: Columns of a printed table that goes into a file.
_FILE_WIDTH = 150


def blind_check(
    cases: Annotated[int, typer.Option(min=4, help="Number of cases to make.")] = 20,
    seed: Annotated[int, typer.Option(min=0, help="Of the cases.")] = 1,
    counts: Annotated[
        str | None,
        typer.Option(
            help="Sound cases, with one effect, two, outside the library, such as 40,100,0,0.", show_default=False
        ),
    ] = None,
    severity: Annotated[
        list[float] | None, typer.Option(help="Of cases with one effect; may be repeated.", show_default=False)
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for cases, diagnoses and tables; goes on where it stopped.")] = Path(
        "blind-check"
    ),
    runs: Annotated[
        Path | None, typer.Option(help="Folder with runs made elsewhere, in place of making them.", show_default=False)
    ] = None,
    common: Annotated[
        Path | None, typer.Option(help="Folder with facility.toml, artifact.toml, material.nc.", show_default=False)
    ] = None,
    labels: Annotated[
        Path | None, typer.Option(help="JSON with the truth of those runs, by name.", show_default=False)
    ] = None,
    workers: Annotated[int, typer.Option(min=1, help="Processes.")] = 1,
    cluster: Annotated[
        str | None,
        typer.Option(help="Address of a Dask scheduler; its workers must see the same folders.", show_default=False),
    ] = None,
    cache: Annotated[Path | None, typer.Option(help="Folder for renderings.", show_default=False)] = None,
    json: Annotated[Path | None, typer.Option(help="Write the scores here.", show_default=False)] = None,
) -> None:
    """Diagnose runs whose effect is withheld, then open the labels and print found against true.

    The labels are committed by their digest before; the diagnosing processes are given the runs alone.
    """
    from instrument.errors import InputError
    from instrument.output import check_json

    check_json(json)
    if (runs is None) != (labels is None) or (runs is None) != (common is None):
        raise InputError("--runs, --common and --labels: expected all three or none")
    if runs is None:
        chosen = ["--counts", counts] if counts is not None else []
        for value in severity or ():
            chosen += ["--severity", f"{value:g}"]
        _make(out, cases, seed, workers, chosen)
        runs, common = out / "cases", out / "common"
    assert common is not None
    found = _diagnose(sorted(runs.glob("*.nc")), common, out / "diagnoses", cache, workers, cluster)
    truths = _open_labels(out, labels)
    _report(found, truths, runs, json)


def _make(out: Path, cases: int, seed: int, workers: int, chosen: Sequence[str]) -> None:
    """Let the simulated laboratory write sealed cases, in a process of its own."""
    import subprocess
    import sys

    from instrument.errors import InputError

    command = [sys.executable, "-m", "instrument", "cases", "make", "--seed", str(seed), "--cases", str(cases)]
    done = subprocess.run([*command, "--out", str(out), "--workers", str(workers), *chosen], check=False)
    if done.returncode:
        raise InputError(f"goniotwin cases make: exit status {done.returncode}; expected a complete set of cases")


def _diagnose(
    files: Sequence[Path], common: Path, out: Path, cache: Path | None, workers: int, cluster: str | None
) -> dict[str, dict[str, Any]]:
    """Diagnoses by the name of the run; those that are there already are kept."""
    import json as codec
    import os
    from functools import partial

    from rich.console import Console
    from rich.progress import Progress

    from instrument.errors import InputError
    from twin.cluster import spread

    if not files:
        raise InputError("no runs (*.nc) in the folder; expected at least one")
    out.mkdir(parents=True, exist_ok=True)
    todo = [file for file in files if not (out / f"{file.stem}.json").exists()]
    # One thread a process: linear algebra on all cores in several processes makes each many times slower.
    os.environ |= dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"), "1")
    work = partial(diagnose_file, common=common, out=out, cache=cache)
    with Progress(console=Console(stderr=True), refresh_per_second=0.5) as progress:
        task = progress.add_task("diagnosing", total=len(todo))
        # The first alone: it renders what all others use.
        for batch in (todo[:1], todo[1:]):
            before = int(progress.tasks[0].completed)

            def tell(count: int, before: int = before) -> None:
                progress.update(task, completed=before + count)

            spread(work, batch, address=cluster, workers=workers, done=tell)
    return {file.stem: codec.loads((out / f"{file.stem}.json").read_text(encoding="utf-8")) for file in files}


def diagnose_file(run: Path, common: Path, out: Path, cache: Path | None) -> None:
    """Diagnose one run and write the result beside the others, with what its correction changes."""
    import numpy as np

    from instrument.output import write_json
    from twin.content import cache_folder
    from twin.diagnosis.diagnose import diagnose
    from twin.diagnosis.observation import read_observation
    from twin.diagnosis.outcome import to_dict
    from twin.diagnosis.preparation import Bench, Inputs

    inputs = Inputs(common / "facility.toml", common / "artifact.toml", common / "material.nc")
    prepared = Bench(inputs, cache or cache_folder()).prepare(read_observation(run))
    found = diagnose(prepared)
    correction = {"points": prepared.problem.run.rows.tolist(), "relative": np.expm1(found.correction).tolist()}
    write_json(out / f"{run.stem}.json", {**to_dict(found), "correction": correction})


def _open_labels(out: Path, labels: Path | None) -> dict[str, Truth]:
    """Labels by name: of a file, or of the sealed set after its digest was checked."""
    import hashlib
    import json as codec

    from instrument.errors import InputError
    from twin.diagnosis.trial import Truth

    sealed = labels is None
    file = out.with_name(out.name + "-labels") / "labels.json" if labels is None else labels
    if not file.is_file():
        raise InputError(f"{file}: not found; expected the labels of the runs")
    content = file.read_bytes()
    if sealed:
        promised = (out / "labels.sha256").read_text(encoding="ascii").split()[0]
        if hashlib.sha256(content).hexdigest() != promised:
            raise InputError(f"{file}: not what {out / 'labels.sha256'} promised; expected unchanged labels")
    found = codec.loads(content)
    return {name: Truth.of(label) for name, label in found.get("labels", found).items()}


def _report(found: dict[str, dict[str, Any]], truths: dict[str, Truth], runs: Path, json: Path | None) -> None:
    from dataclasses import asdict

    from rich.console import Console
    from rich.table import Table

    from instrument.output import write_json
    from twin.diagnosis.observation import read_observation
    from twin.diagnosis.trial import figures, reliability, score, summary

    scores = [
        score(name, truths[name], diagnosis, read_observation(runs / f"{name}.nc") if truths[name].brf else None)
        for name, diagnosis in found.items()
        if name in truths
    ]
    console = Console()
    if not console.is_terminal:
        # A file has no width of its own; rows of a table should stay in one line.
        console = Console(width=_FILE_WIDTH)
    console.print(_cases_table(scores))
    tables = {title: rows for title, rows in summary(scores).items() if any(row.trials for row in rows)}
    for title, rows in tables.items():
        table = Table("", "share [95 %]", title=title, title_justify="left")
        for row in rows:
            if row.trials:
                table.add_row(row.label, row.text())
        console.print(table)
    told = reliability(scores)
    console.print(_reliability_table(told))
    medians = figures(scores)
    for label, value in medians.items():
        console.print(f"{label}: {value:.3f}")
    if json is not None:
        shares = {title: [asdict(row) for row in rows] for title, rows in tables.items()}
        write_json(
            json,
            {"cases": [asdict(s) for s in scores], "tables": shares, "figures": medians}
            | {"reliability": [asdict(b) for b in told]},
        )
        typer.echo(f"written: {json}")


def _reliability_table(told: Sequence[Bin]) -> Any:
    from rich.table import Table

    table = Table("above", "to", "cases", "stated", "right", title="Probability of the answer", title_justify="left")
    for b in told:
        table.add_row(f"{b.low:g}", f"{b.high:g}", str(b.count), f"{b.stated:.3f}", f"{b.right:.3f}")
    return table


def _cases_table(scores: Sequence[Score]) -> Any:
    from rich.table import Column, Table

    names = {name: Column(name, overflow="fold") for name in ("true", "found")}
    columns = ("case", names["true"], "severity", names["found"], "probability", "region", "shrink", "allowed", "right")
    table = Table(*columns, title="Cases")
    for s in scores:
        true = ("outside: " if s.truth.outside else "") + (" + ".join(s.truth.effects) or "none")
        table.add_row(
            s.name,
            true,
            f"{s.truth.severity:.2f}",
            " + ".join(s.named) or s.verdict,
            f"{s.probability:.2f}" if s.named else "",
            "" if s.overlap is None else f"{s.overlap:.2f}",
            f"{s.shrink:.2f}",
            "" if s.allowed is None else f"{s.allowed:.2f}",
            "yes" if s.right else "NO",
        )
    return table


__all__ = ["blind_check", "diagnose_file"]

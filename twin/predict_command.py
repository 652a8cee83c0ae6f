"""``goniotwin predict``: what the instrument should read, before or without measuring."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer

from instrument.options import Force


def predict_command(
    plan_or_run: Annotated[
        Path, typer.Argument(metavar="PLAN|RUN", help="A plan (TOML) or a run file.", show_default=False)
    ],
    artifact: Annotated[Path, typer.Option(help="artifact.toml of the sample.", show_default=False)],
    material: Annotated[Path, typer.Option(help="Coupon run, or table of the BRDF.", show_default=False)],
    facility: Annotated[Path, typer.Option(help="facility.toml of the instrument.", show_default=False)],
    out: Annotated[Path, typer.Option(help="Where the prediction goes.")] = Path("prediction.nc"),
    standard_error: Annotated[float, typer.Option(help="Relative Monte Carlo error to reach.")] = 0.001,
    seed: Annotated[int, typer.Option(min=0, help="Of the random numbers.")] = 1,
    uncertainty: Annotated[
        bool, typer.Option("--uncertainty", help="Propagate the uncertainty of every input.")
    ] = False,
    draws: Annotated[
        int, typer.Option(min=0, help="With --uncertainty: Monte Carlo draws of all inputs, instead of sensitivities.")
    ] = 0,
    unstated: Annotated[
        str,
        typer.Option(
            help="With --uncertainty: correlation of coupon errors that state none: common, slice or independent."
        ),
    ] = "slice",
    workers: Annotated[int, typer.Option(min=1, help="With --uncertainty: processes on this machine.")] = 1,
    dask: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            help="With --uncertainty: evaluate on the Dask cluster whose scheduler is there (tcp://host:8786).",
            show_default=False,
        ),
    ] = None,
    corrections: Annotated[
        Path | None,
        typer.Option(help="Effects to include, from goniotwin diagnose --save-twin.", show_default=False),
    ] = None,
    force: Force = False,
) -> None:
    """Predict the reflectance factor of every point of a plan or of a run by ray tracing."""
    from instrument.errors import InputError
    from instrument.output import check_new

    if not 1e-6 <= standard_error < 1:
        raise InputError(f"--standard-error: found {standard_error:g}; expected 1e-6 to 1 (a relative error)")
    check_new(out, force)
    if uncertainty and corrections is not None:
        raise InputError("--corrections: the uncertainties of a corrected twin are not propagated; leave --uncertainty")
    if uncertainty:
        where = {"workers": workers, "address": dask}
        _propagate(plan_or_run, artifact, material, facility, out, standard_error, seed, draws, unstated, where)
        return
    given = {"--draws": draws != 0, "--unstated": unstated != "slice", "--workers": workers != 1, "--dask": bool(dask)}
    if any(given.values()):
        names = ", ".join(name for name, is_given in given.items() if is_given)
        raise InputError(f"{names}: only used with --uncertainty; expected that too")
    _predict(plan_or_run, artifact, material, facility, out, standard_error, seed, corrections)


def _predict(
    plan_or_run: Path,
    artifact: Path,
    material: Path,
    facility: Path,
    out: Path,
    standard_error: float,
    seed: int,
    corrections: Path | None = None,
) -> None:
    import time

    from instrument.artifact import read_artifact
    from instrument.dataset import write_prediction
    from instrument.facility import read_facility
    from twin.material import read_material

    known = read_facility(facility)
    geometries = _geometries(plan_or_run, known)
    sample, surface = read_artifact(artifact), read_material(material)
    typer.echo(surface.describe())

    from twin.corrections import corrected_twin
    from twin.prediction import Twin

    if corrections is None:
        twin = Twin(known, sample, surface, seed=seed)
    else:
        twin = corrected_twin(facility, artifact, material, corrections, seed=seed)
    started = time.perf_counter()
    prediction = twin.predict(geometries, standard_error=standard_error)
    elapsed = time.perf_counter() - started
    prediction.attrs["inputs"] = _inputs(facility, artifact, material)
    write_prediction(prediction, out)
    _say(prediction, elapsed, out)


def _propagate(
    plan_or_run: Path,
    artifact: Path,
    material: Path,
    facility: Path,
    out: Path,
    standard_error: float,
    seed: int,
    draws: int,
    unstated: Any,
    where: dict[str, Any],
) -> None:
    import time
    from contextlib import nullcontext

    from rich.console import Console

    from instrument.cluster import connected
    from instrument.dataset import write_prediction
    from instrument.errors import InputError
    from twin.budget_table import budget_table
    from twin.propagation_dataset import propagate
    from twin.state_vector import state_vector_from_files

    if draws == 1:
        raise InputError("--draws: found 1; expected at least 2, or 0 for sensitivities")
    state = state_vector_from_files(facility, artifact, material, unstated=unstated)
    geometries = _geometries(plan_or_run, state.facility)
    typer.echo(state.nominal_material.describe())
    typer.echo(f"{len(state)} uncertain inputs from {len(state.sources)} sources")
    for note in state.notes:
        typer.echo(f"note: {note}")
    started = time.perf_counter()
    # An address that is wrong should be known before the prediction is made.
    with nullcontext() if where["address"] is None else connected(where["address"]):
        pass
    with _bar() as progress:
        prediction = propagate(
            state,
            geometries,
            standard_error=standard_error,
            draws=draws,
            seed=seed,
            keep=True,
            progress=progress,
            **where,
        )
    prediction.attrs["inputs"] = _inputs(facility, artifact, material)
    write_prediction(prediction, out)
    Console().print(budget_table(prediction, state))
    _say(prediction, time.perf_counter() - started, out)


@contextmanager
def _bar() -> Iterator[Callable[[str, int, int], None]]:
    """A bar on standard error that shows what is being done; nothing where that is no terminal."""
    from rich.console import Console
    from rich.progress import Progress

    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bar:
        tasks: dict[str, Any] = {}

        def show(what: str, done: int, total: int) -> None:
            if what not in tasks:
                tasks[what] = bar.add_task(what, total=total)
            bar.update(tasks[what], completed=done, total=total)

        yield show


def _inputs(facility: Path, artifact: Path, material: Path) -> str:
    return f"facility {facility.name}, artifact {artifact.name}, material {material.name}"


def _say(prediction: Any, elapsed: float, out: Path) -> None:
    relative = prediction["u_brf_monte_carlo"] / prediction["brf"]
    typer.echo(
        f"{prediction.sizes['point']} points in {elapsed:.1f} s, relative Monte Carlo error"
        f" {100 * float(relative.median()):.3f} % (median), {100 * float(relative.max()):.3f} % (largest)"
    )
    typer.echo(f"u_brf holds {prediction.attrs['u_brf_contains']}")
    for name in ("corrections", "corrections_left_out"):
        if name in prediction.attrs:
            typer.echo(f"{name.replace('_', ' ')}: {prediction.attrs[name]}")
    typer.echo(f"written: {out}")


def _geometries(path: Path, facility: Any) -> Any:
    if path.suffix.lower() == ".toml":
        from instrument.plan import read_plan

        return read_plan(path, facility).points
    from instrument.dataset import read_run

    return read_run(path)

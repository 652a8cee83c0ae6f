"""``goniotwin compare``: a measured run beside its prediction."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from instrument.options import Force

if TYPE_CHECKING:
    import xarray as xr

    from twin.comparison import Comparison


def compare_command(
    run: Annotated[
        Path, typer.Argument(metavar="RUN", help="A run file (.nc, .csv) or run folder.", show_default=False)
    ],
    prediction: Annotated[
        Path | None, typer.Argument(metavar="PREDICTION", help="A prediction made before.", show_default=False)
    ] = None,
    artifact: Annotated[Path | None, typer.Option(help="artifact.toml of the sample.", show_default=False)] = None,
    material: Annotated[Path | None, typer.Option(help="Coupon run, or table of the BRDF.", show_default=False)] = None,
    facility: Annotated[Path | None, typer.Option(help="facility.toml of the instrument.", show_default=False)] = None,
    json: Annotated[
        Path | None, typer.Option(help="Write the comparison here, for programs.", show_default=False)
    ] = None,
    figures: Annotated[
        Path | None, typer.Option(help="Draw one figure per plane into this folder.", show_default=False)
    ] = None,
    standard_error: Annotated[float, typer.Option(help="Relative Monte Carlo error to reach.")] = 0.001,
    seed: Annotated[int, typer.Option(min=0, help="Of the random numbers.")] = 1,
    uncertainty: Annotated[
        bool,
        typer.Option(
            help="Propagate the uncertainty of every input into a prediction computed here; what is found is kept"
            " for the next time."
        ),
    ] = True,
    corrections: Annotated[
        Path | None,
        typer.Option(help="Effects to include, from goniotwin diagnose --save-twin.", show_default=False),
    ] = None,
    force: Force = False,
) -> None:
    """Compare a measured run with a prediction, point by point and by azimuth plane.

    The prediction is the file named PREDICTION, or it is computed from --artifact, --material and --facility; of a
    run folder, what lies in it is used where nothing is named.
    """
    _check_outputs(json, figures, standard_error, force)
    inputs = {"artifact": artifact, "material": material, "facility": facility}
    run_file, prediction, inputs = _resolve(run, prediction, inputs)
    _check_corrections(corrections, prediction)
    _compare(run_file, prediction, inputs, json, figures, standard_error, seed, uncertainty, corrections)


def _check_corrections(corrections: Path | None, prediction: Path | None) -> None:
    from instrument.errors import InputError

    if corrections is not None and prediction is not None:
        raise InputError(
            f"--corrections {corrections}: {prediction} is made already; expected --artifact, --material and --facility"
        )


def _check_outputs(json: Path | None, figures: Path | None, standard_error: float, force: bool) -> None:
    """Before any work: what would fail only at its end."""
    from instrument.errors import InputError
    from instrument.output import check_json, check_new_folder

    if not 1e-6 <= standard_error < 1:
        raise InputError(f"--standard-error: found {standard_error:g}; expected 1e-6 to 1 (a relative error)")
    check_json(json)
    if figures is not None:
        check_new_folder(figures, force)


def _resolve(
    run: Path, prediction: Path | None, inputs: dict[str, Path | None]
) -> tuple[Path, Path | None, dict[str, Path | None]]:
    """The run file, and where the prediction comes from: a file, or the three files of the twin.

    Raises
    ------
    InputError
        If it is not said where the prediction comes from, or said twice.
    """
    from instrument.errors import InputError

    given = [f"--{name}" for name, path in inputs.items() if path is not None]
    if prediction is not None and given:
        raise InputError(f"found both a prediction file and {', '.join(given)}; expected one or the other")
    folder = run if run.is_dir() else None
    if folder is not None:
        run = folder / "run.nc"
        if prediction is None and not given and (folder / "prediction.nc").exists():
            prediction = folder / "prediction.nc"
    if prediction is not None:
        return run, prediction, {}
    if folder is not None:
        inputs = {name: path or kept_input(folder, name) for name, path in inputs.items()}
    missing = [f"--{name}" for name, path in inputs.items() if path is None]
    if missing:
        raise InputError(f"{', '.join(missing)} missing; name a prediction file, or what the twin needs to make one")
    return run, None, inputs


def kept_input(folder: Path, name: str) -> Path | None:
    """The copy of an input that a scan left in its run folder."""
    from instrument.request import existing, material_of

    return material_of(folder) if name == "material" else existing(folder / f"{name}.toml")


def _compare(
    run_file: Path,
    prediction_file: Path | None,
    inputs: dict[str, Path | None],
    json: Path | None,
    figures: Path | None,
    standard_error: float,
    seed: int,
    uncertainty: bool,
    corrections: Path | None = None,
) -> None:
    from rich.console import Console

    from instrument.dataset import capabilities, read_run
    from instrument.output import write_json
    from twin.comparison import compare
    from twin.tables import comparison_tables

    run = read_run(run_file)
    if prediction_file:
        predicted = comparable_prediction(prediction_file)
    else:
        predicted = _predict(run, inputs, standard_error, seed, uncertainty, corrections)
    comparison = compare(run, predicted)
    console = Console()
    for table in comparison_tables(comparison):
        console.print(table)
    for lack in capabilities(run):
        console.print(f"{run_file.name}: {lack}", markup=False, highlight=False)
    if json is not None:
        write_json(json, comparison.to_dict())
        typer.echo(f"written: {json}")
    if figures is not None:
        typer.echo(f"written: {_draw(comparison, figures)} figures in {figures}")


def _draw(comparison: Comparison, folder: Path) -> int:
    from instrument.errors import InputError
    from twin.figures import draw_planes

    try:
        return len(draw_planes(comparison, folder))
    except OSError as error:
        raise InputError(f"{folder}: cannot be written: {error.strerror}") from None


def comparable_prediction(file: Path) -> xr.Dataset:
    """A prediction that says how exact it is; InputError where it does not."""
    from instrument.dataset import read_prediction
    from instrument.errors import InputError

    prediction = read_prediction(file)
    if "u_brf_monte_carlo" not in prediction:
        raise InputError(f"{file}: u_brf_monte_carlo: missing; expected the standard error of the ray tracer")
    return prediction


def _predict(
    run: xr.Dataset,
    inputs: dict[str, Path | None],
    standard_error: float,
    seed: int,
    uncertainty: bool,
    corrections: Path | None = None,
) -> xr.Dataset:
    from twin.corrections import corrected_twin
    from twin.input_uncertainty import find_input_uncertainty, with_inputs
    from twin.prediction import Twin
    from twin.state_vector import state_vector_from_files

    facility, artifact, material = (inputs[name] for name in ("facility", "artifact", "material"))
    assert facility is not None
    assert artifact is not None
    assert material is not None
    if corrections is None:
        twin = Twin.from_files(facility, artifact, material, seed=seed)
    else:
        twin = corrected_twin(facility, artifact, material, corrections, seed=seed)
    typer.echo(f"predicting {run.sizes['point']} points by ray tracing", err=True)
    prediction = twin.predict(run, standard_error=standard_error)
    for name in ("corrections", "corrections_left_out"):
        if name in prediction.attrs:
            typer.echo(f"{name.replace('_', ' ')}: {prediction.attrs[name]}", err=True)
    if not uncertainty:
        return prediction
    state = state_vector_from_files(facility, artifact, material)

    def announce() -> None:
        text = f"propagating {len(state)} uncertain inputs, once for these points (--no-uncertainty leaves it out)"
        typer.echo(text, err=True)

    return with_inputs(prediction, find_input_uncertainty(state, run, begin=announce))

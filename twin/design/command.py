"""``goniotwin design``: what a candidate artifact reflects where, and what a scan of it could tell."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from instrument.options import Force

if TYPE_CHECKING:
    from instrument.artifact import ArtifactDimensions
    from instrument.facility import Facility
    from twin.design.candidates import Candidate
    from twin.design.study import Judgement, Settings
    from twin.material import Material


def design(
    artifact: Annotated[
        list[Path], typer.Argument(help="artifact.toml of one or more candidates.", show_default=False)
    ],
    facility: Annotated[
        Path | None,
        typer.Option(
            help="facility.toml: limits of the arms, and the budget that tells effects apart.", show_default=False
        ),
    ] = None,
    material: Annotated[
        Path | None, typer.Option(help="Coupon run, or table of the BRDF; Lambertian without.", show_default=False)
    ] = None,
    reflectance: Annotated[float, typer.Option(help="Of the Lambertian surface, where no material is named.")] = 0.5,
    illumination: Annotated[str, typer.Option(help="Illumination zeniths, degree, separated by commas.")] = "0,15,30",
    wavelength: Annotated[float, typer.Option(help="For the plan and for the material, nm.")] = 500.0,
    sweep: Annotated[
        list[str] | None,
        typer.Option(
            help="hole_diameter, pitch, depth or plate_thickness =start:stop:count in mm or =value,value; or"
            " shape=square,hexagonal,flat. Repeat for combinations.",
            show_default=False,
        ),
    ] = None,
    planes: Annotated[int, typer.Option(min=1, help="Zenith sweeps of the plan, over all illuminations.")] = 12,
    out: Annotated[Path, typer.Option(help="Folder for pictures, plan and JSON; made where missing.")] = Path("design"),
    json_file: Annotated[
        Path | None,
        typer.Option("--json", help="The result for programs; OUT/design.json without.", show_default=False),
    ] = None,
    standard_error: Annotated[float, typer.Option(help="Relative Monte Carlo error of the patterns.")] = 0.01,
    seed: Annotated[int, typer.Option(min=0, help="Of the random numbers.")] = 1,
    workers: Annotated[int, typer.Option(min=1, help="Processes on this machine, for sweeps.")] = 1,
    dask: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            help="Judge on the Dask cluster whose scheduler is there (tcp://host:8786).",
            show_default=False,
        ),
    ] = None,
    force: Force = False,
) -> None:
    """Draw the hemispherical pattern of candidate artifacts under ideal light, judge them, and write a scan plan.

    Signal: how far the pattern departs from a matt sample's where the instrument can measure. Separation, where a
    facility with a budget is named: by how many standard deviations effects like a tilt or another hole diameter stand
    out from one another in a scan of the chosen planes.
    """
    from instrument.artifact import read_artifact
    from instrument.facility import UNKNOWN_FACILITY, read_facility
    from instrument.output import check_json, check_new_folder
    from twin.design.candidates import Candidate, combinations, parse_sweep

    settings = _settings(illumination, wavelength, planes, standard_error, seed)
    sweeps = [parse_sweep(text) for text in sweep or []]
    known = read_facility(facility) if facility is not None else UNKNOWN_FACILITY
    _check_illumination(settings, known)
    samples = [read_artifact(path) for path in artifact]
    given = [Candidate(_name(sample, samples), sample, {}) for sample in samples]
    swept = [candidate for sample in samples for candidate in combinations(sample, sweeps)]
    surface = _material(material, reflectance)
    check_new_folder(out, force)
    _make_folder(out)
    json_file = json_file or out / "design.json"
    check_json(json_file)
    found = _judge_all([*given, *swept], known, surface, settings, {"workers": workers, "address": dask})
    _write(found, len(given), known, settings, out, json_file, facility is not None)


def _settings(illumination: str, wavelength: float, planes: int, standard_error: float, seed: int) -> Settings:
    from instrument.errors import InputError
    from twin.design.study import Settings

    try:
        zeniths = tuple(float(part) for part in illumination.split(","))
    except ValueError:
        raise InputError(f"--illumination: found {illumination!r}; expected angles in degree, as in 0,15,30") from None
    if any(not 0 <= zenith < 90 for zenith in zeniths) or len(set(zeniths)) < len(zeniths):
        raise InputError(
            f"--illumination: found {illumination!r}; expected different angles from 0 to below 90 degrees"
        )
    if not 1e-4 <= standard_error < 1:
        raise InputError(f"--standard-error: found {standard_error:g}; expected 1e-4 to 1 (a relative error)")
    return Settings(
        illumination_zenith=zeniths, wavelength=wavelength, planes=planes, standard_error=standard_error, seed=seed
    )


def _check_illumination(settings: Settings, facility: Facility) -> None:
    from instrument.errors import InputError

    low, high = facility.arms.illumination_zenith
    for zenith in settings.illumination_zenith:
        if not low <= zenith <= high:
            raise InputError(
                f"--illumination: found {zenith:g} degrees, beyond the facility's arm; expected {low:g} to {high:g}"
            )


def _name(sample: ArtifactDimensions, samples: list[ArtifactDimensions]) -> str:
    """The file's name, with its folder where that alone is not enough."""
    same = [other for other in samples if other.source.stem == sample.source.stem]
    return sample.source.stem if len(same) == 1 else f"{sample.source.parent.name}/{sample.source.stem}"


def _material(path: Path | None, reflectance: float) -> Material:
    from instrument.errors import InputError
    from twin.material import lambertian, read_material

    if path is not None:
        return read_material(path)
    if not 0 < reflectance <= 1:
        raise InputError(f"--reflectance: found {reflectance:g}; expected more than 0 and at most 1")
    return lambertian(reflectance)


def _make_folder(out: Path) -> None:
    from instrument.errors import InputError

    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"--out: {out}: cannot be made a folder: {error.strerror}") from None


def _judge_all(
    candidates: list[Candidate], facility: Facility, material: Material, settings: Settings, where: dict[str, Any]
) -> list[Judgement]:
    """Judge candidates here, in other processes or on a cluster; says how far it is."""
    from functools import partial

    from twin.cluster import spread
    from twin.design.study import judge

    def tell(done: int) -> None:
        typer.echo(f"{done} of {len(candidates)} candidates judged", err=True)

    alone = partial(judge, facility=facility, material=material, settings=settings)
    return spread(alone, candidates, done=tell, **where)


def _write(
    found: list[Judgement],
    given: int,
    facility: Facility,
    settings: Settings,
    out: Path,
    json_file: Path,
    named: bool,
) -> None:
    """Pictures, plans and JSON, and a table for people."""
    from instrument.output import write_json
    from twin.design.pictures import draw_candidates, draw_pattern, draw_sweep
    from twin.design.report import print_study
    from twin.design.scan_plan import write_plan
    from twin.design.study import best

    chosen = best(found)
    written = []
    plan = None
    if chosen.planes:
        title = f"planes that tell most about {chosen.candidate.name}"
        plan = write_plan(out / "plan.toml", facility, chosen.planes, title=title, wavelength=settings.wavelength)
        written.append(out / "plan.toml")
    for number, judgement in enumerate(found[:given]):
        name = "pattern.png" if given == 1 else f"pattern_{number + 1}.png"
        written.append(draw_pattern(judgement, facility.arms, out / name, plan if judgement is chosen else None))
    if len(found) > given:
        if chosen not in found[:given]:
            written.append(draw_pattern(chosen, facility.arms, out / "pattern_best.png", plan))
        written.append(draw_sweep(found[given:], out / "sweep.png"))
        written.append(draw_candidates(found[given:], facility.arms, out / "sweep_patterns.png"))
    elif given > 1:
        written.append(draw_sweep(found, out / "sweep.png"))
    content = {
        "candidates": [judgement.as_json() for judgement in found],
        "best": chosen.candidate.name,
        "plan": {"file": "plan.toml", "points": len(plan.points)} if plan is not None else None,
        "seed": settings.seed,
    }
    write_json(json_file, content)
    print_study(found, chosen, plan, named)
    for path in [*written, json_file]:
        typer.echo(f"written: {path}")

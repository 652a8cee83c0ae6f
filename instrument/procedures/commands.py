"""The commands ``goniotwin calibrate ...`` and ``goniotwin align``."""

from __future__ import annotations

from collections.abc import Callable
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import Annotated, Any

import typer

from instrument.options import Force

Simulate = Annotated[bool, typer.Option("--simulate", help="Use the simulated laboratory.")]
Speed = Annotated[float, typer.Option(min=0.01, help="How many times faster the simulated laboratory's clock runs.")]
Seed = Annotated[int, typer.Option(min=0, help="Of the simulated laboratory's random draws.")]
Devices = Annotated[Path | None, typer.Option(help="Connections of a laboratory (devices.toml).")]
Facility = Annotated[Path | None, typer.Option(help="What is known of the instrument (facility.toml).")]
Results = Annotated[Path, typer.Option(help="Folder of the results.")]
Who = Annotated[str | None, typer.Option(help="Who does it; the account of this computer by default.")]
Json = Annotated[Path | None, typer.Option(help="Write the result to a file, for programs.")]
Wavelength = Annotated[float, typer.Option(min=200, max=3000, help="nm.")]
Samples = Annotated[int, typer.Option(min=2, max=10000, help="Readings of a burst.")]
Repeats = Annotated[int, typer.Option(min=1, max=100, help="How many times everything is read.")]

_FOLDER = Path("calibrations")


def _room(
    simulate: Simulate = False,
    speed: Speed = 1.0,
    seed: Seed = 1,
    devices: Devices = None,
    facility: Facility = None,
    results: Results = _FOLDER,
    who: Who = None,
    json: Json = None,
) -> None:
    """Options that say where and by whom, not what: every procedure has them, beside the settings of its result."""


def _procedure(name: str, target: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Make a command of a procedure from a function that has its own options only, and refuses bad ones.

    Parameters
    ----------
    name
        Of the result.
    target
        ``module:function`` below ``instrument.procedures``; imported once it is needed.
    """

    def made(declared: Callable[..., None]) -> Callable[..., None]:
        def command(**options: Any) -> None:
            room = {key: options.pop(key) for key in signature(_room).parameters}
            declared(**options)
            _run(name, target, room, options)

        own = list(signature(declared, eval_str=True).parameters.values())
        shared = list(signature(_room, eval_str=True).parameters.values())
        named = [each.replace(kind=Parameter.KEYWORD_ONLY) for each in (*shared, *own)]
        command.__signature__ = Signature(named)  # type: ignore[attr-defined]
        command.__annotations__ = {each.name: each.annotation for each in named}
        command.__name__, command.__doc__ = declared.__name__, declared.__doc__
        return command

    return made


@_procedure("gain-ratio", "gain_ratio:gain_ratios")
def gain(
    wavelength: Wavelength = 500.0,
    repeats: Repeats = 3,
    samples: Samples = 9,
) -> None:
    """Measure the ratios of the amplifier's gains with the same light at both."""


@_procedure("linearity", "linearity:linearity")
def linearity(
    wavelength: Wavelength = 500.0,
    way: Annotated[str, typer.Option(help="Add fluxes by 'channels' of the filter or by 'apertures'.")] = "channels",
    gain: Annotated[float | None, typer.Option(help="V/A; the highest by default.")] = None,
    levels: Annotated[int, typer.Option(min=1, max=12, help="Levels of light, each half of the last.")] = 4,
    repeats: Repeats = 3,
    samples: Samples = 9,
) -> None:
    """Measure the detector's linearity by adding two fluxes."""
    if way not in ("channels", "apertures"):
        from instrument.errors import InputError

        raise InputError(f"--way: found {way!r}; expected channels or apertures")


@_procedure("dark-level", "dark:dark_level")
def dark(
    samples: Samples = 100,
    leak: Annotated[bool, typer.Option(help="Look behind the closed shutter with the source on, too.")] = True,
) -> None:
    """Measure the dark level of every gain, and light that passes the closed shutter."""


@_procedure("warm-up", "warm_up:warm_up")
def warm_up(
    wavelength: Wavelength = 500.0,
    limit: Annotated[float, typer.Option(min=1e-6, help="Relative change an hour that counts as stable.")] = 0.005,
    interval: Annotated[float, typer.Option(min=0, help="Seconds from reading to reading.")] = 60.0,
    window: Annotated[int, typer.Option(min=4, help="Last readings whose slope is tested.")] = 10,
    longest: Annotated[float, typer.Option(min=1, help="Seconds after which it gives up.")] = 7200.0,
    samples: Samples = 9,
) -> None:
    """Switch the source on and wait until the slope of the readings is small for sure."""


@_procedure("wavelength", "wavelength:wavelength_check")
def wavelength(
    standard: Annotated[Path | None, typer.Option(help="Certificate of the wavelength standard.")] = None,
    step: Annotated[float, typer.Option(min=0.05, help="Of the scan, nm.")] = 1.5,
    allowed: Annotated[float, typer.Option(min=0, help="Standard uncertainty of the scale, nm.")] = 0.15,
    samples: Samples = 9,
    accept_expired: Annotated[
        bool, typer.Option("--accept-expired", help="Go on with a certificate that is not valid; recorded.")
    ] = False,
) -> None:
    """Check the wavelength scale with the absorption bands of a standard."""


@_procedure("intersection", "intersection:intersection")
def intersection(
    wavelength: Wavelength = 500.0,
    edge: Annotated[bool, typer.Option(help="Use the edge target, too.")] = True,
    samples: Samples = 9,
    repeats: Repeats = 2,
) -> None:
    """Check whether the arms' axes meet: zero of the sensor zenith, tilt of the stage, way of the sensor's axis."""


@_procedure("control-sample", "control_sample:control_sample")
def control_sample(
    sample: Annotated[str, typer.Argument(help="Name of the control sample.")],
    wavelength: Wavelength = 500.0,
    samples: Samples = 9,
) -> None:
    """Measure a control sample and hold it against its long-term chart."""


@_procedure("alignment", "alignment:alignment")
def align() -> None:
    """Align the instrument step by step; every step is confirmed by a person and recorded."""


def list_results(
    results: Results = _FOLDER,
    everything: Annotated[bool, typer.Option("--all", help="Every result, not the youngest ones only.")] = False,
    json: Json = None,
) -> None:
    """List results of procedures and their age."""
    from datetime import UTC, datetime

    from rich.console import Console

    from instrument.output import check_json, write_json
    from instrument.procedures.run import list_results as listed

    check_json(json)
    now = datetime.now(UTC)
    shown = listed(results, now, everything, Console(highlight=False))
    if json is not None:
        content = [result.model_dump(mode="json", exclude={"readings"}) for result in shown]
        ages = [max(result.age(now).total_seconds(), 0.0) for result in shown]
        write_json(json, [one | {"age_s": age} for one, age in zip(content, ages, strict=True)])


def chart(
    sample: Annotated[str, typer.Argument(help="Name of the control sample.")],
    facility: Facility = None,
    results: Results = _FOLDER,
    out: Annotated[Path, typer.Option(help="Picture (PNG, SVG, PDF).")] = Path("control-chart.png"),
    force: Force = False,
) -> None:
    """Draw the control chart of a control sample and say what it tells."""
    from instrument.procedures.chart import run_chart

    status = run_chart(sample, facility, results, out, force)
    if status:
        raise typer.Exit(status)


def _run(name: str, target: str, room: dict[str, Any], own: dict[str, Any]) -> None:
    """Import a procedure and run it with the options that are its own."""
    from functools import partial
    from importlib import import_module

    from instrument.procedures.room import RoomRequest
    from instrument.procedures.run import run_procedure

    module, _, function = target.partition(":")
    settings = {key: str(value) if isinstance(value, Path) else value for key, value in own.items()}
    if "sample" in own:
        own = {("subject" if key == "sample" else key): value for key, value in own.items()}
        own["results"] = room["results"]
    report = room.pop("json")
    work = partial(getattr(import_module(f"instrument.procedures.{module}"), function), **own)
    status = run_procedure(RoomRequest(**room), name, work, settings, report)
    if status:
        raise typer.Exit(status)

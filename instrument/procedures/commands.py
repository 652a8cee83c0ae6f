"""The commands ``goniotwin calibrate ...`` and ``goniotwin align``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

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
#: Options that say where and by whom, not what: they stand beside a result's settings.
_ROOM = ("simulate", "speed", "seed", "devices", "facility", "results", "who", "json")


def gain(
    simulate: Simulate = False,
    speed: Speed = 1.0,
    seed: Seed = 1,
    devices: Devices = None,
    facility: Facility = None,
    results: Results = _FOLDER,
    who: Who = None,
    json: Json = None,
    wavelength: Wavelength = 500.0,
    repeats: Repeats = 3,
    samples: Samples = 9,
) -> None:
    """Measure the ratios of the amplifier's gains with the same light at both."""
    _run("gain-ratio", "gain_ratio:gain_ratios", locals())


def linearity(
    simulate: Simulate = False,
    speed: Speed = 1.0,
    seed: Seed = 1,
    devices: Devices = None,
    facility: Facility = None,
    results: Results = _FOLDER,
    who: Who = None,
    json: Json = None,
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
    _run("linearity", "linearity:linearity", locals())


def dark(
    simulate: Simulate = False,
    speed: Speed = 1.0,
    seed: Seed = 1,
    devices: Devices = None,
    facility: Facility = None,
    results: Results = _FOLDER,
    who: Who = None,
    json: Json = None,
    samples: Samples = 100,
    leak: Annotated[bool, typer.Option(help="Look behind the closed shutter with the source on, too.")] = True,
) -> None:
    """Measure the dark level of every gain, and light that passes the closed shutter."""
    _run("dark-level", "dark:dark_level", locals())


def warm_up(
    simulate: Simulate = False,
    speed: Speed = 1.0,
    seed: Seed = 1,
    devices: Devices = None,
    facility: Facility = None,
    results: Results = _FOLDER,
    who: Who = None,
    json: Json = None,
    wavelength: Wavelength = 500.0,
    limit: Annotated[float, typer.Option(min=1e-6, help="Relative change an hour that counts as stable.")] = 0.005,
    interval: Annotated[float, typer.Option(min=0, help="Seconds from reading to reading.")] = 60.0,
    window: Annotated[int, typer.Option(min=4, help="Last readings whose slope is tested.")] = 10,
    longest: Annotated[float, typer.Option(min=1, help="Seconds after which it gives up.")] = 7200.0,
    samples: Samples = 9,
) -> None:
    """Switch the source on and wait until the slope of the readings is small for sure."""
    _run("warm-up", "warm_up:warm_up", locals())


def wavelength(
    simulate: Simulate = False,
    speed: Speed = 1.0,
    seed: Seed = 1,
    devices: Devices = None,
    facility: Facility = None,
    results: Results = _FOLDER,
    who: Who = None,
    json: Json = None,
    standard: Annotated[Path | None, typer.Option(help="Certificate of the wavelength standard.")] = None,
    step: Annotated[float, typer.Option(min=0.05, help="Of the scan, nm.")] = 1.5,
    allowed: Annotated[float, typer.Option(min=0, help="Standard uncertainty of the scale, nm.")] = 0.15,
    samples: Samples = 9,
    accept_expired: Annotated[
        bool, typer.Option("--accept-expired", help="Go on with a certificate that is not valid; recorded.")
    ] = False,
) -> None:
    """Check the wavelength scale with the absorption bands of a standard."""
    _run("wavelength", "wavelength:wavelength_check", locals())


def intersection(
    simulate: Simulate = False,
    speed: Speed = 1.0,
    seed: Seed = 1,
    devices: Devices = None,
    facility: Facility = None,
    results: Results = _FOLDER,
    who: Who = None,
    json: Json = None,
    wavelength: Wavelength = 500.0,
    edge: Annotated[bool, typer.Option(help="Use the edge target, too.")] = True,
    samples: Samples = 9,
    repeats: Repeats = 2,
) -> None:
    """Check whether the arms' axes meet: zero of the sensor zenith, tilt of the stage, way of the sensor's axis."""
    _run("intersection", "intersection:intersection", locals())


def control_sample(
    sample: Annotated[str, typer.Argument(help="Name of the control sample.")],
    simulate: Simulate = False,
    speed: Speed = 1.0,
    seed: Seed = 1,
    devices: Devices = None,
    facility: Facility = None,
    results: Results = _FOLDER,
    who: Who = None,
    json: Json = None,
    wavelength: Wavelength = 500.0,
    samples: Samples = 9,
) -> None:
    """Measure a control sample and hold it against its long-term chart."""
    _run("control-sample", "control_sample:control_sample", locals())


def align(
    simulate: Simulate = False,
    speed: Speed = 1.0,
    seed: Seed = 1,
    devices: Devices = None,
    facility: Facility = None,
    results: Results = _FOLDER,
    who: Who = None,
    json: Json = None,
) -> None:
    """Align the instrument step by step; every step is confirmed by a person and recorded."""
    _run("alignment", "alignment:alignment", locals())


def list_results(
    results: Results = _FOLDER,
    everything: Annotated[bool, typer.Option("--all", help="Every result, not the youngest ones only.")] = False,
    json: Json = None,
) -> None:
    """List results of procedures and their age."""
    from datetime import UTC, datetime

    from rich.console import Console

    from instrument.output import write_json
    from instrument.procedures.run import list_results as listed

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
) -> None:
    """Draw the control chart of a control sample and say what it tells."""
    from instrument.procedures.chart import run_chart

    status = run_chart(sample, facility, results, out)
    if status:
        raise typer.Exit(status)


def _run(name: str, target: str, options: dict[str, Any]) -> None:
    """Import a procedure and run it with the options that are its own."""
    from functools import partial
    from importlib import import_module

    from instrument.procedures.room import RoomRequest
    from instrument.procedures.run import run_procedure

    module, _, function = target.partition(":")
    own = {key: value for key, value in options.items() if key not in _ROOM}
    settings = {key: str(value) if isinstance(value, Path) else value for key, value in own.items()}
    if "sample" in own:
        own = {("subject" if key == "sample" else key): value for key, value in own.items()}
        own["results"] = options["results"]
    room = {key: value for key, value in options.items() if key in _ROOM and key != "json"}
    work = partial(getattr(import_module(f"instrument.procedures.{module}"), function), **own)
    status = run_procedure(RoomRequest(**room), name, work, settings, options["json"])
    if status:
        raise typer.Exit(status)

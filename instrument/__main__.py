"""The command ``goniotwin``: collects what the rooms register under the entry-point group ``goniotwin.commands``.

Nothing heavy is imported here or by any module that holds a command: help and usage errors answer at once.
"""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Callable, Sequence
from importlib.metadata import EntryPoint, entry_points, version
from typing import Annotated, Any

import typer

from drivers.errors import ConfigurationError, DeviceError
from instrument.errors import EXIT_BAD_INPUT, EXIT_DEVICE, InputError, SafetyError

log = logging.getLogger(__name__)
GROUP = "goniotwin.commands"
#: Shows where in the program an unexpected error arose.
TRACEBACK_VARIABLE = "GONIOTWIN_TRACEBACK"
#: Exit status of an error that the program did not expect (EX_SOFTWARE of sysexits.h).
EXIT_INTERNAL = 70
_HELP = "Run a three-arm goniospectrophotometer and compare it with its ray-traced twin."
_PLAIN: dict[str, Any] = {"rich_markup_mode": None, "add_completion": False, "pretty_exceptions_enable": False}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns or raises ``SystemExit`` with the exit status."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    try:
        build(words)(args=words, prog_name="goniotwin")
    except (InputError, ConfigurationError) as error:
        return _complain(error, EXIT_BAD_INPUT)
    except (DeviceError, SafetyError) as error:
        return _complain(error, EXIT_DEVICE)
    except Exception as error:
        if os.environ.get(TRACEBACK_VARIABLE):
            raise
        hint = f"an error of the program; set {TRACEBACK_VARIABLE}=1 to see where"
        return _complain(f"{type(error).__name__}: {error} ({hint})", EXIT_INTERNAL)
    return 0


def build(words: Sequence[str], points: Sequence[EntryPoint] | None = None) -> typer.Typer:
    """The command tree: the whole of it, or only the branch that ``words`` names."""
    found = sorted(entry_points(group=GROUP) if points is None else points, key=lambda point: point.name)
    wanted = next((word for word in words if not word.startswith("-")), None)
    branch = [point for point in found if point.name.split(".")[0] == wanted]
    root = typer.Typer(name="goniotwin", help=_HELP, no_args_is_help=True, **_PLAIN)
    root.callback()(_root)
    groups: dict[str, typer.Typer] = {"": root}
    for point in branch or found:
        path, _, name = point.name.rpartition(".")
        _group(groups, path).command(name)(_load(point))
    return root


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"goniotwin {version('goniotwin')}")
        raise typer.Exit


def _root(
    show_version: Annotated[
        bool, typer.Option("--version", is_eager=True, callback=_show_version, help="Say which version this is.")
    ] = False,
) -> None:
    """Options before the command."""


def _group(groups: dict[str, typer.Typer], path: str) -> typer.Typer:
    if path not in groups:
        parent, _, name = path.rpartition(".")
        groups[path] = typer.Typer(no_args_is_help=True, **_PLAIN)
        groups[path].callback(help=_GROUP_HELP.get(path, f"Commands of {name}."))(lambda: None)
        _group(groups, parent).add_typer(groups[path], name=name)
    return groups[path]


#: What the groups of this product are for; one that is not named here gets a plain line.
_GROUP_HELP = {
    "runs": "Measured runs: list, show, compare, verify.",
    "exchange": "Measurements in the forms of others, and theirs in ours.",
    "devices": "Connections to the instrument, real or simulated.",
    "calibrate": "Calibration procedures, their results and charts.",
}


def _load(point: EntryPoint) -> Callable[..., Any]:
    """The function of a command; one that cannot be loaded says so, and leaves the others alone."""
    try:
        function: Callable[..., Any] = point.load()
    except Exception as error:
        log.debug("command %s cannot be loaded", point.name, exc_info=True)
        reason = f"{point.name}: cannot be loaded from {point.value}: {type(error).__name__}: {error}"

        def broken() -> None:
            raise InputError(reason)

        broken.__doc__ = f"(cannot be loaded: {error})"
        return broken
    return function


def _complain(error: object, status: int) -> int:
    typer.echo(f"goniotwin: {error}", err=True)
    return status


if __name__ == "__main__":
    sys.exit(main())

"""Errors of the instrument room that a person reads."""

from __future__ import annotations

#: Exit statuses of the command line.
EXIT_DONE, EXIT_INCOMPLETE, EXIT_BAD_INPUT, EXIT_DEVICE, EXIT_INTERRUPTED = 0, 1, 2, 3, 130


class InputError(ValueError):
    """A file or an option is wrong. The message names the file, the key or axis, what was found and what
    was expected. The command line turns it into one line and exit status 2."""


class SafetyError(RuntimeError):
    """Going on would drive an arm where it must not go, or light where it must not be."""

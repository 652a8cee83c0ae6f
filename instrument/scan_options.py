"""Which options of a scan go together. Imports nothing heavy, so that a usage error is answered at once."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from instrument.errors import InputError

#: What stands in the record of a run.
_RECORD = ("operator", "sample", "reference_standard", "project", "remarks")
#: What a resumed run brings along.
_OF_THE_RUN = ("plan", "facility", "artifact", "material", "corrections", "out")


def check_options(given: Mapping[str, Any]) -> None:
    """Refuse options that exclude each other, and the lack of one that is needed.

    Parameters
    ----------
    given
        Fields of :class:`instrument.request.ScanRequest` that were set; None and False count as not given.

    Raises
    ------
    InputError
        Naming the options.
    """
    named = {name for name, value in given.items() if value is not None and value is not False}
    if {"simulate", "devices"} <= named:
        raise InputError("--simulate and --devices exclude each other")
    if "devices" in named:
        for option in ("speed", "seed"):
            if option in named:
                raise InputError(f"--{option}: belongs to the simulated laboratory; leave it out with --devices")
    if "resume" in named:
        for option in _OF_THE_RUN:
            if option in named:
                raise InputError(f"--resume goes on with the {option} of the run; leave it out")
        for option in _RECORD:
            if option in named:
                raise InputError(
                    f"--{option.replace('_', '-')}: stands in the record of the run; goniotwin runs amend amends it"
                )
        return
    if not {"simulate", "devices"} & named:
        raise InputError(
            "nothing to scan with; expected --simulate, or --devices with the devices.toml of a laboratory"
        )
    if "simulate" not in named:
        for option, name in (("plan", "PLAN"), ("facility", "--facility")):
            if option not in named:
                raise InputError(f"{name}: missing; only the simulated laboratory brings one of its own")

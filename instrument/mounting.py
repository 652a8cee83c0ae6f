"""Hands at the stage, while the engine goes on listening."""

from __future__ import annotations

from instrument.control import Controls
from instrument.hands import HandsFailed, while_listening
from instrument.operators import Mounted, Operator


class OperatorFailed(RuntimeError):
    """The sample could not be changed."""


def change_sample(operator: Operator, what: Mounted, controls: Controls) -> None:
    """Ask the operator, on a thread of its own: a scan can be aborted however long that takes.

    Raises
    ------
    OperatorFailed
        If the operator failed.
    Interruption
        If the scan is interrupted meanwhile, or the operator gave up.
    """
    try:
        while_listening(
            lambda: operator.mount(what),
            controls,
            name=f"mount {what}",
            given_up=f"the {what} was not put on the stage",
        )
    except HandsFailed as failure:
        raise OperatorFailed(f"the {what} could not be put on the stage: {failure}") from failure.__cause__

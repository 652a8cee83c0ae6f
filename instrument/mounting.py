"""Hands at the stage, while the engine goes on listening."""

from __future__ import annotations

import logging
import threading

from instrument.control import AbortAsked, Controls
from instrument.operators import Mounted, Operator

log = logging.getLogger(__name__)


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
    failures: list[BaseException] = []

    def hands() -> None:
        try:
            operator.mount(what)
        except KeyboardInterrupt as error:
            failures.append(error)
        except Exception as error:
            log.debug("operator failed", exc_info=True)
            failures.append(error)

    thread = threading.Thread(target=hands, name=f"mount {what}", daemon=True)
    thread.start()
    while thread.is_alive():
        thread.join(0.02)
        controls.checkpoint()
    if failures and isinstance(failures[0], KeyboardInterrupt):
        raise AbortAsked(f"the {what} was not put on the stage")
    if failures:
        raise OperatorFailed(f"the {what} could not be put on the stage: {failures[0]}") from failures[0]

"""Waiting for a person, while the engine goes on listening."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from typing import TypeVar

from instrument.control import AbortAsked, Controls

log = logging.getLogger(__name__)
Answer = TypeVar("Answer")


class HandsFailed(RuntimeError):
    """What a person was asked for failed; the cause is chained."""


def while_listening(action: Callable[[], Answer], controls: Controls, *, name: str, given_up: str) -> Answer:
    """Wait for an action on a thread of its own: an abort or a halt is obeyed however long it takes.

    Parameters
    ----------
    name
        Of the thread.
    given_up
        What is said where the person gives up (KeyboardInterrupt).

    Raises
    ------
    HandsFailed
        If the action failed.
    Interruption
        If the work is interrupted meanwhile, or the person gave up.
    """
    answers: list[Answer] = []
    failures: list[BaseException] = []

    def act() -> None:
        try:
            answers.append(action())
        except KeyboardInterrupt as error:
            failures.append(error)
        except Exception as error:
            log.debug("%s failed", name, exc_info=True)
            failures.append(error)

    thread = threading.Thread(target=act, name=name, daemon=True)
    thread.start()
    while thread.is_alive():
        thread.join(0.02)
        controls.checkpoint()
    if failures and isinstance(failures[0], KeyboardInterrupt):
        raise AbortAsked(given_up)
    if failures:
        raise HandsFailed(str(failures[0])) from failures[0]
    return answers[0]

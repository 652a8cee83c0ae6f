"""People in the loop: what only hands can do at the instrument."""

from __future__ import annotations

from typing import Literal, Protocol

Mounted = Literal["reference", "sample"]


class Operator(Protocol):
    """Answers the engine's requests. The terminal, the window and the simulated laboratory each bring one."""

    def mount(self, what: Mounted) -> None:
        """Put the reference or the sample on the stage; returns when it lies there.

        Raises
        ------
        KeyboardInterrupt
            When the person gives up: the scan ends in an orderly way.
        """
        ...

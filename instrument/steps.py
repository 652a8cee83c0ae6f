"""What people do during a scan: each step asked, obeyed when interrupted, and recorded with who and when."""

from __future__ import annotations

from drivers.clock import Clock
from instrument.control import Controls
from instrument.mounting import change_sample
from instrument.operators import Mounted, Operator
from instrument.prompts import START_SOURCE, Guide, Prompt, attend
from instrument.reporter import Reporter


class Steps:
    """People's part of one scan.

    Parameters
    ----------
    operator
        Who is asked. One that can only change the sample is not asked for more, and the journal says so.
    """

    def __init__(self, operator: Operator, controls: Controls, report: Reporter, clock: Clock) -> None:
        self._operator, self._controls, self._report, self._clock = operator, controls, report, clock
        self._started = False

    def mount(self, what: Mounted) -> None:
        """Have the reference or the sample put on the stage; errors as :func:`instrument.mounting.change_sample`."""
        change_sample(self._operator, what, self._controls)
        self._report.note(f"{what} on the stage")

    def confirm_source(self) -> None:
        """Have a person say that the class-4 source may emit; once a scan, and once whenever it is resumed."""
        if self._started:
            return
        self.confirm(START_SOURCE)
        self._started = True

    def confirm(self, prompt: Prompt, *, needed: bool = False) -> None:
        """Have a step done, and keep the answer in the journal.

        Parameters
        ----------
        needed
            Nothing can go on without it: an operator who only changes the sample is not enough.

        Raises
        ------
        PromptFailed, Interruption
            As :func:`instrument.prompts.attend`.
        """
        if not needed and not isinstance(self._operator, Guide):
            self._report.note(f"not confirmed: {prompt.title}; this operator only changes the sample")
            return
        answer = attend(self._operator, prompt, self._controls, now=self._clock.now())
        self._report.record("confirmation", **answer.model_dump(mode="json"))

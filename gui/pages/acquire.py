"""Acquisition: how far the scan is, where the arms are, and what the last reading said."""

from __future__ import annotations

from gui.pages.base import Desk, SplitPage, scrolled, stacked


class AcquirePage(SplitPage):
    """Progress, reading and geometry on the left, the instrument on the right."""

    name = "acquire"
    title = "Acquire"
    sign = "play"
    tip = "Start and steer the scan; the last reading and where the arms are"
    order = 40

    def __init__(self, desk: Desk) -> None:
        super().__init__(desk)
        left = scrolled(stacked(desk.in_area("acquire")))
        self.stand(left, *desk.in_area("acquire-right"), sizes=(430, 900))


PAGE = AcquirePage

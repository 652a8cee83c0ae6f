"""A report as a PDF of A4 sheets: text is set here, figures are drawn onto the sheets as vectors."""

from __future__ import annotations

import io
from collections.abc import Sequence
from functools import lru_cache

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties, findfont, get_font
from matplotlib.ft2font import LoadFlags
from matplotlib.gridspec import GridSpec
from matplotlib.lines import Line2D

from twin.report.document import WIDTH, Document, LeftOut, Plot, Points, Section, Table, Words, label

#: A4 and its margins, inch.
SHEET = (8.27, 11.69)
_LEFT, _TOP, _BOTTOM = (SHEET[0] - WIDTH) / 2, 0.75, 0.75
_POINT = 1 / 72
_LEADING = 1.32
_BODY, _SMALL, _HEADING, _TITLE = 9.0, 7.5, 13.0, 18.0
_FAINT, _INK, _LINE = "#444444", "#111111", "#999999"
#: Space between the columns of a table, and the least width of one, inch.
_GAP, _LEAST = 0.12, 0.32
#: Stands for a character that the font has no picture of.
_UNKNOWN = "\N{WHITE SQUARE}"


def pdf_of(document: Document) -> bytes:
    """The whole file, the same bytes for the same report."""
    stream = io.BytesIO()
    about = {"Title": document.title, "CreationDate": None, "ModDate": None}
    with PdfPages(stream, metadata=about) as pages:
        sheets = Sheets(pages, document.title)
        sheets.text(document.title, size=_TITLE, weight="bold", after=4)
        sheets.text(document.subtitle, colour=_FAINT, after=10)
        for number, section in enumerate(document.sections, start=1):
            _section(sheets, number, section)
        sheets.finish()
    return stream.getvalue()


def _section(sheets: Sheets, number: int, section: Section) -> None:
    sheets.catch_up()
    sheets.room(1.4)
    sheets.text(f"{number}. {section.title}", size=_HEADING, weight="bold", before=12, after=4)
    for block in section.blocks:
        match block:
            case Words(text, kind):
                strong = kind == "verdict"
                colour = _FAINT if kind == "faint" else _INK
                size = 10.5 if strong else _BODY
                sheets.text(text, size=size, weight="bold" if strong else "normal", colour=colour, after=5)
            case Points(lines):
                for line in lines:
                    sheets.text(line, indent=0.16, bullet=True, after=2)
                sheets.space(4)
            case Table():
                sheets.table(block)
            case Plot():
                sheets.place(block)
            case LeftOut(what, why):
                sheets.text(f"Left out: {what}. Reason: {why}.", colour=_FAINT, after=5)


class Sheets:
    """Fills sheet after sheet from top to bottom."""

    def __init__(self, pages: PdfPages, running: str) -> None:
        self._pages, self._running = pages, running
        self._number = 0
        self._waiting: list[Plot] = []
        self._open()

    def _open(self) -> None:
        self._sheet()
        while self._waiting and self._needed(self._waiting[0]) <= self._y - _BOTTOM:
            self._plot(self._waiting.pop(0))

    def _sheet(self) -> None:
        self._number += 1
        self._figure = Figure(figsize=SHEET)
        FigureCanvasAgg(self._figure)
        self._y = SHEET[1] - _TOP
        foot = _cut(self._running, _SMALL, "normal", WIDTH - 0.5)
        self._put(foot, _LEFT, 0.42, _SMALL, colour=_FAINT)
        self._put(str(self._number), _LEFT + WIDTH, 0.42, _SMALL, colour=_FAINT, align="right")

    def finish(self) -> None:
        """Write what waits, and the last sheet."""
        while self._waiting:
            self._pages.savefig(self._figure)
            self._open()
        self._pages.savefig(self._figure)

    def room(self, height: float) -> None:
        """Go to the next sheet unless so many inch are left."""
        while self._y - height < _BOTTOM:
            self._pages.savefig(self._figure)
            self._open()

    def space(self, points: float) -> None:
        """Leave some room."""
        self._y -= points * _POINT

    def text(
        self,
        text: str,
        *,
        size: float = _BODY,
        weight: str = "normal",
        colour: str = _INK,
        indent: float = 0.0,
        bullet: bool = False,
        before: float = 0.0,
        after: float = 0.0,
    ) -> None:
        """A paragraph over the width of the sheet."""
        self.space(before)
        step = size * _LEADING * _POINT
        for number, line in enumerate(wrapped(text, size, weight, WIDTH - indent)):
            self.room(step)
            self._y -= step
            if bullet and number == 0:
                self._put("\N{BULLET}", _LEFT + 0.03, self._y, size)
            self._put(line, _LEFT + indent, self._y, size, weight=weight, colour=colour)
        self.space(after)

    def place(self, plot: Plot) -> None:
        """A figure: here if there is room, else at the top of the next sheet, after those that wait already."""
        if self._waiting or self._needed(plot) > self._y - _BOTTOM:
            self._waiting.append(plot)
        else:
            self._plot(plot)

    def catch_up(self) -> None:
        """Before a new section: one figure of the last one may still wait for the next sheet, no more."""
        while len(self._waiting) > 1:
            self._pages.savefig(self._figure)
            self._open()

    def _needed(self, plot: Plot) -> float:
        """Height in inch of a figure with its caption; at most a sheet."""
        return min(plot.height + _below(plot), SHEET[1] - _TOP - _BOTTOM)

    def _plot(self, plot: Plot) -> None:
        caption = wrapped(label(plot.counterpart, plot.caption), _SMALL, "normal", WIDTH)
        step = _SMALL * _LEADING * _POINT
        height = self._needed(plot) - _below(plot)
        top = SHEET[1] - self._y
        grid = GridSpec(
            3,
            3,
            figure=self._figure,
            width_ratios=[_LEFT, WIDTH, SHEET[0] - WIDTH - _LEFT],
            height_ratios=[max(top, 1e-6), height, SHEET[1] - top - height],
        )
        plot.draw(self._figure.add_subfigure(grid[1, 1], facecolor="none"))
        self._y -= height + 0.03
        for line in caption:
            self._y -= step
            self._put(line, _LEFT, self._y, _SMALL, colour=_FAINT)
        self.space(8)

    def table(self, table: Table) -> None:
        """A table; its header stands again on every sheet that it goes on to."""
        widths = column_widths(table)
        caption = label(table.counterpart, table.caption)
        header = _cells(table.header, widths, "bold")
        step = _SMALL * _LEADING * _POINT
        self.room(
            len(wrapped(caption, _BODY, "normal", WIDTH)) * _BODY * _LEADING * _POINT + _height(header) + 4 * step
        )
        self.text(caption, before=4, after=4)
        self._row(header, widths, table.numbers, "bold")
        for cells in table.rows:
            lines = _cells(cells, widths, "normal")
            before = self._number
            self.room(_height(lines))
            if self._number != before:
                self._row(header, widths, table.numbers, "bold")
            self._row(lines, widths, table.numbers, "normal")
        self.space(8)

    def _row(self, cells: list[list[str]], widths: Sequence[float], numbers: Sequence[int], weight: str) -> None:
        step = _SMALL * _LEADING * _POINT
        x = _LEFT
        for column, (lines, width) in enumerate(zip(cells, widths, strict=True)):
            right = column in numbers
            for number, line in enumerate(lines, start=1):
                place = x + width if right else x
                align = "right" if right else "left"
                self._put(line, place, self._y - number * step, _SMALL, weight=weight, align=align)
            x += width + _GAP
        self._y -= _height(cells)
        across = [_LEFT / SHEET[0], min(x - _GAP, _LEFT + WIDTH) / SHEET[0]]
        along = [(self._y + 0.02) / SHEET[1]] * 2
        self._figure.add_artist(Line2D(across, along, lw=0.7 if weight == "bold" else 0.3, color=_LINE))

    def _put(
        self,
        text: str,
        x: float,
        y: float,
        size: float,
        *,
        weight: str = "normal",
        colour: str = _INK,
        align: str = "left",
    ) -> None:
        self._figure.text(
            x / SHEET[0],
            y / SHEET[1],
            text,
            fontsize=size,
            fontweight=weight,
            color=colour,
            ha=align,
            va="baseline",
            parse_math=False,
        )


def _below(plot: Plot) -> float:
    """Height in inch of a caption and the space around it."""
    lines = wrapped(label(plot.counterpart, plot.caption), _SMALL, "normal", WIDTH)
    return len(lines) * _SMALL * _LEADING * _POINT + 0.16


def column_widths(table: Table) -> list[float]:
    """Widths of the columns of a table in inch: as wide as their texts; where that is too much, the wide ones less."""
    columns = [[str(name), *(row[k] for row in table.rows)] for k, name in enumerate(table.header)]
    weights = [["bold", *["normal"] * len(table.rows)]] * len(columns)
    natural = [
        max(_LEAST, max(_width(drawable(t), _SMALL, w) for t, w in zip(texts, bold, strict=True)) + 0.02)
        for texts, bold in zip(columns, weights, strict=True)
    ]
    usable = WIDTH - _GAP * (len(columns) - 1)
    if sum(natural) <= usable:
        return natural
    # The widest columns share what the others leave.
    low, high = 0.0, usable
    for _ in range(30):
        cap = (low + high) / 2
        low, high = (cap, high) if sum(min(width, cap) for width in natural) <= usable else (low, cap)
    return [min(width, low) for width in natural]


def wrapped(text: str, size: float, weight: str, width: float) -> list[str]:
    """Lines of a text that are no wider than so many inch; a word that is wider is broken."""
    lines: list[str] = []
    for paragraph in drawable(text).split("\n"):
        line = ""
        for word in paragraph.split(" "):
            longer = f"{line} {word}" if line else word
            if _width(longer, size, weight) <= width:
                line = longer
                continue
            if line:
                lines.append(line)
            *whole, line = _broken(word, size, weight, width)
            lines += whole
        lines.append(line)
    return lines


def _broken(word: str, size: float, weight: str, width: float) -> list[str]:
    parts, part = [], ""
    for character in word:
        if part and _width(part + character, size, weight) > width:
            parts.append(part)
            part = ""
        part += character
    return [*parts, part]


def _cut(text: str, size: float, weight: str, width: float) -> str:
    first = wrapped(text, size, weight, width)
    return first[0] if len(first) == 1 else f"{first[0][:-1]}…"


def _cells(texts: Sequence[str], widths: Sequence[float], weight: str) -> list[list[str]]:
    return [wrapped(str(text), _SMALL, weight, width) for text, width in zip(texts, widths, strict=True)]


def _height(cells: list[list[str]]) -> float:
    return max(len(lines) for lines in cells) * _SMALL * _LEADING * _POINT + 0.05


def drawable(text: str) -> str:
    """A text with a white square for what the font of the PDF cannot draw."""
    known = _characters()
    return "".join(c if c == "\n" or ord(c) in known else " " if c.isspace() else _UNKNOWN for c in text)


@lru_cache(maxsize=1)
def _characters() -> frozenset[int]:
    return frozenset(get_font(findfont(FontProperties())).get_charmap())


@lru_cache(maxsize=4096)
def _advance(character: str, weight: str) -> float:
    """How far a character moves the pen, in sizes of the font."""
    font = get_font(findfont(FontProperties(weight=weight)))
    font.set_size(100.0, 72.0)
    return float(font.load_char(ord(character), flags=LoadFlags.NO_HINTING).linearHoriAdvance) / 65536 / 100


def _width(text: str, size: float, weight: str) -> float:
    """Width of a text in inch."""
    return sum(_advance(character, weight) for character in text) * size * _POINT

"""What a report consists of, whatever it is written as: sections of words, tables and figures with their data."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure, FigureBase

#: Width of every figure in inch: that of the text on a sheet of A4.
WIDTH = 7.1

#: Columns by name; all of the same length.
Columns = Mapping[str, Any]


@dataclass(frozen=True)
class Words:
    """A paragraph; ``kind`` is "", ``verdict`` (the gist, set apart) or ``faint``."""

    text: str
    kind: str = ""


@dataclass(frozen=True)
class Points:
    """A list, one line each."""

    lines: Sequence[str]


@dataclass(frozen=True)
class Table:
    """A table.

    Attributes
    ----------
    name
        Of its file, without suffix.
    counterpart
        Which table of the paper it corresponds to; empty where there is none.
    numbers
        Which columns hold numbers.
    """

    name: str
    caption: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    numbers: Sequence[int] = ()
    counterpart: str = ""


@dataclass(frozen=True)
class Plot:
    """A figure and the numbers it shows.

    Attributes
    ----------
    name
        Of its files, without suffix.
    caption
        What is seen.
    height
        Inch, at the width of :data:`WIDTH`.
    draw
        Draws it into an empty figure or part of one, from nothing but what is in ``data``.
    data
        Columns of the table behind it.
    counterpart
        Which figure of the paper it corresponds to; empty where there is none.
    """

    name: str
    caption: str
    height: float
    draw: Callable[[FigureBase], None]
    data: Columns
    counterpart: str = ""

    def figure(self) -> Figure:
        """The figure on a canvas of its own."""
        figure = Figure(figsize=(WIDTH, self.height))
        self.draw(figure)
        return figure


@dataclass(frozen=True)
class LeftOut:
    """A part that this report cannot have, and why."""

    what: str
    why: str


Block = Words | Points | Table | Plot | LeftOut


@dataclass(frozen=True)
class Section:
    """Blocks under a heading."""

    title: str
    blocks: Sequence[Block]


@dataclass(frozen=True)
class Document:
    """A whole report."""

    title: str
    subtitle: str
    sections: Sequence[Section]

    def plots(self) -> list[Plot]:
        """Every figure, in order."""
        return [block for section in self.sections for block in section.blocks if isinstance(block, Plot)]

    def tables(self) -> list[Table]:
        """Every table, in order."""
        return [block for section in self.sections for block in section.blocks if isinstance(block, Table)]

    def left_out(self) -> list[LeftOut]:
        """Every part that is missing, in order."""
        return [block for section in self.sections for block in section.blocks if isinstance(block, LeftOut)]


def title_size(title: str, usual: float) -> float:
    """Size in points of a panel's title: smaller where it says much, so that it stays over its panel."""
    return usual * min(1.0, 33 / max(len(title), 1))


def label(counterpart: str, caption: str) -> str:
    """A caption that says what it corresponds to."""
    return f"Counterpart of {counterpart}. {caption}" if counterpart else caption


def csv_of(columns: Columns) -> bytes:
    """Columns as CSV: a header, one line a row, numbers to the last digit, empty where there is none.

    Raises
    ------
    ValueError
        If the columns differ in length.
    """
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(zip(*(_texts(values) for values in columns.values()), strict=True))
    return stream.getvalue().encode()


def table_csv(table: Table) -> bytes:
    """A table as CSV, its cells as they stand in the report."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(table.header)
    writer.writerows(table.rows)
    return stream.getvalue().encode()


def _texts(values: Any) -> list[str]:
    array = np.asarray(values)
    if array.dtype.kind == "M":
        return ["" if np.isnat(time) else f"{np.datetime_as_string(time, unit='ms')}Z" for time in array]
    if array.dtype.kind == "f":
        return ["" if np.isnan(value) else repr(value) for value in array.tolist()]
    return [str(value) for value in array.tolist()]

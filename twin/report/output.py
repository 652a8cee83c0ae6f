"""Where a report goes: one HTML file, a PDF, and a folder of figures and tables with their data."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from matplotlib import rc_context

from instrument.errors import InputError
from instrument.output import check_new, check_new_folder, write_result
from twin.figures import rendered
from twin.report.document import Document, csv_of, label, table_csv
from twin.report.paper import pdf_of
from twin.report.web import html_of

#: Forms of every figure.
FORMS = ("png", "svg", "pdf")
CONTENTS = "contents.json"
_DPI = 220
#: Makes the names inside an SVG the same every time.
_SALT: Any = {"svg.hashsalt": "goniotwin"}


def check_targets(html: Path, pdf: Path | None, figures: Path | None, *, force: bool) -> None:
    """Find out before any work whether the report can be written, and would replace nothing.

    Raises
    ------
    InputError
        If a file exists and ``force`` is not set, or cannot be written.
    """
    for path, suffixes in ((html, (".html", ".htm")), (pdf, (".pdf",))):
        if path is None:
            continue
        if path.suffix.lower() not in suffixes:
            raise InputError(f"{path}: found the suffix {path.suffix!r}; expected {suffixes[0]}")
        check_new(path, force)
    if figures is not None:
        check_new_folder(figures, force)


def write_report(document: Document, html: Path, pdf: Path | None, figures: Path | None) -> list[Path]:
    """Write what is asked for; every file atomically.

    Returns
    -------
    list of Path
        What was written, the folder of figures as one.

    Raises
    ------
    InputError
        If a file cannot be written.
    """
    written = [html]
    write_result(html, html_of(document).encode())
    if pdf is not None:
        write_result(pdf, pdf_of(document))
        written.append(pdf)
    if figures is not None:
        write_figures(document, figures)
        written.append(figures)
    return written


def write_figures(document: Document, folder: Path) -> None:
    """Every figure as PNG, SVG and PDF beside its data (CSV), every table as CSV, and what is what (JSON)."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made: {error.strerror}") from None
    plots, tables = [], []
    for plot in document.plots():
        files = [f"{plot.name}.{form}" for form in FORMS]
        figure = plot.figure()
        for form, file in zip(FORMS, files, strict=True):
            with rc_context(_SALT):
                write_result(folder / file, rendered(figure, form, _DPI))
        write_result(folder / f"{plot.name}.csv", csv_of(plot.data))
        caption = label(plot.counterpart, plot.caption)
        plots.append({"name": plot.name, "counterpart": plot.counterpart, "caption": caption, "files": files})
        plots[-1]["data"] = f"{plot.name}.csv"
    for table in document.tables():
        write_result(folder / f"{table.name}.csv", table_csv(table))
        caption = label(table.counterpart, table.caption)
        tables.append({"name": table.name, "counterpart": table.counterpart, "caption": caption})
        tables[-1]["data"] = f"{table.name}.csv"
    left_out = [{"what": one.what, "why": one.why} for one in document.left_out()]
    content = {"title": document.title, "figures": plots, "tables": tables, "left_out": left_out}
    write_result(folder / CONTENTS, (json.dumps(content, indent=1, ensure_ascii=False) + "\n").encode())

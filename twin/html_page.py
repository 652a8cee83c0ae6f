"""Pages of reports: HTML without anything outside the file, readable on paper, on a light and on a dark screen."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence
from html import escape

from matplotlib.figure import Figure

from twin.figures import rendered

#: Sharp enough on paper for pictures that are no wider than a page.
_DPI = 110

_STYLE = """
:root { color-scheme: light dark; --ink: #1b1b1b; --paper: #ffffff; --faint: #5a5a5a; --line: #c9c9c9; --box: #f3f5f7; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e8e8e8; --paper: #16181a; --faint: #a9adb1; --line: #44494e; --box: #212529; }
}
body { font: 15px/1.5 system-ui, sans-serif; color: var(--ink); background: var(--paper); max-width: 62rem;
  margin: 2rem auto; padding: 0 1.2rem; }
h1 { font-size: 1.5rem; margin-bottom: 0.2rem; } h2 { font-size: 1.15rem; margin-top: 2.2rem; }
p.verdict { font-size: 1.2rem; border-left: 0.35rem solid var(--ink); padding: 0.5rem 0.9rem; background: var(--box); }
p.caption { margin: 1.4rem 0 0.1rem; }
p.faint, figcaption { color: var(--faint); font-size: 0.9rem; }
table { border-collapse: collapse; margin: 0.8rem 0; font-size: 0.92rem; }
th, td { text-align: left; padding: 0.25rem 0.8rem 0.25rem 0; border-bottom: 1px solid var(--line);
  vertical-align: top; overflow-wrap: anywhere; }
td.number, th.number { text-align: right; font-variant-numeric: tabular-nums; }
figure { margin: 1rem 0; } figure img { max-width: 100%; background: #ffffff; padding: 0.3rem; border-radius: 4px; }
@media print {
  :root { --ink: #000000; --paper: #ffffff; --faint: #333333; --line: #999999; --box: #ffffff; }
  body { max-width: none; margin: 0; font-size: 11pt; } h2 { break-after: avoid; }
  figure, table { break-inside: avoid; }
}
"""


def page(title: str, parts: Iterable[str]) -> str:
    """The whole document."""
    body = "\n".join(parts)
    return (
        f'<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n<title>{escape(title)}</title>\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<style>{_STYLE}</style>\n</head>\n<body>\n<h1>{escape(title)}</h1>\n{body}\n</body>\n</html>\n"
    )


def heading(text: str) -> str:
    """A section."""
    return f"<h2>{escape(text)}</h2>"


def paragraph(text: str, kind: str = "") -> str:
    """A paragraph; ``kind`` is a class of the style."""
    return f'<p class="{kind}">{escape(text)}</p>' if kind else f"<p>{escape(text)}</p>"


def bullets(lines: Sequence[str]) -> str:
    """A list; nothing where there are no lines."""
    if not lines:
        return ""
    return "<ul>" + "".join(f"<li>{escape(line)}</li>" for line in lines) + "</ul>"


def table(header: Sequence[str], rows: Sequence[Sequence[str]], numbers: Sequence[int] = ()) -> str:
    """A table; ``numbers`` are the columns that hold numbers."""
    kinds = ['class="number"' if k in numbers else "" for k in range(len(header))]
    head = "".join(f"<th {kind}>{escape(text)}</th>" for kind, text in zip(kinds, header, strict=True))
    lines = [
        "<tr>" + "".join(f"<td {kind}>{escape(text)}</td>" for kind, text in zip(kinds, row, strict=True)) + "</tr>"
        for row in rows
    ]
    return f"<table><thead><tr>{head}</tr></thead><tbody>{''.join(lines)}</tbody></table>"


def picture(figure: Figure, caption: str) -> str:
    """A figure inside the file, its caption as text for who cannot see it."""
    return image(rendered(figure, "png", _DPI), "png", caption, caption)


#: Media types of pictures.
_MEDIA = {"png": "image/png", "svg": "image/svg+xml"}


def image(content: bytes, form: str, caption: str, alternative: str) -> str:
    """A picture (``png`` or ``svg``) inside the file; ``alternative`` is for who cannot see it."""
    data = base64.b64encode(content).decode()
    return (
        f'<figure><img alt="{escape(alternative)}" src="data:{_MEDIA[form]};base64,{data}">'
        f"<figcaption>{escape(caption)}</figcaption></figure>"
    )

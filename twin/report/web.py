"""A report as one HTML file that needs nothing beside it."""

from __future__ import annotations

from html import escape

from twin import html_page
from twin.figures import rendered
from twin.report.document import Block, Document, LeftOut, Plot, Points, Table, Words, label

#: Pixels an inch: four times what a screen shows, so that print is sharp.
_DPI = 220


def html_of(document: Document) -> str:
    """The whole file; texts are escaped, pictures are inside."""
    contents = [
        f'<li><a href="#s{number}">{escape(section.title)}</a></li>'
        for number, section in enumerate(document.sections, start=1)
    ]
    parts = [html_page.paragraph(document.subtitle, "faint"), f"<ol>{''.join(contents)}</ol>"]
    for number, section in enumerate(document.sections, start=1):
        parts.append(f'<h2 id="s{number}">{number}. {escape(section.title)}</h2>')
        parts += [_block(block) for block in section.blocks]
    return html_page.page(document.title, parts)


def _block(block: Block) -> str:
    match block:
        case Words(text, kind):
            return html_page.paragraph(text, kind)
        case Points(lines):
            return html_page.bullets(lines)
        case Table():
            caption = html_page.paragraph(label(block.counterpart, block.caption), "caption")
            return caption + html_page.table(block.header, block.rows, block.numbers)
        case Plot():
            caption = label(block.counterpart, block.caption)
            content = rendered(block.figure(), "png", _DPI)
            return html_page.image(content, "png", caption, caption)
        case LeftOut(what, why):
            return html_page.paragraph(f"Left out: {what}. Reason: {why}.", "faint")

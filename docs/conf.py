"""How the pages of this folder become a site: ``make docs`` (Sphinx, MyST)."""

from __future__ import annotations

import re
from importlib.metadata import version as installed_version
from pathlib import Path
from typing import Any

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx

project = "goniotwin"
author = "the goniotwin developers"
version = release = installed_version("goniotwin")
extensions = ["myst_parser"]
root_doc = "index"
myst_enable_extensions = ["dollarmath"]
# So that pages can link to headings of others by the anchors that code hosts make of them.
myst_heading_anchors = 3
# Some pages begin below their second heading on purpose: tables that programs write.
suppress_warnings = ["myst.header"]
html_theme = "furo"
html_title = f"goniotwin {release}"
html_math_renderer = "mathml"
html_static_path = ["_static"]
html_css_files = ["pages.css"]
html_show_copyright = False
html_copy_source = False
html_show_sphinx = False
highlight_language = "text"


def _inline(translator: Any, node: nodes.math) -> None:
    translator.body.append(tex2mathml(node.astext(), as_block=False))
    raise nodes.SkipNode


def _displayed(translator: Any, node: nodes.math_block) -> None:
    translator.body.append(f'<div class="math">{tex2mathml(node.astext(), as_block=True)}</div>')
    raise nodes.SkipNode


def _list_the_rest(app: Sphinx, docname: str, source: list[str]) -> None:
    """Pages that the index does not list stand at the end of the navigation."""
    if docname != root_doc:
        return
    named = set(re.findall(r"^(?:.*<)?(\w+)>?$", "\n".join(re.findall(r"```{toctree}(.*?)```", source[0], re.S)), re.M))
    rest = sorted(page.stem for page in Path(app.srcdir).glob("*.md") if page.stem not in named | {root_doc})
    if rest:
        source[0] += "\n```{toctree}\n:hidden:\n:caption: Further pages\n\n" + "\n".join(rest) + "\n```\n"


def setup(app: Sphinx) -> None:
    """Equations as MathML, which browsers show without a script from elsewhere."""
    app.add_html_math_renderer("mathml", (_inline, None), (_displayed, None))
    app.connect("source-read", _list_the_rest)

"""The site is built as ``make docs`` builds it, and every page has its place in it."""

from __future__ import annotations

import re
import runpy
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from pages import DOCS, HOME


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The built site; a broken link or an unreadable page fails here."""
    words = re.search(r"^docs: setup\n\t\$\(BIN\)/python (.*)$", (HOME / "Makefile").read_text(), re.MULTILINE)
    assert words is not None
    out = tmp_path_factory.mktemp("site")
    command = [sys.executable, *words[1].split()]
    assert "-W" in command
    assert command[-1] == "build/docs"
    command[-1] = str(out)
    done = subprocess.run(command, check=False, cwd=HOME, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    return out


@pytest.mark.slow
@pytest.mark.timeout(900)  # the first of these builds it
def test_every_page_is_built_and_found_in_the_navigation(site: Path) -> None:
    index = (site / "index.html").read_text(encoding="utf-8")
    for page in DOCS.glob("*.md"):
        built = page.with_suffix(".html").name
        assert (site / built).is_file()
        assert f'href="{built}"' in index or page.stem == "index"


@pytest.mark.slow
def test_the_site_needs_nothing_from_elsewhere(site: Path) -> None:
    for page in site.glob("*.html"):
        text = page.read_text(encoding="utf-8")
        assert not re.search(r"<(?:script|link|img)[^>]+(?:src|href)=.https?:", text), page.name


@pytest.mark.slow
def test_equations_are_mathml(site: Path) -> None:
    method = (site / "method.html").read_text(encoding="utf-8")
    assert method.count("<math") > 10
    assert "$$" not in method


@pytest.mark.slow
def test_a_broken_link_fails(tmp_path: Path) -> None:
    (tmp_path / "conf.py").write_text((DOCS / "conf.py").read_text(encoding="utf-8"), encoding="utf-8")
    (tmp_path / "index.md").write_text("# One\n\n[there](nowhere.md)\n", encoding="utf-8")
    words = [
        sys.executable,
        "-m",
        "sphinx",
        "-W",
        "--keep-going",
        "-q",
        "-b",
        "html",
        str(tmp_path),
        str(tmp_path / "o"),
    ]
    done = subprocess.run(words, check=False, capture_output=True, text=True, timeout=120)
    assert done.returncode != 0
    assert "nowhere" in done.stderr


def test_a_page_that_the_index_does_not_list_stands_at_its_end(tmp_path: Path) -> None:
    listed = runpy.run_path(str(DOCS / "conf.py"))["_list_the_rest"]
    for name in ("index", "old", "named_by_title", "new"):
        (tmp_path / f"{name}.md").write_text("# Page\n", encoding="utf-8")
    app = SimpleNamespace(srcdir=str(tmp_path))
    source = ["# Index\n\n```{toctree}\n:caption: One\n\nold\nA title <named_by_title>\n```\n"]
    listed(app, "index", source)
    assert source[0].endswith(":caption: Further pages\n\nnew\n```\n")
    before = ["# Old\n"]
    listed(app, "old", before)
    assert before == ["# Old\n"]

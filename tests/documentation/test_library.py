"""The surface for programs of others: what is documented is there, and importing it costs nothing."""

from __future__ import annotations

import importlib
import re
import subprocess
import sys
from types import ModuleType

import pytest
from pages import DOCS

PACKAGES = ("instrument", "twin")


def documented(package: str) -> set[str]:
    """Names that the page lists for a package: the first cell of its rows."""
    text = (DOCS / "library.md").read_text(encoding="utf-8")
    section = text.split(f"\n## `{package}`\n", 1)[1].split("\n## ", 1)[0]
    cells = re.findall(r"^\| (`.*?`) \|", section, re.MULTILINE)
    return {name for cell in cells for name in re.findall(r"`(\w+)`", cell)}


@pytest.mark.parametrize("package", PACKAGES)
def test_every_name_is_loaded_and_documented(package: str) -> None:
    module: ModuleType = importlib.import_module(package)
    homes = {name: home for home, names in module._HOMES.items() for name in names}
    assert sorted(module.__all__) == sorted(homes)
    assert set(module.__all__) == documented(package)
    for name in module.__all__:
        value = getattr(module, name)
        home = importlib.import_module(f"{package}.{homes[name]}")
        assert value is getattr(home, name)
        assert name in dir(module)


@pytest.mark.parametrize("package", PACKAGES)
def test_a_name_that_is_not_there_is_an_attribute_error(package: str) -> None:
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        _ = importlib.import_module(package).nonsense


def test_importing_loads_nothing_and_the_instrument_never_the_twin_or_a_window() -> None:
    code = (
        "import sys, instrument, twin\n"
        "early = [name for name in ('numpy', 'xarray', 'pydantic') if name in sys.modules]\n"
        "for name in instrument.__all__:\n    getattr(instrument, name)\n"
        "late = [name for name in ('mitsuba', 'drjit', 'PySide6', 'gui', 'matplotlib') if name in sys.modules]\n"
        "late += [name for name in sys.modules if name.startswith('twin.')]\n"
        "print(early, late)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120)
    assert done.stdout.strip() == "[] []"

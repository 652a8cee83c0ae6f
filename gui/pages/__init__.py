"""The pages of the window, in the order in which a laboratory works. Each module that defines ``PAGE`` is found."""

from __future__ import annotations

import pkgutil
from importlib import import_module

from gui.pages.base import Page


def discover() -> list[type[Page]]:
    """Page classes of this package, in order."""
    modules = (import_module(f"{__name__}.{info.name}") for info in pkgutil.iter_modules(__path__))
    pages: list[type[Page]] = [module.PAGE for module in modules if hasattr(module, "PAGE")]
    return sorted(pages, key=lambda page: page.order)

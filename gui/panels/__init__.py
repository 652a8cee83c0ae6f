"""The panels of the window. Each module here that defines ``PANEL`` is found and shown; nothing lists them."""

from __future__ import annotations

import pkgutil
from importlib import import_module

from gui.panels.base import Panel


def discover() -> list[type[Panel]]:
    """Panel classes of this package, in the order in which they stand in the window."""
    modules = (import_module(f"{__name__}.{info.name}") for info in pkgutil.iter_modules(__path__))
    panels: list[type[Panel]] = [module.PANEL for module in modules if hasattr(module, "PANEL")]
    return sorted(panels, key=lambda panel: (panel.area, panel.order))

"""The library of effects: every effect of the modules of this package, and of installed packages.

An effect is added by a class in a module of this package. Another package names its own by an entry point of the group
``goniotwin.effects``: a class, or a module that holds some.
"""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from functools import cache
from importlib.metadata import entry_points
from types import ModuleType
from typing import Any

from instrument.errors import InputError
from twin.diagnosis.effects.base import (
    AzimuthEffect,
    Effect,
    JoinedEffect,
    Known,
    Parameter,
    ReadingEffect,
    SceneEffect,
    TopEffect,
    ZenithEffect,
)

__all__ = [
    "AzimuthEffect",
    "Effect",
    "JoinedEffect",
    "Known",
    "Parameter",
    "ReadingEffect",
    "SceneEffect",
    "TopEffect",
    "ZenithEffect",
    "effect",
    "library",
]

GROUP = "goniotwin.effects"


@cache
def library() -> dict[str, Effect]:
    """All effects by name.

    Raises
    ------
    InputError
        If an installed package offers something else than an effect, or a name that is taken.
    """
    found: dict[str, Effect] = {}
    for module in pkgutil.iter_modules(__path__):
        for kind in _effects_of(importlib.import_module(f"{__name__}.{module.name}")):
            _add(found, kind, module.name)
    for entry in sorted(entry_points(group=GROUP), key=lambda e: e.name):
        loaded: Any = entry.load()
        for kind in _effects_of(loaded) if isinstance(loaded, ModuleType) else [loaded]:
            _add(found, kind, entry.value)
    return dict(sorted(found.items()))


def effect(name: str) -> Effect:
    """One effect by its name."""
    effects = library()
    if name not in effects:
        raise InputError(f"effect: found {name!r}; expected one of {', '.join(effects)}")
    return effects[name]


def _effects_of(module: ModuleType) -> list[type[Effect]]:
    """Concrete effects that a module defines itself."""
    members = [member for _, member in inspect.getmembers(module, inspect.isclass)]
    return [
        member
        for member in members
        if issubclass(member, Effect) and member.__module__ == module.__name__ and hasattr(member, "name")
    ]


def _add(found: dict[str, Effect], kind: Any, source: str) -> None:
    if not (inspect.isclass(kind) and issubclass(kind, Effect) and not inspect.isabstract(kind)):
        raise InputError(f"{GROUP}: {source}: found {kind!r}; expected a class of effects")
    if kind.name in found:
        raise InputError(f"{GROUP}: {source}: the effect {kind.name!r} is there already")
    found[kind.name] = kind()

"""What an effect changes in the twin's scene, as data: comparable, printable, and applied in one place."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, fields, replace
from typing import Any

from instrument.artifact import ArtifactDimensions
from twin.artifact import Surface
from twin.material import Material
from twin.optics import Setup


class ArtifactChange(ABC):
    """A change of the sample's dimensions; a frozen dataclass whose fields say everything."""

    @abstractmethod
    def dimensions(self, artifact: ArtifactDimensions) -> ArtifactDimensions:
        """The changed dimensions."""


class MaterialChange(ABC):
    """A change of the material; a frozen dataclass whose fields say everything."""

    @abstractmethod
    def apply(self, material: Material) -> Material:
        """The changed material."""

    def grid_key(self) -> str:
        """The same for changes that may share a table's nodes: they are rendered together."""
        return repr(self)


@dataclass(frozen=True)
class Variation:
    """One scene that differs from the nominal one.

    Attributes
    ----------
    setup
        Of instrument and sample placement; numbers only.
    reference
        The instrument during the reference measurement; None for that of ``setup``.
    artifact, material
        Changes of dimensions and of reflection, applied in order.
    surface_factor
        Reflectance of surfaces over the nominal one.
    transport
        Mean step in mm that light makes sideways inside the coating, and the share of the light that makes it.
    """

    setup: Setup = field(default_factory=Setup)
    reference: Setup | None = None
    artifact: tuple[ArtifactChange, ...] = ()
    material: tuple[MaterialChange, ...] = ()
    surface_factor: tuple[tuple[Surface, float], ...] = ()
    transport: tuple[float, float] = field(default=(0.0, 0.0), repr=False)

    def reference_setup(self) -> Setup:
        """What is off while the reference is measured."""
        return self.setup.without_sample() if self.reference is None else self.reference

    def key(self) -> str:
        """Tells variations apart, the same in every session."""
        return repr(self) + (f" transport {self.transport!r}" if self.transport[1] else "")

    def scene_key(self) -> str:
        """Tells apart what needs a scene of its own."""
        return repr((self.artifact, self.surface_factor, [change.grid_key() for change in self.material]))


def together(first: Variation, second: Variation) -> Variation:
    """Both at once: setups add, changes follow each other."""
    added: dict[str, Any] = {}
    for name in (f.name for f in fields(Setup)):
        one, two = getattr(first.setup, name), getattr(second.setup, name)
        if name == "square_target":
            added[name] = one or two
        elif name == "source_distance_mm":
            added[name] = min(one, two)
        else:
            added[name] = one + two
    factor = dict(first.surface_factor)
    for surface, value in second.surface_factor:
        factor[surface] = factor.get(surface, 1.0) * value
    if first.transport[1] and second.transport[1]:
        raise ValueError("light goes sideways in one way only")
    if first.reference is not None or second.reference is not None:
        raise ValueError("variations with a reference setup of their own cannot be joined")
    return replace(
        first,
        setup=Setup(**added),
        artifact=first.artifact + second.artifact,
        material=first.material + second.material,
        surface_factor=tuple(sorted(factor.items())),
        transport=first.transport if first.transport[1] else second.transport,
    )

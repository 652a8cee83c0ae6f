"""What an effect is: parameters, what it changes in the scene, and what it makes of a reading.

An effect acts in one of five ways. A :class:`SceneEffect` changes instrument, sample or material, and is rendered; a
:class:`JoinedEffect` brings another one with it. A :class:`ZenithEffect` or :class:`AzimuthEffect` moves the sensor arm
by an angle that differs from point to point; one rendered table over that angle serves all of them. A
:class:`TopEffect` changes the reflectance of part of the plate's top. A :class:`ReadingEffect` changes what electronics
and acquisition make of the light.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import ClassVar

import numpy as np

from instrument.angles import FloatArray
from instrument.artifact import ArtifactDimensions
from instrument.facility import Facility
from twin.diagnosis.acquisition import Acquisition
from twin.diagnosis.variation import Variation
from twin.material import Material
from twin.optics import Setup


@dataclass(frozen=True)
class Parameter:
    """One parameter of an effect.

    Attributes
    ----------
    name, unit
        As in the data contract.
    typical
        Amplitude at which the gap is of about one combined standard uncertainty; an order of magnitude.
    cap
        Lowest and highest value that is physically possible.
    nominal
        Value without effect.
    budget
        Standard uncertainty (k = 1) that the inputs state; 0 where they state none.
    budget_of
        Where they state it, as a path from :class:`Known`.
    shape
        Says how an effect looks, not how large it is: of no consequence where the other parameters are nominal.
    """

    name: str
    unit: str
    typical: float
    cap: tuple[float, float]
    nominal: float = 0.0
    budget: float = 0.0
    budget_of: str = ""
    shape: bool = False


@dataclass(frozen=True)
class Known:
    """What the nominal twin is made from."""

    facility: Facility
    artifact: ArtifactDimensions
    material: Material


class Effect(ABC):
    """One way in which instrument, sample or electronics may differ from what is known.

    Attributes
    ----------
    name
        As in the data contract.
    title
        In words.
    parameters
        Of the effect; :meth:`resolve` fills in what depends on the inputs.
    needs
        Columns of :class:`~twin.diagnosis.acquisition.Acquisition` that the effect needs beyond the geometries.
    confused_with
        Effects with a similar signature.
    separated_by
        The scan that tells them apart.
    catalogued
        Whether the data contract names the effect; another cause is told as a suspicion, not named.
    shapes
        Values of every parameter of shape from which fits start.
    form_error
        Relative standard uncertainty of the parameters because another law of like form may hold.
    """

    name: ClassVar[str]
    title: ClassVar[str]
    parameters: ClassVar[tuple[Parameter, ...]]
    needs: ClassVar[tuple[str, ...]] = ()
    confused_with: ClassVar[tuple[str, ...]] = ()
    separated_by: ClassVar[str] = ""
    catalogued: ClassVar[bool] = True
    shapes: ClassVar[int] = 6
    form_error: ClassVar[float] = 0.0

    def resolve(self, known: Known, run: Acquisition | None = None) -> tuple[Parameter, ...]:
        """The parameters, with budgets from the inputs, and for some effects of number and caps that depend on them."""
        return tuple(
            replace(parameter, budget=float(attrgetter(parameter.budget_of)(known)))
            if parameter.budget_of
            else parameter
            for parameter in self.parameters
        )

    def not_applicable(self, known: Known) -> str:
        """Why the effect cannot occur with this sample or instrument; empty if it can."""
        return ""

    def missing(self, run: Acquisition) -> tuple[str, ...]:
        """Columns that the run lacks."""
        return tuple(name for name in self.needs if getattr(run, name) is None)


class SceneEffect(Effect):
    """An effect that is rendered.

    Attributes
    ----------
    nodes
        Number of nodes for each parameter's tabulation, from cap to cap: so many that what is read off between them
        differs from what is rendered there by a tenth of the change, or a tenth of the uncertainty.
    crowding
        1 for even nodes; with a larger power they crowd around the nominal value, where changes are sought.
    """

    nodes: ClassVar[tuple[int, ...]]
    crowding: ClassVar[float] = 1.0

    def axes(self, parameters: tuple[Parameter, ...]) -> tuple[FloatArray, ...]:
        """Nodes of each parameter, ascending; with a node at the nominal value."""
        return tuple(
            nodes_between(parameter.cap, parameter.nominal, count, self.crowding)
            for parameter, count in zip(parameters, self.nodes, strict=True)
        )

    @abstractmethod
    def variation(self, values: FloatArray) -> Variation:
        """What is rendered at parameter values, shape (parameter,)."""


class JoinedEffect(SceneEffect):
    """An effect that brings another with it: it is rendered without, and the other's logarithmic ratio is added.

    Attributes
    ----------
    part
        Name of the other effect, rendered as well.
    """

    part: ClassVar[str]

    @abstractmethod
    def of_part(self, values: FloatArray) -> FloatArray:
        """Values of the other effect, shape (n, its parameters), for values of shape (n, parameter)."""


class ZenithEffect(Effect):
    """An effect that moves the sensor arm, point by point."""

    @abstractmethod
    def zenith_error(self, run: Acquisition, values: FloatArray) -> FloatArray:
        """True minus commanded sensor zenith in degree, shape (n, point), for values of shape (n, parameter)."""

    def reference_setup(self, values: FloatArray, reference_zenith: float) -> Setup:
        """The instrument during the reference measurement, for values of shape (parameter,)."""
        return Setup()


class AzimuthEffect(Effect):
    """An effect that turns the sensor about the vertical, point by point."""

    @abstractmethod
    def azimuth_error(self, run: Acquisition, values: FloatArray) -> FloatArray:
        """True minus commanded sensor azimuth in degree, shape (n, point), for values of shape (n, parameter)."""


class TopEffect(Effect):
    """An effect on the reflectance of part of the plate's top; only the light that comes from there counts."""

    @abstractmethod
    def change(self, places: FloatArray, values: FloatArray) -> FloatArray:
        """Relative change of reflectance, shape (n, place).

        Parameters
        ----------
        places, shape (place, 2)
            On the plate's top in the frame of the sample, mm.
        values, shape (n, parameter)
        """


class ReadingEffect(Effect):
    """An effect on what is made of the light."""

    @abstractmethod
    def reading(self, run: Acquisition, brf: FloatArray, values: FloatArray) -> FloatArray:
        """Reflectance factors that are read where ``brf`` is right.

        Parameters
        ----------
        brf, shape (..., point)
        values, shape (..., parameter)
            Leading axes broadcast.

        Returns
        -------
        array, shape (..., point)
        """


def nodes_between(cap: tuple[float, float], nominal: float, count: int, crowding: float = 1.0) -> FloatArray:
    """Ascending nodes from cap to cap, one of them at the nominal value; on either side spaced as a power."""
    low, high = cap
    if count == 1:
        return np.array([nominal])
    if nominal <= low or nominal >= high:
        start, end = (low, high) if nominal <= low else (high, low)
        return np.sort(start + (end - start) * np.linspace(0.0, 1.0, count) ** crowding)
    below = min(count - 2, max(1, round((count - 1) * (nominal - low) / (high - low))))
    lower = nominal - (nominal - low) * np.linspace(1.0, 0.0, below + 1) ** crowding
    upper = nominal + (high - nominal) * np.linspace(0.0, 1.0, count - below) ** crowding
    return np.concatenate([lower, upper[1:]])

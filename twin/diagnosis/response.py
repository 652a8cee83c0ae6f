"""What one effect does to the readings of one run: rendered on nodes and interpolated, or computed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline, make_interp_spline

from instrument.angles import FloatArray
from twin.diagnosis.acquisition import Acquisition
from twin.diagnosis.effects import (
    AzimuthEffect,
    Effect,
    JoinedEffect,
    Parameter,
    ReadingEffect,
    TopEffect,
    ZenithEffect,
)
from twin.optics import Setup

#: Errors of the sensor zenith that are rendered, degree; closer near 0, where most effects are.
ZENITH_NODES = np.array([-5.0, -3.0, -1.8, -0.9, 0.0, 0.9, 1.8, 3.0, 5.0])
#: Errors of the sensor azimuth that are rendered, degree.
AZIMUTH_NODES = np.linspace(-30.0, 30.0, 9)
#: Least relative reading: the logarithm of nothing is no number.
_LEAST = 1e-5
_STEP = 1e-3
IntArray = NDArray[np.int64]


class Response(Protocol):
    """One effect in one run."""

    @property
    def effect(self) -> Effect:
        """The effect."""
        ...

    @property
    def name(self) -> str:
        """Of the effect."""
        ...

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Its parameters, with budgets and caps for these inputs."""
        ...

    @property
    def catalogued(self) -> bool:
        """Whether the data contract names the effect."""
        ...

    @property
    def shapes(self) -> int:
        """Values of every parameter of shape from which fits start."""
        ...

    @property
    def form_error(self) -> float:
        """Relative error of the response where its law is only one of several."""
        ...

    def log_ratio(self, values: FloatArray) -> FloatArray:
        """Logarithm of the reading with the effect over that without, shape (n, point); values (n, parameter)."""
        ...

    def apply(self, brf: FloatArray, values: FloatArray) -> FloatArray:
        """Reading with the effect, where without it ``brf`` (..., point) is read; values (..., parameter)."""
        ...


@dataclass(frozen=True)
class Common:
    effect: Effect
    parameters: tuple[Parameter, ...]

    @property
    def name(self) -> str:
        """Of the effect."""
        return self.effect.name

    @property
    def catalogued(self) -> bool:
        """Of the effect."""
        return self.effect.catalogued

    @property
    def shapes(self) -> int:
        """Of the effect."""
        return self.effect.shapes

    @property
    def form_error(self) -> float:
        """Of the effect."""
        return self.effect.form_error

    @property
    def nominal(self) -> FloatArray:
        """Values without effect, shape (parameter,)."""
        return np.array([parameter.nominal for parameter in self.parameters])

    def log_ratio(self, values: FloatArray) -> FloatArray:
        """Logarithm of the ratio, shape (n, point), at values of shape (n, parameter)."""
        raise NotImplementedError

    def relative(self, values: FloatArray) -> FloatArray:
        """Relative change of the reading, shape (n, point), at values of shape (n, parameter)."""
        return np.asarray(np.expm1(self.log_ratio(values)))

    def apply(self, brf: FloatArray, values: FloatArray) -> FloatArray:
        """Reading with the effect, shape (..., point)."""
        flat = np.reshape(values, (-1, len(self.parameters)))
        ratio = np.exp(self.log_ratio(flat))
        return np.asarray(brf * ratio.reshape(*np.shape(values)[:-1], ratio.shape[-1]))

    def derivative(self) -> FloatArray:
        """Derivative of :meth:`log_ratio` at the nominal values, shape (parameter, point), a unit of each parameter.

        One-sided where the nominal value is a cap. A parameter of shape has none where the effect vanishes.
        """
        rows = []
        for number, parameter in enumerate(self.parameters):
            step = _STEP * parameter.typical
            values = np.tile(self.nominal, (2, 1))
            values[0, number] = min(parameter.nominal + step, parameter.cap[1])
            values[1, number] = max(parameter.nominal - step, parameter.cap[0])
            high, low = self.log_ratio(values)
            rows.append((high - low) / (values[0, number] - values[1, number]))
        return np.array(rows)


@dataclass(frozen=True)
class TabulatedResponse(Common):
    """An effect that is rendered on nodes.

    Attributes
    ----------
    axes
        Nodes of each parameter.
    table, u_table, shape (node, ..., node, point)
        Logarithm of the ratio to the nominal twin, and the ray tracer's standard error.
    """

    axes: tuple[FloatArray, ...]
    table: FloatArray
    u_table: FloatArray

    def log_ratio(self, values: FloatArray) -> FloatArray:
        weights = [spline(column) for spline, column in zip(self._splines, self._inside(values).T, strict=True)]
        result = weights[0] @ self.table.reshape(len(self.axes[0]), -1)
        for weight in weights[1:]:
            result = result.reshape(len(values), weight.shape[1], -1)
            result = np.einsum("nk,nkm->nm", weight, result)
        return np.asarray(result.reshape(len(values), -1))

    def _inside(self, values: FloatArray) -> FloatArray:
        low, high = np.array([parameter.cap for parameter in self.parameters]).T
        return np.clip(values, low, high)

    def again(self, run: Acquisition, rows: IntArray) -> TabulatedResponse:
        """The response where some of the points are read again."""
        return replace(self, table=self.table[..., rows], u_table=self.u_table[..., rows])

    @cached_property
    def _splines(self) -> list[BSpline]:
        return [cardinal_spline(axis) for axis in self.axes]


@dataclass(frozen=True)
class JoinedResponse(TabulatedResponse):
    """An effect that brings another with it.

    Attributes
    ----------
    part
        Response to the other; the logarithms of both add up.
    """

    part: TabulatedResponse

    def log_ratio(self, values: FloatArray) -> FloatArray:
        assert isinstance(self.effect, JoinedEffect)
        inside = self._inside(values)
        return super().log_ratio(inside) + self.part.log_ratio(self.effect.of_part(inside))

    def again(self, run: Acquisition, rows: IntArray) -> JoinedResponse:
        """The response where some of the points are read again."""
        table, u_table = self.table[..., rows], self.u_table[..., rows]
        return replace(self, table=table, u_table=u_table, part=self.part.again(run, rows))


@dataclass(frozen=True)
class ZenithResponse(Common):
    """An effect that moves the sensor arm: every point is looked up at its own error.

    Attributes
    ----------
    table, shape (node, point)
        Over :data:`ZENITH_NODES`.
    reference
        Change of the reference reading by a setup.
    """

    run: Acquisition
    table: FloatArray
    u_table: FloatArray
    reference: Callable[[Setup], float]

    def log_ratio(self, values: FloatArray) -> FloatArray:
        assert isinstance(self.effect, ZenithEffect)
        error = np.clip(self.effect.zenith_error(self.run, values), ZENITH_NODES[0], ZENITH_NODES[-1])
        weights = cardinal_spline(ZENITH_NODES)(error)
        result = np.einsum("npk,kp->np", weights, self.table)
        return np.asarray(result - self._reference_log(values)[:, None])

    def again(self, run: Acquisition, rows: IntArray) -> ZenithResponse:
        """The response where some of the points are read again, in their order in ``run``."""
        return replace(self, run=run, table=self.table[:, rows], u_table=self.u_table[:, rows])

    def _reference_log(self, values: FloatArray) -> FloatArray:
        """Logarithm of the change of the reference reading, shape (n,)."""
        assert isinstance(self.effect, ZenithEffect)
        setups = [self.effect.reference_setup(row, self.run.reference_zenith) for row in values]
        errors = np.array([float(setup.sensor_zenith_deg) for setup in setups])
        return np.asarray(self._reference_spline(np.clip(errors, ZENITH_NODES[0], ZENITH_NODES[-1])))

    @cached_property
    def _reference_spline(self) -> BSpline:
        logs = [np.log(self.reference(Setup(sensor_zenith_deg=float(node)))) for node in ZENITH_NODES]
        return make_interp_spline(ZENITH_NODES, np.array(logs), k=3)


@dataclass(frozen=True)
class AzimuthResponse(Common):
    """An effect that turns the sensor: every point is looked up at its own error.

    The reference counts as read alike from every azimuth.

    Attributes
    ----------
    table, shape (node, point)
        Over :data:`AZIMUTH_NODES`.
    """

    run: Acquisition
    table: FloatArray
    u_table: FloatArray

    def log_ratio(self, values: FloatArray) -> FloatArray:
        assert isinstance(self.effect, AzimuthEffect)
        error = np.clip(self.effect.azimuth_error(self.run, values), AZIMUTH_NODES[0], AZIMUTH_NODES[-1])
        return np.asarray(np.einsum("npk,kp->np", cardinal_spline(AZIMUTH_NODES)(error), self.table))

    def again(self, run: Acquisition, rows: IntArray) -> AzimuthResponse:
        """The response where some of the points are read again, in their order in ``run``."""
        return replace(self, run=run, table=self.table[:, rows], u_table=self.u_table[:, rows])


@dataclass(frozen=True)
class ComputedResponse(Common):
    """An effect on the reading.

    Attributes
    ----------
    brf, shape (point,)
        What the nominal twin reads.
    """

    run: Acquisition
    brf: FloatArray

    def again(self, run: Acquisition, rows: IntArray) -> ComputedResponse:
        """The response where some of the points are read again, in their order in ``run``."""
        return replace(self, run=run, brf=self.brf[rows])

    def apply(self, brf: FloatArray, values: FloatArray) -> FloatArray:
        assert isinstance(self.effect, ReadingEffect)
        return self.effect.reading(self.run, brf, values)

    def log_ratio(self, values: FloatArray) -> FloatArray:
        ratio = self.apply(self.brf, values) / self.brf
        return np.asarray(np.log(np.maximum(ratio, _LEAST)))


@dataclass(frozen=True)
class TopResponse(Common):
    """An effect on part of the plate's top.

    Attributes
    ----------
    share, shape (point,)
        Of the reading that the plate's top sends, scattered light included.
    places, shape (place, 2)
        On the plate's top, mm.
    light, shape (point, place)
        Share of the top's light that comes from each place.
    """

    share: FloatArray
    places: FloatArray
    light: FloatArray

    def log_ratio(self, values: FloatArray) -> FloatArray:
        assert isinstance(self.effect, TopEffect)
        change = self.effect.change(self.places, values) @ self.light.T
        return np.asarray(np.log(np.maximum(1 + self.share * change, _LEAST)))

    def again(self, run: Acquisition, rows: IntArray) -> TopResponse:
        """The response where some of the points are read again."""
        return replace(self, share=self.share[rows], light=self.light[rows])


AnyResponse = TabulatedResponse | ZenithResponse | AzimuthResponse | ComputedResponse | TopResponse


def no_response(effect: Effect, parameters: tuple[Parameter, ...], points: int) -> TabulatedResponse:
    """Of readings that an effect leaves as they are."""
    axes = tuple(np.array(parameter.cap) for parameter in parameters)
    table = np.zeros((*(len(axis) for axis in axes), points))
    return TabulatedResponse(effect, parameters, axes, table, np.zeros_like(table))


def cardinal_spline(nodes: FloatArray) -> BSpline:
    """Splines through 1 at one node and 0 at the others, one a node; cubic where there are nodes enough.

    Calling it with x of shape (...) gives the weights of the nodes, shape (..., node).
    """
    if len(nodes) == 1:
        return BSpline(nodes[0] + np.array([-1.0, 1.0]), np.ones((1, 1)), 0)
    return make_interp_spline(nodes, np.eye(len(nodes)), k=min(3, len(nodes) - 1))

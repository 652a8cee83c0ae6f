"""Renderings of variations, kept on disk by content: a repeat or a subset of a plan costs nothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from instrument.angles import FloatArray, direction
from twin.diagnosis.store import PointStore
from twin.diagnosis.variation import Variation
from twin.diagnosis.workbench import Light, Progress, Workbench
from twin.optics import COORDINATES

_NOMINAL = Variation()


@dataclass(frozen=True)
class Rendered:
    """What variations give, as reflectance factors; reference readings are not considered.

    Attributes
    ----------
    once, scattered, shape (variation, point)
        Light reflected once, and the rest.
    nominal_once, nominal_scattered, shape (point,)
        The same of the nominal twin, with the same random numbers.
    u, shape (variation, point)
        The ray tracer's standard error of the relative difference from the nominal twin.
    """

    once: FloatArray
    scattered: FloatArray
    nominal_once: FloatArray
    nominal_scattered: FloatArray
    u: FloatArray

    def log_ratio(self, columns: dict[str, FloatArray]) -> FloatArray:
        """Logarithm of the readings over the nominal twin's, shape (variation, point).

        The scattered light, which comes from the cavity by way of many reflections, changes with the view as a low
        polynomial does: of its ratio to the nominal one, that much is kept, and the noise goes.
        """
        nominal = self.nominal_once + self.nominal_scattered
        ratio = smooth_ratio(self.scattered, self.nominal_scattered, columns)
        varied = self.once + ratio * self.nominal_scattered
        lit = (varied > 0) & (nominal > 0)
        return np.log(
            np.where(lit, varied, 1.0) / np.where(lit, nominal, 1.0), where=lit, out=np.full(lit.shape, _DARK)
        )


class RenderStore:
    """Renders what is not known yet.

    Parameters
    ----------
    workbench
        The nominal twin.
    folder
        Where renderings are kept, in a folder of their own; None keeps none.
    """

    def __init__(self, workbench: Workbench, folder: Path | None) -> None:
        self.workbench = workbench
        self._store = PointStore(None if folder is None else folder / "responses", _ARRAYS)
        self._digest = workbench.digest()

    def missing(self, groups: Sequence[Sequence[Variation]], columns: dict[str, FloatArray]) -> int:
        """How many variations would have to be rendered for at least one geometry."""
        return sum(len(group) for group in groups if self._store.lacking(self._content(group), columns))

    def get(
        self, groups: Sequence[Sequence[Variation]], columns: dict[str, FloatArray], progress: Progress | None = None
    ) -> list[Rendered]:
        """Renderings of groups of variations; a group is kept in one file.

        Parameters
        ----------
        progress
            Told the number of variations just rendered.
        """
        benches: dict[bytes, _Bench] = {}
        found = []
        for group in groups:

            def make(some: dict[str, FloatArray], group: Sequence[Variation] = group) -> dict[str, FloatArray]:
                key = b"".join(some[name].tobytes() for name in COORDINATES)
                bench = benches.setdefault(key, _Bench(self.workbench, some, progress))
                rendered = bench.render(group)
                return {name: getattr(rendered, name) for name in _ARRAYS}

            found.append(Rendered(**self._store.get(self._content(group), columns, make)))
        return found

    def _content(self, group: Sequence[Variation]) -> str:
        return "\n".join([self._digest, *(variation.key() for variation in group)])


class _Bench:
    """Renders groups at the same geometries; the nominal twin once for each way of rendering."""

    def __init__(self, workbench: Workbench, columns: dict[str, FloatArray], progress: Progress | None) -> None:
        self._workbench, self._columns, self._progress = workbench, columns, progress
        self._nominal: dict[bool, Light] = {}

    def render(self, group: Sequence[Variation]) -> Rendered:
        """Render a group: every variation once."""
        distinct = {variation.key(): variation for variation in group}
        distinct.pop(_NOMINAL.key(), None)
        quadrature = all(self._workbench.by_quadrature(v) for v in [_NOMINAL, *distinct.values()])
        nominal = self._of_nominal(quadrature)
        light = self._workbench.render(list(distinct.values()), self._columns, self._progress, traced=not quadrature)
        place = {_NOMINAL.key(): 0} | {key: number for number, key in enumerate(distinct, start=1)}
        chosen = [place[variation.key()] for variation in group]
        whole = Light(np.concatenate([nominal.once, light.once]), np.concatenate([nominal.scattered, light.scattered]))
        once, scattered = whole.once.mean(axis=-1), whole.scattered.mean(axis=-1)
        return Rendered(once[chosen], scattered[chosen], once[0], scattered[0], _error(whole)[chosen])

    def _of_nominal(self, quadrature: bool) -> Light:
        if quadrature not in self._nominal:
            self._nominal[quadrature] = self._workbench.render([_NOMINAL], self._columns, traced=not quadrature)
        return self._nominal[quadrature]


_ARRAYS = tuple(f.name for f in fields(Rendered))
#: Logarithm that stands for no light at all.
_DARK = -12.0
#: Points that a coefficient of the scattered light's ratio needs at least.
_POINTS_EACH = 6
#: Terms with less than this many times the variance of noise are taken for noise.
_NOISE_CUT = 3.0


def smooth_ratio(varied: FloatArray, nominal: FloatArray, columns: dict[str, FloatArray]) -> FloatArray:
    """Ratio of scattered light, smooth over the view, for each illumination and wavelength; shape (variation, point).

    Parameters
    ----------
    varied, shape (variation, point), nominal, shape (point,)
    """
    names = ("wavelength", "illumination_zenith", "illumination_azimuth")
    table = np.nan_to_num(np.stack([columns[name] for name in names], axis=1))
    _, group = np.unique(np.round(table, 6), axis=0, return_inverse=True)
    view = direction(columns["sensor_zenith"], columns["sensor_azimuth"])
    result = np.ones_like(varied)
    for number in range(group.max(initial=-1) + 1):
        rows = np.flatnonzero((group.reshape(-1) == number) & (nominal > 0))
        if len(rows):
            result[:, rows] = _denoised(_basis(view[rows], len(rows)), varied[:, rows] / nominal[rows])
    return np.maximum(result, 0.0)


def _denoised(basis: FloatArray, rows: FloatArray) -> FloatArray:
    """What a basis, a constant first, explains of rows of shape (n, point); terms that are noise are shrunk to nothing.

    The positive part of the Wiener filter, with the noise from the rest.
    """
    size, points = basis.shape[1], basis.shape[0]
    orthonormal = np.linalg.qr(basis)[0]
    coefficients = rows @ orthonormal
    rest = np.sum(rows**2, axis=1) - np.sum(coefficients**2, axis=1)
    noise = np.maximum(rest, 0.0) / max(points - size, 1)
    squared = np.maximum(coefficients**2, 1e-30)
    kept = np.clip(1 - _NOISE_CUT * noise[:, None] / squared, 0.0, 1.0)
    kept[:, 0] = 1.0
    return np.asarray((kept * coefficients) @ orthonormal.T)


def _basis(view: FloatArray, points: int) -> FloatArray:
    """Polynomials in the view's direction cosines, fewer for few points, shape (point, polynomial)."""
    x, y = view[:, 0], view[:, 1]
    s = x * x + y * y
    terms = [np.ones_like(x), s, x, y, x * x - y * y, x * y, s * s, x * s, y * s]
    return np.stack(terms[: max(1, points // _POINTS_EACH)], axis=1)


def _error(light: Light) -> FloatArray:
    """Standard error of the relative difference from the first variation, shape (variation, point)."""
    total = light.once + light.scattered
    mean = np.maximum(total.mean(axis=-1, keepdims=True), 1e-12)
    spread = total / mean - total[:1] / mean[:1]
    return np.asarray(spread.std(axis=-1, ddof=1) / np.sqrt(total.shape[-1]))

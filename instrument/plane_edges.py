"""Where edges of light, field stop and horizon cut the target of a sensor, for the quadrature of a plane's flux.

Maps are homographies from the unit disc of the target, (X, Y, 1), shape (point, 3, 3); edges are conics there.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from instrument.angles import FloatArray
from instrument.optics import Layout

#: Cosine and sine of the angles around the target, shape (point, psi) each.
Around = tuple[FloatArray, FloatArray]


def along_radius(matrix: FloatArray, row: int, around: Around) -> FloatArray:
    """Change of a row of a map along a radius of the target, shape (point, psi)."""
    return matrix[:, row, :1] * around[0] + matrix[:, row, 1:2] * around[1]


def inside_light(edged: FloatArray, around: Around, lit: NDArray[np.bool_]) -> tuple[FloatArray, FloatArray]:
    """From which to which s a radius of the target lies inside the beam, shape (point, psi) each."""
    shape = around[0].shape
    bounded = lit[:, None]
    if not np.any(bounded):
        return np.zeros(shape), np.ones(shape)
    u, v, w = (along_radius(edged, row, around) for row in range(3))
    u_0, v_0, w_0 = (edged[:, row, 2:] for row in range(3))
    a, b = u * u + v * v - w * w, u * u_0 + v * v_0 - w * w_0
    c = np.broadcast_to(u_0**2 + v_0**2 - w_0**2, shape)
    root = np.sqrt(np.maximum(b * b - a * c, 0.0))
    half = -(b + np.where(b < 0, -root, root))
    with np.errstate(divide="ignore", invalid="ignore"):
        crosses = b * b >= a * c
        roots = [
            np.where((s > 0) & (w_0 + s * w > 0) & crosses, s, np.inf)  # on this side of the source
            for s in (half / a, c / half)
        ]
    first, second = np.minimum(*roots), np.maximum(*roots)
    within = c <= 0
    low = np.where(within, 0.0, np.minimum(first, 1.0))
    high = np.where(within, np.minimum(first, 1.0), np.minimum(second, 1.0))
    return np.where(bounded, low, 0.0), np.where(bounded, high, 1.0)


class Stop(NamedTuple):
    """The field stop seen from one point of the mirror: ``scale * (X, Y) + shift``, in mm, is where rays cross it.

    Attributes
    ----------
    scale, shape (point,); shift, shape (point, 2)
    inner, outer, shape (point,)
        Radii where the transmission begins and ends to fall.
    """

    scale: FloatArray
    shift: FloatArray
    inner: FloatArray
    outer: FloatArray

    @classmethod
    def of(cls, layout: Layout, mirror: FloatArray) -> Stop | None:
        """None where there is no stop."""
        radius, edge, share = layout.stop.T
        if not np.any(np.isfinite(radius)):
            return None
        sides = np.stack([layout.along, layout.across], axis=1)
        length = np.linalg.norm(sides, axis=2)
        shift = np.einsum("nki,ni->nk", sides, mirror) / length * share[:, None]
        return cls((1 - share) * length[:, 0], shift, np.maximum(radius - edge / 2, 0.0), radius + edge / 2)

    def divide(self, around: Around, low: FloatArray, high: FloatArray) -> list[FloatArray]:
        """Where a radius of the target between two ends crosses the rims, with the ends; shape (point, psi) each."""
        slope, start = self.scale[:, None], around[0] * self.shift[:, :1] + around[1] * self.shift[:, 1:]
        across = np.sum(self.shift**2, axis=1)[:, None] - start**2
        ends = [low, high]
        for rim in (self.inner, self.outer):
            half = np.sqrt(np.maximum(rim[:, None] ** 2 - across, 0.0))
            ends += [np.clip((sign * half - start) / slope, low, high) for sign in (-1, 1)]
        return list(np.sort(np.stack(ends), axis=0))

    def transmission(self, around: Around, s: FloatArray) -> FloatArray:
        """At s * around of the target, shape (point, psi, node)."""
        x, y = (s * (self.scale[:, None] * around[k])[..., None] + self.shift[:, k, None, None] for k in (0, 1))
        fall = (self.outer - self.inner)[:, None, None]
        return np.clip((self.outer[:, None, None] - np.hypot(x, y)) / fall, 0.0, 1.0)

    def rims(self) -> list[FloatArray]:
        """The rims as conics on the target, shape (point, 3, 3) each."""
        conics = []
        for rim in (self.inner, self.outer):
            conic = np.zeros((len(rim), 3, 3))
            conic[:, 0, 0] = conic[:, 1, 1] = self.scale**2
            conic[:, :2, 2] = conic[:, 2, :2] = self.scale[:, None] * self.shift
            conic[:, 2, 2] = np.sum(self.shift**2, axis=1) - rim**2
            conics.append(conic)
        return conics

    def crossings(self, conic: FloatArray, rim: int) -> FloatArray:
        """Angles about the target's centre where a conic on the target meets a rim, shape (point, 4)."""
        size = np.where(np.isfinite(self.outer), (self.inner, self.outer)[rim], 1.0) / self.scale
        centre = -self.shift / self.scale[:, None]
        to_target = np.zeros_like(conic)
        to_target[:, 0, 0] = to_target[:, 1, 1] = size
        to_target[:, :2, 2], to_target[:, 2, 2] = centre, 1.0
        chi = crossings(np.swapaxes(to_target, 1, 2) @ conic @ to_target)
        x, y = (centre[:, k, None] + size[:, None] * turn(chi) for k, turn in enumerate((np.cos, np.sin)))
        return np.asarray(np.arctan2(y, x))


def crossings(conic: FloatArray) -> FloatArray:
    """Angles where conics, shape (point, 3, 3), meet the unit circle, shape (point, 4).

    On the circle a conic is a trigonometric polynomial of degree two, and with z = exp(i psi) a quartic in z whose
    coefficients are conjugate in pairs. Roots off the unit circle are no crossings; a panel that ends at their argument
    does no harm.
    """
    leading = (conic[:, 0, 0] - conic[:, 1, 1]) / 4 - 0.5j * conic[:, 0, 1]
    second = conic[:, 0, 2] - 1j * conic[:, 1, 2]
    middle = (conic[:, 0, 0] + conic[:, 1, 1]) / 2 + conic[:, 2, 2]
    scale = np.abs(conic[:, 0, 0]) + np.abs(conic[:, 1, 1]) + 1e-30
    leading = np.where(np.abs(leading) < 1e-12 * scale, 1e-12 * scale, leading)  # a circle has no crossings
    companion = np.zeros((len(conic), 4, 4), dtype=complex)
    companion[:, 1:, :3] = np.eye(3)
    for row, coefficient in enumerate((np.conj(leading), np.conj(second), middle, second)):
        companion[:, row, 3] = -coefficient / leading
    return np.asarray(np.angle(np.linalg.eigvals(companion)))


def tangents(conic: FloatArray) -> FloatArray:
    """Angles of the lines through the origin that touch conics, shape (point, 4); anything where there are none."""
    form = conic[:, :2, 2, None] * conic[:, None, :2, 2] - conic[:, :2, :2] * conic[:, 2, 2, None, None]
    mean, half = (form[:, 0, 0] + form[:, 1, 1]) / 2, (form[:, 0, 0] - form[:, 1, 1]) / 2
    length = np.hypot(half, form[:, 0, 1])
    middle = np.arctan2(form[:, 0, 1], half) / 2
    aside = np.arccos(np.clip(-mean / np.maximum(length, 1e-300), -1.0, 1.0)) / 2
    return np.stack([middle + aside, middle - aside, middle + aside + np.pi, middle - aside + np.pi], axis=-1)

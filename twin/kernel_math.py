"""Small functions for Dr.Jit kernels.

Floating-point ``dr.minimum`` and ``dr.maximum`` (and whatever calls them: ``dr.clip``,
``dr.atan2``, ``mi.warp``) become the LLVM
intrinsics ``minimum`` and ``maximum``. LLVM 15 cannot compile those at all, and LLVM 23 not on processors without
AVX-512 once it has taken a vector apart; either aborts the process ("Cannot select fminimum"). Kernels of this room
compare and select instead.
"""

from __future__ import annotations

from typing import Any


def smaller(dr: Any, a: Any, b: Any) -> Any:
    """The smaller of two floats."""
    return dr.select(a < b, a, b)


def larger(dr: Any, a: Any, b: Any) -> Any:
    """The larger of two floats."""
    return dr.select(a > b, a, b)


def uniform_disc(mi: Any, dr: Any, u: Any, v: Any) -> Any:
    """Uniform point of the unit disc; keeps neighbours together (Shirley and Chiu 1997)."""
    x, y = 2.0 * u - 1.0, 2.0 * v - 1.0
    steep = dr.abs(y) > dr.abs(x)
    radius, other = dr.select(steep, y, x), dr.select(steep, x, y)
    angle = (0.25 * dr.pi) * dr.select(radius == 0.0, 0.0, other / radius)
    sine, cosine = dr.sincos(angle)
    return mi.Point2f(radius * dr.select(steep, sine, cosine), radius * dr.select(steep, cosine, sine))


def cosine_hemisphere(mi: Any, dr: Any, u: Any, v: Any) -> Any:
    """Direction about +z with density cosine/pi."""
    disc = uniform_disc(mi, dr, u, v)
    return mi.Vector3f(disc.x, disc.y, dr.sqrt(larger(dr, 1.0 - dr.squared_norm(disc), 1e-12)))


def standard_normal(mi: Any, dr: Any, u: Any, v: Any) -> Any:
    """Two independent standard normal numbers (Box and Muller)."""
    radius = dr.sqrt(-2.0 * dr.log(1.0 - u))
    sine, cosine = dr.sincos(dr.two_pi * v)
    return mi.Vector2f(radius * cosine, radius * sine)


#: Abramowitz and Stegun 4.4.49: atan(x)/x in even powers of x, error below 2e-8 on [0, 1].
_ATAN = (
    1.0,
    -0.3333314528,
    0.1999355085,
    -0.1420889944,
    0.1065626393,
    -0.0752896400,
    0.0429096138,
    -0.0161657367,
    0.0028662257,
)


def full_angle(dr: Any, y: Any, x: Any) -> Any:
    """Angle of the point (x, y) in [0, 2 pi), and 0 for the origin."""
    a, b = dr.abs(x), dr.abs(y)
    steep = b > a
    longer = dr.select(steep, b, a)
    ratio = dr.select(longer > 0.0, dr.select(steep, a, b) / longer, 0.0)
    square = ratio * ratio
    series = _ATAN[-1]
    for coefficient in reversed(_ATAN[:-1]):
        series = dr.fma(series, square, coefficient)
    angle = ratio * series
    angle = dr.select(steep, 0.5 * dr.pi - angle, angle)
    angle = dr.select(x < 0.0, dr.pi - angle, angle)
    angle = dr.select(y < 0.0, dr.two_pi - angle, angle)
    return dr.select(angle >= dr.two_pi, 0.0, angle)

"""Scrambled Sobol points inside a Dr.Jit kernel.

Every randomisation scrambles the sequence anew (Owen scrambling by the hash of Laine and Karras, in the variant of
Burley, "Practical Hash-based Owen Scrambling", JCGT 9(4), 2020), so the scatter between randomisations is an honest
standard error, and each keeps the fast convergence of the sequence.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: Indices below 2**24 are distinct points.
INDEX_BITS = 24
DIMENSIONS = 22
_BYTES = INDEX_BITS // 8
#: Of every dimension but the first: a primitive polynomial, its coefficients as bits, and the first direction numbers
#: (S. Joe and F. Y. Kuo, "Constructing Sobol sequences with better two-dimensional projections", SIAM J. Sci. Comput.
#: 30, 2635 (2008), table new-joe-kuo-6.21201). SciPy has them too, and takes longer to load than a scene to be built.
_JOE_KUO = (
    (3, (1,)),
    (7, (1, 3)),
    (11, (1, 3, 1)),
    (13, (1, 1, 1)),
    (19, (1, 1, 3, 3)),
    (25, (1, 3, 5, 13)),
    (37, (1, 1, 5, 5, 17)),
    (41, (1, 1, 5, 5, 5)),
    (47, (1, 1, 7, 11, 19)),
    (55, (1, 1, 5, 1, 1)),
    (59, (1, 1, 1, 3, 11)),
    (61, (1, 3, 5, 5, 31)),
    (67, (1, 3, 3, 9, 7, 49)),
    (91, (1, 1, 1, 15, 21, 21)),
    (97, (1, 3, 1, 13, 27, 49)),
    (103, (1, 1, 1, 15, 7, 5)),
    (109, (1, 3, 1, 15, 13, 25)),
    (115, (1, 1, 5, 5, 19, 61)),
    (131, (1, 3, 7, 11, 23, 15, 103)),
    (137, (1, 3, 7, 13, 13, 15, 69)),
    (143, (1, 1, 3, 13, 7, 35, 63)),
)


@lru_cache(maxsize=1)
def byte_tables() -> NDArray[np.uint32]:
    """Sobol points by bytes of the index, bit-reversed, shape (DIMENSIONS, 3, 256).

    The coordinate of index n is the exclusive or of the three entries of its bytes; stored with reversed bits
    because the scrambling works on those.
    """
    vectors = _direction_vectors()
    index = np.arange(256, dtype=np.uint32)
    tables = np.zeros((DIMENSIONS, _BYTES, 256), dtype=np.uint32)
    for byte in range(_BYTES):
        for bit in range(8):
            chosen = ((index >> np.uint32(bit)) & np.uint32(1)).astype(bool)
            tables[:, byte] ^= np.where(chosen, vectors[:, 8 * byte + bit, None], np.uint32(0))
    return _reversed_bits(tables)


@lru_cache(maxsize=1)
def _direction_vectors() -> NDArray[np.uint32]:
    """What each bit of an index contributes to a coordinate times 2**32, shape (DIMENSIONS, INDEX_BITS)."""
    numbers = [[1] * INDEX_BITS, *(_direction_numbers(polynomial, first) for polynomial, first in _JOE_KUO)]
    return np.array(numbers, dtype=np.uint32) << np.arange(31, 31 - INDEX_BITS, -1, dtype=np.uint32)


def _direction_numbers(polynomial: int, first: tuple[int, ...]) -> list[int]:
    """The numbers m_1, m_2, ... of a dimension; number k has k bits (P. Bratley and B. L. Fox, Algorithm 659, 1988)."""
    degree, numbers = len(first), list(first)
    while len(numbers) < INDEX_BITS:
        new = numbers[-degree] ^ (numbers[-degree] << degree)
        for back in range(1, degree):
            if polynomial >> (degree - back) & 1:
                new ^= numbers[-back] << back
        numbers.append(new)
    return numbers


def _reversed_bits(values: NDArray[np.uint32]) -> NDArray[np.uint32]:
    bits = np.unpackbits(values[..., None].view(np.uint8), axis=-1, bitorder="little")
    return np.packbits(bits[..., ::-1], axis=-1, bitorder="little").view(np.uint32)[..., 0]


@lru_cache(maxsize=INDEX_BITS + 1)
def coherent_order(bits: int) -> NDArray[np.uint32]:
    """Order in which neighbours in the plane of the first two coordinates follow each other.

    The first 2**bits points of the sequence lie one each in the cells of a grid, and so does every later block of
    that length. Numbering the cells along a Z-shaped curve instead of by sequence lets the rays of a packet run
    side by side, which are traced much faster.

    Returns
    -------
    array, shape (3, 256)
        The index belonging to a number is the exclusive or of the entries of the number's bytes.
    """
    vectors = _direction_vectors()[:2, :bits]
    in_x, in_y = (bits + 1) // 2, bits // 2
    rows = [
        (vectors[axis] >> np.uint32(31 - digit)) & np.uint32(1)
        for axis, digits in ((0, in_x), (1, in_y))
        for digit in range(digits)
    ]
    inverse = _binary_inverse(np.array(rows, dtype=np.uint8).reshape(bits, bits))
    # Most significant first: x0 y0 x1 y1 ...
    cell_digits = [
        digit if axis == 0 else in_x + digit for digit in range(in_x) for axis in (0, 1) if axis == 0 or digit < in_y
    ]
    tables = np.zeros((_BYTES, 256), dtype=np.uint32)
    number = np.arange(256, dtype=np.uint32)
    for place, digit in enumerate(reversed(cell_digits)):
        column = np.uint32(sum(1 << row for row in range(bits) if inverse[row, digit]))
        chosen = ((number >> np.uint32(place % 8)) & np.uint32(1)).astype(bool)
        tables[place // 8] ^= np.where(chosen, column, np.uint32(0))
    return tables


def _binary_inverse(matrix: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Inverse of a square matrix over the field of two elements (Gauss and Jordan)."""
    size = len(matrix)
    work = np.concatenate([matrix, np.eye(size, dtype=np.uint8)], axis=1)
    for column in range(size):
        pivot = column + int(np.argmax(work[column:, column]))
        if not work[pivot, column]:
            raise ArithmeticError("the first two Sobol coordinates are no net")
        work[[column, pivot]] = work[[pivot, column]]
        others = np.flatnonzero(work[:, column])
        others = others[others != column]
        work[others] ^= work[column]
    return work[:, size:]


class Points:
    """Draws coordinates of scrambled Sobol points in a kernel."""

    def __init__(self, mi: Any, dr: Any) -> None:
        self._mi, self._dr = mi, dr
        self._tables = mi.UInt32(byte_tables().ravel())

    def coordinate(self, index: Any, dimension: Any, seed: Any, active: Any) -> Any:
        """Coordinate in [0, 1) of point ``index`` (below 2**24); a dimension past the last is pseudo-random."""
        mi, dr = self._mi, self._dr
        if isinstance(dimension, int) and dimension == 0:  # the bits of the index themselves
            return to_unit(mi, dr.brev(scramble(mi.UInt32(index), mix(seed))))
        dimension = mi.UInt32(dimension)
        inside = dimension < DIMENSIONS
        base = dr.minimum(dimension, DIMENSIONS - 1) * (256 * _BYTES)
        bits = dr.gather(mi.UInt32, self._tables, base + (index & 255), active)
        bits ^= dr.gather(mi.UInt32, self._tables, base + 256 + ((index >> 8) & 255), active)
        bits ^= dr.gather(mi.UInt32, self._tables, base + 512 + ((index >> 16) & 255), active)
        own = mix(seed + dimension * 0x9E3779B9)
        bits = dr.select(inside, bits, mix(index ^ own))
        return to_unit(mi, dr.brev(scramble(bits, own)))


def scramble(bits: Any, seed: Any) -> Any:
    """Owen scrambling of bit-reversed coordinates: each bit is flipped by a hash of the more significant ones."""
    bits = bits ^ (bits * 0x3D20ADEA)
    bits = bits + seed
    bits = bits * ((seed >> 16) | 1)
    bits = bits ^ (bits * 0x05526C56)
    return bits ^ (bits * 0x53A22864)


def mix(value: Any) -> Any:
    """Hash of 32 bits (Wellons, "lowbias32"): works on Dr.Jit arrays."""
    value = value ^ (value >> 16)
    value = value * 0x7FEB352D
    value = value ^ (value >> 15)
    value = value * 0x846CA68B
    return value ^ (value >> 16)


def mix_numpy(value: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """:func:`mix` for NumPy arrays."""
    value = np.asarray(value, dtype=np.uint64)
    mask = np.uint64(0xFFFFFFFF)
    value = value ^ (value >> np.uint64(16))
    value = (value * np.uint64(0x7FEB352D)) & mask
    value = value ^ (value >> np.uint64(15))
    value = (value * np.uint64(0x846CA68B)) & mask
    return (value ^ (value >> np.uint64(16))).astype(np.uint32)


def to_unit(mi: Any, bits: Any) -> Any:
    """The upper 24 bits as a float in [0, 1)."""
    return mi.Float(bits >> 8) * (2.0**-24)

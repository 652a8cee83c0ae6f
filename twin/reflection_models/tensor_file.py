"""Tensor files: named arrays in one binary file, the container of Mitsuba's measured materials.

Layout, little-endian: ``tensor_file`` and a zero byte; version 1.0 (two bytes); number of fields (uint32); for each
field length of its name (uint16), name, number of dimensions (uint16), type (uint8), offset of the data (uint64), shape
(uint64 a dimension). The data stand at their offsets, in C order.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from instrument.errors import InputError

MAGIC = b"tensor_file\0"
_TYPES = {
    1: "<u1",
    2: "<i1",
    3: "<u2",
    4: "<i2",
    5: "<u4",
    6: "<i4",
    7: "<u8",
    8: "<i8",
    9: "<f2",
    10: "<f4",
    11: "<f8",
}


def read_tensor_file(path: Path) -> dict[str, NDArray[Any]]:
    """Read every array of a tensor file.

    Raises
    ------
    InputError
        If the file is no tensor file of version 1.0, is cut short, or holds an unknown type.
    """
    data = path.read_bytes()
    if data[: len(MAGIC)] != MAGIC:
        raise InputError(f"{path}: not a tensor file (it does not begin with 'tensor_file')")
    reader = _Reader(path, data, len(MAGIC))
    version = reader.take("<BB")
    if version != (1, 0):
        raise InputError(f"{path}: version: found {version[0]}.{version[1]}; expected 1.0")
    (count,) = reader.take("<I")
    return dict(reader.field() for _ in range(count))


class _Reader:
    def __init__(self, path: Path, data: bytes, place: int) -> None:
        self.path, self.data, self.place = path, data, place

    def take(self, form: str) -> tuple[Any, ...]:
        size = struct.calcsize(form)
        if self.place + size > len(self.data):
            raise InputError(f"{self.path}: ends within its header at byte {len(self.data)}")
        values = struct.unpack_from(form, self.data, self.place)
        self.place += size
        return values

    def field(self) -> tuple[str, NDArray[Any]]:
        (length,) = self.take("<H")
        (raw,) = self.take(f"<{length}s")
        name = raw.decode("utf-8", "replace")
        dimensions, kind = self.take("<HB")
        (offset,) = self.take("<Q")
        shape = self.take(f"<{dimensions}Q")
        if kind not in _TYPES:
            raise InputError(f"{self.path}: {name}: found the type {kind}; expected 1 to 11")
        dtype = np.dtype(_TYPES[kind])
        size = int(np.prod([int(n) for n in shape], dtype=object)) if shape else 1
        if offset + size * dtype.itemsize > len(self.data):
            raise InputError(
                f"{self.path}: {name}: shape {shape} needs {size * dtype.itemsize} bytes from byte {offset}; the file"
                f" ends at byte {len(self.data)}"
            )
        return name, np.frombuffer(self.data, dtype, size, offset).reshape(shape)

"""NKT Interbus telegrams: pure functions.

A telegram is ``0D | destination source type register data.. crc crc | 0A``; between the two ends the bytes 0A, 0D
and 5E are sent as 5E followed by the byte plus 40h. The checksum is CRC-16/XMODEM over the unescaped bytes
from destination to data, high byte first. Data are little-endian.
"""

from __future__ import annotations

import binascii
from dataclasses import dataclass
from enum import IntEnum

START, END, ESCAPE, SHIFT = 0x0D, 0x0A, 0x5E, 0x40
_SPECIAL = frozenset((START, END, ESCAPE))

#: Data bytes that one telegram can carry.
MAX_DATA = 240


class Kind(IntEnum):
    """Type of a telegram."""

    NACK = 0
    CRC_ERROR = 1
    BUSY = 2
    ACK = 3
    READ = 4
    WRITE = 5
    WRITE_SET = 6
    WRITE_CLEAR = 7
    DATAGRAM = 8
    WRITE_TOGGLE = 9


class TelegramError(ValueError):
    """Bytes that are no telegram."""


@dataclass(frozen=True)
class Telegram:
    """One message between host and module."""

    destination: int
    source: int
    kind: Kind
    register: int
    data: bytes = b""


def crc(body: bytes) -> bytes:
    """CRC-16/XMODEM (polynomial 1021h, initial value 0), high byte first."""
    return binascii.crc_hqx(body, 0).to_bytes(2, "big")


def escape(body: bytes) -> bytes:
    """Replace the bytes that mark a telegram's ends, and the escape byte itself."""
    sent = bytearray()
    for byte in body:
        sent += bytes((ESCAPE, byte + SHIFT)) if byte in _SPECIAL else bytes((byte,))
    return bytes(sent)


def unescape(sent: bytes) -> bytes:
    """Undo :func:`escape`.

    Raises
    ------
    TelegramError
        If an escape byte is followed by nothing, or by what no escaped byte looks like.
    """
    body = bytearray()
    coming = iter(sent)
    for byte in coming:
        if byte == ESCAPE:
            byte = next(coming, 0) - SHIFT
            if byte not in _SPECIAL:
                raise TelegramError(f"wrong escape sequence in {sent.hex(' ')}")
        body.append(byte)
    return bytes(body)


def build(telegram: Telegram) -> bytes:
    """Bytes on the wire.

    Raises
    ------
    ValueError
        If an address, the register or the length of the data does not fit.
    """
    if len(telegram.data) > MAX_DATA:
        raise ValueError(f"{len(telegram.data)} data bytes; at most {MAX_DATA} fit")
    body = bytes((telegram.destination, telegram.source, telegram.kind, telegram.register)) + telegram.data
    return bytes((START,)) + escape(body + crc(body)) + bytes((END,))


def parse(frame: bytes) -> Telegram:
    """Read one frame, its two end bytes included.

    Raises
    ------
    TelegramError
        If the ends, the escapes, the length, the checksum or the type are wrong.
    """
    if len(frame) < 2 or frame[0] != START or frame[-1] != END:
        raise TelegramError(f"no frame: {frame.hex(' ')}")
    content = unescape(frame[1:-1])
    if len(content) < 6:
        raise TelegramError(f"too short: {frame.hex(' ')}")
    body, checksum = content[:-2], content[-2:]
    if crc(body) != checksum:
        raise TelegramError(f"checksum {checksum.hex()} found, {crc(body).hex()} expected: {frame.hex(' ')}")
    try:
        kind = Kind(body[2])
    except ValueError:
        raise TelegramError(f"unknown type {body[2]:02X}: {frame.hex(' ')}") from None
    return Telegram(body[0], body[1], kind, body[3], body[4:])


def split(received: bytes) -> tuple[list[bytes], bytes]:
    """Cut received bytes into complete frames and the rest that may still grow.

    Bytes before a start byte are noise and dropped; a start byte inside a frame begins a new one.
    """
    frames, rest = [], b""
    for piece in received.split(bytes((END,)))[:-1]:
        begin = piece.rfind(bytes((START,)))
        if begin >= 0:
            frames.append(piece[begin:] + bytes((END,)))
    tail = received.rsplit(bytes((END,)), 1)[-1]
    begin = tail.rfind(bytes((START,)))
    if begin >= 0:
        rest = tail[begin:]
    return frames, rest

"""The Interbus codec against the frames of the protocol description, and by property."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.nkt_interbus import Kind, Telegram, TelegramError, build, crc, escape, parse, split, unescape

FRAMES = [
    ("0D 0F A2 04 66 C7 B6 0A", Telegram(0x0F, 0xA2, Kind.READ, 0x66)),
    ("0D A2 0F 08 66 01 00 90 A8 0A", Telegram(0xA2, 0x0F, Kind.DATAGRAM, 0x66, b"\x01\x00")),
    ("0D 0F A2 05 30 03 BC E1 0A", Telegram(0x0F, 0xA2, Kind.WRITE, 0x30, b"\x03")),
    ("0D 0F A2 05 30 00 8C 82 0A", Telegram(0x0F, 0xA2, Kind.WRITE, 0x30, b"\x00")),
    ("0D A2 0F 03 30 48 2F 0A", Telegram(0xA2, 0x0F, Kind.ACK, 0x30)),
    ("0D 0F A2 05 37 58 02 F0 C0 0A", Telegram(0x0F, 0xA2, Kind.WRITE, 0x37, (600).to_bytes(2, "little"))),
    ("0D 0F A2 05 36 5E 4A 87 6E 0A", Telegram(0x0F, 0xA2, Kind.WRITE, 0x36, b"\x0a")),
    ("0D 10 A2 05 33 BA 13 87 47 0A", Telegram(0x10, 0xA2, Kind.WRITE, 0x33, (5050).to_bytes(2, "little"))),
    ("0D 10 A2 05 34 56 13 57 08 0A", Telegram(0x10, 0xA2, Kind.WRITE, 0x34, (4950).to_bytes(2, "little"))),
    ("0D 12 A2 05 90 20 A1 07 00 56 00 0A", Telegram(0x12, 0xA2, Kind.WRITE, 0x90, (500_000).to_bytes(4, "little"))),
]

telegrams = st.builds(
    Telegram,
    destination=st.integers(0, 255),
    source=st.integers(0, 255),
    kind=st.sampled_from(Kind),
    register=st.integers(0, 255),
    data=st.binary(max_size=240),
)


@pytest.mark.parametrize(("frame", "telegram"), FRAMES)
def test_frames_of_the_protocol_description_are_built_and_read_byte_for_byte(frame: str, telegram: Telegram) -> None:
    assert build(telegram) == bytes.fromhex(frame)
    assert parse(bytes.fromhex(frame)) == telegram


def test_the_checksum_is_the_xmodem_one() -> None:
    # Check value of CRC-16/XMODEM in the catalogue of parametrised CRC algorithms.
    assert crc(b"123456789") == bytes.fromhex("31C3")


@given(st.binary(max_size=300))
def test_escaped_bytes_hold_no_frame_ends_and_come_back(body: bytes) -> None:
    sent = escape(body)
    assert not {0x0A, 0x0D} & set(sent)
    assert unescape(sent) == body


@given(telegrams)
def test_a_telegram_survives_the_wire(telegram: Telegram) -> None:
    assert parse(build(telegram)) == telegram


@given(telegrams, st.data())
def test_one_flipped_bit_is_always_noticed(telegram: Telegram, data: st.DataObject) -> None:
    frame = bytearray(build(telegram))
    position = data.draw(st.integers(1, len(frame) - 2))
    frame[position] ^= 1 << data.draw(st.integers(0, 7))
    try:
        assert parse(bytes(frame)) == telegram, "a wrong telegram was accepted"
    except TelegramError:
        return
    raise AssertionError("the flipped bit went unnoticed")


@given(st.lists(telegrams, max_size=4), st.binary(max_size=6), st.integers(0, 30))
def test_frames_are_cut_out_of_noise_and_pieces(sent: list[Telegram], noise: bytes, keep: int) -> None:
    noise = bytes(byte for byte in noise if byte not in (0x0A, 0x0D))
    half = build(Telegram(1, 2, Kind.READ, 3))[:-1][:keep]
    frames, rest = split(noise.join([b"", *map(build, sent)]) + half)
    assert [parse(frame) for frame in frames] == sent
    assert rest == half


@pytest.mark.parametrize(
    "wrong",
    ["", "0D 0A", "0D 0F A2 04 0A", "0D 0F A2 04 66 C7 B7 0A", "0D 0F A2 5E 0A", "0D 5E 00 A2 04 66 C7 B6 0A", "0F 0A"],
)
def test_what_is_no_telegram_is_refused(wrong: str) -> None:
    with pytest.raises(TelegramError):
        parse(bytes.fromhex(wrong))


def test_more_data_than_a_telegram_holds_are_refused() -> None:
    with pytest.raises(ValueError, match="at most 240"):
        build(Telegram(1, 2, Kind.WRITE, 3, bytes(241)))

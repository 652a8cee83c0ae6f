"""One module on an Interbus line: registers read and written with the few repetitions that are safe here."""

from __future__ import annotations

import itertools
import time

from drivers.errors import CommandRefused, CommunicationError
from drivers.nkt_interbus import Kind, Telegram, TelegramError, build, parse, split
from drivers.transport import Line, NoReply

#: Every write is an absolute set-point, so a telegram that was garbled on its way may be sent again.
ATTEMPTS = 4

#: Pause in s before a module that said "busy" is asked again.
BUSY_PAUSE = 0.05

TYPE, FIRMWARE, SERIAL, STATUS, ERROR = 0x61, 0x64, 0x65, 0x66, 0x67

#: Module types by their register 61h.
TYPES = {
    0x60: "SuperK EXTREME or FIANIUM",
    0x88: "SuperK FIANIUM S4x3",
    0x66: "RF driver",
    0x67: "SuperK SELECT",
    0x68: "SuperK VARIA",
    0x7D: "SuperK EVO",
}


class NktModule:
    """A module.

    Parameters
    ----------
    device
        Name of the device, for errors.
    line
        The Interbus line.
    address
        Address of the module.
    """

    def __init__(self, device: str, line: Line, address: int) -> None:
        self.device, self.line, self.address = device, line, address
        # A new source address for every telegram: the reply to an older one cannot be taken for the present one.
        self._sources = itertools.cycle(range(0xA2, 0x100))

    def read(self, register: int) -> bytes:
        """Content of a register.

        Raises
        ------
        CommunicationError
            If no valid reply came after some attempts.
        CommandRefused
            If the module does not know the register.
        """
        reply = self._ask(Kind.READ, register, b"", Kind.DATAGRAM)
        return reply.data

    def read_unsigned(self, register: int) -> int:
        """Content of a register as an unsigned number of whatever length the module gives it."""
        return int.from_bytes(self.read(register), "little")

    def write(self, register: int, value: int, size: int) -> None:
        """Write an unsigned number of ``size`` bytes and wait for its acknowledgement.

        Raises
        ------
        CommunicationError
            If no acknowledgement came after some attempts.
        CommandRefused
            If the module refuses the value.
        """
        self._ask(Kind.WRITE, register, value.to_bytes(size, "little"), Kind.ACK)

    def identify(self, expected: tuple[int, ...]) -> str:
        """Type and serial number of the module.

        Raises
        ------
        CommandRefused
            If the module at this address is of another type.
        """
        found = self.read_unsigned(TYPE)
        if found not in expected:
            wanted = " or ".join(f"{kind:02X}h ({TYPES[kind]})" for kind in expected)
            raise CommandRefused(
                self.device,
                f"module {self.address} is of type {found:02X}h ({TYPES.get(found, 'unknown')}), expected {wanted}",
                "check the address",
            )
        serial = self.read(SERIAL).rstrip(b"\0 ").decode("ascii", "replace")
        return f"NKT {TYPES[found]}, address {self.address}, serial {serial}"

    def module_type(self) -> int:
        """Register 61h."""
        return self.read_unsigned(TYPE)

    def _ask(self, kind: Kind, register: int, data: bytes, expected: Kind) -> Telegram:
        problem: Exception | str = ""
        for _ in range(ATTEMPTS):
            try:
                reply = self._exchange(kind, register, data)
            except NoReply as error:
                problem = error
                continue
            if reply.kind == expected:
                return reply
            if reply.kind == Kind.NACK:
                raise CommandRefused(self.device, f"module {self.address} refuses register {register:02X}h")
            problem = f"it answered {reply.kind.name}"
            if reply.kind == Kind.BUSY:
                time.sleep(BUSY_PAUSE)
        if isinstance(problem, NoReply):
            raise problem
        raise CommunicationError(
            self.device,
            f"module {self.address}, register {register:02X}h on line {self.line.name!r}: {problem} {ATTEMPTS} times",
            "check the cable",
        )

    def _exchange(self, kind: Kind, register: int, data: bytes) -> Telegram:
        source = next(self._sources)
        request = build(Telegram(self.address, source, kind, register, data))

        def complete(received: bytes) -> bytes | None:
            for frame in split(received)[0]:
                try:
                    telegram = parse(frame)
                except TelegramError:
                    continue
                if (telegram.destination, telegram.source, telegram.register) == (source, self.address, register):
                    return frame
            return None

        return parse(self.line.exchange(self.device, request, complete))

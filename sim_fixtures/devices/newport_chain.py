"""Newport SMC100 controllers, daisy-chained behind one serial port."""

from __future__ import annotations

from collections.abc import Callable

from sim_fixtures.bench import Bench
from sim_fixtures.devices.newport_smc100 import Controller
from sim_fixtures.devices.newport_syntax import Command, parse


class Smc100Chain:
    """Controllers on one line; a wire handler (see :class:`~sim_fixtures.devices.wire.Handler`).

    Parameters
    ----------
    bench
        What the stages are part of.
    axes
        Name of the bench's axis by controller address; the limits of use become the software limits.
    """

    def __init__(self, bench: Bench, axes: dict[int, str]) -> None:
        self._bench, self._buffer = bench, b""
        self.request_lost: Callable[[bytes], bool] = lambda _: False
        self.controllers: dict[int, Controller] = {}
        for address, name in axes.items():
            lower, upper = getattr(bench.facility.arms, name)
            limits = (min(lower, 0.0), max(upper, 0.0))
            self.controllers[address] = Controller(address, bench.axes[name], bench, limits)

    def feed(self, data: bytes) -> list[bytes]:
        """Take bytes from the line; answers end with CR LF."""
        self._buffer += data
        *lines, self._buffer = self._buffer.split(b"\n")
        answers = [self._line(line.decode("latin-1")) for line in lines]
        return [f"{answer}\r\n".encode("ascii") for answer in answers if answer is not None]

    def of_axis(self, name: str) -> Controller | None:
        """The controller that drives an axis."""
        return next((c for c in self.controllers.values() if c.axis.name == name), None)

    def _line(self, line: str) -> str | None:
        command = parse(line)
        if command is None or self.request_lost(line.encode("latin-1")):
            return None
        with self._bench.lock:
            if command.address is None:
                self._broadcast(command)
                return None
            controller = self.controllers.get(command.address)
            return controller.execute(command) if controller is not None else None

    def _broadcast(self, command: Command) -> None:
        for controller in self.controllers.values():
            if command.name == "ST":
                controller.stop()
            elif command.name == "SE":
                controller.start_armed()


def of_next_controller(answer: bytes) -> bytes:
    """An answer under the address after its own."""
    digits = len(answer) - len(answer.lstrip(b"0123456789"))
    return str(int(answer[:digits]) + 1).encode("ascii") + answer[digits:]

"""Modbus RTU slaves on a pseudo-terminal, served by pymodbus.

pymodbus opens one end of an inner pseudo-terminal; a relay joins it to the line that clients open, so that the
faults of a wire apply here too, and requests to slaves that are not there stay unanswered as on a real bus.
"""

from __future__ import annotations

import asyncio
import logging
import os
import threading
import tty
from functools import partial

from pymodbus.framer import FramerType
from pymodbus.server import ModbusSerialServer
from pymodbus.simulator import SimDevice

from sim_fixtures.devices.faults import deliver
from sim_fixtures.devices.wire import SerialLine

_BROADCAST = 0


class ModbusLine:
    """Serves slaves on a serial line.

    Parameters
    ----------
    line
        What clients open.
    slaves
        The slaves, in pymodbus's form.
    baudrate
        For pymodbus's sake; a pseudo-terminal has none.
    """

    def __init__(self, line: SerialLine, slaves: list[SimDevice], baudrate: int = 115200) -> None:
        self._line, self._slaves, self._baudrate = line, slaves, baudrate
        self._units = {slave.id for slave in slaves}
        line.faults.change.update(
            refuse=partial(_exception, code=6), deny=partial(_exception, code=4), stray=_of_next_unit
        )
        self._inner, far = os.openpty()
        tty.setraw(far)
        self._port = os.ttyname(far)
        self._far = far
        self._loop = asyncio.new_event_loop()
        self._ready = threading.Event()
        self._failure: BaseException | None = None
        self._server: ModbusSerialServer | None = None
        self._thread = threading.Thread(target=self._run, name=f"modbus {line.link.name}", daemon=True)
        self._thread.start()
        if not self._ready.wait(10.0) or self._failure is not None:
            raise RuntimeError(f"Modbus server on {line.link} did not start") from self._failure
        line.listen(self._request)

    def close(self) -> None:
        """End the server; the line is closed by its owner."""
        if self._loop.is_running():
            asyncio.run_coroutine_threadsafe(self._shutdown(), self._loop).result(5.0)
        self._thread.join(timeout=5.0)
        self._loop.close()
        os.close(self._inner)
        os.close(self._far)

    def _request(self, data: bytes) -> None:
        # The master waits for each answer, so what arrives together is one frame.
        faults = self._line.faults
        if data[0] in {*self._units, _BROADCAST} and not faults.request_lost(data):
            if refusal := faults.refusal(data):
                deliver(refusal, faults, self._line.write)
            else:
                os.write(self._inner, data)

    def _reply(self) -> None:
        reply = os.read(self._inner, 512)
        if reply and reply[0] in self._units:
            deliver(reply, self._line.faults, self._line.write)

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        self._loop.run_until_complete(self._serve())

    async def _serve(self) -> None:
        # A request to an absent slave makes pymodbus log an error; here it is an ordinary event.
        logging.getLogger("pymodbus.logging").setLevel(logging.CRITICAL)
        try:
            self._server = ModbusSerialServer(
                self._slaves,
                framer=FramerType.RTU,
                port=self._port,
                baudrate=self._baudrate,
                broadcast_enable=True,
                ignore_missing_devices=True,
            )
            await self._server.serve_forever(background=True)
        except BaseException as error:
            self._failure = error
            self._ready.set()
            raise
        self._loop.add_reader(self._inner, self._reply)
        self._ready.set()
        await self._server.serving

    async def _shutdown(self) -> None:
        self._loop.remove_reader(self._inner)
        if self._server is not None:
            await self._server.shutdown()


def _exception(request: bytes, code: int) -> bytes:
    return _framed(bytes([request[0], request[1] | 0x80, code]))


def _of_next_unit(reply: bytes) -> bytes:
    return _framed(bytes([reply[0] + 1]) + reply[1:-2])


def _framed(body: bytes) -> bytes:
    """With its CRC-16 (polynomial A001h, start FFFFh, low byte first)."""
    crc = 0xFFFF
    for byte in body:
        crc ^= byte
        for _ in range(8):
            crc = (crc >> 1) ^ (0xA001 if crc & 1 else 0)
    return body + crc.to_bytes(2, "little")

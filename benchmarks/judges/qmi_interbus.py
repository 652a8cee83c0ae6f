"""QMI's Interbus protocol on the simulated SuperK."""

from __future__ import annotations

from protocol import Judge
from qmi.core.transport import create_transport
from qmi.instruments.nkt_photonics.nkt_photonics_interbus_protocol import NKTPhotonicsInterbusProtocol

LASER, RF_DRIVER = 15, 18


def main() -> None:
    judge = Judge("qmi", "NKTPhotonicsInterbusProtocol on the simulated SuperK")
    transport = create_transport(f"serial:{judge.endpoints['laser']}:baudrate=115200")
    transport.open()
    try:
        bus = NKTPhotonicsInterbusProtocol(transport, 2.0)
        judge.check("module type", lambda: bus.get_register(LASER, 0x61).hex(), lambda value: value == "60")
        judge.check("serial number", lambda: bus.get_register(LASER, 0x65), lambda value: value.startswith(b"SIM"))
        for power in (10, 13, 94, 600, 1000):  # 0Ah, 0Dh and 5Eh are escaped on the wire
            data = power.to_bytes(2, "little")
            bus.set_register(LASER, 0x37, data)
            judge.check(f"power {power} permille", lambda: bus.get_register(LASER, 0x37), lambda v, d=data: v == d)
        judge.refused("an unknown register is refused", lambda: bus.get_register(LASER, 0xEE), "NACK")
        judge.refused("a wrong length is refused", lambda: bus.set_register(LASER, 0x37, b"\x01"), "NACK")
        wanted = (500_000).to_bytes(4, "little")
        bus.set_register(RF_DRIVER, 0x90, wanted)
        judge.check("wavelength in pm", lambda: bus.get_register(RF_DRIVER, 0x90), lambda value: value == wanted)
    finally:
        transport.close()
    judge.done()


if __name__ == "__main__":
    main()

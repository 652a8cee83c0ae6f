"""pylablib's NKT Interbus on the simulated SuperK with its SELECT."""

from __future__ import annotations

from protocol import Judge, close_to
from pylablib.devices.NKT.interbus import InterbusSystem


def main() -> None:
    judge = Judge("pylablib", "NKT InterbusSystem on the simulated SuperK and SELECT")
    bus = InterbusSystem((judge.endpoints["laser"], 115200), modules="auto")
    try:
        trial(judge, bus)
    finally:
        bus.close()
    judge.done()


def trial(judge: Judge, bus: InterbusSystem) -> None:
    """Search, laser, RF driver."""
    judge.check("a search finds the modules", lambda: sorted(bus.m), lambda value: {15, 16, 18} <= set(value))
    laser, select, driver = bus[15], bus[16], bus[18]
    judge.check("types", lambda: [m.dtype for m in (laser, select, driver)], lambda v: v == [0x60, 0x67, 0x66])
    judge.check("serial number", lambda: laser.serial, lambda value: value.startswith("SIM"))
    judge.check("all registers of the laser", laser.get_all_registers, lambda value: len(value) > 8)
    judge.check("all registers of the SELECT", select.get_all_registers, lambda value: len(value) > 8)
    judge.check("all registers of the RF driver", driver.get_all_registers, lambda value: len(value) > 20)
    judge.check("inlet temperature", lambda: laser.get_register("temperature_inlet"), close_to(25.3, 0.1))
    judge.check("power", lambda: laser.set_register("power", 42.5), close_to(42.5, 0.05))
    judge.check("watchdog with an escaped value", lambda: laser.set_register("watchdog_interval", 10), close_to(10))
    laser.set_register("watchdog_interval", 0)
    laser.set_register("interlock", 1)
    judge.check("interlock after a reset", lambda: laser.get_register("interlock"), lambda value: value & 0xFF == 2)
    judge.check("emission on", lambda: laser.set_register("emission", 3), close_to(3))
    judge.check("status in words", laser.get_status, lambda value: "emission" in value)
    judge.check("emission off", lambda: laser.set_register("emission", 0), close_to(0))
    judge.refused("a wrong emission value is refused", lambda: laser.set_register("emission", 7), "not understood")
    judge.check("wavelength in m", lambda: driver.set_register("wavelength0", 550e-9)[0], close_to(550e-9, 1e-12))
    judge.check("amplitude in %", lambda: driver.set_register("amplitude0", 80.0)[0], close_to(80.0))
    judge.check("shortest wavelength", lambda: driver.get_register("min_wavelength"), lambda value: 3e-7 < value < 1e-6)


if __name__ == "__main__":
    main()

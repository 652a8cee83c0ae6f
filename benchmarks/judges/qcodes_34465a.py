"""QCoDeS's Keysight 34465A on the simulated meter."""

from __future__ import annotations

import numpy as np
from protocol import Judge, close_to
from qcodes.instrument_drivers.Keysight import Keysight34465A


def main() -> None:
    judge = Judge("qcodes", "Keysight34465A on the simulated meter")
    address = f"TCPIP0::127.0.0.1::{judge.endpoints['meter']}::SOCKET"
    meter = Keysight34465A("meter", address, visalib="@py", terminator="\n", timeout=20)
    try:
        trial(judge, meter)
    finally:
        meter.close()
    judge.done()


def trial(judge: Judge, meter: Keysight34465A) -> None:
    """Settings and bursts of DC voltage."""
    judge.check("identity", meter.get_idn, lambda value: value["model"] == "34465A")
    judge.check("reset and snapshot", meter.reset, lambda value: value is None)
    judge.check("function", meter.sense_function, lambda value: value == "DC Voltage")
    judge.check("line frequency", meter.line_frequency, close_to(50))
    meter.autorange("OFF")
    judge.check("autorange off", meter.autorange, lambda value: value in ("OFF", False))
    meter.range(10)
    judge.check("range", meter.range, close_to(10.0))
    meter.NPLC(0.2)
    judge.check("integration time", meter.NPLC, close_to(0.2, 1e-6))
    meter.autozero("OFF")
    judge.check("autozero off", meter.autozero, lambda value: value in ("OFF", False))
    judge.check("one voltage", meter.volt, lambda value: np.isfinite(value) and abs(value) < 12.0)
    meter.trigger.source("IMM")
    meter.trigger.count(1)
    meter.trigger.delay(0.0)
    judge.check("trigger delay", meter.trigger.delay, close_to(0.0))
    meter.sample.count(9)
    judge.check("nine samples with READ?", meter.read, lambda value: np.shape(value) == (9,))
    meter.init_measurement()
    judge.check("nine samples with INIT and FETCh?", meter.fetch, lambda value: np.shape(value) == (9,))
    meter.trigger.source("BUS")
    meter.init_measurement()
    meter.trigger.force()
    judge.check("nine samples with a bus trigger", meter.fetch, lambda value: np.shape(value) == (9,))
    meter.display.text("judged")
    judge.check("text on the display", meter.display.text, lambda value: "judged" in value)
    meter.display.clear()
    meter.abort_measurement()
    judge.check("no error is left", meter.error, lambda value: value[0] == 0)


if __name__ == "__main__":
    main()

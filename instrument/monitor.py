"""The monitor photodiode: sees the source beside the sample, at the time of the detector, and takes its changes out.

It is the device ``monitor`` of ``devices.toml`` (any driver of a detector). Its readings are recorded as they are;
photocurrents are divided by them when they become reflectance factors.
"""

from __future__ import annotations

import threading
from collections import deque
from typing import Any

import numpy as np

from drivers.errors import DeviceFault
from drivers.interfaces import Detector, Laboratory, Reading
from instrument.angles import FloatArray
from instrument.calibration import Photocurrent
from instrument.control import ask

ROLE = "monitor"
#: Of the monitor's full scale; with less light than that it cannot normalise anything.
_LEAST = 1e-3
_KEPT = 32


class MonitoredDetector:
    """A detector whose every burst is accompanied by one of the monitor. Satisfies ``Detector``."""

    def __init__(self, detector: Detector, monitor: Detector) -> None:
        self.name, self.full_scale = detector.name, detector.full_scale
        self._detector, self._monitor = detector, monitor
        self._seen: deque[tuple[tuple[float, ...], float]] = deque(maxlen=_KEPT)
        self._zero = 0.0

    def identify(self) -> str:
        """Of the detector."""
        return self._detector.identify()

    def make_safe(self) -> None:
        """Of the detector; the monitor is a device of its own."""
        self._detector.make_safe()

    def close(self) -> None:
        """Of the detector; the monitor is a device of its own."""
        self._detector.close()

    def read(self, samples: int) -> Reading:
        """Both bursts at the same time; errors of either are raised."""
        beside: list[Reading] = []
        failures: list[Exception] = []

        def watch() -> None:
            try:
                beside.append(self._monitor.read(samples))
            except Exception as error:  # noqa: BLE001 - raised below, on the thread that asked
                failures.append(error)

        thread = threading.Thread(target=watch, name="monitor", daemon=True)
        thread.start()
        try:
            reading = self._detector.read(samples)
        finally:
            thread.join()
        if failures:
            raise failures[0]
        if beside[0].overload:
            raise DeviceFault(ROLE, "overload", "reduce the light on the monitor photodiode")
        self._seen.append((reading.samples, float(np.mean(beside[0].samples))))
        return reading

    def zero(self) -> float:
        """Read the monitor while the source is off; later readings are taken over this one. Returns it, V."""
        self._zero = float(np.mean(ask(lambda: self._monitor.read(9)).samples))
        return self._zero

    def beside(self, samples: tuple[float, ...]) -> dict[str, Any]:
        """What a record says of the monitor during a burst of the detector.

        Raises
        ------
        DeviceFault
            If the monitor saw no light.
        """
        volts = next((seen for burst, seen in reversed(self._seen) if burst == samples), None)
        if volts is None:
            return {}
        if volts - self._zero < _LEAST * self._monitor.full_scale:
            found = f"no light: {volts:.3g} V, {self._zero:.3g} V with the source off"
            raise DeviceFault(ROLE, found, "look at the monitor photodiode, its amplifier and its place in the beam")
        return {"monitor": volts - self._zero}


def monitored(laboratory: Laboratory) -> MonitoredDetector | None:
    """The detector with its monitor; None where no monitor is configured."""
    device = laboratory.others.get(ROLE)
    return MonitoredDetector(laboratory.detector, device) if isinstance(device, Detector) else None


def normalised(reading: Photocurrent, monitor: FloatArray | None) -> Photocurrent:
    """Photocurrents over what the monitor saw at the same time, A/V; unchanged without a monitor.

    Parameters
    ----------
    monitor
        V, shape (point,).
    """
    if monitor is None:
        return reading
    return Photocurrent(reading.current / monitor, reading.standard_error / np.abs(monitor))

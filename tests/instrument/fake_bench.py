"""Hand-written devices in memory, with a script of faults; they know nothing of the engine.

The bench watches over what must never happen: an arm that moves while the shutter is open, a detector head in the
beam, light while hands are at the stage.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from drivers.clock import Clock
from drivers.errors import CommandRefused, CommunicationError
from drivers.interfaces import AxisLimits, AxisStatus, Laboratory, Reading

SPEED = 2000.0
#: Photocurrent of a Lambertian sample of reflectance factor 1 at normal illumination, A.
FULL_CURRENT = 1.0e-6


@dataclass
class Bench:
    """The physical state that the devices share."""

    clock: Clock = field(default_factory=lambda: Clock(SPEED))
    reflectance: dict[str, float] = field(default_factory=lambda: {"reference": 0.99, "sample": 0.4})
    mounted: str = ""
    wrong: list[str] = field(default_factory=list)
    log: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        wide = {"velocity": 20.0, "acceleration": 40.0}
        self.axes = {
            "illumination_zenith": FakeAxis("illumination_zenith", self, AxisLimits(-91.0, 91.0, **wide)),
            "sensor_azimuth": FakeAxis("sensor_azimuth", self, AxisLimits(-5.0, 185.0, **wide)),
            "sensor_zenith": FakeAxis("sensor_zenith", self, AxisLimits(-91.0, 91.0, **wide)),
        }
        self.source, self.selector = FakeSource(self), FakeSelector()
        self.shutter, self.amplifier = FakeShutter(self), FakeAmplifier()
        self.detector = FakeDetector(self)

    def laboratory(self) -> Laboratory:
        return Laboratory(
            **self.axes,
            source=self.source,
            selector=self.selector,
            detector=self.detector,
            amplifier=self.amplifier,
            shutter=self.shutter,
        )

    def current(self) -> float:
        """Photocurrent now, A."""
        if not (self.shutter.opened and self.source.on and self.mounted):
            return 0.0
        incidence = math.cos(math.radians(self.axes["illumination_zenith"].place()))
        return FULL_CURRENT * self.reflectance[self.mounted] * incidence

    def mount(self, what: str) -> None:
        """The operator's part."""
        if self.source.on or self.shutter.opened:
            self.wrong.append(f"light while the {what} was mounted")
        if any(axis.busy() for axis in self.axes.values()):
            self.wrong.append(f"an arm moved while the {what} was mounted")
        self.mounted = what
        self.log.append(f"mount {what}")

    @property
    def safe(self) -> bool:
        return not self.source.on and not self.shutter.opened and not any(a.busy() for a in self.axes.values())


#: What needs the wire.
_ON_THE_WIRE = frozenset(
    [
        "identify",
        "make_safe",
        "position",
        "status",
        "home",
        "start_move",
        "stop",
        "emission",
        "set_emission",
        "power",
        "set_power",
        "fault",
        "keep_alive",
        "set_wavelength",
        "wavelength",
        "is_open",
        "open",
        "shut",
        "gain",
        "set_gain",
        "overload",
        "read",
    ]
)


class FakeDevice:
    unplugged = False

    def __getattribute__(self, attribute: str) -> Any:
        if attribute in _ON_THE_WIRE and self.unplugged:
            return self._silence
        return super().__getattribute__(attribute)

    def _silence(self, *_: object) -> Any:
        raise CommunicationError(self.name, "no reply", "check the cable")

    def __init__(self, name: str) -> None:
        self.name = name
        self.closed = False
        self.lost_replies = 0

    def identify(self) -> str:
        return f"fake {self.name}"

    def make_safe(self) -> None:
        pass

    def close(self) -> None:
        self.closed = True

    def _maybe_lose_reply(self) -> None:
        if self.lost_replies > 0:
            self.lost_replies -= 1
            raise CommunicationError(self.name, "no reply", "check the cable")


class FakeAxis(FakeDevice):
    """An arm with a script: what becomes of each motion command, "ok" when the script is empty.

    ``lost_taken`` and ``lost_dropped`` lose the reply, ``ignored`` accepts and does nothing, ``half`` stands still half
    way, ``hangs`` says that it moves and does not, ``refused`` and ``alarm`` speak for themselves.
    """

    tolerance = 0.01

    def __init__(self, name: str, bench: Bench, limits: AxisLimits) -> None:
        super().__init__(name)
        self.bench, self.limits = bench, limits
        self.script: deque[str] = deque()
        self.homing_script: deque[str] = deque()
        self.always: str | None = None
        self.homed, self.fault, self.hanging = False, "", False
        self.commands: list[float] = []
        self._from = self._to = 0.0
        self._began = 0.0

    def place(self) -> float:
        if self.hanging:
            return self._from
        travelled = (self.bench.clock.monotonic() - self._began) * self.limits.velocity
        distance = self._to - self._from
        return self._to if travelled >= abs(distance) else self._from + math.copysign(travelled, distance)

    def busy(self) -> bool:
        return self.hanging or self.place() != self._to

    def position(self) -> float:
        self._maybe_lose_reply()
        return self.place()

    def status(self) -> AxisStatus:
        self._maybe_lose_reply()
        return AxisStatus(moving=self.busy(), homed=self.homed, in_position=not self.busy(), fault=self.fault)

    def home(self) -> None:
        fate = self.homing_script.popleft() if self.homing_script else "ok"
        self.bench.log.append(f"home {self.name}")
        if fate == "lost_dropped":
            raise CommunicationError(self.name, "no reply")
        if fate == "ignored":
            return
        self.homed = True

    def start_move(self, target: float) -> None:
        fate = self.always or (self.script.popleft() if self.script else "ok")
        self.commands.append(target)
        self._watch(target)
        here = self.place()
        if fate == "refused":
            raise CommandRefused(self.name, "outside the soft limits")
        if fate == "lost_dropped":
            raise CommunicationError(self.name, "no reply")
        if fate == "alarm":
            self.fault = "overload (30h)"
            return
        if fate == "lost_zero":
            self.homed = False
            return
        if fate == "ignored":
            return
        self._from, self._began = here, self.bench.clock.monotonic()
        self._to = (here + target) / 2 if fate == "half" else target
        self.hanging = fate == "hangs"
        if fate == "lost_taken":
            raise CommunicationError(self.name, "no reply")

    def stop(self) -> None:
        self._maybe_lose_reply()
        here = self.place()
        self._from = self._to = here
        self.hanging = False

    def make_safe(self) -> None:
        self.stop()

    def _watch(self, target: float) -> None:
        if self.bench.shutter.opened:
            self.bench.wrong.append(f"{self.name} was told to move with the shutter open")
        if not self.homed:
            self.bench.wrong.append(f"{self.name} was told to move before it was homed")
        if not self.limits.lower <= target <= self.limits.upper:
            self.bench.wrong.append(f"{self.name} was sent beyond its limits, to {target}")
        if any(axis.busy() for axis in self.bench.axes.values()):
            self.bench.wrong.append(f"{self.name} was told to move while an arm moved")


class FakeSource(FakeDevice):
    def __init__(self, bench: Bench) -> None:
        super().__init__("source")
        self.bench = bench
        self.on, self._power, self.trouble, self.fed = False, 0.0, "", 0

    def emission(self) -> bool:
        self._maybe_lose_reply()
        return self.on

    def set_emission(self, on: bool) -> None:
        self._maybe_lose_reply()
        self.on = on and not self.trouble

    def power(self) -> float:
        return self._power

    def set_power(self, fraction: float) -> None:
        self._power = fraction

    def fault(self) -> str:
        return self.trouble

    def keep_alive(self) -> None:
        self.fed += 1

    def make_safe(self) -> None:
        self.on = False

    def trip(self, trouble: str) -> None:
        """The interlock opens."""
        self.trouble, self.on = trouble, False


class FakeSelector(FakeDevice):
    def __init__(self) -> None:
        super().__init__("selector")
        self.nm = 0.0

    def set_wavelength(self, wavelength: float) -> None:
        self._maybe_lose_reply()
        self.nm = wavelength

    def wavelength(self) -> float:
        return self.nm


class FakeShutter(FakeDevice):
    def __init__(self, bench: Bench) -> None:
        super().__init__("shutter")
        self.bench, self.opened, self.stuck = bench, False, False

    def is_open(self) -> bool:
        self._maybe_lose_reply()
        return self.opened

    def open(self) -> None:
        self._maybe_lose_reply()
        self.opened = True

    def shut(self) -> None:
        self._maybe_lose_reply()
        self.opened = self.opened and self.stuck

    def make_safe(self) -> None:
        self.shut()


class FakeAmplifier(FakeDevice):
    gains = (1e4, 1e5, 1e6, 1e7, 1e8)
    settling_time = 0.1

    def __init__(self) -> None:
        super().__init__("amplifier")
        self._gain = 0.0
        self.overloaded = False

    def gain(self) -> float:
        self._maybe_lose_reply()
        return self._gain

    def set_gain(self, gain: float) -> None:
        assert gain in self.gains
        self._gain = gain

    def overload(self) -> bool:
        return self.overloaded


class FakeDetector(FakeDevice):
    """Ten volts full scale; above that it reports an overload."""

    full_scale = 10.0

    def __init__(self, bench: Bench, seed: int = 1) -> None:
        super().__init__("detector")
        self.bench = bench
        self.offset, self.noise = 0.002, 1e-4
        self.bursts = 0
        self.on_read = lambda: None
        self._random = np.random.default_rng(seed)

    def read(self, samples: int) -> Reading:
        self.on_read()
        self._maybe_lose_reply()
        self.bursts += 1
        volts = self.bench.current() * self.bench.amplifier.gain() + self.offset
        if volts > 1.2 * self.full_scale:
            return Reading((9.9e37,) * samples, overload=True)
        noise = self._random.normal(0.0, self.noise, samples)
        return Reading(tuple(float(volts + n) for n in noise))

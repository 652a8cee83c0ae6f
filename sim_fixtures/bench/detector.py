"""From the light on the photodiode to volts at the meter: amplifier, noise, offset, saturation."""

from __future__ import annotations

import hashlib
import math
from collections import Counter
from dataclasses import dataclass

import numpy as np

from instrument.facility import Budgeted
from instrument.quality.budget_rows import FromSamples
from sim_fixtures.bench.clock import Time

#: Readings whose mean the budget's row "measurement noise" is about.
READINGS_OF_A_POINT = 9


@dataclass(frozen=True)
class Electronics:
    """Constants of the detector chain.

    Attributes
    ----------
    current
        Photocurrent, A, at ``nominal_power`` for a flux of 1 (ideal white sample, reference geometry).
    nominal_power
        Source power, fraction of full power, that ``current`` belongs to.
    offset, readout_noise
        Volts at the amplifier's output without light, and their scatter from reading to reading.
    reference_noise
        Relative scatter of a reading of the reference standard and of other pieces than the sample.
    saturation
        Volts at which the amplifier's output clips and its overload line rises.
    settling
        Time constant, s, of a change of gain.
    """

    current: float = 1e-6
    nominal_power: float = 0.6
    offset: float = 2e-4
    readout_noise: float = 5e-6
    reference_noise: float = 3e-4
    saturation: float = 10.0
    settling: float = 0.02


def gain_of_code(code: int) -> float:
    """Gain (V/A) of the FEMTO DLPCA-200 for its four bits ``mode<<3 | G3<<2 | G2<<1 | G1``.

    High speed (mode 0) runs from 1e5 to 1e11, low noise (mode 1) from 1e3 to 1e9; the codes 7 and 15 do not
    exist: the amplifier then keeps its highest range.
    """
    mode, range_code = divmod(code & 0xF, 8)
    return 10.0 ** (min(range_code, 6) + (3 if mode else 5))


class Amplifier:
    """Transimpedance amplifier with gain bits; code 0 (high speed, 1e5 V/A) while no line is driven."""

    def __init__(self, clock: Time, settling: float) -> None:
        self._clock, self._settling = clock, settling
        self.code = 0
        self._previous = self.gain
        self._changed = -math.inf

    @property
    def gain(self) -> float:
        """Gain that the bits select, V/A."""
        return gain_of_code(self.code)

    def select(self, code: int) -> None:
        """Set the four bits."""
        if code != self.code:
            self._previous = self.effective_gain()
            self.code, self._changed = code, self._clock.now()

    def effective_gain(self) -> float:
        """Gain at this moment; a change settles exponentially, and exactly after ten time constants."""
        elapsed = self._clock.now() - self._changed
        if elapsed > 10 * self._settling:
            return self.gain
        return self.gain + (self._previous - self.gain) * math.exp(-elapsed / self._settling)


class Noise:
    """Seeded noise of the readings.

    A draw depends on the seed, on what is read (the key) and on how many times it has been read, never on the
    order of threads or on the wall clock: a run that sends the same commands reads the same values.
    """

    def __init__(self, seed: int, measurement_noise: Budgeted | FromSamples, electronics: Electronics) -> None:
        self._seed, self._electronics = seed, electronics
        if isinstance(measurement_noise, str):  # the facility leaves it to the samples; something has to scatter
            measurement_noise = electronics.reference_noise / math.sqrt(READINGS_OF_A_POINT)
        pair = measurement_noise if isinstance(measurement_noise, tuple) else (measurement_noise,) * 2
        self._best, self._worst = pair
        self._count: Counter[tuple[object, ...]] = Counter()

    def relative(self, mounted: str, sensor_zenith: float) -> float:
        """Relative standard deviation of one reading.

        The mean of nine follows the budget: a + (b - a)(|sensor zenith|/80)^2 (data contract, Facility).
        """
        if mounted != "sample":
            return self._electronics.reference_noise
        of_mean = self._best + (self._worst - self._best) * (abs(sensor_zenith) / 80.0) ** 2
        return math.sqrt(READINGS_OF_A_POINT) * of_mean

    def draw(self, key: tuple[object, ...]) -> tuple[float, float]:
        """Two standard normal numbers for the next reading of ``key``."""
        number = self._count[key]
        self._count[key] += 1
        digest = hashlib.blake2b(repr((self._seed, key, number)).encode(), digest_size=8).digest()
        first, second = np.random.default_rng(int.from_bytes(digest, "big")).standard_normal(2)
        return float(first), float(second)


def output_voltage(photocurrent: float, gain: float, electronics: Electronics, readout: float = 0.0) -> float:
    """Volts at the amplifier's output, clipped at saturation; ``readout`` is additive noise in V."""
    volts = photocurrent * gain + electronics.offset + readout
    return min(max(volts, -electronics.saturation), electronics.saturation)

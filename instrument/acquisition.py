"""Taking a reading: light on the sample, the right gain, nine samples, then the same in the dark.

A burst that saturates or overloads is never averaged: the gain goes down and the burst is taken anew, and where no
lower gain is left there is no reading. Between the level that sends the gain down and the one that sends it up lies
a decade and more, so that noise never makes it change to and fro. A burst through which the volts still drift is
taken anew; outliers are noted and kept.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from drivers.clock import Clock
from drivers.errors import DeviceFault
from drivers.interfaces import Amplifier, Detector, Reading, Shutter
from instrument.control import Controls, ask, ensure
from instrument.hindrances import DetectorSaturated, LightUnstable, scatter
from instrument.quality.bursts import MOST, SIGNIFICANCE, critical_values, outlying, trend
from instrument.run_schema import REPEATED
from instrument.settings import AcquisitionSettings

#: Voltmeters report an overload as 9.9e37.
_NO_NUMBER = 1e30


class NoReading(DeviceFault):
    """The detector works, and yet what it says is no measurement of this geometry."""


class Overloaded(DetectorSaturated, NoReading):
    """There is more light than the lowest gain can take: whatever number there is, it is too small."""


class NoLight(NoReading):
    """With the shutter open the detector reads no more than with it closed."""


@dataclass(frozen=True)
class Burst:
    """One reading: volts with light, mean volts without, the gain (V/A) of both, and quality flags.

    ``dark_samples`` are the volts without light that ``dark`` is the mean of, where they are known.
    """

    samples: tuple[float, ...]
    dark: float
    gain: float
    quality_flag: int
    dark_samples: tuple[float, ...] = ()

    @property
    def current(self) -> float:
        """Photocurrent, A."""
        return (sum(self.samples) / len(self.samples) - self.dark) / self.gain

    @property
    def relative_standard_error(self) -> float:
        """Standard error of the mean of the samples, less that of the dark ones, over the photocurrent.

        nan for a single sample.
        """
        if len(self.samples) < 2:
            return math.nan
        error = math.hypot(_standard_error(self.samples), _standard_error(self.dark_samples))
        return error / abs(self.current * self.gain) if self.current else math.inf


class Acquisition:
    """Reads the detector.

    Parameters
    ----------
    detector, amplifier, shutter
        The devices.
    clock
        Laboratory time.
    controls
        Consulted while waiting.
    note
        Records what a person should find later.
    settings
        Times and thresholds.
    """

    def __init__(
        self,
        detector: Detector,
        amplifier: Amplifier,
        shutter: Shutter,
        clock: Clock,
        controls: Controls,
        note: Callable[[str], None],
        settings: AcquisitionSettings,
    ) -> None:
        self._detector, self._amplifier, self._shutter = detector, amplifier, shutter
        self._clock, self._controls, self._note, self._settings = clock, controls, note, settings
        self._last_duration = 0.0
        self._repeats = 0
        self._gain_known = False

    @property
    def last_duration(self) -> float:
        """Laboratory seconds that the last reading took; 0 before the first."""
        return self._last_duration

    @property
    def darkest(self) -> float:
        """What a reading with the shutter closed may reach at the lowest gain, fraction of full scale."""
        return self._settings.darkest

    def dark_level(self) -> float:
        """Volts with the shutter closed, at the lowest gain.

        Raises
        ------
        DeviceFault
            If the meter says overload.
        """
        self._set_gain(min(self._amplifier.gains))
        self._gain_known = True
        return _mean(self._dark())

    def forget_gain(self) -> None:
        """The amplifier may have been without power: its gain is chosen anew."""
        self._gain_known = False

    def shut(self) -> None:
        """Close the shutter and make sure that it is closed."""
        ensure(self._shutter.shut, lambda: not ask(self._shutter.is_open), "shutter")

    def measure(self, samples: int) -> Burst:
        """Take one reading; the shutter is closed before and after, however it ends.

        Raises
        ------
        Overloaded
            If the light saturates the detector at the lowest gain.
        NoLight
            If the open shutter makes no difference.
        LightUnstable
            If the samples scatter as no noise does.
        CommunicationError
            If a device does not answer.
        """
        began = self._clock.monotonic()
        self._repeats = 0
        try:
            ensure(self._shutter.open, lambda: ask(self._shutter.is_open), "shutter")
            self._controls.sleep(self._settings.settling)
            reading, gain = self._in_range(samples)
        finally:
            self.shut()
        self._controls.sleep(self._settings.settling)
        dark = self._dark()
        self._last_duration = self._clock.monotonic() - began
        burst = Burst(reading.samples, _mean(dark), gain, REPEATED if self._repeats > 0 else 0, dark)
        if burst.current <= 0:
            # Every uncertainty is relative to the reading: such a point could not even be marked as uncertain.
            light = sum(burst.samples) / len(burst.samples)
            raise NoLight(
                "detector",
                f"no light: {light:.6g} V with the shutter open, {burst.dark:.6g} V with it closed",
                "look at shutter, beam path, sample and the detector's cable",
            )
        self._require_stable(burst)
        self._note_outliers(burst.samples, "with light")
        self._note_outliers(burst.dark_samples, "in the dark")
        return burst

    def _dark(self) -> tuple[float, ...]:
        dark = self._read(self._settings.dark_samples)
        if dark.overload or not _numbers(dark):
            raise DeviceFault("detector", "overload with the shutter closed", "look for stray light or a broken cable")
        return dark.samples

    def _note_outliers(self, samples: tuple[float, ...], which: str) -> None:
        if len(samples) < MOST + 2:
            return
        for number in outlying(samples, critical_values(len(samples), MOST, SIGNIFICANCE)):
            self._note(
                f"sample {number + 1} of {len(samples)} {which} is an outlier: {samples[number]:.6g} V, the mean of all"
                f" is {_mean(samples):.6g} V; kept"
            )

    def _require_stable(self, burst: Burst) -> None:
        light = burst.current * burst.gain
        spread = scatter(burst.samples, burst.dark)
        if spread > self._settings.unstable and light > self._settings.noise_floor * self._detector.full_scale:
            raise LightUnstable(
                "source",
                f"the samples of one reading scatter by {100 * spread:.0f} % of the light"
                f" (at most {100 * self._settings.unstable:g} % are expected)",
                "look at the source's warm-up, its alignment into the fibre, and loose parts in the beam",
            )

    def _in_range(self, samples: int) -> tuple[Reading, float]:
        """A burst at the gain that suits the light, taken when everything has settled."""
        gains = sorted(self._amplifier.gains)
        gain = self._present_gain(gains[0])
        ceiling_gain = math.inf  # the lowest gain that proved too high
        settling = self._settings.settling_attempts
        for _ in range(2 * len(gains) + settling):
            reading = self._read(samples)
            if self._too_high(reading):
                ceiling_gain = min(ceiling_gain, gain)
                better = max((g for g in gains if g < gain), default=gain)
            else:
                better = self._higher(gains, gain, ceiling_gain, reading)
            if better != gain:
                self._note_gain(gain, better, reading)
                gain = better
                self._set_gain(gain)
                continue
            self._require_range(reading, gain)
            settling -= 1
            if self._settled(reading, settling):
                return reading, gain
        raise LightUnstable("source", "no gain suits the light for long enough to read it", "look at the source")

    def _require_range(self, reading: Reading, gain: float) -> None:
        """What is clipped has no mean: it is said, and never averaged."""
        level = max(abs(sample) for sample in reading.samples)
        if reading.overload or not _numbers(reading):
            seen = "overload"
        elif level >= self._detector.full_scale:
            seen = f"saturated, {level:.4g} V of {self._detector.full_scale:g} V,"
        else:
            return
        raise Overloaded("detector", f"{seen} at the lowest gain ({gain:g} V/A)", "reduce the power of the source")

    def _settled(self, reading: Reading, patience: int) -> bool:
        """Whether no trend is left in a burst, or no patience: after a change of gain or light the volts may drift."""
        change, significance = trend(reading.samples)
        level = max(abs(sample) for sample in reading.samples)
        if abs(significance) <= self._settings.drift_significance or abs(change) <= self._settings.drift * level:
            return True
        if patience > 0:
            self._controls.sleep(max(self._settings.settling, self._amplifier.settling_time))
            return False
        self._note(f"the volts still drift by {change:.3g} V during a burst; kept")
        return True

    def _present_gain(self, lowest: float) -> float:
        """The gain in use; before the first reading nobody knows it, and the lowest one is chosen."""
        if not self._gain_known:
            self._set_gain(lowest)
            self._gain_known = True
        return ask(self._amplifier.gain)

    def _higher(self, gains: list[float], gain: float, ceiling_gain: float, reading: Reading) -> float:
        """The highest gain that keeps the reading below target, where the present one wastes range."""
        level = max(abs(sample) for sample in reading.samples)
        if level >= self._settings.floor * self._detector.full_scale:
            return gain
        limit = self._settings.target * self._detector.full_scale
        fitting = [g for g in gains if gain < g < ceiling_gain and level * g / gain <= limit]
        return max(fitting, default=gain)

    def _set_gain(self, gain: float) -> None:
        ensure(
            lambda: self._amplifier.set_gain(gain),
            lambda: math.isclose(ask(self._amplifier.gain), gain, rel_tol=1e-9),
            "amplifier",
        )
        self._controls.sleep(self._amplifier.settling_time)

    def _too_high(self, reading: Reading) -> bool:
        level = max(abs(sample) for sample in reading.samples)
        return reading.overload or level > self._settings.ceiling * self._detector.full_scale

    def _read(self, samples: int) -> Reading:
        """A burst; asked for again after a lost reply, since reading changes nothing."""
        self._controls.checkpoint()

        def burst() -> Reading:
            self._repeats += 1
            reading = self._detector.read(samples)
            overload = reading.overload or ask(self._amplifier.overload)
            return Reading(reading.samples, overload)

        self._repeats -= 1
        return ask(burst, self._settings.read_attempts)

    def _note_gain(self, old: float, new: float, reading: Reading) -> None:
        level = max(abs(sample) for sample in reading.samples)
        seen = "overload" if reading.overload or level > _NO_NUMBER else f"{level:.4g} V"
        self._note(f"gain {old:g} -> {new:g} V/A ({seen})")


def _numbers(reading: Reading) -> bool:
    return all(math.isfinite(sample) and abs(sample) < _NO_NUMBER for sample in reading.samples)


def _mean(samples: tuple[float, ...]) -> float:
    return sum(samples) / len(samples)


def _standard_error(samples: tuple[float, ...]) -> float:
    """Of the mean; 0 where there is nothing to tell it from."""
    count = len(samples)
    if count < 2:
        return 0.0
    mean = _mean(samples)
    return math.sqrt(sum((sample - mean) ** 2 for sample in samples) / (count - 1) / count)

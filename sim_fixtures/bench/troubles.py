"""What can be wrong with the simulated instrument's radiometry, for the procedures that are to find it.

None of it is there unless asked for (:meth:`sim_fixtures.room.Room.control`, ``trouble``). Each is written down here as
what it does to light or volts; nothing is shared with the procedures.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from sim_fixtures.bench.flux import Geometry

#: Output, V, at which ``nonlinearity`` is reached.
FULL_OUTPUT = 10.0


@dataclass
class Troubles:
    """Faults of the radiometry.

    Attributes
    ----------
    nonlinearity
        Relative growth of the response from nothing to 10 V at the output: volts times 1 + nonlinearity volts/10.
    gain_error_1e5, gain_error_1e6, gain_error_1e7
        Relative error of a range of the amplifier.
    wavelength_error_nm
        Wavelength that passes the filter, less the one it was told.
    sensor_zenith_offset_deg
        True sensor zenith less the one the arm shows.
    sensor_runout_mm
        Distance of the sensor's axis from the optical centre, towards growing sensor zenith.
    stage_tilt_deg
        The reference's normal leans so far towards sensor azimuth 0.
    warm_up_share, warm_up_time_s
        After switching on the source is brighter by this share, fading with this time constant.
    drift_per_hour
        Relative change of the source's power in an hour, since it was switched on.
    flicker
        Relative change of the source's power to and fro, with a period of 97 s.
    dark_offset_v, light_leak_v
        Volts at the output at any time; and while the source emits, behind the closed shutter.
    control_change
        Relative change of the control sample's reflectance.
    """

    nonlinearity: float = 0.0
    gain_error_1e5: float = 0.0
    gain_error_1e6: float = 0.0
    gain_error_1e7: float = 0.0
    wavelength_error_nm: float = 0.0
    sensor_zenith_offset_deg: float = 0.0
    sensor_runout_mm: float = 0.0
    stage_tilt_deg: float = 0.0
    warm_up_share: float = 0.0
    warm_up_time_s: float = 600.0
    drift_per_hour: float = 0.0
    flicker: float = 0.0
    dark_offset_v: float = 0.0
    light_leak_v: float = 0.0
    control_change: float = 0.0

    def set(self, name: str, value: float) -> None:
        """Bring a trouble about, or end it with its first value.

        Raises
        ------
        ValueError
            If there is no such trouble, or the value is no number.
        """
        names = [field.name for field in fields(self)]
        if name not in names:
            raise ValueError(f"trouble: found {name!r}; expected one of {names}")
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise ValueError(f"trouble: {name}: found {value!r}; expected a finite number")
        setattr(self, name, float(value))

    def brightness(self, seconds_on: float) -> float:
        """Power of the source over what it was told, so long after it was switched on."""
        warm_up = self.warm_up_share * math.exp(-seconds_on / self.warm_up_time_s)
        flicker = self.flicker * math.sin(2 * math.pi * seconds_on / 97.0)
        return (1 + warm_up) * (1 + self.drift_per_hour * seconds_on / 3600.0) * (1 + flicker)

    def gain(self, nominal: float) -> float:
        """What the amplifier really does, V/A."""
        error: float = getattr(self, f"gain_error_1e{round(math.log10(nominal))}", 0.0) if nominal > 0 else 0.0
        return nominal * (1 + error)

    def response(self, volts: float) -> float:
        """Volts at the output for those of a linear detector."""
        return volts * (1 + self.nonlinearity * volts / FULL_OUTPUT)

    def leak(self, emitting: bool) -> float:
        """Volts that are there without light on the sample."""
        return self.dark_offset_v + (self.light_leak_v if emitting else 0.0)

    def true(self, geometry: Geometry) -> Geometry:
        """Geometry behind the one that the arms show."""
        return geometry._replace(
            sensor_zenith=geometry.sensor_zenith + self.sensor_zenith_offset_deg,
            wavelength=geometry.wavelength + self.wavelength_error_nm,
        )

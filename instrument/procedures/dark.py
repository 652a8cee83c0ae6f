"""Dark level of every gain, and light that passes the closed shutter."""

from __future__ import annotations

import math

from instrument.procedures.reading import Reader, beyond, gain_name
from instrument.procedures.results import Finding, Quantity
from instrument.procedures.room import Room


def dark_level(room: Room, samples: int = 100, leak: bool = True) -> Finding:
    """Read the detector with the shutter closed, the source first off and then on.

    Nothing moves. Fails where a level exceeds what a scan's preflight accepts, or where the source makes a
    difference behind the closed shutter.

    Parameters
    ----------
    leak
        Look at the closed shutter with the source on, too.
    """
    reader = Reader(room, samples)
    room.station.acquisition.shut()
    room.station.light.off()
    values: dict[str, Quantity] = {}
    wrong, readings = [], []
    largest = room.settings.acquisition.darkest * reader.full_scale
    off = {}
    for gain in reader.gains:
        volts, u = off[gain] = reader.dark(gain)
        values[f"dark {gain_name(gain)}"] = Quantity(value=volts, u=u, unit="V")
        readings.append({"gain": gain, "emission": False, "volts": volts, "u": u})
        if abs(volts) > largest:
            wrong.append(f"{volts:.3g} V at {gain_name(gain)} V/A (at most {largest:.3g} V)")
    if leak:
        room.light()
        for gain in reader.gains:
            volts, u = reader.dark(gain)
            through, u_through = volts - off[gain][0], math.hypot(u, off[gain][1])
            values[f"leak {gain_name(gain)}"] = Quantity(value=through, u=u_through, unit="V")
            readings.append({"gain": gain, "emission": True, "volts": volts, "u": u})
            # Volts of leak smaller than a hundred-thousandth of full scale change nothing that is measured.
            if beyond(through, u_through, 5e-6 * reader.full_scale):
                wrong.append(f"{through:.3g} V of light through the closed shutter at {gain_name(gain)} V/A")
    return Finding(
        verdict="failed" if wrong else "passed",
        summary="; ".join(wrong) or f"dark at every gain, at most {max(abs(v) for v, _ in off.values()):.2g} V",
        values=values,
        advice=("look for stray light, the shutter's blade, and the amplifier's offset",) if wrong else (),
        readings=tuple(readings),
    )

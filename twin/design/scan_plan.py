"""A scan plan of chosen planes, in the form that ``goniotwin plan`` and ``goniotwin scan`` read."""

from __future__ import annotations

from pathlib import Path

import tomli_w

from instrument.facility import Facility
from instrument.output import write_result
from instrument.plan import Plan, read_plan


def write_plan(
    path: Path,
    facility: Facility,
    planes: list[tuple[float, float]],
    *,
    title: str,
    wavelength: float,
    zenith_step: float = 5.0,
    furthest_zenith: float = 80.0,
) -> Plan:
    """Write the plan of zenith sweeps over planes, and read it back as the instrument will.

    Parameters
    ----------
    planes
        Illumination zenith and sensor azimuth of each, degree.
    furthest_zenith
        The sweep ends here or at the limit of the arm.
    """
    low, high = facility.arms.sensor_zenith
    limits = max(low, -furthest_zenith), min(high, furthest_zenith)
    steps = range(int(-(-limits[0] // zenith_step)), int(limits[1] // zenith_step) + 1)
    sweep = {"start": steps[-1] * zenith_step, "stop": steps[0] * zenith_step, "step": -zenith_step}
    grids = [
        {
            "wavelength": [wavelength],
            "illumination_zenith": [light],
            "sensor_azimuth": sorted(azimuth for illumination, azimuth in planes if illumination == light),
            "sensor_zenith": sweep if len(steps) > 1 else [steps[0] * zenith_step],
        }
        for light in sorted({light for light, _ in planes})
    ]
    form = {"version": 1, "title": title, "samples": 9, "direction": "unidirectional", "angle_unit": "degree"}
    comment = "# Planes chosen for what they tell about the sample; goniotwin plan shows what this means.\n"
    write_result(path, (comment + tomli_w.dumps(form | {"grid": grids})).encode())
    return read_plan(path, facility)

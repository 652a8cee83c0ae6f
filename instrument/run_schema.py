"""Names, dimensions and units of the run file and of the prediction (data contract, sections Run file, Prediction)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from instrument.budget import COMPONENTS

#: Version of the CF conventions that files follow.
CONVENTIONS = "CF-1.11"


@dataclass(frozen=True)
class Variable:
    """One variable of the data contract; ``unit`` None where it has none (times, flags)."""

    name: str
    dims: tuple[str, ...]
    unit: str | None
    long_name: str
    coordinate: bool = False
    attributes: dict[str, Any] = field(default_factory=dict)


def _table(*variables: Variable) -> dict[str, Variable]:
    return {variable.name: variable for variable in variables}


GEOMETRY = _table(
    Variable("wavelength", ("point",), "nm", "wavelength", True, {"standard_name": "radiation_wavelength"}),
    Variable("illumination_zenith", ("point",), "degree", "commanded illumination zenith, signed", True),
    Variable("illumination_azimuth", ("point",), "degree", "commanded illumination azimuth", True),
    Variable("sensor_zenith", ("point",), "degree", "commanded sensor zenith, signed", True),
    Variable("sensor_azimuth", ("point",), "degree", "commanded sensor azimuth", True),
)
RESULT = _table(
    Variable("brf", ("point",), "1", "bidirectional reflectance factor"),
    Variable("u_brf", ("point",), "1", "combined standard uncertainty (k=1) of brf"),
)
READINGS = _table(
    Variable("time", ("point",), None, "when the readings were taken", True, {"standard_name": "time"}),
    Variable("signal", ("point", "sample"), "V", "detector readings"),
    Variable("dark", ("point",), "V", "shutter-closed reading that belongs to the point"),
    Variable("gain", ("point",), "V A-1", "transimpedance gain"),
    Variable("reference_signal", ("reference", "sample"), "V", "detector readings of the reference sample"),
    Variable("reference_sensor_azimuth", ("reference",), "degree", "sensor azimuth of the reference readings"),
    Variable("reference_gain", ("reference",), "V A-1", "transimpedance gain of the reference readings"),
    Variable("reference_dark", ("reference",), "V", "shutter-closed reading of the reference readings"),
    Variable("reference_time", ("reference",), None, "when the reference readings were taken"),
    Variable(
        "quality_flag",
        ("point",),
        None,
        "what is the matter with a point",
        attributes={"flag_meanings": "saturated overload shadowed repeated"},
    ),
)
COMPONENT_VARIABLES = _table(
    *(
        Variable(name, ("point",), "1", f"standard uncertainty (k=1) of brf: {row.replace('_', ' ')}")
        for row, name in COMPONENTS.items()
    )
)
PREDICTION = _table(
    Variable("u_brf_monte_carlo", ("point",), "1", "standard error of the ray tracer (k=1)"),
)

#: What every file must have.
REQUIRED = GEOMETRY | RESULT
#: Everything that a run file may have under a fixed name.
RUN = REQUIRED | READINGS | COMPONENT_VARIABLES
#: Bits of ``quality_flag``.
SATURATED, OVERLOAD, SHADOWED, REPEATED = FLAG_MASKS = (1, 2, 4, 8)

#: Global attributes of a run file: name, type, and what a file without it does not tell.
GLOBALS: dict[str, tuple[type, str]] = {
    "reference_reflectance_factor": (float, "the readings cannot be turned into reflectance factors again"),
    "reference_illumination_zenith": (float, "the readings cannot be turned into reflectance factors again"),
    "reference_sensor_zenith": (float, "the readings cannot be turned into reflectance factors again"),
    "scan_direction": (str, "backlash cannot be told from an angular zero error"),
}
SCAN_DIRECTIONS = ("unidirectional", "serpentine")

#: Spellings of a unit that mean the same.
UNIT_SPELLINGS: dict[str, tuple[str, ...]] = {
    "degree": ("degree", "degrees", "deg", "arc_degree", "angular_degree"),
    "nm": ("nm", "nanometer", "nanometers", "nanometre", "nanometres"),
    "1": ("1", "", "dimensionless", "unitless"),
    "V": ("V", "volt", "volts"),
    "V A-1": ("V A-1", "V/A", "V A^-1", "V A**-1", "ohm"),
}
#: Names that other programs give to the same thing.
ALIASES: dict[str, tuple[str, ...]] = {
    "wavelength": ("wl", "lambda", "wavelength_nm"),
    "illumination_zenith": ("theta_ill", "theta_i", "sza", "illumination_zenith_angle", "incident_zenith"),
    "illumination_azimuth": ("phi_ill", "phi_i", "saa", "illumination_azimuth_angle", "incident_azimuth"),
    "sensor_zenith": ("theta_sen", "theta_r", "theta_v", "vza", "sensor_zenith_angle", "viewing_zenith"),
    "sensor_azimuth": ("phi_sen", "phi_r", "phi_v", "vaa", "sensor_azimuth_angle", "viewing_azimuth"),
    "brf": ("R", "reflectance_factor", "bidirectional_reflectance_factor", "BRF"),
    "u_brf": ("uncertainty", "u_R", "brf_uncertainty", "sigma_brf"),
}

"""What is known of the instrument and its standard uncertainties: the form ``facility.toml``.

Lengths in mm, angles in degree, uncertainties k = 1 (data contract, section Facility).
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from instrument.forms import Form, read_form

Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Relative = Annotated[float, Field(ge=0, lt=1)]
AngleRange = tuple[float, float]
#: One relative standard uncertainty, or one for the best and one for the worst geometry.
Budgeted = Relative | tuple[Relative, Relative]


class Beam(Form):
    """The illumination: a beam through an iris."""

    diameter: Positive | Literal["unbounded"]
    profile: Literal["gaussian", "tophat"] = "gaussian"
    radius_1_e2: Positive | None = None
    divergence: NonNegative = 0.0
    u_divergence: NonNegative = 0.0
    u_diameter: NonNegative = 0.0

    @model_validator(mode="after")
    def _gaussian_needs_a_radius(self) -> Beam:
        if self.profile == "gaussian" and self.diameter != "unbounded" and self.radius_1_e2 is None:
            raise ValueError("a gaussian beam needs radius_1_e2 (mm)")
        return self


class Sensor(Form):
    """A target disc on the optical centre, seen from a collecting mirror disc; ``mirror_diameter`` 0: parallel."""

    target_diameter: Positive
    target_shape: Literal["disc", "horizontal_disc"] = "disc"
    mirror_diameter: NonNegative = 0.0
    mirror_distance: Positive = 204.7
    u_target_diameter: NonNegative = 0.0


class Arms(Form):
    """Travel of the arms and how well their angles are known."""

    illumination_zenith: AngleRange = (-90.0, 90.0)
    sensor_zenith: AngleRange = (-90.0, 90.0)
    sensor_azimuth: AngleRange = (0.0, 180.0)
    shadow_half_angle: NonNegative = 5.0
    u_illumination_zenith: NonNegative = 0.0
    u_sensor_zenith: NonNegative = 0.0
    u_sensor_azimuth: NonNegative = 0.0

    @model_validator(mode="after")
    def _ranges_ascend(self) -> Arms:
        for name in ("illumination_zenith", "sensor_zenith", "sensor_azimuth"):
            lower, upper = getattr(self, name)
            if not lower < upper:
                raise ValueError(f"{name} must run from low to high, found [{lower}, {upper}]")
        return self


class SamplePlacement(Form):
    """Standard uncertainties of the placement of the sample."""

    u_height: NonNegative = 0.0
    u_offset: NonNegative = 0.0
    u_azimuth: NonNegative = 0.0
    u_tilt: NonNegative = 0.0


class Reference(Form):
    """The reference measurement before each run."""

    illumination_zenith: float = 0.0
    sensor_zenith: float = 15.0
    sensor_azimuth: Annotated[tuple[float, ...], Field(min_length=1)] = (0.0, 45.0, 90.0, 135.0)
    reflectance_factor: Positive
    u_relative: Relative


class Budget(Form):
    """Relative standard uncertainties of the BRF; pairs run from the best to the worst geometry."""

    measurement_noise: Budgeted = 0.0
    instrument_stability: Budgeted = 0.0
    wavelength: Budgeted = 0.0
    straylight: Budgeted = 0.0
    detector_linearity: Budgeted = 0.0
    beam_and_placement: Budgeted = 0.0
    illumination_zenith: Budgeted = 0.0
    sensor_zenith: Budgeted = 0.0
    sensor_azimuth: Budgeted = 0.0
    surface_level: Budgeted = 0.0
    polarization: Budgeted = 0.0
    reference_material: Budgeted = 0.0


class Facility(Form):
    """The whole of ``facility.toml``."""

    name: str
    beam: Beam
    sensor: Sensor
    arms: Arms
    sample: SamplePlacement
    reference: Reference
    budget: Budget


#: Stands in where no facility is named: arms of full travel, the paper's cone and reference geometry.
UNKNOWN_FACILITY = Facility(
    name="",
    beam=Beam(diameter="unbounded", profile="tophat"),
    sensor=Sensor(target_diameter=10.8),
    arms=Arms(),
    sample=SamplePlacement(),
    reference=Reference(reflectance_factor=1.0, u_relative=0.0),
    budget=Budget(),
)


def read_facility(path: Path) -> Facility:
    """Read ``facility.toml``; an :class:`~instrument.errors.InputError` names every wrong key."""
    return read_form(path, Facility)

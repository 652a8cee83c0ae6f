"""What is known of the instrument and its standard uncertainties: the form ``facility.toml``.

Lengths in mm, angles in degree, uncertainties k = 1 (data contract, section Facility).
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, PrivateAttr, model_validator

from instrument.beam_image import BeamImage, read_beam_image
from instrument.files import beside
from instrument.forms import Form, read_form
from instrument.quality.budget_rows import Correlations, DegreesOfFreedom, FromSamples, FromSlope
from instrument.reference_standard import ReferenceStandard

Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Relative = Annotated[float, Field(ge=0, lt=1)]
AngleRange = tuple[float, float]
_ARMS = ("illumination_zenith", "sensor_zenith", "sensor_azimuth")
#: What an instrument may have beside its arms.
STAGES = ("sample_rotation", "polarizer")
#: One relative standard uncertainty, or one for the best and one for the worst geometry.
Budgeted = Relative | tuple[Relative, Relative]


class Beam(Form):
    """The illumination: a beam through an iris.

    Iris and gaussian may be elliptic: ``diameter`` and ``radius_1_e2`` then belong to a first axis, the keys that end
    in ``_across`` to a second one across it. ``orientation`` turns the first axis, and the picture of a beam profiler,
    from the direction of growing illumination zenith towards that of growing azimuth.
    """

    diameter: Positive | Literal["unbounded"]
    diameter_across: Positive | None = None
    profile: Literal["gaussian", "tophat", "image"] = "gaussian"
    radius_1_e2: Positive | None = None
    radius_1_e2_across: Positive | None = None
    orientation: float = 0.0
    image: str | None = None
    pixel_pitch: Positive | None = None
    image_axis: Literal["middle", "centroid"] = "middle"
    divergence: NonNegative = 0.0
    u_divergence: NonNegative = 0.0
    u_diameter: NonNegative = 0.0
    _picture: BeamImage | None = PrivateAttr(default=None)

    @model_validator(mode="after")
    def _profile_is_known(self) -> Beam:
        if self.profile == "gaussian" and self.diameter != "unbounded" and self.radius_1_e2 is None:
            raise ValueError("a gaussian beam needs radius_1_e2 (mm)")
        if self.radius_1_e2_across is not None and (self.profile != "gaussian" or self.radius_1_e2 is None):
            raise ValueError("radius_1_e2_across belongs to a gaussian beam with radius_1_e2 (mm)")
        if self.diameter_across is not None and self.diameter == "unbounded":
            raise ValueError("diameter_across (mm) needs a diameter (mm)")
        if self.profile == "image" and self.image is None:
            raise ValueError("a beam of profile image needs image, the file of its picture")
        if self.profile != "image" and (self.image is not None or self.pixel_pitch is not None):
            raise ValueError('image and pixel_pitch belong to profile = "image"')
        return self

    @property
    def picture(self) -> BeamImage | None:
        """The irradiance where the profile is an image."""
        if self.profile == "image" and self._picture is None:
            raise ValueError(f"the image of the beam, {self.image}, was not read; use read_facility or with_picture")
        return self._picture

    def with_picture(self, picture: BeamImage) -> Beam:
        """This beam with the content of its image."""
        beam = self.model_copy()
        beam._picture = picture
        return beam

    @property
    def iris(self) -> tuple[float, float]:
        """Semi-axes of the iris, mm."""
        if self.diameter == "unbounded":
            return (math.inf, math.inf)
        return (self.diameter / 2, (self.diameter_across or self.diameter) / 2)

    @property
    def decay(self) -> tuple[float, float]:
        """Decay of the irradiance with the squared distance along the two axes, 1/mm2; 0 where it is not gaussian."""
        if self.profile != "gaussian" or self.radius_1_e2 is None:
            return (0.0, 0.0)
        return (2 / self.radius_1_e2**2, 2 / (self.radius_1_e2_across or self.radius_1_e2) ** 2)


class Sensor(Form):
    """A target disc on the optical centre, seen from a collecting mirror disc; ``mirror_diameter`` 0: parallel.

    A field stop limits what is seen besides: a circle about the axis, ``field_stop_distance`` from the optical
    centre, whose transmission falls linearly within ``field_stop_edge`` across its rim.
    """

    target_diameter: Positive
    target_shape: Literal["disc", "horizontal_disc"] = "disc"
    mirror_diameter: NonNegative = 0.0
    mirror_distance: Positive = 204.7
    field_stop_diameter: Positive | None = None
    field_stop_edge: NonNegative = 0.0
    field_stop_distance: NonNegative = 0.0
    u_target_diameter: NonNegative = 0.0

    @model_validator(mode="after")
    def _stop_is_possible(self) -> Sensor:
        if self.field_stop_diameter is None:
            if self.field_stop_edge or self.field_stop_distance:
                raise ValueError("field_stop_edge and field_stop_distance need field_stop_diameter (mm)")
            return self
        if self.target_shape != "disc":
            raise ValueError('a field stop needs target_shape = "disc"')
        if self.field_stop_edge > self.field_stop_diameter:
            raise ValueError("field_stop_edge: expected at most field_stop_diameter")
        if self.field_stop_distance > self.mirror_distance / 2:
            raise ValueError("field_stop_distance: expected at most half of mirror_distance")
        return self


class KeepOut(Form):
    """Where the arms, or an arm and something else, would touch: all three angles within these ranges (degree).

    An angle that is left out may be any.
    """

    name: str = "mechanical interference"
    illumination_zenith: AngleRange = (-360.0, 360.0)
    sensor_zenith: AngleRange = (-360.0, 360.0)
    sensor_azimuth: AngleRange = (-360.0, 360.0)

    @model_validator(mode="after")
    def _ranges_ascend(self) -> KeepOut:
        _require_ascending(self)
        if all(getattr(self, name) == (-360.0, 360.0) for name in _ARMS):
            raise ValueError("expected the range of at least one arm; this keeps all of them from moving")
        return self


class Arms(Form):
    """Travel of the arms, where they would touch, and how well their angles are known.

    ``illumination_azimuth`` is the range of a manual stage under the sample (``docs/calibration.md``);
    ``sample_rotation`` and ``polarizer`` are there where the instrument has a motorised stage or polariser.
    """

    illumination_zenith: AngleRange = (-90.0, 90.0)
    sensor_zenith: AngleRange = (-90.0, 90.0)
    sensor_azimuth: AngleRange = (0.0, 180.0)
    shadow_half_angle: NonNegative = 5.0
    keep_out: tuple[KeepOut, ...] = ()
    sample_rotation: AngleRange | None = None
    illumination_azimuth: AngleRange | None = None
    polarizer: AngleRange | None = None
    u_illumination_zenith: NonNegative = 0.0
    u_sensor_zenith: NonNegative = 0.0
    u_sensor_azimuth: NonNegative = 0.0

    @model_validator(mode="after")
    def _ranges_ascend(self) -> Arms:
        _require_ascending(self)
        if self.polarizer is not None and not (self.polarizer[0] <= 0.0 and self.polarizer[1] >= 90.0):
            raise ValueError(f"polarizer must reach 0 (p) and 90 degrees (s), found {list(self.polarizer)}")
        return self


def _require_ascending(ranges: Arms | KeepOut) -> None:
    for name in (*_ARMS, *STAGES, "illumination_azimuth"):
        if (found := getattr(ranges, name, None)) is None:
            continue
        lower, upper = found
        if not lower < upper:
            raise ValueError(f"{name} must run from low to high, found [{lower}, {upper}]")


class SamplePlacement(Form):
    """Standard uncertainties of the placement of the sample."""

    u_height: NonNegative = 0.0
    u_offset: NonNegative = 0.0
    u_azimuth: NonNegative = 0.0
    u_tilt: NonNegative = 0.0


class Reference(Form):
    """The reference measurement before each run, and every so many minutes during it (0: never).

    ``certificate`` names the file of the standard's certificate (``docs/calibration.md``), or holds it: then the
    certificate says the reflectance factor and its uncertainty at each wavelength.
    """

    illumination_zenith: float = 0.0
    sensor_zenith: float = 15.0
    sensor_azimuth: Annotated[tuple[float, ...], Field(min_length=1)] = (0.0, 45.0, 90.0, 135.0)
    reflectance_factor: Positive
    u_relative: Relative
    repeat_minutes: NonNegative = 0.0
    certificate: str | ReferenceStandard | None = None

    @property
    def standard(self) -> ReferenceStandard | None:
        """The certificate; None where there is none."""
        if isinstance(self.certificate, str):
            raise ValueError(f"the certificate of the reference, {self.certificate}, was not read; use read_facility")
        return self.certificate


#: Procedures that can be wanted again after a time, by the names of their results.
PROCEDURES = (
    "alignment",
    "control-sample",
    "dark-level",
    "gain-ratio",
    "intersection",
    "linearity",
    "warm-up",
    "wavelength",
)


class Calibration(Form):
    """Which procedures are wanted how often, and how the source is treated (``docs/calibration.md``).

    ``results`` is the folder of their results, seen from where the program runs. What is overdue or has failed is said
    before a scan, and keeps it from starting where ``overdue`` is ``refuse``.
    """

    results: str = "calibrations"
    due_days: dict[str, Positive] = Field(default_factory=dict)
    overdue: Literal["warn", "refuse"] = "warn"
    warm_up_minutes: NonNegative = 0.0
    emission_while_mounting: bool = False

    def __hash__(self) -> int:
        """A facility is a key of what has been computed for it; a dictionary cannot be part of one."""
        return hash((self.results, self.overdue, *sorted(self.due_days.items())))

    @model_validator(mode="after")
    def _procedures_are_known(self) -> Calibration:
        unknown = [name for name in self.due_days if name not in PROCEDURES]
        if unknown:
            raise ValueError(f"due_days: no procedure {unknown[0]!r}; expected some of {', '.join(PROCEDURES)}")
        return self


class Budget(Form):
    """Relative standard uncertainties of the BRF; pairs run from the best to the worst geometry.

    Words in place of numbers say where a row comes from (``docs/measurement.md``): an angle that ``arms`` gives an
    uncertainty to, and that no number stands for, counts with the slope of what is measured.
    """

    measurement_noise: Budgeted | FromSamples = 0.0
    instrument_stability: Budgeted = 0.0
    wavelength: Budgeted = 0.0
    straylight: Budgeted = 0.0
    detector_linearity: Budgeted = 0.0
    beam_and_placement: Budgeted = 0.0
    illumination_zenith: Budgeted | FromSlope = "slope"
    sensor_zenith: Budgeted | FromSlope = "slope"
    sensor_azimuth: Budgeted | FromSlope = "slope"
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
    calibration: Calibration = Calibration()
    correlation: Correlations = Correlations()
    degrees_of_freedom: DegreesOfFreedom = DegreesOfFreedom()


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
    """Read ``facility.toml``, the picture of the beam and the certificate of the reference that it may name.

    Raises
    ------
    InputError
        Naming file and every wrong key.
    """
    facility = read_form(path, Facility)
    certificate = facility.reference.certificate
    if isinstance(certificate, str):
        standard = read_form(beside(path, certificate, "reference.certificate"), ReferenceStandard)
        reference = facility.reference.model_copy(update={"certificate": standard})
        facility = facility.model_copy(update={"reference": reference})
    beam = facility.beam
    if beam.image is None:
        return facility
    image = beside(path, beam.image, "beam.image")
    picture = read_beam_image(image, beam.pixel_pitch, about_centroid=beam.image_axis == "centroid")
    return facility.model_copy(update={"beam": beam.with_picture(picture)})

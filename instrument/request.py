"""What a person asks of a scan, and the files it comes down to. Everything wrong with them is said here."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from datetime import datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from instrument.artifact import read_artifact
from instrument.errors import InputError
from instrument.events import Geometry
from instrument.facility import UNKNOWN_FACILITY, Arms, Facility, read_facility
from instrument.journal import JournalContent, read_journal
from instrument.laboratories import Inputs
from instrument.plan import Plan, describe, read_plan
from instrument.run_record import RunRecord
from instrument.scan_options import check_options
from instrument.turning import require_turnable

PLAN_NAME, FACILITY_NAME, ARTIFACT_NAME = "plan.toml", "facility.toml", "artifact.toml"
CORRECTIONS_NAME = "corrections.toml"
#: What a material is called in a run folder, by its form (the last part of its own name; others are taken as netCDF). A
#: ``material.toml`` may refer to files of the others, so it is looked for first.
MATERIAL_NAMES = {form: f"material{form}" for form in (".toml", ".csv", ".bsdf", ".nc")}
DEVICES_NAME = "devices.toml"


class ScanRequest(BaseModel):
    """What a person asks for.

    Attributes
    ----------
    record
        Who measures which sample against which standard; words of the plan stand in for what is not said.
    plan, facility, artifact, material
        Files; with ``simulate`` the laboratory's own examples stand in for what is not given. Without it plan and
        facility are needed; artifact and material serve the twin.
    simulate, speed, seed
        Start the simulated laboratory, with a clock so many times faster, and its seed.
    devices
        ``devices.toml`` of a laboratory; excludes ``simulate``.
    corrections
        Effects that the twin is to include, from a diagnosis.
    out
        The run folder; ``runs/<UTC time>-<plan>`` by default. Must not hold a run already.
    twin
        False leaves out every observer.
    accept_reference
        Go on with a reference whose certificate has expired or does not cover the plan; recorded in the run.
    resume
        Run folder of an interrupted scan: go on with it. Excludes plan, facility, artifact, material and out; the
        laboratory is the one the run began with unless another is named.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")
    plan: Path | None = None
    simulate: bool = False
    speed: float = Field(default=1.0, gt=0)
    seed: int = 1
    devices: Path | None = None
    facility: Path | None = None
    artifact: Path | None = None
    material: Path | None = None
    corrections: Path | None = None
    out: Path | None = None
    twin: bool = True
    accept_reference: bool = False
    resume: Path | None = None
    record: RunRecord = RunRecord()


#: Stands in until the laboratory has said what its arms can do: whatever is wrong with a plan beside that is said at
#: once.
_WIDE_FACILITY = UNKNOWN_FACILITY.model_copy(
    update={
        "arms": Arms(
            illumination_zenith=(-180.0, 180.0),
            sensor_zenith=(-180.0, 180.0),
            sensor_azimuth=(-360.0, 360.0),
            shadow_half_angle=0.0,
        )
    }
)


@dataclass(frozen=True)
class Simulation:
    """How the simulated laboratory is started."""

    speed: float
    seed: int


@dataclass(frozen=True)
class GivenInputs:
    """What is known before the laboratory runs; None where its examples are to stand in."""

    plan: Path | None
    facility: Path | None
    artifact: Path | None
    material: Path | None
    devices: Path | None
    simulate: Simulation | None
    resumed: JournalContent | None = None
    corrections: Path | None = None
    record: RunRecord = field(default_factory=RunRecord)

    def filled(self, examples: Inputs) -> GivenInputs:
        """With the laboratory's own files where none were given."""
        return replace(
            self,
            plan=self.plan or examples.plan,
            facility=self.facility or examples.facility,
            artifact=self.artifact or examples.artifact,
            material=self.material or examples.material,
            devices=examples.devices,
        )


@dataclass(frozen=True)
class ScanInputs:
    """Everything a scan works from, read and checked."""

    plan: Plan
    facility: Facility
    plan_path: Path
    facility_path: Path
    artifact: Path | None
    material: Path | None
    devices: Path
    simulate: Simulation | None
    resumed: JournalContent | None
    corrections: Path | None = None
    record: RunRecord = field(default_factory=RunRecord)


def inputs_of(request: ScanRequest) -> GivenInputs:
    """The files of a request; those that are given are read, so that nothing starts in vain.

    Raises
    ------
    InputError
        If options exclude each other, one is missing, or a file is wrong.
    """
    check_options({name: getattr(request, name) for name in request.model_fields_set})
    given = _resumed(request) if request.resume is not None else _new(request)
    for path in (given.plan, given.material, given.devices, given.corrections):
        if path is not None and not path.is_file():
            raise InputError(f"{path}: no such file")
    if given.artifact is not None:
        read_artifact(given.artifact)
    facility = read_facility(given.facility) if given.facility is not None else _WIDE_FACILITY
    if given.plan is not None:
        read_plan(given.plan, facility)
    return given


def _new(request: ScanRequest) -> GivenInputs:
    simulate = Simulation(request.speed, request.seed) if request.simulate else None
    return GivenInputs(
        request.plan,
        request.facility,
        request.artifact,
        request.material,
        request.devices,
        simulate,
        corrections=request.corrections,
        record=request.record,
    )


def _resumed(request: ScanRequest) -> GivenInputs:
    """A run goes on with what its folder holds, in the laboratory where it began unless another is named."""
    assert request.resume is not None
    content = read_journal(request.resume)
    folder = content.path.parent
    for name, key in ((PLAN_NAME, "plan"), (FACILITY_NAME, "facility")):
        if not (folder / name).is_file():
            raise InputError(f"{folder / name}: no such file; the run cannot go on without it")
        if (folder / name).read_text(encoding="utf-8") != content.header[key]:
            raise InputError(f"{folder / name}: changed since the run began; expected what the journal's header holds")
    began = content.header.get("laboratory", {})
    simulate = None
    if request.devices is None and (request.simulate or began.get("simulate")):
        set_now = request.model_fields_set
        simulate = Simulation(
            request.speed if "speed" in set_now else began.get("speed", request.speed),
            request.seed if "seed" in set_now else began.get("seed", request.seed),
        )
    return GivenInputs(
        plan=folder / PLAN_NAME,
        facility=folder / FACILITY_NAME,
        artifact=existing(folder / ARTIFACT_NAME),
        material=material_of(folder),
        devices=None if simulate else request.devices or folder / DEVICES_NAME,
        simulate=simulate,
        resumed=content,
        corrections=existing(folder / CORRECTIONS_NAME),
    )


def complete(given: GivenInputs) -> ScanInputs:
    """Read what is left to read.

    Raises
    ------
    InputError
        If a file is wrong.
    """
    assert given.plan is not None
    assert given.facility is not None
    assert given.devices is not None
    facility = read_facility(given.facility)
    plan = read_plan(given.plan, facility)
    try:
        for point in plan.points:
            require_turnable(point, facility.arms.illumination_azimuth)
    except InputError as error:
        raise InputError(f"{plan.source}: {error}") from None
    if given.resumed is not None:
        _check_points(plan, given.resumed)
    return ScanInputs(
        plan=plan,
        facility=facility,
        plan_path=given.plan,
        facility_path=given.facility,
        artifact=given.artifact,
        material=given.material,
        devices=given.devices,
        simulate=given.simulate,
        resumed=given.resumed,
        corrections=given.corrections,
        record=given.record.over(plan.record).over(_of_certificate(facility)),
    )


def _of_certificate(facility: Facility) -> RunRecord:
    """What the facility says of the reference standard."""
    standard = facility.reference.standard
    return RunRecord(reference_standard=standard.identity) if standard is not None else RunRecord()


def _check_points(plan: Plan, resumed: JournalContent) -> None:
    """What was measured must be what the plan says, or an index would stand for two geometries."""
    for index, record in resumed.points.items():
        measured = Geometry.model_validate(record["geometry"])
        if index >= len(plan) or measured != plan.points[index]:
            now = describe(plan.points[index]) if index < len(plan) else "nothing"
            raise InputError(
                f"{resumed.path}: point {index} was measured at {describe(measured)}; this program reads the plan as"
                f" having {now} there, and cannot go on with the run"
            )


def header_of(inputs: ScanInputs, created: datetime) -> dict[str, Any]:
    """First line of the journal of a new run."""
    simulate = inputs.simulate
    return {
        "created": created,
        "title": inputs.plan.title,
        "plan": inputs.plan_path.read_text(encoding="utf-8"),
        "facility": inputs.facility_path.read_text(encoding="utf-8"),
        "samples": inputs.plan.samples,
        "scan_direction": inputs.plan.direction,
        "points": len(inputs.plan),
        "software_version": version("goniotwin"),
        "record": inputs.record.said(),
        "laboratory": {"simulate": True, "speed": simulate.speed, "seed": simulate.seed}
        if simulate
        else {"simulate": False},
    }


def material_of(folder: Path) -> Path | None:
    """The material that a run folder holds."""
    return next((folder / name for name in MATERIAL_NAMES.values() if (folder / name).is_file()), None)


def existing(path: Path) -> Path | None:
    """The path, where there is a file."""
    return path if path.is_file() else None

"""What a report is made of: the files that a person names, and those of the run folder."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import xarray as xr
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from instrument.artifact import ArtifactDimensions, read_artifact
from instrument.errors import InputError
from instrument.files import json_object
from instrument.journal import JOURNAL_NAME, JournalContent, read_journal
from instrument.request import existing, material_of
from instrument.run_build import run_of_journal
from instrument.run_folder import RUN_NAME
from instrument.run_read import read_run
from twin.compare_command import comparable_prediction
from twin.comparison import Comparison, compare
from twin.matching import find_points
from twin.report.document import LeftOut

DIAGNOSIS_NAME, PREDICTION_NAME = "diagnosis.json", "prediction.nc"


class _Ranked(BaseModel):
    model_config = ConfigDict(extra="allow")
    effect: str
    members: tuple[str, ...] = Field(default=(), alias="class")
    probability: Annotated[float, Field(ge=0, le=1)]
    parameters: dict[str, dict[str, float]] = {}


class _Consistency(BaseModel):
    model_config = ConfigDict(extra="allow")
    consistent: bool
    p_value: float
    dark_uncertainty: float


class _Region(BaseModel):
    model_config = ConfigDict(extra="allow")
    points: tuple[Annotated[int, Field(ge=0)], ...]
    description: str
    strength: float


class _Gap(BaseModel):
    model_config = ConfigDict(extra="allow")
    rms_before: float
    rms_after: float
    heldout_rms_before: float
    heldout_rms_after: float
    heldout_rms_withheld: float | None = None
    shrink: float
    shrink_interval: tuple[float, float]
    removable: float


class _Scan(BaseModel):
    model_config = ConfigDict(extra="allow")
    description: str
    separates: tuple[tuple[str, ...], ...] = ()
    gain_nats: float = float("nan")
    duration_s: float = float("nan")


class DiagnosisFile(BaseModel):
    """``diagnosis.json`` (data contract, section Diagnosis); keys that are not known are left alone."""

    model_config = ConfigDict(extra="allow")
    consistency: _Consistency
    where: tuple[_Region, ...] = ()
    verdict: Literal["none", "effects", "unknown", "undecided"]
    effects: tuple[_Ranked, ...] = ()
    ranking: tuple[_Ranked, ...] = ()
    gap: _Gap
    next_scan: tuple[_Scan, ...] = ()
    probabilities: dict[str, float] = {}
    made_with: dict[str, Any] = {}
    ruled_out: dict[str, str] = {}


@dataclass(frozen=True)
class Named:
    """What a person named on the command line."""

    run: Path
    prediction: Path | None = None
    diagnosis: Path | None = None
    artifact: Path | None = None
    material: Path | None = None


@dataclass(frozen=True)
class Sources:
    """Everything that a report may rest on; None where there is none.

    Attributes
    ----------
    run
        The measurement, from ``run.nc`` or made anew from the journal.
    run_origin
        Which of the two, in words.
    prediction
        As its file has it.
    comparison
        Of the points that were measured and predicted.
    coupon
        The run over the witness coupon that the material was made of.
    files
        What was read, by what it is.
    gone
        What could not be had, and why.
    """

    named: Path
    folder: Path | None
    journal: JournalContent | None
    run: xr.Dataset | None
    run_origin: str
    prediction: xr.Dataset | None
    comparison: Comparison | None
    diagnosis: DiagnosisFile | None
    artifact: ArtifactDimensions | None
    coupon: xr.Dataset | None
    files: dict[str, Path]
    gone: dict[str, str]

    @property
    def flat(self) -> bool:
        """Whether the sample is known to be flat, as a coupon is."""
        return self.artifact is not None and not len(self.artifact.holes) and self.artifact.mesh is None

    def left_out(self, what: str, about: str) -> LeftOut:
        """A part that is missing because ``about`` is."""
        return LeftOut(what, self.gone[about])


def read_sources(named: Named) -> Sources:
    """Read everything that a report rests on.

    Raises
    ------
    InputError
        If a file that is named cannot be used, or the run can not.
    """
    gone: dict[str, str] = {}
    folder = named.run if named.run.is_dir() else None
    if folder is not None and not (folder / JOURNAL_NAME).exists() and not (folder / RUN_NAME).exists():
        raise InputError(f"{folder}: holds neither {JOURNAL_NAME} nor {RUN_NAME}; expected a run folder or a run file")
    journal = read_journal(folder) if folder is not None and (folder / JOURNAL_NAME).exists() else None
    if journal is None:
        gone["journal"] = "there is no journal: a run file alone does not say how the measurement went"
    files = _files(named, folder)
    run, origin = _run(named.run, folder, journal, gone)
    prediction, comparison = _comparison(files.get("prediction"), run, gone)
    return Sources(
        named=named.run,
        folder=folder,
        journal=journal,
        run=run,
        run_origin=origin,
        prediction=prediction,
        comparison=comparison,
        diagnosis=_diagnosis(files.get("diagnosis"), run, gone),
        artifact=_artifact(files.get("artifact"), gone),
        coupon=_coupon(files.get("material"), gone),
        files=files,
        gone=gone,
    )


def _files(named: Named, folder: Path | None) -> dict[str, Path]:
    """What is read or named in the report, by what it is."""
    found: dict[str, Path | None] = {"run": named.run if folder is None else existing(folder / RUN_NAME)}
    inside: dict[str, Path | None] = dict.fromkeys(("prediction", "diagnosis", "artifact", "material"))
    if folder is not None:
        found["journal"] = existing(folder / JOURNAL_NAME)
        found |= {name: existing(folder / f"{name}.toml") for name in ("plan", "facility", "devices", "corrections")}
        inside = {
            "prediction": existing(folder / PREDICTION_NAME),
            "diagnosis": existing(folder / DIAGNOSIS_NAME),
            "artifact": existing(folder / "artifact.toml"),
            "material": material_of(folder),
        }
    found |= {name: getattr(named, name) or path for name, path in inside.items()}
    return {name: path for name, path in found.items() if path is not None}


def _run(
    named: Path, folder: Path | None, journal: JournalContent | None, gone: dict[str, str]
) -> tuple[xr.Dataset | None, str]:
    if folder is None:
        return read_run(named), named.name
    if (folder / RUN_NAME).exists():
        return read_run(folder / RUN_NAME), RUN_NAME
    assert journal is not None
    try:
        return run_of_journal(journal), "made anew from the journal, as there is no run.nc yet"
    except InputError as error:
        gone["run"] = f"no reflectance factor can be had: {str(error).removeprefix(f'{journal.path}: ')}"
        return None, ""


def _comparison(
    file: Path | None, run: xr.Dataset | None, gone: dict[str, str]
) -> tuple[xr.Dataset | None, Comparison | None]:
    if file is None:
        gone["prediction"] = "there is no prediction (goniotwin predict RUN --out prediction.nc makes one)"
        return None, None
    prediction = comparable_prediction(file)
    if run is None:
        gone["prediction"] = gone["run"]
        return prediction, None
    rows = find_points(run, prediction)
    lonely = int(np.count_nonzero(rows < 0))
    if lonely == len(rows):
        raise InputError(f"{file}: predicts none of the {len(rows)} measured points; expected a prediction of this run")
    notes = (f"{lonely} measured points have no prediction and are left out.",) if lonely else ()
    try:
        return prediction, compare(run.isel(point=np.flatnonzero(rows >= 0)), prediction, notes=notes)
    except (
        InputError
    ) as error:  # a measured zero has no relative difference; what was measured can be told all the same
        gone["prediction"] = f"the two cannot be compared: {error}"
        return prediction, None


def _diagnosis(file: Path | None, run: xr.Dataset | None, gone: dict[str, str]) -> DiagnosisFile | None:
    if file is None:
        gone["diagnosis"] = "no diagnosis is named (goniotwin diagnose RUN --json diagnosis.json makes one)"
        return None
    diagnosis = read_diagnosis(file)
    last = max((point for region in diagnosis.where for point in region.points), default=-1)
    if run is not None and last >= run.sizes["point"]:
        raise InputError(
            f"{file}: where: names point {last}; the run has {run.sizes['point']}: this is the diagnosis of another run"
        )
    return diagnosis


def read_diagnosis(file: Path) -> DiagnosisFile:
    """Read ``diagnosis.json``.

    Raises
    ------
    InputError
        Naming file and key.
    """
    content = json_object(file, "what goniotwin diagnose --json writes")
    if "verdict" not in content:
        raise InputError(f"{file}: verdict: missing; expected what goniotwin diagnose --json writes")
    try:
        return DiagnosisFile.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(map(str, first["loc"]))
        raise InputError(f"{file}: {key}: {first['msg']}; found {str(first['input'])[:80]!r}") from None


def _artifact(file: Path | None, gone: dict[str, str]) -> ArtifactDimensions | None:
    if file is None:
        gone["artifact"] = "no artifact.toml is named, so the dimensions of the sample are not known"
        return None
    return read_artifact(file)


def _coupon(file: Path | None, gone: dict[str, str]) -> xr.Dataset | None:
    """The readings of the coupon, where the material is one."""
    if file is None:
        gone["coupon"] = "no material is named"
        return None
    if file.suffix.lower() not in (".nc", ".csv"):
        gone["coupon"] = f"{file.name} describes the material by models; it is no run over a coupon"
        return None
    if file.suffix.lower() == ".nc":
        with xr.open_dataset(file, engine="h5netcdf") if _is_hdf(file) else xr.Dataset() as dataset:
            if "brdf" in dataset:
                gone["coupon"] = f"{file.name} is a ready table of the BRDF; readings of a coupon are not in it"
                return None
    return read_run(file)


def _is_hdf(file: Path) -> bool:
    try:
        return file.read_bytes()[:8] == b"\x89HDF\r\n\x1a\n"
    except OSError:
        return False

"""What the next start asks for: the laboratory, which stays, and what a person chooses for each run."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from instrument.request import ScanRequest
from instrument.run_record import RunRecord

#: Words of a run's record that a person says on the page Set up.
RECORDED = ("operator", "sample", "project", "remarks")


@dataclass
class Setup:
    """Fields as in :class:`instrument.request.ScanRequest`, and what the window needs beside them.

    Attributes
    ----------
    operator, sample, project, remarks
        For the record of the run (:class:`instrument.run_record.RunRecord`).
    resume
        An interrupted run that the next start goes on with.
    runs, calibrations
        Folders whose runs are listed, and where results of procedures are kept.
    example_plan, example_facility
        Those of the simulated laboratory.
    unsaved
        The plan is being edited and differs from its file.
    """

    simulate: bool = False
    speed: float = 1.0
    seed: int = 1
    devices: Path | None = None
    facility: Path | None = None
    artifact: Path | None = None
    material: Path | None = None
    corrections: Path | None = None
    out: Path | None = None
    twin: bool = True
    plan: Path | None = None
    operator: str = ""
    sample: str = ""
    project: str = ""
    remarks: str = ""
    resume: Path | None = None
    runs: Path = Path("runs")
    calibrations: Path = Path("calibrations")
    example_plan: Path | None = None
    example_facility: Path | None = None
    unsaved: bool = False

    @property
    def known_facility(self) -> Path | None:
        """The facility against which a plan is checked."""
        return self.facility or self.example_facility

    def use_examples(self) -> None:
        """Have the plan of the simulated laboratory ready where none is named."""
        found = list(entry_points(group="goniotwin.examples", name="simulated"))
        if not self.simulate or not found:
            return
        examples = found[0].load()()
        self.example_plan, self.example_facility = examples.plan, examples.facility
        self.plan = self.plan or examples.plan

    @property
    def laboratory(self) -> str:
        """What is driven, in words."""
        if self.simulate:
            return f"simulated laboratory, {self.speed:g} times faster"
        return str(self.devices) if self.devices else ""

    def request(self) -> ScanRequest:
        """What a start asks for; each makes a run folder of its own unless it goes on with one."""
        if self.resume is not None:
            where: dict[str, Any] = {"devices": self.devices} if self.devices else {}
            if self.simulate:
                where = {"simulate": True, "speed": self.speed, "seed": self.seed}
            return ScanRequest(resume=self.resume.absolute(), twin=self.twin, **where)
        return ScanRequest(
            plan=self.plan,
            simulate=self.simulate,
            speed=self.speed if self.simulate else 1.0,
            seed=self.seed,
            devices=self.devices,
            facility=self.facility,
            artifact=self.artifact,
            material=self.material,
            corrections=self.corrections,
            out=self.out,
            twin=self.twin,
            record=RunRecord(**{name: getattr(self, name) for name in RECORDED}),
        )

    def content(self) -> dict[str, Any]:
        """What the process of a scan is told (:mod:`gui.host`)."""
        return {"request": self.request().model_dump(mode="json", exclude_unset=True)}

"""Puts a report together: which part it has, in which order, and why one is missing."""

from __future__ import annotations

import hashlib
from importlib.metadata import version
from pathlib import Path

from instrument.errors import InputError
from instrument.run_archive import verify
from instrument.run_read import capabilities
from instrument.run_record import FIELDS, current_record
from twin.comparison import Comparison
from twin.report.compared import compared_blocks
from twin.report.course import (
    amendment_blocks,
    environment,
    flag_blocks,
    interruptions,
    journal_blocks,
    reference_blocks,
)
from twin.report.diagnosed import diagnosis_blocks
from twin.report.document import Block, Document, LeftOut, Points, Section, Table, Words
from twin.report.measured import material_blocks, relative_u, sample_blocks, symmetric_plots
from twin.report.sources import Sources
from twin.report.uncertain import budget_blocks, dimensions_table, prediction_budget
from twin.report.words import counted, moment, span

_COMPARED = "Tables V and VI, Figs. 13 to 17: measurement beside simulation"


def build_report(sources: Sources) -> Document:
    """The report of what was read."""
    sections = [
        Section("Summary", _summary(sources)),
        Section("The sample and what was measured", _measured(sources)),
        Section("The material", _material(sources)),
        Section("Uncertainty of the measurement", _budget(sources)),
        Section("The simulation", _simulation(sources)),
        Section("Measurement beside simulation", _compared(sources)),
        Section("Diagnosis", _diagnosis(sources)),
        Section("Reference history", _reference(sources)),
        Section("Course of the measurement", _course(sources)),
        Section("Made with", _made(sources)),
    ]
    missing = [block for section in sections for block in section.blocks if isinstance(block, LeftOut)]
    rows = [[block.what, block.why] for block in missing]
    sections.append(
        Section(
            "What this report leaves out",
            [Table("left_out", "Parts that this run or these files cannot have.", ["part", "why"], rows)]
            if rows
            else [Words("Nothing: every part is there.")],
        )
    )
    return Document(f"Report of {_title(sources)}", _subtitle(sources), sections)


def _title(sources: Sources) -> str:
    said = str(sources.journal.header.get("title", "")) if sources.journal else ""
    if not said and sources.run is not None:
        said = str(sources.run.attrs.get("title", ""))
    name = sources.named.resolve().name
    return f"{said} ({name})" if said and said != name else name


def _subtitle(sources: Sources) -> str:
    what = ["run"]
    what += ["prediction"] if sources.comparison else []
    what += ["diagnosis"] if sources.diagnosis else []
    return f"Made of {' and '.join(what)} by goniotwin {version('goniotwin')}."


def _summary(sources: Sources) -> list[Block]:
    lines = []
    journal, run = sources.journal, sources.run
    if journal is not None:
        planned, measured = journal.header["points"], len(journal.points)
        begun, last = moment(str(journal.header["created"])), moment(str(journal.latest))
        ended = [line for line in journal.others if line["kind"] == "ended"]
        outcome = str(ended[-1].get("outcome", "")) if ended else "not ended"
        lines.append(f"{measured} of {planned} points measured, {begun} to {last} UTC; outcome: {outcome}.")
        times = len(interruptions(journal))
        lines.append(f"Interruptions and resumptions: {times or 'none'}.")
    elif run is not None:
        lines.append(f"{counted(run.sizes['point'], 'point')}.")
    if run is not None:
        lines.append(f"Combined standard uncertainty of the reflectance factor: {span(relative_u(run), 2, '%')}.")
    gist = _gist(sources.comparison)
    if sources.diagnosis is not None:
        named = ", ".join(one.effect.replace("_", " ") for one in sources.diagnosis.effects)
        lines.append(f"Diagnosis: {sources.diagnosis.verdict}{f' ({named})' if named else ''}.")
    return [Words(gist, "verdict"), Points(lines), *_record(sources)]


def _gist(comparison: Comparison | None) -> str:
    if comparison is None:
        return "A measurement without a simulation beside it."
    whole = comparison.overall
    return (
        f"Simulation and measurement differ by {100 * whole.mean_absolute_relative_difference:.2f} % on average over"
        f" {counted(whole.points, 'point')}; relative RMSE {whole.relative_rmse:.3f}, level of agreement"
        f" {whole.level_of_agreement:.2f}."
    )


def _record(sources: Sources) -> list[Block]:
    if sources.journal is not None:
        said = current_record(sources.journal).said()
    elif sources.run is not None:
        said = {name: str(sources.run.attrs[name]) for name in FIELDS if name in sources.run.attrs}
    else:
        said = {}
    rows = [[name.replace("_", " "), text] for name, text in said.items()]
    if sources.run is not None:
        known = sources.run.attrs
        for key, word in (
            ("reference_reflectance_factor", "reflectance factor of the reference"),
            ("reference_certificate", "certificate of the reference"),
            ("reference_valid_until", "certificate valid until"),
            ("reference_objections", "accepted although"),
            ("scan_direction", "direction of the scan"),
        ):
            if key in known:
                value = known[key]
                rows.append([word, f"{value:g}" if isinstance(value, float) else str(value)])
    return [Table("record", "Record of the run.", ["", "said"], rows)] if rows else []


def _measured(sources: Sources) -> list[Block]:
    blocks: list[Block] = []
    if sources.artifact is not None:
        blocks.append(dimensions_table(sources.artifact))
    else:
        blocks.append(sources.left_out("Table I: dimensions of the sample", "artifact"))
    what = "Table IV, Figs. 12 and 19: measurement of the sample"
    if sources.run is None:
        return [*blocks, sources.left_out(what, "run")]
    if sources.flat:
        return [*blocks, LeftOut(what, "the sample is flat: what was measured of it stands under The material")]
    blocks += sample_blocks(sources.run)
    if lacks := capabilities(sources.run):
        blocks += [Words("What the run file does not hold:"), Points(lacks)]
    return blocks


def _material(sources: Sources) -> list[Block]:
    what = "Table III, Figs. 10, 11 and 18: measurement of the material"
    if sources.flat and sources.run is not None:
        return material_blocks(sources.run, "The sample is flat: these are the readings of this run.")
    if sources.coupon is None:
        return [sources.left_out(what, "coupon")]
    name = sources.files["material"].name
    return material_blocks(sources.coupon, f"Readings of the witness coupon that the simulation's material is: {name}.")


def _budget(sources: Sources) -> list[Block]:
    if sources.run is None:
        return [sources.left_out("Table II: uncertainty budget of the measurement", "run")]
    return budget_blocks(sources.run)


def _simulation(sources: Sources) -> list[Block]:
    what = "Fig. 20: the simulation of every plane"
    if sources.prediction is None:
        return [sources.left_out(what, "prediction")]
    prediction = sources.prediction
    said = [f"{name}: {value}" for name, value in prediction.attrs.items() if name not in ("Conventions", "title")]
    return [
        Words(f"{counted(prediction.sizes['point'], 'predicted point')}."),
        *([Points(said)] if said else []),
        *symmetric_plots(
            prediction, "fig_20_simulation_all", "Fig. 20", "Simulated reflectance factor", isotropic=sources.flat
        ),
        prediction_budget(prediction),
    ]


def _compared(sources: Sources) -> list[Block]:
    if sources.comparison is None:
        return [sources.left_out(_COMPARED, "prediction")]
    return compared_blocks(sources.comparison)


def _diagnosis(sources: Sources) -> list[Block]:
    if sources.diagnosis is None:
        return [sources.left_out("diagnosis", "diagnosis")]
    run = sources.files.get("run")
    return diagnosis_blocks(sources.diagnosis, sources.run, digest_of(run) if run is not None else "")


def _reference(sources: Sources) -> list[Block]:
    if sources.run is None:
        return [sources.left_out("reference history", "run")]
    return reference_blocks(sources.run)


def _course(sources: Sources) -> list[Block]:
    blocks: list[Block] = []
    if sources.journal is not None:
        blocks += [*journal_blocks(sources.journal), *amendment_blocks(sources.journal)]
    else:
        blocks.append(sources.left_out("interruptions, resumptions, notes and amendments", "journal"))
    if sources.run is not None:
        blocks += flag_blocks(sources.run)
        if rows := environment(sources.run):
            header = ["", "least", "median", "greatest", "unit"]
            blocks.append(
                Table("surroundings", "Surroundings and source while points were read.", header, rows, (1, 2, 3))
            )
    return blocks


def _made(sources: Sources) -> list[Block]:
    """Program and files, by digest, and whether the folder still is what was measured."""
    rows = [["report", f"goniotwin {version('goniotwin')}", ""]]
    if sources.journal is not None:
        rows.append(["run, recorded by", f"goniotwin {sources.journal.header['software_version']}", ""])
        rows.append(["journal's chain", f"{len(sources.journal.chains)} lines", sources.journal.digest])
    elif sources.run is not None and "software" in sources.run.attrs:
        rows.append(["run, recorded by", str(sources.run.attrs["software"]), ""])
    if sources.run is not None and "journal_digest" in sources.run.attrs:
        rows.append(["journal that run.nc stands for", "", str(sources.run.attrs["journal_digest"])])
    rows += [[what, path.name, digest_of(path)] for what, path in _with_companions(sources).items() if path.is_file()]
    if sources.diagnosis is not None and "program" in sources.diagnosis.made_with:
        rows.append(["diagnosis, made by", str(sources.diagnosis.made_with["program"]), ""])
    blocks: list[Block] = [Table("digests", "Software, and SHA-256 of every file.", ["", "", "SHA-256"], rows)]
    if sources.run_origin:
        blocks.append(Words(f"Reflectance factors: {sources.run_origin}."))
    return [*blocks, *_verified(sources)]


def _with_companions(sources: Sources) -> dict[str, Path]:
    """Files by what they are, with the table of holes and the mesh that the artifact names."""
    files = dict(sources.files)
    if sources.artifact is not None:
        form = sources.artifact.form
        if form.holes is not None:
            files["holes"] = sources.artifact.source.parent / form.holes
        if sources.artifact.mesh is not None:
            files["mesh"] = sources.artifact.mesh
    return files


def _verified(sources: Sources) -> list[Block]:
    if sources.folder is None or sources.journal is None:
        return [LeftOut("verification of the run folder", "only a run folder holds its journal")]
    try:
        checks = verify(sources.folder).checks
    except InputError as error:
        return [LeftOut("verification of the run folder", str(error))]
    rows = [[check.name, "good" if check.passed else "bad", check.found] for check in checks]
    return [Table("verification", "The run folder held against its journal.", ["check", "", "found"], rows)]


def digest_of(path: Path) -> str:
    """SHA-256 of a file, hexadecimal."""
    return hashlib.sha256(path.read_bytes()).hexdigest()

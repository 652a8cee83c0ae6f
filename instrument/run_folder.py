"""The run folder: where a scan keeps what it was asked, what it read, and what became of it."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import tomli_w

from instrument.artifact import read_artifact
from instrument.errors import InputError
from instrument.facility import read_facility
from instrument.files import reading, sync_folder
from instrument.forms import read_toml
from instrument.journal import JOURNAL_NAME
from instrument.output import write_result
from instrument.plan_text import self_contained
from instrument.request import (
    ARTIFACT_NAME,
    CORRECTIONS_NAME,
    DEVICES_NAME,
    FACILITY_NAME,
    MATERIAL_NAMES,
    PLAN_NAME,
    ScanInputs,
)

RUN_NAME = "run.nc"
#: Where run folders lie that nobody named.
RUNS = Path("runs")


def make_run_folder(out: Path | None, plan: Path) -> Path:
    """Make the folder of a new run: ``out``, or ``runs/<UTC time>-<plan>``.

    Raises
    ------
    InputError
        If the folder holds a run or anything else already, or cannot be made.
    """
    if out is not None:
        check_free(out)
        return _made(out, exist_ok=True)
    stem = f"{datetime.now(UTC):%Y%m%dT%H%M%SZ}-{plan.stem}"
    for number in range(1, 100):
        folder = RUNS / (stem if number == 1 else f"{stem}-{number}")
        if not folder.exists():
            return _made(folder, exist_ok=False)
    raise InputError(f"{RUNS / stem}: exists already, and so do 98 others of this second")


def check_free(out: Path) -> None:
    """Refuse a folder that holds anything: nothing of it may be replaced.

    Raises
    ------
    InputError
        Saying what to do instead.
    """
    if (out / JOURNAL_NAME).exists():
        raise InputError(f"{out}: holds a run already; go on with it by --resume, or choose another --out")
    if out.exists() and not out.is_dir():
        raise InputError(f"{out}: is a file; expected the name of a folder")
    if out.is_dir() and any(out.iterdir()):
        raise InputError(f"{out}: is not empty; a run has a folder of its own, choose another --out")


def _made(folder: Path, *, exist_ok: bool) -> Path:
    folder = folder.absolute()
    new = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=exist_ok)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made: {error.strerror}") from None
    for path in new:
        sync_folder(path.parent)
    return folder.resolve()


def copy_file(source: Path, folder: Path, name: str) -> Path:
    """Copy a file into the run folder under a fixed name; it is on the disk when this returns.

    Raises
    ------
    InputError
        If it cannot be read or written, or another file has this name already.
    """
    if Path(name).name != name:
        raise InputError(f"{source}: its copy would be called {name!r}; expected a name without folders")
    with reading(source):
        content = source.read_bytes()
    return _write_new(folder / name, content, str(source))


def _write_new(target: Path, content: bytes, source: str) -> Path:
    if target.exists():
        raise InputError(f"{source}: its copy would replace {target.name}, which the run folder needs; rename it")
    write_result(target, content)
    return target


def copy_plan(source: Path, folder: Path) -> Path:
    """Copy a plan, its tables written out, so that the copy stands on its own.

    Raises
    ------
    InputError
        If the plan or a table of it is wrong.
    """
    return _write_new(folder / PLAN_NAME, self_contained(source).encode(), str(source))


def copy_artifact(source: Path, folder: Path) -> Path:
    """Copy an artifact with its table of holes and its mesh, so that the copy stands on its own.

    Raises
    ------
    InputError
        If the artifact is wrong.
    """
    read_artifact(source)
    form = read_toml(source)
    names = {key: Path(form[key]).name for key in ("holes", "mesh") if form.get(key) is not None}
    for key, name in names.items():
        copy_file(source.parent / form[key], folder, name)
    if all(form[key] == name for key, name in names.items()):
        return copy_file(source, folder, ARTIFACT_NAME)
    return _write_new(folder / ARTIFACT_NAME, tomli_w.dumps(form | names).encode(), str(source))


def copy_facility(source: Path, folder: Path) -> Path:
    """Copy a facility with the picture of its beam, if it names one; a certificate that it names goes into the copy.

    Raises
    ------
    InputError
        If the facility is wrong.
    """
    read_facility(source)
    form = read_toml(source)
    moved = dict(form)
    if (image := form["beam"].get("image")) is not None:
        name = Path(image).name
        copy_file(source.parent / image, folder, name)
        moved["beam"] = form["beam"] | {"image": name}
    if isinstance(certificate := form["reference"].get("certificate"), str):
        moved["reference"] = form["reference"] | {"certificate": read_toml(source.parent / certificate)}
    if moved == form:
        return copy_file(source, folder, FACILITY_NAME)
    return _write_new(folder / FACILITY_NAME, tomli_w.dumps(moved).encode(), str(source))


def copy_material(source: Path, folder: Path) -> Path:
    """Copy a material, whatever its form, with the files that it names.

    Copies of those are called after the table of ``material.toml`` that names them first, so that none takes the name
    of another file of the run.

    Raises
    ------
    InputError
        If a file cannot be read.
    """
    form = source.suffix.lower()
    if form != ".toml":
        return copy_file(source, folder, MATERIAL_NAMES.get(form, MATERIAL_NAMES[".nc"]))
    tables = read_toml(source)
    names: dict[Path, str] = {}
    for key, table in tables.items():
        if isinstance(table, dict) and isinstance(table.get("file"), str):
            path = source.parent / table["file"]
            if path not in names:
                names[path] = copy_file(path, folder, f"material-{key}-{path.name}").name
            table["file"] = names[path]
    return _write_new(folder / MATERIAL_NAMES[form], tomli_w.dumps(tables).encode(), str(source))


def keep_inputs(inputs: ScanInputs, folder: Path) -> ScanInputs:
    """Copy what a scan works from into its folder; the scan goes on with the copies.

    Raises
    ------
    InputError
        If a file cannot be read.
    """
    if inputs.simulate is None:
        copy_file(inputs.devices, folder, DEVICES_NAME)
    return replace(
        inputs,
        plan_path=copy_plan(inputs.plan_path, folder),
        facility_path=copy_facility(inputs.facility_path, folder),
        artifact=copy_artifact(inputs.artifact, folder) if inputs.artifact else None,
        material=copy_material(inputs.material, folder) if inputs.material else None,
        corrections=copy_file(inputs.corrections, folder, CORRECTIONS_NAME) if inputs.corrections else None,
    )

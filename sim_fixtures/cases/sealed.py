"""Sets of cases on disk: runs in one folder, labels in another, and a promise between them.

``FOLDER/common`` holds what a diagnosis may see beside the runs (facility, artifact, holes, coupon run),
``FOLDER/cases`` the runs, ``FOLDER/labels.sha256`` the digest of the labels, which lie elsewhere. The
labels hold a random salt: nobody can find them by trying, and nobody can change them later.
"""

from __future__ import annotations

import hashlib
import json
import secrets
import shutil
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from instrument.artifact import read_artifact
from instrument.errors import InputError
from instrument.facility import read_facility
from instrument.files import replacing, write_atomically
from instrument.forms import read_form
from instrument.plan import Direction, PlanForm, make_plan
from sim_fixtures.cases.composition import Composition, Order, orders
from sim_fixtures.cases.maker import CaseMaker
from sim_fixtures.cases.readings import Laboratory
from sim_fixtures.examples import ExampleFiles, example_files
from sim_fixtures.examples.files import write_packed
from sim_fixtures.reality import EXAMPLE_COATING

_COMMON, _CASES, _DIGEST = "common", "cases", "labels.sha256"
_LABELS, _PARTS, _ORDER = "labels.json", "parts", "set.json"


@dataclass(frozen=True)
class SealedSet:
    """Where a set lies.

    Attributes
    ----------
    folder, labels
        Of the runs, and the file of the labels.
    digest
        SHA-256 of that file, hexadecimal.
    """

    folder: Path
    labels: Path
    digest: str


def write_sealed_set(
    folder: Path,
    labels: Path,
    seed: int,
    composition: Composition,
    *,
    files: ExampleFiles | None = None,
    rays: int = 16384,
    workers: int = 1,
    progress: Callable[[str], None] = lambda _: None,
) -> SealedSet:
    """Make a set of cases, or what is missing of it.

    Parameters
    ----------
    folder, labels
        Folders for the runs and for their labels; made where missing. Cases that are there already are kept.
    seed
        Of the set.
    composition
        What it is made of.
    files
        Facility, artifact, coupon run and plan; the examples where not given.
    rays
        See :func:`~sim_fixtures.cases.maker.make_case`.
    workers
        Processes that share the work.
    progress
        Called with the name of every case that is complete.

    Raises
    ------
    InputError
        If the folders hold another set, or a sealed one whose labels were changed.
    """
    files = files or example_files()
    if labels.resolve().is_relative_to(folder.resolve()):
        raise InputError(f"{labels}: the labels would lie among the runs; expected a folder outside {folder}")
    for path in (folder / _COMMON, folder / _CASES, labels / _PARTS):
        path.mkdir(parents=True, exist_ok=True)
    _claim(labels / _ORDER, {"seed": seed, "rays": rays, "composition": asdict(composition)})
    _copy_common(folder / _COMMON, files)
    todo = orders(composition, seed)
    missing = [order for order in todo if not _is_complete(folder, labels, order)]
    if workers > 1 and len(missing) > 1:
        # Started afresh: compiled kernels and threads do not survive a fork.
        with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
            running = [pool.submit(_make, order, folder, labels, files, rays) for order in missing]
            for done in as_completed(running):
                progress(done.result())
    else:
        for order in missing:
            progress(_make(order, folder, labels, files, rays))
    return _seal(folder, labels, todo)


def open_labels(folder: Path, labels: Path) -> dict[str, dict[str, Any]]:
    """The labels by the case's name, after checking them against the digest that lies with the runs.

    Raises
    ------
    InputError
        If a file is missing, or the labels are not those that were promised.
    """
    for path in (folder / _DIGEST, labels / _LABELS):
        if not path.is_file():
            raise InputError(f"{path}: not found; expected a complete set of cases")
    promised = (folder / _DIGEST).read_text(encoding="ascii").split()[0]
    content = (labels / _LABELS).read_bytes()
    found = hashlib.sha256(content).hexdigest()
    if found != promised:
        raise InputError(f"{labels / _LABELS}: SHA-256 {found}; expected {promised}, as {folder / _DIGEST} promises")
    result: dict[str, dict[str, Any]] = json.loads(content)["labels"]
    return result


def _claim(path: Path, what: dict[str, Any]) -> None:
    """Write down which set this is, or make sure that it is the same one."""
    text = json.dumps(what, indent=1, sort_keys=True)
    if path.is_file() and path.read_text(encoding="utf-8") != text:
        raise InputError(f"{path}: holds another set of cases; expected the same seed, rays and composition")
    write_atomically(path, text.encode())


def _copy_common(folder: Path, files: ExampleFiles) -> None:
    artifact = read_artifact(files.artifact)
    holes = files.artifact.parent / str(artifact.form.holes)
    for source in (files.facility, files.artifact, holes, files.material):
        shutil.copyfile(source, folder / source.name)


def _is_complete(folder: Path, labels: Path, order: Order) -> bool:
    return (folder / _CASES / f"{order.name}.nc").is_file() and (labels / _PARTS / f"{order.name}.json").is_file()


def _make(order: Order, folder: Path, labels: Path, files: ExampleFiles, rays: int) -> str:
    dataset, truth = _maker(files, order.scan_direction, rays).make(
        order.effects, order.severity, seed=order.seed, noise_family=order.noise_family
    )
    label = {"kind": order.kind} | truth.as_json()
    write_atomically(labels / _PARTS / f"{order.name}.json", json.dumps(label).encode())
    with replacing(folder / _CASES / f"{order.name}.nc") as part:
        write_packed(dataset, part)
    return order.name


@lru_cache(maxsize=2)
def _maker(files: ExampleFiles, direction: Direction, rays: int) -> CaseMaker:
    facility = read_facility(files.facility)
    form = read_form(files.plan, PlanForm).model_copy(update={"direction": direction})
    plan = replace(make_plan(form, facility, str(files.plan)), title="artifact scan")
    return CaseMaker(Laboratory(facility, read_artifact(files.artifact), EXAMPLE_COATING, plan, rays))


def _seal(folder: Path, labels: Path, todo: list[Order]) -> SealedSet:
    """Join the labels of all cases and promise them; a set that is sealed already stays as it is."""
    path, digest = labels / _LABELS, folder / _DIGEST
    if path.is_file() and digest.is_file():
        if set(open_labels(folder, labels)) != {order.name for order in todo}:
            raise InputError(f"{path}: names other cases than the set has")
        return SealedSet(folder, path, digest.read_text(encoding="ascii").split()[0])
    parts = {o.name: json.loads((labels / _PARTS / f"{o.name}.json").read_text(encoding="utf-8")) for o in todo}
    content = json.dumps({"salt": secrets.token_hex(32), "labels": parts}).encode()
    write_atomically(path, content)
    promise = hashlib.sha256(content).hexdigest()
    write_atomically(digest, f"{promise}  {_LABELS}\n".encode())
    return SealedSet(folder, path, promise)

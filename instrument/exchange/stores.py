"""Runs on a shared or an object store: what a URL names, as files on this machine (fsspec).

``s3://bucket/runs``, ``sftp://host/data``, ``file:///data``: whatever filesystem fsspec finds the package of. A run is
brought into the user's cache folder and read there, so that every command reads it as it reads any other. A file that
is unchanged in the store is not brought again.
"""

from __future__ import annotations

import hashlib
import json
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import fsspec

from instrument.catalogue.entry import SOURCES
from instrument.errors import InputError
from instrument.files import cache_folder, replacing, write_atomically
from instrument.journal import JOURNAL_NAME

_URL = re.compile(r"[a-z][a-z0-9+.-]*(::[a-z][a-z0-9+.-]*)*://")
#: Beside a copy: what the store said of each file when it was brought.
_MARKS = ".store.json"


def is_url(text: str) -> bool:
    """Whether a person named something on a store."""
    return _URL.match(text) is not None


def brought(source: str | Path) -> Path:
    """A run folder or file on this machine: the path itself, or a copy of what a URL names.

    Raises
    ------
    InputError
        If the store has no such thing, cannot be read, or needs a package that is not installed.
    """
    if isinstance(source, Path) or not is_url(source):
        return Path(source)
    with _opened(source) as (store, root):
        home = _home(source)
        if store.isdir(root):
            return _copied(store, _files(store, root), home / _name(root))
        if not store.exists(root):
            raise InputError(f"{source}: no such run in the store")
        return _copied(store, [root], home) / _name(root)


def brought_overviews(source: str | Path) -> Path:
    """A folder on this machine whose run folders hold what the catalogue is made of, of every run of a store."""
    if isinstance(source, Path) or not is_url(source):
        return Path(source)
    with _opened(source) as (store, root):
        if not store.isdir(root):
            raise InputError(f"{source}: no such folder; expected one that holds run folders")
        home = _home(source) / "runs"
        home.mkdir(parents=True, exist_ok=True)
        names = set()
        for entry in sorted(store.ls(root, detail=False)):
            found = {_name(path): path for path in _files(store, entry)} if store.isdir(entry) else {}
            if JOURNAL_NAME in found:
                names.add(_name(entry))
                _copied(store, [found[name] for name in SOURCES if name in found], home / _name(entry))
        for gone in {path.name for path in home.iterdir() if path.is_dir()} - names:
            shutil.rmtree(home / gone)
        return home


def runs_of(url: str) -> list[str]:
    """URLs of the runs that one names: itself, or the run folders in it; itself where there is none.

    Raises
    ------
    InputError
        If the store has no such thing.
    """
    with _opened(url) as (store, root):
        if not store.exists(root):
            raise InputError(f"{url}: no such run in the store")
        if not store.isdir(root) or store.exists(f"{root}/{JOURNAL_NAME}"):
            return [url]
        names = [_name(path) for path in sorted(store.ls(root, detail=False)) if store.exists(f"{path}/{JOURNAL_NAME}")]
        return [f"{url.rstrip('/')}/{name}" for name in names] or [url]


def push(run_dir: Path, url: str, *, force: bool = False) -> int:
    """Put the files of a run folder on a store; the journal last, so that half a copy is no run yet.

    Returns
    -------
    int
        How many files.

    Raises
    ------
    InputError
        If the folder is no run, or something is there already and ``force`` is not set.
    """
    if not (run_dir / JOURNAL_NAME).exists():
        raise InputError(f"{run_dir}: holds no {JOURNAL_NAME}; expected a run folder")
    if not is_url(url):
        raise InputError(f"{url}: expected a URL like s3://bucket/runs/name")
    files = [path for path in sorted(run_dir.rglob("*")) if path.is_file()]
    files.sort(key=lambda path: path.name == JOURNAL_NAME)
    with _opened(url) as (store, root):
        if store.exists(root) and not force and (not store.isdir(root) or store.ls(root, detail=False)):
            raise InputError(f"{url}: exists already; choose another name, or replace its files with --force")
        for path in files:
            target = f"{root.rstrip('/')}/{path.relative_to(run_dir).as_posix()}"
            store.makedirs(target.rsplit("/", 1)[0], exist_ok=True)
            store.put_file(str(path), target)
    return len(files)


def pull(url: str, folder: Path) -> int:
    """Bring a whole run folder of a store into a folder that is empty or new; how many files."""
    if not is_url(url):
        raise InputError(f"{url}: expected a URL like s3://bucket/runs/name")
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"{folder}: exists already and is not an empty folder; choose another name")
    with _opened(url) as (store, root):
        found = {path: path[len(root) :].strip("/") for path in store.find(root)} if store.isdir(root) else {}
        if JOURNAL_NAME not in found.values():
            raise InputError(f"{url}: holds no {JOURNAL_NAME}; expected a run folder")
        for path, name in found.items():
            target = folder / name
            if folder.resolve() not in target.resolve().parents:
                raise InputError(f"{url}: {name}: leads out of the folder")
            target.parent.mkdir(parents=True, exist_ok=True)
            write_atomically(target, store.cat_file(path))
    return len(found)


@contextmanager
def _opened(url: str) -> Iterator[tuple[Any, str]]:
    """The filesystem of a URL and the path in it; what goes wrong inside names the URL."""
    try:
        yield fsspec.core.url_to_fs(url)
    except InputError:
        raise
    except (ImportError, ValueError) as error:
        raise InputError(f"{url}: {error}") from None
    except OSError as error:
        raise InputError(f"{url}: cannot be read or written: {error.strerror or error}") from None


def _home(url: str) -> Path:
    return cache_folder() / "stores" / hashlib.sha256(url.rstrip("/").encode()).hexdigest()[:24]


def _name(path: str) -> str:
    name = path.rstrip("/").rsplit("/", 1)[-1]
    if name in ("", ".", "..") or Path(name).name != name:
        raise InputError(f"{path}: cannot be the name of a file here")
    return name


def _files(store: Any, folder: str) -> list[str]:
    """Files of a run folder; what lies deeper (figures) is not needed to read it."""
    return [entry["name"] for entry in store.ls(folder, detail=True) if entry["type"] == "file"]


def _copied(store: Any, paths: list[str], folder: Path) -> Path:
    """Copies in a folder, brought anew where the store's file has changed; what is gone there is gone here."""
    folder.mkdir(parents=True, exist_ok=True)
    marks_file = folder / _MARKS
    try:
        known: dict[str, str] = json.loads(marks_file.read_text())
    except (FileNotFoundError, ValueError):
        known = {}
    marks = {_name(path): _mark(store, path) for path in paths}
    for path in paths:
        name = _name(path)
        if known.get(name) != marks[name] or not (folder / name).exists():
            with replacing(folder / name) as part:
                store.get_file(path, str(part))
    for name in known.keys() - marks.keys():
        (folder / name).unlink(missing_ok=True)
    write_atomically(marks_file, json.dumps(marks).encode())
    return folder


def _mark(store: Any, path: str) -> str:
    """Changes when the file does: size, and whichever time or tag the store keeps."""
    info = store.info(path)
    stamps = ("size", "mtime", "LastModified", "ETag", "etag", "created", "md5Hash", "last_modified")
    return json.dumps({key: str(info[key]) for key in stamps if key in info})

"""Files that are either the old one or the new one, never half of each."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from instrument.errors import InputError


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A name in the same folder to write to; takes the place of ``path`` when the block ends without an error.

    The content is on the disk before the exchange, and the exchange before this returns. A stream
    (:func:`is_stream`) keeps its place and is given the content.
    """
    if is_stream(path):
        with tempfile.TemporaryDirectory() as folder:
            part = Path(folder) / path.name
            yield part
            with part.open("rb") as content, path.open("ab") as sink:
                shutil.copyfileobj(content, sink)
        return
    descriptor, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".part", dir=path.parent)
    os.close(descriptor)
    part = Path(name)
    try:
        yield part
        with part.open("rb") as handle:
            os.fsync(handle.fileno())
        part.chmod(0o666 & ~_umask())
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
    sync_folder(path.parent)


def text_of(path: Path, expected: str = "", encoding: str = "utf-8") -> str:
    """The text of a file.

    Parameters
    ----------
    expected
        What the file should be, for the message: "a TOML file".

    Raises
    ------
    InputError
        Naming the file: missing, a folder, unreadable, no text.
    """
    with reading(path, expected):
        return path.read_text(encoding=encoding)


@contextlib.contextmanager
def reading(path: Path, expected: str = "") -> Iterator[None]:
    """Say of a file that cannot be read what is wrong with it; parameters and errors as :func:`text_of`."""
    wanted = f"; expected {expected}" if expected else ""
    try:
        yield
    except (FileNotFoundError, NotADirectoryError):
        raise InputError(f"{path}: no such file{wanted}") from None
    except IsADirectoryError:
        raise InputError(f"{path}: is a folder{wanted}") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}{wanted}") from None
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not a text file ({error.reason} at byte {error.start}){wanted}") from None


def json_object(path: Path, expected: str) -> dict[str, Any]:
    """The object that a JSON file holds; errors as :func:`text_of`, and where it is no JSON or no object."""
    try:
        content = json.loads(text_of(path, expected))
    except ValueError as error:
        raise InputError(f"{path}: not JSON ({error}); expected {expected}") from None
    if not isinstance(content, dict):
        raise InputError(f"{path}: found {type(content).__name__}; expected {expected}, a JSON object")
    return content


#: Name of the journal; what holds one is a run folder.
JOURNAL_NAME = "journal.jsonl"


def beside(path: Path, name: str, key: str) -> Path:
    """The file that another one names, relative to it; in a run folder it has to lie in that folder.

    A person names files of an instrument wherever they are. A run folder holds copies of all it needs, and may come
    from elsewhere: a name in it that leads out would read what is none of its business.

    Parameters
    ----------
    path
        The file that names it.
    key
        Of the name, for the message.

    Raises
    ------
    InputError
        If the name leads out of a run folder, be it by ``..``, as an absolute path or through a link.
    """
    target = path.parent / name
    home = path.parent.resolve()
    if (home / JOURNAL_NAME).exists() and home not in target.resolve().parents:
        raise InputError(f"{path}: {key}: found {name!r}; expected a file in this run folder")
    return target


def is_stream(path: Path) -> bool:
    """Whether a name stands for a device, a pipe or a file that is open, such as ``/dev/null`` and ``/dev/stdout``."""
    if not path.exists():
        return False
    names = [path, path.parent / os.readlink(path)] if path.is_symlink() else [path]
    return not path.is_file() or any(Path("/proc") in name.parent.resolve().parents for name in names)


def write_atomically(path: Path, content: bytes) -> None:
    """Write a whole file; see :func:`replacing`."""
    with replacing(path) as part:
        part.write_bytes(content)


def cache_folder() -> Path:
    """``goniotwin`` in the user's folder for caches (XDG base directories)."""
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "goniotwin"


def sync_folder(folder: Path) -> None:
    """Bring the names in a folder onto the disk."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _umask() -> int:
    mask = os.umask(0o022)
    os.umask(mask)
    return mask

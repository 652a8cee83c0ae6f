"""The catalogue as an SQLite file in the data folder. The run folders are the truth; it only remembers what they say.

Whatever is wrong with the file (missing, damaged, of another version, not writable) costs the time to read the folders
again and nothing else.
"""

from __future__ import annotations

import logging
import sqlite3
from contextlib import closing
from dataclasses import astuple
from pathlib import Path

from instrument.catalogue.entry import COLUMNS, FIGURES, RUNNING, Entry, read_entry, signature
from instrument.catalogue.search import Query
from instrument.errors import InputError
from instrument.journal import JOURNAL_NAME

CATALOGUE_NAME = "catalogue.sqlite"
#: Counts up when a row is made differently.
VERSION = 2
#: Run folders lie in the data folder, or one deeper: a folder for each laboratory, sample or year.
_PATTERNS = (f"*/{JOURNAL_NAME}", f"*/*/{JOURNAL_NAME}")
_BUSY_S = 5.0
#: SQLite files begin so.
_MAGIC = b"SQLite format 3\0"
_LOG = logging.getLogger(__name__)
_NUMBERS = {"planned": "INTEGER", "measured": "INTEGER", "skipped": "INTEGER"} | dict.fromkeys(FIGURES, "REAL")


class Catalogue:
    """The catalogue of a folder that holds run folders.

    Parameters
    ----------
    folder
        Of the data.
    file
        Where the catalogue lies; ``catalogue.sqlite`` in the folder by default.

    Raises
    ------
    InputError
        If there is no such folder.
    """

    def __init__(self, folder: Path, file: Path | None = None) -> None:
        if not folder.is_dir():
            raise InputError(f"{folder}: no such folder; expected one that holds run folders")
        self.folder = folder
        self.file = folder / CATALOGUE_NAME if file is None else file

    def search(self, query: Query | None = None, *, rebuild: bool = False) -> list[Entry]:
        """The runs that a query holds for, oldest first, as the folders are now.

        Parameters
        ----------
        rebuild
            Read every folder again, whatever the catalogue remembers.
        """
        query = query or Query()
        try:
            return self._search(self.file, query, rebuild)
        except sqlite3.OperationalError as error:
            _LOG.info("%s: %s; the folders are read instead", self.file, error)
        except sqlite3.DatabaseError as error:
            _LOG.info("%s: %s; it is made anew", self.file, error)
            if _is_ours(self.file):
                self.file.unlink()
                return self._search(self.file, query, rebuild)
        return self._search(None, query, rebuild)

    def _search(self, file: Path | None, query: Query, rebuild: bool) -> list[Entry]:
        with closing(_open(file)) as database, database:
            self._refresh(database, rebuild)
            condition, values = query.sql()
            names = ", ".join(COLUMNS)
            # The condition is made of names of columns and question marks alone.
            found = database.execute(f"SELECT {names} FROM runs WHERE {condition} ORDER BY created, name", values)
            return [Entry(*row) for row in found]

    def _refresh(self, database: sqlite3.Connection, rebuild: bool) -> None:
        """Bring the rows to what the folders are: new, changed and gone ones."""
        if rebuild:
            database.execute("DELETE FROM runs")
        known = {
            name: (kept, outcome)
            for name, kept, outcome in database.execute("SELECT name, signature, outcome FROM runs")
        }
        folders = {path.parent.relative_to(self.folder).as_posix(): path.parent for path in journals(self.folder)}
        database.executemany("DELETE FROM runs WHERE name = ?", [(name,) for name in known if name not in folders])
        marks = ", ".join("?" * (len(COLUMNS) + 1))
        for name, folder in folders.items():
            now = signature(folder)
            # Whoever wrote a running one may have died without changing a file.
            if known.get(name, ("", ""))[0] != now or known[name][1] == RUNNING:
                row = (*astuple(read_entry(folder, name)), now)
                database.execute(f"INSERT OR REPLACE INTO runs VALUES ({marks})", row)


def journals(folder: Path) -> list[Path]:
    """Journals of the run folders in a data folder, or one deeper."""
    return sorted(path for pattern in _PATTERNS for path in folder.glob(pattern))


def _open(file: Path | None) -> sqlite3.Connection:
    """The database with its table; one of another version or without it begins anew."""
    database = sqlite3.connect(":memory:" if file is None else file, timeout=_BUSY_S)
    try:
        (version,) = database.execute("PRAGMA user_version").fetchone()
        if version > VERSION:
            raise sqlite3.OperationalError(f"version {version}, made by a newer program")
        (tables,) = database.execute("SELECT count(*) FROM sqlite_master").fetchone()
        if tables and not version:
            raise sqlite3.OperationalError("tables of another program")
        if version < VERSION:
            database.execute("DROP TABLE IF EXISTS runs")
            columns = ", ".join(f"{name} {_NUMBERS.get(name, 'TEXT')}" for name in COLUMNS)
            database.execute(f"CREATE TABLE runs ({columns}, signature TEXT, PRIMARY KEY (name))")
            database.execute(f"PRAGMA user_version = {VERSION}")
            database.commit()
    except sqlite3.DatabaseError:
        database.close()
        raise
    return database


def _is_ours(file: Path) -> bool:
    """Whether a damaged file was a database once: any other of that name is not ours to take away."""
    with file.open("rb") as handle:
        return handle.read(len(_MAGIC)) == _MAGIC

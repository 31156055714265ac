"""A results folder: one SQLite file in write-ahead mode, one writer, tied to what its numbers depend on.

A study says which tables it needs (`tables.ResultTable`). Beside them stands `meta`: preset, fingerprint, settings,
format, device, version of gapfinder.
"""

from __future__ import annotations

import contextlib
import errno
import json
import os
import re
import sqlite3
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Self

from study.pipeline.settings import StudySettings, device_type
from study.pipeline.tables import R, ResultTable
from sysid import InvalidInput
from sysid.errors import excerpt
from sysid.version import installed_version

META = "CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL);"


class Database:
    """An open results folder; a context manager that holds the folder's lock. `db` is its SQLite connection.

    settings, device: what its numbers are tied to; outputs: the names of what the study writes beside its database,
    never over files of somebody else.

    Raises InvalidInput where the folder cannot be used: no folder, not writable, of another preset, device or version,
    in use by another study, or holding foreign files of the names in `outputs`. Nothing is written before these checks.
    """

    def __init__(
        self,
        folder: Path,
        settings: StudySettings,
        tables: Sequence[ResultTable[Any]] = (),
        outputs: Collection[str] = (),
        device: str = "cpu",
    ) -> None:
        self.folder, self.path, self.device = folder, folder / "results.sqlite", device
        identity = {
            "preset": settings.name,
            "gapfinder": installed_version("gapfinder"),
            "format": settings.format,
            "fingerprint": settings.fingerprint,
            "settings": json.dumps(settings.to_dict()),
            "device": device_type(device),
        }
        schema = META + "".join(table.schema for table in tables)
        _make(folder)
        self._lock = _lock(folder)
        try:
            if not self.path.exists():
                self._refuse_foreign_files(outputs)
            with _readable(self.path):
                self._open(schema, identity)
        except BaseException:
            self.close()
            raise

    def _refuse_foreign_files(self, outputs: Collection[str]) -> None:
        there = [name for name in outputs if (self.folder / name).exists()]
        if there:
            raise InvalidInput(
                f"{self.folder} holds {' and '.join(there)} but no results.sqlite, so they are not of this study: "
                "expected an empty folder or one that a study made; choose another --out"
            )

    def _open(self, schema: str, expected: Mapping[str, str]) -> None:
        if self.path.exists() and 0 < self.path.stat().st_size < 512:  # SQLite takes it for an empty one
            raise InvalidInput(f"{self.path} is not a database of this study: choose another --out")
        self.db = sqlite3.connect(self.path, timeout=3.0, isolation_level=None)
        tables = [name for (name,) in self.db.execute("SELECT name FROM sqlite_master WHERE type = 'table'")]
        if tables and "meta" not in tables:
            raise InvalidInput(f"{self.path} is a database of something else: choose another --out")
        if tables:
            self._check(dict(self.db.execute("SELECT key, value FROM meta")), expected)
            lacking = [name for name in re.findall(r"CREATE TABLE (\w+)", schema) if name not in tables]
            if lacking:
                raise InvalidInput(f"{self.path} has no table {lacking[0]}, as a study makes one: choose another --out")
        self.db.execute("PRAGMA journal_mode = WAL")
        self.db.execute("PRAGMA synchronous = FULL")
        self.db.execute("BEGIN IMMEDIATE")
        if not tables:
            for statement in schema.split(";")[:-1]:
                self.db.execute(statement)
            self.db.executemany("INSERT INTO meta VALUES (?, ?)", expected.items())
        self.db.execute("COMMIT")
        self.db.execute("PRAGMA busy_timeout = 600000")

    def _check(self, stored: Mapping[str, str], expected: Mapping[str, str]) -> None:
        for key, label in (("preset", "preset"), ("gapfinder", "gapfinder version"), ("format", "format")):
            if stored.get(key) != expected[key]:
                raise InvalidInput(
                    f"{self.folder} holds results of {label} {stored.get(key)!r}, expected {expected[key]!r}: "
                    "choose another --out, or move that folder away"
                )
        if stored.get("fingerprint") != expected["fingerprint"]:
            was, now = dict(json.loads(stored.get("settings", "{}"))), json.loads(expected["settings"])
            changed = [f"{k} = {excerpt(was.get(k))}, now {now[k]}" for k in now if was.get(k) != now[k]]
            raise InvalidInput(
                f"{self.folder} holds results of other settings of preset {expected['preset']!r} "
                f"({'; '.join(changed) or 'unknown'}): choose another --out, or move that folder away"
            )
        if stored.get("device") != expected["device"]:
            raise InvalidInput(
                f"{self.folder} holds runs of device {stored.get('device')!r}, where other agents train together than "
                f"on {expected['device']!r}: go on with --device {stored.get('device')}, or choose another --out"
            )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the database and give the folder's lock back."""
        if hasattr(self, "db"):
            self.db.close()
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    @contextlib.contextmanager
    def transaction(self) -> Iterator[sqlite3.Connection]:
        """All or nothing. Raises OSError where the file is full, locked or read-only."""
        try:
            self.db.execute("BEGIN IMMEDIATE")
            yield self.db
            self.db.execute("COMMIT")
        except sqlite3.OperationalError as error:
            self._undo()
            raise OSError(f"{self.path} cannot be written ({error})") from error
        except BaseException:
            self._undo()
            raise

    def add(self, table: ResultTable[R], values: Iterable[R]) -> None:
        """Keep values whose keys are new; all or nothing. Raises OSError as `transaction` does."""
        with self.transaction() as db:
            for row in map(table.row, values):
                places = ", ".join("?" * len(row))
                db.execute(f"INSERT INTO {table.name} VALUES ({places}) ON CONFLICT DO NOTHING", row)

    def all(self, table: ResultTable[R]) -> list[R]:
        """Everything in a table, sorted by its keys."""
        with _readable(self.path):
            return [table.value(row) for row in self.db.execute(f"SELECT * FROM {table.name} ORDER BY {table.key}")]

    def keys(self, table: ResultTable[Any]) -> set[tuple[Any, ...]]:
        """The keys of everything in a table."""
        with _readable(self.path):
            return set(self.db.execute(f"SELECT {table.key} FROM {table.name}"))

    def _undo(self) -> None:
        if self.db.in_transaction:  # SQLite itself has rolled back where the disk is full
            self.db.execute("ROLLBACK")


def _make(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        raise InvalidInput(f"{folder} is a file: expected a folder for the results; choose another --out") from None
    except OSError as error:
        raise InvalidInput(f"the folder {folder} cannot be made ({error.strerror}): choose another --out") from None
    if not os.access(folder, os.W_OK | os.X_OK):
        raise InvalidInput(f"the folder {folder} is not writable: choose another --out")


def _lock(folder: Path) -> int | None:
    """The folder's lock, which the system gives back when this process ends, however it ends."""
    try:
        import fcntl
    except ImportError:  # not a Unix system: SQLite's own lock has to do
        return None
    handle = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if error.errno != errno.EBADF:
                raise
            os.close(handle)  # a network disk locks only what is open for writing, which no folder can be
            handle = os.open(folder / "lock", os.O_RDWR | os.O_CREAT, 0o644)
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(handle)
        raise InvalidInput(
            f"another study is running in {folder}: wait until it ends, or choose another --out"
        ) from None
    return handle


@contextlib.contextmanager
def _readable(path: Path) -> Iterator[None]:
    """Turn what SQLite says, and what rows that nobody of us wrote do to their reader, into sentences."""
    try:
        yield
    except InvalidInput:
        raise
    except (ValueError, TypeError, LookupError, AttributeError):
        raise InvalidInput(f"{path} holds what no study wrote: expected the results of one") from None
    except sqlite3.OperationalError as error:
        if "locked" in str(error):
            raise InvalidInput(
                f"{path} is locked by another process: wait until it ends, or choose another --out"
            ) from None
        raise InvalidInput(f"{path} cannot be used ({error}): choose another --out") from None
    except sqlite3.DatabaseError as error:
        raise InvalidInput(f"{path} is not a database of this study ({error}): choose another --out") from None

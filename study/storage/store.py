"""The results folder: one SQLite file in write-ahead mode, one writer, tied to one preset, device and version.

estimates     theta_hat of every (point, n, seed)
runs          every finished (point, n, w, seed): settings, theta_hat, returns, learning curve, versions, seconds
controllers   returns on the hidden plant (truth_m, truth_l) of a reference designed at (m, l), by seed
training      seconds spent on each unfinished population, as of its last checkpoint
meta          preset, fingerprint, format, device, version of gapfinder
"""

from __future__ import annotations

import contextlib
import errno
import json
import os
import sqlite3
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

from study.cells import Run, Summary
from study.config import FORMAT, Cell, Preset, device_type
from study.identification import Estimated, Theta
from study.references import Reference
from study.storage.policy_files import FOLDER
from study.versions import version
from sysid import InvalidInput

FIGURES = ("heatmap", "pareto", "gap", "curves")
HELD = ("published_heatmap", "published_pareto", "published_contrasts", "published_claims", "identifiers")
"""Figures of a point, and those of the whole preset beside the publication."""

SCHEMA = """
CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL);
CREATE TABLE estimates (
    point TEXT, n INTEGER, seed INTEGER, m REAL, l REAL, seconds REAL, PRIMARY KEY (point, n, seed));
CREATE TABLE runs (
    point TEXT, n INTEGER, w REAL, seed INTEGER, population INTEGER, theta_hat_m REAL, theta_hat_l REAL, id_error REAL,
    returns TEXT, curve TEXT, settings TEXT, versions TEXT, seconds REAL, fresh_returns TEXT, imported TEXT,
    summary TEXT, PRIMARY KEY (point, n, w, seed));
CREATE TABLE controllers (
    controller TEXT, m REAL, l REAL, truth_m REAL, truth_l REAL, seed INTEGER, returns TEXT, versions TEXT,
    seconds REAL, PRIMARY KEY (controller, m, l, truth_m, truth_l, seed));
CREATE TABLE training (population INTEGER PRIMARY KEY, seconds REAL);
"""


def outputs(preset: Preset) -> tuple[str, ...]:
    """What a study writes beside its database; never over files of somebody else."""
    drawn = tuple(figure_name(preset, point.name, name) for point in preset.points for name in FIGURES)
    held = (f"{name}.png" for name in HELD)
    return ("runs.csv", "references.csv", "study.json", *drawn, *held, "report.html", FOLDER)


def figure_name(preset: Preset, point: str, name: str) -> str:
    """The file of a figure: NAME.png, and NAME_POINT.png where the preset has several points."""
    return f"{name}.png" if len(preset.points) == 1 else f"{name}_{point}.png"


class Store:
    """The open results folder of a preset; a context manager that holds the folder's lock.

    Raises InvalidInput where the folder cannot be used: no folder, not writable, of another preset, device or version,
    in use by another study, or holding foreign files of the names in `outputs`. Nothing is written before these checks.
    """

    def __init__(self, folder: Path, preset: Preset, device: str = "cpu") -> None:
        self.folder, self.preset, self.device = folder, preset, device
        self.path = folder / "results.sqlite"
        _make(folder)
        self._lock = _lock(folder)
        try:
            if not self.path.exists():
                self._refuse_foreign_files()
            with _readable(self.path):
                self._open()
        except BaseException:
            self.close()
            raise

    def _refuse_foreign_files(self) -> None:
        there = [name for name in outputs(self.preset) if (self.folder / name).exists()]
        if there:
            raise InvalidInput(
                f"{self.folder} holds {' and '.join(there)} but no results.sqlite, so they are not of this study: "
                "expected an empty folder or one that a study made; choose another --out"
            )

    def _open(self) -> None:
        self.db = sqlite3.connect(self.path, timeout=3.0, isolation_level=None)
        tables = {name for (name,) in self.db.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
        expected = self._identity()
        if tables and "meta" not in tables:
            raise InvalidInput(f"{self.path} is a database of something else: choose another --out")
        if tables:
            self._check(dict(self.db.execute("SELECT key, value FROM meta")), expected)
        self.db.execute("PRAGMA journal_mode = WAL")
        self.db.execute("PRAGMA synchronous = FULL")
        self.db.execute("BEGIN IMMEDIATE")
        if not tables:
            for statement in SCHEMA.split(";")[:-1]:
                self.db.execute(statement)
            self.db.executemany("INSERT INTO meta VALUES (?, ?)", expected.items())
        self.db.execute("COMMIT")
        self.db.execute("PRAGMA busy_timeout = 600000")

    def _identity(self) -> dict[str, str]:
        return {
            "preset": self.preset.name,
            "gapfinder": version("gapfinder"),
            "format": str(FORMAT),
            "fingerprint": self.preset.fingerprint,
            "settings": json.dumps(self.preset.to_dict()),
            "device": device_type(self.device),
        }

    def _check(self, found: dict[str, str], expected: dict[str, str]) -> None:
        for key, label in (("preset", "preset"), ("gapfinder", "gapfinder version"), ("format", "format")):
            if found.get(key) != expected[key]:
                raise InvalidInput(
                    f"{self.folder} holds results of {label} {found.get(key)!r}, expected {expected[key]!r}: "
                    "choose another --out, or move that folder away"
                )
        if found.get("fingerprint") != expected["fingerprint"]:
            was, now = json.loads(found.get("settings", "{}")), self.preset.to_dict()
            changed = [f"{k} = {was.get(k)}, now {now[k]}" for k in now if was.get(k) != now[k]]
            raise InvalidInput(
                f"{self.folder} holds results of other settings of preset {self.preset.name!r} "
                f"({'; '.join(changed) or 'unknown'}): choose another --out, or move that folder away"
            )
        if found.get("device") != expected["device"]:
            raise InvalidInput(
                f"{self.folder} holds runs of device {found.get('device')!r}, where other agents train together than "
                f"on {expected['device']!r}: go on with --device {found.get('device')}, or choose another --out"
            )

    def __enter__(self) -> Store:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the database and give the folder's lock back."""
        if hasattr(self, "db"):
            self.db.close()
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    @contextlib.contextmanager
    def _transaction(self) -> Iterator[sqlite3.Connection]:
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

    def _undo(self) -> None:
        if self.db.in_transaction:  # SQLite itself has rolled back where the disk is full
            self.db.execute("ROLLBACK")

    def add_estimates(self, estimates: Sequence[Estimated]) -> None:
        """Keep what identification found, in place of an earlier answer."""
        rows = [(e.point, e.n, e.seed, *e.theta, e.seconds) for e in estimates]
        with self._transaction() as db:
            db.executemany("INSERT OR REPLACE INTO estimates VALUES (?, ?, ?, ?, ?, ?)", rows)

    def estimates(self) -> dict[tuple[str, int, int], Theta]:
        """theta_hat by (point, n, seed)."""
        rows = self.db.execute("SELECT point, n, seed, m, l FROM estimates ORDER BY point, n, seed")
        return {(point, n, seed): (m, length) for point, n, seed, m, length in rows}

    def add_runs(self, runs: Sequence[Run]) -> None:
        """Keep the runs of a finished population, all or none, but for those that were imported before."""
        imported = "SELECT 1 FROM runs WHERE point = ? AND n = ? AND w = ? AND seed = ? AND imported <> ''"
        rows = [write_run(run) for run in runs if not self.db.execute(imported, run.cell).fetchone()]
        with self._transaction() as db:
            db.executemany(f"INSERT INTO runs VALUES ({', '.join('?' * 16)})", rows)
            db.executemany("DELETE FROM training WHERE population = ?", {(r.population,) for r in runs})

    def add_imported(self, runs: Sequence[Run]) -> int:
        """Take up runs from elsewhere where there are none yet, all or none of them; returns how many."""
        finished = self.finished()
        rows = [write_run(run) for run in runs if run.cell not in finished]
        with self._transaction() as db:
            db.executemany(f"INSERT INTO runs VALUES ({', '.join('?' * 16)})", rows)
        return len(rows)

    def finished(self) -> set[Cell]:
        """The cells whose runs are kept."""
        return {Cell(*row) for row in self.db.execute("SELECT point, n, w, seed FROM runs")}

    def runs(self) -> list[Run]:
        """The finished runs, sorted by point, n, w, seed."""
        return [read_run(row) for row in self.db.execute("SELECT * FROM runs ORDER BY point, n, w, seed")]

    def add_references(self, references: Sequence[Reference]) -> None:
        """Keep what reference controllers returned."""
        rows = [
            (r.controller, *r.theta, *r.truth, r.seed, json.dumps(r.returns), json.dumps(r.versions), r.seconds)
            for r in references
        ]
        with self._transaction() as db:
            db.executemany("INSERT INTO controllers VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?)", rows)

    def references(self) -> list[Reference]:
        """What reference controllers returned, sorted."""
        return [
            Reference(controller, (m, l), (truth_m, truth_l), seed, tuple(json.loads(returns)), json.loads(found), s)
            for controller, m, l, truth_m, truth_l, seed, returns, found, s in self.db.execute(  # noqa: E741
                "SELECT * FROM controllers ORDER BY controller, m, l, truth_m, truth_l, seed"
            )
        ]

    def note_training(self, population: int, seconds: float) -> None:
        """Keep the seconds that a population's checkpoint holds."""
        with self._transaction() as db:
            db.execute("INSERT OR REPLACE INTO training VALUES (?, ?)", (population, seconds))

    def training_seconds(self, population: int) -> float:
        """The seconds that a population's checkpoint holds; 0 without one."""
        row = self.db.execute("SELECT seconds FROM training WHERE population = ?", (population,)).fetchone()
        return float(row[0]) if row else 0.0


def write_run(run: Run) -> tuple[Any, ...]:
    """A run as a row of the table `runs`."""
    summary = None if run.summary is None else (run.summary.mean, run.summary.std, run.summary.fresh_mean)
    return (
        *run.cell, run.population, *run.theta_hat, run.id_error, json.dumps(run.returns), json.dumps(run.curve),
        json.dumps(run.settings), json.dumps(run.versions), run.seconds, json.dumps(run.fresh_returns), run.imported,
        json.dumps(summary),
    )  # fmt: skip


def read_run(row: Sequence[Any]) -> Run:
    """The run in a row of the table `runs`."""
    point, n, w, seed, population, m, length, error, returns, curve, settings, found, seconds, fresh, source, mean = row
    summary = json.loads(mean)
    return Run(
        cell=Cell(point, n, w, seed),
        population=population,
        theta_hat=(m, length),
        id_error=error,
        returns=tuple(json.loads(returns)),
        curve=tuple((step, value) for step, value in json.loads(curve)),
        settings=json.loads(settings),
        versions=json.loads(found),
        seconds=seconds,
        fresh_returns=tuple(json.loads(fresh)),
        imported=source,
        summary=None if summary is None else Summary(*summary),
    )


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
    """Turn SQLite's errors at opening into sentences."""
    try:
        yield
    except sqlite3.OperationalError as error:
        if "locked" in str(error):
            raise InvalidInput(
                f"{path} is locked by another process: wait until it ends, or choose another --out"
            ) from None
        raise InvalidInput(f"{path} cannot be used ({error}): choose another --out") from None
    except sqlite3.DatabaseError as error:
        raise InvalidInput(f"{path} is not a database of this study ({error}): choose another --out") from None

"""A results folder, whatever tables its study needs: it keeps all or nothing, and refuses what is not its own."""

import dataclasses
import errno
import os
import sqlite3
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import pytest

from study.paper.finished_runs import RUNS, Run
from study.paper.presets import SMOKE, Cell
from study.paper.sweep import sweep_results
from study.paper.sweep_page import outputs
from study.pipeline.database import Database
from study.pipeline.publication import PUBLISHED
from study.pipeline.settings import StudySettings
from study.pipeline.tables import ResultTable
from study.strategies.session import STEPS, CaseRound
from study.strategies.trial_experiment import trial_results
from study.strategies.trial_page import FIGURE, TABLES
from sysid import InvalidInput


@dataclass(frozen=True)
class Plan(StudySettings):
    """The least that a results folder can be tied to."""

    name: str = "trial"
    steps: int = 1200
    layout = 1
    page = "study.mismatch.mismatch_page"


TIED = Plan()


@dataclass(frozen=True)
class Kind:
    """A kind of results folder: how it is opened, and how it keeps two items, the second one of 2 MB."""

    open: Callable[..., Database]
    settings: StudySettings
    outputs: tuple[str, ...]
    item: Any
    large: Any
    table: ResultTable

    def add(self, store, items):
        store.add(self.table, items)

    def items(self, store):
        return store.all(self.table)


RUN = Run(Cell("main", 5, 0.5, 1), (1.785, 1.65), 0.26, -1.25, 0.0, -3.0, 7.5, (-1.25,), (), ((200, -3.5),))
ROUND = CaseRound(Case("coulomb", "encoder", "c", 5, 1), 0, {"verdict": "coulomb"}, 7.5)
LARGE = RUN.cell._replace(seed=2)
KINDS = {
    "study": Kind(
        sweep_results, SMOKE, (*outputs(SMOKE), *PUBLISHED), RUN,
        dataclasses.replace(RUN, cell=LARGE, curve=RUN.curve * 200_000), RUNS,
    ),
    "mismatch": Kind(
        trial_results, Plan(), (*TABLES, FIGURE), ROUND,
        dataclasses.replace(ROUND, case=ROUND.case._replace(seed=2), payload={"steps": [1] * 700_000}), STEPS,
    ),
}  # fmt: skip


@pytest.fixture(params=KINDS)
def kind(request):
    return KINDS[request.param]


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir() if not path.name.startswith("results.sqlite-")}


def test_what_went_in_comes_out_again(kind, tmp_path):
    with kind.open(tmp_path / "a" / "b", kind.settings) as store:
        kind.add(store, [kind.item])
    with kind.open(tmp_path / "a" / "b", kind.settings) as store:
        assert kind.items(store) == [kind.item]
        assert store.db.execute("PRAGMA journal_mode").fetchone() == ("wal",)


def test_a_reader_can_look_while_a_study_runs(kind, tmp_path):
    with kind.open(tmp_path, kind.settings) as store:
        kind.add(store, [kind.item])
        with sqlite3.connect(f"file:{store.path}?mode=ro", uri=True) as reader:
            assert list(reader.iterdump()) == list(store.db.iterdump())


def test_what_breaks_in_a_transaction_leaves_nothing(kind, tmp_path):
    with kind.open(tmp_path, kind.settings) as store:
        kind.add(store, [kind.item])
        before = list(store.db.iterdump())
        with pytest.raises(KeyboardInterrupt), store.transaction() as db:
            db.execute("DELETE FROM meta")
            raise KeyboardInterrupt
        assert list(store.db.iterdump()) == before


KILLED = """
import os, sys
from dataclasses import dataclass
from pathlib import Path
from study.pipeline.database import Database
from study.pipeline.settings import StudySettings

@dataclass(frozen=True)
class Plan(StudySettings):
    name: str = "trial"
    steps: int = 1200
    layout = 1
    page = "study.mismatch.mismatch_page"

database = Database(Path(sys.argv[1]), Plan())
with database.transaction() as db:
    db.execute("INSERT INTO meta VALUES ('first', '1')")
with database.transaction() as db:
    db.execute("INSERT INTO meta VALUES ('second', '2')")
    os._exit(9)
"""


def test_a_process_that_dies_in_a_transaction_leaves_nothing_and_no_lock(tmp_path):
    assert subprocess.run([sys.executable, "-c", KILLED, str(tmp_path)], check=False).returncode == 9
    with Database(tmp_path, TIED) as database:
        kept = {key for (key,) in database.db.execute("SELECT key FROM meta")}
    assert "first" in kept and "second" not in kept


def test_a_folder_of_another_name_is_refused_and_left_alone(kind, tmp_path):
    with kind.open(tmp_path, kind.settings) as store:
        kind.add(store, [kind.item])
    before = contents(tmp_path)
    with pytest.raises(InvalidInput, match=f"preset '{kind.settings.name}', expected 'other'"):
        kind.open(tmp_path, dataclasses.replace(kind.settings, name="other"))
    assert contents(tmp_path) == before


def test_a_folder_of_other_settings_is_refused_and_left_alone(kind, tmp_path):
    with kind.open(tmp_path, kind.settings) as store:
        kind.add(store, [kind.item])
    before = contents(tmp_path)
    with pytest.raises(InvalidInput, match=rf"preset '{kind.settings.name}' \(steps = 1200, now 700\)"):
        kind.open(tmp_path, dataclasses.replace(kind.settings, steps=700))
    assert contents(tmp_path) == before


def test_a_folder_of_another_device_is_refused(kind, tmp_path):
    kind.open(tmp_path, kind.settings, "cuda:0").close()
    kind.open(tmp_path, kind.settings, "cuda:1").close()
    with pytest.raises(InvalidInput, match="go on with --device cuda"):
        kind.open(tmp_path, kind.settings, "cpu")


@pytest.mark.parametrize(("key", "label"), [("gapfinder", "gapfinder version"), ("format", "format")])
def test_a_folder_of_another_version_is_refused(kind, tmp_path, key, label):
    with kind.open(tmp_path, kind.settings) as store:
        store.db.execute("UPDATE meta SET value = '0.0.0' WHERE key = ?", (key,))
    with pytest.raises(InvalidInput, match=f"{label} '0.0.0'"):
        kind.open(tmp_path, kind.settings)


def locks_only_what_is_open_for_writing(fcntl):
    """flock by the rule of network disks."""
    flock = fcntl.flock

    def lock(handle, how):
        if fcntl.fcntl(handle, fcntl.F_GETFL) & os.O_ACCMODE == os.O_RDONLY:
            raise OSError(errno.EBADF, "Bad file descriptor")
        flock(handle, how)

    return lock


@pytest.mark.parametrize("disk", ["local", "network"])
def test_two_studies_in_one_folder_are_refused(disk, kind, tmp_path, monkeypatch):
    if disk == "network":
        fcntl = pytest.importorskip("fcntl", reason="this system has no flock")
        monkeypatch.setattr(fcntl, "flock", locks_only_what_is_open_for_writing(fcntl))
    with kind.open(tmp_path, kind.settings), pytest.raises(InvalidInput, match="another study is running"):
        kind.open(tmp_path, kind.settings)
    kind.open(tmp_path, kind.settings).close()


def test_a_database_that_another_program_locks_later_is_told(kind, tmp_path):
    with kind.open(tmp_path, kind.settings) as store:
        kind.add(store, [kind.item])
        store.db.execute("PRAGMA busy_timeout = 1")
        other = sqlite3.connect(store.path, isolation_level=None)
        other.execute("BEGIN IMMEDIATE")
        with pytest.raises(OSError, match=r"results.sqlite cannot be written \(database is locked\)"):
            kind.add(store, [kind.large])
        other.close()
        assert kind.items(store) == [kind.item]


def test_a_database_that_became_read_only_is_told(kind, tmp_path):
    with kind.open(tmp_path, kind.settings) as store:
        kind.add(store, [kind.item])
        store.db.execute("PRAGMA query_only = ON")
        with pytest.raises(OSError, match=r"results.sqlite cannot be written \(attempt to write a readonly database\)"):
            kind.add(store, [kind.large])
        assert kind.items(store) == [kind.item]


def test_a_full_disk_is_told_and_nothing_is_lost(kind, tmp_path):
    with kind.open(tmp_path, kind.settings) as store:
        kind.add(store, [kind.item])
        pages = store.db.execute("PRAGMA page_count").fetchone()[0]
        store.db.execute(f"PRAGMA max_page_count = {pages + 3}")
        with pytest.raises(OSError, match=r"results.sqlite cannot be written \(database or disk is full\)"):
            kind.add(store, [kind.large])
        assert kind.items(store) == [kind.item]
    with kind.open(tmp_path, kind.settings) as store:
        kind.add(store, [kind.large])
        assert kind.items(store) == [kind.item, kind.large]


@pytest.mark.parametrize(
    ("kind", "name"), [(kind, name) for kind in KINDS for name in KINDS[kind].outputs], indirect=["kind"]
)
def test_foreign_files_are_not_overwritten(kind, name, tmp_path):
    (tmp_path / name).write_text("mine")
    with pytest.raises(InvalidInput, match="but no results"):
        kind.open(tmp_path, kind.settings)
    assert contents(tmp_path) == {name: b"mine"}


def test_a_database_that_another_program_locks_is_refused(tmp_path):
    Database(tmp_path, TIED).close()
    other = sqlite3.connect(tmp_path / "results.sqlite", isolation_level=None)
    other.execute("BEGIN EXCLUSIVE")
    with pytest.raises(InvalidInput, match="locked by another process"):
        Database(tmp_path, TIED)
    other.close()


@pytest.mark.parametrize("content", [b"this is a text, long enough to be no SQLite header", b"SQLite format 3\0 no"])
def test_a_file_that_is_no_database_is_refused(tmp_path, content):
    (tmp_path / "results.sqlite").write_bytes(content)
    with pytest.raises(InvalidInput, match="not a database of this study"):
        Database(tmp_path, TIED)
    assert contents(tmp_path) == {"results.sqlite": content}


def test_a_database_of_something_else_is_refused(tmp_path):
    with sqlite3.connect(tmp_path / "results.sqlite") as other:
        other.execute("CREATE TABLE cakes (name TEXT)")
    other.close()
    before = contents(tmp_path)
    with pytest.raises(InvalidInput, match="something else"):
        Database(tmp_path, TIED)
    assert contents(tmp_path) == before


def test_a_file_or_an_unwritable_place_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InvalidInput, match="is a file"):
        Database(tmp_path / "file", TIED)
    with pytest.raises(InvalidInput, match="cannot be made"):
        Database(tmp_path / "file" / "below", TIED)
    if os.geteuid() != 0:
        (tmp_path / "shut").mkdir(mode=0o500)
        with pytest.raises(InvalidInput, match="not writable"):
            Database(tmp_path / "shut", TIED)

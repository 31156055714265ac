"""A results folder, whatever tables its study needs: it keeps all or nothing, and refuses what is not its own."""

import dataclasses
import errno
import os
import sqlite3
import subprocess
import sys

import pytest

from study.paper.presets import SMOKE
from study.pipeline.database import Database
from study.strategies.session import STEPS, CaseRound
from study.strategies.trial_plan import Case
from sysid import InvalidInput

OUTPUTS = ("cases.csv", "policies")
ITEM = CaseRound(Case("coulomb", "encoder", "c", 5, 1), 0, {"verdict": "coulomb"}, 7.5)
LARGE = dataclasses.replace(ITEM, case=ITEM.case._replace(seed=2), payload={"steps": [1] * 700_000})
"""2 MB."""


def opened(folder, settings=SMOKE, device="cpu"):
    return Database(folder, settings, (STEPS,), OUTPUTS, device)


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir() if not path.name.startswith("results.sqlite-")}


def test_a_reader_can_look_while_a_study_runs(tmp_path):
    with opened(tmp_path / "a" / "b") as store:
        assert store.db.execute("PRAGMA journal_mode").fetchone() == ("wal",)
        store.add(STEPS, [ITEM])
        with sqlite3.connect(f"file:{store.path}?mode=ro", uri=True) as reader:
            assert list(reader.iterdump()) == list(store.db.iterdump())


def test_what_breaks_in_a_transaction_leaves_nothing(tmp_path):
    with opened(tmp_path) as store:
        store.add(STEPS, [ITEM])
        before = list(store.db.iterdump())
        with pytest.raises(KeyboardInterrupt), store.transaction() as db:
            db.execute("DELETE FROM meta")
            raise KeyboardInterrupt
        assert list(store.db.iterdump()) == before


KILLED = """
import os, sys
from pathlib import Path
from study.paper.presets import SMOKE
from study.pipeline.database import Database
database = Database(Path(sys.argv[1]), SMOKE)
with database.transaction() as db:
    db.execute("INSERT INTO meta VALUES ('first', '1')")
with database.transaction() as db:
    db.execute("INSERT INTO meta VALUES ('second', '2')")
    os._exit(9)
"""


def test_a_process_that_dies_in_a_transaction_leaves_nothing_and_no_lock(tmp_path):
    assert subprocess.run([sys.executable, "-c", KILLED, str(tmp_path)], check=False).returncode == 9
    with Database(tmp_path, SMOKE) as database:
        kept = {key for (key,) in database.db.execute("SELECT key FROM meta")}
    assert "first" in kept and "second" not in kept


@pytest.mark.parametrize(
    ("other", "message"),
    [
        ({"name": "other"}, f"preset '{SMOKE.name}', expected 'other'"),
        ({"steps": 700}, rf"preset '{SMOKE.name}' \(steps = {SMOKE.steps}, now 700\)"),
    ],
)
def test_a_folder_of_another_name_or_other_settings_is_refused_and_left_alone(tmp_path, other, message):
    with opened(tmp_path) as store:
        store.add(STEPS, [ITEM])
    before = contents(tmp_path)
    with pytest.raises(InvalidInput, match=message):
        opened(tmp_path, dataclasses.replace(SMOKE, **other))
    assert contents(tmp_path) == before


def test_a_folder_of_another_device_is_refused(tmp_path):
    opened(tmp_path, SMOKE, "cuda:0").close()
    opened(tmp_path, SMOKE, "cuda:1").close()
    with pytest.raises(InvalidInput, match="go on with --device cuda"):
        opened(tmp_path, SMOKE, "cpu")


@pytest.mark.parametrize(("key", "label"), [("gapfinder", "gapfinder version"), ("format", "format")])
def test_a_folder_of_another_version_is_refused(tmp_path, key, label):
    with opened(tmp_path) as store:
        store.db.execute("UPDATE meta SET value = '0.0.0' WHERE key = ?", (key,))
    with pytest.raises(InvalidInput, match=f"{label} '0.0.0'"):
        opened(tmp_path)


def locks_only_what_is_open_for_writing(fcntl):
    """flock by the rule of network disks."""
    flock = fcntl.flock

    def lock(handle, how):
        if fcntl.fcntl(handle, fcntl.F_GETFL) & os.O_ACCMODE == os.O_RDONLY:
            raise OSError(errno.EBADF, "Bad file descriptor")
        flock(handle, how)

    return lock


@pytest.mark.parametrize("disk", ["local", "network"])
def test_two_studies_in_one_folder_are_refused(disk, tmp_path, monkeypatch):
    if disk == "network":
        fcntl = pytest.importorskip("fcntl", reason="this system has no flock")
        monkeypatch.setattr(fcntl, "flock", locks_only_what_is_open_for_writing(fcntl))
    with opened(tmp_path), pytest.raises(InvalidInput, match="another study is running"):
        opened(tmp_path)
    opened(tmp_path).close()


def test_a_database_that_another_program_locks_later_is_told(tmp_path):
    with opened(tmp_path) as store:
        store.add(STEPS, [ITEM])
        store.db.execute("PRAGMA busy_timeout = 1")
        other = sqlite3.connect(store.path, isolation_level=None)
        other.execute("BEGIN IMMEDIATE")
        with pytest.raises(OSError, match=r"results.sqlite cannot be written \(database is locked\)"):
            store.add(STEPS, [LARGE])
        other.close()
        assert store.all(STEPS) == [ITEM]


@pytest.mark.parametrize(
    ("pragma", "message"),
    [("query_only = ON", "attempt to write a readonly database"), ("max_page_count = {}", "database or disk is full")],
)
def test_a_database_that_becomes_read_only_or_a_full_disk_is_told_and_nothing_is_lost(tmp_path, pragma, message):
    with opened(tmp_path) as store:
        store.add(STEPS, [ITEM])
        pages = store.db.execute("PRAGMA page_count").fetchone()[0]
        store.db.execute(f"PRAGMA {pragma.format(pages + 3)}")
        with pytest.raises(OSError, match=rf"results.sqlite cannot be written \({message}\)"):
            store.add(STEPS, [LARGE])
        assert store.all(STEPS) == [ITEM]
    with opened(tmp_path) as store:
        store.add(STEPS, [LARGE])
        assert store.all(STEPS) == [ITEM, LARGE]


@pytest.mark.parametrize("name", OUTPUTS)
def test_foreign_files_are_not_overwritten(name, tmp_path):
    (tmp_path / name).write_text("mine")
    with pytest.raises(InvalidInput, match="but no results"):
        opened(tmp_path)
    assert contents(tmp_path) == {name: b"mine"}


def test_a_database_that_another_program_locks_is_refused(tmp_path):
    Database(tmp_path, SMOKE).close()
    other = sqlite3.connect(tmp_path / "results.sqlite", isolation_level=None)
    other.execute("BEGIN EXCLUSIVE")
    with pytest.raises(InvalidInput, match="locked by another process"):
        Database(tmp_path, SMOKE)
    other.close()


@pytest.mark.parametrize("content", [b"this is a text, long enough to be no SQLite header", b"SQLite format 3\0 no"])
def test_a_file_that_is_no_database_is_refused(tmp_path, content):
    (tmp_path / "results.sqlite").write_bytes(content)
    with pytest.raises(InvalidInput, match="not a database of this study"):
        Database(tmp_path, SMOKE)
    assert contents(tmp_path) == {"results.sqlite": content}


def test_a_database_of_something_else_is_refused(tmp_path):
    with sqlite3.connect(tmp_path / "results.sqlite") as other:
        other.execute("CREATE TABLE cakes (name TEXT)")
    other.close()
    before = contents(tmp_path)
    with pytest.raises(InvalidInput, match="something else"):
        Database(tmp_path, SMOKE)
    assert contents(tmp_path) == before


def test_a_file_or_an_unwritable_place_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InvalidInput, match="is a file"):
        Database(tmp_path / "file", SMOKE)
    with pytest.raises(InvalidInput, match="cannot be made"):
        Database(tmp_path / "file" / "below", SMOKE)
    if os.geteuid() != 0:
        (tmp_path / "shut").mkdir(mode=0o500)
        with pytest.raises(InvalidInput, match="not writable"):
            Database(tmp_path / "shut", SMOKE)

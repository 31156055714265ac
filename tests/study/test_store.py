"""The results folder: keeps what it is given, and refuses what is not its own."""

import dataclasses
import errno
import os
import sqlite3

import pytest

from study.cells import Run
from study.config import QUICK, SMOKE, Cell
from study.identification import Estimated
from study.references import Reference
from study.storage.store import Store, outputs
from sysid import InvalidInput

CURVE, SETTINGS = ((200, -3.5),), {"sac": {"steps": 1}}
RUN = Run(Cell("main", 5, 0.5, 1), 0, (1.785, 1.65), 0.26, (-1.25, -2.5), CURVE, SETTINGS, {"torch": "2"}, 7.5, (-3.0,))
REFERENCE = Reference("optimal", (2.1, 1.5), (2.0, 1.5), 1, (-1.0, -2.0), {"numpy": "2"}, 3.0)
ESTIMATED = Estimated("main", 5, 1, (1.785, 1.65), 0.5)


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir() if not path.name.startswith("results.sqlite-")}


def test_what_went_in_comes_out_again(tmp_path):
    with Store(tmp_path / "a" / "b", SMOKE) as store:
        store.note_training(0, 12.5)
        assert store.training_seconds(0) == 12.5
        store.add_runs([RUN])
        store.add_references([REFERENCE])
        store.add_estimates([ESTIMATED])
        assert store.training_seconds(0) == 0.0
    with Store(tmp_path / "a" / "b", SMOKE) as store:
        assert store.runs() == [RUN]
        assert store.references() == [REFERENCE]
        assert store.estimates() == {("main", 5, 1): (1.785, 1.65)}
        assert store.finished() == {RUN.cell}
        assert store.db.execute("PRAGMA journal_mode").fetchone() == ("wal",)


def test_a_population_is_kept_whole_or_not_at_all(tmp_path):
    with Store(tmp_path, SMOKE) as store:
        with pytest.raises(sqlite3.IntegrityError):
            store.add_runs([RUN, RUN])
        assert store.runs() == []


def test_a_reader_can_look_while_a_study_runs(tmp_path):
    with Store(tmp_path, SMOKE) as store:
        store.add_runs([RUN])
        with sqlite3.connect(f"file:{store.path}?mode=ro", uri=True) as reader:
            assert reader.execute("SELECT COUNT(*) FROM runs").fetchone() == (1,)


@pytest.mark.parametrize(
    ("other", "told"),
    [(QUICK, "preset 'smoke', expected 'quick'"), (dataclasses.replace(SMOKE, steps=700), "steps = 1200, now 700")],
)
def test_a_folder_of_another_preset_is_refused_and_left_alone(tmp_path, other, told):
    with Store(tmp_path, SMOKE) as store:
        store.add_runs([RUN])
    before = contents(tmp_path)
    with pytest.raises(InvalidInput, match=told):
        Store(tmp_path, other)
    assert contents(tmp_path) == before


def test_a_folder_of_another_device_is_refused(tmp_path):
    Store(tmp_path, SMOKE, "cuda:0").close()
    Store(tmp_path, SMOKE, "cuda:1").close()
    with pytest.raises(InvalidInput, match="go on with --device cuda"):
        Store(tmp_path, SMOKE, "cpu")


@pytest.mark.parametrize(("key", "label"), [("gapfinder", "gapfinder version"), ("format", "format")])
def test_a_folder_of_another_version_is_refused(tmp_path, key, label):
    with Store(tmp_path, SMOKE) as store:
        store.db.execute("UPDATE meta SET value = '0.0.0' WHERE key = ?", (key,))
    with pytest.raises(InvalidInput, match=f"{label} '0.0.0'"):
        Store(tmp_path, SMOKE)


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
    with Store(tmp_path, SMOKE), pytest.raises(InvalidInput, match="another study is running"):
        Store(tmp_path, SMOKE)
    Store(tmp_path, SMOKE).close()


def test_a_database_that_another_program_locks_is_refused(tmp_path):
    Store(tmp_path, SMOKE).close()
    other = sqlite3.connect(tmp_path / "results.sqlite", isolation_level=None)
    other.execute("BEGIN EXCLUSIVE")
    with pytest.raises(InvalidInput, match="locked by another process"):
        Store(tmp_path, SMOKE)
    other.close()


def test_a_database_that_another_program_locks_later_is_told(tmp_path):
    with Store(tmp_path, SMOKE) as store:
        store.add_runs([RUN])
        store.db.execute("PRAGMA busy_timeout = 1")
        other = sqlite3.connect(store.path, isolation_level=None)
        other.execute("BEGIN IMMEDIATE")
        with pytest.raises(OSError, match=r"results.sqlite cannot be written \(database is locked\)"):
            store.note_training(0, 1.0)
        other.close()
        assert store.runs() == [RUN]


def test_a_full_disk_is_told_and_nothing_is_lost(tmp_path):
    large = dataclasses.replace(RUN, cell=RUN.cell._replace(seed=2), curve=CURVE * 100_000)
    with Store(tmp_path, SMOKE) as store:
        store.add_runs([RUN])
        pages = store.db.execute("PRAGMA page_count").fetchone()[0]
        store.db.execute(f"PRAGMA max_page_count = {pages + 3}")
        with pytest.raises(OSError, match=r"results.sqlite cannot be written \(database or disk is full\)"):
            store.add_runs([large])
        assert store.runs() == [RUN]
    with Store(tmp_path, SMOKE) as store:
        store.add_runs([large])
        assert store.runs() == [RUN, large]


@pytest.mark.parametrize("name", outputs(SMOKE))
def test_foreign_files_are_not_overwritten(tmp_path, name):
    (tmp_path / name).write_text("mine")
    with pytest.raises(InvalidInput, match="but no results"):
        Store(tmp_path, SMOKE)
    assert contents(tmp_path) == {name: b"mine"}


@pytest.mark.parametrize("content", [b"this is a text, long enough to be no SQLite header", b"SQLite format 3\0 no"])
def test_a_file_that_is_no_database_is_refused(tmp_path, content):
    (tmp_path / "results.sqlite").write_bytes(content)
    with pytest.raises(InvalidInput, match="not a database of this study"):
        Store(tmp_path, SMOKE)
    assert contents(tmp_path) == {"results.sqlite": content}


def test_a_database_of_something_else_is_refused(tmp_path):
    with sqlite3.connect(tmp_path / "results.sqlite") as other:
        other.execute("CREATE TABLE cakes (name TEXT)")
    other.close()
    before = contents(tmp_path)
    with pytest.raises(InvalidInput, match="something else"):
        Store(tmp_path, SMOKE)
    assert contents(tmp_path) == before


def test_a_file_or_an_unwritable_place_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InvalidInput, match="is a file"):
        Store(tmp_path / "file", SMOKE)
    with pytest.raises(InvalidInput, match="cannot be made"):
        Store(tmp_path / "file" / "below", SMOKE)
    if os.geteuid() != 0:
        (tmp_path / "shut").mkdir(mode=0o500)
        with pytest.raises(InvalidInput, match="not writable"):
            Store(tmp_path / "shut", SMOKE)

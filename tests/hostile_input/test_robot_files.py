"""Whatever a Parquet, an HDF5, a .mat or a bag holds or claims, it is read, or refused in one sentence."""

import io
import sqlite3
import struct
import zlib

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

import sysid
from sysid.data import guarded
from tests.hostile_input.answering import ARRAYS, CELLS, ESC, answered
from tests.sysid.robot_files import FORMS, write_bag, write_bag_file, write_mat_73, write_parquet

COLUMNS = {name: values[:60] for name, values in ARRAYS.items()}
some = settings(max_examples=80, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
changes = st.lists(st.tuples(st.integers(0, 1 << 20), st.integers(0, 255)), max_size=8)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The bytes of a log in a file of each format."""
    folder = tmp_path_factory.mktemp("whole")
    forms = ("mat 4", "mat 5", "mat 7.3", "parquet", "db3", "mcap")
    return {form: FORMS[form](folder / form, COLUMNS).read_bytes() for form in forms}


@some
@given(
    form=st.sampled_from(["mat 4", "mat 5", "mat 7.3", "parquet", "db3", "mcap"]), changes=changes, cut=st.floats(0, 1)
)
def test_a_damaged_file_is_refused_or_read(whole, tmp_path_factory, form, changes, cut):
    content = bytearray(whole[form])
    for place, byte in changes:
        content[place % len(content)] = byte
    path = tmp_path_factory.getbasetemp() / "log"
    path.write_bytes(content[: int(cut * len(content))] if not changes else content)
    answered(sysid.read, path)


def test_what_crashes_stalls_or_bloats_its_reader_is_refused_and_the_next_file_is_read(whole, tmp_path, monkeypatch):
    """Each of these ends the process that reads."""
    (tmp_path / "log").write_bytes(whole["parquet"])
    for program in (
        "import os; os.abort()",
        "while True: pass",
        "import sys; sys.stdin.readline()",
        "print('no JSON')",
    ):
        monkeypatch.setattr(guarded, "_reader", None)
        with monkeypatch.context() as patch:
            patch.setattr(guarded, "PROGRAM", program)
            patch.setattr(guarded, "SECONDS", 2.0)
            assert not answered(sysid.read, tmp_path / "log")
        assert answered(sysid.read, tmp_path / "log")


def element(kind, content):
    return struct.pack("<II", kind, len(content)) + content + bytes(-len(content) % 8)


def mat_5(name, dimensions, data):
    """A compressed matrix of MATLAB's version 5, whose dimensions and data need not agree."""
    flags = element(6, struct.pack("<II", 6, 0))
    matrix = element(14, flags + element(5, struct.pack("<2i", *dimensions)) + element(1, name) + data)
    return b"MATLAB 5.0 MAT-file".ljust(124) + b"\0\1IM" + element(15, zlib.compress(matrix))


@pytest.mark.parametrize("dimensions", [(1, 10**9), (2**31 - 1, 2**31 - 1), (-1, -5), (0, 7), (3, 50)], ids=str)
@pytest.mark.parametrize("size", [0, 8, 400, 1 << 31], ids=str)
def test_a_matrix_claims_what_it_likes(dimensions, size, tmp_path):
    data = struct.pack("<II", 9, size) + bytes(400)
    (tmp_path / "log").write_bytes(mat_5(b"t", dimensions, data))
    assert not answered(sysid.read, tmp_path / "log", "t=t,theta=t")


@pytest.mark.parametrize("rows", [10**9, 10**12, 2**40])
def test_a_data_set_claims_what_it_likes(rows, tmp_path):
    h5py = pytest.importorskip("h5py")
    path = write_mat_73(tmp_path / "log", COLUMNS)
    with h5py.File(path, "a") as file:
        del file["theta"]
        file.create_dataset("theta", (rows,), "f8", chunks=(1000,), compression="gzip")
    assert not answered(sysid.read, path)


def test_groups_that_hold_themselves_and_what_is_no_number(tmp_path):
    h5py = pytest.importorskip("h5py")
    path = write_mat_73(tmp_path / "log", {"t": COLUMNS["t"]})
    with h5py.File(path, "a") as file:
        file["loop"] = file["/"]
        file["words"] = np.array([b"a", b"b"])
        file["reference"] = file["t"].ref
        file.create_dataset("nothing", data=h5py.Empty("f8"))
        file.create_dataset("pair", (5,), np.dtype([("a", "f8"), ("b", "f8")]))
        file.create_virtual_dataset("virtual", h5py.VirtualLayout((5,), "f8"))
    for name in ("loop", "words", "reference", "nothing", "pair", "virtual"):
        assert not answered(lambda name=name: sysid.read(path, columns={"theta": name}))


@some
@given(names=st.lists(st.one_of(CELLS, st.sampled_from([ESC, "x" * 10**5, "t", "theta"])), min_size=1, max_size=6))
@example(names=["t", "t", "theta"])
def test_hostile_names_of_columns(tmp_path_factory, names):
    path = tmp_path_factory.getbasetemp() / "names"
    pyarrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    names = [name.encode(errors="replace").decode() for name in names]
    parquet.write_table(pyarrow.Table.from_arrays([pyarrow.array(COLUMNS["t"])] * len(names), names), path)
    answered(sysid.read, path)


def test_a_parquet_that_claims_terabytes(tmp_path):
    """The footer says 10^12 rows; and a column of one value, packed, that is far too long in truth."""
    pyarrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    content = write_parquet(tmp_path / "log", COLUMNS).read_bytes()
    rows = bytes([2 * 60])  # zigzag of 60, the number of rows and of values of each column
    claimed = content.replace(b"\x16" + rows, b"\x16" + rows[:1].replace(rows, b"\xfe\xff\xff\x0f"))
    (tmp_path / "log").write_bytes(claimed)
    answered(sysid.read, tmp_path / "log")
    long = pyarrow.array(np.zeros(30_000_000, dtype=np.int8))
    parquet.write_table(pyarrow.table({"t": long, "theta": long}), tmp_path / "long")
    assert (tmp_path / "long").stat().st_size < 1 << 20
    assert not answered(sysid.read, tmp_path / "long")


@pytest.mark.parametrize("storage", ["SQLITE3", "MCAP"])
def test_a_bag_lies_about_its_length(storage, tmp_path):
    path = write_bag(tmp_path / "log", COLUMNS, storage)
    said = (path / "metadata.yaml").read_text()
    for other in (0, 10**15, -1, '"many"'):
        (path / "metadata.yaml").write_text(said.replace("message_count: 60", f"message_count: {other}"))
        answered(sysid.read, path)
    for lie in (
        "",
        "- " * 10**5,
        "rosbag2_bagfile_information: [1]",
        said.replace("log_0", "../../etc/passwd"),
        "&a [*a]",
    ):
        (path / "metadata.yaml").write_text(lie)
        answered(sysid.read, path)


def test_a_message_lies_about_its_length(tmp_path):
    path = write_bag_file(tmp_path / "log", COLUMNS, "SQLITE3")
    with sqlite3.connect(path) as db:
        (content,) = db.execute("SELECT data FROM messages").fetchone()
    for size in (0, 2, 1000, 2**31, 2**32 - 1):
        for place in range(16, len(content) - 4, 4):
            with sqlite3.connect(path) as db:
                lying = content[:place] + struct.pack("<I", size) + content[place + 4 :]
                db.execute("UPDATE messages SET data = ? WHERE id % 2 = 1", (lying,))
            db.close()
            answered(sysid.read, path)


ENDLESS = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT max(i) AS schema_version FROM n"


@pytest.mark.parametrize("statement", [f"DROP TABLE schema; CREATE VIEW schema AS {ENDLESS}", "DROP TABLE topics"])
def test_a_data_base_that_never_answers_or_is_no_bag(statement, tmp_path, monkeypatch):
    monkeypatch.setattr(guarded, "SECONDS", 3.0)
    path = write_bag_file(tmp_path / "log", COLUMNS, "SQLITE3")
    with sqlite3.connect(path) as db:
        db.executescript(statement)
    db.close()
    assert not answered(sysid.read, path)


def test_data_frames_of_anything():
    pandas = pytest.importorskip("pandas")
    n = len(COLUMNS["t"])
    good = pandas.DataFrame(COLUMNS)
    assert answered(sysid.read, good)
    for frame in (
        pandas.DataFrame(),
        good.assign(theta=[{}] * n),
        good.assign(theta=[None] * n),
        good.assign(theta=[10**400] * n),
        good.assign(theta=pandas.Categorical(["a"] * n)),
        good.assign(theta=COLUMNS["theta"] + 1j),
        good.assign(t=pandas.NaT),
        good.rename(columns={"theta": ESC, "theta_dot": 3}),
        good.set_axis([["t", "theta", "theta_dot", "torque"], list("abcd")], axis=1),
        good.set_index("theta", drop=False),
    ):
        assert not answered(sysid.read, frame)


def test_a_pickle_in_any_file_stays_one(tmp_path):
    import pickle

    class Trap:
        def __reduce__(self):
            return (open, (str(tmp_path / "sprung"), "w"))

    content = io.BytesIO()
    np.save(content, np.array([Trap()], dtype=object), allow_pickle=True)
    for kind in (pickle.dumps(Trap()), content.getvalue()):
        (tmp_path / "log").write_bytes(kind)
        assert not answered(sysid.read, tmp_path / "log")
    assert not (tmp_path / "sprung").exists()


def test_what_a_sentence_shows_of_a_name_is_short_whatever_it_is_made_of():
    for name in ("\0" * 700, "\x1b" * 10**5, "x" * 10**5, "\u202e" * 300):
        assert len(str(sysid.InvalidInput(f"no column {name!r}"))) <= 800
        assert len(str(sysid.InvalidInput(f"no column {name}"))) <= 800

"""Whatever a name, a file or a number is, a command answers, or says in one sentence why not."""

import copy
import io
import json
import math
import os
import sqlite3
import zipfile
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

import sysid
from policies.__main__ import main as policies_main
from policies.network_policy import NetworkPolicy
from policies.storage.policy_file import DESCRIPTION, load_policy, save_policy
from study.paper.imported_runs import import_runs
from study.paper.presets import PRESETS
from study.paper.sweep_results import SweepResults
from sysid.__main__ import main as sysid_main
from sysid.cli.log_settings import settings as log_settings
from sysid.data.files import check_outputs
from sysid.errors import LONGEST, InvalidInput

RESULTS = Path(__file__).parents[1] / "study" / "results"
MODEL = sysid.Model(
    sysid.RodPendulum(g=9.81), (sysid.Viscous(b=0.1), sysid.Delay(T=0.02)), sysid.RK4(2), dt=0.05, u_max=2.0
)
ESC = "\x1b[31m"

many = settings(max_examples=300, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))


def answered(call, *arguments):
    """Whether a call answers; that it refuses in one short printable sentence else. Anything else is raised."""
    try:
        call(*arguments)
    except InvalidInput as refusal:
        text = str(refusal)
        assert text and len(text) <= 4 * LONGEST
        assert text.isprintable() or all(c.isprintable() or c.isspace() for c in text)
        assert "\n" not in text and "Error" not in text and "Traceback" not in text
        return False
    return True


def refused(main, words, capsys):
    """What a command line says of bad input: one line, exit code 2."""
    assert main(words) == 2
    said = capsys.readouterr()
    assert said.err.startswith("error: ") and said.err.count("\n") == 1 and "\x1b" not in said.out + said.err
    return said.err


# ---- names -----------------------------------------------------------------------------------------------------------

NAMES = st.one_of(
    st.text(st.characters(codec=None), max_size=20),
    st.sampled_from(
        ["", ".", "loop", "loop/log.csv", "a\0b", "\ud800", "a\udc80", "x" * 300, "y/" * 3000, "fifo", ESC]
    ),
)
READERS = (sysid.read, sysid.load, sysid.load_effects, load_policy, log_settings)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a loop of links and a pipe that nobody writes to."""
    path = tmp_path_factory.mktemp("names")
    (path / "loop").symlink_to("loop")
    os.mkfifo(path / "fifo")
    return path


@many
@given(name=NAMES, suffix=st.sampled_from(["", ".csv", ".npz", ".mat", ".json", ".py"]))
def test_no_name_ends_in_a_traceback(folder, name, suffix):
    path = Path(f"{folder}/{name}{suffix}")
    for reader in READERS:
        assert not answered(reader, path)


@many
@given(name=NAMES)
def test_no_name_of_an_output_ends_in_a_traceback_or_takes_the_place_of_a_device(folder, name):
    path = Path(f"{folder}/{name}")
    if answered(check_outputs, [], [path]):
        assert path.parent.is_dir() and not path.exists()
    for device in ("fifo", "loop"):
        assert not answered(sysid.save, MODEL, folder / device)
    assert (folder / "fifo").is_fifo() and (folder / "loop").is_symlink()


# ---- arrays ----------------------------------------------------------------------------------------------------------

T = 0.02 * np.arange(200)
ARRAYS = {"t": T, "theta": 3.0 + np.sin(3.0 * T), "theta_dot": 3.0 * np.cos(3.0 * T), "torque": np.cos(T)}


def packed(save, **options):
    content = io.BytesIO()
    save(content, **options)
    return content.getvalue()


NPZ = packed(np.savez, **ARRAYS)
MAT = packed(scipy.io.savemat, mdict=ARRAYS, do_compression=True)


def header(shape, kind="<f8"):
    content = io.BytesIO()
    np.lib.format.write_array_header_1_0(content, {"descr": kind, "fortran_order": False, "shape": shape})
    return content.getvalue() + bytes(800)


def zipped(theta):
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("t.npy", header((100,)))
        file.writestr("theta.npy", theta)
    return content.getvalue()


@many
@given(changes=st.lists(st.tuples(st.integers(0, len(NPZ) - 1), st.integers(0, 255)), max_size=8), cut=st.integers(0))
@example(changes=[(6, 1)], cut=0)
def test_a_damaged_npz_is_refused_or_read(tmp_path_factory, changes, cut):
    content = bytearray(NPZ)
    for place, byte in changes:
        content[place] = byte
    path = tmp_path_factory.getbasetemp() / "log.npz"
    path.write_bytes(content[: cut % (len(NPZ) + 1)] if cut else content)
    answered(sysid.read, path)


@pytest.mark.parametrize("shape", [(10**12,), (10**18,), (10**30,), (-1,), (2**62, 4), (0, 10**12), ("x",)], ids=str)
def test_an_array_claims_what_it_likes(shape, tmp_path):
    (tmp_path / "log.npz").write_bytes(zipped(header(shape)))
    assert not answered(sysid.read, tmp_path / "log.npz")


@pytest.mark.parametrize("kind", ["|O", "<U10", "|V1000000000", "zzz"])
def test_an_array_of_something_else(kind, tmp_path):
    (tmp_path / "log.npz").write_bytes(zipped(header((100,), kind)))
    assert not answered(sysid.read, tmp_path / "log.npz")


@pytest.mark.parametrize(("place", "value"), [(6, 1), (8, 1), (8, 97), (8, 65535)], ids=str)
def test_an_npz_that_is_encrypted_or_compressed_in_another_way(place, value, tmp_path):
    content = bytearray(NPZ)
    for mark, offset in ((b"PK\3\4", 0), (b"PK\1\2", 2)):
        at = content.find(mark)
        while at >= 0:
            content[at + place + offset : at + place + offset + 2] = value.to_bytes(2, "little")
            at = content.find(mark, at + 4)
    (tmp_path / "log.npz").write_bytes(content)
    assert not answered(sysid.read, tmp_path / "log.npz")


@many
@given(cut=st.integers(0, len(MAT) - 1))
def test_a_mat_that_was_cut_short_is_refused(tmp_path_factory, cut):
    path = tmp_path_factory.getbasetemp() / "log.mat"
    path.write_bytes(MAT[:cut])
    answered(sysid.read, path)


# ---- text ------------------------------------------------------------------------------------------------------------

CELLS = st.one_of(
    st.floats().map(repr),
    st.sampled_from(["", "nan", "1e308", "-1e400", "1e-320", "1_0", "0x10", "\u0661", ESC, "x" * 5000]),
    st.text(max_size=5),
)
SCALES = st.sampled_from([0.0, 1.0, 1e3, 1e6, 1e9, 1e150, 1e308, 1e-9, 1e-320])


@many
@given(scales=st.tuples(*[SCALES] * 4), cell=CELLS, row=st.integers(0, 199), column=st.integers(0, 3), name=CELLS)
def test_a_table_of_any_numbers_is_refused_or_read(tmp_path_factory, scales, cell, row, column, name):
    """Overflow, other units of time, a cell or a name of anything."""
    rows = [
        [repr(float(v) * s) for v, s in zip(line, scales, strict=True)] for line in zip(*ARRAYS.values(), strict=True)
    ]
    rows[row][column] = cell
    path = tmp_path_factory.getbasetemp() / "log.csv"
    text = "\n".join([f"t,theta,theta_dot,torque,{name}", *map(",".join, rows)])
    path.write_text(text, encoding="utf-8", errors="surrogatepass")
    answered(sysid.read, path)


@pytest.mark.parametrize("unit", [1e3, 1e6, 1e9])
def test_a_clock_that_counts_something_else_is_told_at_once(unit, tmp_path, capsys):
    rows = zip(unit * T, *list(ARRAYS.values())[1:2], ARRAYS["torque"], strict=True)
    path = tmp_path / "log.csv"
    path.write_text("t,theta,torque\n" + "".join(",".join(map(repr, map(float, row))) + "\n" for row in rows))
    assert "--time-unit" in refused(sysid_main, ["diagnose", str(path)], capsys)


@pytest.mark.parametrize("name", [ESC, "\x07", "\u202e", "\x9b31m", "x" * 10**6])
def test_a_name_in_a_file_does_not_reach_the_terminal_as_it_is(name, tmp_path, capsys):
    (tmp_path / "log.csv").write_text(f"t,{name}\n0,1\n")
    (tmp_path / "log.toml").write_text(f"columns = {json.dumps('theta=' + name)}\n")
    for option in ("none", str(tmp_path / "log.toml")):
        assert main_line(sysid_main, ["fit", str(tmp_path / "log.csv"), "--log", option], capsys)


def main_line(main, words, capsys):
    said = refused(main, words, capsys)
    return said.strip().isprintable() and len(said) < 1000


# ---- JSON ------------------------------------------------------------------------------------------------------------


def places(data, above=()):
    for key, value in data.items() if isinstance(data, dict) else enumerate(data):
        yield (*above, key)
        if isinstance(value, dict | list):
            yield from places(value, (*above, key))


def changed(data, place, value):
    data = copy.deepcopy(data)
    at = data
    for key in place[:-1]:
        at = at[key]
    at[place[-1]] = value
    return json.dumps(data)


VALUES = st.one_of(
    st.sampled_from([None, True, 0, -1, 1e-9, 1e6, 1e9, 10**400, -(10**400), 1e308, math.nan, math.inf]),
    st.sampled_from([ESC, "x" * 10**5, [], {}, [[1]], {ESC: 1}]),
    st.recursive(st.none() | st.floats() | st.text(max_size=5), lambda v: st.lists(v, max_size=3), max_leaves=5),
)


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """A model.json as data, and the folder of a policy."""
    path = tmp_path_factory.mktemp("saved")
    sysid.save(MODEL, path / "model.json")
    layers = (
        (np.ones((3, 4), np.float32), np.ones(4, np.float32)),
        (np.ones((4, 1), np.float32), np.ones(1, np.float32)),
    )
    save_policy(NetworkPolicy(layers, 2.0, 0), MODEL, path / "policy", {})
    return path


@many
@given(data=st.data())
def test_any_value_in_a_model_is_refused_or_read(saved, data):
    model = json.loads((saved / "model.json").read_text())
    text = changed(model, data.draw(st.sampled_from(list(places(model)))), data.draw(VALUES))
    (saved / "changed.json").write_text(text)
    answered(sysid.load, saved / "changed.json")


@many
@given(data=st.data())
def test_any_value_in_a_policy_is_refused_or_read(saved, data):
    before = (saved / "policy" / DESCRIPTION).read_text()
    policy = json.loads(before)
    try:
        text = changed(policy, data.draw(st.sampled_from(list(places(policy)))), data.draw(VALUES))
        (saved / "policy" / DESCRIPTION).write_text(text)
        answered(load_policy, saved / "policy")
    finally:
        (saved / "policy" / DESCRIPTION).write_text(before)


# ---- what costs the machine ------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """A short log with noise, of a model that has its rate."""
    rng = np.random.default_rng(0)
    path = tmp_path_factory.mktemp("log")
    u = np.repeat(rng.uniform(-2.0, 2.0, 20), 10)
    model = sysid.Model(sysid.RodPendulum(g=9.81), dt=0.02)
    truth = sysid.simulate(model, u, math.pi, 0.0)
    sysid.write_csv(sysid.Sensor(theta=0.003, theta_dot=0.05).measure(truth, rng)[0], path / "log.csv")
    sysid.save(sysid.fit(model, sysid.read(path / "log.csv"), sysid.Sensor(0.003, 0.05)), path / "model.json")
    return path


COSTS = {
    "rollouts": ("experiment", "--rollouts", "1000000000"),
    "duration": ("experiment", "--duration", "1e6"),
    "duration beyond numbers": ("experiment", "--duration", "1e308"),
    "interval": ("fit", "--dt", "1e9"),
    "interval of nothing": ("fit", "--dt", "1e-300"),
}


@pytest.mark.parametrize("words", COSTS.values(), ids=COSTS.keys())
def test_what_would_cost_the_machine_is_refused(words, log, capsys):
    command, *options = words
    refused(sysid_main, [command, str(log / "log.csv"), "--model", str(log / "model.json"), *options], capsys)


@pytest.mark.parametrize(("name", "value"), [("dt", 1e-9), ("dt", 1e-5), ("substeps", 10**6), ("substeps", 10**9)])
def test_a_model_of_tiny_steps_is_refused(name, value, log, saved, tmp_path, capsys):
    for file, main, words in (
        (log / "model.json", sysid_main, ["fit", str(log / "log.csv"), "--model"]),
        (saved / "model.json", policies_main, ["train", "--out", str(tmp_path / "policy"), "--steps", "10"]),
        (saved / "model.json", policies_main, ["evaluate", str(saved / "policy"), "--model"]),
    ):
        model = json.loads(file.read_text())
        (model if name == "dt" else model["integrator"]["settings"])[name] = value
        (tmp_path / "model.json").write_text(json.dumps(model))
        refused(main, [*words, str(tmp_path / "model.json")], capsys)


TRAININGS = {
    "steps": ("--steps", "10000000000"),
    "layers": ("--hidden", "100000"),
    "a layer": ("--hidden", "1000000000"),
    "agents": ("--agents", "1000", "--hidden", "4096", "4096"),
    "seed": ("--seed", str(2**70)),
    "interval": ("--dt", "1e-9"),
}


@pytest.mark.parametrize("words", TRAININGS.values(), ids=TRAININGS.keys())
def test_a_training_that_would_cost_the_machine_is_refused(words, saved, tmp_path, capsys):
    out = tmp_path / "policy"
    refused(policies_main, ["train", str(saved / "model.json"), "-o", str(out), *words], capsys)
    assert not out.exists()


def test_episodes_that_would_cost_the_machine_are_refused(saved, capsys):
    refused(policies_main, ["evaluate", str(saved / "policy"), "--episodes", "1000000000"], capsys)


# ---- a user's effects ------------------------------------------------------------------------------------------------

EFFECT = """from dataclasses import dataclass
from sysid import JointEffect, ops, parameter, register

@register
@dataclass(frozen=True, eq=False)
class Weight(JointEffect):
    {declared}
    a: ops.Value = parameter(0.0, unit="N m", bounds=(0.0, 1.0), neutral=0.0)

    def torque(self, joint):
        {first}
        return -self.a * ops.sin(joint.theta)
"""
RAISED = ("KeyboardInterrupt", "SystemExit(0)", "GeneratorExit", "BaseException('\\n\\x1b[31m')", "MemoryError", "Bad")
BAD = "class Bad(BaseException):\n    def __str__(self): return 3\n"
EFFECTS = {
    **{f"file {raised}": f"{BAD}raise {raised}\n" for raised in RAISED},
    **{f"torque {raised}": BAD + EFFECT.format(declared="", first=f"raise {raised}") for raised in RAISED},
    **{
        f"declared {declared}": EFFECT.format(declared=declared, first="")
        for declared in ("name = 3", "formula = 3", "confused = 3", "rarity = 'x'", "refines = 3", "name = 'x' * 10**6")
    },
    "for ever": "def f(): f()\nf()\n",
    "a number": "from sysid import register\nregister(3)\n",
    "no effect": "from sysid import register\n@register\nclass Weight: pass\n",
    "nothing": "x = 3\n",
    "NUL": "a\0b",
}


@pytest.mark.parametrize("text", EFFECTS.values(), ids=EFFECTS.keys())
def test_an_effect_may_raise_anything_or_be_none(text, tmp_path, capsys):
    (tmp_path / "mine.py").write_text(text)
    before = dict(sysid.CATALOGUE)
    assert "mine.py" in refused(sysid_main, ["effects", "--effects", str(tmp_path / "mine.py")], capsys)
    assert before == sysid.CATALOGUE


def test_an_effect_that_raises_in_the_middle_is_blamed_with_its_line(log, tmp_path, capsys):
    count = "import builtins; builtins.seen = getattr(builtins, 'seen', 0) + 1; assert builtins.seen < 200, 'too often'"
    (tmp_path / "mine.py").write_text(EFFECT.format(declared="", first=count))
    before = dict(sysid.CATALOGUE)
    try:
        words = ["fit", str(log / "log.csv"), "--effects", str(tmp_path / "mine.py"), "--with", "weight"]
        assert "mine.py, line 11 raises AssertionError: too often" in refused(sysid_main, words, capsys)
    finally:
        sysid.CATALOGUE.clear()
        sysid.CATALOGUE.update(before)


# ---- the results of a study ------------------------------------------------------------------------------------------

STATEMENTS = {
    "no table": "DROP TABLE runs",
    "another table": "DROP TABLE runs; CREATE TABLE runs (a)",
    "a view": "DROP TABLE runs; CREATE VIEW runs AS SELECT 1",
    "another meta": "DROP TABLE meta; CREATE TABLE meta (a)",
    "settings of nothing": "UPDATE meta SET value = '[1' WHERE key IN ('settings', 'fingerprint')",
    "settings of a list": "UPDATE meta SET value = '[1]' WHERE key IN ('settings', 'fingerprint')",
    "another preset": f"UPDATE meta SET value = '{ESC}{'x' * 10**5}' WHERE key = 'preset'",
    "text for numbers": "INSERT INTO estimates VALUES ('main', 'a', 'b', 'c', 'd', 'e')",
    "text for seconds": "INSERT INTO training VALUES (1, 'long')",
    "nothing in a run": "INSERT INTO runs (point, n, w, seed) VALUES ('main', 0, 0.0, 0)",
    "no JSON in a run": "INSERT INTO runs VALUES ('main', 0, 0.0, 0, 0, 1, 1, 0, 'f', 'g', 'h', 'i', 1, 'k', '', 'm')",
    "other JSON in a run": (
        "INSERT INTO runs VALUES ('main', 0, 0.0, 0, 0, 1, 1, 0, '[\"a\"]', '[[1]]', '3', '3', 1, '{}', '', '[1]')"
    ),
}


def opened(path):
    with SweepResults(path, PRESETS["smoke"]) as results:
        assert results.runs() is not None and results.estimates() is not None
        results.training_seconds(1)


@pytest.mark.parametrize("statements", STATEMENTS.values(), ids=STATEMENTS.keys())
def test_results_of_another_kind_are_refused(statements, tmp_path):
    opened(tmp_path)
    with sqlite3.connect(tmp_path / "results.sqlite") as db:
        db.executescript(statements)
    db.close()
    assert not answered(opened, tmp_path)
    answered(import_runs, tmp_path / "results.sqlite", PRESETS["smoke"], defaultdict(lambda: (1.0, 1.0)))


@pytest.mark.parametrize("size", [1, 100, 5000, 30000])
def test_results_that_were_cut_short_are_refused(size, tmp_path):
    opened(tmp_path)
    content = (tmp_path / "results.sqlite").read_bytes()
    (tmp_path / "results.sqlite").write_bytes(content[:size])
    assert not answered(opened, tmp_path)


RUNS = (RESULTS / "paper-small" / "runs.csv").read_text().splitlines()[:3]


@many
@given(cells=st.lists(st.tuples(st.integers(0, 2), st.integers(0, 9), CELLS), max_size=4), cut=st.integers(0, 900))
@example(cells=[(1, 2, "x" * 200_000)], cut=0)
@example(cells=[(1, 1, "9" * 5000)], cut=0)
def test_any_cell_in_a_table_of_runs_is_refused_or_read(tmp_path_factory, cells, cut):
    rows = [line.split(",") for line in RUNS]
    for row, column, cell in cells:
        rows[row][column] = cell
    path = tmp_path_factory.getbasetemp() / "runs.csv"
    text = "\n".join(map(",".join, rows)).encode(errors="surrogatepass")
    path.write_bytes(text[: len(text) - cut])
    answered(import_runs, path, PRESETS["paper-small"], defaultdict(lambda: (1.0, 1.0)))

"""Whatever a table, a model.json or a policy.json says, it is read, or refused in one sentence."""

import copy
import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

import sysid
from policies.storage.policy_file import DESCRIPTION, load_policy
from sysid.__main__ import main as sysid_main
from tests.hostile_input.answering import ARRAYS, CELLS, ESC, answered, many, refused

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


@pytest.mark.parametrize("name", [ESC, "\x07", "\u202e", "\x9b31m", "x" * 10**6])
def test_a_name_in_a_file_does_not_reach_the_terminal_as_it_is(name, tmp_path, capsys):
    (tmp_path / "log.csv").write_text(f"t,{name}\n0,1\n")
    (tmp_path / "log.toml").write_text(f"columns = {json.dumps('theta=' + name)}\n")
    for option in ("none", str(tmp_path / "log.toml")):
        assert main_line(sysid_main, ["fit", str(tmp_path / "log.csv"), "--log", option], capsys)


def main_line(main, words, capsys):
    said = refused(main, words, capsys)
    return said.strip().isprintable() and len(said) < 1000


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

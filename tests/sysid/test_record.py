"""Records: what a log must be."""

import math
import re

import numpy as np
import pytest

from study.paper.protocol import paper_model
from sysid import InvalidInput, Record
from sysid.data.record import COLUMNS, check_records

T = 0.05 * np.arange(5)
U = np.array([0.5, -1.0, 2.0, 0.0])
THETA = np.array([3.0, 3.1, 3.2, 3.3, 3.4])


def spoilt(values, index, value):
    changed = np.array(values, dtype=float)
    changed[index] = value
    return changed


BAD = [
    ({"t": [0.0], "u": [], "theta": [1.0]}, "log is empty: expected at least one control interval"),
    ({"theta": None}, "log has no readings: expected theta, theta_dot or both"),
    ({"u": U[:3]}, "log is ragged: t has 5 values, expected 4 for 3 commands u"),
    ({"theta": THETA[:4]}, "log is ragged: theta has 4 values, expected 5 for 4 commands u"),
    ({"theta_dot": U}, "theta_dot has 4 values, expected 5 for 4 commands"),
    ({"u": [[0.0], [1.0, 2.0]]}, "u is ragged or not numeric: expected a list of numbers"),
    ({"u": ["a", "b", "c", "d"]}, "u is ragged or not numeric"),
    ({"u": np.zeros((4, 1))}, "u has shape (4, 1): expected one dimension"),
    ({"theta": spoilt(THETA, 2, math.nan)}, "theta[2] is nan (1 such values): expected finite numbers"),
    ({"u": spoilt(U, 1, -math.inf)}, "u[1] is -inf (1 such values): expected finite numbers"),
    ({"t": spoilt(T, 3, math.nan)}, "t[3] is nan"),
    ({"t": spoilt(T, 2, 0.05)}, "time does not increase at sample 2 (0.05 s, then 0.05 s)"),
    ({"t": T[::-1]}, "time does not increase at sample 1"),
    ({"t": spoilt(T, 2, 0.11)}, "time steps differ by up to 0.01 s from their mean 0.05 s: expected even sampling"),
]


@pytest.mark.parametrize(("change", "message"), BAD)
def test_a_bad_log_is_refused_with_what_was_expected(change, message):
    with pytest.raises(InvalidInput, match=re.escape(message)):
        Record(**({"t": T, "u": U, "theta": THETA, "name": "log"} | change))


def test_a_record_keeps_what_it_was_given():
    u = U.copy()
    record = Record(T, u, THETA)
    u[0] = 99.0
    assert record.u[0] == 0.5 and len(record) == 4 and record.dt == pytest.approx(0.05)
    for column in ("t", "u", "theta"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(record, column)[0] = 1.0


def test_whole_turns_are_taken_out():
    turning = np.linspace(0.0, 20.0, 81)
    wrapped = (turning + math.pi) % (2.0 * math.pi) - math.pi
    record = Record(0.05 * np.arange(81), np.zeros(80), wrapped)
    np.testing.assert_allclose(record.theta, turning, atol=1e-12)


def test_what_covers_more_than_a_turn_was_never_wrapped():
    """A motor that makes more than half a turn between two samples keeps its angles."""
    theta = 4.0 * np.arange(50.0)
    assert np.array_equal(Record(0.02 * np.arange(50), np.zeros(49), theta).theta, theta)


@pytest.mark.parametrize("every", [1, 2, 3, 7])
def test_a_thinned_record_is_the_same_motion_under_the_same_impulse(every):
    rng = np.random.default_rng(0)
    record = Record(0.01 * np.arange(101), rng.standard_normal(100), 0.3 * rng.random(101), rng.random(101))
    for unthinned in (record, record.part(20, 100)):
        thin = unthinned.thinned(every)
        n = len(unthinned) // every
        assert len(thin) == n and thin.dt == pytest.approx(every * record.dt)
        assert np.array_equal(thin.theta, unthinned.theta[: n * every + 1 : every])
        assert np.sum(thin.u) * thin.dt == pytest.approx(np.sum(unthinned.u[: n * every]) * unthinned.dt)
        assert np.sum(thin.previous_commands) * every == pytest.approx(
            np.sum(unthinned.previous_commands[len(unthinned.previous_commands) % every :])
        )
        assert thin.time_since_start[0] == unthinned.time_since_start[0]


def test_the_head_is_a_record_of_the_first_intervals():
    record = Record(0.05 * np.arange(21), np.arange(20.0), np.linspace(0.0, 1.0, 21), np.arange(21.0))
    head = record.head(7)
    assert len(head) == 7 and record.head(99) is record
    for column in COLUMNS:
        mine = getattr(head, column)
        np.testing.assert_array_equal(mine, getattr(record, column)[: len(mine)])


def test_records_must_fit_the_model():
    model, record = paper_model(), Record(T, U, THETA, name="log")
    assert check_records(model, [record]) == (record,) and check_records(model, record) == (record,)
    with pytest.raises(InvalidInput, match="no records were given: expected at least one"):
        check_records(model, [])
    with pytest.raises(InvalidInput, match=re.escape("log is sampled every 0.1 s, the model steps every 0.05 s")):
        check_records(model, [Record(2.0 * T, U, THETA, name="log")])
    t = 0.05 * 1.0005 * np.arange(101)
    drifting = Record(t, np.zeros(100), np.zeros(101), name="log")
    assert check_records(model, drifting.head(30))
    with pytest.raises(InvalidInput, match="expected a model with the log's dt"):
        check_records(model, drifting)
    with pytest.raises(InvalidInput, match=re.escape("log has a torque of 3 N m, beyond the model's limit |u| <= 2")):
        check_records(model, [Record(T, spoilt(U, 0, -3.0), THETA, name="log")])

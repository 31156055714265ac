"""What else can be had on a model: the optimum is the best of them, and what a design does not know is said."""

import numpy as np
import pytest

from policies.control import references as module
from policies.control.dynamic_programming import Grid
from policies.control.references import references
from policies.evaluation import fresh_start_states
from study.paper.protocol import paper_model
from sysid import AngleOffset, Coulomb, DeadZone, Delay, Drift, Model, RodPendulum, SensorDelay

START = fresh_start_states(0, 40)


@pytest.fixture(autouse=True)
def coarse(monkeypatch):
    monkeypatch.setattr(module, "FINE", Grid(theta=150, theta_dot=151, u=5))
    monkeypatch.setattr(module, "COARSE", Grid(theta=60, theta_dot=61, u=5, memory=5))


def model(*effects):
    return Model(RodPendulum(2.0, 1.5), effects, dt=0.05, u_max=2.0)


@pytest.mark.parametrize(
    ("plant", "note"),
    [
        (paper_model(2.0, 1.5), ""),
        (model(Coulomb(0.3)), "designed without coulomb"),
        (model(DeadZone(0.2)), "designed without dead_zone"),
        (model(Delay(T=0.1), AngleOffset(0.03)), "designed without delay, angle_offset"),
    ],
)
def test_the_optimum_is_the_best_and_the_others_say_what_they_do_not_know(plant, note):
    optimum, swing_up, lqr = references(plant, *START)
    assert optimum.evaluation.mean > swing_up.evaluation.mean > lqr.evaluation.mean
    assert optimum.note == "" and swing_up.note == lqr.note == note


@pytest.mark.long
def test_the_optimum_knows_the_state_whatever_the_sensors_show():
    blind, seeing = references(model(SensorDelay(T=0.1)), *START), references(model(), *START)
    np.testing.assert_array_equal(blind[0].evaluation.returns, seeing[0].evaluation.returns)
    assert blind[1].evaluation.mean < seeing[1].evaluation.mean


def test_what_cannot_be_designed_is_left_out_with_the_reason():
    _, swing_up, lqr = references(model(Drift(0.01)), *START)
    for reference in (swing_up, lqr):
        assert reference.evaluation is None and "depend on time" in reference.note

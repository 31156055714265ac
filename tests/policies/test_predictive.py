"""Prediction through commands under way is simulation, and a delay costs only the samples that it makes one wait."""

import dataclasses

import numpy as np
import pytest

from policies.control.design_model import without_dead_time
from policies.control.dynamic_programming import Grid, solve
from policies.control.predictive import Predictive, design_predictive
from policies.environments import task
from policies.evaluation import evaluate, fresh_start_states
from study.paper.protocol import paper_model
from sysid import (
    RK4,
    DeadZone,
    Delay,
    Drift,
    InvalidInput,
    Lag,
    Periodic,
    Spring,
    Stamp,
    State,
    TorqueGain,
    Viscous,
)

MACHINE = dataclasses.replace(paper_model(m=2.0, l=1.5), integrator=RK4(substeps=2))
DT = MACHINE.dt
COARSE = Grid(theta=60, theta_dot=61, u=7, memory=5)
STARTS = fresh_start_states(7, 40)
LATE = {
    "two samples": (Delay(T=2 * DT),),
    "a part": (Delay(T=0.4 * DT),),
    "samples and a part": (Delay(T=2.6 * DT), DeadZone(d=0.3)),
    "lag": (Lag(T=0.06), TorqueGain(c=0.8)),
    "delay, lag and time": (Delay(T=3 * DT), Lag(T=0.04), Drift(r=0.1), Viscous(b=0.2)),
}


class Spy:
    """In the place of the optimum: what it is asked for."""

    horizon = 200

    def __init__(self, model):
        self.model, self.asked = model, None

    def __call__(self, state, t):
        self.asked = (state, t)
        return 0.0 * state.theta


@pytest.mark.parametrize("late", LATE)
def test_the_state_predicted_is_the_one_that_simulation_reaches(late):
    model = dataclasses.replace(MACHINE, effects=LATE[late])
    designed = design_predictive(model, dataclasses.replace(COARSE, theta=8, theta_dot=9))
    core, d = without_dead_time(model)
    spy = Spy(core)
    policy = Predictive(spy, designed.ahead, designed.history)
    rng = np.random.default_rng(3)
    u = rng.uniform(-2.0, 2.0, (40, 5))
    states = [model.initial_state(*fresh_start_states(1, 5))]
    for k in range(40):
        states.append(model.advance(states[-1], u[k], k * DT))
    past = np.zeros((5, designed.history))
    for k in range(40 - d):
        policy(states[k], k * DT, past)
        predicted, t = spy.asked
        assert t == pytest.approx((k + d) * DT)
        np.testing.assert_allclose(predicted.theta, states[k + d].theta, atol=1e-6)
        np.testing.assert_allclose(predicted.theta_dot, states[k + d].theta_dot, atol=1e-5)
        if LATE[late][0].name == "lag":
            np.testing.assert_allclose(predicted.memory[-1][0], states[k].memory[-1][0], atol=1e-5)
        past = np.column_stack((u[k], past))[:, : designed.history]


@pytest.mark.parametrize("d", [1, 3])
def test_with_a_delay_the_optimum_is_the_plain_one_from_where_blind_samples_end(d):
    delayed, horizon = MACHINE.with_effect(Delay(T=d * DT)), 60
    plain, aware = solve(MACHINE, COARSE, horizon), design_predictive(delayed, COARSE, horizon)
    assert (aware.ahead, aware.history) == (d, d)
    state, blind = MACHINE.initial_state(*STARTS), np.zeros(len(STARTS[0]))
    for _ in range(d):
        blind += task.reward(state, 0.0)
        state = MACHINE.advance(state, 0.0)
    later = evaluate(lambda s, t: plain(s, t + d * DT), MACHINE, state.theta, state.theta_dot, horizon - d)
    got = evaluate(aware, delayed, *STARTS, horizon).returns
    np.testing.assert_allclose(got, blind + later.returns, rtol=1e-9)


@pytest.fixture(scope="module")
def returns():
    """Of the aware policy by delay, in samples."""

    def worth(samples):
        model = MACHINE.with_effect(Delay(T=samples * DT)) if samples else MACHINE
        return evaluate(design_predictive(model, COARSE), model, *STARTS).mean

    return {samples: worth(samples) for samples in (0, 1, 1.5, 1.999, 2, 4)}


def test_more_delay_is_worth_less_and_a_part_of_a_sample_lies_between(returns):
    slack = 0.01 * abs(returns[0])  # the table's own error
    for less, more in zip((0, 1, 1.5, 2), (1, 1.5, 2, 4), strict=True):
        assert returns[more] < returns[less] + slack
    assert returns[1.999] == pytest.approx(returns[2], rel=0.01)
    assert returns[4] < returns[0]


def test_where_nothing_is_late_it_is_the_optimum():
    plain, same = solve(MACHINE, COARSE, horizon=20), design_predictive(MACHINE, COARSE, horizon=20)
    assert same.history == 0
    np.testing.assert_array_equal(same(State(*STARTS), 0.5), plain(State(*STARTS), 0.5))
    stamped = design_predictive(MACHINE.with_effect(Stamp(s=0.5)), COARSE, horizon=20)
    np.testing.assert_array_equal(stamped(State(*STARTS), 0.5), plain(State(*STARTS), 0.5))


def test_a_lag_known_is_worth_more_than_one_ignored_and_a_short_one_changes_nothing():
    model = MACHINE.with_effect(Lag(T=0.2))
    aware, ignorant = design_predictive(model, COARSE), solve(MACHINE, COARSE)
    assert evaluate(aware, model, *STARTS).mean > evaluate(ignorant, model, *STARTS).mean + 10.0
    short = design_predictive(MACHINE.with_effect(Lag(T=1e-4)), COARSE)
    expected = evaluate(ignorant, MACHINE, *STARTS).mean
    assert evaluate(short, MACHINE.with_effect(Lag(T=1e-4)), *STARTS).mean == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize(
    "effects",
    [
        (),
        (Periodic(a=1.0, f=2.0),),
        (Drift(r=3.0),),
        (Spring(k=0.4),),
        (Lag(T=0.1),),
        (Delay(T=0.5 * DT), Lag(T=0.1)),
        (DeadZone(d=0.5),),
    ],
)
def test_three_steps_are_as_good_as_trying_every_sequence(effects):
    """Whatever the machine remembers, winds up or meets in time."""
    model = dataclasses.replace(MACHINE, effects=effects)
    grid = Grid(theta=100, theta_dot=101, u=3, memory=5)
    policy = design_predictive(model, grid, horizon=3)
    rng = np.random.default_rng(0)
    start = rng.uniform(-3.0, 3.0, 60), rng.uniform(-6.0, 6.0, 60)
    least = np.full(60, np.inf)
    for sequence in np.stack(np.meshgrid(*[grid.torques(2.0)] * 3), -1).reshape(-1, 3):
        state, paid = model.initial_state(*start), np.zeros(60)
        for k, u in enumerate(sequence):
            paid += task.cost(state, u)
            state = model.advance(state, u + np.zeros(60), k * DT)
        least = np.minimum(least, paid)
    np.testing.assert_allclose(-evaluate(policy, model, *start, horizon=3).returns, least, atol=5e-3)


def test_after_the_last_command_that_acts_there_is_none():
    aware = design_predictive(MACHINE.with_effect(Delay(T=2 * DT)), COARSE, horizon=10)
    past = np.ones((len(STARTS[0]), 2))
    assert np.any(aware(State(*STARTS), 6 * DT, past))
    assert not np.any(aware(State(*STARTS), 8 * DT, past))


def test_a_table_too_large_for_what_is_remembered_is_refused():
    with pytest.raises(InvalidInput, match="remembers 2 numbers"):
        design_predictive(MACHINE.with_effect(Delay(T=1.5 * DT)).with_effect(Lag(T=0.05)))

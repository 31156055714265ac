"""A learned torque: neutral before it learns, its derivatives exact, each pendulum its own, silent without cause."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from study.mismatch.measured import measured_rollouts
from study.strategies.plant import SENSORS
from study.trials.ground_truth import PRIOR
from study.trials.hidden_plant import DELAY_LARGE, PLAIN
from study.trials.learned_torque import (
    CommandFilter,
    ResidualNetwork,
    Weights,
    Windows,
    fit_network,
    stacked,
    untrained,
)
from sysid import InvalidInput, RodPendulum, effect, fit, simulate
from sysid.estimation.held_out import held_out_error

SENSOR = SENSORS["encoder"]
TRUE = replace(PRIOR, plant=RodPendulum(m=2.0, l=1.5, g=10.0))


def some_effects(seed):
    """A filter and a torque with nothing at zero."""
    rng = np.random.default_rng(seed)
    layers = tuple((W + 0.1 * rng.standard_normal(W.shape), b + 0.1) for W, b in untrained(rng))
    return CommandFilter(taps=rng.uniform(-0.5, 1.0, 5)), ResidualNetwork(layers=layers, drive_max=2.0)


def moved(model, steps=40):
    """Angles of three pendulums under random commands."""
    rng = np.random.default_rng(5)
    u = rng.uniform(-2.0, 2.0, (3, steps))
    return simulate(model, u, np.array([0.1, -2.0, 3.0]), np.array([0.5, -0.2, 0.0])).theta


def test_untrained_effects_change_nothing():
    torque = ResidualNetwork(layers=untrained(np.random.default_rng(0)), drive_max=2.0)
    extended = replace(TRUE, effects=(CommandFilter(), torque))
    np.testing.assert_allclose(moved(extended), moved(TRUE), atol=1e-12)


def test_a_filter_of_one_late_tap_is_a_delay_of_whole_samples():
    late = replace(TRUE, effects=(CommandFilter(taps=np.eye(5)[3]),))
    named = TRUE.with_effect(effect("delay", T=0.15))
    np.testing.assert_allclose(moved(late), moved(named), atol=1e-9)


def test_a_filter_runs_over_several_records_at_once():
    """It has no strategy of its own to do so: an effect of a user's has none, either."""
    u = np.random.default_rng(6).uniform(-2.0, 2.0, (3, 20))
    model = replace(TRUE, effects=(CommandFilter(taps=np.array([0.2, 0.5, 0.3])),))
    np.testing.assert_allclose(model.drive_record(u), [list(model.drives(row.tolist())) for row in u], atol=1e-12)


def test_stacked_pendulums_move_as_each_alone():
    effect_sets = [some_effects(seed) for seed in (1, 2, 3)]
    together = replace(TRUE, effects=stacked(effect_sets))
    theta, theta_dot = torch.tensor([0.1, -2.0, 3.0]).double(), torch.tensor([0.5, -0.2, 0.0]).double()
    state = together.initial_state(theta, theta_dot)
    models = [replace(TRUE, effects=effects) for effects in effect_sets]
    alone = [m.initial_state(float(a), float(b)) for m, a, b in zip(models, theta, theta_dot, strict=True)]
    for u in (1.5, -2.0, 0.3, 1.0):
        state = together.advance(state, torch.full((3,), u, dtype=torch.float64))
        alone = [m.advance(s, u) for m, s in zip(models, alone, strict=True)]
    np.testing.assert_allclose(state.theta, [s.theta for s in alone], rtol=1e-12)


def test_derivatives_are_finite_differences():
    rng = np.random.default_rng(3)
    weights = Weights.untrained(TRUE, rng)
    windows = Windows(weights, measured_rollouts(PLAIN, 1, 2)[:1], SENSOR)
    p = weights.first + 0.05 * rng.standard_normal(weights.first.shape)
    starts = windows.response.starts
    lin = windows.linearise(p, starts)
    strategy, turn = rng.standard_normal(p.shape), rng.standard_normal(starts.shape)
    h = 1e-6
    up, down = (windows.residual(p + s * h * strategy, starts + s * h * turn)[0] for s in (1.0, -1.0))
    exact = -(lin.S_p @ strategy + (lin.S_x @ turn[..., None])[..., 0])
    np.testing.assert_allclose((up - down) / (2.0 * h), exact, rtol=1e-5, atol=1e-4 * np.abs(exact).max())


@pytest.mark.long
def test_a_late_command_is_learned_and_a_plant_that_lacks_nothing_is_left_nearly_alone():
    """At the noise on rollouts that neither the weights nor their choice saw."""
    for plant, gap in ((DELAY_LARGE, 0.05), (PLAIN, -1.0)):
        records = measured_rollouts(plant, 1, 16)
        base = fit(PRIOR, records[:8], SENSOR, ("m", "l")).model
        learned = fit_network(base, records[:8], SENSOR, np.random.default_rng(0))
        before, after = (held(model, records[8:]) for model in (base, learned))
        assert after < 1.03
        assert before - after > gap


def held(model, records):
    return held_out_error(model, records, SENSOR, 1.0).ratio


def test_a_learned_torque_predicts_held_out_records_as_any_effect_does():
    """Its weights are arrays within tuples, which no table of compiled steps can hash."""
    records, effects = measured_rollouts(PLAIN, 1, 2), some_effects(1)
    assert held(replace(TRUE, effects=effects), records) > 1.1 * held(TRUE, records)


def test_one_rollout_is_too_few():
    with pytest.raises(InvalidInput, match="1 records to learn from: expected at least two"):
        fit_network(PRIOR, measured_rollouts(PLAIN, 1, 2)[:1], SENSOR, np.random.default_rng(0))

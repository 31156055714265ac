"""Each of a population's pendulums is the single one, and depends on its own seed alone."""

import numpy as np
import pytest
import torch

from policies.learning.pendulums import Pendulums
from policies.pendulum_env import PendulumEnv
from policies.randomization import Band, PriorRange
from sysid import AngleOffset, Backlash, Delay, InvalidInput, Model, RodPendulum, SensorDelay, Viscous, paper_model

BANDS = [Band({"m": 2.0, "l": 1.5}, 0.2), Band({"m": 1.0, "l": 1.0}, 0.0), PriorRange()]


def make(randomizations=BANDS, seeds=(4, 5, 6), **options):
    return Pendulums(paper_model(), randomizations, seeds, **options)


SENSING = (Backlash(width=0.1), SensorDelay(T=0.06), AngleOffset(offset=0.05))


def actions(steps, agents, seed=0):
    rng = np.random.default_rng(seed)
    return torch.from_numpy(rng.uniform(-1.0, 1.0, (steps, agents, 1)).astype(np.float32))


@pytest.mark.parametrize("history", [0, 3])
@pytest.mark.parametrize("effects", [(), (Viscous(b=0.05), Delay(T=0.07)), SENSING])
def test_every_agent_is_the_single_pendulum_with_its_own_parameters(effects, history):
    model = Model(RodPendulum(), effects, dt=0.04, u_max=2.0)
    env = Pendulums(model, BANDS, (4, 5, 6), history=history)
    begun = env.restart()
    singles = []
    for a in range(3):
        drawn = {name: float(values[a]) for name, values in env.parameters_now.items()}
        single = PendulumEnv(model.with_parameters(drawn), history=history)
        start = {"theta": float(env.state.theta[a]), "theta_dot": float(env.state.theta_dot[a])}
        np.testing.assert_allclose(begun[a].numpy(), single.reset(options=start)[0], atol=2e-5)
        singles.append(single)
    for action in actions(50, 3):
        observation, reward, _ = env.advance(action)
        for a, single in enumerate(singles):
            expected, cost, *_ = single.step(2.0 * action[a].numpy())
            np.testing.assert_allclose(observation[a].numpy(), expected, atol=2e-5)
            assert float(reward[a]) == pytest.approx(cost, rel=1e-4, abs=1e-6)


def test_a_new_episode_draws_new_parameters_and_a_new_start():
    env = make([PriorRange()] * 2, (1, 2))
    first = env.restart(), env.snapshot()["parameters"]
    second = env.restart(), env.snapshot()["parameters"]
    assert (first[0] != second[0]).all()
    for name in ("m", "l"):
        assert (first[1][name] != second[1][name]).all()


def test_past_commands_are_observed_the_latest_first_and_forgotten_at_the_start():
    env = Pendulums(paper_model(), BANDS, (4, 5, 6), history=2)
    assert (env.restart()[:, 3:] == 0.0).all()
    moves = actions(4, 3)
    moves[3] *= 1.5  # beyond the limit: what was given is the limit
    for action in moves:
        observation, *_ = env.advance(action)
    assert torch.equal(observation[:, 3:], torch.cat((moves[3].clamp(-1.0, 1.0), moves[2]), 1))
    assert (env.restart()[:, 3:] == 0.0).all()


def test_sensors_that_show_something_else_do_not_change_the_motion_or_the_reward():
    plain, shown = (Pendulums(Model(RodPendulum(), e, u_max=2.0), BANDS, (4, 5, 6)) for e in ((), SENSING))
    plain.restart(), shown.restart()
    for action in actions(20, 3):
        (seen, reward, _), (other, same, _) = plain.advance(action), shown.advance(action)
        assert torch.equal(reward, same)
    assert torch.equal(plain.state.theta, shown.state.theta) and not torch.equal(seen, other)


def test_the_horizon_is_ten_seconds_and_the_return_the_same_integral_at_every_interval():
    costs = []
    for dt, steps in ((0.05, 200), (0.02, 500), (0.0125, 800)):
        env = Pendulums(Model(RodPendulum(2.0, 1.5), dt=dt, u_max=2.0), [Band({"m": 2.0})], [3])
        assert env.horizon == steps
        env.restart()
        costs.append(sum(float(env.advance(torch.zeros(1, 1))[1]) for _ in range(steps)))
    assert costs[1:] == pytest.approx([costs[0]] * 2, rel=0.02)


def test_draws_depend_on_the_own_seed_only():
    together = make([PriorRange()] * 3, (4, 5, 6))
    alone = make([PriorRange()], (5,))
    for _ in range(3):
        assert torch.equal(together.restart()[1], alone.restart()[0])
        assert together.parameters_now["m"][1] == alone.parameters_now["m"][0]


def test_agents_that_share_a_seed_share_the_start_states_whatever_the_width():
    env = make([Band({"m": 2.0, "l": 1.5}, w) for w in (0.0, 0.5)], (3, 3))
    for _ in range(3):
        observation = env.restart()
        assert torch.equal(observation[0], observation[1])


def test_a_snapshot_goes_on_where_it_was_taken():
    model = Model(RodPendulum(), (Delay(T=0.07), *SENSING), u_max=2.0)
    one, other = (Pendulums(model, BANDS, (4, 5, 6), horizon=5, history=2) for _ in range(2))
    one.restart()
    moves = actions(12, 3)
    for action in moves[:4]:
        one.advance(action)
    other.restore(one.snapshot())
    for action in moves[4:]:
        for ours, theirs in zip(one.advance(action), other.advance(action), strict=True):
            assert torch.equal(ours, theirs)
    assert torch.equal(one.restart(), other.restart())


def test_bad_input_is_named():
    with pytest.raises(InvalidInput, match="3 randomizations and 1 seeds"):
        make(seeds=(1,))
    with pytest.raises(InvalidInput, match="expected the same"):
        make([Band({"m": 1.0}), Band({"l": 1.0})], (1, 2))
    with pytest.raises(InvalidInput, match="u_max"):
        Pendulums(Model(RodPendulum()), [PriorRange()], [0])

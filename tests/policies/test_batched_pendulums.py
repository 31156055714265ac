"""A proper TorchRL environment, each of whose pendulums is the single one and depends on its own seed alone."""

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torchrl.envs.utils import check_env_specs

from policies.environments import task
from policies.environments.batched_pendulums import BatchedPendulums
from policies.environments.gymnasium_env import PendulumEnv
from policies.environments.random_streams import Purpose, generator
from policies.environments.randomization import Band, Mixture, RandomForce, Ranges
from study.paper.protocol import paper_model
from sysid import (
    CATALOGUE,
    AngleOffset,
    Backlash,
    Coulomb,
    Delay,
    InvalidInput,
    Model,
    RodPendulum,
    SensorDelay,
    Viscous,
)

BANDS = [Band({"m": 2.0, "l": 1.5}, 0.2), Band({"m": 1.0, "l": 1.0}, 0.0), Ranges.of(paper_model(), ("m", "l"))]


def make(randomizations=BANDS, seeds=(4, 5, 6), **options):
    return BatchedPendulums(paper_model(), randomizations, seeds, **options)


SENSING = (Backlash(width=0.1), SensorDelay(T=0.06), AngleOffset(offset=0.05))


def begin(env):
    """The observations of a new episode of every agent."""
    return env.reset()["observation"]


def hold(env, action):
    """Observation, reward (A,) and whether the time is over (A,), after a step."""
    after = env.step(TensorDict({"action": action}, env.batch_size))["next"]
    return after["observation"], after["reward"][:, 0], after["truncated"][:, 0]


def actions(steps, agents, seed=0):
    rng = np.random.default_rng(seed)
    return torch.from_numpy(rng.uniform(-1.0, 1.0, (steps, agents, 1)).astype(np.float32))


@pytest.mark.parametrize("history", [0, 3])
@pytest.mark.parametrize("effects", [(), (Viscous(b=0.05), Delay(T=0.07)), SENSING])
def test_every_agent_is_the_single_pendulum_with_its_own_parameters(effects, history):
    model = Model(RodPendulum(), effects, dt=0.04, u_max=2.0)
    env = BatchedPendulums(model, BANDS, (4, 5, 6), history=history)
    begun = begin(env)
    singles = []
    for a in range(3):
        drawn = {name: float(values[a]) for name, values in env.parameters_now.items()}
        single = PendulumEnv(model.with_parameters(drawn), history=history)
        start = {"theta": float(env.state.theta[a]), "theta_dot": float(env.state.theta_dot[a])}
        np.testing.assert_allclose(begun[a].numpy(), single.reset(options=start)[0], atol=2e-5)
        singles.append(single)
    for action in actions(50, 3):
        observation, reward, _ = hold(env, action)
        for a, single in enumerate(singles):
            expected, cost, *_ = single.step(2.0 * action[a].numpy())
            np.testing.assert_allclose(observation[a].numpy(), expected, atol=2e-5)
            assert float(reward[a]) == pytest.approx(cost, rel=1e-4, abs=1e-6)


def test_a_new_episode_draws_new_parameters_and_a_new_start():
    env = make([Ranges.of(paper_model(), ("m", "l"))] * 2, (1, 2))
    first = begin(env), env.get_extra_state()["parameters"]
    second = begin(env), env.get_extra_state()["parameters"]
    assert (first[0] != second[0]).all()
    for name in ("m", "l"):
        assert (first[1][name] != second[1][name]).all()


def test_past_commands_are_observed_the_latest_first_and_forgotten_at_the_start():
    env = BatchedPendulums(paper_model(), BANDS, (4, 5, 6), history=2)
    assert (begin(env)[:, 3:] == 0.0).all()
    moves = actions(4, 3)
    moves[3] *= 1.5  # beyond the limit: what was given is the limit
    for action in moves:
        observation, *_ = hold(env, action)
    assert torch.equal(observation[:, 3:], torch.cat((moves[3].clamp(-1.0, 1.0), moves[2]), 1))
    assert (begin(env)[:, 3:] == 0.0).all()


def test_agents_that_share_a_seed_share_the_start_states_whatever_the_width():
    env = make([Band({"m": 2.0, "l": 1.5}, w) for w in (0.0, 0.5)], (3, 3))
    for _ in range(3):
        observation = begin(env)
        assert torch.equal(observation[0], observation[1])


def remembering():
    model = Model(RodPendulum(), (Delay(T=0.07), *SENSING), u_max=2.0)
    return BatchedPendulums(model, BANDS, (4, 5, 6), horizon=5, history=2)


def forced():
    return make(MIXED, horizon=9)


@pytest.mark.parametrize("pendulums", [remembering, forced])
def test_a_restart_of_some_leaves_the_others_alone(pendulums):
    whole, parts = pendulums(), pendulums()
    begin(whole), begin(parts)
    for k, action in enumerate(actions(12, 3)):
        if k == 5:
            parts.reset(TensorDict({"_reset": torch.tensor([[False], [True], [True]])}, [3]))
        ours, theirs = hold(whole, action)[0], hold(parts, action)[0]
        assert torch.equal(ours[0], theirs[0])
        assert torch.equal(ours[1:], theirs[1:]) == (k < 5)
    assert parts.steps.tolist() == [12, 7, 7]
    assert [new - old for new, old in zip(parts.episodes, whole.episodes, strict=True)] == [0, 1, 1]


@pytest.mark.parametrize("pendulums", [remembering, forced])
def test_a_snapshot_goes_on_where_it_was_taken(pendulums):
    one, other = pendulums(), pendulums()
    begin(one), begin(one)
    moves = actions(12, 3)
    for action in moves[:4]:
        hold(one, action)
    other.load_state_dict(one.state_dict())
    for action in moves[4:]:
        for ours, theirs in zip(hold(one, action), hold(other, action), strict=True):
            assert torch.equal(ours, theirs)
    assert torch.equal(begin(one), begin(other))


def test_bad_input_is_named():
    with pytest.raises(InvalidInput, match="3 randomizations and 1 seeds"):
        make(seeds=(1,))
    with pytest.raises(InvalidInput, match="expected the same"):
        make([Band({"m": 1.0}), Band({"l": 1.0})], (1, 2))
    with pytest.raises(InvalidInput, match="u_max"):
        BatchedPendulums(Model(RodPendulum()), [Ranges.of(paper_model(), ("m", "l"))], [0])


MIXED = [RandomForce(BANDS[0], 0.9, 0.1), BANDS[1], RandomForce(BANDS[2], 0.4, 0.0)]


def torques_of(randomization, seed, episode, model, steps):
    """The random torques of an episode, by the rule: start state, parameters, then they."""
    rng = generator(seed, Purpose.EPISODES, episode)
    task.start_state(rng), randomization.sample(rng, model)
    return randomization.torques(rng, steps, model.dt)


def test_a_pendulum_with_random_force_moves_as_one_under_the_torque_u_plus_d():
    model = Model(RodPendulum(), (Viscous(b=0.05),), dt=0.05, u_max=2.0)
    env = BatchedPendulums(model, MIXED, (4, 5, 6))
    for episode in range(2):
        begin(env)
        states = [model.initial_state(float(env.state.theta[a]), float(env.state.theta_dot[a])) for a in range(3)]
        singles = [model.with_parameters({n: float(v[a]) for n, v in env.parameters_now.items()}) for a in range(3)]
        d = np.zeros((3, env.horizon))
        for a in (0, 2):
            d[a] = torques_of(MIXED[a], env.seeds[a], episode, model, env.horizon)
        for k, action in enumerate(actions(env.horizon, 3)):
            hold(env, action)
            for a in range(3):
                states[a] = singles[a].advance(states[a], 2.0 * float(action[a, 0]) + d[a, k])
            if k in (0, 1, 20):  # a swing-up is chaotic: rounding grows later
                np.testing.assert_allclose(env.state.theta.numpy(), [s.theta for s in states], atol=1e-9)
                np.testing.assert_allclose(env.state.theta_dot.numpy(), [s.theta_dot for s in states], atol=1e-9)


def test_a_random_force_goes_past_what_is_between_command_and_torque():
    """Behind a delay of two intervals the first commands do nothing, random torques act at once."""
    model = Model(RodPendulum(), (Delay(T=0.1),), dt=0.05, u_max=2.0)
    still, forced = (BatchedPendulums(model, [r], [3]) for r in (BANDS[1], RandomForce(BANDS[1], 1.0, 0.1)))
    assert torch.equal(begin(still), begin(forced))
    for env in (still, forced):
        hold(env, torch.ones(1, 1))
    d = torques_of(RandomForce(BANDS[1], 1.0, 0.1), 3, 0, model, 200)[0]
    inertia = float(model.with_parameters({"m": 1.0, "l": 1.0}).inertia())
    gained = float(forced.state.theta_dot - still.state.theta_dot)
    assert gained == pytest.approx(0.05 * d / inertia, rel=0.05)


def test_an_agent_has_a_random_force_or_not_whatever_its_neighbours_are():
    together = make(MIXED)
    alone = [make([r], (seed,)) for r, seed in zip(MIXED, (4, 5, 6), strict=True)]
    for _ in range(2):
        begun = begin(together)
        for a, env in enumerate(alone):
            assert torch.equal(begin(env)[0], begun[a])
        for action in actions(30, 3):
            observation, reward, _ = hold(together, action)
            for a, env in enumerate(alone):
                ours, worth, _ = hold(env, action[a : a + 1])
                torch.testing.assert_close(ours[0], observation[a], rtol=0.0, atol=1e-6)
                torch.testing.assert_close(worth[0], reward[a], rtol=1e-6, atol=1e-6)


def test_where_nobody_has_a_random_force_nothing_is_there_and_no_torque_changes_nothing():
    plain, still = make(), make([RandomForce(r, 0.0, 0.1) for r in BANDS])
    assert plain.model.effects == () and "torques" not in plain.get_extra_state()
    assert [e.name for e in still.model.effects] == ["random_torque"] and "random_torque" not in CATALOGUE
    assert still.base_model.effects == ()
    for _ in range(2):
        assert torch.equal(begin(plain), begin(still))
        for action in actions(20, 3):
            for ours, theirs in zip(hold(plain, action), hold(still, action), strict=True):
                assert torch.equal(ours, theirs)


def test_a_random_force_leaves_every_start_and_every_parameter_as_they_were():
    plain, forced = make(), make([RandomForce(r, 1.0, 0.1) for r in BANDS])
    for _ in range(3):
        assert torch.equal(begin(plain), begin(forced))
        for name, values in plain.parameters_now.items():
            assert torch.equal(values, forced.parameters_now[name])
        for action in actions(5, 3):
            ours, theirs = hold(plain, action)[0], hold(forced, action)[0]
        assert (ours != theirs).any(1).all()


def test_agents_may_draw_the_same_parameters_in_any_order():
    one, other = Band({"m": 1.2, "l": 0.9}), Band({"l": 0.9, "m": 1.2})
    env = BatchedPendulums(paper_model(), [one, other], [3, 3])
    begin(env)
    assert {name: float(values[1]) for name, values in env.parameters_now.items()} == {"m": 1.2, "l": 0.9}


def test_an_effect_that_an_alternative_does_not_mean_is_not_there():
    base = {"m": 1.0, "l": 1.0}
    unsure = Model(RodPendulum(), (Coulomb(), Delay()), dt=0.05, u_max=2.0)
    either = Mixture(({**base, "coulomb.tau_c": 1.0, "delay.T": 0.0}, {**base, "coulomb.tau_c": 0.0, "delay.T": 0.13}))
    env = BatchedPendulums(unsure, [either], [7])
    rubs = BatchedPendulums(Model(RodPendulum(), (Coulomb(tau_c=1.0),), dt=0.05, u_max=2.0), BANDS[1:2], [7])
    late = BatchedPendulums(Model(RodPendulum(), (Delay(T=0.13),), dt=0.05, u_max=2.0), BANDS[1:2], [7])
    met = set()
    for _ in range(6):
        begun = [begin(e) for e in (env, rubs, late)]
        assert torch.equal(begun[0], begun[1]) and torch.equal(begun[0], begun[2])
        meant = float(env.parameters_now["delay.T"][0]) > 0.0
        met.add(meant)
        for action in actions(40, 1):
            ours, theirs = hold(env, action)[0], hold(late if meant else rubs, action)[0]
            torch.testing.assert_close(ours, theirs, rtol=0.0, atol=1e-5)
    assert met == {False, True}


def test_torchrl_accepts_it():
    check_env_specs(make())
    check_env_specs(BatchedPendulums(Model(RodPendulum(), SENSING, u_max=2.0), BANDS, (4, 5, 6), history=2))


def test_a_time_limit_truncates_and_never_terminates():
    env = make(horizon=7)
    out = env.rollout(20, lambda td: td.set("action", env.action_spec.rand()), break_when_any_done=False)
    ends = torch.arange(1, 21) % 7 == 0
    for name in ("truncated", "done"):
        assert (out["next", name][..., 0] == ends).all()
    assert not out["next", "terminated"].any()


def test_setting_the_seed_repeats_the_rollout():
    env = make()
    rewards = []
    for _ in range(2):
        env.set_seed(11)
        begin(env)
        rewards.append(torch.stack([hold(env, action)[1] for action in actions(5, 3)]))
    assert torch.equal(*rewards)

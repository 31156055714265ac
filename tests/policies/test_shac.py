"""Short-horizon actor-critic: its gradient is that of the simulated return, and its agents get near the optimum."""

import dataclasses
import re

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from policies.control.references import references
from policies.environments.batched_pendulums import BatchedPendulums
from policies.environments.machine import past_commands_needed
from policies.environments.randomization import Band, Fixed, RandomForce, Ranges
from policies.evaluation import batch_returns, fresh_start_states
from policies.training.shac import SHACPopulation, SHACSettings
from study.paper.protocol import paper_model
from sysid import CATALOGUE, Coulomb, Delay, InvalidInput, Model, RodPendulum, SensorDelay, Viscous
from sysid.physics.effects import effect

SMALL = SHACSettings(hidden=(16, 16), environments=8, horizon=5, steps=2000)
BANDS = [Band({"m": 2.0, "l": 1.5}, 0.2), Band({"m": 1.0, "l": 1.0}, 0.0), Ranges.of(paper_model(), ("m", "l"))]


def make(randomizations=BANDS, seeds=(0, 1, 0), settings=SMALL, model=None, **options):
    return SHACPopulation(model or paper_model(), randomizations, seeds, settings, **options)


def weights(population):
    loss = population.loss
    return [leaf.detach().clone() for leaf in (*loss.actor_leaves, *loss.value_leaves, *loss.target_leaves)]


def fresh_window(population):
    """The same window every time."""
    population.env.forget()
    population.observation = population.env.reset()["observation"]
    return population._window()


@pytest.mark.parametrize("effects", [(), (Coulomb(0.3), Delay(0.12)), (SensorDelay(0.07),)])
def test_the_gradient_is_that_of_the_simulated_return(effects):
    """By central differences: windows are simulated anew with a weight a little larger and a little smaller."""
    population = make(model=Model(RodPendulum(), effects, u_max=2.0), history=2)
    loss = population.loss
    gradients = torch.autograd.grad(loss.actor_loss(fresh_window(population)), loss.actor_leaves)
    for leaf, gradient in zip(loss.actor_leaves, gradients, strict=True):
        where = int(gradient.abs().argmax())
        values, step = leaf.data.view(-1), 1e-2
        kept, ends = float(values[where]), []
        for end in (kept + step, kept - step):
            values[where] = end
            ends.append(float(loss.actor_loss(fresh_window(population)).detach().double()))
        values[where] = kept
        assert (ends[0] - ends[1]) / (2.0 * step) == pytest.approx(float(gradient.view(-1)[where]), rel=0.03, abs=1e-5)


def test_a_policy_that_hangs_at_full_torque_is_brought_back():
    """Where tanh is flat the return says nothing; the other term does, until the training ends."""
    population = make(history=1)
    loss, leaf = population.loss, population.loss.actor_leaves[-1]
    leaf.data.fill_(-40.0)
    (gradient,) = torch.autograd.grad(loss.actor_loss(fresh_window(population)), [leaf])
    assert (gradient < -1.0).all()  # downhill is up, towards 0
    loss.progress = 1.0
    (gradient,) = torch.autograd.grad(loss.actor_loss(fresh_window(population)), [leaf])
    assert (gradient == 0.0).all()


def test_a_long_gradient_is_cut_and_another_is_left_alone():
    population = make()
    whole, short = (
        population.loss.actor_gradients(fresh_window(population))
        for population.loss.settings in (SMALL, dataclasses.replace(SMALL, gradient_norm=1e-6))
    )
    norm = torch.stack([g.flatten(1).norm(dim=1) for g in whole]).norm(dim=0)
    assert (norm < 1.0).all()
    for g, cut in zip(whole, short, strict=True):
        torch.testing.assert_close(cut, g * (1e-6 / norm).view(-1, 1, 1))


def test_values_learn_the_discounted_rewards_and_what_the_slow_copy_says_of_the_end():
    """R_t = r_t + gamma ((1 - lambda) V'(s_{t+1}) + lambda R_{t+1}), from the end of the window back."""
    loss = make().loss
    window = fresh_window(make()).detach()
    reward = SMALL.reward_scale * window["next", "reward"].squeeze(-1)
    value = loss.value_after(window["next", "observation"])
    expected, after = torch.zeros_like(reward), value[..., -1]
    for t in reversed(range(SMALL.horizon)):
        after = reward[..., t] + SMALL.gamma * ((1.0 - SMALL.decay) * value[..., t] + SMALL.decay * after)
        expected[..., t] = after
    torch.testing.assert_close(loss.taught(window)["value_target"], expected)
    error = loss.value_loss(TensorDict({"observation": window["next", "observation"], "value_target": value}, []))
    assert float(error) == 0.0  # before the first update both are one


def test_the_losses_are_those_of_torchrls_interface():
    population = make()
    losses = population.loss(fresh_window(population))
    assert set(losses.keys()) == {"loss_actor", "loss_value"} and float(losses["loss_value"]) > 0.0


def test_an_agent_trained_alone_becomes_what_it_becomes_among_others():
    together = make()
    together.train(400)
    for a in range(3):
        alone = make(BANDS[a : a + 1], (together.seeds[a],))
        alone.train(400)
        for ours, theirs in zip(together.loss.actor_leaves, alone.loss.actor_leaves, strict=True):
            torch.testing.assert_close(ours[a], theirs[0], rtol=1e-3, atol=1e-3)


def test_an_interrupted_training_ends_where_an_undisturbed_one_ends(tmp_path):
    """With a delay's memory, and random torques in the middle of an episode."""
    model, drawn = Model(RodPendulum(), (Delay(T=0.12),), u_max=2.0), [RandomForce(BANDS[0], 0.5, 0.1), *BANDS[1:]]
    undisturbed, first, second = (make(drawn, model=model, history=3) for _ in range(3))
    undisturbed.train(10_000)
    first.train(700)
    first.save(tmp_path / "shac.pt")
    second.resume(tmp_path / "shac.pt")
    assert second.steps_done == 720 == 18 * SMALL.window
    second.train(10_000)
    assert second.steps_done == undisturbed.steps_done == SMALL.steps
    assert all(torch.equal(x, y) for x, y in zip(weights(second), weights(undisturbed), strict=True))
    assert second.curves == undisturbed.curves and len(second.curves[0]) == 1
    with pytest.raises(InvalidInput, match=r"with learning_rate = 0\.01; this population has learning_rate = 0.02"):
        make(drawn, settings=dataclasses.replace(SMALL, learning_rate=0.02), model=model, history=3).resume(
            tmp_path / "shac.pt"
        )


def test_the_pendulums_of_an_agent_have_its_episodes_and_move_as_single_ones():
    model = Model(RodPendulum(), (Delay(T=0.07),), u_max=2.0)
    single = BatchedPendulums(model, BANDS[:1], (4,), history=2)
    many = BatchedPendulums(model, BANDS[:1], (4,), history=2, environments=3, differentiable=True)
    begun = many.reset()["observation"]
    action = torch.full((1, 3, 1), 0.3)
    moved = many.step(TensorDict({"action": action}, (1, 3)))["next"]
    for e in range(3):
        assert torch.equal(single.reset()["observation"][0], begun[0, e])
        alone = single.step(TensorDict({"action": action[:, e]}, (1,)))["next"]
        for name in ("observation", "reward"):
            torch.testing.assert_close(alone[name][0], moved[name][0, e], rtol=0.0, atol=1e-6)


def test_episodes_end_one_after_another_and_begin_anew():
    population = make(settings=dataclasses.replace(SMALL, steps=8 * 400))
    ends = []
    while population.steps_done < population.settings.steps:
        before = list(population.env.episodes[:8])
        population.train(1)
        ends.append(sum(x != y for x, y in zip(before, population.env.episodes[:8], strict=True)))
    assert max(ends) == 1 and sum(ends) == 8 * 400 // 200
    assert [step for step, _ in population.curves[0]] == [8 * 200, 8 * 400]


@pytest.mark.parametrize("name", sorted(CATALOGUE))
def test_gradients_flow_through_every_effect(name):
    """They are finite, and the policy's is not nothing."""
    probe = effect(name)
    model = Model(RodPendulum(), (probe,), u_max=2.0)
    if any(e.ahead for e in model.input_effects):
        pytest.skip("no environment carries it")
    population = make([Fixed()], (0,), model=model.machine)
    for _ in range(3):
        window = population._window()
        gradients = population.loss.actor_gradients(window)
        assert all(bool(g.isfinite().all()) for g in gradients)
        assert sum(float(g.abs().sum()) for g in gradients) > 1e-6
        population._go_on_after(window)


def test_a_motion_that_runs_away_is_told():
    population = make([Fixed()], (0,), model=Model(RodPendulum(), (Viscous(b=1000.0),), u_max=2.0))
    with pytest.raises(InvalidInput, match=r"gradient through the model is not finite .* sac trains without"):
        population.train(2000)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"minibatches": 5}, "divides the 64 environments"),
        ({"hidden": ()}, "one or more layer sizes"),
        ({"decay": 1.5}, "decay = 1.5"),
        ({"horizon": 0}, "horizon = 0"),
        ({"noise": (0.1, -1.0)}, "noise = (0.1, -1.0): expected no negative number"),
        ({"saturation": -1.0}, "saturation = -1.0"),
    ],
)
def test_bad_settings_are_named(changes, message):
    with pytest.raises(InvalidInput, match=re.escape(message)):
        SHACSettings(**changes)


@pytest.mark.long
@pytest.mark.parametrize(("effects", "steps", "within"), [((), 1_024_000, 0.04), ((Delay(T=0.155),), 2_048_000, 0.04)])
def test_agents_get_near_the_optimum(effects, steps, within):
    """The median of three, on the paper's rod, after half the steps that `policies train` takes; with a delay, all."""
    model = dataclasses.replace(paper_model(2.0, 1.5), effects=effects)
    history, starts = past_commands_needed(model), fresh_start_states(0, 100)
    population = SHACPopulation(model, [Fixed()] * 3, range(3), SHACSettings(steps=steps), history=history)
    population.train(population.settings.steps)
    returns = batch_returns(population.policies(), model, *starts).mean(1)
    optimum = references(model, *starts)[0].evaluation.mean
    assert optimum * (1.0 + within) < np.median(returns) <= optimum * 0.99

"""The mended model put to work: setups are plain data, equal setups share an agent, and naming an effect pays."""

import json

import numpy as np
import pytest

from policies.environments import task
from policies.environments.randomization import Band
from policies.evaluation import evaluate, fresh_start_states
from study.mismatch.measured import MeasuredPlant, known_setup, measured_rollouts
from study.mismatch.mismatch_plan import MISMATCH_PLANS, STRATEGIES
from study.mismatch.naming import FIRST, MOST, steps_of
from study.paper.presets import PAPER_PRESETS
from study.strategies.plant import SENSORS
from study.strategies.populations import AgentToTrain, populations
from study.strategies.session import step
from study.strategies.strategy import Play
from study.strategies.trial_plan import Case
from study.trials.ground_truth import SUBSTEPS, ground_truth, hidden_machine, near_optimal, oracle
from study.trials.hidden_plant import ALL_PLANTS, DELAY_LARGE, MAGNET
from study.trials.rollout_budget import AT_ONCE, Budget
from study.trials.training_setup import TrainingSetup, training_setup_of
from sysid import InvalidInput, simulate
from sysid.estimation.held_out import held_out_error

SMOKE, ENCODER = MISMATCH_PLANS["mismatch-smoke"], SENSORS["encoder"]


@pytest.fixture(scope="module")
def budget():
    """Five rollouts of the plant whose delay costs 30 % of the return."""
    return Budget(measured_rollouts(DELAY_LARGE, 1, 5), ENCODER, 1)


@pytest.mark.long
def test_naming_the_effect_brings_back_at_least_half_of_what_it_cost(budget):
    """The mended strategy end to end, with dynamic programming in the place of training."""
    plant, starts = ground_truth(DELAY_LARGE), fresh_start_states(7, 100)

    def worth(model):
        return evaluate(near_optimal(model), plant, *starts).mean

    aware, ignorant = worth(oracle(DELAY_LARGE)), worth(hidden_machine(substeps=2))
    named = budget.setup("mended")
    assert named.verdict == "missing" and named.steps == ("delay",)
    loss, left = aware - ignorant, aware - worth(named.model)
    assert loss > 0.2 * abs(aware)
    assert left < 0.5 * loss


@pytest.mark.long
@pytest.mark.parametrize("seed", [2000, 2015])
def test_a_delay_of_three_samples_is_named_alone(seed):
    """To a first order it moves the readings as a stamp does, which cannot be so late: both have to be tried."""
    diagnosis = Budget(measured_rollouts(DELAY_LARGE, seed, 50)[:10], ENCODER, seed).diagnosis
    assert (diagnosis.verdict, steps_of(diagnosis)) == ("missing", ("delay",))


def test_a_band_is_about_the_same_fit_and_random_torques_leave_it(budget):
    fitted, band, forced = (budget.setup(strategy) for strategy in ("fitted", "band", "random_force"))
    assert fitted.drawn.center == band.drawn.center == forced.drawn.inner.center
    assert (fitted.drawn.w, band.drawn.w) == (0.0, 0.3)
    assert forced.drawn.s > 0.0


def test_setups_are_plain_data(budget):
    free = [known_setup(strategy, MAGNET) for strategy in ("prior", "breadth", "oracle")]
    for setup in (
        *(budget.setup(strategy) for strategy in ("grid", "fitted", "mended", "posterior", "random_force")),
        *free,
    ):
        again = training_setup_of(json.loads(json.dumps(setup.to_json())))
        assert again.key == setup.key and again.verdict == setup.verdict
        state = setup.model.initial_state(np.array([0.3]), np.array([1.0]))
        assert again.model.advance(state, 1.5).theta == setup.model.advance(state, 1.5).theta


def test_the_oracle_moves_as_the_hidden_plant_does():
    """In steps five times as long: a speed of 1 rad/s is off by less than 2 % after an interval."""
    for plant in ALL_PLANTS:
        coarse, fine = oracle(plant), ground_truth(plant)
        state = coarse.initial_state(np.array([2.0]), np.array([1.0]))
        assert coarse.advance(state, 1.0).theta_dot == pytest.approx(fine.advance(state, 1.0).theta_dot, abs=0.02)


STICKING = [plant for plant in ALL_PLANTS if ground_truth(plant).dry_frictions]


@pytest.mark.parametrize("plant", STICKING, ids=lambda plant: plant.name)
def test_a_plant_that_sticks_moves_as_in_finer_steps(plant):
    """Under random torques, far below what any sensor reads."""
    rng = np.random.default_rng(0)
    u, starts = rng.uniform(-2.0, 2.0, (20, 200)), task.draw_start_states([rng] * 20)
    default, finer = (simulate(hidden_machine(plant.hidden_effect, n), u, *starts) for n in (SUBSTEPS, 4 * SUBSTEPS))
    np.testing.assert_allclose(default.theta, finer.theta, atol=1e-5)
    np.testing.assert_allclose(default.theta_dot, finer.theta_dot, atol=1e-4)


def test_a_smaller_budget_is_the_first_rollouts_of_a_larger_one():
    few, many = (MeasuredPlant(MAGNET, n, 3, drawn=4).play(Play(n)) for n in (2, 4))
    assert [r.u.tolist() for r in few] == [r.u.tolist() for r in many[:2]]
    assert [r.theta_dot.tolist() for r in few] == [r.theta_dot.tolist() for r in measured_rollouts(MAGNET, 3, 4)[:2]]


def test_what_was_measured_cannot_be_asked_for_other_torques():
    with pytest.raises(InvalidInput, match="measured under random torques"):
        MeasuredPlant(MAGNET, 2, 3, drawn=4).play(Play(1, at_rest=True))


def test_a_case_is_one_round_and_a_strategy_that_measures_shares_its_fits():
    answers = [
        step(SMOKE, Case("magnet", "encoder", strategy, n, 1000), {}.get)
        for strategy, n in (("fitted", 2), ("band", 2), ("prior", 0))
    ]
    fitted, band, prior = (payload["setups"][payload["answer"]["deployed"]] for payload in answers)
    assert fitted["model"] == band["model"] != prior["model"]
    assert [payload["answer"]["rollouts"] for payload in answers] == [2, 2, 0]
    assert all(payload["answer"]["simulated"] == SMOKE.steps for payload in answers)


def test_structures_train_together_and_no_agent_twice():
    late = oracle(DELAY_LARGE)
    setups = [TrainingSetup(late, Band({"m": 2.0, "delay.T": 0.1 + 0.001 * k})) for k in range(6)]
    setups += [TrainingSetup(oracle(ALL_PLANTS[0]), Band({"m": 2.0, "l": 1.5}, w)) for w in (0.0, 0.3)]
    agents = [AgentToTrain(setup.key, setup.to_json(), 1) for setup in setups]
    groups = populations(SMOKE, agents)
    assert [agent for group in groups for agent in group] == agents
    for group in groups:
        assert len(group) <= SMOKE.agents
        assert len({tuple(e["name"] for e in a.setup["model"]["effects"]) for a in group}) == 1


def test_the_plan_is_balanced_and_its_seeds_are_matched():
    for plan in MISMATCH_PLANS.values():
        assert set(plan.strategies) <= set(STRATEGIES) and len(set(plan.cases)) == len(plan.cases)
        seeds = {}
        for case in plan.cases:
            seeds.setdefault(case.condition, []).append(case.seed)
        for condition, used in seeds.items():
            assert tuple(used) == plan.seeds_of(condition.strategy)
    assert Case("plain", "encoder", "mended", 50, 3019) in MISMATCH_PLANS["mismatch"].cases
    assert len(MISMATCH_PLANS["mismatch"].cases) == 1740


def test_the_experiments_seeds_are_used_for_nothing_else():
    """But by its second asking, with agents of another algorithm on the same rollouts."""
    first, asked_again = MISMATCH_PLANS["mismatch"], MISMATCH_PLANS["mismatch-shac"]
    assert set(asked_again.seeds) <= set(first.seeds) and set(asked_again.plants) < set(first.plants)
    others = [plan for plan in MISMATCH_PLANS.values() if plan not in (first, asked_again)]
    own_seeds = set(first.seeds)
    assert own_seeds.isdisjoint(s for plan in others for s in plan.seeds)
    assert own_seeds.isdisjoint(range(FIRST, FIRST + MOST)) and own_seeds.isdisjoint(
        s for p in PAPER_PRESETS.values() for s in p.seeds
    )


@pytest.mark.long
def test_what_is_unknown_or_does_not_help_is_not_believed(budget):
    """Then it trains as under random forces; all effects at once, with what it found, is no further off."""
    lost = Budget(measured_rollouts(MAGNET, 2, 5), ENCODER, 2)
    assert lost.diagnosis.verdict == "unknown" and not lost.believed
    assert lost.setup("mended").key == lost.setup("random_force").key
    assert budget.believed
    named, every = (
        held_out_error(budget.setup(strategy).model, budget.records, budget.sensor)
        for strategy in ("mended", "all_effects")
    )
    assert every.ratio < named.ratio + 0.02


def test_breadth_is_over_one_effect_at_a_time():
    setup = known_setup("breadth", MAGNET)
    rng, count = np.random.default_rng(0), []
    for _ in range(300):
        drawn = setup.drawn.sample(rng, setup.model)
        assert 0.3 <= drawn["m"] <= 3.0 and 0.3 <= drawn["l"] <= 3.0
        off = {name.split(".")[0] for name, value in drawn.items() if value != setup.drawn.neutral.get(name, value)}
        count.append(off)
    assert max(map(len, count)) == 1
    assert set().union(*count) == set(AT_ONCE)
    tilts = [setup.drawn.sample(rng, setup.model)["tilt.alpha"] for _ in range(600)]
    assert min(tilts) < -0.05 and max(tilts) > 0.05

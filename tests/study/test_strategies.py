"""The dialogue of a strategy: never more rollouts than the budget, the same answers when it is asked again, and agents
that a round waits for together."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from policies.network_policy import NetworkPolicy
from study.mismatch.mismatch_plan import MISMATCH_PLANS
from study.paper.protocol import paper_model
from study.strategies.candidates import most_promising
from study.strategies.catalogue import PLACES, strategy_called
from study.strategies.plant import SENSORS, BudgetedPlant
from study.strategies.session import CRITICS, Finished, Waiting, advance
from study.strategies.strategies_plan import STRATEGIES_PLANS
from study.strategies.strategy import Choice, Learn, Play, Situation, Strategy, Train, TrainingSetup, Try
from study.trials.ground_truth import PRIOR
from study.trials.hidden_plant import DELAY_MEDIUM
from sysid import InvalidInput

ROOT = Path(__file__).resolve().parents[2]
OWN = f"{ROOT / 'examples' / 'own_strategy.py'}:TestedBand"
ELSEWHERE = dataclasses.replace(paper_model(m=1.5, l=1.2), integrator=PRIOR.integrator)
LIGHT = {
    "bayes_sim": {"simulations": 40, "epochs": 5, "draws": 10},
    "auto_tuned": {"simulations": 20, "steps": 2},
    "adapt_sim": {"levels": 3, "episodes": 2},
    "simopt": {"samples": 20, "steps": 1},
    "dropo": {"evaluations": 20, "transitions": 20},
}
"""Settings with which a strategy is fast; what it asks for is the same."""


def still(key):
    """The policy of any agent."""
    return NetworkPolicy(((np.zeros((3, 1), np.float32), np.zeros(1, np.float32)),), u_max=2.0)


def untrained(key):
    return None


def talk(name, budget, policy_of, seed=3, steps=60):
    strategy = strategy_called(name)
    plant = BudgetedPlant(ELSEWHERE, "encoder", budget, seed, steps=steps)
    situation = Situation(PRIOR, plant.sensor, budget, seed, np.random.default_rng(seed))
    return advance(dataclasses.replace(strategy, **LIGHT.get(name, {})), situation, plant, policy_of, "elsewhere")


@pytest.mark.long
@settings(max_examples=40, deadline=None, suppress_health_check=list(HealthCheck))
@given(st.sampled_from([*PLACES, OWN]), st.integers(0, 7))
def test_no_strategy_exceeds_its_budget(name, budget):
    assume(strategy_called(name).least <= budget <= strategy_called(name).most)
    finished = talk(name, budget, still)
    assert isinstance(finished, Finished) and isinstance(finished.choice, Choice)
    generation = 5 if name == "cross_entropy" else 1
    assert finished.rollouts == budget // generation * generation


@pytest.mark.parametrize("name", [*PLACES, OWN])
def test_a_dialogue_is_a_function_of_its_answers(name):
    """It is repeated in every round and after an interruption."""
    budget = strategy_called(name).least
    first, again = (talk(name, budget, untrained) for _ in range(2))
    if isinstance(first, Waiting):
        assert list(first.setups) == list(again.setups) and first.learn == again.learn
        known = set(first.setups) | set((first.learn or ())[:1])
        # with these agents it goes on, to others or to the end
        later = talk(name, budget, lambda key: still(key) if key in known else None)
        assert isinstance(later, Finished) or not known & set(later.setups)
    else:
        assert first.choice.deployed.key == again.choice.deployed.key


def test_the_plant_refuses_the_rollout_after_the_last_and_plays_none_of_them():
    plant = BudgetedPlant(ELSEWHERE, "encoder", 3, seed=1)
    plant.play(Play(2))
    with pytest.raises(InvalidInput, match="the plant refuses 2 rollouts: 1 of 3 are left of the budget"):
        plant.run(lambda state, t: 0.0, 2, at_rest=True)
    assert plant.spent == 2
    plant.spend(1)
    with pytest.raises(InvalidInput, match="0 of 3 are left"):
        plant.spend(1)
    with pytest.raises(InvalidInput, match="expected at least one"):
        plant.play(Play(0))
    with pytest.raises(InvalidInput, match=r"torques have shape \(1, 9\): expected \(2, N\)"):
        plant.play(Play(2, np.zeros((1, 9))))


def test_whoever_plays_the_kth_rollout_sees_the_same():
    alone, one, other = (BudgetedPlant(ELSEWHERE, "encoder", 3, seed=1) for _ in range(3))
    alone.spend(2)
    (third,) = alone.play(Play(1))
    assert np.array_equal(one.play(Play(3))[2].theta, third.theta)
    other.play(Play(1, np.zeros((1, 200)), at_rest=True))
    assert np.array_equal(other.play(Play(2))[1].theta_dot, third.theta_dot)


def test_readings_are_what_the_sensors_say_and_returns_are_the_tasks():
    speed, encoder = (BudgetedPlant(ELSEWHERE, sensing, 2, seed=1) for sensing in ("speed", "encoder"))
    (alone,), (whole,) = speed.play(Play(1)), encoder.play(Play(1))
    assert len(alone.theta) == 1 and len(whole.theta) == 201
    tried = encoder.run(lambda state, t: 0.0, 1, at_rest=True)
    assert tried.mean == pytest.approx(-200.0 * np.pi**2)
    off = tried.records[0].theta - np.pi
    assert np.std(off) == pytest.approx(0.01, rel=0.2) and len(tried.records[0].u) == 199


class Asks(Strategy):
    """Asks for what it is made with."""

    short = "asks"

    def __init__(self, *requests):
        self.requests = requests

    def spend(self, situation):
        answers = []
        for request in self.requests[:-1]:
            answers.append((yield request(answers) if callable(request) else request))
        return self.requests[-1]


def ask(*requests, policy_of=still, budget=4):
    plant = BudgetedPlant(ELSEWHERE, "encoder", budget, 3, steps=40)
    situation = Situation(PRIOR, plant.sensor, budget, 3, np.random.default_rng(3))
    return advance(Asks(*requests), situation, plant, policy_of, "elsewhere")


def test_what_is_no_request_or_no_answer_is_told_in_a_sentence():
    with pytest.raises(InvalidInput, match="asked for 'more': expected Play, Try, Train or Learn"):
        ask("more", None)
    with pytest.raises(InvalidInput, match="gave back a int: expected a TrainingSetup or an Agent"):
        ask(Play(1), 7)


def test_an_agent_with_critics_is_another_one_and_learning_costs_rollouts():
    from policies.environments.randomization import Fixed

    setup = TrainingSetup(PRIOR, Fixed())
    plain, kept = (
        ask(Train((setup,)), setup, policy_of=untrained),
        ask(Train((setup,), True), setup, policy_of=untrained),
    )
    (one,), (other,) = plain.setups, kept.setups
    assert other == one + CRITICS
    learned = ask(Train((setup,), True), lambda a: Learn(3, a[0][0]), setup)
    assert learned.rollouts == 3 and learned.keys == (other,)
    waiting = ask(
        Train((setup,), True), lambda a: Learn(3, a[0][0]), setup, policy_of=lambda k: {other: still(k)}.get(k)
    )
    assert waiting.learn[1:] == (other, 3)
    with pytest.raises(InvalidInput, match="refuses 1 rollouts"):
        ask(Learn(4), lambda a: Try(a[0]), setup)


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["guess"], "unknown strategy 'guess': expected one of prior, prior_range, point"),
        (["absent.py:Mine"], "no such file"),
        ([f"{ROOT / 'examples' / 'own_strategy.py'}:Yours"], "has no strategy 'Yours'"),
        (["point", "band", "point"], "strategy 'point' was given 2 times: expected each once"),
    ],
)
def test_a_strategy_that_is_unknown_or_named_twice_is_refused_in_a_sentence(names, message):
    with pytest.raises(InvalidInput, match=message):
        STRATEGIES_PLANS["strategies"].with_strategies(names)


@pytest.mark.parametrize("name", [*PLACES, OWN])
def test_a_plant_that_ends_early_is_enough_or_said_to_be_too_short(name):
    strategy = strategy_called(name)
    try:
        assert isinstance(talk(name, min(strategy.most, max(5, strategy.least)), still, steps=12), Finished)
    except InvalidInput as error:
        assert name == "dropo" and "given rollouts of 12 steps: expected at least" in str(error)


def test_a_missing_library_is_a_sentence(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(InvalidInput, match=r"BayRn needs the package botorch.*pip install 'gapfinder\[strategies\]'"):
        most_promising(np.zeros((4, 3)), np.zeros(4), seed=0)


def test_plans_are_balanced_and_the_experiments_seeds_are_its_own():
    for plan in STRATEGIES_PLANS.values():
        assert len(set(plan.cases)) == len(plan.cases)
        for case in plan.cases:
            strategy = strategy_called(case.strategy)
            assert strategy.least <= case.n <= strategy.most
            assert case.sensing in SENSORS and (case.sensing == "encoder" or not strategy.needs_angle)
        pairs = {case[:4]: 0 for case in plan.cases}
        assert set(plan.strategies) == {key[2] for key in pairs}
    assert (DELAY_MEDIUM, "speed") not in STRATEGIES_PLANS["strategies"].places
    seeds = set(STRATEGIES_PLANS["strategies"].seeds)
    others = [*MISMATCH_PLANS.values(), *(plan for name, plan in STRATEGIES_PLANS.items() if name != "strategies")]
    assert seeds.isdisjoint(seed for plan in others for seed in plan.seeds)


def test_a_users_strategy_is_held_against_the_baseline():
    plan = STRATEGIES_PLANS["strategies-quick"].with_strategies(["point", OWN])
    assert STRATEGIES_PLANS["strategies-quick"].arguments == "--preset strategies-quick"
    assert plan.arguments == f"--preset strategies-quick --strategies point,{OWN}"
    assert plan.contrasts == ((OWN, "point"),)
    assert {case.n for case in plan.cases if case.strategy == OWN} == {10}


def test_the_example_is_about_twenty_lines():
    source = (ROOT / "examples" / "own_strategy.py").read_text()
    class_source = source[source.index("class TestedBand") : source.index("def main")]
    assert len([line for line in class_source.splitlines() if line.strip()]) <= 24

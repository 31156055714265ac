"""From a model to a policy: a few agents trained side by side, and the best of them on that model.

training = train(machine, Fixed(), settings_for(machine), seeds=[0, 1], history=2)
training.policy       # what an evaluation, a file or a robot takes
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from policies.environments import task
from policies.environments.randomization import Randomization
from policies.evaluation import evaluate, fresh_start_states
from policies.network_policy import NetworkPolicy
from policies.training.population import Population
from policies.training.sac import SACSettings
from sysid import InvalidInput, Model

CHOICE = 100
"""Start states on which the best of several agents is chosen."""

TrainingCurve = tuple[tuple[int, float], ...]
Listener = Callable[[int, Sequence[float], float], None]


@dataclass(frozen=True, eq=False)
class TrainedPolicy:
    """What a training gave.

    policy   of the agent that is best on the model
    best     which of `seeds` that is; chosen (A,) are the agents' mean returns, by which it was
    curves   of each agent: (steps done, return) of every training episode
    """

    policy: NetworkPolicy
    model: Model
    randomization: Randomization
    settings: SACSettings
    seeds: tuple[int, ...]
    best: int
    chosen: tuple[float, ...]
    curves: tuple[TrainingCurve, ...]
    seconds: float


def settings_for(model: Model, hidden: Sequence[int] = (64, 64), steps: int = 75_000) -> SACSettings:
    """The paper's settings; the discount is the same per second at every dt: 0.99 at 0.05 s."""
    gamma = 0.99 ** (model.dt / task.INTERVAL)
    return SACSettings(hidden=tuple(hidden), steps=steps, random_steps=min(1000, math.ceil(0.1 * steps)), gamma=gamma)


def train(
    model: Model,
    randomization: Randomization,
    settings: SACSettings,
    seeds: Sequence[int],
    history: int = 0,
    listener: Listener = lambda steps, returns, seconds: None,
) -> TrainedPolicy:
    """Train an agent a seed; `listener` hears ten times (steps done, mean return of each agent since, seconds).

    Nothing is drawn from the start states on which a policy is judged later: the choice among the agents has its own.
    Raises InvalidInput where the numbers run away.
    """
    begin = time.monotonic()
    population = Population(model, [randomization] * len(seeds), seeds, settings, history=history)
    for tenth in range(1, 11):
        heard = len(population.curves[0])
        population.train(math.ceil(tenth * settings.steps / 10) - population.steps_done)
        new = [[value for _, value in curve[heard:]] for curve in population.curves]
        means = [float(np.mean(values)) if values else math.nan for values in new]
        if not all(math.isfinite(v) for values in new for v in values):
            raise InvalidInput(f"the returns are not finite after {population.steps_done} steps: the model runs away")
        listener(population.steps_done, means, time.monotonic() - begin)
    policies = population.policies()
    starts = fresh_start_states(seeds[0], CHOICE, block=1)
    chosen = tuple(evaluate(policy, model, *starts).mean for policy in policies)
    best = int(np.argmax(chosen))
    return TrainedPolicy(
        policy=policies[best],
        model=model,
        randomization=randomization,
        settings=settings,
        seeds=population.seeds,
        best=best,
        chosen=chosen,
        curves=tuple(tuple(curve) for curve in population.curves),
        seconds=time.monotonic() - begin,
    )

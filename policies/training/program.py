"""From a model to a policy: a few agents trained side by side, and the best of them on that model.

training = train(machine, Fixed(), settings_for(machine), seeds=[0, 1], history=2)
training.policy       # what an evaluation, a file or a robot takes
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from policies.environments import task
from policies.environments.randomization import Randomization
from policies.evaluation import evaluate, fresh_start_states
from policies.network_policy import NetworkPolicy
from policies.training.population import Population, TrainingSettings
from policies.training.sac import SACPopulation, SACSettings
from policies.training.shac import SHACPopulation, SHACSettings
from sysid import InvalidInput, Model

CHOICE = 100
"""Start states on which the best of several agents is chosen."""
CHUNK = 20
"""Steps between two looks at the clock."""
TRIAL = 100, 0.005
"""Steps with updates from which the time is told: at least so many, and that share of all."""
WINDOW = 0.8, 32
"""A window of SHAC [s], and its steps at most."""
WINDOWS = 2000
"""Windows of a training by SHAC."""
STEPS = 75_000
"""Of a training by SAC."""
POPULATIONS: dict[str, type[Population]] = {"shac": SHACPopulation, "sac": SACPopulation}
"""By the algorithm's name."""
CHECKPOINT_SECONDS = 60.0
"""About what a crash may cost."""
TrainingCurve = tuple[tuple[int, float], ...]
Listener = Callable[[int, Sequence[float], float, float], None]


@dataclass(frozen=True, eq=False)
class TrainedPolicy:
    """What a training gave.

    policy   of the agent that is best on the model
    best     which of `seeds` that is; chosen (A,) are the agents' mean returns, by which it was
    curves   of each agent: (steps done, return) of every training episode
    """

    policy: NetworkPolicy
    seeds: tuple[int, ...]
    best: int
    chosen: tuple[float, ...]
    curves: tuple[TrainingCurve, ...]
    seconds: float


def settings_for(
    model: Model, hidden: Sequence[int] = (64, 64), steps: int | None = None, algorithm: str = "shac"
) -> TrainingSettings:
    """How agents of a machine are trained: discounts and windows are the same in seconds at every dt.

    algorithm   "shac", through the gradient of the model; "sac", from its transitions alone, as in the paper
    steps       environment steps of each agent; by default as many as the algorithm needs

    Raises InvalidInput for an algorithm that does not exist.
    """
    intervals = model.dt / task.INTERVAL
    if algorithm == "sac":
        steps = STEPS if steps is None else steps
        random_steps = min(1000, math.ceil(0.1 * steps))
        gamma = SACSettings().gamma ** intervals
        return SACSettings(hidden=tuple(hidden), steps=steps, random_steps=random_steps, gamma=gamma)
    if algorithm != "shac":
        raise InvalidInput(f"algorithm {algorithm!r}: expected one of {', '.join(POPULATIONS)}")
    seconds, most = WINDOW
    settings = SHACSettings(hidden=tuple(hidden), horizon=max(1, min(most, round(seconds / model.dt))))
    steps = WINDOWS * settings.window if steps is None else steps
    return replace(settings, steps=steps, gamma=settings.gamma**intervals, decay=settings.decay**intervals)


def train(
    model: Model,
    randomization: Randomization,
    settings: TrainingSettings,
    seeds: Sequence[int],
    history: int = 0,
    listener: Listener = lambda steps, returns, seconds, left: None,
    checkpoint: Path | None = None,
) -> TrainedPolicy:
    """Train an agent a seed; `listener` hears ten times (steps done, mean return of each agent since, seconds, seconds
    left), and before that once without returns, as soon as it is known how long the training takes.

    checkpoint: written every minute and when the training is interrupted, gone on from where it is there, and removed
    at the end. Nothing is drawn from the start states on which a policy is judged later: the choice among the agents
    has its own. Raises InvalidInput where the numbers run away, and for a checkpoint of another training.
    """
    begin = time.monotonic()
    kind, randomizations = POPULATIONS[settings.algorithm], [randomization] * len(seeds)
    population = kind(model, randomizations, seeds, settings, history=history)
    if checkpoint is not None and checkpoint.exists():
        population.resume(checkpoint)
    try:
        _finish(population, listener, checkpoint)
    except KeyboardInterrupt:
        _save(population, checkpoint)
        raise
    if checkpoint is not None:
        checkpoint.unlink(missing_ok=True)
    policies = population.policies()
    starts = fresh_start_states(seeds[0], CHOICE, block=1)
    chosen = tuple(evaluate(policy, model, *starts).mean for policy in policies)
    best = int(np.argmax(chosen))
    curves = tuple(map(tuple, population.curves))
    return TrainedPolicy(policies[best], population.seeds, best, chosen, curves, time.monotonic() - begin)


def _finish(population: Population, listener: Listener, checkpoint: Path | None) -> None:
    """Train all steps that are left."""
    settings, heard = population.settings, len(population.curves[0])
    steps, trial = settings.steps, max(TRIAL[0], math.ceil(TRIAL[1] * settings.steps))
    begin = saved = learning = time.monotonic()
    without = first = max(population.steps_done, settings.random_steps)
    marks = [mark for tenth in range(1, 11) if (mark := math.ceil(tenth * steps / 10)) > population.steps_done]
    announced = False
    while population.steps_done < steps:
        ahead = min(mark for mark in (first, first + trial, marks[0]) if mark > population.steps_done)
        population.train(min(CHUNK, ahead - population.steps_done))
        now, done = time.monotonic(), population.steps_done
        if now - saved >= CHECKPOINT_SECONDS:
            _save(population, checkpoint)
            saved = time.monotonic()
        if done <= first:
            learning, without = now, done  # steps without updates tell nothing
        left = (now - learning) / max(1, done - without) * (steps - done)
        if done >= marks[0]:
            marks = [mark for mark in marks if mark > done]
            listener(done, _latest(population, heard), now - begin, left)
            heard = len(population.curves[0])
        elif not announced and done >= first + trial:
            announced = True
            listener(done, (), now - begin, left)


def _latest(population: Population, heard: int) -> list[float]:
    """The mean return of each agent's episodes after so many; nan where there is none."""
    new = [[value for _, value in curve[heard:]] for curve in population.curves]
    if not all(math.isfinite(v) for values in new for v in values):
        raise InvalidInput(f"the returns are not finite after {population.steps_done} steps: the model runs away")
    return [float(np.mean(values)) if values else math.nan for values in new]


def _save(population: Population, checkpoint: Path | None) -> None:
    if checkpoint is not None and population.steps_done > 0:
        checkpoint.parent.mkdir(exist_ok=True)
        try:
            population.save(checkpoint)
        except OSError as error:
            raise InvalidInput(str(error)) from None

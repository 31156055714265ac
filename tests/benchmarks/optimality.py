"""python -m tests.benchmarks.optimality: what it costs until agents are near the optimum.

On three plants (the paper's rod of 2 kg and 1.5 m: plain, with dry friction of 1.5 N m, with a delay of 0.155 s) agents
train by an algorithm, with settings that are given by name. Some times a training their policies play 100 start states;
the answer is the processor time of all agents and the steps of each after which their median return is within 5 % and
2 % of the optimum, which dynamic programming finds on the same plant with the commands under way in its state.

shac and sac are ours. sb3 is Stable-Baselines3's SAC (extra `bench`) with its settings tuned for Pendulum-v1
(rl-baselines3-zoo: a learning rate of 1e-3, everything else as it comes), on the same plants and observations.
"""

from __future__ import annotations

import csv
import dataclasses
import math
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from policies import Fixed, PendulumEnv, SACSettings, SHACSettings, fresh_start_states, tune_cpu
from policies.control.references import references
from policies.environments import task
from policies.environments.machine import past_commands_needed
from policies.evaluation import batch_returns, evaluate
from policies.training.population import TrainingSettings
from policies.training.program import POPULATIONS
from study.paper.protocol import paper_model
from sysid import Coulomb, Delay, Model, State
from tests.benchmarks import command

PLANTS = {"plain": (), "friction": (Coulomb(tau_c=1.5),), "delay": (Delay(T=0.155),)}
WITHIN = (0.05, 0.02)
COLUMNS = (
    "plant", "algorithm", "settings", "history", "agents", "steps", "cpu_seconds", "median", "lowest", "highest",
    "optimum",
)  # fmt: skip
SETTINGS = {"shac": SHACSettings(), "sac": SACSettings(hidden=(64, 64))}
STARTS = 100


def plant(name: str) -> Model:
    """The machine of that name."""
    return dataclasses.replace(paper_model(m=2.0, l=1.5), effects=PLANTS[name])


def settings_of(algorithm: str, changes: Sequence[str]) -> TrainingSettings:
    """Those of `policies train`, but for changes as "polyak=0.01"; hidden=256 is two layers of so many."""
    settings, changed = SETTINGS[algorithm], dict[str, object]()
    for name, _, value in (change.partition("=") for change in changes):
        kind = type(getattr(settings, name))
        changed[name] = (int(value),) * 2 if kind is tuple else kind(value)
    return dataclasses.replace(settings, **changed)


def curve(model: Model, settings: TrainingSettings, history: int, agents: int, looks: int) -> Iterator[tuple]:
    """(steps, CPU seconds, returns (agents,)) some times a training; judging them is not counted."""
    starts, spent = fresh_start_states(0, STARTS), 0.0
    kind = POPULATIONS[settings.algorithm]
    population = kind(model, [Fixed()] * agents, range(agents), settings, history=history)
    for look in range(1, looks + 1):
        begin = time.process_time()
        population.train(math.ceil(look * settings.steps / looks) - population.steps_done)
        spent += time.process_time() - begin
        yield population.steps_done, spent, batch_returns(population.policies(), model, *starts).mean(1)


def stable_baselines(model: Model, steps: int, history: int, agents: int, looks: int) -> Iterator[tuple]:
    """As `curve`, of agents that train one after another."""
    from gymnasium.wrappers import TimeLimit
    from stable_baselines3 import SAC

    env = TimeLimit(PendulumEnv(model, history=history), task.horizon(model.dt))
    learners = [SAC("MlpPolicy", env, learning_rate=1e-3, seed=seed, device="cpu") for seed in range(agents)]
    starts, spent = fresh_start_states(0, STARTS), 0.0
    for look in range(1, looks + 1):
        begin = time.process_time()
        for learner in learners:
            learner.learn(math.ceil(look * steps / looks) - learner.num_timesteps, reset_num_timesteps=False)
        spent += time.process_time() - begin
        returns = [evaluate(_Learned(learner, model.u_max, history), model, *starts).mean for learner in learners]
        yield learners[0].num_timesteps, spent, np.array(returns)


class _Learned:
    """An agent of Stable-Baselines3 as a policy."""

    def __init__(self, learner: Any, u_max: float, history: int) -> None:
        self.learner, self.u_max, self.history = learner, u_max, history

    def __call__(self, state: State, t: float, past: np.ndarray | None = None) -> np.ndarray:
        commands = () if past is None else tuple((past / self.u_max).T)
        seen = np.stack(task.observation(state, commands), -1).astype(np.float32)
        return self.learner.predict(seen, deterministic=True)[0][:, 0]


def reached(rows: Sequence[dict], within: float) -> str:
    """When the median was first so near."""
    near = [row for row in rows if row["median"] >= row["optimum"] * (1.0 + within)]
    return f"{near[0]['cpu_seconds']:.0f} s, {near[0]['steps']:,} steps" if near else "never"


def main(arguments: Sequence[str] | None = None) -> int:
    """Train, print a line a plant, and append what was measured to a table."""
    parser = command.parser("optimality", __doc__)
    parser.add_argument("--plants", nargs="+", choices=PLANTS, default=list(PLANTS))
    parser.add_argument("--algorithm", choices=(*SETTINGS, "sb3"), default="shac")
    parser.add_argument("--set", nargs="*", default=[], metavar="NAME=VALUE", help="fields of the algorithm's settings")
    parser.add_argument("--history", type=int, help="past commands observed; by default as many as the delay needs")
    parser.add_argument("--agents", type=int, default=10)
    parser.add_argument("--looks", type=int, default=16)
    parser.add_argument("--steps", type=int, help="of each agent; sb3: 20,000 by default")
    parser.add_argument("--csv", type=Path, help="a table to append to")
    given = parser.parse_args(arguments)
    known = (
        [field.name for field in dataclasses.fields(SETTINGS[given.algorithm])] if given.algorithm in SETTINGS else []
    )
    unknown = [change for change in given.set if change.partition("=")[0] not in known]
    if unknown:
        parser.error(f"--set {unknown[0]}: expected a field of the algorithm's settings: {', '.join(known) or 'none'}")
    tune_cpu(threads=1)
    for name in given.plants:
        model = plant(name)
        optimum = references(model, *fresh_start_states(0, STARTS))[0].evaluation.mean
        history = past_commands_needed(model) if given.history is None else given.history
        shape = history, given.agents, given.looks
        if given.algorithm == "sb3":
            looked = stable_baselines(model, given.steps or 20_000, *shape)
        else:
            steps = [f"steps={given.steps}"] if given.steps else []
            looked = curve(model, settings_of(given.algorithm, [*given.set, *steps]), *shape)
        rows = []
        for steps, spent, returns in looked:
            settings = " ".join(given.set) or "default"
            named = (name, given.algorithm, settings, history, given.agents, steps, round(spent, 1))
            numbers = (float(np.median(returns)), returns.min(), returns.max(), optimum)
            rows.append(dict(zip(COLUMNS, (*named, *(round(float(x), 1) for x in numbers)), strict=True)))
            print("  ".join(f"{key} {value}" for key, value in rows[-1].items()), flush=True)
            if given.csv:
                _append(given.csv, rows[-1])
        print(f"{name}: " + "; ".join(f"within {100 * w:.0f} %: {reached(rows, w)}" for w in WITHIN), flush=True)
    return 0


def _append(file: Path, row: dict) -> None:
    new = not file.exists()
    with file.open("a", newline="") as opened:
        table = csv.DictWriter(opened, COLUMNS, lineterminator="\n")
        if new:
            table.writeheader()
        table.writerow(row)


if __name__ == "__main__":
    raise SystemExit(main())

"""The real plant: whatever touches it costs a rollout, and it refuses the one beyond the budget.

Rollout k of a seed has a start state, random torques and errors of the sensors of its own, whoever plays it: strategies
that ask for the same see the same. A policy acts on the state itself, as it does where the paper evaluates it; what a
strategy observes goes through the sensors.
"""

from __future__ import annotations

import numpy as np

from policies.environments import task
from policies.evaluation import Policy, rollout
from study.strategies.readings import sensed
from study.strategies.strategy import Play, Tried
from sysid import InvalidInput, Model, Record, Sensor, simulate
from sysid.physics.ops import Array

SENSORS = {"speed": Sensor(theta=0.001, theta_dot=1.0), "encoder": Sensor(theta=0.01, theta_dot=1.0)}
"""The paper's, which reads the speed and is told the angle at the start alone; and with an encoder beside it."""


class BudgetedPlant:
    """A hidden model that grants `budget` rollouts of `steps` control intervals."""

    def __init__(self, model: Model, sensing: str, budget: int, seed: int, steps: int = task.HORIZON) -> None:
        self.model, self.sensor, self.whole = model, SENSORS[sensing], sensing == "encoder"
        self.budget, self.seed, self.steps, self.spent = budget, seed, steps, 0

    def spend(self, rollouts: int) -> range:
        """Which rollouts these are. Raises InvalidInput where fewer are left; none is played then."""
        if not rollouts >= 1:
            raise InvalidInput(f"{rollouts} rollouts were asked for: expected at least one")
        if self.spent + rollouts > self.budget:
            left = f"{self.budget - self.spent} of {self.budget}"
            raise InvalidInput(f"the plant refuses {rollouts} rollouts: {left} are left of the budget")
        first, self.spent = self.spent, self.spent + rollouts
        return range(first, self.spent)

    def play(self, asked: Play) -> list[Record]:
        """The rollouts as the sensors read them."""
        if asked.torques is not None and np.shape(asked.torques)[:1] != (asked.rollouts,):
            raise InvalidInput(f"torques have shape {np.shape(asked.torques)}: expected ({asked.rollouts}, N)")
        rngs, starts = self._begin(asked.rollouts, asked.at_rest)
        u = np.array([rng.uniform(-self.model.u_max, self.model.u_max, self.steps) for rng in rngs])
        run = simulate(self.model, u if asked.torques is None else asked.torques, *starts)
        return [self._read(*each) for each in zip(run.u, run.theta, run.theta_dot, rngs, strict=True)]

    def run(self, policy: Policy, rollouts: int, at_rest: bool) -> Tried:
        """Episodes of a policy; a record ends with the state before the last command."""
        rngs, starts = self._begin(rollouts, at_rest)
        seen = rollout(policy, self.model, *starts, horizon=self.steps)
        records = [
            self._read(seen.u[:-1, e], seen.theta[:, e], seen.theta_dot[:, e], rng) for e, rng in enumerate(rngs)
        ]
        return Tried(records, seen.returns)

    def _begin(self, rollouts: int, at_rest: bool) -> tuple[list[np.random.Generator], tuple[Array, Array]]:
        """The generators of the next rollouts, and where these start."""
        rngs = [np.random.default_rng([self.seed, k]) for k in self.spend(rollouts)]
        theta, theta_dot = task.draw_start_states(rngs)
        return rngs, (np.full(rollouts, np.pi), np.zeros(rollouts)) if at_rest else (theta, theta_dot)

    def _read(self, u: Array, theta: Array, theta_dot: Array, rng: np.random.Generator) -> Record:
        t = self.model.dt * np.arange(len(u) + 1)
        return Record(t, u, *sensed(theta, theta_dot, self.sensor, self.whole, rng))

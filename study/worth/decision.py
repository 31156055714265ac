"""What is decided with the parameters: a policy, and what it returns on a machine whose parameters are others."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from policies.control.dynamic_programming import Grid
from policies.control.predictive import Predictive, design_predictive
from policies.control.references import spanning
from policies.environments.machine import machine_of
from policies.evaluation import PolicyBatch, evaluate, fresh_start_states
from sysid import Model, OutputEffect
from sysid.physics.ops import Array

DECISION_GRID = Grid(120, 121, u=5, memory=3)
"""More torques and memory change returns by 0.01 %."""


@dataclass(frozen=True, eq=False)
class SwingUpDecision:
    """Swing up and hold, by dynamic programming: what a policy trained to the optimum of a model would do.

    machine    the fitted model as a policy meets it, which acts on the state: sensing is left out
    names      of the P parameters; one that the machine does not have (of a sensor's zero, of the log) changes nothing
    episodes   start states, the same for all
    table      of the optimum; a coarse one plans with a margin, as trained agents do
    """

    machine: Model
    names: tuple[str, ...]
    episodes: int = 40
    table: Grid = DECISION_GRID

    @classmethod
    def of(
        cls,
        model: Model,
        names: Sequence[str],
        u_max: float | None = None,
        episodes: int = 40,
        table: Grid = DECISION_GRID,
    ) -> SwingUpDecision:
        """On a fitted model, with commands up to u_max [N m]. Raises InvalidInput as `machine_of` does."""
        machine = machine_of(model, u_max)
        moving = tuple(e for e in machine.effects if not isinstance(e, OutputEffect))
        return cls(dataclasses.replace(machine, effects=moving), tuple(names), episodes, table)

    def returns(self, believed: Array, true: Array) -> Array:
        """The return (K,) of the policy made for each believed (K, D, P), on the machine of that row of true (K, P).

        The policy is for one set of parameters, or for D of them alike.
        """
        kept = believed[..., self._kept]
        _, first, which = np.unique(kept.reshape(len(kept), -1), axis=0, return_index=True, return_inverse=True)
        designed = [self._policy(believed[i]) for i in first]
        return self._worth(designed if len(designed) == 1 else [designed[i] for i in which.ravel()], true)

    def _policy(self, believed: Array) -> Predictive:
        """For one set of parameters or for several (D, P), of which one is drawn anew at every step.

        What the input path remembers keeps its mean among these, since a policy counts on it.
        """
        mean = self._model(np.mean(believed, axis=0))
        if len(believed) == 1:
            return design_predictive(mean, self._grid)
        remembering = [e.name for e in mean.input_effects if e.rest(mean.dt)]
        same = {n: mean.parameters[n].value for name in remembering for n in mean.names_of(name)}
        return design_predictive(mean, self._grid, draws=[self._model(p).with_parameters(same) for p in believed])

    @cached_property
    def _kept(self) -> list[int]:
        return [i for i, name in enumerate(self.names) if name in self.machine.parameters]

    @cached_property
    def _grid(self) -> Grid:
        return spanning(self.table, self.machine)

    def _model(self, parameters: Array) -> Model:
        return self.machine.with_parameters({self.names[i]: float(parameters[i]) for i in self._kept})

    def _worth(self, policies: Sequence[Predictive], true: Array) -> Array:
        """The mean return (K,) of one policy on all machines, or of each on its own, all machines side by side."""
        parameters = {self.names[i]: np.repeat(true[:, i], self.episodes) for i in self._kept}
        starts = (np.tile(values, len(true)) for values in fresh_start_states(0, self.episodes))
        policy = policies[0] if len(policies) == 1 else PolicyBatch(tuple(policies))
        evaluation = evaluate(policy, self.machine.with_parameters(parameters), *starts)
        return np.asarray(np.mean(evaluation.returns.reshape(len(true), -1), axis=1))

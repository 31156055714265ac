"""What is decided with the parameters: a policy, and what it returns on a machine whose parameters are others."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from policies.control.dynamic_programming import Grid
from policies.control.predictive import Predictive, design_predictive
from policies.control.references import spanning
from policies.environments.machine import machine_of
from policies.evaluation import PolicyBatch, evaluate, fresh_start_states
from sysid import Model, OutputEffect

Array = NDArray[np.float64]

TABLE = Grid(120, 121, u=5, memory=3)
"""More torques and memory change returns by 0.01 %."""


class Decision(Protocol):
    """A problem in which a policy is made for what is believed, and earns what is true."""

    def returns(self, believed: Array, true: Array) -> Array:
        """The return (K,) of the policy made for each row of believed (K, P), on the machine of that row of true."""
        ...

    def randomized(self, draws: Array, true: Array) -> Array:
        """The return (K,) on the machines true (K, P) of one policy made for all draws (D, P) alike."""
        ...


@dataclass(frozen=True, eq=False)
class SwingUp:
    """Swing up and hold, by dynamic programming: what a policy trained to the optimum of a model would do.

    machine    the fitted model as a policy meets it, which acts on the state: sensing is left out
    names      of the P parameters; one that the machine does not have (of a sensor's zero, of the log) changes nothing
    episodes   start states, the same for all
    table      of the optimum; a coarse one plans with a margin, as trained agents do
    """

    machine: Model
    names: tuple[str, ...]
    episodes: int = 40
    table: Grid = TABLE

    @classmethod
    def of(
        cls,
        model: Model,
        names: Sequence[str],
        u_max: float | None = None,
        episodes: int = 40,
        table: Grid = TABLE,
    ) -> SwingUp:
        """On a fitted model, with commands up to u_max [N m]. Raises InvalidInput as `machine_of` does."""
        machine = machine_of(model, u_max)
        moving = tuple(e for e in machine.effects if not isinstance(e, OutputEffect))
        return cls(dataclasses.replace(machine, effects=moving), tuple(names), episodes, table)

    def returns(self, believed: Array, true: Array) -> Array:
        """As Decision says."""
        rows, which = np.unique(believed[:, self._kept], axis=0, return_inverse=True)
        designed = [design_predictive(self._model(believed[which == i][0]), self._grid) for i in range(len(rows))]
        return self._worth(designed if len(rows) == 1 else [designed[i] for i in which], true)

    def randomized(self, draws: Array, true: Array) -> Array:
        """As Decision says; what the input path remembers keeps its mean, since a policy counts on it."""
        mean = self._model(np.mean(draws, axis=0))
        remembering = [e.name for e in mean.input_effects if e.rest(mean.dt)]
        kept = {n: mean.parameters[n].value for name in remembering for n in mean.names_of(name)}
        others = [self._model(draw).with_parameters(kept) for draw in draws]
        return self._worth([design_predictive(mean, self._grid, draws=others)], true)

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
        own = {self.names[i]: np.repeat(true[:, i], self.episodes) for i in self._kept}
        starts = (np.tile(values, len(true)) for values in fresh_start_states(0, self.episodes))
        policy = policies[0] if len(policies) == 1 else PolicyBatch(tuple(policies))
        found = evaluate(policy, self.machine.with_parameters(own), *starts)
        return np.asarray(np.mean(found.returns.reshape(len(true), -1), axis=1))

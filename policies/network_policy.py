"""A trained policy as plain arrays: a network's commands in NumPy, free of torch."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from policies.environments import task
from sysid import InvalidInput, State


@dataclass(frozen=True, eq=False)
class NetworkPolicy:
    """The deterministic policy of one trained agent: u = u_max tanh(loc(observation)), in float32 NumPy.

    layers: (W (in, out), b (out,)) of the actor, ReLU between them; history: how many past commands it observes.
    A callable for `policies.evaluation.evaluate`, which hands it its past commands.
    """

    layers: tuple[tuple[NDArray[np.float32], NDArray[np.float32]], ...]
    u_max: float
    history: int = 0

    def __call__(self, state: State, t: float, past: NDArray[np.float64] | None = None) -> NDArray[np.float32]:
        """u (E,) [N m] for what is seen of E episodes, and their last commands past (E, history) [N m].

        Raises InvalidInput where past commands are missing.
        """
        known = 0 if past is None else past.shape[-1]
        if known != self.history:
            raise InvalidInput(f"{known} past commands were given: this policy observes the last {self.history}")
        fractions = () if past is None else tuple(past[..., i] / self.u_max for i in range(known))
        return self.command(np.stack(task.observation(state, fractions), -1).astype(np.float32))

    def command(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """u (...) [N m] for observations (..., 3 + history)."""
        x = observation
        *hidden, (weight, bias) = self.layers
        for w, b in hidden:
            x = np.maximum(x @ w + b, np.float32(0.0))
        loc = (x @ weight + bias)[..., 0]
        return np.float32(self.u_max) * np.tanh(loc)

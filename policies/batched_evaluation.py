"""Many policies on one machine in one run: a fine simulation costs nearly the same for one as for all of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from policies.evaluate import Policy, evaluate
from sysid import Model, State

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Abreast:
    """Policies side by side, each on its own share of the episodes."""

    policies: tuple[Policy, ...]

    @property
    def history(self) -> int:
        """As many past commands as any of them asks for."""
        return max(getattr(policy, "history", 0) for policy in self.policies)

    def __call__(self, state: State, t: float, past: Array | None = None) -> Array:
        shares = np.split(np.arange(len(state.theta)), len(self.policies))
        commands = []
        for policy, own in zip(self.policies, shares, strict=True):
            seen, known = State(state.theta[own], state.theta_dot[own]), getattr(policy, "history", 0)
            commands.append(policy(seen, t, past[own, :known]) if known and past is not None else policy(seen, t))
        return np.concatenate(commands)


def returns(policies: Sequence[Policy], model: Model, theta: Array, theta_dot: Array) -> Array:
    """Returns (P, E) of policies from start states (E,), the same for all, or (P, E), of each its own.

    Raises InvalidInput as `evaluate` does.
    """
    shape = (len(policies), np.shape(theta)[-1])
    starts = (np.broadcast_to(values, shape).ravel() for values in (theta, theta_dot))
    return evaluate(Abreast(tuple(policies)), model, *starts).returns.reshape(shape)

"""A trained policy as plain arrays: a network's commands in NumPy, free of torch."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from policies.environments import task
from sysid import InvalidInput, State


@dataclass(frozen=True, eq=False)
class NetworkPolicy:
    """The deterministic policy of one trained agent, in float32 NumPy; a policy for `evaluate`.

        u = u_max tanh(loc(observation))

    Parameters
    ----------
    layers : tuple of pairs of arrays (in, out) and (out,)
        Weights W and biases b of the actor's layers, float32; a ReLU stands between them.
    u_max : float
        The largest command [N m].
    history : int, optional
        How many past commands it observes; `evaluate` hands them to it.
    """

    layers: tuple[tuple[NDArray[np.float32], NDArray[np.float32]], ...]
    u_max: float
    history: int = 0

    def __call__(self, state: State, t: float, past_commands: NDArray[np.float64] | None = None) -> NDArray[np.float32]:
        """The commands of E episodes.

        Parameters
        ----------
        state : State
            What is seen of the episodes: theta (E,) [rad], theta_dot (E,) [rad/s].
        t : float
            The time since the start [s], which makes no difference.
        past_commands : array (E, history), optional
            The last commands [N m], the latest first.

        Returns
        -------
        array (E,)
            The commands u [N m], float32.

        Raises
        ------
        InvalidInput
            Where as many past commands as the policy observes are not given.
        """
        known = 0 if past_commands is None else past_commands.shape[-1]
        if known != self.history:
            raise InvalidInput(f"{known} past commands were given: this policy observes the last {self.history}")
        fractions = () if past_commands is None else tuple(past_commands[..., i] / self.u_max for i in range(known))
        return self.command(np.stack(task.observation(state, fractions), -1).astype(np.float32))

    def command(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """The commands for observations.

        Parameters
        ----------
        observation : array (..., 3 + history)
            The observations, float32.

        Returns
        -------
        array (...)
            The commands u [N m], float32.
        """
        x = observation
        *hidden, (weight, bias) = self.layers
        for w, b in hidden:
            x = np.maximum(x @ w + b, np.float32(0.0))
        loc = (x @ weight + bias)[..., 0]
        return np.float32(self.u_max) * np.tanh(loc)

"""One pendulum as a gymnasium.Env: any sysid Model, the swing-up task.

    env = gymnasium.make("gapfinder/Pendulum-v0", model=sysid.paper_model(m=2.0, l=1.5))

The same interface, numbers and start states as Gymnasium's Pendulum-v1 (float64 inside, float32 observations).
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from policies import task
from policies.randomization import Randomization
from sysid import InvalidInput, Model, State, paper_model

Observation = NDArray[np.float32]


class PendulumEnv(gymnasium.Env[Observation, NDArray[np.float32]]):
    """Observation [cos theta, sin theta, theta_dot] (3,), action u (1,) [N m] in [-u_max, u_max], clipped to it.

    `randomization` draws new parameters at every reset, after the start state; `info` holds them. The horizon is
    the TimeLimit of `gymnasium.make`: a truncation, never a terminal state. Raises InvalidInput for a model without
    u_max.
    """

    metadata = {"render_modes": []}  # noqa: RUF012

    def __init__(self, model: Model | None = None, randomization: Randomization | None = None) -> None:
        self.model = self._drawn = paper_model() if model is None else model
        self.randomization = randomization
        if not np.isfinite(self.model.u_max):
            raise InvalidInput(f"the model has u_max = {self.model.u_max}: expected a finite torque limit [N m]")
        speed = getattr(self.model.integrator, "theta_dot_max", np.inf)
        high = np.array([1.0, 1.0, speed], dtype=np.float32)
        self.observation_space = spaces.Box(-high, high, dtype=np.float32)
        self.action_space = spaces.Box(-self.model.u_max, self.model.u_max, shape=(1,), dtype=np.float32)
        self._state, self._steps = State(0.0, 0.0), 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode; options {"theta": ..., "theta_dot": ...} fix the start state instead of drawing it."""
        super().reset(seed=seed)
        theta, theta_dot = task.start_state(self.np_random)
        fixed = options or {}
        drawn = self.randomization.sample(self.np_random, self.model) if self.randomization else {}
        self._drawn = self.model.with_parameters(drawn)
        self._state = self._drawn.initial_state(
            float(fixed.get("theta", theta)), float(fixed.get("theta_dot", theta_dot))
        )
        self._steps = 0
        return self._observation(), {"parameters": drawn}

    def step(self, action: NDArray[np.float32]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Hold u = clip(action) for dt; the reward is of the state before the step."""
        u = float(np.clip(np.asarray(action, dtype=np.float32), -self.model.u_max, self.model.u_max)[0])
        reward = float(task.reward(self._state, u))
        self._state = self._drawn.advance(self._state, u, self._steps * self.model.dt)
        self._steps += 1
        return self._observation(), reward, False, False, {}

    def _observation(self) -> Observation:
        return np.array(task.observation(self._state), dtype=np.float32)

"""One pendulum as a gymnasium.Env: any sysid Model, the swing-up task.

    env = gymnasium.make("gapfinder/Pendulum-v0", model=model)

The same interface, numbers and start states as Gymnasium's Pendulum-v1 (float64 inside, float32 observations). At
another dt than its 0.05 s give `max_episode_steps=task.horizon(dt)` too.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from policies.environments import task
from policies.environments.randomization import RandomForce, Randomization
from sysid import InvalidInput, Model, RodPendulum, SemiImplicitEuler

Observation = NDArray[np.float32]


def pendulum_v1() -> Model:
    """The machine of Gymnasium's Pendulum-v1."""
    return Model(RodPendulum(), integrator=SemiImplicitEuler(theta_dot_max=8.0), dt=0.05, u_max=2.0)


class PendulumEnv(gymnasium.Env[Observation, NDArray[np.float32]]):
    """Observation [cos theta, sin theta, theta_dot, *past] (3 + history,), action u (1,) [N m], clipped to +-u_max.

    Observed is what the model's sensors show, and the last `history` commands / u_max. `randomization` draws new
    parameters at every reset, after the start state; `info` holds them. The horizon is the TimeLimit of
    `gymnasium.make`: a truncation, never a terminal state. Raises InvalidInput for a model without u_max and for random
    torques.
    """

    metadata = {"render_modes": []}  # noqa: RUF012

    def __init__(
        self, model: Model | None = None, randomization: Randomization | None = None, history: int = 0
    ) -> None:
        self.model = self._drawn = pendulum_v1() if model is None else model
        self.randomization, self.history = randomization, history
        if isinstance(randomization, RandomForce):
            raise InvalidInput("a RandomForce acts in BatchedPendulums alone: expected another randomization")
        if not np.isfinite(self.model.u_max):
            raise InvalidInput(f"the model has u_max = {self.model.u_max}: expected a finite torque limit [N m]")
        speed = getattr(self.model.integrator, "theta_dot_max", np.inf)
        if self.model.output_effects:
            speed = np.inf
        high = np.array([1.0, 1.0, speed, *(1.0,) * history], dtype=np.float32)
        self.observation_space = spaces.Box(-high, high, dtype=np.float32)
        self.action_space = spaces.Box(-self.model.u_max, self.model.u_max, shape=(1,), dtype=np.float32)
        self._begin(0.0, 0.0)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode; options {"theta": ..., "theta_dot": ...} fix the start state instead of drawing it."""
        super().reset(seed=seed)
        theta, theta_dot = task.start_state(self.np_random)
        fixed = options or {}
        drawn = self.randomization.sample(self.np_random, self.model) if self.randomization else {}
        self._drawn = self.model.with_parameters(drawn)
        self._begin(float(fixed.get("theta", theta)), float(fixed.get("theta_dot", theta_dot)))
        return self._observation(), {"parameters": drawn}

    def step(self, action: NDArray[np.float32]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Hold u = clip(action) for dt; the reward is of the state before the step."""
        u = float(np.clip(np.asarray(action, dtype=np.float32), -self.model.u_max, self.model.u_max)[0])
        reward = float(task.reward(self._state, u, self.model.dt))
        self._state = self._drawn.advance(self._state, u, self._steps * self.model.dt)
        self._steps += 1
        self._past = (u / self.model.u_max, *self._past)[: self.history]
        self._look()
        return self._observation(), reward, False, False, {}

    def _begin(self, theta: float, theta_dot: float) -> None:
        self._state, self._steps = self._drawn.initial_state(theta, theta_dot), 0
        self._past, self._sensing = (0.0,) * self.history, self._drawn.sensing(theta, theta_dot)
        self._look()

    def _look(self) -> None:
        now = self._state.theta, self._state.theta_dot
        self._seen, self._sensing = self._drawn.read(*now, self._sensing, self._steps * self.model.dt)

    def _observation(self) -> Observation:
        return np.array(task.observation(self._seen, self._past), dtype=np.float32)

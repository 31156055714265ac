"""One pendulum as a gymnasium.Env: any sysid Model, the swing-up task.

    env = gymnasium.make("policies:gapfinder/Pendulum-v0", model="model.json", u_max=2.0, history=3)

"policies:" spares the import of this package, which registers the name; Gymnasium 1 reads no entry points.
The same interface, numbers and start states as Gymnasium's Pendulum-v1 (float64 inside, float32 observations).
"""

from __future__ import annotations

from os import PathLike
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from policies.environments import task
from policies.environments.machine import machine_of
from policies.environments.randomization import RandomForce, Randomization
from sysid import InvalidInput, Model, RodPendulum, SemiImplicitEuler, load

Observation = NDArray[np.float32]
SIZE = 200
"""Pixels of an image."""


def pendulum_v1() -> Model:
    """The machine of Gymnasium's Pendulum-v1."""
    return Model(RodPendulum(), integrator=SemiImplicitEuler(theta_dot_max=8.0), dt=0.05, u_max=2.0)


def make_pendulum(
    model: Model | str | PathLike[str] | None = None,
    u_max: float | None = None,
    dt: float | None = None,
    randomization: Randomization | None = None,
    history: int = 0,
    render_mode: str | None = None,
) -> gymnasium.Env[Observation, NDArray[np.float32]]:
    """What `gymnasium.make` calls: an episode of 10 s, whatever the interval between commands is.

    model: a Model, the file of one, or Pendulum-v1's; u_max [N m] and dt [s] make the machine of a file as they do on
    the command line. Raises InvalidInput for a machine that cannot be trained on.
    """
    if model is not None and not isinstance(model, Model):
        model = machine_of(load(model).model, u_max, dt)
    elif u_max is not None or dt is not None:
        raise InvalidInput("u_max and dt are given: expected them with the file of a model only")
    env = PendulumEnv(model, randomization, history, render_mode)
    return gymnasium.wrappers.TimeLimit(env, task.horizon(env.model.dt))


class PendulumEnv(gymnasium.Env[Observation, NDArray[np.float32]]):
    """One pendulum as a gymnasium.Env, with the swing-up task.

        observation = [cos theta, sin theta, theta_dot, past_commands]   (3 + history,)    action = u   (1,) [N m]

    The action is clipped to +-u_max. Observed is what the model's sensors show, and the last `history` commands divided
    by u_max.

    Parameters
    ----------
    model : Model, optional
        The pendulum; by default the machine of Gymnasium's Pendulum-v1.
    randomization : Randomization, optional
        It draws new parameters at every reset, after the start state; `info` holds them.
    history : int, optional
        How many past commands are observed.
    render_mode : str, optional
        "rgb_array" for images; by default nothing is rendered.

    Raises
    ------
    InvalidInput
        For a model without u_max, a history longer than an episode, and random torques.

    Notes
    -----
    The horizon is the TimeLimit of `gymnasium.make`: a truncation, never a terminal state.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 20}  # noqa: RUF012

    def __init__(
        self,
        model: Model | None = None,
        randomization: Randomization | None = None,
        history: int = 0,
        render_mode: str | None = None,
    ) -> None:
        self.model = self._drawn = pendulum_v1() if model is None else model
        self.render_mode, self.metadata = render_mode, {**self.metadata, "render_fps": round(1.0 / self.model.dt)}
        task.check_history(history, self.model.dt)
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
        """Start an episode.

        Parameters
        ----------
        seed : int, optional
            The seed of the random numbers from here on.
        options : dict, optional
            {"theta": ..., "theta_dot": ...} fix the start state [rad], [rad/s] instead of drawing it.

        Returns
        -------
        observation : array (3 + history,)
            The first observation, float32.
        info : dict
            "parameters" holds those that were drawn.
        """
        super().reset(seed=seed)
        theta, theta_dot = task.start_state(self.np_random)
        fixed = options or {}
        drawn = self.randomization.sample(self.np_random, self.model) if self.randomization else {}
        self._drawn = self.model.with_parameters(drawn)
        self._begin(float(fixed.get("theta", theta)), float(fixed.get("theta_dot", theta_dot)))
        return self._observation(), {"parameters": drawn}

    def step(self, action: NDArray[np.float32]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Hold u = clip(action) for dt; the reward is of the state before the step.

        Parameters
        ----------
        action : array (1,)
            The command [N m].

        Returns
        -------
        observation : array (3 + history,)
            What is observed after the step, float32.
        reward : float
            What the step adds to the return.
        terminated, truncated : bool
            False: the environment itself ends no episode.
        info : dict
            Nothing.
        """
        u = float(np.clip(np.asarray(action, dtype=np.float32), -self.model.u_max, self.model.u_max)[0])
        reward = float(task.reward(self._state, u, self.model.dt))
        self._state = self._drawn.advance(self._state, u, self._steps * self.model.dt)
        self._steps += 1
        self._past_commands = (u / self.model.u_max, *self._past_commands)[: self.history]
        self._look()
        return self._observation(), reward, False, False, {}

    def render(self) -> NDArray[np.uint8] | None:
        """The rod as it stands, upright at the top.

        Returns
        -------
        array (SIZE, SIZE, 3) or None
            The image; None where render_mode is not "rgb_array".
        """
        if self.render_mode != "rgb_array":
            return None
        y, x = (0.5 - np.mgrid[:SIZE, :SIZE] / SIZE) * 2.4
        theta = float(self._state.theta)
        along = np.clip(x * np.sin(theta) + y * np.cos(theta), 0.0, 1.0)
        away = np.hypot(x - along * np.sin(theta), y - along * np.cos(theta))
        return np.where((away < 0.06)[..., None], np.uint8((178, 34, 34)), np.uint8(255))

    def _begin(self, theta: float, theta_dot: float) -> None:
        self._state, self._steps = self._drawn.initial_state(theta, theta_dot), 0
        self._past_commands, self._sensing = (0.0,) * self.history, self._drawn.sensing(theta, theta_dot)
        self._look()

    def _look(self) -> None:
        now = self._state.theta, self._state.theta_dot
        self._seen, self._sensing = self._drawn.read(*now, self._sensing, self._steps * self.model.dt)

    def _observation(self) -> Observation:
        return np.array(task.observation(self._seen, self._past_commands), dtype=np.float32)

"""Energy swing-up that hands over to the LQR: pump until the LQR can catch, then let it.

    policy = design_swing_up(model)
    print(evaluate(policy, plant, *start_states(seed=0)))

Source: Astrom & Furuta, "Swinging up a pendulum by energy control", Automatica 36 (2000).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from policies.control.design_model import Step, step_of
from policies.control.lqr import LQR, design_lqr
from sysid import InvalidInput, Model, State, ops
from sysid.physics.ops import Array

LOOK_AHEAD = 4.0
"""How far `catches` looks, in times sqrt(J / G) of falling. A longer look hands over earlier, to an LQR that
creeps up at its torque limit; a shorter one misses the few chances of a heavy pendulum."""
CAUGHT = 0.05
"""The LQR has caught where its cost to come is below this: below 0.1 rad from the upright."""
BAND = 0.2
"""Pumping eases off where the missing energy is below u_max * BAND: full torque's work over BAND [rad]."""


@dataclass(frozen=True, eq=False)
class SwingUp:
    """Swing-up by energy: the LQR acts where it catches the pendulum, else energy is pumped; a policy for `evaluate`.

        E(theta, theta_dot) = J theta_dot^2 / 2 - G (1 - cos theta),   E = 0 upright at rest, -2 G hanging
        u = u_max clip(-E / (u_max BAND), -1, 1) sign(theta_dot),      dE/dt = u theta_dot

    Attributes
    ----------
    lqr : LQR
        The feedback about the upright.
    step : callable
        The step of the design model: (theta, theta_dot) after dt from theta [rad], theta_dot [rad/s] and u [N m].
    dt : float
        The control interval [s].
    J : float
        The inertia with all effects [kg m^2].
    G : float
        The largest gravity torque [N m].

    Notes
    -----
    Where the LQR catches is not guessed: the design model is run ahead from every state under the saturated LQR.

    References
    ----------
    Astrom & Furuta, "Swinging up a pendulum by energy control", Automatica 36 (2000).
    """

    lqr: LQR
    step: Step
    dt: float
    J: float
    G: float

    def energy(self, theta: Array | float, theta_dot: Array | float) -> Array | float:
        """The energy E above the upright at rest.

        Parameters
        ----------
        theta, theta_dot : array or float
            The state [rad], [rad/s].

        Returns
        -------
        array or float
            E [J].
        """
        return 0.5 * self.J * theta_dot**2 - self.G * (1.0 - ops.cos(theta))

    def pump(self, state: State) -> Array:
        """The torque that brings the energy to that of the upright.

        Parameters
        ----------
        state : State
            The state, theta (E,) [rad] and theta_dot (E,) [rad/s].

        Returns
        -------
        array (E,)
            The command u [N m].
        """
        missing = -self.energy(state.theta, state.theta_dot)
        direction = np.where(np.asarray(state.theta_dot) < 0.0, -1.0, 1.0)  # never 0: it would hang at rest
        return np.clip(missing / BAND, -self.lqr.u_max, self.lqr.u_max) * direction

    def catches(self, state: State) -> NDArray[np.bool_]:
        """Whether the LQR brings each state to the upright within LOOK_AHEAD, on the design model.

        Parameters
        ----------
        state : State
            The state, theta (E,) [rad] and theta_dot (E,) [rad/s].

        Returns
        -------
        array (E,) of bool
            True where the LQR catches.
        """
        theta, theta_dot = state.theta, state.theta_dot
        for _ in range(math.ceil(LOOK_AHEAD * math.sqrt(self.J / self.G) / self.dt)):
            theta, theta_dot = self.step(theta, theta_dot, self.lqr(State(theta, theta_dot)))
        return self.lqr.cost_to_go(theta, theta_dot) < CAUGHT

    def __call__(self, state: State, t: float = 0.0) -> Array:
        return np.where(self.catches(state), self.lqr(state), self.pump(state))


def design_swing_up(model: Model) -> SwingUp:
    """Design the swing-up for a model whose gravity torque is G sin(theta).

    Parameters
    ----------
    model : Model
        The model that the swing-up is designed on.

    Returns
    -------
    SwingUp
        The controller, a policy for `evaluate`.

    Raises
    ------
    InvalidInput
        As `design_lqr` does, and for another gravity torque or no torque limit.
    """
    lqr, step = design_lqr(model), step_of(model)
    if not math.isfinite(model.u_max):
        raise InvalidInput("the model has no torque limit u_max: expected one; without it use the LQR alone")
    J = model.plant.inertia() + sum(e.inertia() for e in model.joint_effects)
    G = model.plant.largest_gravity_torque
    theta = np.linspace(-math.pi, math.pi, 33)
    if not G > 0.0 or np.max(np.abs(model.plant.gravity_torque(theta) - G * np.sin(theta))) > 1e-9 * G:
        raise InvalidInput(f"the gravity torque of {model.plant}: expected G sin(theta) with G > 0")
    return SwingUp(lqr=lqr, step=step, dt=model.dt, J=float(J), G=float(G))

"""LQR at the upright: the best linear feedback on the linearised step, saturated at the torque limit.

policy = design_lqr(model)
print(evaluate(policy, plant, *start_states(seed=0)))
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi
import numpy as np
from numpy.typing import NDArray

from policies.control.design_model import step_of
from policies.environments import task
from sysid import InvalidInput, Model, State, ops
from sysid.physics.ops import Array

NEWTON = 5
"""Steps towards the torque that holds the upright: one is exact but for rounding where the plant is steep."""


@dataclass(frozen=True, eq=False)
class LQR:
    """Linear feedback about the upright, saturated at the torque limit; a policy for `evaluate`.

        u = clip(u_0 - K x, -u_max, u_max),   x = (wrap(theta), theta_dot)

    Attributes
    ----------
    A, B : array (2, 2), array (2, 1)
        The model's step linearised at the upright: x' = A x + B (u - u_0).
    Q, R, N : array (2, 2), array (1, 1), array (2, 1)
        The task's cost there: x'Q x + u'R u + 2 x'N u.
    K : array (1, 2)
        The gain [N m/rad, N m s/rad].
    S : array (2, 2)
        The cost to come without saturation is x'S x.
    u_0 : float
        The torque [N m] that holds the upright: 0 unless the model has a torque bias.
    u_max : float
        The torque limit [N m].
    """

    A: Array
    B: Array
    Q: Array
    R: Array
    N: Array
    K: Array
    S: Array
    u_0: float
    u_max: float

    @property
    def poles(self) -> NDArray[np.complex128]:
        """Eigenvalues (2,) of A - B K, inside the unit circle."""
        return np.linalg.eigvals(self.A - self.B @ self.K).astype(np.complex128)

    def cost_to_go(self, theta: Array | float, theta_dot: Array | float) -> Array:
        """The cost to come without saturation, x'S x.

        Parameters
        ----------
        theta, theta_dot : array or float
            The state [rad], [rad/s].

        Returns
        -------
        array
            The cost, in the shape of theta and theta_dot broadcast together.
        """
        x = np.stack(np.broadcast_arrays(ops.wrap(theta), theta_dot), axis=-1)
        return np.einsum("...i,ij,...j->...", x, self.S, x)

    def __call__(self, state: State, t: float = 0.0) -> Array:
        k_theta, k_theta_dot = self.K[0]
        u = self.u_0 - k_theta * ops.wrap(state.theta) - k_theta_dot * state.theta_dot
        return np.clip(u, -self.u_max, self.u_max)

    def __str__(self) -> str:
        k_theta, k_theta_dot = self.K[0]
        law = f"u = {self.u_0:.3g} - {k_theta:.3g} theta - {k_theta_dot:.3g} theta_dot"
        return f"LQR {law}, poles {np.real_if_close(self.poles).round(3)}"


def design_lqr(model: Model) -> LQR:
    """Design the LQR of a model about the upright.

    Parameters
    ----------
    model : Model
        The model that the LQR is designed on.

    Returns
    -------
    LQR
        The feedback, a policy for `evaluate`.

    Raises
    ------
    InvalidInput
        For a model whose input effects remember past commands, with a parameter that is not one number, or with an
        effect that depends on time; for one that no torque within +-u_max holds upright; and for one that a small
        torque does not move.

    Notes
    -----
    The LQR minimises the sum of the task's costs over an infinite horizon, to second order at the upright. The Riccati
    equation is solved by python-control.
    """
    import control  # loads matplotlib; late, so that importing this module stays cheap

    x, u = casadi.SX.sym("x", 2), casadi.SX.sym("u")
    after = casadi.vertcat(*step_of(model)(x[0], x[1], u))
    cost = task.cost(State(x[0], x[1]), u)
    hessian, _ = casadi.hessian(cost, casadi.vertcat(x, u))
    linearise = casadi.Function(
        "linearise", [x, u], [after, casadi.jacobian(after, x), casadi.jacobian(after, u), 0.5 * hessian]
    )

    u_0 = 0.0
    for _ in range(NEWTON):
        drift, _, B, _ = (np.asarray(a) for a in linearise([0.0, 0.0], u_0))
        if not abs(B[1, 0]) > 0.0:
            raise InvalidInput("a small torque does not move the upright: dry friction or a dead zone holds it")
        u_0 -= float(drift[1, 0] / B[1, 0])
    drift, A, B, half = (np.asarray(a) for a in linearise([0.0, 0.0], u_0))
    if np.max(np.abs(drift)) > 1e-9 or abs(u_0) > model.u_max:
        raise InvalidInput(
            f"the upright needs {u_0:g} N m and still drifts by {drift[:, 0]} a step: "
            f"expected an equilibrium at theta = 0 within +-{model.u_max:g} N m"
        )
    Q, R, N = half[:2, :2], half[2:, 2:], half[:2, 2:]
    K, S, _ = control.dlqr(A, B, Q, R, N)
    return LQR(A=A, B=B, Q=Q, R=R, N=N, K=np.asarray(K), S=np.asarray(S), u_0=u_0 + 0.0, u_max=model.u_max)

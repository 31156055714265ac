"""The near-optimal return, by finite-horizon dynamic programming over (theta, theta_dot).

    optimal = solve(sysid.paper_model(m=2.0, l=1.5))
    print(evaluate(optimal, plant, *start_states(seed=0)))           # the best that this grid knows to do
    print(-optimal.cost_to_go(*start_states(seed=0)).mean())         # what it promises

Interpolation weights act as transition probabilities: the scheme is monotone and its error cannot grow.
Source: Kushner & Dupuis, Numerical Methods for Stochastic Control Problems in Continuous Time, ch. 5.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from policies import task
from policies.design import Step, step_of
from sysid import InvalidInput, Model, State

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Grid:
    """Nodes of the table: `theta` angles around the circle, `theta_dot` speeds up to +-theta_dot_max [rad/s]
    and `u` torques up to +-u_max. The upright at rest without torque is a node, hence even and odd numbers.

    A speed beyond theta_dot_max counts as theta_dot_max, which is exact where the model clips it there. Twice
    the torques change the paper's returns by less than 0.05 (the optimum is nearly bang-bang).
    """

    theta: int = 450
    theta_dot: int = 451
    u: int = 21
    theta_dot_max: float = 8.0

    def __post_init__(self) -> None:
        if self.theta < 4 or self.theta % 2:
            raise InvalidInput(f"a grid of theta = {self.theta} angles: expected an even number >= 4")
        for name in ("theta_dot", "u"):
            number = getattr(self, name)
            if number < 3 or number % 2 == 0:
                raise InvalidInput(f"a grid of {name} = {number} values: expected an odd number >= 3")
        if not 0.0 < self.theta_dot_max < math.inf:
            raise InvalidInput(f"theta_dot_max = {self.theta_dot_max}: expected a positive speed [rad/s]")

    @property
    def states(self) -> State:
        """The nodes theta (T, 1) in [-pi, pi) and theta_dot (1, D)."""
        theta = -math.pi + 2.0 * math.pi / self.theta * np.arange(self.theta)
        theta_dot = np.linspace(-self.theta_dot_max, self.theta_dot_max, self.theta_dot)
        return State(theta[:, None], theta_dot[None, :])

    def torques(self, u_max: float) -> Array:
        """The torques (U,) [N m]."""
        return np.linspace(-u_max, u_max, self.u)

    def corners(self, theta: Array, theta_dot: Array) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
        """The nodes (..., 4) around each state, numbered as in a flat table, and their weights (..., 4)."""
        a = (theta + math.pi) / (2.0 * math.pi / self.theta)
        b = np.clip(theta_dot / self.theta_dot_max, -1.0, 1.0) * (self.theta_dot // 2) + self.theta_dot // 2
        a, b = np.broadcast_arrays(a, b)
        i, j = np.floor(a).astype(np.int32), np.minimum(b.astype(np.int32), self.theta_dot - 2)
        p, q = a - i, b - j
        low, high = i % self.theta * self.theta_dot + j, (i + 1) % self.theta * self.theta_dot + j
        weights = np.stack([(1.0 - p) * (1.0 - q), (1.0 - p) * q, p * (1.0 - q), p * q], axis=-1)
        return np.stack([low, low + 1, high, high + 1], axis=-1), weights.astype(np.float32)


@dataclass(frozen=True, eq=False)
class Optimal:
    """The cost to come V_k on the grid, and the policy that is greedy with it; a policy for `evaluate`.

        V_N = 0,   V_k(x) = min_u [cost(x, u) + V_{k+1}(f(x, u))],   u_k(x) = argmin of the same

    f is the step of `model`, the one designed on; values (N + 1, T, D) float32 hold V_k at the nodes, bilinear
    between them. The policy applies f to the state as it is, so it acts well on a coarse grid too.
    """

    model: Model
    grid: Grid
    values: NDArray[np.float32]

    @property
    def horizon(self) -> int:
        """N, the number of steps."""
        return len(self.values) - 1

    @cached_property
    def _step(self) -> Step:
        return step_of(self.model)

    def cost_to_go(self, theta: Array, theta_dot: Array, k: int = 0) -> Array:
        """V_k at theta [rad], theta_dot [rad/s], of their shape; -V_0 is the return that it promises."""
        nodes, weights = self.grid.corners(theta, theta_dot)
        return np.einsum("...c,...c->...", self.values[k].ravel()[nodes], weights, dtype=np.float64)

    def __call__(self, state: State, t: float) -> Array:
        k = round(t / self.model.dt)
        if not 0 <= k < self.horizon:
            raise InvalidInput(f"step {k} (t = {t:g} s): this policy was solved for {self.horizon} steps")
        theta, theta_dot = np.asarray(state.theta)[..., None], np.asarray(state.theta_dot)[..., None]
        torques = self.grid.torques(self.model.u_max)
        after = self._step(theta, theta_dot, torques)
        total = task.cost(State(theta, theta_dot), torques) + self.cost_to_go(*after, k + 1)
        return torques[np.argmin(total, axis=-1)]

    def __str__(self) -> str:
        g = self.grid
        size = f"{g.theta} x {g.theta_dot} states, {g.u} torques, {self.horizon} steps"
        return f"optimal for {self.model}: {size}"


def solve(model: Model, grid: Grid = Grid(), horizon: int = task.HORIZON) -> Optimal:
    """Dynamic programming, backwards from the last step, for the task's cost on the model.

    Interpolation at f(x, u) is the same linear map of V_{k+1} at every k: a sparse matrix a torque, with four
    entries a row, built once from the model's own step. Raises InvalidInput as `step_of` does and for a
    model without torque limit.
    """
    step = step_of(model)
    if not math.isfinite(model.u_max):
        raise InvalidInput("the model has no torque limit u_max: expected one, torques are a grid up to it")
    states, shape = grid.states, (grid.theta, grid.theta_dot)
    size = grid.theta * grid.theta_dot
    stages = []
    for u in grid.torques(model.u_max):
        nodes, weights = grid.corners(*step(states.theta, states.theta_dot, float(u)))
        rows = np.arange(0, 4 * size + 1, 4, dtype=np.int32)
        cost = np.broadcast_to(task.cost(states, u), shape).astype(np.float32).ravel()
        stages.append((cost, csr_array((weights.ravel(), nodes.ravel(), rows), shape=(size, size))))

    values = np.zeros((horizon + 1, *shape), dtype=np.float32)
    best, total = np.empty(size, dtype=np.float32), np.empty(size, dtype=np.float32)
    for k in reversed(range(horizon)):
        later = values[k + 1].ravel()
        best.fill(np.inf)
        for cost, expectation in stages:
            np.add(cost, expectation @ later, out=total)
            np.minimum(best, total, out=best)
        values[k] = best.reshape(shape)
    return Optimal(model=model, grid=grid, values=values)

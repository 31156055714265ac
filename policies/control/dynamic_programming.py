"""The near-optimal return, by finite-horizon dynamic programming over (theta, theta_dot).

    optimal = solve(model)
    print(evaluate(optimal, plant, *start_states(seed=0)))           # the best that this grid knows to do
    print(-optimal.cost_to_go(*start_states(seed=0)).mean())         # what it promises

Tables are multilinear between the nodes of a regular grid. Interpolation weights act as transition probabilities: the
scheme is monotone and its error cannot grow. They act as noise too, whose variance a step is on average a sixth of the
squared spacing: a coarse table plans with a margin, a fine one to the edge of what the plant can do. The finer is worth
more on the plant it was solved for, less on others.
Source: Kushner & Dupuis, Numerical Methods for Stochastic Control Problems in Continuous Time, ch. 5.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array

from policies.control.design_model import check_numbers, is_periodic, is_steady
from policies.environments import task
from sysid import InvalidInput, Model, State
from sysid.physics.ops import Array, Value


@dataclass(frozen=True)
class Axis:
    """`count` nodes over `span`, centred at zero: from -span/2 around a circle, or to span/2 along a line.

    What lies beyond a line's ends counts as its ends. The nodes of a line are odd in number, those of a circle even, so
    that zero is one of them.
    """

    span: float
    count: int
    circle: bool = False

    @property
    def spacing(self) -> float:
        """Between two nodes."""
        return self.span / (self.count if self.circle else self.count - 1)

    @property
    def nodes(self) -> Array:
        """Where they are (count,)."""
        return self.spacing * (np.arange(self.count) - self.count // 2)

    def around(self, x: ArrayLike) -> tuple[NDArray[np.int32], NDArray[np.int32], Array]:
        """The nodes below and above x, and the share of the upper one, each of the shape of x."""
        place = np.asarray(x) / self.spacing + self.count // 2
        if self.circle:
            below = np.floor(place).astype(np.int32)
            return below % self.count, (below + 1) % self.count, place - below
        place = np.clip(place, 0.0, self.count - 1.0)
        below = np.minimum(place.astype(np.int32), self.count - 2)
        return below, below + 1, place - below


def corners(axes: Sequence[Axis], point: Sequence[ArrayLike]) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """The nodes (..., 2^D) around each point, numbered as in a flat table over D axes, and their weights (..., 2^D)."""
    nodes, weights = np.zeros(1, dtype=np.int32), np.ones(1, dtype=np.float32)
    for axis, x in zip(axes, np.broadcast_arrays(*point), strict=True):
        below, above, share = axis.around(x)
        pair = np.stack([below, above], axis=-1)[..., None, :]
        shares = np.stack([1.0 - share, share], axis=-1).astype(np.float32)[..., None, :]
        nodes = (nodes[..., None] * np.int32(axis.count) + pair).reshape(*x.shape, -1)
        weights = (weights[..., None] * shares).reshape(*x.shape, -1)
    return nodes, weights


TURNS = 3
"""Turns of theta that a table spans where torques wind up with the angle."""
LARGEST = 200_000_000
"""Entries of all matrices beyond which a table is refused, 8 bytes each; twice as many of its own, 4 bytes each."""
Stage = tuple[NDArray[np.float32], csr_array]


@dataclass(frozen=True)
class Grid:
    """Nodes of the table: `theta` angles a turn, `theta_dot` speeds up to +-theta_dot_max [rad/s] and `u` torques up
    to +-u_max; `memory` values of each number that the input path remembers.

    The upright at rest without torque is a node, hence even and odd numbers. A speed beyond theta_dot_max counts as
    theta_dot_max, which is exact where the model clips it there. Twice the torques change the paper's returns by less
    than 0.05 (the optimum is nearly bang-bang).
    """

    theta: int = 450
    theta_dot: int = 451
    u: int = 21
    theta_dot_max: float = 8.0
    memory: int = 9

    def __post_init__(self) -> None:
        if self.theta < 4 or self.theta % 2:
            raise InvalidInput(f"a grid of theta = {self.theta} angles: expected an even number >= 4")
        for name in ("theta_dot", "u", "memory"):
            number = getattr(self, name)
            if number < 3 or number % 2 == 0:
                raise InvalidInput(f"a grid of {name} = {number} values: expected an odd number >= 3")
        if not 0.0 < self.theta_dot_max < math.inf:
            raise InvalidInput(f"theta_dot_max = {self.theta_dot_max}: expected a positive speed [rad/s]")

    def torques(self, u_max: float) -> Array:
        return np.linspace(-u_max, u_max, self.u)


@dataclass(frozen=True, eq=False)
class Optimal:
    """The cost to come V_k on a grid, and the policy that is greedy with it; a policy for `evaluate`.

        V_N = 0,   V_k(x) = min_u [cost(x, u) + V_{k+1}(f(x, u, t_k))],   u_k(x) = argmin of the same

    f is the step of `model`; x = (theta, theta_dot, memory), what its input path remembers included.

    Attributes
    ----------
    model : Model
        The model that the policy was designed on.
    grid : Grid
        The nodes of the table.
    values : array (N + 1, T, D, ...)
        V_k at the nodes, float32, multilinear between them; an axis for each number that the input path remembers
        follows those of theta and theta_dot.
    draws : tuple of Model
        With them f is the step of one of these, drawn anew at every step, and what is minimised is the mean.

    Notes
    -----
    The policy applies f to the state as it is, so it acts well on a coarse grid too.

    References
    ----------
    Kushner & Dupuis, Numerical Methods for Stochastic Control Problems in Continuous Time, ch. 5.
    """

    model: Model
    grid: Grid
    values: NDArray[np.float32]
    draws: tuple[Model, ...] = ()

    @property
    def horizon(self) -> int:
        """N, the number of steps."""
        return len(self.values) - 1

    @cached_property
    def axes(self) -> tuple[Axis, ...]:
        """Those of the table."""
        return _axes(self.model, self.grid)

    def cost_to_go(self, theta: Array, theta_dot: Array, k: int = 0, memory: Sequence[Value] = ()) -> Array:
        """The cost to come V_k of states; -V_0 is the return that it promises.

        Parameters
        ----------
        theta, theta_dot : array
            The states [rad], [rad/s].
        k : int, optional
            The step.
        memory : sequence of arrays or floats, optional
            The numbers that the input path remembers; by default those of rest.

        Returns
        -------
        array
            V_k, in the shape of the states.
        """
        remembered = tuple(memory) or (0.0,) * (len(self.axes) - 2)
        nodes, weights = corners(self.axes, (theta, theta_dot, *remembered))
        return np.einsum("...c,...c->...", self.values[k].ravel()[nodes], weights, dtype=np.float64)

    def __call__(self, state: State, t: float) -> Array:
        k = round(t / self.model.dt)
        if not 0 <= k < self.horizon:
            raise InvalidInput(f"step {k} (t = {t:g} s): this policy was solved for {self.horizon} steps")
        memory = self.model.rest()
        if len(self.axes) > 2:
            memory = tuple(tuple(np.asarray(v)[..., None] for v in values) for values in state.memory)
        now = State(np.asarray(state.theta)[..., None], np.asarray(state.theta_dot)[..., None], memory)
        torques = self.grid.torques(self.model.u_max)
        later = [model.advance(now, torques, t) for model in self.draws or (self.model,)]
        paid = -task.reward(now, torques, self.model.dt)
        total = paid + sum(self.cost_to_go(x.theta, x.theta_dot, k + 1, _flat(x)) for x in later) / len(later)
        return torques[np.argmin(total, axis=-1)]


def solve(model: Model, grid: Grid | None = None, horizon: int | None = None, draws: Sequence[Model] = ()) -> Optimal:
    """Dynamic programming, backwards from the last step, for the task's cost on the model.

    Interpolation at f(x, u) is the same linear map of V_{k+1} at every k: a sparse matrix a torque, with 2^D entries a
    row, built once from the model's own step, and for effects that depend on time at every k. Sensing is left out: the
    policy acts on the state.
    horizon   steps in an episode, by default those of 10 s
    draws     models that the machine may be: which one moves it is drawn anew at every step

    Raises InvalidInput for a model without torque limit, with a parameter that is not one number, whose input path
    remembers too much for the grid (`predictive` takes whole samples of a delay out).
    """
    grid = Grid() if grid is None else grid
    horizon = task.horizon(model.dt) if horizon is None else horizon
    _check(model, grid, horizon)
    axes = _axes(model, grid)
    shape, size = tuple(axis.count for axis in axes), math.prod(axis.count for axis in axes)
    moving = tuple(draws) or (model,)
    kept = list(_stages(moving, axes, grid, 0.0)) if all(map(is_steady, moving)) else None

    values = np.zeros((horizon + 1, *shape), dtype=np.float32)
    best, total = np.empty(size, dtype=np.float32), np.empty(size, dtype=np.float32)
    for k in reversed(range(horizon)):
        later = values[k + 1].ravel()
        best.fill(np.inf)
        for cost, expectation in kept or _stages(moving, axes, grid, k * model.dt):
            np.add(cost, expectation @ later, out=total)
            np.minimum(best, total, out=best)
        values[k] = best.reshape(shape)
    return Optimal(model=model, grid=grid, values=values, draws=tuple(draws))


def _check(model: Model, grid: Grid, horizon: int) -> None:
    check_numbers(model)
    if not math.isfinite(model.u_max):
        raise InvalidInput("the model has no torque limit u_max: expected one, torques are a grid up to it")
    counts = [axis.count for axis in _axes(model, grid)]
    if math.prod(counts) * 2 ** len(counts) * grid.u > LARGEST:
        remembered = len(counts) - 2
        raise InvalidInput(
            f"a table of {' x '.join(map(str, counts))} states and {grid.u} torques is too large (of past commands, "
            f"the model remembers {remembered} numbers): expected a coarser grid, as Grid(120, 121, u=11, memory=5)"
        )
    if math.prod(counts) * (horizon + 1) > 2 * LARGEST:
        raise InvalidInput(
            f"a table of {' x '.join(map(str, counts))} states at each of {horizon} steps is too large: expected a "
            "coarser grid, as Grid(120, 121), or a longer dt"
        )


def _axes(model: Model, grid: Grid) -> tuple[Axis, ...]:
    """Those of the table: angles around the circle, or along some turns where torques wind up with the angle.

    What is remembered are torques, which never exceed the largest that a command gives.
    """
    turn = 2.0 * math.pi
    angles = Axis(turn, grid.theta, circle=True) if is_periodic(model) else Axis(TURNS * turn, TURNS * grid.theta + 1)
    remembered = len(_flat(model.initial_state(0.0, 0.0)))
    static = dataclasses.replace(model, effects=tuple(e for e in model.input_effects if not e.rest(model.dt)))
    drives, _ = static.drive(grid.torques(model.u_max), static.rest())
    reach = float(np.max(np.abs(drives[0]))) or 1.0
    return (angles, Axis(2.0 * grid.theta_dot_max, grid.theta_dot), *(Axis(2.0 * reach, grid.memory),) * remembered)


def _stages(models: Sequence[Model], axes: Sequence[Axis], grid: Grid, t: float) -> Iterator[Stage]:
    """For each torque the cost at every node, and the matrix that interpolates the table one step on."""
    model, counts = models[0], [axis.count for axis in axes]
    theta, theta_dot, *rest = np.ix_(*(axis.nodes for axis in axes))
    numbers = iter(rest)
    memory = tuple(tuple(next(numbers) for _ in values) for values in model.rest())
    now = State(theta, theta_dot, memory)
    for u in grid.torques(model.u_max).tolist():
        paid = np.broadcast_to(-task.reward(now, u, model.dt), counts)
        first, *others = (_interpolation(axes, machine.advance(now, u, t)) for machine in models)
        mean = sum(others, start=first) / np.float32(len(models)) if others else first
        yield paid.astype(np.float32).ravel(), mean


def _interpolation(axes: Sequence[Axis], after: State) -> csr_array:
    """The matrix that reads the table where the nodes go; its weights are float32 as the table is."""
    counts = [axis.count for axis in axes]
    size = math.prod(counts)
    nodes, weights = corners(axes, (after.theta, after.theta_dot, *_flat(after)))
    width = nodes.shape[-1]
    rows = np.arange(0, width * size + 1, width, dtype=np.int32)
    nodes, weights = (np.broadcast_to(x, (*counts, width)).ravel() for x in (nodes, weights))
    return csr_array((weights, nodes, rows), shape=(size, size))


def _flat(state: State) -> tuple[Value, ...]:
    """Every number that the input path remembers."""
    return tuple(value for memory in state.memory for value in memory)

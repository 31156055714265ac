"""Kalman filter and smoother of z = (theta, theta_dot, d, o, states of dynamic effects, f, its rate) about a motion.

CasADi runs the recursion of mean and covariance, instant by instant. How innovations respond to changes of the model
then is one banded triangular system, which LAPACK solves for all changes together.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import casadi
import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dtbtrs

from sysid.estimation.disturbances import Disturbances
from sysid.physics.ops import Array

BLOCK = 256
"""Number of instants in one CasADi call; a longer log takes several calls."""
UNROLLED = 16
"""Number of instants that are unrolled into one CasADi graph."""
SPREAD = (3.0, 30.0)
"""Prior sd of angle and speed at a record's start, as multiples of the reach: so wide that it says nothing."""


@dataclass(frozen=True, eq=False)
class LinearSystem:
    """A linear state-space model of M instants; x is the deviation from the motion that it was linearised about.

        x_(k+1) = A_k (x_k, d_k) + gap_k,    r_k = H_k x_k + weight_k (o_k + f_k) (1, 0) + v_k,   v ~ N(0, I)

    x holds theta, theta_dot and the n - 2 states of dynamic effects, whose sd at a record's start is inner_sd (n - 2,).
    The third column of A (M, n, n + 1) belongs to d. gap (M, n); the slopes H (M, 2, 2) and residuals r (M, 2) of the
    readings are in units of the sensor's sd, 0 where nothing was read. o is an error of `error_channel`: 0, the angle,
    as written, or 1, the speed, and so is f; weight (M,) is 1 / sd of its readings. follows (M,) says whether the next
    instant is of the same record. dt [s]. reach [rad]: a large way for this log.
    """

    A: Array
    gap: Array
    H: Array
    r: Array
    weight: Array
    follows: NDArray[np.bool_]
    dt: float
    inner_sd: tuple[float, ...] = ()
    reach: float = 1.0
    error_channel: int = 0

    @property
    def moving(self) -> list[int]:
        """The indices in z of the states that the model moves: theta, theta_dot and those of dynamic effects."""
        return _moving(len(self.inner_sd))

    @property
    def driving(self) -> list[int]:
        """The indices in z that the next state depends on (all but the errors), in the order of A's columns."""
        return _driving(len(self.inner_sd))

    def filter(self, disturbances: Disturbances) -> Filter:
        """The Kalman filter under these disturbances."""
        states, updates = self._scan(disturbances)
        return Filter(self, disturbances, states, updates)

    @cached_property
    def _columns(self) -> Array:
        """A row of W inputs of the recursion for each instant, M rows padded to whole blocks."""
        M, (n, m) = len(self.r), self.A.shape[1:]
        columns = np.zeros((-(-M // BLOCK) * BLOCK, n * m + n + 8))
        follows = self.follows[:, None]
        parts = [follows * self.A.reshape(M, n * m), follows * self.gap, self.H.reshape(M, 4), self.r]
        columns[:M] = np.hstack([*parts, self.weight[:, None], ~follows])
        return columns

    def _scan(self, disturbances: Disturbances) -> tuple[Array, Array]:
        columns, M, inner, smooth = self._columns, len(self.r), len(self.inner_sd), disturbances.sigma_f > 0.0
        N = _size(inner, smooth)
        factor, increment, variance = disturbances.discrete(self.dt)
        first = np.zeros(_packed(N) + N)
        start = [*np.square(np.multiply(SPREAD, self.reach)), *variance[:2], *np.square(self.inner_sd), *variance[2:]]
        first[_diagonal(N)] = start[:N]
        scale = np.concatenate([factor[_NONZERO], increment[_NONZERO], start[:N]])
        states, updates = np.empty((len(columns) + 1, len(first))), np.empty((len(columns), 2 * N + 4))
        states[0] = first
        read = self.H[:, [0, 1], [0, 1]]
        own_state = not (np.any(self.H[:, 0, 1]) or np.any(self.H[:, 1, 0]))
        seen = bool(np.any(read[:, 0])), bool(np.any(read[:, 1]))
        steps = _steps(inner, own_state, seen, self.error_channel, disturbances.sigma_o > 0.0, smooth)
        buffer, run = steps.buffer()
        buffer.set_arg(2, _view(scale))
        for begin in range(0, len(columns), BLOCK):
            state = np.ascontiguousarray(states[begin])
            buffer.set_arg(0, _view(state))
            buffer.set_arg(1, _view(columns[begin : begin + BLOCK]))
            buffer.set_res(0, _view(states[begin + 1 : begin + 1 + BLOCK]))
            buffer.set_res(1, _view(updates[begin : begin + BLOCK]))
            run()
        return states[:M], updates[:M]


_NONZERO = np.array([0, 1, 2, 2, 3, 3]), np.array([0, 1, 2, 3, 2, 3])
"""The entries of a transition of (d, o, f, its rate) that are not 0."""


def _moving(inner: int) -> list[int]:
    return [0, 1, *range(4, 4 + inner)]


def _driving(inner: int) -> list[int]:
    return [0, 1, 2, *range(4, 4 + inner)]


def _disturbing(inner: int, smooth: bool) -> list[int]:
    return [2, 3, *range(4 + inner, _size(inner, smooth))]


def _size(inner: int, smooth: bool) -> int:
    return 4 + inner + 2 * smooth


def _packed(N: int) -> int:
    """The number of entries in the lower triangle of an (N, N) matrix; they are stored column by column."""
    return N * (N + 1) // 2


def _diagonal(N: int) -> list[int]:
    return [_packed(N) - _packed(N - j) for j in range(N)]


def _instant(
    inner: int, own_state: bool, seen: tuple[bool, bool], error_channel: int, coloured: bool, smooth: bool
) -> casadi.Function:
    """One instant of the filter: update by each channel's reading in turn, then predict the next instant.

        S = h P h' + 1,  K = P h' / S,  e = r - h m;   m + K e,  P - K S K';   then  F m + g,  F P F' + Q

    The inputs are the predicted P (lower triangle) and m, a row of `_columns`, and scale: how the disturbances go on,
    their increments, and the variances at a record's start. The outputs are the next P and m; and the gains K,
    variances S and errors e of the readings. The flags keep zeros out of the graph: whether each channel shows its own
    state alone, whether it was read at all, and whether there are errors o and f of `error_channel`.
    """
    n, N = inner + 2, _size(inner, smooth)
    width, lower = n * (n + 1) + n + 8, casadi.Sparsity.lower(N)
    state, scale = casadi.SX.sym("state", _packed(N) + N), casadi.SX.sym("scale", N + 12)
    column = casadi.SX.sym("column", width)
    A, gap, rest = casadi.reshape(column[: n * (n + 1)], n + 1, n).T, column[n * (n + 1) : n * (n + 2)], column[-8:]
    H, r, weight, ends = casadi.reshape(rest[:4], 2, 2).T, rest[4:6], rest[6], rest[7]
    P, m = casadi.tril2symm(casadi.SX(lower, state[: _packed(N)])), state[_packed(N) :]
    if not coloured:
        P[3, :], P[:, 3], m[3] = 0, 0, 0
        P = casadi.sparsify(P)
    gains, variances, errors = list[casadi.SX](), list[casadi.SX](), list[casadi.SX]()
    for i, read in enumerate(seen):
        h, K, S, e = casadi.SX(1, N), casadi.SX.zeros(N), casadi.SX(1), casadi.SX(0)
        if read:
            for j in range(2):
                if i == j or not own_state:
                    h[j] = H[i, j]
            if i == error_channel:
                h[[3] * coloured + [N - 2] * smooth] = weight
            Ph = P @ h.T
            S, e = 1.0 + h @ Ph, r[i] - h @ m
            K = Ph * (1.0 / S)
            m, P = m + K * e, casadi.tril2symm(casadi.tril(P - K @ Ph.T))
        gains, variances, errors = [*gains, K], [*variances, S], [*errors, e]
    F, g = casadi.SX(N, N), casadi.SX(N, 1)
    F[_moving(inner), _driving(inner)], g[_moving(inner)] = A, gap
    Q = casadi.diag(ends * scale[12:])
    at = _disturbing(inner, smooth)
    for k, (i, j) in enumerate(zip(*_NONZERO, strict=True)):
        if max(i, j) < len(at):
            F[at[i], at[j]] = scale[k] * (1.0 - ends)
            Q[at[i], at[j]] += scale[6 + k] * (1.0 - ends)
    m, P = F @ m + g, F @ P @ F.T + Q
    after = casadi.vertcat(casadi.project(P, lower).nz[:], casadi.densify(m))
    said = casadi.densify(casadi.vertcat(*gains, *variances, *errors))
    return casadi.Function("instant", [state, column, scale], [after, said], {"cse": True})


@cache
def _steps(
    inner: int, own_state: bool, seen: tuple[bool, bool], error_channel: int, coloured: bool, smooth: bool
) -> casadi.Function:
    """`_instant` over a BLOCK of instants, with its outputs after each. UNROLLED of them share one graph, since a call
    for each would cost as much as the computation itself."""
    instant = _instant(inner, own_state, seen, error_channel, coloured, smooth)
    V, W, scales = (instant.size1_in(k) for k in range(3))
    scale = casadi.SX.sym("scale", scales)
    several, states, updates = casadi.SX.sym("several", W, UNROLLED), [casadi.SX.sym("state", V)], list[casadi.SX]()
    for k in range(UNROLLED):
        after, said = instant(states[-1], several[:, k], scale)
        states.append(after)
        updates.append(said)
    ends, given = [states[-1], casadi.horzcat(*states[1:]), casadi.horzcat(*updates)], [states[0], several, scale]
    unrolled, count = casadi.Function("unrolled", given, ends, {"cse": True}), BLOCK // UNROLLED
    inputs = [casadi.MX.sym("state", V), casadi.MX.sym("block", W, BLOCK), casadi.MX.sym("scale", scales)]
    _, after, said = unrolled.mapaccum(count).call([*inputs[:2], casadi.repmat(inputs[2], 1, count)])
    return casadi.Function("steps", inputs, [after, said])


def _view(values: Array) -> Any:
    return memoryview(values)  # type: ignore[arg-type]  # NumPy arrays are buffers


@dataclass(frozen=True, eq=False)
class Filter:
    """The Kalman filter's result on a log: `states` (M, N (N + 3) / 2), predicted covariances and means of z; and
    `updates` (M, 2 N + 4), gains, variances and errors of the readings.

    If predicted means change by m and readings by R, then innovations change by W R + W H m, and the next predicted
    mean by m' = Phi m + g - Gamma R. The readings of the two channels come in turn, with the gains K_1 and K_2.
    """

    system: LinearSystem
    disturbances: Disturbances
    states: Array
    updates: Array

    @property
    def size(self) -> int:
        """The number N of components of z; without a smooth error f, its two are not there."""
        return _size(len(self.system.inner_sd), self.disturbances.sigma_f > 0.0)

    @cached_property
    def variances(self) -> Array:
        """Predicted variances (M, 2) of the innovations: 1 where nothing was read, nan where the model ran away."""
        predicted = self.updates[:, -4:-2]
        return np.where(predicted > 0.0, predicted, np.nan)

    @cached_property
    def innovations(self) -> Array:
        """Prediction errors (M, 2) in units of their predicted sd; they are white if the model is right."""
        return self.updates[:, -2:] / np.sqrt(self.variances)

    @cached_property
    def log_variances(self) -> Array:
        """Logarithms (M, 2) of the innovations' predicted variances; 0 where nothing was read."""
        return np.log(self.variances)

    @cached_property
    def deviance(self) -> float:
        """-2 log likelihood of the readings, up to a constant that depends on the sensor alone; inf if the model ran
        away."""
        total = float(np.sum(self.log_variances) + np.sum(self.innovations**2))
        return total if math.isfinite(total) else math.inf

    @cached_property
    def F(self) -> Array:
        """The transition (M, N, N) from z to the next z; 0 at a record's end."""
        s, at = self.system, self._disturbing
        F = np.zeros((len(self.updates), self.size, self.size))
        F[:, np.array(s.moving)[:, None], s.driving] = s.A
        F[:, np.array(at)[:, None], at] = self.disturbances.discrete(s.dt)[0][: len(at), : len(at)]
        F *= s.follows[:, None, None]
        return F

    @cached_property
    def H(self) -> Array:
        """The slopes (M, 2, N) of the readings in z."""
        H = np.zeros((len(self.updates), 2, self.size))
        H[:, :, :2], H[:, self.system.error_channel, self._disturbing[1:3]] = self.system.H, self.system.weight[:, None]
        return H

    @cached_property
    def W(self) -> Array:
        """W (M, 2, 2): the second channel's innovation is what K_1 left of its reading."""
        sd = np.sqrt(self.variances)
        W = np.zeros((len(sd), 2, 2))
        W[:, 0, 0], W[:, 1, 1] = 1.0 / sd.T
        W[:, 1, 0] = -np.einsum("mi,mi->m", self.H[:, 1], self._gains[0][:, :, 0]) / sd[:, 1]
        return W

    @cached_property
    def WH(self) -> Array:
        """W H (M, 2, N)."""
        return self.W @ self.H

    @cached_property
    def Gamma(self) -> Array:
        """Gamma = F ((1 - K_2 H_2) K_1, K_2) (M, N, 2)."""
        K_1, K_2 = self._gains
        after = self.F - (self.F @ K_2) @ self.H[:, 1, None, :]
        return np.concatenate([after @ K_1, self.F @ K_2], axis=2)

    @cached_property
    def Phi(self) -> Array:
        """Phi = F - Gamma H (M, N, N)."""
        return self.F - self.Gamma[:, :, 1:] @ self.H[:, 1, None, :] - self.Gamma[:, :, :1] @ self.H[:, 0, None, :]

    @cached_property
    def band(self) -> Array:
        """The band matrix (2 N, N M) of the identity less the shifted Phi."""
        M, N = len(self.updates), self.size
        band = np.zeros((2 * N, N * M))
        band[0] = 1.0
        for i in range(N):
            for j in range(N):
                band[N + i - j, j::N] = -self.Phi[:, i, j]
        return band

    @property
    def _gains(self) -> tuple[Array, Array]:
        """K_1 and K_2, each (M, N, 1)."""
        N = self.size
        return self.updates[:, :N, None], self.updates[:, N : 2 * N, None]

    @property
    def _disturbing(self) -> list[int]:
        """The indices in z of d, o, f and its rate."""
        return _disturbing(len(self.system.inner_sd), self.disturbances.sigma_f > 0.0)

    def whiten(self, G: Array, R: Array) -> Array:
        """The change of the innovations (2 M, C) by small changes G (M, n, C) of the steps' ends and R (M, 2, C) of the
        readings, R in units of the sensor's sd."""
        innovations = self.WH @ np.moveaxis(self._response(G, R), 0, -1)
        if np.any(R):
            innovations += self.W @ R
        return innovations.reshape(2 * len(G), G.shape[2])

    def _response(self, G: Array, R: Array) -> Array:
        """The change (C, M, N) of the predicted means by the changes G and R of `whiten`."""
        M, C, N = len(G), G.shape[2], self.size
        g = np.zeros((C, M, N))
        if C == 0:
            return g
        g[:, 1:, self.system.moving] = np.moveaxis(G, -1, 0)[:, :-1]
        if np.any(R):
            g[:, 1:] -= np.moveaxis(self.Gamma @ R, -1, 0)[:, :-1]
        g[:, 1:][:, ~self.system.follows[:-1]] = 0.0
        m, _ = dtbtrs(self.band, g.reshape(C, M * N).T, uplo="L")
        return m.T.reshape(C, M, N)

    def smooth(self, G: Array | None = None, R: Array | None = None) -> Array:
        """The mean of z (M, N) given all readings, after the model's predictions have changed by G (M, n), R (M, 2)."""
        M, e, mean = len(self.updates), self.innovations, self.states[:, _packed(self.size) :]
        if G is not None and R is not None:
            m = self._response(G[:, :, None], R[:, :, None])[0]
            e = e - np.einsum("mij,mj->mi", self.W, R) - np.einsum("mij,mj->mi", self.WH, m)
            mean = mean + m
        source = np.einsum("mij,mi->mj", self.WH, e).reshape(-1, 1)
        adjoint, _ = dtbtrs(self.band, source, uplo="L", trans="T")
        return mean + np.einsum("mij,mj->mi", self.covariance, adjoint.reshape(M, -1))

    @cached_property
    def covariance(self) -> Array:
        """Predicted covariances (M, N, N)."""
        N = self.size
        columns, rows = np.triu_indices(N)
        P = np.empty((len(self.states), N, N))
        P[:, rows, columns] = P[:, columns, rows] = self.states[:, : _packed(N)]
        return P

    @property
    def sd(self) -> Array:
        """Predicted sd (M, N) of z."""
        return np.sqrt(np.maximum(self.states[:, _diagonal(self.size)], 0.0))

    @cached_property
    def information(self) -> Array:
        """The information I (M, N, N) about z in the readings from each instant on. It is found backwards:
        I = (W H)'(W H) + Phi' I' Phi, where I' belongs to the next instant."""
        gained = np.swapaxes(self.WH, 1, 2) @ self.WH
        information = np.empty_like(gained)
        after = np.zeros((self.size, self.size))
        for k in range(len(gained) - 1, -1, -1):
            information[k] = after = gained[k] + self.Phi[k].T @ after @ self.Phi[k]
        return information

    def posterior_sd(self) -> Array:
        """The sd (M, N) of z given all readings; its covariance is P - P I P."""
        P = self.covariance
        variance = np.diagonal(P - P @ self.information @ P, axis1=1, axis2=2)
        return np.sqrt(np.maximum(variance, 0.0))

    def posterior_sd_of_sums(self, shares: Array) -> Array:
        """The sd (C,), given all readings, of the weighted sums sum_k shares_k d_k with shares (M, C).

        For j < k:  cov(z_k, z_j) = (1 - P_k I_k) Phi_(k-1) ... Phi_j P_j
        """
        P, N = self.covariance, self.size
        left = np.eye(N)[2] - (P @ self.information)[:, 2]
        carried, variance = np.zeros((N, shares.shape[1])), np.zeros(shares.shape[1])
        for k, share in enumerate(shares):
            added = P[k, :, 2, None] * share
            variance += share * (left[k] @ (added + 2.0 * carried))
            carried = self.Phi[k] @ (carried + added)
        return np.sqrt(np.maximum(variance, 0.0))

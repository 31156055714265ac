"""A Kalman smoother for (theta, theta_dot, d, d_dot): which torque d must have acted for a log to have come about.

Linear around a given motion; all records of a log form one chain. CasADi runs the recursions, instant by instant.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache, cached_property

import casadi
import numpy as np
from numpy.typing import NDArray

from sysid.records import Array

_BLOCK = 256
"""Instants that one CasADi call runs through; a longer chain takes several."""


@dataclass(frozen=True)
class Torque:
    """What is taken for granted about d before the log is seen: Gaussian, zero mean, sd s [N m], memory T [s].

        smooth:      Matern covariance s^2 (1 + a) exp(-a),   a = sqrt(3) |t - t'| / T:  d has a derivative
        not smooth:  Ornstein-Uhlenbeck, s^2 exp(-|t - t'| / T):  a random walk that returns to zero; jumps are likely

    (Hartikainen, Sarkka, "Kalman filtering and smoothing solutions to temporal Gaussian process regression", 2010.)
    """

    s: float
    T: float
    smooth: bool = False

    @property
    def variances(self) -> Array:
        """Of d and d_dot (2,); d_dot is left out, as 0, where d has none."""
        return np.array([self.s**2, 3.0 * (self.s / self.T) ** 2 if self.smooth else 0.0])

    def step(self, dt: float) -> tuple[Array, Array]:
        """Phi (2, 2) and Q (2, 2) of (d, d_dot)' = Phi (d, d_dot) + w, w ~ N(0, Q), over dt [s]."""
        rate = math.sqrt(3.0) / self.T
        Phi = np.diag([math.exp(-dt / self.T), 0.0])
        if self.smooth:
            Phi = math.exp(-rate * dt) * np.array([[1.0 + rate * dt, dt], [-rate * rate * dt, 1.0 - rate * dt]])
        P = np.diag(self.variances)
        return Phi, P - Phi @ P @ Phi.T


@dataclass(frozen=True, eq=False)
class Chain:
    """M instants of z = (x, d, d_dot), x being the deviation from the motion about which the model was linearised.

        x_(k+1) = A_k (x_k, d_k) + gap_k,      r_k = H_k x_k + v_k,   v ~ N(0, I)

    A (M, 2, 3), gap (M, 2), H (M, 2, 2), r (M, 2): residuals and slopes in units of the sensor's sd, 0 where nothing
    was read. follows (M,): whether the next instant belongs to the same record; where not, the state begins anew,
    x from N(0, diag(spread^2)). dt [s].
    """

    A: Array
    gap: Array
    H: Array
    r: Array
    follows: NDArray[np.bool_]
    spread: tuple[float, float]
    dt: float

    def log_likelihood(self, torque: Torque) -> float:
        """log p(readings), up to a constant that does not depend on the torque."""
        scale = self._scale(torque)
        state, total = casadi.DM(_start(scale)), 0.0
        for block in self._blocks:
            state, own = _likelihood()(state, block, scale)
            total += float(own)
        return total

    def smooth(self, torque: Torque, linked: bool = False) -> Smoothed:
        """Mean and variance of every z_k given all readings; `linked`: and what ties one instant to the next."""
        scale = self._scale(torque)
        first, forward = casadi.DM(_start(scale)), []
        for block in self._blocks:
            after = _filter()(first, block, scale)
            forward.append((first, after, block))
            first = after[:, -1]
        state, backward = casadi.DM.zeros(14), []
        for first, after, block in reversed(forward):
            state, own = _backward(linked)(state, first, after, block, scale)
            backward.append(np.asarray(own))
        own = np.hstack(backward[::-1])[:, : len(self.r)]
        return Smoothed(own[:4].T, np.maximum(own[4:8].T, 0.0), own[8:])

    def thinned(self, most: int, length: int = 250) -> Chain:
        """About `most` of the instants: stretches of `length`, evenly spread; all where there are no more."""
        M = len(self.r)
        stretches = np.array_split(np.arange(M), max(1, M // length))
        step = M / most
        if step <= 1.0:
            return self
        kept = [stretches[int(i)] for i in np.arange(0.0, len(stretches), step)]
        rows, follows = np.concatenate(kept), self.follows.copy()
        follows[[stretch[-1] for stretch in kept]] = False
        return Chain(self.A[rows], self.gap[rows], self.H[rows], self.r[rows], follows[rows], self.spread, self.dt)

    def _scale(self, torque: Torque) -> Array:
        """Phi, Q and the variances with which a record begins, (12,)."""
        Phi, Q = torque.step(self.dt)
        return np.concatenate([Phi.T.ravel(), Q.ravel(), np.square(self.spread), torque.variances])

    @cached_property
    def _blocks(self) -> list[casadi.DM]:
        M = len(self.r)
        parts = (self.A.reshape(M, 6), self.gap, self.H.reshape(M, 4), self.r, self.follows[:, None])
        return _cut(np.hstack([np.asarray(p, dtype=float) for p in parts]).T)


@dataclass(frozen=True, eq=False)
class Smoothed:
    """Mean and variance (M, 4) of z, and `links` (24, M): what ties one instant to the next."""

    mean: Array
    variance: Array
    links: Array

    def sd_of_means(self, group: NDArray[np.intp], groups: int) -> Array:
        """Posterior sd (groups,) of the mean of d over each group of instants; group (M,), negative: in none.

        For j < k:  cov(z_j, z_k) = P_j L_j' ... L_(k-1)' (I - Lambda_k P_k),   L = F (I - K h').
        """
        size = np.maximum(np.bincount(group[group >= 0], minlength=groups), 1)
        share = np.where(group >= 0, 1.0 / size[group], 0.0)
        state = casadi.DM.zeros(5 * groups)
        for block in _cut(np.vstack([group, share, self.variance[:, 2], self.links])):
            state = _pairs(groups)(state, block)
        total: Array = np.asarray(state)[4 * groups :, 0]
        return np.sqrt(np.maximum(total, 0.0))


def _start(scale: Array) -> Array:
    return np.concatenate([np.zeros(4), np.diag(scale[8:])[np.triu_indices(4)]])


def _cut(inputs: Array) -> list[casadi.DM]:
    """Blocks of instants, the last one filled up with instants that follow nothing and read nothing."""
    M = inputs.shape[1]
    padded = np.zeros((len(inputs), -(-M // _BLOCK) * _BLOCK))
    padded[:, :M] = inputs
    return [casadi.DM(padded[:, begin : begin + _BLOCK]) for begin in range(0, M, _BLOCK)]


def _scan(step: casadi.Function) -> tuple[list[casadi.MX], list[casadi.MX]]:
    """step(state, column[, scale]) -> (state'[, other]) over a block: its inputs, and its states and others."""
    inputs = [casadi.MX.sym("state", step.size1_in(0)), casadi.MX.sym("block", step.size1_in(1), _BLOCK)]
    more = [casadi.MX.sym("scale", step.size1_in(2))] if step.n_in() > 2 else []
    return [*inputs, *more], step.mapaccum(_BLOCK).call([*inputs, *(casadi.repmat(v, 1, _BLOCK) for v in more)])


# one instant, in symbols -------------------------------------------------------------------------------------


def _symbols(before: int = 0) -> tuple[casadi.SX, ...]:
    """Chain's steps behind `before` numbers, and A (2, 3), gap (2,), H (2, 2), r (2,), follows in it."""
    column = casadi.SX.sym("column", before + 15)
    own = column[before:]
    A, H = casadi.reshape(own[:6], 3, 2).T, casadi.reshape(own[8:12], 2, 2).T
    return column, A, own[6:8], H, own[12:14], own[14]


def _symmetric(lower: casadi.SX) -> casadi.SX:
    """A matrix (4, 4) from its lower triangle, column by column (10,)."""
    return casadi.tril2symm(casadi.SX(casadi.Sparsity.lower(4), lower))


def _lower(matrix: casadi.SX) -> casadi.SX:
    return casadi.densify(casadi.tril(matrix)).nz[[4 * j + i for j in range(4) for i in range(j, 4)]]


def _updates(m: casadi.SX, P: casadi.SX, H: casadi.SX, r: casadi.SX) -> list[tuple[casadi.SX, ...]]:
    """A Kalman update a reading: (h, its gain K, its error e, the error's variance S, m and P after it)."""
    steps = []
    for i in range(2):
        h = casadi.vertcat(H[i, :].T, 0, 0)
        Ph = casadi.mtimes(P, h)
        S, e = 1.0 + casadi.dot(h, Ph), r[i] - casadi.dot(h, m)
        m, P = m + Ph * (e / S), P - casadi.mtimes(Ph, Ph.T) / S
        steps.append((h, Ph / S, e, S, m, P))
    return steps


def _transition(A: casadi.SX, follows: casadi.SX, scale: casadi.SX) -> casadi.SX:
    """F (4, 4); zero where the next instant belongs to another record."""
    x = casadi.horzcat(A, casadi.SX(2, 1))
    d = casadi.horzcat(casadi.SX(2, 2), casadi.reshape(scale[:4], 2, 2))
    return casadi.vertcat(x, d) * follows


def _filter_step() -> casadi.Function:
    """Kalman filter: predicted (m, P) -> predicted (m', P') and the instant's log-likelihood."""
    state, scale = casadi.SX.sym("state", 14), casadi.SX.sym("scale", 12)
    column, A, gap, H, r, follows = _symbols()
    updates = _updates(state[:4], _symmetric(state[4:]), H, r)
    log_likelihood = sum(-0.5 * (casadi.log(S) + e * e / S) for _, _, e, S, _, _ in updates)
    m, P = updates[-1][-2:]
    F = _transition(A, follows, scale)
    Q = casadi.diagcat(casadi.SX(2, 2), casadi.reshape(scale[4:8], 2, 2))
    m = casadi.mtimes(F, m) + casadi.vertcat(gap, 0, 0) * follows
    P = casadi.mtimes([F, P, F.T]) + Q * follows + casadi.diag(scale[8:]) * (1.0 - follows)
    after = casadi.vertcat(m, _lower(P))
    return casadi.Function("filter", [state, column, scale], [after, log_likelihood], {"cse": True})


@cache
def _filter() -> casadi.Function:
    """(predicted at first, block, scale) -> predicted after each instant (14, B)."""
    inputs, (states, _) = _scan(_filter_step())
    return casadi.Function("filter_block", inputs, [states])


@cache
def _likelihood() -> casadi.Function:
    """(predicted at first, block, scale) -> predicted after the last instant, and the block's log-likelihood."""
    inputs, (states, others) = _scan(_filter_step())
    return casadi.Function("likelihood_block", inputs, [states[:, -1], casadi.sum2(others)])


def _backward_step(linked: bool) -> casadi.Function:
    """Bierman's fixed-interval smoother, which inverts no covariance: any part of z may be known exactly.

        lambda = -h e/S + C' lambda',   Lambda = h h'/S + C' Lambda' C,   C = I - K h'
        mean = m - P lambda',   cov = P - P Lambda' P

    (Bierman, "Fixed interval smoothing with discrete measurements", Int. J. Control 18, 1973.)
    """
    state, scale = casadi.SX.sym("state", 14), casadi.SX.sym("scale", 12)
    column, A, _, H, r, follows = _symbols(before=14)
    predicted = _symmetric(column[4:14])
    updates = _updates(column[:4], predicted, H, r)
    m, P = updates[-1][-2:]
    F = _transition(A, follows, scale)
    lam, Lam = casadi.mtimes(F.T, state[:4]), casadi.mtimes([F.T, _symmetric(state[4:]), F])
    own = [m - casadi.mtimes(P, lam), casadi.diag(P - casadi.mtimes([P, Lam, P]))]
    L = F
    for h, K, e, S, _, _ in reversed(updates):
        C = casadi.SX.eye(4) - casadi.mtimes(K, h.T)
        lam = casadi.mtimes(C.T, lam) - h * (e / S)
        Lam = casadi.mtimes([C.T, Lam, C]) + casadi.mtimes(h, h.T) / S
        L = casadi.mtimes(L, C)
    if linked:
        ahead = (casadi.SX.eye(4) - casadi.mtimes(Lam, predicted))[:, 2]
        own += [predicted[:, 2], casadi.vec(L), ahead]
    after = casadi.vertcat(lam, _lower(Lam))
    return casadi.Function("backward", [state, column, scale], [after, casadi.vertcat(*own)], {"cse": True})


@cache
def _backward(linked: bool) -> casadi.Function:
    """(lambda, Lambda behind the block, predicted at first and after each instant, block, scale) -> before it, own."""
    (state, columns, scale), (states, own) = _scan(_backward_step(linked))
    first, after = casadi.MX.sym("first", 14), casadi.MX.sym("after", 14, _BLOCK)
    block = casadi.MX.sym("block", 15, _BLOCK)
    turned = casadi.vertcat(casadi.horzcat(first, after[:, :-1]), block)[:, ::-1]
    before, own = casadi.graph_substitute([states[:, -1], own[:, ::-1]], [columns], [turned])
    return casadi.Function("backward_block", [state, first, after, block, scale], [before, own])


@cache
def _pairs(groups: int) -> casadi.Function:
    """Adds up w_j w_k cov(d_j, d_k) for each group; the state holds a (4, groups) = sum_(j<k) L_(k-1) ... L_j P_j w_j
    and the sums so far (groups,)."""
    state, column = casadi.SX.sym("state", 5 * groups), casadi.SX.sym("column", 27)
    a, total = casadi.reshape(state[: 4 * groups], 4, groups), state[4 * groups :]
    group, weight, variance, own, L, ahead = casadi.vertsplit(column, [0, 1, 2, 3, 7, 23, 27])
    w = weight * (group == casadi.DM(range(groups))).T
    share = w * w * variance + 2.0 * w * casadi.mtimes(ahead.T, a)
    a = casadi.mtimes(casadi.reshape(L, 4, 4), a + casadi.mtimes(own, w))
    after = casadi.vertcat(casadi.vec(a), total + share.T)
    inputs, (states,) = _scan(casadi.Function("pairs", [state, column], [after], {"cse": True}))
    return casadi.Function("pairs_block", inputs, [states[:, -1]])

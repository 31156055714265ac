"""How the paper's grid search scatters: theta_hat on many seeds, budgets and noise levels, without training anything.

    residual_k = clip(x_k + a sin(theta_k) + b u_k, +-8) - y_k,    a = 3 g dt / (2 l),  b = 3 dt / (m l^2)

x and y are the noisy speeds before and after a step. Where nothing clips, the sum of squares of a cell (m, l) is a
quadratic form in (a, b) of five sums over the samples, and so cheap that a laptop makes thousands of searches; the
best cells of that form are then rated anew with the clip. A test holds the result equal to `sysid.GridSearch`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from study.paper.presets import PAPER
from study.paper.protocol import BOUNDS, ROLLOUT_LENGTH, paper_model
from sysid import GridSearch, simulate
from sysid.physics.ops import Array

MOST_CANDIDATES, FEWEST_CANDIDATES, WORK = 1500, 250, 4_000_000
"""Cells of the unclipped form that are rated again with the clip: fewer where many samples tell cells apart."""


@dataclass(frozen=True, eq=False)
class Transitions:
    """One-step samples (K,): noisy speeds before and after [rad/s], sine of the angle, torque [N m]."""

    before: Array
    after: Array
    sine: Array
    u: Array

    def read(self, noise: Array, *, clean_inputs: bool = False) -> Transitions:
        """The same with noise (2, K) [rad/s]; clean inputs: all of its variance is on the later reading."""
        first, second = noise
        if clean_inputs:
            return replace(self, after=self.after + second - first)
        return replace(self, before=self.before + first, after=self.after + second)


class OneStepGrid:
    """The paper's 61 x 61 cells, with the change of speed by which each answers to gravity (a) and torque (b)."""

    def __init__(self) -> None:
        model = paper_model()
        axis = np.linspace(*BOUNDS, GridSearch().points)
        self.m, self.l = (cells.ravel() for cells in np.meshgrid(axis, axis, indexing="ij"))
        cells = model.with_parameters({"m": self.m, "l": self.l})
        self.a = np.broadcast_to(cells.move(0.5 * np.pi, 0.0, (0.0,))[1], self.m.shape)
        self.b = np.broadcast_to(cells.move(0.0, 0.0, (1.0,))[1], self.m.shape)

    def search(self, samples: Transitions, ends: Sequence[int], limit: float = 8.0) -> Array:
        """theta_hat (len(ends), 2) of the first `ends` samples each; limit: where speeds clip [rad/s]."""
        x, y, s, u = samples.before, samples.after, samples.sine, samples.u
        d = y - x
        sums = np.cumsum([s * s, s * u, u * u, d * s, d * u], axis=1)
        ss, su, uu, ds, du = sums[:, np.asarray(ends) - 1, None]
        a, b = self.a, self.b
        cost = a * a * ss + 2.0 * a * b * su + b * b * uu - 2.0 * a * ds - 2.0 * b * du
        estimates = []
        for k, end in enumerate(ends):
            count = max(FEWEST_CANDIDATES, min(MOST_CANDIDATES, WORK // end))
            best = np.sort(np.argpartition(cost[k], count)[:count])
            reach = float(np.max(a[best] + 2.0 * b[best]))
            near = np.flatnonzero(np.abs(x[:end]) > limit - reach)
            moved = x[near] + a[best, None] * s[near] + b[best, None] * u[near]
            saved = (np.clip(moved, -limit, limit) - y[near]) ** 2 - (moved - y[near]) ** 2
            winner = best[np.argmin(cost[k, best] + saved.sum(axis=1))]
            estimates.append((self.m[winner], self.l[winner]))
        return np.array(estimates)


def noise_free_rollouts(truth: tuple[float, float], n: int, rng: np.random.Generator) -> tuple[Transitions, Array]:
    """What n rollouts from the paper's start states under its torques go through on the plant at truth (m, l), and unit
    noise (2, K) for both readings."""
    model = paper_model(*truth)
    u = rng.uniform(-model.u_max, model.u_max, (n, ROLLOUT_LENGTH))
    theta, theta_dot = rng.uniform(-np.pi, np.pi, n), rng.uniform(-1.0, 1.0, n)
    run = simulate(model, u, theta, theta_dot)
    speed, sine = run.theta_dot, np.sin(run.theta[:, :ROLLOUT_LENGTH])
    noise = rng.standard_normal((2, n * ROLLOUT_LENGTH))
    return Transitions(speed[:, :-1].ravel(), speed[:, 1:].ravel(), sine.ravel(), u.ravel()), noise


@dataclass(frozen=True, eq=False)
class Scatter:
    """theta_hat (sigmas, budgets, seeds, 2) of the grid search on the plant at truth.

    clean: the same where all noise is on the later reading, so that the predictor's input carries none.
    """

    truth: tuple[float, float]
    sigmas: tuple[float, ...]
    budgets: tuple[int, ...]
    estimates: Array
    clean: Array

    @property
    def seeds(self) -> int:
        return int(self.estimates.shape[2])

    def thetas(self, sigma: float, n: int, *, clean: bool = False) -> Array:
        """theta_hat (seeds, 2) with a noise and a budget."""
        return (self.clean if clean else self.estimates)[self.sigmas.index(sigma), self.budgets.index(n)]

    def errors(self, sigma: float) -> Array:
        """||theta_hat - truth|| (budgets, seeds) with a noise."""
        off = self.estimates[self.sigmas.index(sigma)] - np.array(self.truth)
        return np.hypot(off[..., 0], off[..., 1])

    def edge(self, sigma: float, n: int) -> NDArray[np.bool_]:
        """Of each seed, whether m ended at the edge of the grid (S,)."""
        m = self.thetas(sigma, n)[:, 0]
        low, high = BOUNDS
        return (m < low + 1e-9) | (m > high - 1e-9)

    def at_bound(self, sigma: float, n: int) -> float:
        """The share of seeds whose m ended at the edge of the grid."""
        return float(np.mean(self.edge(sigma, n)))

    def exponent(self, sigma: float, first: int, last: int, rng: np.random.Generator) -> tuple[float, float, float]:
        """p of mean error ~ n^p between two budgets, with its 95 % interval (bootstrap of whole seeds)."""
        chosen = [k for k, n in enumerate(self.budgets) if first <= n <= last]
        log_n = np.log([self.budgets[k] for k in chosen])
        log_n = (log_n - log_n.mean()) / np.sum((log_n - log_n.mean()) ** 2)
        errors = self.errors(sigma)[chosen]
        seeds = errors.shape[1]
        draws = errors[:, rng.integers(0, seeds, (2000, seeds))].mean(axis=2)
        low, high = np.quantile(log_n @ np.log(draws), [0.025, 0.975])
        return float(log_n @ np.log(errors.mean(axis=1))), float(low), float(high)


def scatter(
    rng: np.random.Generator,
    seeds: int = 200,
    budgets: Sequence[int] = (1, 2, 5, 10, 25, 50, 100, 200, 400),
    sigmas: Sequence[float] = (0.5, 1.0, 2.0),
) -> Scatter:
    """Search on `seeds` measurements of the paper's plant; budgets and noise levels of a seed share its rollouts."""
    grid, truth, ends = OneStepGrid(), PAPER.points[0].truth, [n * ROLLOUT_LENGTH for n in budgets]
    estimates = np.empty((2, len(sigmas), len(budgets), seeds, 2))
    for seed, child in enumerate(rng.spawn(seeds)):
        moved, noise = noise_free_rollouts(truth, max(budgets), child)
        for k, sigma in enumerate(sigmas):
            for c in (False, True):
                estimates[int(c), k, :, seed] = grid.search(moved.read(sigma * noise, clean_inputs=c), ends)
    return Scatter(truth, tuple(sigmas), tuple(budgets), *estimates)

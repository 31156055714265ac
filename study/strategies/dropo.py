"""DROPO: a distribution of the parameters under which the observed transitions are likely, from an offline set."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from study.strategies.readings import REACH, smoothed, smoothing_covariance
from study.strategies.simopt import setup_of
from study.strategies.strategy import Dialogue, Play, Situation, Strategy
from sysid import InvalidInput, Record, simulate
from sysid.data.files import check_installed
from sysid.physics.ops import Array

SHIFT = 1e-4
SHIFTS = SHIFT * np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
"""Of a first state, to see what becomes of its error."""


@dataclass(frozen=True)
class Dropo(Strategy):
    """Tiboni, Arndt and Kyrki, "DROPO: Sim-to-real transfer with offline domain randomization", 2023.

        max over mu, sigma of sum_t log N(s_{t+k}; mean, cov of s_{t+k}(xi) + R_t),   xi ~ N(mu, diag sigma^2)
        R_t = E + F_t E F_t',   F_t = d s_{t+k} / d s_t

    mean and covariance over samples xi that all begin in the observed state s_t; CMA-ES searches.

    ahead         k, control intervals of a transition
    transitions   at most, evenly chosen; samples: xi of each, the same draws for every distribution
    evaluations   of CMA-ES; least, most: of sigma, as a share of the plausible range

    Changed: states are smoothed readings, and R_t, which the source tunes as one number epsilon, is what their errors E
    make of both ends. One interval ahead says nothing at a noise of 1 rad/s; k = 20 was found on a plant of m = 1.5 kg
    and l = 1.2 m, the paper's small gap.
    """

    ahead: int = 20
    transitions: int = 300
    samples: int = 10
    evaluations: int = 400
    narrowest: float = 1e-3
    widest: float = 0.5
    short: ClassVar[str] = "DROPO"
    source: ClassVar[str] = "Tiboni 2023"
    group: ClassVar[str] = "adapted"
    needs_angle: ClassVar[bool] = True

    def spend(self, situation: Situation) -> Dialogue:
        records = yield Play(situation.budget)
        mean, sd = self.distribution(situation, records)
        return setup_of(situation, mean, np.diag(sd**2))

    def distribution(self, situation: Situation, records: list[Record]) -> tuple[Array, Array]:
        """mu (P,) and sigma (P,)."""
        check_installed("cma", "strategies", "DROPO")
        import cma

        P = len(situation.names)
        before, u, after = self._transitions(situation, records)
        z = situation.rng.standard_normal((self.samples, P))
        error = smoothing_covariance(situation.sensor, situation.prior.dt)

        def misfits(x: list[Array]) -> list[float]:
            mean, sd = self._of(situation, np.array(x))
            return (-likelihoods(situation, mean, sd, (before, u, after), z, error)).tolist()

        draws = situation.rng.standard_normal
        options = {"bounds": [0.0, 1.0], "maxfevals": self.evaluations, "verbose": -9, "randn": lambda *s: draws(s),
                   "seed": np.nan}  # fmt: skip
        low, high = situation.bounds.T
        begin = np.concatenate([(situation.believed - low) / (high - low), np.full(P, 0.7)])
        result = cma.fmin2(None, begin, 0.25, options, parallel_objective=misfits)[1].result
        return self._of(situation, np.asarray(result.xbest))

    def _of(self, situation: Situation, x: Array) -> tuple[Array, Array]:
        """mu and sigma (..., P) of points (..., 2 P) of the unit cube: mu evenly, log sigma evenly."""
        low, high = situation.bounds.T
        P = len(low)
        ends = np.log([self.narrowest, self.widest])
        return low + x[..., :P] * (high - low), (high - low) * np.exp(ends[0] + x[..., P:] * (ends[1] - ends[0]))

    def _transitions(self, situation: Situation, records: list[Record]) -> tuple[Array, Array, Array]:
        """States before (T, 2), torques (T, k) and states after (T, 2), none near a record's ends, where they are less
        sure."""
        k, rows = self.ahead, []
        for record in records:
            states = np.stack(smoothed(record, situation.sensor), -1)
            begins = range(REACH, len(record.u) - k - REACH + 1, k)
            rows += [(states[i], record.u[i : i + k], states[i + k]) for i in begins]
        if not rows:
            steps = max(len(record.u) for record in records)
            raise InvalidInput(f"DROPO was given rollouts of {steps} steps: expected at least {2 * REACH + k}")
        chosen = np.linspace(0, len(rows) - 1, min(self.transitions, len(rows))).round().astype(int)
        before, u, after = (np.array(column) for column in zip(*(rows[i] for i in chosen), strict=True))
        return before, u, after


def likelihoods(
    situation: Situation, mean: Array, sd: Array, transitions: tuple[Array, Array, Array], z: Array, error: Array
) -> Array:
    """The log of it (S,) for S distributions, mean and sd (S, P), summed over the transitions, but for a constant; z
    (K, P) standard normal."""
    (low, high), (before, u, after), K = situation.bounds.T, transitions, len(z)
    at_mean = np.repeat(np.clip(mean, low, high)[:, None], len(SHIFTS), axis=1)
    values = np.concatenate([np.clip(mean[:, None] + sd[:, None] * z, low, high), at_mean], axis=1)
    starts = before + np.concatenate([np.zeros((K, 2)), SHIFTS])[:, None]
    ends = simulated(situation, values, u, starts)
    drawn, shifted = ends[:, :K], ends[:, K:]
    center = np.mean(drawn, axis=1)
    off = drawn - center[:, None]
    F = np.stack([(shifted[:, i] - shifted[:, 0]) / SHIFT for i in (1, 2)], -1)
    C = np.einsum("skti,sktj->stij", off, off) / (K - 1) + error + F @ error @ np.swapaxes(F, -1, -2)
    e = after - center
    distance = np.einsum("sti,stij,stj->st", e, np.linalg.inv(C), e)
    return np.asarray(-0.5 * np.sum(distance + np.linalg.slogdet(C)[1], axis=1))


def simulated(situation: Situation, values: Array, u: Array, starts: Array) -> Array:
    """States (S, K, T, 2) at the end of transitions (T,) under parameters (S, K, P), from starts (K, T, 2)."""
    run = simulate(situation.model(values[..., None, :]), u, starts[..., 0], starts[..., 1])
    situation.simulated += u.size * values[..., 0].size
    return np.stack([run.theta[..., -1], run.theta_dot[..., -1]], -1)

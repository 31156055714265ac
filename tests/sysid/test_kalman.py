"""The filter is exact: what it says is what conditioning one large Gaussian vector says, in any system it is given."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.linalg import block_diag, expm

from sysid.estimation.disturbances import Disturbances
from sysid.estimation.kalman import BLOCK, SPREAD, LinearSystem
from sysid.estimation.likelihood import likelihood_ascent, maximum_likelihood

DT = 0.02
BOTH = Disturbances(s=4.0, T=0.3, sigma_o=0.8, T_o=0.07)
DISTURBANCES = {
    "d and o": BOTH,
    "no o": replace(BOTH, sigma_o=0.0),
    "no d": replace(BOTH, s=0.0),
    "neither": replace(BOTH, s=0.0, sigma_o=0.0),
    "d, o and f": replace(BOTH, sigma_f=0.6, T_f=0.2),
    "f alone": Disturbances(0.0, sigma_f=0.6, T_f=0.2),
}
READ = ("both channels", "mixed channels", "angle alone", "speed alone", "speed alone, with o", "states inside")
"""What the readings show: each its own state, a mixture, or one channel; or a model with two states of its own. The
error o is the angle's, or else the speed's."""
INSIDE = (0.5, 2.0)


def system(seed: int, lengths: tuple[int, ...], read: str = "both channels") -> LinearSystem:
    """A random time-varying system of several records; a fifth of the readings is missing."""
    rng, M = np.random.default_rng(seed), sum(lengths)
    A = np.tile([[1.0, DT, 0.5 * DT * DT], [-20.0 * DT, 1.0 - 0.5 * DT, DT]], (M, 1, 1))
    A[:, 1] *= rng.uniform(0.8, 1.2, (M, 1))
    A[:, 0, 1] *= rng.uniform(0.8, 1.2, M)
    if read == "states inside":
        coupled = 0.1 * rng.standard_normal((M, 4, 5))
        coupled[:, :2, :3] = A
        coupled[:, [2, 3], [3, 4]] += 0.9
        A = coupled
    H = np.eye(2) * rng.uniform(2.0, 5.0, (M, 2, 2))
    if read == "mixed channels":
        H[:, [0, 1], [1, 0]] = rng.standard_normal((M, 2))
    there = rng.uniform(size=(M, 2)) > 0.2
    there &= [not read.startswith("speed alone"), read != "angle alone"]
    r = 5.0 * rng.standard_normal((M, 2)) * there
    follows = np.ones(M, dtype=bool)
    follows[np.cumsum(lengths) - 1] = False
    erring = int(read == "speed alone, with o")
    weight = rng.uniform(2.0, 5.0, M) * there[:, erring]
    gap, inner_sd = 0.05 * rng.standard_normal((M, A.shape[1])), INSIDE[: A.shape[1] - 2]
    return LinearSystem(A, gap, H * there[:, :, None], r, weight, follows, DT, inner_sd, error_channel=erring)


@dataclass(frozen=True, eq=False)
class Dense:
    """The same as one Gaussian vector: mean (N M,) and covariance (N M, N M) of all z; readings r = H z + N(0, I)."""

    size: int
    mean: np.ndarray
    covariance: np.ndarray
    H: np.ndarray
    r: np.ndarray

    @classmethod
    def of(cls, given: LinearSystem, disturbances: Disturbances) -> Dense:
        """From the defining equations, z' = F z + gap + w, by one inverse."""
        M, inner, sd = len(given.r), len(given.inner_sd), disturbances.sigma_f
        # a process with a double pole at -2 / T_f whose state, scaled so, has equal variances: F by its power series
        pole, f = 2.0 * DT / disturbances.T_f * np.array([[0.0, 1.0], [-1.0, -2.0]]), [0, 1] if sd else []
        N = 4 + inner + len(f)
        at = [2, 3, *range(4 + inner, N)]
        kept = block_diag(*np.exp(-DT / np.array([disturbances.T, disturbances.T_o])), expm(pole)[np.ix_(f, f)])
        kept = kept[: len(at), : len(at)]
        variances = np.square([disturbances.s, disturbances.sigma_o, sd, sd])[: len(at)]
        start = np.diag([*np.square(SPREAD), *variances[:2], *np.square(given.inner_sd), *variances[2:]])
        F, Q, shift = np.zeros((N * M, N * M)), np.zeros((N * M, N * M)), np.zeros(N * M)
        H = np.zeros((2 * M, N * M))
        for k in range(M):
            block = slice(N * k, N * k + N)
            H[2 * k : 2 * k + 2, block][:, :2] = given.H[k]
            H[2 * k + given.error_channel, N * k + np.array(at[1:3])] = given.weight[k]
            if k == 0 or not given.follows[k - 1]:
                Q[block, block] = start
                continue
            step = F[block, N * k - N : N * k]
            step[np.ix_(at, at)], step[np.ix_(given.moving, given.driving)] = kept, given.A[k - 1]
            Q[block, block][np.ix_(at, at)] = np.diag(variances) - kept @ np.diag(variances) @ kept.T
            shift[block][given.moving] = given.gap[k - 1]
        G = np.linalg.inv(np.eye(N * M) - F)
        return cls(N, G @ shift, G @ Q @ G.T, H, given.r.ravel())

    def conditioned(self, readings: slice = slice(None)) -> tuple[np.ndarray, np.ndarray, float]:
        """Mean (M, N) and sd (M, N) given these readings, and -2 log of their likelihood, less n log 2 pi."""
        H = self.H[readings]
        S, e = H @ self.covariance @ H.T + np.eye(len(H)), self.r[readings] - H @ self.mean
        gain = np.linalg.solve(S, H @ self.covariance).T
        variance = np.diag(self.covariance - gain @ H @ self.covariance)
        deviance = np.linalg.slogdet(S)[1] + e @ np.linalg.solve(S, e)
        mean = self.mean + gain @ e
        sd = np.sqrt(np.maximum(variance, 0.0))
        return mean.reshape(-1, self.size), sd.reshape(-1, self.size), float(deviance)


@pytest.mark.parametrize("read", READ)
@pytest.mark.parametrize("disturbances", DISTURBANCES.values(), ids=DISTURBANCES.keys())
def test_filtering_and_smoothing_are_conditioning(disturbances: Disturbances, read: str) -> None:
    given = system(1, (37, 24), read)
    filtered = given.filter(disturbances)
    mean, sd, deviance = Dense.of(given, disturbances).conditioned()
    assert filtered.deviance == pytest.approx(deviance, rel=1e-9)
    np.testing.assert_allclose(filtered.smooth(), mean, rtol=1e-7, atol=1e-7)
    # sd are differences of variances up to 900: what rounding leaves of them is the root of 1e-16 of that
    np.testing.assert_allclose(filtered.posterior_sd(), sd, rtol=1e-6, atol=2e-6)


@pytest.mark.parametrize("disturbances", [BOTH, replace(BOTH, sigma_o=0.0)], ids=["d and o", "no o"])
def test_the_sd_of_a_sum_of_d_is_that_of_conditioning(disturbances: Disturbances) -> None:
    """Sums within a record, over both, and of one instant alone."""
    given = system(1, (37, 24), "mixed channels")
    dense, shares = Dense.of(given, disturbances), np.random.default_rng(3).standard_normal((61, 3))
    shares[37:, 1], shares[:, 2] = 0.0, np.arange(61) == 20
    S = dense.H @ dense.covariance @ dense.H.T + np.eye(len(dense.H))
    left = dense.covariance - dense.covariance @ dense.H.T @ np.linalg.solve(S, dense.H @ dense.covariance)
    d = left[2::4, 2::4]
    filtered = given.filter(disturbances)
    np.testing.assert_allclose(
        filtered.posterior_sd_of_sums(shares), np.sqrt(np.diag(shares.T @ d @ shares)), rtol=1e-5
    )
    assert filtered.posterior_sd_of_sums(shares)[2] == pytest.approx(filtered.posterior_sd()[20, 2], rel=1e-9)


@pytest.mark.parametrize("disturbances", DISTURBANCES.values(), ids=DISTURBANCES.keys())
def test_what_is_predicted_is_conditioned_on_what_came_before(disturbances: Disturbances) -> None:
    given = system(2, (20, 15), "mixed channels")
    filtered, dense = given.filter(disturbances), Dense.of(given, disturbances)
    for k in (0, 1, 7, 19, 20, 21, 34):
        mean, sd, _ = dense.conditioned(slice(0, 2 * k))
        np.testing.assert_allclose(filtered.sd[k], sd[k], rtol=1e-6, atol=2e-6)
        np.testing.assert_allclose(np.sqrt(np.diag(filtered.covariance[k])), filtered.sd[k], rtol=1e-12)
        np.testing.assert_allclose(filtered.states[k, -filtered.size :], mean[k], rtol=1e-7, atol=1e-7)


@pytest.mark.parametrize("read", READ)
@pytest.mark.parametrize("disturbances", DISTURBANCES.values(), ids=DISTURBANCES.keys())
def test_whitened_changes_are_what_the_innovations_lose(disturbances: Disturbances, read: str) -> None:
    """A model that ends its steps G further and shows R more leaves gaps + G and residuals - R."""
    given, C = system(7, (40, 25), read), 3
    rng = np.random.default_rng(8)
    there = np.any(given.H != 0.0, axis=2)
    G = rng.standard_normal((65, len(given.moving), C)) * given.follows[:, None, None]
    R = rng.standard_normal((65, 2, C)) * there[:, :, None]
    before, h = given.filter(disturbances), 1e-3
    whitened = before.whiten(G, R)
    for c in range(C):
        sides = [
            replace(given, gap=given.gap + side * G[:, :, c], r=given.r - side * R[:, :, c]).filter(disturbances)
            for side in (h, -h)
        ]
        lost = -(sides[0].innovations - sides[1].innovations).ravel() / (2.0 * h)
        np.testing.assert_allclose(whitened[:, c], lost, rtol=1e-7, atol=1e-8)
        moved = replace(given, gap=given.gap + G[:, :, c], r=given.r - R[:, :, c]).filter(disturbances)
        np.testing.assert_allclose(before.smooth(G[:, :, c], R[:, :, c]), moved.smooth(), rtol=1e-7, atol=1e-7)


@pytest.mark.parametrize("size", [1e-9, 1e-150])
def test_vanishing_disturbances_are_none(size: float) -> None:
    given = system(10, (200, 100))
    none, little = (given.filter(Disturbances(s, sigma_o=s)) for s in (0.0, size))
    assert little.deviance == pytest.approx(none.deviance, rel=1e-9)
    np.testing.assert_allclose(little.innovations, none.innovations, atol=1e-8)
    np.testing.assert_allclose(little.smooth(), none.smooth(), atol=1e-8)
    np.testing.assert_allclose(little.posterior_sd(), none.posterior_sd(), atol=2e-8)


@pytest.mark.parametrize("first", [1, 100, BLOCK - 1, BLOCK, BLOCK + 1])
def test_where_a_block_ends_does_not_matter(first: int) -> None:
    """Records do not speak to each other, and another one in front moves the edges of the blocks within this one."""
    front, behind = system(11, (first,), "mixed channels"), system(12, (300, 5), "mixed channels")
    fields = ("A", "gap", "H", "r", "weight", "follows")
    both = LinearSystem(*(np.concatenate([getattr(front, f), getattr(behind, f)]) for f in fields), DT)
    together, apart = both.filter(BOTH), behind.filter(BOTH)
    assert together.deviance == pytest.approx(front.filter(BOTH).deviance + apart.deviance, rel=1e-12)
    np.testing.assert_allclose(together.innovations[first:], apart.innovations, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(together.smooth()[first:], apart.smooth(), rtol=1e-9, atol=1e-10)
    np.testing.assert_allclose(together.posterior_sd()[first:], apart.posterior_sd(), rtol=1e-9, atol=1e-10)


def test_where_the_model_ran_away_no_disturbances_are_likelier_and_some_are_told() -> None:
    whole = system(0, (20,))
    lost = replace(whole, gap=np.full_like(whole.gap, math.nan))
    filtered = lost.filter(BOTH)
    assert filtered.deviance == math.inf
    assert likelihood_ascent(filtered, np.full(3, -40.0)) is filtered
    assert maximum_likelihood(lost, [BOTH, replace(BOTH, T=1.0)]) == BOTH


@pytest.mark.parametrize("both", [False, True])
def test_where_the_motion_runs_away_beside_larger_disturbances_no_others_are_likelier(both: bool) -> None:
    """Beside a larger random torque, or beside one with a larger error of the readings."""

    def filtered(at: Disturbances) -> Any:
        lost = at.s > BOTH.s and (at.sigma_o > BOTH.sigma_o or not both)
        return SimpleNamespace(deviance=math.inf if lost else 1.0 + at.s, disturbances=at, system=system)

    system = SimpleNamespace(filter=filtered)
    now = filtered(BOTH)
    assert likelihood_ascent(now, np.full(3, -40.0)) is now

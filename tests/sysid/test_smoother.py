"""The smoother is exact: it says what conditioning a large Gaussian vector says."""

from __future__ import annotations

import numpy as np
import pytest

from sysid.smoothing.smoother import Chain, Smoothed, Torque

DT, M = 0.02, 60
SPREAD = (2.0, 9.0)


def chain(seed: int = 0) -> Chain:
    """Two records of 30 instants; four instants without readings, one reading of speed alone."""
    rng = np.random.default_rng(seed)
    A = np.tile(np.array([[1.0, DT, 2.5 * DT * DT], [0.1 * DT, 1.0, 5.0 * DT]]), (M, 1, 1))
    H, r = 3.0 * rng.standard_normal((M, 2, 2)), 5.0 * rng.standard_normal((M, 2))
    H[5:9], r[5:9], H[20, 0], r[20, 0] = 0.0, 0.0, 0.0, 0.0
    follows = np.ones(M, dtype=bool)
    follows[[29, M - 1]] = False
    return Chain(A, 0.1 * rng.standard_normal((M, 2)), H, r, follows, SPREAD, DT)


def conditioned(given: Chain, torque: Torque) -> tuple[np.ndarray, np.ndarray, float]:
    """Mean (4M,) and covariance (4M, 4M) of all z given all readings, and the log-likelihood, by dense algebra."""
    F, Q, shift = np.zeros((4 * M, 4 * M)), np.zeros((4 * M, 4 * M)), np.zeros(4 * M)
    Phi, Q_d = torque.step(DT)
    begin = np.diag([*np.square(SPREAD), *torque.variances])
    Q[:4, :4] = begin
    for k in range(M - 1):
        now, then = slice(4 * k, 4 * k + 4), slice(4 * k + 4, 4 * k + 8)
        if given.follows[k]:
            F[then, now][:2, :3], F[then, now][2:, 2:], Q[then, then][2:, 2:] = given.A[k], Phi, Q_d
            shift[then] = [*given.gap[k], 0.0, 0.0]
        else:
            Q[then, then] = begin
    G = np.linalg.inv(np.eye(4 * M) - F)
    mean, cov = G @ shift, G @ Q @ G.T
    H = np.zeros((2 * M, 4 * M))
    for k in range(M):
        H[2 * k : 2 * k + 2, 4 * k : 4 * k + 2] = given.H[k]
    S, e = H @ cov @ H.T + np.eye(2 * M), given.r.ravel() - H @ mean
    gain = np.linalg.solve(S, H @ cov).T
    log_likelihood = -0.5 * (np.linalg.slogdet(S)[1] + e @ np.linalg.solve(S, e))
    return mean + gain @ e, cov - gain @ H @ cov, float(log_likelihood)


@pytest.mark.parametrize("smooth", [False, True], ids=["rough", "smooth"])
def test_smoothing_is_conditioning(smooth: bool) -> None:
    given, torque = chain(), Torque(0.4, 0.3, smooth)
    mean, cov, log_likelihood = conditioned(given, torque)
    for linked in (False, True):
        smoothed = given.smooth(torque, linked)
        np.testing.assert_allclose(smoothed.mean.ravel(), mean, rtol=1e-8, atol=1e-8)
        np.testing.assert_allclose(smoothed.variance.ravel(), np.diag(cov), rtol=1e-7, atol=1e-10)
    assert given.log_likelihood(torque) == pytest.approx(log_likelihood, rel=1e-9)


@pytest.mark.parametrize("smooth", [False, True], ids=["rough", "smooth"])
def test_the_sd_of_a_mean_counts_how_samples_go_together(smooth: bool) -> None:
    given, torque = chain(1), Torque(0.4, 0.3, smooth)
    cov = conditioned(given, torque)[1]
    group = np.random.default_rng(2).integers(-1, 4, M)
    found = given.smooth(torque, linked=True).sd_of_means(group, 5)
    for i in range(4):
        w = np.zeros(4 * M)
        w[4 * np.flatnonzero(group == i) + 2] = 1.0 / np.sum(group == i)
        assert found[i] == pytest.approx(np.sqrt(w @ cov @ w), rel=1e-6)
    assert found[4] == 0.0


@pytest.mark.parametrize("smooth", [False, True], ids=["rough", "smooth"])
def test_a_torque_is_stationary_and_two_half_steps_are_one(smooth: bool) -> None:
    torque = Torque(0.7, 0.2, smooth)
    Phi, Q = torque.step(0.05)
    P = np.diag(torque.variances)
    np.testing.assert_allclose(Phi @ P @ Phi.T + Q, P, atol=1e-12)
    half, Q_half = torque.step(0.025)
    np.testing.assert_allclose(half @ half, Phi, atol=1e-12)
    np.testing.assert_allclose(half @ Q_half @ half.T + Q_half, Q, atol=1e-10)


def test_a_long_chain_is_no_other_than_a_short_one() -> None:
    """Records do not speak to each other: twenty copies, over several blocks, give what one gives."""
    one, torque = chain(), Torque(0.4, 0.3, True)
    many = Chain(*(np.concatenate([v] * 20) for v in (one.A, one.gap, one.H, one.r, one.follows)), SPREAD, DT)
    assert many.log_likelihood(torque) == pytest.approx(20.0 * one.log_likelihood(torque), rel=1e-9)
    short: Smoothed = one.smooth(torque)
    np.testing.assert_allclose(many.smooth(torque).mean[-M:], short.mean, rtol=1e-7, atol=1e-8)


def test_a_thinned_chain_keeps_whole_stretches_of_all_of_the_log() -> None:
    one = chain()
    many = Chain(*(np.concatenate([v] * 100) for v in (one.A, one.gap, one.H, one.r, one.follows)), SPREAD, DT)
    part = many.thinned(1500)
    assert 1200 <= len(part.r) <= 1800
    assert many.thinned(len(many.r)) is many
    follows = np.flatnonzero(part.follows)
    where = {tuple(row): k for k, row in enumerate(one.gap)}
    places = np.array([where[tuple(row)] for row in part.gap])
    assert np.all(places[follows + 1] - places[follows] == 1)

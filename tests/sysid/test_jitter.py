"""Jitter of the stamps: found where it is, nowhere else, and no reason to believe a machine wrong."""

import math

import numpy as np
import pytest

from sysid import RK4, Coulomb, GeneralJoint, Model, Sensor, Viscous, fit, simulate
from sysid.data.jitter import speed_about
from sysid.data.noise import sensor_noise
from sysid.diagnosis.diagnose import diagnose
from sysid.planning.excitation import multisine

DT, N = 0.02, 400
FAST = GeneralJoint(J=0.002, G=0.0)


def spun(jitter, hidden=(), seed=0, step=0.0):
    """A light wheel under slow torques, which reaches tens of rad/s; its angle alone is read, rounded to steps."""
    rng = np.random.default_rng(seed)
    machine = Model(FAST, (Viscous(b=0.004), *hidden), RK4(substeps=4), dt=DT)
    u = np.stack([multisine(rng, N, DT, 0.25, 1.0) for _ in range(6)])
    records = Sensor(theta=0.003, jitter=jitter).measure(simulate(machine, u, np.zeros(6), np.zeros(6)), rng)
    if not step:
        return records
    return [r.__class__(r.t, r.u, step * np.round(r.theta / step), name=r.name) for r in records]


@pytest.mark.parametrize("jitter", [5e-4, 2e-3])
@pytest.mark.parametrize("step", [0.0, 0.01])
def test_jitter_is_found_within_a_fifth(jitter, step):
    noise = sensor_noise(spun(jitter, step=step))
    assert noise.sensor.jitter == pytest.approx(jitter, rel=0.2)
    assert any("the stamps jitter" in note for note in noise.notes)
    assert noise.sensor.theta < 3.0 * max(0.003, step / math.sqrt(12.0))


@pytest.mark.parametrize("step", [0.0, 0.01, 0.1])
@pytest.mark.parametrize("seed", range(3))
def test_exact_stamps_show_none(step, seed):
    assert sensor_noise(spun(0.0, (Coulomb(tau_c=0.02),), seed, step=step)).sensor.jitter == 0.0


def test_a_reading_errs_by_the_speed_times_the_jitter():
    (record, *_) = spun(0.0)
    exact, late = (Sensor(theta=0.003, jitter=j).readings(record)[1][:, 0] for j in (0.0, 0.002))
    assert np.all(exact == 0.003)
    np.testing.assert_allclose(late, np.hypot(0.003, 0.002 * speed_about(record.theta, DT)))
    truth = simulate(Model(FAST, dt=DT), np.zeros((1, N)), np.zeros(1), np.full(1, 30.0))
    read = Sensor(theta=0.003, jitter=0.002).measure(truth, np.random.default_rng(0))[0].theta
    assert np.std(read - truth.theta[0]) == pytest.approx(math.hypot(0.003, 0.06), rel=0.1)


def test_the_mean_speed_of_a_steady_turn_is_its_speed_also_at_the_ends():
    theta = 7.0 * DT * np.arange(100.0)
    np.testing.assert_allclose(speed_about(theta, DT), 7.0)


@pytest.mark.long
def test_numbers_are_recovered_within_their_errors():
    misses = []
    model = Model(FAST, (Viscous(b=0.004),), RK4(substeps=4), dt=DT)
    for seed in range(8):
        estimate = fit(model, spun(2e-3, seed=seed), parameters=("J", "viscous.b"))
        truth = {"J": 0.002, "viscous.b": 0.004}
        misses += [(estimate.values[k] - truth[k]) / estimate.sd[k] for k in truth]
    assert np.sqrt(np.mean(np.square(misses))) < 1.6


@pytest.mark.long
def test_friction_is_named_beside_jitter_and_nothing_else():
    records = spun(2e-3, (Coulomb(tau_c=0.02),))
    diagnosis = diagnose(Model(FAST, integrator=RK4(substeps=4), dt=DT), records)
    assert {step.effect for step in diagnosis.steps} == {"viscous", "coulomb"}
    assert diagnosis.estimate.values["coulomb.tau_c"] == pytest.approx(
        0.02, abs=4.0 * diagnosis.estimate.sd["coulomb.tau_c"]
    )
    assert diagnosis.verdict == "missing"

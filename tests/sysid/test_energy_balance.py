"""The energy balance of half swings tells frictions from each other, blind to what a random torque has to stand for."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from sysid import RK4, GeneralJoint, LinearAxis, Model, Record, Sensor, diagnose, effect, simulate
from sysid.diagnosis.criteria import matters, shows_in_balance
from sysid.diagnosis.search_settings import SearchSettings
from sysid.estimation.disturbances import Disturbances
from sysid.estimation.energy_balance import FEWEST, EnergyBalance, Path, half_swings
from sysid.estimation.first_fit import with_best_memory
from sysid.estimation.linearisation import Samples
from sysid.estimation.prediction_error import Fit
from sysid.estimation.refits import settled, with_energy_balance
from sysid.estimation.solver import Settings, fit_parameters
from tests.sysid.planted import with_memory

DT, SENSOR = 0.02, Sensor(theta=1e-3)
JOINT = Model(GeneralJoint(J=1.0, G=20.0), (), RK4(substeps=2), DT)
SIZES = {"coulomb": 0.05, "viscous": 0.03, "drag": 0.02}
NAMES = ("G", "coulomb.tau_c", "viscous.b")
QUIET = Settings(shared_error=False)


def damped(*frictions: str) -> Model:
    """The joint with some of the frictions."""
    model = JOINT
    for name in frictions:
        (field,) = effect(name).parameters
        model = model.with_effect(effect(name, **{field: SIZES[name]}))
    return model


def swings(model: Model, seeds: Sequence[int], torque: float = 0.0, scale: float = 0.0) -> list[Record]:
    """50 s of a free swing for each seed, beside which a random torque of rms `torque` [N m] may act (T = 0.3 s), and
    whose angles may be read from a scale that errs by `scale` [rad] five times a turn."""
    rngs, N = [np.random.default_rng(seed) for seed in seeds], 2500
    d = with_memory(torque * np.array([rng.standard_normal(N) for rng in rngs]), 0.3)
    run = simulate(model, d, math.pi + 0.9, 0.0)
    read = run.theta + scale * np.sin(5.0 * run.theta + 1.0)
    noise = [1e-3 * rng.standard_normal(N + 1) for rng in rngs]
    return [Record(run.t, np.zeros(N), theta + e) for theta, e in zip(read, noise, strict=True)]


def swing(model: Model, torque: float = 0.0, scale: float = 0.0) -> Record:
    """The first of `swings`."""
    return swings(model, [0], torque, scale)[0]


def fitted(record: Record) -> Fit:
    """Dry and viscous friction fitted beside a random torque, from numbers that are far too small."""
    start = damped("coulomb", "viscous").with_parameters({"coulomb.tau_c": 0.02, "viscous.b": 0.01})
    return with_best_memory(fit_parameters(Samples(start, [record], SENSOR), start, NAMES))


def balance_of(record: Record, model: Model = JOINT) -> EnergyBalance:
    balance = EnergyBalance.of(Samples(model, [record], SENSOR), model)
    assert balance is not None
    return balance


@pytest.mark.parametrize(
    "planted", [("coulomb",), ("viscous",), ("drag",), ("coulomb", "viscous"), ("coulomb", "drag"), ("viscous", "drag")]
)
@pytest.mark.parametrize("scale", [0.0, 0.01])
def test_the_frictions_of_a_free_swing_are_told_from_each_other(planted: tuple[str, ...], scale: float) -> None:
    """They are, whatever the scale's error, which does no work over whole swings."""
    frictions = balance_of(swing(damped(*planted), scale=scale)).frictions
    assert {e.name for e in frictions} == set(planted)
    for friction in frictions:
        (size,) = friction.parameters.values()
        assert float(size.value) == pytest.approx(SIZES[friction.name], rel=0.2 if scale else 0.05)


def test_a_right_model_takes_what_is_lost() -> None:
    """Whitened errors have a mean square of 1 at the truth, and with another form of it; poorer models have more."""
    balance = balance_of(swing(damped("coulomb", "viscous")))
    right, *wrong = (
        balance.errors(damped(*names)) for names in (("coulomb", "viscous"), ("coulomb",), ("viscous",), ())
    )
    assert np.mean(right**2) == pytest.approx(1.0, abs=0.3)
    assert all(np.mean(errors**2) > 100.0 for errors in wrong)
    refined = damped("viscous").with_effect(effect("stribeck", tau_c=0.05, excess=0.0))
    presliding = damped("viscous").with_effect(effect("dahl", tau_c=0.05, z_s=1e-3))
    np.testing.assert_allclose(balance.errors(refined), right, atol=1e-9)
    assert np.mean(balance.errors(presliding) ** 2) < 2.0


def test_the_rows_are_the_slopes_of_the_errors() -> None:
    balance, model = balance_of(swing(damped("coulomb", "viscous"))), damped("coulomb", "viscous")
    Z, e = balance.rows(model, NAMES)
    scale = math.sqrt(max(1.0, float(np.mean(balance.errors(model) ** 2))))
    np.testing.assert_allclose(e * scale, balance.errors(model))
    for column, name in zip(Z.T, NAMES, strict=True):
        value = float(model.parameters[name].value)
        up, down = (balance.errors(model.with_parameters({name: value * (1.0 + h)})) for h in (1e-3, -1e-3))
        np.testing.assert_allclose(column * scale, (down - up) / (2e-3 * value), rtol=1e-3, atol=1e-6)


def test_it_does_not_know_how_large_all_torques_are() -> None:
    """A swing shows torques per inertia: with all of them doubled a model takes the same share of what is lost."""
    balance, model = balance_of(swing(damped("coulomb", "viscous"))), damped("coulomb", "viscous")
    double = model.with_parameters({n: 2.0 * float(model.parameters[n].value) for n in ("J", *NAMES)})
    np.testing.assert_allclose(balance.errors(double), balance.errors(model), atol=1e-6)


def test_the_zero_of_the_angle_does_not_matter() -> None:
    record, model = swing(damped("coulomb", "viscous")), damped("coulomb", "viscous")
    off = replace(record, theta=record.theta + 0.01)  # type: ignore[operator]
    sizes = [
        {e.name: float(p.value) for e in balance_of(r).frictions for p in e.parameters.values()} for r in (record, off)
    ]
    assert sizes[1] == pytest.approx(sizes[0], rel=0.01)
    errors = balance_of(off).errors(model.with_effect(effect("angle_offset", offset=0.01)))
    assert np.mean(errors**2) == pytest.approx(1.0, abs=0.3)


def test_a_half_swing_in_which_time_is_lost_does_not_count() -> None:
    """A quarter of a second is missing in the middle: one half swing errs by far more than the others."""
    whole = swing(damped("coulomb", "viscous"))
    kept = np.delete(np.arange(len(whole.t)), np.arange(1000, 1012))
    torn = Record(whole.t[: len(kept)], whole.u[: len(kept) - 1], whole.theta[kept])  # type: ignore[index]
    balance = balance_of(torn)
    assert 1 <= np.sum(~balance.counts) <= 3
    assert {e.name for e in balance.frictions} == {"coulomb", "viscous"}


def test_only_free_swings_with_enough_half_swings_have_one() -> None:
    model, record = damped("viscous"), swing(damped("viscous"))
    (few,) = [record.part(0, round(0.5 * FEWEST * math.pi / math.sqrt(20.0) / DT))]
    driven = replace(record, u=record.u + 0.1 * np.sin(record.t[:-1]))
    axis = Model(LinearAxis(m=1.0), (), RK4(substeps=2), DT)
    speeds = replace(record, theta=None, theta_dot=np.gradient(record.theta, DT))
    for machine, one, sensor in (
        (model, few, SENSOR),
        (model, driven, SENSOR),
        (model, speeds, Sensor(theta_dot=0.05)),
        (axis, record, SENSOR),
    ):
        assert EnergyBalance.of(Samples(machine, [one], sensor), machine) is None


def test_half_swings_go_from_turning_point_to_turning_point() -> None:
    """Without friction each takes half a period, and the work from one end to the other is none, but for two readings'
    errors of 1 mrad."""
    samples = Samples(JOINT, [swing(JOINT)], SENSOR)
    swings = half_swings(samples)
    half_period = math.pi / math.sqrt(20.0) * (1.0 + 0.9**2 / 16.0 + 11.0 * 0.9**4 / 3072.0)
    assert np.mean([half.t[-1] - half.t[0] for half in swings]) == pytest.approx(half_period, rel=1e-3)
    loss = Path(samples, swings).work(JOINT, 0.0).loss
    assert math.sqrt(float(np.mean(loss**2))) < math.sqrt(2.0) * 1e-3


def test_beside_a_scale_that_errs_it_tells_friction_where_the_readings_do_not() -> None:
    """The random torque that stands for the scale hides both frictions: their intervals reach from 0 to twice their
    sizes. With the balance, each is sure and right within a tenth."""
    fit = fitted(swing(damped("coulomb", "viscous"), scale=0.012))
    beside = with_energy_balance(fit)
    for one, share in ((fit, 0.9), (beside, 0.1)):
        sd = np.sqrt(np.diag(one.covariance))[1:]
        assert np.all((sd > share * np.array([0.05, 0.03])) == (one is fit))
    assert beside.values[1:] == pytest.approx([0.05, 0.03], rel=0.1)
    plain = fit_parameters(fit.samples, damped("viscous"), ("G", "viscous.b"), beside)
    settings = SearchSettings()
    assert shows_in_balance(plain.model, beside, settings) and matters(plain.model, beside, settings)
    assert not shows_in_balance(beside.model, beside, settings)
    assert settled(beside).balance is beside.balance


@pytest.mark.long
def test_beside_a_torque_that_acts_at_random_the_intervals_cover() -> None:
    """The same readings are read twice then, and intervals are as wide as that allows: of 40 logs 95 % of the 95 %
    intervals cover, 34 or more but for one set of logs in 300."""
    truth = np.array([20.0, 0.05, 0.03])
    model = damped("coulomb", "viscous")
    logs = [Samples(model, [log], SENSOR) for log in swings(model, range(40), torque=0.1)]
    fits = [
        fit_parameters(samples, model, NAMES, disturbances=Disturbances(1.0, 0.3), settings=QUIET) for samples in logs
    ]
    balanced = [with_energy_balance(fit) for fit in fits]
    z = np.array([(fit.values - truth) / np.sqrt(np.diag(fit.covariance)) for fit in balanced])
    assert all(fit.balance is not None for fit in balanced)
    assert np.all(np.sum(np.abs(z) < 1.96, axis=0) >= 34), z
    assert np.all(np.mean(z**2, axis=0) > 0.4)


@pytest.mark.long
def test_a_diagnosis_names_both_frictions_beside_a_scale_that_errs() -> None:
    names = ("coulomb", "viscous", "drag", "torque_bias", "tilt")
    diagnosis = diagnose(JOINT, [swing(damped("coulomb", "viscous"), scale=0.012)], SENSOR, effects=names)
    assert {step.effect for step in diagnosis.steps} == {"coulomb", "viscous"}
    assert diagnosis.error.ratio < diagnosis.base_error.ratio

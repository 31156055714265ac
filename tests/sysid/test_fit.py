"""fit: from a log to a model with honest numbers, in one call."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from sysid import (
    RK4,
    Backlash,
    Coulomb,
    Delay,
    Effect,
    GeneralJoint,
    LinearAxis,
    Model,
    Plant,
    PointMassPendulum,
    PositionServo,
    Record,
    RodPendulum,
    Saturation,
    Sensor,
    SensorDelay,
    Viscous,
    fit,
    simulate,
)
from sysid.estimation.fit import free, without_scale
from sysid.physics.simulate import Trajectory
from sysid.planning.excitation import multisine, steps
from tests.sysid.planted import DT, SENSOR, assert_found, without_noise


def rod(*effects: Effect, m: float = 1.0, l: float = 0.9) -> Model:  # noqa: E741
    return Model(RodPendulum(m=m, l=l), effects, dt=DT)


def run(model: Model, seed: int = 0, n: int = 3, seconds: float = 4.0) -> Trajectory:
    rng = np.random.default_rng(seed)
    u = np.array([steps(rng, round(seconds / model.dt), model.dt, 1.5, 0.3) for _ in range(n)])
    return simulate(model, u, math.pi + rng.uniform(-0.8, 0.8, n), np.zeros(n))


def logs(model: Model, seed: int = 0, sensor: Sensor = SENSOR) -> list[Record]:
    return sensor.measure(run(model, seed), np.random.default_rng(seed))


def exact(model: Model) -> list[Record]:
    return without_noise(run(model))


@pytest.fixture(scope="module")
def clean() -> list[Record]:
    return logs(rod())


PLANTS = {
    "rod": (RodPendulum(m=1.3, l=0.9), RodPendulum()),
    "point": (PointMassPendulum(m=0.7, l=0.6), PointMassPendulum(m=1.0, l=1.0)),
    "joint": (GeneralJoint(J=0.3, G=2.1), GeneralJoint(J=0.5, G=1.0)),
    "axis": (LinearAxis(m=0.4), LinearAxis(m=1.0)),
}


@pytest.mark.parametrize(("truth", "begin"), PLANTS.values(), ids=PLANTS.keys())
def test_every_plant_is_found_without_being_told_the_noise(truth: Plant, begin: Plant) -> None:
    truth_model = Model(truth, (Viscous(b=0.05),), dt=DT)
    records = logs(truth_model)
    estimate = fit(Model(begin, (Viscous(),), dt=DT), records)
    assert estimate.names == tuple(n for n in truth_model.parameters if n != "g")
    assert_found(estimate, truth_model)
    assert estimate.sensor is not None
    assert estimate.sensor.theta == pytest.approx(SENSOR.theta, rel=0.1)
    assert estimate.sensor.theta_dot == pytest.approx(SENSOR.theta_dot, rel=0.1)
    assert estimate.noise["theta"] == pytest.approx(SENSOR.theta, rel=0.1)
    assert estimate.noise["theta_dot"] == pytest.approx(SENSOR.theta_dot, rel=0.1)


def test_what_is_fixed_keeps_its_number(clean: list[Record]) -> None:
    estimate = fit(rod(m=1.05), clean, SENSOR, ("l",))
    assert estimate.names == ("l",)
    assert estimate.model.parameters["m"].value == 1.05
    both, one = fit(rod(), clean, SENSOR), fit(rod(), clean, SENSOR, ("m",))
    assert one.sd["m"] <= both.sd["m"]


def test_a_free_swing_fits_what_it_shows(clean: list[Record]) -> None:
    swing = [replace(record, u=0.0 * record.u) for record in clean]
    assert free(rod(Viscous()), clean) == free(rod(Viscous()), [*swing, *clean]) == ("m", "l", "viscous.b")
    assert free(rod(Viscous()), swing) == ("l", "viscous.b")
    weighed, all_of_it = Model(GeneralJoint(G=4.9), dt=clean[0].dt), ("J", "G")
    assert without_scale(weighed, all_of_it, swing) == ("G",) and without_scale(weighed, ("J",), swing) == ("J",)
    assert without_scale(Model(GeneralJoint(G=0.0)), ("J",), swing) == (), "without a weight nothing tells J"
    servo = Model(GeneralJoint(), (PositionServo(),))
    assert "J" in free(servo, swing), "a servo that is told to stay at 0 holds the joint there"


def test_gravity_is_known_unless_it_is_named(clean: list[Record]) -> None:
    assert free(rod(Viscous())) == ("m", "l", "viscous.b")
    estimate = fit(rod(), clean, SENSOR, ("m", "g"))
    assert estimate.values["g"] == pytest.approx(10.0, abs=5.0 * estimate.sd["g"])


def test_a_fitted_model_is_a_model(clean: list[Record]) -> None:
    estimate = fit(rod(m=1.2), clean, SENSOR)
    again = simulate(estimate.model, clean[0].u, clean[0].theta[0], clean[0].theta_dot[0])  # type: ignore[index]
    assert np.sqrt(np.mean((again.theta - clean[0].theta) ** 2)) < 0.05
    assert fit(estimate.model, clean, SENSOR).values == pytest.approx(estimate.values, rel=1e-3)
    json.dumps(estimate.to_dict(), allow_nan=False)
    assert "m" in str(estimate)


@pytest.mark.parametrize("effect", [Saturation(limit=0.9), Delay(T=0.03), Coulomb(tau_c=0.05)], ids=lambda e: e.name)
def test_an_effect_begins_at_neutral_and_is_found(effect: Effect) -> None:
    """Also a limit that begins at "never", where nothing has a slope."""
    truth = rod(effect)
    estimate = fit(rod(effect.at_neutral()), logs(truth), SENSOR)
    assert_found(estimate, truth)


@pytest.mark.long
@pytest.mark.parametrize(
    ("effects", "sensor"),
    [
        *(((*e,), s) for e in ((), (Coulomb(tau_c=0.05),), (Delay(T=0.03),)) for s in (None, SENSOR)),
        ((SensorDelay(T=0.03), Backlash(width=0.02)), SENSOR),
    ],
)
def test_a_log_without_noise_gives_the_exact_numbers(effects: tuple[Effect, ...], sensor: Sensor | None) -> None:
    truth = rod(*effects)
    estimate = fit(rod(*(e.at_neutral() for e in effects), m=1.1), exact(truth), sensor)
    for name in estimate.names:
        assert estimate.values[name] == pytest.approx(truth.parameters[name].value, rel=1e-3)
    assert "lacks" not in estimate.status


def test_an_error_of_the_angle_alone_is_no_random_torque(clean: list[Record]) -> None:
    """Neighbouring readings of the angle share an error of 0.01 rad that is forgotten in 0.05 s."""
    rng, kept = np.random.default_rng(0), math.exp(-DT / 0.05)
    shared = []
    for record in clean:
        error = lfilter([1.0], [1.0, -kept], 0.01 * math.sqrt(1.0 - kept**2) * rng.standard_normal(len(record.t)))
        assert record.theta is not None
        shared.append(replace(record, theta=record.theta + error))
    estimate = fit(rod(), shared, SENSOR)
    assert estimate.random_torque == 0.0
    assert "lacks" not in estimate.status
    assert "neighbouring readings of the angle share an error" in estimate.status


def test_a_model_that_lacks_something_says_so_and_how_much(clean: list[Record]) -> None:
    """What it lacks is a random torque of that size, and intervals are wider by it."""
    estimate = fit(rod(), logs(rod(Viscous(b=0.3))), SENSOR)
    lacking = 0.3 * float(np.sqrt(np.mean(run(rod(Viscous(b=0.3))).theta_dot ** 2)))
    assert 0.3 * lacking < estimate.random_torque < 3.0 * lacking
    assert "the model lacks something" in estimate.status
    assert "a random torque of" in str(estimate)
    right = fit(rod(), clean, SENSOR)
    assert right.random_torque == 0.0 and "lacks" not in right.status
    assert estimate.sd["m"] > 3.0 * right.sd["m"]


def test_the_same_numbers_again_and_inputs_untouched(clean: list[Record]) -> None:
    before = [(r.u.copy(), r.theta.copy(), r.theta_dot.copy()) for r in clean]  # type: ignore[union-attr]
    model = rod(m=1.1)
    one, other = fit(model, clean), fit(model, list(clean))
    assert one.values == other.values
    np.testing.assert_array_equal(one.covariance, other.covariance)
    assert model.parameters["m"].value == 1.1
    for record, kept in zip(clean, before, strict=True):
        for now, then in zip((record.u, record.theta, record.theta_dot), kept, strict=True):
            np.testing.assert_array_equal(now, then)


def test_the_order_of_rollouts_and_names_is_no_matter(clean: list[Record]) -> None:
    one, other = fit(rod(m=1.1), clean, SENSOR), fit(rod(m=1.1), clean[::-1], SENSOR, ("l", "m"))
    for name in ("m", "l"):
        assert other.values[name] == pytest.approx(one.values[name], abs=1e-3 * one.sd[name])
        assert other.sd[name] == pytest.approx(one.sd[name], rel=1e-6)


@pytest.mark.parametrize("dt", [0.005, 0.001])
def test_speeds_alone_are_enough_at_any_rate(dt: float) -> None:
    truth = Model(RodPendulum(m=1.0, l=0.9), (Coulomb(tau_c=0.1),), dt=dt)
    rng, sensor = np.random.default_rng(0), Sensor(None, 0.05)
    u = steps(rng, round(6.0 / dt), dt, 1.5, 0.3)
    records = sensor.measure(simulate(truth, u, math.pi + 0.3, 0.0), rng)
    estimate = fit(Model(RodPendulum(), (Coulomb(),), dt=dt), records, sensor)
    assert_found(estimate, truth)


@pytest.mark.parametrize("n", [1, 2, 5])
def test_a_log_of_few_samples_is_fitted_without_a_claim(n: int, clean: list[Record]) -> None:
    estimate = fit(rod(), [clean[0].head(n)], SENSOR)
    assert np.all(np.isfinite(list(estimate.values.values())))
    assert estimate.ambiguous


@pytest.mark.parametrize("unit", [1.0, 1024.0, 1.0 / 1024.0])
def test_the_unit_of_an_axis_does_not_matter(unit: float) -> None:
    """A fit from far off, in metres or otherwise, ends at the same machine."""
    truth = Model(LinearAxis(m=0.4), (Viscous(b=0.5), Coulomb(tau_c=0.05)), dt=DT)
    records = [
        replace(r, theta=unit * np.asarray(r.theta), theta_dot=unit * np.asarray(r.theta_dot)) for r in logs(truth)
    ]
    bounds = {"m": (1e-6, 1e6)}
    estimate = fit(Model(LinearAxis(m=1.0 / unit, bounds=bounds), (Viscous(), Coulomb()), dt=DT), records)
    assert estimate.success
    for name, value in {"m": 0.4 / unit, "viscous.b": 0.5 / unit, "coulomb.tau_c": 0.05}.items():
        assert abs(estimate.values[name] - value) < 4.0 * estimate.sd[name] < 0.1 * value, name


@pytest.mark.parametrize("gravity", [0.0, 2.0])
def test_a_fit_that_begins_without_gravity_finds_what_there_is(gravity: float) -> None:
    """A number of the plant that begins at its bound, at 0, neither stays there nor holds the others back."""
    rng = np.random.default_rng(0)
    machine = Model(GeneralJoint(J=0.05, G=gravity), (Viscous(b=0.05),), RK4(substeps=2), dt=0.02)
    u = np.stack([multisine(rng, 300, 0.02, 2.0, 3.0) for _ in range(3)])
    records = Sensor(theta=0.003).measure(simulate(machine, u, np.full(3, math.pi), np.zeros(3)), rng)
    begun = Model(GeneralJoint(J=0.1, G=0.0), (Viscous(b=0.0),), RK4(substeps=2), dt=0.02)
    estimate = fit(begun, records, parameters=("J", "G", "viscous.b"))
    assert estimate.success
    for name, truth in {"J": 0.05, "G": gravity, "viscous.b": 0.05}.items():
        assert abs(estimate.values[name] - truth) < 4.0 * estimate.sd[name]

"""compare says where a model fails, and says nothing of a model that does not."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from sysid import (
    Coulomb,
    Delay,
    Drag,
    Drift,
    Effect,
    InvalidInput,
    Lag,
    Model,
    PointMassPendulum,
    Record,
    Ripple,
    RodPendulum,
    Saturation,
    Sensor,
    SensorDelay,
    Stamp,
    Tilt,
    TorqueBias,
    TorqueGain,
    VelocityBias,
    VelocityGain,
    Viscous,
    simulate,
)
from sysid.comparison.compare import Comparison, compare
from sysid.comparison.held_out import refit_windows
from sysid.comparison.whiteness import innovations
from sysid.excitation import multisine, steps
from sysid.windows import cut

BOTH = Sensor(0.003, 0.05)
ROD = Model(RodPendulum(m=1.0, l=0.9), dt=0.02)


def logs(
    model: Model, seed: int = 0, n: int = 4, sensor: Sensor = BOTH, signal: str = "steps", T: float = 6.0
) -> list[Record]:
    """n rollouts, begun near hanging."""
    rng = np.random.default_rng(seed)
    N = round(T / model.dt)
    shapes = {
        "steps": lambda: steps(rng, N, model.dt, 1.5, 0.3),
        "multisine": lambda: multisine(rng, N, model.dt, 1.5, 2.5),
    }
    u = np.array([shapes[signal]() for _ in range(n)])
    return simulate(model, u, math.pi + rng.uniform(-0.8, 0.8, n), np.zeros(n)).measure(sensor, rng)


def comparison(*effects: Effect, signal: str = "steps", seed: int = 0) -> Comparison:
    """ROD against logs of ROD with effects."""
    model = ROD
    for effect in effects:
        model = model.with_effect(effect)
    return compare(ROD, logs(model, signal=signal, seed=seed), BOTH)


@pytest.fixture(scope="module")
def perfect() -> list[Comparison]:
    """The true model against 40 logs."""
    return [compare(ROD, logs(ROD, seed, n=2, T=4.0), BOTH) for seed in range(40)]


def test_a_perfect_model_is_called_so(perfect: list[Comparison]) -> None:
    """1 in 100 for each of whiteness and past torque together, of causes, and of the error."""
    assert sum(c.adequate for c in perfect) >= 36
    assert sum(bool(c.causes) for c in perfect) <= 2
    assert all("nothing is missing" in c.sentence for c in perfect if c.adequate)


def test_p_values_of_a_perfect_model_are_uniform(perfect: list[Comparison]) -> None:
    """Below 0.1 in 4 of 40 +- 3 sd, and below 0.5 in 20 of 40 +- 3 sd."""
    p = {name: [c.curves[name].p_value for c in perfect] for name in perfect[0].curves}
    p |= {f"white {name}": [c.whiteness[name].p_value for c in perfect] for name in perfect[0].whiteness}
    p["past torque"] = [c.past.p_value for c in perfect]
    for name, values in p.items():
        assert np.sum(np.array(values) < 0.1) <= 10, name
        assert 10 <= np.sum(np.array(values) < 0.5) <= 30, name


def test_ratios_of_a_perfect_model_are_one_at_every_horizon(perfect: list[Comparison]) -> None:
    for name in perfect[0].errors:
        ratio = np.array([c.errors[name].ratio for c in perfect])
        assert abs(np.mean(ratio) - 1.0) < 4.0 * np.std(ratio) / math.sqrt(len(ratio)), name
        assert np.std(ratio) < 0.05, name


def test_the_bands_of_a_perfect_model_hold(perfect: list[Comparison]) -> None:
    """99 % of the autocorrelations, of the curves' knots; the map is flat."""
    outside = [np.mean(np.abs(w.correlation) > w.band) for c in perfect for w in c.whiteness.values()]
    assert np.mean(outside) < 0.02
    beyond = np.concatenate([np.abs(k.torque) > 2.5758 * k.sd for c in perfect for k in c.curves.values()])
    assert np.mean(beyond) < 0.02
    assert np.mean([np.any(c.map.significant) for c in perfect]) < 0.1


@pytest.mark.parametrize("signal", ["steps", "multisine"])
@pytest.mark.parametrize("lag", [1, 2, 4])
def test_a_delay_shows_at_its_lag(lag: int, signal: str) -> None:
    c = comparison(Delay(T=lag * ROD.dt, longest=0.1), signal=signal)
    assert [cause.on for cause in c.causes] == ["history"]
    assert f"follows the torque of {lag} sample" in c.sentence
    assert not c.past.independent and not c.adequate


def test_a_stamp_of_the_next_row_is_told_from_a_delay() -> None:
    assert "how the log stamps its rows" in comparison(Stamp(s=-1.0)).sentence


@pytest.mark.parametrize(
    ("effect", "on", "words"),
    [
        (Viscous(b=0.05), "theta_dot", "against the motion is missing, which grows with |theta_dot|"),
        (Coulomb(tau_c=0.08), "theta_dot", "alike at all speeds"),
        (Drag(c=0.03), "theta_dot", "grows with theta_dot^2"),
        (Tilt(alpha=0.05), "theta", "depends on the angle"),
        (Ripple(a=0.15, b=0.1, order=5.0), "theta", "depends on the angle"),
        (Saturation(limit=1.0), "torque", "depends on the commanded torque"),
        (Lag(T=0.04), "history", "a delay or a lag"),
        (SensorDelay(T=0.04), "history", "torque or readings"),
        (Drift(r=0.1), "time", "comes and goes with time"),
        (TorqueBias(tau_0=0.1), "constant", "a constant torque of +0."),
        (TorqueGain(c=0.85), "plant", "the torque 8"),
        (VelocityBias(bias=0.1), "readings", "offset by +0."),
        (VelocityGain(c=1.05), "readings", "% off"),
    ],
    ids=lambda value: getattr(value, "name", ""),
)
def test_the_quantity_that_the_error_depends_on_is_named(effect: Effect, on: str, words: str) -> None:
    c = comparison(effect)
    assert c.causes[0].on == on
    assert c.causes[0].share > 0.9
    assert words in c.sentence
    assert c.off


def test_two_effects_at_once() -> None:
    c = comparison(Delay(T=0.04), Viscous(b=0.1))
    assert {cause.on for cause in c.causes} == {"history", "theta_dot"}
    assert sum(cause.share for cause in c.causes) > 0.9


def test_numbers_of_the_plant_that_are_off() -> None:
    heavy = Model(RodPendulum(m=1.05, l=0.945), dt=ROD.dt)
    c = compare(ROD, logs(heavy), BOTH)
    assert [cause.on for cause in c.causes] == ["plant"]
    inertia, gravity = (float(part.split("%")[0].split()[-1]) for part in c.causes[0].words.split("is ")[1:])
    assert inertia == pytest.approx(15.8, abs=2.0)  # 1.05^3
    assert gravity == pytest.approx(10.3, abs=2.0)  # 1.05^2


@pytest.mark.parametrize("seed", range(3))
def test_the_curves_are_the_missing_torque(seed: int) -> None:
    b = 0.05
    c = comparison(Viscous(b=b), seed=seed)
    curve = c.curves["theta_dot"]
    z = (curve.torque + b * curve.at) / curve.sd
    assert np.mean(z**2) < 2.5
    assert np.ptp(curve.torque) > 20.0 * np.median(curve.sd)
    found, middle = c.map, 0.5 * (c.map.theta_dot[1:] + c.map.theta_dot[:-1])
    error = (found.torque + b * middle)[found.significant]
    assert np.sum(found.significant) > 10
    assert np.sqrt(np.mean(error**2)) < 0.3 * b * np.max(np.abs(middle))


def test_a_gust_is_found_in_its_rollout() -> None:
    records = logs(ROD)
    push = np.zeros(len(records[2]))
    push[25:50], push[150:175] = 0.4, 0.6
    moved = simulate(ROD, records[2].u + push, records[2].theta[0], 0.0).measure(BOTH, np.random.default_rng(1))[0]
    records[2] = Record(moved.t, records[2].u, moved.theta, moved.theta_dot, name="gusty")
    c = compare(ROD, records, BOTH)
    assert c.causes[0].on == "time" and "gusty at 3." in c.sentence
    assert c.worst[0].error.record == "gusty"
    curve = c.curves["time"]
    assert curve.record[curve.strongest] == "gusty"


def test_the_worst_windows_hold_readings_and_model() -> None:
    records = logs(ROD.with_effect(Tilt(alpha=0.05)))
    worst = compare(ROD, records, BOTH).worst
    assert len(worst) == 3
    for trace in worst:
        record = next(r for r in records if r.name == trace.error.record)
        at = np.searchsorted(record.t, trace.t - 1e-9)
        np.testing.assert_allclose(trace.readings["theta"], record.theta[at], rtol=1e-12)
        e = (trace.readings["theta_dot"] - trace.model["theta_dot"]) / BOTH.theta_dot
        e = np.concatenate([e, (trace.readings["theta"] - trace.model["theta"]) / BOTH.theta])
        assert math.sqrt(np.sum(e**2) / (len(e) - 2)) == pytest.approx(trace.error.ratio, rel=1e-6)


@pytest.mark.parametrize("sensor", [BOTH, Sensor(0.003), Sensor(None, 0.05)])
def test_innovations_are_the_least_squares_residuals_in_another_basis(sensor: Sensor) -> None:
    """As many as readings less states, and their squares add up to the same (Brown, Durbin and Evans)."""
    records = logs(ROD, sensor=sensor)
    fit = refit_windows(ROD, records, sensor, cut(records, 1.0))
    w = innovations(fit)
    assert np.isfinite(w).sum() == fit.response.n_readings.sum() - 2 * len(fit.starts)
    np.testing.assert_allclose(np.nansum(w**2, axis=1), np.sum(fit.lin.e**2, axis=1), rtol=1e-3)


def test_a_rerun_gives_the_same_numbers() -> None:
    first, second = (comparison(Viscous(b=0.05)).to_dict() for _ in range(2))
    assert json.dumps(first, allow_nan=False) == json.dumps(second, allow_nan=False)


def test_it_prints_every_horizon() -> None:
    c = comparison(Viscous(b=0.05))
    for words in (*c.errors, "theta_dot [rad/s]", "worst windows", c.sentence):
        assert words in str(c)


@pytest.mark.parametrize("sensor", [Sensor(0.003), Sensor(None, 0.05)])
def test_one_channel_is_enough(sensor: Sensor) -> None:
    c = compare(ROD, logs(ROD.with_effect(Viscous(b=0.05)), sensor=sensor), sensor)
    assert c.causes[0].on == "theta_dot"
    assert len(c.whiteness) == len(c.one_second.ratios) == 1


def test_the_noise_is_found_where_it_is_not_given() -> None:
    c = compare(ROD, logs(ROD))
    assert c.sensor.theta == pytest.approx(BOTH.theta, rel=0.1)
    assert c.ratio == pytest.approx(1.0, abs=0.1)


def test_a_free_swing_and_one_short_rollout() -> None:
    """No torque to depend on; fewer readings than one window."""
    swing = simulate(ROD.with_effect(Viscous(b=0.1)), np.zeros(200), 2.0, 0.0).measure(BOTH, np.random.default_rng(0))
    c = compare(ROD, swing, BOTH)
    assert c.causes[0].on == "theta_dot" and "torque" not in c.curves
    short = compare(ROD, logs(ROD, n=1, T=0.4), BOTH)
    assert short.one_second.n_windows == 1
    json.dumps(short.to_dict(), allow_nan=False)


def test_a_model_that_runs_away_is_said() -> None:
    c = compare(ROD.with_effect(Drag(c=500.0, bounds={"c": (0.0, 1e4)})), logs(ROD), BOTH)
    assert "runs away" in c.sentence
    json.dumps(c.to_dict(), allow_nan=False)
    assert "inf" in str(c)


def test_other_plants_and_rates() -> None:
    point = Model(PointMassPendulum(m=0.7, l=0.5), dt=0.05)
    assert compare(point, logs(point), BOTH).adequate
    assert compare(point, logs(point.with_effect(Coulomb(tau_c=0.05))), BOTH).causes[0].on == "theta_dot"


def test_records_that_do_not_fit_are_said() -> None:
    with pytest.raises(InvalidInput, match="steps every"):
        compare(Model(RodPendulum(), dt=0.05), logs(ROD), BOTH)


def test_a_window_that_is_like_no_other_is_set_apart() -> None:
    """A hand that pushes once; beyond it the friction that is missing is still seen."""
    slow = ROD.with_effect(Viscous(b=0.03))
    records = logs(slow)
    push = np.zeros(len(records[2]))
    push[155:165] = 15.0
    moved = simulate(slow, records[2].u + push, records[2].theta[0], 0.0).measure(BOTH, np.random.default_rng(1))[0]
    records[2] = Record(moved.t, records[2].u, moved.theta, moved.theta_dot, name="pushed")
    c = compare(ROD, records, BOTH)
    assert c.apart is c.worst[0].error and c.apart.record == "pushed" and c.apart.begin == 3.0
    assert "without pushed at 3.0-4.0 s" in c.sentence
    assert [cause.on for cause in c.causes] == ["theta_dot"]

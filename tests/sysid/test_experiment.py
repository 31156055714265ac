"""The next experiment keeps its promises: rivals come apart, intervals shrink, limits hold, and a rig can play it."""

from __future__ import annotations

import csv
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sysid import (
    BackEmf,
    Coulomb,
    Delay,
    GeneralJoint,
    InvalidInput,
    Lag,
    LinearAxis,
    Model,
    Record,
    RodPendulum,
    Sensor,
    Stribeck,
    TorqueGain,
    Viscous,
    simulate,
)
from sysid.estimation import prediction_error, solver
from sysid.estimation.disturbances import Disturbances
from sysid.estimation.fit import fit
from sysid.estimation.linearisation import Samples
from sysid.estimation.refits import extended
from sysid.estimation.scores import scores
from sysid.physics.effects import CATALOGUE, Effect
from sysid.planning.design import KNOWN, NO_DISTURBANCE, Conditions, Hypothesis, Pool
from sysid.planning.excitation import KINDS, Limits, Signal, random_signals
from sysid.planning.next_experiment import limits_of, next_experiment
from sysid.planning.non_torque_experiments import non_torque_experiment, payload
from sysid.planning.planned_experiment import Experiment

SENSOR = Sensor(0.003, 0.05)
LIMITS = Limits(2.0, theta_max=2.0)
CONDITIONS = Conditions(LIMITS, SENSOR)
NAMES = ("m", "l")


def rod() -> Model:
    return Model(RodPendulum(m=1.0, l=0.9, g=9.81), dt=0.02)


def log(model: Model, *commands: np.ndarray, seed: int = 1) -> list[Record]:
    """Rollouts from rest, with noise."""
    return SENSOR.measure(simulate(model, np.array(commands), math.pi, 0.0), np.random.default_rng(seed))


def time(seconds: float = 8.0) -> np.ndarray:
    return 0.02 * np.arange(round(seconds / 0.02))


def in_phase() -> np.ndarray:
    """A weak bang-bang at the pendulum's own frequency: its torque is in phase with the speed, of one amplitude."""
    return 0.12 * np.sign(np.sin(2.0 * math.pi * 0.62 * time(4.0)))


def slow_sines() -> np.ndarray:
    return 0.8 * np.sin(2.0 * math.pi * 0.2 * time())


def played(e: Experiment, truth: Model, seed: int) -> list[Record]:
    """What a rig would log."""
    return SENSOR.measure(simulate(truth, e.u, e.start, 0.0), np.random.default_rng(seed))


def predict(model: Model, signals: list[Signal], conditions: Conditions) -> list[Record]:
    """The records that perfect sensors would make of a model under the signals."""
    return Pool([Hypothesis("", model, ())], signals, conditions).shown("")


def output_error(records: list[Record]) -> prediction_error.Fit:
    """The bare rod, fitted as if nothing acted beside it."""
    return solver.fit_parameters(Samples(rod(), records, SENSOR), rod(), NAMES, None, NO_DISTURBANCE, KNOWN)


CONFUSED = {
    "viscous or Coulomb, the torque in phase with the speed": (Coulomb(tau_c=0.006), "viscous", in_phase()),
    "Coulomb or viscous, the torque in phase with the speed": (Viscous(b=0.008), "coulomb", in_phase()),
    "delay or lag, slow sines": (Delay(T=0.02), "lag", slow_sines()),
    "lag or delay, slow sines": (Lag(T=0.02), "delay", slow_sines()),
}


@pytest.mark.long
@pytest.mark.parametrize(("effect", "rival", "u"), CONFUSED.values(), ids=CONFUSED.keys())
def test_what_a_poor_log_confuses_comes_apart_with_the_evidence_promised(
    effect: Effect, rival: str, u: np.ndarray
) -> None:
    truth = rod().with_effect(effect)
    poor = log(truth, u)
    sized = next_experiment(rod(), (effect, rival), LIMITS, SENSOR)
    e = next_experiment(rod(), (effect.name, rival), LIMITS, SENSOR, poor)
    assert e.before < 16.0, "the log is not poor"
    assert e.after > max(16.0, 3.0 * e.before)
    promised = next(c.after for c in sized.pairs if c.truth == effect.name)
    for answer, most in ((sized, promised), (e, None)):
        evidence = []
        for seed in range(4):
            base = output_error(played(answer, truth, 100 + seed))
            tested = scores(base, (effect.name, rival))
            left = {name: extended(base, [s.best.at(s.sizes)], KNOWN).e for name, s in tested.items()}
            evidence.append(left[rival] @ left[rival] - left[effect.name] @ left[effect.name])
        assert min(evidence) > 9.0, "another effect is named first"
        if most is not None:  # a non-central chi-square: mean = the promise, variance 4 times that
            assert abs(np.mean(evidence) - most) < 3.0 * 2.0 * math.sqrt(most / len(evidence)) + 0.15 * most


@pytest.mark.parametrize("theta_max", [0.3, 2.0])
def test_the_widest_interval_shrinks_as_promised(theta_max: float) -> None:
    truth = rod()
    estimate = fit(truth, log(truth, 0.5 * slow_sines()), SENSOR, NAMES)
    e = next_experiment(estimate, limits=Limits(2.0, theta_max=theta_max))
    assert e.measure == "interval"
    assert e.before == pytest.approx(1.96 * estimate.sd[e.widest])
    assert e.gain > 2.0
    new = [fit(truth, played(e, truth, seed), SENSOR, NAMES) for seed in range(6)]
    half = 1.96 * float(np.mean([x.sd[e.widest] for x in new]))
    assert half == pytest.approx(e.after, rel=0.1)
    off = np.array([x.values[e.widest] - truth.parameters[e.widest].value for x in new])
    assert 1.96 * np.sqrt(np.mean(off**2)) < 1.7 * e.after  # 99.9 % of six draws


def test_what_errors_cost_falls_as_promised_and_where_it_is_high() -> None:
    truth = rod()
    before = log(truth, in_phase())
    estimate = fit(truth, before, SENSOR, NAMES)
    planned = [
        next_experiment(estimate, limits=Limits(2.0, 2.0, theta_max=1.0), cost=np.diag(weight))
        for weight in ((1.0, 0.0), (0.0, 1.0))
    ]
    for k, e in enumerate(planned):
        assert e.measure == "cost"
        assert e.before == pytest.approx(estimate.covariance[k, k])
        both = [fit(truth, [*before, *played(e, truth, seed)], SENSOR, NAMES) for seed in range(4)]
        assert np.mean([x.covariance[k, k] for x in both]) == pytest.approx(e.after, rel=0.15)
        other = np.linalg.inv(np.linalg.inv(estimate.covariance) + planned[1 - k].information)[k, k]
        assert e.after < 1.001 * other, "the other plan serves this cost better"


def test_first_order_evidence_is_that_of_the_scores() -> None:
    """lambda (1 - rho^2), with z_perp as the scores take it, once the truth's own motion is the nominal one."""
    small = 1e-5
    truth = Hypothesis("viscous", rod().with_effect(Viscous(b=small)), (*NAMES, "viscous.b"))
    rival = Hypothesis("drag", rod().with_effect(CATALOGUE["drag"](c=small)), (*NAMES, "drag.c"))
    signals = random_signals(np.random.default_rng(3), LIMITS, 0.02, 1, swings=False)
    ours = Pool([truth, rival], signals, CONDITIONS).unlike("viscous", "drag").unexplained()[0]

    tested = scores(output_error(predict(rod(), signals, CONDITIONS)), ("viscous", "drag"))
    z = {name: s.z[:, 0] for name, s in tested.items()}
    rho = z["viscous"] @ z["drag"] / math.sqrt((z["viscous"] @ z["viscous"]) * (z["drag"] @ z["drag"]))
    assert ours == pytest.approx(small**2 * z["viscous"] @ z["viscous"] * (1.0 - rho**2), rel=0.02)


@pytest.mark.parametrize(
    ("truth", "rival"),
    [(Viscous(b=0.03), "drag"), (Coulomb(tau_c=0.005), "viscous"), (Delay(T=0.03), "lag"), (Lag(T=0.03), "delay")],
    ids=lambda case: getattr(case, "name", case),
)
def test_first_order_evidence_is_what_a_refit_leaves(truth: Effect, rival: str) -> None:
    """With the rival at its best numbers, also where the effect is large: the two motions differ little."""
    hypothesis = Hypothesis(
        truth.name, rod().with_effect(truth), (*NAMES, f"{truth.name}.{next(iter(truth.parameters))}")
    )
    signals = [Signal("multisine", 0.8, 0.3, 0.1, 1.0, 1.0, 0.0, seed) for seed in range(2)]
    base = output_error(predict(hypothesis.model, signals, CONDITIONS))
    score = scores(base, (rival,))[rival]
    best = extended(base, [score.best.at(score.sizes)], KNOWN)
    pool = Pool([hypothesis, Hypothesis(rival, best.model, best.names)], signals, CONDITIONS)
    assert pool.unlike(truth.name, rival).together().unexplained()[0] == pytest.approx(best.e @ best.e, rel=0.1)


def test_a_random_torque_makes_an_experiment_tell_less() -> None:
    """As much less as it takes away: the information is that of a fit beside such a torque."""
    signals = random_signals(np.random.default_rng(5), LIMITS, 0.02, 3, swings=False)
    disturbances = Disturbances(0.3, 0.5, 0.002, 0.1)
    hypothesis = Hypothesis("model", rod(), NAMES)
    calm, shaken = (
        Pool([hypothesis], signals, Conditions(LIMITS, SENSOR, assumed)).precision()
        for assumed in (NO_DISTURBANCE, disturbances)
    )
    assert np.all(shaken.sd() > 2.0 * calm.sd())
    samples = Samples(rod(), predict(rod(), signals, CONDITIONS), SENSOR)
    refit = solver.fit_parameters(samples, rod(), NAMES, None, disturbances, KNOWN)
    np.testing.assert_allclose(shaken.together().sd()[0], np.sqrt(np.diag(refit.covariance)), rtol=0.05)


@pytest.mark.long
def test_what_acts_beside_the_model_will_act_again() -> None:
    """A rod that rubs, fitted without friction: the next log is promised to tell about as much as it does."""
    rubbing = log(rod().with_effect(Coulomb(tau_c=0.02)), slow_sines(), 1.5 * slow_sines())
    estimate = fit(rod(), rubbing, SENSOR, NAMES)
    honest, from_estimate = (next_experiment(estimate, limits=LIMITS, records=records) for records in (rubbing, ()))
    naive = next_experiment(replace(estimate, random_torque=0.0), limits=LIMITS)
    assert min(honest.after, from_estimate.after) > 2.0 * naive.after, "the estimate knows it, too, without the records"
    again = fit(rod(), played(honest, rod().with_effect(Coulomb(tau_c=0.02)), 3), SENSOR, NAMES)
    assert 0.3 < 1.96 * again.sd[honest.widest] / honest.after < 3.0, "friction is not an Ornstein-Uhlenbeck process"


def test_a_motion_that_runs_away_spoils_no_other() -> None:
    """Every rollout is told by itself, whatever stands beside it."""
    driven = Hypothesis("model", rod().with_effect(Viscous(b=-1.0, bounds={"b": (-9.0, 9.0)})), NAMES)
    signals = [
        Signal("multisine", 1.0, 0.3, 0.1, 1.0, 1.0, 0.0, 1),
        Signal("free swing", 0.0, 1.0, 1.0, 1.0, 1.0, 0.0, 1),
    ]
    with np.errstate(all="ignore"):
        both, alone = (Pool([driven], subset, Conditions(Limits(2.0), SENSOR)) for subset in (signals, signals[1:]))
        np.testing.assert_allclose(both.precision().F[1], alone.precision().F[0], rtol=1e-6)
        assert both.stays().tolist() == [False, True]


def test_a_log_that_tells_more_is_not_followed_by_a_poorer_one() -> None:
    """A long log under a large torque, and a rig that may do next to nothing: it is said, and nothing is advised."""
    truth, poor = rod().with_effect(Coulomb(tau_c=0.02)), Limits(0.2, 2.0)
    rich = log(truth, in_phase(), 2.0 * slow_sines()[:200], 1.5 * slow_sines()[:200])
    experiment = next_experiment(rod(), ("coulomb", "viscous"), poor, SENSOR, rich)
    assert (experiment.kind, experiment.after, experiment.u.size) == ("none", None, 0)
    assert experiment.before > max(16.0, min(c.after for c in experiment.pairs))
    assert "the log at hand tells coulomb from viscous" in experiment.description
    known = next_experiment(rod(), (), poor, SENSOR, log(rod(), 2.0 * slow_sines()))
    assert (known.kind, known.measure, known.u.size) == ("none", "interval", 0)
    assert known.widest in known.description


@pytest.mark.long
def test_a_linear_axis_is_told_what_to_do_in_its_own_units() -> None:
    axis = Model(LinearAxis(m=0.4), dt=0.02)
    e = next_experiment(axis, (Viscous(b=0.3), "coulomb"), Limits(2.0, 3.0, theta_max=1.5), SENSOR)
    assert " N" in e.description
    for text in (e.description, str(e)):
        assert "N m" not in text
        assert "rad" not in text
    assert " m from rest" in str(e)
    with pytest.raises(InvalidInput, match="1e-09 N, 1e-30 m"):
        next_experiment(axis, limits=Limits(1e-9, 3.0, theta_max=1e-30), sensor=SENSOR)


@pytest.mark.long
def test_a_special_case_is_not_asked_to_beat_the_general_one() -> None:
    """Coulomb's friction is Stribeck's without excess: only the other way round can be told."""
    e = next_experiment(rod(), (Stribeck(tau_c=0.02, excess=0.03, v_s=0.2), Coulomb(tau_c=0.03)), LIMITS, SENSOR)
    assert {(c.truth, c.rival) for c in e.pairs} == {("stribeck", "coulomb")}
    assert e.after > 16.0


def test_more_rollouts_tell_at_least_in_proportion() -> None:
    rivals = (Viscous(b=0.01), "coulomb")
    evidence = [next_experiment(rod(), rivals, Limits(1.0, 4.0, rollouts=n), SENSOR).after for n in (1, 3)]
    assert evidence[1] > 2.0 * evidence[0]


@pytest.mark.parametrize(
    "limits",
    [
        Limits(0.3, 4.0),
        Limits(3.0, 4.0, theta_max=0.4),
        Limits(3.0, 4.0, theta_dot_max=1.0, start=0.5),
        Limits(3.0, 4.0, rollouts=2, theta_max=1.0),
    ],
)
def test_signal_and_predicted_motion_keep_to_the_limits(limits: Limits) -> None:
    e = next_experiment(rod(), limits=limits, sensor=SENSOR)
    assert e.u.shape == (limits.rollouts, round(limits.duration / 0.02))
    assert np.max(np.abs(e.u)) <= limits.u_max
    run = simulate(rod(), e.u, e.start, 0.0)
    np.testing.assert_allclose(run.theta, e.theta, atol=1e-9)
    assert np.max(np.abs(e.start - math.pi)) <= limits.start + 1e-9
    assert e.reach == pytest.approx(np.max(np.abs(run.theta - math.pi)))
    assert e.speed == pytest.approx(np.max(np.abs(run.theta_dot)))
    assert e.reach <= (limits.theta_max or math.inf) * (1.0 + 1e-5)
    assert e.speed <= (limits.theta_dot_max or math.inf) * (1.0 + 1e-5)


def test_without_limits_the_rig_does_what_it_has_done() -> None:
    records = log(rod(), slow_sines(), 0.5 * slow_sines())
    limits = limits_of(records, rod())
    assert limits.u_max == pytest.approx(0.8, rel=1e-3)
    assert (limits.rollouts, limits.duration) == (2, pytest.approx(8.0))
    turned = [Record(r.t, r.u, r.theta - 2.0 * math.pi, r.theta_dot) for r in records if r.theta is not None]
    assert limits_of(turned, rod()).theta_max == pytest.approx(limits.theta_max)
    e = next_experiment(rod(), records=records)
    assert e.reach <= max(float(np.max(np.abs(r.theta - math.pi))) for r in records if r.theta is not None) + 1e-6


@pytest.mark.long
def test_what_no_model_explains_counts_as_noise() -> None:
    """Three times the noise that was claimed: evidence is a ninth, and intervals are as wide as the fit's own."""
    truth = rod().with_effect(Coulomb(tau_c=0.01))
    records, quiet = log(truth, 2.0 * slow_sines()), Sensor(0.001, 0.05 / 3.0)
    rivals = ("coulomb", "viscous")
    right, wrong = (next_experiment(rod(), rivals, LIMITS, sensor, records) for sensor in (SENSOR, quiet))
    assert wrong.before == pytest.approx(right.before, rel=0.25)
    estimate = fit(rod(), log(rod(), 2.0 * slow_sines()), quiet, NAMES)
    e = next_experiment(estimate, limits=LIMITS)
    again = fit(rod(), played(e, rod(), 0), SENSOR, NAMES)
    assert e.after == pytest.approx(1.96 * again.sd[e.widest], rel=0.15)


def test_the_same_question_gets_the_same_answer() -> None:
    limits = Limits(1.0, 3.0)
    a, b = (next_experiment(rod(), limits=limits, sensor=SENSOR, rng=np.random.default_rng(4)) for _ in range(2))
    assert a.to_dict() == b.to_dict()
    np.testing.assert_array_equal(a.u, b.u)
    other = next_experiment(rod(), limits=limits, sensor=SENSOR, rng=np.random.default_rng(5))
    assert not np.array_equal(a.u, other.u)


@pytest.mark.parametrize("rollouts", [1, 2])
def test_the_csv_plays_the_same_torque(rollouts: int, tmp_path: Path) -> None:
    e = next_experiment(rod(), limits=Limits(1.0, 3.0, rollouts=rollouts), sensor=SENSOR)
    e.write_csv(tmp_path / "play.csv")
    with open(tmp_path / "play.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert ("rollout" in rows[0]) == (rollouts > 1)
    for i in range(rollouts):
        of_rollout = [r for r in rows if int(r.get("rollout", 0)) == i]
        t, torque = (np.array([float(r[c]) for r in of_rollout]) for c in ("t", "torque"))
        held = torque[np.searchsorted(t, e.t[:-1] + 0.5 * e.dt, side="right") - 1]
        np.testing.assert_array_equal(held, e.u[i])


def test_the_answer_is_plain_data_and_a_sentence() -> None:
    e = next_experiment(rod(), (Viscous(b=0.01), "coulomb"), Limits(1.0, 3.0), SENSOR)
    data = json.loads(json.dumps(e.to_dict(), allow_nan=False))
    assert data["kind"] in (*KINDS, "mixed")
    assert set(data["separates"]) == {"viscous", "coulomb"}
    assert data["seconds"] == pytest.approx(3.0)
    assert "viscous from coulomb" in str(e)
    assert e.repeats == max(1, math.ceil(16.0 / data["after"]))


def test_a_single_rival_is_told_from_its_absence() -> None:
    alone, listed = (
        next_experiment(rod(), rivals, Limits(1.0, 3.0), SENSOR) for rivals in (Viscous(b=0.01), [Viscous(b=0.01)])
    )
    assert alone.to_dict() == listed.to_dict()
    assert {(c.truth, c.rival) for c in alone.pairs} == {("viscous", "nothing")}


# what no torque tells -----------------------------------------------------------------------------------------


def test_back_emf_is_told_from_friction_with_the_driver_off() -> None:
    e = next_experiment(rod(), (Viscous(b=0.02), BackEmf(k=0.02)), LIMITS, SENSOR)
    assert e.kind == "none"
    assert e.description.startswith("switch the driver off, let it go")


@pytest.mark.parametrize("pair", [("tilt", "angle_offset"), ("sensor_delay", "delay"), ("stamp", "delay")])
def test_of_some_pairs_nothing_that_is_played_tells(pair: tuple[str, str], tmp_path: Path) -> None:
    e = next_experiment(rod(), pair, LIMITS, SENSOR)
    assert (e.kind, e.after, e.repeats) == ("none", None, 1)
    assert pair[0] in e.description
    assert pair[1] in e.description
    assert (e.to_dict()["rollouts"], e.to_dict()["start"]) == (0, [])
    with pytest.raises(InvalidInput, match="nothing to play"):
        e.write_csv(tmp_path / "none.csv")


def test_twins_are_said_and_the_others_told_apart() -> None:
    e = next_experiment(rod(), (Viscous(b=0.01), BackEmf(k=0.01), "coulomb"), LIMITS, SENSOR)
    assert set(e.separates) == {"viscous", "coulomb"}
    assert "no torque tells back_emf from viscous" in e.description


def test_a_payload_shows_the_torque_gain() -> None:
    asked = next_experiment(rod(), ("torque_gain",), LIMITS, SENSOR, log(rod(), slow_sines()))
    mass, distance = payload(rod())
    assert f"hang {mass:g} kg on it, {distance:g} m from the axis" in asked.description
    J, G = float(rod().inertia()), float(rod().plant.gravity_torque(0.5 * math.pi))
    loaded = J + mass * distance**2, G + mass * 9.81 * distance
    estimates = []
    for seed, numbers in enumerate(((J, G), loaded)):
        truth = Model(GeneralJoint(*numbers), (TorqueGain(c=1.1),), dt=0.02)
        estimates.append(fit(Model(GeneralJoint(J=0.3, G=4.0), dt=0.02), log(truth, slow_sines(), seed=seed), SENSOR))
    step = estimates[1].values["J"] - estimates[0].values["J"]
    assert mass * distance**2 / step == pytest.approx(1.1, abs=0.03)  # (J + m r^2) / c - J / c


def test_the_least_labour_is_asked_for() -> None:
    def asked(model: Model, *names: str) -> str:
        return non_torque_experiment(model, names).description

    assert asked(rod(), "rotor_inertia").startswith("weigh the moving part (m): then")
    assert asked(rod(), "m", "l", "g").startswith("hang")
    assert asked(rod(), "torque_gain", "rotor_inertia").startswith("weigh the moving part (m) and hang")
    assert asked(Model(LinearAxis(m=0.4), dt=0.02), "torque_gain").startswith("load it with 0.2 kg")


def test_an_estimate_that_no_motion_determines_asks_for_a_payload() -> None:
    estimate = fit(rod(), log(rod(), slow_sines()), SENSOR, ("m", "l", "g"))
    assert not estimate.success
    assert "hang" in next_experiment(estimate, limits=Limits(1.0, 3.0, theta_max=1.5)).description

"""The search: what is added pays, matters and is no imitation, what has become idle goes, and chance is no effect."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import Any, cast

import numpy as np
import pytest
from scipy.stats import binom

from sysid import (
    CATALOGUE,
    AsymmetricCoulomb,
    AsymmetricViscous,
    Backlash,
    Coulomb,
    CubicSpring,
    Dahl,
    Drag,
    Effect,
    FlexibleTransmission,
    GeneralJoint,
    Joint,
    JointEffect,
    Model,
    Periodic,
    PointMassPendulum,
    PositionServo,
    Record,
    Ripple,
    RodPendulum,
    RotorInertia,
    Saturation,
    Sensor,
    SensorDelay,
    Spring,
    Stribeck,
    Tilt,
    TorqueBias,
    TorqueSpeedLimit,
    Viscous,
    WarmingFriction,
    diagnose,
    effect,
    ops,
    simulate,
)
from sysid import parameter as number
from sysid.diagnosis import search as search_module
from sysid.diagnosis.criteria import is_nothing, is_plausible, matters, recurs, squared_size
from sysid.diagnosis.search import Addition, Search, Trial
from sysid.diagnosis.search_settings import DEFAULT
from sysid.errors import InvalidInput
from sysid.estimation.first_fit import first_fit
from sysid.estimation.linearisation import Samples
from sysid.estimation.prediction import PredictionErrors
from sysid.estimation.prediction_error import Fit
from sysid.estimation.refits import extended, reduced
from sysid.estimation.scores import price, scores
from sysid.estimation.solver import HELD, fit_parameters
from sysid.physics.ops import Value
from sysid.planning.excitation import steps
from tests.sysid.planted import DT, SENSOR, logs, rod, shaken, truth

PLANT = ("m", "l")
FRICTIONS = ("viscous", "coulomb", "asymmetric_viscous", "asymmetric_coulomb", "stribeck", "drag", "tilt")


@cache
def rubbing() -> tuple[Record, ...]:
    """Dry friction, and nothing else but the noise."""
    return tuple(logs(truth(Coulomb(tau_c=0.1)), n=3, seconds=4.0))


@cache
def base() -> Fit:
    """The bare rod on it."""
    return first_fit(Samples(rod(), rubbing(), SENSOR), rod(), PLANT)


@cache
def mended() -> Fit:
    return extended(base(), [Coulomb(tau_c=0.05)])


def test_what_was_added_in_vain_leaves_no_worse_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two effects are added and pruned again, and the fit without them ends elsewhere."""
    search = Search(rubbing(), SENSOR, effects=("coulomb",))
    worse = fit_parameters(
        base().samples, rod().with_parameters({"m": 1.5}), (), base(), base().disturbances.scaled(0.5), HELD
    )

    def pruned(self: Search, now: Fit) -> Fit:
        self.additions = []
        return worse

    monkeypatch.setattr(Search, "_pruned", pruned)
    _, end = search.run(rod(), PLANT)
    assert search.trials and not search.additions, "nothing was tried"
    assert end.deviance < worse.deviance - 100.0


# a random torque beside the model ----------------------------------------------------------------------------


def test_what_explains_no_better_than_its_simple_parent_is_not_named() -> None:
    """Asymmetric friction and Stribeck's contain Coulomb's: only the simplest is named, and it is no class of them."""
    found = diagnose(rod(), shaken(truth(Coulomb(tau_c=0.1)), 0.05), SENSOR)
    assert found.verdict == "partly"
    assert found.error.ratio == found.steps[0].error_after <= found.base_error.ratio
    assert [s.effect for s in found.steps] == ["coulomb"]
    assert found.steps[0].indistinguishable == ("coulomb",)
    tau_c = found.steps[0].parameters["coulomb.tau_c"]
    assert abs(tau_c["value"] - 0.1) < 4.0 * tau_c["sd"] < 0.04


@pytest.mark.long
def test_a_free_decay_under_a_constant_torque_names_dry_friction_alone() -> None:
    u = np.full((4, 250), 0.3)
    found = diagnose(rod(), shaken(truth(Coulomb(tau_c=0.08)), 0.02, 0, u), SENSOR)
    assert [s.effect for s in found.steps] == ["coulomb"]
    assert found.verdict == "partly"
    assert abs(found.estimate.values["coulomb.tau_c"] - 0.08) < 4.0 * found.estimate.sd["coulomb.tau_c"] < 0.04


@pytest.mark.long
def test_a_random_torque_is_no_effect() -> None:
    """It is unknown, of the size that it has, and m and l are as sure as it allows."""
    found = diagnose(rod(), shaken(truth(), 0.05, 1), SENSOR)
    assert found.verdict == "unknown" and found.remaining is not None
    assert not found.steps
    assert 0.02 < found.remaining.torque < 0.1
    for name in PLANT:
        off = found.estimate.values[name] - truth().parameters[name].value
        assert abs(off) < 4.0 * found.estimate.sd[name]


SEEDS = 12


@pytest.mark.long
def test_false_alarms_are_rare() -> None:
    """Of short logs in which nothing is hidden."""
    alarms = 0
    for seed in range(SEEDS):
        found = diagnose(rod(), logs(truth(), 500 + seed, n=4, seconds=3.0), SENSOR)
        alarms += found.verdict != "adequate" or bool(found.steps or found.conventions)
    assert alarms <= binom.ppf(0.999, SEEDS, 0.05)


# what matters, and what is likely before any log ---------------------------------------------------------------


def test_what_is_there_and_too_small_to_matter_is_said_and_not_added() -> None:
    records = logs(truth(Viscous(b=3e-4)), n=4)
    found = diagnose(rod(), records, SENSOR, effects=("viscous",))
    assert found.verdict == "adequate"
    assert not found.steps
    assert found.negligible == ("viscous",)
    assert "no better by what matters: viscous" in str(found)
    eager = dataclasses.replace(DEFAULT, tolerance=0.0, noise_share=0.0)
    found = diagnose(rod(), records, SENSOR, effects=("viscous",), settings=eager)
    assert [s.effect for s in found.steps] == ["viscous"]


def test_what_is_too_small_to_matter_over_a_second_matters_over_a_longer_horizon() -> None:
    records = logs(truth(Viscous(b=6e-4)), n=4)
    assert diagnose(rod(), records, SENSOR, effects=("viscous",)).negligible == ("viscous",)
    far = dataclasses.replace(DEFAULT, horizon=3.0)
    found = diagnose(rod(), records, SENSOR, effects=("viscous",), settings=far)
    assert [s.effect for s in found.steps] == ["viscous"]
    assert found.error.window == 3.0
    assert "lowers the error of 3 s predictions by 2%" in str(found)


def test_what_most_readings_cannot_be_compared_with_is_no_candidate() -> None:
    """In rollouts of a quarter of a second hardly a reading shows what a sensor that is as late as this one saw."""
    truth = Model(GeneralJoint(J=0.1, G=1.0), (Coulomb(tau_c=0.5),), dt=0.01)
    u, sensor = np.random.default_rng(0).uniform(-2.0, 2.0, (12, 25)), Sensor(theta=1e-4)
    records = sensor.measure(simulate(truth, u, np.full(12, math.pi), np.zeros(12)), np.random.default_rng(1))
    wrong = Model(GeneralJoint(J=0.3, G=1.0), dt=0.01)
    now = fit_parameters(Samples(wrong, records, sensor), wrong, ("J",))
    search = Search(records, sensor)
    search.last = scores(now, ("sensor_delay",))
    assert not search.trial(now, ("sensor_delay",), [SensorDelay(T=0.19)])


@pytest.mark.parametrize("wrong", [{"horizon": 0.0}, {"horizon": -1.0}, {"horizon": math.inf}, {"tolerance": 1.0}])
def test_settings_out_of_range_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(InvalidInput, match="expected"):
        dataclasses.replace(DEFAULT, **wrong)  # type: ignore[arg-type]


@pytest.mark.long
def test_of_two_effects_that_change_little_the_one_stays_that_explains_more() -> None:
    """Over a second a slow decay is as well viscous as dry; over half a minute it is exponential."""
    truth = Model(PointMassPendulum(m=1.0, l=0.33, g=9.81), (Viscous(b=0.004), TorqueBias(tau_0=0.03)), dt=1.0 / 30.0)
    run = simulate(truth, np.zeros((1, 900)), np.array([math.pi + 0.95]), np.zeros(1))
    filmed = Sensor(theta=0.008).measure(run, np.random.default_rng(0))
    plain = Model(PointMassPendulum(m=1.0, l=0.3, g=9.81), dt=1.0 / 30.0)
    among = ("viscous", "coulomb", "torque_bias", "tilt")
    found = diagnose(plain, filmed, Sensor(theta=0.008), parameters=("l",), effects=among)
    assert {s.effect for s in found.steps} == {"viscous", "torque_bias"}, str(found)


def test_what_matters_depends_on_the_tolerance() -> None:
    """The effect lowers the error by much more than 2 %, and by less than 99 %."""
    assert matters(base().model, mended(), DEFAULT)
    assert matters(base().model, mended(), dataclasses.replace(DEFAULT, tolerance=0.2))
    assert not matters(base().model, base(), DEFAULT)
    assert not matters(base().model, mended(), dataclasses.replace(DEFAULT, noise_share=1e3))


@pytest.mark.long
def test_an_effect_that_is_rare_needs_more_evidence(catalogue: dict[str, type[Effect]]) -> None:
    """The same torque by two names, of which one is believed at odds of exp(-20) only."""

    @dataclass(frozen=True, eq=False)
    class Wave(JointEffect):
        k: Value = number(0.0, unit="N m", bounds=(-1.0, 1.0), neutral=0.0)  # noqa: RUF009

        def torque(self, joint: Joint) -> Value:
            return self.k * ops.sin(3.0 * joint.theta)

    class Unlikely(Wave):
        rarity = 20.0

    catalogue["wave"], catalogue["unlikely"] = Wave, Unlikely
    assert price("unlikely", DEFAULT.price) - price("wave", DEFAULT.price) == 2.0 * (20.0 - Wave.rarity)
    records = logs(truth(Wave(k=0.004)), n=4)
    common, rare = (diagnose(rod(), records, SENSOR, effects=(n,)) for n in ("wave", "unlikely"))
    assert "wave" in {*(s.effect for s in common.steps), *common.negligible}
    assert "unlikely" not in {*(s.effect for s in rare.steps), *rare.negligible}
    plain = diagnose(rod(), logs(truth(Wave(k=0.1)), n=4), SENSOR, effects=("unlikely",))
    assert [s.effect for s in plain.steps] == ["unlikely"], "a log that says enough is believed"


def test_friction_is_in_every_joint() -> None:
    """Nothing is likelier beforehand."""
    assert CATALOGUE["viscous"].rarity == CATALOGUE["coulomb"].rarity == 0.0
    assert all(kind.rarity >= 0.0 for kind in CATALOGUE.values())
    for refined, parent in (
        ("asymmetric_coulomb", "coulomb"),
        ("asymmetric_viscous", "viscous"),
        ("stribeck", "coulomb"),
    ):
        assert price(refined, DEFAULT.price) > price(parent, DEFAULT.price) + DEFAULT.price


# the loop ------------------------------------------------------------------------------------------------------


def sd_of(found: Fit) -> dict[str, float]:
    return dict(zip(found.names, np.sqrt(np.diag(found.covariance)).tolist(), strict=True))


def held(found: Fit, numbers: dict[str, float]) -> Fit:
    """The same fit with other numbers."""
    return dataclasses.replace(found, model=found.model.with_parameters(numbers))


def having(own: Effect, found: Fit | None = None) -> Fit:
    """The fit of the bare rod, or another one, as if its model had that effect."""
    found = found or base()
    return dataclasses.replace(found, model=found.model.with_effect(own))


def pruned(found: Fit, added: tuple[str, ...], **settings: float) -> tuple[list[str], Fit]:
    """What stays of what was added, and the fit with it."""
    search = Search(rubbing(), SENSOR, settings=dataclasses.replace(DEFAULT, **settings))
    search.last = scores(base(), FRICTIONS)
    search.additions = [Addition(n, (), (), 1e-9) for n in added]
    end = search._pruned(found)
    return [a.name for a in search.additions], end


def test_what_has_become_idle_goes() -> None:
    """As if viscous friction had been added while the dry one was still unknown."""
    both = extended(extended(base(), [Viscous(b=0.02)]), [Coulomb(tau_c=0.05)])
    stays, end = pruned(both, ("viscous", "coulomb"))
    assert stays == [e.name for e in end.model.effects] == ["coulomb"]
    assert end.deviance == pytest.approx(mended().deviance, abs=0.5)


@pytest.mark.parametrize("names", [("viscous", "coulomb"), ("coulomb", "viscous")])
@pytest.mark.parametrize("sizes", [(1.5, 0.1), (0.1, 1.5)])
def test_of_two_that_are_nothing_beside_each_other_that_goes_of_which_less_is_lost(
    names: tuple[str, str], sizes: tuple[float, float]
) -> None:
    """Two frictions that take each other's place, where the log has dry friction: neither the order in which they came
    nor their sizes, in standard deviations, decide which one it is."""
    both = extended(base(), [Viscous(b=0.02), Coulomb(tau_c=0.05)])
    sd = sd_of(both)
    nothing = held(both, {n: own * sd[n] for n, own in zip(("viscous.b", "coulomb.tau_c"), sizes, strict=True)})
    assert all(is_nothing(nothing, name) for name in names)
    stays, end = pruned(nothing, names)
    assert stays == [e.name for e in end.model.effects] == ["coulomb"]


def test_a_refinement_that_stands_alone_yields_to_its_simple_form() -> None:
    """As if dry friction of two sizes had been chosen where its sides are alike."""
    refined = extended(base(), [AsymmetricCoulomb(tau_plus=0.09, tau_minus=0.11)])
    stays, end = pruned(refined, ("asymmetric_coulomb",))
    assert stays == [e.name for e in end.model.effects] == ["coulomb"]
    assert end.deviance == pytest.approx(mended().deviance, abs=0.5)


def test_a_refinement_whose_own_number_may_be_nothing_is_its_simple_form(monkeypatch: pytest.MonkeyPatch) -> None:
    """However well it predicts: Stribeck's friction without an excess is Coulomb's."""
    refined = extended(base(), [Stribeck(tau_c=0.1, excess=0.01, v_s=0.5)])
    excess = refined.names.index("stribeck.excess")
    assert refined.values[excess] < 2.0 * math.sqrt(refined.covariance[excess, excess])
    assert not is_nothing(refined, "stribeck"), "its friction is sure"
    search = Compared(rubbing(), SENSOR)
    search.last = scores(base(), FRICTIONS)
    search.additions = [Addition("stribeck", (), (), 1e-9)]
    monkeypatch.setattr(search_module, "gain", lambda *_: 100.0)
    monkeypatch.setattr(search_module, "matters", lambda *_: True)
    monkeypatch.setattr(search, "_predicts", lambda *_: True)
    search._simplified(refined)
    assert [a.name for a in search.additions] == ["coulomb"]


def test_a_refinement_is_its_simple_form_too_if_it_was_added_beside_that(monkeypatch: pytest.MonkeyPatch) -> None:
    """Then the last scores do not hold the simple form, which went when the refinement took all of its friction."""
    warming = effect("warming_friction", tau_c=0.0, excess=0.1, T=100.0)
    search = Compared(rubbing(), SENSOR)
    search.first = scores(base(), FRICTIONS)
    search.additions = [Addition("warming_friction", (), (), 1e-9)]
    monkeypatch.setattr(search_module, "is_plausible", lambda *_: False)
    end = search._simplified(extended(base(), [warming]))
    assert [a.name for a in search.additions] == ["coulomb"]
    assert end.deviance == pytest.approx(mended().deviance, abs=0.5)


def sized(found: Fit, *sd: float) -> Fit:
    """The same fit with a ripple whose sizes are that many standard deviations."""
    rippled = extended(found, [Ripple(a=1e-4, b=1e-4, order=6.0)])
    return held(rippled, {f"ripple.{k}": n * sd_of(rippled)[f"ripple.{k}"] for k, n in zip("ab", sd, strict=True)})


def test_what_is_no_two_standard_deviations_from_nothing_is_nothing() -> None:
    """All its sizes together; its shape is no size."""
    assert is_nothing(sized(mended(), 0.9, -0.9), "ripple")
    assert not is_nothing(sized(mended(), 4.0, 0.0), "ripple")
    assert not is_nothing(sized(mended(), 0.0, -4.0), "ripple")
    assert not is_nothing(mended(), "coulomb")


def test_what_changes_nothing_is_nothing_though_no_number_is_determined() -> None:
    """As a rotor's inertia of 0 beside the plant's own, which no motion tells apart."""
    both = extended(mended(), [RotorInertia(J_r=0.1)])
    assert not np.all(np.isfinite(both.covariance))
    for J_r, nothing in ((0.1, False), (0.0, True)):
        assert is_nothing(held(both, {"rotor_inertia.J_r": J_r}), "rotor_inertia") == nothing


def test_a_limit_that_may_as_well_be_infinite_is_none() -> None:
    """The limit is as many of its standard deviations as is said."""
    records = logs(truth(Saturation(limit=0.5)), n=3, seconds=4.0)
    cut = extended(first_fit(Samples(rod(), records, SENSOR), rod(), PLANT), [Saturation(limit=0.6)])
    for multiple, nothing in ((1.5, True), (4.0, False)):
        own = held(cut, {"saturation.limit": multiple * sd_of(cut)["saturation.limit"]})
        assert is_nothing(own, "saturation") == nothing


def test_a_limit_is_sure_whether_or_not_the_log_shows_how_it_falls_with_speed() -> None:
    records = logs(truth(Saturation(limit=0.5)), n=3, seconds=4.0)
    base = first_fit(Samples(rod(), records, SENSOR), rod(), PLANT)
    cut = extended(base, [TorqueSpeedLimit(limit=0.6, k=0.0)])
    Z = cut.Z.copy()
    Z[:, cut.names.index("torque_speed_limit.k")] = 0.0
    for found in (cut, dataclasses.replace(cut, Z=Z)):
        assert not is_nothing(found, "torque_speed_limit")


def test_what_the_free_parameters_absorb_is_no_simple_form_of_anything() -> None:
    """A stiff transmission is a rotor's inertia, which beside a free inertia is nothing."""
    springy = extended(mended(), [FlexibleTransmission(J=0.01, f=6.0)])
    search = Search(rubbing(), SENSOR)
    search.last = scores(mended(), ("rotor_inertia", "viscous"))
    assert not search.last["rotor_inertia"].visible
    search.additions = [Addition(n, (), (), 1e-9) for n in ("coulomb", "flexible_transmission")]
    assert "rotor_inertia" not in {e.name for e in search._simplified(springy).model.effects}


@pytest.mark.long
def test_a_spring_that_rests_elsewhere_is_found_with_its_offset() -> None:
    """Beside dry friction, in a search through these alone."""
    sprung = truth(Coulomb(tau_c=0.1), Spring(k=0.6), TorqueBias(tau_0=0.5))
    search = Search(logs(sprung, n=3, seconds=4.0), SENSOR, ("coulomb", "spring", "torque_bias", "ripple"))
    search.run(rod(), PLANT)
    assert {a.name for a in search.additions} == {"coulomb", "spring", "torque_bias"}


def test_a_spring_has_a_size_where_gravity_could_only_push_the_other_way() -> None:
    """Over a small swing gravity would do as well, if it did not stand at its bound: a search named nothing there."""
    plain, rest = Model(GeneralJoint(J=0.1, G=0.0), dt=0.01), 0.07
    sprung = plain.with_effect(Spring(k=47.0)).with_effect(TorqueBias(tau_0=47.0 * (rest - math.pi)))
    run, sensor = simulate(sprung, np.zeros(400), rest + 0.1, 0.0), Sensor(theta=2e-3, theta_dot=None)
    noise = np.random.default_rng(0).normal(0.0, 2e-3, run.theta.shape)
    record = Record(run.t, run.u, run.theta + noise, None)
    start = first_fit(Samples(plain, [record], sensor), plain, ("G",))
    found = extended(start, [Spring(k=40.0), TorqueBias(tau_0=-120.0)])
    at, G = found.names.index("spring.k"), found.model.parameters["G"]
    assert float(G.value) == 0.0 and float(found.covariance[at, at]) > 40.0**2
    assert squared_size(found, "spring") > 100.0 and squared_size(found, "torque_bias") > 100.0


@pytest.mark.long
@pytest.mark.parametrize(
    "losses",
    [
        {"viscous": 0.036, "coulomb": 0.348, "drag": 0.0069},
        {"coulomb": 0.4, "drag": 0.03},
    ],
)
def test_what_a_free_swing_loses_is_named_and_no_friction_that_falls_with_time(losses: dict[str, float]) -> None:
    """The swing falls with time, too, and so does the loss by all that grows with speed. Numbers are per inertia; the
    encoder is coarse."""
    plain = Model(RodPendulum(m=1.0, l=0.1766), dt=0.02)
    inertia, lossy = float(plain.inertia()), plain
    for name, size in losses.items():
        (field,) = CATALOGUE[name]().parameters
        lossy = lossy.with_effect(effect(name, **{field: inertia * size}))
    run, sensor = simulate(lossy, np.zeros(1575), math.pi - 1.7, 0.0), Sensor(theta=0.003, theta_dot=None)
    noise = np.random.default_rng(0).normal(0.0, 0.001, run.theta.shape)
    record = Record(run.t, run.u, np.round((run.theta + noise) / 0.01) * 0.01, None)
    found = diagnose(plain, [record], sensor, parameters=["l"])
    assert {step.effect for step in found.steps} == set(losses)
    for name, size in losses.items():
        (number,) = (own for own in found.estimate.names if own.startswith(name))
        assert abs(found.estimate.values[number] - inertia * size) < 4.0 * found.estimate.sd[number]


def test_a_search_that_comes_back_to_effects_that_it_had_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each of two effects is added where the other stands, and takes its place."""
    search, added = Search(rubbing(), SENSOR), list[str]()

    def swapped(now: Fit, *_: object) -> Fit:
        added.append("viscous" if added[-1:] == ["coulomb"] else "coulomb")
        search.additions = [Addition(added[-1], (), (), 1e-9)]
        return now

    chosen = Trial(("coulomb",), mended(), 1.0)
    for name, does in (("_trials", [chosen]), ("_common", []), ("_chosen", chosen)):
        monkeypatch.setattr(search, name, lambda *_, does=does: does)
    monkeypatch.setattr(search, "_added", swapped)
    monkeypatch.setattr(search, "_pruned", lambda now: now)
    search.run(rod(), PLANT)
    assert added == ["coulomb", "viscous", "coulomb"]
    assert [[a.name for a in own] for own, _ in search.stages] == [["coulomb"], ["viscous"]]


def test_friction_that_rubs_one_way_only_is_no_friction() -> None:
    """An offset of the torque or a wrong zero looks like that."""
    assert AsymmetricCoulomb(tau_plus=0.1, tau_minus=0.05).plausible and AsymmetricViscous().plausible
    assert not AsymmetricCoulomb(tau_plus=0.4, tau_minus=0.02).plausible
    assert not AsymmetricViscous(b_plus=0.0, b_minus=0.004).plausible


def test_a_spring_pulls_back_and_friction_is_left_in_a_warm_machine() -> None:
    assert Spring(k=0.1).plausible and not Spring(k=-0.1).plausible
    assert CubicSpring(k=0.0, k_3=1.0).plausible and not CubicSpring(k=-0.1, k_3=1.0).plausible
    for kind in (Spring, CubicSpring):
        within, round_and_round = (kind().resolved(0.0, reach, cast(Any, None)) for reach in (3.0, 30.0))
        assert within and not round_and_round
    assert WarmingFriction(tau_c=0.1, excess=0.5).plausible and WarmingFriction().plausible
    assert not WarmingFriction(tau_c=0.01, excess=0.5).plausible


def test_what_is_nothing_goes_whatever_the_likelihood_says() -> None:
    both = sized(mended(), 0.5, 0.5)
    assert is_nothing(both, "ripple")
    stays, _ = pruned(both, ("coulomb", "ripple"), price=-1e3, tolerance=0.0, noise_share=0.0)
    assert stays == ["coulomb"]


def test_a_pattern_has_to_come_back() -> None:
    """Twice within some record, and never as often as the motion does."""
    samples = base().samples
    span = max(float(np.ptp(samples.smoothed[a:b, 0])) for a, b in pairwise(samples.first.tolist()))
    duration = float(np.ptp(samples.time_since_start))

    def comes_back(own: Effect) -> bool:
        return recurs(having(own), (own.name,), DEFAULT)

    waves = 2.0 * math.pi / span
    assert comes_back(Ripple(a=0.1, order=max(2.0, 2.2 * waves))) and not comes_back(Ripple(a=0.1, order=1.8 * waves))
    still, theta = np.zeros(99), np.linspace(0.0, 1.0, 100)
    driven, free = (Ripple(order=5.0 * math.pi).recurrences(theta, theta, u) for u in (still + 1.0, still))
    assert driven == pytest.approx(2.5) and free == pytest.approx(1.5), "of a free swing the scale may be uneven"
    assert comes_back(Periodic(a=0.1, f=2.2 / duration)) and not comes_back(Periodic(a=0.1, f=1.8 / duration))
    assert comes_back(Tilt(alpha=0.1)) and comes_back(Coulomb(tau_c=0.1))


@pytest.mark.parametrize("size", [0.0, 0.1])
def test_how_often_a_pattern_comes_back_has_to_be_told(size: float) -> None:
    """A ripple that the log has none of may have any order."""
    records = logs(truth(Coulomb(tau_c=0.1), Ripple(a=size, b=0.5 * size, order=8.0)), n=3, seconds=4.0)
    rubs = rod(Coulomb(tau_c=0.1))
    fit = first_fit(Samples(rubs, records, SENSOR), rubs, ("m", "l", "coulomb.tau_c"))
    found = scores(fit, ("ripple",))["ripple"]
    rippled = extended(fit, [found.best.at(found.sizes)])
    assert recurs(rippled, ("ripple",), DEFAULT) == (size > 0.0)


def test_what_stays_pays() -> None:
    """Two effects, both found; without either the log is less likely by more than its price."""
    search = Search(logs(truth(Coulomb(tau_c=0.06), Tilt(alpha=0.04)), n=3, seconds=4.0), SENSOR, FRICTIONS)
    _, end = search.run(rod(), PLANT)
    assert {a.name for a in search.additions} == {"coulomb", "tilt"}
    assert {e.name for e in end.model.effects} == {"coulomb", "tilt"}
    for name in ("coulomb", "tilt"):
        assert reduced(end, name).deviance - end.deviance > price(name, DEFAULT.price)


def test_a_bigger_model_is_never_less_likely() -> None:
    for name in ("viscous", "tilt", "delay", "asymmetric_coulomb", "spring"):
        own = scores(base(), (name,))[name]
        bigger = extended(base(), [own.best.at(own.sizes)])
        assert bigger.deviance < base().deviance + 0.5, name
        assert bigger.names[: len(PLANT)] == PLANT


def test_taking_an_effect_away_gives_the_smaller_fit_back() -> None:
    again = reduced(mended(), "coulomb")
    assert again.names == base().names and not again.model.effects
    assert again.deviance == pytest.approx(base().deviance, abs=2.0)
    assert mended().model.effects, "the fit that was reduced has changed"


class Compared(Search):
    """A search of trials whose errors on left-out stretches are given by their names, all of which pay and matter."""

    squares: dict[str, list[float]]

    def left_out(self, own: Fit, lead: float) -> PredictionErrors:
        squares = np.array(self.squares["+".join(e.name for e in own.model.effects)])
        return PredictionErrors(squares, np.full(len(squares), 50.0))


@pytest.mark.parametrize(
    ("merits", "squares", "best"),
    [
        ((13.0, 8.0), (9e4, 1e4), "viscous"),  # explains about as much and predicts better
        ((13.0, 8.0), (1e4, 9e4), "coulomb"),
        ((13.0, 3.0), (9e4, 1e4), "coulomb"),  # explains too little
    ],
)
def test_of_two_that_explain_about_as_much_the_one_that_predicts_better_is_taken(
    merits: tuple[float, float], squares: tuple[float, float], best: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where the model lacks more than one effect; each window is a little different, as windows are."""
    disturbed = dataclasses.replace(base())
    disturbed.__dict__["undisturbed"] = False
    trials = []
    for own, merit in zip((Coulomb(tau_c=0.1), Viscous(b=0.05)), merits, strict=True):
        fit = having(own)
        fit.__dict__["undisturbed"] = False
        trials.append(Trial((own.name,), fit, merit))
    monkeypatch.setattr(search_module, "matters", lambda *_: True)
    monkeypatch.setattr(search_module, "is_determined", lambda *_: True)
    search = Compared(rubbing(), SENSOR)
    search.last = scores(base(), FRICTIONS)
    shape = np.linspace(0.8, 1.2, 8)
    search.squares = {"": list(1e6 * shape)} | {
        t.effects[0]: list(size * shape) for t, size in zip(trials, squares, strict=True)
    }
    monkeypatch.setattr(search, "_preferred", lambda *_: [])
    chosen = search._chosen(disturbed, trials, trials, ())
    assert chosen is not None and chosen.effects == (best,)


def test_what_turned_out_to_be_nothing_is_not_added_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nor is what is made anew of it each time."""
    added: list[tuple[str, ...]] = []
    search = Compared(rubbing(), SENSOR, FRICTIONS)
    monkeypatch.setattr(search, "_added", lambda now, chosen, trials: added.append(chosen.effects) or now)
    monkeypatch.setattr(search, "_pruned", lambda now: now)
    monkeypatch.setattr(search, "_preferred", lambda now, best: [dataclasses.replace(best)])
    monkeypatch.setattr(search, "_predicts", lambda *_: True)
    monkeypatch.setattr(search, "_predicts_better", lambda *_: False)
    search.run(rod(), PLANT)
    assert added and len(added) == len(set(added))


class Likelier(Fit):
    """A fit that led to better numbers of the disturbances."""

    deviance = -1e6  # type: ignore[assignment]

    @classmethod
    def than(cls, now: Fit) -> Likelier:
        return cls(**{f.name: getattr(now, f.name) for f in dataclasses.fields(now)})


@pytest.mark.parametrize("after", [lambda now: now, Likelier.than], ids=["as likely", "likelier"])
def test_where_what_was_added_is_nothing_the_others_have_their_turn(
    monkeypatch: pytest.MonkeyPatch, after: Callable[[Fit], Fit]
) -> None:
    """A drive that is late and weak at speed: friction alone paid, had no size, and neither of the two was tried. A
    winch: a huge rotor that no torque moves predicted best, was nothing, and its load was not tried."""
    asked: list[str] = []
    search = Compared(rubbing(), SENSOR, FRICTIONS)
    monkeypatch.setattr(search, "_added", lambda now, chosen, trials: after(now))
    monkeypatch.setattr(search, "_pruned", lambda now: now)
    monkeypatch.setattr(search, "_predicts", lambda *_: True)
    monkeypatch.setattr(search, "_predicts_better", lambda *_: False)
    for name in ("_others", "_simulated", "_composites"):
        monkeypatch.setattr(search, name, lambda *_, name=name, **__: asked.append(name) or [])
    search.run(rod(), PLANT)
    assert asked == ["_others", "_simulated", "_composites"]


def test_what_promised_less_has_its_turn_and_has_to_predict_better(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of what was not tried yet: a spring that predicts better, a tilt that does not, a drag that promises less."""
    effects = (Coulomb(tau_c=0.1), Spring(k=0.1), Tilt(alpha=0.1), Drag(c=0.1))
    made = {own.name: Trial((own.name,), having(own), 5.0) for own in effects}
    search = Compared(rubbing(), SENSOR)
    promised = dict(zip(made, (500.0, 40.0, 30.0, 1.0), strict=True))
    found = scores(base(), tuple(made))
    search.last = {n: dataclasses.replace(found[n], lm=lm, visible=True) for n, lm in promised.items()}
    shape = np.linspace(0.8, 1.2, 8)
    sizes = dict(zip(made, (1e4, 1e3, 1e6, 1e3), strict=True))
    search.squares = {"": list(1e6 * shape)} | {n: list(size * shape) for n, size in sizes.items()}
    monkeypatch.setattr(search, "_try_class", lambda now, name, tried: tried.append(made[name]))
    assert [t.effects for t in search._others(base(), [made["coulomb"]])] == [("spring",)]


def test_a_contact_gives_by_more_than_the_noise_and_by_less_than_the_motion() -> None:
    half = 0.5 * float(np.ptp(base().samples.smoothed[:, 0]))
    assert SENSOR.theta == 0.003
    for z_s, plausible in ((0.0015, False), (0.006, True), (0.12 * half, False)):
        assert is_plausible(having(Dahl(tau_c=0.1, z_s=z_s)), ("dahl",)) == plausible


def test_a_curve_that_falls_over_no_range_of_speeds_is_no_motors_but_a_servos_profile() -> None:
    """To a drive that is told torques; what follows positions is held to a speed by its firmware."""
    largest = float(np.max(np.abs(base().linearised.drive_torques)))
    curves = [TorqueSpeedLimit(limit=size * largest, k=size * largest / 3.0) for size in (1.5, 40.0)]
    found = [having(curve) for curve in curves]
    assert [is_plausible(fit, ("torque_speed_limit",)) for fit in found] == [True, False]
    assert is_plausible(having(PositionServo(k_p=10.0), found[1]), ("torque_speed_limit",))


@pytest.mark.parametrize("hidden", [Viscous(b=5e-4), Tilt(alpha=6e-4), Coulomb(tau_c=1e-3)], ids=lambda e: e.name)
def test_a_score_is_no_more_than_the_deviance_that_a_refit_saves(hidden: Effect) -> None:
    """Or less: the refit makes the random torque smaller, too. The size is that of the refit, and of the truth."""
    records = logs(truth(hidden), 3, n=3)
    fit = first_fit(Samples(rod(), records, SENSOR), rod(), PLANT)
    score = scores(fit, (hidden.name,))[hidden.name]
    bigger = extended(fit, [score.best.at(score.sizes)])
    assert score.lm > 6.0, "too small to test anything"
    assert fit.deviance - bigger.deviance > 0.95 * score.lm - 0.5
    (p,) = hidden.parameters.values()
    assert abs(score.sizes[0] - float(p.value)) < 4.0 * score.sd[0]
    found = bigger.values[-1]
    assert abs(score.sizes[0] - found) < score.sd[0]


# where a random torque, or a small motion, hides what is missing ------------------------------------------------


def test_a_sensor_at_fault_is_found_though_a_random_torque_follows_its_readings() -> None:
    """Beside an encoder with play the motion that is likeliest goes where the encoder says, under any torque."""
    found = diagnose(rod(), logs(truth(Backlash(width=0.06)), n=4), SENSOR, effects=("coulomb", "backlash"))
    assert found.verdict == "missing"
    assert [s.effect for s in found.steps] == ["backlash"]
    width = found.steps[0].parameters["backlash.width"]
    assert abs(width["value"] - 0.06) < 4.0 * width["sd"] < 0.004
    assert found.error.ratio < 1.1


@pytest.mark.long
def test_what_a_small_motion_hardly_shows_is_added_where_a_large_one_shows_it() -> None:
    """A spring is a part of gravity for small angles, and no part of it for large ones, which were held out."""
    rng, model = np.random.default_rng(0), truth(Spring(k=0.15))
    u = np.array([size * steps(rng, 250, DT, 1.0, 0.3) for size in (1.0, 1.0, 1.0, 1.0, 2.2)])
    records = SENSOR.measure(simulate(model, u, np.full(5, math.pi), 0.0), rng)
    found = diagnose(rod(), records, SENSOR, 1, effects=("viscous", "spring"))
    assert found.verdict == "missing"
    assert [s.effect for s in found.steps] == ["spring"]
    assert found.error.ratio < 1.1 < found.base_error.ratio
    without = diagnose(rod(), records, SENSOR, 1, effects=("viscous",))
    assert without.verdict == "unknown", "no model is adequate that fails on what was held out"
    assert without.remaining is not None and without.remaining.unseen
    assert "held-out data are not" in without.sentence

"""Score tests: right where nothing is hidden, right sizes where something is, and what no log can show."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.stats import binom, chi2, kstest

from sysid import (
    CATALOGUE,
    Coulomb,
    Effect,
    GeneralJoint,
    Lag,
    Model,
    Record,
    Ripple,
    RotorInertia,
    Saturation,
    Sensor,
    SensorDelay,
    TorqueGain,
    Viscous,
    effect,
    simulate,
)
from sysid.estimation.disturbances import Disturbances
from sysid.estimation.linearisation import LinearisedModel, Samples
from sysid.estimation.prediction_error import Fit
from sysid.estimation.refits import extended
from sysid.estimation.scores import Score, collinearity, scores
from sysid.estimation.solver import Settings, fit_parameters
from sysid.physics.candidates import candidates_for
from sysid.physics.effects import JointEffect
from sysid.physics.parameters import Extent
from sysid.planning.excitation import steps
from tests.sysid import planted
from tests.sysid.planted import DT, SENSOR, shaken
from tests.sysid.planted import truth as rod

PLANT = ("m", "l")
NONE = Disturbances(0.0)
KNOWN = Settings(sizes=False, vague=math.inf)
EXTENT = Extent(DT, 4.0, 1.5)
logs = partial(planted.logs, n=3, seconds=4.0)


def null(
    records: list[Record], names: tuple[str, ...] = PLANT, disturbances: Disturbances = NONE, sensor: Sensor = SENSOR
) -> Fit:
    """The bare rod, fitted beside disturbances that are known."""
    return fit_parameters(Samples(rod(), records, sensor), rod(), names, None, disturbances, KNOWN)


@pytest.fixture(scope="module")
def clean() -> Fit:
    return null(logs(rod()))


@pytest.fixture(scope="module")
def scored(clean: Fit) -> dict[str, Score]:
    return scores(clean)


# where nothing is hidden -------------------------------------------------------------------------------------

SEEDS = 24
SINGLE = ("viscous", "coulomb", "drag", "tilt", "spring", "torque_bias", "drift", "velocity_gain", "velocity_bias")
BESIDE = {"nothing": NONE, "a random torque": Disturbances(1.0, 0.5)}


@pytest.fixture(scope="module", params=BESIDE)
def many(request: pytest.FixtureRequest) -> list[dict[str, Score]]:
    """Scores of logs in which nothing is hidden, beside no disturbance and beside a random torque of known size."""
    disturbances, found = BESIDE[request.param], []
    for seed in range(SEEDS):
        u = np.array([steps(np.random.default_rng(900 + seed), 150, DT, 1.5, 0.3) for _ in range(2)])
        rms = disturbances.s * float(rod().inertia())
        found.append(scores(null(shaken(rod(), rms, seed, u, disturbances.T), PLANT, disturbances), SINGLE))
    return found


def test_p_values_are_uniform(many: list[dict[str, Score]]) -> None:
    """LM is chi-square; where an effect can be on one side only, half of all logs point to the other: LM = 0."""
    for name in SINGLE:
        lm = np.array([own[name].lm for own in many])
        if candidates_for(CATALOGUE[name], EXTENT)[0].side:
            few, most = binom.ppf([0.0005, 0.9995], SEEDS, 0.5)
            assert few <= np.count_nonzero(lm == 0.0) <= most, name
            lm = lm[lm > 0.0]
        assert kstest(chi2.sf(lm, 1), "uniform").pvalue > 1e-3 / len(SINGLE), name


# where something small is hidden -----------------------------------------------------------------------------

SMALL = {
    "viscous": {"b": 1e-3},
    "coulomb": {"tau_c": 1e-3},
    "drag": {"c": 2e-4},
    "load_friction": {"mu": 4e-4},
    "tilt": {"alpha": 8e-4},
    "spring": {"k": 0.2},
    "torque_bias": {"tau_0": 4e-3},
    "drift": {"r": 2e-3},
    "velocity_bias": {"bias": 8e-3},
    "velocity_gain": {"c": 1.004},
    "delay": {"T": 8e-4},
    "back_emf": {"k": 1e-3},
    "asymmetric_viscous": {"b_plus": 2e-3, "b_minus": 5e-4},
}


@pytest.mark.parametrize("name", SMALL)
def test_size_sd_and_lm_are_those_of_the_refit(name: str) -> None:
    """To first order, so with sizes of a few standard deviations."""
    truth = effect(name, **SMALL[name])
    base = null(logs(rod(truth), 3, n=4))
    score = scores(base, (name,))[name]
    better = extended(base, [score.best.at(score.sizes)], KNOWN)
    at = [better.names.index(f"{name}.{k}") for k in score.best.magnitudes]
    found = better.values[at] - [truth.parameters[k].neutral or 0.0 for k in score.best.magnitudes]
    hidden = [float(truth.parameters[k].value) - (truth.parameters[k].neutral or 0.0) for k in score.best.magnitudes]
    sd = np.array(score.sd)
    assert np.all(np.abs(np.array(score.sizes) - found) < 0.1 * sd)
    assert np.all(np.abs(np.array(score.sizes) - hidden) < 4.0 * sd)
    np.testing.assert_allclose(sd, np.sqrt(np.diag(better.covariance))[at], rtol=0.15)
    assert score.lm > 4.0, "too small to test anything"
    assert base.deviance - better.deviance == pytest.approx(score.lm, rel=0.02, abs=0.2)


# sensitivities -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", CATALOGUE)
@pytest.mark.parametrize("beside", BESIDE)
def test_z_is_what_the_innovations_lose_with_the_effect(name: str, beside: str, clean: Fit) -> None:
    """As the model with the effect itself shows it, about the same motion, whitened by the same factor; but for what
    the change of the motion within an interval makes of a torque."""
    tried = candidates_for(CATALOGUE[name], EXTENT)
    probe = tried[len(tried) // 2].probes[0]
    system, filter = clean.linearised.system, clean.linearised.system.filter(BESIDE[beside])
    z = filter.whiten(*clean.linearised.effect_changes([probe], [1.0]))[:, 0]
    with_it = LinearisedModel(clean.samples, clean.model.with_effect(probe), clean.motion)
    further = (with_it.ends[:, :2] - clean.linearised.ends) * clean.samples.follows[:, None]
    seen = clean.samples.read(with_it.model, clean.motion.x) - clean.samples.read(clean.model, clean.motion.x)
    moved = replace(system, gap=system.gap + further, r=system.r - seen * clean.samples.weight)
    lost = filter.innovations - moved.filter(BESIDE[beside]).innovations
    assert np.linalg.norm(z) > 0.0
    close = 1e-2 if isinstance(probe, JointEffect) else 1e-6
    assert np.linalg.norm(z - lost.ravel()) < close * np.linalg.norm(z)


def test_z_lies_beside_the_parameters(clean: Fit, scored: dict[str, Score]) -> None:
    for score in scored.values():
        length = np.linalg.norm(score.z, axis=0)
        assert np.max(np.abs(clean.Z.T @ score.z)) <= 1e-7 * np.linalg.norm(clean.Z) * np.max(length) + 1e-6


def test_a_score_is_no_matter_of_which_others_are_asked(clean: Fit, scored: dict[str, Score]) -> None:
    names = ("drag", "viscous", "tilt")
    few = scores(clean, names)
    assert tuple(few) == names
    for name in names:
        assert few[name].lm == pytest.approx(scored[name].lm)
        assert few[name].sizes == pytest.approx(scored[name].sizes)


def test_a_model_that_runs_away_does_not_break_it() -> None:
    """Negative friction, and readings of a motion that no such model makes: every score is a number, or is left out."""
    driven = rod(Viscous(b=-9.0, bounds={"b": (-9.0, 9.0)}))
    with np.errstate(all="ignore"):
        found = scores(fit_parameters(Samples(driven, logs(rod()), SENSOR), driven, PLANT, None, Disturbances(1.0)))
    assert len(found) > 10
    for score in found.values():
        assert math.isfinite(score.lm)
        assert np.all(np.isfinite(score.z))


# one side, and what cannot be seen ---------------------------------------------------------------------------


def test_a_driver_that_gives_more_is_no_limit() -> None:
    """Beyond 1 N m this one gives 1.3 times the command."""
    records = logs(rod())
    for i, r in enumerate(records):
        more = np.sign(r.u) * (np.abs(r.u) + 0.3 * np.maximum(np.abs(r.u) - 1.0, 0.0))
        made = SENSOR.measure(simulate(rod(), more, r.theta[0], 0.0), np.random.default_rng(i))[0]  # type: ignore[index]
        records[i] = Record(r.t, r.u, made.theta, made.theta_dot)
    assert scores(null(records), ("saturation",))["saturation"].lm == 0.0
    assert scores(null(logs(rod(Saturation(limit=1.2)))), ("saturation",))["saturation"].lm > 30.0


@pytest.mark.parametrize("truth", [TorqueGain(c=0.98), RotorInertia(J_r=0.005)], ids=lambda e: e.name)
def test_what_m_and_l_absorb_shows_on_a_weighed_pendulum(truth: Effect, scored: dict[str, Score]) -> None:
    absorbed = {name for name, score in scored.items() if score.absorbed}
    assert absorbed == {"torque_gain", "rotor_inertia"} == {n for n, score in scored.items() if not score.visible}
    assert all(scored[name].lm == 0.0 for name in absorbed)
    base = null(logs(rod(truth)), ("l",))
    score = scores(base, (truth.name,))[truth.name]
    assert score.lm > 30.0
    (parameter,) = truth.parameters.values()
    better = extended(base, [score.best.at(score.sizes)], KNOWN)
    assert better.values[-1] == pytest.approx(parameter.value, abs=4.0 * math.sqrt(better.covariance[-1, -1]))


def test_an_effect_is_alike_to_itself_and_to_nothing_that_does_not_show(scored: dict[str, Score]) -> None:
    assert collinearity(scored["viscous"], scored["torque_gain"]) == 0.0
    for score in scored.values():
        if score.visible:
            assert collinearity(score, score) == pytest.approx(1.0)


def test_a_family_explains_what_its_members_do(scored: dict[str, Score]) -> None:
    for small, large in (("viscous", "asymmetric_viscous"), ("coulomb", "asymmetric_coulomb")):
        assert scored[large].lm >= (1.0 - 1e-3) * scored[small].lm


def test_speeds_alone_do_not_show_an_encoders_zero() -> None:
    records = [Record(r.t, r.u, None, r.theta_dot) for r in logs(rod())]
    base = null(records, sensor=Sensor(None, 0.05))
    assert not scores(base, ("angle_offset",))["angle_offset"].visible


# what else is missing ----------------------------------------------------------------------------------------


def test_something_else_that_is_missing_counts_as_a_random_torque() -> None:
    """Beside a strong ripple the wrong effects promise far less than white residuals would make them."""
    names = ("drift", "drag", "velocity_gain", "torque_bias", "velocity_bias")
    records = logs(rod(Ripple(a=0.1, b=0.05, order=5.0)))
    beside = fit_parameters(Samples(rod(), records, SENSOR), rod(), PLANT)
    white, right = (max(s.lm for s in scores(own, names).values()) for own in (null(records), beside))
    assert right < 0.1 * white


@pytest.mark.parametrize("truth", [Lag(T=0.05), SensorDelay(T=0.03)], ids=lambda e: e.name)
def test_what_is_hidden_scores_best_beside_its_like(truth: Effect) -> None:
    records = logs(rod(truth))
    found = scores(fit_parameters(Samples(rod(), records, SENSOR), rod(), PLANT))
    best = max(found.values(), key=lambda s: s.lm - 7.0 * len(s.sizes))
    assert best.name == truth.name or best.name in truth.confused
    assert found[truth.name].lm > 0.6 * best.lm
    assert found[truth.name].lm > 15.0


def test_a_number_that_ended_at_its_bound_absorbs_no_effect() -> None:
    """Gravity that would have to push upwards is none, and explains nothing of what else is missing."""
    truth = Model(GeneralJoint(J=0.1, G=1.0), (Coulomb(tau_c=0.02),), dt=DT)
    u = steps(np.random.default_rng(0), 200, DT, 0.3, 0.2)
    hanging = SENSOR.measure(simulate(truth, u, math.pi, 0.0), np.random.default_rng(1))
    records = [replace(r, theta=np.asarray(r.theta) - math.pi) for r in hanging]

    def found(G: float, names: tuple[str, ...]) -> tuple[Fit, dict[str, Score]]:
        plain = Model(GeneralJoint(J=0.1, G=G), dt=DT)
        fit = fit_parameters(Samples(plain, records, SENSOR), plain, names, None, Disturbances(5.0, 0.1), KNOWN)
        return fit, scores(fit, ("spring", "coulomb", "viscous", "tilt"))

    bounded, with_gravity = found(0.3, ("J", "G"))
    _, without = found(0.0, ("J",))
    assert "G" in bounded.at_bounds
    for name in ("spring", "coulomb", "viscous"):
        assert with_gravity[name].lm == pytest.approx(without[name].lm, rel=1e-2), name

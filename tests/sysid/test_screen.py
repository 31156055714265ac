"""The screen: right p-values where nothing is hidden, right sizes where something is, and what no log can show."""

from __future__ import annotations

import math
import sys

import numpy as np
import pytest
from scipy.stats import binom, chi2, kstest

from sysid import (
    CATALOGUE,
    AngleOffset,
    BackEmf,
    Backlash,
    Coulomb,
    Delay,
    Drag,
    Drift,
    Effect,
    Lag,
    LoadFriction,
    Model,
    Record,
    Ripple,
    RodPendulum,
    RotorInertia,
    Saturation,
    Sensor,
    SensorDelay,
    Spring,
    Tilt,
    TorqueBias,
    TorqueGain,
    VelocityBias,
    VelocityGain,
    Viscous,
    effect,
    simulate,
)
from sysid.diagnosis.candidates import alternatives
from sysid.excitation import steps
from sysid.holm import holm
from sysid.identify.gauss_newton import Fit, fit_longest, fit_windows, without
from sysid.planning.directions import Directions
from sysid.planning.refits import LEAD, extend
from sysid.planning.screen import Score, alikeness, screen
from sysid.records import extent_of
from sysid.response import Response

DT = 0.02
SENSOR = Sensor(0.003, 0.05)
PLANT = ("m", "l")
LEVEL = 0.05


def rod(*effects: Effect) -> Model:
    return Model(RodPendulum(m=1.0, l=0.9), effects, dt=DT)


def logs(model: Model, seed: int = 0, n: int = 3, seconds: float = 4.0, noise: bool = True) -> list[Record]:
    rng = np.random.default_rng(seed)
    u = np.array([steps(rng, round(seconds / DT), DT, 1.5, 0.3) for _ in range(n)])
    run = simulate(model, u, math.pi + rng.uniform(-0.8, 0.8, n), np.zeros(n))
    if noise:
        return run.measure(SENSOR, rng)
    return [Record(run.t, *row) for row in zip(run.u, run.theta_read, run.theta_dot_read, strict=True)]


def null(records: list[Record], names: tuple[str, ...] = PLANT, horizon: float = math.inf) -> Fit:
    """The bare rod, fitted."""
    begin = np.array([{"m": 1.0, "l": 0.9}[n] for n in names])
    return fit_windows(rod(), names, records, SENSOR, horizon, begin, lead=LEAD)


@pytest.fixture(scope="module")
def clean() -> Fit:
    return null(logs(rod()))


@pytest.fixture(scope="module")
def screened(clean: Fit) -> dict[str, Score]:
    return screen(clean)[0]


# where nothing is hidden -------------------------------------------------------------------------------------

SEEDS = 32


@pytest.fixture(scope="module")
def screens() -> list[dict[str, Score]]:
    """Screens of short logs in which nothing is hidden."""
    return [screen(null(logs(rod(), 500 + seed)))[0] for seed in range(SEEDS)]


def test_false_alarms_are_as_rare_as_promised(screens: list[dict[str, Score]]) -> None:
    adjusted = [holm({n: s.p_value for n, s in scores.items() if s.visible}) for scores in screens]
    named = [[n for n, p in own.items() if p < LEVEL] for own in adjusted]
    assert sum(map(bool, named)) <= binom.ppf(0.999, SEEDS, LEVEL), named


def test_p_values_are_uniform(screens: list[dict[str, Score]]) -> None:
    """Where an effect can be on one side only, half of all logs point to the other: p = 1."""
    kinds = {name: alternatives(CATALOGUE[name], extent_of(logs(rod()))) for name in screens[0]}
    single = [name for name, tried in kinds.items() if len(tried) == 1 and screens[0][name].visible]
    assert len(single) >= 14
    for name in single:
        p = np.array([r[name].p_value for r in screens])
        if kinds[name][0].side:
            few, many = binom.ppf([0.0005, 0.9995], SEEDS, 0.5)
            assert few <= np.count_nonzero(p == 1.0) <= many, name
            p = 2.0 * p[p < 1.0]
        assert kstest(p, "uniform").pvalue > 1e-3 / len(single), name


def test_where_residuals_are_white_the_p_value_is_that_of_chi_square(screens: list[dict[str, Score]]) -> None:
    """Up to what stretches of the residuals happen to say; never below it."""
    ratios = []
    for score in (s for r in screens for name, s in r.items() if name in ("tilt", "drift", "velocity_gain")):
        ratios.append(score.p_value / chi2.sf(score.lm, 1))
    assert min(ratios) > 0.9
    assert np.median(ratios) == pytest.approx(1.0, abs=0.02)


def test_the_best_of_many_shapes_is_no_more_significant(screens: list[dict[str, Score]]) -> None:
    for name in ("stribeck", "ripple", "periodic", "delay", "lag", "sensor_delay", "saturation", "stamp"):
        p = np.array([r[name].p_value for r in screens])
        for level in (0.05, 0.2):
            assert np.count_nonzero(p < level) <= binom.ppf(0.9995, SEEDS, level), name


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
    "ripple": {"a": 5e-3, "b": 3e-3, "order": 4.0},
    "periodic": {"a": 5e-3, "b": -3e-3, "f": 1.0},
}


@pytest.fixture(scope="module", params=SMALL)
def confirmed(request: pytest.FixtureRequest) -> tuple[Fit, Score, Fit, Effect]:
    """(null fit, score, refit with the effect, the truth)."""
    truth = effect(request.param, **SMALL[request.param])
    base = null(logs(rod(truth), 3, n=4))
    score = screen(base, (request.param,))[0][request.param]
    return base, score, extend(base, score), truth


def shaped(score: Score) -> bool:
    """Whether a shape is searched beside the magnitudes: the refit then finds a better one than the grid's."""
    return any(p.neutral is None for p in CATALOGUE[score.name]().parameters.values())


def test_predicted_sizes_are_those_of_the_refit(confirmed: tuple[Fit, Score, Fit, Effect]) -> None:
    _, score, better, truth = confirmed
    assert score.best is not None
    if shaped(score):
        return  # another order turns sine into cosine
    for k, size, sd in zip(score.best.magnitudes, score.sizes, score.sd, strict=True):
        parameter = truth.parameters[k]
        neutral = parameter.neutral or 0.0
        found = better.model.parameters[f"{score.name}.{k}"].value - neutral
        assert abs(size - found) < 0.1 * sd
        assert abs(size - (parameter.value - neutral)) < 4.0 * sd


def test_the_score_is_the_cost_that_a_refit_saves(confirmed: tuple[Fit, Score, Fit, Effect]) -> None:
    """-2 log likelihood falls by z^2: Lagrange multiplier and likelihood ratio agree to second order."""
    base, score, better, _ = confirmed
    saved = 2.0 * (base.solution.lin.cost - better.solution.lin.cost) / base.variance
    assert score.lm > 4.0, "too small to test anything"
    assert saved > 0.98 * score.lm
    if not shaped(score):
        assert saved < 1.02 * score.lm


def test_its_standard_error_is_that_of_the_refit(confirmed: tuple[Fit, Score, Fit, Effect]) -> None:
    _, score, better, _ = confirmed
    if not shaped(score):
        assert score.best is not None
        fitted = [better.estimate().sd[f"{score.name}.{k}"] for k in score.best.magnitudes]
        np.testing.assert_allclose(score.sd, fitted, rtol=0.15)


@pytest.mark.parametrize(
    "truth",
    [
        Viscous(b=1e-5),
        Drag(c=1e-5),
        Spring(k=1e-4),
        TorqueBias(tau_0=1e-4),
        Drift(r=1e-4),
        Tilt(alpha=1e-5),
        Coulomb(tau_c=1e-5),
        VelocityGain(c=1.0001),
        VelocityBias(bias=1e-4),
        AngleOffset(offset=1e-5),
        BackEmf(k=1e-5),
        LoadFriction(mu=1e-5),
    ],
    ids=lambda e: e.name,
)
def test_to_first_order_the_size_is_exact(truth: Effect) -> None:
    """Without noise, and with sizes far below what it would show."""
    base = null(logs(rod(truth), 3, noise=False))
    score = screen(base, (truth.name,))[0][truth.name]
    (parameter,) = truth.parameters.values()
    assert score.sizes[0] == pytest.approx(parameter.value - (parameter.neutral or 0.0), rel=0.03)


# directions --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", CATALOGUE)
def test_a_direction_is_the_change_of_the_readings(name: str, clean: Fit) -> None:
    """To first order that of a probe, as the model itself with the probe shows it at the same numbers and starts."""
    directions = Directions(clean)
    tried = alternatives(CATALOGUE[name], extent_of(clean.response.records))
    alternative = tried[len(tried) // 2]
    probe = alternative.probes[0]
    small = probe
    (k, size), share = (alternative.magnitudes[0], alternative.sizes[0]), 1.0
    if name not in ("saturation", "delay", "sensor_delay", "lag", "stamp", "dead_zone", "backlash"):
        share = 0.01
        small = alternative.neutral.with_parameters({k: (probe.parameters[k].neutral or 0.0) + share * size})
    response = Response(clean.model.with_effect(small), (), clean.response.records, SENSOR, clean.response.windows)
    moved = clean.solution.lin.e - response.residual(np.zeros(0), clean.solution.starts)
    expected = directions.response_to(small)
    scale = np.linalg.norm(moved)
    assert scale > 0.0
    loose = 0.02 if share < 1.0 else 0.35  # these have no slope at neutral, or a grid that begins far from it
    assert np.linalg.norm(moved - expected) < loose * scale
    if share < 1.0:
        assert np.linalg.norm(share * directions.response_to(probe) - expected) < 0.06 * scale


def test_directions_lie_beside_starts_and_parameters(clean: Fit) -> None:
    directions = Directions(clean)
    S = without(clean.reduced.directions, clean.solution.lin.S_p).reshape(-1, 2)
    names = ("viscous", "coulomb", "tilt", "velocity_gain", "delay")
    for name in names:
        for _, z, size in directions.each(alternatives(CATALOGUE[name], extent_of(clean.response.records))[:2]):
            length = np.linalg.norm(z)
            assert np.all(length <= size * (1.0 + 1e-9))
            assert np.max(np.abs(S.T @ z)) < 1e-8 * np.linalg.norm(S) * length
            windows = z.reshape(len(clean.response.windows), -1)
            starts = np.einsum("krs,kr->ks", clean.reduced.directions, windows)
            assert np.max(np.abs(starts)) < 1e-8 * length


def test_scores_do_not_depend_on_how_directions_are_cut_into_blocks(
    clean: Fit, screened: dict[str, Score], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.modules[Directions.__module__], "_CHUNK", 3 * Directions(clean).e.size)
    names = ("stribeck", "ripple", "delay", "asymmetric_viscous", "velocity_bias")
    for name, score in screen(clean, names)[0].items():
        assert score.lm == pytest.approx(screened[name].lm, rel=1e-6, abs=1e-9)
        assert score.p_value == pytest.approx(screened[name].p_value, rel=1e-6)


def test_a_score_is_no_matter_of_units_or_order(clean: Fit, screened: dict[str, Score]) -> None:
    names = ("drag", "viscous", "tilt")
    few = screen(clean, names)[0]
    assert list(few) == list(names)
    for name in names:
        assert few[name].lm == pytest.approx(screened[name].lm)
        assert few[name].sizes == pytest.approx(screened[name].sizes)


# one side, and what cannot be seen ---------------------------------------------------------------------------


@pytest.mark.parametrize("truth", [Viscous(b=-0.01, bounds={"b": (-1.0, 1.0)}), Drag(c=-0.003, bounds={"c": (-1, 1)})])
def test_a_friction_that_drives_is_no_friction(truth: Effect) -> None:
    score = screen(null(logs(rod(truth))), (truth.name,))[0][truth.name]
    assert score.p_value == 1.0
    assert score.lm == 0.0
    assert score.sizes[0] < 0.0


def test_a_driver_that_gives_more_is_no_limit() -> None:
    """Beyond 1 N m this one gives 1.3 times the command."""
    records = logs(rod())
    for i, r in enumerate(records):
        more = np.sign(r.u) * (np.abs(r.u) + 0.3 * np.maximum(np.abs(r.u) - 1.0, 0.0))
        made = simulate(rod(), more, r.theta[0], 0.0).measure(SENSOR, np.random.default_rng(i))[0]  # type: ignore[index]
        records[i] = Record(r.t, r.u, made.theta, made.theta_dot)
    base = null(records)
    assert base.variance > 2.0
    assert screen(base, ("saturation",))[0]["saturation"].p_value == 1.0
    limited = null(logs(rod(Saturation(limit=1.2))))
    assert screen(limited, ("saturation",))[0]["saturation"].p_value < 1e-6


def test_what_m_and_l_absorb_is_flagged(clean: Fit, screened: dict[str, Score]) -> None:
    absorbed = {name for name, score in screened.items() if not score.visible}
    assert absorbed == {"torque_gain", "rotor_inertia"}
    for name in absorbed:
        assert screened[name].p_value == 1.0
        assert screened[name].lm == 0.0
    weighed = screen(null(logs(rod()), ("l",)), absorbed)[0]
    assert all(score.visible for score in weighed.values())


@pytest.mark.parametrize("truth", [TorqueGain(c=0.95), RotorInertia(J_r=0.02)], ids=lambda e: e.name)
def test_a_weighed_pendulum_shows_them(truth: Effect) -> None:
    base = null(logs(rod(truth)), ("l",), 1.0)
    score = screen(base, (truth.name,))[0][truth.name]
    assert score.p_value < 1e-6
    (parameter,) = truth.parameters.values()
    found = extend(base, score).model.parameters[f"{truth.name}.{parameter.name}"].value
    assert found == pytest.approx(parameter.value, rel=0.02)


def test_twins_are_the_same_to_any_log(screened: dict[str, Score]) -> None:
    for a, b in (("viscous", "back_emf"), ("tilt", "angle_offset")):
        assert alikeness(screened[a], screened[b]) > 1.0 - 1e-6
        assert screened[a].lm == pytest.approx(screened[b].lm, rel=1e-3)
    for a, b in (("viscous", "coulomb"), ("viscous", "drag"), ("torque_bias", "spring"), ("delay", "drag")):
        assert alikeness(screened[a], screened[b]) < 0.995
    assert alikeness(screened["viscous"], screened["torque_gain"]) == 0.0, "it has no direction"
    for score in screened.values():
        if score.visible:
            assert alikeness(score, score) == pytest.approx(1.0)


def test_a_family_holds_its_members(screened: dict[str, Score]) -> None:
    """A larger family has the smaller one's direction within its span."""
    for small, large in (("viscous", "asymmetric_viscous"), ("coulomb", "asymmetric_coulomb")):
        assert alikeness(screened[small], screened[large]) == pytest.approx(1.0, abs=1e-4)
        assert screened[large].lm >= (1.0 - 1e-3) * screened[small].lm


def test_speeds_alone_do_not_show_an_encoders_zero() -> None:
    records = [Record(r.t, r.u, None, r.theta_dot) for r in logs(rod())]
    base = fit_windows(rod(), PLANT, records, Sensor(None, 0.05), math.inf, np.array([1.0, 0.9]))
    assert not screen(base, ("angle_offset",))[0]["angle_offset"].visible


# what else is missing ----------------------------------------------------------------------------------------


def test_something_else_that_is_missing_counts_as_coloured_noise() -> None:
    """Beside a strong ripple the wrong effects are far less significant than white residuals would make them."""
    base = null(logs(rod(Ripple(a=0.1, b=0.05, order=5.0))), horizon=0.5)
    scores = screen(base, ("drift", "drag", "velocity_gain", "torque_bias", "velocity_bias"))[0]
    for score in scores.values():
        assert score.best is not None
        white = chi2.sf(score.lm, 1) * (0.5 if score.best.side else 1.0)
        assert score.p_value > 0.8 * white
    assert max(s.p_value / chi2.sf(s.lm, 1) for s in scores.values()) > 1e3


@pytest.mark.parametrize(
    "truth",
    [Coulomb(tau_c=0.05), Delay(T=0.04), Lag(T=0.05), SensorDelay(T=0.03), Backlash(width=0.03), Tilt(alpha=0.03)],
    ids=lambda e: e.name,
)
def test_what_is_hidden_scores_best_beside_its_like(truth: Effect) -> None:
    scores = screen(fit_longest(rod(), PLANT, logs(rod(truth)), SENSOR, lead=LEAD))[0]
    best = max(scores.values(), key=lambda s: s.lm - 7.0 * len(s.sizes))
    assert best.name == truth.name or best.name in truth.confused
    assert scores[truth.name].lm > 0.6 * best.lm
    assert scores[truth.name].p_value < 1e-4


def test_a_start_for_the_fit_lies_within_the_bounds(screened: dict[str, Score]) -> None:
    for name, score in screened.items():
        if score.visible:
            effect(name, **score.start())  # raises where a number is out of bounds

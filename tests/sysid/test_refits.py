"""Refits of a screen's candidates: a bigger model is never worse, and what it gains is what leaving out says."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sysid import (
    CATALOGUE,
    Coulomb,
    Delay,
    Effect,
    Model,
    Record,
    RodPendulum,
    Sensor,
    Spring,
    Stribeck,
    Tilt,
    Viscous,
    simulate,
)
from sysid.excitation import steps
from sysid.identify.gauss_newton import NEGLIGIBLE, Fit, fit_longest, fit_windows
from sysid.planning.refits import LEAD, at_horizon, extend, gain, grow, reduce_by
from sysid.planning.screen import screen
from sysid.response import Response
from sysid.windows import cut

DT = 0.02
SENSOR = Sensor(0.003, 0.05)
PLANT = ("m", "l")


def rod(*effects: Effect) -> Model:
    return Model(RodPendulum(m=1.0, l=0.9), effects, dt=DT)


def logs(model: Model, seed: int = 0, n: int = 4, seconds: float = 4.0) -> list[Record]:
    rng = np.random.default_rng(seed)
    u = np.array([steps(rng, round(seconds / DT), DT, 1.5, 0.3) for _ in range(n)])
    return simulate(model, u, math.pi + rng.uniform(-0.8, 0.8, n), np.zeros(n)).measure(SENSOR, rng)


def longest(records: list[Record]) -> Fit:
    """The bare rod at the longest horizon that it follows."""
    return fit_longest(rod(), PLANT, records, SENSOR, lead=LEAD)


@pytest.fixture(scope="module")
def rubbing() -> list[Record]:
    return logs(rod(Coulomb(tau_c=0.2)), n=3)


@pytest.fixture(scope="module")
def base(rubbing: list[Record]) -> Fit:
    return longest(rubbing)


@pytest.fixture(scope="module")
def mended(base: Fit) -> Fit:
    return extend(base, screen(base, ("coulomb",))[0]["coulomb"])


# bigger and smaller models -----------------------------------------------------------------------------------


@pytest.mark.parametrize("hidden", [(), (Coulomb(tau_c=0.08),), (Delay(T=0.05), Spring(k=0.5))], ids=str)
def test_a_bigger_model_never_ends_above_the_smaller_one_it_contains(hidden: tuple[Effect, ...]) -> None:
    base = longest(logs(rod(*hidden), 2, n=3, seconds=3.0))
    names = ("viscous", "coulomb", "asymmetric_coulomb", "tilt", "ripple", "delay", "saturation", "backlash", "stamp")
    for name, score in screen(base, names)[0].items():
        bigger = extend(base, score)
        assert bigger.solution.lin.cost <= base.solution.lin.cost + NEGLIGIBLE, name
        assert bigger.horizon == base.horizon
        assert bigger.names[: len(base.names)] == base.names
        assert bigger.names[len(base.names) :] == tuple(f"{name}.{k}" for k in CATALOGUE[name]().parameters)
        for k, p in bigger.model.parameters.items():
            assert p.bounds[0] <= p.value <= p.bounds[1], k


def test_a_chain_of_additions_never_climbs() -> None:
    fit = longest(logs(rod(Stribeck(tau_c=0.05, excess=0.08, v_s=0.4), Tilt(alpha=0.03)), 1, n=3))
    for name in ("drag", "tilt", "stribeck", "torque_bias"):
        bigger = extend(fit, screen(fit, (name,))[0][name])
        assert bigger.solution.lin.cost <= fit.solution.lin.cost + NEGLIGIBLE
        fit = bigger


def test_taking_an_effect_away_gives_the_smaller_fit_back(base: Fit, mended: Fit) -> None:
    again = reduce_by(mended, "coulomb")
    assert again.names == base.names
    assert not again.model.effects
    assert again.solution.lin.cost == pytest.approx(base.solution.lin.cost, rel=1e-4)
    np.testing.assert_allclose(again.solution.p, base.solution.p, rtol=1e-3)
    assert mended.model.effects, "the fit that was reduced has changed"


def test_a_mended_model_is_followed_further(base: Fit, mended: Fit) -> None:
    assert base.horizon < math.inf
    whole = grow(mended)
    assert math.isinf(whole.horizon)
    assert grow(whole) is whole
    assert at_horizon(whole, whole.horizon) is whole
    back = at_horizon(whole, base.horizon)
    assert back.horizon == base.horizon
    assert back.solution.lin.cost == pytest.approx(mended.solution.lin.cost, abs=0.5)  # kinks of dry friction
    assert abs(whole.solution.p[2] - 0.2) < 4.0 * math.sqrt(whole.covariance[2, 2])


# cross-validation --------------------------------------------------------------------------------------------


def left_out(fit: Fit) -> float:
    """Half the sum of squares of each record, its start free, under the model fitted to the others."""
    total, response = 0.0, fit.response
    for i, record in enumerate(response.records):
        others = [r for k, r in enumerate(response.records) if k != i]
        part = fit_windows(fit.model, fit.names, others, SENSOR, math.inf, fit.solution.p, lead=LEAD)
        own = Response(fit.model, fit.names, [record], SENSOR, cut([record], skip=1))
        starts = fit.solution.starts[i : i + 1]
        for _ in range(4):
            lin = own.linearise(part.solution.p, starts)
            starts = starts + np.linalg.lstsq(lin.S_x[0], lin.e[0], rcond=None)[0]
        total += own.linearise(part.solution.p, starts).cost
    return total


def test_leaving_out_by_one_step_is_leaving_out_by_refits() -> None:
    """For a small effect, where the whole difference is a few units of log likelihood."""
    records = logs(rod(Viscous(b=0.0006)), 5)
    fit = fit_windows(rod(), PLANT, records, SENSOR, math.inf, lead=LEAD)
    for name in ("viscous", "tilt", "asymmetric_coulomb"):
        bigger = extend(fit, screen(fit, (name,))[0][name])
        expected = (left_out(fit) - left_out(bigger)) / min(fit.variance, bigger.variance)
        assert gain(fit, bigger) == pytest.approx(expected, abs=0.1 + 0.03 * abs(expected))


def test_what_is_there_gains_and_what_is_not_loses_on_average() -> None:
    gains = []
    for seed in range(12):
        fit = fit_windows(rod(), PLANT, logs(rod(), 100 + seed, n=3, seconds=2.0), SENSOR, math.inf, lead=LEAD)
        gains.append(gain(fit, extend(fit, screen(fit, ("tilt",))[0]["tilt"])))
    assert np.mean(gains) < 0.0, "an idle parameter costs about half a unit"
    fit = fit_windows(rod(), PLANT, logs(rod(Tilt(alpha=0.003))), SENSOR, math.inf, lead=LEAD)
    assert gain(fit, extend(fit, screen(fit, ("tilt",))[0]["tilt"])) > 10.0


def test_of_few_records_stretches_are_left_out() -> None:
    records = logs(rod(Tilt(alpha=0.003)), n=1, seconds=8.0)
    fit = fit_windows(rod(), PLANT, records, SENSOR, 2.0, lead=LEAD)
    assert gain(fit, extend(fit, screen(fit, ("tilt",))[0]["tilt"])) > 10.0


def test_lead_in_is_the_same_all_along(base: Fit, mended: Fit) -> None:
    """Costs compare only where the same readings are scored."""
    for fit in (base, mended, reduce_by(mended, "coulomb"), at_horizon(grow(mended), base.horizon)):
        assert [w.lead for w in fit.response.windows] == [w.lead for w in base.response.windows]
        np.testing.assert_array_equal(fit.response.n_readings, base.response.n_readings)

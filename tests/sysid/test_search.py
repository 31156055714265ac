"""The search: a bigger model is never worse, what is added has earned it, and what has become idle goes."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sysid import (
    CATALOGUE,
    Coulomb,
    Delay,
    Drag,
    Effect,
    Model,
    Record,
    Ripple,
    RodPendulum,
    Sensor,
    Spring,
    Stribeck,
    Tilt,
    Viscous,
    simulate,
)
from sysid.planning.refits import LEAD, at_horizon, extend, gain, grow, reduce_by
from sysid.planning.screen import screen
from sysid.diagnose.search import MOST_STEPS, Addition, Round, Search, Trial, alike, confined, holds, twins
from sysid.excitation import steps
from sysid.identify.gauss_newton import NEGLIGIBLE, Fit, fit_longest, fit_windows
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


def found(search: Search) -> set[str]:
    return {a.name for a in search.additions}


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


def test_an_effect_that_is_there_holds_and_one_that_is_not_does_not(mended: Fit) -> None:
    whole = grow(mended)
    assert holds(whole, "coulomb")
    idle = extend(whole, screen(whole, ("tilt",))[0]["tilt"])
    assert not holds(idle, "tilt")


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


# rounds and trials -------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def first(base: Fit) -> Round:
    return Round.of(base, None)


def test_effects_and_flexible_torques_are_one_family(first: Round) -> None:
    visible = {n for n, s in first.scores.items() if s.visible}
    assert set(first.adjusted) == visible | {f"~{n}" for n in first.flexible}
    raw = {n: first.scores[n].p_value for n in visible} | {f"~{n}": d.p_value for n, d in first.flexible.items()}
    assert all(raw[n] <= p <= min(1.0, len(raw) * raw[n]) for n, p in first.adjusted.items())
    assert min(first.adjusted.values()) == pytest.approx(min(1.0, len(raw) * min(raw.values())))


def test_what_is_warranted_is_significant_and_the_best_comes_first(first: Round) -> None:
    assert first.left
    assert "coulomb" in first.warranted
    assert all(first.adjusted[n] < 0.05 for n in first.warranted)
    merits = [first.merit(n) for n in first.warranted]
    assert merits == sorted(merits, reverse=True)
    assert "theta_dot" in first.structured


def test_of_twins_one_is_tried_and_of_larger_families_the_smaller_too(base: Fit, first: Round) -> None:
    trials = Search(base.response.records).trials(first)
    names = [t.name for t in trials]
    assert len(names) == len(set(names))
    assert "coulomb" in names
    assert not {"viscous", "back_emf"} <= set(names)
    assert "back_emf" not in names, "viscous friction stands for both"
    for t in trials:
        assert t.fit.horizon == base.horizon
        assert t.fit.solution.lin.cost <= base.solution.lin.cost + NEGLIGIBLE


def test_merit_weighs_fit_against_numbers(base: Fit, mended: Fit, first: Round) -> None:
    bare, better = (Trial("", f, first.scores["coulomb"], 0.0) for f in (base, mended))
    for variance in (1.0, mended.variance):
        saved = 2.0 * (base.solution.lin.cost - mended.solution.lin.cost) / variance
        price = math.log(mended.degrees) + 2.0 * (math.log(mended.degrees) - math.log(base.degrees))
        assert better.merit(variance) - bare.merit(variance) == pytest.approx(saved - price)


def test_twins_are_alike_and_relatives_are_not(first: Round) -> None:
    scores = first.scores
    assert twins(scores["viscous"], scores["back_emf"])
    assert twins(scores["tilt"], scores["angle_offset"])
    assert not twins(scores["viscous"], scores["asymmetric_viscous"]), "one has more numbers"
    assert not twins(scores["stribeck"], scores["asymmetric_coulomb"]), "they share Coulomb's friction only"
    assert not twins(scores["coulomb"], scores["viscous"])


def test_effects_that_explain_unequally_are_not_alike(base: Fit, mended: Fit, first: Round) -> None:
    viscous = extend(base, first.scores["viscous"])
    a, b = (Trial("", f, first.scores["viscous"], 0.0) for f in (mended, viscous))
    assert not alike(a, b, mended.variance)
    assert alike(a, a, mended.variance)


# the loop ----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def pair() -> tuple[tuple[Effect, ...], Search, Fit]:
    """What was hidden, the search, and where it ended."""
    hidden = (Ripple(a=0.06, b=0.03, order=5.0), Delay(T=0.05))
    search = Search(logs(rod(*hidden)))
    return hidden, search, search.run(longest(list(search.records)))


def test_both_members_of_a_pair_are_found(pair: tuple[tuple[Effect, ...], Search, Fit]) -> None:
    hidden, search, end = pair
    assert found(search) == {e.name for e in hidden}
    assert {e.name for e in end.model.effects} == found(search)
    assert math.isinf(end.horizon)
    assert not search.rounds[-1].left
    assert abs(math.sqrt(end.variance) - 1.0) < 0.08
    assert all(a.p_value < 0.05 for a in search.additions)
    assert len(search.rounds) <= MOST_STEPS + 1
    for e in hidden:
        for k, p in e.parameters.items():
            at = end.names.index(f"{e.name}.{k}")
            assert abs(end.solution.p[at] - p.value) < 5.0 * math.sqrt(end.covariance[at, at])


def test_an_idle_addition_is_dropped(pair: tuple[tuple[Effect, ...], Search, Fit]) -> None:
    """As if drag had been added while something else was still unknown."""
    hidden, search, end = pair
    again = Search(search.records, (*found(search), "drag"), rounds=[search.rounds[0]])
    drag = extend(end, screen(end, ("drag",))[0]["drag"])
    again.additions = [*search.additions, Addition("drag", (), (), 0.01, drag)]
    last = again.run(drag)
    assert found(again) == {e.name for e in hidden}
    assert last.solution.lin.cost == pytest.approx(end.solution.lin.cost, rel=1e-3)


def test_nothing_hidden_nothing_found() -> None:
    records = logs(rod(), 7)
    base = longest(records)
    search = Search(records)
    assert search.run(base) is base
    assert not search.additions
    assert len(search.rounds) == 1


def test_only_what_is_allowed_is_used() -> None:
    search = Search(logs(rod(Drag(c=0.02)), n=3), ("tilt", "delay"))
    search.run(longest(list(search.records)))
    assert found(search) <= {"tilt", "delay"}
    assert search.rounds[-1].left, "a drag that is not allowed was explained"
    assert search.rounds[-1].structured[0] in ("theta_dot", "theta+theta_dot")


def test_an_effect_that_the_model_has_is_not_found_again(rubbing: list[Record]) -> None:
    model = rod(Coulomb(tau_c=0.01))
    search = Search(rubbing)
    end = search.run(fit_longest(model, (*PLANT, "coulomb.tau_c"), rubbing, SENSOR, lead=LEAD))
    assert not search.additions
    assert end.model.parameters["coulomb.tau_c"].value == pytest.approx(0.2, rel=0.03)


def test_a_fixed_number_stays_fixed(rubbing: list[Record]) -> None:
    search = Search(rubbing, ("coulomb", "viscous", "tilt"))
    end = search.run(fit_longest(rod(), ("l",), rubbing, SENSOR, lead=LEAD))
    assert end.model.parameters["m"].value == 1.0
    assert found(search) == {"coulomb"}


def test_the_same_search_again(rubbing: list[Record], base: Fit) -> None:
    one, other = (Search(rubbing, ("coulomb", "viscous", "tilt", "stribeck")) for _ in range(2))
    ends = [s.run(base) for s in (one, other)]
    np.testing.assert_array_equal(ends[0].solution.p, ends[1].solution.p)
    assert [a.name for a in one.additions] == [a.name for a in other.additions] == ["coulomb"]
    assert one.rounds[0].adjusted == other.rounds[0].adjusted


def test_lead_in_is_the_same_all_along(base: Fit, mended: Fit) -> None:
    """Costs compare only where the same readings are scored."""
    for fit in (base, mended, reduce_by(mended, "coulomb"), at_horizon(grow(mended), base.horizon)):
        assert [w.lead for w in fit.response.windows] == [w.lead for w in base.response.windows]
        np.testing.assert_array_equal(fit.response.n_readings, base.response.n_readings)


def late() -> Fit:
    """The bare rod on logs of one whose drive is three samples and a bit late: more than a stamp can be."""
    rng, sensor = np.random.default_rng(0), Sensor(0.01, 1.0)
    model = Model(RodPendulum(m=2.0, l=1.5, g=10.0), (Delay(T=0.155),), dt=0.05)
    records = simulate(model, rng.uniform(-2.0, 2.0, (6, 200)), rng.uniform(-math.pi, math.pi, 6), np.zeros(6))
    bare = Model(RodPendulum(g=10.0), dt=0.05)
    return fit_longest(bare, PLANT, records.measure(sensor, rng), sensor, lead=LEAD)


def added(fit: Fit, name: str) -> Fit:
    return grow(extend(fit, screen(fit, (name,))[0][name]))


def test_a_stamp_that_cannot_be_late_enough_is_confined() -> None:
    """Its bound is one sample; the delay beside it ends where its own bounds do not matter."""
    bare = late()
    scores = screen(bare, ("stamp", "delay"))[0]
    stamp, delay = (Trial(name, extend(bare, scores[name]), scores[name], 0.01) for name in ("stamp", "delay"))
    assert confined(stamp) and not confined(delay)


def test_an_addition_that_a_later_one_makes_idle_is_dropped() -> None:
    """A late sensor was named first. Beside the late drive it is idle, though the covariance says that it is not."""
    bare, names = late(), ("delay", "sensor_delay")
    both = added(added(bare, "sensor_delay"), "delay")
    assert holds(both, "sensor_delay") and holds(both, "delay")
    search = Search(bare.response.records, names, rounds=[Round.of(bare, names)])
    search.additions = [Addition(name, (), (), 1e-9, both) for name in ("sensor_delay", "delay")]
    search.run(both)
    assert found(search) == {"delay"}


def test_no_candidate_is_fitted_twice_in_a_round() -> None:
    """Nor where the one that stands for a class is confined and the others are tried, too."""
    bare = late()
    tried = [t.name for t in Search(bare.response.records).trials(Round.of(bare, None))]
    assert {"stamp", "delay"} <= set(tried) and len(set(tried)) == len(tried)

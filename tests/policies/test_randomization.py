"""Each episode's parameters come from the stated distribution and never leave the bounds."""

import json

import numpy as np
import pytest

from policies.environments.randomization import (
    Band,
    Fixed,
    Mixture,
    Posterior,
    RandomForce,
    Ranges,
    SingleEffect,
    from_json,
)
from study.paper.protocol import paper_model
from sysid import Coulomb, Delay, InvalidInput, Model, RodPendulum, Tilt

MODEL = paper_model()
DRAWS = 4000


def draws(randomization, seed=0, model=MODEL):
    rng = np.random.default_rng(seed)
    samples = [randomization.sample(rng, model) for _ in range(DRAWS)]
    return {name: np.array([s[name] for s in samples]) for name in samples[0]}


def test_no_width_trains_at_the_centre_alone():
    assert Ranges.of(MODEL, ("m", "l")).sample(np.random.default_rng(0), MODEL).keys() == {"m", "l"}
    assert Band({"m": 2.0, "l": 1.5}).sample(np.random.default_rng(0), MODEL) == {"m": 2.0, "l": 1.5}


@pytest.mark.parametrize(
    ("randomization", "ranges"),
    [
        (Band({"m": 2.0, "l": 1.5}, w=0.3), {"m": (1.4, 2.6), "l": (1.05, 1.95)}),
        (Ranges.of(MODEL, ("m", "l")), {"m": (0.3, 3.0), "l": (0.3, 3.0)}),
    ],
)
def test_parameters_are_uniform_and_independent(randomization, ranges):
    drawn = draws(randomization)
    for name, (low, high) in ranges.items():
        unit = (drawn[name] - low) / (high - low)
        assert 0.0 <= unit.min() < 0.01 and 0.99 < unit.max() <= 1.0
        np.testing.assert_allclose(np.histogram(unit, 5, (0.0, 1.0))[0] / DRAWS, 0.2, atol=0.03)
    assert abs(np.corrcoef(drawn["m"], drawn["l"])[0, 1]) < 0.06


def test_the_sample_is_clipped_not_the_interval():
    m = draws(Band({"m": 2.8, "l": 0.4}, w=0.5))
    beyond = (2.8 * 1.5 - 3.0) / 2.8
    assert np.mean(m["m"] == 3.0) == pytest.approx(beyond, abs=0.03)
    assert np.mean(m["l"] == 0.3) == pytest.approx((0.3 - 0.2) / 0.4, abs=0.03)
    assert m["m"].max() == 3.0 and m["l"].min() == 0.3


def test_a_band_around_a_negative_number_is_as_wide_as_around_a_positive_one():
    model = Model(RodPendulum(), (Tilt(alpha=-0.2),))
    alpha = draws(Band({"tilt.alpha": -0.2}, 0.5), model=model)["tilt.alpha"]
    assert -0.3 <= alpha.min() < -0.299 and -0.101 < alpha.max() <= -0.1


def test_nothing_is_drawn_from_a_fixed_model():
    rng = np.random.default_rng(0)
    assert Fixed().sample(rng, MODEL) == {}
    assert rng.random() == np.random.default_rng(0).random()


def test_ranges_are_uniform_within_the_bounds():
    drawn = draws(Ranges({"m": (0.5, 0.7), "l": (2.5, 3.5)}))
    assert 0.5 <= drawn["m"].min() < 0.501 and 0.699 < drawn["m"].max() <= 0.7
    assert np.mean(drawn["l"] == 3.0) == pytest.approx(0.5, abs=0.04)


COVARIANCE = ((0.04, -0.012), (-0.012, 0.0049))


def test_a_posterior_has_the_mean_and_the_covariance_of_the_fit():
    drawn = draws(Posterior(("m", "l"), (1.5, 1.2), COVARIANCE))
    sample = np.stack([drawn["m"], drawn["l"]])
    np.testing.assert_allclose(sample.mean(1), (1.5, 1.2), atol=4.0 * 0.2 / DRAWS**0.5)
    np.testing.assert_allclose(np.cov(sample), COVARIANCE, rtol=0.1)
    unit = (drawn["m"] - 1.5) / 0.2
    assert np.mean(np.abs(unit) < 1.0) == pytest.approx(0.683, abs=0.03)


def test_a_posterior_keeps_a_combination_that_the_fit_knows_exactly():
    drawn = draws(Posterior(("m", "l"), (1.5, 1.2), ((0.01, 0.001), (0.001, 0.0001))))
    np.testing.assert_allclose(drawn["m"] - 1.5, 10.0 * (drawn["l"] - 1.2), atol=1e-7)
    assert drawn["m"].std() == pytest.approx(0.1, rel=0.1)


def test_a_posterior_stays_within_the_bounds_and_units_may_lie_decades_apart():
    drawn = draws(Posterior(("m", "l"), (2.9, 1.0), ((0.04, 0.0), (0.0, 1e-16))))
    assert drawn["m"].max() == 3.0 and np.mean(drawn["m"] == 3.0) == pytest.approx(0.309, abs=0.03)
    assert drawn["l"].std() == pytest.approx(1e-8, rel=0.1)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((("m", "l"), (1.0, 1.0), ((np.inf, 0.0), (0.0, 1.0))), "leaves m open"),
        ((("m",), (1.0, 1.0), ((1.0,),)), "expected as many"),
        (((), (), ()), "expected as many"),
        ((("m",), (1.0,), ((-1.0,),)), "not symmetric with variances >= 0"),
        ((("m", "l"), (1.0, 1.0), ((1.0, 0.5), (0.1, 1.0))), "not symmetric"),
    ],
)
def test_what_is_no_covariance_is_refused(arguments, message):
    with pytest.raises(InvalidInput, match=message):
        Posterior(*arguments)


def test_ranges_that_mean_nothing_are_refused():
    for ends in ((2.0, 1.0), (0.0, np.inf), (np.nan, 1.0)):
        with pytest.raises(InvalidInput, match="range of m"):
            Ranges({"m": ends})
    with pytest.raises(InvalidInput, match="unknown parameter 'mass'"):
        Ranges.of(MODEL, ("mass",))


@pytest.mark.parametrize(
    "unknown",
    [
        Band({"mass": 1.0}),
        Ranges({"mass": (1.0, 2.0)}),
        Posterior(("mass",), (1.0,), ((1.0,),)),
        Mixture(({"mass": 1.0},)),
    ],
    ids=lambda r: type(r).__name__,
)
def test_a_name_that_the_model_does_not_have_is_refused(unknown):
    with pytest.raises(InvalidInput, match="unknown parameter 'mass'"):
        unknown.sample(np.random.default_rng(0), MODEL)


@pytest.mark.parametrize("w", [-0.1, 1.0, float("nan")])
def test_a_width_that_means_nothing_is_refused(w):
    with pytest.raises(InvalidInput, match="w = "):
        Band({"m": 1.0}, w)


def test_bad_centres_are_refused():
    with pytest.raises(InvalidInput, match="no centre"):
        Band({})
    with pytest.raises(InvalidInput, match="centre of l"):
        Band({"l": float("nan")})


EITHER = (
    {"coulomb.tau_c": 1.5, "delay.T": 0.0},
    {"delay.T": 0.13, "coulomb.tau_c": 0.0},
    {"coulomb.tau_c": 0.8, "delay.T": 9.0},
)
UNSURE = Model(RodPendulum(), (Coulomb(), Delay()), u_max=2.0)


def test_one_of_takes_each_alternative_about_equally_often_and_whole():
    drawn = draws(Mixture(EITHER), model=UNSURE)
    pairs = list(zip(drawn["coulomb.tau_c"].tolist(), drawn["delay.T"].tolist(), strict=True))
    expected = {(1.5, 0.0), (0.0, 0.13), (0.8, Delay().longest)}  # the last is clipped to its bound
    assert set(pairs) == expected
    for pair in expected:
        assert pairs.count(pair) / DRAWS == pytest.approx(1.0 / 3.0, abs=4.0 * (2.0 / 9.0 / DRAWS) ** 0.5)


def test_one_alternative_is_what_is_always_drawn_and_names_come_in_one_order():
    rng = np.random.default_rng(0)
    assert Mixture(EITHER[1:2]).sample(rng, UNSURE) == EITHER[1]
    assert {tuple(Mixture(EITHER).sample(rng, UNSURE)) for _ in range(20)} == {("coulomb.tau_c", "delay.T")}


@pytest.mark.parametrize(
    ("alternatives", "message"),
    [
        ((), "expected at least one"),
        (({},), "expected at least one"),
        ({"m": 1.0}, "expected at least one"),
        (({"m": 1.0}, {"m": 1.0, "l": 1.0}), "has m, l: expected m in each"),
        (({"m": 1.0}, {"m": np.nan}), "has m = nan"),
    ],
)
def test_alternatives_that_mean_nothing_are_refused(alternatives, message):
    with pytest.raises(InvalidInput, match=message):
        Mixture(alternatives)


def test_one_at_a_time_draws_none_or_one_kind_each_as_often_and_leaves_the_rest_neutral():
    kinds = ({"coulomb.tau_c": (0.5, 1.5)}, {"delay.T": (0.1, 0.3)})
    drawn = draws(SingleEffect({"m": (0.5, 2.5)}, kinds, {"coulomb.tau_c": 0.0, "delay.T": 0.0}), model=UNSURE)
    rubs, late = drawn["coulomb.tau_c"] > 0.0, drawn["delay.T"] > 0.0
    assert not np.any(rubs & late)
    for share in (rubs.mean(), late.mean(), (~rubs & ~late).mean()):
        assert share == pytest.approx(1.0 / 3.0, abs=4.0 * (2.0 / 9.0 / DRAWS) ** 0.5)
    assert drawn["coulomb.tau_c"][rubs].min() >= 0.5 and drawn["m"].mean() == pytest.approx(1.5, abs=0.05)
    with pytest.raises(InvalidInput, match=r"delay\.T has no neutral number"):
        SingleEffect({}, kinds, {"coulomb.tau_c": 0.0})


@pytest.mark.parametrize(("s", "T"), [(0.5, 0.0), (1.2, 0.08), (0.3, 0.4)])
def test_random_torques_are_stationary_with_the_stated_sd_and_memory(s, T):
    episodes, steps, dt = 4000, 30, 0.05
    rng, forced = np.random.default_rng(1), RandomForce(Fixed(), s, T)
    d = np.stack([forced.torques(rng, steps, dt) for _ in range(episodes)])
    assert d.shape == (episodes, steps)
    error = episodes**-0.5
    np.testing.assert_allclose(d.mean(0), 0.0, atol=5.0 * s * error)
    np.testing.assert_allclose(d.std(0), s, rtol=5.0 * error / 2.0**0.5)
    for lag in (1, 2, 5):
        rho = np.exp(-lag * dt / T) if T > 0.0 else 0.0
        correlation = [np.corrcoef(d[:, k], d[:, k + lag])[0, 1] for k in range(steps - lag)]
        np.testing.assert_allclose(correlation, rho, atol=5.0 * error)


def test_random_torques_of_a_finer_interval_are_the_same_process():
    """Every fourth torque at dt / 4 has the correlation of neighbours at dt."""
    rng, forced = np.random.default_rng(2), RandomForce(Fixed(), 1.0, 0.1)
    fine = forced.torques(rng, 80_000, 0.0125)[::4]
    assert np.corrcoef(fine[:-1], fine[1:])[0, 1] == pytest.approx(np.exp(-0.5), abs=0.03)


@pytest.mark.parametrize("number", [-0.1, np.inf, np.nan])
def test_a_random_force_that_means_nothing_is_refused(number):
    with pytest.raises(InvalidInput, match="s = "):
        RandomForce(Fixed(), number, 0.1)
    with pytest.raises(InvalidInput, match="T = "):
        RandomForce(Fixed(), 0.1, number)
    for inner in (None, RandomForce(Fixed(), 1.0, 0.0)):
        with pytest.raises(InvalidInput, match="without a random force"):
            RandomForce(inner, 0.1, 0.1)


@pytest.mark.parametrize(
    "randomization",
    [
        Fixed(),
        Band({"m": 2.0}, 0.1),
        Ranges({"m": (1, 2)}),
        Posterior(("m", "l"), (1.5, 1.2), np.array(COVARIANCE)),
        Mixture(EITHER),
        SingleEffect({"m": (0.3, 3.0)}, ({"coulomb.tau_c": (0.0, 1.5)},), {"coulomb.tau_c": 0.0}),
        RandomForce(Mixture(EITHER), 0.5, 0.1),
    ],
    ids=lambda r: type(r).__name__,
)
def test_every_kind_comes_back_from_plain_data(randomization):
    assert from_json(json.loads(json.dumps(randomization.to_json()))) == randomization


@pytest.mark.parametrize(
    "data", [{}, {"kind": "Bend"}, {"kind": "Band", "w": 0.1}, {"kind": "RandomForce", "inner": {}}]
)
def test_other_data_is_no_randomization(data):
    with pytest.raises(InvalidInput):
        from_json(data)

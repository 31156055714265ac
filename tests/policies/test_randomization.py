"""Each episode's parameters come from the stated distribution and never leave the bounds."""

import json

import numpy as np
import pytest

from policies.randomization import Band, PriorRange
from sysid import InvalidInput, paper_model

MODEL = paper_model()
DRAWS = 4000


def draws(randomization, seed=0):
    rng = np.random.default_rng(seed)
    samples = [randomization.sample(rng, MODEL) for _ in range(DRAWS)]
    return {name: np.array([s[name] for s in samples]) for name in samples[0]}


def test_no_width_trains_at_the_centre_alone():
    assert PriorRange().sample(np.random.default_rng(0), MODEL).keys() == {"m", "l"}
    assert Band({"m": 2.0, "l": 1.5}).sample(np.random.default_rng(0), MODEL) == {"m": 2.0, "l": 1.5}


def test_band_is_uniform_and_its_parameters_are_independent():
    drawn = draws(Band({"m": 2.0, "l": 1.5}, w=0.3))
    for name, center in (("m", 2.0), ("l", 1.5)):
        unit = (drawn[name] / center - 0.7) / 0.6
        assert 0.0 <= unit.min() < 0.01 and 0.99 < unit.max() <= 1.0
        np.testing.assert_allclose(np.histogram(unit, 5, (0.0, 1.0))[0] / DRAWS, 0.2, atol=0.03)
    assert abs(np.corrcoef(drawn["m"], drawn["l"])[0, 1]) < 0.06


def test_the_sample_is_clipped_not_the_interval():
    m = draws(Band({"m": 2.8, "l": 0.4}, w=0.5))
    beyond = (2.8 * 1.5 - 3.0) / 2.8
    assert np.mean(m["m"] == 3.0) == pytest.approx(beyond, abs=0.03)
    assert np.mean(m["l"] == 0.3) == pytest.approx((0.3 - 0.2) / 0.4, abs=0.03)
    assert m["m"].max() == 3.0 and m["l"].min() == 0.3


def test_prior_range_covers_the_bounds():
    drawn = draws(PriorRange())
    for name in ("m", "l"):
        unit = (drawn[name] - 0.3) / 2.7
        np.testing.assert_allclose(np.histogram(unit, 5, (0.0, 1.0))[0] / DRAWS, 0.2, atol=0.03)


def test_it_is_plain_data():
    assert json.loads(json.dumps(Band({"m": 2.0}, 0.1).to_json())) == {"kind": "Band", "center": {"m": 2.0}, "w": 0.1}
    assert json.loads(json.dumps(PriorRange().to_json())) == {"kind": "PriorRange", "names": ["m", "l"]}


@pytest.mark.parametrize("w", [-0.1, 1.0, float("nan")])
def test_a_width_that_means_nothing_is_refused(w):
    with pytest.raises(InvalidInput, match="w = "):
        Band({"m": 1.0}, w)


def test_bad_centres_and_names_are_refused():
    rng = np.random.default_rng(0)
    with pytest.raises(InvalidInput, match="no centre"):
        Band({})
    with pytest.raises(InvalidInput, match="centre of l"):
        Band({"l": float("nan")})
    with pytest.raises(InvalidInput, match="mass"):
        Band({"mass": 1.0}).sample(rng, MODEL)
    with pytest.raises(InvalidInput, match="mass"):
        PriorRange(("mass",)).sample(rng, MODEL)

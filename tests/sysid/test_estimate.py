"""Estimate: intervals, what cannot be told, and plain data."""

import json

import numpy as np
import pytest
from scipy.stats import norm

from sysid import Estimate, LinearAxis, Model, RodPendulum, Viscous


def estimate(covariance, **changes):
    model = Model(RodPendulum(m=2.0, l=1.5), (Viscous(b=0.1),))
    settings = {
        "model": model,
        "names": ("m", "viscous.b"),
        "covariance": np.array(covariance, dtype=float),
        "noise": {"theta_dot": 1.02},
        "success": True,
        "status": "converged",
        "cost": 12.0,
        "n_readings": 400,
        "method": "by hand",
    }
    return Estimate(**(settings | changes))


def test_values_and_sds_go_by_name():
    e = estimate([[0.04, 0.0], [0.0, 1e-4]])
    assert e.values == {"m": 2.0, "viscous.b": 0.1}
    assert e.sd == pytest.approx({"m": 0.2, "viscous.b": 0.01})


@pytest.mark.parametrize("level", [0.5, 0.95, 0.999])
def test_intervals_cover_at_their_level(level):
    low, high = estimate([[0.04, 0.0], [0.0, 1e-4]]).interval(level)["m"]
    assert norm.cdf(high, 2.0, 0.2) - norm.cdf(low, 2.0, 0.2) == pytest.approx(level)


SCALES = np.array([estimate(np.eye(2)).model.parameters[n].scale for n in ("m", "viscous.b")])


@pytest.mark.parametrize(
    ("covariance", "sentences"),
    [
        ([[1e-4, 0.0], [0.0, 1e-6]], ()),
        ([[9.0, 0.0], [0.0, 1e-6]], ("m is poorly determined by these records",)),
        (
            4.0 * np.outer(SCALES, SCALES) * [[1.0, 0.9999], [0.9999, 1.0]],
            ("m and viscous.b cannot be told apart by these records",),
        ),
        (np.full((2, 2), np.inf), ("the records do not determine these parameters: m, viscous.b",)),
    ],
    ids=["sharp", "one poorly", "together", "nothing"],
)
def test_what_the_records_do_not_determine_is_named(covariance, sentences):
    assert estimate(covariance).ambiguous == sentences


def test_a_value_at_its_bound_is_told():
    bound = Model(RodPendulum(m=1e3, l=1.5), (Viscous(b=0.1),))
    assert estimate(np.eye(2), model=bound).at_bound == ("m",)
    assert "(at its bound)" in str(estimate(np.eye(2), model=bound))


def test_it_turns_into_json_and_prints_its_numbers():
    e = estimate([[0.04, 0.0], [0.0, 1e-4]])
    back = json.loads(json.dumps(e.to_dict()))
    assert back["values"] == e.values and back["sd"] == e.sd and back["status"] == "converged"
    text = str(e)
    for part in ("by hand: converged", "m         = 2 +- 0.2 kg", "viscous.b = 0.1 +- 0.01 N m s/rad", "400 readings"):
        assert part in text


def test_an_axis_has_its_own_units_and_the_plus_minus_is_explained_once():
    axis = estimate(np.diag([0.04, 1e-4]), model=Model(LinearAxis(m=2.0), (Viscous(b=0.1),)))
    text = str(axis)
    assert "viscous.b = 0.1 +- 0.01 N s/m" in text and "theta_dot 1.02 m/s" in text and "rad" not in text
    assert text.count("+- is one standard deviation") == 1
    assert axis.to_dict()["units"] == {"m": "kg", "viscous.b": "N s/m", "theta_dot": "m/s"}
    rod = estimate(np.diag([0.04, 1e-4]))
    assert rod.to_dict()["units"] == {"m": "kg", "viscous.b": "N m s/rad", "theta_dot": "rad/s"}

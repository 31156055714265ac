"""Friction that predictions show where likelihood does not is found, and nothing else is taken for it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from sysid import RK4, DCMotor, Effect, GeneralJoint, Lag, Model, Sensor, effect, simulate, split
from sysid.diagnosis.explanation import Evidence, Explanation
from sysid.diagnosis.hidden_friction import hidden_friction
from sysid.diagnosis.search import Search
from sysid.estimation.first_fit import first_fit
from sysid.estimation.linearisation import Samples
from sysid.estimation.torque_regression import FrictionAlong
from sysid.physics.ops import Array

DT, SENSOR = 0.02, Sensor(theta=2e-3)
MOTOR = Model(GeneralJoint(J=0.02, G=0.0), (DCMotor(k=1.0, k_e=0.5),), RK4(substeps=2), DT)
NAMES = ("J", "dc_motor.k_e")
SAG = 0.25
"""Share by which the supply sags under full command, over seconds: no effect of the catalogue is like that."""


def sagging(u: Array, share: float) -> Array:
    """Commands (N,) [V] as a tired supply passes them on: it sags by a share, and recovers over 1.5 s."""
    level, passed = 0.0, np.empty_like(u)
    for k, command in enumerate(u):
        level += DT / 1.5 * (abs(command) / 6.0 - level)
        passed[k] = command * (1.0 - share * level)
    return passed


@cache
def bare(*hidden: Effect, seed: int = 0, sag: float = SAG) -> Explanation:
    """The plain motor on a log of one with hidden effects, whose supply sags."""
    rng, machine = np.random.default_rng(seed), MOTOR
    u = np.repeat(rng.uniform(-6.0, 6.0, 40), 30)
    for one in hidden:
        machine = machine.with_effect(one)
    record = replace(SENSOR.measure(simulate(machine, sagging(u, sag), 0.0, 0.0), rng)[0], u=u)
    fitted, held_out = split([record])
    search, base = Search(fitted, SENSOR), first_fit(Samples(MOTOR, fitted, SENSOR), MOTOR, NAMES)
    search.first = search.last = search.tested(base)
    return Explanation(Evidence(search, base, held_out, (), SENSOR), (), base)


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(
    "numbers", [{"coulomb.tau_c": 0.5}, {"coulomb.tau_c": 0.5, "torque_bias.tau_0": 0.25}], ids=len
)
def test_dry_friction_and_an_offset_are_found_beside_something_unknown(numbers: dict[str, float], seed: int) -> None:
    hidden = tuple(effect(name.split(".")[0], **{name.split(".")[1]: value}) for name, value in numbers.items())
    found = hidden_friction(bare(*hidden, seed=seed))
    assert found is not None and found.names == tuple(sorted(e.name for e in hidden))
    sd = np.sqrt(np.diag(found.fit.covariance))
    for name, true in numbers.items():
        i = found.fit.names.index(name)
        assert abs(found.fit.values[i] - true) < 4.0 * sd[i] < true


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("hidden", [(), (Lag(T=0.1),)])
def test_what_is_unknown_or_late_is_no_friction(hidden: tuple[Effect, ...], seed: int) -> None:
    own = bare(*hidden, seed=seed)
    assert own.remains and own.error.ratio > 1.1, "nothing is missing: the law says nothing"
    assert hidden_friction(own) is None


def test_nothing_hides_in_a_motion_that_the_model_explains() -> None:
    own = bare(sag=0.0)
    assert own.remaining is None and hidden_friction(own) is None


def test_friction_along_a_motion_takes_no_place_of_a_dry_friction_that_it_lacks() -> None:
    """Though its inertia is another, and it leaves next to nothing of the torque."""
    found = hidden_friction(bare(effect("coulomb", tau_c=0.5)))
    assert found is not None
    along = FrictionAlong((0.5, 0.01), (0.5, 0.02), (0.0, 0.01), (0.005, 1e-4), share=1.0 - 1e-9)
    assert found.leaves_more_than(along)
    assert not found.leaves_more_than(replace(along, coulomb=(0.02, 0.02)))

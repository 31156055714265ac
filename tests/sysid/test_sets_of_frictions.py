"""All sets of common frictions are compared in the end: the likeliest is named, and those about as likely are told."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sysid import Record, diagnose, effect, simulate
from sysid.data.splitting import split
from sysid.diagnosis.answer import Alternative
from sysid.diagnosis.confirmation import Confirmation
from sysid.diagnosis.explanation import Evidence
from sysid.diagnosis.search import Search
from sysid.report.write import page_of
from tests.sysid.planted import logs, rod, truth, with_memory
from tests.sysid.test_energy_balance import JOINT, SENSOR, SIZES, damped, swing


def confirmed(record: Record, *first: str) -> Confirmation:
    """The confirmation of a search that knew no other effects than the `first`."""
    fitted, held_out = split([record], None)
    search = Search(fitted, SENSOR, first)
    base, _ = search.run(JOINT, ("G",))
    search.effects = None
    search.first = search.tested(base)
    return Confirmation(Evidence(search, base, held_out, (), SENSOR))


@pytest.mark.parametrize(
    ("planted", "first"),
    [(("coulomb", "viscous"), "coulomb"), (("coulomb", "viscous"), "viscous"), (("coulomb", "drag"), "coulomb")],
)
def test_a_pair_that_explains_more_takes_the_place_of_the_friction_that_was_found(
    planted: tuple[str, ...], first: str
) -> None:
    """The scale of the angle is uneven by 10 mrad, which a random torque stands for."""
    found = confirmed(swing(damped(*planted), scale=0.01), first)
    assert first in {a.name for additions, _ in found.evidence.search.stages for a in additions}
    assert {a.name for a in found.additions} == set(planted)
    values, sd = found.now.fit.estimate().values, found.now.fit.estimate().sd
    for name, size in values.items():
        if name != "G":
            assert abs(size - SIZES[name.partition(".")[0]]) < 3.0 * sd[name]
    assert not set(found.unconfirmed) & set(planted)


@pytest.mark.parametrize("planted", ["coulomb", "viscous", "drag"])
def test_a_free_swing_for_which_no_friction_was_found_has_the_one_that_it_shows(planted: str) -> None:
    found = confirmed(swing(damped(planted), torque=0.02), "tilt")
    assert not any(additions for additions, _ in found.evidence.search.stages)
    assert [a.name for a in found.additions] == [planted]


def test_frictions_that_a_log_cannot_tell_from_those_named_are_told() -> None:
    """20 s of a swing beside a random torque that is as large as its dry friction."""
    rng, N = np.random.default_rng(1), 1000
    d = with_memory(0.05 * rng.standard_normal((1, N)), 0.3)
    run = simulate(damped("coulomb", "drag"), d, np.array([math.pi + 0.5]), np.zeros(1))
    record = Record(run.t, np.zeros(N), run.theta[0] + 1e-3 * rng.standard_normal(N + 1))
    found = diagnose(JOINT, [record], SENSOR)
    assert [s.effect for s in found.steps] == ["viscous"]
    (other,) = found.alternatives
    assert (other.effects, other.instead) == (("coulomb", "drag"), ("viscous",))
    for name, numbers in other.parameters.items():
        (size,) = numbers.values()
        assert abs(size["value"] - SIZES[name]) < 3.0 * size["sd"]
    assert ", or coulomb and drag in place of viscous, explain " in found.finding
    assert any(said.endswith("explain the log as well as viscous") for said in found.remarks)
    assert other.sentence in page_of(found).lists["Other effects"]


def test_a_driven_log_that_is_explained_to_its_noise_has_no_other_frictions() -> None:
    found = diagnose(rod(), logs(truth(effect("coulomb", tau_c=0.1))), SENSOR)
    assert [s.effect for s in found.steps] == ["coulomb"] and not found.alternatives


def test_what_may_stand_beside_the_named_frictions_is_told_apart_from_what_may_replace_them() -> None:
    numbers = {"viscous": {}, "drag": {}, "coulomb": {}}
    more = Alternative(("viscous", "drag"), ("viscous",), numbers)
    others = Alternative(("coulomb", "drag"), ("viscous",), numbers)
    assert more.in_words == "perhaps with drag"
    assert others.in_words == "or coulomb and drag in place of viscous"

"""Refinements: an effect that contains another takes its place, in what is added and in what is found."""

from __future__ import annotations

import dataclasses
import json
import math
from typing import Any

import numpy as np
import pytest

import sysid
from sysid import Model, RodPendulum, diagnose, simulate
from sysid.diagnosis.search import Addition, Search, all_but, contained_in
from sysid.estimation.refits import extended
from sysid.estimation.solver import QUICK
from sysid.physics.effects import CATALOGUE
from tests.sysid.planted import DT, SENSOR, logs, rod, truth

SIMPLER: dict[tuple[str, str], tuple[dict[str, float], dict[str, float]]] = {
    ("asymmetric_viscous", "viscous"): ({"b_plus": 0.1, "b_minus": 0.1}, {"b": 0.1}),
    ("asymmetric_coulomb", "coulomb"): ({"tau_plus": 0.2, "tau_minus": 0.2}, {"tau_c": 0.2}),
    ("stribeck", "coulomb"): ({"tau_c": 0.2, "excess": 0.0}, {"tau_c": 0.2}),
    ("warming_friction", "coulomb"): ({"tau_c": 0.2, "excess": 0.0}, {"tau_c": 0.2}),
    ("dahl", "coulomb"): ({"tau_c": 0.2, "z_s": 1e-5}, {"tau_c": 0.2}),
    ("lugre", "coulomb"): ({"tau_c": 0.2, "z_s": 1e-5, "ratio": 1.0}, {"tau_c": 0.2}),
    ("lugre", "dahl"): ({"tau_c": 0.2, "z_s": 0.03, "ratio": 1.0}, {"tau_c": 0.2, "z_s": 0.03}),
    ("lugre", "stribeck"): (
        {"tau_c": 0.2, "z_s": 1e-5, "ratio": 1.5, "v_s": 0.3},
        {"tau_c": 0.2, "excess": 0.1, "v_s": 0.3},
    ),
    ("cubic_spring", "spring"): ({"k": 0.5, "k_3": 0.0}, {"k": 0.5}),
    ("directional_load_friction", "load_friction"): ({"mu": 0.2, "share": 0.5}, {"mu": 0.1}),
    ("torque_speed_limit", "saturation"): ({"limit": 1.0, "k": 0.0}, {"limit": 1.0}),
}
"""For each effect and one that it contains: the numbers with which it is that one."""
NUMBERS: dict[str, dict[str, float]] = {
    "asymmetric_viscous": {"b_plus": 0.02, "b_minus": 0.06},
    "stribeck": {"tau_c": 0.1, "excess": 0.15, "v_s": 0.3},
    "dahl": {"tau_c": 0.2, "z_s": 0.05},
}


def planted(name: str) -> list[sysid.Record]:
    return logs(truth(sysid.effect(name, **NUMBERS[name])), n=4)


def present(model: Model) -> set[str]:
    return {e.name for e in model.effects}


def assert_found(estimate: sysid.Estimate, name: str) -> None:
    for field, value in NUMBERS[name].items():
        sd = estimate.sd[f"{name}.{field}"]
        assert abs(estimate.values[f"{name}.{field}"] - value) < 4.0 * sd < math.inf, field


def test_each_containment_is_tried_here() -> None:
    declared = {(name, own) for name, kind in CATALOGUE.items() for own in kind.contains}
    assert declared == set(SIMPLER)
    assert all((own,) in CATALOGUE[name].refines for name, own in declared)


@pytest.mark.parametrize(("names", "numbers"), SIMPLER.items(), ids=map(" is ".join, SIMPLER))
def test_an_effect_is_what_it_contains_for_some_of_its_numbers(
    names: tuple[str, str], numbers: tuple[dict[str, float], dict[str, float]]
) -> None:
    u = 1.5 * np.sin(2.0 * math.pi * 0.4 * DT * np.arange(300))[None]
    effects = [sysid.effect(name, **own) for name, own in zip(names, numbers, strict=True)]
    one, other, without = (
        simulate(Model(RodPendulum(m=1.0, l=0.9), own, dt=DT), u, np.full(1, 2.6), np.zeros(1)).theta
        for own in (effects[:1], effects[1:], [])
    )
    assert np.max(np.abs(one - other)) < 0.02 * np.max(np.abs(one - without))


@pytest.mark.parametrize("name", NUMBERS)
def test_what_is_added_takes_the_place_of_what_it_contains(name: str) -> None:
    (own,) = CATALOGUE[name].contains
    added = sysid.add(rod(sysid.effect(own)), name, planted(name), SENSOR)
    assert present(added.estimate.model) == {name} and present(added.base.model) == {own}
    assert_found(added.estimate, name)
    assert f" in place of {own}: " in added.sentence
    assert added.after.ratio < 1.1 and added.after.ratio < added.before.ratio


def test_a_friction_whose_number_is_known_stays_beside_its_refinement() -> None:
    known = sysid.fit(rod(sysid.effect("viscous", b=0.02)), planted("asymmetric_viscous"), SENSOR, ("m", "l"))
    added = sysid.add(known, "asymmetric_viscous", planted("asymmetric_viscous"), SENSOR).estimate
    assert present(added.model) == {"viscous", "asymmetric_viscous"}
    assert added.values["asymmetric_viscous.b_minus"] == pytest.approx(0.04, abs=0.003)


@pytest.mark.parametrize("name", NUMBERS)
def test_a_model_with_the_simpler_effect_is_told_the_refinement(name: str) -> None:
    (own,) = CATALOGUE[name].contains
    found = diagnose(rod(sysid.effect(own)), planted(name), SENSOR)
    assert found.verdict == "missing" and [s.effect for s in found.steps] == [name], str(found)
    assert present(found.model) == {name}
    assert_found(found.estimate, name)
    assert f"+ {name} " in str(found) and f"in place of {own}" in str(found)


@pytest.mark.parametrize("name", NUMBERS)
def test_no_stage_of_a_search_has_an_effect_beside_one_that_contains_it(name: str) -> None:
    search = Search(planted(name), SENSOR)
    search.run(rod(), ("m", "l"))
    assert search.stages
    for additions, fit in search.stages:
        assert {a.name for a in additions} == present(fit.model)
        assert not present(fit.model) & contained_in(fit.model.effects)


def test_a_second_form_of_what_is_there_is_not_tested_but_what_contains_the_first_one_is() -> None:
    search = Search(planted("dahl"), SENSOR)
    _, end = search.run(rod(), ("m", "l"))
    assert present(end.model) == {"dahl"}
    tested = set(search.tested(end))
    assert {"lugre", "viscous", "load_friction"} <= tested
    assert not {"dahl", "coulomb", "stribeck", "warming_friction", "asymmetric_coulomb"} & tested


def test_what_a_refinement_replaced_comes_back_without_it() -> None:
    search = Search(planted("dahl"), SENSOR)
    _, end = search.run(rod(), ("m", "l"))
    (dahl,) = (a for a in search.additions if a.name == "dahl")
    coulomb = Addition("coulomb", (), (), 0.0)
    beside = dataclasses.replace(dahl, replaced=(coulomb,))
    assert all_but(beside, [beside]) == [coulomb]
    assert present(search.without(end, beside, [coulomb]).model) == {"coulomb"}
    assert present(search.without(end, beside).model) == set()


def test_what_another_effect_contains_is_no_simpler_form_of_a_second_one() -> None:
    """Warming friction is dry friction, which one that gives before it slides is, too."""
    search = Search(planted("dahl"), SENSOR)
    _, end = search.run(rod(), ("m", "l"))
    both = extended(end, [sysid.effect("warming_friction", tau_c=0.02, excess=0.05)], QUICK)
    forms = [new for new, _ in search.simpler_forms(both, Addition("warming_friction", (), (), 0.0))]
    assert forms and not any("coulomb" in new for new in forms)


def test_a_model_that_has_the_right_friction_keeps_it() -> None:
    found = diagnose(rod(sysid.effect("coulomb")), logs(truth(sysid.effect("coulomb", tau_c=0.1))), SENSOR)
    assert found.verdict == "adequate" and present(found.model) == {"coulomb"}


def test_a_pair_is_told_with_the_refinement_that_does_as_well() -> None:
    """Dry friction that depends on the direction is, in a joint that moves, a symmetric one with an offset."""
    hidden: dict[str, Any] = {"tau_plus": 0.03, "tau_minus": 0.08}
    found = diagnose(rod(), logs(truth(sysid.effect("asymmetric_coulomb", **hidden))), SENSOR)
    assert {s.effect for s in found.steps} == {"coulomb", "torque_bias"}
    (other,) = found.alternatives
    assert (other.effects, other.instead) == (("asymmetric_coulomb",), ("coulomb", "torque_bias"))
    for field, value in hidden.items():
        told = other.parameters["asymmetric_coulomb"][f"asymmetric_coulomb.{field}"]
        assert abs(told["value"] - value) < 4.0 * told["sd"]
    assert "explains the log as well as coulomb and torque_bias" in str(found)
    (plain,) = found.to_dict()["alternatives"]
    assert plain == json.loads(json.dumps(dataclasses.asdict(other)))

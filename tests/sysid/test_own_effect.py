"""An effect out of a formula: what is understood, what is refused, and that it means what it says."""

from __future__ import annotations

import ast
import dataclasses

import numpy as np
import pytest

import sysid
from sysid.errors import InvalidInput
from sysid.physics.effects import CATALOGUE
from sysid.web.own_effect import OwnEffect, parsed_formula, suggested, value


@pytest.mark.parametrize(
    "formula",
    [
        "__import__('os').system('true')",
        "().__class__",
        "theta.__class__",
        "a[0]",
        "[a for a in theta]",
        "(lambda: 1)()",
        "a if theta else b",
        "a ** b",
        "9 ** 9 ** 9",
        "a * theta ** 9",
        "a * 1e300",
        "a * 'x'",
        "a * True",
        "f'{a}'",
        "eval(a)",
        "sin(theta, theta)",
        "sin(x=theta)",
        "a := 1",
        "a * -" + "-" * 60 + "theta",
        "a * " + "(" * 220 + "theta" + ")" * 220,
        "a * " + "theta * " * 200 + "theta",
        "",
    ],
)
def test_what_is_no_formula_is_refused_in_a_sentence(formula: str) -> None:
    with pytest.raises(InvalidInput):
        OwnEffect("mine", formula).checked()


@pytest.mark.parametrize(
    ("formula", "shapes", "message"),
    [
        ("a * sin(k * theta)", "", "values to try"),
        ("a * k * theta", "", "values to try"),
        ("theta", "", "a size before it"),
        ("a * theta", "w: 3", "values to try"),
        ("a * sqrt(theta_dot)", "", "not finite"),
        ("torque * theta", "", "another"),
        ("-b * theta_dott", "", "expected one of the variables theta, theta_dot"),
    ],
)
def test_what_cannot_be_fitted_is_refused_in_a_sentence(formula: str, shapes: str, message: str) -> None:
    with pytest.raises(InvalidInput, match=message):
        OwnEffect("mine", formula, shapes).checked()


@pytest.mark.parametrize("name", ["", "Mine", "a b", "class", "../x", "<b>", "x" * 60, "coulomb"])
def test_a_name_is_small_letters_and_new(name: str) -> None:
    with pytest.raises(InvalidInput):
        OwnEffect(name, "-b * theta_dot").checked()


def test_a_formula_means_what_python_means_by_it() -> None:
    text = "a * exp(-((theta - c) / w) ** 2) - b * abs(theta_dot) * theta_dot + minimum(t, maximum(drive, 1)) ** 3"
    names = {"a": 1.0, "b": 2.0, "c": 3.0, "w": 4.0, "theta": 5.0, "theta_dot": -6.0, "t": 7.0, "drive": 8.0}
    functions = {"exp": np.exp, "abs": np.abs, "minimum": np.minimum, "maximum": np.maximum}
    expected = eval(compile(ast.Expression(parsed_formula(text)), "x", "eval"), {**functions, **names})
    assert value(parsed_formula(text), names) == pytest.approx(expected)


def test_the_class_in_python_is_the_same_effect() -> None:
    effect = OwnEffect("bump", "-a * ((theta - c) / w) * exp(-((theta - c) / w) ** 2)", "c = 3, 3.5; w = 0.2, 0.5")
    kind = effect.checked()
    try:
        names: dict[str, object] = {"sysid": sysid, "dataclasses": dataclasses}
        exec(effect.source(), names)
        again = CATALOGUE.pop("bump")
    finally:
        CATALOGUE.pop("bump", None)
    here, there = (k().parameters for k in (kind, again))
    assert {n: (p.bounds, p.value) for n, p in here.items()} == {n: (p.bounds, p.value) for n, p in there.items()}
    plant, u, start = sysid.RodPendulum(), np.ones(50), np.array([2.5])
    ends = [
        sysid.simulate(sysid.Model(plant, (k(a=0.7, c=3.2, w=0.4),), dt=0.02), u, start, 0.0 * start).theta[0, -1]
        for k in (kind, again)
    ]
    assert ends[0] == ends[1]
    assert ends[0] != sysid.simulate(sysid.Model(plant, dt=0.02), u, start, 0.0 * start).theta[0, -1]


@pytest.mark.parametrize("on", ["theta", "theta_dot", "torque", "time"])
def test_what_is_suggested_can_be_fitted(on: str) -> None:
    over = {"mean": [0.0, 0.1, -0.4, None, 0.0], "edges": [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]}
    comparison = {"torque": {"depends_on": [on], "over": {on: over}}}
    assert suggested(comparison).checked().name == "my_effect"

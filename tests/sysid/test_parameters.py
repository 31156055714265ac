"""Parameters: fields with unit and bounds, checked wherever they hold numbers."""

import dataclasses
import math

import casadi as ca
import numpy as np
import pytest
import torch

from sysid import Delay, Drag, Extent, InvalidInput, Parameter, RodPendulum, Stribeck, TorqueSpeedLimit, Viscous


def test_a_field_knows_its_unit_bounds_and_neutral_value():
    p = Viscous(b=0.2).parameters["b"]
    assert (p.name, p.value, p.unit, p.bounds, p.neutral) == ("b", 0.2, "N m s/rad", (0.0, math.inf), 0.0)


def test_bounds_of_ones_own_go_with_the_part():
    heavy = RodPendulum(m=5.0, l=1.0, bounds={"m": (1.0, 9.0)})
    assert heavy.parameters["m"].bounds == (1.0, 9.0)
    assert heavy.parameters["l"].bounds == (1e-2, 1e2)
    assert heavy.with_parameters({"m": 8.0}).parameters["m"].bounds == (1.0, 9.0)
    with pytest.raises(InvalidInput, match=r"expected 1 <= RodPendulum.m <= 9"):
        heavy.with_parameters({"m": 0.5})
    with pytest.raises(InvalidInput, match=r"bounds name 'mass': RodPendulum has m, l, g"):
        RodPendulum(bounds={"mass": (1.0, 2.0)})
    with pytest.raises(InvalidInput, match=r"low < high"):
        RodPendulum(bounds={"m": (2.0, 1.0)})


@pytest.mark.parametrize("value", [1e-3, np.array([1.0, 1e3]), ca.SX.sym("m"), torch.tensor(99.0)])
def test_numbers_up_to_the_bounds_symbols_and_tensors_are_held_as_they_came(value):
    assert RodPendulum(m=value).m is value


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (math.nan, r"RodPendulum.m is nan: a finite number \[kg\] was expected"),
        (math.inf, r"RodPendulum.m is inf: a finite number"),
        (1001.0, r"RodPendulum.m = 1001 kg is out of bounds: expected 0.001 <= RodPendulum.m <= 1000"),
        (np.array([1.0, 0.1, 5e3]), r"RodPendulum.m = 5000 kg is out of bounds"),
        (np.array([1.0, math.nan]), r"a finite number"),
        ("1.0", r"RodPendulum.m is '1.0': expected a number or an array \[kg\]"),
        (None, r"RodPendulum.m is None: expected a number"),
        ([1.0, 2.0], r"RodPendulum.m is \[1.0, 2.0\]: expected a number or an array"),
    ],
)
def test_bad_numbers_are_refused(value, message):
    with pytest.raises(InvalidInput, match=message):
        RodPendulum(m=value)
    with pytest.raises(InvalidInput, match=message):
        RodPendulum().with_parameters({"m": value})


def test_every_parameter_has_a_positive_scale_at_every_number(plant, all_effects):
    for part in (plant, *all_effects, *(e.at_neutral() for e in all_effects)):
        for p in part.parameters.values():
            assert 0.0 < p.scale < math.inf


def test_probes_are_numbers_or_a_function_of_the_log():
    extent = Extent(dt=0.02, duration=8.0, u_max=3.0)
    kinds = {"N m": 0.03, "N m s/rad": 0.03, "rad": 0.01}
    for unit, step in kinds.items():
        assert Parameter("x", 0.0, unit, (0.0, 9.0), neutral=0.5).probes(extent) == pytest.approx((0.5 + step,))
        assert Parameter("x", 0.0, unit, (0.0, 9.0), neutral=0.5).probes(extent._replace(u_max=0.0)) == (0.51,)
    assert Parameter("x", 4.0, "N m", (0.0, 9.0)).probes(extent) == (4.0,)
    rotor = Parameter("x", 0.0, "kg m^2", (0.0, 9.0), neutral=0.0)
    assert rotor.probes(extent._replace(inertia=1e-5)) == pytest.approx((1e-7,)), "as small as the machine"
    assert Parameter("x", 4.0, "N m", (0.0, 9.0), probe=(1, 2)).probes(extent) == (1.0, 2.0)
    assert Parameter("x", 4.0, "s", (0.0, 9.0), probe=lambda e: (e.dt, e.duration)).probes(extent) == (0.02, 8.0)


def test_what_is_declared_in_radians_are_shares_of_the_reach():
    extent = Extent(dt=0.02, duration=8.0, u_max=3.0, reach=0.01)
    for kind, name, declared, power in (
        (Stribeck, "v_s", (0.5, 1.0), 1),
        (TorqueSpeedLimit, "k", (3.0, 6.0), -1),
        (Drag, "c", (0.03,), -2),
        (Delay, "T", (0.1,), 0),
    ):
        p = dataclasses.replace(kind().parameters[name], probe=declared)
        assert p.angles == power
        assert p.probes(extent) == pytest.approx(tuple(number * 0.01**power for number in declared))

"""Effects at large: what each declares, neutral values and slopes there, the input path, classes of the user's own."""

from dataclasses import dataclass

import casadi as ca
import numpy as np
import pytest
import torch

import sysid
from sysid import (
    CATALOGUE,
    RK4,
    Delay,
    Extent,
    InputEffect,
    InvalidInput,
    JointEffect,
    Lag,
    Model,
    RodPendulum,
    SemiImplicitEuler,
    Viscous,
    parameter,
    register,
    simulate,
)
from sysid.planning.excitation import multisine
from tests.sysid.conftest import EFFECTS
from tests.sysid.planted import drives

ROD = RodPendulum(m=1.3, l=0.9)
EXTENTS = [Extent(0.02, 8.0, 2.0), Extent(0.001, 0.5, 0.01), Extent(0.05, 600.0, 30.0), Extent(0.5, 2.0, 0.0)]


def channels(model, u):
    run = simulate(model, u, 2.0, 0.5)
    return np.stack([run.theta, run.theta_dot, run.theta_read, run.theta_dot_read])


def test_the_catalogue_is_complete_in_its_order_and_tested(all_effects):
    ours = [name for name, kind in CATALOGUE.items() if kind.__module__.startswith("sysid.")]
    assert ours == list(EFFECTS)
    assert set(ours) == {e.name for e in all_effects} | {"stamp"}


def test_every_effect_says_what_it_is(effect):
    kind = type(effect)
    assert kind.formula and kind.__doc__
    for p in effect.parameters.values():
        assert p.name in kind.formula or p.name in kind.__doc__, f"{p.name} is not explained"


def test_confusion_is_mutual():
    for name, kind in CATALOGUE.items():
        for other in kind.confused:
            assert name in CATALOGUE[other].confused, f"{name} names {other}, which does not name it"


@pytest.mark.parametrize("extent", EXTENTS)
def test_probes_lie_within_the_bounds_and_beside_neutral(effect, extent):
    for p in effect.parameters.values():
        probes = p.probes(extent)
        assert 0 < len(probes) <= 200
        assert all(p.bounds[0] <= value <= p.bounds[1] and value != p.neutral for value in probes)
        assert p.neutral is None or p.bounds[0] <= p.neutral <= p.bounds[1]


def test_probes_follow_the_log():
    extent = Extent(dt=0.02, duration=8.0, u_max=2.0)
    probes = {name: {k: p.probes(extent) for k, p in sysid.effect(name).parameters.items()} for name in CATALOGUE}
    assert probes["delay"]["T"] == pytest.approx((0.01, 0.02, 0.04, 0.08, 0.16))
    assert probes["saturation"]["limit"] == pytest.approx((1.8, 1.5, 1.2, 0.9, 0.6))


@pytest.mark.parametrize("integrator", [RK4(substeps=2), SemiImplicitEuler()], ids=["rk4", "euler"])
def test_neutral_changes_nothing(effect, integrator):
    u = np.random.default_rng(0).uniform(-2.0, 2.0, 200)
    without = channels(Model(ROD, (), integrator, 0.02), u)
    np.testing.assert_allclose(
        channels(Model(ROD, (effect.at_neutral(),), integrator, 0.02), u), without, rtol=1e-11, atol=1e-12
    )
    acting = channels(Model(ROD, (effect,), integrator, 0.02), u)
    assert np.max(np.abs(acting - without)) > 1e-3


def test_effects_are_made_neutral_by_name(effect):
    named, neutral = sysid.effect(effect.name).parameters, effect.at_neutral().parameters
    shapes = {k for k, p in named.items() if p.neutral is None}
    assert {k: p.value for k, p in named.items() if k not in shapes} == {
        k: p.value for k, p in neutral.items() if k not in shapes
    }


def slopes_in_casadi(model, names, u):
    """d(states and readings) / d(names), (P, 4, N+1), at the model's numbers."""
    p = ca.SX.sym("p", len(names))
    symbolic = model.with_parameters(dict(zip(names, ca.vertsplit(p), strict=True)))
    now, path = (ca.SX(2.0), ca.SX(0.5)), []
    sensing, torques = symbolic.sensing(*now), symbolic.drives(u.tolist(), ca.SX(0.0))
    inner = symbolic.inner_rest(ca.SX(0.0))
    for k in range(len(u) + 1):
        reading, sensing = symbolic.read(*now, sensing, k * model.dt)
        path.extend([*now, *reading])
        if k < len(u):
            *now, inner = symbolic.move_with_inner(*now, inner, next(torques), k * model.dt)
    jacobian = ca.Function("slopes", [p], [ca.jacobian(ca.vertcat(*path), p)])
    slopes = np.array(jacobian([model.parameters[n].value for n in names]))
    return slopes.T.reshape(len(names), len(u) + 1, 4).swapaxes(1, 2)


@pytest.mark.long
def test_the_slope_at_neutral_is_that_of_a_small_probe(effect):
    """The score of an effect that a model lacks is taken there, where many of them have a kink."""
    if effect.name in ("saturation", "torque_speed_limit", "stamp", "backlash"):
        pytest.skip("neutral at infinity; a kink both ways; a speed that jumps")
    neutral = effect.at_neutral()
    model = Model(ROD, (neutral,), RK4(substeps=2), 0.02)
    names = [f"{effect.name}.{k}" for k, p in neutral.parameters.items() if p.neutral is not None]
    u = multisine(np.random.default_rng(6), 60, 0.02, 2.0, 3.0)
    slopes = slopes_in_casadi(model, names, u)
    for name, slope in zip(names, slopes, strict=True):
        h = 1e-7
        moved = model.with_parameters({name: model.parameters[name].value + h})
        expected = (channels(moved, u) - channels(model, u)) / h
        np.testing.assert_allclose(slope, expected, rtol=1e-3, atol=1e-3 * np.max(np.abs(expected)))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_gradients_at_the_neutral_value_are_finite(effect, dtype):
    neutral = effect.at_neutral()
    numbers = {k: torch.tensor(p.value, dtype=dtype, requires_grad=True) for k, p in neutral.parameters.items()}
    model = Model(ROD, (neutral.with_parameters(numbers),), dt=0.02)
    now = torch.tensor(2.0, dtype=dtype), torch.tensor(0.0, dtype=dtype)
    sensing, torques = model.sensing(*now), model.drives([1.0 + 0.1 * k for k in range(10)], now[0])
    inner = model.inner_rest(now[0])
    for k, torque in enumerate(torques):
        *now, inner = model.move_with_inner(*now, inner, torque, 0.02 * k)
        reading, sensing = model.read(*now, sensing, 0.02 * (k + 1))
    total = sum((*now, *reading))
    for slope in torch.autograd.grad(total, list(numbers.values()), materialize_grads=True):
        assert torch.isfinite(slope)


def test_a_static_input_effect_acts_before_delay_and_lag(catalogue, agree):
    @register
    @dataclass(frozen=True, eq=False)
    class CheapDriver(InputEffect):
        """drive = k u - 0.1 u^3."""

        k: float = parameter(1.0, unit="1", bounds=(0.0, 2.0))

        def advance(self, signal, memory, dt):
            return tuple(self.k * s - 0.1 * s * s * s for s in signal), memory

    u = np.random.default_rng(4).uniform(-1.5, 1.5, 100)
    path = (Lag(T=0.05), Delay(T=0.033), CheapDriver(k=0.8))
    torques = drives(Model(ROD, path, dt=0.02), u)
    np.testing.assert_allclose(torques, drives(Model(ROD, path[:2], dt=0.02), 0.8 * u - 0.1 * u**3), atol=1e-12)
    agree(Model(ROD, path, dt=0.02), steps=100)


def test_a_users_own_class_joins_the_catalogue_and_every_back_end(catalogue, agree):
    @register
    @dataclass(frozen=True, eq=False)
    class RubberBand(JointEffect):
        """tau = -k sin(theta - theta_0), with a rotor of inertia J_r."""

        k: float = parameter(0.0, unit="N m", bounds=(0.0, 5.0), neutral=0.0)
        theta_0: float = parameter(0.3, unit="rad")
        J_r: float = parameter(0.0, unit="kg m^2", bounds=(0.0, 1.0), neutral=0.0)

        def inertia(self):
            return self.J_r

        def torque(self, joint):
            return -self.k * sysid.ops.sin(joint.theta - self.theta_0)

    band = sysid.effect("rubber_band", k=0.9, J_r=0.05)
    model = Model(ROD, (band, Viscous(b=0.1)), dt=0.02)
    assert list(model.parameters)[3:6] == ["rubber_band.k", "rubber_band.theta_0", "rubber_band.J_r"]
    assert (band.at_neutral().k, band.at_neutral().theta_0) == (0.0, 0.3)
    agree(model)
    with pytest.raises(InvalidInput, match=r"did you mean rubber_band\? Expected one of viscous, .*rubber_band"):
        sysid.effect("rubber")


def test_a_taken_name_is_refused(catalogue):
    class Viscous(JointEffect):
        def torque(self, joint):
            return 0.0

    with pytest.raises(InvalidInput, match="named 'viscous' is in the catalogue: give the class another name"):
        register(Viscous)
    assert catalogue["viscous"] is sysid.Viscous
    assert register(sysid.Viscous) is sysid.Viscous


def test_friction_sees_the_load_and_other_effects_do_not(catalogue):
    seen = {}

    @dataclass(frozen=True, eq=False)
    class Push(JointEffect):
        def torque(self, joint):
            seen["push"] = joint.load
            return 0.5

    @dataclass(frozen=True, eq=False)
    class Grip(JointEffect):
        friction = True

        def torque(self, joint):
            seen["grip"] = joint.load
            return -0.1

    model = Model(ROD, (Grip(), Push()), dt=0.02)
    a = model.acceleration(1.0, 0.0, 0.0, 0.25)
    load = ROD.gravity_torque(1.0) + 0.5
    assert seen["push"] == 0.0 and seen["grip"] == pytest.approx(load)
    assert a == pytest.approx((0.25 + load - 0.1) / ROD.inertia())

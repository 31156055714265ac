"""The machine that a policy meets holds commands as its model would, and one that no training can use is named."""

import dataclasses
from dataclasses import dataclass

import numpy as np
import pytest

from policies.environments.machine import (
    check_machine,
    check_stable,
    machine_of,
    past_commands_needed,
    with_command_interval,
)
from policies.environments.randomization import Band, Fixed, Ranges
from study.paper.protocol import paper_model
from sysid import (
    CATALOGUE,
    RK4,
    Coulomb,
    Dahl,
    DCMotor,
    Delay,
    FilteredSpeed,
    FlexibleTransmission,
    GeneralJoint,
    InputEffect,
    InvalidInput,
    JointEffect,
    Lag,
    LinearAxis,
    Model,
    PositionServo,
    RodPendulum,
    SemiImplicitEuler,
    SensorDelay,
    Spring,
    Stamp,
    Viscous,
    effect,
    parameter,
)

STATES = (Lag(T=0.05), Dahl(tau_c=0.2, z_s=0.05), FlexibleTransmission(J=0.2, f=3.0))
EFFECTS = {"none": (), "joint": (Viscous(0.1), Coulomb(0.3)), "path": (Delay(T=0.07), Lag(T=0.05)), "states": STATES}


@pytest.mark.parametrize("integrator", [RK4(2), SemiImplicitEuler(theta_dot_max=8.0)])
@pytest.mark.parametrize("effects", EFFECTS)
def test_a_held_command_moves_as_the_same_command_given_again_and_again(effects, integrator):
    model = Model(RodPendulum(2.0, 1.5), EFFECTS[effects], integrator, dt=0.02, u_max=2.0)
    slow = with_command_interval(model, 0.08)
    assert slow.integrator.substeps == 4 * integrator.substeps
    theta, theta_dot = np.linspace(-3.0, 3.0, 7), np.linspace(4.0, -4.0, 7)
    here, there = slow.initial_state(theta, theta_dot), model.initial_state(theta, theta_dot)
    for u in (1.5, -2.0, 0.3, 2.0, 0.0):
        here = slow.advance(here, u)
        for _ in range(4):
            there = model.advance(there, u)
    np.testing.assert_allclose(here.theta, there.theta, atol=1e-12)
    np.testing.assert_allclose(here.theta_dot, there.theta_dot, atol=1e-12)


def test_steps_that_are_part_of_the_numbers_are_kept_and_others_get_finer():
    assert with_command_interval(Model(RodPendulum(), dt=0.05, integrator=RK4(1)), 0.02).integrator.substeps == 1
    assert with_command_interval(Model(RodPendulum(), dt=0.02, integrator=RK4(1)), 0.05).integrator.substeps == 3
    with pytest.raises(InvalidInput, match=r"steps of 0\.05 s, which are part of its numbers"):
        with_command_interval(paper_model(), 0.04)
    with pytest.raises(InvalidInput, match="time between two commands"):
        with_command_interval(paper_model(), 0.0)


@pytest.mark.parametrize(("dt", "chosen"), [(0.05, 0.05), (0.02, 0.04), (0.01, 0.05), (0.001, 0.05), (0.1, 0.1)])
def test_commands_come_about_every_20th_of_a_second_unless_asked_otherwise(dt, chosen):
    model = Model(RodPendulum(), dt=dt, u_max=2.0)
    assert machine_of(model).dt == pytest.approx(chosen, rel=1e-12)
    assert machine_of(model, dt=0.07).dt == 0.07


def test_the_machine_has_a_limit_and_nothing_of_the_log():
    model = Model(RodPendulum(), (Stamp(s=0.5), Viscous(0.1)), dt=0.05)
    machine = machine_of(model, 3.0)
    assert [e.name for e in machine.effects] == ["viscous"] and machine.u_max == 3.0
    assert machine_of(paper_model()).u_max == 2.0 and machine_of(paper_model(), 1.0).u_max == 1.0
    for u_max, message in ((None, "give one with --u-max"), (-1.0, "u_max = -1"), (np.nan, "u_max = nan")):
        with pytest.raises(InvalidInput, match=message):
            machine_of(model, u_max)
    with pytest.raises(InvalidInput, match="beyond the model's own limit"):
        machine_of(paper_model(), 2.5)
    with pytest.raises(InvalidInput, match="LinearAxis"):
        machine_of(Model(LinearAxis()), 1.0)


def test_commands_of_the_future_are_refused_by_name():
    @dataclass(frozen=True, eq=False)
    class Foresight(InputEffect):
        ahead = 1

        def advance(self, signal, memory, dt):
            return tuple(signal), memory

    with pytest.raises(InvalidInput, match="'foresight' acts on commands before they are given"):
        machine_of(Model(RodPendulum(), (Foresight(),)), 1.0)


@pytest.mark.long
def test_every_effect_of_the_catalogue_is_carried():
    for name in CATALOGUE:
        check_machine(machine_of(Model(RodPendulum(2.0, 1.5), (effect(name),), dt=0.05), 2.0), Fixed())


def test_the_papers_whole_prior_is_stable():
    check_machine(paper_model(), Ranges.of(paper_model(), ("m", "l")))
    check_machine(paper_model(), Band({"m": 1.0, "l": 1.0}, 0.5))


@pytest.mark.parametrize(
    ("model", "message"),
    [
        (Model(RodPendulum(), (Spring(-100.0),), dt=0.05, u_max=2.0), "runs away under torques within 2 N m"),
        (Model(GeneralJoint(J=1e-4, G=0.01), dt=0.05, u_max=2.0), "runs away"),
        (Model(RodPendulum(), (Viscous(9.0),), RK4(1), dt=0.2, u_max=2.0), "runs away|cannot be simulated stably"),
        (dataclasses.replace(paper_model(), effects=(Viscous(9.0),), dt=0.1), "cannot be simulated stably in steps"),
    ],
)
def test_a_motion_that_is_not_the_models_is_noticed(model, message):
    with pytest.raises(InvalidInput, match=message):
        check_stable(model, Fixed())


def test_finer_steps_make_a_stiff_model_usable():
    check_stable(Model(RodPendulum(), (Viscous(9.0),), RK4(20), dt=0.2, u_max=2.0), Fixed())


def test_the_parameters_that_make_it_unstable_are_named():
    model = Model(RodPendulum(bounds={"m": (1e-3, 1e3)}), dt=0.05, u_max=20.0)
    check_stable(model, Fixed())
    with pytest.raises(InvalidInput, match=r"the model at m = 0\.00\d+ "):
        check_stable(model, Band({"m": 0.005}, 0.5))


def test_an_effect_that_tensors_cannot_pass_is_named():
    @dataclass(frozen=True, eq=False)
    class Numb(JointEffect):
        """Written for arrays, not with sysid.ops."""

        a: float = parameter(0.1, unit="N m", neutral=0.0)

        def torque(self, joint):
            return self.a * joint.theta.round(3)

    model = Model(RodPendulum(), (Viscous(0.1), Numb()), dt=0.05, u_max=2.0)
    with pytest.raises(InvalidInput, match=r"effect 'numb' cannot be carried .* it raises TypeError"):
        check_machine(model, Fixed())


def test_history_reaches_as_far_back_as_delays_and_lags():
    def reached(*effects):
        return past_commands_needed(Model(RodPendulum(), effects, dt=0.05))

    assert reached() == reached(Viscous(0.1)) == 0
    assert reached(Delay(T=0.1)) == 2 and reached(Delay(T=0.12)) == 3
    assert (
        reached(Lag(T=0.05)) == reached(FilteredSpeed(T=0.05)) == 2 and reached(Delay(T=0.1), SensorDelay(T=0.05)) == 3
    )


def test_a_servo_that_is_told_positions_is_refused_and_a_voltage_is_not():
    model = Model(RodPendulum(), (PositionServo(k_p=5.0),), dt=0.05, u_max=4.0)
    with pytest.raises(InvalidInput, match=r"driven by a position command \(position_servo\)"):
        machine_of(model)
    volts = Model(RodPendulum(), (DCMotor(k=0.5, k_e=0.1),), dt=0.05, u_max=4.0)
    assert machine_of(volts).command_unit == "V"

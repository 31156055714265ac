"""A misuse of the public functions ends in a sentence that says what came and what was expected."""

import math

import numpy as np
import pandas as pd
import pytest

from sysid import (
    RK4,
    Coulomb,
    Dahl,
    DCMotor,
    Delay,
    GeneralJoint,
    GridSearch,
    InvalidInput,
    LeastSquares,
    Model,
    PositionServo,
    Record,
    Saturation,
    SemiImplicitEuler,
    Sensor,
    SensorDelay,
    Stamp,
    TorqueConstant,
    UnscentedKalman,
    Viscous,
    add,
    compare,
    diagnose,
    effect,
    fisher_information,
    fit,
    load,
    load_effects,
    plot_comparison,
    read,
    residual_torque,
    save,
    sensor_noise,
    simulate,
    split,
    to_mjcf,
    to_urdf,
    write_csv,
)
from sysid.estimation.estimate import Estimate
from sysid.estimation.held_out import held_out_error
from sysid.planning.excitation import Limits
from sysid.planning.next_experiment import next_experiment

PLANT = GeneralJoint()
JOINT = Model(PLANT, dt=0.02)
SERVO = JOINT.with_effect(PositionServo())
MANY = JOINT.with_parameters({"J": np.ones(3)})
WEAK = Model(PLANT, DCMotor(), dt=0.02, u_max=0.5)
DAHL = Model(PLANT, Dahl(tau_c=0.1), dt=0.02)
T = 0.02 * np.arange(301)
RNG = np.random.default_rng(0)
SENSOR, BOTH, LIMITS = Sensor(theta=0.003), Sensor(theta=0.003, theta_dot=0.05), Limits(2.0, theta_max=2.0)
RECORD = SENSOR.measure(simulate(JOINT, np.cos(T[:-1]), math.pi, 0.0), RNG)[0]
SLOW = Record(1000.0 * T, np.cos(T[:-1]), RECORD.theta)
FULL = Record(T, np.cos(T[:-1]), RECORD.theta, np.gradient(RECORD.theta, 0.02))
STILL = Record(T, np.zeros(300), RECORD.theta)
FRAME = pd.DataFrame({"t": T, "theta": RECORD.theta, "torque": np.cos(T)})
FITTED = Estimate(JOINT, ("J",), np.eye(1), {"theta": 0.003}, True, "converged", 1.0, 301, "least squares", SENSOR)
A_MODEL, A_SENSOR, RECORDS = "expected a Model, such as", "expected a Sensor, such as", "expected Record objects"
BEYOND = "is out of bounds: expected 0 <= .*T <= 0.1$"
LIST = "expected a list of names, such as \\['J'\\]"


def joint(*effects):
    return Model(PLANT, effects, dt=0.02)


MISUSES = {
    # names of parameters
    "diagnose: unknown parameter": (lambda: diagnose(JOINT, [RECORD], parameters=["m"]), "unknown parameter 'm'.*J, G"),
    "diagnose: a text of parameters": (lambda: diagnose(JOINT, [RECORD], parameters="J"), f"parameters = 'J': {LIST}"),
    "diagnose: a parameter twice": (lambda: diagnose(JOINT, [RECORD], parameters=["J", "J"]), "named twice in J, J"),
    "compare: unknown parameter": (lambda: compare(JOINT, [RECORD], parameters=["mass"]), "unknown parameter 'mass'"),
    "compare: a text of parameters": (lambda: compare(JOINT, [RECORD], parameters="J"), LIST),
    "fit: a text of parameters": (lambda: fit(JOINT, [RECORD], parameters="J"), LIST),
    "fit: a number of parameters": (lambda: fit(JOINT, [RECORD], parameters=1), LIST),
    "fit: a parameter twice": (lambda: fit(JOINT, [RECORD], SENSOR, ("J", "J")), "named twice in J, J"),
    "fit: no parameters": (lambda: fit(JOINT, [RECORD], SENSOR, ()), "nothing is left to fit"),
    "grid: unknown parameter": (lambda: GridSearch(("J", "m")).fit(JOINT, [RECORD]), "'m': this model has J, G"),
    "grid: no parameters": (lambda: GridSearch(()).fit(JOINT, [RECORD]), "no parameters to fit: choose among J, G"),
    "least squares: no parameters": (lambda: LeastSquares(()).fit(JOINT, [RECORD]), "no parameters to fit"),
    "fit: parameters in lists": (lambda: fit(JOINT, [RECORD], parameters=[["J"]]), r"unknown parameter \['J'\]"),
    "information about a text": (lambda: fisher_information(JOINT, "J", [RECORD], SENSOR, np.zeros((1, 2))), LIST),
    # sensors
    "fit: noise as sensor": (lambda: fit(JOINT, [RECORD], sensor_noise([RECORD])), f"{A_SENSOR}.*sensor_noise"),
    "fit: tuple as sensor": (lambda: fit(JOINT, [RECORD], (0.003, 0.05)), rf"sensor is \(0.003, 0.05\): {A_SENSOR}"),
    "diagnose: float as sensor": (lambda: diagnose(JOINT, [RECORD], 0.3), f"sensor is 0.3: {A_SENSOR}"),
    "compare: tuple as sensor": (lambda: compare(JOINT, [RECORD], (0.003, 0.05)), A_SENSOR),
    "add: float as sensor": (lambda: add(JOINT, "coulomb", [RECORD], 0.3), A_SENSOR),
    "residual torque: float as sensor": (lambda: residual_torque(JOINT, [RECORD], 0.003), A_SENSOR),
    "grid: float as sensor": (lambda: GridSearch(("G",), sensor=0.003).fit(JOINT, [RECORD]), A_SENSOR),
    "filter: float as sensor": (lambda: UnscentedKalman(("J",), sensor=0.003).fit(JOINT, [RECORD]), A_SENSOR),
    "sd as text": (lambda: Sensor("0.1"), "sensor sd of theta is '0.1': expected a positive number"),
    "jitter as text": (lambda: Sensor(0.1, jitter="1"), "jitter is '1' s: expected zero or more"),
    "fit: no speed": (lambda: fit(JOINT, [RECORD], BOTH), "no theta_dot readings"),
    "diagnose: no speed": (lambda: diagnose(JOINT, [RECORD], BOTH), "no theta_dot readings"),
    "held-out error: no speed": (lambda: held_out_error(JOINT, [RECORD], BOTH), "no theta_dot readings"),
    "least squares: no speed": (lambda: LeastSquares(("J",), BOTH).fit(JOINT, [RECORD]), "no theta_dot readings"),
    "grid: no speed": (lambda: GridSearch(("J",)).fit(JOINT, [RECORD]), "no theta_dot: .* needs angles and speeds"),
    # models
    "fit: plant as model": (lambda: fit(PLANT, [RECORD]), rf"model is GeneralJoint\(.*\): {A_MODEL}"),
    "fit: path as model": (lambda: fit("model.json", [RECORD]), f"model is 'model.json': {A_MODEL}.*load"),
    "fit: estimate as model": (lambda: fit(FITTED, [RECORD]), rf"model is an Estimate: {A_MODEL} estimate\.model"),
    "diagnose: plant as model": (lambda: diagnose(PLANT, [RECORD]), A_MODEL),
    "compare: plant as model": (lambda: compare(PLANT, [RECORD]), A_MODEL),
    "add: plant as model": (lambda: add(PLANT, "coulomb", [RECORD]), A_MODEL),
    "residual torque: estimate as model": (lambda: residual_torque(FITTED, [RECORD], SENSOR), A_MODEL),
    "information: estimate as model": (lambda: fisher_information(FITTED, ["J"], [RECORD], SENSOR, None), A_MODEL),
    "least squares: estimate as model": (lambda: LeastSquares(("J",)).fit(FITTED, [RECORD]), A_MODEL),
    "simulate: estimate as model": (lambda: simulate(FITTED, [1.0], 0.0, 0.0), A_MODEL),
    "MJCF: estimate as model": (lambda: to_mjcf(FITTED), A_MODEL),
    "URDF: plant as model": (lambda: to_urdf(PLANT), A_MODEL),
    "MJCF: many machines": (lambda: to_mjcf(MANY), "expected a model of one machine"),
    "URDF: many machines": (lambda: to_urdf(MANY), "expected a model of one machine"),
    "model: unknown parameter": (lambda: JOINT.with_parameters({"viscous.b": 1.0}), "'viscous.b': this model has J, G"),
    "model: no such effect": (lambda: JOINT.without_effect("lag"), "no effect 'lag': it has none"),
    "model: none of that name": (lambda: joint(Viscous()).effect_named("lag"), "no effect 'lag': it has viscous"),
    "model: numbers of another": (lambda: JOINT.numbers(["m"]), "unknown parameter 'm': this model has J, G"),
    "model: too few numbers": (
        lambda: JOINT.with_numbers(["J", "G"], [1.0]),
        "1 values for 2 parameters",
    ),
    "model: an effect twice": (lambda: joint(Viscous(), Viscous(b=1.0)), "'viscous' was given 2 times: expected once"),
    "model: delay and stamp": (lambda: joint(Delay(), Stamp()), "'delay' and 'stamp' contain each other: expected one"),
    "model: servo and limit": (lambda: joint(PositionServo(), Saturation(limit=1.0)), "contain each other"),
    "model: two actuators": (lambda: joint(TorqueConstant(), DCMotor()), "torque_constant and dc_motor: expected one"),
    "model: dt of zero": (lambda: Model(PLANT, dt=0.0), "dt = 0.0: expected a positive"),
    "model: u_max of nan": (lambda: Model(PLANT, u_max=math.nan), "u_max = nan: expected a positive"),
    "model: dt that is None": (lambda: Model(PLANT, dt=None), "dt = None: expected a positive number of seconds"),
    "model: dt as text": (lambda: Model(PLANT, dt="0.02"), "dt = '0.02': expected a positive number of seconds"),
    "model: u_max beyond all": (lambda: Model(PLANT, u_max=1e300), "u_max = 1e\\+300: expected 1e-20 to 1e\\+20"),
    "model: u_max as text": (lambda: Model(PLANT, u_max="2"), "u_max = '2': expected a positive number"),
    "model: dt as effects": (lambda: Model(PLANT, 0.02), "effects holds 0.02: expected effects"),
    "model: class as effects": (lambda: Model(PLANT, Coulomb), "effects holds <class .*Coulomb'>: expected effects"),
    "model: name as effects": (lambda: Model(PLANT, "coulomb"), "effects holds 'coulomb': expected effects"),
    "plant: a dict": (lambda: GeneralJoint(J={}), "parameter GeneralJoint.J is {}: expected a number or an array"),
    "grid: points as text": (lambda: GridSearch(("J",), points="9").fit(JOINT, [RECORD]), "points = '9': expected at"),
    "starts as text": (
        lambda: LeastSquares(("J",), starts="3").fit(JOINT, [RECORD]),
        "starts = '3': expected a positive",
    ),
    "no substeps of RK4": (lambda: RK4(substeps=0), "substeps = 0: expected a whole number >= 1"),
    "no substeps of Euler": (lambda: SemiImplicitEuler(substeps=0), "substeps = 0: expected a whole number >= 1"),
    "substeps as text": (lambda: RK4(substeps="2"), "substeps = '2': expected a whole number"),
    "fastest as text": (lambda: SemiImplicitEuler(theta_dot_max="8"), "theta_dot_max = '8': expected a positive"),
    # effects
    "diagnose: classes": (lambda: diagnose(JOINT, [RECORD], effects=[Coulomb]), "expected its name, one of viscous"),
    "diagnose: an effect": (lambda: diagnose(JOINT, [RECORD], effects=Coulomb()), "expected its name, one of viscous"),
    "add: an effect": (lambda: add(JOINT, Coulomb(), [RECORD]), r"effect Coulomb\(.*\): expected its name, one of"),
    "add: a list": (lambda: add(JOINT, ["coulomb"], [RECORD]), r"effect \['coulomb'\]: expected its name, one of"),
    "diagnose: an actuator": (lambda: diagnose(JOINT, [RECORD], effects=["dc_motor"]), "dc_motor is an actuator"),
    "add: an actuator": (lambda: add(JOINT, "dc_motor", [RECORD]), "dc_motor is an actuator, and none is searched for"),
    "diagnose: a typing error": (lambda: diagnose(JOINT, [RECORD], effects=("coulom",)), "did you mean coulomb"),
    "diagnose: one word": (lambda: diagnose(JOINT, [RECORD], effects="friction"), "unknown effect 'friction'"),
    "diagnose: no effects": (lambda: diagnose(JOINT, [RECORD], effects=()), "no effects were named"),
    "effect: nearly": (lambda: effect("viscosity"), r"did you mean viscous\? Expected one of .*coulomb, .*delay"),
    "effect: unknown": (lambda: effect("xyz"), "'xyz': expected one of viscous, coulomb, .*position_servo$"),
    "effect: no such number": (lambda: effect("viscous", c=1.0), "'viscous' has no parameter 'c': it has b"),
    "delay beyond its memory": (lambda: Delay(T=0.11, longest=0.1), f"T = 0.11 s {BEYOND}"),
    "late sensor beyond its memory": (lambda: SensorDelay(T=0.11, longest=0.1), f"T = 0.11 s {BEYOND}"),
    "delay without memory": (lambda: Delay(longest=0.0), "delay longest = 0.0: expected a positive time"),
    "late sensor without memory": (lambda: SensorDelay(longest=0.0), "delay longest = 0.0: expected a positive time"),
    "grid: states of its own": (lambda: GridSearch(("J",)).fit(DAHL, [FULL]), "'dahl' has states of its own"),
    "filter: states of its own": (lambda: UnscentedKalman(("J",)).fit(DAHL, [FULL]), "'dahl' has states of its own"),
    "effect of None": (lambda: effect(None), "effect None: expected its name, one of"),
    # records
    "fit: no records": (lambda: fit(JOINT, []), "no records were given"),
    "grid: no records": (lambda: GridSearch(("J",)).fit(JOINT, []), "no records were given"),
    "least squares: no records": (lambda: LeastSquares(("J",)).fit(JOINT, []), "no records were given"),
    "diagnose: a number as records": (lambda: diagnose(JOINT, [3]), RECORDS),
    "fit: another rate": (lambda: fit(Model(PLANT, dt=0.05), [RECORD]), "sampled every"),
    "diagnose: another rate": (lambda: diagnose(Model(PLANT, dt=0.05), [RECORD]), "sampled every"),
    "compare: another rate": (lambda: compare(Model(PLANT, dt=0.05), [RECORD]), "the model steps every"),
    "diagnose: one sample": (lambda: diagnose(JOINT, [RECORD.head(1)]), "too few"),
    "fit: beyond the model's limit": (lambda: fit(WEAK, [RECORD]), "a voltage of 1 V, beyond the model's limit"),
    "information from one start": (
        lambda: fisher_information(JOINT, ["J"], [RECORD] * 2, SENSOR, np.zeros((1, 2))),
        r"shape \(1, 2\): expected \(2, 2\)",
    ),
    "fit: DataFrame as records": (lambda: fit(JOINT, FRAME), f"records holds 't': {RECORDS}, as read makes"),
    "fit: path as records": (lambda: fit(JOINT, "rig.csv"), f"records holds 'rig.csv': {RECORDS}, as read makes"),
    "fit: None as records": (lambda: fit(JOINT, None), f"records holds None: {RECORDS}, as read makes"),
    "split: nothing": (lambda: split([]), "no records were given"),
    "split: DataFrame": (lambda: split(FRAME), RECORDS),
    "split: share in words": (lambda: split([RECORD], "a quarter"), "hold_out = 'a quarter': expected a share between"),
    "split: share in a list": (lambda: split([RECORD], [0.3]), r"hold_out = \[0.3\]: expected a share between"),
    "diagnose: share in words": (lambda: diagnose(JOINT, [RECORD], hold_out="half"), "hold_out = 'half': expected a"),
    "noise of a DataFrame": (lambda: sensor_noise(FRAME), RECORDS),
    "noise of None": (lambda: sensor_noise(None), RECORDS),
    "CSV of a list": (lambda: write_csv([RECORD], "rig.csv"), "record is .*: expected a Record"),
    "compare: milliseconds": (lambda: compare(Model(PLANT, dt=20.0), [SLOW]), "interval .* of 20: .*milliseconds?"),
    "fit: milliseconds": (lambda: fit(JOINT, [SLOW]), "interval .* of 20: expected at most .*milliseconds?"),
    "fit: torques for a servo": (
        lambda: fit(SERVO, [read(FRAME)[0]]),
        "command = 'torque', and .* driven by a position",
    ),
    "fit: a servo's log for torques": (
        lambda: fit(JOINT, [read(FRAME, command="position")[0]]),
        "command = 'position', and .* driven by a torque",
    ),
    "origin as text": (
        lambda: Record(T, RECORD.u, RECORD.theta, origin="0"),
        r"before its rollout does \(origin = '0'",
    ),
    # reading
    "read: None": (lambda: read(None), "log is None: expected a path or a DataFrame"),
    "read: a number": (lambda: read(5), "log is 5: expected a path or a DataFrame"),
    "read: lists of numbers": (lambda: read([0.0, 0.1], [1.0, 2.0]), "log is 0.0: expected a path or a DataFrame"),
    "read: arrays": (lambda: read(T, T), "log is .*: expected a path or a DataFrame"),
    "read: a record": (lambda: read(RECORD), "log is a Record: expected a path or a DataFrame"),
    "read: a log": (lambda: read(read(FRAME)), "log is a Record: expected a path or a DataFrame"),
    "read: no zero": (lambda: read(FRAME, zero=None), "zero = None: expected upright, hanging"),
    "read: zero in a list": (lambda: read(FRAME, zero=[0.0]), r"zero = \[0.0\]: expected upright, hanging"),
    "read: columns in a list": (lambda: read(FRAME, columns=["t", "theta"]), "columns is .*: expected .*t=time_s"),
    "read: plant by name": (lambda: read(FRAME, plant="joint"), "plant is 'joint': expected a plant, such as"),
    "read: plant by class": (lambda: read(FRAME, plant=GeneralJoint), "plant is <class .*>: expected a plant, such as"),
    "read: begin as text": (lambda: read(FRAME, begin="2"), "begin = '2': expected a number of seconds"),
    "read: end as text": (lambda: read(FRAME, end="2"), "end = '2': expected a number of seconds"),
    "read: dt as text": (lambda: read(FRAME, dt="0.1"), "dt = '0.1': expected a number of seconds"),
    "read: degrees in words": (lambda: read(FRAME, degrees="yes"), "degrees = 'yes': expected one of True, False"),
    "read: sign in words": (lambda: read(FRAME, flip_torque="no"), "flip_torque = 'no': expected one of True, False"),
    # the next experiment
    "next: a typing error": (lambda: next_experiment(JOINT, ("coulumb",), LIMITS, SENSOR), "did you mean coulomb"),
    "next: an effect twice": (lambda: next_experiment(JOINT, ("coulomb", "coulomb"), LIMITS, SENSOR), "twice"),
    "next: no noise": (lambda: next_experiment(JOINT, ("coulomb",), LIMITS), "noise"),
    "next: no limits": (lambda: next_experiment(JOINT, ("coulomb",), sensor=SENSOR), "no limits"),
    "next: no torque": (lambda: next_experiment(JOINT, records=[STILL], sensor=SENSOR), "no torque"),
    "next: too short": (lambda: next_experiment(JOINT, limits=Limits(1.0, 0.1), sensor=SENSOR), "samples"),
    "next: too strong": (lambda: next_experiment(WEAK, (), LIMITS, SENSOR), "beyond the model's own limit"),
    "next: a twin": (lambda: next_experiment(joint(Delay(T=0.02)), ("stamp", "lag"), LIMITS, SENSOR), "cannot stand"),
    "next: a cost of another shape": (lambda: next_experiment(FITTED, limits=LIMITS, cost=np.eye(3)), "cost has shape"),
    "next: a cost and rivals": (
        lambda: next_experiment(FITTED, ("coulomb", "viscous"), LIMITS, cost=np.eye(1)),
        "a cost of errors has no rivals",
    ),
    "next: a cost alone": (lambda: next_experiment(JOINT, (), LIMITS, SENSOR, cost=np.eye(1)), "needs an estimate"),
    "limits: u_max": (lambda: Limits(0.0), "limits"),
    "limits: duration": (lambda: Limits(1.0, duration=math.nan), "limits"),
    "limits: rollouts": (lambda: Limits(1.0, rollouts=0), "limits"),
    "limits: start": (lambda: Limits(1.0, start=4.0), "limits"),
    # the rest
    "grid: one point": (lambda: GridSearch(("J",), points=1).fit(JOINT, [RECORD]), "points = 1: expected at least 2"),
    "grid: a million cells": (
        lambda: GridSearch(("J", "G"), points=1001).fit(JOINT, [RECORD]),
        r"1001\^2 cells .*: use LeastSquares",
    ),
    "least squares: no starts": (lambda: LeastSquares(("J",), starts=0).fit(JOINT, [RECORD]), "starts = 0: expected"),
    "settings in a dict": (lambda: diagnose(JOINT, [RECORD], settings={"steps": 1}), "settings is .*: expected Search"),
    "settings that are None": (lambda: diagnose(JOINT, [RECORD], settings=None), "settings is None: expected Search"),
    "picture of an estimate": (lambda: plot_comparison(FITTED), "answer is an Estimate: expected a Comparison"),
    "interval in percent": (lambda: FITTED.interval(95), "level = 95: expected a probability between 0 and 1"),
    "load: None": (lambda: load(None), "path is None: expected the name of a file"),
    "load effects: None": (lambda: load_effects(None), "path is None: expected the name of a file"),
    "save: None": (lambda: save(JOINT, None), "path is None: expected the name of a file"),
    "MJCF: joint by number": (lambda: to_mjcf(JOINT, joint=5), "joint is 5: expected its name, such as 'hinge'"),
    "URDF: joint by number": (lambda: to_urdf(JOINT, joint=5), "joint is 5: expected its name, such as 'hinge'"),
    "MJCF: into a number": (lambda: to_mjcf(JOINT, into=5), "path is 5: expected the name of a file"),
}


@pytest.mark.parametrize(("call", "sentence"), MISUSES.values(), ids=MISUSES.keys())
def test_a_misuse_ends_in_a_sentence(call, sentence):
    with pytest.raises(InvalidInput, match=sentence) as refusal:
        call()
    assert "\n" not in str(refusal.value)

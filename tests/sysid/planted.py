"""Logs of rods with one thing hidden, and what `diagnose` says of each: asked once, whoever wants to know."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial

import numpy as np
from scipy.stats import chi2

from study.paper.protocol import averaged_sensor, paper_rollouts
from sysid import (
    RK4,
    Coulomb,
    Delay,
    Diagnosis,
    Drag,
    Drift,
    Effect,
    Estimate,
    GeneralJoint,
    Joint,
    JointEffect,
    Lag,
    Model,
    Plant,
    Record,
    Ripple,
    RodPendulum,
    Saturation,
    Sensor,
    Spring,
    Stamp,
    Tilt,
    TorqueBias,
    Trajectory,
    VelocityGain,
    Viscous,
    diagnose,
    fit,
    simulate,
)
from sysid.physics.ops import Value
from sysid.planning.excitation import multisine, steps

DT = 0.02
SENSOR = Sensor(0.003, 0.05)
PAPER = averaged_sensor(1.0)
ENCODER = Sensor(theta=0.01, theta_dot=1.0)
PAPERS_ENCODER = dataclasses.replace(PAPER, theta=0.01)
"""The paper's sensor, one that reads angles, too, and the paper's with these angles."""
RICH = Model(
    GeneralJoint(J=0.05, G=1.2),
    (Viscous(b=0.03), Coulomb(tau_c=0.05), Delay(T=0.033), Lag(T=0.025), TorqueBias(tau_0=0.04)),
    RK4(substeps=2),
    dt=0.02,
    u_max=2.0,
)
"""A joint with friction, a late drive and an offset: five effects at once."""
JOINT = Model(GeneralJoint(J=0.3, G=2.0), (Viscous(b=0.07),), RK4(substeps=2), DT)
NAMES = ("J", "G", "viscous.b")
"""A damped joint, and what it is made of."""
STEPS = partial(steps, u_max=1.5, hold=0.3)
HAND = np.repeat([0.0, 1.2, 0.0], [75, 30, 145])
"""A hand that leans on a joint from 1.5 s to 2.1 s of five."""
FEW = ("viscous", "coulomb", "tilt", "delay")
VERDICTS = ("adequate", "missing", "partly", "unknown", "cannot tell")
DEPENDENCES = {"theta", "theta_dot", "torque", "time", "history"}


def rod(*effects: Effect) -> Model:
    return Model(RodPendulum(m=1.1, l=0.8), effects, dt=DT)


def truth(*effects: Effect) -> Model:
    return Model(RodPendulum(m=1.0, l=0.9), effects, dt=DT)


def drives(model: Model, u: np.ndarray) -> np.ndarray:
    """The drive torques of a record, (N, substeps)."""
    return np.array(list(model.drives(u.tolist())))


def energy(plant: Plant, theta: np.ndarray, theta_dot: np.ndarray) -> np.ndarray:
    """1/2 J theta_dot^2 + G cos(theta), G the largest gravity torque."""
    return 0.5 * plant.inertia() * theta_dot**2 + plant.gravity_torque(0.5 * math.pi) * np.cos(theta)


def logs(
    model: Model,
    seed: int = 0,
    n: int = 5,
    seconds: float = 5.0,
    spin: float = 0.0,
    sensor: Sensor | None = SENSOR,
    draw: Callable[[np.random.Generator, int, float], np.ndarray] = STEPS,
) -> list[Record]:
    """Rollouts that begin near hanging, with speed `spin` [rad/s] in turns forwards and backwards; exact without a
    sensor. `draw` makes the commands of one, of a generator, their number and their interval [s]."""
    rng = np.random.default_rng(seed)
    u = np.array([draw(rng, round(seconds / model.dt), model.dt) for _ in range(n)])
    run = simulate(model, u, math.pi + rng.uniform(-0.8, 0.8, n), spin * (-1.0) ** np.arange(n))
    return without_noise(run) if sensor is None else sensor.measure(run, rng)


def without_noise(run: Trajectory) -> list[Record]:
    return [Record(run.t, *row) for row in zip(run.u, run.theta_read, run.theta_dot_read, strict=True)]


def with_memory(white: np.ndarray, T: float) -> np.ndarray:
    """An Ornstein-Uhlenbeck process of correlation time T [s] of white numbers (n, N), of the same sd."""
    kept, d = math.exp(-DT / T), white.copy()
    for k in range(1, d.shape[1]):
        d[:, k] = kept * d[:, k - 1] + math.sqrt(1.0 - kept**2) * d[:, k]
    return d


def accelerated(
    model: Model, count: int, n: int, s: float, T: float, seed: int = 0, push: tuple[int, float] | None = None
) -> tuple[Trajectory, list[Record]]:
    """Rollouts, and their records, under a random acceleration of sd s [rad/s^2] and memory T [s], held over each
    interval.

    push: the rollout that is pushed from 4 s to 4.5 s, and by how much [N m].
    """
    rng = np.random.default_rng(seed)
    u = np.array([multisine(rng, n, DT, 1.5, 2.0) for _ in range(count)])
    torque = float(model.inertia()) * with_memory(s * rng.standard_normal((count, n)), T)
    if push is not None:
        torque[push[0], round(4.0 / DT) : round(4.5 / DT)] += push[1]
    run = simulate(model, u + torque, math.pi + rng.uniform(-1.0, 1.0, count), np.zeros(count))
    return run, [dataclasses.replace(r, u=commands) for r, commands in zip(SENSOR.measure(run, rng), u, strict=True)]


def distance(estimate: Estimate, truth: Mapping[str, float]) -> float:
    """e' P^-1 e of the errors e, chi-square with as many degrees of freedom as there are fitted parameters."""
    e = np.array([estimate.values[name] - truth[name] for name in estimate.names])
    return float(e @ np.linalg.solve(estimate.covariance, e))


def assert_found(estimate: Estimate, model: Model) -> None:
    """A fit succeeded, and ends at the numbers of this model within its stated error."""
    assert estimate.success
    truth = {name: float(p.value) for name, p in model.parameters.items()}
    assert distance(estimate, truth) < chi2.ppf(0.999, len(estimate.names))


def assert_recovered(effect: Effect, records: Sequence[Record]) -> None:
    """A fit from neutral, and from the wrong rod, ends at the truth within its stated error."""
    assert_found(fit(rod(effect.at_neutral()), records, SENSOR), truth(effect))


def papers_records(model: Model, n: int, seed: int, sensor: Sensor, noise: np.random.Generator) -> list[Record]:
    """The paper's rollouts; their exact angles, or start angles alone, get the sensor's error."""
    rollouts = paper_rollouts(model, n, np.random.default_rng(seed))
    exact = [r.theta[:1] if sensor is PAPER else r.theta for r in rollouts]
    angles = [theta + sensor.theta * noise.standard_normal(len(theta)) for theta in exact]
    return [dataclasses.replace(r.averaged, theta=theta) for r, theta in zip(rollouts, angles, strict=True)]


def assert_named(effect: Effect, records: Sequence[Record]) -> Diagnosis:
    """A diagnosis of the plain rod names the effect and nothing else, at its size."""
    diagnosis = diagnose(rod(), records, SENSOR)
    assert diagnosis.verdict == "missing"
    assert [s.effect for s in diagnosis.steps] == [effect.name]
    for key, p in effect.parameters.items():
        said = diagnosis.steps[0].parameters[f"{effect.name}.{key}"]
        assert abs(said["value"] - float(p.value)) < 4.5 * said["sd"]
    assert diagnosis.error.ratio < 1.1
    return diagnosis


def shaken(model: Model, rms: float, seed: int = 0, u: np.ndarray | None = None, T: float = 0.5) -> list[Record]:
    """As on a real machine: beside the model a random torque acts, rms [N m], that no record shows.

    An Ornstein-Uhlenbeck process of correlation time T [s], beside steps, or beside commands u (n, N) from standstill.
    """
    rng = np.random.default_rng(seed)
    if u is None:
        u = np.array([steps(rng, 200, DT, 1.5, 0.3) for _ in range(5)])
    theta = math.pi + np.linspace(-0.8, 0.8, len(u))
    d = with_memory(rms * rng.standard_normal(u.shape), T)
    made = SENSOR.measure(simulate(model, u + d, theta, np.zeros(len(u))), rng)
    return [dataclasses.replace(r, u=commands) for r, commands in zip(made, u, strict=True)]


def under_control(
    model: Model, controller: Callable[[int, float, float], float], start: float, errors: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Commands (N,) of a controller by the step, the angle and the speed, which it reads with errors (N+1, 2); and the
    motion (N+1, 2) from standstill."""
    u, x, state = np.zeros(len(errors) - 1), np.zeros(errors.shape), model.initial_state(start, 0.0)
    for k in range(len(u)):
        x[k] = state.theta, state.theta_dot
        u[k] = controller(k, *(x[k] + errors[k]))
        state = model.advance(state, u[k], k * model.dt)
    x[-1] = state.theta, state.theta_dot
    return u, x


def pushed(records: list[Record], i: int, model: Model, push: np.ndarray = HAND, seed: int = 9) -> list[Record]:
    """Beside its command a push (N,) acts on rollout i of this model, that the record does not show."""
    run = simulate(model, records[i].u + push, records[i].theta[0], 0.0)  # type: ignore[index]
    (made,) = SENSOR.measure(run, np.random.default_rng(seed))
    return [*records[:i], dataclasses.replace(made, u=records[i].u, name="pushed"), *records[i + 1 :]]


def misread(records: list[Record]) -> list[Record]:
    """The speed wobbles with the angle, as that of a tachometer with seven poles does."""
    return [
        dataclasses.replace(r, theta_dot=r.theta_dot * (1.0 + 0.05 * np.sin(7.0 * r.theta)))  # type: ignore[operator]
        for r in records
    ]


PLANTED = {
    "viscous": (Viscous(b=0.03),),
    "coulomb": (Coulomb(tau_c=0.04),),
    "delay": (Delay(T=0.05),),
    "tilt": (Tilt(alpha=0.05),),
    "ripple": (Ripple(a=0.05, b=0.03, order=5.0),),
    "velocity_gain": (VelocityGain(c=1.06),),
    "saturation": (Saturation(limit=1.0),),
    "drift": (Drift(r=0.05),),
    "coulomb and spring": (Coulomb(tau_c=0.04), Spring(k=0.6)),
}


@dataclasses.dataclass(frozen=True, eq=False)
class Unknown(JointEffect):
    """tau = curve(joint): no effect of the catalogue."""

    curve: Callable[[Joint], Value] = lambda joint: 0.0

    def torque(self, joint: Joint) -> Value:
        """curve(joint) [N m]."""
        return self.curve(joint)


UNKNOWN: dict[str, tuple[Effect, tuple[str, ...], str]] = {
    "speed": (Drag(c=0.02), ("tilt", "delay", "torque_bias"), "theta_dot"),
    "angle": (Ripple(a=0.08, b=0.03, order=5.0), ("viscous", "coulomb", "delay", "tilt"), "theta"),
    "torque": (Saturation(limit=0.9), ("viscous", "coulomb", "tilt", "delay"), "torque"),
    "time": (Drift(r=0.05), ("viscous", "coulomb", "delay", "torque_bias"), "time"),
    "history": (Delay(T=0.06), ("viscous", "coulomb", "tilt", "torque_bias"), "history"),
}


@cache
def records_of(name: str) -> tuple[Record, ...]:
    if name == "pushed":
        return tuple(pushed(logs(truth()), 1, truth()))
    if name == "misread":
        return tuple(misread(logs(truth())))
    others = {"stamped": (Stamp(s=-0.5),), "nothing": ()}
    hidden = UNKNOWN[name][:1] if name in UNKNOWN else PLANTED.get(name) or others[name]
    return tuple(logs(truth(*hidden)))


@cache
def of(name: str) -> Diagnosis:
    """Each log is diagnosed once."""
    effects = UNKNOWN[name][1] if name in UNKNOWN else None
    return diagnose(rod(), records_of(name), SENSOR, effects=effects)


EVERY = ("nothing", *PLANTED, *UNKNOWN, "stamped", "pushed", "misread")

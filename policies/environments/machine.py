"""The machine that a policy will meet: a fitted model without what belongs to its log, ready for an environment.

machine = machine_of(load_model("model.json"), u_max=2.0)      # holds each command for about 0.05 s
check_machine(machine, Band({"m": 1.2}, 0.3))                  # raises InvalidInput where training makes no sense
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping

import numpy as np

from policies.environments import task
from policies.environments.random_streams import Purpose, generator
from policies.environments.randomization import Randomization
from policies.limits import EPISODE_STEPS
from sysid import RK4, Delay, FilteredSpeed, InvalidInput, Lag, LinearAxis, Model, SensorDelay, State
from sysid.limits import check_size
from sysid.physics.ops import Array

FASTEST = 1e3
"""Speed [rad/s] at which a motion has run away."""
ROLLOUTS = 64
"""Motions that a machine is tried on."""
LAG_MEMORY = 2.0
"""Time constants of a lag after which a command is as good as forgotten."""


def machine_of(model: Model, u_max: float | None = None, dt: float | None = None) -> Model:
    """The model as a policy meets it: without effects of the log, with a torque limit, a command every dt [s].

    u_max   [N m]; by default the model's own, which it may not exceed
    dt      [s]; by default the multiple of the model's own that is nearest to 0.05 s

    Raises InvalidInput for a model without limit, a linear axis, a servo that is told positions, an effect that needs
    commands of the future, and an interval that the model's steps do not make up.
    """
    if isinstance(model.plant, LinearAxis):
        raise InvalidInput("the plant is a LinearAxis: expected a pendulum or a joint, something that swings up")
    machine = model.machine
    if machine.actuator is not None and machine.actuator.at_angle:
        raise InvalidInput(
            f"the model is driven by a {machine.actuator.command} command ({machine.actuator.name}): "
            "expected one that a torque, a current or a voltage drives"
        )
    for e in machine.input_effects:
        if e.ahead:
            raise InvalidInput(f"effect {e.name!r} acts on commands before they are given: no environment carries that")
    if u_max is not None and not 0.0 < u_max < math.inf:
        raise InvalidInput(f"u_max = {u_max}: expected a positive torque limit [N m]")
    if u_max is not None and u_max > model.u_max:
        raise InvalidInput(
            f"u_max = {u_max:g} N m is beyond the model's own limit: expected at most {model.u_max:g} N m"
        )
    limit = model.u_max if u_max is None else u_max
    if not math.isfinite(limit):
        raise InvalidInput("the model has no torque limit: give one with --u-max [N m]")
    if dt is None:
        dt = max(1, round(task.INTERVAL / model.dt)) * model.dt
    return dataclasses.replace(with_command_interval(machine, dt), u_max=limit)


def with_command_interval(model: Model, dt: float) -> Model:
    """The same model with commands held for dt [s]; its integrator's steps stay as they are, or get finer.

    Raises InvalidInput where steps of a fixed size, which are part of an Euler model's numbers, do not make up dt.
    """
    if not 0.0 < dt <= task.DURATION:
        raise InvalidInput(f"dt = {dt}: expected a time between two commands in (0, {task.DURATION:g}] s")
    step = model.dt / model.integrator.substeps
    substeps = max(1, math.ceil(dt / step - 1e-6))
    check_episode(dt, substeps)
    if not isinstance(model.integrator, RK4) and abs(substeps * step - dt) > 1e-6 * dt:
        raise InvalidInput(
            f"the model is integrated in steps of {step:g} s, which are part of its numbers: "
            f"commands every {dt:g} s do not fit them; expected a multiple"
        )
    return dataclasses.replace(model, dt=dt, integrator=dataclasses.replace(model.integrator, substeps=substeps))


def check_episode(dt: float, substeps: int) -> None:
    """Raise InvalidInput where an episode would take too many steps of the integrator."""
    check_size(
        f"steps of the integrator in {task.DURATION:g} s, {substeps} for each command of {dt:g} s:",
        task.DURATION / dt * substeps,
        EPISODE_STEPS,
    )


def past_commands_needed(model: Model) -> int:
    """How many past commands decide what comes: what delays and lags of the input and the sensors remember."""
    late = [float(e.T) for e in model.effects if isinstance(e, Delay | SensorDelay)]
    lagged = [LAG_MEMORY * float(e.T) for e in model.effects if isinstance(e, Lag | FilteredSpeed)]
    return math.ceil(sum(late + lagged) / model.dt - 1e-6)


def advised_interval(model: Model) -> tuple[float, float]:
    """Between which times [s] a command should be held: 0.05 to 0.5 of 1 / omega, which is how fast the machine falls.

    omega = sqrt(|dG/dtheta| / J) upright, of the gravity torque G: slower than that a controller comes late, faster
    only makes an episode long. Infinite where no gravity acts.
    """
    small = 1e-4
    slope = (model.plant.gravity_torque(small) - model.plant.gravity_torque(-small)) / (2.0 * small)
    omega = math.sqrt(abs(float(slope)) / float(model.inertia()))
    return (0.05 / omega, 0.5 / omega) if omega > 0.0 else (0.0, math.inf)


def check_machine(model: Model, randomization: Randomization) -> None:
    """Raise InvalidInput where a machine cannot be simulated stably, or not by the training environment.

    Its parameters are drawn as in training; torques are random within the limit.
    """
    check_stable(model, randomization)
    parameters, state, u = _trial(model, randomization)
    _check_carried(model, parameters, state, u)


def check_stable(model: Model, randomization: Randomization) -> None:
    """Raise InvalidInput where a motion runs away, or depends on the size of the model's steps."""
    parameters, state, u = _trial(model, randomization)
    with np.errstate(all="ignore"):
        _check_motion(model.with_parameters(parameters), parameters, state, u)


def _trial(model: Model, randomization: Randomization) -> tuple[dict[str, Array], State, Array]:
    """Parameters (ROLLOUTS,) by name, start states, and torques (N, ROLLOUTS); always the same."""
    rng = generator(0, Purpose.EVALUATION, 2)
    drawn = [randomization.sample(rng, model) for _ in range(ROLLOUTS)]
    parameters = {name: np.array([row[name] for row in drawn]) for name in drawn[0]}
    theta, theta_dot = task.draw_start_states([rng] * ROLLOUTS)
    u = rng.uniform(-model.u_max, model.u_max, (task.horizon(model.dt), ROLLOUTS))
    return parameters, model.with_parameters(parameters).initial_state(theta, theta_dot), u


def _check_motion(model: Model, parameters: Mapping[str, Array], state: State, u: Array) -> None:
    """No motion may run away, and no step may be far from the same step taken in eight: the mark of a stiff model."""
    finer = dataclasses.replace(model.integrator, substeps=8 * model.integrator.substeps)
    fine = dataclasses.replace(model, integrator=finer)
    for k, command in enumerate(u):
        t = k * model.dt
        after = model.advance(state, command, t)
        speed = np.broadcast_to(np.abs(after.theta_dot), command.shape)
        if not np.all(speed < FASTEST):
            worst = int(np.argmax(np.where(np.isfinite(speed), speed, np.inf)))
            raise InvalidInput(
                f"the model{_at(parameters, worst)} runs away under torques within {model.u_max:g} N m: "
                f"at t = {t:.3g} s it turns with {speed[worst]:.3g} rad/s; expected less than {FASTEST:g}"
            )
        if k % 5 == 0:
            other = np.abs(fine.advance(state, command, t).theta_dot - after.theta_dot)
            far = np.broadcast_to(other > 1.0 + 0.5 * np.maximum(speed, np.abs(state.theta_dot)), command.shape)
            if np.any(far):
                raise InvalidInput(
                    f"the model{_at(parameters, int(np.argmax(far)))} cannot be simulated stably in steps of "
                    f"{model.dt / model.integrator.substeps:g} s: eight times as many steps end elsewhere; "
                    "expected slower dynamics, or a shorter dt"
                )
        state = after


def _at(parameters: Mapping[str, Array], which: int) -> str:
    numbers = ", ".join(f"{name} = {values[which]:.4g}" for name, values in parameters.items())
    return f" at {numbers}" if numbers else ""


def _check_carried(model: Model, parameters: Mapping[str, Array], state: State, u: Array) -> None:
    """The environment moves tensors: every effect must move them as it moves arrays. Raises InvalidInput if not."""
    alone = dataclasses.replace(model, effects=())
    for e in model.effects:
        single = dataclasses.replace(alone, effects=(e,))
        effect_parameters = {name: values for name, values in parameters.items() if name in single.parameters}
        problem = _differs(single.with_parameters(effect_parameters), state.theta, state.theta_dot, u[:5])
        if problem:
            raise InvalidInput(f"effect {e.name!r} cannot be carried by the training environment: {problem}")


def _differs(model: Model, theta: Array, theta_dot: Array, u: Array) -> str:
    """Why tensors do not move as arrays do, or ""."""
    import torch

    def tensor(values: Array) -> torch.Tensor:
        return torch.from_numpy(np.ascontiguousarray(values, dtype=np.float64))

    tensors = model.with_parameters(
        {name: tensor(p.value) for name, p in model.parameters.items() if isinstance(p.value, np.ndarray)}
    )
    try:
        there = _walk(tensors, tensor(theta), tensor(theta_dot), [tensor(command) for command in u])
    except Exception as error:
        return f"it raises {type(error).__name__} ({str(error).splitlines()[0] if str(error) else 'no reason given'})"
    here = _walk(model, theta, theta_dot, list(u))
    same = all(
        isinstance(b, torch.Tensor) and np.allclose(a, b.numpy(), rtol=1e-6, atol=1e-9)
        for a, b in zip(here, there, strict=True)
    )
    return "" if same else "tensors and arrays disagree; use the functions of sysid.ops in it"


def _walk(model: Model, theta: Array, theta_dot: Array, u: list[Array]) -> list[Array]:
    """States and readings under the commands."""
    state, sensing, seen = model.initial_state(theta, theta_dot), model.sensing(theta, theta_dot), []
    for k, command in enumerate(u):
        state = model.advance(state, command, k * model.dt + 0.0 * command)
        reading, sensing = model.read(state.theta, state.theta_dot, sensing, (k + 1) * model.dt + 0.0 * command)
        seen += [state.theta, state.theta_dot, *reading]
    return seen

"""The commands of the command line: each reads a log, asks one question, prints the answer, writes what was asked."""

from __future__ import annotations

import dataclasses
import json
import math
import sys
from dataclasses import dataclass
from functools import singledispatch
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sysid.cli.log_settings import settled
from sysid.cli.options import Add, Compare, Diagnose, Effects, Experiment, Fit, LogOptions, ModelOptions
from sysid.data.files import save_text
from sysid.data.logs import Command, Log, read
from sysid.data.record import Record
from sysid.data.sensor import Sensor
from sysid.data.splitting import split
from sysid.errors import InvalidInput
from sysid.estimation.estimate import Estimate
from sysid.estimation.fit import fit, free
from sysid.physics.effects import ACTUATORS, CATALOGUE, Actuator, DCMotor, PositionServo, TorqueConstant
from sysid.physics.integrators import RK4
from sysid.physics.model import Model
from sysid.physics.plants import GeneralJoint, LinearAxis, Plant, PointMassPendulum, RodPendulum

if TYPE_CHECKING:
    from sysid.planning.signals import Limits

PENDULUM = {"m": (1e-3, 1e3), "l": (1e-2, 1e2)}
PLANTS: dict[str, Plant] = {
    "rod": RodPendulum(g=9.81, bounds=PENDULUM),
    "point": PointMassPendulum(g=9.81, bounds=PENDULUM),
    "joint": GeneralJoint(bounds={"J": (1e-9, 1e6), "G": (0.0, 1e6)}),
    "axis": LinearAxis(bounds={"m": (1e-6, 1e6)}),
}
INPUTS: dict[Command, type[Actuator] | None] = {
    "torque": None,
    "current": TorqueConstant,
    "voltage": DCMotor,
    "position": PositionServo,
}
"""What turns each kind of command into torque."""
SUBSTEP = 0.01
"""Longest step [s] of the integrator."""


def run(command: Any) -> None:
    """Run a command of sysid.options, completed by the log's log.toml. Raises InvalidInput for bad input."""
    if isinstance(command, Fit | Compare | Diagnose | Add | Experiment):
        log, start, said = settled(command.log, command.start)
        if said:
            print(said)
        command = dataclasses.replace(command, log=log, start=start)
    _run(command)


@singledispatch
def _run(command: Any) -> None:
    raise InvalidInput(f"unknown command {command!r}")


@_run.register
def _(command: Fit) -> None:
    from sysid.estimation.held_out import held_out_error

    _load(command.start.effects)
    task = Task.of(command, command.out, command.json)
    estimate = task.fitted()
    error = held_out_error(estimate.model, task.held_out, task.sensor)
    print(estimate)
    print(f"  on held-out data: {error}")
    task.doubt(error.theta)
    task.write_json(command.json, {**estimate.to_dict(), "held_out_error": error.to_dict()})
    task.write_model(command.out, estimate)


@_run.register
def _(command: Compare) -> None:
    from sysid.diagnosis.compare import compare

    _load(command.start.effects)
    task = Task.of(command, command.json, command.html, command.figure)
    model = task.model if task.known or not task.names else task.fitted().model
    comparison = compare(model, task.held_out, task.sensor, task.names)
    print(comparison)
    task.doubt(comparison.one_second.theta)
    task.write_json(command.json, comparison.to_dict())
    if command.figure is not None:
        _draw(comparison, command.figure)
    task.write_report(command.html, comparison)


@_run.register
def _(command: Diagnose) -> None:
    from sysid.diagnosis.diagnose import diagnose
    from sysid.diagnosis.search_settings import DEFAULT

    if not 0.0 < command.tolerance < 1.0:
        raise InvalidInput(f"--tolerance {command.tolerance:g}: expected a share between 0 and 1, such as 0.02")
    settings = dataclasses.replace(DEFAULT, tolerance=command.tolerance)
    _load(command.start.effects)
    task = Task.of(command, command.out, command.json, command.html)
    task.check_free()
    diagnosis = diagnose(
        task.model,
        task.log,
        task.sensor,
        command.log.hold_out,
        parameters=task.names,
        settings=settings,
        tell=_progress,
    )
    _progress("")
    print(diagnosis)
    task.doubt(diagnosis.error.theta)
    task.write_json(command.json, diagnosis.to_dict())
    task.write_model(command.out, diagnosis.best.estimate)
    task.write_report(command.html, diagnosis)


def _progress(doing: str) -> None:
    """Say on a terminal what is being done, in one line that the next one replaces."""
    if sys.stderr.isatty():
        print(f"\r\033[K{doing}{' ...' if doing else ''}", end="", file=sys.stderr, flush=True)


@_run.register
def _(command: Add) -> None:
    from sysid.diagnosis.add import add
    from sysid.physics.effects import effect

    _load(command.start.effects)
    effect(command.effect)  # raises, and says which names are near
    task = Task.of(command, command.out, command.json)
    added = add(task.fitted(), command.effect, task.log, task.sensor, command.log.hold_out)
    print(added)
    task.write_json(command.json, added.to_dict())
    task.write_model(command.out, added.estimate)


@_run.register
def _(command: Experiment) -> None:
    from sysid.planning.experiment import next_experiment

    _load(command.start.effects)
    task = Task.of(command, command.out, command.json)
    estimate = task.fitted()
    rivals = [name.strip() for name in command.between.split(",") if name.strip()]
    limits = _limits(command, task.log, estimate.model)
    experiment = next_experiment(estimate, rivals, limits, task.sensor, task.training)
    print(experiment)
    task.write_json(command.json, experiment.to_dict())
    if command.out is not None and not experiment.u.size:
        print(f"{command.out} was not written: there is nothing to play")
    elif command.out is not None:
        experiment.write_csv(command.out)
        print(f"wrote {command.out}")


@_run.register
def _(command: Effects) -> None:
    _load(command.effects)
    for name, kind in {**ACTUATORS, **CATALOGUE}.items():
        print(name)
        print(f"    {kind.formula or (kind.__doc__ or '').strip().splitlines()[0]}")
        parameters = ", ".join(f"{p.name} [{p.unit}]" for p in kind().parameters.values())
        print(f"    parameters: {parameters}")
        if kind.confused:
            print(f"    may be confused with: {', '.join(kind.confused)}")


# ---- what all commands on a log begin and end with -------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Task:
    """A log with its noise, and the model to begin with.

    names   the parameters that a fit may move
    known   whether nothing has to be fitted first: the model came from a file, and all that was added has its numbers
    """

    log: Log
    sensor: Sensor
    training: tuple[Record, ...]
    held_out: tuple[Record, ...]
    model: Model
    names: tuple[str, ...]
    known: bool

    @classmethod
    def of(cls, command: Fit | Compare | Diagnose | Add | Experiment, *outputs: Path | None) -> Task:
        """Read everything, and say what was read. Raises InvalidInput before anything expensive."""
        _check_outputs([*command.log.files, command.log.settings, command.start.model, command.start.effects], outputs)
        model, names, added = _begun(command.start, command.log.input)
        given = command.start.model is not None
        log = _read(command.log, model)
        thin = log.thinned() if command.log.dt is None else log
        print(thin)
        sensor = _sensor(command.log, log, model.plant)
        log = thin
        training, held_out = split(log, command.log.hold_out)
        model = _sampled(model, log.dt, given)
        names = _shown(model, names, log)
        if not given:
            from sysid.estimation.initial_guess import initial_guess

            model = initial_guess(model, names, training, sensor)
        return cls(log, sensor, training, held_out, model, names, given and not added)

    def fitted(self) -> Estimate:
        """The model fitted to what is not held out."""
        self.check_free()
        return fit(self.model, self.training, self.sensor, self.names)

    def check_free(self) -> None:
        """Raise InvalidInput where there is nothing to fit."""
        if not self.names:
            raise InvalidInput("nothing is left to fit: every parameter that this log can show is fixed")

    def doubt(self, error: float | None) -> None:
        """Say so where the model explains next to nothing of the angle: an error of columns rather than of physics."""
        if error is None:
            return
        spread = float(np.std(np.concatenate([r.theta for r in self.held_out if r.theta is not None])))
        if not error < 0.3 * spread:
            print("  the error is far above any noise: check columns, units, --zero, --flip-torque and --plant")

    def write_model(self, path: Path | None, estimate: Estimate) -> None:
        """model.json."""
        if path is not None:
            from sysid.estimation.saved_model import save

            save(estimate, path)
            print(f"wrote {path}")

    def write_json(self, path: Path | None, data: dict[str, Any]) -> None:
        """Plain data."""
        if path is not None:
            _write(path, json.dumps(data, indent=1, allow_nan=False) + "\n")

    def write_report(self, path: Path | None, answer: Any) -> None:
        """The page that opens offline."""
        if path is not None:
            from sysid.report.write import write_report

            write_report(answer, path)
            print(f"wrote {path}")


def _check_outputs(inputs: list[Path | None], outputs: tuple[Path | None, ...]) -> None:
    """Raise InvalidInput where an output is an input, comes twice, or cannot be written."""
    read_from = {p.resolve() for p in inputs if p is not None}
    written: set[Path] = set()
    for path in (p for p in outputs if p is not None):
        where = path.resolve()
        if where in read_from:
            raise InvalidInput(f"{path} is read by this command: expected another file to write to")
        if where in written:
            raise InvalidInput(f"{path} is to hold two answers: expected two files")
        if path.is_dir():
            raise InvalidInput(f"{path} is a folder: expected a file to write to")
        if not where.parent.is_dir():
            raise InvalidInput(f"cannot write {path}: there is no folder {path.parent}")
        written.add(where)


def _load(effects: Path | None) -> None:
    if effects is not None:
        from sysid.physics.user_effects import load_effects

        print(f"effects of {effects.name}: {', '.join(load_effects(effects))}")


def _read(options: LogOptions, model: Model) -> Log:
    return read(
        *options.files,
        columns=options.columns or None,
        zero=options.zero or "upright",
        flip_torque=options.flip_torque,
        degrees=options.degrees,
        begin=options.begin,
        end=options.end,
        dt=options.dt,
        time_unit=options.time_unit,
        plant=model.plant,
        command=_command(model),
    )


def _command(model: Model) -> Command:
    """What the model's command is."""
    return next(name for name, kind in INPUTS.items() if kind is (type(model.actuator) if model.actuator else None))


# ---- noise -----------------------------------------------------------------------------------------------------------


def _sensor(options: LogOptions, log: Log, plant: Plant) -> Sensor:
    """The noise that the user gave; what was not given is found. Raises InvalidInput where nothing moves."""
    from sysid.data.checks import check_excitation
    from sysid.data.noise import sensor_noise

    measured = [c for c in ("theta", "theta_dot") if all(getattr(r, c) is not None for r in log)]
    if all(np.ptp(getattr(r, c)) == 0.0 for r in log for c in measured):
        at = getattr(log[0], measured[0])[0]
        raise InvalidInput(f"the machine is at rest: {measured[0]} stays at {at:.4g}: nothing excites m")
    given = _numbers("--noise", options.noise.split(",") if options.noise else ())
    for channel in given:
        if channel not in measured:
            raise InvalidInput(f"--noise names {channel!r}: this log measures {' and '.join(measured)}")
    if set(given) == set(measured):
        sensor = Sensor(**given)
    else:
        noise = sensor_noise(log)
        print(noise.sentence(plant))
        sensor = dataclasses.replace(noise.sensor, **given)
    check_excitation(log, sensor)
    return sensor


def _numbers(option: str, pairs: tuple[str, ...] | list[str]) -> dict[str, float]:
    """{name: number} of "name=number"."""
    found: dict[str, float] = {}
    for pair in pairs:
        name, _, number = (part.strip() for part in pair.partition("="))
        try:
            found[name] = float(number)
        except ValueError:
            raise InvalidInput(f"{option} {pair!r}: expected NAME=NUMBER, as in l=0.45") from None
    return found


# ---- the model to begin with -----------------------------------------------------------------------------------------


def _begun(options: ModelOptions, command: Command | None) -> tuple[Model, tuple[str, ...], tuple[str, ...]]:
    """The model of the file or the plain plant, what the user knows put in; its free names; those of --with.

    Where the command is no torque, an actuator is in the model.
    """
    if options.model is None:
        model = Model(PLANTS[options.plant or "rod"])
        names = free(model)
    else:
        from sysid.estimation.saved_model import load

        saved = load(options.model)
        model, names = saved.model, saved.free
        _check_plant(options, model.plant)
    known = _numbers("--set", options.set)
    if options.gravity is not None:
        if "g" not in model.parameters:
            raise InvalidInput(f"--gravity: a {type(model.plant).__name__} has none, but {', '.join(model.parameters)}")
        known["g"] = options.gravity
    model, added = _with_effects(model, options.effects_from_start)
    model, more = _with_actuator(model, command)
    names += more
    for name in known:
        owner, dot, _ = name.partition(".")
        if dot and owner in CATALOGUE and name not in model.parameters and owner not in {e.name for e in model.effects}:
            raise InvalidInput(f"--set {name}: the model has no {owner} yet; --with {name}={known[name]:g} puts it in")
    model = model.with_parameters(known)
    added = tuple(n for n in added if n not in known)
    names = (*(n for n in names if n not in known), *added)
    if options.model is None:
        names += _scale(model, names, (*known, *options.effects_from_start.split(",")))
    return model, names, added


def _check_plant(options: ModelOptions, plant: Plant) -> None:
    """Raise InvalidInput where --plant says otherwise than --model."""
    if options.plant is None or type(PLANTS[options.plant]) is type(plant):
        return
    own = next((name for name, known in PLANTS.items() if type(known) is type(plant)), type(plant).__name__)
    raise InvalidInput(f"--plant {options.plant}, but the plant of {options.model} is {own}: leave --plant out")


def _with_effects(model: Model, text: str) -> tuple[Model, tuple[str, ...]]:
    """The model with the effects of "coulomb,viscous.b=0.1", and the names of their parameters that have no number."""
    from sysid.physics.effects import effect

    numbers: dict[str, dict[str, float]] = {}
    for part in (part.strip() for part in text.split(",") if part.strip()):
        whole, equals, _ = part.partition("=")
        owner, dot, field = whole.strip().partition(".")
        known = effect(owner).parameters
        if bool(equals) != bool(dot) or (dot and field not in known):
            choices = " or ".join([owner, *(f"{owner}.{name}=NUMBER" for name in known)])
            raise InvalidInput(f"--with {part!r}: expected {choices}")
        numbers.setdefault(owner, {})
        if equals:
            numbers[owner][field] = _numbers("--with", [part])[whole.strip()]
    present = [e.name for e in model.effects]
    for owner, own in numbers.items():
        if owner in present:
            raise InvalidInput(f"--with {owner}: the model has it already; --set {owner}.NAME=NUMBER fixes its numbers")
        model = model.with_effect(effect(owner, **own))
    free_ones = [f"{o}.{name}" for o, own in numbers.items() for name in effect(o).parameters if name not in own]
    return model, tuple(free_ones)


def _with_actuator(model: Model, command: Command | None) -> tuple[Model, tuple[str, ...]]:
    """The model with what turns that kind of command into torque, and the names that a fit may move of it."""
    own, wanted = model.actuator, INPUTS[command or "torque"]
    if command is None or (type(own) if own else None) is wanted:
        return model, ()
    if own is not None or wanted is None:
        has = f"a {own.name}, driven by a {own.command}" if own else "no actuator: its command is a torque"
        raise InvalidInput(f"--input {command}, but the model has {has}")
    actuator = wanted()
    return model.with_effect(actuator), tuple(
        f"{actuator.name}.{k}" for k, p in actuator.parameters.items() if not p.known
    )


def _scale(model: Model, names: tuple[str, ...], known: tuple[str, ...]) -> tuple[str, ...]:
    """The actuator's constant where the plant's own numbers are known and it is not; else a word on what that means."""
    actuator = model.actuator
    if actuator is None:
        return ()
    scale = f"{actuator.name}.{actuator.scale}"
    if scale in names or any(k.partition("=")[0].strip() == scale for k in known):
        return ()
    if not any(n in names for n in model.plant.parameters):
        return (scale,)
    p = model.parameters[scale]
    print(
        f"motion alone cannot show {scale}: it stays at {p.value:g} {p.unit}, and every torque, friction and inertia "
        f"is relative to it; give it with --set {scale}=..., or what the plant weighs"
    )
    return ()


def _sampled(model: Model, dt: float, given: bool) -> Model:
    """The model at the log's sample interval; its integrator's steps stay as fine, and no longer than SUBSTEP.

    A `given` model of that interval stays as it is.
    """
    if not isinstance(model.integrator, RK4):
        return dataclasses.replace(model, dt=dt) if abs(model.dt - dt) < 0.01 * dt else model
    if given and abs(model.dt - dt) <= 1e-6 * dt:
        return dataclasses.replace(model, dt=dt)
    own = model.dt / model.integrator.substeps
    return dataclasses.replace(model, dt=dt, integrator=RK4(substeps=math.ceil(dt / min(SUBSTEP, own) - 1e-6)))


def _shown(model: Model, names: tuple[str, ...], log: Log) -> tuple[str, ...]:
    """The names without the one that sets the scale of all torques, where no torque is known."""
    if any(np.any(record.u != 0.0) for record in log) or isinstance(model.actuator, PositionServo):
        return names
    scale = model.plant.scale
    if scale not in names:
        return names
    p = model.parameters[scale]
    torque = "torque" if model.plant.turns else "force"
    print(
        f"a free swing cannot show {scale}: it stays at {p.value:g} {p.unit}, and every {torque} is relative to it; "
        f"give it with --set {scale}=..."
    )
    return tuple(n for n in names if n != scale)


# ---- what the rig may do ---------------------------------------------------------------------------------------------


def _limits(options: Experiment, log: Log, model: Model) -> Limits:
    """What the log has done, where the user says nothing else."""
    from sysid.planning.experiment import limits_of
    from sysid.planning.signals import Limits

    said = {
        "u_max": options.u_max,
        "duration": options.duration,
        "rollouts": options.rollouts,
        "theta_max": options.reach,
        "theta_dot_max": options.speed,
        "payload": options.payload,
    }
    given: dict[str, Any] = {name: value for name, value in said.items() if value is not None}
    if np.any([np.any(record.u != 0.0) for record in log]):
        return dataclasses.replace(limits_of(log, model), **given)
    if options.u_max is None:
        raise InvalidInput("the log has no torque to go by: give --u-max")
    return Limits(**given)


# ---- files -----------------------------------------------------------------------------------------------------------


def _write(path: Path, text: str) -> None:
    save_text(path, text)
    print(f"wrote {path}")


def _draw(comparison: Any, path: Path) -> None:
    from sysid.report.comparison_figure import plot_comparison

    try:
        plot_comparison(comparison).savefig(path)
    except (OSError, ValueError) as error:
        raise InvalidInput(f"cannot write {path}: {error}") from None
    print(f"wrote {path}")

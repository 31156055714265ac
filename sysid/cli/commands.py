"""The commands of the command line: each reads a log, asks one question, prints the answer, writes what was asked."""

from __future__ import annotations

import dataclasses
import json
import logging
import shlex
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial, singledispatch
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from sysid.cli.command_options import (
    AddCommand,
    CompareCommand,
    DiagnoseCommand,
    EffectsCommand,
    ExperimentCommand,
    ExportCommand,
    FitCommand,
    LogOptions,
    OnLog,
)
from sysid.cli.log_settings import with_settings
from sysid.cli.starting_model import begun, identifiable_part, named_numbers, sampled
from sysid.data.checks import check_excitation
from sysid.data.files import check_outputs, save_file
from sysid.data.logs import Log, read
from sysid.data.noise import sensor_noise
from sysid.data.record import Record
from sysid.data.sensor import Sensor
from sysid.data.splitting import split
from sysid.diagnosis.findings import quantity
from sysid.errors import InvalidInput
from sysid.estimation.channels import relied_on
from sysid.estimation.estimate import Estimate
from sysid.estimation.fit import fit
from sysid.estimation.held_out import HeldOutError, held_out_error
from sysid.estimation.initial_guess import initial_guess
from sysid.estimation.saved_model import load_model, save
from sysid.physics.effects import ACTUATORS, CATALOGUE, effect
from sysid.physics.model import Model
from sysid.physics.plants import Plant
from sysid.planning.excitation import Limits

logger = logging.getLogger(__name__)

ANSWER = "gapfinder/answer/1"
"""The schema of answers that have none of their own."""
FAR_ABOVE_NOISE = 10.0
"""An error of so many times the noise is far above it."""


def run(command: Any) -> None:
    """Run a command of sysid.cli.command_options. Raises InvalidInput for bad input."""
    if isinstance(command, EffectsCommand | ExportCommand):
        register_effects(command.effects)
    else:
        command = completed(command)
    _run(command)


def completed(command: Any) -> Any:
    """A command with what the log's log.toml says; the user's own effects are registered."""
    log, start, said = with_settings(command.log, command.start)
    if said:
        logger.info(said)
    register_effects(start.effects)
    return dataclasses.replace(command, log=log, start=start)


def register_effects(file: Path | None) -> None:
    """Run a user's file of effects, and name them."""
    if file is not None:
        from sysid.data.user_effects import load_effects

        logger.info(f"effects of {file.name}: {', '.join(load_effects(file))}")


@singledispatch
def _run(command: Any) -> None:
    """Answer a command."""


@_run.register
def _(command: FitCommand) -> None:
    task = LogAndModel.of(command)
    estimate = task.fitted()
    error = held_out_error(estimate.model, task.held_out, task.sensor)
    logger.info(estimate)
    logger.info(f"  on held-out data: {error}")
    task.doubt(error)
    write_json(command.json, lambda: {**estimate.to_dict(), "held_out_error": error.to_dict()})
    write(command.out, partial(save, estimate))


@_run.register
def _(command: CompareCommand) -> None:
    from sysid.diagnosis.compare import compare

    task = LogAndModel.of(command)
    model = task.model if task.known or not task.names else task.fitted().model
    comparison = compare(model, task.held_out, task.sensor, task.names)
    logger.info(comparison)
    task.doubt(comparison.one_second)
    write_json(command.json, comparison.to_dict)
    write(command.figure, partial(_draw, comparison))
    write(command.html, partial(_write_page, comparison))
    if command.parquet is not None:
        from sysid.export.prediction_table import write_predictions

        write(command.parquet, partial(write_predictions, model, task.log, task.sensor))


@_run.register
def _(command: DiagnoseCommand) -> None:
    from sysid.diagnosis.diagnose import diagnose
    from sysid.diagnosis.search_settings import DEFAULT

    settings = dataclasses.replace(DEFAULT, tolerance=command.tolerance, horizon=command.horizon)
    task = LogAndModel.of(command)
    hold_out, names = command.log.hold_out, task.names
    diagnosis = diagnose(task.model, task.log, task.sensor, hold_out, parameters=names, settings=settings)
    logger.info(diagnosis)
    task.doubt(diagnosis.error)
    write_json(command.json, diagnosis.to_dict)
    write(command.out, partial(save, diagnosis.estimate))
    write(command.html, partial(_write_page, diagnosis))


@_run.register
def _(command: AddCommand) -> None:
    from sysid.diagnosis.add import add

    effect(command.effect)  # raises, and says which names are near
    task = LogAndModel.of(command)
    added = add(task.fitted(), command.effect, task.log, task.measured, command.log.hold_out)
    logger.info(added)
    write_json(command.json, added.to_dict)
    write(command.out, partial(save, added.estimate))


@_run.register
def _(command: ExperimentCommand) -> None:
    from sysid.planning.next_experiment import next_experiment

    task = LogAndModel.of(command)
    estimate = task.fitted()
    rivals = [name.strip() for name in command.between.split(",") if name.strip()]
    limits = _limits(command, task.log, estimate.model)
    experiment = next_experiment(estimate, rivals, limits, task.sensor, task.training)
    logger.info(experiment)
    if estimate.random_torque and not task.known:
        logger.info("  the model lacks something, so that this says little: diagnose the log, then plan with --model")
    write_json(command.json, experiment.to_dict)
    if command.out is not None and not experiment.u.size:
        logger.info(f"{command.out} was not written: there is nothing to play")
    else:
        write(command.out, experiment.write_csv)


@_run.register
def _(command: ExportCommand) -> None:
    from sysid.export.mjcf import to_mjcf
    from sysid.export.urdf import to_urdf

    urdf = command.to.suffix.lower() == ".urdf"
    if not urdf and command.to.suffix.lower() != ".xml":
        raise InvalidInput(f"{command.to.name} is neither MJCF nor URDF: expected a name that ends with .xml or .urdf")
    if urdf and command.into is not None:
        raise InvalidInput(f"--into changes a file of MJCF: expected --to FILE.xml, not {command.to.name}")
    check_outputs([command.model, command.into], [command.to, command.json], command.force)
    model, joint = load_model(command.model), command.joint
    exported = to_urdf(model, joint) if urdf else to_mjcf(model, joint, command.into)
    for sentence in exported.sentences:
        logger.info(sentence)
    write_json(command.json, exported.to_dict)
    write(command.to, exported.save)


@_run.register
def _(command: EffectsCommand) -> None:
    for name, kind in {**ACTUATORS, **CATALOGUE}.items():
        logger.info(name)
        logger.info(f"    {kind.formula or (kind.__doc__ or '').strip().splitlines()[0]}")
        parameters = ", ".join(f"{p.name} [{p.unit}]" for p in kind().parameters.values())
        logger.info(f"    parameters: {parameters}")
        if kind.confused:
            logger.info(f"    may be confused with: {', '.join(kind.confused)}")


# ---- what all commands on a log begin and end with -------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class LogAndModel:
    """A log with its noise, and the model to begin with.

    measured, sensor   the noise of all readings, and of those that a fit of the model relies on
    names   the parameters that a fit may move
    known   whether nothing has to be fitted first: the model came from a file, and all that was added has its numbers
    """

    log: Log
    measured: Sensor
    sensor: Sensor
    training: tuple[Record, ...]
    held_out: tuple[Record, ...]
    model: Model
    names: tuple[str, ...]
    known: bool

    @classmethod
    def of(cls, command: OnLog) -> LogAndModel:
        """Read everything, and say what was read. Raises InvalidInput before anything expensive."""
        outputs = [getattr(command, name, None) for name in ("out", "json", "html", "figure", "parquet")]
        check_outputs([*command.log.files, command.log.settings, command.start.model, command.start.effects], outputs)
        model, names, added = begun(command.start, command.log.input)
        given = command.start.model is not None
        log = read_log(command.log, model)
        logger.info(log)
        measured = _sensor(command.log, log, model.plant)
        training, held_out = split(log, command.log.hold_out)
        model = sampled(model, names, log, given)
        model, names = identifiable_part(model, names, log, given)
        if not given:
            model = initial_guess(model, names, training, measured)
        sensor = relied_on(model, training, measured)
        if sensor != measured:
            what = quantity("theta_dot", model.plant.quantities)
            logger.info(f"the {what} is left out: beside theta it tells little, or it is filtered or late")
        return cls(log, measured, sensor, training, held_out, model, names, given and not added)

    def fitted(self) -> Estimate:
        """The model fitted to what is not held out; raises InvalidInput where nothing is free."""
        return fit(self.model, self.training, self.sensor, self.names)

    def doubt(self, error: HeldOutError) -> None:
        """Say so where the model explains next to nothing of the angle: an error of columns rather than of physics."""
        if error.theta is None or error.ratio < FAR_ABOVE_NOISE:
            return
        spread = float(np.std(np.concatenate([r.theta for r in self.held_out if r.theta is not None])))
        if not error.theta < 0.3 * spread:
            logger.info("  the error is far above any noise: check columns, units, --zero, --flip-torque and --plant")


def read_log(options: LogOptions, model: Model) -> Log:
    """The log as the options say, for a model of what it is of."""
    return read(*options.files, **{**options.reading(), "plant": model.plant, "command": model.command})


# ---- noise -----------------------------------------------------------------------------------------------------------


def _sensor(options: LogOptions, log: Log, plant: Plant) -> Sensor:
    """The noise that the user gave; what was not given is found. Raises InvalidInput where nothing moves."""
    measured = [c for c in ("theta", "theta_dot") if all(getattr(r, c) is not None for r in log)]
    if all(np.ptp(getattr(r, c)) == 0.0 for r in log for c in measured):
        at = getattr(log[0], measured[0])[0]
        raise InvalidInput(f"the machine is at rest: {measured[0]} stays at {at:.4g}: nothing shows its inertia")
    given = named_numbers("--noise", options.noise.split(",") if options.noise else ())
    for channel in given:
        if channel not in measured:
            raise InvalidInput(f"--noise names {channel!r}: this log measures {' and '.join(measured)}")
    if set(given) == set(measured):
        sensor = Sensor(**given)
    else:
        noise = sensor_noise(log)
        sensor = dataclasses.replace(noise.sensor, **given)
        errors = {channel: error for channel, error in noise.error.items() if channel not in given}
        logger.info(dataclasses.replace(noise, sensor=sensor, error=errors).sentence(plant))
    check_excitation(log, sensor)
    return sensor


# ---- what the rig may do ---------------------------------------------------------------------------------------------


def _limits(options: ExperimentCommand, log: Log, model: Model) -> Limits:
    """What the log has done, where the user says nothing else."""
    from sysid.planning.next_experiment import limits_of

    names = ("u_max", "duration", "rollouts", "theta_max", "theta_dot_max")
    given: dict[str, Any] = {n: getattr(options, n) for n in names if getattr(options, n) is not None}
    if np.any([np.any(record.u != 0.0) for record in log]):
        return dataclasses.replace(limits_of(log, model), **given)
    if options.u_max is None:
        raise InvalidInput("the log has no torque to go by: give --u-max")
    return Limits(**given)


# ---- what commands write ---------------------------------------------------------------------------------------------


def write(path: Path | None, writer: Callable[[Path], None]) -> None:
    """Write a file that was asked for, and say so."""
    if path is not None:
        writer(path)
        logger.info(f"wrote {path}")


def write_json(path: Path | None, to_dict: Callable[[], dict[str, Any]]) -> None:
    """Write what an answer tells as plain data: some of it costs as much as the answer. The schema comes first."""
    write(
        path, lambda file: save_file(file, json.dumps({"schema": ANSWER} | to_dict(), indent=1, allow_nan=False) + "\n")
    )


def _write_page(answer: Any, path: Path) -> None:
    from sysid.report.write import write_report

    write_report(answer, path, shlex.join(["python", "-m", "sysid", *sys.argv[1:]]))


def _draw(comparison: Any, path: Path) -> None:
    from sysid.report.figures import plot_comparison

    content = BytesIO()
    try:
        plot_comparison(comparison).savefig(content, format=path.suffix.removeprefix(".") or "png")
    except ValueError as error:
        raise InvalidInput(f"cannot write {path}: {error}") from None
    save_file(path, content.getvalue())

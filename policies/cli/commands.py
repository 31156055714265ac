"""The commands of the command line: each reads its files, answers one question, writes what was asked."""

from __future__ import annotations

import dataclasses
import logging
import math
from collections.abc import Mapping, Sequence
from functools import singledispatch
from pathlib import Path
from typing import Any

import numpy as np

from policies.cli.options import EvaluateCommand, ExportPolicyCommand, TrainCommand
from policies.control.references import ReferenceReturn, references
from policies.environments import task
from policies.environments.machine import (
    advised_interval,
    check_machine,
    check_stable,
    machine_of,
    past_commands_needed,
)
from policies.environments.randomization import Band, Fixed, Posterior, Randomization, Ranges
from policies.evaluation import Evaluation, evaluate, fresh_start_states
from policies.limits import EPISODES, EVALUATION_MEMORY, LAYER_WIDTH, LAYERS
from policies.storage.policy_file import DESCRIPTION, LONGEST_HISTORY, WEIGHTS, SavedPolicy, load_policy, save_policy
from sysid import InvalidInput, Model, Parameter, SavedModel, load
from sysid.cli.commands import register_effects, write_json
from sysid.data.files import check_outputs, full_path
from sysid.limits import check_size

logger = logging.getLogger(__name__)
JUDGED = 200
"""Start states from which `train` states the expected return."""
LARGEST_SEED = 2**62
CHECKPOINT = "training.checkpoint"
"""What an unfinished training is, in the policy's folder."""
NARROW = 20.0
"""Bounds whose ends differ by no more than this factor say what is plausible."""


@singledispatch
def run(command: Any) -> None:
    """Run a command of policies.cli.options. Raises InvalidInput for bad input."""
    raise InvalidInput(f"unknown command {command!r}")


@run.register
def _(command: TrainCommand) -> None:
    _check_numbers(command)
    _check_folder(command.out, [command.model, command.effects], command.force)
    register_effects(command.effects)
    saved = load(command.model)
    machine = machine_of(saved.model, command.u_max, command.dt)
    randomization = _randomization(command, saved, machine)
    check_machine(machine, randomization)
    history = history_for(machine, randomization) if command.history is None else command.history
    task.check_history(history, machine.dt)

    from policies.training.cpu_settings import tune_cpu
    from policies.training.program import settings_for, train

    settings = settings_for(machine, command.hidden, command.steps, command.algorithm)
    checkpoint = _checkpoint(command)
    _introduce(command, saved.model, machine, randomization, history)
    layers = " x ".join(map(str, command.hidden))
    agents = "1 agent" if command.agents == 1 else f"{command.agents} agents"
    logger.info(f"training {agents} of {layers} by {command.algorithm} for {settings.steps:,} steps")
    tune_cpu(threads=1)
    seeds = range(command.seed, command.seed + command.agents)
    training = train(machine, randomization, settings, seeds, history, _Curve(), checkpoint)
    if command.agents > 1:
        returns = ", ".join(f"{value:.0f}" for value in training.chosen)
        logger.info(f"agent {training.best + 1} is the best on this model, by other start states: {returns}")
    starts = fresh_start_states(0, JUDGED)
    worth = evaluate(training.policy, machine, *starts)
    about = {
        "model_file": command.model.name,
        "randomization": randomization.to_json(),
        "algorithm": settings.algorithm,
        "settings": dataclasses.asdict(settings),
        "seeds": list(training.seeds),
        "best": training.best,
        "return": _plain(worth),
        "curve": [[step, value] for step, value in training.curves[training.best]],
        "seconds": round(training.seconds, 1),
    }
    save_policy(training.policy, machine, command.out, about)
    logger.info(f"wrote {command.out / DESCRIPTION} and {WEIGHTS}")
    logger.info(f"expected return on this model ({JUDGED} fresh start states, 95 % intervals):")
    _show("this policy", worth)
    if not command.no_references:
        _show_references(references(machine, *starts))


@run.register
def _(command: EvaluateCommand) -> None:
    _check_whole("--episodes", command.episodes, 2, EPISODES)
    _check_whole("--seed", command.seed, 0, LARGEST_SEED)
    inputs = [command.model, command.effects, command.policy / DESCRIPTION, command.policy / WEIGHTS]
    check_outputs(inputs, [command.json], command.force)
    register_effects(command.effects)
    saved = load_policy(command.policy)
    widest = max(len(b) for _, b in saved.policy.layers)
    check_size("bytes of memory for all start states:", 4.0 * widest * command.episodes, EVALUATION_MEMORY)
    starts = fresh_start_states(command.seed, command.episodes)
    evaluation = evaluate(saved.policy, saved.model, *starts)
    logger.info(f"return from {command.episodes} start states, 95 % intervals:")
    _show("on its own model", evaluation)
    data: dict[str, Any] = {"schema": "gapfinder/transfer/1", "episodes": command.episodes, "own": _plain(evaluation)}
    on = saved.model
    if command.model is not None:
        on = _other(command.model, saved)
        other = evaluate(saved.policy, on, *starts)
        gap = Evaluation(evaluation.returns - other.returns)
        _show(f"on {command.model.name}", other)
        _show("transfer gap", gap, "what it loses there, paired over start states")
        data |= {"other": _plain(other), "gap": _plain(gap)}
    if command.references:
        logger.info(f"others on {'its own model' if command.model is None else command.model.name}:")
        reference_returns = references(on, *starts)
        _show_references(reference_returns)
        data["references"] = [
            {"name": r.name, "note": r.note, **({} if r.evaluation is None else _plain(r.evaluation))}
            for r in reference_returns
        ]
    write_json(command.json, lambda: data)


@run.register
def _(command: ExportPolicyCommand) -> None:
    inputs = [command.effects, command.policy / DESCRIPTION, command.policy / WEIGHTS]
    check_outputs(inputs, [command.out], command.force)
    register_effects(command.effects)
    from policies.storage.onnx_file import write_onnx

    saved = load_policy(command.policy)
    difference = write_onnx(saved.policy, saved.model.dt, command.out)
    logger.info(f"wrote {command.out}: differs from the policy by at most {difference:.1g} of its largest torque")


# ---- train -----------------------------------------------------------------------------------------------------------


def _checkpoint(command: TrainCommand) -> Path:
    """Where this training is kept until it ends."""
    file = command.out / CHECKPOINT
    if command.force:
        file.unlink(missing_ok=True)
    elif file.exists():
        logger.info(f"going on from {file}; --force begins anew")
    return file


def _check_numbers(command: TrainCommand) -> None:
    _check_whole("--steps", 1 if command.steps is None else command.steps, 1, 10**9)
    _check_whole("--agents", command.agents, 1, 1000)
    _check_whole("--seed", command.seed, 0, LARGEST_SEED)
    _check_whole("--history", command.history or 0, 0, LONGEST_HISTORY)
    for size in command.hidden:
        _check_whole("--hidden", size, 1, LAYER_WIDTH)
    check_size("--hidden: layers:", len(command.hidden), LAYERS - 1)


def _check_whole(option: str, number: int, low: int, high: int) -> None:
    if not low <= number <= high:
        raise InvalidInput(f"{option} {number}: expected a whole number from {low} to {high:g}")


def _randomization(command: TrainCommand, saved: SavedModel, machine: Model) -> Randomization:
    """What --randomize says, of the parameters that a fit may move."""
    parameters = machine.parameters
    names = [name for name in saved.free if name in parameters]
    kind, _, width = command.randomize.partition(":")
    if command.range and kind != "prior":
        raise InvalidInput(f"--range {command.range[0]}: expected --randomize prior with it")
    if command.randomize == "none":
        return Fixed()
    if not names:
        raise InvalidInput(
            f"--randomize {command.randomize}: {command.model.name} has no parameter that a fit may move"
        )
    if kind == "band":
        return Band({name: float(parameters[name].value) for name in names}, _number("--randomize", width, "band:0.3"))
    if command.randomize == "prior":
        return Ranges({name: plausible_range(parameters[name]) for name in names} | _ranges(command.range, parameters))
    if command.randomize == "posterior":
        if saved.estimate is None:
            never = f"{command.model.name} was never fitted; expected one that `sysid fit -o` wrote"
            raise InvalidInput(f"--randomize posterior: {never}")
        return Posterior.of(saved.estimate, names)
    raise InvalidInput(f"--randomize {command.randomize}: expected none, band:W as in band:0.3, posterior or prior")


def plausible_range(p: Parameter) -> tuple[float, float]:
    """What a parameter may be where nobody measured: its bounds, where their ends are within a factor of 20; else half
    to twice a plant's number (or a limit's), and from nothing to twice an effect's."""
    low, high = p.bounds
    if low > 0.0 and high <= NARROW * low:
        return low, high
    value = float(p.value)
    nothing = None if p.never else p.neutral
    ends = (0.5 * value, 2.0 * value) if nothing is None else (nothing, nothing + 2.0 * (value - nothing))
    low, high = np.clip(sorted(ends), low, high).tolist()
    return low, high


def _ranges(given: Sequence[str], known: Mapping[str, Parameter]) -> dict[str, tuple[float, float]]:
    ranges = {}
    for text in given:
        name, _, ends = (part.strip() for part in text.partition("="))
        low, _, high = ends.partition(":")
        if name not in known:
            raise InvalidInput(f"--range {text}: unknown parameter {name!r}; this model has {', '.join(known)}")
        ranges[name] = _number("--range", low, "m=0.5:2"), _number("--range", high, "m=0.5:2")
        for end in ranges[name]:
            known[name].check(end)
    return ranges


def _number(option: str, text: str, example: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise InvalidInput(f"{option}: {text!r} is no number; expected {example}") from None


def history_for(machine: Model, randomization: Randomization) -> int:
    """As many past commands as the delays and lags reach back, in the longest of some draws."""
    rng = np.random.default_rng(0)
    wanted = max(past_commands_needed(machine.with_parameters(randomization.sample(rng, machine))) for _ in range(20))
    if wanted > LONGEST_HISTORY:
        logger.info(f"delays and lags reach back {wanted} commands: the policy observes the last {LONGEST_HISTORY}")
    return min(LONGEST_HISTORY, wanted)


def _introduce(command: TrainCommand, model: Model, machine: Model, randomization: Randomization, history: int) -> None:
    numbers = ", ".join(f"{name} = {p.value:.4g} {p.unit}" for name, p in machine.parameters.items())
    logger.info(f"{command.model.name}: {type(machine.plant).__name__}, {numbers}; torque up to {machine.u_max:g} N m")
    left_out = [e.name for e in model.effects if e.of_log]
    if left_out:
        logger.info(f"left out, as it belongs to the log: {', '.join(left_out)}")
    past = {0: "", 1: " and its last command"}.get(history, f" and its last {history} commands")
    seen = ", ".join(task.observation_names()) + past
    logger.info(f"task: swing up and hold for {task.DURATION:g} s, a command every {machine.dt:g} s; observed: {seen}")
    rng = np.random.default_rng(0)
    draws = [randomization.sample(rng, machine) for _ in range(200)]
    spread = ", ".join(
        f"{name} {min(d[name] for d in draws):.3g} .. {max(d[name] for d in draws):.3g}" for name in draws[0]
    )
    logger.info(f"drawn in every episode: {spread or 'nothing'}")
    low, high = advised_interval(machine)
    if not low <= machine.dt <= high:
        slow = "more than it can wait" if machine.dt > high else "which only makes its episodes long"
        logger.info(f"a command every {machine.dt:g} s is {slow}: --dt from {low:.2g} to {high:.2g} suits this machine")


class _Curve:
    """The learning curve, line by line; a bar is what an episode costs."""

    width, most = 40, 2000.0

    def __init__(self) -> None:
        self.begun = False

    def __call__(self, steps: int, returns: Sequence[float], seconds: float, left: float) -> None:
        if not returns:
            logger.info(f"this takes about {_span(seconds + left)} here")
            return
        value = float(np.mean(returns))
        if not math.isfinite(value):
            return
        if not self.begun:
            logger.info("     step   return in training")
            self.begun = True
        bar = "#" * max(1, min(self.width, round(-value / self.most * self.width)))
        ahead = f", {_span(left)} left" if left > 0.0 else ""
        logger.info(f"{steps:9,} {value:9.0f}  {bar:<{self.width}}  {seconds:5.0f} s{ahead}")


def _span(seconds: float) -> str:
    """A time as people say it."""
    return f"{seconds:.0f} s" if seconds < 90.0 else f"{seconds / 60.0:.0f} min"


# ---- evaluate --------------------------------------------------------------------------------------------------------


def _other(file: Path, saved: SavedPolicy) -> Model:
    """Another model as the machine that the policy meets: its commands come at the policy's times."""
    model, policy = load(file).model, saved.policy
    own_limit = math.isfinite(model.u_max)
    try:
        machine = machine_of(model, None if own_limit else policy.u_max, saved.model.dt)
        check_stable(machine, Fixed())
    except InvalidInput as error:
        raise InvalidInput(f"{file.name}: {error}") from None
    if own_limit and model.u_max < policy.u_max:
        logger.info(f"{file.name} gives at most {model.u_max:g} N m, the policy commands up to {policy.u_max:g} N m")
    return machine


# ---- what is said ----------------------------------------------------------------------------------------------------


def _show(name: str, evaluation: Evaluation, note: str = "") -> None:
    low, high = evaluation.interval()
    logger.info(f"  {name:<30} {evaluation.mean:9.1f}  [{low:.1f}, {high:.1f}]{'  ' + note if note else ''}")


def _show_references(reference_returns: Sequence[ReferenceReturn]) -> None:
    for reference in reference_returns:
        if reference.evaluation is None:
            logger.info(f"  {reference.name:<30}   unknown: {reference.note}")
        else:
            _show(reference.name, reference.evaluation, reference.note)


def _plain(evaluation: Evaluation) -> dict[str, Any]:
    return {"mean": evaluation.mean, "interval": list(evaluation.interval()), "episodes": len(evaluation.returns)}


# ---- files -----------------------------------------------------------------------------------------------------------


def _check_folder(folder: Path, inputs: Sequence[Path | None], force: bool) -> None:
    full = full_path(folder, "write")
    if full.exists() and not full.is_dir():
        raise InvalidInput(f"{folder} is a file: expected a folder for the policy")
    if full.is_dir():
        check_outputs(inputs, [folder / DESCRIPTION, folder / WEIGHTS], force)
    elif not full.parent.is_dir():
        raise InvalidInput(f"cannot write {folder}: there is no folder {folder.parent}")

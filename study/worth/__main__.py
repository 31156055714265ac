"""Measure again, or train? What further rollouts are worth, told before they are measured.

python -m study.worth swing*.csv --model model.json               the price of a rollout below which measuring pays
python -m study.worth swing*.csv --model model.json --price 3     whether to measure, where a rollout costs 3
"""

from __future__ import annotations

import dataclasses
import logging
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Annotated

from tyro.conf import arg

from sysid.cli.command_line import answer_one, entry_point
from sysid.cli.command_options import File, Number, OnLog, Output
from sysid.errors import InvalidInput

if TYPE_CHECKING:
    from sysid.cli.commands import LogAndModel
    from sysid.estimation.estimate import Estimate

logger = logging.getLogger(__name__ if __name__ != "__main__" else "study.worth")


@dataclass(frozen=True)
class WorthOptions(OnLog):
    """Measure again, or train? What further rollouts are worth to the policy, before they are measured.

    The machines that the log leaves possible are drawn, and dynamic programming says what a policy that swings up
    and holds would return on them: one made now, after further rollouts, and with perfect knowledge.
    """

    price: Annotated[Number, arg(metavar="RETURN")] = None
    """What one rollout costs, in units of the return; without it the price is told below which measuring pays."""

    u_max: Annotated[Number, arg(metavar="TORQUE", help_behavior_hint="(default: the model's)")] = None
    """Largest torque [N m] that the policy commands."""

    further: Annotated[tuple[int, ...], arg(metavar="N")] = (1, 3, 10)
    """The numbers of further rollouts that are tried."""

    draws: Annotated[int, arg(metavar="N")] = 32
    """Machines drawn: standard errors fall as their root, and time grows with them."""

    seed: Annotated[int, arg(metavar="S")] = 0
    """Where the draws come from."""

    out: Output = None
    """Write the designed rollout here, as CSV with columns t [s], torque [N m]."""

    json: File = None
    """Write the answer here, as schema gapfinder/worth/1."""

    figure: File = None
    """Draw the answer here (.png)."""


@entry_point
def main(arguments: Sequence[str]) -> int:
    """Run the command line; returns the exit code: 0 answered, 1 nobody reads on, 2 bad input, 130 stopped."""
    return answer_one(WorthOptions, run, "python -m study.worth", arguments)


def run(command: WorthOptions) -> None:
    """Answer the command. Raises InvalidInput for bad input."""
    import numpy as np

    from study.worth.decision import SwingUpDecision
    from study.worth.value_of_information import check_question, worth_of_rollouts
    from sysid.cli.commands import LogAndModel, completed, write, write_json
    from sysid.planning.next_experiment import limits_of, next_experiment

    check_question(command.price, command.further, command.draws)
    if command.seed < 0:
        raise InvalidInput(f"--seed {command.seed}: expected a whole number, 0 or more")
    command = completed(command)
    task = LogAndModel.of(command)
    SwingUpDecision.of(task.model, task.names, command.u_max)  # raises before anything is fitted
    estimate = _estimate(command, task)
    logger.info(estimate)
    if not estimate.success:
        raise InvalidInput(f"the fit cannot be used ({estimate.status}): expected one that converged")
    logger.debug("drawing machines and making policies for them")
    decision = SwingUpDecision.of(estimate.model, estimate.names, command.u_max)
    limits = dataclasses.replace(limits_of(tuple(task.log), estimate.model), rollouts=1)
    worth = worth_of_rollouts(
        estimate,
        _rollouts(task),
        decision,
        lambda cost: next_experiment(estimate, limits=limits, sensor=task.sensor, cost=cost),
        command.price,
        command.further,
        command.draws,
        np.random.default_rng(command.seed),
    )
    logger.info(worth)
    write_json(command.json, worth.to_dict)
    if worth.experiment is None:
        unwritten = [str(path) for path in (command.out, command.figure) if path is not None]
        if unwritten:
            logger.info(f"{' and '.join(unwritten)} not written: nothing is worth measuring")
        return
    logger.info(f"the designed rollout: {worth.experiment}")
    write(command.out, worth.experiment.write_csv)
    if command.figure is not None:
        from study.figure_style import save_figure
        from study.worth.figure import worth_figure

        write(command.figure, partial(save_figure, partial(worth_figure, worth)))


def _estimate(command: WorthOptions, task: LogAndModel) -> Estimate:
    """What is known: the estimate in --model where it holds one and nothing was added, else a fit."""
    if task.known and command.start.model is not None:
        from sysid.estimation.saved_model import load

        saved = load(command.start.model)
        if saved.estimate is not None:
            return saved.estimate
    return task.fitted()


def _rollouts(task: LogAndModel) -> float:
    """How many rollouts a fit saw: those of the log, less what was held out."""
    seen, all_ = (sum(len(record.u) for record in records) for records in (task.training, task.log))
    return len(task.log) * seen / all_


if __name__ == "__main__":
    sys.exit(main())

"""What the command line of `python -m study.worth` understands."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from tyro.conf import arg

from sysid.cli.command_options import File, Number, OnLog, Output


@dataclass(frozen=True)
class WorthOptions(OnLog):
    """Measure again, or train? What further rollouts are worth to the policy, before they are measured.

    The machines that the log leaves possible are drawn, and dynamic programming says what a policy made now, after
    further rollouts, and with perfect knowledge would return on them.
    """

    task: Literal["swing-up"] = "swing-up"
    """What the policy is for: swing up and hold."""

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

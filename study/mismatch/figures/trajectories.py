"""Why one policy holds the pendulum up and another does not: how they move one hidden plant from the same starts."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from policies.environments import task
from policies.evaluation import Episodes, Policy, rollout
from study.figure_style import ACCENT, COLOURS
from study.formatting import MINUS, number
from sysid import Model, State, ops

Array = NDArray[np.float64]


def trajectories(
    plant_name: str,
    model: Model,
    policies: Mapping[str, Policy],
    starts: tuple[Array, Array],
    labels: Mapping[str, str] | None = None,
) -> Figure:
    """Angle and torque of each policy, a column each, from the start states theta (E,), theta_dot (E,).

    plant_name   of the hidden plant, as the title says it; model: that plant
    labels       what stands above a column, by the policy's name; the mean return of these episodes is added
    """
    motions = {name: rollout(policy, model, *starts) for name, policy in policies.items()}
    figure = Figure(figsize=(1.0 + 4.7 * len(motions), 4.4), layout="constrained")
    rows = figure.subplots(2, len(motions), sharex=True, sharey="row", squeeze=False, height_ratios=(1.5, 1.0))
    for (name, motion), upper, lower in zip(motions.items(), *rows, strict=True):
        _angles(upper, motion)
        _torques(lower, motion, model.u_max)
        upper.set_title(f"{(labels or {}).get(name, name)}: {number(_return(motion, model))} from these starts", pad=8)
        lower.set_xlabel("time [s]")
    rows[0, 0].set_ylabel("angle from upright [°]")
    rows[1, 0].set_ylabel("torque [N m]")
    figure.suptitle(plant_name, x=0.01, ha="left", fontsize=10.0, color="0.3")
    return figure


def _angles(axes: Axes, motion: Episodes) -> None:
    axes.axhline(0.0, color=ACCENT, linewidth=1.1, zorder=1)
    for k, colour in enumerate(_colours(motion)):
        degrees = np.degrees(ops.wrap(motion.theta[:, k]))
        around = np.flatnonzero(np.abs(np.diff(degrees)) > 180.0) + 1
        axes.plot(np.insert(motion.t, around, np.nan), np.insert(degrees, around, np.nan), color=colour, linewidth=1.5)
    axes.set_ylim(-185.0, 185.0)
    axes.set_yticks([-180, -90, 0, 90, 180], ["hanging", f"{MINUS}90", "upright", "90", "hanging"])


def _torques(axes: Axes, motion: Episodes, u_max: float) -> None:
    """Of the first episode, and the others faint behind it."""
    for k, colour in enumerate(_colours(motion)):
        axes.step(motion.t, motion.u[:, k], where="post", color=colour, linewidth=0.8 if k else 1.4,
                  alpha=0.25 if k else 1.0, zorder=2 if k else 3)  # fmt: skip
    axes.set_ylim(-1.12 * u_max, 1.12 * u_max)
    axes.set_yticks([-u_max, 0.0, u_max], [number(-u_max), "0", number(u_max)])


def _colours(motion: Episodes) -> list[tuple[float, ...]]:
    episodes = motion.theta.shape[1]
    return [COLOURS(0.05 + 0.75 * k / max(1, episodes - 1)) for k in range(episodes)]


def _return(motion: Episodes, model: Model) -> float:
    rewards = task.reward(State(motion.theta, motion.theta_dot), motion.u, model.dt)
    return float(np.mean(np.sum(rewards, axis=0)))

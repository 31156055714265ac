"""Why one policy holds the pendulum up and another does not: two agents on a hidden plant, from the same starts."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from policies.environments import task
from policies.evaluation import Episodes, Policy, fresh_start_states, rollout
from study.figure_style import ACCENT, shades
from study.formatting import MINUS, capital, number
from study.mismatch.mismatch_findings import MismatchFindings
from study.mismatch.mismatch_plan import SPLIT
from study.pipeline.policy_files import FOLDER, read_policies
from study.strategies.trial_plan import Case
from study.trials.ground_truth import ground_truth
from sysid import Model, State, ops
from sysid.physics.ops import Array

if TYPE_CHECKING:
    from policies.network_policy import NetworkPolicy


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
    for k, colour in enumerate(shades(motion.theta.shape[1], 0.05, 0.8)):
        degrees = np.degrees(ops.wrap(motion.theta[:, k]))
        around = np.flatnonzero(np.abs(np.diff(degrees)) > 180.0) + 1
        axes.plot(np.insert(motion.t, around, np.nan), np.insert(degrees, around, np.nan), color=colour, linewidth=1.5)
    axes.set_ylim(-185.0, 185.0)
    axes.set_yticks([-180, -90, 0, 90, 180], ["hanging", f"{MINUS}90", "upright", "90", "hanging"])


def _torques(axes: Axes, motion: Episodes, u_max: float) -> None:
    """Of the first episode, and the others faint behind it."""
    for k, colour in enumerate(shades(motion.theta.shape[1], 0.05, 0.8)):
        axes.step(motion.t, motion.u[:, k], where="post", color=colour, linewidth=0.8 if k else 1.4,
                  alpha=0.25 if k else 1.0, zorder=2 if k else 3)  # fmt: skip
    axes.set_ylim(-1.12 * u_max, 1.12 * u_max)
    axes.set_yticks([-u_max, 0.0, u_max], [number(-u_max), "0", number(u_max)])


def _return(motion: Episodes, model: Model) -> float:
    rewards = task.reward(State(motion.theta, motion.theta_dot), motion.u, model.dt)
    return float(np.mean(np.sum(rewards, axis=0)))


SHOWN_EPISODES = 4
"""Start states whose trajectories are shown: the first ones of the evaluation."""


def telling(findings: MismatchFindings) -> Case | None:
    """Where mending gained most in the mean, the seed whose gain is nearest to the median gain: neither the best nor
    the worst. None where the plan has no such contrast."""
    rows = [row for row in findings.compared if (row.a, row.b) == ("mended", "fitted")]
    if not rows:
        return None
    most = max(rows, key=lambda row: row.contrast.mean)
    condition = findings.condition(most.plant, most.a, most.n)
    mended, fitted = findings.outcomes[condition], findings.outcomes[condition._replace(strategy=most.b)]
    k = int(np.argmin(np.abs(mended.returns - fitted.returns - most.median)))
    return Case(*condition, mended.seeds[k])


def telling_trajectories(
    findings: MismatchFindings, answers: Mapping[Case, Mapping[str, Any]], folder: Path
) -> Callable[[], Figure] | None:
    """The figure of the telling pair of agents, whose policies lie in the results folder; None where these are gone."""
    if not (shown := telling(findings)):
        return None
    wanted = {key: answers[shown._replace(strategy=key)]["deployed"] for key in SPLIT}
    found = read_agents(folder, wanted.values())
    if not set(wanted.values()) <= set(found):
        return None
    plant, states = findings.plan.plant(shown.plant), fresh_start_states(shown.seed, findings.plan.episodes)
    title = f"{capital(plant.title)}, {shown.n} rollouts, seed {shown.seed}"
    theta, theta_dot = (own[:SHOWN_EPISODES] for own in states)
    policies = {strategy: found[key] for strategy, key in wanted.items()}
    return lambda: trajectories(title, ground_truth(plant), policies, (theta, theta_dot))


def read_agents(folder: Path, keys: Iterable[str]) -> dict[str, NetworkPolicy]:
    """Those of the agents with these keys whose policies lie in the results folder."""
    found: dict[str, NetworkPolicy] = {}
    left = set(keys)
    for path in sorted((folder / FOLDER).glob("*.npz")):
        if left:
            own = read_policies(path)
            found |= {key: own[key] for key in left if key in own}
            left -= set(found)
    return found

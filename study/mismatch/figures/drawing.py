"""Draws the experiment's figures into a folder, and chooses the pair of agents whose trajectories are shown."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from policies.evaluation import fresh_start_states
from study.figure_style import save
from study.formatting import capital
from study.mismatch.figures.experiment import ladder, strategy_returns
from study.mismatch.figures.trajectories import trajectories
from study.mismatch.findings import Condition, MismatchFindings
from study.mismatch.ground_truth import ground_truth
from study.mismatch.mismatch_results import Fitted
from study.mismatch.plan import RUNGS, StrategyKey, Trial
from study.mismatch.trainings import agents_of
from study.pipeline.policy_files import FOLDER, read_policies

if TYPE_CHECKING:
    from policies.network_policy import NetworkPolicy

SHOWN_EPISODES = 4
"""Start states whose trajectories are shown: the first ones of the evaluation."""


def telling(findings: MismatchFindings) -> Trial | None:
    """Where mending gained most in the mean, the seed whose gain is nearest to the median gain: neither the best nor
    the worst. None where the plan has no such contrast."""
    rows = [row for row in findings.compared if (row.a, row.b) == (StrategyKey.MENDED, StrategyKey.FITTED)]
    if not rows:
        return None
    most = max(rows, key=lambda row: row.contrast.mean)
    mended, fitted = (findings.outcomes[Condition(most.plant, strategy, most.n)] for strategy in (most.a, most.b))
    k = int(np.argmin(np.abs(mended.returns - fitted.returns - most.median)))
    return Trial(most.plant, most.a, most.n, mended.seeds[k])


def draw_figures(findings: MismatchFindings, fits: Sequence[Fitted], folder: Path) -> dict[str, Path]:
    """Draw the figures into the results folder; returns the files by name. The trajectories need the folder's policies,
    and are left out where these are gone."""
    files = {
        "returns": save(lambda: strategy_returns(findings), folder / "returns.png"),
        "ladder": save(lambda: ladder(findings), folder / "ladder.png"),
    }
    if shown := telling(findings):
        keys, _ = agents_of(findings.plan, fits)
        wanted = {key: keys[shown._replace(strategy=key)] for key in (StrategyKey.FITTED, StrategyKey.MENDED)}
        found = read_agents(folder, wanted.values())
        if set(wanted.values()) <= set(found):
            policies = {strategy: found[key] for strategy, key in wanted.items()}
            files["trajectories"] = _trajectories(findings, shown, policies, folder / "trajectories.png")
    return files


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


def _trajectories(
    findings: MismatchFindings, shown: Trial, policies: dict[StrategyKey, NetworkPolicy], path: Path
) -> Path:
    plant = findings.plan.plant(shown.plant)
    theta, theta_dot = fresh_start_states(shown.seed, findings.plan.episodes)
    title = f"{capital(plant.title)}, {shown.n} rollouts, seed {shown.seed}"
    labels = {strategy: f"{RUNGS[strategy]} ({strategy})" for strategy in policies}
    starts = (theta[:SHOWN_EPISODES], theta_dot[:SHOWN_EPISODES])
    return save(lambda: trajectories(title, ground_truth(plant), policies, starts, labels), path)

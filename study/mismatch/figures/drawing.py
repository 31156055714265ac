"""Draws the experiment's figures into a folder, and chooses the pair of agents whose trajectories are shown."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from study.formatting import capital
from study.mismatch.findings import Condition, MismatchFindings
from study.mismatch.mismatch_results import MISMATCH_FIGURES, Fitted
from study.mismatch.plan import FREE, RUNGS, StrategyKey, Trial

if TYPE_CHECKING:
    from policies.network_policy import NetworkPolicy

SHOWN_EPISODES = 4
"""Start states whose trajectories are shown: the first ones of the evaluation."""

FILES = {name: f"{name}.png" for name in MISMATCH_FIGURES}


class AgentPair(NamedTuple):
    """Two agents on a hidden plant: of the strategies fitted and mended, after n rollouts, of one seed."""

    plant: str
    n: int
    seed: int

    def trial(self, strategy: str) -> Trial:
        return Trial(self.plant, strategy, 0 if strategy in FREE else self.n, self.seed)


def telling(findings: MismatchFindings) -> AgentPair | None:
    """Where mending gained most in the mean, the seed whose gain is nearest to the median gain: neither the best nor
    the worst. None where the plan has no such contrast."""
    rows = [row for row in findings.compared if (row.a, row.b) == (StrategyKey.MENDED, StrategyKey.FITTED)]
    if not rows:
        return None
    most = max(rows, key=lambda row: row.contrast.mean)
    mended, fitted = (
        findings.outcomes[Condition(most.plant, strategy, most.n)]
        for strategy in (StrategyKey.MENDED, StrategyKey.FITTED)
    )
    k = int(np.argmin(np.abs(mended.returns - fitted.returns - most.median)))
    return AgentPair(most.plant, most.n, mended.seeds[k])


def draw_figures(findings: MismatchFindings, fits: Sequence[Fitted], folder: Path) -> dict[str, Path]:
    """Draw the figures into the results folder; returns the files by the names of FILES. The trajectories need the
    folder's policies, and are left out where these are gone."""
    from study.figure_style import save
    from study.mismatch.figures.experiment import ladder, strategy_returns

    files = {
        "returns": save(lambda: strategy_returns(findings), folder / FILES["returns"]),
        "ladder": save(lambda: ladder(findings), folder / FILES["ladder"]),
    }
    pair = telling(findings)
    policies = {} if pair is None else _policies(findings, pair, fits, folder)
    if pair is not None and policies:
        files["trajectories"] = _trajectories(findings, pair, policies, folder / FILES["trajectories"])
    return files


def _policies(
    findings: MismatchFindings, pair: AgentPair, fits: Sequence[Fitted], folder: Path
) -> dict[str, NetworkPolicy]:
    """The pair's policies by strategy; {} unless both are there."""
    from study.mismatch.trainings import agents_of

    keys, _ = agents_of(findings.plan, fits)
    wanted = {strategy: keys[pair.trial(strategy)] for strategy in (StrategyKey.FITTED, StrategyKey.MENDED)}
    found = read_agents(folder, wanted.values())
    return {strategy: found[key] for strategy, key in wanted.items()} if set(wanted.values()) <= set(found) else {}


def read_agents(folder: Path, keys: Iterable[str]) -> dict[str, NetworkPolicy]:
    """Those of the agents with these keys whose policies lie in the results folder."""
    from study.pipeline.policy_files import FOLDER, read_policies

    found: dict[str, NetworkPolicy] = {}
    left = set(keys)
    for path in sorted((folder / FOLDER).glob("*.npz")):
        if left:
            own = read_policies(path)
            found |= {key: own[key] for key in left if key in own}
            left -= set(found)
    return found


def _trajectories(
    findings: MismatchFindings, pair: AgentPair, policies: Mapping[str, NetworkPolicy], path: Path
) -> Path:
    from policies.evaluation import fresh_start_states
    from study.figure_style import save
    from study.mismatch.figures.trajectories import trajectories
    from study.mismatch.ground_truth import ground_truth

    plant = findings.plan.plant(pair.plant)
    starts = fresh_start_states(pair.seed, findings.plan.episodes)
    title = f"{capital(plant.title)}, {pair.n} rollouts, seed {pair.seed}"
    labels = {strategy: f"{RUNGS[strategy]} ({strategy})" for strategy in policies}
    shown = (starts[0][:SHOWN_EPISODES], starts[1][:SHOWN_EPISODES])
    return save(lambda: trajectories(title, ground_truth(plant), policies, shown, labels), path)

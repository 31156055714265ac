"""Every preset of the study by name, and what runs it. This module loads nothing heavy: `--help` answers at once."""

from __future__ import annotations

import importlib
from contextlib import AbstractContextManager
from typing import Any

from study.mismatch.mismatch_plan import MISMATCH_PLANS
from study.paper.presets import PAPER_PRESETS
from study.pipeline.settings import RunOptions, StudySettings
from study.strategies.strategies_plan import STRATEGIES_PLANS

PRESETS: dict[str, StudySettings] = {**PAPER_PRESETS, **MISMATCH_PLANS, **STRATEGIES_PLANS}


def open_experiment(settings: StudySettings, options: RunOptions) -> AbstractContextManager[Any]:
    """The experiment (`StudyExperiment`) over the open folder of its results; loads what its kind needs alone.

    Raises InvalidInput for options of another kind, and a folder that cannot be used.
    """
    from sysid import InvalidInput

    for option, given, kinds, expected in (
        ("--import", options.imported, ("", "strategies"), "the paper's kind or of strategies"),
        ("--published", options.published, ("",), "the paper's kind"),
        ("--strategies", ",".join(options.strategies), ("strategies",), "strategies"),
    ):
        if given and settings.kind not in kinds:
            raise InvalidInput(f"{option} {given}: expected a preset of {expected}, not {settings.name}")
    experiment = importlib.import_module(settings.experiment)
    return experiment.open_experiment(settings, options)


ABOUT = """quick: 18 small agents, minutes. paper: the paper's 250 agents, 256 x 256. paper-small: the same as paper
with 64 x 64 networks, the one for CPUs. robustness: two gaps, two noise levels and the prior range, the table and the
text of the paper. robustness-small: the same, 64 x 64. identifiers: n on grid, least squares and Kalman filter.
longer, longer-small: the widest band with twice the steps. mismatch: does breadth pay when the simulator lacks an
effect; mismatch-quick: two of its plants, in minutes. strategies: published ways to spend rollouts, on the same
rollouts; strategies-small: with five rollouts of two plants; strategies-quick: in minutes. smoke, mismatch-smoke,
strategies-smoke: every part once, in a minute; the numbers mean nothing."""
"""What they are, for the command line."""

"""Every strategy by name, ours and a user's: `own.py:Halving` is the class Halving in the file own.py."""

from __future__ import annotations

import importlib
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from study.strategies.strategy import Strategy

PLACES = {
    "prior": "identified:PRIOR_ALONE",
    "prior_range": "identified:WHOLE_PRIOR_RANGE",
    "point": "identified:POINT_ESTIMATE",
    "grid": "identified:GRID_ESTIMATE",
    "kalman": "identified:KALMAN_ESTIMATE",
    "band": "identified:RELATIVE_BAND",
    "posterior": "identified:POSTERIOR_OF_FIT",
    "designed": "identified:DesignedExcitation",
    "mended": "identified:MENDED_MODEL",
    "random_force": "identified:UNDER_RANDOM_FORCE",
    "simopt": "simopt:SimOpt",
    "auto_tuned": "learned_search:AutoTuned",
    "adapt_sim": "learned_search:AdaptSim",
    "dropo": "dropo:Dropo",
    "bayes_sim": "bayes_sim:BayesSim",
    "bayrn": "candidates:BayRn",
    "cross_entropy": "candidates:CrossEntropy",
    "fine_tuning": "learning:FineTuning",
    "scratch": "learning:FromScratch",
}
"""Where each is: module of this package, and the class or the strategy in it. In the order in which they are shown."""


def strategy_called(name: str) -> Strategy:
    """The strategy of that name. Raises InvalidInput for an unknown one or one of an unknown group, and for a file
    without such a class."""
    strategy = _looked_up(name)
    return strategy() if isinstance(strategy, type) else strategy


@cache
def _looked_up(name: str) -> type[Strategy] | Strategy:
    from study.strategies.strategy import GROUPS, Strategy
    from sysid import InvalidInput
    from sysid.data.files import read_file
    from sysid.data.user_effects import run_file

    if name in PLACES:
        module, _, attribute = PLACES[name].partition(":")
        return getattr(importlib.import_module(f"study.strategies.{module}"), attribute)
    path, _, attribute = name.rpartition(":")
    if not path.endswith(".py"):
        raise InvalidInput(f"unknown strategy {name!r}: expected one of {', '.join(PLACES)}, or FILE.py:CLASS")
    read_file(Path(path), "a Python file with a strategy")
    strategy = getattr(run_file(Path(path).resolve(), f"{__name__}:{path}"), attribute, None)
    if not (isinstance(strategy, type) and issubclass(strategy, Strategy)):
        raise InvalidInput(
            f"{path} has no strategy {attribute!r}: expected a subclass of study.strategies.strategy.Strategy"
        )
    if strategy.group not in GROUPS:
        raise InvalidInput(f"strategy {name!r} has group = {strategy.group!r}: expected one of {', '.join(GROUPS)}")
    return strategy

"""What an input may cost: every size has a limit, stated here, that is checked before any memory is taken for it."""

from __future__ import annotations

from sysid.errors import InvalidInput

LOG_ROWS = 1_000_000
"""Rows of a log that are worked on."""
RAW_ROWS = 20_000_000
"""Rows that are read where a sample interval is asked for, and numbers of an array in a file."""
SHORTEST_INTERVAL = 1e-6
"""The shortest sample interval of a log [s]."""
LOG_SUBSTEPS = 200
"""Steps of the integrator in a sample interval of a log."""
SUBSTEPS = 10_000
"""Steps of the integrator in any control interval."""
EPISODE_STEPS = 20_000
"""Steps of the integrator in an episode of a policy."""
PLANNED_ROLLOUTS = 100
"""Rollouts of an experiment."""
PLANNED_SAMPLES = 20_000
"""Samples of an experiment, all its rollouts together."""
EPISODES = 100_000
"""Start states from which a policy is judged."""
LAYERS = 20
"""Layers of a policy's network."""
LAYER_WIDTH = 10_000
"""Width of a layer."""
TRAINING_MEMORY = 8e9
"""Bytes that networks, optimisers and transitions of a training take."""
EVALUATION_MEMORY = 2e9
"""Bytes that the widest layer takes for all start states."""
MAGNITUDE = 1e12
"""The largest reading, command or time of a log."""


def check_size(what: str, size: float, most: float, advice: str = "") -> None:
    """Raise InvalidInput where a size is above its limit. what: what has that size; advice: what else to expect."""
    if not size <= most:
        raise InvalidInput(f"{what} {_plain(size)}: expected at most {_plain(most)}{f', {advice}' if advice else ''}")


def _plain(size: float) -> str:
    return f"{size:,.0f}" if size < 1e12 else f"{size:.3g}"

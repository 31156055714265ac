"""What an input may cost: every size has a limit, stated here, that is checked before more memory is taken for it."""

from __future__ import annotations

import math

from sysid.errors import InvalidInput

LOG_ROWS = 1_000_000
"""Rows of a log that are worked on."""
RAW_ROWS = 20_000_000
"""Rows that are read of a file, to be cut or resampled, and numbers of an array in a file."""
SHORTEST_INTERVAL = 1e-6
"""The shortest sample interval of a log [s]."""
LONGEST_INTERVAL = 2.0
"""The longest sample interval of a record [s]: in windows of a second, the least that is judged, it is none."""
LOG_SUBSTEPS = 200
"""Steps of the integrator in a sample interval of a log."""
SUBSTEPS = 10_000
"""Steps of the integrator in any control interval."""
PLANNED_ROLLOUTS = 100
"""Rollouts of an experiment."""
PLANNED_SAMPLES = 20_000
"""Samples of an experiment, all its rollouts together."""
MAGNITUDE = 1e12
"""The largest reading, command or time of a log."""
SIZES = (1e-20, 1e20)
"""Between which sizes a noise or a largest torque lies, in the unit of its channel: squares and sums stay finite."""


def check_size(what: str, size: float, most: float, advice: str = "") -> None:
    """Raise InvalidInput where a size is above its limit. what: what has that size; advice: what else to expect."""
    if not size <= most:
        raise InvalidInput(f"{what} {_plain(size)}: expected at most {_plain(most)}{f', {advice}' if advice else ''}")


def check_range(what: str, value: float) -> None:
    """Raise InvalidInput where a positive number is out of all proportion; inf stands for no limit at all."""
    low, high = SIZES
    if not (low <= value <= high or value == math.inf):
        raise InvalidInput(f"{what} {value:g}: expected {low:g} to {high:g}")


def _plain(size: float) -> str:
    return f"{size:,.0f}" if size < 1e12 else f"{size:.3g}"

"""The style of all figures: colours, what axes are called, bands, legends, and axes of multiples of the noise."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from sysid.diagnosis.findings import quantity
from sysid.physics.ops import Array

STYLE: Any = {
    "font.size": 9.0,
    "axes.titlesize": 10.0,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "0.4",
    "axes.labelcolor": "0.15",
    "xtick.color": "0.3",
    "ytick.color": "0.3",
    "legend.frameon": False,
    "axes.formatter.useoffset": False,
    "figure.dpi": 130.0,
}
# Okabe and Ito's colours, which all eyes tell apart
BLUE, ORANGE, GREEN, YELLOW, GREY = "#0072B2", "#D55E00", "#009E73", "#E69F00", "0.55"
LOOK: Any = {"theta": {"color": BLUE, "marker": "o"}, "theta_dot": {"color": ORANGE, "marker": "s"}}
SYMBOL = {"rad": {"theta": r"$\theta$", "theta_dot": r"$\dot\theta$"}, "m": {"theta": "$x$", "theta_dot": r"$\dot x$"}}
RASTERIZED_FROM = 1500
"""Points from which a picture in pixels is smaller than one of lines."""


@contextmanager
def styled(width: float, height: float) -> Iterator[Figure]:
    """A figure of that size [in], in the style of all."""
    with matplotlib.rc_context(STYLE):
        yield Figure(figsize=(width, height), layout="constrained")


def label(name: str, units: Mapping[str, str]) -> str:
    """What an axis of "theta", "theta_dot", "torque" or "time" is called where these are the plant's units."""
    parts = (quantity(name, units), SYMBOL[units["theta"]].get(name), f"[{units[name]}]")
    return " ".join(filter(None, parts))


def state_label(name: str, units: Mapping[str, str]) -> str:
    """The same, and where the angle is zero."""
    return label(name, units) + (", 0 upright" if name == "theta" and units["theta"] == "rad" else "")


def beyond(units: Mapping[str, str]) -> str:
    """What an axis of the residual torque is called."""
    return f"{quantity('torque', units)} beyond\nthe model [{units['torque']}]"


def banded(axes: Axes, x: Array, y: Array, half: Array, colour: str, **line: Any) -> None:
    """A curve with its band; in pixels where it has many points."""
    many = len(x) > RASTERIZED_FROM
    axes.fill_between(x, y - half, y + half, color=colour, alpha=0.25, linewidth=0.0, rasterized=many)
    axes.plot(x, y, color=colour, rasterized=many, **line)


def legend_above(axes: Axes) -> None:
    """What the lines are, where none of them runs."""
    axes.legend(
        ncols=3, loc="lower left", bbox_to_anchor=(-0.02, 1.0), fontsize=8.5, handlelength=1.4, columnspacing=1.2
    )


def noise_scale(axes: Axes) -> None:
    """A logarithmic axis of multiples of the noise, from below 1, with numbers that read as numbers."""
    axes.set_yscale("log")
    low, high = axes.get_ylim()
    axes.set_ylim(min(low, 0.65), max(1.15 * high, 2.2))
    few = axes.get_ylim()[1] < 30.0
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if few else (1.0,)))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())


def short(name: str, most: int = 24) -> str:
    """A name that fits, and that is no formula."""
    return (name if len(name) <= most else f"{name[: most - 4]} ...").replace("$", r"\$")

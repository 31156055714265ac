"""Figures of a comparison, and the style of all figures: each draws on given Axes, or returns a Figure.

errors        by horizon                           curve        torque missing over one quantity
residual_map  torque missing over the states       past_torque  what the residuals know of it
whiteness     what the residuals know of themselves
worst         the worst windows                    comparison   all of it on one page
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import TwoSlopeNorm
from matplotlib.figure import Figure, FigureBase
from matplotlib.ticker import FuncFormatter, MaxNLocator, NullFormatter

from sysid.records import Array
from sysid.typography import chance, multiple

if TYPE_CHECKING:
    from sysid.comparison.compare import Comparison, Trace
    from sysid.comparison.residual_map import Curve, ResidualMap

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
BLUE, ORANGE, GREEN, SKY, GREY = "#0072B2", "#D55E00", "#009E73", "#56B4E9", "0.55"
COLOUR = {"theta": BLUE, "theta_dot": ORANGE}
MARK = {"theta": "o", "theta_dot": "s"}
LABEL = {
    "theta": r"angle $\theta$ [rad]",
    "theta_dot": r"speed $\dot\theta$ [rad/s]",
    "torque": "commanded torque u [N m]",
    "time": "time [s]",
}
SHORT = {"theta": r"$\theta$", "theta_dot": r"$\dot\theta$"}
UNIT = {"theta": "rad", "theta_dot": "rad/s"}
SIGMA_99 = 2.5758


# compare ---------------------------------------------------------------------------------------------------------


def comparison(answer: Comparison) -> Figure:
    """All of a comparison on one page."""
    names, channels = list(answer.curves), list(answer.one_second.ratios)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(14.0, 6.6 + 2.1 * len(channels)), layout="constrained")
        figure.suptitle(
            "\n".join(textwrap.wrap(answer.sentence, 150)).replace("$", r"\$"), x=0.01, ha="left", fontsize=11.0
        )
        parts: Any = figure.subfigures(3, 1, height_ratios=[3.1, 2.6, 2.1 * len(channels)])
        top, middle, bottom = parts
        first = top.subplots(1, 4, width_ratios=[1.25, 1.25, 1.0, 1.0])
        for draw, axes in zip((errors, residual_map, past_torque, whiteness), first, strict=True):
            draw(answer, axes)
        for name, axes in zip(names, middle.subplots(1, max(1, len(names)), squeeze=False)[0], strict=False):
            curve(answer.curves[name], axes)
        _windows(answer, bottom)
    return figure


def comparison_figures(answer: Comparison) -> dict[str, Figure]:
    """Each figure of a comparison by itself, by name."""
    drawn: dict[str, Callable[[Axes], None]] = {
        "errors": lambda axes: errors(answer, axes),
        "map": lambda axes: residual_map(answer, axes),
        "past torque": lambda axes: past_torque(answer, axes),
        "whiteness": lambda axes: whiteness(answer, axes),
    }
    for name, found in answer.curves.items():
        drawn[f"over {name}"] = lambda axes, found=found: curve(found, axes)  # type: ignore[misc]
    figures = {name: alone(draw) for name, draw in drawn.items()}
    figures["worst windows"] = worst(answer)
    return figures


def alone(draw: Callable[[Axes], None], size: tuple[float, float] = (5.6, 3.6)) -> Figure:
    """A figure of one panel, size [in]."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=size, layout="constrained")
        draw(figure.add_subplot())
    return figure


def errors(answer: Comparison, axes: Axes) -> None:
    """The error over windows of every length, in units of the sensor noise, with its physical size."""
    for row, channel in enumerate(answer.one_second.ratios):
        ratio = [e.ratios[channel] for e in answer.errors.values()]
        axes.plot(ratio, marker=MARK[channel], color=COLOUR[channel], label=LABEL[channel])
        for k, error in enumerate(answer.errors.values()):
            if math.isfinite(ratio[k]):
                axes.annotate(
                    f"{getattr(error, channel):.2g} {UNIT[channel]}",
                    (k, ratio[k]),
                    (0, (7, -13)[row]),
                    textcoords="offset points",
                    ha=("left", "center", "center", "right")[k],
                    fontsize=7.5,
                    color=COLOUR[channel],
                    bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.7, "pad": 0.5},
                )
    axes.set_xticks(range(len(answer.errors)), list(answer.errors))
    axes.margins(y=0.18)
    _noise_scale(axes, [e.ratio for e in answer.errors.values()])
    axes.set_xlabel("predicted over (state refitted)")
    axes.set_title("Error, in units of the sensor noise")
    axes.legend(loc="upper left", fontsize=8.0)


def residual_map(answer: Comparison, axes: Axes) -> None:
    """The torque that the readings need beyond the model, over the states; a dot marks what noise does not explain."""
    norm = scale(answer.map)
    image = cells(answer.map, axes, norm or TwoSlopeNorm(0.0, -1.0, 1.0))
    axes.set_ylabel(LABEL["theta_dot"])
    axes.set_title("Torque missing in the model" + ("" if norm else ": none"))
    bar = axes.figure.colorbar(image, ax=axes, pad=0.02, aspect=25, extend="both")
    bar.set_label("[N m];  dot: beyond 99 %")
    bar.outline.set_visible(False)
    if norm is None:
        bar.set_ticks([0.0])


def scale(*found: ResidualMap) -> TwoSlopeNorm | None:
    """One scale about zero for all maps; None where they are flat."""
    seen = np.concatenate([np.abs(m.torque[np.isfinite(m.torque)]) for m in found])
    return TwoSlopeNorm(0.0, -reach, reach) if np.any(seen) and (reach := float(np.quantile(seen, 0.95))) else None


def cells(found: ResidualMap, axes: Axes, norm: TwoSlopeNorm) -> Any:
    """The cells of a map and its dots."""
    axes.set_facecolor("0.93")
    image = axes.pcolormesh(found.theta, found.theta_dot, found.torque.T, cmap="PuOr", norm=norm, rasterized=True)
    i, j = np.nonzero(found.significant)
    middle = [0.5 * (edges[1:] + edges[:-1]) for edges in (found.theta, found.theta_dot)]
    axes.plot(middle[0][i], middle[1][j], ".", color="0.1", markersize=3.0)
    axes.set_xlabel(LABEL["theta"] + ", 0 upright")
    return image


def curve(found: Curve, axes: Axes) -> None:
    """The torque that the readings need beyond the model over one quantity, with its 99 % band."""
    axes.axhline(0.0, color="0.3", linewidth=0.8)
    if found.record:
        _over_time(found, axes)
    else:
        sides = (found.at < 0.0, found.at > 0.0) if found.name == "theta_dot" else (np.ones(len(found.at), dtype=bool),)
        for part in sides:
            _band(axes, found.at[part], found.torque[part], SIGMA_99 * found.sd[part])
        axes.set_xlabel(LABEL[found.name])
        axes.xaxis.set_major_locator(MaxNLocator(5))
    axes.set_ylabel("torque missing, 99 % [N m]")
    axes.set_title(f"over {found.name}  ({chance(found.p_value)})")


def _over_time(found: Curve, axes: Axes) -> None:
    """Rollout after rollout."""
    names = list(dict.fromkeys(found.record))
    begin, gap = 0.0, 0.03 * (float(np.ptp(found.at)) or 1.0)
    middles = []
    for k, name in enumerate(names):
        own = np.array([r == name for r in found.record])
        t = found.at[own] - found.at[own][0] + begin
        _band(axes, t, found.torque[own], SIGMA_99 * found.sd[own])
        if k:
            axes.axvline(begin - 0.5 * gap, color="0.85", linewidth=0.8)
        middles.append(0.5 * (t[0] + t[-1]))
        begin = float(t[-1]) + gap
    if len(names) <= 4:
        axes.set_xticks(middles, [short(n, 60 // len(names)) for n in names])
        axes.tick_params(axis="x", length=0)
    axes.set_xlabel("time, rollout after rollout" + ("" if len(names) <= 4 else " [s]"))


def past_torque(answer: Comparison, axes: Axes) -> None:
    """Correlation of the residual with the commands of earlier (and later) samples."""
    past = answer.past
    axes.axhspan(-past.band, past.band, color="0.88", label="99 % band")
    axes.axhline(0.0, color="0.3", linewidth=0.8)
    axes.vlines(past.lags, 0.0, past.correlation, color=BLUE, linewidth=1.5)
    axes.plot(past.lags, past.correlation, "o", color=BLUE, markersize=4.0)
    axes.set_xlabel("lag [samples]; negative: coming torque")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    _at_least(axes, 3.0 * past.band)
    axes.set_title(f"Residual and torque  ({chance(past.p_value)})")
    axes.set_ylabel("correlation")
    axes.legend(loc="best", fontsize=8.0)


def whiteness(answer: Comparison, axes: Axes) -> None:
    """Autocorrelation of what is left, by channel."""
    axes.axhline(0.0, color="0.3", linewidth=0.8)
    for k, (channel, found) in enumerate(answer.whiteness.items()):
        if k == 0:
            axes.fill_between(found.lags, -found.band, found.band, color="0.88", linewidth=0.0, label="99 % band")
        axes.plot(
            found.lags,
            found.correlation,
            marker=MARK[channel],
            markersize=3.5,
            color=COLOUR[channel],
            label=f"{SHORT[channel]}  {chance(found.p_value)}",
        )
    _at_least(axes, 3.0 * max(float(np.max(found.band)) for found in answer.whiteness.values()))
    axes.set_xlabel("lag [samples]")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_ylabel("autocorrelation")
    axes.set_title("Are the residuals white?")
    axes.legend(loc="upper right", fontsize=8.0)


def worst(answer: Comparison) -> Figure:
    """The three worst windows: readings against the model."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(4.0 * len(answer.worst), 2.5 * len(answer.one_second.ratios)), layout="constrained")
        _windows(answer, figure)
    return figure


def _windows(answer: Comparison, figure: FigureBase) -> None:
    channels = list(answer.one_second.ratios)
    panels = figure.subplots(len(channels), len(answer.worst), squeeze=False, sharex="col")
    for i, trace in enumerate(answer.worst):
        for row, channel in enumerate(channels):
            axes = panels[row][i]
            window(trace, axes, channel)
            if row + 1 < len(channels):
                axes.set_xlabel("")
            if row or i:
                axes.get_legend().remove()


def window(trace: Trace, axes: Axes, channel: str) -> None:
    """One channel of one window: readings as dots, the model as a line."""
    if channel not in trace.readings:
        axes.set_axis_off()
        return
    axes.plot(trace.t, trace.readings[channel], ".", color="0.45", markersize=4.0, label="readings")
    axes.plot(trace.t, trace.model[channel], color=COLOUR[channel], linewidth=1.6, label="model")
    axes.set_xlabel(LABEL["time"])
    axes.set_ylabel(LABEL[channel])
    axes.set_title(f"{short(trace.error.record)}: {multiple(trace.error.ratio)} x the noise", fontweight="normal")
    axes.legend(fontsize=8.0)


# parts -----------------------------------------------------------------------------------------------------------


def _band(axes: Axes, x: Array, y: Array, half: Array, marker: str = ".") -> None:
    axes.fill_between(x, y - half, y + half, color=SKY, alpha=0.35, linewidth=0.0)
    axes.plot(x, y, marker=marker, markersize=4.0, color=BLUE, linewidth=1.3)


def _noise_scale(axes: Axes, values: Sequence[float]) -> None:
    """A logarithmic axis of multiples of the noise, with a line where a perfect model ends."""
    sound = [v for v in values if math.isfinite(v)]
    axes.set_yscale("log")
    axes.axhline(1.0, color=GREEN, linewidth=1.5, zorder=0, label="the noise: a perfect model")
    low, high = axes.get_ylim()
    axes.set_ylim(min(low, 0.7), max(high, 1.5, 1.2 * max(sound, default=1.0)))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())
    if max(sound, default=1.0) < 8.0:
        axes.set_yticks([t for t in (0.7, 1.0, 1.5, 2.0, 3.0, 5.0, 7.0) if t <= axes.get_ylim()[1]])


def _at_least(axes: Axes, half: float) -> None:
    """Limits of an axis about zero that is never finer than the band."""
    low, high = axes.get_ylim()
    axes.set_ylim(min(low, -half), max(high, half))


def short(name: str, most: int = 24) -> str:
    """A name that fits, and that is no formula."""
    return (name if len(name) <= most else f"{name[: most - 4]} ...").replace("$", r"\$")

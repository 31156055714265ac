"""Figures of the answers: each draws one answer on given Axes, or returns a Figure.

comparison   how far a model is off, and where           fall       the held-out error as effects are added
torque       residual torque over a state, with its band ranking    which effects would explain the error
trajectories readings, and a model before and after
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

from sysid.model import Model
from sysid.records import Array, Record
from sysid.response import CHANNELS
from sysid.sensor import Sensor

if TYPE_CHECKING:
    from sysid.diagnose.answer import Diagnosis
    from sysid.diagnose.compare import Comparison, Trace
    from sysid.diagnose.residual_map import Curve
    from sysid.diagnose.residual_torque import ResidualTorque

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
        figure.suptitle("\n".join(textwrap.wrap(answer.sentence, 150)), x=0.01, ha="left", fontsize=11.0)
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
    found = answer.map
    seen = np.abs(found.torque[np.isfinite(found.torque)])
    flat = not np.any(seen > 0.0)
    largest = 1.0 if flat else float(np.quantile(seen, 0.95))
    axes.set_facecolor("0.93")
    image = axes.pcolormesh(
        found.theta, found.theta_dot, found.torque.T, cmap="PuOr", norm=TwoSlopeNorm(0.0, -largest, largest)
    )
    i, j = np.nonzero(found.significant)
    middle = [0.5 * (edges[1:] + edges[:-1]) for edges in (found.theta, found.theta_dot)]
    axes.plot(middle[0][i], middle[1][j], ".", color="0.1", markersize=3.0)
    axes.set_xlabel(LABEL["theta"] + ", 0 upright")
    axes.set_ylabel(LABEL["theta_dot"])
    axes.set_title("Torque missing in the model" + (": none" if flat else ""))
    bar = axes.figure.colorbar(image, ax=axes, pad=0.02, aspect=25, extend="both")
    bar.set_label("[N m];  dot: beyond 99 %")
    bar.outline.set_visible(False)
    if flat:
        bar.set_ticks([0.0])


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
    axes.set_title(f"over {found.name}  ({_p(found.p_value)})")


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
        axes.set_xticks(middles, [_short(n, 60 // len(names)) for n in names])
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
    axes.set_title(f"Residual and torque  ({_p(past.p_value)})")
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
            label=f"{SHORT[channel]}  {_p(found.p_value)}",
        )
        _at_least(axes, 3.0 * float(np.max(found.band)))
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
    axes.set_title(f"{_short(trace.error.record)}: {_times(trace.error.ratio)} the noise", fontweight="normal")
    axes.legend(fontsize=8.0)


# diagnose --------------------------------------------------------------------------------------------------------


def fall(answer: Diagnosis, axes: Axes) -> None:
    """The held-out error after each step, down to the noise."""
    steps = (*answer.conventions, *answer.steps)
    labels = ["model as it came", *(f"+ {s.effect}" for s in steps)]
    values = [answer.base_error.ratio, *(s.error_after for s in steps)]
    bars = axes.bar(labels, values, color=[GREY] + [SKY] * (len(values) - 2) + [BLUE] * (len(values) > 1), width=0.62)
    axes.bar_label(bars, [_times(v) for v in values], padding=2, fontsize=8.5)
    _noise_scale(axes, values)
    axes.set_ylim(top=1.25 * max(*values, 1.3))
    axes.tick_params(axis="x", length=0)
    axes.set_ylabel("held-out error / sensor noise")
    axes.legend(loc="upper right", fontsize=8.0)
    axes.set_title("Error on rollouts that no fit has seen")


def ranking(answer: Diagnosis, axes: Axes, most: int = 10) -> None:
    """The first round: how much each candidate would explain (grey: it could be chance), and the error left with it."""
    shown = answer.ranking[:most][::-1]
    sure = [r.p_value < 0.05 for r in shown]
    bars = [max(r.score, 0.0) for r in shown]
    axes.barh(range(len(shown)), bars, height=0.62, color=[BLUE if s else "0.8" for s in sure])
    axes.set_yticks(range(len(shown)), [r.effect for r in shown])
    reach = max([1.0, *(r.score for r in shown)])
    for k, r in enumerate(shown):
        error = "" if r.error_after is None else f"error {_times(r.error_after)}, "
        axes.text(
            max(r.score, 0.0) + 0.01 * reach, k, f" {error}{_p(r.p_value)}", va="center", fontsize=7.5, color="0.3"
        )
    axes.set_xlim(0.0, 1.3 * reach)
    axes.tick_params(axis="y", length=0)
    axes.set_xlabel("squared error that it would explain, in units of the noise")
    axes.set_title("Which effect explains the error?")


def torque(answer: ResidualTorque, axes: Axes, name: str) -> None:
    """The residual torque over "theta", "theta_dot", "torque" or "time", with its 95 % band."""
    found = answer.over(name)
    middle = 0.5 * (found.edges[1:] + found.edges[:-1])
    seen = np.isfinite(found.mean)
    axes.axhline(0.0, color="0.3", linewidth=0.8)
    _band(axes, middle[seen], found.mean[seen], 1.96 * found.sd[seen])
    axes.set_xlabel(LABEL[name])
    axes.set_ylabel("torque beyond the model [N m]")
    axes.set_title(f"over {name}  (explains {answer.explained.get(name, 0.0):.0%} of it)")


def residual_torque(answer: ResidualTorque) -> Figure:
    """The torque that the log needs beyond the model: rollout by rollout, and over each state."""
    names = list(answer.binned)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(3.4 * len(names), 6.0), layout="constrained")
        parts: Any = figure.subfigures(2, 1)
        top, bottom = parts
        axes, begin = top.subplots(), 0.0
        axes.axhline(0.0, color="0.3", linewidth=0.8)
        for k, record in enumerate(answer.records):
            t = record.t[:-1] - record.t[0] + begin
            _band(axes, t, record.d, 1.96 * record.sd, marker="")
            if k:
                axes.axvline(begin, color="0.85", linewidth=0.8)
            begin = float(t[-1]) + (t[-1] - t[-2] if len(t) > 1 else 0.0)
        axes.set_xlabel("time, rollout after rollout [s]")
        axes.set_ylabel("torque beyond the model [N m]")
        axes.set_title("Residual torque, with its 95 % band")
        for name, panel in zip(names, bottom.subplots(1, len(names), squeeze=False)[0], strict=True):
            torque(answer, panel, name)
    return figure


def trajectories(before: Model, after: Model, record: Record, sensor: Sensor) -> Figure:
    """Readings of a whole rollout against two models, each from the initial state that fits it best."""
    from sysid.diagnose.held_out import error_of, refit_windows
    from sysid.response import cut

    shown = [c for c in CHANNELS if getattr(sensor, c) is not None]
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(8.0, 2.4 * len(shown) + 0.3), layout="constrained")
        panels = figure.subplots(len(shown), 1, sharex=True, squeeze=False)[:, 0]
        for channel, axes in zip(shown, panels, strict=True):
            y = getattr(record, channel)
            axes.plot(record.t[: len(y)], y, ".", color="0.45", markersize=3.5, label="readings")
            axes.set_ylabel(LABEL[channel])
        for model, name, colour, style in ((before, "before", ORANGE, "--"), (after, "after", BLUE, "-")):
            fit = refit_windows(model, [record], sensor, cut([record]))
            path = fit.response.readings(np.zeros(0), fit.lin.states)[0]
            label = f"{name}: {_times(error_of(fit, math.inf).ratio)} the noise"
            for channel, axes in zip(shown, panels, strict=True):
                axes.plot(record.t, path[CHANNELS.index(channel)], style, color=colour, linewidth=1.5, label=label)
        panels[0].legend(ncols=3, loc="lower left", bbox_to_anchor=(0.0, 1.0), fontsize=8.5)
        panels[-1].set_xlabel(LABEL["time"])
        figure.suptitle(f"{record.name}, the whole rollout", x=0.01, ha="left", fontsize=10.0, fontweight="bold")
    return figure


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


def _short(name: str, most: int = 24) -> str:
    return name if len(name) <= most else f"{name[: most - 4]} ..."


def _times(ratio: float) -> str:
    return f"{ratio:.2f} x" if ratio < 9.995 else f"{ratio:.3g} x"


def _p(p_value: float) -> str:
    return f"p = {p_value:.2g}" if p_value >= 1e-4 else "p < 0.0001"

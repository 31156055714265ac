"""The pictures of a diagnosis, each a narrow Figure that a phone can show."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from sysid.data.sensor import Sensor
from sysid.diagnosis.answer import Diagnosis, Step
from sysid.diagnosis.contacts import Contact
from sysid.diagnosis.findings import chance
from sysid.diagnosis.predictions import Prediction
from sysid.diagnosis.residual_torque import ResidualTorque
from sysid.report import comparison_figure
from sysid.report import figure_style as style
from sysid.report.typesetting import typeset_multiple

WIDE, NARROW = 5.0, 4.2
"""Widths [in]: of a column, and of half of one."""


def drawn(width: float, height: float, draw: Callable[[Axes], None]) -> Figure:
    """A figure of one panel, in the style of all."""
    with style.styled(width, height) as figure:
        draw(figure.add_subplot())
    return figure


# ---- the error -------------------------------------------------------------------------------------------------------


def fall(answer: Diagnosis) -> Figure:
    """The held-out error after each step, down to the noise; small dots are single windows."""
    return drawn(WIDE, 3.3 if answer.steps or answer.conventions else 2.3, lambda axes: fall_in(axes, answer))


def in_order(answer: Diagnosis) -> tuple[Step, ...]:
    """Effects and conventions as they came: each begins at the error at which the one before ended."""
    left, error, ordered = [*answer.conventions, *answer.steps], answer.base_error.ratio, list[Step]()
    while left:
        following = next((s for s in left if s.error_before == error), left[0])
        left.remove(following)
        ordered.append(following)
        error = following.error_after
    return tuple(ordered)


def fall_in(axes: Axes, answer: Diagnosis) -> None:
    """The same on given axes."""
    steps = in_order(answer)
    values = [answer.base_error.ratio, *(s.error_after for s in steps)]
    clouds = {0: answer.base_error} | ({len(steps): answer.error} if steps else {})
    for x, error in clouds.items():
        ratios = [w.ratio for w in error.windows if math.isfinite(w.ratio)]
        ratios = ratios[:: max(1, len(ratios) // 200)]
        shift = np.linspace(-0.16, 0.16, len(ratios)) if len(ratios) > 1 else np.zeros(len(ratios))
        axes.plot(x + shift, ratios, "o", color=style.GREY, alpha=0.5, markersize=3.5, markeredgewidth=0.0, zorder=1)
    axes.axhline(1.0, color=style.GREEN, linewidth=1.6, zorder=2)
    axes.plot(values, color=style.BLUE, linewidth=2.2, marker="o", markersize=8.0, markeredgecolor="white", zorder=3)
    for x, value in enumerate(values):
        axes.annotate(typeset_multiple(value), (x, value), (11, 5), textcoords="offset points", color=style.BLUE,
                      fontsize=11.0, fontweight="bold", zorder=4)  # fmt: skip
    axes.set_xlim(-0.45, len(steps) + 0.55)
    side, place = ("left", 0.01) if steps and min(clouds[0].ratio, 2.0) > 1.3 else ("right", 1.0)
    axes.annotate("sensor noise: a perfect model", (place, 1.0), (0, -4), xycoords=axes.get_yaxis_transform(),
                  textcoords="offset points", ha=side, va="top", color=style.GREEN, fontsize=8.5)  # fmt: skip
    style.noise_scale(axes)
    labels = ["model\nas it came", *("+ " + s.effect.replace("_", "\n") for s in steps)]
    axes.set_xticks(range(len(labels)), labels, fontsize=9.0 if len(labels) < 5 else 7.0)
    axes.tick_params(axis="x", length=0)
    axes.set_ylabel("held-out error / sensor noise")


def ranking(answer: Diagnosis, most: int = 9) -> Figure:
    """The classes of the first round by what they would explain; a class is what this log cannot tell apart."""
    rows: list[Any] = []
    for r in answer.ranking:
        if not any(r.effect in other.alike for other in rows):
            rows.append(r)
    rows = rows[:most]
    added = {name for s in (*answer.steps, *answer.conventions) for name in s.alike}
    labels = [textwrap.fill(", ".join(r.alike), 26) for r in rows]
    return drawn(
        WIDE,
        0.75 + 0.3 * sum(0.55 + 0.45 * (1 + text.count("\n")) for text in labels),
        lambda axes: _bars(axes, rows, labels, added),
    )


def _bars(axes: Axes, rows: Sequence[Any], labels: Sequence[str], added: set[str]) -> None:
    scores = [max(r.score, 0.0) for r in rows]
    reach = max([1.0, *scores])
    colours = [style.BLUE if r.p_value < 0.05 else "0.82" for r in rows]
    axes.barh(range(len(rows)), scores, height=0.6, color=colours)
    for k, r in enumerate(rows):
        error = "" if r.error_after is None else f"error {typeset_multiple(r.error_after)};  "
        end = max(r.score, 0.0) + 0.015 * reach
        axes.text(end, k, error + chance(r.p_value), va="center", fontsize=8.0, color="0.3")
    axes.set_yticks(range(len(rows)), labels)
    for r, text in zip(rows, axes.get_yticklabels(), strict=True):
        text.set_fontweight("bold" if r.effect in added else "normal")
    axes.set_ylim(len(rows) - 0.4, -0.6)
    axes.set_xlim(0.0, 1.6 * reach)
    axes.xaxis.set_major_locator(MaxNLocator(4))
    axes.tick_params(axis="y", length=0)
    axes.figure.supxlabel("squared error that it would explain, in units of the noise", fontsize=9.0)


# ---- a rollout -------------------------------------------------------------------------------------------------------


def rollout_figure(
    paths: Sequence[Prediction], sensor: Sensor, names: Sequence[str], contacts: Sequence[Contact] = ()
) -> Figure:
    """Readings against models, under each channel what they leave, with the noise, and below all the command."""
    channels = list(paths[0].readings)
    with style.styled(WIDE, 1.6 + 2.75 * len(channels)) as figure:
        heights = [*([1.75, 1.0] * len(channels)), 1.0]
        panels = figure.subplots(len(heights), 1, sharex=True, height_ratios=heights)
        for channel, above, below in zip(channels, panels[::2], panels[1::2], strict=False):
            course_in(above, paths, channel, names)
            residual_in(below, paths, channel, float(getattr(sensor, channel)))
        comparison_figure.command(paths[0], panels[-1])
        for axes in panels:
            comparison_figure.shade(axes, contacts, paths[0].record)
        style.legend_above(panels[0])
        panels[-1].set_xlabel(f"time [s] of {style.short(paths[0].record, 40)}")
        figure.align_ylabels(panels)
    return figure


def course_in(axes: Axes, paths: Sequence[Prediction], channel: str, names: Sequence[str]) -> None:
    """One channel: readings as dots, models as lines; the frame follows the readings."""
    t, y = paths[0].t, paths[0].readings[channel]
    axes.plot(t, y, ".", color="0.45", markersize=3.5, label="readings", rasterized=len(t) > style.RASTERIZED_FROM)
    for path, name, (colour, line, width) in zip(paths, names, _lines(len(paths)), strict=True):
        said = f"{name}: {typeset_multiple(path.ratio)}"
        axes.plot(t, path.model[channel], line, color=colour, linewidth=width, label=said)
    low, high = float(np.nanmin(y)), float(np.nanmax(y))
    room = 0.35 * max(high - low, 1e-9)
    seen = [v for p in paths for v in p.model[channel] if math.isfinite(v)]
    axes.set_ylim(max(low - room, min([low, *seen]) - 0.1 * room), min(high + room, max([high, *seen]) + 0.1 * room))
    axes.set_ylabel(style.label(channel, paths[0].units))


def residual_in(axes: Axes, paths: Sequence[Prediction], channel: str, sd: float) -> None:
    """Readings less model, over the band of the noise."""
    axes.axhspan(-2.0 * sd, 2.0 * sd, color=style.GREEN, alpha=0.22, linewidth=0.0)
    size = 5.0 * sd
    for path, (colour, _, _) in zip(paths, _lines(len(paths)), strict=True):
        left = path.readings[channel] - path.model[channel]
        axes.plot(path.t, left, color=colour, linewidth=1.0, rasterized=len(left) > style.RASTERIZED_FROM)
        size = max(size, float(np.max(np.abs(left[np.isfinite(left)]), initial=0.0)))
    size = min(size, 3.0 * float(np.nanstd(paths[0].readings[channel])) + 5.0 * sd)
    axes.set_ylim(-1.1 * size, 1.1 * size)
    axes.yaxis.set_major_locator(MaxNLocator(3, symmetric=True))
    axes.set_ylabel("readings\nless model", fontsize=8.0)


def _lines(count: int) -> tuple[tuple[str, str, float], ...]:
    return ((style.ORANGE, "--", 1.4), (style.BLUE, "-", 1.6))[-count:]


def window_figure(found: Prediction) -> Figure:
    channels = list(found.readings)
    with style.styled(3.2, 1.9 + 1.5 * len(channels)) as figure:
        panels = figure.subplots(len(channels) + 1, 1, sharex=True, squeeze=False)[:, 0]
        comparison_figure.window_panels(found, channels, list(panels))
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
        figure.align_ylabels(panels)
    return figure


# ---- residual torque -------------------------------------------------------------------------------------------------


def torque_over_time(
    found: ResidualTorque, before: ResidualTorque | None = None, contacts: Sequence[Contact] = ()
) -> Figure:
    """The residual torque, rollout after rollout, and that of the model before."""
    return drawn(WIDE, 2.9, lambda axes: comparison_figure.over_time(found, axes, before, contacts))


def torque_over_quantity(
    found: ResidualTorque, name: str, before: ResidualTorque | None = None, mark: bool = False
) -> Figure:
    """The mean of d over one quantity with its 99 % band; `mark`: where it peaks."""
    return drawn(NARROW, 2.7, lambda axes: comparison_figure.binned_torque(found, name, axes, before, mark))


# ---- the map of the states -------------------------------------------------------------------------------------------


def maps(found: Sequence[ResidualTorque], titles: Sequence[str]) -> Figure:
    """The mean residual torque over angle and speed, all on one scale; a dot: beyond what noise explains."""
    with style.styled(WIDE if len(found) > 1 else NARROW, 3.0) as figure:
        panels = figure.subplots(1, len(found), sharey=True, squeeze=False)[0]
        comparison_figure.state_maps(found, list(panels), titles)
    return figure

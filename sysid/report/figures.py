"""The pictures of answers: each draws on given Axes, or returns a Figure."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import TwoSlopeNorm
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from sysid.data.record import in_a_row, is_part
from sysid.data.sensor import Sensor
from sysid.diagnosis.answer import Diagnosis, Step
from sysid.diagnosis.compare import Comparison
from sysid.diagnosis.contacts import Contact
from sysid.diagnosis.findings import chance, quantity
from sysid.diagnosis.predictions import Prediction
from sysid.diagnosis.residual_torque import Binned, ResidualTorque, TorqueMap
from sysid.errors import check_kind
from sysid.estimation.likelihood import SIGMA_99
from sysid.report import figure_style as style
from sysid.report.typesetting import typeset_multiple

WIDE = 5.0
"""Width [in] of a column."""
NARROW = 4.2
"""Width [in] of half a column."""
LOWEST_RATIO = 0.1
"""Multiple of the noise at which windows with less are drawn: where a joint rests there is hardly an error."""


def drawn(width: float, height: float, draw: Callable[[Axes], None]) -> Figure:
    """A figure of one panel, in the style of all."""
    with style.styled(width, height) as figure:
        draw(figure.add_subplot())
    return figure


# ---- a comparison ----------------------------------------------------------------------------------------------------


def plot_comparison(answer: Comparison) -> Figure:
    """Draw all of a comparison on one page.

    Parameters
    ----------
    answer : Comparison
        What `compare` found.

    Returns
    -------
    matplotlib.figure.Figure
        Errors by horizon, the torque beyond the model over everything, whiteness, and the worst windows.
    """
    check_kind("answer", answer, Comparison, "a Comparison, as compare returns it")
    channels, torque = list(answer.one_second.ratios), answer.torque
    with style.styled(14.0, 8.1 + 2.1 * len(channels)) as figure:
        title = textwrap.fill(answer.sentence, 150).replace("$", r"\$")
        figure.suptitle(title, x=0.01, ha="left", fontsize=11.0)
        parts: Any = figure.subfigures(3, 1, height_ratios=[3.1, 2.6, 1.5 + 2.1 * len(channels)])
        top, middle, bottom = parts
        first = top.subplots(1, 1 if torque is None else 3, squeeze=False)[0]
        errors(answer, first[0])
        if torque is not None:
            what = quantity("torque", torque.units).capitalize()
            state_maps([torque], [first[1]], [f"{what} beyond the model; dot: 99 %"])
            autocorrelation_panel(answer, first[2])
            for name, axes in zip(torque.binned, middle.subplots(1, len(torque.binned)), strict=True):
                draw_over(torque, name, axes)
        panels = bottom.subplots(len(channels) + 1, len(answer.worst), squeeze=False, sharex="col")
        for window, column in zip(answer.worst, panels.T, strict=True):
            window_panels(window, channels, list(column))
        bottom.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return figure


def errors(answer: Comparison, axes: Axes) -> None:
    """The error over windows of every length, in units of the sensor noise."""
    for channel in answer.one_second.ratios:
        ratio = [e.ratios[channel] for e in answer.errors.values()]
        axes.plot(ratio, label=quantity(channel, answer.units), **style.LOOK[channel])
    axes.set_xticks(range(len(answer.errors)), list(answer.errors))
    axes.axhline(1.0, color=style.GREEN, linewidth=1.5, zorder=0, label="the noise: a perfect model")
    style.noise_scale(axes)
    axes.set_xlabel("predicted over (state refitted)")
    axes.set_ylabel("error / sensor noise")
    style.legend_above(axes)


def state_maps(torques: Sequence[ResidualTorque], panels: Sequence[Axes], titles: Sequence[str]) -> None:
    """The mean residual torque over the states, all on one scale; a dot: beyond 99 % of what noise explains."""
    seen, units = np.concatenate([np.abs(r.map.torque[np.isfinite(r.map.torque)]) for r in torques]), torques[0].units
    reach = float(np.quantile(seen, 0.95)) if np.any(seen) else 0.0
    norm = TwoSlopeNorm(0.0, -reach or -1.0, reach or 1.0)
    for torque, axes, title in zip(torques, panels, titles, strict=True):
        image = _cells(torque.map, axes, norm, units)
        axes.set_title(title, fontweight="normal")
    panels[0].set_ylabel(style.label("theta_dot", units))
    bar = panels[0].figure.colorbar(image, ax=list(panels), pad=0.02, aspect=25, extend="both")
    bar.set_label(style.beyond(units))
    bar.outline.set_visible(False)
    bar.set_ticks(MaxNLocator(5) if reach else [0.0])


def _cells(torque_map: TorqueMap, axes: Axes, norm: TwoSlopeNorm, units: Mapping[str, str]) -> Any:
    """The cells of a map and its dots."""
    axes.set_facecolor("0.93")
    image = axes.pcolormesh(
        torque_map.theta, torque_map.theta_dot, torque_map.torque.T, cmap="PuOr", norm=norm, rasterized=True
    )
    i, j = np.nonzero(torque_map.significant)
    middle = [0.5 * (edges[1:] + edges[:-1]) for edges in (torque_map.theta, torque_map.theta_dot)]
    axes.plot(middle[0][i], middle[1][j], ".", color="0.1", markersize=3.0)
    axes.set_xlabel(style.state_label("theta", units))
    return image


def binned_torque(
    torque: ResidualTorque, name: str, axes: Axes, before: ResidualTorque | None = None, mark: bool = False
) -> None:
    """The mean residual torque over one quantity with its 99 % band, after and before; `mark`: where it peaks."""
    axes.axhline(0.0, color="0.3", linewidth=0.8)
    for residual, colour in ((before, style.ORANGE), (torque, style.BLUE)):
        if residual is not None:
            mean(axes, residual.over(name), colour)
    if mark and torque.present:
        axes.axvspan(*torque.over(name).peak, color=style.YELLOW, alpha=0.25, linewidth=0.0, zorder=0)
    axes.set_xlabel(style.state_label(name, torque.units))
    axes.set_ylabel(f"mean {style.beyond(torque.units)}")
    axes.xaxis.set_major_locator(MaxNLocator(5))
    axes.yaxis.set_major_locator(MaxNLocator(5))


def draw_over(torque: ResidualTorque, name: str, axes: Axes) -> None:
    """The residual torque over one quantity, or over time, and what share of it that tells."""
    if name == "time":
        over_time(torque, axes)
    else:
        binned_torque(torque, name, axes)
    share = torque.dependence.shares.get(name, 0.0)
    tells = f": tells {share:.0%}" if torque.present and share else ""
    axes.set_title(f"over {quantity(name, torque.units)}{tells}")


def mean(axes: Axes, binned: Binned, colour: str) -> None:
    """The mean in each bin that rests on more than a few intervals, with its 99 % band."""
    seen = np.isfinite(binned.mean) & (binned.count >= 0.002 * binned.count.sum())
    middle, half = 0.5 * (binned.edges[1:] + binned.edges[:-1])[seen], SIGMA_99 * binned.sd[seen]
    style.banded(axes, middle, binned.mean[seen], half, colour, marker=".", markersize=5.0, linewidth=1.4)


def over_time(
    torque: ResidualTorque, axes: Axes, before: ResidualTorque | None = None, contacts: Sequence[Contact] = ()
) -> None:
    """The residual torque with its 99 % band, rollout after rollout; that of the model before; shaded contacts."""
    axes.axhline(0.0, color="0.3", linewidth=0.8)
    names, ends = [r.name for r in torque.records], list[tuple[float, float]]()
    for k, (record, begin) in enumerate(zip(torque.records, in_a_row([r.t for r in torque.records]), strict=True)):
        t = record.t[:-1] - record.t[0] + begin
        if before is not None:
            axes.plot(t, before.records[k].d, color=style.ORANGE, linewidth=0.9, alpha=0.8)
        style.banded(axes, t, record.d, SIGMA_99 * record.sd, style.BLUE, linewidth=1.0)
        shade(axes, contacts, record.name, begin - record.t[0])
        if ends:
            axes.axvline(0.5 * (ends[-1][1] + t[0]), color="0.85", linewidth=0.8)
        ends.append((t[0], t[-1]))
    if len(names) <= 4:
        room = 40 // len(names)
        begins = [f"from {r.t[0]:.3g} s" for r in torque.records]  # tells the parts of one rollout apart
        long = max(map(len, names)) > room and len(set(begins)) == len(names)
        axes.set_xticks(np.mean(ends, axis=1), begins if long else [style.short(n, room) for n in names])
        axes.tick_params(axis="x", length=0)
    axes.set_xlabel("time, rollout after rollout" + ("" if len(names) <= 4 else " [s]"))
    axes.set_ylabel(style.beyond(torque.units))


def shade(axes: Axes, contacts: Sequence[Contact], record: str, shift: float = 0.0) -> None:
    """Where something acted that no state of the joint explains."""
    for t in contacts:
        if is_part(t.name, record):
            axes.axvspan(t.t_begin + shift, t.t_end + shift, color=style.YELLOW, alpha=0.35, linewidth=0.0, zorder=0)


def autocorrelation_panel(answer: Comparison, axes: Axes) -> None:
    """Autocorrelation of the filter's innovations, by channel."""
    axes.axhline(0.0, color="0.3", linewidth=0.8)
    for k, (channel, whiteness) in enumerate(answer.whiteness.items()):
        if k == 0:
            axes.fill_between(
                whiteness.lags, -whiteness.band, whiteness.band, color="0.88", linewidth=0.0, label="99 % band"
            )
        said = f"{style.SYMBOL[answer.units['theta']][channel]}  {chance(whiteness.p_value)}"
        axes.plot(whiteness.lags, whiteness.correlation, markersize=3.5, label=said, **style.LOOK[channel])
    half = 3.0 * max((float(np.max(whiteness.band)) for whiteness in answer.whiteness.values()), default=0.1)
    low, high = axes.get_ylim()
    axes.set_ylim(min(low, -half), max(high, half))
    axes.set_xlabel("lag [samples]")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_ylabel("autocorrelation of the innovations")
    if answer.whiteness:
        style.legend_above(axes)


def window_panels(window: Prediction, channels: Sequence[str], panels: Sequence[Axes]) -> None:
    """One window: under each other the channels, readings as dots and the model as a line, and the command."""
    for channel, axes in zip(channels, panels, strict=False):
        if channel not in window.readings:
            axes.set_axis_off()
            continue
        axes.plot(window.t, window.readings[channel], ".", color="0.45", markersize=4.0, label="readings")
        axes.plot(window.t, window.model[channel], color=style.LOOK[channel]["color"], linewidth=1.6, label="model")
        axes.set_ylabel(style.label(channel, window.units))
    command(window, panels[-1])
    title = f"{style.short(window.record)}: {typeset_multiple(window.ratio)} x the noise"
    panels[0].set_title(title, fontweight="normal")
    panels[-1].set_xlabel(style.label("time", window.units))


def command(window: Prediction, axes: Axes) -> None:
    """What the machine was told, held from sample to sample."""
    axes.step(window.t, window.command, where="post", color="0.3", linewidth=1.0)
    name = quantity("torque", window.units) if window.command_unit == window.units["torque"] else "command"
    axes.set_ylabel(f"{name} [{window.command_unit}]")


# ---- the error -------------------------------------------------------------------------------------------------------


def fall(answer: Diagnosis) -> Figure:
    """The held-out error after each step, down to the noise; small dots are windows, at `LOWEST_RATIO` where less."""
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
        ratios = [max(w.ratio, LOWEST_RATIO) for w in error.windows if math.isfinite(w.ratio)]
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
        if not any(r.effect in other.indistinguishable for other in rows):
            rows.append(r)
    rows = rows[:most]
    added = {name for s in (*answer.steps, *answer.conventions) for name in s.indistinguishable}
    labels = [textwrap.fill(", ".join(r.indistinguishable), 26) for r in rows]
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
        command(paths[0], panels[-1])
        for axes in panels:
            shade(axes, contacts, paths[0].record)
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


def window_figure(window: Prediction) -> Figure:
    """One window of a comparison: its channels and the command, under each other."""
    channels = list(window.readings)
    with style.styled(3.2, 1.9 + 1.5 * len(channels)) as figure:
        panels = figure.subplots(len(channels) + 1, 1, sharex=True, squeeze=False)[:, 0]
        window_panels(window, channels, list(panels))
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
        figure.align_ylabels(panels)
    return figure


# ---- the map of the states -------------------------------------------------------------------------------------------


def maps(torques: Sequence[ResidualTorque], titles: Sequence[str]) -> Figure:
    """The mean residual torque over angle and speed, all on one scale; a dot: beyond what noise explains."""
    with style.styled(WIDE if len(torques) > 1 else NARROW, 3.0) as figure:
        panels = figure.subplots(1, len(torques), sharey=True, squeeze=False)[0]
        state_maps(torques, list(panels), titles)
    return figure

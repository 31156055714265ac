"""Figures of a comparison: each draws on given Axes, or returns a Figure."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import TwoSlopeNorm
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from sysid.data.record import in_a_row, is_part
from sysid.diagnosis.findings import chance, quantity
from sysid.report import figure_style as style
from sysid.report.typesetting import typeset_multiple

if TYPE_CHECKING:
    from sysid.diagnosis.compare import Comparison
    from sysid.diagnosis.contacts import Contact
    from sysid.diagnosis.predictions import Prediction
    from sysid.diagnosis.residual_torque import Binned, ResidualTorque, TorqueMap


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
        for found, column in zip(answer.worst, panels.T, strict=True):
            window_panels(found, channels, list(column))
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


def state_maps(found: Sequence[ResidualTorque], panels: Sequence[Axes], titles: Sequence[str]) -> None:
    """The mean residual torque over the states, all on one scale; a dot: beyond 99 % of what noise explains."""
    seen, units = np.concatenate([np.abs(own.map.torque[np.isfinite(own.map.torque)]) for own in found]), found[0].units
    reach = float(np.quantile(seen, 0.95)) if np.any(seen) else 0.0
    norm = TwoSlopeNorm(0.0, -reach or -1.0, reach or 1.0)
    for own, axes, title in zip(found, panels, titles, strict=True):
        image = _cells(own.map, axes, norm, units)
        axes.set_title(title, fontweight="normal")
    panels[0].set_ylabel(style.label("theta_dot", units))
    bar = panels[0].figure.colorbar(image, ax=list(panels), pad=0.02, aspect=25, extend="both")
    bar.set_label(style.beyond(units))
    bar.outline.set_visible(False)
    bar.set_ticks(MaxNLocator(5) if reach else [0.0])


def _cells(found: TorqueMap, axes: Axes, norm: TwoSlopeNorm, units: Mapping[str, str]) -> Any:
    """The cells of a map and its dots."""
    axes.set_facecolor("0.93")
    image = axes.pcolormesh(found.theta, found.theta_dot, found.torque.T, cmap="PuOr", norm=norm, rasterized=True)
    i, j = np.nonzero(found.significant)
    middle = [0.5 * (edges[1:] + edges[:-1]) for edges in (found.theta, found.theta_dot)]
    axes.plot(middle[0][i], middle[1][j], ".", color="0.1", markersize=3.0)
    axes.set_xlabel(style.state_label("theta", units))
    return image


def binned_torque(
    torque: ResidualTorque, name: str, axes: Axes, before: ResidualTorque | None = None, mark: bool = False
) -> None:
    """The mean residual torque over one quantity with its 99 % band, after and before; `mark`: where it peaks."""
    axes.axhline(0.0, color="0.3", linewidth=0.8)
    for found, colour in ((before, style.ORANGE), (torque, style.BLUE)):
        if found is not None:
            mean(axes, found.over(name), colour)
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


def mean(axes: Axes, found: Binned, colour: str) -> None:
    """The mean in each bin that rests on more than a few intervals, with its 99 % band."""
    seen = np.isfinite(found.mean) & (found.count >= 0.002 * found.count.sum())
    middle, half = 0.5 * (found.edges[1:] + found.edges[:-1])[seen], style.SIGMA_99 * found.sd[seen]
    style.banded(axes, middle, found.mean[seen], half, colour, marker=".", markersize=5.0, linewidth=1.4)


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
        style.banded(axes, t, record.d, style.SIGMA_99 * record.sd, style.BLUE, linewidth=1.0)
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
    for k, (channel, found) in enumerate(answer.whiteness.items()):
        if k == 0:
            axes.fill_between(found.lags, -found.band, found.band, color="0.88", linewidth=0.0, label="99 % band")
        said = f"{style.SYMBOL[answer.units['theta']][channel]}  {chance(found.p_value)}"
        axes.plot(found.lags, found.correlation, markersize=3.5, label=said, **style.LOOK[channel])
    half = 3.0 * max((float(np.max(found.band)) for found in answer.whiteness.values()), default=0.1)
    low, high = axes.get_ylim()
    axes.set_ylim(min(low, -half), max(high, half))
    axes.set_xlabel("lag [samples]")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_ylabel("autocorrelation of the innovations")
    if answer.whiteness:
        style.legend_above(axes)


def window_panels(found: Prediction, channels: Sequence[str], panels: Sequence[Axes]) -> None:
    """One window: under each other the channels, readings as dots and the model as a line, and the command."""
    for channel, axes in zip(channels, panels, strict=False):
        if channel not in found.readings:
            axes.set_axis_off()
            continue
        axes.plot(found.t, found.readings[channel], ".", color="0.45", markersize=4.0, label="readings")
        axes.plot(found.t, found.model[channel], color=style.LOOK[channel]["color"], linewidth=1.6, label="model")
        axes.set_ylabel(style.label(channel, found.units))
    command(found, panels[-1])
    title = f"{style.short(found.record)}: {typeset_multiple(found.ratio)} x the noise"
    panels[0].set_title(title, fontweight="normal")
    panels[-1].set_xlabel(style.label("time", found.units))


def command(found: Prediction, axes: Axes) -> None:
    """What the machine was told, held from sample to sample."""
    axes.step(found.t, found.command, where="post", color="0.3", linewidth=1.0)
    name = quantity("torque", found.units) if found.command_unit == found.units["torque"] else "command"
    axes.set_ylabel(f"{name} [{found.command_unit}]")

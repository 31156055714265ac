"""The pictures of the workbench, for plotly: what answers hold, thinned so that peaks survive."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray
from plotly.subplots import make_subplots

from sysid.diagnosis.findings import quantity
from sysid.estimation.likelihood import SIGMA_99
from sysid.physics.ops import Array
from sysid.report.typesetting import typeset_multiple

MOST_POINTS = 5_000
"""Points of a series that a page is sent."""
MARKED = 400
"""Points of a selection that are marked in each picture."""
DOTS = 600
"""Samples that are drawn as dots."""
BLUE, ORANGE, GREEN, GREY, YELLOW = "#3d7eff", "#e8702a", "#1a9b6c", "#8a8f98", "#d99a00"
BASE = {
    "template": None,
    "paper_bgcolor": "rgba(0,0,0,0)",
    "plot_bgcolor": "rgba(0,0,0,0)",
    "font": {"family": "system-ui, sans-serif", "size": 12, "color": "#808080"},
    "margin": {"l": 60, "r": 12, "t": 12, "b": 42},
    "hoverlabel": {"font": {"family": "system-ui, sans-serif"}},
    "uirevision": "kept",
    "dragmode": "select",
    "legend": {"orientation": "h", "font": {"size": 11}, "traceorder": "normal", "x": 0, "y": 1.0, "yanchor": "bottom",
               "bgcolor": "rgba(0,0,0,0)"},
    "showlegend": False,
    "modebar": {"bgcolor": "rgba(0,0,0,0)", "color": GREY, "activecolor": BLUE},
}  # fmt: skip
AXIS = {"gridcolor": "rgba(128,128,128,0.18)", "zeroline": False, "linecolor": "rgba(128,128,128,0.6)", "ticks": "",
        "hoverformat": ".3g"}  # fmt: skip
DIVERGING = [[0.0, ORANGE], [0.5, "rgba(128,128,128,0.06)"], [1.0, BLUE]]


Series = dict[str, Array]
"""All samples of a log as a model sees them, rollout after rollout on one axis of time."""


@lru_cache(maxsize=8)
def _loaded(path: Path, changed: int) -> Series:
    with np.load(path, allow_pickle=False) as file:
        return dict(file)


def series(path: Path) -> Series:
    """The samples in a file, kept as long as it does not change."""
    return _loaded(path, path.stat().st_mtime_ns)


def within(s: Series, region: Mapping[str, tuple[float, float]]) -> NDArray[np.bool_]:
    """The samples whose quantities lie in these ranges."""
    inside = np.ones(len(s["t"]), dtype=bool)
    for name, ends in region.items():
        inside &= (s[name] >= min(ends)) & (s[name] <= max(ends))
    return inside


def thinned(
    t: Array, y: Array, most: int = MOST_POINTS, begin: float = -np.inf, end: float = np.inf
) -> tuple[Array, Array]:
    """At most `most` points of a series within [begin, end]: of each stretch its smallest and its largest value."""
    first, last = np.searchsorted(np.nan_to_num(t, nan=np.inf), [begin, end]) if np.isfinite(begin) else (0, len(t))
    t, y = t[max(first - 1, 0) : last + 1], y[max(first - 1, 0) : last + 1]
    if len(t) <= most:
        return t, y
    width = math.ceil(len(t) / (most // 2))
    begins = np.arange(0, len(t), width)
    stretches = y[np.minimum(begins[:, None] + np.arange(width), len(t) - 1)]
    low = np.argmin(np.where(np.isnan(stretches), np.inf, stretches), axis=1)
    high = np.argmax(np.where(np.isnan(stretches), -np.inf, stretches), axis=1)
    at = np.sort([begins + low, begins + high], axis=0).T.ravel()
    return t[at], y[at]


def axis_title(name: str, units: Mapping[str, str]) -> str:
    """A quantity with its unit."""
    return f"{quantity(name, units)} [{units[name]}]"


def blank(height: int, x: str = "", y: str = "", **more: Any) -> go.Figure:
    """A figure in the page's style, with the titles of its axes."""
    figure = go.Figure(layout={**BASE, "height": height, **more})
    figure.update_xaxes(**AXIS, title=x)
    figure.update_yaxes(**AXIS, title=y)
    return figure


def two_rows(height: int, **more: Any) -> go.Figure:
    """A figure in the page's style of two plots over one axis."""
    figure = make_subplots(rows=2, cols=1, shared_xaxes=True, **more)
    figure.update_layout({**BASE, "height": height})
    figure.update_xaxes(**AXIS)
    figure.update_yaxes(**AXIS)
    return figure


# ---- where it fails --------------------------------------------------------------------------------------------------

READ, SAID, LOW, BAND, D, MARKS_ABOVE, MARKS_BELOW = range(7)
"""The traces of `course`, in their order."""


def residual_over_time(comparison: Mapping[str, Any], s: Series, channel: str) -> go.Figure:
    """Measured against simulated, and the residual torque with its band below, on one axis of time."""
    units = comparison["quantities"]
    figure = two_rows(380, vertical_spacing=0.06, row_heights=[0.58, 0.42])
    figure.update_layout(showlegend=True, selectdirection="h")
    edge: dict[str, Any] = {"line": {"width": 0}, "hoverinfo": "skip", "showlegend": False}
    styles: tuple[tuple[int, dict[str, Any]], ...] = (
        (1, {"line": {"color": "rgba(138,143,152,0.75)", "width": 3.5}, "name": "measured"}),
        (1, {"line": {"color": BLUE, "width": 1.3}, "name": "model, 1 s ahead"}),
        (2, edge),
        (2, {**edge, "fill": "tonexty", "fillcolor": "rgba(232,112,42,0.28)"}),
        (2, {"line": {"color": ORANGE, "width": 1.2}, "name": f"residual {quantity('torque', units)}"}),
    )
    for line, (row, style) in zip(course_lines(s, channel), styles, strict=True):
        figure.add_scatter(**line, mode="lines", **style, row=row, col=1)
    for row in (1, 2):
        figure.add_scatter(x=[], y=[], **_marks(), row=row, col=1)
    for place in comparison["rollouts"]:
        for low, high in place["unseen"]:
            figure.add_vrect(x0=low, x1=high, fillcolor=GREEN, opacity=0.07, line_width=0, layer="below")
    figure.update_yaxes(title=axis_title(channel, units), row=1)
    figure.update_yaxes(title=f"residual [{units['torque']}]", row=2, range=_residual_range(comparison, 1.5))
    figure.update_xaxes(title="time [s], rollout after rollout", row=2)
    return figure


def course_lines(s: Series, channel: str, begin: float = -np.inf, end: float = np.inf) -> list[dict[str, Any]]:
    """The series of `course` in its order, thinned within a stretch of time."""
    d, half = s["residual_torque"], SIGMA_99 * s["residual_torque_sd"]
    read, said = (np.where(np.isnan(d), np.nan, s[f"{channel}_{of}"]) for of in ("read", "predicted"))
    lines = []
    for k, line in enumerate((read, said, d - half, d + half, d)):  # nan at a rollout's last sample, where lines end
        t, y = thinned(s["t"], line, MOST_POINTS if k < LOW else MOST_POINTS // 2, begin, end)
        lines.append({"x": t.astype(np.float32), "y": y.astype(np.float32)})
    return lines


def _marks() -> dict[str, Any]:
    return {"mode": "markers", "marker": {"color": YELLOW, "size": 4}, "hoverinfo": "skip", "showlegend": False}


def state_map(comparison: Mapping[str, Any], s: Series) -> go.Figure:
    """The mean residual torque over angle and speed, and the samples as dots that can be selected."""
    units, cells = comparison["quantities"], comparison["torque"]["map"]
    z = np.array(cells["torque"], dtype=float).T
    reach = max(float(np.nanquantile(np.abs(z), 0.95)) if np.any(np.isfinite(z)) else 0.0, 0.7 * comparison["reach"])
    figure, at = blank(270, axis_title("theta", units), axis_title("theta_dot", units)), _dots(s)
    figure.add_heatmap(
        x=cells["theta"], y=cells["theta_dot"], z=z, zmin=-reach or -1.0, zmax=reach or 1.0, colorscale=DIVERGING,
        colorbar={"title": {"text": f"[{units['torque']}]"}, "thickness": 10, "len": 0.9, "outlinewidth": 0},
        hovertemplate="%{z:.3g}<extra></extra>",
    )  # fmt: skip
    dots = {"color": GREY, "size": 2, "opacity": 0.35}
    figure.add_scatter(x=s["theta"][at], y=s["theta_dot"][at], mode="markers", marker=dots, hoverinfo="skip")
    figure.add_scatter(x=[], y=[], **_marks())
    figure.update_xaxes(range=[cells["theta"][0], cells["theta"][-1]])
    figure.update_yaxes(range=[cells["theta_dot"][0], cells["theta_dot"][-1]])
    return figure


def _dots(s: Series) -> NDArray[np.intp]:
    n = len(s["t"])
    return np.linspace(0, n - 1, min(n, DOTS)).astype(np.intp)


def torque_against(
    comparison: Mapping[str, Any], s: Series, name: str, curve: Mapping[str, Any] | None = None
) -> go.Figure:
    """The residual torque over one quantity: samples, means with their 99 % band, perhaps an effect's curve."""
    units, at = comparison["quantities"], _dots(s)
    figure = blank(270, axis_title(name, units), f"residual {axis_title('torque', units)}")
    dots = {"color": GREY, "size": 2.5, "opacity": 0.4}
    figure.add_scatter(x=s[name][at], y=s["residual_torque"][at], mode="markers", marker=dots, hoverinfo="skip")
    means = comparison["torque"]["over"][name]
    mean, sd, edges, count = (np.array(means[k], dtype=float) for k in ("mean", "sd", "edges", "count"))
    seen = np.isfinite(mean) & (count >= 0.002 * count.sum())
    figure.add_scatter(
        x=(0.5 * (edges[1:] + edges[:-1]))[seen], y=mean[seen], mode="markers", name="mean residual",
        marker={"color": ORANGE, "size": 6}, error_y={"array": SIGMA_99 * sd[seen], "thickness": 1, "width": 0},
    )  # fmt: skip
    figure.add_scatter(x=[], y=[], **_marks())
    if curve is not None:
        line = {"color": BLUE, "width": 2.5}
        figure.add_scatter(x=curve["x"], y=curve["mean"], mode="lines", line=line, name="effect")
    figure.update_yaxes(range=_residual_range(comparison, 1.15))
    return figure


def _residual_range(comparison: Mapping[str, Any], room: float) -> list[float]:
    """One scale for all models of a history: that of the first, whose residual is the largest."""
    reach = room * comparison["reach"] or 1.0
    return [-reach, reach]


def torque_over_time(comparison: Mapping[str, Any], s: Series, curve: Mapping[str, Any]) -> go.Figure:
    """The residual torque over a stretch of time, and an effect's torque through it."""
    name, places = curve["record"].partition(", ")[0], comparison["rollouts"]
    place = next((p for p in places if p["name"] == name), places[0])
    shift, torque = place["shift"], axis_title("torque", comparison["quantities"])
    x = np.array(curve["x"]) + shift
    figure = blank(270, f"time [s] of {place['name']}", f"residual {torque}", showlegend=True)
    t, d = thinned(s["t"], s["residual_torque"], 1_500, float(x[0]), float(x[-1]))
    figure.add_scatter(x=t - shift, y=d, mode="lines", line={"color": ORANGE, "width": 1.2}, name="residual")
    figure.add_scatter(x=curve["x"], y=curve["mean"], mode="lines", line={"color": BLUE, "width": 1.8}, name="effect")
    return figure


def error_bars(names: Sequence[str], ratios: Sequence[float | None], x: str = "") -> go.Figure:
    """Errors in units of the noise, a bar each, on a scale of powers, and a line where a perfect model would be."""
    figure = blank(230, x, "error / sensor noise", bargap=0.35 if len(names) > 1 else 0.65)
    figure.add_bar(
        x=names, y=ratios, marker={"color": BLUE}, text=[typeset_multiple(r) if r else "" for r in ratios],
        textposition="outside", cliponaxis=False, hoverinfo="skip",
    )  # fmt: skip
    figure.add_hline(y=1.0, line={"color": GREEN, "width": 2})
    top = max([2.0, *(r for r in ratios if r)])
    ticks = [v for v in (0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 10_000, 100_000) if v <= 2.2 * top]
    reach = [np.log10(0.6), np.log10(1.7 * top)]
    figure.update_yaxes(type="log", range=reach, tickvals=ticks, ticktext=[f"{v:g}" for v in ticks])
    return figure

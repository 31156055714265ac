"""How figures look, and how one becomes a file."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import matplotlib
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from sysid.data.files import write_whole
from sysid.report import figure_style
from sysid.report.typesetting import capital

STYLE: Any = figure_style.STYLE | {
    "font.family": "DejaVu Sans",
    "font.size": 10.0,
    "axes.titlesize": 11.0,
    "axes.titlepad": 12.0,
    "xtick.color": "0.3",
    "ytick.color": "0.3",
    "figure.dpi": 160.0,
    "figure.constrained_layout.w_pad": 0.1,
    "figure.constrained_layout.h_pad": 0.08,
}
COLOUR_MAP = matplotlib.colormaps["viridis"]
ACCENT = "#c8102e"


def save_figure(draw: Callable[[], Figure], path: Path) -> Path:
    """Draw a figure in the study's style into a PNG file; returns the path."""
    with matplotlib.rc_context(STYLE):
        figure = draw()
        FigureCanvasAgg(figure)
        content = io.BytesIO()
        figure.savefig(content, format="png")
        write_whole(path, content.getvalue())
    return path


def panels_abreast(count: int, width: float, height: float) -> tuple[Figure, list[Axes]]:
    """A figure of so many inches with panels beside each other, to one scale upwards."""
    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, list(figure.subplots(1, count, sharey=True, squeeze=False)[0])


def faint_lines(axes: Axes, axis: Literal["x", "y"]) -> None:
    """Lines at the ticks of an axis, behind all else."""
    axes.grid(axis=axis, color="0.92", linewidth=0.8)
    axes.set_axisbelow(True)


def annotate_beside(
    axes: Axes, text: str, at: tuple[float, float], shift: tuple[float, float] = (4, 0), **style: Any
) -> None:
    """A note so many points beside a place of an axis."""
    axes.annotate(text, at, shift, **{"textcoords": "offset points", "va": "center", "fontsize": 9.0} | style)


def panel_title(axes: Axes, title: str, *about: str, **style: Any) -> None:
    """What a panel shows, with lines about it below; empty ones are left out."""
    axes.set_title(capital(title), pad=30, **style)
    lines = "\n".join(filter(None, about))
    annotate_beside(axes, lines, (0.0, 1.0), (0, 26), xycoords="axes fraction", va="top", fontsize=8.5, color="0.4")


def shades(count: int, first: float = 0.15, last: float = 0.85) -> list[tuple[float, ...]]:
    """So many colours (count, 4) of the scale, from dark to light."""
    return [COLOUR_MAP(first + (last - first) * k / max(1, count - 1)) for k in range(count)]

"""What controllers that know the hidden plant return there, drawn the same way in every figure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from matplotlib.axes import Axes

from study.figure_style import ACCENT, beside
from study.formatting import number
from study.paper.reference_controllers import LQR, OPTIMAL, SWING_UP

NAMES = {OPTIMAL: "optimal", SWING_UP: "swing-up + LQR", LQR: "LQR alone"}
LOOKS = {OPTIMAL: ("-", 6), SWING_UP: ("-.", -6), LQR: (":", 0)}
"""Line style, and by how many points the name stands beside the line."""


def reference_lines(panels: Sequence[Axes], references: Mapping[str, float], low: float) -> None:
    """Lines across panels that share their scale, named at the right; what lies below the figure stands in words.

    low: the least mean return that is drawn.
    """
    room = 0.14 * (references[OPTIMAL] - low)
    end = panels[-1]
    end.set_ylim(low - room, references[OPTIMAL] + room)
    for controller, (style, shift) in LOOKS.items():
        value = references[controller]
        inside = value > low - room
        for axes in panels if inside else ():
            axes.axhline(value, color=ACCENT, linestyle=style, linewidth=1.1, zorder=1)
        text = f"{'' if inside else '↓ '}{NAMES[controller]} {number(value)}"
        at = 1.0, value if inside else low - 0.9 * room
        beside(end, text, at, (5, shift), xycoords=end.get_yaxis_transform(), color=ACCENT)

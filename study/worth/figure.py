"""The return that is expected after further rollouts, of both kinds, below that of perfect knowledge."""

from __future__ import annotations

from matplotlib.figure import Figure

from study.figure_style import ACCENT, annotate_beside
from study.worth.value_of_information import AS_BEFORE, DESIGNED, Worth
from sysid.report.figure_style import BLUE, ORANGE

KIND_COLOURS = {AS_BEFORE: BLUE, DESIGNED: ORANGE}


def worth_figure(worth: Worth) -> Figure:
    """What is added to the return over the number of further rollouts, with standard errors, less what they cost."""
    figure = Figure(figsize=(6.4, 3.8), layout="constrained")
    axes = figure.subplots()
    kinds = [kind for kind in KIND_COLOURS if any(x.kind == kind for x in worth.further)]
    counts = sorted({x.rollouts for x in worth.further})
    places = {0: 0, **{h: i + 1 for i, h in enumerate(counts)}}
    for shift, kind in enumerate(kinds):
        points = [x for x in worth.further if x.kind == kind]
        at = [0.0, *(places[x.rollouts] + 0.06 * (shift - 0.5) for x in points)]
        values, errors = [0.0, *(x.gain.value for x in points)], [0.0, *(x.gain.sem for x in points)]
        label = f"{kind} rollouts" if kind == DESIGNED else f"rollouts {kind}"
        axes.errorbar(at, values, errors, color=KIND_COLOURS[kind], marker="o", capsize=0, label=label)
    axes.axhline(worth.perfect.value, color=ACCENT)
    annotate_beside(axes, "the machine known perfectly", (0.0, worth.perfect.value), (4, 7), color=ACCENT)
    if worth.price is not None:
        cost = [worth.price * h for h in (0, *counts)]
        axes.plot(list(places.values()), cost, color="0.4", linestyle="--", label="what they cost")
        axes.set_ylim(top=1.25 * max(worth.perfect.value + worth.perfect.sem, 1e-9))
    axes.set_xticks(list(places.values()), [str(h) for h in places])
    axes.set_xlabel("further rollouts")
    axes.set_ylabel("added to the return")
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
    return figure

"""The page of the mismatch experiment: one HTML file that opens without a network, the answer in words first."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from study.formatting import bracketed, number
from study.mismatch.findings import MismatchFindings
from study.mismatch.labels import capital, plant_title
from study.mismatch.naming_results import NamingResult, naming_table
from study.mismatch.plan import STRATEGIES
from study.pipeline.html_page import embedded, template
from study.pipeline.progress import duration
from study.statistics import Contrast

CAPTIONS = {
    "returns": "Every strategy at every hidden plant: mean return with its 95 % interval over seeds, hollow for few "
    "rollouts, filled for many. All panels have one scale, each about its own optimum; a number at the left edge is a "
    "mean left of the panel.",
    "ladder": "Left: from knowing nothing to knowing everything, at the largest budget. Right: what the gap to the "
    "optimum consists of, with a model that lacks the effect and with the mended one.",
    "trajectories": "Where mending gained most, the two agents of the seed whose gain is nearest to the median, from "
    "the same start states. Torques: of the first in full, of the others faint.",
    "naming": "Above: how often the diagnosis is right, with Wilson's 95 % band: the effect named and no other, or its "
    "class where the log cannot tell; \u201cunknown\u201d or \u201cpartly\u201d where the catalogue lacks it. "
    "Below: the error of m and l in the model without the effect (squares) and in the mended one (dots).",
}
"""What stands below a figure, by its name and in the page's order."""


def page(
    findings: MismatchFindings,
    sentences: Sequence[tuple[str, str]],
    figures: Mapping[str, Path],
    versions: Mapping[str, str],
    rows: Sequence[NamingResult] = (),
) -> str:
    """The finished page.

    figures   PNG files by their names in CAPTIONS; those that are missing are left out
    rows      of the naming study, where they are there
    """
    plan = findings.plan
    settings = plan.to_dict()
    for shown in ("plants", "ways"):
        del settings[shown]
    content = {
        "findings": findings,
        "plan": plan,
        "sentences": sentences,
        "images": [(embedded(figures[name]), text) for name, text in CAPTIONS.items() if name in figures],
        "strategies": STRATEGIES,
        "titles": {plant.name: capital(plant_title(plant)) for plant in plan.plants},
        "verdicts": _verdicts(findings),
        "named": naming_table(rows) if rows else None,
        "worker_time": duration(3600.0 * findings.hours),
        "settings": settings,
        "versions": versions,
    }
    return template("mismatch.html.j2", {"interval": _interval}).render(content)


def _verdicts(findings: MismatchFindings) -> list[tuple[str, int, str]]:
    """(plant, n, what was said and how often), in the plan's order."""
    return [
        (capital(plant_title(plant)), n, ", ".join(f"{text} ({count})" for text, count in found.most_common()))
        for plant in findings.plan.plants
        for n in findings.plan.budgets
        if (found := findings.verdicts.get((plant.name, n)))
    ]


def _interval(mean: Contrast) -> str:
    """A return, which is read without a plus sign; its interval where there is one."""
    if not math.isfinite(mean.low):
        return number(mean.mean)
    return bracketed(mean.mean, mean.low, mean.high).replace(" ", "\u00a0")

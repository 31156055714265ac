"""The section of the report that holds a preset against the publication, as HTML."""

from __future__ import annotations

import math
from typing import Any

from markupsafe import Markup, escape

from study.formatting import number
from study.paper import published_numbers as paper
from study.paper.agreement import DIFFERS, MARGIN, Agreement, CellAgreement, ContrastAgreement
from study.paper.presets import Preset
from study.paper.published_numbers import CELLS, Spot
from study.paper.published_runs import CellSummary
from study.paper.reproduction import REPRODUCTION_CAPTIONS, Reproduction
from study.pipeline.html_page import embedded, template
from study.statistics import Contrast


def section(reproduction: Reproduction, preset: Preset) -> Markup:
    page = template("reproduction.html.j2", {"bold": _bold, "summary": _summary})
    return Markup(page.render(_content(reproduction, preset)))


def _content(reproduction: Reproduction, preset: Preset) -> dict[str, Any]:
    agreement = reproduction.agreement
    return {
        "reproduction": reproduction,
        "preset": preset,
        "paper": paper,
        "points": paper.POINTS,
        "margin": MARGIN,
        "pictures": [
            (name, embedded(file), REPRODUCTION_CAPTIONS[name]) for name, file in reproduction.figures.items()
        ],
        "apart": _apart(agreement) if agreement else [],
        "published": _published,
        "fresh": lambda spot: _fresh(agreement, spot) if agreement else "",
    }


def _apart(agreement: Agreement) -> list[dict[str, str]]:
    """Where the two disagree: cells that differ, then contrasts of which one is significant and the other is not."""
    cells = [
        {
            "what": f"mean return, {_named(c.spot)}",
            "theirs": _published(c).partition(" (")[0],
            "ours": _summary(c.ours).partition(" (")[0],
            "difference": str(c.difference),
            "reason": c.reason,
        }
        for c in agreement.cells
        if c.verdict == DIFFERS
    ]
    contrasts = [
        {
            "what": c.published.label,
            "theirs": str(c.theirs),
            "ours": str(c.ours),
            "difference": str(c.change or ""),
            "reason": _flipped(c),
        }
        for c in agreement.contrasts
        if c.agrees is False
    ]
    return cells + contrasts


def _flipped(c: ContrastAgreement) -> str:
    """Why one contrast is significant and the other is not, as far as the intervals tell."""
    said = []
    if c.change is not None and not c.change.significant:
        said.append("the two do not differ by more than scatter")
    if c.published.significant and not c.theirs_t.significant:
        said.append("the published one has zero in its t interval")
    if c.ours is not None and c.ours_t is not None and c.ours.significant and not c.ours_t.significant:
        said.append("ours has zero in its t interval")
    return "; ".join(said) or "not found"


def _named(spot: Spot) -> str:
    point = "" if spot.point == "main" else f"{spot.point.replace('_', ' ')}, "
    return f"{point}n = {spot.n}, w = {spot.w:g}"


def _published(c: CellAgreement) -> str:
    """The published side of a cell, as printed where the text has a number."""
    printed = CELLS[c.spot].printed
    return _summary(CellSummary(c.theirs.mean if printed is None else printed, *list(vars(c.theirs).values())[1:]))


def _fresh(agreement: Agreement, spot: Spot) -> str:
    summary = agreement.ours.summary(spot, fresh=True)
    return "" if math.isnan(summary.mean) else _summary(summary)


def _summary(summary: CellSummary) -> str:
    error = "" if math.isnan(summary.sem) else f" ± {summary.sem:.0f}"
    return f"{number(summary.mean)}{error} ({number(summary.median)})"


def _bold(contrast: Contrast | None) -> Markup:
    if contrast is None:
        return Markup("")
    return Markup("<b>{}</b>").format(contrast) if contrast.significant else Markup(escape(str(contrast)))

"""A finished preset held against the publication: agreement, claims, identifiers, and the figures that show them.

The preset's siblings, folders beside its own that hold the runs of its companions, take part: the main sweep gives the
robustness table its first row, the longer training its sentence. For a missing one the command is said.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from study.paper import claims
from study.paper.agreement import Agreement
from study.paper.claims import Claim
from study.paper.finished_runs import Outcomes, outcomes, read_runs
from study.paper.identification_scatter import Scatter
from study.paper.presets import PAPER, PAPER_PRESETS, Preset
from study.paper.published_numbers import CELLS, SEEDS, URL, Spot
from study.paper.reference_controllers import OPTIMAL
from study.paper.saturation_budget import budget_curves, paragraph
from study.paper.sweep_findings import PointFindings
from study.statistics import Contrast, paired_bootstrap
from sysid import InvalidInput

if TYPE_CHECKING:
    from matplotlib.figure import Figure

REPRODUCTION_CAPTIONS = {
    "published_heatmap": "The published sweep and this one on one colour scale, which ends at the optimum of the "
    "hidden plant. The best cell of each is outlined.",
    "published_pareto": "The best width at every budget, there and here (the published curve again in grey), between "
    "each side's extremes and the references. w* is the width with the best mean return at that n.",
    "published_contrasts": "Every contrast that the paper calls significant or not, there and here.",
    "published_claims": "The paper's grid search on many seeds. Left: the error falls slower than 1/√n within the "
    "paper's budgets, where the edge of the grid bounds it, and has no floor there. Right: m scatters; noise in the "
    "inputs does not move it.",
    "identifiers": "The same rollouts through three identifiers: the return that they buy, and how close m and l come.",
}
"""What each figure shows; drawn are those for which there are runs."""

WITHOUT_THEIRS = (
    "Without the authors' runs every cell is compared by Welch's interval. --published DIR, with the results folder of "
    f"{URL}, pairs them seed by seed."
)

LONGER_AT = Spot("main", 50, 0.5)
"""The cell that the presets longer and longer-small train on."""


@dataclass(frozen=True, eq=False)
class Reproduction:
    """What the section says. agreement is None where nothing published was repeated; short: the paper's best cell, the
    optimum from the same start states, percent between them; drawings: what draws each of REPRODUCTION_CAPTIONS."""

    agreement: Agreement | None
    claims: Sequence[Claim]
    identifiers: str
    short: tuple[float, float, float] | None
    notes: Sequence[str]
    drawings: Mapping[str, Callable[[], Figure]]

    def sentences(self) -> list[tuple[str, str]]:
        """Pairs of question and answer."""
        said = self.agreement.sentences() if self.agreement else []
        return said + [("What is a rollout worth to a good identifier?", self.identifiers)] * bool(self.identifiers)


def reproduce(
    answers: Sequence[PointFindings],
    folder: Path,
    theirs: Outcomes | None = None,
    scatter: Scatter | None = None,
) -> Reproduction:
    """Compare.

    folder: of the results, beside which those of other presets lie; theirs: the authors' runs, where they are given;
    scatter: where identification was studied
    """
    from study.paper import paper_figures  # loads matplotlib, which no worker needs

    preset = answers[0].preset
    base = PAPER_PRESETS.get(preset.companion or "", preset)
    swept = outcomes(run for answer in answers for run in answer.runs)
    siblings, notes = _siblings(preset, base, folder)
    ours = swept
    for name, runs in siblings.items():
        ours = ours.merged(runs) if PAPER_PRESETS[name].steps == preset.steps else ours
    agreement = None
    if preset.steps == base.steps and any(spot in ours for spot in CELLS):
        agreement = Agreement(ours, theirs, preset)
        if theirs is None:
            notes.insert(0, WITHOUT_THEIRS)
    if theirs and theirs.missing:
        notes.insert(0, f"Of the authors' files these were not there: {', '.join(theirs.missing)}.")
    main = next(iter(_on_main(answers)), None)
    allowed = main.allowed() if main else {}
    curves, wider = (budget_curves(swept, w) if main else {} for w in (0.0, 0.2))
    drawings = _sweeps(agreement, main) if agreement else {}
    if scatter:
        drawings["published_claims"] = lambda: paper_figures.identification(scatter)
    if curves:
        drawings["identifiers"] = lambda: paper_figures.identifiers(curves, wider, allowed)

    said = _claims(answers, swept if preset.steps == base.steps else None, scatter)
    said += _undertraining(answers, _longer(preset, base, {preset.name: swept, **siblings}))
    return Reproduction(agreement, said, paragraph(curves, wider, allowed), _short(main), notes, drawings)


def _on_main(answers: Sequence[PointFindings]) -> list[PointFindings]:
    return [answer for answer in answers if answer.point.truth == PAPER.points[0].truth]


def _claims(answers: Sequence[PointFindings], swept: Outcomes | None, scatter: Scatter | None) -> list[Claim]:
    on_main = _on_main(answers)

    def optima(seeds: Sequence[int]) -> list[float]:
        return [float(np.mean(on_main[0].reference(OPTIMAL, seeds, fresh=fresh))) for fresh in (False, True)]

    starts = claims.starts(SEEDS, swept, [answer.point.name for answer in on_main], optima if on_main else None)
    identified = [claims.rate(scatter), claims.bias(scatter), claims.error_floor(scatter)] if scatter else []
    return [*identified, claims.plateau(swept), claims.monotone(swept), starts]


def _siblings(preset: Preset, base: Preset, folder: Path) -> tuple[dict[str, Outcomes], list[str]]:
    """Runs of the presets that belong together, by preset, and a sentence on each that is missing."""
    siblings, said = {}, []
    family = [
        name for name, other in PAPER_PRESETS.items() if base.name in (name, other.companion) and name != preset.name
    ]
    for name in family:
        file = folder.parent / name / "runs.csv"
        if not file.exists():
            said.append(f"The runs of preset {name} are not beside these: python -m study.main --preset {name}")
            continue
        try:
            siblings[name] = read_runs(file)
        except InvalidInput as error:
            said.append(f"The runs of preset {name} are left out: {error}")
    return siblings, said


def _sweeps(agreement: Agreement, main: PointFindings | None) -> dict[str, Callable[[], Figure]]:
    """The published sweep and ours beside what controllers reach on its plant (`main`) with the published seeds."""
    from study.paper import paper_figures

    theirs = {spot[1:]: cell.summary for spot, cell in CELLS.items() if spot.point == "main"}
    ours = {spot[1:]: agreement.ours.summary(spot) for spot in agreement.ours.table if spot.point == "main"}
    drawings: dict[str, Callable[[], Figure]] = {}
    if ours and main:
        references = main.figure_references
        layers, seeds = " × ".join(map(str, agreement.preset.hidden)), max(cell.seeds for cell in ours.values())  # noqa: RUF001
        our_seeds = sorted({seed for n, w in ours for seed in agreement.ours.seeds(Spot("main", n, w))})
        here = f"Here ({layers} networks, {seeds} seed{'s' * (seeds != 1)})"
        published = "Published (256 × 256 networks, 10 seeds)"  # noqa: RUF001
        sides = {published: theirs, here: ours}
        optima = {published: references[OPTIMAL], here: main.rating(OPTIMAL, our_seeds)[0]}
        drawings["published_heatmap"] = lambda: paper_figures.heatmaps(sides, references, optima)
        drawings["published_pareto"] = lambda: paper_figures.paretos(sides, references)
    if ran := [contrast for contrast in agreement.contrasts if contrast.ours]:
        drawings["published_contrasts"] = lambda: paper_figures.contrasts(ran)
    return drawings


def _longer(preset: Preset, base: Preset, runs: Mapping[str, Outcomes]) -> tuple[Contrast, int] | None:
    """What training on gained at the widest band, and to how many steps; None where it was not run."""
    long = next((name for name in runs if PAPER_PRESETS.get(name, preset).steps > base.steps), "")
    if not long or not all(LONGER_AT in runs.get(name, Outcomes({})) for name in (long, base.name)):
        return None
    a, b = runs[long], runs[base.name]
    seeds = sorted({*a.seeds(LONGER_AT)} & {*b.seeds(LONGER_AT)})
    return paired_bootstrap(a.returns(LONGER_AT, seeds), b.returns(LONGER_AT, seeds)), PAPER_PRESETS[long].steps


def _undertraining(answers: Sequence[PointFindings], longer: tuple[Contrast, int] | None) -> list[Claim]:
    main = next((answer for answer in answers if answer.point.name == "main"), None)
    if main is None or LONGER_AT.w not in main.point.widths:
        return []
    n, widths = max(main.point.budgets), sorted({min(main.point.widths), max(main.point.widths)})
    curves = {w: [run.curve for run in main.cells[n, w] if len(run.curve) > 2] for w in widths}
    return [claims.undertraining(curves, n, main.preset.steps, longer)] if all(curves.values()) else []


def _short(main: PointFindings | None) -> tuple[float, float, float] | None:
    if main is None or (main.preset.episodes, main.preset.reference_seeds) != (PAPER.episodes, SEEDS):
        return None
    best, optimum = CELLS[Spot("main", 50, 0.0)].printed, float(np.mean(main.reference(OPTIMAL, seeds=SEEDS)))
    assert best is not None
    return best, optimum, 100.0 * (optimum - best) / abs(optimum)

"""A finished preset held against the publication: agreement, claims, identifiers, and the figures that show them.

The preset's siblings, folders beside its own that hold the runs of its companions, take part: the main sweep gives the
robustness table its first row, the longer training its sentence. For a missing one the command is said.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from study.figure_style import save
from study.paper import claims
from study.paper.agreement import Agreement
from study.paper.claims import Claim
from study.paper.figures import identification as claim_figures
from study.paper.figures import side_by_side
from study.paper.figures.sweeps import heatmaps, paretos
from study.paper.findings import PointFindings
from study.paper.identification_scatter import Scatter
from study.paper.presets import PRESETS, Preset
from study.paper.published_numbers import CELLS, EPISODES, POINTS, ROBUSTNESS, SEEDS, URL, Spot
from study.paper.published_runs import Outcome, Outcomes, outcomes, read_runs
from study.paper.reference_controllers import OPTIMAL
from study.paper.saturation_budget import budget_curves, paragraph
from study.statistics import Contrast, paired_bootstrap
from sysid import InvalidInput

REPRODUCTION_CAPTIONS = {
    "published_heatmap": "The published sweep and this one on one colour scale, which ends at the optimum of the "
    "hidden plant. The best cell of each is outlined.",
    "published_pareto": "The best width at every budget, there and here (the published curve again in grey), between "
    "each side's extremes and the references.",
    "published_contrasts": "Every contrast that the paper calls significant or not, there and here.",
    "published_claims": "The paper's grid search on many seeds. Left: the error falls slower than 1/√n within the "
    "paper's budgets, where the edge of the grid bounds it, and has no floor there. Right: m scatters; noise in the "
    "inputs does not move it.",
    "identifiers": "The same rollouts through three identifiers: the return that they buy, and how close m and l come.",
}
"""What each figure shows; drawn are those for which there are runs."""

LONGER_AT = Spot("main", 50, 0.5)
"""The cell that the presets longer and longer-small train on."""


@dataclass(frozen=True, eq=False)
class Reproduction:
    """What the section says. agreement is None where nothing published was repeated; short: the paper's best cell, the
    optimum from the same start states, percent between them."""

    agreement: Agreement | None
    claims: Sequence[Claim]
    identifiers: str
    short: tuple[float, float, float] | None
    notes: Sequence[str]
    figures: Mapping[str, Path]

    def sentences(self) -> list[tuple[str, str]]:
        said = self.agreement.sentences() if self.agreement else []
        return (
            [*said, ("What is a rollout worth to a good identifier?", self.identifiers)] if self.identifiers else said
        )


def reproduce(
    found: Sequence[PointFindings],
    folder: Path,
    theirs: Outcomes | None = None,
    scatter: Scatter | None = None,
    fresh_optimum: Callable[[Sequence[int]], float] | None = None,
) -> Reproduction:
    """Compare and draw. theirs: the authors' runs, where they are given; scatter: where identification was studied;
    fresh_optimum: of such seeds, at the main plant, from start states that no two seeds share."""
    preset = found[0].preset
    own = outcomes(_rows(found))
    siblings, lacking = _siblings(preset, folder)
    swept = preset.steps == _base(preset).steps
    ours = own
    for name, runs in siblings.items():
        ours = ours.merged(runs) if PRESETS[name].steps == preset.steps else ours
    agreement: Agreement | None = Agreement(
        ours, theirs, preset.episodes == EPISODES, preset.hidden, preset.steps, preset.resamples
    )
    if not swept or not any(spot in ours for spot in CELLS):
        agreement = None
    main = next(iter(_on_main(found)), None)
    allowed = main.allowed() if main else {}
    curves, wider = (budget_curves(own, w) if main else {} for w in (0.0, 0.2))
    drawings: dict[str, Callable[[], Figure]] = {}
    if agreement:
        drawings |= _sweeps(agreement, main)
    if scatter:
        drawings["published_claims"] = lambda: claim_figures.identification(scatter)
    if curves:
        drawings["identifiers"] = lambda: claim_figures.identifiers(curves, wider, allowed)
    files = {name: save(draw, folder / f"{name}.png") for name, draw in drawings.items()}
    return Reproduction(
        agreement,
        _claims(found, own if swept else None, scatter, _longer(preset, own, siblings), fresh_optimum),
        paragraph(curves, wider, allowed),
        _short(found),
        _notes(agreement, theirs, lacking),
        files,
    )


def _rows(found: Iterable[PointFindings]) -> Iterable[tuple[Spot, int, Outcome]]:
    for answer in found:
        for run in answer.runs:
            spot = Spot(run.cell.point, run.cell.n, run.cell.w)
            yield spot, run.cell.seed, Outcome(run.mean, run.id_error, run.theta_hat, run.fresh_mean)


def _base(preset: Preset) -> Preset:
    return PRESETS.get(preset.companion or "", preset)


def _siblings(preset: Preset, folder: Path) -> tuple[dict[str, Outcomes], list[str]]:
    """Runs of the presets that belong together, by preset, and a sentence on each that is missing."""
    base, found, said = _base(preset).name, {}, []
    family = [name for name, other in PRESETS.items() if base in (name, other.companion) and name != preset.name]
    for name in family:
        file = folder.parent / name / "runs.csv"
        if not file.exists():
            said.append(f"The runs of preset {name} are not beside these: python -m study.main --preset {name}")
            continue
        try:
            found[name] = read_runs(file)
        except InvalidInput as error:
            said.append(f"The runs of preset {name} are left out: {error}")
    return found, said


def _on_main(found: Sequence[PointFindings]) -> list[PointFindings]:
    return [answer for answer in found if answer.point.truth == POINTS["main"].truth]


def _sweeps(agreement: Agreement, main: PointFindings | None) -> dict[str, Callable[[], Figure]]:
    """The published sweep and ours beside what controllers reach on its plant (`main`) with the published seeds."""
    theirs, ours = side_by_side.published_sweep(), side_by_side.sweep(agreement)
    drawings: dict[str, Callable[[], Figure]] = {}
    if ours and main:
        references = main.allowed(main.preset.reference_seeds)
        titles = side_by_side.titles(agreement.hidden, max(cell.seeds for cell in ours.values()))
        sides = dict(zip(titles, (theirs, ours), strict=True))
        drawings["published_heatmap"] = lambda: heatmaps(sides, references)
        drawings["published_pareto"] = lambda: paretos(sides, references)
    if ran := [contrast for contrast in agreement.contrasts if contrast.ours]:
        drawings["published_contrasts"] = lambda: side_by_side.contrasts(ran)
    return drawings


def _longer(preset: Preset, own: Outcomes, siblings: Mapping[str, Outcomes]) -> tuple[Contrast, int] | None:
    """What training on gained at the widest band, and to how many steps; None where it was not run."""
    every = {preset.name: own, **siblings}
    base, long = (
        _base(preset),
        next((name for name in every if PRESETS.get(name, preset).steps > _base(preset).steps), ""),
    )
    if base.name not in every or not long:
        return None
    a, b = every[long], every[base.name]
    if LONGER_AT not in a or LONGER_AT not in b:
        return None
    seeds = sorted({*a.seeds(LONGER_AT)} & {*b.seeds(LONGER_AT)})
    gain = paired_bootstrap(a.returns(LONGER_AT, seeds), b.returns(LONGER_AT, seeds), np.random.default_rng(0))
    return gain, PRESETS[long].steps


def _claims(
    found: Sequence[PointFindings],
    ours: Outcomes | None,
    scatter: Scatter | None,
    longer: tuple[Contrast, int] | None,
    fresh_optimum: Callable[[Sequence[int]], float] | None,
) -> list[Claim]:
    said = [claims.rate(scatter), claims.bias(scatter), claims.floor(scatter)] if scatter else []
    alike = _on_main(found)

    def optima(seeds: Sequence[int]) -> tuple[float, float]:
        assert fresh_optimum is not None
        return float(np.mean(alike[0].reference(OPTIMAL, seeds=seeds))), fresh_optimum(seeds)

    names = [answer.point.name for answer in alike]
    own_starts = claims.starts(SEEDS, ours, names, optima if alike and fresh_optimum else None)
    said += [claims.plateau(ours), claims.monotone(ours), own_starts]
    main = next((answer for answer in found if answer.point.name == "main"), None)
    if main and LONGER_AT.w in main.point.widths:
        n, widths = max(main.point.budgets), sorted({min(main.point.widths), max(main.point.widths)})
        curves = {w: [run.curve for run in main.cells[n, w] if len(run.curve) > 2] for w in widths}
        if all(curves.values()):
            said.append(claims.undertraining(curves, n, main.preset.steps, longer))
    return said


def _short(found: Sequence[PointFindings]) -> tuple[float, float, float] | None:
    main = next(iter(_on_main(found)), None)
    if main is None or (main.preset.episodes, main.preset.reference_seeds) != (EPISODES, SEEDS):
        return None
    best, optimum = ROBUSTNESS[0].best, float(np.mean(main.reference(OPTIMAL, seeds=SEEDS)))
    return best, optimum, 100.0 * (optimum - best) / abs(optimum)


def _notes(agreement: Agreement | None, theirs: Outcomes | None, lacking: Sequence[str]) -> list[str]:
    said = []
    if theirs is None and agreement:
        said.append(
            f"Without the authors' runs every cell is compared by Welch's interval. --published DIR, with the results "
            f"folder of {URL}, pairs them seed by seed."
        )
    elif theirs and theirs.missing:
        said.append(f"Of the authors' files these were not there: {', '.join(theirs.missing)}.")
    return [*said, *lacking]

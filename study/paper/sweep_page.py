"""The paper's sweep, told: tables for other programs, figures and page."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from study.paper import published_numbers as paper
from study.paper.agreement import MARGIN
from study.paper.finished_runs import run_table
from study.paper.presets import Point, Preset
from study.paper.reference_controllers import CONTROLLERS, LQR, OPTIMAL, SWING_UP
from study.paper.reproduction import REPRODUCTION_CAPTIONS, Reproduction
from study.paper.sweep_findings import PointFindings
from study.pipeline.publication import Account, AnswerSection, Table
from study.pipeline.settings import all_versions

CONTROLLER_LABELS = {OPTIMAL: "optimal (dynamic programming)", LQR: "LQR alone", SWING_UP: "energy swing-up, then LQR"}

POINT_CAPTIONS = {
    "heatmap": "Mean return on the hidden plant ± standard error over seeds. The best cell is outlined; the brightest "
    "colour is the optimum.",
    "pareto": "The best width at every budget, between training without data and training on the most data. "
    "w* is the width with the best mean return at that n.",
    "curves": "Returns of training episodes in the simulators agents train on, averaged over seeds and ten episodes. "
    "Every n has simulators of its own, so that heights do not compare from panel to panel: what n is worth shows on "
    "the hidden plant alone.",
}


def outputs(preset: Preset) -> tuple[str, ...]:
    """The tables and figures that may be written."""
    drawn = (preset.figure_file(point.name, name) for point in preset.points for name in POINT_CAPTIONS)
    return "runs.csv", "references.csv", *drawn, *(f"{name}.png" for name in REPRODUCTION_CAPTIONS)


def sweep_account(answers: Sequence[PointFindings], reproduction: Reproduction) -> Account:
    """What is told of the operating points, one after the other, and of all of them against the publication."""
    from study.paper.paper_figures import drawings  # loads matplotlib, which no worker needs

    preset, runs = answers[0].preset, [run for answer in answers for run in answer.runs]
    references = {(r.key, r.seed): r for answer in answers for r in answer.references}
    made = [*runs, *references.values()]
    drawn = [
        {preset.figure_file(answer.point.name, name): (draw, POINT_CAPTIONS[name]) for name, draw in figures.items()}
        for answer, figures in zip(answers, map(drawings, answers), strict=True)
    ]
    held = {f"{name}.png": (draw, REPRODUCTION_CAPTIONS[name]) for name, draw in reproduction.drawings.items()}
    sections = [
        AnswerSection(answer.sentences(), title(answer.point) if len(answers) > 1 else "", answer.caveat())
        for answer in answers
    ]
    return Account(
        plan=preset,
        sections=[*sections, AnswerSection(reproduction.sentences())],
        tables={"runs.csv": run_table(runs), "references.csv": reference_table(answers)},
        drawings={name: drawing for figures in (*drawn, held) for name, drawing in figures.items()},
        template="sweep.html.j2",
        shown={
            "parts": list(zip(answers, drawn, strict=True)),
            "held": held,
            "controllers": CONTROLLER_LABELS,
            "sac": next((run.settings["sac"] for run in runs if "sac" in run.settings), {}),
            "origins": Counter(run.imported for run in runs if run.imported),
            "reproduction": reproduction,
            "paper": paper,
            "margin": MARGIN,
        },
        counts={"runs": len(runs), "imported": sum(bool(run.imported) for run in runs)},
        seconds=sum(item.seconds for item in made),
        versions=all_versions(item.versions for item in made),
    )


def reference_table(answers: Sequence[PointFindings]) -> Table:
    """One row a controller, designed at a hidden plant's own (m, l).

    Mean and SEM are over the start states of the preset's reference seeds, the paper's ten, so that these numbers do
    not change with the preset; gaps in the report are paired over the study's own seeds.
    """
    rows = [
        (*truth, controller, *answer.rating(controller, answer.preset.reference_seeds))
        for truth, answer in {answer.point.truth: answer for answer in answers}.items()
        for controller in CONTROLLERS
    ]
    return ("m", "l", "controller", "return_mean", "return_sem"), rows


def title(point: Point) -> str:
    """An operating point in a line."""
    m, l = point.truth  # noqa: E741
    band = "" if point.randomization == "band" else ", trained over the prior range"
    return (
        f"{point.name.replace('_', ' ')}: m = {m:g} kg, l = {l:g} m, speed read to {point.sigma:g} rad/s, "
        f"identified by {point.identifier.replace('_', ' ')}{band}"
    )

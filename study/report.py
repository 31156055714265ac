"""The report: one HTML file that opens without a network, the answer in words first; and the same in a terminal."""

from __future__ import annotations

import base64
import itertools
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from study import figures, paper, tables
from study.answer import Answer, number
from study.config import Preset
from study.progress import duration
from study.references import LQR, OPTIMAL, SWING_UP
from study.statistics import MINUS, Contrast
from study.store import Store

LABELS = {OPTIMAL: "optimal (dynamic programming)", LQR: "LQR alone", SWING_UP: "energy swing-up, then LQR"}

CAPTIONS = {
    "heatmap": "Mean return on the hidden plant ± standard error over seeds. The best cell is outlined; the brightest "
    "colour is the optimum.",
    "pareto": "The best width at every budget, between training without data and training on the most data.",
    "gap": "Diamonds: the controller that is optimal for the estimate, run on the hidden plant. From the red line to a "
    "diamond is what identification cost; from the diamond to a dot is what training and width cost.",
    "curves": "Returns of training episodes in the simulators agents train on, averaged over seeds and ten episodes.",
}


def publish(preset: Preset, store: Store, console: Console) -> Answer:
    """Write tables, figures and report into the folder and say the answer on the console."""
    folder = store.folder
    with console.status("drawing"):
        answer = Answer(preset, store.runs(), store.references())
        tables.write_runs(answer, folder / "runs.csv")
        tables.write_references(answer, folder / "references.csv")
        drawn = figures.save_all(answer, folder)
        write_report(answer, drawn, folder / "report.html")
    console.print()
    for question, text in answer.sentences():
        console.print(f"[bold]{question}[/]\n{_plain(text)}\n", soft_wrap=False)
    console.print(f"[dim]{_plain(answer.caveat())}[/]\n")
    console.print(f"report   {folder / 'report.html'}", soft_wrap=True)
    console.print(f"figures  {', '.join(str(path) for path in drawn.values())}", soft_wrap=True)
    return answer


def write_report(answer: Answer, drawn: Mapping[str, Path], path: Path) -> None:
    """Write the self-contained report with the figures of these files."""
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("study"), autoescape=True, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["number"] = number
    template = environment.get_template("report.html.j2")
    path.write_text(template.render(_content(answer, drawn)), encoding="utf-8")


def _content(answer: Answer, drawn: Mapping[str, Path]) -> dict[str, Any]:
    preset = answer.preset
    seconds = sum(run.seconds for run in answer.runs) + sum(r.seconds for r in answer.references)
    return {
        "answer": answer,
        "preset": preset,
        "sentences": [(question, _unbroken(text)) for question, text in answer.sentences()],
        "images": [(name, _embedded(file), CAPTIONS[name]) for name, file in drawn.items()],
        "budget_rows": _budgets(answer),
        "cell_rows": [_cell_row(answer, key) for key in answer.cells],
        "contrasts": _contrasts(answer),
        "controllers": [
            (LABELS[c], mean, sem, here)
            for (c, mean, sem), (_, here, _) in zip(answer.controllers(), answer.controllers(preset.seeds), strict=True)
        ],
        "short": _paper_short_of_optimal(answer),
        "published": _published(answer),
        "paper": paper,
        "settings": preset.to_dict(),
        "sac": answer.runs[0].settings.get("sac", {}),
        "versions": _versions(answer),
        "worker_time": duration(seconds),
    }


def _embedded(file: Path) -> str:
    return "data:image/png;base64," + base64.b64encode(file.read_bytes()).decode()


def _budgets(answer: Answer) -> list[tuple[int, float, float | None]]:
    """(n, our mean identification error, the paper's where it is printed)."""
    return [(n, answer.id_error(n), paper.ID_ERROR.get(n)) for n in answer.preset.budgets]


def _cell_row(answer: Answer, key: tuple[int, float]) -> dict[str, Any]:
    gap = answer.gap(key)
    return {
        "n": key[0],
        "w": key[1],
        "mean": answer.mean(key),
        "sem": answer.sem(key),
        "best": key == answer.best,
        "gap": gap.total,
        "percent": 100.0 * gap.total.mean / abs(answer.optimum),
        "identification": gap.identification,
        "training": gap.training,
    }


def _contrasts(answer: Answer) -> list[tuple[str, Contrast]]:
    """Every step of the budget at the least width, and every width against the least."""
    budgets, widths = answer.preset.budgets, answer.preset.widths
    steps = [
        (f"n = {a} → {b}, w = {widths[0]:g}", answer.contrast((b, widths[0]), (a, widths[0])))
        for a, b in [*itertools.pairwise(budgets), (budgets[0], budgets[-1])]
        if a != b
    ]
    steps = list(dict(steps).items())
    wider = [
        (f"w = {widths[0]:g} → {w:g}, n = {n}", answer.contrast((n, w), (n, widths[0])))
        for n in budgets
        for w in widths[1:]
    ]
    return steps + wider


def _published(answer: Answer) -> list[tuple[str, str, str, str]]:
    """(quantity, the paper's, ours, place in the paper) for what both report."""
    rows = []
    for p in paper.MEANS:
        if (p.n, p.w) in answer.cells:
            ours = f"{number(answer.mean((p.n, p.w)))} ± {answer.sem((p.n, p.w)):.0f}"
            rows.append((f"mean return at n = {p.n}, w = {p.w:g}", number(p.mean), ours, p.place))
    for c in paper.CONTRASTS:
        if c.a in answer.cells and c.b in answer.cells:
            (n_a, w_a), (n_b, w_b) = c.a, c.b
            change = f"n = {n_b} → {n_a} at w = {w_a:g}" if w_a == w_b else f"w = {w_b:g} → {w_a:g} at n = {n_a}"
            theirs = f"{c.mean:+.0f}" + (f" [{c.interval[0]:+.0f}, {c.interval[1]:+.0f}]" if c.interval else "")
            rows.append(
                (f"change of return, {change}", theirs.replace("-", MINUS), str(answer.contrast(c.a, c.b)), c.place)
            )
    return rows


def _paper_short_of_optimal(answer: Answer) -> tuple[float, float, float] | None:
    """(the paper's best cell, the optimum from the same start states, percent between them); None elsewhere."""
    preset = answer.preset
    if (preset.truth, preset.episodes, preset.reference_seeds) != (paper.TRUTH, paper.EPISODES, paper.SEEDS):
        return None
    optimum = float(np.mean(answer.reference(OPTIMAL, seeds=paper.SEEDS)))
    return paper.BEST, optimum, 100.0 * (optimum - paper.BEST) / abs(optimum)


def _versions(answer: Answer) -> list[tuple[str, str]]:
    """(package, every version that took part)."""
    found: dict[str, set[str]] = {}
    for item in [*answer.runs, *answer.references]:
        for package, version in item.versions.items():
            found.setdefault(package, set()).add(version)
    return [(package, " and ".join(sorted(all_))) for package, all_ in found.items()]


def _unbroken(text: str) -> str:
    """The same with no line break inside an interval."""
    return re.sub(r"\S+ \[[^]]*\]", lambda found: found.group().replace(" ", "\u00a0"), text)


def _plain(text: str) -> str:
    """Brackets that rich does not take for markup."""
    return text.replace("[", r"\[")

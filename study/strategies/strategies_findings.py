"""What the strategies came to, in words: who arrives at the optimum with how many rollouts."""

from __future__ import annotations

import numpy as np

from study.formatting import number, percent, signed
from study.strategies.catalogue import strategy_called
from study.strategies.trial_findings import NEAR, TrialFindings

FEW = 5
"""Seeds below which a mean says little."""


def strategies_sentences(findings: TrialFindings) -> list[tuple[str, str]]:
    """Pairs of question and answer."""
    found = [
        ("How many rollouts does it take?", _arrivals(findings)),
        ("Which strategy beats the point estimate?", _contrasts(findings)),
    ]
    if any(np.isfinite(o.observed).any() for o in findings.outcomes.values()):
        found.append(("What is the best return worth that was seen?", _curse(findings)))
    return found


def _arrivals(findings: TrialFindings) -> str:
    """Who comes within NEAR of the optimum first, on every plant."""
    told = []
    for plant, sensing in findings.plan.places:
        own = {s: findings.arrived(plant.name, sensing, s) for s in findings.plan.strategies}
        there = {s: n for s, n in own.items() if n is not None}
        seeds = max(len(o.seeds) for c, o in findings.outcomes.items() if c[:2] == (plant.name, sensing) and c.n)
        where = f"On the plant with {plant.title}" if plant.effect else "On the paper's plant"
        where += f" ({sensing}, {seeds} seeds)"
        if not there:
            told.append(f"{where} no strategy comes within {percent(NEAR)} of the optimum.")
            continue
        least = min(there.values())
        first = [strategy_called(s).short for s, n in there.items() if n == least]
        told.append(
            f"{where} {_listed(first)} {'comes' if len(first) == 1 else 'come'} within {percent(NEAR)} of "
            f"the optimum with {least} rollout{'s' * (least != 1)}, and {len(there)} of {len(own)} do so within the "
            "budgets that were run."
        )
    return " ".join(told) + _caution(findings)


def _contrasts(findings: TrialFindings) -> str:
    compared = findings.compared
    if not compared:
        return "No contrast was planned between these strategies."
    certain = [c for c in compared if c.certain]
    better = [c for c in certain if c.contrast.mean > 0.0]
    text = (
        f"Of {len(compared)} contrasts that were fixed beforehand, {len(better)} certainly favour the other strategy "
        f"and {len(certain) - len(better)} the point estimate, after Holm's correction over all of them."
    )
    if certain:
        most = max(certain, key=lambda c: abs(c.contrast.mean))
        short = strategy_called(most.a).short
        text += f" The largest: {short} with {most.n} rollouts on {most.plant}, {most.contrast}."
    return text


def _curse(findings: TrialFindings) -> str:
    """Observed returns of the best candidates against what these return when they are evaluated anew. Candidates are
    compared from rest and evaluated from the task's starts, so the two are no one scale; deployed is held against."""
    told = []
    for strategy in findings.plan.strategies:
        own = [o for c, o in findings.outcomes.items() if c.strategy == strategy and np.isfinite(o.best).any()]
        if own:
            gain = float(np.mean(np.concatenate([o.returns - o.best for o in own])))
            told.append(f"{strategy_called(strategy).short}: what it deploys returns {signed(gain)} against its best "
                        f"candidate so far, evaluated anew ({number(np.mean([o.anew for o in own]))})")  # fmt: skip
    return "; ".join(told) + "." + _caution(findings)


def _caution(findings: TrialFindings) -> str:
    seeds = len(findings.plan.seeds)
    return f" With {seeds} seed{'s' * (seeds != 1)} these are no findings yet." if seeds < FEW else ""


def _listed(names: list[str]) -> str:
    return " and ".join(filter(None, (", ".join(names[:-1]), names[-1])))

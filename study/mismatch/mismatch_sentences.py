"""The experiment's answers in words, each with its intervals; nothing here decides anything."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from study.formatting import number, percent
from study.mismatch.mismatch_findings import MismatchFindings, Verdict
from study.mismatch.mismatch_plan import SPLIT
from study.strategies.trial_findings import PlannedContrast
from study.trials.rollout_budget import BAND


@dataclass(frozen=True)
class Change:
    """What is told of the contrasts of strategy a with b.

    text        with {counted}: how many stand, {listed}: each with its interval, {verdict}: whether they are better
    catalogue   at which plants: whether the catalogue has their effect; None: those without one
    verdict     of which diagnoses it is told how many there were, in words and as a condition
    """

    a: str
    b: str
    text: str
    catalogue: tuple[bool | None, ...] = (True, False, None)
    verdict: tuple[str, Callable[[Verdict], bool]] | None = None

    def told(self, findings: MismatchFindings) -> str:
        """The text; empty where the plan has no such contrasts."""
        plants = {plant.name for plant in findings.plan.plants if plant.in_catalogue in self.catalogue}
        rows = [row for row in findings.compared if (row.a, row.b) == (self.a, self.b) and row.plant in plants]
        if not rows:
            return ""
        better, worse = (sum(row.certain and sign * row.contrast.mean > 0.0 for row in rows) for sign in (1, -1))
        counted = f"{better} of {len(rows)} are better and {worse} worse after Holm's correction"
        if len(rows) > 1:
            counted += f", in the mean {findings.together(rows)} (not pre-registered)"
        verdict = "No" if better == 0 else "Yes" if better == len(rows) else "In part"
        listed = by_plant(findings, ((row.plant, row.n, self._cell(findings, row)) for row in rows))
        return self.text.format(counted=counted, listed=listed, verdict=verdict, band=percent(BAND))

    def _cell(self, findings: MismatchFindings, row: PlannedContrast) -> str:
        """A change with its interval, and how many of the seeds had such a verdict."""
        if self.verdict is None:
            return str(row.contrast)
        (words, which), said = self.verdict, findings.verdicts.get((row.plant, row.n), {})
        counted = sum(times for one, times in said.items() if which(one))
        return f"{row.contrast} ({words}: {counted} of {sum(said.values())})"


BREADTH = Change(
    "band", "fitted",
    "{verdict}: with a band of ±{band} around the fitted m and l {counted}. In return: {listed}.",
    catalogue=(True, False),
)  # fmt: skip
NAMING = Change(
    "mended", "fitted", "Against m and l alone: {counted}. In return: {listed}.",
    (True,), ("named and believed", lambda said: bool(said.named) and said.believed),
)  # fmt: skip
UNKNOWN = Change(
    "mended", "fitted",
    "Where the catalogue lacks the effect, a diagnosis that says so trains under random torques of the size that the "
    "log asks for. Against m and l alone: {counted}. In return: {listed}.",
    (False,), ("unknown", lambda said: said.verdict == "unknown"),
)  # fmt: skip
RIVALS = (
    Change("mended", "all_effects", "against all effects fitted at once: {counted}"),
    Change("mended", "network", "against a learned residual torque: {counted}"),
)
WITHOUT_ROLLOUTS = Change(
    "breadth", "prior",
    "Breadth over everything plausible, against the prior: {counted}. In return: {listed}.",
)  # fmt: skip
ORACLE = (
    Change("oracle", "mended", "where the catalogue has the effect, {counted}", (True,)),
    Change("oracle", "mended", "where it lacks it, {counted}", (False,)),
)


def mismatch_sentences(findings: MismatchFindings) -> list[tuple[str, str]]:
    """(question, answer), as far as the plan asked for it."""
    left = _all(findings, "Trained on the hidden plant itself, against the diagnosis: ", ORACLE), _split(findings)
    asked = {
        "Does breadth pay when the simulator lacks an effect?": BREADTH.told(findings),
        "What is it worth to name the effect?": NAMING.told(findings),
        "Does breadth pay after that?": _after_that(findings),
        "What does an honest “unknown” buy?": UNKNOWN.told(findings),
        "What else could the rollouts be spent on?": _all(findings, "The diagnosis ", RIVALS),
        "And without any rollout?": WITHOUT_ROLLOUTS.told(findings),
        "What is left?": " ".join(filter(None, left)),
    }
    return [(question, text) for question, text in asked.items() if text]


def _all(findings: MismatchFindings, begin: str, changes: Sequence[Change]) -> str:
    """Several of them in a sentence."""
    parts = [text for change in changes if (text := change.told(findings))]
    return f"{begin}{'; '.join(parts)}." if parts else ""


def _after_that(findings: MismatchFindings) -> str:
    """The posterior against its centre: breadth after the diagnosis."""
    found = {
        (plant.name, n): contrast
        for plant in findings.plan.plants
        for n in findings.plan.contrasted
        if plant.in_catalogue and (contrast := findings.difference(plant.name, "posterior", "mended", n))
    }
    if not found:
        return ""
    text = by_plant(findings, ((*key, str(contrast)) for key, contrast in found.items()))
    return (
        "Parameters drawn from the fit's covariance, the breadth that the data leave, in place of its numbers. "
        f"In return: {text} ({min(contrast.seeds for contrast in found.values())} seeds, not pre-registered)."
    )


def _split(findings: MismatchFindings) -> str:
    """What is left of the gap at the largest budget, fitted and mended: with agents, and by design on their models."""
    n, parts = max(findings.plan.budgets), []
    for plant in findings.plan.plants:
        both = (findings.splits.get(findings.condition(plant.name, key, n)) for key in SPLIT)
        splits = [split for split in both if split]
        if plant.effect and len(splits) == 2:
            trained = " to ".join(number(-split.gap) for split in splits)
            designed = " to ".join(number(-split.model) for split in splits)
            parts.append(f"{plant.title}: {trained} ({designed})")
    told = f"From the optimum, with {n} rollouts, from fitted to mended (in brackets: dynamic programming, not agents)"
    return f"{told}: {'; '.join(parts)}." if parts else ""


def by_plant(findings: MismatchFindings, parts: Iterable[tuple[str, int, str]]) -> str:
    """(plant, n, text) as "delay 0.155 s: text with 5 rollouts, text with 50; magnet ..."."""
    found: dict[str, list[str]] = {}
    for plant, n, text in parts:
        own = found.setdefault(findings.plan.plant(plant).title, [])
        unit = "" if own else " rollout" if n == 1 else " rollouts"
        own.append(f"{text} with {n}{unit}" if n else text)
    return "; ".join(f"{title}: {', '.join(own)}" for title, own in found.items())

"""The experiment's answers in words, each with its intervals; nothing here decides anything."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

from study.formatting import number, percent
from study.mismatch.findings import Compared, Condition, MismatchFindings, Verdict
from study.mismatch.labels import in_catalogue, is_out_of_catalogue, plant_title
from study.mismatch.naming_results import NamingResult, naming_errors, naming_rates
from study.mismatch.plan import HiddenPlant, StrategyKey

Said = Callable[[Verdict], bool]


def sentences(findings: MismatchFindings, rows: Sequence[NamingResult] = ()) -> list[tuple[str, str]]:
    """(question, answer), as far as the plan asked for it.

    rows: of the naming study, where they are there.
    """
    asked = {
        "Does breadth pay when the simulator lacks an effect?": _breadth(findings),
        "What is it worth to name the effect?": _naming(findings),
        "Does breadth pay after that?": _still(findings),
        "How many rollouts does naming take?": _rollouts(findings, rows),
        "What does an honest “unknown” buy?": _unknown(findings),
        "What else could the rollouts be spent on?": _rivals(findings),
        "And without any rollout?": _blind(findings),
        "What is left?": " ".join(text for text in (_oracle(findings), _split(findings)) if text),
    }
    return [(question, text) for question, text in asked.items() if text]


def _breadth(findings: MismatchFindings) -> str:
    """(b+) - (b) where an effect is missing."""
    rows = _rows(findings, StrategyKey.BAND, StrategyKey.FITTED, lambda plant: plant.effect is not None)
    if not rows:
        return ""
    better = sum(row.certain and row.contrast.mean > 0.0 for row in rows)
    verdict = "No" if better == 0 else "Yes" if better == len(rows) else "In part"
    return (
        f"{verdict}: with a band of ±{percent(findings.plan.band)} around the fitted m and l "
        f"{_counted(findings, rows)}. "
        f"In return: {_listed(findings, rows)}."
    )


def _naming(findings: MismatchFindings) -> str:
    """(c) - (b) where the effect is in the catalogue."""
    rows = _rows(findings, StrategyKey.MENDED, StrategyKey.FITTED, in_catalogue)
    if not rows:
        return ""
    text = _listed(findings, rows, "named and believed", lambda said: bool(said.named) and said.believed)
    return f"Against m and l alone: {_counted(findings, rows)}. In return: {text}."


def _still(findings: MismatchFindings) -> str:
    """(f) - (c): breadth after the diagnosis."""
    found = {
        (plant.name, n): contrast
        for plant in findings.plan.plants
        for n in findings.plan.budgets
        if in_catalogue(plant)
        and (contrast := findings.difference(plant.name, StrategyKey.POSTERIOR, StrategyKey.MENDED, n))
    }
    if not found:
        return ""
    seeds = min(contrast.seeds for contrast in found.values())
    text = _by_plant(findings, ((*key, str(contrast)) for key, contrast in found.items()))
    return (
        "Parameters drawn from the fit's covariance, the breadth that the data leave, in place of its numbers. "
        f"In return: {text} ({seeds} seeds, not pre-registered)."
    )


def _rollouts(findings: MismatchFindings, rows: Sequence[NamingResult]) -> str:
    """How often the naming is right with the fewest rollouts, a middling number and the most; how well m and l are
    known meanwhile."""
    found, parts = naming_rates(rows), list[tuple[str, int, str]]()
    for plant in findings.plan.plants:
        budgets = sorted(n for name, n in found if name == plant.name)
        for n in sorted({budgets[k] for k in (0, len(budgets) // 2, -1)} if budgets else ()):
            fitted, mended = (100.0 * error for error in naming_errors(rows, plant.name, n))
            parts.append((plant.name, n, f"{100.0 * found[plant.name, n].share:.0f} % ({fitted:.2g}, {mended:.2g} %)"))
    told = "Seeds in which the answer is right (m and l are off by so much without, and with it)"
    return f"{told}: {_by_plant(findings, parts)}." if parts else ""


def _unknown(findings: MismatchFindings) -> str:
    """(c) - (b) where no effect of the catalogue is right."""
    rows = _rows(findings, StrategyKey.MENDED, StrategyKey.FITTED, is_out_of_catalogue)
    if not rows:
        return ""
    text = _listed(findings, rows, "unknown", lambda said: said.verdict == "unknown")
    return (
        "Where the catalogue lacks the effect, a diagnosis that says so trains under random torques of the size that "
        f"the log asks for. Against m and l alone: {_counted(findings, rows)}. In return: {text}."
    )


def _rivals(findings: MismatchFindings) -> str:
    """(c) - (d) and (c) - (i), at all plants."""
    parts = []
    for rival, name in (
        (StrategyKey.ALL_EFFECTS, "all effects fitted at once"),
        (StrategyKey.NETWORK, "a learned residual torque"),
    ):
        rows = _rows(findings, StrategyKey.MENDED, rival)
        if rows:
            parts.append(f"against {name}: {_counted(findings, rows)}")
    return f"The diagnosis {'; '.join(parts)}." if parts else ""


def _blind(findings: MismatchFindings) -> str:
    """(e) - (z)."""
    rows = _rows(findings, StrategyKey.BREADTH, StrategyKey.PRIOR)
    if not rows:
        return ""
    counted, listed = _counted(findings, rows), _listed(findings, rows)
    return f"Breadth over everything plausible, against the prior: {counted}. In return: {listed}."


def _oracle(findings: MismatchFindings) -> str:
    """(h) - (c), where the catalogue has the effect and where it lacks it."""
    parts = []
    for which, name in (
        (in_catalogue, "where the catalogue has the effect"),
        (is_out_of_catalogue, "where it lacks it"),
    ):
        rows = _rows(findings, StrategyKey.ORACLE, StrategyKey.MENDED, which)
        if rows:
            parts.append(f"{name}, {_counted(findings, rows)}")
    return f"Trained on the hidden plant itself, against the diagnosis: {'; '.join(parts)}." if parts else ""


def _split(findings: MismatchFindings) -> str:
    """What is left of the gap at the largest budget, for b and c: with agents, and with designs on their models."""
    n, parts = max(findings.plan.budgets), []
    for plant in findings.plan.plants:
        fitted, mended = (
            findings.outcomes.get(Condition(plant.name, strategy, n))
            for strategy in (StrategyKey.FITTED, StrategyKey.MENDED)
        )
        if plant.effect and fitted and mended and fitted.split and mended.split:
            trained = f"{number(-fitted.split.gap)} to {number(-mended.split.gap)}"
            designed = f"{number(-fitted.split.model)} to {number(-mended.split.model)}"
            parts.append(f"{plant_title(plant)}: {trained} ({designed})")
    told = f"From the optimum, with {n} rollouts, from fitted to mended (in brackets: dynamic programming, not agents)"
    return f"{told}: {'; '.join(parts)}." if parts else ""


def _rows(
    findings: MismatchFindings, a: str, b: str, which: Callable[[HiddenPlant], bool] = lambda plant: True
) -> list[Compared]:
    """The contrasts a - b at such plants."""
    plants = {plant.name for plant in findings.plan.plants if which(plant)}
    return [row for row in findings.compared if (row.a, row.b) == (a, b) and row.plant in plants]


def _counted(findings: MismatchFindings, rows: Sequence[Compared]) -> str:
    """How many of them stand, and what they come to together."""
    better, worse = (sum(row.certain and sign * row.contrast.mean > 0.0 for row in rows) for sign in (1, -1))
    text = f"{better} of {len(rows)} are better and {worse} worse after Holm's correction"
    return text if len(rows) < 2 else f"{text}, in the mean {findings.together(rows)} (not pre-registered)"


def _listed(findings: MismatchFindings, rows: Sequence[Compared], verdict: str = "", which: Said | None = None) -> str:
    """Each change with its interval, and how many of the seeds had such a verdict."""
    parts = []
    for row in rows:
        said = findings.verdicts.get((row.plant, row.n), {})
        counted = sum(times for one, times in said.items() if which and which(one))
        about = f" ({verdict}: {counted} of {sum(said.values())})" if which else ""
        parts.append((row.plant, row.n, f"{row.contrast}{about}"))
    return _by_plant(findings, parts)


def _by_plant(findings: MismatchFindings, parts: Iterable[tuple[str, int, str]]) -> str:
    """(plant, n, text) as "delay 0.155 s: text with 5 rollouts, text with 50; magnet ..."."""
    found: dict[str, list[str]] = {}
    for plant, n, text in parts:
        own = found.setdefault(plant_title(findings.plan.plant(plant)), [])
        unit = "" if own else " rollout" if n == 1 else " rollouts"
        own.append(f"{text} with {n}{unit}" if n else text)
    return "; ".join(f"{title}: {', '.join(own)}" for title, own in found.items())

"""The experiment's answers in sentences, each with its interval; nothing here decides anything."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from study.mismatch.answer import Answer, Compared, Spot, Verdict
from study.mismatch.named import Named, enough, errors
from study.mismatch.titles import in_catalogue, is_outside, plant_title
from study.numerals import number, percent


def sentences(answer: Answer, rows: Sequence[Named] = ()) -> list[str]:
    """Breadth, naming, the honest unknown: one sentence each, as far as the plan asked for it.

    rows: of the naming study, where they are there.
    """
    found = [_breadth(answer), _naming(answer), _still(answer), _rollouts(answer, rows), _unknown(answer)]
    found += [_rivals(answer), _blind(answer), _split(answer)]
    return [sentence for sentence in found if sentence]


def _breadth(answer: Answer) -> str:
    """(b+) - (b) where an effect is missing."""
    rows = _rows(answer, "b+", "b", [p.name for p in answer.plan.plants if p.effect])
    if not rows:
        return ""
    better, worse = _count(rows, +1), _count(rows, -1)
    return (
        "Does breadth pay when the simulator lacks an effect? A band of "
        f"±{percent(answer.plan.band)} around the fitted m and l changed the return by {_listed(answer, rows)}: "
        f"{better} of {len(rows)} are gains and {worse} losses that stand after Holm's correction."
    )


def _naming(answer: Answer) -> str:
    """(c) - (b) where the effect is in the catalogue."""
    rows = _rows(answer, "c", "b", [p.name for p in answer.plan.plants if in_catalogue(p)])
    if not rows:
        return ""
    return (
        f"The diagnosis changed the return against m and l alone by {_listed(answer, rows)}; it named an effect and "
        f"believed it in {_counts(answer, rows, lambda said: bool(said.named) and said.believed)}."
    )


def _still(answer: Answer) -> str:
    """(f) - (c): breadth after the diagnosis."""
    parts = []
    for plant in answer.plan.plants:
        for n in answer.plan.budgets:
            found = answer.difference(plant.name, "f", "c", n) if in_catalogue(plant) else None
            if found:
                parts.append(f"{found} ({plant_title(plant)}, n = {n})")
                seeds = found.seeds
    if not parts:
        return ""
    return (
        "And after the diagnosis? Drawing the parameters from the fit's covariance, which is the breadth that the data "
        f"leave, changed the return by {', '.join(parts)} ({seeds} seeds; not pre-registered)."
    )


def _rollouts(answer: Answer, rows: Sequence[Named]) -> str:
    """How many rollouts naming takes, and what m and l cost meanwhile."""
    if not rows:
        return ""
    parts = []
    for plant in answer.plan.plants:
        budgets = [row.n for row in rows if row.plant == plant.name]
        if not budgets:
            continue
        least = enough(rows, plant.name)
        n = max(budgets) if least is None else least
        when = f"{n} rollouts" if least else f"more than {n}"
        fitted, mended = (100.0 * error for error in errors(rows, plant.name, n))
        parts.append(f"{plant_title(plant)}: {when} (m and l off by {fitted:.2g} % without, {mended:.2g} % with it)")
    return f"The right answer, for nine seeds in ten, takes: {'; '.join(parts)}."


def _unknown(answer: Answer) -> str:
    """(c) - (b) where no effect of the catalogue is right."""
    rows = _rows(answer, "c", "b", [p.name for p in answer.plan.plants if is_outside(p)])
    if not rows:
        return ""
    return (
        "Where the catalogue lacks the effect, a diagnosis that says unknown trains under random torques of the size "
        f"that the log asks for; it did in {_counts(answer, rows, lambda said: said.verdict == 'unknown')}, and over "
        f"all seeds the return changed by {_listed(answer, rows)}."
    )


def _rivals(answer: Answer) -> str:
    """(c) - (d) and (c) - (i)."""
    parts = []
    for rival, name in (("d", "all effects fitted at once"), ("i", "a learned residual torque")):
        rows = _rows(answer, "c", rival, [p.name for p in answer.plan.plants])
        if rows:
            parts.append(f"against {name} {_count(rows, +1)} better and {_count(rows, -1)} worse of {len(rows)}")
    return f"The diagnosis, {', and '.join(parts)}, at all plants, after Holm." if parts else ""


def _blind(answer: Answer) -> str:
    """(e) - (z)."""
    rows = _rows(answer, "e", "z", [p.name for p in answer.plan.plants])
    if not rows:
        return ""
    return f"Without any rollout, breadth over everything plausible changed the return by {_listed(answer, rows)}."


def _split(answer: Answer) -> str:
    """What is left of the gap at the largest budget, for b and c."""
    n, parts = max(answer.plan.budgets), []
    for plant in answer.plan.plants:
        fitted, mended = (answer.outcomes.get(Spot(plant.name, way, n)) for way in ("b", "c"))
        if plant.effect and fitted and mended and fitted.split and mended.split:
            parts.append(f"{plant_title(plant)} {number(-fitted.split.gap)} to {number(-mended.split.gap)}")
    return (
        f"With {n} rollouts the distance to the optimum went, from fitted to mended: {'; '.join(parts)}."
        if parts
        else ""
    )


def _rows(answer: Answer, a: str, b: str, plants: Sequence[str]) -> list[Compared]:
    return [row for row in answer.compared if (row.a, row.b) == (a, b) and row.plant in plants]


def _listed(answer: Answer, rows: Sequence[Compared]) -> str:
    title = {plant.name: plant_title(plant) for plant in answer.plan.plants}
    return ", ".join(f"{row.contrast} ({title[row.plant]}{f', n = {row.n}' if row.n else ''})" for row in rows)


def _counts(answer: Answer, rows: Sequence[Compared], which: Callable[[Verdict], bool]) -> str:
    """How many of the seeds of each row had a verdict of a kind."""
    parts = []
    for row in rows:
        found = answer.verdicts.get((row.plant, row.n), {})
        count = sum(times for said, times in found.items() if which(said))
        parts.append(f"{count} of {sum(found.values())}")
    return ", ".join(parts)


def _count(rows: Sequence[Compared], sign: int) -> int:
    return sum(row.certain and sign * row.contrast.mean > 0.0 for row in rows)

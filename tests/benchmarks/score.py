"""What counts as right, and the table."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from tests.benchmarks.cases import COLUMNS, Case
from tests.benchmarks.command import markdown
from tests.benchmarks.decidability import ENOUGH, TWINS
from tests.benchmarks.hidden import STRANGERS
from tests.benchmarks.methods import Answer

WEAK = (16.0, 30.0)
SAME_AS = {"asymmetric_coulomb": {"coulomb", "torque_bias"}}
"""Effects that together are the same to a machine that moves: two frictions, or one and an offset."""


@dataclass(frozen=True)
class Cell:
    """right of total, and which were not."""

    right: int
    total: int
    wrong: tuple[str, ...] = ()

    def __str__(self) -> str:
        return f"{100.0 * self.right / self.total:.0f} % ({self.right}/{self.total})" if self.total else "-"


def indistinguishable(effect: str) -> frozenset[str]:
    """The effect and those that are the same to every log of this kind."""
    return frozenset({effect}) | TWINS.get(effect, frozenset())


def first_right(case: Case, answer: Answer) -> bool:
    """The first-ranked effect is the hidden one, or its twin, or one of those that together are the same."""
    hidden = case.hidden[0]
    return bool(answer.ranking) and answer.ranking[0] in indistinguishable(hidden) | SAME_AS.get(hidden, set())


def all_named(case: Case, answer: Answer) -> bool:
    """Every hidden effect is named, each in a group of its own."""
    named = {effect for group in answer.named for effect in group}
    return all(indistinguishable(name) & named or SAME_AS.get(name, {name}) <= named for name in case.hidden)


def exact(case: Case, answer: Answer) -> bool:
    """All that is hidden is named, and nothing else."""
    named = {effect for group in answer.named for effect in group}
    expected = sum(1 if indistinguishable(name) & named else len(SAME_AS.get(name, {name})) for name in case.hidden)
    return all_named(case, answer) and len(answer.named) == expected


def noticed(case: Case, answer: Answer) -> bool:
    """The hidden effect is named, or listed as too small to matter."""
    return all_named(case, answer) or bool(indistinguishable(case.hidden[0]) & set(answer.small))


def silent(answer: Answer) -> bool:
    """Nothing is said to be missing from the machine."""
    return answer.verdict == "adequate" and not answer.named


def stranger_right(case: Case, answer: Answer) -> bool:
    """What is nearly it is named alone; or something unknown is said to remain, whatever of it known effects explain,
    with the right dependence."""
    who = STRANGERS[case.hidden[0]]
    said, named = frozenset(answer.depends_on), {effect for group in answer.named for effect in group}
    if who.near and named == {who.near}:
        return answer.verdict in ("missing", "partly")
    return answer.verdict in ("unknown", "partly") and bool(said & who.needs) and said <= who.allows


def decided(case: Case, prepared: Mapping[str, Any]) -> bool:
    """Whether the log decides: only then is a name right or wrong."""
    if not prepared:
        return True
    least = min(prepared["least"].values())
    return WEAK[0] <= least <= WEAK[1] if case.size == "weak" else bool(least >= ENOUGH)


def right(case: Case, answer: Answer) -> bool:
    """The rule of a case's column."""
    if not case.hidden:
        return silent(answer)
    if case.stranger:
        return stranger_right(case, answer)
    if case.column == "weak":
        return first_right(case, answer) and noticed(case, answer)
    if len(case.hidden) > 1:
        return all_named(case, answer)
    return first_right(case, answer)


# Each says right, wrong, or None where it does not apply.
RULES: Mapping[str, Callable[[Case, Answer], bool | None]] = {
    "right": right,
    "named, and nothing else": lambda case, a: None if not case.hidden or case.stranger else exact(case, a),
    "unknown": lambda case, a: a.verdict in ("unknown", "partly") if case.stranger else None,
    "error <= 1.1": lambda case, a: (
        None if case.stranger or case.column == "told" or a.error_after is None else a.error_after <= 1.1
    ),
}


def cell(
    cases: Sequence[Case], answers: Mapping[str, Answer], prepared: Mapping[str, Mapping[str, Any]], rule: str = "right"
) -> Cell:
    """A method's score on some cases."""
    scored = [c for c in cases if c.key in answers and c.key in prepared and decided(c, prepared[c.key])]
    said = {c.key: RULES[rule](c, answers[c.key]) for c in scored}
    wrong = tuple(key for key, yes in said.items() if yes is False)
    total = sum(yes is not None for yes in said.values())
    return Cell(total - len(wrong), total, wrong)


def columns(cases: Sequence[Case]) -> dict[str, list[Case]]:
    """Cases by column; in those that hold both, logs with nothing hidden stand apart."""
    parts: dict[str, list[Case]] = {name: [] for name in COLUMNS}
    for case in cases:
        parts[case.column].append(case)
    split = {}
    for name, whole in parts.items():
        planted = [c for c in whole if c.hidden]
        split[name] = planted or whole
        split[f"{name}: nothing"] = [c for c in whole if planted and not c.hidden]
    return {name: part for name, part in split.items() if part}


def table(
    cases: Sequence[Case],
    answers: Mapping[str, Mapping[str, Answer]],
    prepared: Mapping[str, Mapping[str, Any]],
    rule: str = "right",
) -> str:
    """The score table in Markdown: a column of cases a row, a method a column."""
    scores = {name: [cell(part, a, prepared, rule) for a in answers.values()] for name, part in columns(cases).items()}
    rows = [(name, *cells) for name, cells in scores.items() if any(c.total for c in cells)]
    return markdown(("cases", *answers), ["---"] * (1 + len(answers)), rows) if rows else ""

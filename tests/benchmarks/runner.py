"""Runs methods on cases, in several processes, and keeps every answer in a file, so that a run can be resumed."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import as_completed
from dataclasses import asdict
from pathlib import Path
from typing import Any

from tests.benchmarks.cases import Case, records, training, world
from tests.benchmarks.command import processes
from tests.benchmarks.decidability import decide, scaled
from tests.benchmarks.experiments import LOGS
from tests.benchmarks.methods import METHODS, Answer, ask

AIM = 22.0
Row = dict[str, Any]
Solve = Callable[[Case, Sequence[str], Row | None], tuple[Row, dict[str, Row]]]


def prepare(case: Case) -> Row:
    """What can be decided of a case: its numbers, and by effect the evidence, the least lambda and the rival of that.

    Empty where nothing of the catalogue is hidden, or three effects at once. A weak effect's numbers are chosen here.
    """
    if not 1 <= len(case.hidden) <= 2 or case.stranger:
        return {}
    made = world(case)
    by_effect = {}
    if case.size == "weak":
        (name,) = case.hidden
        chosen, decidability = scaled(training(made), name, AIM)
        by_effect, numbers = {name: decidability}, dict(chosen.numbers)
    else:
        numbers = dict(made.numbers)
        for name in case.hidden:
            beside = next((n for n in case.hidden if n != name), None)
            by_effect[name] = decide(training(made), name, beside)
    return {
        "numbers": numbers,
        "evidence": {k: d.evidence for k, d in by_effect.items()},
        "least": {k: d.least for k, d in by_effect.items()},
        "rival": {k: d.worst for k, d in by_effect.items()},
    }


def solve(case: Case, methods: Sequence[str], known: Row | None) -> tuple[Row, dict[str, Row]]:
    """What can be decided, and each method's answer to the case's log."""
    prepared = prepare(case) if known is None else known
    log = records(case, world(case, prepared.get("numbers")))
    claimed = LOGS[case.log].claimed
    return prepared, {m: asdict(ask(m, log, claimed)) for m in methods}


class Store:
    """One JSON line a case in a file a method, and one file of what can be decided."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)

    def _path(self, name: str) -> Path:
        return self.folder / f"{name}.jsonl"

    def read(self, name: str) -> dict[str, Row]:
        """Rows by case."""
        if not self._path(name).is_file():
            return {}
        lines = self._path(name).read_text(encoding="utf-8").splitlines()
        rows = (json.loads(line) for line in lines if line.endswith("}"))
        return {row.pop("case"): row for row in rows}

    def append(self, name: str, case: Case, row: Mapping[str, Any]) -> None:
        """Add a row; a later one of the same case counts."""
        with open(self._path(name), "a", encoding="utf-8") as file:
            file.write(json.dumps({"case": case.key, **row}) + "\n")

    def answers(self, method: str) -> dict[str, Answer]:
        """The answers of a method by case."""
        return {key: restored(row) for key, row in self.read(method).items()}


def restored(row: Row) -> Answer:
    """An answer from its row of a file."""
    row = dict(row)
    for name in ("ranking", "alike", "depends_on"):
        row[name] = tuple(row[name])
    row["named"] = tuple(tuple(group) for group in row["named"])
    return Answer(**row)


def run(
    cases: Sequence[Case],
    methods: Sequence[str],
    store: Store,
    workers: int,
    again: bool = False,
    solve: Solve = solve,
) -> Iterator[tuple[Case, int, int]]:
    """Answer what is not in the store yet, or all again; yields each case as it is done, how many are done, and of how
    many."""
    unknown = [m for m in methods if m not in METHODS]
    if unknown:
        raise KeyError(f"unknown method {unknown[0]!r}: expected some of {', '.join(METHODS)}")
    known = store.read("decidability")
    done: dict[str, Row] = {m: {} if again else store.read(m) for m in methods}
    open_cases = [(c, [m for m in methods if c.key not in done[m]]) for c in cases]
    open_cases = [(c, unanswered) for c, unanswered in open_cases if unanswered]
    with processes(workers) as pool:
        jobs = {pool.submit(solve, c, unanswered, known.get(c.key)): c for c, unanswered in open_cases}
        for count, job in enumerate(as_completed(jobs), 1):
            case, (prepared, answers) = jobs[job], job.result()
            if case.key not in known:
                store.append("decidability", case, prepared)
            for method, answer in answers.items():
                store.append(method, case, answer)
            yield case, count, len(jobs)


def add_options(parser: argparse.ArgumentParser, folder: str) -> None:
    """Those of a command whose answers are kept in a folder."""
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path(folder))
    parser.add_argument("--table", action="store_true", help="run nothing, print what is there")


def answered(
    given: argparse.Namespace, cases: Sequence[Case], methods: Sequence[str] = ("ours",), **options: Any
) -> Store:
    """The store in which every case is answered, unless --table asks for what is there; progress goes to the standard
    error."""
    store, began = Store(given.out), time.perf_counter()
    if not given.table:
        for case, done, of in run(cases, methods, store, given.workers, **options):
            print(f"\r{done}/{of}  {time.perf_counter() - began:.0f} s  {case.key:90s}", end="", file=sys.stderr)
        print(file=sys.stderr)
    return store

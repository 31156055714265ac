"""python -m tests.benchmarks.readme_example: how often is the README's first example answered as the README says?

The eight logs of examples/hidden_effect.py are made up anew by each of many seeds, and of one seed every two and more
of them are given alone. Each log goes through its files and the command line; right is an answer that names exactly the
two effects that the example hides. Answers are kept in --out, one JSON line a log; a run that was stopped goes on.
"""

from __future__ import annotations

import io
import json
import time
import zlib
from collections.abc import Iterator, Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import asdict
from itertools import combinations
from pathlib import Path
from tempfile import TemporaryDirectory

from sysid import write_csv
from sysid.__main__ import main as command_line
from tests.benchmarks import command
from tests.benchmarks.cases import Case
from tests.benchmarks.methods import Answer
from tests.benchmarks.runner import Row, add_options, answered
from tests.benchmarks.score import exact

HIDDEN = ("coulomb", "delay")
LOGS = "12345678"


def example(seed: int, logs: str = LOGS) -> Case:
    """The case of some of the example's logs, by their digits."""
    return Case("readme", HIDDEN, "own", "swings", logs, seed)


def subsets(seed: int) -> Iterator[Case]:
    """Every two and more of the logs of a seed, all of them included."""
    for count in range(2, len(LOGS) + 1):
        yield from (example(seed, "".join(logs)) for logs in combinations(LOGS, count))


def solve(case: Case, methods: Sequence[str], known: Row | None) -> tuple[Row, dict[str, Row]]:
    """What the command line answers to the logs of a case, written as the example writes them."""
    from examples.hidden_effect import swings

    began = time.perf_counter()
    with TemporaryDirectory() as folder:
        files = [Path(folder, f"swing{k}.csv") for k in case.log]
        records = swings(case.seed)
        for k, file in zip(case.log, files, strict=True):
            write_csv(records[int(k) - 1], file)
        answer = Path(folder, "answer.json")
        said = io.StringIO()
        with redirect_stdout(said), redirect_stderr(said):
            code = command_line(["diagnose", *map(str, files), "--json", str(answer)])
        row = read(json.loads(answer.read_text())) if code == 0 else Answer("failed", failure=said.getvalue())
    return {}, {m: asdict(row) | {"seconds": time.perf_counter() - began} for m in methods}


def read(diagnosis: Row) -> Answer:
    """The answer in a diagnosis that the command line wrote as JSON."""
    ranking = diagnosis["ranking"]
    return Answer(
        verdict=diagnosis["verdict"],
        ranking=tuple(r["effect"] for r in ranking),
        alike=tuple(ranking[0]["class"]) if ranking else (),
        named=tuple(tuple(s["class"]) for s in diagnosis["steps"]),
        depends_on=tuple((diagnosis["remaining"] or {}).get("depends_on", ())),
        error_after=diagnosis["error"],
        small=tuple(diagnosis["negligible"]),
    )


def report(title: str, cases: Sequence[Case], answers: dict[str, Answer]) -> list[str]:
    """How many are right, and what was answered to the others."""
    asked = [c for c in cases if c.key in answers]
    wrong = [c for c in asked if not right(c, answers[c.key])]
    lines = [f"{title}: exactly {' and '.join(HIDDEN)} in {len(asked) - len(wrong)} of {len(asked)}"]
    for case in wrong:
        a = answers[case.key]
        lines.append(
            f"  seed {case.seed}, logs {case.log}: {a.verdict} {a.named} {a.error_after} {a.small} {a.failure}"
        )
    return lines


def right(case: Case, answer: Answer) -> bool:
    """Both effects are named, nothing else, and nothing is said to remain."""
    return answer.verdict == "missing" and exact(case, answer)


def main(arguments: list[str] | None = None) -> int:
    """Run, then print."""
    parser = command.parser("readme_example", __doc__)
    parser.add_argument("--seeds", type=int, default=100, help="seeds 0 .. SEEDS - 1, all eight logs of each")
    parser.add_argument("--subsets-of", type=int, default=0, metavar="SEED", help="whose logs are given by subsets")
    parser.add_argument("--every", type=int, default=1, help="take a sample, about one subset in so many; 0: none")
    add_options(parser, "results/readme_example")
    given = parser.parse_args(arguments)
    seeds = [example(seed) for seed in range(given.seeds)]
    parts = [c for c in subsets(given.subsets_of) if given.every and zlib.crc32(c.key.encode()) % given.every == 0]
    answers = answered(given, list(dict.fromkeys([*seeds, *parts])), solve=solve).answers("ours")
    lines = report(f"all eight logs of seeds 0 .. {given.seeds - 1}", seeds, answers) if seeds else []
    for count in range(2, len(LOGS) + 1):
        cases = [c for c in parts if len(c.log) == count]
        lines += report(f"{count} of the logs of seed {given.subsets_of}", cases, answers) if cases else []
    print("\n".join(lines))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

"""python -m tests.benchmarks: run methods on columns of hidden-effect cases and print the score table.

Answers are kept in --out, one JSON line a case; a run that was stopped goes on where it was.
"""

from __future__ import annotations

import zlib

from tests.benchmarks import command
from tests.benchmarks.cases import COLUMNS
from tests.benchmarks.methods import METHODS
from tests.benchmarks.runner import add_options, answered
from tests.benchmarks.score import RULES, cell, columns, table


def main(arguments: list[str] | None = None) -> int:
    """Run, then print the tables."""
    parser = command.parser("", __doc__)
    parser.add_argument("--columns", nargs="+", choices=tuple(COLUMNS), default=list(COLUMNS), metavar="COLUMN")
    parser.add_argument("--methods", nargs="+", choices=tuple(METHODS), default=list(METHODS), metavar="METHOD")
    parser.add_argument("--seeds", nargs="+", type=int, default=[0], help="each makes up all cases anew")
    parser.add_argument("--every", type=int, default=1, help="take a sample, about one case in so many")
    parser.add_argument("--only", default="", metavar="TEXT", help="only cases whose key contains TEXT")
    parser.add_argument(
        "--again", action="store_true", help="ask again what is answered already (a method has changed)"
    )
    add_options(parser, "results/hidden_effects")
    parser.add_argument("--wrong", action="store_true", help="list the cases that were answered wrongly")
    given = parser.parse_args(arguments)
    cases = [c for name in given.columns for seed in given.seeds for c in COLUMNS[name](seed)]
    cases = [c for c in cases if given.only in c.key and zlib.crc32(c.key.encode()) % given.every == 0]
    store = answered(given, cases, given.methods, again=given.again)
    prepared = store.read("decidability")
    answers = {m: store.answers(m) for m in given.methods}
    tables = {rule: table(cases, answers, prepared, rule) for rule in RULES}
    print("\n".join(f"\n{rule}:\n\n{text}" for rule, text in tables.items() if text))
    if given.wrong:
        for method, by_key in answers.items():
            for name, part in columns(cases).items():
                for key in cell(part, by_key, prepared).wrong:
                    a = by_key[key]
                    first, error = a.ranking[:2], a.error_after
                    print(f"{method} {name} {key}: {a.verdict} {first} {a.named} {a.depends_on} {error} {a.failure}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

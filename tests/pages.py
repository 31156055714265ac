"""The pages of the documentation as programs: their blocks, run in order in a folder of their own, and what they print.

    python -m tests.pages             run all pages but for slow blocks, and say where they are wrong
    python -m tests.pages --write     and put what was printed where a page shows something else

A fenced block of `sh` or `python` is run; a block of `text` right after it is what it prints. In it a line `...` stands
for any lines, and numbers may differ by a tenth. A comment before a block says what else it is:

    <!-- file: log.toml -->           it is written to that file
    <!-- slow: two minutes -->        it is run only where slow blocks are asked for
    <!-- not run: needs a network --> it never is
    <!-- fails -->                    its command answers with an error, as the page says
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGES = (
    ROOT / "README.md",
    *(page for part in ("tutorials", "howto", "explanation") for page in sorted((ROOT / "docs" / part).glob("*.md"))),
)
RUN = ("sh", "python")
FENCE = re.compile(r"(?P<mark>(?:^<!--.*?-->\n)*)^```(?P<kind>\w*)\n(?P<text>.*?)^```$", re.M | re.S)
MARK = re.compile(r"<!-- *(?P<name>file|slow|not run|fails)(?:: *(?P<value>.*?))? *-->")
NUMBER = re.compile(r"[-+\u2212]?\d[\d,]*(?:\.\d+)?(?:e[-+]?\d+)?")
LONGEST = 1800.0
"""Seconds that a block may take."""
SAME = 0.1
"""Share by which a printed number may differ: other processors round otherwise."""

WORKER = """
import contextlib, io, json, sys, traceback
names = {"__name__": "__main__"}
for line in sys.stdin:
    told, out = json.loads(line), io.StringIO()
    import os
    os.chdir(told["folder"])
    failed = False
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(out):
        try:
            exec(compile(told["text"], "the page", "exec"), names)
        except BaseException:
            failed = True
            traceback.print_exc()
    print(json.dumps({"out": out.getvalue(), "failed": failed}), file=sys.__stdout__, flush=True)
"""


@dataclass(frozen=True)
class Block:
    """A fenced block of a page: its language, text, line number, marks, and where its text lies in the page."""

    kind: str
    text: str
    line: int
    marks: dict[str, str]
    begin: int
    end: int
    shows: Block | None = None


@dataclass(frozen=True)
class Wrong:
    """A block that fails, or prints something else than the page shows."""

    block: Block
    printed: str
    what: str


def blocks(page: str) -> list[Block]:
    """The blocks of a page, each that is run with the output that follows it."""
    parsed: list[Block] = []
    ends: list[int] = []
    for match in FENCE.finditer(page):
        marks = {m["name"]: m["value"] or "" for m in MARK.finditer(match["mark"])}
        line = page.count("\n", 0, match.start("text"))
        block = Block(match["kind"], match["text"], line, marks, match.start("text"), match.end("text"))
        follows = parsed and parsed[-1].kind in RUN and not page[ends[-1] : match.start()].strip()
        if block.kind == "text" and follows and not marks:
            parsed[-1] = Block(**{**vars(parsed[-1]), "shows": block})
        else:
            parsed.append(block)
        ends.append(match.end())
    return parsed


def wrong(page: str, folder: Path, slow: bool = False) -> Iterator[Wrong]:
    """Run a page in a folder; yields its blocks that are wrong."""
    for name in ("examples", "study"):
        (folder / name).symlink_to(ROOT / name)
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
    environment = os.environ | {
        "PATH": path,
        "PYTHONPATH": os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])]),
        "OMP_NUM_THREADS": "1",
        "MPLBACKEND": "agg",
        "NO_COLOR": "1",
        "COLUMNS": "80",
    }
    here = folder
    worker = subprocess.Popen(
        [sys.executable, "-c", WORKER], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment
    )
    assert worker.stdin and worker.stdout
    try:
        for block in blocks(page):
            if "not run" in block.marks or ("slow" in block.marks and not slow):
                continue
            if "file" in block.marks:
                (here / block.marks["file"]).write_text(block.text, encoding="utf-8")
            elif block.kind == "sh":
                where = folder / ".where"
                script = f"set -eu\n{block.text}\npwd > {where}\n"
                done = subprocess.run(
                    ["bash", "-c", script],
                    stdout=subprocess.PIPE,
                    stderr=subprocess.STDOUT,
                    text=True,
                    cwd=here,
                    env=environment,
                    timeout=LONGEST,
                    check=False,
                )
                if done.returncode == 0:
                    here = Path(where.read_text(encoding="utf-8").strip())
                yield from judged(block, done.stdout, done.returncode != 0)
            elif block.kind == "python":
                late = threading.Timer(LONGEST, worker.kill)
                late.start()
                worker.stdin.write(json.dumps({"folder": str(here), "text": block.text}) + "\n")
                worker.stdin.flush()
                answer = worker.stdout.readline()
                late.cancel()
                if not answer:
                    yield Wrong(block, "", f"the interpreter ended, or it took more than {LONGEST:g} s")
                    return
                result = json.loads(answer)
                yield from judged(block, result["out"], result["failed"])
    finally:
        with contextlib.suppress(BrokenPipeError):
            worker.stdin.close()
        worker.wait(60)


def judged(block: Block, printed: str, failed: bool) -> Iterator[Wrong]:
    """What is wrong with a block that printed this."""
    if failed != ("fails" in block.marks):
        yield Wrong(block, printed, "it failed" if failed else "it was expected to fail")
    elif block.shows is not None and not agrees(block.shows.text, printed):
        yield Wrong(block, printed, "it printed something else")


def agrees(shown: str, printed: str) -> bool:
    """Whether a page shows what was printed: the same words, about the same numbers; `...` stands for any lines."""
    wanted = [_words(line) for line in shown.strip().splitlines()]
    actual = [_words(line) for line in printed.strip().splitlines()]
    groups: list[list[str]] = [[]]
    for line in wanted:
        if line == "...":
            groups.append([])
        else:
            groups[-1].append(line)
    if len(groups) == 1:
        return _same(wanted, actual)
    first, *middle, last = groups
    if len(actual) < sum(map(len, groups)) or not _same(first, actual[: len(first)]):
        return False
    if last and not _same(last, actual[-len(last) :]):
        return False
    at, end = len(first), len(actual) - len(last)
    for group in middle:
        places = (i for i in range(at, end - len(group) + 1) if _same(group, actual[i : i + len(group)]))
        place = next(places, None)
        if place is None:
            return False
        at = place + len(group)
    return True


def _words(line: str) -> str:
    return " ".join(line.split())


def _same(wanted: list[str], actual: list[str]) -> bool:
    return len(wanted) == len(actual) and all(map(_same_line, wanted, actual))


def _same_line(wanted: str, actual: str) -> bool:
    if NUMBER.sub("#", wanted) != NUMBER.sub("#", actual):
        return False
    return all(map(_near, NUMBER.findall(wanted), NUMBER.findall(actual)))


def _near(a: str, b: str) -> bool:
    x, y = (float(n.replace(",", "").replace("\u2212", "-")) for n in (a, b))
    _, point, decimals = a.partition(".")
    last = 10.0 ** -len(decimals) if point and "e" not in a else 0.0  # two roundings apart
    return abs(x - y) <= max(SAME * max(abs(x), abs(y)), 2.0 * last) or max(abs(x), abs(y)) < 1e-6


def main(arguments: list[str]) -> int:
    """Run the pages; returns 1 where one is wrong."""
    names = [Path(a).resolve() for a in arguments if not a.startswith("-")]
    failures = 0
    for path in names or PAGES:
        page = path.read_text(encoding="utf-8")
        with tempfile.TemporaryDirectory() as folder:
            mistakes = list(wrong(page, Path(folder), "--slow" in arguments))
        for mistake in reversed(mistakes):
            block = mistake.block
            print(f"{path.relative_to(ROOT)}:{block.line}: {mistake.what}:\n{mistake.printed}")
            if "--write" in arguments and block.shows is not None and "\n...\n" not in f"\n{block.shows.text}":
                page = page[: block.shows.begin] + mistake.printed.strip("\n") + "\n" + page[block.shows.end :]
        if "--write" in arguments:
            path.write_text(page, encoding="utf-8")
        failures += len(mistakes)
    return int(failures > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

"""The documentation is true: its blocks run and print what the pages show (that it builds, `make docs` tests)."""

import inspect
import re

import pytest

import policies
import sysid
from sysid.physics.effects.catalogue import ACTUATORS
from tests.pages import PAGES, ROOT, agrees, blocks, wrong

DOCS = ROOT / "docs"
SLOW = [p for p in PAGES if any("slow" in b.marks for b in blocks(p.read_text(encoding="utf-8")))]


def named(path):
    return str(path.relative_to(ROOT))


def slug(heading):
    return re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")


def said(mistakes):
    return "\n\n".join(f"line {w.block.line}: {w.what}:\n{w.block.text}\n--- printed:\n{w.printed}" for w in mistakes)


@pytest.mark.long
@pytest.mark.parametrize("path", PAGES, ids=named)
def test_blocks_run_and_print_what_the_page_shows(path, tmp_path):
    mistakes = list(wrong(path.read_text(encoding="utf-8"), tmp_path))
    assert not mistakes, said(mistakes)


@pytest.mark.slow
@pytest.mark.parametrize("path", SLOW, ids=named)
def test_slow_blocks_too(path, tmp_path, request):
    if "slow" not in request.config.option.markexpr:
        pytest.skip("this page has blocks that take minutes: python -m pytest tests/test_docs.py -m slow")
    mistakes = list(wrong(path.read_text(encoding="utf-8"), tmp_path, slow=True))
    assert not mistakes, said(mistakes)


def test_the_tutorial_shows_the_answer_that_the_readme_asks_for():
    """It asks the same of the same log, in a slow block."""
    answers = []
    for page in (ROOT / "README.md", DOCS / "tutorials" / "log_to_model.md"):
        (shown,) = (b.shows.text for b in blocks(page.read_text(encoding="utf-8")) if "sysid diagnose" in b.text)
        answers.append([line for line in shown.splitlines() if line.startswith(("missing", "  "))])
    readme, tutorial = answers
    assert len(readme) > 4 and readme == tutorial[: len(readme)]


PAGE = """
```sh
mkdir here && cd here
```

<!-- file: numbers.txt -->
```text
1 2 3
```

```python
total = sum(map(int, open("numbers.txt").read().split()))
print("the sum is", total)
```
```text
the sum is 6
```

```sh
cat numbers.txt
```
"""


def test_a_page_that_is_right_is_not_wrong(tmp_path):
    assert not list(wrong(PAGE, tmp_path))


@pytest.mark.parametrize(
    ("before", "after", "what"),
    [
        ("the sum is 6", "the sum is 8", "it printed something else"),
        ("the sum is 6", "the total is 6", "it printed something else"),
        ("cat numbers.txt", "cat absent.txt", "it failed"),
        ('print("the sum', 'absent("the sum', "it failed"),
    ],
)
def test_a_page_that_is_wrong_is_found(tmp_path, before, after, what):
    assert [w.what for w in wrong(PAGE.replace(before, after, 1 if what == "it failed" else -1), tmp_path)] == [what]


def test_what_agrees():
    assert agrees("m = 1.04 kg\n", "m  = 1.041 kg")
    assert not agrees("m = 1.04 kg", "m = 1.4 kg")
    assert agrees("a\n...\nc", "a\nb 1\nb 2\nc")
    assert not agrees("a\n...\nc", "a\nb")
    assert agrees("p = 7e-250", "p = 2e-249")
    assert not agrees("nothing", "")


def test_every_public_name_is_in_the_reference_once():
    pages = ("sysid.md", "effects.md", "policies.md")
    text = "".join((DOCS / "reference" / page).read_text(encoding="utf-8") for page in pages)
    for package, others in ((sysid, ["ops"]), (policies, [])):
        documented = re.findall(rf"^\.\. (?:autoclass|autofunction|data):: {package.__name__}\.(\w+)$", text, re.M)
        assert sorted([*documented, *others]) == sorted(package.__all__)


def explained(package):
    """The classes and functions of a package, but for effects, whose parameters are declared by their classes."""
    effects = {*sysid.CATALOGUE.values(), *ACTUATORS.values()}
    members = {f"{package.__name__}.{name}": getattr(package, name) for name in package.__all__}
    return {n: o for n, o in members.items() if (inspect.isclass(o) or inspect.isfunction(o)) and o not in effects}


EXPLAINED = explained(policies) | explained(sysid)


@pytest.mark.parametrize("name", EXPLAINED)
def test_every_public_name_has_a_section_of_numpydoc(name):
    rule = r"^(Parameters|Attributes|Returns|Raises|Notes|Methods)\n-{3,}$"
    text = inspect.cleandoc(EXPLAINED[name].__doc__ or "")
    assert re.search(rule, text, re.M), f"{name} has no section: expected one, such as Parameters"


@pytest.mark.parametrize("path", [*PAGES, *sorted(DOCS.rglob("*.md"))], ids=named)
def test_links_within_the_repository_lead_somewhere(path):
    text = re.sub(r"^```.*?^```$", "", path.read_text(encoding="utf-8"), flags=re.M | re.S)
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if "://" not in target and not target.startswith("#"):
            file, _, anchor = target.partition("#")
            there = (path.parent / file).resolve()
            assert there.exists(), f"{target}: no such file"
            if anchor and there.suffix == ".md":
                headings = re.findall(r"^#+ (.*)$", there.read_text(encoding="utf-8"), re.M)
                assert anchor in map(slug, headings), f"{target}: no such heading"


def test_counts_of_real_logs_are_those_of_the_rows():
    page, evidence = ((DOCS / "explanation" / f).read_text(encoding="utf-8") for f in ("real_logs.md", "evidence.md"))
    head, *parts = re.split(r"^## (.+)\n", page, flags=re.M)
    verdicts = ("yes", "mostly", "unknown", "no")
    rows = []
    for kind, part in zip(parts[::2], parts[1::2], strict=True):
        for line in re.findall(r"^\| (?!log \|)(.*) \|$", part, re.M):
            log, _, _, verdict, _ = line.split(" | ")
            first, _, last = verdict.partition(" → ")
            assert {first, last or first} <= set(verdicts), line
            rows.append((kind, "*judged*" in log, first, last or first))
    read_first = [(kind, first) for kind, _, first, _ in rows]
    judged = [(kind, first) for kind, marked, first, _ in rows if marked]
    answered_last = [(kind, last) for kind, *_, last in rows]
    tables = {"all rows": read_first, "rows marked *judged*": judged, "all rows, as answered last": answered_last}
    for title, some in tables.items():
        table = [f"| {title} | rows | {' | '.join(verdicts)} |", "|---|---:|---:|---:|---:|---:|"]
        for kind in (*dict.fromkeys(r[0] for r in rows), "all"):
            of_kind = [v for k, v in some if kind in (k, "all")]
            counts = " | ".join(map(str, (len(of_kind), *map(of_kind.count, verdicts))))
            table.append(f"| {kind if kind == 'all' else f'[{kind}](#{slug(kind)})'} | {counts} |")
        assert "\n".join(table) in head
        assert f"| {title} | {counts} |" in evidence
    readme = (DOCS.parent / "README.md").read_text(encoding="utf-8")
    right, nearly, silent, wrong = map([v for _, v in read_first].count, verdicts)
    counted = (
        f"in {right} of them, and but for a small thing in {nearly}; it was `unknown` in {silent}, and a number or"
    )
    assert f"Before {len(rows)} other public logs" in readme and f"{counted} an effect was wrong in {wrong}." in readme
    right, nearly, _, wrong = map([v for _, v in answered_last].count, verdicts)
    assert f"Of the last answers {right} and {nearly} are so, and {wrong} are wrong." in readme


def test_readme_is_short():
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 150

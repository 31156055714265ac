"""The project's docstrings as reStructuredText.

They are written to be read as they stand: an equation is an indented block, a table of fields is lines whose second
column is aligned, |x| is a magnitude. What follows a heading such as Parameters is numpydoc's. An effect says
what it is; its equation and its parameters are declared by its class, and are put in here.
"""

from __future__ import annotations

import math
import re
from typing import Any

ROW = re.compile(r"(?P<names>\S+(?:, \S+)*(?: \([^)]*\))?(?: or None)?)\s{2,}(?P<text>\S.*)")
RULE = re.compile(r"-{3,}$")


def restructured(lines: list[str]) -> list[str]:
    """The lines of a docstring as reStructuredText, up to the first section of numpydoc's."""
    end = next((i - 1 for i, line in enumerate(lines) if i and RULE.match(line.strip())), len(lines))
    found: list[str] = []
    block: list[str] = []
    for line in [*lines[:end], ""]:
        if line.strip():
            block.append(line.rstrip())
            continue
        found += _blocks(block) if block else []
        block = []
    return [*found, *(_numpydoc(line) for line in lines[end:])]


def _blocks(block: list[str]) -> list[str]:
    """One run of lines without a blank one: prose, an equation, or a table of fields, or several in a row."""
    if _indent(block[0]) >= 4:
        return [".. code-block:: text", "", *("    " + line for line in block), ""]
    if ROW.fullmatch(block[0]) and not block[0].endswith("::"):
        return _table(block)
    for i, line in enumerate(block):
        if i and _indent(line) == 4 and all(_indent(rest) >= 4 for rest in block[i:]):
            return [*_prose(block[:i]), *_blocks(block[i:])]
        if i and ROW.fullmatch(line) and block[i - 1].endswith(":"):
            return [*_prose(block[:i]), *_table(block[i:])]
    return _prose(block)


def _prose(block: list[str]) -> list[str]:
    return [*(escaped(line.strip()) for line in block), ""]


def _table(block: list[str]) -> list[str]:
    """A definition list: names, and beneath them what they mean."""
    found: list[str] = []
    for line in block:
        row = ROW.fullmatch(line)
        if row and _indent(line) == 0:
            found += [escaped(row["names"]), "    " + escaped(re.sub(r"\s{2,}", " ", row["text"]))]
        else:
            found.append("    " + escaped(line.strip()))
    return [*found, ""]


def _numpydoc(line: str) -> str:
    """A line of numpydoc's sections: names keep their stars, text is escaped."""
    if RULE.match(line.strip()) or _indent(line) == 0:
        return line
    return " " * _indent(line) + escaped(line.strip())


def _indent(line: str) -> int:
    return len(line) - len(line.lstrip())


def escaped(text: str) -> str:
    """Text whose stars, bars and trailing underscores are what they are; `code` stays code."""
    parts = re.split(r"(`[^`]*`)", text)
    plain = [re.sub(r"([*|])|(?<=\w)(_)(?!\w)", lambda m: "\\" + m[0], part) for part in parts[::2]]
    return "".join(a + b for a, b in zip(plain, [*parts[1::2], ""], strict=True))


def declared(effect: Any) -> tuple[list[str], list[str]]:
    """The equation of an effect's class, and numpydoc's section of its parameters."""
    section = ["", "Parameters", "----------"]
    for p in effect().parameters.values():
        section += [f"{p.name} : float, default {p.value:g}", f"    {_about(p)}"]
    return [".. code-block:: text", "", f"    {effect.formula}", ""], section


def _about(p: Any) -> str:
    """The unit of a parameter, its bounds and its neutral value."""
    low, high = p.bounds
    within = f"from {low:g} to {high:g}" if math.isfinite(high - low) else f"at least {low:g}" * math.isfinite(low)
    unit = "" if p.unit == "1" else f"[{p.unit}]"
    neutral = "" if p.neutral is None else f"at {p.neutral:g} the effect does nothing"
    text = "; ".join(filter(None, (" ".join(filter(None, (unit, within))), neutral)))
    return f"{text[:1].upper()}{text[1:]}."


def _process(app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    lines[:] = restructured(lines)
    if what == "class" and getattr(obj, "formula", ""):
        equation, parameters = declared(obj)
        lines[:] = [*lines[: lines.index("") + 1], *equation, *lines[lines.index("") + 1 :], *parameters]


def setup(app: Any) -> dict[str, bool]:
    """Before numpydoc, which handles what follows a heading."""
    app.connect("autodoc-process-docstring", _process, priority=100)
    return {"parallel_read_safe": True, "parallel_write_safe": True}

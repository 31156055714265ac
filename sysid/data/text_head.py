"""The head of a text file: the row that names its columns, where its numbers begin, and what parts its cells.

The first lines of a log are mostly rows of numbers, and these tell how many cells a row has, and which hold numbers.
Above the first of them stands the row of names, perhaps as a comment, perhaps with a row of units below it, and with
lines about the log above it.
"""

from __future__ import annotations

import csv
import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

SAMPLE = 200
"""Lines from which the head is told."""
DELIMITERS = (";", "\t", ",")
EMPTY_CELLS = frozenset({"", "nan", "na", "n/a", "none", "null", "-", "--"})
DECIMAL_COMMA = re.compile(r"(?<=\d),(?=\d)")


class Head(NamedTuple):
    """The names of the columns, or 1, 2, ... without any; what parts the cells; and how many lines stand above the
    numbers."""

    names: tuple[str, ...]
    delimiter: str
    above: int


def head(lines: Sequence[str]) -> Head | None:
    """The head of a file that begins with these lines; None if they hold nothing."""
    whole = (line.strip(" \r\n").lstrip("#").strip(" ") for line in lines)  # a tab is an empty cell's end
    texts = {k: text for k, text in enumerate(whole) if text.strip()}
    rows = {k: text for k, text in texts.items() if not lines[k].lstrip().startswith("#")}
    if not texts:
        return None
    forms = Counter((d, len(cells(row, d))) for row in rows.values() for d in (_delimiter(row),) if _has_number(row, d))
    if not forms:
        first = min(rows or texts)
        delimiter = _delimiter(texts[first])
        return Head(_stripped(_split(texts[first], delimiter)), delimiter, first + 1)
    (delimiter, width), _ = forms.most_common(1)[0]
    first, filled = _first_numbers(rows, delimiter, width)
    above = {k: _stripped(_split(texts[k], delimiter)) for k in reversed(texts) if k < first}
    # the words of a sentence may be nearly as many by chance
    counts = [(width, width)] if delimiter == " " else [(filled, math.inf), (width // 2 + 1, math.inf)]
    naming = next(filter(None, (_naming(above, *count) for count in counts)), {})
    chosen = [k for k in naming if k in rows][-1:] or list(naming)[:1]
    names = naming[chosen[0]] if chosen else tuple(str(i + 1) for i in range(width))
    return Head(names, delimiter, first)


def _first_numbers(rows: Mapping[int, str], delimiter: str, width: int) -> tuple[int, int]:
    """The first row of a `width` that holds numbers wherever most rows do, and how many cells go up to the last of
    these."""
    alike = {k: row for k, row in rows.items() if len(cells(row, delimiter)) == width and _has_number(row, delimiter)}
    known = {k: [_is_number(cell) or is_empty(cell) for cell in cells(row, delimiter)] for k, row in alike.items()}
    numeric = np.flatnonzero(np.mean(list(known.values()), axis=0) > 0.5).tolist()
    first = next((k for k, row in known.items() if all(row[i] for i in numeric)), min(alike))
    return first, max(numeric, default=width - 1) + 1


def cells(line: str, delimiter: str) -> list[str]:
    """The cells of a line, with decimal points in place of decimal commas."""
    return _split(line if delimiter == "," else DECIMAL_COMMA.sub(".", line), delimiter)


def is_empty(cell: str) -> bool:
    """Whether a cell says that there is no number."""
    return cell.strip().lower() in EMPTY_CELLS


def _split(line: str, delimiter: str) -> list[str]:
    return line.split() if delimiter == " " else next(csv.reader([line], delimiter=delimiter), [])


def _stripped(names: Sequence[str]) -> tuple[str, ...]:
    return tuple(name.strip() for name in names)


def _delimiter(text: str) -> str:
    """What parts a row's cells; in a row of numbers with decimal commas, commas do not."""
    for delimiter in (";", "\t", " "):
        parts = cells(text, delimiter) if delimiter in text else []
        if len(parts) > 1 and all(_is_number(cell) or is_empty(cell) for cell in parts):
            return delimiter
    likely = max(DELIMITERS, key=text.count)
    return likely if likely in text else " "


def _has_number(text: str, delimiter: str) -> bool:
    return any(_is_number(cell) and not is_empty(cell) for cell in cells(text, delimiter))


def _naming(above: Mapping[int, tuple[str, ...]], fewest: int, most: float) -> dict[int, tuple[str, ...]]:
    """Those of the rows above the numbers that may name columns, as far as no other row stands between.

    They have `fewest` to `most` cells and hold no numbers; only the nearest may have numbers beside other names.
    """
    naming: dict[int, tuple[str, ...]] = {}
    for k, names in above.items():
        numbers = [_is_number(name) for name in names if name]
        if not fewest <= len(names) <= most or all(numbers) or (naming and any(numbers)):
            break
        naming[k] = names
    return naming


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True

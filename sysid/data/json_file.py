"""JSON: entries of a file, checked one by one, and answers as plain data.

An entry that is missing or of another type becomes an InvalidInput in one sentence.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from sysid.data.files import read_file
from sysid.errors import InvalidInput, excerpt

Kind = TypeVar("Kind")
LONGEST_TEXT = 1000
"""Characters, at most, of a name or a sentence in a file."""
LARGEST_NUMBER = 1e150
"""Finite numbers in a file may be no larger, so that their squares are still numbers."""


def read_json(path: Path, expected: str) -> Any:
    """The content of a JSON file that should be what `expected` says; raises InvalidInput where it cannot be read."""
    try:
        return json.loads(read_file(path, expected))
    except InvalidInput:
        raise
    except (ValueError, RecursionError):
        raise InvalidInput(f"{path.name} is not JSON: expected {expected}") from None


def entry(saved: Any, name: str) -> Any:
    """The entry of that name; like the functions below it raises InvalidInput if there is none."""
    if not isinstance(saved, Mapping) or name not in saved:
        raise InvalidInput(f"it has no {name!r}")
    return saved[name]


def _of(kind: type[Kind], saved: Any, name: str, expected: str) -> Kind:
    value = entry(saved, name)
    if not isinstance(value, kind):
        raise InvalidInput(f"{name!r} is {excerpt(value)}: expected {expected}")
    return value


def mapping(saved: Any, name: str) -> dict[str, Any]:
    """An object."""
    return _of(dict, saved, name, "an object")


def sequence(saved: Any, name: str) -> list[Any]:
    """A list."""
    return _of(list, saved, name, "a list")


def text(saved: Any, name: str) -> str:
    """A text of at most 1000 characters."""
    value = _of(str, saved, name, "a text")
    if len(value) > LONGEST_TEXT:
        raise InvalidInput(f"{name!r} has {len(value):,} characters: expected at most {LONGEST_TEXT:,}")
    return value


def number_in(saved: Any, name: str, null: float | None = None) -> float:
    """A number, or infinity; `null` is what null stands for (None: it must be a number)."""
    value = entry(saved, name)
    if value is None and null is not None:
        return null
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InvalidInput(f"{name!r} is {excerpt(value)}: expected a number")
    if not (abs(value) <= LARGEST_NUMBER or abs(value) == math.inf):
        raise InvalidInput(f"{name!r} is {excerpt(value)}: expected a number of at most {LARGEST_NUMBER:g}")
    return float(value)


def count(saved: Any, name: str) -> int:
    """A whole number that is not negative."""
    value = number_in(saved, name)
    if not 0.0 <= value < math.inf or value != int(value):
        raise InvalidInput(f"{name!r} is {value!r}: expected a whole number")
    return int(value)


def plain_fields(answer: Any, *names: str) -> dict[str, Any]:
    """What an answer says under these of its names, as plain data."""
    return {name: plain(getattr(answer, name)) for name in names}


def plain(value: Any) -> Any:
    """A value as plain JSON data: arrays and tuples as lists, dataclasses as objects (by their `to_dict` if they have
    one), numbers that are not finite as null."""
    if hasattr(value, "to_dict"):
        value = value.to_dict()
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, tuple) and hasattr(value, "_asdict"):
        value = value._asdict()
    if is_dataclass(value):
        value = {f.name: getattr(value, f.name) for f in fields(value)}
    if isinstance(value, Mapping):
        return {name: plain(item) for name, item in value.items()}
    if isinstance(value, tuple | list):
        return [plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value

"""The one exception that means "the input is wrong, and here is what to do", how foreign text is shown in it, and the
checks that raise it wherever something else was given than expected."""

from __future__ import annotations

import unicodedata
from collections.abc import Iterable
from numbers import Real
from types import UnionType
from typing import Any, TypeGuard

LONGEST_SHOWN = 200
"""Characters that are shown of a text out of a file."""
LONGEST_WHOLE = 80
"""Characters, at most, of a value that is shown as it is; of a longer one only the type is named."""


class InvalidInput(ValueError):
    """Input that cannot be used. The message says what came, what was expected and which choices exist.

    Command lines print it as one line and leave with exit code 2. It shows no control characters of what a file held,
    and of a long message the begin and the end.

    Parameters
    ----------
    message : object
        What the exception says; it is converted to text, and every run of white space in it becomes one space.
    """

    def __init__(self, message: object = "") -> None:
        super().__init__(printable(" ".join(str(message).split()), 4 * LONGEST_SHOWN))


def printable(text: str, longest: int = 10 * LONGEST_SHOWN) -> str:
    """The text with escapes in place of what a terminal would obey: control and format characters, half characters.

    Of a longer line its begin and its end are left.
    """
    foreign = {c for c in set(text) - {"\n"} if unicodedata.category(c)[0] == "C"}
    text = text.translate({ord(c): c.encode("unicode_escape").decode() for c in foreign})
    return "\n".join(
        line if len(line) <= longest else f"{line[: 2 * LONGEST_SHOWN]} ... {line[-LONGEST_SHOWN:]}"
        for line in text.split("\n")
    )


def excerpt(value: Any) -> str:
    """A value out of a file as `repr` writes it, cut after 200 characters."""
    text = repr(value[: LONGEST_SHOWN + 1] if isinstance(value, str) else value)
    return text if len(text) <= LONGEST_SHOWN else f"{text[:LONGEST_SHOWN]} ..."


def described(value: object) -> str:
    """A value that a user gave, in a few words: as `repr` writes it or, where that is long, its type."""
    text, kind = excerpt(value), type(value).__name__
    return text if len(text) <= LONGEST_WHOLE and "\n" not in text else f"a{'n' * (kind[0] in 'AEIOUaeiou')} {kind}"


def check_kind(what: str, given: object, kind: type | UnionType, expected: str) -> None:
    """Raise InvalidInput where an argument is not of its kind. what: its name; expected: what to give, in words."""
    if not isinstance(given, kind):
        raise InvalidInput(f"{what} is {described(given)}: expected {expected}")


def items_of(given: Any) -> tuple[Any, ...]:
    """The items of an argument that may also be a single one: a text, and what holds nothing, is one item."""
    return tuple(given) if isinstance(given, Iterable) and not isinstance(given, str) else (given,)


def is_real(value: object) -> TypeGuard[float]:
    """Whether a value is a number, and no text, truth value or None."""
    return isinstance(value, Real) and not isinstance(value, bool)

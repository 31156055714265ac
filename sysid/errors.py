"""The one exception that means "the input is wrong, and here is what to do", and how foreign text is shown."""

from __future__ import annotations

import unicodedata
from typing import Any

LONGEST = 200
"""Characters that are shown of a text out of a file."""


class InvalidInput(ValueError):
    """Input that cannot be used. The message says what came, what was expected and which choices exist.

    Command lines print it as one line and leave with exit code 2. It shows no control characters of what a file held,
    and of a long message the begin and the end.
    """

    def __init__(self, message: object = "") -> None:
        super().__init__(printable(" ".join(str(message).split()), 4 * LONGEST))


def printable(text: str, longest: int = 10 * LONGEST) -> str:
    """The text with escapes in place of what a terminal would obey: control and format characters, half characters.

    Of a longer line its begin and its end are left.
    """
    foreign = {c for c in set(text) - {"\n"} if unicodedata.category(c)[0] == "C"}
    text = text.translate({ord(c): c.encode("unicode_escape").decode() for c in foreign})
    return "\n".join(
        line if len(line) <= longest else f"{line[: 2 * LONGEST]} ... {line[-LONGEST:]}" for line in text.split("\n")
    )


def excerpt(value: Any) -> str:
    """A value out of a file as `repr` writes it, cut after 200 characters."""
    text = repr(value[: LONGEST + 1] if isinstance(value, str) else value)
    return text if len(text) <= LONGEST else f"{text[:LONGEST]} ..."

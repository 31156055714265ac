"""How numbers are set where more than plain text can be shown: in tables and figures."""

from __future__ import annotations

import math
from collections.abc import Sequence

from sysid.estimation import held_out

ARROW, MINUS, TIMES = "\N{RIGHTWARDS ARROW}", "\N{MINUS SIGN}", "\N{MULTIPLICATION SIGN}"
PLUS_MINUS = "\N{PLUS-MINUS SIGN}"
RAISED = str.maketrans("-0123456789", "\u207b\u2070\u00b9\u00b2\u00b3\u2074\u2075\u2076\u2077\u2078\u2079")


def typeset(text: str) -> str:
    """A number with a minus sign and a power of ten."""
    digits, _, power = text.replace("-", MINUS).partition("e")
    return digits + (f"{TIMES}10{str(int(power.replace(MINUS, '-'))).translate(RAISED)}" if power else "")


def typeset_multiple(ratio: float) -> str:
    """A multiple of the noise."""
    return held_out.multiple(ratio).replace("inf", "\N{INFINITY}")


def rounded(value: float, sd: float) -> str:
    """A number to two digits of its sd."""
    if not (math.isfinite(value) and 0.0 < sd < math.inf) or abs(value) > 1e6:
        return typeset(f"{value:.4g}")
    return typeset(f"{value:.{min(max(1 - math.floor(math.log10(sd)), 0), 12)}f}")


def measured(value: float, sd: float) -> str:
    if not math.isfinite(sd):
        return f"{rounded(value, sd)}, not determined"
    return f"{rounded(value, sd)} {PLUS_MINUS} {rounded(sd, sd) if sd > 0.0 else '0'}"


def capital(text: str) -> str:
    """The text with a capital first letter, and the others as they are."""
    return text[:1].upper() + text[1:]


def listed(names: Sequence[str]) -> str:
    """Names, the first twelve of them where they are more."""
    return ", ".join(names[:12]) + (f" and {len(names) - 12} more" if len(names) > 12 else "")

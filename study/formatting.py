"""How numbers are printed: with a minus sign that is one, and never as minus zero; infinity stays.

number(-338.2)                      −338                a return
signed(87.3), signed(-0.002, 3)     +87, −0.002         a change
percent(0.953)                      95 %
bracketed(44.2, 5.1, 73.9)          44 [5, 74]          with its interval; write=signed: +44 [+5, +74]
"""

from __future__ import annotations

from collections.abc import Callable

MINUS = "\N{MINUS SIGN}"
"""What a printed number is negated with."""


def number(value: float, digits: int = 0) -> str:
    """Rounded to so many digits behind the point."""
    return f"{round(value, digits) + 0.0:.{digits}f}".replace("-", MINUS)


def signed(value: float, digits: int = 0) -> str:
    """A change: with its sign, the plus too."""
    return f"{round(value, digits) + 0.0:+.{digits}f}".replace("-", MINUS)


def percent(share: float) -> str:
    """A share of one, in whole percent."""
    return f"{number(100.0 * share)} %"


def bracketed(
    mean: float, low: float, high: float, digits: int = 0, write: Callable[[float, int], str] = number
) -> str:
    """A mean with its interval: `12 [10, 14]`."""
    return f"{write(mean, digits)} {interval(low, high, digits, write)}"


def interval(low: float, high: float, digits: int = 0, write: Callable[[float, int], str] = number) -> str:
    """Both ends of an interval in brackets."""
    return f"[{write(low, digits)}, {write(high, digits)}]"

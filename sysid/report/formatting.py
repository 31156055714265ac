"""How numbers and sentences are set where more than plain text can be shown: in reports and figures."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence

from sysid.estimation import held_out

ARROW, MINUS, TIMES = "\N{RIGHTWARDS ARROW}", "\N{MINUS SIGN}", "\N{MULTIPLICATION SIGN}"
PLUS_MINUS = "\N{PLUS-MINUS SIGN}"
RAISED = str.maketrans("-0123456789", "\u207b\u2070\u00b9\u00b2\u00b3\u2074\u2075\u2076\u2077\u2078\u2079")


def sentence(text: str) -> str:
    """Sentences as print would set them."""
    text = re.sub(r"^(adequate|missing|unknown|cannot tell): ", "", text.strip())
    text = re.sub(r"p = (0|[\d.]+e-\d+)(?=[,;).])", "p < 0.0001", text)
    text = re.sub(r"(?<![\w.])[-+]?\d[\d.]*(e[-+]\d+)?", lambda found: number(found[0]), text.replace("+-", PLUS_MINUS))
    text = re.sub(r"(?<=\d)%", "\N{NO-BREAK SPACE}%", text)
    return re.sub(r"(^|\. )([a-z])(?![a-z]*_)", lambda first: first[1] + first[2].upper(), text)


def number(text: str) -> str:
    """A number, or several, with a minus sign and powers of ten."""
    text = re.sub(r"e([-+])0*(\d+)", lambda e: f"{TIMES}10" + (e[1].strip("+") + e[2]).translate(RAISED), text)
    return re.sub(r"(?<!\w)-(?=\d)", MINUS, text)


def multiple(ratio: float) -> str:
    """A multiple of the noise."""
    return held_out.multiple(ratio).replace("inf", "\N{INFINITY}")


def chance(p_value: float) -> str:
    """How probable it is by chance."""
    return f"p = {p_value:.2g}" if p_value >= 1e-4 else "p < 0.0001"


def word(name: str, units: Mapping[str, str]) -> str:
    """What "theta", "theta_dot", "torque" or "time" is called where these are the plant's units."""
    turning = {"theta": "angle", "theta_dot": "speed", "torque": "torque", "time": "time"}
    sliding = {"theta": "position", "torque": "force"}
    return sliding.get(name, turning[name]) if units["theta"] == "m" else turning[name]


def unit(name: str) -> str:
    """A unit; nothing for a plain number."""
    return "" if name == "1" else name


def rounded(value: float, sd: float) -> str:
    """A number to two digits of its sd."""
    if not (math.isfinite(value) and 0.0 < sd < math.inf) or abs(value) > 1e6:
        return number(f"{value:.4g}")
    return number(f"{value:.{min(max(1 - math.floor(math.log10(sd)), 0), 12)}f}")


def measured(value: float, sd: float) -> str:
    """A number and its sd."""
    if not math.isfinite(sd):
        return f"{rounded(value, sd)}, not determined"
    return f"{rounded(value, sd)} {PLUS_MINUS} {rounded(sd, sd) if sd > 0.0 else '0'}"


def listed(names: Sequence[str], most: int = 12) -> str:
    """Names, the first of them where they are many."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more

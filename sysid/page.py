"""Page: what a report is made of, and how its numbers and sentences are set."""

from __future__ import annotations

import base64
import io
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from sysid.comparison import compare
from sysid.comparison.held_out import HeldOutError
from sysid.logs import Log
from sysid.records import Record
from sysid.response import CHANNELS
from sysid.sensor import Sensor

if TYPE_CHECKING:
    from matplotlib.figure import Figure

UNITS = {"theta": "rad", "theta_dot": "rad/s"}
WORDS = {"theta": "angle", "theta_dot": "speed"}
ARROW, MINUS, TIMES = "\N{RIGHTWARDS ARROW}", "\N{MINUS SIGN}", "\N{MULTIPLICATION SIGN}"
PLUS_MINUS = "\N{PLUS-MINUS SIGN}"
RAISED = str.maketrans("-0123456789", "\u207b\u2070\u00b9\u00b2\u00b3\u2074\u2075\u2076\u2077\u2078\u2079")


class Picture(NamedTuple):
    """A figure as a data URI, what it shows in words, and whether it takes a whole column."""

    image: str
    caption: str
    wide: bool = True


@dataclass(frozen=True)
class Section:
    """Pictures under a heading, with sentences above them; `small`: three side by side."""

    title: str
    sentences: tuple[str, ...] = ()
    pictures: tuple[Picture, ...] = ()
    small: bool = False


@dataclass(frozen=True)
class Table:
    """Rows under heads; the columns of `words` hold words, the others numbers. `note` stands below."""

    title: str
    heads: tuple[str, ...]
    rows: Sequence[Sequence[str]]
    note: str = ""
    words: tuple[int, ...] = (0,)


@dataclass(frozen=True)
class Page:
    """All that the template is told: the verdict, its error before and after (or alone), pictures, then numbers."""

    title: str
    badge: str
    sentence: str
    numbers: tuple[str, ...]
    under: str
    sections: Sequence[Section]
    tables: Sequence[Table]
    lists: Mapping[str, Sequence[str]]
    settings: Mapping[str, str]
    warnings: tuple[str, ...] = ()


# ---- parts -----------------------------------------------------------------------------------------------------------


def picture(figure: Figure, caption: str, wide: bool = True) -> Picture:
    """The figure as an SVG inside the page, without a background."""
    import matplotlib

    file = io.BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "gapfinder", "path.simplify_threshold": 0.3}):
        figure.savefig(file, format="svg", transparent=True, dpi=150, metadata={"Date": None})
    return Picture("data:image/svg+xml;base64," + base64.b64encode(file.getvalue()).decode(), caption.strip(), wide)


def horizons(errors: Sequence[Mapping[str, HeldOutError]]) -> Table:
    """Errors over windows of every length by the length's name, of one model or of two."""
    heads, columns = ["error over"], list[list[str]]()
    for channel in next(iter(errors[0].values())).ratios:
        heads += [f"{WORDS[channel]} [{UNITS[channel]}]", f"{TIMES} noise"]
        columns.append([_to([f"{getattr(own[label], channel):.2g}" for own in errors]) for label in errors[0]])
        columns.append([_to([multiple(own[label].ratios[channel]) for own in errors]) for label in errors[0]])
    rows = [[label, *(c[k] for c in columns)] for k, label in enumerate(errors[0])]
    return Table("Errors by horizon", tuple(heads), rows, "The state of every window is refitted.")


def physical(errors: Sequence[HeldOutError]) -> str:
    """The error of each channel in its unit, of one model or of two."""
    return "; ".join(f"{WORDS[c]} {_to([f'{getattr(e, c):.2g}' for e in errors])} {UNITS[c]}" for c in errors[0].ratios)


def _to(values: Sequence[str]) -> str:
    return number(f" {ARROW} ".join(values))


def settings(sensor: Sensor, records: Sequence[Record]) -> dict[str, str]:
    """The version, the log and the noise."""
    return dict(_settings(sensor, records))


def _settings(sensor: Sensor, records: Sequence[Record]) -> Iterator[tuple[str, str]]:
    from importlib import metadata

    dt, n = records[0].dt, sum(len(r) for r in records)
    many = "s" * (len(records) != 1)
    yield "log", f"{len(records)} rollout{many}, {n:,} samples ({n * dt:.4g} s) at {1.0 / dt:.4g} Hz"
    yield "rollouts", listed([r.name for r in records])
    if isinstance(records, Log) and records.notes:
        yield "on reading", "; ".join(records.notes)
    noise = [f"{WORDS[c]} {sd:.3g} {UNITS[c]}" for c in CHANNELS if (sd := getattr(sensor, c)) is not None]
    yield "sensor noise", ", ".join(noise)
    try:
        yield "gapfinder", metadata.version("gapfinder")
    except metadata.PackageNotFoundError:
        yield "gapfinder", "not installed"


def listed(names: Sequence[str], most: int = 12) -> str:
    """Names, the first of them where they are many."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


# ---- typography ------------------------------------------------------------------------------------------------------


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
    return compare.multiple(ratio).replace("inf", "\N{INFINITY}")


def chance(p_value: float) -> str:
    """How probable it is by chance."""
    return f"p = {p_value:.2g}" if p_value >= 1e-4 else "p < 0.0001"


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

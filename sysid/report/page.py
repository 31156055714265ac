"""Page: what a report is made of."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import matplotlib
from matplotlib.figure import Figure

from sysid.data.record import Record, amount_of
from sysid.data.sensor import Sensor
from sysid.diagnosis.findings import quantity
from sysid.estimation.held_out import HeldOutError
from sysid.estimation.output_error import CHANNELS
from sysid.report.typesetting import ARROW, TIMES, listed, typeset, typeset_multiple
from sysid.version import version


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
    """Rows under heads; the columns in `text_columns` hold words, the others numbers. `note` stands below."""

    title: str
    heads: tuple[str, ...]
    rows: Sequence[Sequence[str]]
    note: str = ""
    text_columns: tuple[int, ...] = (0,)


@dataclass(frozen=True)
class Page:
    """All that the template is told: the verdict, its error before and after (or alone), pictures, then numbers;
    `turns`: of a machine that turns rather than slides."""

    title: str
    badge: str
    sentence: str
    numbers: tuple[str, ...]
    under: str
    sections: Sequence[Section]
    tables: Sequence[Table]
    lists: Mapping[str, Sequence[str]]
    settings: Mapping[str, str]
    turns: bool
    warnings: tuple[str, ...] = ()


# ---- parts -----------------------------------------------------------------------------------------------------------


def picture(figure: Figure, caption: str, wide: bool = True) -> Picture:
    """The figure as an SVG inside the page, without a background."""
    file = io.BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "gapfinder", "path.simplify_threshold": 0.3}):
        figure.savefig(file, format="svg", transparent=True, dpi=150, metadata={"Date": None})
    return Picture("data:image/svg+xml;base64," + base64.b64encode(file.getvalue()).decode(), caption.strip(), wide)


def horizon_table(errors: Sequence[Mapping[str, HeldOutError]]) -> Table:
    """Errors over windows of every length by the length's name, of one model or of two."""
    heads, columns = ["error over"], list[list[str]]()
    units = next(iter(errors[0].values())).units
    for channel in next(iter(errors[0].values())).ratios:
        heads += [f"{quantity(channel, units)} [{units[channel]}]", f"{TIMES} noise"]
        columns.append(
            [_to([f"{getattr(by_length[label], channel):.2g}" for by_length in errors]) for label in errors[0]]
        )
        columns.append(
            [_to([typeset_multiple(by_length[label].ratios[channel]) for by_length in errors]) for label in errors[0]]
        )
    rows = [[label, *(c[k] for c in columns)] for k, label in enumerate(errors[0])]
    return Table("Errors by horizon", tuple(heads), rows, "The state of every window is refitted.")


def physical(errors: Sequence[HeldOutError]) -> str:
    """The error of each channel in its unit, of one model or of two."""
    units = errors[0].units
    return "; ".join(
        f"{quantity(c, units)} {_to([f'{getattr(e, c):.2g}' for e in errors])} {units[c]}" for c in errors[0].ratios
    )


def _to(values: Sequence[str]) -> str:
    return f" {ARROW} ".join(map(typeset, values))


def report_settings(
    sensor: Sensor, records: Sequence[Record], units: Mapping[str, str], notes: Sequence[str]
) -> dict[str, str]:
    """The version, the log and the noise in these units."""
    noise = [f"{quantity(c, units)} {sd:.3g} {units[c]}" for c in CHANNELS if (sd := getattr(sensor, c)) is not None]
    return {
        "log": amount_of(records),
        "rollouts": listed([r.name for r in records]),
        **({"on reading": "; ".join(notes)} if notes else {}),
        "sensor noise": ", ".join(noise),
        "written by": version(),
    }

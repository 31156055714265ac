"""An experiment's answer, published: tables, figures, study.json, one HTML page that opens without a network and begins
with the answer in words, and the same words in a terminal.
"""

from __future__ import annotations

import base64
import json
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import jinja2
from rich.console import Console
from rich.markup import escape

from study.formatting import number, signed
from study.pipeline.database import Database
from study.pipeline.population_task import POLICY_FOLDER
from study.pipeline.settings import StudySettings
from study.pipeline.stages import duration
from study.pipeline.tables import write_rows
from sysid.data.files import write_whole
from sysid.report.typesetting import capital

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PUBLISHED = ("study.json", "report.html", POLICY_FOLDER)
"""What every experiment writes beside its tables and figures."""

Table = tuple[Sequence[str], Iterable[Sequence[object]]]
"""Columns and rows of a CSV file."""
Drawing = tuple[Callable[[], "Figure"], str]
"""What draws a figure, and what stands below it."""


class AnswerSection(NamedTuple):
    """Pairs of question and answer, under a title where they need one, and how far they can be trusted."""

    sentences: Sequence[tuple[str, str]]
    title: str = ""
    caveat: str = ""


@dataclass(frozen=True, kw_only=True)
class Account:
    """What is told of an experiment.

    tables, drawings   by the names of their files
    template           of the page; shown: what this shows besides
    counts             how much was run, for study.json
    seconds, versions  of everything that was made
    """

    plan: StudySettings
    sections: Sequence[AnswerSection]
    tables: Mapping[str, Table]
    drawings: Mapping[str, Drawing]
    template: str
    shown: Mapping[str, Any]
    counts: Mapping[str, Any]
    seconds: float
    versions: Mapping[str, str]

    def write(self, folder: Path, device: str) -> list[Path]:
        """Write all of it into the folder; returns the figures."""
        from study.figure_style import save_figure  # loads matplotlib, which no worker needs

        for name, table in self.tables.items():
            write_rows(folder / name, *table)
        drawn = {name: (save_figure(draw, folder / name), text) for name, (draw, text) in self.drawings.items()}
        where = "" if device == "cpu" else f" --device {device}"
        record = {
            "command": f"python -m study.main {self.plan.arguments}{where}",
            "device": device,
            **self.counts,
            "worker_hours": round(self.seconds / 3600.0, 3),
            "versions": self.versions,
            "fingerprint": self.plan.fingerprint,
            "settings": self.plan.to_dict(),
        }
        write_whole(folder / "study.json", json.dumps(record, indent=1) + "\n")
        write_whole(folder / "report.html", self.page(drawn))
        return [path for path, _ in drawn.values()]

    def page(self, figures: Mapping[str, tuple[Path, str]]) -> str:
        """The finished page with these figures, each with what stands below it."""
        return template(self.template).render(**vars(self), **self.shown, figures=figures)

    def say(self, console: Console) -> None:
        """The answers on the console."""
        for section in self.sections:
            console.print()
            if section.title:
                console.print(f"[bold underline]{section.title}[/]\n")
            for question, text in section.sentences:
                console.print(f"[bold]{question}[/]\n{escape(text)}\n")
            if section.caveat:
                console.print(f"[dim]{escape(section.caveat)}[/]\n")


def publish(results: Database, account: Callable[[], Account], console: Console) -> None:
    """Write what is told of an experiment into the folder of its results, and say the answers and where they are."""
    with console.status("drawing"):
        report = account()
        figures = report.write(results.folder, results.device)
    report.say(console)
    console.print(f"report   {results.folder / 'report.html'}", soft_wrap=True)
    console.print(f"figures  {', '.join(map(str, figures))}", soft_wrap=True)


def template(name: str) -> jinja2.Template:
    """A template of this package, whose values are escaped."""
    loader = jinja2.PackageLoader("study")
    environment = jinja2.Environment(loader=loader, autoescape=True, trim_blocks=True, lstrip_blocks=True)
    filters: tuple[Callable[..., str], ...] = (number, signed, capital, duration, unbroken, embedded, p_value_text)
    environment.filters |= {function.__name__: function for function in filters}
    environment.tests["finite"] = math.isfinite
    return environment.get_template(name)


def embedded(file: Path) -> str:
    """A PNG file as a data URL, so that a page needs no other file."""
    return "data:image/png;base64," + base64.b64encode(file.read_bytes()).decode()


def unbroken(text: object) -> str:
    """The same with no line break inside an interval."""
    return re.sub(r"\S+ \[[^]]*\]", lambda match: match.group().replace(" ", "\u00a0"), str(text))


def p_value_text(value: float) -> str:
    """To three digits; nothing for nan."""
    if math.isnan(value):
        return ""
    return "< 0.001" if value < 0.001 else f"{value:.3f}"

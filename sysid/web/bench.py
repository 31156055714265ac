"""The workbench: what the page asks for, as plain functions of a session."""

from __future__ import annotations

import base64
import binascii
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from dash import Patch, html

from sysid.cli.command_options import LogOptions, ModelOptions
from sysid.data.files import check_input
from sysid.data.record import write_csv
from sysid.errors import InvalidInput
from sysid.web import figures, layout, log_part, take_part
from sysid.web.jobs import Jobs, finished
from sysid.web.layout import STAMPED
from sysid.web.own_effect import OwnEffect, suggested
from sysid.web.samples import SAMPLES_BY_NAME, sample
from sysid.web.session import EFFECTS, ENDINGS, FAILS, MODEL, REPORT, SERIES, Session, Sessions
from sysid.web.training import Trainings

LARGEST_UPLOAD = 64 << 20
"""Bytes of the files that are dropped at once."""


class Workbench:
    """What the page asks for, by session; `jobs` are the processes that answer what takes long."""

    def __init__(self, sessions: Sessions, jobs: Jobs, most: int = LARGEST_UPLOAD) -> None:
        self.sessions, self.jobs, self.most = sessions, jobs, most
        self.trainings = Trainings(jobs.effects)
        self.messages: dict[str, str] = {}

    # ---- logs

    def open(self, log: LogOptions, start: ModelOptions) -> Session:
        """The session of files that the command line names: the one that they had, or a new one."""
        for file in log.files:
            check_input(file, "a log file", math.inf)
        known = self.sessions.of_files(log.files)
        session = known or self.sessions.new(log.files[0].stem[:60], log, start)
        if known is None:
            log_part.settle_columns(session)
        return session

    def upload(self, titles: Sequence[str], contents: Sequence[str]) -> Session:
        """A new session of files that were dropped; raises InvalidInput where they are too large or no files."""
        if sum(map(len, contents)) * 3 // 4 > self.most:
            raise InvalidInput(
                f"these files have more than {self.most >> 20} MB: expected less, or `sysid workbench LOG`"
            )
        for title in titles:
            if Path(title).suffix.lower() not in ENDINGS:
                raise InvalidInput(f"{title}: expected a file that ends in {', '.join(ENDINGS)}")
        try:
            found = [base64.b64decode(content.partition(",")[2], validate=True) for content in contents]
        except (binascii.Error, ValueError):
            raise InvalidInput("what came is no file: expected a log") from None
        session = self.sessions.new(Path(titles[0]).stem[:60])
        files = [session.keep_file(k, *own) for k, own in enumerate(zip(titles, found, strict=True), start=1)]
        session.change(log={"files": [str(f) for f in files]}, titles=tuple(t[:120] for t in titles))
        log_part.settle_columns(session)
        return session

    def sample(self, name: str) -> Session:
        """A new session of a simulated log."""
        own = SAMPLES_BY_NAME[name]
        session = self.sessions.new(own.title)
        (session.folder / "log").mkdir()
        records = sample(name)
        files = [session.folder / "log" / f"log{k}.csv" for k in range(1, len(records) + 1)]
        for record, file in zip(records, files, strict=True):
            write_csv(record, file)
        session.change(log={"files": [str(f) for f in files]}, titles=tuple(f.name for f in files))
        self.fit(session)
        return session

    # ---- models

    def fit(self, session: Session) -> None:
        """Fit a model to the log; the history begins anew, but for a log that cannot be read with these settings."""
        if session.state.nodes and log_part.preview(session).about.error:
            return
        self.jobs.cancel(session)
        session.begin_anew()
        self.jobs.begin(session, session.add_node(None))

    def add(self, session: Session, effect: str) -> None:
        """Add an effect to the model that is looked at; where the history has that model, go there."""
        state = session.state
        if state.at is None or not (session.of(state.at) / MODEL).is_file():
            return
        known = [k for k, node in enumerate(state.nodes) if node.parent == state.at and node.added == effect]
        if known:
            self.go(session, known[0])
            return
        self.jobs.begin(session, session.add_node(state.at, effect))

    def try_own(self, session: Session, own: OwnEffect) -> None:
        """Add an effect that the user wrote; raises InvalidInput where it is none."""
        own.checked()
        state = session.state
        others = tuple(o for o in state.own if o["name"] != own.name)
        if asdict(own) not in state.own and any(node.added == own.name for node in state.nodes):
            raise InvalidInput(f"another {own.name!r} was added before: give this one another name")
        session.change(own=(*others, asdict(own)))
        self.add(session, own.name)

    def go(self, session: Session, node: int | None) -> None:
        """Look at another model of the history."""
        state = session.state
        if node is not None and 0 <= node < len(state.nodes):
            session.change(at=node)
            if not finished(session, node) and self.jobs.running(session) is None:
                self.jobs.begin(session, node)

    def undo(self, session: Session) -> None:
        """Look at the model before."""
        state = session.state
        if state.at is not None and state.nodes[state.at].parent is not None:
            self.jobs.cancel(session)
            self.go(session, state.nodes[state.at].parent)

    def beside(self, session: Session, node: int) -> None:
        """Compare the model that is looked at with another of the history; once more: no longer."""
        session.change(beside=None if session.state.beside == node else node)

    def plan(self, session: Session) -> None:
        """Ask for the next experiment."""
        state = session.state
        if state.at is not None and self.jobs.running(session) is None:
            self.jobs.begin(session, state.at, "--next")

    def cancel(self, session: Session) -> None:
        """End what is under way."""
        self.jobs.cancel(session)
        self.messages[session.identifier] = "Cancelled: the page shows what was known before."

    # ---- what the page shows

    def stamps(self, session: Session | None) -> dict[str, str]:
        """What each part of the page rests on, as a text that changes with it."""
        if session is None:
            return dict.fromkeys(STAMPED, "none")
        state, folder = session.state, None
        if state.at is not None:
            folder = session.of(state.at)
        there = {n: "" if folder is None or not (folder / n).is_file() else str((folder / n).stat().st_mtime_ns)
                 for n in (FAILS, SERIES, EFFECTS, MODEL, REPORT)}  # fmt: skip
        own, known = session.identifier, [(session.of(k) / FAILS).is_file() for k in range(len(state.nodes))]
        return {
            "log": f"{own} {state.titles} {bool(state.nodes)}",
            "fails": f"{own} {state.at} {there[FAILS]}",
            "effects": f"{own} {state.at} {there[EFFECTS]} {there[FAILS]}",
            "ladder": f"{own} {state.at} {state.nodes} {known} {state.beside}",
            "take": f"{own} {state.at} {there[MODEL]} {there[REPORT]} {take_part.stamp(session)}",
            "train": f"{own} {state.at} {there[FAILS]} {take_part.training_stamp(session)} "
            f"{self.trainings.running(session)}",
        }

    def busy(self, session: Session) -> bool:
        """Whether something is under way that the page watches."""
        return self.jobs.running(session) is not None or self.trainings.running(session)

    def end(self) -> None:
        """End everything that is under way."""
        self.jobs.end()
        self.trainings.end()

    def work(self, session: Session | None) -> Any:
        """What is under way, or what went wrong last."""
        if session is None:
            return ""
        if message := self.jobs.message(session):
            self.messages[session.identifier] = message
        if self.jobs.running(session) is None:
            said = self.messages.get(session.identifier, "")
            return html.P(said, className="error") if said else ""
        self.messages.pop(session.identifier, None)
        part, text, seconds = self.jobs.progress(session)
        return [html.Progress(**{"aria-label": "at work"}), html.Span(part, className="part"),
                html.Span(text, className="quiet"), html.Span(f"{seconds:.0f} s", className="quiet")]  # fmt: skip

    def part(self, name: str, session: Session | None) -> Any:
        """What a section of the page shows."""
        if session is None:
            return layout.start_part(self.most) if name == "log" else layout.part(name)
        show: dict[str, Callable[[Session], Any]] = {
            "log": lambda own: log_part.form(own, self.most),
            "fails": self._fails,
            "effects": self._effects,
            "ladder": lambda own: layout.ladder_part(own.state, self.history(own)),
            "take": take_part.take,
            "train": lambda own: take_part.training_part(own, self.trainings.running(own)),
        }
        return show[name](session)

    def _fails(self, session: Session) -> Any:
        at = session.state.at
        found = session.read(at, FAILS)
        return layout.fails(found, None if found is None or at is None else figures.series(session.of(at) / SERIES))

    def _effects(self, session: Session) -> Any:
        state = session.state
        found, known = session.read(state.at, FAILS), session.read(state.at, EFFECTS)
        own = OwnEffect(**state.own[-1]) if state.own else suggested(found)
        rows = layout.effects(known, None if found is None else found["ratio"])
        return rows if known is None else [*rows, *layout.own_effect(own, known)]

    def history(self, session: Session) -> list[dict[str, Any]]:
        """Of each model its label, error and the model that it was made of."""
        found = []
        for k, node in enumerate(session.state.nodes):
            seen = session.read(k, FAILS)
            found.append({"node": k, "label": f"+ {node.added}" if node.added else "as it came", "parent": node.parent,
                          "error": None if seen is None else seen["ratio"]})  # fmt: skip
        return found

    def marked(
        self, session: Session, region: Mapping[str, tuple[float, float]], channel: str, over: str
    ) -> list[Patch]:
        """What marks the samples of a region in the course, the map and the picture over one quantity."""
        assert session.state.at is not None
        s = figures.series(session.of(session.state.at) / SERIES)
        at = np.flatnonzero(s.within(region)) if region else np.zeros(0, dtype=np.intp)
        at = at[:: max(1, len(at) // figures.MARKED)]
        course, states, quantity = Patch(), Patch(), Patch()
        for trace, y in ((figures.MARKS_ABOVE, s[f"read_{channel}"]), (figures.MARKS_BELOW, s["d"])):
            course["data"][trace]["x"], course["data"][trace]["y"] = s["t"][at], y[at]
        states["data"][2]["x"], states["data"][2]["y"] = s["theta"][at], s["theta_dot"][at]
        quantity["data"][2]["x"], quantity["data"][2]["y"] = s[over][at], s["d"][at]
        return [course, states, quantity]

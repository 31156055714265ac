"""The workbench: what the page asks for, as plain functions of a session."""

from __future__ import annotations

import base64
import binascii
import math
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from dash import Patch, html

from sysid.cli.command_options import LogOptions, ModelOptions
from sysid.data.files import check_input
from sysid.data.record import write_csv
from sysid.errors import InvalidInput
from sysid.web import figures, layout, log_part
from sysid.web.jobs import Jobs, Trainings, finished
from sysid.web.layout import STAMPED
from sysid.web.own_effect import OwnEffect, suggested
from sysid.web.samples import SAMPLES_BY_NAME, sample
from sysid.web.session import CHANGING, ENDINGS, Answer, Node, Session, Sessions

LARGEST_UPLOAD = 64 << 20
"""Bytes of the files that are dropped at once."""
LONGEST_TITLE = 60


class Workbench:
    """What the page asks for, by session; `jobs` are the processes that answer what takes long."""

    def __init__(self, sessions: Sessions, jobs: Jobs, most: int = LARGEST_UPLOAD) -> None:
        self.sessions, self.jobs, self.most = sessions, jobs, most
        self.trainings = Trainings(jobs.effects)
        self.messages: dict[str, str] = {}
        self.resumed: set[str] = set()

    # ---- what buttons ask for

    def do(self, session: Session | None, clicked: Mapping[str, Any], fields: Mapping[str, Any]) -> Session | None:
        """What a button asks for, of the fields of the page; the session to look at. Raises InvalidInput."""
        with self.sessions.lock:
            match clicked:
                case {"do": "sample", "name": name}:
                    return self.sample(name)
                case {"do": "delete", "session": name}:
                    gone = self.sessions.find(name)
                    if gone is not None:
                        self.delete(gone)
                    return None if gone == session else session
            if session is not None:
                self._do(session, clicked, fields)
            return session

    def _do(self, session: Session, clicked: Mapping[str, Any], fields: Mapping[str, Any]) -> None:
        text, at = {name: str(value or "").strip() for name, value in fields.items()}, session.state.at
        self.messages.pop(session.identifier, None)
        match clicked["do"]:
            case "fit":
                self.fit(session)
            case "add":
                self.add(session, clicked["effect"])
            case "own":
                self.try_own(session, OwnEffect(text["name"], text["formula"], text["shapes"]))
            case "go":
                self.go(session, clicked["node"])
            case "undo":
                self.undo(session)
            case "cancel":
                self.jobs.cancel(session)
                self.messages[session.identifier] = "Cancelled: the page shows what was known before."
            case "plan" if at is not None and self.jobs.running(session) is None:
                self.jobs.begin(session, at, "--next")
            case "train" if at is not None:
                self.trainings.begin(session, at, float(fields["u_max"] or 0.0))
            case "untrain":
                self.trainings.end(session)
            case "rename" if not text["title"]:
                raise InvalidInput("the session's name is empty: expected one to choose it by")
            case "rename":
                session.change(title=text["title"][:LONGEST_TITLE])

    # ---- logs

    def open(self, log: LogOptions, start: ModelOptions) -> Session:
        """The session of files that the command line names: the one that they had, or a new one."""
        for file in log.files:
            check_input(file, "a log file", math.inf)
        known = self.sessions.of_files(log.files)
        session = known or self.sessions.new(log.files[0].stem[:LONGEST_TITLE], log, start)
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
            decoded = [base64.b64decode(content.partition(",")[2], validate=True) for content in contents]
        except (binascii.Error, ValueError):
            raise InvalidInput("what came is no file: expected a log") from None
        session = self.sessions.new(Path(titles[0]).stem[:LONGEST_TITLE])
        files = [session.keep_file(k, *file) for k, file in enumerate(zip(titles, decoded, strict=True), start=1)]
        session.change(log=LogOptions(tuple(files)))
        log_part.settle_columns(session)
        return session

    def sample(self, name: str) -> Session:
        """A new session of a simulated log."""
        session, records = self.sessions.new(SAMPLES_BY_NAME[name].title), sample(name)
        (session.folder / "log").mkdir()
        files = [session.folder / "log" / f"log{k}.csv" for k in range(1, len(records) + 1)]
        for record, file in zip(records, files, strict=True):
            write_csv(record, file)
        session.change(log=LogOptions(tuple(files)))
        self.fit(session)
        return session

    def delete(self, session: Session) -> None:
        """Delete a session with all that was written of it; files that lie elsewhere stay."""
        self.trainings.end(session)
        self.jobs.cancel(session)
        shutil.rmtree(session.folder, ignore_errors=True)

    # ---- models

    def fit(self, session: Session) -> None:
        """Fit a model to the log beside those that are there, but for a log that cannot be read with these settings."""
        if session.state.nodes and log_part.preview(session).error:
            return
        self.jobs.cancel(session)
        state = session.state
        self.jobs.begin(session, session.add_node(Node(log=state.log, start=state.start, before=state.at)))

    def add(self, session: Session, effect: str) -> None:
        """Add an effect to the model that is looked at; where the history has that model, go there."""
        state = session.state
        if state.at is None or not session.has(state.at, Answer.MODEL):
            return
        known = [k for k, node in enumerate(state.nodes) if node.parent == state.at and node.added == effect]
        if known:
            self.go(session, known[0])
            return
        self.jobs.begin(session, session.add_node(Node(state.at, effect)))

    def try_own(self, session: Session, effect: OwnEffect) -> None:
        """Add an effect that the user wrote; raises InvalidInput where it is none."""
        effect.checked()
        state = session.state
        if effect not in state.own and any(node.added == effect.name for node in state.nodes):
            raise InvalidInput(f"another {effect.name!r} was added before: give this one another name")
        session.change(own=(*(o for o in state.own if o.name != effect.name), effect))
        self.add(session, effect.name)

    def go(self, session: Session, node: int | None) -> None:
        """Look at another model of the history; the form shows the settings that it was made with."""
        if node is None or not 0 <= node < len(session.state.nodes):
            return
        with CHANGING:
            state = session.state
            same = state.path(node)[:1] == state.path(state.at)[:1]
            session.save(replace(state if same else state.settings_of(node), at=node))
        self._finish(session, node)

    def _finish(self, session: Session, node: int | None) -> None:
        if node is not None and not finished(session, node) and self.jobs.running(session) is None:
            self.jobs.begin(session, node)

    def resume(self, session: Session) -> None:
        """Go on, once, with what was under way when the server ended, or with what another version wrote."""
        if session.identifier not in self.resumed:
            self.resumed.add(session.identifier)
            self._finish(session, session.state.at)

    def undo(self, session: Session) -> None:
        """Look at the model before, also at that before everything was begun anew."""
        state = session.state
        if state.at is None or (before := state.nodes[state.at].undone) is None:
            return
        self.jobs.cancel(session)
        if state.nodes[state.at].parent is None:
            with CHANGING:
                session.save(session.state.settings_of(before))
        self.go(session, before)

    # ---- what the page shows

    def stamps(self, session: Session | None) -> dict[str, str]:
        """What each part of the page rests on, as a text that changes with it."""
        if session is None:
            return dict.fromkeys(STAMPED, "none")
        state = session.state
        shown = {name: session.shown(name) for name in (Answer.FAILS, Answer.EFFECTS)}
        fails, effects = ((state.at, node, _changed(session, node, name)) for name, node in shown.items())
        answers = [
            _changed(session, state.at, n) for n in (Answer.MODEL, Answer.EXPORTED, Answer.REPORT, Answer.PLANNED)
        ]
        known = [_changed(session, k, Answer.FAILS) for k in range(len(state.nodes))]
        rests_on: dict[str, Any] = {
            "log": (state.title, state.path(state.at)[:1], state.log.joint),
            "fails": fails,
            "effects": effects,
            "ladder": (state.at, state.nodes, known),
            "take": (state.at, answers),
            "train": (fails, _changed(session, state.at, Answer.TRAINING), self.trainings.running(session)),
        }
        return {part: f"{session.identifier} {rests_on[part]}" for part in STAMPED}

    def busy(self, session: Session) -> bool:
        """Whether something is under way that the page watches."""
        return any(processes.running(session) is not None for processes in (self.jobs, self.trainings))

    def end(self) -> None:
        self.jobs.end_all()
        self.trainings.end_all()

    def work(self, session: Session | None) -> Any:
        """What is under way, or what went wrong last."""
        if session is None:
            return ""
        if message := self.jobs.message(session):
            self.messages[session.identifier] = message
        said = self.messages.get(session.identifier, "")
        shown = [html.P(said, className="error")] if said else []
        if self.jobs.running(session) is None:
            return shown or ""
        part, text, seconds = self.jobs.progress(session)
        details = [html.Span(said, className="quiet") for said in (text, f"{seconds:.0f} s")]
        return [html.Progress(**{"aria-label": "at work"}), html.Span(part, className="part"), *details, *shown]

    def part(self, name: str, session: Session | None) -> Any:
        """What a section of the page shows."""
        if session is None:
            return layout.start_part() if name == "log" else layout.nothing(name)
        if name in ("fails", "effects"):
            node = session.shown(Answer(f"{name}.json"))
            return layout.nothing(name) if node is None else self._answers(name, session, node)
        if name == "log":
            return log_part.form(session)
        if name == "ladder":
            state = session.state
            known = [session.read(k, Answer.FAILS) for k in range(len(state.nodes))]
            return layout.ladder_part(
                state, [None if comparison is None else comparison["ratio"] for comparison in known]
            )
        return layout.take_part(session) if name == "take" else layout.training_part(session, self.trainings)

    def _answers(self, name: str, session: Session, node: int) -> html.Div:
        """Where a model fails, or what it is missing; dimmed where it is not the one that is looked at."""
        live, own_effects = node == session.state.at, session.state.own
        comparison, known = session.read(node, Answer.FAILS), session.read(node, Answer.EFFECTS)
        if name == "fails":
            shown = layout.fails(comparison, figures.series(session.of(node) / Answer.SERIES))
        else:
            effect = own_effects[-1] if own_effects else suggested(comparison)
            error = None if comparison is None else comparison["ratio"]
            shown = [*layout.effects(known, error, live), *layout.own_effect(effect, known, live)]
        return html.Div(shown, className="" if live else "before")

    def marked(
        self, session: Session, region: Mapping[str, tuple[float, float]], channel: str, over: str
    ) -> list[Patch]:
        """What marks the samples of a region in the course, the map and the picture over one quantity."""
        node = session.shown(Answer.FAILS)
        assert node is not None
        s = figures.series(session.of(node) / Answer.SERIES)
        at = np.flatnonzero(figures.within(s, region)) if region else np.zeros(0, dtype=np.intp)
        at = at[:: max(1, len(at) // figures.MARKED)]
        course, states, quantity = Patch(), Patch(), Patch()
        for trace, y in ((figures.MARKS_ABOVE, s[f"{channel}_read"]), (figures.MARKS_BELOW, s["residual_torque"])):
            course["data"][trace]["x"], course["data"][trace]["y"] = s["t"][at], y[at]
        states["data"][2]["x"], states["data"][2]["y"] = s["theta"][at], s["theta_dot"][at]
        quantity["data"][2]["x"], quantity["data"][2]["y"] = s[over][at], s["residual_torque"][at]
        return [course, states, quantity]


def _changed(session: Session, node: int | None, name: Answer) -> int:
    """When an answer was written [ns]; 0 where it is not there."""
    path = None if node is None else session.of(node) / name
    return path.stat().st_mtime_ns if path is not None and path.is_file() else 0

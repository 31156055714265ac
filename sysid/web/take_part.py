"""The last part of the page: what can be taken along."""

from __future__ import annotations

from typing import Any

from dash import dcc, html

from sysid.web.own_effect import OwnEffect
from sysid.web.script import script
from sysid.web.session import BEGUN, MODEL, NEXT, PLANNED, REPORT, Session

DOWNLOADS = {MODEL: "application/json", REPORT: "text/html", NEXT: "text/csv"}
"""The answers that can be downloaded, and what they are."""


def stamp(session: Session) -> str:
    """What this part rests on beside the model and its report."""
    at = session.state.at
    return "" if at is None else f"{(session.of(at) / PLANNED).is_file()}"


def take(session: Session) -> Any:
    """Links to the model and the report, the next experiment, and the lines that repeat every click."""
    state = session.state
    at = state.at
    if at is None or not (session.of(at) / MODEL).is_file():
        return html.P("Here the mended model waits to be taken along.", className="quiet")
    links = [
        _link(session, at, MODEL, "the model, for policies and everything else"),
        _link(session, at, REPORT, "one page that opens offline"),
    ]
    return [html.Div(links, className="links"), *_experiment(session, at), *_lines(session, at)]


def _link(session: Session, node: int, file: str, about: str) -> Any:
    if not (session.of(node) / file).is_file():
        return html.Span([file, html.Small("is being written")], className="link waiting")
    address, name = f"/download/{session.identifier}/{node}/{file}", file.partition(".")[0]
    return html.A([file, html.Small(about)], href=address, download=file, className="link", id=f"get-{name}")


def _experiment(session: Session, at: int) -> list[Any]:
    planned = session.read(at, PLANNED)
    if planned is None:
        return [html.Button("Plan the next experiment", id={"do": "plan"})]
    link = [_link(session, at, NEXT, "what the rig plays next")] if (session.of(at) / NEXT).is_file() else []
    said = planned["sentence"].splitlines()
    return [*link, html.Details([html.Summary("What it is for"), *(html.P(line, className="quiet") for line in said)])]


def _lines(session: Session, at: int) -> list[Any]:
    """Python that does the same, and the model as an environment for agents."""
    state = session.state
    begun = session.read(state.path(at)[0], BEGUN)
    if begun is None:
        return []
    own = [OwnEffect(**o).source() for o in state.own if o["name"] in state.added(at)]
    lines = script(state, begun, at, own)
    environment = 'gymnasium.make("policies:gapfinder/Pendulum-v0", model="model.json")'
    return [
        html.Details(
            [
                html.Summary("The same in Python"),
                dcc.Clipboard(target_id="lines", className="copy"),
                html.Pre(lines, id="lines"),
            ]
        ),
        html.Details([html.Summary("As a Gymnasium environment"), html.Pre(environment)]),
    ]

"""The last part of the page: what can be taken along."""

from __future__ import annotations

from typing import Any

from dash import html

from sysid.web.session import MODEL, REPORT, Session

DOWNLOADS = {MODEL: "application/json", REPORT: "text/html"}
"""The answers that can be downloaded, and what they are."""


def stamp(session: Session) -> str:
    """What this part rests on beside the model."""
    return str(session.state.at)


def take(session: Session) -> Any:
    """Links to the model and the report."""
    at = session.state.at
    if at is None or not (session.of(at) / MODEL).is_file():
        return html.P("Here the mended model waits to be taken along.", className="quiet")
    links = [
        _link(session, at, MODEL, "model.json", "the model, for policies and everything else"),
        _link(session, at, REPORT, "report.html", "one page that opens offline"),
    ]
    return [html.Div(links, className="links")]


def _link(session: Session, node: int, file: str, label: str, about: str) -> Any:
    if not (session.of(node) / file).is_file():
        return html.Span([label, html.Small("is being written")], className="link waiting")
    address, name = f"/download/{session.identifier}/{node}/{file}", file.partition(".")[0]
    return html.A([label, html.Small(about)], href=address, download=label, className="link", id=f"get-{name}")

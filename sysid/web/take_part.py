"""The last part of the page: what can be taken along."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.util import find_spec
from typing import Any

from dash import dcc, html

from sysid.web import layout
from sysid.web.jobs import Trainings
from sysid.web.script import script
from sysid.web.session import Answer, Session

DOWNLOADS = {
    Answer.MODEL: ("application/json", "the model, for policies and everything else"),
    Answer.REPORT: ("text/html", "one page that opens offline"),
    Answer.OWN_EFFECTS: ("text/x-python", "your own effects, which the model needs: --effects own_effects.py"),
    Answer.MJCF: ("text/xml", "for MuJoCo"),
    Answer.URDF: ("text/xml", "for ROS"),
    Answer.NEXT: ("text/csv", "what the rig plays next"),
}
"""The answers that can be downloaded: what they are to a browser, and what they are for."""


def take(session: Session) -> Any:
    """Links to the model and the report, the next experiment, and the lines that repeat every click."""
    at = session.state.at
    if at is None or not session.has(at, Answer.MODEL):
        return layout.nothing("take")
    exported, planned = session.read(at, Answer.EXPORTED) or {}, session.read(at, Answer.PLANNED)
    found: list[Any] = []
    for file in DOWNLOADS:
        found += _link(session, at, file)
        found += layout.folded(f"{file} cannot say all of it", exported.get(file, ()))
    said = [] if planned is None else planned["sentence"].splitlines()
    plan = layout.folded("What the experiment is for", said) or [
        html.Button("Plan the next experiment", id={"do": "plan"})
    ]
    return [html.Div(found, className="links"), *plan, *_lines(session, at)]


def _link(session: Session, node: int, file: Answer) -> list[Any]:
    if session.has(node, file):
        address, name = f"/download/{session.identifier}/{node}/{file}", file.replace(".", "-")
        about = html.Small(DOWNLOADS[file][1])
        return [html.A([file, about], href=address, download=file, className="link", id=f"get-{name}")]
    waiting = html.Span([file, html.Small("is being written")], className="link waiting")
    return [waiting] if file is Answer.REPORT else []


def _lines(session: Session, at: int) -> list[Any]:
    """Python that does the same."""
    state = session.state
    if (begun := session.read(state.path(at)[0], Answer.BEGUN)) is None:
        return []
    lines = script(state, begun, at, [own.source() for own in state.own_effects(at)])
    copied = [dcc.Clipboard(target_id="lines", className="copy"), html.Pre(lines, id="lines")]
    return [html.Details([html.Summary("The same in Python"), *copied])]


# ---- training --------------------------------------------------------------------------------------------------------


def training_part(session: Session, trainings: Trainings) -> Any:
    """Train a policy on the model that is looked at, and what the training says: its curve, and the optimum."""
    at = session.state.at
    found = session.read(at, Answer.FAILS)
    if at is None or found is None:
        return ""
    if refusal := _no_policy(found):
        return html.P(refusal, className="quiet")
    running, said = trainings.running(session) is not None, session.of(at) / Answer.TRAINING
    u_max = dcc.Input(id={"field": "u_max"}, type="number", value=_limit(found), min=0)
    button = html.Button("Stop", id={"do": "untrain"}) if running else html.Button("Train", id={"do": "train"})
    label = f"commands up to [{found['command_unit']}]"
    return [
        html.H3("A policy for this model"),
        html.Div([html.Label([html.Span(label), u_max]), button], className="field"),
        *([html.Pre(said.read_text(errors="replace"))] if said.is_file() else []),
    ]


def _no_policy(found: Mapping[str, Any]) -> str:
    """Why no policy can be trained on a model; empty where one can."""
    if not found["turns"]:
        return "A policy swings something up: this model is a linear axis, which does not swing."
    if found["at_angle"]:
        return (
            "A policy commands a torque, a current or a voltage: this model is driven by a servo that is told angles."
        )
    return "" if find_spec("policies") else "A policy can be trained here where the package policies is installed."


def _limit(found: Mapping[str, Any]) -> float:
    """The largest command of the log; 1 where that is a free swing."""
    return float(f"{found['u_max']:.3g}") or 1.0

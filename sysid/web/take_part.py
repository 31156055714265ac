"""The last part of the page: what can be taken along."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from dash import dcc, html

from sysid.web import figures, layout
from sysid.web.own_effect import OwnEffect
from sysid.web.script import script
from sysid.web.session import BEGUN, EXPORTED, FAILS, MJCF, MODEL, NEXT, PLANNED, REPORT, URDF, Session
from sysid.web.training import OPTIMUM, OWN, SAID, available, heard

DOWNLOADS = {MODEL: "application/json", REPORT: "text/html", NEXT: "text/csv", MJCF: "text/xml", URDF: "text/xml"}
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
    links = [html.Div(links, className="links"), *_simulators(session, at)]
    return [*links, *_experiment(session, at), *_lines(session, at)]


def _simulators(session: Session, at: int) -> list[Any]:
    """The model for MuJoCo and as URDF, with what these cannot express."""
    sentences = session.read(at, EXPORTED) or {}
    found: list[Any] = []
    for name, about in ((MJCF, "for MuJoCo"), (URDF, "for ROS")):
        if (session.of(at) / name).is_file():
            found.append(_link(session, at, name, about))
        if sentences.get(name):
            said = [html.Li(sentence) for sentence in sentences[name]]
            found.append(html.Details([html.Summary(f"{name} cannot say all of it"), html.Ul(said)]))
    return [html.Div(found, className="links")]


def _link(session: Session, node: int, file: str, about: str) -> Any:
    if not (session.of(node) / file).is_file():
        return html.Span([file, html.Small("is being written")], className="link waiting")
    address, name = f"/download/{session.identifier}/{node}/{file}", file.replace(".", "-")
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
    limit = _torque_limit(session.read(at, FAILS))
    environment = (
        f'gymnasium.make("policies:gapfinder/Pendulum-v0", model="model.json", u_max={limit or 1.0})'
        "  # u_max: the largest torque [N m]"
    )
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


# ---- training --------------------------------------------------------------------------------------------------------


def training_stamp(session: Session) -> str:
    """How much a training has said."""
    at = session.state.at
    said = None if at is None else session.of(at) / SAID
    return str(said.stat().st_size) if said is not None and said.is_file() else ""


def training_part(session: Session, running: bool) -> Any:
    """Train a policy on the model that is looked at, and its curve against the optimum."""
    at = session.state.at
    found = session.read(at, FAILS)
    if at is None or found is None or not found["turns"]:
        return ""
    if not available():
        return html.P("A policy can be trained here where the package policies is installed.", className="quiet")
    said = heard(session, at)
    u_max = dcc.Input(id="train-u-max", type="number", value=_torque_limit(found), min=0)
    button = html.Button("Stop", id={"do": "untrain"}) if running else html.Button("Train", id="train")
    return [
        html.H3("A policy for this model"),
        html.Div([html.Label([html.Span("torque up to [N m]"), u_max]), button], className="training"),
        html.P(id="train-message", className="error", role="alert"),
        *([] if said is None else [layout.graph(figures.learning(said["points"], said["returns"].get(OPTIMUM)))]),
        *([] if said is None else [html.P(_said(said, running), className="quiet")]),
    ]


def _torque_limit(found: Mapping[str, Any] | None) -> float | None:
    """The largest torque [N m] of the log; None where its commands are no torques."""
    if found is None or found["command_unit"] != "N m":
        return None
    return float(f"{found['u_max']:.3g}")


def _said(said: Mapping[str, Any], running: bool) -> str:
    """Where a training is, or what it came to."""
    returns = said["returns"]
    if OWN in returns:
        best = f"; the optimum has {returns[OPTIMUM]:.0f}" if OPTIMUM in returns else ""
        return f"The policy earns {returns[OWN]:.0f} an episode{best}. It is kept as {said['policy']}."
    if not said["points"]:
        return str(said["last"])
    steps, earned = said["points"][-1]
    left = str(said["last"]).rpartition("#")[2].strip() if running else "stopped"
    return f"After {steps:,} simulated steps the policy in training earns {earned:.0f} an episode; {left}."

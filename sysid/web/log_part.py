"""The log's part of the page: how it is read, and what that means, drawn at once."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go
from dash import dcc, html
from plotly.subplots import make_subplots

from sysid.cli.commands import read_log
from sysid.cli.starting_model import begun
from sysid.data.files import write_whole
from sysid.data.log_files import sources
from sysid.data.logs import likely_columns, named_columns
from sysid.data.record import Record
from sysid.data.table import TimeWindow
from sysid.errors import InvalidInput
from sysid.limits import RAW_ROWS
from sysid.physics.ops import Array
from sysid.web import figures
from sysid.web.layout import graph, upload
from sysid.web.session import Session, SessionState

OURS = {"t": "time", "theta": "angle", "theta_dot": "speed", "torque": "command"}
PLANTS = {
    "rod": "a rod that swings",
    "point": "a mass at an arm's end",
    "joint": "a joint of any shape",
    "axis": "a linear axis",
}
INPUTS = {"torque": "a torque", "current": "a current", "voltage": "a voltage", "position": "a position (servo)"}
MOST_PREVIEWED = 2_000
"""Points of each preview."""


@dataclass(frozen=True)
class About:
    """What is said of a log: what was read, what was noted, or why it cannot be read; and in which units."""

    said: str
    notes: tuple[str, ...]
    error: str
    turns: bool
    units: Mapping[str, str]
    command: str


@dataclass(frozen=True, eq=False)
class Preview:
    """What the settings make of the files: t, theta, torque (K,) of all rollouts one after the other, nan between."""

    about: About
    t: Array
    theta: Array
    torque: Array


def preview(session: Session) -> Preview:
    """What the session's settings make of its files; kept, also in its folder, as long as neither changes."""
    state = session.state
    stamps = [Path(f).stat().st_mtime_ns if Path(f).is_file() else 0 for f in state.log.get("files", ())]
    return _previewed(json.dumps([state.log, state.start, stamps]), session)


@lru_cache(maxsize=16)
def _previewed(key: str, session: Session) -> Preview:
    path = session.folder / "preview.npz"
    with suppress(OSError, ValueError, KeyError, TypeError), np.load(path, allow_pickle=False) as file:
        if str(file["key"]) == key:
            about = json.loads(str(file["about"]))
            return Preview(About(**about | {"notes": tuple(about["notes"])}), file["t"], file["theta"], file["torque"])
    found, content = _read(session.state), BytesIO()
    columns: dict[str, Any] = {"t": found.t, "theta": found.theta, "torque": found.torque}
    np.savez(content, key=key, about=json.dumps(asdict(found.about)), **columns)
    write_whole(path, content.getvalue())
    return found


def _read(state: SessionState) -> Preview:
    model, error, log = None, "", None
    try:
        model, _, _ = begun(replace(state.model_options, set=()), state.log_options.input)
        log = read_log(state.log_options, model)
    except InvalidInput as refused:
        error = str(refused)
    except MemoryError:
        error = "this log needs more memory than there is: expected a shorter one"
    if model is None:
        model, _, _ = begun(replace(state.model_options, set=()), None)
    said, notes = ("", ()) if log is None else (str(log).partition(";")[0], log.notes)
    about = About(said, notes, error, model.plant.turns, dict(model.plant.quantities), model.command_unit)
    return Preview(about, *_joined(log or ()))


def _joined(records: Sequence[Record]) -> tuple[Array, Array, Array]:
    t, theta, torque, begin = [np.zeros(0)], [np.zeros(0)], [np.zeros(0)], 0.0
    for r in records:
        t.append(np.append(r.t - r.t[0] + begin, math.nan))
        known = r.theta if r.has_angles and r.theta is not None else np.full(len(r) + 1, math.nan)
        theta.append(np.append(known, math.nan))
        torque.append(np.append(r.u, [r.u[-1], math.nan]))
        begin += float(r.t[-1] - r.t[0]) * 1.03
    return np.concatenate(t), np.concatenate(theta), np.concatenate(torque)


def columns(session: Session) -> tuple[tuple[str, ...], dict[str, str]]:
    """The names of the first file's columns, and which of them are taken for what."""
    state = session.state
    found = sources(state.log["files"][:1], state.log.get("joint", ""))[0].names()
    told = dict(pair.split("=", 1) for pair in state.log.get("columns", "").split(",") if "=" in pair)
    own = named_columns(found) | told
    return found, {ours: theirs for ours, theirs in (likely_columns(found, own) | own).items() if theirs}


def settle_columns(session: Session) -> None:
    """Take for what they look like the columns that are called otherwise than we call them, and that hold numbers."""
    try:
        found, chosen = columns(session)
        empty = [chosen[ours] for ours in _without_numbers(session, chosen)]
    except InvalidInput:
        return
    if empty:
        kept = {ours: theirs for ours, theirs in chosen.items() if theirs not in empty}
        chosen = likely_columns([name for name in found if name not in empty], kept) | kept
    state, told = session.state, ",".join(f"{a}={b}" for a, b in chosen.items() if named_columns(found).get(a) != b)
    if told and not state.log.get("columns"):
        session.change(log={**state.log, "columns": told})


def _without_numbers(session: Session, chosen: Mapping[str, str]) -> list[str]:
    """Which of ours the chosen columns of the first file hold no number for."""
    state = session.state
    source = sources(state.log["files"][:1], state.log.get("joint", ""))[0]
    table = source.load(chosen, TimeWindow(-math.inf, math.inf, RAW_ROWS))
    return [ours for ours, column in table.items() if not np.any(np.isfinite(column))]


def changed(state: SessionState, values: Mapping[str, Any], found: Mapping[str, str]) -> SessionState:
    """The state with the settings that a form shows; `found` are the columns by our names that the form began with."""
    pairs = [
        f"{ours}={values.get(ours) or ''}"
        for ours in OURS
        if (values.get(ours) or "") != (found.get(ours) or "") or ours in found
    ]
    log = {
        k: v
        for k, v in state.log.items()
        if k not in ("columns", "zero", "flip_torque", "degrees", "input", "begin", "end")
    }
    told = ",".join(p for p in pairs if p != "=")
    log |= {"columns": told} if told else {}
    log |= {"zero": "hanging"} if values.get("zero") == "hanging" else {}
    log |= {"flip_torque": True} if "flip" in values.get("signs", ()) else {}
    log |= {"degrees": True} if "degrees" in values.get("signs", ()) else {}
    log |= {k: float(values[k]) for k in ("begin", "end") if values.get(k) is not None}
    log |= {"input": values["input"]} if values.get("input", "torque") != "torque" else {}
    start = {k: v for k, v in state.start.items() if k not in ("plant", "set")}
    start |= {"plant": values["plant"]} if values.get("plant", "rod") != "rod" else {}
    known = [part.strip() for part in (values.get("known") or "").replace(";", ",").split(",") if part.strip()]
    start |= {"set": known} if known else {}
    return replace(state, log=log, start=start)


# ---- the form --------------------------------------------------------------------------------------------------------


def form(session: Session, most: int) -> list[Any]:
    """The files, the settings, the preview and the button that fits a model."""
    state = session.state
    try:
        found, chosen = columns(session)
    except InvalidInput as error:
        return [html.P(str(error), className="error", role="alert"), upload(most)]
    count = len(state.titles)
    told = state.titles[0] if count == 1 else f"{state.titles[0]} to {state.titles[-1]} ({count} files)"
    signs = [n for n, on in (("flip", state.log.get("flip_torque")), ("degrees", state.log.get("degrees"))) if on]
    return [
        html.P([html.Strong(state.title or "log"), f": {told}"], className="files"),
        html.Div(id="preview"),
        html.Details(
            [
                html.Summary("How it is read"),
                html.Div([_labelled(OURS[c], _choice(f"set-{c}", {"": "none", **{n: n for n in found if n}},
                                                     chosen.get(c, ""))) for c in OURS], className="fields"),
                _labelled("what moves", _choice("set-plant", PLANTS, state.start.get("plant") or "rod")),
                _labelled("the command is", _choice("set-input", INPUTS, state.log.get("input") or "torque")),
                _labelled("angle 0 is", dcc.RadioItems(["upright", "hanging"], state.log.get("zero") or "upright",
                                                       id="set-zero", inline=True, className="choice")),
                dcc.Checklist([{"label": "a positive command lowers the angle", "value": "flip"},
                               {"label": "angles are in degrees", "value": "degrees"}], signs, id="set-signs"),
                html.Div([_labelled(f"{word} [s]", dcc.Input(id=f"set-{k}", type="number", debounce=True,
                                                             value=state.log.get(k)))
                          for word, k in (("from", "begin"), ("to", "end"))], className="fields"),
                _labelled("known numbers", dcc.Input(id="set-known", value=", ".join(state.start.get("set", ())),
                                                     placeholder="l=0.45, m=0.5", debounce=True)),
            ],
            open=bool(preview(session).about.error) or not state.nodes,
        ),
        html.Button("Begin anew with these settings" if state.nodes else "Fit a model to this log", id={"do": "fit"},
                    className="wide" if state.nodes else "main wide"),
        upload(most),
    ]  # fmt: skip


def _labelled(label: str, control: Any) -> html.Label:
    return html.Label([html.Span(label), control])


def _choice(identifier: str, choices: Mapping[str, str], value: str) -> dcc.Dropdown:
    options = [{"label": label, "value": v} for v, label in choices.items()]
    return dcc.Dropdown(options, value, id=identifier, clearable=False, searchable=False)


# ---- the preview -----------------------------------------------------------------------------------------------------


def previewed(found: Preview) -> list[Any]:
    """The angle and the command over time, the machine at the cursor, and what looks unlikely."""
    about = found.about
    if about.error:
        return [html.P(about.error, className="error", role="alert")]
    notes = [html.Li(note) for note in about.notes]
    end = float(np.nanmax(found.t))
    return [
        html.Div(
            [graph(machine_figure(found, 0.0), id="machine"),
             graph(readings(found), id="readings")],
            className="preview",
        ),
        html.Div(dcc.Slider(0.0, end, value=0.0, id="cursor", marks=None, step=end / 500.0, updatemode="drag",
                            allow_direct_input=False), className="cursor", **{"aria-label": "cursor along the log"}),
        html.P(about.said, className="quiet"),
        *([html.Ul(notes, className="notes")] if notes else []),
    ]  # fmt: skip


def readings(found: Preview) -> go.Figure:
    """Angle and command over time."""
    about, figure = found.about, make_subplots(rows=2, cols=1, shared_xaxes=True, vertical_spacing=0.08)
    figure.update_layout(
        {**figures.BASE, "height": 230, "margin": {"l": 44, "r": 4, "t": 6, "b": 34}, "hovermode": "x"}
    )
    for row, (series, colour) in enumerate(((found.theta, figures.BLUE), (found.torque, figures.GREY)), start=1):
        t, y = figures.thinned(found.t, series, MOST_PREVIEWED)
        figure.add_scatter(x=t, y=y, mode="lines", line={"color": colour, "width": 1}, row=row, col=1, hoverinfo="none")
    figure.update_xaxes(**figures.AXIS)
    figure.update_yaxes(**figures.AXIS)
    figure.update_layout(font={"size": 10})
    figure.update_xaxes(title="time [s]", row=2)
    figure.update_yaxes(title=f"{'angle' if about.turns else 'position'} [{about.units['theta']}]", row=1)
    figure.update_yaxes(title=f"command [{about.command}]", row=2)
    figure.add_vline(x=0.0, line={"color": figures.YELLOW, "width": 1.5})
    return figure


def machine_figure(found: Preview, t: float) -> go.Figure:
    """The machine as the settings have it at an instant: 0 upright, angles to the right, gravity down."""
    x, y = arm(found, t)
    figure = figures.blank(150, margin={"l": 0, "r": 0, "t": 0, "b": 0})
    figure.update_xaxes(visible=False, range=[-1.25, 1.25], fixedrange=True)
    figure.update_yaxes(visible=False, range=[-1.25, 1.25], scaleanchor="x", fixedrange=True)
    figure.add_scatter(x=x, y=y, mode="lines+markers", hoverinfo="skip", line={"color": figures.BLUE, "width": 7},
                       marker={"size": [10, 16], "color": [figures.GREY, figures.BLUE], "opacity": 1})  # fmt: skip
    if found.about.turns:
        figure.add_annotation(x=-1.1, y=-1.1, ax=-1.1, ay=-0.6, axref="x", ayref="y", text="g", showarrow=True,
                              arrowhead=2, arrowcolor=figures.GREY)  # fmt: skip
    return figure


def arm(found: Preview, t: float) -> tuple[list[float], list[float]]:
    """Where the arm begins and ends at an instant, or where a carriage is."""
    known = np.flatnonzero(np.isfinite(found.t) & np.isfinite(found.theta))
    if not len(known):
        return [0.0, 0.0], [0.0, 0.0]
    theta = float(found.theta[known[np.argmin(np.abs(found.t[known] - t))]])
    if found.about.turns:
        return [0.0, math.sin(theta)], [0.0, math.cos(theta)]
    reach = float(np.nanmax(np.abs(found.theta))) or 1.0
    return [0.0, theta / reach], [0.0, 0.0]

"""The log's part of the page: how it is read, and what that means, drawn at once."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
import plotly.graph_objects as go
from dash import dcc, html

from sysid.cli.command_options import LogOptions, ModelOptions
from sysid.cli.commands import read_log
from sysid.cli.starting_model import begun
from sysid.data.columns import likely_columns, named_columns, wanted_columns
from sysid.data.log_files import sources
from sysid.data.logs import Log
from sysid.data.record import in_a_row
from sysid.data.splitting import split
from sysid.errors import InvalidInput
from sysid.physics.model import Model
from sysid.physics.ops import Array
from sysid.web import figures
from sysid.web.layout import graph
from sysid.web.session import BAGS, Session

OURS = {"t": "time", "theta": "angle", "theta_dot": "speed", "torque": "command"}
CHOICES = {
    "plant": {"rod": "a rod that swings", "point": "a mass at an arm's end", "joint": "a joint of any shape",
              "axis": "a linear axis"},
    "input": {"torque": "a torque", "current": "a current", "voltage": "a voltage",
              "position": "a position (servo)"},
    "zero": {"upright": "upright", "hanging": "hanging"},
}  # fmt: skip
"""The settings that are one of several, what these mean, and first the usual one."""
FLAGS = {"flip_torque": "a positive command lowers the angle", "degrees": "angles are in degrees"}
NUMBERS = {
    "begin": "from [s]",
    "end": "to [s]",
    "dt": "sample interval [s]",
    "hold_out": "held out: a share, or rollouts",
}
SETTINGS = (*OURS, *CHOICES, "signs", *NUMBERS, "joint", "known")
"""The controls of the form, in the order in which they are handed over."""
MOST_PREVIEWED = 2_000
"""Points of each preview."""


@dataclass(frozen=True, eq=False)
class Preview:
    """What the settings make of the files: the log, or why it cannot be read, and a model of the machine."""

    log: Log | None
    error: str
    model: Model

    @cached_property
    def course(self) -> tuple[Array, Array, Array]:
        """t, theta, torque (K,) of all rollouts one after the other, nan between."""
        t, theta, torque = [np.zeros(0)], [np.zeros(0)], [np.zeros(0)]
        records = self.log or ()
        for r, begin in zip(records, in_a_row([r.t for r in records]), strict=True):
            t.append(np.append(r.t - r.t[0] + begin, math.nan))
            known = r.theta if r.has_angles and r.theta is not None else np.full(len(r) + 1, math.nan)
            theta.append(np.append(known, math.nan))
            torque.append(np.append(r.u, [r.u[-1], math.nan]))
        return np.concatenate(t), np.concatenate(theta), np.concatenate(torque)


def preview(session: Session) -> Preview:
    """What the session's settings make of its files; kept as long as neither changes."""
    state = session.state
    stamps = tuple(f.stat().st_mtime_ns if f.is_file() else 0 for f in state.log.files)
    return _previewed(state.log, replace(state.start, set=()), stamps)


@lru_cache(maxsize=2)
def _previewed(options: LogOptions, start: ModelOptions, stamps: tuple[int, ...]) -> Preview:
    """The preview; stamps: when the files were written."""
    error, log = "", None
    model, _, _ = begun(start, None)
    try:
        model, _, _ = begun(start, options.input)
        log = read_log(options, model)
        if options.hold_out is not None:
            split(log, options.hold_out)
    except InvalidInput as refused:
        error = str(refused)
    except MemoryError:
        error = "this log needs more memory than there is: expected a shorter one"
    return Preview(log, error, model)


def columns(session: Session) -> tuple[tuple[str, ...], dict[str, str]]:
    """The names of the first file's columns, and which of them are taken for what; none of a file that has none."""
    log = session.state.log
    command = log.input or "torque"
    try:
        names = next(sources(log.files[:1], log.joint)).names
        wanted = wanted_columns(log.columns, command)
    except InvalidInput:  # the preview says why
        return (), {}
    taken = named_columns(names, command) | wanted
    return names, {ours: theirs for ours, theirs in (likely_columns(names, taken, command) | taken).items() if theirs}


def settle_columns(session: Session) -> None:
    """Take for what they look like the columns that are called otherwise than we call them, and that hold numbers."""
    log, (names, chosen) = session.state.log, columns(session)
    try:
        table = next(sources(log.files[:1], log.joint)).load(chosen)
    except InvalidInput:
        return
    if empty := [chosen[ours] for ours, column in table.items() if not np.any(np.isfinite(column))]:
        kept = {ours: theirs for ours, theirs in chosen.items() if theirs not in empty}
        chosen = likely_columns([name for name in names if name not in empty], kept, log.input or "torque") | kept
    named = named_columns(names, log.input or "torque")
    text = ",".join(f"{a}={b}" for a, b in chosen.items() if named.get(a) != b)
    if text and not log.columns:
        session.change(log=replace(log, columns=text))


def change(session: Session, values: Mapping[str, Any]) -> None:
    """Keep the settings that a form shows; the columns of another joint are looked at anew."""
    before, (_, chosen) = session.state, columns(session)
    pairs = [f"{ours}={values.get(ours) or ''}" for ours in OURS if values.get(ours) or ours in chosen]
    known = [part.strip() for part in (values.get("known") or "").replace(";", ",").split(",") if part.strip()]
    given: dict[str, Any] = {name: name in values.get("signs", ()) for name in FLAGS}
    given |= {name: None if values.get(name) is None else float(values[name]) for name in NUMBERS}
    given |= {n: None if values.get(n) == next(iter(choices)) else values.get(n) for n, choices in CHOICES.items()}
    start = replace(before.start, plant=given.pop("plant"), set=tuple(known))
    joint = (values.get("joint") or "").strip()
    session.change(start=start, log=replace(before.log, columns=",".join(pairs), joint=joint, **given))
    if joint != before.log.joint:
        settle_columns(session)


# ---- the form --------------------------------------------------------------------------------------------------------


def form(session: Session) -> list[Any]:
    """The files, the settings, the preview and the button that fits a model."""
    state, (names, chosen) = session.state, columns(session)
    log = state.log
    titles = [file.name for file in log.files] or ["no file"]
    title = titles[0] if len(titles) == 1 else f"{titles[0]} to {titles[-1]} ({len(titles)} files)"
    given = vars(log) | vars(state.start)
    shown = {name: next(iter(choices)) if given[name] is None else given[name] for name, choices in CHOICES.items()}
    zero = [{"value": value, "label": label} for value, label in CHOICES["zero"].items()]
    if not isinstance(at := shown["zero"], str):
        zero.append({"value": at, "label": f"where it hangs at {at:g}"})
    of_bag = any(file.suffix in BAGS or file.is_dir() for file in log.files)
    return [
        html.P([html.Strong(state.title or "log"), f": {title}"], className="files"),
        html.Div(id="preview"),
        html.Details(
            [
                html.Summary("How it is read"),
                html.Div([_labelled(OURS[c], _choice(c, {"": "none", **{n: n for n in names if n}}, chosen.get(c, "")))
                          for c in OURS], className="fields"),
                _labelled("what moves", _choice("plant", CHOICES["plant"], shown["plant"])),
                _labelled("the command is", _choice("input", CHOICES["input"], shown["input"])),
                _labelled("angle 0 is", dcc.RadioItems(zero, shown["zero"], id="set-zero", inline=True,
                                                       className="choice")),
                dcc.Checklist(FLAGS, [name for name in FLAGS if given[name]], id="set-signs"),
                html.Div([_labelled(label, dcc.Input(id=f"set-{name}", type="number", debounce=True,
                                                     value=given[name]))
                          for name, label in NUMBERS.items()], className="fields"),
                _labelled("joint", dcc.Input(id="set-joint", value=log.joint, debounce=True), hidden=not of_bag),
                _labelled("known numbers", dcc.Input(id="set-known", value=", ".join(state.start.set),
                                                     placeholder="l=0.45, m=0.5", debounce=True)),
            ],
            open=bool(preview(session).error) or not state.nodes,
        ),
        html.Button("Begin anew with these settings" if state.nodes else "Fit a model to this log", id={"do": "fit"},
                    className="wide" if state.nodes else "main wide"),
    ]  # fmt: skip


def _labelled(label: str, control: Any, hidden: bool = False) -> html.Label:
    return html.Label([html.Span(label), control], hidden=hidden)


def _choice(name: str, choices: Mapping[str, str], value: str) -> dcc.Dropdown:
    return dcc.Dropdown(dict(choices), value, id=f"set-{name}", clearable=False, searchable=False)


# ---- the preview -----------------------------------------------------------------------------------------------------


def previewed(preview: Preview) -> list[Any]:
    """The angle and the command over time, the machine at the cursor, and what looks unlikely."""
    if preview.error or preview.log is None:
        return [html.P(preview.error, className="error", role="alert")]
    notes = [html.Li(note) for note in preview.log.notes]
    end = float(np.nanmax(preview.course[0]))
    return [
        html.Div([graph(machine_figure(preview, 0.0), id="machine"), graph(readings(preview), id="readings")],
                 className="preview"),
        html.Div(dcc.Slider(0.0, end, value=0.0, id="cursor", marks=None, step=end / 500.0, updatemode="drag",
                            allow_direct_input=False), className="cursor", **{"aria-label": "cursor along the log"}),
        html.P(str(preview.log).partition(";")[0], className="quiet"),
        *([html.Ul(notes, className="notes")] if notes else []),
    ]  # fmt: skip


def readings(preview: Preview) -> go.Figure:
    """Angle and command over time."""
    t, theta, torque = preview.course
    margin = {"l": 44, "r": 4, "t": 6, "b": 34}
    figure = figures.two_rows(230, vertical_spacing=0.08)
    figure.update_layout(margin=margin, hovermode="x", font={"size": 10})
    for row, (series, colour) in enumerate(((theta, figures.BLUE), (torque, figures.GREY)), start=1):
        x, y = figures.thinned(t, series, MOST_PREVIEWED)
        figure.add_scatter(x=x, y=y, mode="lines", line={"color": colour, "width": 1}, row=row, col=1, hoverinfo="none")
    figure.update_xaxes(title="time [s]", row=2)
    figure.update_yaxes(title=figures.axis_title("theta", preview.model.plant.quantities), row=1)
    figure.update_yaxes(title=f"command [{preview.model.command_unit}]", row=2)
    figure.add_vline(x=0.0, line={"color": figures.YELLOW, "width": 1.5})
    return figure


def machine_figure(preview: Preview, t: float) -> go.Figure:
    """The machine as the settings have it at an instant: 0 upright, angles to the right, gravity down."""
    x, y = arm(preview, t)
    figure = figures.blank(150, margin={"l": 0, "r": 0, "t": 0, "b": 0})
    figure.update_xaxes(visible=False, range=[-1.25, 1.25], fixedrange=True)
    figure.update_yaxes(visible=False, range=[-1.25, 1.25], scaleanchor="x", fixedrange=True)
    figure.add_scatter(x=x, y=y, mode="lines+markers", hoverinfo="skip", line={"color": figures.BLUE, "width": 7},
                       marker={"size": [10, 16], "color": [figures.GREY, figures.BLUE], "opacity": 1})  # fmt: skip
    if preview.model.plant.turns:
        figure.add_annotation(x=-1.1, y=-1.1, ax=-1.1, ay=-0.6, axref="x", ayref="y", text="g", showarrow=True,
                              arrowhead=2, arrowcolor=figures.GREY)  # fmt: skip
    return figure


def arm(preview: Preview, t: float) -> tuple[list[float], list[float]]:
    """Where the arm begins and ends at an instant, or where a carriage is."""
    times, angles, _ = preview.course
    known = np.flatnonzero(np.isfinite(times) & np.isfinite(angles))
    if not len(known):
        return [0.0, 0.0], [0.0, 0.0]
    theta = float(angles[known[np.argmin(np.abs(times[known] - t))]])
    if preview.model.plant.turns:
        return [0.0, math.sin(theta)], [0.0, math.cos(theta)]
    reach = float(np.nanmax(np.abs(angles))) or 1.0
    return [0.0, theta / reach], [0.0, 0.0]

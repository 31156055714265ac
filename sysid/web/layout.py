"""The page: Log | Where it fails | What is missing | Add it | Take it along."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from typing import Any

from dash import dcc, html

from sysid.cli.command_options import LogOptions, ModelOptions
from sysid.diagnosis.findings import quantity
from sysid.report.typesetting import capital, typeset_multiple
from sysid.web import figures
from sysid.web.jobs import Trainings
from sysid.web.own_effect import FUNCTIONS, VARIABLES, OwnEffect
from sysid.web.samples import SAMPLES_BY_NAME
from sysid.web.script import script
from sysid.web.session import Answer, Session, SessionState

TITLES = {"log": "Log", "fails": "Where it fails", "effects": "What is missing", "ladder": "Add it",
          "take": "Take it along"}  # fmt: skip
"""The five sections, in the order in which they are read."""
STAMPED = (*TITLES, "train")
"""What is shown anew when it changes; a training has a place of its own in the last section."""
PLACEHOLDERS = {
    "fails": "Here is shown how far a model is off, and where, once one is fitted to a log.",
    "effects": "Here stand the effects that would explain it, the best first.",
    "ladder": "Here the error falls, effect by effect, down to the noise of the sensors.",
    "take": "Here the mended model waits to be taken along.",
    "train": "",
}
FIRST = 3
"""Rows that are shown at once."""
PLOT = {"displaylogo": False, "responsive": True, "plotlyServerURL": "",
        "modeBarButtonsToRemove": ["lasso2d", "toImage", "autoScale2d", "sendChartToCloud"]}  # fmt: skip
"""What plots offer: nothing that leaves the machine."""
QUIET = {"displayModeBar": False, "responsive": True}


def graph(figure: Any, config: Mapping[str, Any] = QUIET, **more: Any) -> dcc.Graph:
    """A figure that takes the width that it is given, and the height that it wants."""
    return dcc.Graph(figure=figure, config=config, style={"height": f"{figure.layout.height}px"}, **more)


def empty_page(most: int) -> html.Div:
    """What is there before anything is known."""
    links = [html.A(title, href=f"#{part}") for part, title in TITLES.items()]
    cancel = html.Button("Cancel", id={"do": "cancel"})
    return html.Div(
        [
            dcc.Location(id="url", refresh=False),
            dcc.Interval(id="tick", interval=400, disabled=False),
            *(dcc.Store(id=f"seen-{part}") for part in STAMPED),
            dcc.Store(id="act"),
            html.Header([html.H1("gapfinder workbench"), html.Nav(links, **{"aria-label": "Sections"}),
                         html.Details([html.Summary("Sessions"), html.Div(id="sessions")], className="sessions")]),
            html.Div([html.Div(id="work", role="status"), cancel], className="work"),
            html.Main([section("log", upload(most)), section("fails"), section("effects"), section("ladder"),
                       section("take", html.Div(id="part-train"))]),
        ],
        className="page",
    )  # fmt: skip


def section(part: str, *more: Any) -> html.Section:
    """A section with its heading; what it holds comes later."""
    heading, place = html.H2(TITLES[part], id=f"head-{part}"), html.Div(id=f"part-{part}")
    return html.Section([heading, place, *more], id=part, **{"aria-labelledby": f"head-{part}"})


def nothing(part: str) -> html.P:
    """What a section shows before there is anything."""
    return html.P(PLACEHOLDERS[part], className="quiet")


def folded(summary: str, items: Sequence[Any]) -> list[Any]:
    """A list that is unfolded on a click; nothing where it is empty."""
    return [html.Details([html.Summary(summary), html.Ul([html.Li(item) for item in items])])] if items else []


# ---- where it fails --------------------------------------------------------------------------------------------------


def fails(comparison: Mapping[str, Any], series: figures.Series) -> list[Any]:
    """How far off the model is, and where."""
    channels = [c for c in ("theta", "theta_dot") if c in comparison["errors"]["1_s"]["ratios"]]
    torque = comparison["torque"]
    quantities = [n for n in ("theta", "theta_dot", "torque") if n in torque["over"]]
    first = next((q for q in torque["depends_on"] if q in quantities), quantities[0])
    called = {name: quantity(name, comparison["quantities"]) for name in (*channels, *quantities)}
    reading = dcc.RadioItems(
        {c: called[c] for c in channels}, channels[0], id="channel", inline=True, className="choice"
    )
    over = dcc.Dropdown({q: called[q] for q in quantities}, first, id="over-what", clearable=False, searchable=False)
    numbers = [
        f"{n['name']} = {n['said']} {n['unit']}".strip() + " (at its bound)" * (n["name"] in comparison["at_bound"])
        for n in comparison["parameters"]
    ]
    horizons = [name.replace("_", " ") for name in comparison["errors"]]
    ratios = [error["ratio"] for error in comparison["errors"].values()]
    plots = (
        ("Residual by state", graph(figures.state_map(comparison, series), PLOT, id="map")),
        (["Residual over ", over], graph(figures.torque_against(comparison, series, first), PLOT, id="over")),
        ("Error by horizon", graph(figures.error_bars(horizons, ratios, "predicted over"))),
    )
    return [
        html.P([html.Strong(_multiple(comparison["ratio"])), " times the sensor noise over 1 s of held-out data"],
               className="big"),
        html.P(comparison["sentence"], className="quiet"),
        html.P(f"The fitted model: {', '.join(numbers)} ({comparison['status']}).",
               className="quiet"),
        *folded("What was noted on the way", comparison["notes"]),
        html.Div(reading, role="radiogroup", **{"aria-label": "Which reading is drawn"}),
        graph(figures.residual_over_time(comparison, series, channels[0]), PLOT, id="course"),
        html.P("Drag over any plot: the same samples light up in the others. Green: what no fit has seen.",
               className="hint"),
        html.Div([html.Figure([html.Figcaption(caption), plot]) for caption, plot in plots], className="plots"),
    ]  # fmt: skip


def _multiple(ratio: float | None) -> str:
    return typeset_multiple(float("inf") if ratio is None else ratio)


# ---- what is missing -------------------------------------------------------------------------------------------------


def effects(diagnosis: Mapping[str, Any], error: float | None, live: bool) -> list[Any]:
    """The ranked effects, a row each, and what is ruled out; none can be added to a model that is not fitted yet."""
    rows = [row(effect, error, effect["effect"] in diagnosis["next"], live) for effect in diagnosis["rows"]]
    more = html.Div(rows[FIRST:], className="rows")
    together = ["these pay only together: add one, then the other"] if len(diagnosis["next"]) > 1 else []
    ruled_out = [
        [html.Code(name), f" above {size['size']:.2g} {size['unit']} of {size['parameter']}"]
        for name, size in sorted(diagnosis["ruled_out"].items())
    ]
    others = [[html.Code(o["effect"]), f" {o['formula']}  ({o['chance']})"] for o in diagnosis["others"]]
    return [
        html.P(next_sentence(diagnosis), className="summary"),
        *(html.P(capital(said) + ".", className="error") for said in diagnosis["doubts"]),
        *(html.P(capital(said) + ".", className="quiet") for said in (*together, *diagnosis["remarks"])),
        html.Div(rows[:FIRST], className="rows"),
        *([html.Details([html.Summary(f"{len(rows) - FIRST} more were fitted"), more])] if rows[FIRST:] else []),
        *folded(f"{len(ruled_out)} effects are ruled out above a size", ruled_out),
        *folded(f"{len(others)} others promise less", others),
        *folded("What this motion cannot tell apart", [", ".join(group) for group in diagnosis["not_identifiable"]]),
    ]  # fmt: skip


def next_sentence(diagnosis: Mapping[str, Any]) -> str:
    """What to do next, in a sentence."""
    names = {r["effect"]: r["words"] for r in diagnosis["rows"]}
    if diagnosis["next"]:
        return f"What pays most: {' and '.join(names.get(n, n) for n in diagnosis['next'])}."
    return capital(str(diagnosis["finding"]))


def row(effect: Mapping[str, Any], error: float | None, pays: bool, live: bool) -> html.Article:
    """An effect: what it is, how large, what it explains, and the button that adds it."""
    name, share = effect["effect"], effect["explained"]
    sizes = [
        html.Span([f"{s['name'].rpartition('.')[2]} = {s['said']} ", html.Span(s["unit"], className="unit")])
        for s in effect["sizes"]
    ]
    facts = [f"1 s error {_multiple(error)} → {_multiple(effect['error'])}", effect["chance"]]
    explained = []
    if share is not None:
        filled, said = html.Span(style={"width": f"{share:.0%}"}), {"role": "img", "aria-label": f"{share:.0%}"}
        bar = html.Span(filled, className="bar", **said)
        explained = [html.Span([bar, f"{share:.0%} of the missing torque"], className="fact share")]
    add = html.Button(
        "Add it",
        id={"do": "add", "effect": name},
        className="main" if pays else "",
        disabled=not live,
        **{"aria-label": f"Add {name}"},
    )
    return html.Article(
        [
            html.Div([html.H3([effect["words"] or name, html.Code(name)]), add], className="row-head"),
            html.Div(effect["formula"], className="formula"),
            html.Div(sizes, className="sizes"),
            html.Div([*explained, *(html.Span(fact, className="fact") for fact in facts)], className="facts"),
            *([html.P(f"This log cannot tell it from {', '.join(effect['alike'])}.", className="quiet")]
              if effect["alike"] else []),
            *([html.Details([html.Summary("Its torque through the residual", id={"do": "unfold", "effect": name}),
                             html.Div(id={"do": "picture", "effect": name})])] if effect["torque"] else []),
        ],
        className="row pays" if pays else "row",
    )  # fmt: skip


def own_effect(effect: OwnEffect, diagnosis: Mapping[str, Any], live: bool) -> list[Any]:
    """The editor of the user's own effect, open where no known one explains the rest."""
    fields = (
        ("name", "name", effect.name, "my_effect"),
        ("formula", "torque =", effect.formula, "-b * theta_dot"),
        ("shapes", "values to try", effect.shapes, "w = 0.2, 0.5; c = 3"),
    )
    hint = f"Of {', '.join(VARIABLES)} and numbers of your own, with + - * / ** and {', '.join(FUNCTIONS)}."
    return [
        html.Details(
            [
                html.Summary("Your own effect"),
                *(html.Label([html.Span(label), dcc.Input(id={"field": name}, value=value, placeholder=like,
                                                          className="code")])
                  for name, label, value, like in fields),
                html.P(hint, className="hint"),
                html.Button("Add it", id={"do": "own"}, disabled=not live, **{"aria-label": "Add your own effect"}),
            ],
            open=not diagnosis["next"] and diagnosis["verdict"] in ("unknown", "partly"),
            className="own",
        )
    ]  # fmt: skip


# ---- log -------------------------------------------------------------------------------------------------------------


def start_part() -> list[Any]:
    """Where no log is there yet: samples."""
    cards = [
        html.Button([html.Strong(s.title), html.Span(s.about)], id={"do": "sample", "name": name}, className="card")
        for name, s in SAMPLES_BY_NAME.items()
    ]
    return [
        html.P("Which physics does your simulator miss? Begin with a log of your machine, or with a sample."),
        html.Div(cards, className="cards"),
    ]


def upload(most: int) -> html.Div:
    """Where files are dropped, and what is said of those that cannot be taken."""
    about = f"CSV, JSON, Excel, Parquet, .npz, .mat, a ROS 2 bag; {most >> 20} MB at most"
    place = html.Button(["Drop log files here, or choose them", html.Small(about)])
    said = {"className": "error", "role": "alert"}
    return html.Div(
        [
            dcc.Upload(place, id="upload", multiple=True, className="upload"),
            html.P(id="upload-refusal", **said, **{"data-most": most}),
            html.P(id="upload-message", **said),
        ]
    )


# ---- add it ----------------------------------------------------------------------------------------------------------


def ladder_part(state: SessionState, errors: Sequence[float | None]) -> Any:
    """The error falling, model by model; the way back, and the other ways that were tried."""
    if state.at is None:
        return nothing("ladder")
    path = state.path(state.at)
    labels = [f"+ {node.added}" if (node := state.nodes[k]).added else "as it came" for k in path]
    others = [k for k in range(len(errors)) if k not in path]
    undo = html.Button("Undo", id={"do": "undo"}, disabled=state.nodes[state.at].undone is None)
    return [
        graph(figures.error_bars(labels, [errors[k] for k in path])),
        html.Div([undo], className="buttons"),
        *([html.P("Also tried:", className="quiet")] if others else []),
        html.Ul([html.Li(_other(state, node, errors[node])) for node in others], className="ways"),
    ]


def _other(state: SessionState, node: int, error: float | None) -> html.Button:
    """Another model of the history, to go there: what was added on the way, and what of its settings is otherwise."""
    name = " + ".join(["", *state.added(node)]).strip() or "as it came"
    here, there = (vars(s.log) | vars(s.start) for s in (state.settings_of(state.at or 0), state.settings_of(node)))
    usual = vars(LogOptions()) | vars(ModelOptions())
    changed = (k for k in here if here[k] != there[k])
    said = ", ".join(f"{k} {'as usual' if there[k] == usual[k] else there[k]}" for k in changed)
    label, small = f"{name} ({said})" if said else name, "" if error is None else f"error {_multiple(error)}"
    return html.Button([label, html.Small(small)], id={"do": "go", "node": node})


# ---- take it along ---------------------------------------------------------------------------------------------------

DOWNLOADS = {
    Answer.MODEL: ("application/json", "the model, for policies and everything else"),
    Answer.REPORT: ("text/html", "one page that opens offline"),
    Answer.OWN_EFFECTS: ("text/x-python", "your own effects, which the model needs: --effects own_effects.py"),
    Answer.MJCF: ("text/xml", "for MuJoCo"),
    Answer.URDF: ("text/xml", "for ROS"),
    Answer.NEXT: ("text/csv", "what the rig plays next"),
}
"""The answers that can be downloaded: what they are to a browser, and what they are for."""


def take_part(session: Session) -> Any:
    """Links to the model and the report, the next experiment, and the lines that repeat every click."""
    at = session.state.at
    if at is None or not session.has(at, Answer.MODEL):
        return nothing("take")
    exported, planned = session.read(at, Answer.EXPORTED) or {}, session.read(at, Answer.PLANNED)
    links: list[Any] = []
    for file in DOWNLOADS:
        links += _link(session, at, file)
        links += folded(f"{file} cannot say all of it", exported.get(file, ()))
    said = [] if planned is None else planned["sentence"].splitlines()
    plan = folded("What the experiment is for", said) or [html.Button("Plan the next experiment", id={"do": "plan"})]
    return [html.Div(links, className="links"), *plan, *_lines(session, at)]


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
    lines = script(state, begun, at, [effect.source() for effect in state.own_effects(at)])
    copied = [dcc.Clipboard(target_id="lines", className="copy"), html.Pre(lines, id="lines")]
    return [html.Details([html.Summary("The same in Python"), *copied])]


def training_part(session: Session, trainings: Trainings) -> Any:
    """Train a policy on the model that is looked at, and what the training says: its curve, and the optimum."""
    at = session.state.at
    comparison = session.read(at, Answer.FAILS)
    if at is None or comparison is None:
        return ""
    if refusal := _no_policy(comparison):
        return html.P(refusal, className="quiet")
    running, said = trainings.running(session) is not None, session.of(at) / Answer.TRAINING
    u_max = dcc.Input(id={"field": "u_max"}, type="number", value=_limit(comparison), min=0)
    button = html.Button("Stop", id={"do": "untrain"}) if running else html.Button("Train", id={"do": "train"})
    label = f"commands up to [{comparison['command_unit']}]"
    return [
        html.H3("A policy for this model"),
        html.Div([html.Label([html.Span(label), u_max]), button], className="field"),
        *([html.Pre(said.read_text(errors="replace"))] if said.is_file() else []),
    ]


def _no_policy(comparison: Mapping[str, Any]) -> str:
    """Why no policy can be trained on a model; empty where one can."""
    if not comparison["turns"]:
        return "A policy swings something up: this model is a linear axis, which does not swing."
    if comparison["at_angle"]:
        return (
            "A policy commands a torque, a current or a voltage: this model is driven by a servo that is told angles."
        )
    return "" if find_spec("policies") else "A policy can be trained here where the package policies is installed."


def _limit(comparison: Mapping[str, Any]) -> float:
    """The largest command of the log; 1 where that is a free swing."""
    return float(f"{comparison['u_max']:.3g}") or 1.0


# ---- sessions --------------------------------------------------------------------------------------------------------


def sessions(known: Sequence[tuple[str, str]], now: str | None) -> list[Any]:
    """The sessions to choose from, and a new one."""
    rename = [
        html.Div([html.Label([html.Span("name"), dcc.Input(id={"field": "title"}, value=title)]),
                  html.Button("Rename", id={"do": "rename"})], className="field")
        for identifier, title in known if identifier == now
    ]  # fmt: skip
    new = html.Li(html.A("a new log", href="/"))
    return [*rename, html.Ul([new, *(html.Li(_session(*entry, now)) for entry in known)])]


def _session(identifier: str, title: str, now: str | None) -> list[Any]:
    here = {"aria-current": "page"} if identifier == now else {}
    delete = html.Button("Delete", **{"aria-label": f"Delete {title}"})
    asked = f"Delete the session {title!r} with all its models? Log files that were not dropped here stay."
    return [
        html.A(title or identifier, href=f"?session={identifier}", **here),
        dcc.ConfirmDialogProvider(delete, id={"do": "delete", "session": identifier}, message=asked),
    ]

"""The page: Log | Where it fails | What is missing | Add it | Take it along."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from dash import dcc, html

from sysid.diagnosis.findings import quantity, spaced_unit
from sysid.report.typesetting import typeset_multiple
from sysid.web import figures
from sysid.web.own_effect import FUNCTIONS, VARIABLES, OwnEffect
from sysid.web.samples import SAMPLES_BY_NAME
from sysid.web.session import SessionState

PARTS = ("log", "fails", "effects", "ladder", "take")
"""The five sections, in the order in which they are read."""
STAMPED = (*PARTS, "train")
"""What is shown anew when it changes; a training has a place of its own in the last section."""
TITLES = {
    "log": "Log",
    "fails": "Where it fails",
    "effects": "What is missing",
    "ladder": "Add it",
    "take": "Take it along",
}
FIRST = 3
"""Rows that are shown at once."""
PLOT = {"displaylogo": False, "responsive": True, "modeBarButtonsToRemove": ["lasso2d", "toImage", "autoScale2d"]}
QUIET = {"displayModeBar": False, "responsive": True}


def graph(figure: Any, config: Mapping[str, Any] = QUIET, **more: Any) -> dcc.Graph:
    """A figure that takes the width that it is given, and the height that it wants."""
    return dcc.Graph(figure=figure, config=config, style={"height": f"{figure.layout.height}px"}, **more)


def empty_page() -> html.Div:
    """What is there before anything is known."""
    return html.Div(
        [
            dcc.Location(id="url", refresh=False),
            dcc.Interval(id="tick", interval=400, disabled=False),
            *(dcc.Store(id=f"seen-{part}") for part in STAMPED),
            dcc.Store(id="act"),
            html.Header(
                [
                    html.H1("gapfinder workbench"),
                    html.Nav([html.A(TITLES[p], href=f"#{p}") for p in PARTS], **{"aria-label": "Sections"}),
                    html.Div(id="sessions", className="sessions"),
                ]
            ),
            html.Div(
                [html.Div(id="work", role="status"), html.Button("Cancel", id={"do": "cancel"})], className="work"
            ),
            html.Main([section(p) for p in PARTS]),
        ],
        className="page",
    )


def section(part: str) -> html.Section:
    """A section with its heading; what it holds comes later."""
    return html.Section(
        [
            html.H2(TITLES[part], id=f"head-{part}"),
            html.Div(id=f"part-{part}"),
            *([html.Div(id="part-train")] if part == PARTS[-1] else []),
        ],
        id=part,
        **{"aria-labelledby": f"head-{part}"},
    )


# ---- where it fails --------------------------------------------------------------------------------------------------


def fails(found: Mapping[str, Any] | None, series: figures.Series | None) -> Any:
    """How far off the model is, and where."""
    if found is None or series is None:
        return html.P("A model is fitted to the log first; then it shows here where that fails.", className="quiet")
    channels = [c for c in ("theta", "theta_dot") if c in found["errors"]["1_s"]["ratios"]]
    torque = found["torque"]
    quantities = [n for n in ("theta", "theta_dot", "torque") if n in torque["over"]]
    first = next((q for q in torque["depends_on"] if q in quantities), quantities[0])
    return [
        html.P([html.Strong(_multiple(found["ratio"])), " times the sensor noise over 1 s of held-out data"],
               className="big"),
        html.P(found["sentence"], className="quiet"),
        html.P(f"The fitted model: {_fitted_numbers(found['parameters'])}", className="quiet"),
        *([html.Details([html.Summary("What was noted on the way"), html.Ul([html.Li(n) for n in found["notes"]])])]
          if found["notes"] else []),
        html.Div(
            dcc.RadioItems(
                [{"label": quantity(c, found["quantities"]), "value": c} for c in channels],
                channels[0], id="channel", inline=True, className="choice",
            ),
            role="radiogroup", **{"aria-label": "Which reading is drawn"},
        ),
        graph(figures.residual_over_time(found, series, channels[0]), PLOT, id="course"),
        html.P("Drag over any plot: the same samples light up in the others. Green: what no fit has seen.",
               className="hint"),
        html.Div(
            [
                html.Figure([html.Figcaption("Residual by state"),
                             graph(figures.state_map(found, series), PLOT, id="map")]),
                html.Figure([
                    html.Figcaption(["Residual over ", dcc.Dropdown(
                        [{"label": quantity(q, found["quantities"]), "value": q} for q in quantities], first,
                        id="over-what", clearable=False, searchable=False)]),
                    graph(figures.torque_against(found, series, first), PLOT, id="over")]),
                html.Figure([html.Figcaption("Error by horizon"),
                             graph(figures.horizon_figure(found))]),
            ],
            className="plots",
        ),
    ]  # fmt: skip


def _fitted_numbers(parameters: Sequence[Mapping[str, Any]]) -> str:
    """The numbers with their standard deviations and units."""
    return ", ".join(
        f"{p['name']} = {p['said']}{spaced_unit(p['unit'])}{' (at its bound)' * p['at_bound']}" for p in parameters
    )


def _multiple(ratio: float | None) -> str:
    return typeset_multiple(float("inf") if ratio is None else ratio)


# ---- what is missing -------------------------------------------------------------------------------------------------


def effects(found: Mapping[str, Any] | None, error: float | None) -> list[Any]:
    """The ranked effects, a row each, and what is ruled out."""
    if found is None:
        return [html.P("The effects of the catalogue are ranked once the model is fitted.", className="quiet")]
    rows = [row(own, error, own["effect"] in found["next"]) for own in found["rows"]]
    return [html.P(next_sentence(found), className="summary"),
            *(html.P(_capital(said) + ".", className="error") for said in found["doubts"]),
            *([_together(found)] if len(found["next"]) > 1 else []),
            *(html.P(_capital(said) + ".", className="quiet") for said in found["remarks"]),
            html.Div(rows[:FIRST], className="rows"), *_tried(rows[FIRST:]), *_others(found)]  # fmt: skip


def _capital(sentence: str) -> str:
    return sentence[:1].upper() + sentence[1:]


def next_sentence(found: Mapping[str, Any]) -> str:
    """What to do next, in a sentence."""
    names = {r["effect"]: r["words"] for r in found["rows"]}
    if found["next"]:
        said = " and ".join(names.get(n, n) for n in found["next"])
        return f"What pays most: {said}."
    return _capital(str(found["finding"]))


def _together(found: Mapping[str, Any]) -> html.P:
    return html.P("These pay only together: add one, then the other.", className="quiet")


def row(own: Mapping[str, Any], error: float | None, pays: bool) -> html.Article:
    """An effect: what it is, how large, what it explains, and the button that adds it."""
    name = own["effect"]
    sizes = [html.Span([f"{s['name']} = {s['said']} ", html.Span(s["unit"], className="unit")]) for s in own["sizes"]]
    facts = [_share(own["explained"]), _fall(error, own["error"]), html.Span(own["chance"], className="fact")]
    return html.Article(
        [
            html.Div(
                [
                    html.H3([own["words"] or name, html.Code(name)]),
                    html.Button("Add it", id={"do": "add", "effect": name}, className="main" if pays else "",
                                **{"aria-label": f"Add {name}"}),
                ],
                className="row-head",
            ),
            html.Div(own["formula"], className="formula"),
            html.Div(sizes, className="sizes"),
            html.Div(facts, className="facts"),
            *([html.P(f"This log cannot tell it from {', '.join(own['alike'])}.", className="quiet")]
              if own["alike"] else []),
            *([html.Details([html.Summary("Its torque through the residual", id={"do": "unfold", "effect": name}),
                             html.Div(id={"do": "picture", "effect": name})])] if own["torque"] else []),
        ],
        className="row pays" if pays else "row",
    )  # fmt: skip


def _share(share: float | None) -> html.Span:
    if share is None:
        return html.Span("")
    return html.Span(
        [
            html.Span(html.Span(style={"width": f"{100 * share:.0f}%"}), className="bar", role="img",
                      **{"aria-label": f"{share:.0%}"}),
            f"{share:.0%} of the missing torque",
        ],
        className="fact share",
    )  # fmt: skip


def _fall(before: float | None, after: float | None) -> html.Span:
    return html.Span(f"1 s error {_multiple(before)} → {_multiple(after)}", className="fact")


def _tried(rows: Sequence[Any]) -> list[Any]:
    if not rows:
        return []
    return [html.Details([html.Summary(f"{len(rows)} more were fitted"), html.Div(rows, className="rows")])]


def _others(found: Mapping[str, Any]) -> list[Any]:
    parts = []
    if found["ruled_out"]:
        said = [
            html.Li([html.Code(name), f" above {size['size']:.2g} {size['unit']} of {size['parameter']}"])
            for name, size in sorted(found["ruled_out"].items())
        ]
        parts.append(html.Details([html.Summary(f"{len(said)} effects are ruled out above a size"), html.Ul(said)]))
    if found["others"]:
        said = [html.Li([html.Code(o["effect"]), f" {o['formula']}  ({o['chance']})"]) for o in found["others"]]
        parts.append(html.Details([html.Summary(f"{len(said)} others promise less"), html.Ul(said)]))
    groups = [html.Li(", ".join(group)) for group in found["not_identifiable"]]
    if groups:
        parts.append(html.Details([html.Summary("What this motion cannot tell apart"), html.Ul(groups)]))
    return parts


def own_effect(own: OwnEffect, found: Mapping[str, Any]) -> list[Any]:
    """The editor of the user's own effect, open where no known one explains the rest."""
    fields = (
        ("own-name", "name", own.name, "my_effect"),
        ("own-formula", "torque =", own.formula, "-b * theta_dot"),
        ("own-shapes", "values to try", own.shapes, "w = 0.2, 0.5; c = 3"),
    )
    hint = f"Of {', '.join(VARIABLES)} and numbers of your own, with + - * / ** and {', '.join(FUNCTIONS)}."
    return [
        html.Details(
            [
                html.Summary("Your own effect"),
                *(
                    html.Label([html.Span(label), dcc.Input(id=k, value=v, placeholder=like, className="code")])
                    for k, label, v, like in fields
                ),
                html.P(hint, className="hint"),
                html.Button("Try it", id="own-try"),
                html.P(id="own-message", className="error", role="alert"),
            ],
            open=not found["next"] and found["verdict"] in ("unknown", "partly"),
            className="own",
        )
    ]


# ---- log -------------------------------------------------------------------------------------------------------------


def start_part(most: int) -> list[Any]:
    """Where no log is there yet: samples, and a place for files."""
    return [
        html.P("Which physics does your simulator miss? Begin with a log of your machine, or with a sample."),
        html.Div(
            [
                html.Button(
                    [html.Strong(s.title), html.Span(s.about)], id={"do": "sample", "name": name}, className="card"
                )
                for name, s in SAMPLES_BY_NAME.items()
            ],
            className="cards",
        ),
        upload(most),
    ]


def upload(most: int) -> html.Div:
    """Where files are dropped, and what is said of those that cannot be taken."""
    about = f"CSV, Parquet, .npz, .mat, a ROS 2 bag; {most >> 20} MB at most"
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


def ladder_part(state: SessionState, history: Sequence[Mapping[str, Any]]) -> Any:
    """The error falling, model by model; the way back, and the other ways that were tried."""
    if not history or state.at is None:
        return part("ladder")

    def way(node: int) -> list[tuple[str, float | None]]:
        return [(history[k]["label"], history[k]["error"]) for k in state.path(node)]

    ends = [state.at] if state.beside is None else [state.at, state.beside]
    names = ["this model", *(_ways_name(state, node) for node in ends[1:])]
    others = [own for own in history if own["node"] not in state.path(state.at)]
    return [
        graph(figures.error_ladder([(name, way(node)) for name, node in zip(names, ends, strict=True)])),
        html.Div([html.Button("Undo", id={"do": "undo"}, disabled=len(way(state.at)) < 2)], className="buttons"),
        *([html.P("Also tried:", className="quiet")] if others else []),
        html.Ul([html.Li(_other(state, own)) for own in others], className="ways"),
    ]


def _other(state: SessionState, own: Mapping[str, Any]) -> list[Any]:
    """Another model of the history: go there, or hold it beside the one that is looked at."""
    error = "" if own["error"] is None else f"error {_multiple(own['error'])}"
    label, beside = _ways_name(state, own["node"]), state.beside == own["node"]
    return [
        html.Button([label, html.Small(error)], id={"do": "go", "node": own["node"]}),
        html.Button("Stop comparing" if beside else "Compare", id={"do": "beside", "node": own["node"]},
                    **{"aria-label": f"compare with {label}"}),
    ]  # fmt: skip


def _ways_name(state: SessionState, node: int) -> str:
    return " + ".join(["", *state.added(node)]).strip() or "as it came"


def part(name: str) -> Any:
    """What a section shows before there is anything."""
    said = {
        "fails": "Here is shown how far a model is off, and where.",
        "effects": "Here stand the effects that would explain it, the best first.",
        "ladder": "Here the error falls, effect by effect, down to the noise of the sensors.",
        "train": "",
        "take": "Here the mended model waits to be taken along.",
    }
    return html.P(said[name], className="quiet")


def sessions(known: Sequence[tuple[str, str]], now: str | None) -> list[Any]:
    """The sessions to choose from, and a new one."""
    links = [html.Li(html.A(title or identifier, href=f"?session={identifier}",
                            **({"aria-current": "page"} if identifier == now else {})))
             for identifier, title in known[:12]]  # fmt: skip
    return [html.Details([html.Summary("Sessions"), html.Ul([html.Li(html.A("a new log", href="/")), *links])])]

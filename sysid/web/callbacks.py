"""What clicks do: plain functions, and how they are joined to the page."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any
from urllib.parse import parse_qs

import numpy as np
from dash import ALL, MATCH, Dash, Input, Output, Patch, State, ctx, html, no_update

from sysid.errors import InvalidInput
from sysid.web import figures, layout, log_part
from sysid.web.bench import Workbench
from sysid.web.layout import STAMPED
from sysid.web.log_part import SETTINGS, preview
from sysid.web.session import Answer, Session

BUSY_INTERVAL = 400
"""How often [ms] the page asks what is new while something is under way."""
IDLE_INTERVAL = 3_000
"""How often [ms] it asks else."""


def region_of(plot: str, chosen: Mapping[str, Any] | None, over: str) -> dict[str, tuple[float, float]]:
    """The ranges of quantities that a selection in a plot means."""
    ranges = (chosen or {}).get("range") or {}
    x = next((v for k, v in ranges.items() if k.startswith("x")), None)
    y = next((v for k, v in ranges.items() if k.startswith("y")), None)
    if x is None:
        return {}
    if plot == "course":
        return {"t": (x[0], x[1])}
    other = {"map": ("theta", "theta_dot"), "over": (over, "residual_torque")}[plot]
    return {other[0]: (x[0], x[1])} | ({other[1]: (y[0], y[1])} if y is not None else {})


def session_name(search: str | None) -> str | None:
    """The session that an address names."""
    return next(iter(parse_qs((search or "").lstrip("?")).get("session", [])), None)


def pressed_button() -> Mapping[str, Any] | None:
    """The button that was pressed; the same request may tell of buttons that were just drawn, which have no click."""
    clicks = {trigger["prop_id"]: trigger["value"] for trigger in ctx.triggered}
    return next((button for name, button in ctx.triggered_prop_ids.items() if clicks[name]), None)


def zoomed(s: figures.Series, channel: str, moved: Mapping[str, Any] | None) -> Patch | None:
    """The course in a stretch of time, thinned anew; None where nothing was moved along the time."""
    moved = moved or {}
    ends = [moved.get(f"xaxis.range[{k}]", moved.get(f"xaxis2.range[{k}]")) for k in (0, 1)]
    whole = any(k.endswith(".autorange") for k in moved)
    if None in ends and not whole:
        return None
    begin, end = (-np.inf, np.inf) if whole else (float(ends[0]), float(ends[1]))
    patch = Patch()
    for k, line in enumerate(figures.course_lines(s, channel, begin, end)):
        patch["data"][k]["x"], patch["data"][k]["y"] = line["x"], line["y"]
    return patch


def effect_picture(session: Session, effect: str) -> Any:
    """The residual torque over what an effect acts on, with the effect's curve through it."""
    at = session.shown(Answer.EFFECTS)
    comparison, known = session.read(at, Answer.FAILS), session.read(at, Answer.EFFECTS)
    if comparison is None or known is None or at is None:
        return figures.blank(200)
    s = figures.series(session.of(at) / Answer.SERIES)
    curve = next(r["torque"] for r in known["rows"] if r["effect"] == effect)
    if curve["over"] == "time":
        return figures.torque_over_time(comparison, s, curve)
    return figures.torque_against(comparison, s, curve["over"], curve)


# ---- joined to the page ----------------------------------------------------------------------------------------------


class PageCallbacks:
    """The callbacks of the page; `search` is the address behind its question mark."""

    def __init__(self, bench: Workbench) -> None:
        self.bench = bench

    def session(self, search: str | None) -> Session | None:
        """The session that an address names."""
        return self.bench.sessions.find(session_name(search))

    def look(self, _: Any, search: str | None, __: Any, *seen: str | None) -> list[Any]:
        """What is new: stamps of the parts, what is under way, and when to ask again."""
        session, name = self.session(search), session_name(search)
        if session is not None:
            self.bench.resume(session)
        now, stamps = self.bench.work(session), self.bench.stamps(session)
        if session is None and name:
            now = html.P(self.bench.sessions.refusal(name), className="error")
        new = [no_update if stamps[p] == s else stamps[p] for p, s in zip(STAMPED, seen, strict=True)]
        return [*new, now, BUSY_INTERVAL if session is not None and self.bench.busy(session) else IDLE_INTERVAL]

    def part(self, name: str, _: Any, search: str | None) -> Any:
        return self.bench.part(name, self.session(search))

    def act(self, *given: Any) -> tuple[Any, Any]:
        """A button was pressed; what cannot be done is said where work is shown."""
        clicked, session = pressed_button(), self.session(given[-1])
        if clicked is None:
            return no_update, no_update
        fields = {state["id"]["field"]: state.get("value") for state in ctx.states_list[0]}
        try:
            shown = self.bench.do(session, clicked, fields)
        except InvalidInput as error:
            shown = session
            if session is not None:
                self.bench.messages[session.identifier] = str(error)
        address = no_update if shown == session else f"?session={shown.identifier}" if shown else "?"
        return f"{clicked} {time.time()}", address

    def unfold(self, clicks: int | None, search: str | None) -> Any:
        """A row shows its picture."""
        session = self.session(search)
        if not clicks or session is None:
            return no_update
        return layout.graph(effect_picture(session, ctx.triggered_id["effect"]))

    def point(
        self, course: Any, states: Any, over: Any, moved: Any, channel: str, what: str, search: str | None
    ) -> list[Any]:
        """A region was selected, the time was zoomed, or another quantity was chosen."""
        session, by = self.session(search), ctx.triggered_id
        at = None if session is None else session.shown(Answer.FAILS)
        if session is None or at is None:
            return [no_update] * 3
        comparison, s = session.read(at, Answer.FAILS), figures.series(session.of(at) / Answer.SERIES)
        if by == "channel":
            return [figures.residual_over_time(comparison, s, channel), no_update, no_update]
        if by == "over-what":
            return [no_update, no_update, figures.torque_against(comparison, s, what)]
        if ctx.triggered[0]["prop_id"].endswith("relayoutData"):
            patch = zoomed(s, channel, moved)
            return [no_update if patch is None else patch, no_update, no_update]
        chosen = {"course": course, "map": states, "over": over}[by]
        return self.bench.marked(session, region_of(by, chosen, what), channel, what)

    def settings(self, *given: Any) -> Any:
        """How the log is read was changed, or is shown for the first time."""
        *values, search = given
        session = self.session(search)
        if session is None:
            return no_update
        if ctx.triggered_id is not None:
            log_part.change(session, dict(zip(SETTINGS, values, strict=True)))
        return log_part.previewed(preview(session))

    def move(self, at: float | None, hovered: Any, search: str | None) -> tuple[Any, Any]:
        """The cursor moves along the log, and the machine with it."""
        session = self.session(search)
        if session is None:
            return no_update, no_update
        if ctx.triggered_id == "readings" and hovered:
            at = float(hovered["points"][0]["x"])
        arm, line = Patch(), Patch()
        arm["data"][0]["x"], arm["data"][0]["y"] = log_part.arm(preview(session), at or 0.0)
        for shape in range(2):
            line["layout"]["shapes"][shape]["x0"] = line["layout"]["shapes"][shape]["x1"] = at
        return arm, line

    def drop(self, contents: Sequence[str] | None, titles: Sequence[str] | None) -> tuple[Any, Any]:
        if not contents or not titles:
            return no_update, no_update
        try:
            return f"?session={self.bench.upload(titles, contents).identifier}", ""
        except InvalidInput as error:
            return no_update, str(error)

    def choose(self, search: str | None, _: Any) -> Any:
        """The sessions to choose from."""
        return layout.sessions([(s.identifier, s.state.title) for s in self.bench.sessions.all()], session_name(search))


def join(app: Dash, bench: Workbench) -> None:
    """Register all callbacks of the page."""
    page, url, once = PageCallbacks(bench), State("url", "search"), {"prevent_initial_call": True}
    stamps, seen = ([kind(f"seen-{p}", "data") for p in STAMPED] for kind in (Output, State))
    now = [Input("tick", "n_intervals"), Input("url", "search"), Input("act", "data")]
    app.callback([*stamps, Output("work", "children"), Output("tick", "interval")], now, seen)(page.look)
    for part in STAMPED:
        app.callback(Output(f"part-{part}", "children"), Input(f"seen-{part}", "data"), url)(partial(page.part, part))
    buttons = [Input({"do": ALL, **more}, "n_clicks") for more in ({}, {"effect": ALL}, {"name": ALL}, {"node": ALL})]
    buttons += [Input({"do": ALL, "session": ALL}, "submit_n_clicks")]
    fields = State({"field": ALL}, "value")
    app.callback([Output("act", "data"), Output("url", "search")], buttons, fields, url, **once)(page.act)
    unfolded, picture = {"do": "unfold", "effect": MATCH}, {"do": "picture", "effect": MATCH}
    app.callback(Output(picture, "children"), Input(unfolded, "n_clicks"), url, **once)(page.unfold)
    plots = ("course", "map", "over")
    chosen = [*(Input(p, "selectedData") for p in plots), Input("course", "relayoutData")]
    chosen += [Input("channel", "value"), Input("over-what", "value")]
    app.callback([Output(p, "figure") for p in plots], chosen, url, **once)(page.point)
    app.callback(Output("preview", "children"), [Input(f"set-{s}", "value") for s in SETTINGS], url)(page.settings)
    cursor = [Input("cursor", "value"), Input("readings", "hoverData")]
    app.callback([Output("machine", "figure"), Output("readings", "figure")], cursor, url, **once)(page.move)
    dropped = [Output("url", "search", allow_duplicate=True), Output("upload-message", "children")]
    files = [Input("upload", "contents"), State("upload", "filename")]
    app.callback(dropped, files, **once)(page.drop)
    app.callback(Output("sessions", "children"), Input("url", "search"), Input("act", "data"))(page.choose)

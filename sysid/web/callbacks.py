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
from sysid.web.log_part import OURS, preview
from sysid.web.own_effect import OwnEffect
from sysid.web.session import EFFECTS, FAILS, SERIES, Session

SETTINGS = (
    *(f"set-{c}" for c in OURS),
    "set-plant",
    "set-input",
    "set-zero",
    "set-signs",
    "set-begin",
    "set-end",
    "set-known",
)
"""The controls of the form, in the order in which they are handed over."""
QUICK, SLOW = 400, 3_000
"""How often [ms] the page asks what is new, while something is under way and else."""


def region_of(plot: str, chosen: Mapping[str, Any] | None, over: str) -> dict[str, tuple[float, float]]:
    """The ranges of quantities that a selection in a plot means."""
    found = (chosen or {}).get("range") or {}
    x = next((v for k, v in found.items() if k.startswith("x")), None)
    y = next((v for k, v in found.items() if k.startswith("y")), None)
    if x is None:
        return {}
    if plot == "course":
        return {"t": (x[0], x[1])}
    other = {"map": ("theta", "theta_dot"), "over": (over, "d")}[plot]
    return {other[0]: (x[0], x[1])} | ({other[1]: (y[0], y[1])} if y is not None else {})


def session_name(search: str | None) -> str | None:
    """The session that an address names."""
    return next(iter(parse_qs((search or "").lstrip("?")).get("session", [])), None)


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


def do(bench: Workbench, own: Session | None, clicked: Mapping[str, Any]) -> Session | None:
    """What a button asks for; a new session, where it made one."""
    with bench.sessions.lock:
        if clicked["do"] == "sample":
            return bench.sample(clicked["name"])
        if own is None:
            return None
        if clicked["do"] == "add":
            bench.add(own, clicked["effect"])
        elif clicked["do"] in ("go", "beside"):
            {"go": bench.go, "beside": bench.beside}[clicked["do"]](own, clicked["node"])
        else:
            simple = {"fit": bench.fit, "undo": bench.undo, "cancel": bench.cancel, "plan": bench.plan,
                      "untrain": bench.trainings.cancel}  # fmt: skip
            simple.get(clicked["do"], lambda _: None)(own)
    return None


def effect_picture(session: Session, effect: str) -> Any:
    """The residual torque over what an effect acts on, with the effect's curve through it."""
    at = session.state.at
    found, known = session.read(at, FAILS), session.read(at, EFFECTS)
    if found is None or known is None or at is None:
        return figures.empty("not known yet")
    s, curve = (
        figures.series(session.of(at) / SERIES),
        next(r["torque"] for r in known["rows"] if r["effect"] == effect),
    )
    if curve["over"] == "time":
        return figures.torque_over_time(found, s, curve)
    return figures.torque_against(found, s, curve["over"], curve)


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
        own = self.session(search)
        now, stamps = self.bench.work(own), self.bench.stamps(own)
        new = [no_update if stamps[p] == s else stamps[p] for p, s in zip(STAMPED, seen, strict=True)]
        return [*new, now, QUICK if own is not None and self.bench.busy(own) else SLOW]

    def part(self, name: str, search: str | None) -> Any:
        """A section anew."""
        return self.bench.part(name, self.session(search))

    def act(self, *given: Any) -> tuple[Any, Any]:
        """A button was pressed."""
        clicked = ctx.triggered_id
        if not any(own["value"] for own in ctx.triggered) or not isinstance(clicked, dict):
            return no_update, no_update
        made = do(self.bench, self.session(given[-1]), clicked)
        return f"{clicked} {time.time()}", f"?session={made.identifier}" if made else no_update

    def unfold(self, clicks: int | None, search: str | None) -> Any:
        """A row shows its picture."""
        own = self.session(search)
        if not clicks or own is None:
            return no_update
        return layout.graph(effect_picture(own, ctx.triggered_id["effect"]))

    def point(
        self, course: Any, states: Any, over: Any, moved: Any, channel: str, what: str, search: str | None
    ) -> list[Any]:
        """A region was selected, the time was zoomed, or another quantity was chosen."""
        own, by = self.session(search), ctx.triggered_id
        at = None if own is None else own.state.at
        if own is None or at is None or not (own.of(at) / FAILS).is_file():
            return [no_update] * 3
        found, s = own.read(at, FAILS), figures.series(own.of(at) / SERIES)
        if by == "channel":
            return [figures.residual_over_time(found, s, channel), no_update, no_update]
        if by == "over-what":
            return [no_update, no_update, figures.torque_against(found, s, what)]
        if ctx.triggered[0]["prop_id"].endswith("relayoutData"):
            patch = zoomed(s, channel, moved)
            return [no_update if patch is None else patch, no_update, no_update]
        chosen = {"course": course, "map": states, "over": over}[by]
        return self.bench.marked(own, region_of(by, chosen, what), channel, what)

    def settings(self, *given: Any) -> Any:
        """How the log is read was changed, or is shown for the first time."""
        *values, search = given
        own = self.session(search)
        if own is None:
            return no_update
        if ctx.triggered_id is not None:
            named = dict(zip((s.removeprefix("set-") for s in SETTINGS), values, strict=True))
            try:
                own.save(log_part.changed(own.state, named, log_part.columns(own)[1]))
            except InvalidInput as error:
                return html.P(str(error), className="error", role="alert")
        return log_part.previewed(preview(own))

    def move(self, at: float | None, hovered: Any, search: str | None) -> tuple[Any, Any]:
        """The cursor moves along the log, and the machine with it."""
        own = self.session(search)
        if own is None:
            return no_update, no_update
        if ctx.triggered_id == "readings" and hovered:
            at = float(hovered["points"][0]["x"])
        arm, line = Patch(), Patch()
        arm["data"][0]["x"], arm["data"][0]["y"] = log_part.arm(preview(own), at or 0.0)
        for shape in range(2):
            line["layout"]["shapes"][shape]["x0"] = line["layout"]["shapes"][shape]["x1"] = at
        return arm, line

    def drop(self, contents: Sequence[str] | None, titles: Sequence[str] | None) -> tuple[Any, Any]:
        """Files were dropped."""
        if not contents or not titles:
            return no_update, no_update
        try:
            return f"?session={self.bench.upload(titles, contents).identifier}", ""
        except InvalidInput as error:
            return no_update, str(error)

    def train(self, clicks: int | None, u_max: Any, search: str | None) -> tuple[Any, str]:
        """A training begins."""
        own = self.session(search)
        if not clicks or own is None or own.state.at is None:
            return no_update, ""
        try:
            self.bench.trainings.begin(own, own.state.at, float(u_max or 0.0))
        except (InvalidInput, ValueError) as error:
            return no_update, str(error)
        return f"train {time.time()}", ""

    def own(self, clicks: int | None, name: str, formula: str, shapes: str, search: str | None) -> tuple[Any, str]:
        """The user's own effect is tried."""
        own = self.session(search)
        if not clicks or own is None:
            return no_update, ""
        try:
            self.bench.try_own(own, OwnEffect((name or "").strip(), formula or "", shapes or ""))
        except InvalidInput as error:
            return no_update, str(error)
        return f"own {time.time()}", ""

    def choose(self, search: str | None) -> Any:
        """The sessions to choose from."""
        return layout.sessions([(s.identifier, s.state.title) for s in self.bench.sessions.all()], session_name(search))


def join(app: Dash, bench: Workbench) -> None:
    """Register all callbacks of the page."""
    page, url, once = PageCallbacks(bench), State("url", "search"), {"prevent_initial_call": True}
    stamps = [Output(f"seen-{p}", "data") for p in STAMPED]
    seen = [State(f"seen-{p}", "data") for p in STAMPED]
    now = [Input("tick", "n_intervals"), Input("url", "search"), Input("act", "data")]
    app.callback([*stamps, Output("work", "children"), Output("tick", "interval")], now, seen)(page.look)
    for part in STAMPED:
        show = partial(_part, page, part)
        app.callback(Output(f"part-{part}", "children"), Input(f"seen-{part}", "data"), url)(show)
    buttons = [Input({"do": ALL, **more}, "n_clicks") for more in ({}, {"effect": ALL}, {"name": ALL}, {"node": ALL})]
    app.callback([Output("act", "data"), Output("url", "search")], buttons, url, **once)(page.act)
    unfolded, picture = {"do": "unfold", "effect": MATCH}, {"do": "picture", "effect": MATCH}
    app.callback(Output(picture, "children"), Input(unfolded, "n_clicks"), url, **once)(page.unfold)
    plots = ("course", "map", "over")
    chosen = [*(Input(p, "selectedData") for p in plots), Input("course", "relayoutData")]
    chosen += [Input("channel", "value"), Input("over-what", "value")]
    app.callback([Output(p, "figure") for p in plots], chosen, url, **once)(page.point)
    app.callback(Output("preview", "children"), [Input(s, "value") for s in SETTINGS], url)(page.settings)
    cursor = [Input("cursor", "value"), Input("readings", "hoverData")]
    app.callback([Output("machine", "figure"), Output("readings", "figure")], cursor, url, **once)(page.move)
    dropped = [Output("url", "search", allow_duplicate=True), Output("upload-message", "children")]
    files = [Input("upload", "contents"), State("upload", "filename")]
    app.callback(dropped, files, **once)(page.drop)
    wrote = [State(f"own-{k}", "value") for k in ("name", "formula", "shapes")]
    tried = [Output("act", "data", allow_duplicate=True), Output("own-message", "children")]
    app.callback(tried, Input("own-try", "n_clicks"), [*wrote, url], **once)(page.own)
    begun = [Output("act", "data", allow_duplicate=True), Output("train-message", "children")]
    app.callback(begun, Input("train", "n_clicks"), [State("train-u-max", "value"), url], **once)(page.train)
    app.callback(Output("sessions", "children"), Input("url", "search"))(page.choose)


def _part(page: PageCallbacks, name: str, _: Any, search: str | None) -> Any:
    return page.part(name, search)

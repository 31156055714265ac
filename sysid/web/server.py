"""The server of the workbench: who may ask, what is answered, and nothing else."""

from __future__ import annotations

import hmac
import logging
import re
import secrets
from pathlib import Path
from typing import Any

import flask
from dash import Dash
from werkzeug.serving import BaseWSGIServer, make_server

from sysid.cli.command_options import WorkbenchCommand as Command
from sysid.cli.commands import completed
from sysid.errors import InvalidInput
from sysid.web import figures, layout
from sysid.web.bench import LARGEST_UPLOAD, Workbench
from sysid.web.callbacks import join
from sysid.web.jobs import Jobs
from sysid.web.layout import DOWNLOADS
from sysid.web.session import Answer, Sessions

logger = logging.getLogger(__name__)

COOKIE = "gapfinder_token"
POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-inline'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; font-src 'self' data:; frame-ancestors 'none'; base-uri 'none'; form-action 'self'"
)
"""What a browser may load for the page: nothing from elsewhere."""
LOCAL = ("127.0.0.1", "localhost", "::1")


def refusal(request: flask.Request, token: str) -> tuple[str, int] | None:
    """Why a request is refused, with its status; None where it is not: it came from a page of this server, and knows
    the token, or where there is none asks by a name of this machine.

    A foreign page that makes its own name point here (DNS rebinding) still sends that name as Host, and its browser
    keeps no token for it.
    """
    host, origin = request.host, request.headers.get("Origin")
    if origin is not None and origin.partition("://")[2] != host:
        return f"A page of {origin} asked: expected one of this server.", 403
    given = (request.args.get("token"), request.cookies.get(COOKIE))
    if token and not any(_is_token(one, token) for one in given):
        return "This workbench wants a token: open the address that it printed when it was started.", 401
    if not token and re.sub(r":\d+$", "", host).strip("[]") not in LOCAL:
        return f"The address says {host!r}: expected {' or '.join(LOCAL)}.", 403
    return None


def _is_token(given: str | None, token: str) -> bool:
    return given is not None and hmac.compare_digest(given.encode(), token.encode())


def make_app(bench: Workbench, token: str = "") -> Dash:
    """The page and its callbacks."""
    app = Dash(
        __name__,
        title="gapfinder workbench",
        update_title="",
        serve_locally=True,
        suppress_callback_exceptions=True,
        assets_folder=str(Path(__file__).parent / "assets"),
        meta_tags=[{"name": "viewport", "content": "width=device-width, initial-scale=1"}],
    )
    app.layout = layout.empty_page(bench.most)
    server: flask.Flask = app.server
    server.config["MAX_CONTENT_LENGTH"] = bench.most * 4 // 3 + (1 << 20)

    @server.before_request
    def check() -> Any:
        refused = refusal(flask.request, token)
        return None if refused is None else flask.Response(refused[0], refused[1], mimetype="text/plain")

    @server.after_request
    def guard(response: flask.Response) -> flask.Response:
        response.headers["Content-Security-Policy"] = POLICY
        response.headers["X-Content-Type-Options"] = "nosniff"
        response.headers["Referrer-Policy"] = "no-referrer"
        if token and _is_token(flask.request.args.get("token"), token):
            response.set_cookie(COOKIE, token, httponly=True, samesite="Strict")
        return response

    @server.errorhandler(413)
    def too_large(_: Any) -> flask.Response:
        return flask.Response(f"More than {bench.most >> 20} MB came: expected less.", 413, mimetype="text/plain")

    @server.get("/download/<identifier>/<int:node>/<name>")
    def download(identifier: str, node: int, name: str) -> Any:
        session = bench.sessions.find(identifier)
        if session is None or name not in DOWNLOADS or not session.has(node, Answer(name)):
            return flask.Response("There is no such answer.", 404, mimetype="text/plain")
        path, (kind, _) = session.of(node) / name, DOWNLOADS[Answer(name)]
        return flask.send_file(path, kind, as_attachment=True, download_name=name)

    join(app, bench)
    figures.blank(200).to_json()  # loads what plotly loads when first asked, which threads must not do side by side
    return app


def make(folder: Path, host: str, port: int, token: str = "", effects: Path | None = None,
         most: int = LARGEST_UPLOAD) -> tuple[BaseWSGIServer, Workbench]:  # fmt: skip
    """A server that listens, and its workbench; port 0 takes a free one. Raises InvalidInput where it cannot."""
    bench = Workbench(Sessions(folder), Jobs(effects), most)
    app = make_app(bench, token)
    try:
        server = make_server(host, port, app.server, threaded=True)
    except (OSError, SystemExit) as error:
        raise InvalidInput(f"cannot listen on {host}, port {port}: {error}: give another --port") from None
    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    return server, bench


def serve(command: Command) -> None:
    """Serve until it is stopped; a log that was given has a session, the one that it had before if it had one."""
    command = completed(command)
    log, start, host, folder = command.log, command.start, command.host, command.folder
    token = command.token or ("" if host in LOCAL else secrets.token_urlsafe(16))
    server, bench = make(folder, host, command.port, token, start.effects)
    query = [f"session={bench.open(log, start).identifier}"] if log.files else []
    query += [f"token={token}"] if token else []
    shown = f"[{host}]" if ":" in host else host
    address = f"http://{shown}:{server.server_port}/{'?' if query else ''}{'&'.join(query)}"
    logger.info(f"the workbench is at {address} (Ctrl+C ends it); it writes into {folder} alone")
    try:
        server.serve_forever()
    finally:
        bench.end()

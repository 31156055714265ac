"""The workbench's server: who may ask, and what is never answered."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("dash", reason="the workbench needs the extra web")

from sysid.errors import InvalidInput
from sysid.web.bench import Workbench
from sysid.web.server import COOKIE, make, make_app

HERE = {"Host": "127.0.0.1:8050"}


@pytest.fixture
def client(bench: Workbench) -> Any:
    return make_app(bench).server.test_client()


@pytest.mark.parametrize("host", ["127.0.0.1:8050", "localhost:8050", "[::1]:8050"])
def test_a_browser_on_this_machine_is_let_in(client: Any, host: str) -> None:
    assert client.get("/", headers={"Host": host}).status_code == 200


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:8050", "127.0.0.1.evil.example:8050", "[x", "192.168.1.7:8050", ""]
)
def test_a_foreign_name_that_points_here_is_refused(client: Any, host: str) -> None:
    answer = client.get("/_dash-layout", headers={"Host": host})
    assert answer.status_code in (400, 403)
    assert b"props" not in answer.data


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://127.0.0.1:1", "https://localhost:8050"])
def test_a_page_from_elsewhere_may_not_ask(client: Any, origin: str) -> None:
    asked = client.post("/_dash-update-component", headers={**HERE, "Origin": origin}, json={})
    assert asked.status_code == 403 and f"A page of {origin} asked".encode() in asked.data
    assert client.get("/", headers={**HERE, "Origin": "http://127.0.0.1:8050"}).status_code == 200


def test_bound_elsewhere_it_wants_a_token(bench: Workbench) -> None:
    client = make_app(bench, "secret").server.test_client()
    away = {"Host": "192.168.1.7:8050"}
    for address in ("/", "/?token=wrong"):
        answer = client.get(address, headers=away)
        assert answer.status_code == 401 and b"wants a token" in answer.data
        assert "Set-Cookie" not in answer.headers
    answer = client.get("/?token=secret", headers=away)
    assert answer.status_code == 200
    assert "HttpOnly" in answer.headers["Set-Cookie"]
    client.set_cookie(COOKIE, "secret", domain="192.168.1.7")
    assert client.get("/_dash-layout", headers=away).status_code == 200


def test_a_click_counts_though_other_buttons_are_drawn_at_that_moment(
    client: Any, bench: Workbench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The page then tells of all of them in one request, in the order of the page or of their drawing."""
    asked = list[Any]()
    monkeypatch.setattr(bench, "do", lambda session, clicked, fields: asked.append(dict(clicked)))
    drawn, clicked = {"do": "train"}, {"do": "add", "effect": "coulomb"}

    def press(*buttons: dict[str, str], clicks: dict[str, int]) -> None:
        values = [{"id": button, "property": "n_clicks", "value": clicks.get(button["do"])} for button in buttons]
        here = [[value for value in values if set(value["id"]) == set(kind)] for kind in (drawn, clicked)]
        body = {
            "output": "..act.data...url.search..",
            "outputs": [{"id": "act", "property": "data"}, {"id": "url", "property": "search"}],
            "inputs": [*here, [], [], []],
            "changedPropIds": [f"{json.dumps(button, separators=(',', ':'))}.n_clicks" for button in buttons],
            "state": [[], {"id": "url", "property": "search", "value": ""}],
        }
        assert client.post("/_dash-update-component", headers=HERE, json=body).status_code in (200, 204)

    press(drawn, clicked, clicks={})
    assert asked == []
    press(drawn, clicked, clicks={"add": 1})
    press(clicked, drawn, clicks={"add": 1})
    press(clicked, clicks={"add": 2})
    assert asked == [clicked] * 3


def test_too_large_a_body_is_refused_with_a_sentence(client: Any) -> None:
    answer = client.post(
        "/_dash-update-component", headers=HERE, data=b"x" * (4 << 20), content_type="application/json"
    )
    assert answer.status_code == 413
    assert b"expected less" in answer.data


@pytest.mark.parametrize(
    "path", ["../session.json", "0/session.json", "0/work.log", "0/..%2fsession.json", "0/model.json", "-1/model.json"]
)
def test_a_download_is_an_answer_or_nothing(client: Any, bench: Workbench, path: str) -> None:
    session = bench.sessions.new("a title that stands in session.json")
    for address in (f"/download/{session.identifier}/{path}", f"/download/../{path}"):
        answer = client.get(address, headers=HERE)
        assert "Content-Disposition" not in answer.headers
        assert b"a title that" not in answer.data


def test_the_page_may_load_nothing_from_elsewhere(client: Any) -> None:
    answer = client.get("/", headers=HERE)
    assert "default-src 'self'" in answer.headers["Content-Security-Policy"]
    assert b"https://" not in answer.data


def test_a_port_that_is_taken_is_one_sentence(tmp_path: Path) -> None:
    first, _ = make(tmp_path, "127.0.0.1", 0)
    try:
        with pytest.raises(InvalidInput, match="--port"):
            make(tmp_path, "127.0.0.1", first.server_port)
    finally:
        first.server_close()

"""The workbench in a real browser: the whole loop by clicks, with no request that leaves the machine."""

from __future__ import annotations

import shutil
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("dash", reason="the workbench needs the extra web")
playwright = pytest.importorskip("playwright.sync_api", reason="a browser is driven by playwright, of the extra dev")

from sysid.web.server import make  # noqa: E402 - dash may not be installed

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
LONG = 120_000
"""Milliseconds that an answer may take on a busy machine."""

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed: apt-get install chromium"),
]


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with playwright.sync_playwright() as driver:
        made = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox", "--disable-gpu"])
        yield made
        made.close()


@pytest.fixture
def site(tmp_path: Path) -> Iterator[str]:
    server, bench = make(tmp_path / "sessions", "127.0.0.1", 0)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}"
    bench.end()
    server.shutdown()
    server.server_close()


@pytest.fixture
def page(browser: Any, site: str) -> Iterator[Any]:
    """A page that blocks and remembers every request that is not for this machine, and every error."""
    context = browser.new_context(viewport={"width": 1280, "height": 800})
    own, foreign, errors = context.new_page(), list[str](), list[str]()

    def only_local(route: Any) -> None:
        if route.request.url.startswith((site, "data:", "blob:")):
            route.continue_()
        else:
            foreign.append(route.request.url)
            route.abort()

    context.route("**/*", only_local)
    own.on("pageerror", lambda error: errors.append(str(error)))
    yield own
    context.close()
    assert not foreign
    assert not errors


def test_the_hidden_friction_is_found_and_added_by_clicks(page: Any, site: str, tmp_path: Path) -> None:
    page.goto(site)
    page.get_by_role("button", name="a sticky joint").click()
    page.locator("#course .main-svg").first.wait_for(timeout=LONG)
    assert float(page.locator(".big strong").inner_text()) > 3.0
    page.get_by_role("button", name="Add coulomb", exact=True).wait_for(timeout=LONG)
    page.reload()
    first = page.locator("article.row").first
    first.wait_for(timeout=LONG)
    assert first.get_by_text("coulomb", exact=True).count() == 1
    first.get_by_role("button", name="Add coulomb").click()
    page.get_by_role("button", name="Cancel").click()
    page.get_by_text("Cancelled").wait_for(timeout=LONG)
    page.get_by_role("button", name="Add coulomb", exact=True).click()
    page.get_by_text("lacks nothing that matters").wait_for(timeout=LONG)
    assert float(page.locator(".big strong").inner_text()) < 1.1
    bars = page.locator("#part-ladder .bartext").all_text_contents()
    assert float(bars[0]) > 3.0
    assert float(bars[1]) < 1.1
    page.locator("#get-report").wait_for(timeout=LONG)
    with page.expect_download() as waiting:
        page.locator("#get-report").click()
    waiting.value.save_as(tmp_path / "report.html")
    text = (tmp_path / "report.html").read_text()
    assert "coulomb" in text
    assert "https://" not in text.replace("http://www.w3.org", "")

"""The workbench in a real browser: the whole loop by clicks, with no request that leaves the machine."""

from __future__ import annotations

import shutil
import statistics
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("dash", reason="the workbench needs the extra web")
playwright = pytest.importorskip("playwright.sync_api", reason="a browser is driven by playwright, of the extra dev")

from sysid.cli.command_options import LogOptions, ModelOptions  # noqa: E402 - dash may not be installed
from sysid.data.record import write_csv  # noqa: E402
from sysid.web import samples  # noqa: E402
from sysid.web.bench import Workbench  # noqa: E402
from sysid.web.server import make  # noqa: E402
from sysid.web.session import Answer  # noqa: E402
from tests.sysid.workbench import waited  # noqa: E402

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
LOG = Path(__file__).parents[3] / "shared" / "data" / "logs" / "dfki_sp_energy_shaping.csv"
LONG = 300_000
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


@contextmanager
def served(folder: Path, host: str = "127.0.0.1", **options: Any) -> Iterator[tuple[str, Workbench]]:
    """A workbench that answers until this ends, and where it does."""
    server, bench = make(folder, host, 0, **options)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_port}", bench
    finally:
        bench.end()
        server.shutdown()
        server.server_close()


@pytest.fixture
def site(tmp_path: Path) -> Iterator[str]:
    with served(tmp_path / "sessions", most=2 << 20) as (address, _):
        yield address


@pytest.fixture
def page(browser: Any, site: str) -> Iterator[Any]:
    """A page that blocks and remembers every request that is not for this machine, and every error."""
    context = browser.new_context(viewport={"width": 1280, "height": 800})
    tab, foreign, errors = context.new_page(), list[str](), list[str]()

    def only_local(route: Any) -> None:
        if route.request.url.startswith((site, "data:", "blob:")):
            route.continue_()
        else:
            foreign.append(route.request.url)
            route.abort()

    context.route("**/*", only_local)
    tab.on("pageerror", lambda error: errors.append(str(error)))
    yield tab
    context.close()
    assert not foreign
    assert not errors


def test_the_hidden_friction_is_found_and_added_by_clicks(page: Any, site: str, tmp_path: Path) -> None:
    page.goto(site)
    page.get_by_role("button", name="a sticky joint").click()
    page.locator("#course .main-svg").first.wait_for(timeout=LONG)
    assert page.locator("#course .modebar-btn").count() > 3
    assert page.locator(".modebar-btn[data-title*=Share]").count() == 0
    assert float(page.locator(".big strong").inner_text()) > 3.0
    page.get_by_role("button", name="Add coulomb", exact=True).wait_for(timeout=LONG)
    page.reload()
    first = page.locator("article.row").first
    first.wait_for(timeout=LONG)
    assert first.get_by_text("coulomb", exact=True).count() == 1
    first.get_by_role("button", name="Add coulomb").click()
    page.locator("#part-fails .before").wait_for(timeout=LONG)  # two quick clicks may be answered in either order
    page.get_by_role("button", name="Cancel").click()
    page.get_by_text("Cancelled").wait_for(timeout=LONG)
    page.get_by_role("button", name="Add coulomb", exact=True).click()
    page.get_by_text("lacks nothing that matters").wait_for(timeout=LONG)
    assert float(page.locator(".big strong").inner_text()) < 1.1
    bars = page.locator("#part-ladder .bartext").all_text_contents()
    assert float(bars[0]) > 3.0
    assert float(bars[1]) < 1.1
    opened_offline(page, site, tmp_path)


def test_a_real_log_is_dropped_read_and_mended(page: Any, site: str, tmp_path: Path) -> None:
    if not LOG.is_file():
        pytest.skip(f"{LOG.name} is not here: expected ../shared/data/logs beside the project")
    page.goto(site)
    page.locator("#upload input").set_input_files(LOG)
    page.locator("#readings .main-svg").first.wait_for(timeout=LONG)
    page.get_by_text("does 0 mean hanging in this log?").wait_for(timeout=LONG)
    page.locator("#set-zero").get_by_text("hanging").click()
    page.get_by_text("does 0 mean hanging in this log?").wait_for(state="detached", timeout=LONG)
    page.locator("#set-end").fill("4.2")
    page.locator("#set-end").press("Enter")
    page.get_by_text("419 samples").first.wait_for(timeout=LONG)
    page.locator("#set-torque").click()
    page.get_by_role("option", name="torque_meas_Nm").click()
    page.get_by_role("button", name="Fit a model to this log").click()
    page.locator("#course .main-svg").first.wait_for(timeout=LONG)
    page.reload()
    page.locator("article.row").first.wait_for(timeout=LONG)
    drag(page, "#over", 0.6, 0.9, "#course .scatterlayer .point")
    assert page.locator("#map .scatterlayer .trace").nth(1).locator(".point").count() > 0
    before = float(page.locator(".big strong").inner_text())
    page.locator("article.row").first.get_by_role("button", name="Add coulomb").click()
    page.locator("#part-ladder .bartext").nth(1).wait_for(timeout=LONG)
    page.locator("#part-fails .before").wait_for(state="detached", timeout=LONG)
    bars = page.locator("#part-ladder .bartext").all_text_contents()
    assert [float(bar) for bar in bars] == sorted(map(float, bars), reverse=True)
    assert float(page.locator(".big strong").inner_text()) < 0.75 * before
    opened_offline(page, site, tmp_path)


def test_plots_stay_while_it_refits_and_a_session_is_renamed_and_deleted(page: Any, site: str) -> None:
    page.goto(site)
    page.get_by_role("button", name="a sticky joint").click(timeout=LONG)
    page.get_by_role("button", name="Add coulomb", exact=True).click(timeout=LONG)
    page.locator("#part-fails .before #course .main-svg").first.wait_for(timeout=LONG)
    assert page.get_by_role("button", name="Add coulomb", exact=True).is_disabled()
    page.get_by_role("button", name="Cancel").click(timeout=LONG)
    page.locator("#part-fails .before").wait_for(state="detached", timeout=LONG)
    fill(page, "How it is read", "#set-end", "6")
    page.locator("#set-end").press("Enter")
    page.get_by_text("48 s").first.wait_for(timeout=LONG)
    page.get_by_role("button", name="Begin anew with these settings").click()
    page.get_by_role("button", name="Undo").click(timeout=LONG)
    page.locator("#part-fails .before").wait_for(state="detached", timeout=LONG)
    playwright.expect(page.locator("#set-end")).to_have_value("", timeout=LONG)
    fill(page, "Sessions", "#sessions input", "the rig")
    page.get_by_role("button", name="Rename").click()
    page.locator(".files", has_text="the rig").wait_for(timeout=LONG)
    page.on("dialog", lambda dialog: dialog.accept())
    page.get_by_role("button", name="Delete the rig").click()
    page.get_by_role("button", name="a sticky joint").wait_for(timeout=LONG)


def fill(page: Any, fold: str, field: str, text: str) -> None:
    """Open a fold and fill a field in it, again where the part is drawn anew meanwhile and folds up."""
    for _ in range(20):
        if not page.locator(field).is_visible():
            page.get_by_text(fold, exact=True).click()
        try:
            return page.locator(field).fill(text, timeout=3_000)
        except playwright.TimeoutError:
            continue
    raise AssertionError(f"{field} in {fold!r} stays folded up")


def opened_offline(page: Any, site: str, folder: Path) -> None:
    """The report that the page offers is opened with no connection to anything."""
    page.locator("#get-report-html").wait_for(timeout=LONG)
    with page.expect_download() as waiting:
        page.locator("#get-report-html").click()
    waiting.value.save_as(folder / "report.html")
    context = page.context.browser.new_context(offline=True)
    report, asked = context.new_page(), list[str]()
    report.on("request", lambda request: asked.append(request.url))
    report.goto((folder / "report.html").as_uri())
    assert report.locator("h1").inner_text()
    assert report.locator("svg, img").count() > 2
    assert "coulomb" in report.content()
    assert not [url for url in asked if not url.startswith(("file:", "data:"))]
    context.close()


def drag(page: Any, plot: str, begin: float, end: float, shown: str) -> None:
    """Select a part of a plot by its shares of the width, until what the selection shows is there: a plot that is
    drawn anew meanwhile loses the drag."""
    from playwright.sync_api import Error

    for _ in range(20):
        try:
            page.locator(f"{plot}:not(.dash-graph--pending)").scroll_into_view_if_needed()
            box = page.locator(f"{plot} .nsewdrag").first.bounding_box()
            page.mouse.move(box["x"] + begin * box["width"], box["y"] + 0.3 * box["height"])
            page.mouse.down()
            page.mouse.move(box["x"] + end * box["width"], box["y"] + box["height"] - 5, steps=4)
            page.mouse.up()
            return page.locator(shown).first.wait_for(timeout=LONG / 60)
        except Error as lost:
            last = lost
    raise last


def test_what_is_too_large_or_no_log_is_said(page: Any, site: str, tmp_path: Path) -> None:
    """One sentence each, and the page goes on: the last file is a log like any other."""
    (tmp_path / "large.csv").write_bytes(b"t,theta\n" + b"0,0\n" * (1 << 20))
    (tmp_path / "log.pkl").write_bytes(b"\x80\x04.")
    (tmp_path / "text.csv").write_text("t,theta\n0,=cmd|' /C calc'!A0\n1,<img src=x onerror=alert(1)>\n")
    write_csv(samples.sample("friction")[0], tmp_path / "good.csv")
    page.goto(site)
    for name, said in (
        ("large.csv", "4 MB: expected less than 2 MB"),
        ("log.pkl", "ends in"),
        ("text.csv", "expected a number"),
    ):
        page.locator("#upload input").set_input_files(tmp_path / name)
        page.locator(".error", has_text=said).first.wait_for(timeout=LONG)
    page.locator("#upload input").set_input_files(tmp_path / "good.csv")
    page.locator("#readings .main-svg").first.wait_for(timeout=LONG)
    assert page.locator(".error:visible").count() == 0


def test_a_click_is_answered_and_the_page_is_painted_soon(
    browser: Any, tmp_path: Path, record_property: Any, capsys: Any
) -> None:
    """With a log of 100,000 samples. The limits are wide: a busy machine is slow; the numbers are printed."""
    window = {"width": 1280, "height": 800}
    with served(tmp_path / "sessions") as (address, bench), browser.new_page(viewport=window) as page:
        session = long_session(bench, tmp_path, 100_000)
        inspector = page.context.new_cdp_session(page)
        inspector.send("Performance.enable", {"timeDomain": "threadTicks"})
        page.goto(f"{address}/?session={session.identifier}")
        page.locator("#over .main-svg").first.wait_for(timeout=LONG)
        paint = page.evaluate("performance.getEntriesByName('first-contentful-paint')[0].startTime") / 1e3
        drawn = page.evaluate("performance.now()") / 1e3
        metrics = inspector.send("Performance.getMetrics")["metrics"]
        work = next(m["value"] for m in metrics if m["name"] == "TaskDuration")
        page.wait_for_timeout(1_500)
        clicks = []
        for what in ("speed", "angle") * 4:
            began = time.perf_counter()
            with page.expect_response("**/_dash-update-component*"):
                page.locator("#channel").get_by_text(what).click()
            clicks.append(time.perf_counter() - began)
            page.wait_for_timeout(300)
    numbers = {"first paint": paint, "all plots": drawn, "of the browser's CPU": work}
    numbers["click, median"] = statistics.median(clicks)
    with capsys.disabled():
        print("\n100,000 samples: " + ", ".join(f"{k} {v:.2f} s" for k, v in numbers.items()))
    for name, seconds in numbers.items():
        record_property(name, seconds)
    assert paint < 3.0 * 1.5
    assert numbers["click, median"] < 3.0 * 0.3


def long_session(bench: Any, folder: Path, count: int) -> Any:
    """A session whose model is a small log's and whose samples are that log's, again and again."""
    record = samples.sample("friction")[0]
    write_csv(record, folder / "short.csv")
    session = bench.open(LogOptions(files=(folder / "short.csv",)), ModelOptions())
    bench.fit(session)
    waited(bench, session)
    path = session.of(0) / Answer.SERIES
    with np.load(path) as file:
        short = {name: file[name] for name in file.files}
    times = -(-count // len(short["t"]))
    span = float(short["t"][-1]) + 0.1
    later = span * np.repeat(np.arange(times), len(short["t"]))
    series = {name: np.tile(column, times) for name, column in short.items()}
    series["t"] = series["t"] + later
    np.savez(path, **{name: column[:count] for name, column in series.items()})
    rows = np.column_stack([series[k][:count] for k in ("t", "theta_read", "theta_dot_read", "torque")])
    np.savetxt(folder / "short.csv", rows, delimiter=",", header="t,theta,theta_dot,torque", comments="")
    return session

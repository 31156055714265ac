"""The workbench's pictures: a browser loads the sample with two hidden effects, adds them, and is photographed.

    python examples/workbench.py                          docs/tutorials/workbench_*.png, about a minute
    python examples/workbench.py --folder pictures        elsewhere

It needs Chromium (Debian's package), and the extras web and dev. For a look of your own: python -m sysid workbench
"""

from __future__ import annotations

import argparse
import io
import shutil
import sys
import tempfile
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import PIL.Image

LONG = 300_000
"""Milliseconds that an answer may take on a busy machine."""


def photographed(page: Any, folder: Path, name: str) -> None:
    """Keep what the page shows as a small PNG."""
    page.wait_for_timeout(1_000)
    picture = PIL.Image.open(io.BytesIO(page.screenshot()))
    folder.mkdir(parents=True, exist_ok=True)
    few = picture.convert("P", palette=PIL.Image.Palette.ADAPTIVE, colors=128)
    few.save(folder / f"workbench_{name}.png", optimize=True)
    print(f"wrote {folder / f'workbench_{name}.png'}", flush=True)


def walk(page: Any, address: str, folder: Path) -> None:
    """The loop by clicks, with a picture at each turn."""
    page.goto(address)
    page.get_by_role("button", name="two at once").click(timeout=LONG)
    page.locator("article.row").first.wait_for(timeout=LONG)
    page.locator("#get-report-html").wait_for(timeout=LONG)
    page.locator("progress").wait_for(state="detached", timeout=LONG)
    page.get_by_text("Its torque through the residual").first.click()
    photographed(page, folder, "missing")
    for _ in range(2):
        add = page.locator("article.row.pays").first.get_by_role("button", name="Add")
        of_effect = str(add.get_attribute("aria-label", timeout=LONG))
        add.click(timeout=LONG)
        page.get_by_role("button", name=of_effect, exact=True).wait_for(state="detached", timeout=LONG)
        page.locator("#get-report-html").wait_for(timeout=LONG)
    page.get_by_text("lacks nothing that matters").wait_for(timeout=LONG)
    page.locator("progress").wait_for(state="detached", timeout=LONG)
    photographed(page, folder, "mended")


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; exit code 2 with one sentence where there is no browser."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    here = Path(__file__).resolve().parents[1] / "docs" / "tutorials"
    parser.add_argument("--folder", type=Path, default=here, metavar="FOLDER", help="where the pictures go")
    options = parser.parse_args(arguments)
    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    if chromium is None:
        parser.error("there is no Chromium: expected Debian's package, apt-get install chromium")

    from playwright.sync_api import sync_playwright

    from sysid.web.server import make

    with tempfile.TemporaryDirectory() as sessions, sync_playwright() as driver:
        server, bench = make(Path(sessions), "127.0.0.1", 0)
        threading.Thread(target=server.serve_forever, daemon=True).start()
        browser = driver.chromium.launch(executable_path=chromium, args=["--no-sandbox", "--disable-gpu"])
        try:
            page = browser.new_page(viewport={"width": 1440, "height": 900})
            walk(page, f"http://127.0.0.1:{server.server_port}", options.folder)
        finally:
            browser.close()
            bench.end()
            server.shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())

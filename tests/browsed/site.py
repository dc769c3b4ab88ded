"""The pages of the built site in a browser: ``python tests/browsed/site.py build/site [--write]``.

Each is opened on a wide and a narrow window, light and dark. Nothing may fail to load or be loaded from elsewhere, no
page may be wider than the window, and axe-core may find no serious fault. The pages look as in `screenshots`, which
``--write`` stores: windows reduced to a few pixels, so that fonts and versions of browsers matter little.
"""

from __future__ import annotations

import argparse
import functools
import http.server
import io
import os
import shutil
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import axe_core_python
import numpy as np
from PIL import Image
from playwright.sync_api import Browser, Page, sync_playwright

SCREENSHOTS = Path(__file__).with_name("screenshots")
AXE = Path(axe_core_python.__file__).with_name("axe.min.js")
NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
WINDOWS = ((1400, 1000), (390, 844))
COLORS = ("light", "dark")
PAGES = ("index", "start", "schemes", "systems/heavy_top", "own_algebra")
# Further pages of each kind, which are not compared.
OTHERS = ("systems/index", "schemes/Splitting", "api", "reference/coadjoint.integrate", "paper", "spins", "derivatives")
REDUCTION = 20
# Part of the reduced pixels that differ by more than this of 255: fewer with other fonts, more without a style sheet.
DIFFERENT, TOLERANCE = 24, 0.1
# What a reader looks for, with the pages that answer; each is at most two links from the first page.
QUESTIONS = {
    "how to integrate an algebra of one's own": "own_algebra.html",
    "which scheme for spins": "schemes.html",
    "what drift means": "terms.html",
    "how to resume a run": "archives.html",
    "how accurate Taylor is": "accuracy.html",
}


@contextmanager
def served(folder: Path) -> Iterator[str]:
    """Serve a folder to this machine alone; yield the address."""

    class Quiet(http.server.SimpleHTTPRequestHandler):
        def log_message(self, *_: Any) -> None:
            pass

    handler = functools.partial(Quiet, directory=str(folder))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.server_port}/"
        finally:
            server.shutdown()


@contextmanager
def opened(
    browser: Browser, base: str, page: str, window: tuple[int, int], color: str, wrong: list[str]
) -> Iterator[Page]:
    """Open a page, and add what goes wrong to the list."""
    width, height = window
    where = f"{page}, {width} pixels, {color}"
    context = browser.new_context(viewport={"width": width, "height": height}, color_scheme=color)  # type: ignore[arg-type]
    tab = context.new_page()
    tab.on("console", lambda message: message.type == "error" and wrong.append(f"{where}: {message.text}"))
    tab.on("requestfailed", lambda request: wrong.append(f"{where}: {request.url} is not loaded"))
    tab.on("response", lambda answer: answer.status >= 400 and wrong.append(f"{where}: {answer.url}: {answer.status}"))
    tab.on(
        "request",
        lambda request: (
            request.url.startswith((base, "data:")) or wrong.append(f"{where}: {request.url} is loaded from elsewhere")
        ),
    )
    tab.goto(base + page + ".html", wait_until="networkidle")
    tab.evaluate("window.MathJax && window.MathJax.startup && window.MathJax.startup.promise")
    yield tab
    context.close()


def faults(tab: Page, width: int) -> list[str]:
    """Return what is wrong with an open page."""
    found = []
    if (wide := tab.evaluate("document.documentElement.scrollWidth")) > width:
        found.append(f"the page is {wide} pixels wide")
    if unset := tab.evaluate(
        r"[...document.querySelectorAll('.math')].filter(m => !m.querySelector('mjx-container')).length"
    ):
        found.append(f"{unset} formulas are not set")
    tab.evaluate(AXE.read_text(encoding="utf-8"))
    for fault in tab.evaluate("axe.run()")["violations"]:
        if fault["impact"] in ("serious", "critical"):
            found.append(f"{fault['id']}: {fault['nodes'][0]['html'][:120]}")
    return found


def reduced(tab: Page) -> np.ndarray:
    """Return the window with few pixels, without movies."""
    tab.add_style_tag(content="img[src$='.gif'] { visibility: hidden }")
    image = Image.open(io.BytesIO(tab.screenshot())).convert("RGB")
    return np.asarray(image.reduce(REDUCTION))


def compared(name: str, seen: np.ndarray, write: bool) -> list[str]:
    """Compare a window with the stored one, or store it."""
    path = SCREENSHOTS / f"{name.replace('/', '-')}.png"
    if write:
        path.parent.mkdir(exist_ok=True)
        Image.fromarray(seen).save(path, optimize=True)
        return []
    if not path.exists():
        return [f"{path} is missing; --write stores it"]
    stored = np.asarray(Image.open(path).convert("RGB"))
    if stored.shape != seen.shape:
        return [f"the window has {seen.shape[:2]} reduced pixels, and the stored one {stored.shape[:2]}"]
    differing = float((np.abs(stored.astype(int) - seen).max(axis=-1) > DIFFERENT).mean())
    return [] if differing <= TOLERANCE else [f"{differing:.0%} of the window differ from {path.name}"]


def links(tab: Page, base: str) -> set[str]:
    """Return the pages of the site that a page links."""
    found = tab.evaluate("[...document.querySelectorAll('a[href]')].map(a => a.href.split('#')[0])")
    return {address.removeprefix(base) for address in found if address.startswith(base)}


def searches(browser: Browser, base: str, wrong: list[str]) -> None:
    """Search for a word, as a reader does."""
    context = browser.new_context()
    tab = context.new_page()
    tab.goto(base + "search.html?q=Casimir")
    try:
        tab.wait_for_selector("#search-results li a", timeout=20_000)
    except Exception as error:
        wrong.append(f"the search finds nothing: {str(error).splitlines()[0]}")
    context.close()


def main() -> int:
    """Open all pages; print what is wrong."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--write", action="store_true", help="store the windows")
    given = parser.parse_args()
    program = os.environ.get("CHROMIUM") or next(filter(None, map(shutil.which, NAMES)), None)
    if program is None:
        print("no browser: install Chromium, or set CHROMIUM=/path/to/it", file=sys.stderr)
        return 2
    wrong: list[str] = []
    with served(given.folder) as base, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=["--no-sandbox"])
        for page in (*PAGES, *OTHERS):
            for window in WINDOWS:
                for color in COLORS:
                    with opened(browser, base, page, window, color, wrong) as tab:
                        name = f"{page}-{window[0]}-{color}"
                        wrong += [f"{name}: {fault}" for fault in faults(tab, window[0])]
                        if page in PAGES:
                            wrong += [f"{name}: {fault}" for fault in compared(name, reduced(tab), given.write)]
        with opened(browser, base, "index", WINDOWS[0], "light", wrong) as tab:
            near = links(tab, base)
        reached = set(near)
        for page in sorted(near):
            with opened(browser, base, page.removesuffix(".html") or "index", WINDOWS[0], "light", wrong) as tab:
                reached |= links(tab, base)
        wrong += [
            f"{asked}: {page} is more than two links away" for asked, page in QUESTIONS.items() if page not in reached
        ]
        searches(browser, base, wrong)
        browser.close()
    print(*wrong, sep="\n")
    print(f"{len(PAGES) + len(OTHERS)} pages, {len(wrong)} faults")
    return bool(wrong)


if __name__ == "__main__":
    sys.exit(main())

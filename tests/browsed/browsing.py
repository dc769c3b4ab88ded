"""Common to the tests in a browser: the browser, a server of a folder, and faults of a page."""

from __future__ import annotations

import functools
import http.server
import os
import shutil
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import axe_core_python
from playwright.sync_api import Page

AXE = Path(axe_core_python.__file__).with_name("axe.min.js")
NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
WINDOWS = ((1400, 1000), (390, 844))
COLORS = ("light", "dark")


def browser_program() -> str | None:
    """Return the path of a browser; print what to do if there is none."""
    program = os.environ.get("CHROMIUM") or next(filter(None, map(shutil.which, NAMES)), None)
    if program is None:
        print("no browser: install Chromium, or set CHROMIUM=/path/to/it", file=sys.stderr)
    return program


@contextmanager
def served(folder: Path) -> Iterator[str]:
    """Serve a folder to this machine alone; yield the address."""

    class Quiet(http.server.SimpleHTTPRequestHandler):
        def log_message(self, *_: Any) -> None:
            pass

    class Server(http.server.ThreadingHTTPServer):
        def handle_error(self, *_: Any) -> None:
            """Closed tabs break connections; what an open one does not get is seen there."""

    handler = functools.partial(Quiet, directory=str(folder))
    with Server(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.server_port}/"
        finally:
            server.shutdown()


def layout_faults(tab: Page, width: int) -> list[str]:
    """Return what is wrong with the width of an open page and with its formulas."""
    found = []
    if (wide := tab.evaluate("document.documentElement.scrollWidth")) > width:
        found.append(f"the page is {wide} pixels wide")
    if unset := tab.evaluate(
        r"[...document.querySelectorAll('.math')].filter(m => !m.querySelector('mjx-container')).length"
    ):
        found.append(f"{unset} formulas are not set")
    if wrong := tab.evaluate("[...document.querySelectorAll('mjx-merror')].map(m => m.title || m.textContent)"):
        found.append(f"formulas with errors: {wrong}")
    return found


def faults(tab: Page, width: int) -> list[str]:
    """Return what is wrong with an open page."""
    found = layout_faults(tab, width)
    tab.evaluate(AXE.read_text(encoding="utf-8"))
    for fault in tab.evaluate("axe.run()")["violations"]:
        if fault["impact"] in ("serious", "critical"):
            found.append(f"{fault['id']}: {fault['nodes'][0]['html'][:120]}")
    return found

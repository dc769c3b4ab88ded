"""The pages of the built site in a browser: ``python tests/browsed/site.py build/site [--write]``.

Each is opened on a wide and a narrow window, light and dark. Nothing may fail to load or be loaded from elsewhere, no
page may be wider than the window, and axe-core may find no serious fault. The pages look as in `screenshots`, which
``--write`` stores: windows reduced to a few pixels, so that fonts and versions of browsers matter little.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import re
import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import urljoin

import numpy as np
from browsing import COLORS, WINDOWS, browser_program, faults, layout_faults, served
from PIL import Image
from playwright.sync_api import Browser, Page, sync_playwright
from playwright.sync_api import Error as PlaywrightError

SCREENSHOTS = Path(__file__).with_name("screenshots")
PAGES = ("index", "start", "schemes", "systems/heavy_top", "own_algebra")
# Further pages of each kind, which are not compared.
OTHERS = (
    "systems/index", "schemes/Splitting", "pictures/index", "api", "reference/coadjoint.integrate", "paper", "spins",
    "derivatives",
)  # fmt: skip
# A formula that Markdown did not recognize is left as text.
RAW = re.compile(r".{0,30}(?:\$|\\[a-zA-Z]{2,}).{0,30}")
VOID = {"area", "base", "br", "col", "embed", "hr", "img", "input", "link", "meta", "source", "track", "wbr"}
REDUCTION = 20
# Part of the reduced pixels that differ by more than this of 255: fewer with other fonts, more without a style sheet.
DIFFERENT, TOLERANCE = 24, 0.1
# What a reader looks for, with the pages that answer and words of the answers; each page is at most two links from the
# first one.
QUESTIONS = {
    "how to integrate an algebra of one's own": ("own_algebra", "LieAlgebra.from_brackets("),
    "which scheme for spins": ("schemes", "spins at a temperature, lattices"),
    "what drift means": ("terms", "largest deviation of an invariant"),
    "how to resume a run": ("archives", "co.resume(path)"),
    "how accurate Taylor is": ("accuracy", "How accurate Taylor is"),
}


@contextlib.contextmanager
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


class Prose(HTMLParser):
    """The text of a page without code and formulas, and whether it has formulas."""

    def __init__(self, page: Path) -> None:
        super().__init__()
        self.text, self.formulas, self.inside = "", False, list[bool]()
        self.feed(page.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in VOID:
            math = "math" in (dict(attrs).get("class") or "").split()
            self.formulas |= math
            self.inside.append(math or tag in ("code", "pre", "script", "style"))

    def handle_endtag(self, tag: str) -> None:
        if tag not in VOID:
            self.inside.pop()

    def handle_data(self, data: str) -> None:
        if not any(self.inside):
            self.text += data


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


def versions(tab: Page, base: str, page: str) -> list[str]:
    """Return what is wrong with the menu of versions, which only published sites have."""
    if not tab.query_selector(".version-switcher__button"):
        return []
    with contextlib.suppress(PlaywrightError):
        tab.wait_for_selector(".version-switcher__menu a", state="attached", timeout=20_000)
    found = tab.evaluate("[...document.querySelectorAll('.version-switcher__menu a')].map(a => a.getAttribute('href'))")
    expected = {urljoin(base, f"../{version}/{page}.html") for version in ("dev", "stable")}
    return [] if set(found) == expected else [f"the menu of versions leads to {found}"]


def code_faults(tab: Page) -> list[str]:
    """Return the lines of code that are wider than their place, and what the first button copies."""
    wide = tab.evaluate(
        """[...document.querySelectorAll('article pre')]
        .filter(p => p.offsetParent && p.scrollWidth > p.clientWidth + 1)
        .map(p => p.textContent.split('\\n').reduce((a, b) => (b.length > a.length ? b : a)))"""
    )
    found = [f"code of {len(line)} letters scrolls sideways: {line}" for line in wide]
    button = tab.query_selector("article .doctest button.copybtn, article .highlight-python button.copybtn")
    if button is not None:
        tab.context.grant_permissions(["clipboard-read", "clipboard-write"])
        button.evaluate("button => button.click()")
        copied = tab.evaluate("navigator.clipboard.readText()")
        if not copied.strip() or ">>>" in copied:
            found.append(f"the button of an example copies {copied!r}")
    return found


def links(tab: Page, base: str) -> set[str]:
    """Return the pages of the site that the text of a page links."""
    selected = "article a[href]"
    found = tab.evaluate(f"[...document.querySelectorAll('{selected}')].map(a => a.href.split('#')[0])")
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
    if (program := browser_program()) is None:
        return 2
    wrong: list[str] = []
    with served(given.folder) as base, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=["--no-sandbox"])
        for page in (*PAGES, *OTHERS):
            for window in WINDOWS:
                for color in COLORS:
                    with opened(browser, base, page, window, color, wrong) as tab:
                        name = f"{page}-{window[0]}-{color}"
                        wrong += [f"{name}: {fault}" for fault in faults(tab, window[0]) + versions(tab, base, page)]
                        if page in PAGES:
                            wrong += [f"{name}: {fault}" for fault in compared(name, reduced(tab), given.write)]
        count = len(PAGES) + len(OTHERS)
        for path in sorted(given.folder.glob("*.html")):
            with opened(browser, base, path.stem, WINDOWS[0], "light", wrong) as tab:
                wrong += [f"{path.stem}: {fault}" for fault in code_faults(tab)]
        explorer = given.folder / "explorer"  # has tests of its own
        for file in sorted(path for path in given.folder.rglob("*.html") if explorer not in path.parents):
            prose, page = Prose(file), file.relative_to(given.folder).with_suffix("").as_posix()
            wrong += [f"{page}: raw formula: {text}" for text in RAW.findall(prose.text)]
            if prose.formulas and page not in (*PAGES, *OTHERS):
                count += 1
                with opened(browser, base, page, WINDOWS[1], "light", wrong) as tab:
                    wrong += [f"{page}: {fault}" for fault in layout_faults(tab, WINDOWS[1][0])]
        with opened(browser, base, "index", WINDOWS[0], "light", wrong) as tab:
            near = links(tab, base)
        reached = set(near)
        for page in sorted(near):
            with opened(browser, base, page.removesuffix(".html") or "index", WINDOWS[0], "light", wrong) as tab:
                reached |= links(tab, base)
        for asked, (page, answer) in QUESTIONS.items():
            if f"{page}.html" not in reached:
                wrong.append(f"{asked}: {page} is more than two links away")
            with opened(browser, base, page, WINDOWS[0], "light", wrong) as tab:
                if answer not in tab.inner_text("article"):
                    wrong.append(f"{asked}: {page} does not contain {answer!r}")
        searches(browser, base, wrong)
        browser.close()
    print(*wrong, sep="\n")
    print(f"{count} pages, {len(wrong)} faults")
    return bool(wrong)


if __name__ == "__main__":
    sys.exit(main())

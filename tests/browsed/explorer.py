"""The explorer in a browser: ``python tests/browsed/explorer.py build/explorer/site``.

The page loads nothing from elsewhere, every system runs, and the numbers of both runs are those that the script of the
page prints. The address keeps the choice, and the page works by keyboard, on a narrow window, light and dark. Its size
is bounded. The time until its first picture and its speed, which depend on the load of the machine, are printed.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import gzip
import io
import sys
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from browsing import COLORS, WINDOWS, browser_program, faults, served
from playwright.sync_api import Browser, Page, sync_playwright
from playwright.sync_api import Error as PlaywrightError

sys.path.append(str(Path(__file__).parents[2] / "docs"))

from explorer_systems import SHOWN
from write_explorer import first_values

import coadjoint as co

LARGEST_SIZE = 500_000  # bytes of all files, compressed
FRAMES_TIME = 1.2  # seconds in which frames are counted
STEPS = 150
PLANET_STEPS, PLANET_ERROR = 100, 1e-10  # products of matrices add in another order
SECTION_STEPS, SECTION_ERROR = 2000, 3e-3
SYSTEMS = (*(shown.name for shown in SHOWN), "algebra")
(PLANET,) = (shown.name for shown in SHOWN if shown.start)
SCHEMES = ("splitting2", "splitting4", "rk4", "gauss", "taylor")
WAIT = 20_000


@contextmanager
def opened(
    browser: Browser,
    base: str,
    address: str,
    wrong: list[str],
    window: tuple[int, int] = WINDOWS[0],
    color: str = "light",
) -> Iterator[Page]:
    """Open the page with a choice, and add what goes wrong to the list."""
    width, height = window
    where = f"#{address}, {width} pixels, {color}"
    context = browser.new_context(viewport={"width": width, "height": height}, color_scheme=color)  # type: ignore[arg-type]
    tab = context.new_page()
    tab.on("console", lambda message: message.type == "error" and wrong.append(f"{where}: {message.text}"))
    tab.on("pageerror", lambda error: wrong.append(f"{where}: {error}"))
    tab.on(
        "request",
        lambda request: (
            request.url.startswith((base, "data:")) or wrong.append(f"{where}: {request.url} is loaded from elsewhere")
        ),
    )
    tab.goto(f"{base}index.html#{address}")
    tab.wait_for_function("window.explorer && performance.getEntriesByName('first picture').length", timeout=WAIT)
    yield tab
    context.close()


def compressed_size(folder: Path) -> int:
    """Return the size of all files, each compressed."""
    return sum(len(gzip.compress(file.read_bytes(), 9)) for file in folder.rglob("*") if file.is_file())


def take(tab: Page, steps: int) -> list[list[float]]:
    """Begin both runs again, and return their states after some steps."""
    states: list[list[float]] = tab.evaluate(
        """steps => {
            const { app } = explorer;
            app.playing = false;
            app.restart();
            while (app.steps < steps && !app.problem) app.take(Math.min(10, steps - app.steps));
            return app.tracks.map((track) => Array.from(track.x));
        }""",
        steps,
    )
    return states


def printed(script: str) -> tuple[list[list[float]], Any]:
    """Return the states that the script of the page prints, and its last run."""
    output, names = io.StringIO(), {}
    with contextlib.redirect_stdout(output), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        exec(compile(script, "script of the explorer", "exec"), names)
    lines = output.getvalue().splitlines()
    return [eval(line[line.index("[") : line.index("]") + 1]) for line in lines], names["sol"]


def check_data(text: str, states: list[list[float]], rotations: list[Any], sol: Any) -> list[str]:
    """Return how the downloaded data differ from both runs of the page, and from the second in Python."""
    header, *rows = csv.reader(io.StringIO(text))
    size, invariants = len(states[0]), len(sol.casimirs) + 1
    numbers = np.array([row[1:] for row in rows], dtype=float).reshape(2, STEPS + 1, -1)
    columns = numbers[..., 2 : 2 + size], numbers[..., 2 + size + invariants :]
    found = [] if columns[0][:, -1].tolist() == states else ["the last states differ from those of the page"]
    if not np.array_equal(numbers[1, :, 0] * sol.t[1], sol.t) or not np.array_equal(numbers[1, :, 1], sol.t):
        found.append("the steps or times differ")
    if header[-9:] != [f"R{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3)]:
        return [*found, *(["there are attitudes in Python only"] if sol.attitude is not None else [])]
    if columns[1][:, -1].tolist() != rotations:
        found.append("the last rotations differ from those of the page")
    if not np.array_equal(columns[1][1], sol.attitude[:, :3, :3].reshape(-1, 9)):
        found.append("the rotations differ from those of Python")
    return found


def check_numbers(browser: Browser, base: str, wrong: list[str]) -> None:
    """Compare every system under every scheme with the script that the page writes."""
    for system in (name for name in SYSTEMS if name != PLANET):
        for first, second in (SCHEMES[:2], SCHEMES[2:4], (SCHEMES[4], SCHEMES[0])):
            with opened(browser, base, f"system={system}&a={first}&b={second}", wrong) as tab:
                states = take(tab, STEPS)
                expected, sol = printed(tab.evaluate("explorer.script()"))
                rotations = tab.evaluate("explorer.app.tracks.map((track) => track.rotation)")
                data = tab.evaluate("explorer.data()")
            wrong += [f"{system}, data: {fault}" for fault in check_data(data, states, rotations, sol)]
            for name, state, value in zip((first, second), states, expected, strict=True):
                rounded = system == "algebra" and name == "taylor"
                same = np.allclose(state, value, rtol=0, atol=1e-12) if rounded else state == value
                if not same:
                    wrong.append(f"{system}, {name}: {state} in the page, {value} in Python")


def check_planet(browser: Browser, base: str, wrong: list[str]) -> None:
    """Compare a flow on a sphere with the script of the page, and find the picture of it where its disc is."""
    for address in ("", "&p.N=16&p.lamb=150&p.rotation=20&a=isospectral4&b=isospectral2"):
        with opened(browser, base, f"system={PLANET}{address}", wrong) as tab:
            states = take(tab, PLANET_STEPS)
            tab.wait_for_timeout(300)
            script, size = tab.evaluate("explorer.script()"), tab.evaluate("explorer.app.choice.values.N")
            errors = tab.evaluate("explorer.app.tracks.map((track) => track.casimirs.most)")
            drawn = [len(tab.evaluate(COLOR_POINTS, [f"canvas.{name}", 1, None])) for name in ("scene", "body")]
        names: dict[str, Any] = {}
        with contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            exec(compile(script, "script of the explorer", "exec"), names)
        expected = names["sol"].x[-1]
        found = np.array(states[1]).view(np.complex128).reshape(expected.shape)
        if len(expected) != size or not np.abs(found - expected).max() < PLANET_ERROR * np.abs(expected).max():
            wrong.append(f"a planet of N = {size}: states differ by {np.abs(found - expected).max()}")
        if not 0 < max(errors) < 1e-13:
            wrong.append(f"a planet of N = {size}: the errors of traces are {errors}")
        if drawn[0] < 30_000 or not drawn[1]:
            wrong.append(f"a planet of N = {size}: {drawn} pixels are drawn")


def check_address(browser: Browser, base: str, wrong: list[str]) -> None:
    """Change settings by keyboard, and open the address that results."""
    with opened(browser, base, "system=heavy_top", wrong) as tab:
        tab.get_by_label("lever l₃").focus()
        for _ in range(3):
            tab.keyboard.press("ArrowRight")
        tab.get_by_label("step h").focus()
        tab.keyboard.press("ArrowLeft")
        tab.get_by_label("Right scheme", exact=True).select_option("gauss")
        for label, text in (("gamma1", "0.5"), ("gamma2", "-0.25"), ("gamma3", "x")):
            tab.get_by_label(label).fill(text)
            tab.keyboard.press("Enter")
        if tab.get_by_label("gamma3").get_attribute("aria-invalid") != "true":
            wrong.append("a field without a number is not marked")
        tab.wait_for_timeout(400)
        choice, address = tab.evaluate("explorer.app.choice"), tab.evaluate("location.hash.slice(1)")
    if choice["values"]["l3"] != 1.15 or choice["schemes"][1] != "gauss" or choice["x0"][3:] != [0.5, -0.25, 0.8]:
        wrong.append(f"keys and fields set {choice}")
    with opened(browser, base, address, wrong) as tab:
        again = tab.evaluate("explorer.app.choice")
    if again != choice:
        wrong.append(f"#{address} gives {again}, not {choice}")
    with opened(browser, base, "system=none&h=-3&p.I1=x&turn=1&x=1,2", wrong) as tab:
        if tab.evaluate("explorer.app.choice.system") != "rigid_body":
            wrong.append("an address that cannot be read does not open the first system")
    with opened(browser, base, "system=algebra&c=1,0,0,0,1,0,1,0,1", wrong) as tab:
        if "Jacobi" not in tab.inner_text("#message"):
            wrong.append("brackets without the Jacobi identity are not refused")


def check_refusals(browser: Browser, base: str, wrong: list[str]) -> None:
    """Type what is no number, and brackets without the Jacobi identity: nothing is run, shown or copied of them."""
    with opened(browser, base, "", wrong) as tab:
        for text in ("abc", "", "1e7", "1,5"):
            tab.get_by_label("x1", exact=True).fill(text)
            tab.keyboard.press("Enter")
            shown = tab.inner_text("#message")
            if "x1" not in shown or f"“{text}”" not in shown or tab.evaluate("explorer.app.choice.x0[0]") != 0.05:
                wrong.append(f"{text!r} as a state shows {shown!r}")
    with opened(browser, base, "x=abc&h=0.1", wrong) as tab:
        shown = tab.inner_text("#message")
        if "x=abc" not in shown or "h=" in shown or tab.evaluate("explorer.app.choice.step") != 0.1:
            wrong.append(f"the address x=abc shows {shown!r}")
    with opened(browser, base, "system=algebra", wrong) as tab:
        tab.context.grant_permissions(["clipboard-read", "clipboard-write"])
        tab.get_by_role("button", name="Copy link").click()
        tab.wait_for_timeout(200)
        before = tab.evaluate("location.href")
        tab.get_by_label("[e₁, e₂], e1").fill("1")
        tab.keyboard.press("Enter")
        tab.wait_for_timeout(400)
        for name in ("Copy as Python", "Download data", "Copy link"):
            tab.get_by_role("button", name=name).click()
            if "Jacobi" not in (shown := tab.inner_text("#message")) or "Nothing is copied" not in shown:
                wrong.append(f"{name} of brackets without the Jacobi identity shows {shown!r}")
        after = tab.evaluate("navigator.clipboard.readText()"), tab.evaluate("location.href")
        if after != (before, before):
            wrong.append(f"brackets without the Jacobi identity are copied: {after}")
        pixels = sum(len(tab.evaluate(COLOR_POINTS, ["canvas.scene", k, None])) for k in (0, 1))
        texts = "".join(tab.locator(".readout").all_inner_texts())
        if tab.evaluate("explorer.app.tracks.length") or pixels or texts:
            wrong.append(f"runs go on without the Jacobi identity: {pixels} pixels, {texts!r}")
        tab.get_by_label("[e₁, e₂], e1").fill("0")
        tab.keyboard.press("Enter")
        tab.wait_for_timeout(200)
        if tab.inner_text("#message") or tab.evaluate("explorer.app.tracks.length") != 2:
            wrong.append("valid brackets do not run again")


def check_file(browser: Browser, folder: Path, wrong: list[str]) -> None:
    """Opened as a file, from which browsers load no modules, the page names a server."""
    tab = browser.new_page()
    tab.goto((folder / "index.html").resolve().as_uri())
    if "http.server" not in (text := tab.inner_text("#message")):
        wrong.append(f"opened as a file, the page shows {text!r}")
    tab.close()


def check_keys_and_clicks(browser: Browser, base: str, wrong: list[str]) -> None:
    """Turn the scene and stop the runs by keys, and set the initial state by a click."""
    with opened(browser, base, "", wrong) as tab:
        scene = tab.locator("canvas.scene").first
        reached = set()
        for _ in range(40):
            tab.keyboard.press("Tab")
            reached.add(tab.evaluate("document.activeElement.className + document.activeElement.tagName"))
        if "sceneCANVAS" not in reached or "SELECT" not in reached or "mainBUTTON" not in reached:
            wrong.append(f"by Tab only {sorted(reached)} are reached")
        scene.focus()
        before = np.array(tab.evaluate("explorer.app.choice.turn"))
        tab.keyboard.press("ArrowLeft")
        tab.keyboard.press("ArrowUp")
        if not np.allclose(tab.evaluate("explorer.app.choice.turn") - before, (0.08, -0.08)):
            wrong.append("arrow keys do not turn the scene")
        tab.keyboard.press(" ")
        if tab.evaluate("explorer.app.playing"):
            wrong.append("the space bar does not stop the runs")
        box = scene.bounding_box()
        assert box is not None
        start = np.array(tab.evaluate("explorer.app.choice.x0"))
        tab.mouse.click(box["x"] + 0.35 * box["width"], box["y"] + 0.4 * box["height"])
        clicked = np.array(tab.evaluate("explorer.app.choice.x0"))
        if np.allclose(clicked, start) or abs(np.linalg.norm(clicked) / np.linalg.norm(start) - 1) > 1e-5:
            wrong.append(f"a click on the sphere sets {clicked}, from {start}")
        turned = np.array(tab.evaluate("explorer.app.choice.turn"))
        tab.mouse.move(box["x"] + 100, box["y"] + 100)
        tab.mouse.down()
        tab.mouse.move(box["x"] + 160, box["y"] + 130, steps=5)
        tab.mouse.up()
        across, up = tab.evaluate("explorer.app.choice.turn") - turned
        if not across < -0.2 or not up > 0.1:
            wrong.append(f"dragging turns the scene by {across}, {up}")


COLOR_POINTS = """([selector, number, color]) => {
    const canvas = document.querySelectorAll(selector)[number], { width, height } = canvas;
    const value = color && getComputedStyle(document.documentElement).getPropertyValue(color).trim();
    const wanted = color ? [1, 3, 5].map((k) => parseInt(value.slice(k, k + 2), 16)) : [];
    const { data } = canvas.getContext("2d").getImageData(0, 0, width, height), found = [];
    for (let k = 0; k < data.length; k += 4)
        if (data[k + 3] > (color ? 250 : 20) && wanted.every((part, i) => Math.abs(part - data[k + i]) < 12))
            found.push([(k / 4) % width, Math.floor(k / 4 / width)]);
    return found;
}"""


def trail_faults(browser: Browser, base: str, wrong: list[str]) -> list[str]:
    """Return whether the newest states, where they are in front, are not on the drawn path."""
    with opened(browser, base, "system=spin_pair", wrong) as tab:
        take(tab, 60)
        tab.wait_for_timeout(200)
        states = np.array(tab.evaluate("[...explorer.app.tracks[0].states()].map((x) => [...x])"))[-15:-2, :3]
        width, height = tab.evaluate("(({ width, height }) => [width, height])(document.querySelector('canvas.scene'))")
        drawn = np.array(tab.evaluate(COLOR_POINTS, ["canvas.scene", 0, "--a"]))
        yaw, pitch = tab.evaluate("explorer.app.choice.turn")
    (s, u), (c, v) = np.sin([yaw, pitch]), np.cos([yaw, pitch])
    # The rows are right, up and toward the reader.
    seen = states / np.linalg.norm(states[0]) @ np.array([(c, s, 0), (-u * s, u * c, v), (v * s, -v * c, u)]).T
    radius = 0.41 * min(width, height)
    places = np.array([0.39 * width, 0.5 * height]) + radius * seen[:, :2] * (1, -1)
    front = places[seen[:, 2] > 0.1]
    if not len(front) or not len(drawn):
        return ["no states are drawn in front"]
    # The path of the other spin covers some.
    distance = np.median(np.linalg.norm(front[:, None] - drawn, axis=-1).min(axis=1))
    return [f"states are {distance:.0f} pixels from the drawn path"] if distance > 2 else []


def section_faults(browser: Browser, base: str, wrong: list[str]) -> list[str]:
    """Return what is wrong with the section: whether it is shown, and where its highest point is."""
    with opened(browser, base, "", wrong) as tab:
        found = ["a system without a section shows one"] if tab.locator("canvas.plot:visible").count() != 2 else []
    with opened(browser, base, "system=heavy_top&b=gauss", wrong) as tab:
        take(tab, SECTION_STEPS)
        tab.wait_for_timeout(200)
        if tab.locator("canvas.plot:visible").count() != 3:
            return [*found, "the section is not shown"]
        tracks = tab.evaluate("explorer.app.tracks.map((track) => [...track.crossings])")
        # Points of the second run cover those of the first one.
        drawn = np.array(tab.evaluate(COLOR_POINTS, ["canvas.plot", 2, "--b"]))
    points = np.array(tracks[1]).reshape(-1, 2)
    across = [np.ptp(part) for part in (points[:, 0], drawn[:, 0])]
    expected = (points[points[:, 1].argmax(), 0] - points[:, 0].min()) / across[0]
    at = (drawn[drawn[:, 1].argmin(), 0] - drawn[:, 0].min()) / across[1]
    return found if abs(at - expected) < 0.05 else [*found, f"the highest point is at {at}, not {expected}"]


def check_drawings(browser: Browser, base: str, wrong: list[str]) -> None:
    """Find the colors of both runs where their errors and states are, and the waves of a fluid where they are."""
    with opened(browser, base, "", wrong) as tab:
        take(tab, 1000)
        tab.wait_for_timeout(200)
        for plot, name in ((0, "energy"), (1, "casimirs")):
            lines = [np.array(tab.evaluate(COLOR_POINTS, ["canvas.plot", plot, color])) for color in ("--a", "--b")]
            if min(map(len, lines)) < 100:
                wrong.append(f"of the errors of {name}, {[len(line) for line in lines]} pixels are drawn")
                continue
            ends = [line[line[:, 0] > 0.97 * line[:, 0].max(), 1].mean() for line in lines]
            errors = tab.evaluate(f"explorer.app.tracks.map((track) => track.{name}.most)")
            if (ends[0] < ends[1]) != (errors[0] > errors[1]):
                wrong.append(f"the errors of {name} are {errors}, and their lines end at {ends} from above")
    with opened(browser, base, "h=0.01", wrong) as tab:
        tab.evaluate("explorer.app.playing = false")
        for number, color in enumerate(("--a", "--b")):
            scene = tab.locator("canvas.scene").nth(number)
            box = scene.bounding_box()
            assert box is not None
            at = np.array([0.3 * box["width"], 0.55 * box["height"]])
            tab.mouse.click(box["x"] + at[0], box["y"] + at[1])
            tab.wait_for_timeout(200)
            dot = np.array(tab.evaluate(COLOR_POINTS, ["canvas.scene", number, color]))
            if not len(dot) or np.abs(dot.mean(axis=0) - at).max() > 3:
                wrong.append(f"after a click at {at} the state is drawn at {dot.mean(axis=0) if len(dot) else None}")
            if not tab.evaluate(f"document.querySelectorAll('canvas.body')[{number}].width > 0"):
                wrong.append("the body is not drawn")
    wrong += trail_faults(browser, base, wrong) + section_faults(browser, base, wrong)
    with opened(browser, base, "system=maxwell_bloch&h=0.01", wrong) as tab:
        take(tab, 1)
        tab.wait_for_timeout(200)
        if (drawn := len(tab.evaluate(COLOR_POINTS, ["canvas.scene", 0, None]))) < 3000:
            wrong.append(f"the cylinder has {drawn} pixels")
    for system, x, expected in (
        ("fluid_triad", "1,0,0", [("red", 0, 0), ("blue", 11, 0), ("red", 22, 30)]),
        ("fluid_triad", "0,1,0", [("red", 0, 0), ("blue", 0, 7), ("blue", 22, 0)]),
        ("fluid_triad", "0,0,1", [("red", 0, 0), ("blue", 7, 0), ("red", 15, 0), ("blue", 0, 7)]),
    ):
        with opened(browser, base, f"system={system}&h=0.01&x={x}", wrong) as tab:
            tab.evaluate("explorer.app.playing = false")
            tab.wait_for_timeout(100)
            for color, column, row in expected:
                context = "document.querySelector('canvas.body').getContext('2d')"
                pixel = tab.evaluate(f"[...{context}.getImageData({column}, {row}, 1, 1).data]")
                if (pixel[0] > pixel[2] + 60, pixel[2] > pixel[0] + 60) != (color == "red", color == "blue"):
                    wrong.append(f"{system} at {x}: the pixel ({column}, {row}) is {pixel}, not {color}")


def check_buttons(browser: Browser, base: str, wrong: list[str]) -> None:
    """Press every button, change the address, and choose another system."""
    with opened(browser, base, "", wrong) as tab:
        tab.context.grant_permissions(["clipboard-read", "clipboard-write"])
        tab.get_by_role("button", name="Pause").click()
        tab.get_by_role("button", name="Restart").click()
        first = tab.evaluate("explorer.app.steps")
        tab.get_by_role("button", name="One step").click()
        tab.wait_for_timeout(200)
        if (now := tab.evaluate("[explorer.app.steps, explorer.app.playing]")) != [first + 1, False] or first > 1:
            wrong.append(f"from step {first}, one step leads to {now}")
        if f"Step {first + 1} " not in tab.locator(".readout").first.inner_text():
            wrong.append("the step is not shown")
        tab.get_by_role("button", name="Play").click()
        try:
            tab.wait_for_function("first => explorer.app.steps > first + 5", arg=first, timeout=WAIT)
        except PlaywrightError:
            wrong.append("the runs do not continue")
        tab.get_by_role("button", name="Pause").click()
        tab.get_by_role("button", name="Copy as Python").click()
        tab.wait_for_function("document.getElementById('message').textContent.includes('clipboard')")
        if tab.evaluate("navigator.clipboard.readText()") != tab.evaluate("explorer.script()"):
            wrong.append("the script is not in the clipboard")
        tab.get_by_role("button", name="Copy link").click()
        tab.wait_for_timeout(200)
        if tab.evaluate("navigator.clipboard.readText()") != tab.url:
            wrong.append("the link is not in the clipboard")
        with tab.expect_download() as saved:
            tab.get_by_role("button", name="Download data").click()
        text = Path(saved.value.path()).read_text(encoding="utf-8")
        if saved.value.suggested_filename != "rigid_body.csv" or text != tab.evaluate("explorer.data()"):
            wrong.append(f"{saved.value.suggested_filename} is downloaded, and its data are not those of both runs")
        dark = "document.documentElement.dataset.theme === 'dark'"
        tab.get_by_label("Light or dark").click()
        if not tab.evaluate(dark):
            wrong.append("the button does not change the colors")
        tab.wait_for_timeout(200)
        if not tab.evaluate(COLOR_POINTS, ["canvas.plot", 0, "--a"]):
            wrong.append("drawings keep their colors when those of the page change")
        tab.evaluate("localStorage.removeItem('theme')")  # as after a choice on the other pages of the site
        tab.reload()
        tab.wait_for_function("window.explorer")
        if not tab.evaluate(dark):
            wrong.append("the chosen colors are lost")
        tab.locator("canvas.scene").first.focus()
        tab.keyboard.press("ArrowLeft")
        tab.wait_for_function("location.hash.includes('turn')")
        tab.keyboard.press("Home")
        tab.wait_for_timeout(400)
        if tab.evaluate("explorer.app.choice.turn") != [-0.65, 0.42] or "turn" in tab.url:
            wrong.append("Home does not turn the scene back")
        tab.evaluate("location.hash = 'system=spin_pair'")
        tab.wait_for_timeout(200)
        if tab.evaluate("explorer.app.tracks[0].x.length") != 6 or not tab.get_by_label("exchange J").count():
            wrong.append("another address does not show its system")
        tab.get_by_label("System", exact=True).last.select_option("toda_ring")
        tab.wait_for_timeout(400)
        if tab.evaluate("explorer.app.choice.system") != "toda_ring" or "toda_ring" not in tab.url:
            wrong.append("the list of systems does not choose one")


def check_failures(browser: Browser, base: str, wrong: list[str]) -> None:
    """Show a run that fails beside one that goes on, and refuse an energy of zero."""
    with opened(browser, base, "system=heavy_top&h=2&x=9,9,9,0.6,0,0.8", wrong) as tab:
        take(tab, 400)
        tab.wait_for_timeout(200)
        texts = tab.locator(".readout").all_inner_texts()
        if "overflowed" not in texts[1] or "energy" not in texts[0]:
            wrong.append(f"a run that overflows is described by {texts}")
    with opened(browser, base, "system=algebra", wrong) as tab:
        tab.get_by_label("Example").select_option("sl(2), hyperboloids")
        if tab.evaluate("explorer.app.choice.algebra.constants") != [0, 2, 0, 1, 0, 0, 0, 0, 2]:
            wrong.append("an example does not set the structure constants")
        tab.get_by_label("Example").select_option("so(3), the sphere")
        for label, text in (("[e₃, e₁], e2", "2"), ("b2", "0.5"), ("a3", "0.7")):
            tab.get_by_label(label, exact=True).fill(text)
            tab.keyboard.press("Enter")
        typed = {"constants": [0, 0, 1, 1, 0, 0, 0, 2, 0], "squares": [1, 0.6, 0.7], "linear": [0, 0.5, 0]}
        if (found := tab.evaluate("explorer.app.choice.algebra")) != typed:
            wrong.append(f"the fields of an algebra set {found}")
        tab.get_by_label("Example").select_option("sl(2), hyperboloids")
        if not tab.evaluate("explorer.app.orbit.length"):
            wrong.append("the level set of the Casimir of sl(2) has no lines")
    with opened(browser, base, "system=algebra&squares=0,0,0", wrong) as tab:
        if "H is zero" not in tab.inner_text("#message"):
            wrong.append("an energy of zero is not refused")


def check_drift(browser: Browser, base: str, wrong: list[str]) -> None:
    """At the first settings Runge-Kutta leaves the sphere, and the splitting stays."""
    with opened(browser, base, "", wrong) as tab:
        take(tab, 3000)
        stays, leaves = tab.evaluate("explorer.app.tracks.map((track) => track.casimirs.most)")
        if not stays < 1e-13 < 1e-2 < leaves:
            wrong.append(f"the errors of the Casimir are {stays} and {leaves}")
        orthogonal, collapsed = np.array(tab.evaluate("explorer.app.tracks.map((t) => t.rotation)")).reshape(2, 3, 3)
        if not np.abs(orthogonal.T @ orthogonal - np.eye(3)).max() < 1e-12 or np.linalg.det(collapsed) > 0.5:
            wrong.append(f"the rotations are {orthogonal} and {collapsed}")


def check_sections(browser: Browser, base: str, wrong: list[str]) -> None:
    """Compare points of the sections with events of the library, which may be two in one step."""
    for shown in SHOWN:
        if (section := shown.view.get("section")) is None:
            continue
        with opened(browser, base, f"system={shown.name}&b=gauss", wrong) as tab:
            take(tab, SECTION_STEPS)
            points = np.array(tab.evaluate("explorer.app.tracks[1].crossings")).reshape(-1, 2)
        rises = co.Event(lambda x, level=section["level"]: x[level], direction=1)
        system, span = shown.build(first_values(shown)), (0.0, SECTION_STEPS * shown.step)
        sol = co.integrate(system, shown.x0, span, shown.step, co.GaussLegendre(stages=2), events=rises)
        expected = sol.events.x[:, [section["across"], section["up"]]]
        distances = np.abs(points[:, None] - expected).max(axis=-1).min(axis=1)
        if abs(len(points) - len(expected)) > 1 or distances.max() > SECTION_ERROR:
            wrong.append(
                f"the section of {shown.name} has {len(points)} points of {len(expected)}, {distances.max()} off"
            )


def measured(browser: Browser, base: str, wrong: list[str]) -> str:
    """Return milliseconds until the first picture, frames per second of the slowest system, and steps a second."""
    starts, frames = [], []
    for system in SYSTEMS:
        with opened(browser, base, f"system={system}", wrong) as tab:
            starts.append(tab.evaluate("performance.getEntriesByName('first picture')[0].startTime"))
            time.sleep(FRAMES_TIME)
            frames.append(tab.evaluate("explorer.framesPerSecond"))
    rate = steps_a_second(browser, base, wrong) / 1000
    return (
        f"first picture after {starts[0]:.0f} ms, at least {min(frames):.1f} frames per second, "
        f"{rate:.0f} thousand steps of a rigid body a second"
    )


def steps_a_second(browser: Browser, base: str, wrong: list[str]) -> float:
    """Return the steps a second of a rigid body under the first scheme."""
    with opened(browser, base, "", wrong) as tab:
        rate: float = tab.evaluate(
            """() => {
                const { app } = explorer, [plan] = app.plans();
                const run = app.kernels.run(plan.loop, plan.fields, 3, plan.invariants.length);
                run.begin(plan.x0);
                run.advance(1000, plan.step);
                const start = performance.now();
                let steps = 0;
                while (performance.now() - start < 500) run.advance(1000, plan.step), (steps += 1000);
                run.free();
                return 1000 * steps / (performance.now() - start);
            }"""
        )
    return rate


def main() -> int:
    """Test the page; print what is wrong."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    if (program := browser_program()) is None:
        return 2
    wrong: list[str] = []
    if (size := compressed_size(folder)) > LARGEST_SIZE:
        wrong.append(f"the files have {size} bytes compressed; at most {LARGEST_SIZE} are allowed")
    with served(folder) as base, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=["--no-sandbox"])
        figures = measured(browser, base, wrong)
        for system in SYSTEMS:
            for window in WINDOWS:
                for color in COLORS:
                    with opened(browser, base, f"system={system}", wrong, window, color) as tab:
                        tab.evaluate("explorer.app.playing = false")
                        found = faults(tab, window[0])
                        wrong += [f"{system}, {window[0]} pixels, {color}: {fault}" for fault in found]
        check_file(browser, folder, wrong)
        check_numbers(browser, base, wrong)
        check_planet(browser, base, wrong)
        check_address(browser, base, wrong)
        check_refusals(browser, base, wrong)
        check_keys_and_clicks(browser, base, wrong)
        check_drift(browser, base, wrong)
        check_drawings(browser, base, wrong)
        check_buttons(browser, base, wrong)
        check_sections(browser, base, wrong)
        check_failures(browser, base, wrong)
        browser.close()
    print(*wrong, sep="\n")
    print(f"{size / 1000:.0f} kB compressed, {figures}, {len(wrong)} faults")
    return bool(wrong)


if __name__ == "__main__":
    sys.exit(main())

"""The page of the kinds of pictures: each with its picture, the code that draws it, and its options."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from formulas import in_markdown
from system_pages import DOTS_PER_INCH, code

import coadjoint as co
from coadjoint.pictures.register import Kind, kinds
from coadjoint.systems.registry import gallery_entry_of

FIRST = "rigid_body", "heavy_top"
"""Systems whose pictures are shown where they declare the kind; otherwise the first one that does."""

WHEELS = """\
import numpy as np
import coadjoint as co

motors = co.forces.ReactionWheels(co.forces.Pointing(0.5, 1.5), period=0.5, max_torque=0.1, max_momentum=0.6)
system = co.systems.body((1.0, 2.0, 2.5), wheels=0.01 * np.eye(3)).with_forces(motors)
sol = co.integrate(system, system.state([0.0, 0.36, 0.48, 0.8], angular_velocity=(0.05, 0.0, 0.2)), (0, 60), 0.05)
"""
RUNS = {
    "angular momentum": """\
import coadjoint as co

system = co.systems.heavy_top(inertia=(1, 2, 3), lever=(0, 0, 1))
sol = co.integrate(system, (0.5, 0.2, 2.0, 0.6, 0.0, 0.8), (0, 30), 0.05, attitude=True)
figure = sol.plot([co.plotting.Picture("angular momentum", frame="space")])""",
    "angular velocity": """\
import coadjoint as co

system = co.systems.heavy_top(inertia=(1, 2, 3), lever=(0, 0, 1))
sol = co.integrate(system, (0.5, 0.2, 2.0, 0.6, 0.0, 0.8), (0, 30), 0.05, attitude=True)
figure = sol.plot("angular velocity")""",
    "body": """\
import coadjoint as co

system = co.systems.rigid_body(inertia=(1, 2, 3))
sol = co.integrate(system, (0.01, 1.0, 0.01), (0, 30), 0.05, attitude=True)
figure = sol.plot([co.plotting.Picture("body", at=0.6, axis=1)])""",
    "drift": """\
import coadjoint as co

system = co.systems.rigid_body(inertia=(1, 2, 3))
sol = co.integrate(system, (0.01, 1.0, 0.01), (0, 200), 0.1, co.Splitting(order=4))
figure = sol.plot("drift")""",
    "observed": """\
import coadjoint as co

system = co.systems.heavy_top(inertia=(1, 2, 3), lever=(0, 0, 1))
sol = co.integrate(
    system, (0.5, 0.2, 2.0, 0.6, 0.0, 0.8), (0, 30), 0.05,
    observe={"height": lambda x: x[5], "momentum about the vertical": lambda x: x[:3] @ x[3:]},
)
figure = sol.plot("observed")""",
    "gimbal angles": """\
import coadjoint as co

axes = [(1, 0), (0, 1), (-1, 0), (0, -1)]
gyros = [[(-q, p, 0), (-0.6 * p, -0.6 * q, 0.8)] for p, q in axes]
motors = co.forces.ControlMomentGyros(co.forces.Pointing(0.5, 1.5), period=0.5, max_rate=0.5)
system = co.systems.body((1.0, 2.0, 2.5), gyros=gyros).with_forces(motors)
sol = co.integrate(system, system.state([0.0, 0.0, 0.6, 0.8]), (0, 60), 0.05)
figure = sol.plot("gimbal angles")""",
    "pointing error": WHEELS + 'figure = sol.plot("pointing error")',
    "torques": WHEELS + 'figure = sol.plot("torques")',
    "wheel speeds": WHEELS + 'figure = sol.plot("wheel speeds")',
    "section": """\
import coadjoint as co

system = co.systems.heavy_top(inertia=(1, 2, 3), lever=(0, 0, 1))
x0 = [(m, 0.2, 2.0, 0.6, 0.0, 0.8) for m in (0.1, 0.4, 0.7)]
rises = co.Event(lambda x: x[1], direction=1)
sol = co.integrate(system, x0, (0, 1000), 0.05, co.Splitting(order=4), events=rises)
figure = sol.plot([co.plotting.Picture("section", components=("gamma1", "gamma3"))])""",
    "sphere field": """\
import numpy as np
import coadjoint as co

latitude = np.linspace(-np.pi / 2, np.pi / 2, 45)[:, None]
longitude = np.linspace(0, 2 * np.pi, 90, endpoint=False)
across = np.cos(latitude)
normals = np.stack(np.broadcast_arrays(across * np.cos(longitude), across * np.sin(longitude), np.sin(latitude)))


def along_normals(system, x):
    return np.tensordot(x, normals, axes=1)


system = co.systems.rigid_body(inertia=(1, 2, 3))
sol = co.integrate(system, (0.01, 1.0, 0.01), (0, 40), 0.1)
figure = sol.plot([co.plotting.Picture("sphere field", values=along_normals, label="x . n")])""",
}
"""Code of the pictures of kinds that no ready-made system declares."""

OPTION = re.compile(r"^([\w, ]+) : (.*)((?:\n    .*)+)", re.MULTILINE)


def picture_pages() -> dict[str, str]:
    """Return the page by its path."""
    return {"pictures/index.md": "\n".join(_page()) + "\n"}


def draw_kinds(folder: Path, library: float) -> None:
    """Draw pictures that are older than the library, by the code on the page."""
    import matplotlib

    matplotlib.use("Agg")

    folder.mkdir(parents=True, exist_ok=True)
    for name in kinds():
        path = folder / f"{file_name(name)}.png"
        if not path.exists() or path.stat().st_mtime <= library:
            names: dict[str, Any] = {}
            exec(picture_code(name), names)
            names["figure"].savefig(path, dpi=DOTS_PER_INCH)


def picture_code(name: str) -> str:
    """Return a script that draws a picture of a kind as `figure`."""
    declaring = (system for system in (*FIRST, *co.systems.names()) if name in _declared(system))
    system = next(declaring, None)
    if system is not None:
        return f'{code(system).rpartition(chr(10))[0]}\nfigure = sol.plot("{name}")'
    if name not in RUNS:
        raise ValueError(f"no ready-made system declares the picture {name!r}; write the code of one in RUNS")
    return RUNS[name]


def _declared(system: str) -> set[str]:
    entry = gallery_entry_of(system)
    return set() if entry is None else {picture.kind for picture in (*entry.pictures, entry.components)}


def file_name(name: str) -> str:
    """Return the name of the file of a picture, without its ending."""
    return re.sub(r"\W", "_", name)


def _page() -> Iterator[str]:
    yield "# Kinds of pictures\n"
    yield (
        "Every kind that `Solution.plot` draws, by its name or as a `Picture` with options: "
        '`sol.plot(["drift", co.plotting.Picture("body axis", axis=1)])`. Options without a default are needed. '
        '`help(co.plotting.kinds()["body axis"])` shows those of one kind, and `Solution.movie` draws those that move. '
        "[](../gallery.md) explains plots, and how to add a kind.\n"
    )
    for name, kind in kinds().items():
        yield from _section(name, kind)


def _section(name: str, kind: Kind) -> Iterator[str]:
    text = inspect.getdoc(kind.prepare) or ""
    summary, _, rest = text.partition("\nParameters\n----------\n")[0].partition("\n")
    yield f"## {name}\n"
    yield f"{in_markdown(summary)}\n"
    yield f":::{{figure}} {file_name(name)}.png\n:alt: A picture of the kind {name}\n:::\n"
    if rest.strip():
        yield f"{in_markdown(' '.join(rest.split()))}\n"
    if kind.moves:
        yield "It moves in movies.\n"
    if kind.options:
        yield "| option | default | values | what it is |\n|---|---|---|---|"
        yield from _rows(name, kind, text)
        yield ""
    yield f":::{{dropdown}} Code\n```python\n{picture_code(name)}\n```\n:::\n"


def _rows(name: str, kind: Kind, text: str) -> Iterator[str]:
    """Yield a row for each option; raise ValueError unless the docstring explains each once."""
    described = text.partition("\nParameters\n----------\n")[2]
    found = [
        (option, match[2], " ".join(match[3].split()))
        for match in OPTION.finditer(described)
        for option in match[1].split(", ")
    ]
    if [option for option, _, _ in found] != list(kind.options):
        raise ValueError(f"the docstring of the picture {name!r} explains {found}; its options are {[*kind.options]}")
    for option, values, meaning in found:
        default = kind.options[option].default
        shown = "needed" if default is inspect.Parameter.empty else f"`{default!r}`"
        yield f"| `{option}` | {shown} | {_cell(values.removesuffix(', optional'))} | {_cell(meaning)} |"


def _cell(text: str) -> str:
    return in_markdown(text).replace("|", "\\|")

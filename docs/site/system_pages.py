"""Pages of the ready-made systems: equations, parameters, invariants, the picture, and the code that draws it."""

from __future__ import annotations

import contextlib
import inspect
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from explorer_systems import SHOWN
from formulas import in_markdown
from starts import STARTS

import coadjoint as co
from coadjoint.methods import registry
from coadjoint.methods.registry import suggested_scheme
from coadjoint.pictures.gallery import decaying_turbulence, summary_of
from coadjoint.pictures.register import CannotShow
from coadjoint.summaries import summarize_system
from coadjoint.systems.coordinates import in_coordinates_of
from coadjoint.systems.gallery_entry import GalleryEntry
from coadjoint.systems.registry import gallery_entry_of

GROUPS = {
    "bodies": "Bodies and tops",
    "lattices": "Spins and lattices",
    "fluids": "Fluids and plasmas",
    "examples": "Light, growth and examples of the literature",
}
"""Titles of groups, by the folder of a system."""
JETS = (
    "Turbulence on a rotating planet, decaying above and forced below: the relative vorticity, and the mean eastward "
    "speed. Jets are strong at the equator, and weak where the deformation radius is small; grey, without one."
)
MAX_START = 13
MAX_FORMULAS = 12
MAX_LATEX = 400
DOTS_PER_INCH = 90
THUMBNAIL_WIDTH = 3.4


def system_pages() -> dict[str, str]:
    """Return the pages by their paths."""
    pages = {f"systems/{name}.md": "\n".join(_page(name)) + "\n" for name in co.systems.names()}
    return pages | {"systems/index.md": "\n".join(_index()) + "\n"}


def draw_pictures(folder: Path, library: float) -> None:
    """Draw pictures that are older than the library, by the code on the page of the system, with thumbnails."""
    import matplotlib

    matplotlib.use("Agg")

    for name in co.systems.names():
        path = folder / f"{name}.png"
        if path.exists() and path.stat().st_mtime > library:
            continue
        names: dict[str, Any] = {}
        exec(code(name), names)
        names["figure"].savefig(path, dpi=DOTS_PER_INCH)
        _thumbnail(names["sol"], _entry(name)).savefig(folder / f"{name}_small.png", dpi=DOTS_PER_INCH)


def write_notebooks(folder: Path) -> None:
    """Write a notebook of each system: what it is, and the code that draws its picture."""
    import nbformat
    from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook

    folder.mkdir(parents=True, exist_ok=True)
    for name in co.systems.names():
        summary = _sentence(name)
        text = f"# {name}\n\n{summary}\n\n{_entry(name).caption}"
        # Numbers in place of random identifiers, so that a notebook is the same each time.
        cells = [
            new_markdown_cell(text, id="text"),
            new_code_cell(f"%matplotlib inline\n{code(name)}\nfigure", id="code"),
        ]
        nbformat.write(new_notebook(cells=cells), folder / f"{name}.ipynb")


def _thumbnail(sol: Any, entry: GalleryEntry) -> Any:
    """Return a figure of the first declared picture that the run can show."""
    for picture in (*entry.pictures, entry.components):
        with contextlib.suppress(CannotShow):
            return sol.plot([picture], width=THUMBNAIL_WIDTH)
    raise ValueError(f"{sol.system.name} declares no picture that its run can show")


def code(name: str) -> str:
    """Return a script that runs a system as its gallery entry declares, and draws it as `figure`."""
    entry = _entry(name)
    start = STARTS.get(name) or f"x0 = {_written_out(name, entry)}"
    parameters = ", ".join(f"{key}={value!r}" for key, value in entry.parameters.items())
    options = [scheme_name(repr(suggested_scheme(co.systems.get(name, **entry.parameters))))]
    options += ["attitude=True"] if entry.attitude else []
    options += [f"save_every={entry.save_every}"] if entry.save_every > 1 else []
    return (
        f"{'import numpy as np' + chr(10) if 'np.' in start else ''}import coadjoint as co\n\n"
        f"system = co.systems.{name}({parameters})\n"
        f"{start}\n"
        f"sol = co.integrate(\n    system, x0, {entry.t_span}, {entry.step},\n    {', '.join(options)},\n)\n"
        "figure = sol.plot()"
    )


def _written_out(name: str, entry: GalleryEntry) -> list[Any]:
    """Return the numbers of an initial state, unless they are many."""
    start = np.asarray(entry.start())
    if start.size > MAX_START:
        raise ValueError(f"the gallery entry of {name} starts from {start.size} numbers; write their code in STARTS")
    return start.tolist()


def scheme_name(scheme: str) -> str:
    """Return the text of a scheme with the arguments that differ from its defaults, as code."""
    kind, _, rest = scheme.partition("(")
    defaults = registry.parameters_of(kind)
    given = [pair for pair in rest.removesuffix(")").split(", ") if pair]
    shown = [pair for pair in given if pair != f"{pair.partition('=')[0]}={defaults[pair.partition('=')[0]]!r}"]
    return f"co.{'' if kind in dir(co) else 'methods.'}{kind}({', '.join(shown)})"


def _entry(name: str) -> GalleryEntry:
    entry = gallery_entry_of(name)
    if entry is None:
        raise ValueError(f"{name} has no gallery entry; give @ready_made one, as docs/gallery.md shows")
    return entry


def _page(name: str) -> Iterator[str]:
    summary, entry = summarize_system(name), _entry(name)
    system = co.systems.get(name, **entry.parameters)
    yield f"# {name}\n"
    yield f"{_sentence(name)}\n"
    yield f":::{{figure}} {name}.png\n:alt: {entry.caption}\n:target: {name}.png\n\n{entry.caption}\n:::\n"
    yield f"```python\n{code(name)}\n```\n"
    yield f"{{download}}`The same as a notebook <{name}.ipynb>`\n"
    for shown in (shown for shown in SHOWN if f"co.systems.{name}(" in shown.code):
        yield f"<!-- explorer#system={shown.name}: {shown.title} in the explorer -->\n"
    yield "## Equations and invariants\n"
    if summary["attitude"] != "matrices":
        sign = "" if summary["sign"] > 0 else "-"
        yield f"$$ x' = {sign}J(x)\\,\\nabla H(x) $$\n"
    yield from _displayed("H", getattr(system, "hamiltonian", None), system)
    for number, casimir in enumerate(system.casimirs.values(), start=1):
        yield from _displayed(f"C_{{{number}}}", casimir, system)
    yield "| property | value |\n|---|---|"
    yield f"| algebra | {_cell(summary['algebra'] or 'none: J(x) is not linear in x')} |"
    yield f"| dimension, rank of J | {summary['dimension']}, {summary['rank']} |"
    if len(summary["coordinates"]) <= MAX_FORMULAS:
        yield f"| coordinates | {_cell(', '.join(summary['coordinates']))} |"
    for kind, missing in (("casimirs", "none is known"), ("integrals", "none beside H and the Casimirs is known")):
        title = "Casimirs" if kind == "casimirs" else kind
        yield f"| {title} | {_cell(_formulas(summary[kind])) if summary[kind] else missing} |"
    yield f"| closed form | {'`exact(x0, t)`' if summary['exact'] else 'none is known for these parameters'} |"
    yield f"| scheme to begin with | {_link(summary['scheme'])}, step {entry.step:g} |"
    kinds = dict.fromkeys(picture.kind for picture in (*entry.pictures, entry.components))
    links = (f"[{kind}](../pictures/index.md#{kind.replace(' ', '-')})" for kind in kinds)
    yield f"| pictures | {', '.join(links)} |"
    yield "\n## Docstring\n"
    yield f"```{{eval-rst}}\n.. autofunction:: coadjoint.systems.{name}\n```\n"
    yield "[All systems](index.md). [Which scheme?](../schemes.md)"


def _displayed(symbol: str, value: Any, system: Any) -> Iterator[str]:
    """Yield a polynomial of the state as a displayed formula, unless it is long."""
    if isinstance(value, co.Quadratic):
        value = value.to_polynomial() if (value.dim or MAX_FORMULAS + 1) <= MAX_FORMULAS else None
    if isinstance(value, co.Polynomial) and value.dim <= MAX_FORMULAS:
        latex = in_coordinates_of(system, value).to_latex()
        if len(latex) <= MAX_LATEX:
            yield f"$$ {symbol} = {latex} $$\n"


def _formulas(formulas: dict[str, str | None]) -> str:
    shown = [name if formula in (None, name) else f"{name} = {formula}" for name, formula in formulas.items()]
    rest = f"; and {len(shown) - MAX_FORMULAS} more" if len(shown) > MAX_FORMULAS else ""
    return "; ".join(shown[:MAX_FORMULAS]) + rest


def _cell(text: str) -> str:
    """Return text as code in a cell of a table."""
    return f"`{text}`".replace("|", "\\|")


def _link(scheme: str) -> str:
    return f"[`{scheme}`](../schemes/{scheme.partition('(')[0]}.md)"


def _sentence(name: str) -> str:
    """Return the first line of the docstring of a system as Markdown."""
    docstring = inspect.getdoc(getattr(co.systems, name)) or ""
    text = docstring.partition("\n\n")[0].replace("\n", " ").removeprefix("Return ")
    return in_markdown(text[:1].upper() + text[1:])


def _folder(name: str) -> str:
    return getattr(co.systems, name).__module__.split(".")[-2]


def thumbnails(folder: str, path: str = "") -> Iterator[str]:
    """Yield the thumbnails of the systems of a folder, with links to their pages, which are at this path."""
    yield "::::{grid} 2 2 3 3\n:gutter: 2\n:class-container: systems\n"
    for name in (name for name in co.systems.names() if _folder(name) == folder):
        yield f":::{{grid-item-card}} {name.replace('_', '_<wbr>')}\n:link: {path}{name}\n:link-type: doc"
        yield f":img-bottom: {path}{name}_small.png\n:img-alt: {_entry(name).caption}\n:::\n"
    yield "::::"


def _index() -> Iterator[str]:
    yield "# Ready-made systems\n"
    yield "Every system of `co.systems.names()`. A picture leads to equations, invariants and the code that draws it.\n"
    for folder, title in GROUPS.items():
        yield f"## {title}\n"
        yield from thumbnails(folder)
        yield ""
    left = sorted({_folder(name) for name in co.systems.names()} - set(GROUPS))
    if left:
        raise ValueError(f"systems of the folders {', '.join(left)} have no group; add a title to GROUPS")
    caption = decaying_turbulence().caption
    yield "## Large scenes\n"
    yield f":::{{figure}} ../decaying_turbulence.png\n:alt: {caption}\n\n{caption}\n:::\n"
    yield f"{summary_of(decaying_turbulence)} See [](../fluids.md).\n"
    yield "```sh\ncoadjoint gallery decaying_turbulence\n```\n"
    yield f":::{{figure}} ../jets.png\n:alt: {JETS}\n\n{JETS}\n:::\n"
    yield "See [](../planets.md#jets).\n"
    yield "```{toctree}\n:hidden:\n"
    yield from co.systems.names()
    yield "```"

"""Gallery: a picture of each system, long example runs, and an HTML page of the pictures."""

from __future__ import annotations

import html
import importlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from coadjoint.keyword_hints import suggest_keywords
from coadjoint.methods.registry import suggested_scheme
from coadjoint.optional_packages import require_packages
from coadjoint.runs.integrate import integrate
from coadjoint.runs.results.solution import Solution
from coadjoint.short_repr import short
from coadjoint.systems.fluids.sphere_euler import sphere_euler
from coadjoint.systems.gallery_entry import GalleryEntry, Picture
from coadjoint.systems.registry import gallery_entry_of, ready_made_systems

PAGE = "index.html"

_STYLE = (
    "body{font:16px/1.5 system-ui,sans-serif;color:#222;background:#fff}"
    "body{max-width:1100px;margin:2rem auto;padding:0 1rem}"
    "h1{font-size:1.6rem}h2{font-size:1.15rem;margin:2.5rem 0 .3rem}img{max-width:100%;height:auto}"
    "figure{margin:0}figcaption{margin:.4rem 0}code{background:#f3f5f8;padding:.1em .3em}nav a{margin-right:.8em}"
)


def decaying_turbulence(N: int = 128, seed: int = 1, end: float = 100.0, step: float = 0.0125) -> GalleryEntry:
    """Decaying turbulence of a fluid on the sphere, from random vorticity of degrees 3 to 8: one to three minutes."""
    views = [(at, part) for at in (0.0, 0.2, 1.0) for part in ("all", "large")]
    return GalleryEntry(
        lambda: sphere_euler(N).random(seed, degrees=(3, 8)),
        (0.0, end),
        step,
        "Vortices of like sign merge, and two of each sign are left, which keep moving. Above, the vorticity, which is "
        "stretched into filaments and fine structure. Below, its large-scale part, which is constant along "
        "streamlines.",
        tuple(Picture("vorticity", at=at, part=part, limit=3.0) for at, part in views),
        parameters={"N": N},
        save_every=max(1, round(1.0 / step)),
    )


SCENES = {"decaying_turbulence": ("sphere_euler", decaying_turbulence)}
"""Long example runs by name: a ready-made system, and a function that returns the gallery entry."""


def run_example(name: str) -> Solution:
    """Run a ready-made system over the span of its gallery entry, by the suggested scheme."""
    entry = gallery_entry_of(name)
    if entry is None:
        raise ValueError(
            f"{name} declares no start, span and step of a run; give @ready_made a GalleryEntry, as docs/gallery.md "
            "shows"
        )
    return _run(name, entry)


def _run(name: str, entry: GalleryEntry) -> Solution:
    system = importlib.import_module("coadjoint.systems").get(name, **entry.parameters)
    start, scheme, every = entry.start(), suggested_scheme(system), entry.save_every
    return integrate(system, start, entry.t_span, entry.step, scheme, save_every=every, attitude=entry.attitude)


def summary_of(function: Callable[..., Any]) -> str:
    """Return the first paragraph of the docstring of a ready-made system or a scene, as a sentence."""
    summary = " ".join((function.__doc__ or "").partition("\n\n")[0].split()).removeprefix("Return ").replace("``", "")
    return summary[:1].upper() + summary[1:]


def piece(name: str) -> tuple[Any, str]:
    """Run a ready-made system, or one of `SCENES`, over its declared span; return the figure and its HTML section."""
    require_packages("a gallery", "matplotlib")
    if name in SCENES:
        system, scene = SCENES[name]
        entry = scene()
        run = _run(system, entry)
        text = f"{_describe(run)}; {run.stats.seconds:.0f} s"
        return run.plot(entry.pictures), _section(name, summary_of(scene), entry.caption, text)
    run, declared = run_example(name), gallery_entry_of(name)
    assert declared is not None
    return run.plot(), _section(name, summary_of(ready_made_systems()[name]), declared.caption, _describe(run))


@suggest_keywords
def gallery(names: Sequence[str], draw: Callable[[Any, str], None], echo: Callable[[str], None] = print) -> str:
    """Draw systems one by one, and return an HTML page of their pictures.

    Parameters
    ----------
    names : sequence of str
        As for `piece`.
    draw : callable
        Receives a figure and the name of its file.
    echo : callable
        Receives a line of text for each system as it begins.

    Returns
    -------
    str
        HTML that needs only the pictures in its folder; each has an alternative text.
    """
    sections = {}
    for number, name in enumerate(names, start=1):
        echo(f"{number} of {len(names)}: {name}")
        figure, sections[name] = piece(name)
        draw(figure, file_of(name))
    return _page(sections)


def file_of(name: str) -> str:
    """Return the file name of a picture, such as 'rigid_body.png'."""
    return f"{Path(name).name}.png"


def _describe(solution: Solution) -> str:
    system: Any = solution.system
    values = ", ".join(f"{key}={short(value)}" for key, value in (system.parameters or {}).items())
    start, end = solution.t_span
    drift = solution.drift()["energy"]
    sizes = " to ".join(f"{size:.1e}" for size in sorted({np.min(drift.scale), np.max(drift.scale)}))
    return (
        f"{system.name}({values}), {solution.method}, step {solution.step:g}, t from {start:g} to {end:g}; "
        f"the energy stays within {drift:.1e} of its size {sizes}"
    )


def _page(sections: Mapping[str, str]) -> str:
    links = "".join(f'<a href="#{name}">{name}</a> ' for name in map(html.escape, sections))
    body = "".join(sections.values())
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>coadjoint: gallery</title>'
        f'<meta name="viewport" content="width=device-width,initial-scale=1"><style>{_STYLE}</style></head><body>\n'
        f"<h1>Every ready-made system</h1>\n<nav>{links}</nav>\n{body}</body></html>\n"
    )


def _section(name: str, summary: str, caption: str, run: str) -> str:
    picture = html.escape(file_of(name))
    name, caption = html.escape(name), html.escape(caption, quote=True)
    return (
        f'<h2 id="{name}">{name}</h2>\n<p>{html.escape(summary)}</p>\n'
        f'<figure><img src="{picture}" alt="{caption}">'
        f'<figcaption aria-hidden="true">{caption}</figcaption></figure>\n'
        f"<p><code>{html.escape(run)}</code></p>\n"
    )

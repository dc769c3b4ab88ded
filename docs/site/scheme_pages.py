"""Pages of the schemes: order, what they preserve on systems of each kind, their cost, and the docstring."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from typing import Any

import write_api
from formulas import in_markdown
from system_pages import scheme_name

import coadjoint as co
from coadjoint.methods import registry

SYSTEMS = "rigid_body", "heavy_top", "toda", "spin_lattice", "separable_cosh", "sklyanin", "sphere_euler"
"""Systems on which the declared properties are shown, one of each kind."""

NEEDED = "base", "coefficients", "order"
"""Parameters of which a scheme has no default."""


def scheme_pages() -> dict[str, str]:
    """Return the pages by their paths."""
    pages = {f"schemes/{name}.md": "\n".join(_page(name)) + "\n" for name in registry.names()}
    return pages | {"schemes/index.md": "\n".join(_index()) + "\n"}


def _index() -> Iterator[str]:
    yield "# Schemes\n"
    yield "Every scheme of `co.methods.names()`. [Which scheme?](../schemes.md) says which one to take.\n"
    yield "| scheme | |\n|---|---|"
    for name in registry.names():
        line = in_markdown(registry.documentation_of(name).partition("\n")[0]).replace("|", "\\|")
        yield f"| [`{name}`]({name}.md) | {line} |"
    yield "\n```{toctree}\n:hidden:\n"
    yield from registry.names()
    yield "```"


def _page(name: str) -> Iterator[str]:
    scheme = registry.scheme(name)
    examples = list(scheme.examples())
    shown = _default(scheme, examples)
    yield f"# {name}\n"
    yield f"{in_markdown(registry.documentation_of(name).partition(chr(10))[0])}\n"
    yield "## Order and symmetry\n"
    yield "| scheme | order | explicit | symmetric | steps |\n|---|---|---|---|---|"
    for example in examples:
        own = "of its own choice" if example.own_steps else "as given"
        yield (
            f"| `{text_of(example)}` | {example.order} | {_yes(example.explicit)} | {_yes(example.symmetric)} | {own} |"
        )
    yield "\n## What it preserves, and its cost\n"
    yield f"Of `{text_of(shown)}`, as declared; [certificates](../certificates.md) measure it."
    yield "The cost is the estimate for one step, in rotations of one pair of coordinates (about 11 ns on one core)."
    yield "Of an implicit scheme it varies with the iterations.\n"
    yield "| system | Poisson map | energy | Casimirs | attitude | cost |\n|---|---|---|---|---|---|"
    for system in SYSTEMS:
        yield _row(shown, system)
    yield from _coefficients(examples)
    yield "\n## Docstring\n"
    public = next((space for space in ("", "methods.") if name in dir(getattr(co, space[:-1], co))), None)
    qualified = scheme.__module__ if public is None else f"coadjoint.{public}".removesuffix(".")
    members = {kind: names for _, kind, names in write_api.MEMBERS_OF}.get(scheme)
    yield f"```{{eval-rst}}\n.. autoclass:: {qualified}.{name}"
    if members:
        yield f"   :members: {', '.join(members.split())}"
    yield "```\n"
    yield "[All schemes](index.md). [Which scheme?](../schemes.md)"


def _coefficients(examples: list[Any]) -> Iterator[str]:
    """Yield the section of coefficients: tableaux, sweeps and substeps of the examples that have them."""
    tables = {}
    for example in examples:
        if lines := list(_tableau(example) or _sweeps(example) or _substeps(example)):
            tables.setdefault(tuple(lines), text_of(example))
    if not tables:
        return
    yield "\n## Coefficients\n"
    for lines, name in tables.items():
        yield f"`{name}`:\n"
        yield from lines
        yield ""


def _tableau(scheme: Any) -> list[str]:
    """Return the Butcher tableau of a Runge-Kutta method: nodes, weights and the matrix of the stages."""
    if not callable(getattr(scheme, "coefficients", None)):
        return []
    found = scheme.coefficients()
    rows = zip(found.node.tolist(), (found.mix * found.scale).tolist(), strict=True)
    body = [f"| {c!r} | {' | '.join(map(repr, row))} |" for c, row in rows]
    weights = f"| b | {' | '.join(map(repr, (found.scale * found.out).tolist()))} |"
    columns = len(found.node)
    return [f"| c | {' | '.join(f'a{k + 1}' for k in range(columns))} |", "|---" * (columns + 1) + "|", *body, weights]


def _sweeps(scheme: Any) -> list[str]:
    """Return the sweeps of a splitting, each through all parts, first to last."""
    if getattr(scheme, "sweeps", None) is None:
        return []
    rows = [f"| {'forward' if one.forward else 'backward'} | {one.coefficient!r} |" for one in scheme.sweeps()]
    return ["| through the parts | fraction of the step |", "|---|---|", *rows]


def _substeps(scheme: Any) -> list[str]:
    """Return the substeps of a composition."""
    if len(scheme.fractions) == 1:
        return []
    return ["| substep | fraction of the step |", "|---|---|"] + [
        f"| {k + 1} | {one!r} |" for k, one in enumerate(scheme.fractions)
    ]


def _default(scheme: Any, examples: list[Any]) -> Any:
    """Return a scheme with its default parameters, or its first example if it has none."""
    parameters = inspect.signature(scheme).parameters.values()
    if any(
        parameter.default in (inspect.Parameter.empty, None) for parameter in parameters if parameter.name in NEEDED
    ):
        return examples[0]
    return scheme()


def _row(scheme: Any, name: str) -> str:
    system = co.systems.get(name)
    link = f"[{name}](../systems/{name}.md)"
    try:
        kept = scheme.properties(system)
        cost = f"{scheme.work(system).cost(1.0, 1.0):.3g}" if scheme.explicit else "varies"
    except (TypeError, ValueError) as reason:
        return f"| {link} | not applicable: {_escaped(str(reason).partition(';')[0])} | | | | |"
    return f"| {link} | {_yes(kept.poisson)} | {_yes(kept.energy)} | {kept.casimirs} | {kept.attitude} | {cost} |"


def text_of(scheme: Any) -> str:
    """Return a scheme as code, or as text if it is made of another one."""
    parameters = inspect.signature(type(scheme)).parameters
    if "base" in parameters or type(scheme).__name__ == "Composition":
        return str(scheme)
    return scheme_name(repr(scheme))


def _yes(value: bool) -> str:
    return "yes" if value else "no"


def _escaped(text: str) -> str:
    return text.replace("|", "\\|").replace("*", "\\*").replace("_", "\\_").replace("<", "\\<")

"""Pages of the schemes: order, what they preserve on systems of each kind, their cost, and the docstring."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from fractions import Fraction
from typing import Any

import write_api
from formulas import in_markdown
from system_pages import scheme_name

import coadjoint as co
from coadjoint.methods import commutator_free, registry
from coadjoint.methods.numerics.gauss_coefficients import gauss_legendre, radau

SYSTEMS = "rigid_body", "heavy_top", "toda", "spin_lattice", "separable_cosh", "sklyanin", "sphere_euler"
"""Systems on which the declared properties are shown, one of each kind."""

QUADRATURES = {"RadauEnergy": radau, "IsospectralGauss": gauss_legendre}
"""Nodes, weights and ratios of the coefficients to these, of schemes that are no plain Runge-Kutta methods."""

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
    yield f"`{text_of(shown)}` declares these properties; [certificates](../certificates.md) measure them."
    yield "The cost is the estimate for one step, in rotations of one pair of coordinates (about 11 ns on one core)."
    yield "The cost of an implicit scheme varies with its iterations.\n"
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
        if lines := list(_tableau(example) or _sweeps(example) or _exponentials(example) or _substeps(example)):
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
    if quadrature := QUADRATURES.get(type(scheme).__name__):
        nodes, weights, mu = quadrature(scheme.stages)
        matrix = mu * weights
    elif callable(getattr(scheme, "coefficients", None)):
        found = scheme.coefficients()
        nodes, weights, matrix = found.node, found.scale * found.out, found.mix * found.scale
    else:
        return []
    body = [f"| {c!r} | {' | '.join(map(repr, row))} |" for c, row in zip(nodes.tolist(), matrix.tolist(), strict=True)]
    last = f"| b | {' | '.join(map(repr, weights.tolist()))} |"
    columns = len(nodes)
    return [f"| c | {' | '.join(f'a{k + 1}' for k in range(columns))} |", "|---" * (columns + 1) + "|", *body, last]


def _exponentials(scheme: Any) -> list[str]:
    """Return the exponentials of a commutator-free method: where each begins, and its combination of gradients."""
    if not isinstance(scheme, commutator_free.CommutatorFree):
        return []
    stages, ends = commutator_free.SCHEMES[scheme.order]
    rows = [f"| stage {k + 2} | stage {start + 1} | {_sum(row)} |" for k, (start, row) in enumerate(stages)]
    for k, row in enumerate(ends):
        begin = f"exponential {k}" if k else "stage 1"
        rows.append(f"| new state, exponential {k + 1} of {len(ends)} | {begin} | {_sum(row)} |")
    return ["| result | of | exponential of the step times, g the gradients at the stages |", "|---|---|---|", *rows]


def _sum(row: list[Fraction]) -> str:
    terms = (f"{'-' if a < 0 else '+'} {abs(a)} g{k + 1}" for k, a in enumerate(row) if a)
    return " ".join(terms).replace(" 1 g", " g").removeprefix("+ ")


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

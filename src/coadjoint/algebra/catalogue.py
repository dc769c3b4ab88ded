"""Catalogue of Lie algebras by name, and constructions of new algebras: the namespace ``coadjoint.algebras``."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from coadjoint.algebra.families.classical import e, gl, se, sl, so, sp, su, u
from coadjoint.algebra.families.low_dimensional import A3_7, check_names, entries, low_dimensional
from coadjoint.algebra.families.phase_space import heisenberg
from coadjoint.algebra.families.products import copies, direct_sum, semidirect
from coadjoint.algebra.families.subspaces import change_of_basis, quotient, subalgebra
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.errors import refuse_others, unknown_name
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.short_repr import short
from coadjoint.validation import read_integer

__all__ = [
    "A3_7",
    "change_of_basis",
    "copies",
    "direct_sum",
    "e",
    "get",
    "gl",
    "heisenberg",
    "low_dimensional",
    "names",
    "quotient",
    "se",
    "semidirect",
    "sl",
    "so",
    "sp",
    "su",
    "subalgebra",
    "u",
]


if not TYPE_CHECKING:  # type checkers know the names above and must report any other
    __getattr__, __dir__ = refuse_others("co.algebras", __all__)


def _sp_by_half(n: int) -> LieAlgebra:
    return sp(2 * read_integer(n, "n of sp(2n)"))


# pattern -> constructor, and the names of its numbers
_FAMILIES: Mapping[str, tuple[Callable[..., LieAlgebra], tuple[str, ...]]] = {
    "e(n)": (e, ("n",)),
    "gl(n)": (gl, ("n",)),
    "heisenberg(n)": (heisenberg, ("n",)),
    "se(n)": (se, ("n",)),
    "sl(n)": (sl, ("n",)),
    "so(n)": (so, ("n",)),
    "so(p,q)": (so, ("p", "q")),
    "sp(2n)": (_sp_by_half, ("n",)),
    "su(n)": (su, ("n",)),
    "u(n)": (u, ("n",)),
}
_MEMBERS = ("e(3)", "heisenberg", "sl(2)", "so(2)", "so(3)", "so(4)")


@suggest_keywords
def names() -> tuple[str, ...]:
    """Return the names accepted by `get`: the algebras of dimension 2 to 5, families as patterns, and a few members.

    Examples
    --------
    >>> [name for name in names() if "(" in name]
    ['e(3)', 'e(n)', 'gl(n)', 'heisenberg(n)', 'se(n)', 'sl(2)', 'sl(n)', 'so(2)', 'so(3)', 'so(4)', 'so(n)', 'so(p,q)',
     'sp(2n)', 'su(n)', 'u(n)']
    >>> len([name for name in names() if name.startswith("A")])
    62
    """
    return tuple(sorted([*entries(), *_FAMILIES, *_MEMBERS]))


def families() -> dict[str, tuple[str, ...]]:
    """Return the patterns of families among `names`, with the names of their numbers."""
    return {pattern: numbers for pattern, (_, numbers) in _FAMILIES.items()}


@suggest_keywords
def get(name: str, **parameters: Any) -> LieAlgebra:
    """Return an algebra of the catalogue by name.

    Parameters
    ----------
    name : str
        One of `names`. Numbers may be written in the pattern, ``"so(5)"``, ``"so(3,1)"``, ``"sp(4)"`` (4 x 4 matrices),
        or given as parameters; ``"A5,23"`` is ``"A5_23"``, and ``"heisenberg"`` is ``"heisenberg(1)"``.
    **parameters
        The parameters of an algebra of dimension 2 to 5, or the numbers of a pattern: ``get("so(p,q)", p=3, q=1)``.

    Returns
    -------
    LieAlgebra

    Raises
    ------
    ValueError
        The name is unknown, or a parameter is missing, unknown, or out of range.
    TypeError
        The name is not a string, or a parameter not a number.

    Examples
    --------
    >>> get("so(5)")
    LieAlgebra('so(5)', dim=10, 30 brackets)
    >>> get("A5,23", b=0.5)
    LieAlgebra('A5_23(b=0.5)', dim=5...)
    >>> get("sp(2n)", n=2) == get("sp(4)")
    True
    """
    if not isinstance(name, str):
        raise TypeError(f"name of an algebra must be a string, not {short(name)}")
    compact = re.sub(r"\s", "", name)
    entry_name = compact.replace(",", "_")
    if entry_name in entries():
        return low_dimensional(entry_name, **parameters)
    if compact == "heisenberg":
        compact = "heisenberg(n)" if parameters else "heisenberg(1)"
    if compact in _FAMILIES:
        build, required = _FAMILIES[compact]
        check_names(name, required, parameters)
        return build(*(parameters[key] for key in required))
    match = re.fullmatch(r"([a-z]+)\(([0-9]{1,4000})(?:,([0-9]{1,4000}))?\)", compact)
    if match is None or match[1] not in {pattern.split("(")[0] for pattern in _FAMILIES}:
        bare = re.fullmatch(r"([a-z]+)[_-]?([0-9]{1,3})", compact)  # such as so3
        near = (f"{bare[1]}({bare[2]})",) if bare and f"{bare[1]}(n)" in _FAMILIES else names()
        raise unknown_name("algebra", name, near)
    if match[3] is not None and match[1] != "so":
        raise unknown_name("algebra", name, names())
    check_names(name, (), parameters)
    numbers = [int(number) for number in match.groups()[1:] if number is not None]
    return sp(*numbers) if match[1] == "sp" else _FAMILIES[f"{match[1]}(n)"][0](*numbers)

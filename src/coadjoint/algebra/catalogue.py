"""Catalogue of Lie algebras by name, and constructions of new algebras: the namespace ``coadjoint.algebras``."""

from __future__ import annotations

import functools
import importlib.resources
import json
import re
from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np

from coadjoint.algebra.exact.elimination import Span
from coadjoint.algebra.exact.numbers import exact_number, read_exact, rounded
from coadjoint.algebra.exact.sparse_sums import Floats
from coadjoint.algebra.families.classical import e, gl, se, sl, so, sp, su, u
from coadjoint.algebra.families.phase_space import heisenberg
from coadjoint.algebra.families.products import copies, direct_sum, semidirect
from coadjoint.algebra.families.subspaces import change_of_basis, quotient, subalgebra
from coadjoint.algebra.invariants.invariant import LOGARITHM, LogarithmicSum
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.algebra.polynomials.formulas import Number, condition_holds, parse_formula
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.caching import shared
from coadjoint.errors import refuse_others, unknown_name
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.short_repr import short
from coadjoint.validation import read_choice, read_integer

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

Constants = dict[tuple[int, int], Polynomial]


@functools.cache
def entries() -> Mapping[str, Mapping[str, Any]]:
    """Return the catalogue entries by name in published order: dim, parameters, range, brackets, invariants."""
    source = importlib.resources.files("coadjoint.algebra.families") / "low_dimensional.json"
    return {entry["name"]: entry for entry in json.loads(source.read_text(encoding="utf-8"))["algebras"]}


def parameters_of(name: str) -> tuple[str, ...]:
    """Return the names of the parameters of an algebra."""
    return tuple(entries()[name].get("parameters", ()))


def check_names(name: str, expected: Sequence[str], parameters: Mapping[str, Any]) -> None:
    """Raise a ValueError unless the parameters of an algebra have the expected names."""
    missing = [key for key in expected if key not in parameters]
    if missing:
        raise ValueError(f"algebra {name!r} needs the parameter {missing[0]!r}, as in get({name!r}, {missing[0]}=...)")
    extra = sorted(set(parameters) - set(expected))
    if extra:
        accepted = ", ".join(expected) or "none"
        raise ValueError(f"algebra {name!r} has no parameter {short(extra[0])}; it takes: {accepted}")


def read_parameters(name: str, parameters: Mapping[str, Any]) -> dict[str, Number]:
    """Validate the parameters of an algebra and return them exactly; floats are converted exactly."""
    expected = parameters_of(name)
    check_names(name, expected, parameters)
    values = {key: read_exact(parameters[key], f"{key} of {name}") for key in expected}
    condition = entries()[name].get("range")
    if condition is not None and not condition_holds(condition, values):
        shown = ", ".join(f"{key} = {_format_number(value)}" for key, value in values.items())
        raise ValueError(f"parameters of {name} are out of range: it needs {condition}, not {shown}")
    return values


def _format_number(value: Number) -> str:
    text = f"{rounded(value):g}"
    return text if Fraction(text) == value or float(text) == rounded(value) else repr(rounded(value))


def exact_constants(name: str, parameters: Mapping[str, Number]) -> Constants:
    """Return the brackets (i, j) -> sum_k c_ij^k e_k, as linear polynomials in e1 ... en with exact coefficients."""
    entry = entries()[name]
    result: Constants = {}
    for pair, text in entry["brackets"].items():
        i, j = (int(label.removeprefix("e")) - 1 for label in pair.split())
        bracket = parse_formula(text, parameters, entry["dim"], "e")
        if not isinstance(bracket, Polynomial) or any(sum(exponents) != 1 for exponents in bracket.monomials):
            raise ValueError(f"bracket {pair!r} of {name} must be a combination of basis elements, not {text!r}")
        result[i, j] = bracket
    return result


def formulas(name: str, parameters: Mapping[str, Number]) -> dict[str, Polynomial | LogarithmicSum]:
    """Return the invariants {formula: invariant} in exact arithmetic; a logarithm of a polynomial becomes this."""
    # An invariant with dense values at a point is omitted: angles in an irrational ratio, as of A5_17 with p = q = 0.
    entry = entries()[name]
    result: dict[str, Polynomial | LogarithmicSum] = {}
    for argument in entry["invariants"]:
        invariant = {"formula": argument} if isinstance(argument, str) else argument
        if "where" in invariant and not condition_holds(invariant["where"], parameters):
            continue
        formula = parse_formula(invariant["formula"], parameters, entry["dim"])
        key = invariant.get("name")
        if isinstance(formula, LogarithmicSum):
            if formula.period is None:
                continue
            if key is None and [term.kind for term in formula.terms] == [LOGARITHM]:
                formula = formula.terms[0].second
            else:
                key = key or re.sub(r"log\(([^()]*)\)", r"log|\1|", invariant["formula"]).replace("**", "^")
        elif formula.degree == 0:
            raise ValueError(f"invariant {invariant['formula']!r} of {name} is a constant")
        result[key or repr(formula)] = formula
    return result


def _representation(brackets: Constants, dim: int) -> Floats | None:
    """Return affine n x n matrices if e1 ... e_(n-1) commute, else the adjoint matrices if they are faithful."""
    last = dim - 1
    rho = np.zeros((dim, dim, dim))
    if all(j == last for _, j in brackets):
        rho[range(last), range(last), last] = 1.0
    adjoint: list[dict[int, Number]] = [{} for _ in range(dim)]
    for (i, j), bracket in brackets.items():
        for exponents, value in bracket.monomials.items():
            k = exponents.index(1)
            adjoint[i][k * dim + j], adjoint[j][k * dim + i] = exact_number(value), exact_number(-value)
            if j == last:
                rho[last, k, i] = -rounded(value)
    if all(j == last for _, j in brackets) and not np.any(rho[last, last]):
        return rho
    rho[:] = 0.0
    try:
        Span(adjoint)
    except ValueError:
        return None  # the adjoint representation annihilates the centre
    for i, row in enumerate(adjoint):
        for position, value in row.items():
            rho[i].flat[position] = rounded(value)
    return rho


@suggest_keywords
@shared
def low_dimensional(name: str, **parameters: Any) -> LieAlgebra:
    """Return one of the 62 algebras A2_1 ... A5_40.

    Parameters
    ----------
    name : str
        ``"A5_23"``; the catalogue's `get` also takes ``"A5,23"``.
    **parameters : int, float or Fraction
        The parameters named by `parameters_of`, within their range.

    Returns
    -------
    LieAlgebra
        With all dim - rank independent invariants, named by formula: `Polynomial` if possible, otherwise `Invariant`
        with the logarithm of the published one (values in floats, NaN where undefined, `period` > 0 if it contains an
        angle). A5_17 with p = q = 0 and irrational s has one less, see `formulas`. The representation is affine if
        e1 ... e_(n-1) commute, else adjoint if the centre is zero, else None.

    Raises
    ------
    TypeError, ValueError
        A parameter is missing, unknown, not a finite real number, or out of range.

    References
    ----------
    J. Patera, R. T. Sharp, P. Winternitz, H. Zassenhaus, J. Math. Phys. 17 (1976) 986.

    Examples
    --------
    >>> g = low_dimensional("A3_5", a=0.5)
    >>> g.casimirs_known["log|x2| - a*log|x1|"]([1.0, 1.0, 3.0])
    0.0
    >>> low_dimensional("A3_5", a=2.0)
    Traceback (most recent call last):
    ValueError: parameters of A3_5 are out of range: it needs a != 0 and -1 < a < 1, not a = 2
    """
    read_choice(name, "algebra", entries())
    values = read_parameters(name, parameters)
    dim = entries()[name]["dim"]
    brackets = exact_constants(name, values)
    rows = [
        (i, j, exponents.index(1), rounded(value))
        for (i, j), bracket in brackets.items()
        for exponents, value in bracket.monomials.items()
    ]
    casimirs = {
        key: formula if isinstance(formula, Polynomial) else formula.invariant()
        for key, formula in formulas(name, values).items()
    }
    shown = ", ".join(f"{key}={_format_number(value)}" for key, value in values.items())
    return LieAlgebra(
        rows,
        dim=dim,
        name=f"{name}({shown})" if shown else name,
        representation=_representation(brackets, dim),
        casimirs=casimirs,
    )


@suggest_keywords
@shared
def A3_7(a: float) -> LieAlgebra:
    """Return A_{3,7}: [e1, e3] = a e1 - e2, [e2, e3] = e1 + a e2; spirals (Bianchi VII_h), not unimodular for a != 0.

    Parameters
    ----------
    a : float
        Any finite number; 0 gives e(2).

    Returns
    -------
    LieAlgebra
        With a 3 x 3 representation by affine matrices, and the Casimir ``"log C"``, log(x1^2 + x2^2) - 2 a theta with
        theta = atan2(x2, x1): multivalued, with period 4 pi abs(a).

    Raises
    ------
    TypeError, ValueError
        a is not a finite real number.

    References
    ----------
    S. Reich, Numerical integration of the generalized Euler equations, section 5.1; J. Patera, R. T. Sharp,
    P. Winternitz, H. Zassenhaus, J. Math. Phys. 17 (1976) 986.

    Examples
    --------
    >>> A3_7(2.0).casimirs_known["log C"]([1.0, 0.0, 5.0])
    0.0
    """
    return low_dimensional("A3_7", a=a)


# pattern -> constructor, and the names of its numbers
_FAMILIES: Mapping[str, tuple[Callable[..., LieAlgebra], tuple[str, ...]]] = {
    "e(n)": (e, ("n",)),
    "gl(n)": (gl, ("n",)),
    "heisenberg(n)": (heisenberg, ("n",)),
    "se(n)": (se, ("n",)),
    "sl(n)": (sl, ("n",)),
    "so(n)": (so, ("n",)),
    "so(p,q)": (so, ("p", "q")),
    "sp(2n)": (lambda n: sp(2 * read_integer(n, "n of sp(2n)")), ("n",)),
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

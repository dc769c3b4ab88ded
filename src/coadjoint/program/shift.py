"""Casimir shifts: H - c C moves the momentum as H does, and may have fewer parts."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.polynomial import Polynomial
from coadjoint.program.parts import Part
from coadjoint.program.pencil import singular_factors
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.quadratic import Quadratic
from coadjoint.systems.terms import QuadraticTerm, Term

Shift = tuple[tuple[str, float], ...]

LARGEST_SINGULAR = 8
LARGEST_DENSE = 32  # coordinates: up to here a sum over all n^2 entries is quicker than to sort those that are not zero


def quadratic_casimirs(system: LiePoissonSystem) -> dict[str, Polynomial]:
    """Return the known Casimirs of a system that are homogeneous of degree two, by name."""
    return {
        name: casimir
        for name, casimir in system.casimirs.items()
        if isinstance(casimir, Polynomial)
        and casimir.monomials
        and all(sum(exponents) == 2 for exponents in casimir.monomials)
    }


def shifted_terms(terms: Sequence[Term], casimirs: Mapping[str, Polynomial], shift: Shift) -> tuple[Term, ...]:
    """Take multiples of quadratic Casimirs off the quadratic term of a Hamiltonian.

    Parameters
    ----------
    terms : sequence of Term
        The Hamiltonian; one of its quadratic terms belongs to no piece.
    casimirs : mapping
        Name -> quadratic Casimir.
    shift : tuple of (str, float)
        Names and factors.

    Returns
    -------
    tuple of Term
        Entries that cancel up to rounding are gone.

    Raises
    ------
    ValueError
        If a name is not known, or there is no quadratic term.
    """
    if not shift:
        return tuple(terms)
    unknown = [name for name, _ in shift if name not in casimirs]
    if unknown:
        raise ValueError(f"the shift names {unknown[0]!r}; the quadratic Casimirs are {', '.join(map(repr, casimirs))}")
    own = next((k for k, term in enumerate(terms) if isinstance(term, QuadraticTerm) and term.piece is None), None)
    if own is None:
        raise ValueError("a shift needs a quadratic term in the Hamiltonian, outside the pieces of a SplitHamiltonian")
    term = terms[own]
    assert isinstance(term, QuadraticTerm)
    entries = [(term.rows, term.indices, term.values)]
    for name, factor in shift:
        piece = _term_of(casimirs[name])
        entries.append((piece.rows, piece.indices, -factor * piece.values))
    rows, columns = (np.concatenate([entry[side] for entry in entries]) for side in (0, 1))
    values = np.concatenate([entry[2] for entry in entries])
    n = len(term.linear)
    flat, cells = rows * n + columns, np.arange(n * n) if n <= LARGEST_DENSE else None
    if cells is None:
        cells, flat = np.unique(flat, return_inverse=True)
    total: NDArray[Any] = np.bincount(flat, weights=values, minlength=len(cells))
    kept = np.abs(total) > 4 * 2.0**-53 * np.bincount(flat, weights=np.abs(values), minlength=len(cells))
    rows, columns = np.divmod(cells[kept], n)
    indptr = np.searchsorted(rows, np.arange(n + 1))
    changed = QuadraticTerm(indptr, columns, total[kept], term.linear, term.constant)
    return (*terms[:own], changed, *terms[own + 1 :])


# A scan over constants takes off the same Casimir again and again.
@lru_cache(maxsize=256)
def _term_of(casimir: Polynomial) -> QuadraticTerm:
    (term,) = Quadratic.from_polynomial(casimir).terms()
    assert isinstance(term, QuadraticTerm)
    return term


def candidate_shifts(system: LiePoissonSystem, parts: Sequence[Part]) -> Iterable[Shift]:
    """Yield shifts after which a coordinate, a part, or a completed square may vanish.

    Parameters
    ----------
    system : LiePoissonSystem
        The system.
    parts : sequence of Part
        Its parts without a shift.

    Yields
    ------
    tuple of (str, float)
        Each at most once.
    """
    quadratic = [term for term in system.hamiltonian.terms() if isinstance(term, QuadraticTerm) and term.piece is None]
    casimirs = quadratic_casimirs(system)
    if not quadratic or not casimirs:
        return
    own = quadratic[0].rows == quadratic[0].indices
    diagonal = dict(zip(quadratic[0].indices[own].tolist(), quadratic[0].values[own].tolist(), strict=True))
    holders = _holders(casimirs)
    seen: set[Shift] = {()}
    for part in parts:
        # All coordinates of a part at once, each by the first Casimir that holds its square: a lattice has one a spin.
        factors: dict[str, float] = {}
        for coordinate in sorted({i for form, _ in part.forms for i in form}):
            for name, entry in holders.get(coordinate, [])[:1]:
                factors.setdefault(name, diagonal.get(coordinate, 0.0) / entry)
        seen.add(together := tuple((name, factor) for name, factor in sorted(factors.items()) if factor))
        if together:
            yield together
        for coordinate in sorted({i for form, _ in part.forms for i in form}) if len(casimirs) <= 4 else []:
            for name, entry in holders.get(coordinate, []):
                alone: Shift = ((name, diagonal.get(coordinate, 0.0) / entry),)
                if alone[0][1] and alone not in seen:
                    seen.add(alone)
                    yield alone
    if len(casimirs) == 1 and system.dim <= LARGEST_SINGULAR:
        ((name, casimir),) = casimirs.items()
        for factor in singular_factors(_dense(quadratic[0]), _dense(_term_of(casimir))):
            if ((name, factor),) not in seen:
                yield ((name, factor),)


def _holders(casimirs: Mapping[str, Polynomial]) -> dict[int, list[tuple[str, float]]]:
    """Return for each coordinate the Casimirs with its square, and the entry of their matrix there."""
    found: dict[int, list[tuple[str, float]]] = {}
    for name, casimir in casimirs.items():
        for exponents, coefficient in casimir.monomials.items():
            if 2 in exponents:
                found.setdefault(exponents.index(2), []).append((name, 2.0 * float(coefficient)))
    return found


def _dense(term: QuadraticTerm) -> NDArray[np.float64]:
    matrix = np.zeros((len(term.linear),) * 2)
    matrix[term.rows, term.indices] = term.values
    return matrix

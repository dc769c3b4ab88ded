"""Which parts? A Hamiltonian taken apart into pieces of commuting forms, each with an exact flow."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.polynomial import Polynomial
from coadjoint.program.parts import (
    Commutation,
    FunctionShare,
    LinearShare,
    Part,
    PolynomialShare,
    few_parts,
    joined,
    unit_forms,
)
from coadjoint.program.squares import complete_squares
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.quadratic import Quadratic
from coadjoint.systems.terms import FunctionTerm, PolynomialTerm, QuadraticTerm, Term

Choice = str | Sequence[Sequence[int]]

LARGEST_PATTERN = 64  # coordinates: the parts of larger systems are not remembered


def split(system: LiePoissonSystem, choice: Choice = "auto", terms: Sequence[Term] | None = None) -> tuple[Part, ...]:
    """Take the Hamiltonian of a system apart into parts with exact flows (section 4 of Reich 1993, generalised).

    Parameters
    ----------
    system : LiePoissonSystem
        The system.
    choice : "auto", "coordinates", or sequence of sequences of int
        ``"auto"`` joins commuting coordinates; ``"coordinates"`` gives each coordinate (or completed square) a part of
        its own, as in the paper; sets of coordinates are taken as they stand, in that order.

    Returns
    -------
    tuple of Part
        In the order in which a forward sweep applies them.

    Raises
    ------
    ValueError
        If the Hamiltonian is not a sum of functions of commuting forms, or the sets given do not serve it.
    """
    commutation = Commutation(system.algebra)
    terms = terms or system.hamiltonian.terms()
    if isinstance(choice, str) and choice == "auto" and system.dim <= LARGEST_PATTERN and len(terms) == 1:
        (term,) = terms
        known = _parts_by_pattern(term, commutation) if isinstance(term, QuadraticTerm) and term.piece is None else None
        if known is not None:
            return known
    atoms = sorted(_atoms(system, terms, commutation, apart=choice == "coordinates"), key=_first_coordinate)
    if choice == "coordinates":
        return tuple(atoms)
    if isinstance(choice, str):
        return few_parts(atoms, commutation)
    return _as_given(system, choice, atoms, commutation)


class _Pattern:
    """Where a matrix and a linear part are not zero, and what commutes; equal where both are."""

    def __init__(self, term: QuadraticTerm, commutation: Commutation) -> None:
        self.term, self.commutation = term, commutation
        self._key = (*commutation.key, *(part.tobytes() for part in (term.indptr, term.indices, term.linear != 0)))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Pattern) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)


def _parts_by_pattern(term: QuadraticTerm, commutation: Commutation) -> tuple[Part, ...] | None:
    """Return the automatic parts of a quadratic term where no square is completed: then no entry decides on them."""
    template = _template(_Pattern(term, commutation))
    if template is None:
        return None
    return tuple(
        Part(
            part.forms,
            tuple(
                LinearShare(term.linear[share.offset], share.indptr, share.columns, term.values[share.weights])
                for share in part.shares
                if isinstance(share, LinearShare)
            ),
        )
        for part in template
    )


@lru_cache(maxsize=1024)
def _template(pattern: _Pattern) -> tuple[Part, ...] | None:
    """Return the parts with places in `linear` and `values` for numbers; None where a square must be completed."""
    term, commutation = pattern.term, pattern.commutation
    used = term.linear != 0
    used[term.rows] = True
    clusters = _clusters(term.linear.size, zip(term.rows, term.indices, strict=True), used)
    if any(commutation.first_clash(cluster) is not None for cluster in clusters):
        return None
    entries: Any = np.arange(term.values.size)
    coordinates: Any = np.arange(term.linear.size)
    places = QuadraticTerm(term.indptr, term.indices, entries, coordinates)
    atoms = [Part(unit_forms(cluster), (_rows_of(places, cluster),)) for cluster in clusters]
    return few_parts(sorted(atoms, key=_first_coordinate), commutation)


def _first_coordinate(part: Part) -> int:
    return min(i for form, _ in part.forms for i in form)


def _atoms(system: LiePoissonSystem, terms: Sequence[Term], commutation: Commutation, apart: bool) -> Iterable[Part]:
    pieces: dict[int, list[Part]] = {}
    size = system.dim
    for term in terms:
        keep = term.piece
        if isinstance(term, QuadraticTerm):
            parts = list(_quadratic_atoms(term, size, commutation, apart and keep is None))
        elif isinstance(term, PolynomialTerm):
            parts = list(_polynomial_atoms(system, term.polynomial, commutation, apart and keep is None))
        else:
            parts = [_function_atom(system, term, commutation)]
        if keep is not None:
            pieces.setdefault(keep, []).extend(parts)
        else:
            yield from parts
    for parts in pieces.values():
        if parts:
            yield joined(parts)


def _clusters(size: int, links: Iterable[tuple[Any, Any]], used: NDArray[np.bool_]) -> list[list[int]]:
    """Return the connected sets of the coordinates in use."""
    parent = np.arange(size)

    def root(i: int) -> int:
        while parent[i] != i:
            parent[i] = parent[parent[i]]
            i = int(parent[i])
        return i

    for i, j in links:
        a, b = root(int(i)), root(int(j))
        parent[max(a, b)] = min(a, b)
    found: dict[int, list[int]] = {}
    for i in np.flatnonzero(used):
        found.setdefault(root(int(i)), []).append(int(i))
    return list(found.values())


def _quadratic_atoms(term: QuadraticTerm, size: int, commutation: Commutation, apart: bool) -> Iterable[Part]:
    links = zip(term.rows, term.indices, strict=True)
    used = term.linear != 0
    used[term.rows] = True
    for cluster in _clusters(size, links, used):
        coupled = len(cluster) > 1
        if coupled and (apart or commutation.first_clash(cluster) is not None):
            yield from _square_atoms(term, cluster)
        else:
            yield Part(unit_forms(cluster), (_rows_of(term, cluster),))


def _rows_of(term: QuadraticTerm, cluster: list[int]) -> LinearShare:
    slices = [slice(int(term.indptr[i]), int(term.indptr[i + 1])) for i in cluster]
    columns = np.concatenate([term.indices[s] for s in slices])
    weights = np.concatenate([term.values[s] for s in slices])
    indptr = np.concatenate([[0], np.cumsum([s.stop - s.start for s in slices])])
    return LinearShare(term.linear[cluster], indptr, columns, weights)


def _square_atoms(term: QuadraticTerm, cluster: list[int]) -> Iterable[Part]:
    place = {i: k for k, i in enumerate(cluster)}
    dense = np.zeros((len(cluster), len(cluster)), dtype=term.values.dtype)
    for i in cluster:
        for entry in range(int(term.indptr[i]), int(term.indptr[i + 1])):
            dense[place[i], place[int(term.indices[entry])]] += term.values[entry]
    squares = complete_squares(dense, term.linear[cluster])
    # A square below the rounding of the entries is one that a Casimir shift made vanish.
    floor = 8 * 2.0**-53 * np.max(np.abs(dense))
    for form, weight, beta in zip(*squares, strict=True):
        if beta == 0 and abs(weight) * max(abs(form)) ** 2 <= floor:
            continue
        present = np.flatnonzero(form != 0)
        coordinates = tuple(cluster[k] for k in present)
        values = tuple(form[present])
        used = weight != 0
        share = LinearShare(
            np.array([beta]),
            np.array([0, len(values) if used else 0]),
            np.array(coordinates if used else (), dtype=np.int64),
            np.array([weight * value for value in values] if used else ()),
        )
        yield Part(((coordinates, values),), (share,))


def _variables(exponents: tuple[int, ...]) -> list[int]:
    return [k for k, e in enumerate(exponents) if e]


def _polynomial_atoms(
    system: LiePoissonSystem, polynomial: Polynomial, commutation: Commutation, apart: bool
) -> Iterable[Part]:
    size = polynomial.dim
    monomials = {e: c for e, c in polynomial.monomials.items() if sum(e)}
    used = np.zeros(size, dtype=bool)
    links: list[tuple[int, int]] = []
    for exponents in monomials:
        variables = _variables(exponents)
        used[variables] = True
        links.extend((variables[0], other) for other in variables[1:])
    for cluster in _clusters(size, links, used):
        own = {e: c for e, c in monomials.items() if e[cluster[0]] or any(e[k] for k in cluster)}
        if commutation.first_clash(cluster) is None and not (apart and len(cluster) > 1):
            yield Part(unit_forms(cluster), (PolynomialShare(tuple(cluster), Polynomial(own)),))
            continue
        low = {e: c for e, c in own.items() if sum(e) <= 2}
        if low:
            for quadratic in Quadratic.from_polynomial(Polynomial(low)).terms():
                assert isinstance(quadratic, QuadraticTerm)
                yield from _quadratic_atoms(quadratic, size, commutation, apart)
        for exponents in (e for e in own if sum(e) > 2):
            variables = _variables(exponents)
            clash = commutation.first_clash(variables)
            if clash is not None:
                monomial = Polynomial({exponents: own[exponents]})
                raise _not_split(system, f"its monomial {monomial!r}", clash)
            share = PolynomialShare(tuple(variables), Polynomial({exponents: own[exponents]}))
            yield Part(unit_forms(variables), (share,))


def _function_atom(system: LiePoissonSystem, term: FunctionTerm, commutation: Commutation) -> Part:
    clash = commutation.first_clash(term.coordinates.tolist())
    if clash is not None:
        raise _not_split(system, "a function in it", clash)
    return Part(unit_forms(term.coordinates.tolist()), (FunctionShare(term),), term.timed)


def _not_split(system: LiePoissonSystem, what: str, clash: tuple[int, int]) -> ValueError:
    first, second = (system.algebra.basis[k] for k in clash)
    return ValueError(
        f"Splitting cannot serve {system.name}: {what} couples {first} and {second}, which do not commute; "
        "give H as a sum of functions of commuting coordinates (SplitHamiltonian), or use GaussLegendre"
    )


def _as_given(
    system: LiePoissonSystem, choice: Sequence[Sequence[int]], atoms: list[Part], commutation: Commutation
) -> tuple[Part, ...]:
    sets = [{int(i) for i in group} for group in choice]
    basis = system.algebra.basis
    for group in sets:
        outside = [i for i in sorted(group) if not 0 <= i < system.dim]
        if outside:
            raise ValueError(f"parts name coordinate {outside[0]}, but coordinates run from 0 to {system.dim - 1}")
        clash = commutation.first_clash(group)
        if clash is not None:
            raise ValueError(f"parts put {basis[clash[0]]} and {basis[clash[1]]} together, which do not commute")
    chosen: list[list[Part]] = [[] for _ in sets]
    for atom in atoms:
        coordinates = {i for form, _ in atom.forms for i in form}
        home = next((k for k, group in enumerate(sets) if coordinates <= group), None)
        if home is None:
            left = sorted(coordinates.difference(*sets))
            if left:
                raise ValueError(
                    f"parts leave out {basis[left[0]]} (coordinate {left[0]}), which the Hamiltonian depends on"
                )
            names = ", ".join(basis[i] for i in sorted(coordinates))
            raise ValueError(f"parts must hold {names} in one set, since the Hamiltonian couples them")
        chosen[home].append(atom)
    return tuple(joined(group) for group in chosen if group)

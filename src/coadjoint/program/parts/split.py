"""Splitting of a Hamiltonian into parts: pieces of commuting forms, each with an exact flow."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, lru_cache, partial
from itertools import pairwise
from types import SimpleNamespace
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.sparse_sums import Integers, connected, distinct
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.algebra.polynomials.polynomial import Polynomial, SparseKey, SparseMonomials, SparsePolynomial
from coadjoint.program.commutation import few_parts, first_noncommuting, has_noncommuting, ideals
from coadjoint.program.generators import NotSplittable, check_products
from coadjoint.program.parts.covering import groups_of_products
from coadjoint.program.parts.part import GradientShare, Parts
from coadjoint.program.parts.powers_of_forms import MAX_DEGREE, parts_of_powers
from coadjoint.program.parts.squares import DENSE_ROW, MAX_RATIONAL_SIZE, Squares, sparse_squares
from coadjoint.program.separated_parts import joined_if_cancelling
from coadjoint.program.sparse_rows import MAX_PATTERN_SIZE, Pattern, SparseRows, order_by, run_starts, starts_of
from coadjoint.program.term_table import rows_of_form
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.short_repr import short
from coadjoint.systems.coordinates import coordinate_names, in_coordinates_of
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.hamiltonians.repeated_rows import values_at
from coadjoint.systems.hamiltonians.separated_function import separated
from coadjoint.systems.hamiltonians.terms import FunctionTerm, PolynomialTerm, QuadraticTerm, Term
from coadjoint.systems.hamiltonians.traced_function import TracingError
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.user_functions import without_multiples
from coadjoint.systems.vanishing_products import field_products, products_without_cancelling

# Number of entries above which the width of squares is checked.
MIN_CHECKED_ENTRIES = 1 << 14


def quadratic_atoms(term: QuadraticTerm, algebra: LieAlgebra, separate: bool) -> Parts:
    """Split a quadratic term into parts of one share each, by the first coordinate of each connected set."""
    label, members, squared = _sets(term, algebra, separate)
    if not separate and np.any(squared):
        *groups, rest = separated_products(term, algebra, squared[label] & (label >= 0), label)
        if groups:
            return Parts.concatenate(
                [*(_commuting(one, algebra) for one in groups), quadratic_atoms(rest, algebra, separate)]
            )
    if not len(members):
        return Parts.concatenate([])
    plain = members[~squared[label[members]]]
    atoms = [_coupled(term, plain, label[plain])]
    owner = [label[plain][run_starts(label[plain])]]
    if np.any(squared):
        central = np.diff(algebra.neighbours()[0]) == 0
        squares, cluster = _square_atoms(term, members[squared[label[members]]], label, central)
        atoms, owner = [*atoms, squares], [*owner, cluster]
    return Parts.concatenate(atoms).take(np.argsort(np.concatenate(owner), kind="stable"))


def coupled_atoms(term: QuadraticTerm, algebra: LieAlgebra) -> Parts | None:
    """Return `quadratic_atoms` if all coupled coordinates commute, else None."""
    label, members, squared = _sets(term, algebra, separate=False)
    return None if np.any(squared) else _coupled(term, members, label[members])


def check_width(term: QuadraticTerm, algebra: LieAlgebra) -> None:
    """Raise NotSplittable if completed squares of many coupled coordinates have too many entries."""
    if term.multiplications < MIN_CHECKED_ENTRIES or int(np.diff(term.indptr).max(initial=0)) < DENSE_ROW:
        return
    label, members, squared = _sets(term, algebra, separate=False)
    label = label[members]
    size, entries = np.bincount(label), np.bincount(label, weights=np.diff(term.indptr)[members])
    ideal, _ = ideals(algebra)
    if np.bincount(ideal[members]).max() <= MAX_RATIONAL_SIZE:
        return  # products are separated
    full = squared & (entries >= DENSE_ROW * size)
    # The generator of a coordinate has as many entries as structure constants contain it.
    i, j, _, _ = algebra.triples
    entries_of = np.bincount(np.concatenate([i, j]), minlength=algebra.dim)
    products = np.bincount(label, weights=entries_of[members]) / 2
    check_products(np.repeat(products[full].astype(np.int64), size[full]), "the Hamiltonian")


def _sets(term: QuadraticTerm, algebra: LieAlgebra, separate: bool) -> tuple[Integers, Integers, NDArray[np.bool_]]:
    """Label the connected sets of coupled coordinates, -1 if a coordinate is unused."""
    used = term.linear != 0
    first: NDArray[Any]
    second: NDArray[Any]
    if (matrix := term.repeated) is not None:
        first, second = matrix.edges()
        used |= matrix.lengths > 0
    else:
        rows = term.rows
        above = rows < term.indices
        first, second = rows[above], term.indices[above].astype(np.int64)
        used[rows] = True
    label = connected(len(term.linear), first, second)
    label[~used] = -1
    members = np.flatnonzero(used)
    members = members[order_by(label[members])]
    size = np.bincount(label[members], minlength=1)
    squared = size > 1
    if not separate:
        squared = squared & has_noncommuting(algebra, label)[: len(size)]
    return label, members, squared


def separated_products(
    term: QuadraticTerm, algebra: LieAlgebra, squared: NDArray[np.bool_], label: Integers
) -> list[QuadraticTerm]:
    """Split the products of large sets into terms of which all coordinates commute; squares would fill up.

    The last term has the products within an ideal. Sets of large ideals, or of fewer squares, stay as they are.
    """
    rows, indices, values, size = term.rows, term.indices, term.values, len(term.linear)
    number = np.bincount(label[squared], minlength=size)
    large = squared & (number > MAX_RATIONAL_SIZE)[label]
    ideal, axis = ideals(algebra)
    if np.bincount(ideal[large], minlength=1).max() > MAX_RATIONAL_SIZE:
        return [term]
    above = np.flatnonzero((rows < indices) & large[rows] & (ideal[rows] != ideal[indices]))
    i, j = rows[above], indices[above].astype(np.int64)
    group = groups_of_products(i, j, ideal, axis)
    # Each entry of M goes with its product, and what concerns one coordinate with the first of its products.
    groups = int(group.max(initial=-1)) + 1
    if groups >= number.max():
        return [term]
    owner = np.full(size, groups)
    np.minimum.at(owner, np.concatenate([i, j]), np.concatenate([group, group]))
    within = rows[(rows != indices) & (ideal[rows] == ideal[indices])]
    owner[np.isin(ideal, ideal[within])] = groups
    of_entry = np.where(rows == indices, owner[rows], groups)
    key = i * size + j
    order = np.argsort(key)
    keys = np.minimum(rows, indices) * size + np.maximum(rows, indices)
    position = np.minimum(np.searchsorted(key[order], keys), len(key) - 1)
    product = key[order][position] == keys if len(key) else np.zeros(len(keys), dtype=bool)
    of_entry[product] = group[order][position[product]]
    terms: list[QuadraticTerm] = []
    for g in range(groups + 1):
        chosen = of_entry == g
        linear = np.where(owner == g, term.linear, 0.0)
        indptr = np.searchsorted(rows[chosen], np.arange(size + 1))
        constant = term.constant if not terms else 0 * term.constant
        terms.append(
            QuadraticTerm(indptr, indices[chosen], values[chosen], linear, constant=constant, piece=term.piece)
        )
    return terms


def _coupled(term: QuadraticTerm, members: Integers, label: Integers) -> Parts:
    """Build one part per set of coordinates, with the rows of M as angles."""
    row = np.append(np.flatnonzero(run_starts(label)), len(members))
    matrix = rows_of_form(term)
    weights = matrix if len(members) == len(term.linear) and np.all(np.diff(members) == 1) else matrix.take(members)
    units = SparseRows.units(members)
    return Parts.linear(units, values_at(term.linear, members), weights.with_target(units.coordinate), row, source=0)


def _commuting(term: QuadraticTerm, algebra: LieAlgebra) -> Parts:
    """Build one part of a term whose coordinates commute."""
    label, members, _ = _sets(term, algebra, separate=False)
    parts = _coupled(term, members, label[members])
    return parts.joined(np.zeros(len(parts), dtype=np.int64))


def _square_atoms(
    term: QuadraticTerm, members: Integers, label: Integers, central: NDArray[np.bool_]
) -> tuple[Parts, Integers]:
    """Build one part per completed square; also return the label of its set."""
    ends = np.append(np.flatnonzero(run_starts(label[members])), len(members))
    local_index = np.zeros(len(term.linear), dtype=np.int64)
    local_index[members] = np.arange(len(members)) - np.repeat(ends[:-1], np.diff(ends))
    matrix = rows_of_form(term).take(members)
    local, linear = local_index[matrix.coordinate], term.linear[members]
    cache: dict[Any, Squares] = {}
    squares: list[Squares] = []
    for first, last in pairwise(ends.tolist()):
        start, entries = matrix.start[first : last + 1], slice(*matrix.start[[first, last]])
        block = SparseRows(start - start[0], local[entries].astype(np.uint32), matrix.value[entries])
        # Sets that repeat, as in a lattice, have equal squares, which are computed once.
        own = central[members[first:last]]
        key = tuple(column.tobytes() for column in (*block, linear[first:last], own))
        if key not in cache:
            cache[key] = _without_rounding(sparse_squares(block, linear[first:last], own), block.value)
        squares.append(cache[key])
    counts = np.array([len(square.weights) for square in squares])
    forms = SparseRows.concatenate([square.forms for square in squares])
    shift = np.repeat(ends[:-1], [len(square.forms.value) for square in squares])
    forms = forms._replace(coordinate=members[forms.coordinate + shift].astype(np.uint32))
    factor = np.concatenate([square.weights for square in squares])
    used = factor != 0
    used_forms = forms.take(np.flatnonzero(used))
    lengths = np.where(used, np.diff(forms.start), 0)
    weights = SparseRows(
        starts_of(lengths), used_forms.coordinate, np.repeat(factor[used], np.diff(used_forms.start)) * used_forms.value
    )
    offset = np.concatenate([square.linear for square in squares])
    parts = Parts.linear(forms, offset, weights, np.arange(len(factor) + 1))
    if np.diff(ends).max() > MAX_RATIONAL_SIZE:
        parts.pivots = np.concatenate([square.pivots for square in squares])
        parts.pivots[:, 1:] = members[parts.pivots[:, 1:] + np.repeat(ends[:-1], counts)[:, None]]
    return parts, np.repeat(label[members[ends[:-1]]], counts)


def _without_rounding(squares: Squares, entries: NDArray[np.float64]) -> Squares:
    """Drop squares below the rounding of the entries, which vanish after a Casimir shift."""
    # The entries are differences, rounded twice, and each pivot twice again.
    floor = 8 * UNIT_ROUNDOFF * np.max(np.abs(entries))
    largest = np.maximum.reduceat(np.abs(squares.forms.value), squares.forms.start[:-1])
    significant = np.flatnonzero((squares.linear != 0) | (np.abs(squares.weights) * largest**2 > floor))
    rest = (column[significant] for column in squares[1:])
    return Squares(squares.forms.take(significant), *rest)


Choice = str | Sequence[Sequence[int]]


def split(system: LiePoissonSystem, choice: Choice = "auto", terms: Sequence[Term] | None = None) -> Parts:
    """Split the Hamiltonian of a system into parts with exact flows (section 4 of Reich 1993, generalised)."""
    algebra = system.algebra
    cancels = cache(partial(_cancels, system, terms))
    terms = terms or system.hamiltonian.terms()
    if choice == "auto" and system.dim <= MAX_PATTERN_SIZE:
        cached = _parts_by_pattern(terms, algebra)
        if cached is not None and not cancels():
            return cached
    atoms = _by_first_coordinate(_atoms(system, terms, separate=choice == "coordinates"))
    if choice == "coordinates":
        return atoms
    if isinstance(choice, str):
        if cancels():
            atoms = joined_if_cancelling(algebra, atoms)
        return few_parts(atoms, algebra)
    return _join_as_chosen(system, choice, atoms)


def _cancels(system: LiePoissonSystem, terms: Sequence[Term] | None) -> bool:
    """Whether products of the field cancel, by H or by other terms."""
    found = field_products(system) if terms is None else products_without_cancelling(system.algebra, terms)
    return found is not None


def atoms_of(system: LiePoissonSystem, terms: Sequence[Term]) -> Parts:
    """Return the smallest parts of terms, before any are joined."""
    return _by_first_coordinate(_atoms(system, terms, separate=False))


def _by_first_coordinate(atoms: Parts) -> Parts:
    return atoms.take(np.argsort(atoms.first_coordinate, kind="stable")) if len(atoms) else atoms


def _parts_by_pattern(terms: Sequence[Term], algebra: LieAlgebra) -> Parts | None:
    """Return the automatic parts of a single quadratic term without completed squares, else None."""
    term = terms[0].form
    if len(terms) > 1 or term is None or term.piece is not None:
        return None
    columns = (term.indptr, term.indices, term.linear != 0)
    model = _parts_of_pattern(Pattern((term, algebra), *columns, *algebra.neighbours()))
    if model is None:
        return None
    weights = model.weights
    assert isinstance(weights, SparseRows), "patterns are small"
    weights = weights._replace(value=term.values[weights.value])
    return replace(model, offset=term.linear[model.forms.coordinate], weights=weights)


@lru_cache(maxsize=1024)
def _parts_of_pattern(pattern: Pattern[tuple[QuadraticTerm, LieAlgebra]]) -> Parts | None:
    """Return the parts, and the index of each weight among the values of the term."""
    term, algebra = pattern.source
    indices: Any = np.arange(len(term.values))
    atoms = coupled_atoms(replace(term, values=indices), algebra)
    return None if atoms is None else few_parts(_by_first_coordinate(atoms), algebra)


def _read(
    system: LiePoissonSystem,
    term: Term,
    quadratic: Callable[[QuadraticTerm], Any],
    polynomial: Callable[[PolynomialTerm], Any],
    function: Callable[[FunctionTerm], Any],
) -> None:
    """Pass a term to one of the functions, and for functions of noncommuting coordinates the terms of their sums."""

    def summands(one: FunctionTerm) -> None:
        if first_noncommuting(system.algebra, one.coordinates.tolist()) is None:
            function(one)
        else:
            for summand in separated_terms(system, one):
                summand.describe_to(reader)

    reader = SimpleNamespace(quadratic=quadratic, polynomial=polynomial, function=summands)
    term.describe_to(reader)


def _atoms_of_term(system: LiePoissonSystem, term: Term, separate: bool) -> Parts:
    found: list[Parts] = []
    _read(
        system,
        term,
        lambda one: found.append(quadratic_atoms(one, system.algebra, separate)),
        lambda one: found.append(_polynomial_atoms(system, one.polynomial, separate)),
        lambda one: found.append(Parts.single(GradientShare(tuple(one.coordinates.tolist()), term=one), one.timed)),
    )
    return Parts.concatenate(found)


def _atoms(system: LiePoissonSystem, terms: Sequence[Term], separate: bool) -> Parts:
    result: list[Parts] = []
    pieces: dict[int, list[Parts]] = {}
    for number, term in enumerate(terms):
        parts = _atoms_of_term(system, term, separate and term.piece is None).of_term(number)
        if term.piece is None:
            result.append(parts)
        else:
            pieces.setdefault(term.piece, []).append(parts)
    for members in pieces.values():
        joined = Parts.concatenate(members)
        result.append(joined.joined(np.zeros(len(joined), dtype=np.int64)))
    return Parts.concatenate(result)


def _polynomial_atoms(system: LiePoissonSystem, polynomial: Polynomial, separate: bool) -> Parts:
    size = polynomial.dim
    found = {tuple(factors.items()): value for _, value, factors in polynomial._factors if factors}
    used = np.zeros(size, dtype=bool)
    used[[k for key in found for k, _ in key]] = True
    links = [(key[0][0], k) for key in found for k, _ in key[1:]]
    label = connected(size, *np.array(links, dtype=np.int64).reshape(-1, 2).T)
    monomials: dict[int, SparseMonomials] = {int(k): {} for k in distinct(label[used])}
    for key, value in found.items():
        monomials[int(label[key[0][0]])][key] = value
    members = {k: np.flatnonzero(used & (label == k)).tolist() for k in monomials}
    atoms = []
    for k, cluster in members.items():
        terms = monomials[k]
        if first_noncommuting(system.algebra, cluster) is None and not (separate and len(cluster) > 1):
            atoms.append(Parts.single(GradientShare(tuple(cluster), SparsePolynomial(terms, size))))
            continue
        low = {key: value for key, value in terms.items() if _degree(key) <= 2}
        if low:
            form = Quadratic.from_polynomial(SparsePolynomial(low, size)).terms()[0].form
            assert form is not None
            atoms.append(quadratic_atoms(form, system.algebra, separate))
        high = {key: value for key, value in terms.items() if key not in low}
        if any(first_noncommuting(system.algebra, [i for i, _ in key]) is not None for key in high):
            for key, value in high.items():
                _check_monomial(system, key, value)
            # The parts after each shift by Casimirs have the same powers.
            cache = _POWERS_CACHE.setdefault(system, {})
            if (id(polynomial), k) not in cache:
                cache[id(polynomial), k] = polynomial, parts_of_powers(system.algebra, high, size)
            atoms += cache[id(polynomial), k][1]
            continue
        for key, value in high.items():
            share = GradientShare(tuple(i for i, _ in key), SparsePolynomial({key: value}, size))
            atoms.append(Parts.single(share))
    return Parts.concatenate(atoms)


def _degree(key: SparseKey) -> int:
    return sum(e for _, e in key)


def separated_terms(system: LiePoissonSystem, term: FunctionTerm) -> tuple[Term, ...]:
    """Return a function of noncommuting coordinates as a sum of a polynomial and functions of commuting ones."""
    cache = _SEPARATED_CACHE.setdefault(system, {})
    if id(term.value) not in cache:
        found: tuple[Term, ...] = ()
        refused: str | None = getattr(without_multiples(term.value)[0], "not_split", None)
        refusal = partial(_not_splittable, system, "a function in it")
        try:
            if refused is None:
                found = separated(term, system.dim, partial(first_noncommuting, system.algebra), refusal)
        except NotSplittable as reason:
            refused = str(reason)
        except TracingError as reason:
            noncommuting = first_noncommuting(system.algebra, term.coordinates.tolist())
            assert noncommuting is not None
            refused = str(refusal(noncommuting, str(reason)))
        cache[id(term.value)] = term.value, found, refused
    _, found, refused = cache[id(term.value)]
    if refused is not None:
        raise NotSplittable(refused)
    return found


def separated_functions(system: LiePoissonSystem) -> dict[int, tuple[Term, ...]]:
    """Return the sums of the functions in H that depend on noncommuting coordinates, by the numbers of their terms."""
    functions = {k: term for k, term in enumerate(system.hamiltonian.terms()) if isinstance(term, FunctionTerm)}
    return {
        k: separated_terms(system, term)
        for k, term in functions.items()
        if first_noncommuting(system.algebra, term.coordinates.tolist()) is not None
    }


# Systems are immutable. Functions are stored with their identities, so that these stay unique.
Separated = tuple[Any, tuple[Term, ...], str | None]
_SEPARATED_CACHE: WeakKeyDictionary[LiePoissonSystem, dict[int, Separated]] = WeakKeyDictionary()
_POWERS_CACHE: WeakKeyDictionary[LiePoissonSystem, dict[tuple[int, int], tuple[Polynomial, list[Parts]]]]
_POWERS_CACHE = WeakKeyDictionary()


def check_splits(system: LiePoissonSystem) -> None:
    """Raise NotSplittable if the Hamiltonian is not a sum of functions of commuting forms, without splitting it."""

    def quadratic(term: QuadraticTerm) -> None:
        check_width(term, system.algebra)

    def polynomial(term: PolynomialTerm) -> None:
        for _, coefficient, factors in term.polynomial._factors:
            _check_monomial(system, tuple(factors.items()), coefficient)

    for term in system.hamiltonian.terms():
        if type(term) is QuadraticTerm:
            quadratic(term)
        else:
            _read(system, term, quadratic, polynomial, lambda _: None)


def _check_monomial(system: LiePoissonSystem, key: SparseKey, coefficient: Any) -> None:
    if _degree(key) <= MAX_DEGREE:
        return  # it is a sum of powers of forms
    noncommuting = first_noncommuting(system.algebra, [k for k, _ in key])
    if noncommuting is not None:
        shown = short(in_coordinates_of(system, SparsePolynomial({key: coefficient}, system.dim)))
        what = f"its monomial {shown}, of a degree above {MAX_DEGREE},"
        raise _not_splittable(system, what, noncommuting)


def _not_splittable(
    system: LiePoissonSystem, what: str, noncommuting: tuple[int, int], unknown: str = ""
) -> NotSplittable:
    """Return the error for a piece of H; `unknown` is the reason why it cannot be taken apart."""
    names = coordinate_names(system)
    first, second = (names[k] for k in noncommuting)
    couples = f"depends on {first} and {second}" if unknown else f"couples {first} and {second}"
    reason = f", and cannot be taken apart ({unknown})" if unknown else ""
    return NotSplittable(
        f"{what} {couples}, which do not commute{reason}; "
        "give H as a sum of functions of commuting coordinates (SplitHamiltonian), or use GaussLegendre"
    )


def _join_as_chosen(system: LiePoissonSystem, choice: Sequence[Sequence[int]], atoms: Parts) -> Parts:
    names, set_of_coordinate = coordinate_names(system), np.full(system.dim, len(choice))
    for number, group in enumerate(choice):
        coordinates = np.array(sorted({int(i) for i in group}), dtype=np.int64)
        outside = coordinates[(coordinates < 0) | (coordinates >= system.dim)]
        if len(outside):
            raise ValueError(f"parts name coordinate {outside[0]}, but coordinates run from 0 to {system.dim - 1}")
        noncommuting = first_noncommuting(system.algebra, coordinates.tolist())
        if noncommuting is not None:
            raise ValueError(
                f"parts put {names[noncommuting[0]]} and {names[noncommuting[1]]} together, which do not commute"
            )
        set_of_coordinate[coordinates] = np.minimum(set_of_coordinate[coordinates], number)
    if not len(atoms):
        return atoms
    begins = atoms.forms.start[atoms.angle[:-1]]
    sets = set_of_coordinate[atoms.forms.coordinate]
    # Central coordinates, which have no flow, may be in any set but that of what they are coupled with.
    central = np.diff(system.algebra.neighbours()[0])[atoms.forms.coordinate] == 0
    alone = np.logical_and.reduceat(central, begins)
    free = central & ~alone[atoms.part_of_angle[atoms.forms.owner]] & (sets < len(choice))
    first = np.minimum.reduceat(np.where(free, len(choice), sets), begins)
    last = np.maximum.reduceat(np.where(free, -1, sets), begins)
    wrong = np.flatnonzero((first < last) | (last == len(choice)))
    if len(wrong):
        entries = slice(*atoms.forms.start[atoms.angle[[wrong[0], wrong[0] + 1]]])
        coordinates = distinct(atoms.forms.coordinate[entries])
        missing = coordinates[set_of_coordinate[coordinates] == len(choice)]
        if len(missing):
            raise ValueError(
                f"parts leave out {names[missing[0]]} (coordinate {missing[0]}), which the Hamiltonian depends on"
            )
        coupled = ", ".join(names[i] for i in coordinates)
        raise ValueError(f"parts must hold {coupled} in one set, since the Hamiltonian couples them")
    groups = atoms.joined(first)
    return groups.take(np.argsort(first[np.sort(np.unique(first, return_index=True)[1])], kind="stable"))

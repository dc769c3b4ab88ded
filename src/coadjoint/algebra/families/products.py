"""Constructions of new algebras: direct sums, copies, semidirect products."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any

import numpy as np

from coadjoint.algebra.constants import BYTES_PER_CONSTANT, Triples
from coadjoint.algebra.exact.sparse_sums import Floats, groups
from coadjoint.algebra.families.matrix_bases import MAX_REPRESENTATION_NUMBERS, casimirs_fit
from coadjoint.algebra.invariants.casimirs import embedded
from coadjoint.algebra.lie_algebra import LieAlgebra, read_algebra
from coadjoint.algebra.representation import check_representation
from coadjoint.caching import MAX_CACHED_SIZE
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.memory import check_available_memory
from coadjoint.short_repr import short
from coadjoint.validation import read_integer, truncate_title


def shifted(triples: Triples, begin: int) -> Triples:
    """Shift the coordinate indices by `begin`."""
    return Triples(triples.i + begin, triples.j + begin, triples.k + begin, triples.c)


def joined(parts: Sequence[Triples]) -> Triples:
    """Concatenate structure constants."""
    i, j, k = (np.concatenate([part[column] for part in parts]) for column in range(3))
    return Triples(i, j, k, np.concatenate([part.c for part in parts]))


@suggest_keywords
def direct_sum(*algebras: LieAlgebra) -> LieAlgebra:
    """Return the direct sum: the coordinates of the algebras in order; different summands commute.

    Parameters
    ----------
    *algebras : LieAlgebra
        At least one.

    Returns
    -------
    LieAlgebra
        Basis names are unchanged if all are distinct; otherwise ``e1[2]`` is e1 of the second summand. The
        representation is block diagonal if all summands have one and it stays within 128 MB, else None. Known Casimirs
        are those of the summands, named ``"|x|^2 [2]"``, up to 2^22 exponents in total (682 copies of so(3)), above
        that none; a user's `Invariant` given as a Python function is not carried over.

    Raises
    ------
    TypeError, ValueError
        An argument is not an algebra, or there is none.

    See Also
    --------
    copies : faster for many copies of one algebra.

    Examples
    --------
    >>> from coadjoint.algebra.families.classical import so
    >>> g = direct_sum(so(3), so(4))
    >>> g
    LieAlgebra('so(3) + so(4)', dim=9, 15 brackets)
    >>> list(g.casimirs_known)
    ['|x|^2 [1]', '|x|^2 [2]', 'Pfaffian [2]']
    """
    for algebra in algebras:
        read_algebra(algebra, "a direct sum is made of LieAlgebras, not of")
    if not algebras:
        raise ValueError("a direct sum needs at least one algebra")
    begins = np.cumsum([0] + [algebra.dim for algebra in algebras]).tolist()
    parts = [shifted(algebra.triples, begin) for algebra, begin in zip(algebras, begins, strict=False)]
    names = [label for algebra in algebras for label in algebra.basis]
    if len(set(names)) < len(names):
        names = [f"{label}[{number}]" for number, algebra in enumerate(algebras, 1) for label in algebra.basis]
    # The Jacobi identities are those of the summands, already checked.
    return LieAlgebra._from_valid(
        joined(parts),
        begins[-1],
        tuple(names),
        truncate_title(" + ".join(algebra.name or f"g{number}" for number, algebra in enumerate(algebras, 1))),
        _block_diagonal([algebra.representation for algebra in algebras]),
        _summand_casimirs(algebras, begins),
    )


@suggest_keywords
def copies(g: LieAlgebra, count: int) -> LieAlgebra:
    """Return the direct sum of `count` copies of one algebra, such as a lattice of spins for g = so(3).

    Coordinate i of copy a (both from 0) has the index a * g.dim + i.

    Parameters
    ----------
    g : LieAlgebra
    count : int
        Number of copies, from 1.

    Returns
    -------
    LieAlgebra
        As from `direct_sum`, with basis names ``e1[1]``, ...; with the Casimirs of every copy up to 2^22 exponents (682
        copies of so(3)) and none above, since a run would record each of them. Pass those to record to the system by
        name, as sparse `Quadratic` functions of the coordinates of a copy.

    Raises
    ------
    TypeError, ValueError
        g is not a LieAlgebra, or count is not a positive integer.

    Examples
    --------
    >>> from coadjoint.algebra.families.classical import so
    >>> lattice = copies(so(3), 1000)
    >>> lattice, lattice.triples.c.size, lattice.basis[3]
    (LieAlgebra('1000 so(3)', dim=3000, 3000 brackets), 3000, 'e1[2]')
    """
    read_algebra(g, "copies are made of a LieAlgebra, not of")
    count = read_integer(count, "count of copies(g, count)")
    c = g.triples.c
    # Names are made when they are read.
    title = f"the sum of {short(count)} copies, of dimension {short(g.dim * count)},"
    check_available_memory(BYTES_PER_CONSTANT * c.size * count, title, "take fewer")
    constants = functools.partial(_constants_of_copies, g, count)
    size = 0 if g.representation is None else g.representation.shape[1]
    fits = g.representation is not None and g.dim * count * (size * count) ** 2 <= MAX_REPRESENTATION_NUMBERS
    known = {}
    if _casimirs_fit_memory([g], count):
        known = _summand_casimirs([g] * count, range(0, g.dim * (count + 1), g.dim))
    # The Jacobi identities of every copy are those of g, already checked.
    algebra = LieAlgebra._from_valid(
        constants if c.size * count > MAX_CACHED_SIZE else constants(),
        g.dim * count,
        functools.partial(_names_of_copies, g, count),
        truncate_title(f"{count} {g.name or 'g'}"),
        _block_diagonal([g.representation] * count) if fits else None,
        known,
    )
    algebra._copied = g, count
    return algebra


def _constants_of_copies(g: LieAlgebra, count: int) -> Triples:
    shift = g.dim * np.arange(count, dtype=np.int64)[:, None]
    i, j, k = ((shift + column).ravel() for column in g.triples[:3])
    triples = Triples(i, j, k, np.tile(g.triples.c, count))
    for column in triples:
        column.flags.writeable = False
    return triples


def _names_of_copies(g: LieAlgebra, count: int) -> tuple[str, ...]:
    return tuple([f"{label}[{number}]" for number in range(1, count + 1) for label in g.basis])


def _casimirs_fit_memory(algebras: Sequence[LieAlgebra], count: int = 1) -> bool:
    """Return whether the Casimirs of all summands, `count` times, are small enough to be stored as polynomials."""
    known = [casimir for algebra in algebras for casimir in algebra.casimirs_known.values()]
    monomials = sum(casimir._term_count for casimir in known)
    return casimirs_fit(monomials * count, sum(algebra.dim for algebra in algebras) * count)


def _summand_casimirs(algebras: Sequence[LieAlgebra], begins: Sequence[int]) -> dict[str, Any]:
    if not _casimirs_fit_memory(algebras):
        return {}
    dim = begins[-1]
    result: dict[str, Any] = {}
    for number, (algebra, begin) in enumerate(zip(algebras, begins, strict=False), 1):
        for name, casimir in algebra.casimirs_known.items():
            placed = casimir._transformed(
                functools.partial(embedded, coordinates=range(begin, begin + algebra.dim), dim=dim)
            )
            if placed is not None:
                result[f"{name} [{number}]"] = placed
    return result


def _block_diagonal(parts: Sequence[Floats | None]) -> Floats | None:
    blocks = [part for part in parts if part is not None]
    dim, size = sum(part.shape[0] for part in blocks), sum(part.shape[1] for part in blocks)
    if len(blocks) < len(parts) or dim * size**2 > MAX_REPRESENTATION_NUMBERS:
        return None
    rho = np.zeros((dim, size, size))
    element = offset = 0
    for part in blocks:
        n, d = part.shape[:2]
        rho[element : element + n, offset : offset + d, offset : offset + d] = part
        element, offset = element + n, offset + d
    return rho


@suggest_keywords
def semidirect(g: LieAlgebra, representation: Any = None, ideal: LieAlgebra | None = None) -> LieAlgebra:
    """Return the semidirect product of g with the space it acts on: ``[e_i, p_a] = sum_b (rho_i)_ba p_b``.

    The coordinates are those of g, then those of the space. ``semidirect(so(3))`` is e(3).

    Parameters
    ----------
    g : LieAlgebra
    representation : (n, d, d) array, optional
        The matrices rho_i by which g acts on R^d; those of g by default.
    ideal : LieAlgebra, optional
        Brackets of the space, of dimension d, if it is not abelian; every rho_i must be a derivation of it.

    Returns
    -------
    LieAlgebra
        The space has the basis p1 ... pd (v1 ... vd if g uses these names), or that of `ideal`. If the space is abelian
        and the result within 128 MB, the representation is by affine (d + 1) x (d + 1) matrices. No Casimirs are known,
        since those of g are not Casimirs of the product; ``casimirs(max_degree)`` finds the polynomial ones.

    Raises
    ------
    TypeError, ValueError
        The matrices are missing, not a representation, or not derivations of the ideal.

    Examples
    --------
    >>> from coadjoint.algebra.families.classical import so
    >>> semidirect(so(3)).basis
    ('e1', 'e2', 'e3', 'p1', 'p2', 'p3')
    """
    if not isinstance(g, LieAlgebra) or not isinstance(ideal, LieAlgebra | None):
        raise TypeError("a semidirect product is made of LieAlgebras")
    matrices = g.representation if representation is None else representation
    if matrices is None:
        raise ValueError(f"{short(g)} has no representation; give the matrices by which it acts, shape ({g.dim}, d, d)")
    rho = check_representation(matrices, g.triples, g.dim, g.basis)
    n, d = g.dim, rho.shape[1]
    if ideal is not None and ideal.dim != d:
        raise ValueError(f"the ideal has dimension {ideal.dim}; the matrices act on {d} dimensions")
    element, row, column = (index.astype(np.int64) for index in np.nonzero(rho))
    parts = [g.triples, Triples(element, column + n, row + n, rho[element, row, column])]
    names = list(g.basis)
    if ideal is not None:
        parts.append(shifted(ideal.triples, n))
        space = list(ideal.basis)
    else:
        letter = next(letter for letter in ("p", "v", "w", "p'") if f"{letter}1" not in g.basis)
        space = [f"{letter}{a}" for a in range(1, d + 1)]
    if set(names) & set(space):
        names, space = [f"{label}[1]" for label in names], [f"{label}[2]" for label in space]
    affine = None
    if ideal is None and (n + d) * (d + 1) ** 2 <= MAX_REPRESENTATION_NUMBERS:
        affine = np.zeros((n + d, d + 1, d + 1))
        affine[:n, :d, :d] = rho
        affine[range(n, n + d), range(d), d] = 1.0
    space_name = f"R^{d}" if ideal is None else ideal.name or "h"
    constants = joined(parts)
    name = truncate_title(f"{g.name or 'g'} ⋉ {space_name}")
    if ideal is not None:  # the Jacobi check verifies that the matrices are derivations of it
        return LieAlgebra(constants, dim=n + d, basis=names + space, name=name)
    constants = constants.rows(groups(constants.i, constants.j, constants.k)[0])
    return LieAlgebra._from_valid(constants, n + d, tuple(names + space), name, affine, {})

"""Is a matrix an element of the group? By what all elements keep: forms, fixed vectors, determinants, and brackets."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
# An element that was written in half of the digits of float64, or that a long run has moved by round-off, is one.
ALLOWED = 2.0**-26
LARGEST_SPAN = 1 << 24  # entries of a representation whose span is found; beyond, forms and determinants are looked at


class _Kept(NamedTuple):
    """What the elements of a group of matrices keep.

    `orthogonal`: all generators are skew-symmetric. `every`: they are all skew-symmetric matrices that there are.
    `fixed` (d, r) and `covectors` (r, d) are vectors that no generator moves; `special` says that no generator has a
    trace. `generator` is a random one, and `span` (d^2, n) an orthonormal basis of all of them, where it is found.
    """

    orthogonal: bool
    every: bool
    special: bool
    fixed: Floats
    covectors: Floats
    generator: Floats
    span: Floats | None


def are_rotations(groups: Floats, representation: Floats) -> bool:
    """Return whether matrices are rotations, and all rotations are elements of the group.

    Parameters
    ----------
    groups : (d, d) or (members, d, d) array
    representation : (n, d, d) array
        The generators.

    Returns
    -------
    bool

    Examples
    --------
    >>> are_rotations(np.eye(2), np.array([[[0.0, -1.0], [1.0, 0.0]]]))
    True
    """
    return _kept(representation.tobytes(), representation.shape).every and _why_no_rotation(groups) is None


def why_no_element(groups: Floats, representation: Floats) -> str | None:
    """Return why a matrix is no element of the group that a representation generates, or None.

    What is looked at is necessary: an orthogonal matrix of determinant 1 where all generators are skew-symmetric, the
    determinant and the fixed vectors that the generators tell, and that ``g rho g^-1`` is a generator again.

    Parameters
    ----------
    groups : (members, d, d) array
        Regular matrices.
    representation : (n, d, d) array
        The generators.

    Returns
    -------
    str or None
        Of the first matrix that is none.

    Examples
    --------
    >>> rotations = np.array([[[0.0, -1.0], [1.0, 0.0]]])
    >>> why_no_element(np.eye(2)[None], rotations)
    >>> why_no_element(2 * np.eye(2)[None], rotations)
    'it is not orthogonal: g^T g differs from the unit matrix by 3'
    """
    kept = _kept(representation.tobytes(), representation.shape)
    if kept.orthogonal:
        why = _why_no_rotation(groups)
        if why is not None or kept.every:
            return why
    return next((why for g in groups if (why := _why(g, kept)) is not None), None)


def _why_no_rotation(groups: Floats) -> str | None:
    with np.errstate(over="ignore", invalid="ignore"):
        error = np.abs(groups.swapaxes(-2, -1) @ groups - np.eye(groups.shape[-1])).max()
    if not error <= ALLOWED:
        return f"it is not orthogonal: g^T g differs from the unit matrix by {error:.3g}"
    if np.linalg.det(groups).min() < 0.0:
        return "it is a reflection: its determinant is -1"
    return None


def _why(g: Floats, kept: _Kept) -> str | None:
    largest = float(np.abs(g).max())
    unit = g / largest
    inverse = np.linalg.inv(unit)
    # By what a determinant changes when every entry is rounded.
    room = ALLOWED * float((np.abs(inverse) @ np.abs(unit)).sum(axis=1).max())
    for moved, size in ((g @ kept.fixed - kept.fixed, largest), ((kept.covectors @ g - kept.covectors), largest)):
        if np.abs(moved).max(initial=0.0) > ALLOWED * max(1.0, size):
            return "it moves a vector that every element of the group leaves where it is"
    if not kept.orthogonal:
        sign, logarithm = np.linalg.slogdet(g)
        if sign < 0 or (kept.special and abs(logarithm) > room):
            wanted = "1" if kept.special else "positive"
            return f"its determinant is {sign * np.exp(min(logarithm, 700.0)):.6g}; that of every element is {wanted}"
    if kept.span is None:
        return None
    turned = (unit @ kept.generator @ inverse).ravel()
    rest = turned - kept.span @ (kept.span.T @ turned)
    if np.abs(rest).max() > ALLOWED * float((np.abs(unit) @ np.abs(kept.generator) @ np.abs(inverse)).max()):
        return "it does not keep the brackets: g rho g^-1 is no element of the algebra"
    return None


def why_no_automorphism(groups: Floats, structure_matrix: Callable[[Floats], Any]) -> str | None:
    """Return why a matrix K of the coadjoint action keeps no brackets, or None: ``J(K x)`` must be ``K J(x) K^T``.

    Parameters
    ----------
    groups : (members, n, n) array
        Regular matrices.
    structure_matrix : callable
        x -> J(x), (n, n), linear in x, so that one random x tells.

    Returns
    -------
    str or None
        Of the first matrix that keeps none.

    Examples
    --------
    >>> import coadjoint as co
    >>> J = co.algebras.so(3).structure_matrix
    >>> why_no_automorphism(np.eye(3)[None], J)
    >>> why_no_automorphism(2 * np.eye(3)[None], J)
    'it does not keep the brackets: K J(x) K^T differs from J(K x)'
    """
    x: Floats = np.random.default_rng(0).standard_normal((groups.shape[1],))
    J = np.asarray(structure_matrix(x))
    for K in groups:
        found, wanted = K @ J @ K.T, np.asarray(structure_matrix(np.asarray(K @ x)))
        size = np.abs(K) @ np.abs(J) @ np.abs(K).T
        if np.abs(found - wanted).max(initial=0.0) > ALLOWED * max(float(size.max()), float(np.abs(wanted).max())):
            return "it does not keep the brackets: K J(x) K^T differs from J(K x)"
    return None


@lru_cache(maxsize=32)
def _kept(numbers: bytes, shape: tuple[int, int, int]) -> _Kept:
    rho = np.frombuffer(numbers).reshape(shape)
    n, d, _ = shape
    orthogonal = bool(np.array_equal(rho.transpose(0, 2, 1), -rho))
    weights = np.random.default_rng(0).standard_normal(n)
    generator = np.tensordot(weights, rho, axes=1)
    span, every = None, False
    if rho.size <= LARGEST_SPAN:
        U, singular, _ = np.linalg.svd(rho.reshape(n, d * d).T, full_matrices=False)
        rank = int(np.count_nonzero(singular > singular.max(initial=0.0) * ALLOWED))
        span, every = U[:, :rank], orthogonal and rank == d * (d - 1) // 2
    sizes = np.abs(rho).max(axis=(1, 2), keepdims=True)
    scaled = rho / np.where(sizes > 0.0, sizes, 1.0)
    # Folded into d rows: sums of squares have the same vectors of zero.
    right = np.einsum("kia,kib->ab", scaled, scaled, optimize=True)
    left = np.einsum("kai,kbi->ab", scaled, scaled, optimize=True)
    traces = np.abs(np.trace(scaled, axis1=1, axis2=2))
    return _Kept(orthogonal, every, bool((traces <= d * ALLOWED).all()), _zeros(right), _zeros(left).T, generator, span)


def _zeros(square: Floats) -> Floats:
    """Return the vectors that a symmetric positive semidefinite matrix takes to zero, as columns."""
    values, vectors = np.linalg.eigh(square)
    return np.asarray(vectors[:, values <= ALLOWED**2 * max(float(values.max(initial=0.0)), 1.0)])

"""Matrix representations: validation, invariant forms, intertwiners, and whether matrices belong to the group."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.constants import Triples, triple_name
from coadjoint.algebra.exact.sparse_sums import (
    DEFECT_FACTOR,
    Floats,
    Integers,
    chunks,
    expand,
    group_max_abs,
    groups,
    largest_violation,
)
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.validation import read_numbers

REDUCED_ROWS = 1 << 12  # equations reduced to triangular form at a time
# Accepts elements with half of the digits of float64, or with the round-off of a long run.
TOLERANCE = 2.0**-26
ORTHOGONALITY = 1e-6
"""Largest deviation from a rotation or a unit quaternion that is taken for rounding of the argument, and removed."""
MAX_SPAN_ENTRIES = 1 << 24  # entries of a representation; above, only forms and determinants are checked


def read_representation(representation: Any, dim: int | None = None) -> Floats:
    """Validate the matrices of a representation and return a float64 copy, shape (n, d, d)."""
    rho = read_numbers(representation, "representation")
    if rho.ndim != 3 or rho.shape[1] != rho.shape[2] or 0 in rho.shape or dim not in (None, rho.shape[0]):
        count = "n" if dim is None else dim
        raise ValueError(
            f"representation must have shape ({count}, d, d), one matrix per basis element, not {rho.shape}"
        )
    wrong = np.argwhere(~np.isfinite(rho))
    if wrong.size:
        i, a, b = wrong[0].tolist()
        raise ValueError(f"representation[{i}, {a}, {b}] is {rho[i, a, b]}; it must be finite")
    return rho


def commutator_products(
    matrices: Triples, count: int, further_cost: float | NDArray[Any] = 0.0
) -> Iterator[tuple[slice, tuple[Integers, Integers], tuple[Integers, Integers]]]:
    """Yield runs of a with the entries (p, q) in X_a X_b and (r, s) in X_b X_a, a < b, of sparse matrices."""
    # `matrices` has entries (a, row, column, value), matrix after matrix; p and r are those of X_a.
    i, row, column, _ = matrices
    by_row, _ = groups(row, i)
    by_column, _ = groups(column, i)
    joins: list[tuple[Integers, Integers]] = []
    # Rows of X_b are joined with columns of X_a, then columns of X_b with rows of X_a.
    for order, outer, middle in ((by_row, row, column), (by_column, column, row)):
        key = (outer * count + i)[order]
        start = np.searchsorted(key, middle * count + i, side="right")
        joins.append((start, np.maximum(np.searchsorted(key, (middle + 1) * count), start)))
    cost = np.bincount(i, weights=sum(stop - start for start, stop in joins), minlength=count) + further_cost
    for part in chunks(np.arange(count), cost.astype(np.int64)):
        entries = slice(*np.searchsorted(i, [part.start, part.stop]))
        (p, q), (r, s) = (expand(start[entries], stop[entries]) for start, stop in joins)
        yield part, (p + entries.start, by_row[q]), (r + entries.start, by_column[s])


def check_representation(representation: Any, triples: Triples, dim: int, names: Sequence[str]) -> Floats:
    """Check [rho_i, rho_j] = sum_k c_ij^k rho_k for every pair; return a read-only float64 array (n, d, d)."""
    # Each entry must be below 64 u times the sum of the absolute values of its products (u = 2^-53).
    rho = read_representation(representation, dim)
    d = rho.shape[1]
    i, a, b = (index.astype(np.int64) for index in np.nonzero(rho))
    v = rho[i, a, b]
    v_size, c_size = group_max_abs(i, v), group_max_abs(triples.i * dim + triples.j, triples.c)
    structure = np.searchsorted(i, triples.k), np.searchsorted(i, triples.k, side="right")  # c_ij^k rho_k, joined on k
    cost = np.bincount(triples.i, weights=structure[1] - structure[0], minlength=dim)
    for part, (p, q), (r, s) in commutator_products(Triples(i, a, b, v), dim, cost):
        constant_rows = slice(*np.searchsorted(triples.i, [part.start, part.stop]))
        row, element = expand(structure[0][constant_rows], structure[1][constant_rows])
        row += constant_rows.start
        pair = [i[p] * dim + i[q], i[r] * dim + i[s], (triples.i * dim + triples.j)[row]]
        position = [a[p] * d + b[q], a[s] * d + b[r], a[element] * d + b[element]]
        keys = np.concatenate(pair), np.concatenate(position)
        factors = np.concatenate([v[p], -v[r], -triples.c[row]]), np.concatenate([v[q], v[s], v[element]])
        sizes = (
            np.concatenate([v_size[p], v_size[r], c_size[row]]),
            np.concatenate([v_size[q], v_size[s], v_size[element]]),
        )
        violation = largest_violation(keys, factors, sizes)
        if violation is not None:
            first, second = divmod(int(keys[0][violation[0]]), dim)
            entry = divmod(int(keys[1][violation[0]]), d)
            raise ValueError(
                f"representation violates the commutator of {triple_name((first, second), names)}: "
                f"[rho_i, rho_j] - sum_k c_ij^k rho_k has {violation[1]:.3g} at {entry}, where it must be zero"
            )
    rho.flags.writeable = False
    return rho


def _solutions(left: Floats, right: Floats) -> Floats:
    """Return a basis (r, m, d) of the matrices X with X right_i = left_i X for all i."""
    m, d = left.shape[1], right.shape[1]
    size = np.maximum(np.abs(left).max(axis=(1, 2)), np.abs(right).max(axis=(1, 2)))
    size = np.where(size > 0.0, size, 1.0)[:, None, None]  # equal weight for every i, independent of units
    left, right = left / size, right / size
    per_fold = max(1, REDUCED_ROWS // (m * d))
    triangle: Floats = np.zeros((0, m * d))
    for begin in range(0, left.shape[0], per_fold):
        blocks = [
            np.kron(np.eye(m), r.T) - np.kron(l, np.eye(d))
            for l, r in zip(left[begin : begin + per_fold], right[begin : begin + per_fold], strict=True)
        ]
        triangle = np.asarray(np.linalg.qr(np.concatenate([triangle, *blocks]), mode="r"))
    _, singular, basis = np.linalg.svd(triangle, full_matrices=True)
    tolerance = DEFECT_FACTOR * UNIT_ROUNDOFF * m * d * max(float(singular.max(initial=0.0)), UNIT_ROUNDOFF)
    rank = int(np.count_nonzero(singular > tolerance))
    return basis[rank:].reshape(-1, m, d)


def _generic_of_full_rank(basis: Floats) -> Floats | None:
    """Return a seeded random combination of full rank with largest entry 1, or None if all are singular."""
    if basis.shape[0] == 0:
        return None
    combination = np.tensordot(np.random.default_rng(0).standard_normal(basis.shape[0]), basis, axes=1)
    singular = np.linalg.svd(combination, compute_uv=False)
    m, d = combination.shape
    if m > d or singular[-1] <= DEFECT_FACTOR * UNIT_ROUNDOFF * m * d * singular[0]:
        return None
    return combination / combination.flat[np.argmax(np.abs(combination))]


def invariant_form(rho: Any) -> NDArray[np.float64] | None:
    """Find a nonsingular P with rho_i^T P + P rho_i = 0 for all i, a bilinear form that the group keeps; else None."""
    matrices = read_representation(rho)
    transposed = matrices.transpose(0, 2, 1)
    if np.array_equal(transposed, -matrices):
        return np.eye(matrices.shape[1])
    return _generic_of_full_rank(_solutions(-transposed, matrices))


def intertwiner(rho: Any, D: Any) -> NDArray[np.float64] | None:
    """Find T (m, d) of full row rank with T rho_i = D_i T for all i, rho (n, d, d) and D (n, m, m); else None."""
    matrices = read_representation(rho)
    actions = read_representation(D, matrices.shape[0])
    if actions.shape[1] > matrices.shape[1]:
        return None
    return _generic_of_full_rank(_solutions(actions, matrices))


def is_rotation(value: Any) -> bool:
    """Return whether a value is a rotation of SciPy, one or several."""
    return hasattr(value, "as_matrix")


def matrices_of_quaternions(quaternions: Floats, what: str, scalar_first: bool = False) -> Floats:
    """Return rotation matrices (..., 3, 3) of unit quaternions (..., 4), in the order of SciPy."""
    norms = np.sqrt((quaternions**2).sum(axis=-1))
    wrong = ~(np.abs(norms - 1.0) <= ORTHOGONALITY)
    if wrong.any():
        raise ValueError(f"{what} has a quaternion of norm {norms[wrong].flat[0]:g}; give unit quaternions")
    unit = quaternions / norms[..., None]
    w, x, y, z = np.moveaxis(unit if scalar_first else np.roll(unit, 1, axis=-1), -1, 0)
    return np.ascontiguousarray(np.moveaxis(quaternion_matrix(w, x, y, z), (0, 1), (-2, -1)))


def quaternion_matrix(w: Any, x: Any, y: Any, z: Any) -> Floats:
    """Return the rotation matrix of a unit quaternion, (3, 3), or (3, 3, ...) of several."""
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )


def rotation_block(representation: Any) -> int | None:
    """Return the index of the block of rotations in space in the matrices of a representation, or None."""
    # It is the whole of 3 x 3 matrices, the first in SE(3), and the second of three beside positions and momenta.
    rho = np.asarray(representation)
    if rho.ndim != 3:  # none, or the name of one
        return None
    size = rho.shape[-1]
    if size == 3 or (size == 4 and not rho[:, 3].any()):
        return 0
    if size == 5 and not rho[:, 1:, 0].any() and not rho[:, 4].any() and rho[:, 1:4, 1:4].any():
        return 1
    return None


def group_elements(attitude: Any, size: int, block: int | None) -> Floats:
    """Return group elements (..., size, size); rotations and quaternions fill the `rotation_block` at `block`."""
    if isinstance(attitude, list | tuple) and any(map(is_rotation, attitude)):
        attitude = np.stack([group_elements(one, size, block) for one in attitude])
    array = read_numbers(attitude.as_matrix() if is_rotation(attitude) else attitude, "attitude")
    # Four numbers are a quaternion: rows of other matrices have three or five. Four rows of four are one affine matrix.
    if block is not None and array.shape[-1:] == (4,) and array.ndim <= (1 if size == 4 else 2):
        array = matrices_of_quaternions(array, "attitude")
    if block is None or size == 3 or array.shape[-2:] != (3, 3):
        return array
    elements = np.tile(np.eye(size), (*array.shape[:-2], 1, 1))
    elements[..., block : block + 3, block : block + 3] = array
    return elements


def expected_elements(size: int, block: int | None) -> str:
    """Return the shapes of group elements, for messages."""
    rotation = ", a quaternion (4,) or a SciPy Rotation" if block is not None else ""
    return f"({size}, {size}){rotation}"


def are_rotations(groups: Floats, representation: Floats) -> bool:
    """Return whether `groups`, (d, d) or (members, d, d), are rotations and the group contains all rotations."""
    _, all_rotations, _ = _group_of(representation.tobytes(), representation.shape)
    return all_rotations and _rotation_violation(groups) is None


def group_element_violation(groups: Floats, representation: Floats) -> str | None:
    """Return why the first offending regular matrix is not in the group generated by `representation`, or None."""
    # The conditions are necessary: orthogonality with determinant 1 for skew-symmetric generators, the determinant and
    # the fixed vectors implied by the generators, and that ``g rho g^-1`` is again a generator.
    orthogonal, all_rotations, violation_of = _group_of(representation.tobytes(), representation.shape)
    if orthogonal:
        violation = _rotation_violation(groups)
        if violation is not None or all_rotations:
            return violation
    return next((violation for g in groups if (violation := violation_of(g)) is not None), None)


def _rotation_violation(groups: Floats) -> str | None:
    with np.errstate(over="ignore", invalid="ignore"):
        error = np.abs(groups.swapaxes(-2, -1) @ groups - np.eye(groups.shape[-1])).max()
    if not error <= TOLERANCE:
        return f"it is not orthogonal: g^T g differs from the unit matrix by {error:.3g}"
    if np.linalg.det(groups).min() < 0.0:
        return "it is a reflection: its determinant is -1"
    return None


def _element_violation(
    g: Floats,
    *,
    determinant: str | None,
    fixed: Floats,
    covectors: Floats,
    generator: Floats,
    span: Floats | None,
) -> str | None:
    """Return why a regular matrix is not in a group, or None."""
    # Elements have the `determinant` "1" or "positive", None if it is known, and preserve `fixed` (d, r), `covectors`
    # (r, d), and the `span` (d^2, n) of the generators, orthonormal, of which `generator` is a random one.
    largest = float(np.abs(g).max())
    unit = g / largest
    inverse = np.linalg.inv(unit)
    # Change of the determinant when every entry is rounded.
    tolerance = TOLERANCE * float((np.abs(inverse) @ np.abs(unit)).sum(axis=1).max())
    for displacement, size in (
        (g @ fixed - fixed, largest),
        (covectors @ g - covectors, largest),
    ):
        if np.abs(displacement).max(initial=0.0) > TOLERANCE * max(1.0, size):
            return "it moves a vector that every element of the group fixes"
    if determinant is not None:
        sign, logarithm = np.linalg.slogdet(g)
        if sign < 0 or (determinant == "1" and abs(logarithm) > tolerance):
            value = sign * np.exp(min(logarithm, 700.0))
            return f"its determinant is {value:.6g}; that of every element is {determinant}"
    if span is None:
        return None
    conjugated = (unit @ generator @ inverse).ravel()
    remainder = conjugated - span @ (span.T @ conjugated)
    size = float((np.abs(unit) @ np.abs(generator) @ np.abs(inverse)).max())
    if np.abs(remainder).max() > TOLERANCE * size:
        return "it does not preserve the brackets: g rho g^-1 is no element of the algebra"
    return None


def automorphism_violation(groups: Floats, structure_matrix: Callable[[Floats], Any]) -> str | None:
    """Return why a regular matrix K does not preserve brackets, ``J(K x) = K J(x) K^T``, or None.

    >>> import coadjoint as co
    >>> automorphism_violation(2 * np.eye(3)[None], co.algebras.so(3).structure_matrix)
    'it does not preserve the brackets: K J(x) K^T differs from J(K x)'
    """
    # J(x) is linear in x, so that one random x decides.
    x: Floats = np.random.default_rng(0).standard_normal((groups.shape[1],))
    J = np.asarray(structure_matrix(x))
    for K in groups:
        transformed, expected = K @ J @ K.T, np.asarray(structure_matrix(np.asarray(K @ x)))
        size = max(float((np.abs(K) @ np.abs(J) @ np.abs(K).T).max()), float(np.abs(expected).max()))
        if np.abs(transformed - expected).max(initial=0.0) > TOLERANCE * size:
            return "it does not preserve the brackets: K J(x) K^T differs from J(K x)"
    return None


@lru_cache(maxsize=32)
def _group_of(numbers: bytes, shape: tuple[int, int, int]) -> tuple[bool, bool, Callable[[Floats], str | None]]:
    """Return whether a group is orthogonal, whether it has all rotations, and why a matrix is not in it, a function."""
    rho = np.frombuffer(numbers).reshape(shape)
    n, d, _ = shape
    orthogonal = bool(np.array_equal(rho.transpose(0, 2, 1), -rho))
    weights = np.random.default_rng(0).standard_normal(n)
    generator = np.tensordot(weights, rho, axes=1)
    span, all_rotations = None, False
    if rho.size <= MAX_SPAN_ENTRIES:
        U, singular, _ = np.linalg.svd(rho.reshape(n, d * d).T, full_matrices=False)
        rank = int(np.count_nonzero(singular > singular.max(initial=0.0) * TOLERANCE))
        span, all_rotations = U[:, :rank], orthogonal and rank == d * (d - 1) // 2
    sizes = np.abs(rho).max(axis=(1, 2), keepdims=True)
    scaled = rho / np.where(sizes > 0.0, sizes, 1.0)
    # Folded into d rows: the sum of the squares has the same null space.
    right = np.einsum("kia,kib->ab", scaled, scaled, optimize=True)
    left = np.einsum("kai,kbi->ab", scaled, scaled, optimize=True)
    traces = np.abs(np.trace(scaled, axis1=1, axis2=2))
    determinant = "1" if (traces <= d * TOLERANCE).all() else "positive"
    violation_of = partial(
        _element_violation,
        determinant=None if orthogonal else determinant,
        fixed=_null_space(right),
        covectors=_null_space(left).T,
        generator=generator,
        span=span,
    )
    return orthogonal, all_rotations, violation_of


def _null_space(square: Floats) -> Floats:
    """Return the null space of a symmetric positive semidefinite matrix, as columns."""
    values, vectors = np.linalg.eigh(square)
    return np.asarray(vectors[:, values <= TOLERANCE**2 * max(float(values.max(initial=0.0)), 1.0)])

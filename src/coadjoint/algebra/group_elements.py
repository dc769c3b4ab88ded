"""Group elements: read from matrices, SciPy rotations and quaternions, and tested: forms, fixed vectors, brackets."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.validation import read_numbers

Floats = NDArray[np.float64]
# Accepts elements with half of the digits of float64, or with the round-off of a long run.
TOLERANCE = 2.0**-26
ORTHOGONALITY = 1e-6
"""Largest deviation from a rotation or a unit quaternion that is taken for rounding of the argument, and removed."""
MAX_SPAN_ENTRIES = 1 << 24  # entries of a representation; above, only forms and determinants are checked


class _PreservedQuantities(NamedTuple):
    """Quantities preserved by the elements of a matrix group.

    `orthogonal`: all generators are skew-symmetric; `all_rotations`: they span all skew-symmetric matrices. `fixed` (d,
    r) and `covectors` (r, d): vectors annihilated by every generator. `special`: all generators are traceless.
    `generator`: a random generator. `span` (d^2, n): orthonormal basis of the generators, if computed.
    """

    orthogonal: bool
    all_rotations: bool
    special: bool
    fixed: Floats
    covectors: Floats
    generator: Floats
    span: Floats | None


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
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def rotation_block(representation: Any) -> int | None:
    """Return the index at which the block of rotations in space begins in the matrices of a representation, or None.

    The block is the whole of 3 x 3 matrices, the first in SE(3), and the second of three beside positions and momenta.

    Examples
    --------
    >>> import coadjoint as co
    >>> [rotation_block(one.representation) for one in (co.algebras.so(3), co.algebras.e(3), co.algebras.sl(2))]
    [0, 0, None]
    """
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
    """Return group elements (size, size), or with an axis of members before, also of rotations and quaternions.

    `block` is the `rotation_block` of the representation; other entries of a given rotation are those of the identity.
    """
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
    """Return whether `groups`, (d, d) or (members, d, d), are rotations and the group contains all rotations.

    Examples
    --------
    >>> are_rotations(np.eye(2), np.array([[[0.0, -1.0], [1.0, 0.0]]]))
    True
    """
    return (
        _preserved_quantities(representation.tobytes(), representation.shape).all_rotations
        and _rotation_violation(groups) is None
    )


def group_element_violation(groups: Floats, representation: Floats) -> str | None:
    """Return why the first offending matrix of `groups` is not in the group generated by `representation`, or None.

    The conditions are necessary: orthogonality with determinant 1 for skew-symmetric generators, the determinant and
    the fixed vectors implied by the generators, and that ``g rho g^-1`` is again a generator. Matrices must be regular.

    Examples
    --------
    >>> rotations = np.array([[[0.0, -1.0], [1.0, 0.0]]])
    >>> group_element_violation(np.eye(2)[None], rotations)
    >>> group_element_violation(2 * np.eye(2)[None], rotations)
    'it is not orthogonal: g^T g differs from the unit matrix by 3'
    """
    preserved = _preserved_quantities(representation.tobytes(), representation.shape)
    if preserved.orthogonal:
        violation = _rotation_violation(groups)
        if violation is not None or preserved.all_rotations:
            return violation
    return next((violation for g in groups if (violation := _element_violation(g, preserved)) is not None), None)


def _rotation_violation(groups: Floats) -> str | None:
    with np.errstate(over="ignore", invalid="ignore"):
        error = np.abs(groups.swapaxes(-2, -1) @ groups - np.eye(groups.shape[-1])).max()
    if not error <= TOLERANCE:
        return f"it is not orthogonal: g^T g differs from the unit matrix by {error:.3g}"
    if np.linalg.det(groups).min() < 0.0:
        return "it is a reflection: its determinant is -1"
    return None


def _element_violation(g: Floats, preserved: _PreservedQuantities) -> str | None:
    largest = float(np.abs(g).max())
    unit = g / largest
    inverse = np.linalg.inv(unit)
    # Change of the determinant when every entry is rounded.
    tolerance = TOLERANCE * float((np.abs(inverse) @ np.abs(unit)).sum(axis=1).max())
    for displacement, size in (
        (g @ preserved.fixed - preserved.fixed, largest),
        ((preserved.covectors @ g - preserved.covectors), largest),
    ):
        if np.abs(displacement).max(initial=0.0) > TOLERANCE * max(1.0, size):
            return "it moves a vector that every element of the group fixes"
    if not preserved.orthogonal:
        sign, logarithm = np.linalg.slogdet(g)
        if sign < 0 or (preserved.special and abs(logarithm) > tolerance):
            expected = "1" if preserved.special else "positive"
            return f"its determinant is {sign * np.exp(min(logarithm, 700.0)):.6g}; that of every element is {expected}"
    if preserved.span is None:
        return None
    conjugated = (unit @ preserved.generator @ inverse).ravel()
    remainder = conjugated - preserved.span @ (preserved.span.T @ conjugated)
    size = float((np.abs(unit) @ np.abs(preserved.generator) @ np.abs(inverse)).max())
    if np.abs(remainder).max() > TOLERANCE * size:
        return "it does not preserve the brackets: g rho g^-1 is no element of the algebra"
    return None


def automorphism_violation(groups: Floats, structure_matrix: Callable[[Floats], Any]) -> str | None:
    """Return why a matrix K of the coadjoint action does not preserve brackets, ``J(K x) = K J(x) K^T``, or None.

    `structure_matrix` maps x to J(x), linear in x, so that one random x decides. Matrices must be regular.

    Examples
    --------
    >>> import coadjoint as co
    >>> J = co.algebras.so(3).structure_matrix
    >>> automorphism_violation(np.eye(3)[None], J)
    >>> automorphism_violation(2 * np.eye(3)[None], J)
    'it does not preserve the brackets: K J(x) K^T differs from J(K x)'
    """
    x: Floats = np.random.default_rng(0).standard_normal((groups.shape[1],))
    J = np.asarray(structure_matrix(x))
    for K in groups:
        transformed, expected = K @ J @ K.T, np.asarray(structure_matrix(np.asarray(K @ x)))
        size = max(float((np.abs(K) @ np.abs(J) @ np.abs(K).T).max()), float(np.abs(expected).max()))
        if np.abs(transformed - expected).max(initial=0.0) > TOLERANCE * size:
            return "it does not preserve the brackets: K J(x) K^T differs from J(K x)"
    return None


@lru_cache(maxsize=32)
def _preserved_quantities(numbers: bytes, shape: tuple[int, int, int]) -> _PreservedQuantities:
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
    return _PreservedQuantities(
        orthogonal,
        all_rotations,
        bool((traces <= d * TOLERANCE).all()),
        _null_space(right),
        _null_space(left).T,
        generator,
        span,
    )


def _null_space(square: Floats) -> Floats:
    """Return the null space of a symmetric positive semidefinite matrix, as columns."""
    values, vectors = np.linalg.eigh(square)
    return np.asarray(vectors[:, values <= TOLERANCE**2 * max(float(values.max(initial=0.0)), 1.0)])

"""Free rigid bodies of n dimensions, on so(n), with the integrals of Manakov, coefficients of ``tr (X + mu a)^m``."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.exact.numbers import fraction, rational
from coadjoint.algebra.polynomials.exact_polynomials import Exact, ExactPolynomials
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.short_repr import short
from coadjoint.systems.bodies.inertia import check_symmetric_matrix, read_vector, warn_negative_mass, with_change
from coadjoint.systems.bodies.rigid_body import rotations
from coadjoint.systems.gallery_entry import GalleryEntry, Picture
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.registry import ready_made
from coadjoint.validation import as_tuples, check_finite, read_finite, read_numbers

MAX_SO_DIMENSION = 6
"""Largest n with integrals of degree 4 and higher; their number of terms grows at least like n^4."""
MAX_TRACE_POWER = 10
"""Largest power of a in a quadratic integral; higher ones would overflow float64 in large dimensions."""


def planes(n: int) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Return i and j of each coordinate of so(n), the entry (i, j) of the matrix X."""
    if n == 3:
        return np.array([2, 0, 1]), np.array([1, 2, 0])
    first, second = np.triu_indices(n, 1)
    return first.astype(np.int64), second.astype(np.int64)


def trace_form(a: npt.NDArray[Any], k: int) -> npt.NDArray[Any]:
    """Return the matrix of the form ``-sum over p + q = k of tr(X a^p X a^q) / 2`` in the n (n - 1)/2 coordinates x."""
    # For k = 1 and the second moments of mass it maps Omega to the momentum.
    i, j = planes(len(a))
    powers = [np.eye(len(a), dtype=int).astype(a.dtype)]
    for _ in range(k):
        powers.append(np.array([[(row * column).sum() for column in a.T] for row in powers[-1]], dtype=a.dtype))
    total = np.zeros((i.size, i.size), dtype=a.dtype)
    for P, Q in zip(powers, reversed(powers), strict=True):
        # tr(E_ij P E_kl Q) with E_ij = e_i e_j^T - e_j e_i^T, rows (i, j), columns (k, l).
        total += P[np.ix_(j, j)] * Q[np.ix_(i, i)] - P[np.ix_(j, i)] * Q[np.ix_(i, j)]
        total += P[np.ix_(i, i)] * Q[np.ix_(j, j)] - P[np.ix_(i, j)] * Q[np.ix_(j, i)]
    return total / 2


def inverse_of_form(form: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
    """Return the inverse of a matrix of exact numbers, rounded once."""
    from flint import fmpq_mat

    n = len(form)
    inverse = fmpq_mat(n, n, [rational(entry) for entry in form.ravel().tolist()]).inv()
    try:
        return np.array([float(fraction(entry)) for entry in inverse.entries()]).reshape(n, n)
    except OverflowError:
        raise ValueError("inertia has an inverse that overflows; take larger units") from None


def manakov_integrals(a: npt.NDArray[Any]) -> dict[str, Quadratic | Polynomial]:
    """Return the nontrivial integrals by name, for a diagonal (n,) or a symmetric matrix a."""
    # At most ten quadratic ones for every n; those of higher degree for n up to 6.
    try:
        return _quadratic_integrals(a) | (_higher_integrals(a) if 5 <= len(a) <= MAX_SO_DIMENSION else {})
    except OverflowError:  # fractions beyond the range of floats
        raise ValueError("a power of the entries overflows in an integral; take other units") from None


def _quadratic_integrals(a: npt.NDArray[Any]) -> dict[str, Quadratic | Polynomial]:
    n = len(a)
    integrals: dict[str, Quadratic | Polynomial] = {}
    with np.errstate(over="ignore", invalid="ignore"):
        for k in range(1, min(n - 2, MAX_TRACE_POWER) + 1):
            form = 2 * (_complete_homogeneous_sums(a, k) if a.ndim == 1 else trace_form(a, k)).astype(np.float64)
            if not np.isfinite(form).all():
                raise ValueError(f"the power {k} of the entries overflows in an integral; take other units")
            integrals[_integral_name(2, k)] = Quadratic(form)
    return integrals


def _complete_homogeneous_sums(a: npt.NDArray[Any], k: int) -> npt.NDArray[Any]:
    """Return ``sum over p + q = k of a_i^p a_j^q`` for each plane."""
    i, j = planes(len(a))
    return sum((a[i] ** p * a[j] ** (k - p) for p in range(k + 1)), np.zeros(i.size))


def _integral_name(degree: int, power: int) -> str:
    return f"X^{degree} a" if power == 1 else f"X^{degree} a^{power}"


def _higher_integrals(a: npt.NDArray[Any]) -> dict[str, Polynomial]:
    """Return the integrals of degree 4 and higher, from the powers of X + mu a as a matrix of polynomials."""
    n = len(a)
    a_matrix = np.diag(a) if a.ndim == 1 else a
    ring = ExactPolynomials(rotations(n), ("mu",))
    matrix = [[rational(entry) * ring.symbol_elements["mu"] for entry in row] for row in a_matrix.tolist()]
    for x, i, j in zip(ring.coordinates, *(side.tolist() for side in planes(n)), strict=True):
        matrix[i][j] += x
        matrix[j][i] -= x
    columns = list(zip(*matrix, strict=True))

    def dot(row: Sequence[Exact], column: Sequence[Exact]) -> Exact:
        return sum((p * q for p, q in zip(row, column, strict=True)), ring.zero)

    power, integrals = matrix, {}
    for m in range(2, n + 1):
        if m >= 5:
            trace = sum(map(dot, power, columns), ring.zero).to_dict()
            for j in range(2, (m + 1) // 2):
                monomials: dict[tuple[int, ...], Any] = {
                    tuple(map(int, e[:-1])): float(fraction((-1) ** j * value / m))
                    for e, value in trace.items()
                    if e[-1] == m - 2 * j
                }
                integrals[_integral_name(2 * j, m - 2 * j)] = Polynomial(monomials, dim=ring.dim)
        power = [[dot(row, column) for column in columns] for row in power]
    return integrals


def halves_of_so4(sign: float) -> list[list[float]]:
    """Return the linear forms, (3, 6), of ``(x23, -x13, x12) + sign (x14, x24, x34)``, of constant length in so(4)."""
    # The coordinates are x12, x13, x14, x23, x24, x34; sign is 1.0 or -1.0.
    forms = [[0.0] * 6 for _ in range(3)]
    for row, (first, factor, second) in enumerate(((3, 1.0, 2), (1, -1.0, 4), (0, 1.0, 5))):
        forms[row][first], forms[row][second] = factor, sign
    return forms


TWO_SPHERES = Picture(
    "directions",
    vectors={"self-dual part": halves_of_so4(1.0), "anti-self-dual part": halves_of_so4(-1.0)},
    title="so(4) as two spheres: the directions of both parts",
)


def _planes_of_so4(dim: int) -> tuple[str, ...]:
    return ("x12", "x13", "x14", "x23", "x24", "x34") if dim == 6 else ()


def _body_energy(inertia: npt.NDArray[Any]) -> tuple[npt.NDArray[Any]]:
    if inertia.ndim == 1:
        first, second = planes(len(inertia))
        return (1.0 / (inertia[first] + inertia[second]),)
    inverse = inverse_of_form(trace_form(_exact(inertia.real), 1))
    return (with_change(inverse, trace_form(inertia.imag, 1)) if inertia.dtype.kind == "c" else inverse,)


def _exact(matrix: npt.NDArray[np.float64]) -> npt.NDArray[Any]:
    return np.array([[Fraction(entry) for entry in row] for row in matrix.tolist()], dtype=object)


@ready_made(
    energy=_body_energy,
    symmetric=("inertia",),
    gallery_entry=GalleryEntry(
        x0=(1.0, 0.3, 0.2, 0.1, 0.6, 0.5),
        t_span=(0.0, 200.0),
        step=0.1,
        caption="A body of four dimensions: so(4) is two copies of so(3), so its momentum is two vectors of constant "
        "lengths, each on a sphere of its own (both drawn on one). Together they fill a torus: the motion is "
        "integrable.",
        pictures=(TWO_SPHERES,),
        coordinates=_planes_of_so4,
        quantity="angular momentum",
    ),
)
def so_n_body(inertia: npt.ArrayLike = (1.0, 2.0, 3.0, 4.0)) -> LiePoissonSystem:
    """Return the free rigid body of n dimensions, ``X' = [X, Omega]`` with ``X = Lambda Omega + Omega Lambda``.

    X is the angular momentum in the body frame, a skew n x n matrix, and Omega the angular velocity. The state consists
    of the coordinates of X in the basis of so(n), for the planes 12, 13, ..., 1n, 23, ...; for n = 3 it is the vector
    along the axes. Sign -1, the body equations, and ``H = sum of x_ij Omega_ij / 2`` over the planes. For principal
    axes ``Omega_ij = x_ij / (l_i + l_j)``, so for n = 3 it is `rigid_body` with the moments l2 + l3, l3 + l1, l1 + l2.

    The group element g is the attitude, a rotation of n-dimensional space from the body to space; ``g X g^T`` is
    constant.

    Parameters
    ----------
    inertia : (n,) or (n, n)
        Second moments of the mass along the principal axes, or the symmetric matrix of them, Lambda (mass times length
        squared), n >= 3. The sum of any two principal values must be positive. A full matrix is inverted in rational
        arithmetic, which takes minutes from about n = 20: give principal values then.

    Returns
    -------
    LiePoissonSystem
        Casimirs of so(n). Manakov's integrals with ``a = Lambda^2``, such as ``"X^2 a"``; see `manakov_top`. The energy
        is a linear combination of the quadratic ones and ``|x|^2``.

    Raises
    ------
    ValueError
        `inertia` has the wrong shape, is not finite or not symmetric, or a sum of two principal values is not positive.

    Warns
    -----
    UserWarning
        A principal value is negative, which is impossible for a distribution of mass.

    Notes
    -----
    Manakov, Funct. Anal. Appl. 10, 328 (1976); Ratiu, Indiana Univ. Math. J. 29, 609 (1980).

    Examples
    --------
    >>> body = so_n_body((1.0, 1.0, 3.0, 7.0))
    >>> body.energy([1.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    0.3
    >>> list(body.integrals)
    ['X^2 a', 'X^2 a^2']
    """
    values = read_numbers(inertia, "inertia")
    if values.ndim not in (1, 2) or values.shape[0] < 3 or values.shape != values.shape[:1] * values.ndim:
        raise ValueError(f"inertia has shape {values.shape}; give n principal values, or a symmetric (n, n), n from 3")
    check_finite(values, "inertia")
    n = len(values)
    if values.ndim == 2:
        check_symmetric_matrix(values, "inertia")
        values = np.triu(values) + np.triu(values, 1).T
    smallest = np.sort(values if values.ndim == 1 else np.linalg.eigvalsh(values))[:2]
    with np.errstate(over="ignore"):
        least_sum = smallest.sum()
    if least_sum <= (0.0 if values.ndim == 1 else 4 * n * UNIT_ROUNDOFF * np.abs(values).max()):
        raise ValueError(f"inertia has the principal values {short(smallest.tolist())}; their sum must be positive")
    warn_negative_mass(values)
    algebra = rotations(n)
    if values.ndim == 1:
        first, second = planes(n)
        with np.errstate(over="ignore", divide="ignore"):
            sums = values[first] + values[second]
            (M,), a = _body_energy(values), values**2
        if not (np.isfinite(sums).all() and np.isfinite(M).all()):
            raise ValueError(
                "sums of two principal values of inertia or their inverses leave the range of float64; change units"
            )
    else:
        (M,), a = _body_energy(values), _exact(values) @ _exact(values)
    return LiePoissonSystem(
        algebra,
        Quadratic(M),
        sign=-1,
        name="so_n_body",
        parameters={"inertia": as_tuples(values)},
        integrals=manakov_integrals(a),
    )


def _manakov_energy(a: npt.NDArray[Any], b: npt.NDArray[Any]) -> tuple[npt.NDArray[Any]]:
    first, second = planes(len(a))
    return ((b[first] - b[second]) / (a[first] - a[second]),)


@ready_made(
    energy=_manakov_energy,
    gallery_entry=GalleryEntry(
        x0=(1.0, 0.3, 0.2, 0.1, 0.6, 0.5),
        t_span=(0.0, 60.0),
        step=0.05,
        caption="An integrable energy on so(4), which is two copies of so(3): the momentum is two vectors of constant "
        "lengths, each on a sphere of its own (both drawn on one), and the paths fill bands with sharp edges.",
        pictures=(TWO_SPHERES,),
        coordinates=_planes_of_so4,
        quantity="angular momentum",
    ),
)
def manakov_top(a: npt.ArrayLike = (1.0, 2.0, 4.0, 7.0), b: npt.ArrayLike = (1.0, 3.0, 2.0, 5.0)) -> LiePoissonSystem:
    """Return Manakov's top on so(n), ``X' = [X, Omega]`` with ``Omega_ij = (b_i - b_j)/(a_i - a_j) x_ij``.

    State, sign -1 and group element are those of `so_n_body`, which is the case ``a = l^2``, ``b = l``. The energy
    ``sum of (b_i - b_j)/(a_i - a_j) x_ij^2 / 2`` need not be positive.

    The equations are equivalent to ``(X + mu a)' = [X + mu a, Omega + mu b]`` for every number mu, with a and b as
    diagonal matrices. So the coefficients of ``tr (X + mu a)^m`` are constant, and they are in involution.

    Parameters
    ----------
    a : (n,)
        Distinct numbers, n >= 3.
    b : (n,)
        Any numbers, in units such that (b_i - b_j)/(a_i - a_j) is an inverse moment of inertia.

    Returns
    -------
    LiePoissonSystem
        With the quadratic integrals ``"X^2 a"``, ``"X^2 a^2"``, ..., ``"X^2 a^(n-2)"``, ten at most, and those of
        higher degree, such as ``"X^4 a"``, up to n = 6: ``(-1)^j / m`` times the coefficient of mu^(m - 2j) of
        ``tr (X + mu a)^m`` is called X^2j a^(m - 2j). The energy is a combination of the quadratic ones and
        of ``|x|^2``.

    Raises
    ------
    ValueError
        a and b are not finite, differ in length or have fewer than three entries, two entries of a are equal, or a
        quotient or a power of a overflows.

    Notes
    -----
    Manakov, "Note on the integration of Euler's equations of the dynamics of an n-dimensional rigid body", Funct. Anal.
    Appl. 10, 328 (1976).

    Examples
    --------
    >>> top = manakov_top(a=(1.0, 2.0, 4.0, 7.0), b=(1.0, 3.0, 2.0, 5.0))
    >>> top.energy([1.0, 0.0, 0.0, 0.0, 0.0, 2.0])
    3.0
    >>> top.integrals["X^2 a"].value([1.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    14.0
    """
    a_values = read_finite(a, "a")
    if a_values.ndim != 1 or a_values.size < 3:
        raise ValueError(f"a has shape {a_values.shape}; give n numbers, n from 3")
    b_values = read_vector(b, "b", a_values.size)
    algebra = rotations(a_values.size)
    first, second = planes(a_values.size)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        (M,) = _manakov_energy(a_values, b_values)
    equal = a_values[first] == a_values[second]
    if equal.any():
        i, j = sorted((int(first[equal][0]), int(second[equal][0])))
        raise ValueError(f"a[{i}] and a[{j}] are both {a_values[i]:g}; give different numbers")
    if not np.isfinite(M).all():
        raise ValueError("a quotient (b_i - b_j)/(a_i - a_j) overflows; take smaller b, or a farther apart")
    return LiePoissonSystem(
        algebra,
        Quadratic(M),
        sign=-1,
        name="manakov_top",
        parameters={"a": tuple(a_values.tolist()), "b": tuple(b_values.tolist())},
        integrals=manakov_integrals(a_values),
    )

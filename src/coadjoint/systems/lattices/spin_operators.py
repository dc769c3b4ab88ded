"""Matrices of spin operators, an orthogonal basis of all operators of a spin, and the algebra su(N) in that basis."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.constants import Triples
from coadjoint.algebra.families.products import copies
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.short_repr import short
from coadjoint.systems.lattices.space_groups import product
from coadjoint.systems.lattices.spin_polynomials import directions, stevens, values_of
from coadjoint.validation import read_number

Floats = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complexfloating[Any, Any]]

MAX_TEXT_TERMS = 9  # of an operator as text
MAX_LEVELS = 16  # of a site: its algebra has 255 dimensions and some 10^4 structure constants


@suggest_keywords
def operators(spin: float = 0.5) -> tuple[Complex, Complex, Complex]:
    """Return the matrices of Sx, Sy and Sz of a quantum spin, in units of hbar.

    Choose them for the single-ion and pair energies of models with ``mode="SU(N)"``, and for expectations: products and
    sums of them are all operators of a site.

    Parameters
    ----------
    spin : float
        S, a positive multiple of 1/2, up to 15/2.

    Returns
    -------
    tuple of three (N, N) arrays of complex
        N = 2 S + 1, in the basis of Sz from m = S down to -S, with real Sx and Sz.

    Raises
    ------
    ValueError
        The spin is not a multiple of 1/2, or too large.

    Examples
    --------
    >>> import coadjoint as co
    >>> Sx, Sy, Sz = co.spins.operators(1)
    >>> Sz.real.diagonal().tolist(), bool(abs(Sx @ Sy - Sy @ Sx - 1j * Sz).max() < 1e-15)
    ([1.0, 0.0, -1.0], True)
    """
    m = magnetic_numbers(levels_of(spin, "spin"))
    raising = np.zeros((len(m), len(m)))
    # S (S + 1) - m (m + 1) is a multiple of 1/4, without rounding.
    raising[np.arange(len(m) - 1), np.arange(1, len(m))] = np.sqrt(m[0] * (m[0] + 1.0) - m[1:] * (m[1:] + 1.0))
    return 0.5 * (raising + raising.T) + 0j, -0.5j * (raising - raising.T), np.diag(m) + 0j


def levels_of(spin: Any, what: str) -> int:
    """Return N = 2 S + 1; ValueError if S is not a positive multiple of 1/2."""
    value = read_number(spin, what)
    levels = 2.0 * value + 1.0
    if not 2.0 <= levels <= MAX_LEVELS or levels != round(levels):
        raise ValueError(
            f"{what} is {short(spin)}; spins of quantum states are multiples of 1/2, from 1/2 to {(MAX_LEVELS - 1) / 2}"
        )
    return round(levels)


def magnetic_numbers(levels: int) -> Floats:
    """Return m = S, S - 1, ..., -S."""
    return np.asarray(0.5 * (levels - 1) - np.arange(levels))


def norms_of(levels: int) -> Floats:
    """Return tr T^2 of the basis operators: N of the unit matrix, tr Sz^2 of all others."""
    return np.where(np.arange(levels**2), levels * (levels**2 - 1) / 12, levels)


def orders(levels: int) -> list[tuple[int, int]]:
    """Return the rank k and the order q of the basis operators; -q is the imaginary part of q."""
    of_ranks = [
        (rank, q)
        for rank in range(1, levels)
        for q in (1, -1, 0, *(s * q for q in range(2, rank + 1) for s in (1, -1)))
    ]
    return [(0, 0), *of_ranks]


def ranks(levels: int) -> npt.NDArray[np.int64]:
    """Return the ranks of the basis operators; those of odd rank are odd under time reversal."""
    return np.array([rank for rank, _ in orders(levels)])


@cache
def tensor_operators(levels: int) -> Complex:
    """Return the basis (N^2, N, N): the unit matrix, Sx, Sy, Sz, and multipoles of rank 2, ..., N - 1 as in `orders`.

    They are Hermitian, orthogonal in the trace form, and but for the unit matrix of the norm of Sz.
    """
    spin = operators(0.5 * (levels - 1))
    lowering = (spin[0] - 1j * spin[1]).real
    tensors = {(0, 0): np.eye(levels)}  # of both rank and order, q >= 0
    highest: npt.NDArray[Any] = np.eye(levels)
    for rank in range(1, levels):
        tensor = highest = product(highest, -lowering.T)
        for q in range(rank, -1, -1):
            tensors[rank, q] = tensor / np.sqrt((tensor**2).sum())
            tensor = product(lowering, tensors[rank, q]) - product(tensors[rank, q], lowering)
    found: list[Complex] = []
    for rank, q in orders(levels):
        T = tensors[rank, abs(q)] * (-1.0) ** q
        real, imaginary = T + T.T, 1j * (T.T - T)
        found.append(T + 0j if q == 0 else np.sqrt(0.5) * (real + 0j if q > 0 else imaginary))
    basis = np.array(found) * np.sqrt(norms_of(levels))[:, None, None]
    basis[:4] = np.eye(levels), *spin
    basis.flags.writeable = False
    return basis


def coefficients_of(operator: Complex) -> Floats:
    """Return the coefficients (..., N^2) of Hermitian matrices (..., N, N) in the basis, the unit matrix first."""
    levels = operator.shape[-1]
    traces = (operator[..., None, :, :] * tensor_operators(levels).conj()).sum(axis=(-2, -1)).real
    return _without_roundoff(traces / norms_of(levels))


def pair_coefficients_of(operator: Complex) -> Floats:
    """Return the coefficients (N^2, N^2) of a Hermitian matrix of two sites in products of the basis."""
    levels = math.isqrt(len(operator))
    T, norms = tensor_operators(levels).conj(), norms_of(levels)
    blocks = operator.reshape(levels, levels, levels, levels).swapaxes(1, 2)  # (first, first, second, second)
    of_first = np.array([(blocks * matrix[:, :, None, None]).sum(axis=(0, 1)) for matrix in T])
    found = np.array([(of_first * matrix).sum(axis=(1, 2)).real for matrix in T]).T
    return _without_roundoff(found / (norms[:, None] * norms))


def operator_text(coefficients: Floats) -> str:
    """Return an operator of one or two sites, by coefficients in the basis, as a sum of spins and Stevens operators."""
    levels = math.isqrt(len(coefficients))
    names, units = ["1", "Sx", "Sy", "Sz"], [1.0] * 4
    for index, (rank, q) in enumerate(orders(levels)[4:], 4):
        even = rank in (2, 4, 6)
        names.append(f"{'O' if even else 'T'}{rank}{q}")
        units.append(float(stevens_coefficients(levels, rank, q)[index]) if even else 1.0)
    pair = coefficients.ndim == 2
    values = coefficients / (np.multiply.outer(units, units) if pair else np.array(units))
    if not pair:
        values = values[:, None]
    found = [
        (values[a, b], " ".join(name for name in ((names[a], names[b]) if pair else (names[a],)) if name != "1"))
        for a, b in np.argwhere(np.abs(values) > 1e-12 * np.abs(values).max(initial=0.0)).tolist()
    ]
    if len(found) > MAX_TEXT_TERMS:
        return f"{levels} x {levels} operator" if not pair else f"operator of {len(found)} products of {names[1]}, ..."
    terms = [f"{'-' if value < 0 else '+'} {abs(value):.6g}{' ' if name else ''}{name}" for value, name in found]
    first = terms[0].replace("- ", "-").removeprefix("+ ") if terms else "0"
    return " ".join([first, *terms[1:]])


def _without_roundoff(values: Floats) -> Floats:
    """Return coefficients without those that are round-off of the largest."""
    return np.where(np.abs(values) > 1e-15 * np.abs(values).max(initial=0.0), values, 0.0)


def stevens_coefficients(levels: int, degree: int, m: int) -> Floats:
    """Return the coefficients (N^2,) of a Stevens operator, which is a multiple of one operator of the basis.

    Its expectation in the coherent state of a direction n is ``S^l (1 - 1/(2 S)) ... (1 - (l - 1)/(2 S)) O_lm(n)``.
    """
    spin, index = 0.5 * (levels - 1), orders(levels).index((degree, m))
    points, function = directions(), stevens(degree, m)
    values = values_of(function, points)
    n = int(np.argmax(np.abs(values)))
    Z = coherent_amplitudes(levels, points[n])
    own = (Z.conj() * (tensor_operators(levels)[index] * Z).sum(axis=-1)).sum().real / (np.abs(Z) ** 2).sum()
    factor = math.prod(1.0 - k / (2.0 * spin) for k in range(1, degree)) * spin**degree
    found = np.zeros(levels**2)
    found[index] = factor * values[n] / own
    return found


def rotations_of_operators(levels: int, rotations: Floats) -> Floats:
    """Return the matrices (k, N^2, N^2) by which orthogonal (k, 3, 3) act on coefficients of operators.

    Spins are axial: reflections act as their products with the inversion.
    """
    T, spinor = tensor_operators(levels), _spinor(levels)
    proper = (np.cross(rotations[:, 0], rotations[:, 1]) * rotations[:, 2]).sum(axis=1)
    found = []
    for R in rotations * np.sign(proper)[:, None, None]:
        U = spinor(R)
        found.append(coefficients_of(product(product(U, T), U.conj().T)).T)
    return np.array(found)


def _spinor(levels: int) -> Any:
    """Return the function from a proper rotation to exp(-i theta n . S), up to its sign."""
    spin = np.array(operators(0.5 * (levels - 1)))

    def of_rotation(R: Floats) -> Complex:
        # The quaternion of R by its largest component, which is never small.
        K = np.empty((4, 4))
        K[0] = np.trace(R), R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
        K[1:, 1:] = R + R.T - np.trace(R) * np.eye(3)
        K[1:, 0] = K[0, 1:]
        K = K + np.eye(4)
        q = K[int(np.argmax(K.diagonal()))]
        q = q / np.sqrt((q**2).sum())
        size = np.sqrt((q[1:] ** 2).sum())
        axis = q[1:] / size if size > 0.0 else np.zeros(3)
        halvings = 8
        generator = -2j * np.arctan2(size, q[0]) / 2**halvings * (axis[:, None, None] * spin).sum(axis=0)
        U: npt.NDArray[Any] = np.eye(levels) + 0j
        term = U
        for k in range(1, 16):
            term = product(term, generator) / k
            U = U + term
        for _ in range(halvings):
            U = product(U, U)
        return U

    return of_rotation


def coherent_amplitudes(levels: int, directions: Floats) -> Complex:
    """Return the amplitudes (..., N) of the coherent states of directions (..., 3) of any length."""
    x, y, z = np.moveaxis(directions, -1, 0)
    polar, turn = np.arctan2(np.hypot(x, y), z), np.arctan2(y, x)
    k = np.arange(levels)  # S - m
    binomials = np.sqrt([float(math.comb(levels - 1, number)) for number in k.tolist()])
    sizes = np.cos(0.5 * polar)[..., None] ** k[::-1] * np.sin(0.5 * polar)[..., None] ** k
    return np.asarray(binomials * sizes * np.exp(1j * k * turn[..., None]))


@cache
def site_algebra(levels: int, hbar: float) -> LieAlgebra:
    """Return su(N) in the basis: x_a are expectations, ``{x_a, x_b} = <-i [T_a, T_b]> / hbar``."""
    T, norm = tensor_operators(levels)[1:], norms_of(levels)[1]
    n, found = len(T), []
    for a in range(n):
        for b in range(a + 1, n):
            commutator = product(T[a], T[b]) - product(T[b], T[a])
            # The constants are totally antisymmetric: each is computed once, so that rotations are skew to the bit.
            values = (commutator * T[b + 1 :].conj()).sum(axis=(1, 2)).imag / norm
            for k in np.flatnonzero(np.abs(values) > 1e-12 * levels).tolist():
                c, value = b + 1 + k, float(values[k]) / hbar
                found += [(a, b, c, value), (b, c, a, value), (a, c, b, -value)]
    columns = [np.array(column) for column in zip(*sorted(found), strict=True)]
    constants = Triples(columns[0], columns[1], columns[2], columns[3])
    square = {"|x|^2": Polynomial({tuple(2 * (a == b) for b in range(n)): 1.0 for a in range(n)})}
    names = ("Sx", "Sy", "Sz", *(f"T{rank}{'m' if q < 0 else ''}{abs(q)}" for rank, q in orders(levels)[4:]))
    return LieAlgebra._from_valid(constants, n, names, f"su({levels})", None, square)


@cache
def _few_sites(levels: int, count: int, hbar: float) -> LieAlgebra:
    return copies(site_algebra(levels, hbar), count)


def sites_algebra(levels: int, count: int, hbar: float) -> LieAlgebra:
    """Return the algebra of all sites; those of few sites are shared."""
    return _few_sites(levels, count, hbar) if count <= 8 else copies(site_algebra(levels, hbar), count)

"""Equations of the weak form: samples and test functions, monomials and their fields, and covariances of errors."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.algebra.polynomials.monomials import exponents_of_degree
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.memory import check_available_memory
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.short_repr import distinct, short
from coadjoint.validation import are_finite, read_numbers

Floats = NDArray[np.float64]

# Test functions are (1 - s^2)^POWER: sums over 2 r samples are then integrals to 2e-10 for r = 8, 2e-15 for r = 16.
POWER = 16
MIN_RADIUS = 8
"""Least half length of test functions, in samples."""
STRIDES = 4
"""Test functions for each half length."""
GROUPED = 16
"""Test functions with a common covariance; groups share no samples."""
DIFFERENCES = 6
"""Order of the differences from which the noise is first estimated; the residuals correct it."""
LEAST_NOISE = 1e-3
"""Least noise of a component, relative to the largest of all."""
RANK = 1e-9
"""Relative singular value below which a direction is undetermined."""
EQUAL_STEPS = 1e-6
"""Relative difference of steps that count as equal."""


class TrajectorySamples(NamedTuple):
    """Trajectories (members, k, n) at increasing times, scaled to the mean square 1, and what was given."""

    algebra: LieAlgebra
    sign: int
    t: Floats
    x: Floats
    scale: float
    given: tuple[Floats, Floats]

    @classmethod
    def of(cls, algebra: Any, t: Any, x: Any, sign: int) -> TrajectorySamples:
        if not isinstance(algebra, LieAlgebra):
            raise TypeError(f"algebra is {short(algebra)}; give a LieAlgebra, such as co.algebras.so(3)")
        times, states = read_numbers(t, "t"), read_numbers(x, "x")
        n = algebra.dim
        if states.ndim not in (2, 3) or states.shape[-1] != n:
            raise ValueError(f"x has the shape {states.shape}; it must be (k, {n}) or (k, members, {n})")
        if times.shape != states.shape[:1]:
            raise ValueError(f"t has the shape {times.shape} and x {states.shape}; give a time for each sample")
        if not are_finite(times) or not are_finite(states):
            raise ValueError("t or x contains values that are not finite; leave out trajectories that end early")
        if len(times) < 2 * MIN_RADIUS + 1:
            raise ValueError(f"there are {len(times)} samples of each trajectory; give at least {2 * MIN_RADIUS + 1}")
        steps = np.diff(times)
        step = (times[-1] - times[0]) / (len(times) - 1)
        if not step or np.abs(steps - step).max() > EQUAL_STEPS * abs(step):
            shortest, longest = distinct(steps.min(), steps.max())
            raise ValueError(
                f"t has steps from {shortest} to {longest}; they must be equal, since the integrals are "
                "sums over the samples: measure or save at equal steps, without t_eval"
            )
        members = np.moveaxis(states.reshape(len(times), -1, n), 0, 1)
        scale = float(np.sqrt(np.mean(np.sum(members**2, axis=-1))))
        if not scale:
            raise ValueError("x is zero everywhere; give trajectories that move")
        order = slice(None) if step > 0 else slice(None, None, -1)
        return cls(algebra, sign, times[order], members[:, order] / scale, scale, (times, states))

    @property
    def step(self) -> float:
        return float((self.t[-1] - self.t[0]) / (len(self.t) - 1))


def exponents_of(n: int, degree: int) -> NDArray[np.int64]:
    """Return the exponents (p, n) of all monomials of degree 1 to `degree`."""
    check_available_memory(
        8 * n * math.comb(n + degree, degree), f"monomials of degree {short(degree)} in {n} coordinates"
    )
    return np.array([e for d in range(1, degree + 1) for e in exponents_of_degree(n, d)], dtype=np.int64)


def gradients_of(exponents: NDArray[np.int64], x: Floats) -> Floats:
    """Return the gradients (k, n, p) of the monomials at states (k, n)."""
    n = x.shape[1]
    powers = np.stack([x**d for d in range(int(exponents.max()) + 1)], axis=-1)
    out = np.empty((len(x), n, len(exponents)))
    for j in range(n):
        lowered = exponents - (np.arange(n) == j)
        value = exponents[:, j].astype(np.float64) * np.ones((len(x), 1))
        for i in range(n):
            value *= powers[:, i, np.maximum(lowered[:, i], 0)]
        out[:, j] = value
    return out


def moved(algebra: LieAlgebra, x: Floats, gradients: Floats) -> Floats:
    """Return J(x) g for states (k, n) and vectors g (k, n, p)."""
    out = np.zeros_like(gradients)
    for i, j, k, c in zip(*(column.tolist() for column in algebra.triples), strict=True):
        weight = c * x[:, k, None]
        out[:, i] += weight * gradients[:, j]
        out[:, j] -= weight * gradients[:, i]
    return out


def complement_of_casimirs(algebra: LieAlgebra, exponents: NDArray[np.int64]) -> Floats:
    """Return an orthonormal basis (p, q) of the coefficients orthogonal to those of all Casimirs."""
    # Casimirs are the combinations that move no state; generic states suffice to find them.
    n, p = algebra.dim, len(exponents)
    count = 2 + 2 * p // max(1, n - 1)
    states = np.random.default_rng(0).standard_normal((count, n))
    columns = moved(algebra, states / np.linalg.norm(states, axis=1)[:, None], gradients_of(exponents, states))
    _, values, rows = np.linalg.svd(columns.reshape(-1, p), full_matrices=True)
    rank = int(np.count_nonzero(values > RANK * max(values.max(initial=0.0), UNIT_ROUNDOFF)))
    return np.asarray(rows[:rank].T)


Equations = tuple[Floats, Floats, Callable[[Polynomial | None], Floats]]
"""Matrix (w, n, p) and right-hand side (w, n) of w test functions, and their derivative by the samples for an H."""


def equations_of(data: TrajectorySamples, exponents: NDArray[np.int64], r: int) -> Iterator[Equations]:
    """Yield the equations in groups that share no samples with weights."""
    s = np.arange(-r, r + 1) / r
    bump, slope = (1 - s**2) ** POWER, -2 * POWER * s * (1 - s**2) ** (POWER - 1) / (r * data.step)
    stride, samples = max(1, r // STRIDES), data.x.shape[1]
    length = 2 * r + stride * (GROUPED - 1)
    for member in data.x:
        for first in range(0, samples - 2 * r, length):
            x = member[first : first + length + 1]
            starts = range(0, len(x) - 2 * r, stride)
            psi, of_slope = (np.zeros((len(starts), len(x))) for _ in range(2))
            for w, start in enumerate(starts):
                psi[w, start : start + 2 * r + 1], of_slope[w, start : start + 2 * r + 1] = bump, slope
            fields = data.sign * moved(data.algebra, x, gradients_of(exponents, x))
            yield np.tensordot(psi, fields, 1), -of_slope @ x, partial(_derivative_by_samples, data, x, psi, of_slope)


def _derivative_by_samples(
    data: TrajectorySamples, x: Floats, psi: Floats, slope: Floats, H: Polynomial | None
) -> Floats:
    """Return the derivative (w, n, k, n) of equations by samples; without H, that of the right-hand side alone."""
    # Samples x + e change the equations by sum_t (psi dF/dx + psi') e, with the field F of H.
    by_sample = np.einsum("wt,il->witl", slope, np.eye(x.shape[1]))
    if H is not None:
        by_sample += np.einsum("wt,til->witl", psi, field_derivatives(data, H, x))
    return np.asarray(by_sample)


def whitened_equations(A: Floats, b: Floats, by_sample: Floats, noise: Floats) -> tuple[Floats, Floats]:
    """Return matrix and right-hand side, divided by a root of the covariance of errors by the noise."""
    w, n = b.shape
    root = (by_sample * noise).reshape(w * n, -1)
    S = root @ root.T
    L = np.linalg.cholesky(S + 4 * w * n * UNIT_ROUNDOFF * np.trace(S) / (w * n) * np.eye(w * n))
    both = np.concatenate([A.reshape(w * n, -1), b.reshape(-1, 1)], axis=1)
    solved = np.linalg.solve(L, both)
    return solved[:, :-1], solved[:, -1]


def field_derivatives(data: TrajectorySamples, H: Polynomial, x: Floats) -> Floats:
    """Return dF/dx (k, n, n) of F = sign J(x) grad H(x) at states (k, n)."""
    hessian = np.stack([H.derivative(j).gradient(x) for j in range(x.shape[1])], axis=1)
    gradient, out = H.gradient(x), moved(data.algebra, x, hessian)
    for i, j, k, c in zip(*(column.tolist() for column in data.algebra.triples), strict=True):
        out[:, i, k] += c * gradient[:, j]
        out[:, j, k] -= c * gradient[:, i]
    return np.asarray(data.sign * out)


def first_noise(x: Floats) -> Floats:
    """Return estimates of the noise (n,) by high differences of the samples, which are small for smooth motions."""
    weights = np.array([math.comb(DIFFERENCES, k) for k in range(DIFFERENCES + 1)], dtype=np.float64)
    noise = np.sqrt(np.mean(np.diff(x, DIFFERENCES, axis=1) ** 2, axis=(0, 1)) / np.sum(weights**2))
    return np.asarray(np.maximum(noise, max(LEAST_NOISE * noise.max(), UNIT_ROUNDOFF)))


def polynomial_of(exponents: NDArray[np.int64], coefficients: Floats) -> Polynomial:
    """Return the polynomial with these coefficients."""
    return Polynomial(
        dict(zip(map(tuple, exponents.tolist()), coefficients.tolist(), strict=True)), dim=exponents.shape[1]
    )

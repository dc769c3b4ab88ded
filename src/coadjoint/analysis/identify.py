"""Polynomial Hamiltonians from measured trajectories, by the weak form of the equations of motion."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.errors import IntegrationError
from coadjoint.long_operations import long_operation, note_progress
from coadjoint.memory import check_available_memory
from coadjoint.methods.gauss_legendre import GaussLegendre
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.runs.integrate import integrate
from coadjoint.runs.results.solution import Solution
from coadjoint.short_repr import short
from coadjoint.systems.arguments import read_sign
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.validation import are_finite, read_integer, read_numbers

Floats = NDArray[np.float64]

# Test functions are (1 - s^2)^POWER: sums over 2 r samples are then integrals to 2e-10 for r = 8, 2e-15 for r = 16.
POWER = 16
MIN_RADIUS = 8
RADII = (8, 12, 16, 24, 32, 48, 64, 96, 128)
"""Half lengths of test functions in samples, of which the one with the least uncertainty is chosen."""
STRIDES = 4
"""Test functions for each half length."""
GROUPED = 16
"""Test functions with a common covariance; groups share no samples."""
ITERATIONS = 20
CONVERGED = (1e-3, 1e-13)
"""Changes of coefficients, relative to their largest standard deviation and size, that end the iteration."""
DIFFERENCES = 6
"""Order of the differences from which the noise is first estimated; the residuals correct it."""
LEAST_NOISE = 1e-3
"""Least noise of a component, relative to the largest of all."""
RANK = 1e-9
"""Relative singular value below which a direction is undetermined."""


@dataclass(frozen=True, eq=False, repr=False)
class Identification:
    """The result of `identify`.

    Parameters
    ----------
    hamiltonian : Polynomial
        H without constant, and with the least sum of squared coefficients among all that differ by Casimirs (in units
        in which the states have the mean square 1).
    system : LiePoissonSystem
        The system that H moves.
    exponents : tuple of tuple of int
        The monomials, in the order of `covariance`.
    covariance : ndarray, shape (p, p)
        Of the coefficients, for independent normal errors of the samples; singular in the directions of Casimirs.
    noise : ndarray, shape (n,)
        Standard deviations of the errors of the samples, as found from the data.
    undetermined : tuple of Polynomial
        Combinations of monomials, no Casimirs, that the trajectories do not determine: H has no part along them.
    radius : int
        Half length of the test functions, in samples.
    solution : Solution or None
        A run of `system` from the first states at the times of the data; None if it fails.
    run_error : float
        Root mean square of that run minus the data, relative to the data; infinite if the run fails.
    """

    hamiltonian: Polynomial
    system: LiePoissonSystem
    exponents: tuple[tuple[int, ...], ...]
    covariance: Floats
    noise: Floats
    undetermined: tuple[Polynomial, ...]
    radius: int
    solution: Solution | None
    run_error: float
    basis: Floats

    def coefficients_of(self, H: Polynomial) -> Floats:
        """Return the coefficients of a polynomial modulo Casimirs, constants and what is undetermined.

        Its difference from that of `hamiltonian` has the `covariance`, if this polynomial is the true H.

        Parameters
        ----------
        H : Polynomial

        Returns
        -------
        ndarray, shape (p,)
        """
        unknown = next((e for e in H.monomials if sum(e) and e not in self.exponents), None)
        if unknown is not None:
            raise ValueError(f"H has the monomial {unknown}, beyond the degree that was identified")
        coefficients = np.array([float(H.monomials.get(e, 0.0)) for e in self.exponents])
        projected, _, _, _ = np.linalg.lstsq(self.basis, coefficients, rcond=None)
        return np.asarray(self.basis @ projected)

    @property
    def standard_deviation(self) -> Floats:
        """Standard deviations of the coefficients, (p,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def __repr__(self) -> str:
        missing = f", {len(self.undetermined)} undetermined" if self.undetermined else ""
        return (
            f"<identified {self.hamiltonian}: {len(self.exponents)} monomials{missing}, noise {self.noise.max():.2g}, "
            f"error of a run {self.run_error:.2g}>"
        )


@long_operation("identify")
def identify(
    algebra: LieAlgebra, t: Any, x: Any, degree: int = 2, *, sign: int = 1, radius: int | None = None
) -> Identification:
    """Identify a polynomial Hamiltonian from measured trajectories, without their derivatives.

    Choose it if the algebra is known and H is not; for parameters of a known form of H use `fit`. The equations of
    motion are multiplied by test functions and integrated by parts (weak SINDy), which is linear in the coefficients.
    They are weighted by the covariance of their errors (WENDy), so that the covariance of the coefficients follows.

    Parameters
    ----------
    algebra : LieAlgebra
        The algebra, with structure constants.
    t : array_like, shape (k,)
        Times of the samples, in equal steps, forward or backward; at least 17. Motions faster than about 20 samples a
        period are not resolved.
    x : array_like, shape (k, n) or (k, members, n)
        The samples of one or several trajectories. Each component has independent errors of one size.
    degree : int
        Largest degree of H.
    sign : int
        Sign of the system, as of `LiePoissonSystem`: +1 for x' = J(x) grad H, and -1 for bodies.
    radius : int, optional
        Half length of the test functions in samples, at least 8. By default the one with the least uncertainty.

    Returns
    -------
    Identification
        With `hamiltonian`, `system`, `covariance` of the coefficients, `noise`, `undetermined` directions, and a run of
        the system with its `run_error` against the data.

    Raises
    ------
    ValueError
        For unequal steps, too few samples, values that are not finite, or if nothing is determined.
    TypeError
        The algebra is not a `LieAlgebra`.

    Notes
    -----
    H is determined up to Casimirs and constants, which move nothing. Trajectories on one orbit only, or at rest, may
    leave more undetermined. Errors of the samples are treated to first order: noise of a few percent is the limit.

    References
    ----------
    D. A. Messenger, D. M. Bortz, Multiscale Modeling and Simulation 19 (2021) 1474; D. M. Bortz, D. A. Messenger, V.
    Dukic, Bulletin of Mathematical Biology 85 (2023) 110.

    Examples
    --------
    >>> import coadjoint as co
    >>> body = co.systems.rigid_body(inertia=(1.0, 2.0, 2.5))
    >>> sol = co.integrate(body, (1.0, 0.2, 0.5), (0, 40), 0.1, co.GaussLegendre(4))
    >>> found = co.identify(co.algebras.so(3), sol.t, sol.x, sign=-1)
    >>> error = found.hamiltonian - body.hamiltonian.to_polynomial()  # a multiple of |x|^2
    >>> [round(error.monomials[tuple(e)], 8) for e in ((2, 0, 0), (0, 2, 0), (0, 0, 2))]
    [-0.31666667, -0.31666667, -0.31666667]
    >>> found.run_error < 1e-6
    True
    """
    data = _Data.of(algebra, t, x, read_sign(sign))
    exponents = _exponents(algebra.dim, read_integer(degree, "degree", 1))
    longest = (data.x.shape[1] - 1) // 2
    if radius is not None:
        radii: tuple[int, ...] = (read_integer(radius, "radius", MIN_RADIUS, longest),)
    else:
        radii = tuple(r for r in RADII if r <= longest)
    rows = data.x.shape[0] * STRIDES * data.x.shape[1] // radii[0] * algebra.dim
    needed = 8 * len(exponents) * (3 * rows + 4 * STRIDES * GROUPED * radii[-1] * algebra.dim + 4 * len(exponents))
    check_available_memory(needed, f"an identification of {len(exponents)} monomials", "take a lower degree")
    complement = _complement(algebra, exponents)
    best: _Estimate | None = None
    for k, r in enumerate(radii):
        found = _estimate(data, exponents, complement, r)
        if found is not None and (best is None or found.better_than(best)):
            best = found
        note_progress("estimates with longer test functions", (k + 1) / len(radii))
    if best is None:
        raise ValueError(
            f"{data.x.shape[0]} trajectories of {data.x.shape[1]} samples give fewer equations than there are unknowns, "
            f"{complement.shape[1]}, or do not move; give more samples, or a lower degree"
        )
    return _result(data, exponents, complement, best)


class _Data(NamedTuple):
    """Trajectories (members, k, n) at increasing times, scaled to the mean square 1, and what was given."""

    algebra: LieAlgebra
    sign: int
    t: Floats
    x: Floats
    scale: float
    given: tuple[Floats, Floats]

    @classmethod
    def of(cls, algebra: Any, t: Any, x: Any, sign: int) -> _Data:
        """Validate the samples."""
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
        if not step or np.abs(steps - step).max() > 1e-6 * abs(step):
            raise ValueError(
                f"t has steps from {steps.min():.6g} to {steps.max():.6g}; they must be equal, since the integrals are "
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
        """The step between samples, positive."""
        return float((self.t[-1] - self.t[0]) / (len(self.t) - 1))


def _exponents(n: int, degree: int) -> NDArray[np.int64]:
    """Return the exponents (p, n) of all monomials of degree 1 to `degree`."""
    check_available_memory(8 * n * math.comb(n + degree, degree), f"monomials of degree {degree} in {n} coordinates")
    chosen = (c for d in range(1, degree + 1) for c in combinations_with_replacement(range(n), d))
    return np.array([np.bincount(c, minlength=n) for c in chosen], dtype=np.int64)


def _gradients(exponents: NDArray[np.int64], x: Floats) -> Floats:
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


def _moved(algebra: LieAlgebra, x: Floats, gradients: Floats) -> Floats:
    """Return J(x) g for states (k, n) and vectors g (k, n, p)."""
    out = np.zeros_like(gradients)
    for i, j, k, c in zip(*(column.tolist() for column in algebra.triples), strict=True):
        weight = c * x[:, k, None]
        out[:, i] += weight * gradients[:, j]
        out[:, j] -= weight * gradients[:, i]
    return out


def _complement(algebra: LieAlgebra, exponents: NDArray[np.int64]) -> Floats:
    """Return an orthonormal basis (p, q) of the coefficients orthogonal to those of all Casimirs.

    Casimirs are the combinations that move no state; generic states suffice to find them.
    """
    n, p = algebra.dim, len(exponents)
    count = 2 + 2 * p // max(1, n - 1)
    states = np.random.default_rng(0).standard_normal((count, n))
    columns = _moved(algebra, states / np.linalg.norm(states, axis=1)[:, None], _gradients(exponents, states))
    _, values, rows = np.linalg.svd(columns.reshape(-1, p), full_matrices=True)
    rank = int(np.count_nonzero(values > RANK * max(values.max(initial=0.0), UNIT_ROUNDOFF)))
    return np.asarray(rows[:rank].T)


class _Equations(NamedTuple):
    """Equations of a group of test functions: matrix (w, n, p), right-hand side (w, n), and what their errors need."""

    A: Floats
    b: Floats
    x: Floats
    psi: Floats
    slope: Floats


def _equations(data: _Data, exponents: NDArray[np.int64], r: int) -> Iterator[_Equations]:
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
            fields = data.sign * _moved(data.algebra, x, _gradients(exponents, x))
            yield _Equations(np.tensordot(psi, fields, 1), -of_slope @ x, x, psi, of_slope)


class _Estimate(NamedTuple):
    """Coefficients y in the determined directions V of the complement, their covariance, and factors of the noise."""

    y: Floats
    V: Floats
    rest: Floats
    covariance: Floats
    noise: Floats
    radius: int

    def better_than(self, other: _Estimate) -> bool:
        """Whether more directions are determined, or as many with less uncertainty."""
        own, others = self.V.shape[1], other.V.shape[1]
        return own > others or (own == others and np.trace(self.covariance) < np.trace(other.covariance))


def _estimate(data: _Data, exponents: NDArray[np.int64], complement: Floats, r: int) -> _Estimate | None:
    """Solve the equations, weighted by the covariance of their errors at the solution, by iteration."""
    equations = [_in_basis(group, complement) for group in _equations(data, exponents, r)]
    count = sum(group.b.size for group in equations)
    if count < complement.shape[1] + 1:
        return None
    noise = _first_noise(data.x)
    y = np.zeros(complement.shape[1])
    V = np.eye(len(y))
    for iteration in range(ITERATIONS):
        H = _polynomial(exponents, complement @ y)
        whitened = [_whitened(data, group, H if iteration else None, noise) for group in equations]
        A, b = (np.concatenate(parts) for parts in zip(*whitened, strict=True))
        _, values, rows = np.linalg.svd(A, full_matrices=False)
        if not values.size or not values[0]:
            return None
        determined = values > RANK * values[0]
        V, rest = rows[determined].T, rows[~determined].T
        z, _, _, _ = np.linalg.lstsq(A @ V, b, rcond=None)
        freedom = max(1, count - V.shape[1])
        variance = float(np.sum((A @ V @ z - b) ** 2)) / freedom
        covariance = variance * (V / values[determined] ** 2) @ V.T
        before, y = y, V @ z
        accuracy = CONVERGED[0] * math.sqrt(np.diag(covariance).max()) + CONVERGED[1] * np.abs(y).max()
        if iteration and np.abs(y - before).max() <= accuracy:
            break
    return _Estimate(y, V, rest, covariance, noise * math.sqrt(variance), r)


def _in_basis(group: _Equations, complement: Floats) -> _Equations:
    """Return equations for the coefficients in a basis."""
    return group._replace(A=group.A @ complement)


def _whitened(data: _Data, group: _Equations, H: Polynomial | None, noise: Floats) -> tuple[Floats, Floats]:
    """Return matrix and right-hand side divided by a root of the covariance of their errors; without H of the latter.

    Samples x + e change the equations by sum_t (psi dF/dx + psi') e, with the field F of H.
    """
    w, n = group.b.shape
    by_sample = np.einsum("wt,il->witl", group.slope, np.eye(n))
    if H is not None:
        by_sample += np.einsum("wt,til->witl", group.psi, _field_derivatives(data, H, group.x))
    root = (by_sample * noise).reshape(w * n, -1)
    S = root @ root.T
    L = np.linalg.cholesky(S + 4 * w * n * UNIT_ROUNDOFF * np.trace(S) / (w * n) * np.eye(w * n))
    both = np.concatenate([group.A.reshape(w * n, -1), group.b.reshape(-1, 1)], axis=1)
    solved = np.linalg.solve(L, both)
    return solved[:, :-1], solved[:, -1]


def _field_derivatives(data: _Data, H: Polynomial, x: Floats) -> Floats:
    """Return dF/dx (k, n, n) of F = sign J(x) grad H(x) at states (k, n)."""
    hessian = np.stack([H.derivative(j).gradient(x) for j in range(x.shape[1])], axis=1)
    gradient, out = H.gradient(x), _moved(data.algebra, x, hessian)
    for i, j, k, c in zip(*(column.tolist() for column in data.algebra.triples), strict=True):
        out[:, i, k] += c * gradient[:, j]
        out[:, j, k] -= c * gradient[:, i]
    return np.asarray(data.sign * out)


def _first_noise(x: Floats) -> Floats:
    """Return estimates of the noise (n,) by high differences of the samples, which are small for smooth motions."""
    weights = np.array([math.comb(DIFFERENCES, k) for k in range(DIFFERENCES + 1)], dtype=np.float64)
    noise = np.sqrt(np.mean(np.diff(x, DIFFERENCES, axis=1) ** 2, axis=(0, 1)) / np.sum(weights**2))
    return np.asarray(np.maximum(noise, max(LEAST_NOISE * noise.max(), UNIT_ROUNDOFF)))


def _polynomial(exponents: NDArray[np.int64], coefficients: Floats) -> Polynomial:
    """Return the polynomial with these coefficients."""
    return Polynomial(
        dict(zip(map(tuple, exponents.tolist()), coefficients.tolist(), strict=True)), dim=exponents.shape[1]
    )


def _result(data: _Data, exponents: NDArray[np.int64], complement: Floats, best: _Estimate) -> Identification:
    """Return the result in the units of the data, with a run of the system."""
    # H(x) = scale h(x / scale) moves the scaled states as h does: x' = J(x) grad H.
    units = data.scale ** (1.0 - exponents.sum(axis=1))
    listed = tuple(map(tuple, exponents.tolist()))
    coefficients = units * (complement @ best.y)
    H = _polynomial(exponents, coefficients)
    root = units[:, None] * complement
    system = LiePoissonSystem(data.algebra, H, sign=data.sign, name=f"identified system on {data.algebra.name or 'g'}")
    found = Identification(
        hamiltonian=H,
        system=system,
        exponents=listed,
        covariance=np.asarray(root @ best.covariance @ root.T),
        noise=data.scale * best.noise,
        undetermined=tuple(_polynomial(exponents, root @ direction) for direction in best.rest.T),
        radius=best.radius,
        solution=None,
        run_error=math.inf,
        basis=np.asarray(root @ best.V),
    )
    times, states = data.given
    step = abs(float(times[-1] - times[0])) / (len(times) - 1)
    try:
        span = (float(times[0]), float(times[0]) + math.copysign(step * (len(times) - 1), times[-1] - times[0]))
        run = integrate(system, states[0], span, step / 2, GaussLegendre(4), save_every=2)
    except IntegrationError:
        return found
    error = float(np.sqrt(np.mean((run.x - states) ** 2) / np.mean(states**2)))
    return replace(found, solution=run, run_error=error)

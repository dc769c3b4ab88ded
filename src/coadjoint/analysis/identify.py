"""Polynomial Hamiltonians from measured trajectories, by the weak form of the equations of motion."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.algebra.polynomials.monomials import exponents_of_degree
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.analysis.standard_errors import student_factor
from coadjoint.errors import IntegrationError
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.long_operations import long_operation, note_progress
from coadjoint.memory import check_available_memory
from coadjoint.methods.registry import reference_scheme
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.runs.integrate import integrate
from coadjoint.runs.results.solution import Solution
from coadjoint.short_repr import distinct, short
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.system_checks import read_sign
from coadjoint.validation import are_finite, read_integer, read_numbers

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


RADII = (8, 12, 16, 24, 32, 48, 64, 96, 128)
"""Half lengths of test functions in samples, of which the one with the least uncertainty is chosen."""
ENOUGH_FREEDOM = 16
"""Degrees of freedom with which estimated variances are compared; of fewer, the smallest one is so by chance."""
HIDDEN = 0.1
"""Noise in the coefficients of the equations, relative to them, with which a direction is undetermined."""
ITERATIONS = 20  # of weights and noise, which settle in some five
CONVERGED = (1e-3, 1e-13)
"""Changes of coefficients, relative to their largest standard deviation and size, that end the iteration."""


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
        Of the coefficients, for independent normal errors of the samples; singular in the directions of Casimirs. Since
        the noise is found from the data, it has the square of Student's factor for the degrees of freedom, with which
        two standard deviations hold 95 of 100 cases.
    noise : ndarray, shape (n,)
        Standard deviations of the errors of the samples, as found from the data.
    undetermined : tuple of Polynomial
        Combinations of monomials, no Casimirs, that the trajectories do not determine, or that are hidden by noise in
        the states: H has no part along them.
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
        """Return coefficients (p,) of H modulo Casimirs, constants and `undetermined`, comparable by `covariance`."""
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
            f"<identified Hamiltonian of degree {self.hamiltonian.degree}: {len(self.exponents)} monomials{missing}, "
            f"noise {self.noise.max():.2g}, error of a run {self.run_error:.2g}>"
        )


@suggest_keywords
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
    H is determined up to Casimirs and constants, which move nothing. Trajectories on one orbit, a part of it, or at
    rest, may leave more undetermined. Errors of the samples are treated to first order: noise of a few percent is the
    limit.

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
    data = TrajectorySamples.of(algebra, t, x, read_sign(sign))
    exponents = exponents_of(algebra.dim, read_integer(degree, "degree", 1))
    longest = (data.x.shape[1] - 1) // 2
    if radius is not None:
        radii: tuple[int, ...] = (read_integer(radius, "radius", MIN_RADIUS, longest),)
    else:
        radii = tuple(r for r in RADII if r <= longest)
    complement = complement_of_casimirs(algebra, exponents)
    best, certainty = None, (-1, 0, -math.inf)
    for k, r in enumerate(radii):
        estimate = _estimate(data, exponents, complement, r)
        # More directions are determined, or as many with enough degrees of freedom, or with less uncertainty.
        if estimate is not None and (best is None or estimate[1] > certainty):
            best, certainty = estimate
        note_progress("estimates with longer test functions", (k + 1) / len(radii))
    if best is None:
        raise ValueError(
            f"{data.x.shape[0]} trajectories of {data.x.shape[1]} samples give fewer equations than there are unknowns "
            f"({complement.shape[1]}), or do not move; give more samples, or a lower degree"
        )
    return _with_run(best, data)


def _estimate(
    data: TrajectorySamples, exponents: NDArray[np.int64], complement: Floats, r: int
) -> tuple[Identification, tuple[int, int, float]] | None:
    """Solve the equations by iteration, weighted by the covariance of their errors at the solution.

    Return the result without a run, and (determined directions, degrees of freedom up to `ENOUGH_FREEDOM`, -variance).
    """
    noise, unknowns = first_noise(data.x), complement.shape[1]
    # Equations of samples with twice the variance show how much of the matrix is noise.
    drawn = data._replace(x=data.x + noise * np.random.default_rng(0).standard_normal(data.x.shape))
    equations = [
        (np.concatenate([A, noisy - A], axis=2) @ np.kron(np.eye(2), complement), b, by_samples)
        for (A, b, by_samples), (noisy, _, _) in zip(
            equations_of(data, exponents, r), equations_of(drawn, exponents, r), strict=True
        )
    ]
    count = sum(b.size for _, b, _ in equations)
    if count < unknowns + 1:
        return None
    y, variance = np.zeros(unknowns), 1.0
    V = np.eye(len(y))
    for iteration in range(ITERATIONS):
        H = polynomial_of(exponents, complement @ y)
        whitened = [
            whitened_equations(A, b, by_samples(H if iteration else None), noise) for A, b, by_samples in equations
        ]
        both, b = (np.concatenate(parts) for parts in zip(*whitened, strict=True))
        A, of_noise = both[:, :unknowns], both[:, unknowns:]
        _, values, rows = np.linalg.svd(A, full_matrices=False)
        if not values.size or not values[0]:
            return None
        hidden = np.linalg.norm(of_noise @ rows.T, axis=0) * math.sqrt(variance)
        determined = (values > RANK * values[0]) & (HIDDEN * values > hidden)
        if not determined.any():
            return None
        V, rest = rows[determined].T, rows[~determined].T
        z, _, _, _ = np.linalg.lstsq(A @ V, b, rcond=None)
        freedom = max(1, count - V.shape[1])
        variance = float(np.sum((A @ V @ z - b) ** 2)) / freedom
        covariance = variance * student_factor(freedom) ** 2 * (V / values[determined] ** 2) @ V.T
        before, y = y, V @ z
        accuracy = CONVERGED[0] * math.sqrt(np.diag(covariance).max()) + CONVERGED[1] * np.abs(y).max()
        if iteration and np.abs(y - before).max() <= accuracy:
            break
    # In the units of the data: H(x) = scale h(x / scale) moves the scaled states as h does, x' = J(x) grad H.
    units = data.scale ** (1.0 - exponents.sum(axis=1))
    H = polynomial_of(exponents, units * (complement @ y))
    root = units[:, None] * complement
    system = LiePoissonSystem(data.algebra, H, sign=data.sign, name=f"identified system on {data.algebra.name or 'g'}")
    found = Identification(
        hamiltonian=H,
        system=system,
        exponents=tuple(map(tuple, exponents.tolist())),
        covariance=np.asarray(root @ covariance @ root.T),
        noise=data.scale * (noise * math.sqrt(variance)),
        undetermined=tuple(polynomial_of(exponents, root @ direction) for direction in rest.T),
        radius=r,
        solution=None,
        run_error=math.inf,
        basis=np.asarray(root @ V),
    )
    return found, (V.shape[1], min(freedom, ENOUGH_FREEDOM), -float(np.trace(covariance)))


def _with_run(found: Identification, data: TrajectorySamples) -> Identification:
    """Return the result with a run of its system from the first samples, if that does not fail."""
    times, states = data.given
    step = abs(float(times[-1] - times[0])) / (len(times) - 1)
    try:
        span = (float(times[0]), float(times[0]) + math.copysign(step * (len(times) - 1), times[-1] - times[0]))
        run = integrate(found.system, states[0], span, step / 2, reference_scheme(8), save_every=2)
    except IntegrationError:
        return found
    error = float(np.sqrt(np.mean((run.x - states) ** 2) / np.mean(states**2)))
    return replace(found, solution=run, run_error=error)

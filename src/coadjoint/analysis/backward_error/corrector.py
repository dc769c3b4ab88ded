"""Poisson correctors: coordinate changes of the output that reduce the energy error of a splitting."""

from __future__ import annotations

from collections.abc import Mapping
from math import ceil, comb
from typing import Any, cast

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.polynomials.exact_polynomials import ExactPolynomials
from coadjoint.algebra.polynomials.monomials import exponents_of_degree
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.analysis.backward_error.modified_hamiltonian import (
    ModifiedHamiltonian,
    check_system_and_scheme,
    modified_hamiltonian,
)
from coadjoint.errors import IntegrationError
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.memory import check_available_memory
from coadjoint.methods.numerics.short_orbit import MIN_STEPS, RELATIVE_STEP, orbit_overflow_error, rate_at
from coadjoint.methods.protocol.method import Method
from coadjoint.methods.registry import reference_scheme
from coadjoint.runs.integrate import integrate
from coadjoint.runs.start import momenta_of
from coadjoint.systems.coordinates import in_coordinates_of
from coadjoint.systems.hamiltonians.sum_of_hamiltonians import polynomial_of
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.validation import check_power, read_finite, read_number

Floats = npt.NDArray[np.float64]

MAX_MONOMIALS = 1500  # unknowns of a dense least squares problem; some seconds
POINTS_PER_MONOMIAL = 4  # points of the motion for each monomial that is fitted
# The least-squares fit drops singular directions, by increasing cutoffs, until the corrector moves states by at most
# this multiple of the motion of the error term over one radian.
MAX_DISPLACEMENT = 4.0
CUTOFFS = tuple(10.0**-k for k in range(10, 0, -1))
# A step of the corrector's flow moves states by at most this part of their size, so that its iteration finds the way
# back; the displacement of a useful corrector takes few such steps.
LARGEST_MOVE, MOST_STEPS = 0.5, 1024


class Corrector:
    """A map from computed states to more accurate ones, the flow of h^p G; `make_corrector` creates it.

    A step of a kernel K of order p is the flow of H + h^p H_p + .... With this map P, the step P K P^-1 is the flow of
    H + h^p (H_p + sign {G, H}) + .... G minimizes the variation of the second term along the motion. The kernel runs
    unchanged; P is applied to the output only.

    Attributes
    ----------
    generator : Polynomial
        G.
    order : int
        The order p of the kernel.
    remaining : float
        Largest change of H_p + sign {G, H} along the motion, divided by that of H_p. For small h it is the ratio of the
        energy error of the output to that of the kernel. If it is zero up to round-off, the energy error of the output
        falls as h^(p + 2).

    Examples
    --------
    >>> import coadjoint as co
    >>> body, x0, h = co.systems.rigid_body(inertia=(1, 2, 3)), (1.0, 0.2, 0.5), 0.05
    >>> better = co.make_corrector(body, co.Splitting(), x0)
    >>> run = co.integrate(body, better.inverse(x0, h), (0, 100), h, co.Splitting())
    >>> output = better(run.x, h)
    >>> spread = [max(abs(e - e[0])) for e in (run.energy, np.array([body.energy(x) for x in output]))]
    >>> bool(spread[1] < 0.2 * spread[0])
    True
    """

    _speed = 0.0  # of the flow, relative to the size of states

    def __init__(self, system: LiePoissonSystem, generator: Polynomial, order: int, remaining: float) -> None:
        self.generator, self.order, self.remaining = in_coordinates_of(system, generator), order, remaining
        self._flow = LiePoissonSystem(
            system.algebra, generator, sign=system.sign, name=f"the corrector of {system.name}"
        )

    def __repr__(self) -> str:
        return f"Corrector(order={self.order}, remaining={self.remaining:.2g})"

    def __call__(self, x: npt.ArrayLike, h: float) -> Floats:
        """Map states of the kernel to output.

        Parameters
        ----------
        x : array_like, shape (..., n)
            States of the kernel.
        h : float
            The step of the kernel, negative for backward.

        Returns
        -------
        ndarray, shape (..., n)
        """
        return self._apply_flow(x, h, 1.0)

    def inverse(self, x: npt.ArrayLike, h: float) -> Floats:
        """Return the initial state of the kernel for a given initial output; parameters as for a call."""
        return self._apply_flow(x, h, -1.0)

    def _apply_flow(self, x: npt.ArrayLike, h: float, direction: float) -> Floats:
        states, n = read_finite(x, "x"), self._flow.dim
        if states.ndim == 0 or states.shape[-1] != n:
            raise ValueError(f"x has the shape {states.shape}; its last axis must have {n} coordinates")
        step = read_number(h, "h")
        check_power(step, self.order, "h")
        duration = direction * step**self.order
        if duration == 0.0 or states.size == 0 or not self.generator.monomials:
            return states
        rows = states.reshape(-1, n)
        # One step of order four over h^p has an error far below the next term, h^(p + 2).
        steps = min(max(1, ceil(abs(duration) * self._speed / LARGEST_MOVE)), MOST_STEPS)
        run = integrate(self._flow, rows, (0.0, duration), abs(duration) / steps, reference_scheme(4), watch=False)
        return np.asarray(run.x[-1]).reshape(states.shape)


@suggest_keywords
def make_corrector(system: LiePoissonSystem, method: Method | str | Mapping[str, Any], x0: npt.ArrayLike) -> Corrector:
    """Return a map of the output that reduces the energy error of a splitting near a motion.

    The scheme remains unchanged: the processing map comes from the modified Hamiltonian of the given system. Choose it
    to compare energies or other smooth functions of the output at a step that is not small. It does not reduce the
    phase errors of long runs, which remain those of the kernel.

    Parameters
    ----------
    system : LiePoissonSystem
        With a polynomial Hamiltonian that does not depend on time.
    method : Method, str or mapping
        The kernel: a splitting or a composition of splittings, or its name as in `integrate`.
    x0 : array_like, shape (n,) or (k, n)
        The initial state, or a sample of states, to whose motions G is fitted.

    Returns
    -------
    Corrector
        Its generator G is fitted to the motions by least squares, among all polynomials up to degree
        deg H_p - deg H + 1.

    Raises
    ------
    TypeError, ValueError
        The scheme has no modified Hamiltonian on this system (see `modified_hamiltonian`); there are too many monomials
        of that degree; or a motion overflows.

    References
    ----------
    S. Blanes, F. Casas and A. Murua, Composition methods for differential equations with processing, SIAM J. Sci.
    Comput. 27 (2006), for correctors of compositions.
    """
    system, scheme = check_system_and_scheme(system, method)
    modified, H = modified_hamiltonian(system, scheme, scheme.order), polynomial_of(system.hamiltonian)
    if H is None:
        raise ValueError(f"the Hamiltonian of {system.name} is not a polynomial; correctors need a polynomial one")
    term = cast(Polynomial, cast(ModifiedHamiltonian, modified).error_term.term)
    starts, _ = momenta_of(system, x0)
    basis = _monomials(system.dim, max(term.degree - H.degree + 1, 1))
    count = max(POINTS_PER_MONOMIAL * len(basis) // len(starts), 64)
    check_available_memory(
        8 * 3 * len(basis) * count * len(starts), f"{len(basis)} monomials at {count * len(starts)} states"
    )
    motions, rates = zip(*(short_motion(system, start, count) for start in starts), strict=True)
    ring = ExactPolynomials(system.algebra)
    energy = ring.from_polynomial(H)
    brackets = [ring.polynomial(ring.bracket(ring.from_polynomial(monomial), energy)) for monomial in basis]
    columns = np.concatenate([_deviations(brackets, points) for points in motions])
    target = np.concatenate([_deviations([term], points)[:, 0] for points in motions])
    size = float(np.max(np.abs(target), initial=0.0))
    if size == 0.0:
        return Corrector(system, Polynomial({}, dim=system.dim), scheme.order, 0.0)
    points = np.concatenate(motions)
    bound = MAX_DISPLACEMENT * _largest_speed(system, term, points) / min(rates)
    U, singular, V = np.linalg.svd(columns, full_matrices=False)
    for cutoff in CUTOFFS:
        used = singular > cutoff * singular[0]
        factors = -system.sign * (V[used].T @ ((U[:, used].T @ target) / singular[used]))
        coefficients = {next(iter(F.monomials)): float(c) for F, c in zip(basis, factors, strict=True)}
        generator = Polynomial(coefficients, dim=system.dim)
        speed = _largest_speed(system, generator, points)
        if speed <= bound:
            break
    remaining = float(np.max(np.abs(target + system.sign * (columns @ factors)))) / size
    corrector = Corrector(system, generator, scheme.order, remaining)
    corrector._speed = speed / float(np.linalg.norm(points, axis=1).max())
    return corrector


def short_motion(system: LiePoissonSystem, start: Floats, count: int) -> tuple[Floats, float]:
    """Return states (count + 1, n) a quarter of a radian apart, fewer if the motion overflows, and its rate."""
    rate = rate_at(system, start)
    spacing = RELATIVE_STEP / rate
    try:
        states = integrate(system, start, (0.0, count * spacing), spacing, reference_scheme(6), watch=False).x
    except IntegrationError as error:
        if error.partial is None or len(error.partial.x) <= MIN_STEPS:
            raise orbit_overflow_error(start, spacing) from None
        states = error.partial.x
    return np.asarray(states), rate


def _largest_speed(system: LiePoissonSystem, function: Polynomial, points: Floats) -> float:
    """Return the largest speed of the flow of a function at some states."""
    slopes = np.asarray(function.gradient(points))
    return max(
        float(np.linalg.norm(system.algebra.structure_matrix(x) @ u)) for x, u in zip(points, slopes, strict=True)
    )


def _monomials(n: int, degree: int) -> list[Polynomial]:
    """Return all monomials of degree 1 to `degree` in n coordinates."""
    total = comb(n + degree, n) - 1
    if total > MAX_MONOMIALS:
        raise ValueError(
            f"a corrector in {n} coordinates would need {total} monomials of degree up to {degree}; at most "
            f"{MAX_MONOMIALS} are supported; use a scheme of lower order, or a processed one"
        )
    return [Polynomial({e: 1}) for size in range(1, degree + 1) for e in exponents_of_degree(n, size)]


def _deviations(functions: list[Polynomial], points: Floats) -> Any:
    """Return the values of functions at points of a motion minus their means, shape (k, functions)."""
    values = np.stack([np.asarray(f(points)) for f in functions], axis=1)
    return values - values.mean(axis=0)

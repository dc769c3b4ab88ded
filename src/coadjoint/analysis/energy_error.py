"""Energy errors of schemes: the step for a bound, and Poisson correctors, which reduce them in the output."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import pairwise
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
from coadjoint.long_operations import long_operation, note_progress
from coadjoint.methods.numerics.tuned_parts import MIN_STEPS, RELATIVE_STEP, orbit_overflow_error, rate_at
from coadjoint.methods.protocol.method import Method, declared_properties
from coadjoint.methods.registry import reference_scheme
from coadjoint.runs.integrate import integrate
from coadjoint.runs.measured_steps import trial_run
from coadjoint.runs.prepared_run import PreparedRun
from coadjoint.runs.start import momenta_of
from coadjoint.runs.times import Times
from coadjoint.systems.coordinates import in_coordinates_of
from coadjoint.systems.hamiltonians.sum_of_hamiltonians import polynomial_of
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.validation import check_power, read_finite, read_number, read_positive

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

# Radians of a trial run, and its least number of steps: those of whole radians are too few to find the largest change.
RADIANS, STEPS = 128.0, 512
# Steps of the run that comes first, in which a step that is much too large is recognized.
FIRST_STEPS = 8
# Smallest trial step, in units of the time of one radian; changes of smaller steps follow from the order.
SHORTEST = 2.0**-7
# Most trial runs until the bound is met, and between two steps; the change that suffices, relative to the bound.
MAX_REDUCTIONS, TRIALS, SUFFICIENT = 16, 12, 0.99
# Largest difference of the observed order from that of the scheme at which changes of smaller steps follow from it.
ORDER_TOLERANCE = 0.1


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
        steps = min(max(1, math.ceil(abs(duration) * self._speed / LARGEST_MOVE)), MOST_STEPS)
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
    slopes = np.asarray(function.gradient(points))
    return max(
        float(np.linalg.norm(system.algebra.structure_matrix(x) @ u)) for x, u in zip(points, slopes, strict=True)
    )


def _monomials(n: int, degree: int) -> list[Polynomial]:
    total = math.comb(n + degree, n) - 1
    if total > MAX_MONOMIALS:
        raise ValueError(
            f"a corrector in {n} coordinates would need {total} monomials of degree up to {degree}; at most "
            f"{MAX_MONOMIALS} are supported; use a scheme of lower order, or a processed one"
        )
    return [Polynomial({e: 1}) for size in range(1, degree + 1) for e in exponents_of_degree(n, size)]


def _deviations(functions: list[Polynomial], points: Floats) -> Any:
    values = np.stack([np.asarray(f(points)) for f in functions], axis=1)
    return values - values.mean(axis=0)


@suggest_keywords
@long_operation("suggest_step")
def suggest_step(
    system: LiePoissonSystem, method: Method | str | Mapping[str, Any], x0: npt.ArrayLike, energy: float
) -> float:
    """Estimate the largest step at which the energy changes by at most a given amount, from short runs.

    A run by a Poisson map preserves H + h^p H_p + ... but for terms that are small for small steps, so its energy
    varies about as h^p H_p does along the motion. Measured is the time in which the motion turns by one radian; a
    longer run may exceed the amount, above all near the largest step. Choose it to control the energy error. `choose`
    selects scheme and step for an error of the momentum over a span.

    Parameters
    ----------
    system : LiePoissonSystem
        With a Hamiltonian that does not depend on time and has second derivatives.
    method : Method, str or mapping
        A scheme that preserves the bracket or the energy, or its name as in `integrate`.
    x0 : array_like, shape (n,) or (k, n)
        The initial state, or a sample of states, for which the smallest step is returned.
    energy : float
        The largest accepted change of the energy, in units of H.

    Returns
    -------
    float
        A positive step, from runs over 128 radians of the motion or 512 steps. It is at most the time in which the
        motion turns by one radian; if it is smaller, the energy usually changes by 99 to 100 per cent of the bound.
        Steps below 1/128 of that time follow from the order of the scheme.

    Raises
    ------
    TypeError, ValueError
        The scheme preserves neither bracket nor energy on this system, or the energy depends on time.

    Examples
    --------
    >>> import coadjoint as co
    >>> body, x0 = co.systems.rigid_body(inertia=(1, 2, 3)), (1.0, 0.2, 0.5)
    >>> h = suggest_step(body, co.Splitting(), x0, energy=1e-5)
    >>> run = co.integrate(body, x0, (0, 1000 * h), h, co.Splitting())
    >>> 0.9e-5 < run.drift()["energy"].absolute < 1.1e-5
    True
    """
    system, scheme = check_system_and_scheme(system, method, "suggest_step")
    if system.hamiltonian.timed:
        raise ValueError(f"the energy of {system.name} depends on time; `choose` selects a step by the error of x")
    declared = declared_properties(scheme, system)
    if not (declared.poisson or declared.energy):
        raise ValueError(
            f"{scheme} preserves neither the bracket nor the energy of {system.name}, so that the energy error grows "
            "with the length of the run; take Splitting, or select a step by `choose`"
        )
    bound = read_positive(energy, "energy")
    points, _ = momenta_of(system, x0)
    return min(_largest_step(system, scheme, start, bound) for start in points)


def _largest_step(system: LiePoissonSystem, method: Method, start: Floats, bound: float) -> float:
    rate, order = rate_at(system, start), method.order
    target, shortest = 0.5 * (1.0 + SUFFICIENT) * bound, SHORTEST / rate
    prepared = PreparedRun(system, method, 1.0 / rate, threads=1)

    def change_in(h: float, count: int) -> float:
        run = trial_run(prepared, Times(0.0, h, count, count), start[None])
        largest = float(np.max(run.state["worst"][:, :, 0]))
        return largest if math.isfinite(largest) and not run.state["status"].any() else math.inf

    def change(h: float) -> float:
        note_progress(f"the change of the energy at the step {h:.3g}")
        # Steps near the smallest one are tried in full, since those below are extrapolated from them.
        if h > 2.0 * shortest and change_in(h, FIRST_STEPS) > 2.0**order * bound:
            return math.inf
        return change_in(h, max(STEPS, math.ceil(RADIANS / (h * rate))))

    steps, changes = [1.0 / rate], [change(1.0 / rate)]
    while changes[-1] > bound:
        if steps[-1] <= shortest or len(steps) == MAX_REDUCTIONS:
            return _extrapolated(steps, changes, bound, order)
        steps.append(max(shortest, _smaller_step(steps, changes, target, order)))
        changes.append(change(steps[-1]))
    if len(changes) == 1:
        return steps[0]
    (high, low), (above, below) = steps[-2:], changes[-2:]
    for _ in range(TRIALS):
        if below >= SUFFICIENT * bound or low >= SUFFICIENT * high or not 0.0 < below < above:
            break
        # Between a step and one at which the change is unknown, it follows from the order.
        power = math.log(high / low) / math.log(above / below) if above < math.inf else 1.0 / order
        h = min(low * (target / below) ** power, math.sqrt(low * high) if above == math.inf else high)
        found = change(h)
        if found <= bound:
            low, below = h, found
        else:
            high, above = h, found
    return low


def _smaller_step(steps: list[float], changes: list[float], target: float, order: int) -> float:
    """Return the next trial step: that of the order, or half of the last unless its change follows the order."""
    by_order = steps[-1] * (target / changes[-1]) ** (1.0 / order)
    if len(steps) > 1 and abs(_observed_order(steps, changes, len(steps) - 1) - order) <= ORDER_TOLERANCE:
        return by_order
    return max(by_order, 0.5 * steps[-1])


def _observed_order(steps: list[float], changes: list[float], k: int) -> float:
    """Return the power of the step by which the change of a trial run differs from the previous one."""
    if not 0.0 < changes[k] < math.inf or not 0.0 < changes[k - 1] < math.inf:
        return math.inf
    return math.log(changes[k - 1] / changes[k]) / math.log(steps[k - 1] / steps[k])


def _extrapolated(steps: list[float], changes: list[float], bound: float, order: int) -> float:
    """Return the step for a bound below all changes, from the one near which they follow the order best."""
    # A correction that is linear in h changes from h' to h by h' / h - 1 times its value at h.
    deviations = [math.inf] + [
        abs(_observed_order(steps, changes, k) - order) * math.log(ratio) / (ratio - 1.0)
        for k, ratio in enumerate((a / b for a, b in pairwise(steps)), 1)
    ]
    k = int(np.argmin(deviations))
    if not math.isfinite(deviations[k]):
        raise ValueError("the motion from x0 cannot be followed at any step; take another state")
    return steps[k] * (bound / changes[k]) ** (1.0 / order)

"""Defects of structure: of the Poisson bracket in a step, and by round-off in ensembles (Brouwer's law)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coadjoint.algebra.invariants.invariant import Invariant
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.runs.integrate import integrate
from coadjoint.runs.results.solution import check_solution
from coadjoint.runs.start import momenta_of
from coadjoint.runs.stepper import Stepper
from coadjoint.short_repr import short
from coadjoint.systems.evaluation import ignore_overflow
from coadjoint.validation import read_finite, read_integer


class PoissonDefect(NamedTuple):
    """Distance of a map from a Poisson map at a point.

    Parameters
    ----------
    defect : float
        Frobenius norm of P J(x) P^T - J(step(x)).
    bound : float
        Bound on the effect of round-off: 64 u times the number of operations times ``|P|^2 |J(x)|``.
    """

    defect: float
    bound: float

    @property
    def poisson(self) -> bool:
        """Whether the defect is within the bound on round-off."""
        return self.defect <= self.bound


@suggest_keywords
def defect_of_tangent(P: ArrayLike, before: ArrayLike, after: ArrayLike, *, operations: int) -> PoissonDefect:
    """Return the Poisson defect of a map from its tangent.

    Parameters
    ----------
    P : array_like, shape (n, n)
        Derivative of the map at x.
    before, after : array_like, shape (n, n)
        J(x), and J at the image of x.
    operations : int
        Number of roundings in an entry of P.

    Returns
    -------
    PoissonDefect

    Notes
    -----
    The paper (section 2) prints the transpose on the other side, ``P^T J P``, which the exact motion does not satisfy.

    Examples
    --------
    >>> J = np.array([[0.0, 1.0], [-1.0, 0.0]])
    >>> defect_of_tangent([[2.0, 0.0], [0.0, 0.5]], J, J, operations=1).poisson
    True
    """
    tangent, J, image = read_finite(P, "P"), read_finite(before, "before"), read_finite(after, "after")
    operations = read_integer(operations, "operations", 0, 2**53)
    if tangent.ndim != 2 or not tangent.shape == J.shape == image.shape or tangent.shape[0] != tangent.shape[1]:
        raise ValueError(
            f"P, before and after have the shapes {tangent.shape}, {J.shape} and {image.shape}; they must all be (n, n)"
        )
    defect = float(np.linalg.norm(tangent @ J @ tangent.T - image))
    size = float(np.linalg.norm(tangent) ** 2 * np.linalg.norm(J))
    return PoissonDefect(defect, 64 * UNIT_ROUNDOFF * operations * size)


@suggest_keywords
def poisson_defect(step: Stepper, x: ArrayLike, operations: int | None = None) -> PoissonDefect:
    """Return the Poisson defect of one step of a scheme at x.

    Parameters
    ----------
    step : Stepper
        From `coadjoint.stepper`; its tangent is exact, so the defect is not masked by finite differences.
    x : array_like, shape (n,)
        The state.
    operations : int, optional
        Number of roundings in an entry of the tangent. None is n for each elementary flow (or evaluation of the vector
        field) of a step, and 4 n for the products in the defect.

    Returns
    -------
    PoissonDefect

    Examples
    --------
    >>> import coadjoint as co
    >>> body = co.systems.rigid_body(inertia=(1, 2, 3))
    >>> poisson_defect(co.stepper(body, co.Splitting(order=2), 0.1), [1.0, 0.2, 0.5]).poisson
    True
    >>> poisson_defect(co.stepper(body, co.GaussLegendre(1), 0.1), [1.0, 0.2, 0.5]).poisson
    False
    """
    if not isinstance(step, Stepper):
        raise TypeError(f"step is {short(step)}; it must be a Stepper, from co.stepper(system, method, h)")
    momenta, single = momenta_of(step.system, x)
    if not single:
        raise ValueError(f"x has the shape {np.shape(x)}; give one state")
    y = momenta[0]
    if step.system.shape != y.shape:
        step = Stepper(step.system.in_numbers, step.method, step.h)
    if operations is None:
        ends = (0.0, step.h)
        run = integrate(step.system, y, ends, abs(step.h), step.method, watch=False)
        operations = (run.stats.evaluations + 4) * y.size
    before, after = step.system.structure_matrix(y), step.system.structure_matrix(step(y))
    return defect_of_tangent(step.tangent(y), before, after, operations=operations)


@suggest_keywords
@dataclass(frozen=True)
class RandomWalk:
    """Growth of the deviations of an ensemble between an early and a late time.

    Attributes
    ----------
    early, late : float
        Root mean square deviation over the members, relative to the size of the invariant.
    worst : float
        The largest late deviation of any member.
    bias : float
        The mean late deviation in standard errors of that mean, as the normal deviate of the same probability as its
        Student's t: within 3 for unbiased rounding, for any number of members. NaN without a scatter of members.
    """

    early: float
    late: float
    worst: float
    bias: float

    @property
    def growth(self) -> float:
        """The ratio of late to early deviation; over 100 times the time, 10 for a random walk and 100 for a bias."""
        return self.late / self.early if self.early else np.inf


@suggest_keywords
@ignore_overflow
def random_walk(deviations: NDArray[np.float64], early: int) -> RandomWalk:
    """Return the growth of deviations of an ensemble.

    Parameters
    ----------
    deviations : ndarray, shape (k, members) or (k, members, ...)
        Relative deviations at the saved times; entries of further axes count as members in the root mean squares, and
        are averaged for the bias.
    early : int
        Index of the saved point compared with the last one.

    Returns
    -------
    RandomWalk
        Root mean squares, growth and bias.

    Examples
    --------
    >>> steps = np.random.default_rng(1).choice([-1.0, 1.0], (10000, 64))
    >>> walk = random_walk(np.cumsum(steps, axis=0), 100)
    >>> bool(5 < walk.growth < 20 and abs(walk.bias) < 3)
    True
    """
    deviations = read_finite(deviations, "deviations")
    if deviations.ndim < 2 or 0 in deviations.shape:
        raise ValueError(f"deviations has the shape {deviations.shape}; it must be (k, members) or (k, members, ...)")
    early = read_integer(early, "early", 0, len(deviations) - 1)
    last = deviations[-1]
    means = last.reshape(len(last), -1).mean(axis=1)
    return RandomWalk(
        early=float(np.sqrt(np.mean(deviations[early] ** 2))),
        late=float(np.sqrt(np.mean(last**2))),
        worst=float(np.max(np.abs(last))),
        bias=_normal_score(means),
    )


def _normal_score(values: NDArray[np.float64]) -> float:
    """Return the normal deviate of the probability of Student's t of values, for the mean zero."""
    from scipy.special import ndtri, stdtr

    mean, freedom = float(np.mean(values)), len(values) - 1
    spread = float(np.std(values, ddof=1)) / np.sqrt(len(values)) if freedom else 0.0
    if not spread:
        return float("nan") if mean or not freedom else 0.0
    return float(np.copysign(ndtri(stdtr(freedom, -abs(mean) / spread)), mean))


@suggest_keywords
def round_off(solution: Any, early: int = 1) -> dict[str, RandomWalk]:
    """Return the growth of the round-off in energy and Casimirs of an ensemble.

    Brouwer's law: under unbiased rounding an invariant deviates as the square root of time, under biased rounding it
    drifts linearly. Choose it to decide which of the two applies to a scheme; for the deviations of a single trajectory
    use `drift`.

    Parameters
    ----------
    solution : Solution
        A run of an ensemble, with at least three saved points.
    early : int
        Index of the saved point compared with the last one.

    Returns
    -------
    dict
        Name -> `RandomWalk`, relative to abs(gradient) abs(x) at the start, the effect of a relative change of x. An
        invariant given as a function is taken relative to its largest value.

    Raises
    ------
    ValueError
        The solution has a single trajectory.

    References
    ----------
    D. Brouwer, On the accumulation of errors in numerical integration, Astron. J. 46 (1937).

    Examples
    --------
    >>> import coadjoint as co
    >>> body = co.systems.rigid_body(inertia=(1, 2, 3))
    >>> x0 = np.random.default_rng(0).normal(size=(64, 3))
    >>> sol = co.integrate(body, x0, (0, 1000), 0.1, co.Splitting(compensated=True), save_every=100, watch=False)
    >>> round_off(sol)["|x|^2"].growth < 20
    True
    """
    _check_unforced(solution)
    if solution.energy.ndim == 1:
        raise ValueError(
            "round-off is measured over an ensemble, and the solution has one trajectory; give x0 of shape (members, n)"
        )
    systems = [solution.system.of_member(m) for m in range(len(solution.x[0]))]
    walks = {}
    for name, values in {"energy": solution.energy, **solution.casimirs}.items():
        size = np.max(np.abs(values), axis=0)
        invariants = [system.hamiltonian if name == "energy" else system.casimirs[name] for system in systems]
        if not any(isinstance(invariant, Invariant) for invariant in invariants):
            pairs = zip(invariants, solution.x[0], strict=True)
            size = np.array([np.linalg.norm(invariant.gradient(x)) * np.linalg.norm(x) for invariant, x in pairs])
        walks[name] = random_walk((values - values[0]) / size, early)
    return walks


def _check_unforced(solution: Any) -> None:
    check_solution(solution)
    if solution.work:
        raise TypeError(f"{solution.system.name} has forces, which change its invariants; see solution.balance()")


@suggest_keywords
def orthogonality(solution: Any, size: int | None = None) -> RandomWalk:
    """Return the growth of the orthogonality defect of the group elements, g g^T - 1 over all entries.

    Parameters
    ----------
    solution : Solution
        A run of an ensemble, with an attitude.
    size : int, optional
        Size of the leading block, for instance 3 for the rotation in a rigid motion. None is the complete matrix.

    Returns
    -------
    RandomWalk
        In absolute deviations.

    Examples
    --------
    >>> import coadjoint as co
    >>> body = co.systems.rigid_body(inertia=(1, 2, 3))
    >>> x0 = np.random.default_rng(0).normal(size=(64, 3))
    >>> orthogonality(co.integrate(body, x0, (0, 100), 0.1, save_every=10, attitude=True)).worst < 1e-14
    True
    """
    check_solution(solution)
    if solution.attitude is None or solution.attitude.ndim != 4:
        raise ValueError("the solution is not of an ensemble with an attitude; give x0 members, and attitude=True")
    if size is not None:
        size = read_integer(size, "size", 1, solution.attitude.shape[-1])
    g = solution.attitude[..., :size, :size]
    return random_walk(g @ np.swapaxes(g, -1, -2) - np.eye(g.shape[-1]), 1)


@suggest_keywords
def spatial_momentum(solution: Any) -> RandomWalk:
    """Return the growth of the deviation of the spatial momentum K x.

    Parameters
    ----------
    solution : Solution
        A run of an ensemble, with ``attitude="coadjoint"``.

    Returns
    -------
    RandomWalk
        Relative to abs(K) abs(x): on e(3) the translation grows with time, and its rounding with it.

    Examples
    --------
    >>> import coadjoint as co
    >>> body = co.systems.rigid_body(inertia=(1, 2, 3))
    >>> x0 = np.random.default_rng(0).normal(size=(64, 3))
    >>> spatial_momentum(co.integrate(body, x0, (0, 100), 0.1, save_every=10, attitude="coadjoint")).worst < 1e-14
    True
    """
    _check_unforced(solution)
    if solution.carried != "coadjoint" or solution.x.ndim != 3:
        raise ValueError(
            'the solution is not of an ensemble with the coadjoint matrix; give x0 members, and attitude="coadjoint"'
        )
    spatial = np.einsum("kmij,kmj->kmi", solution.attitude, solution.x)
    size = np.linalg.norm(solution.attitude, axis=(2, 3), ord=2) * np.linalg.norm(solution.x, axis=2)
    return random_walk((spatial - spatial[0]) / size[..., None], 1)

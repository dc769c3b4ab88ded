"""Equilibria on coadjoint orbits: relaxation, Newton's method on the orbit, frequencies, and stability."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coadjoint.algebra.constants import summands
from coadjoint.analysis.matrix_orbits import MatrixOrbits
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.long_operations import long_operation, note_progress
from coadjoint.memory import check_available_memory
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.runs.start import momenta_of
from coadjoint.short_repr import record_repr
from coadjoint.systems.coordinates import CoordinateGroups, has_skew_actions, independent_groups
from coadjoint.systems.evaluation import ignore_overflow, scatter
from coadjoint.systems.system_checks import check_one_system
from coadjoint.validation import read_choice

Floats = NDArray[np.float64]

RANK_TOLERANCE = 1e-10  # singular values of J(x) below this, relative to the largest, are zero
MAX_DEGREE = 40  # of the series of an exponential, whose substeps have norms of at most one
NEGLIGIBLE = 2.0**-60  # of the state: the series of an exponential ends there, below round-off


class TangentSpace(NamedTuple):
    """The tangent space of an orbit: P = sign J(x), an orthonormal basis (n, r), and its blocks on direct summands."""

    P: Floats
    basis: Floats
    blocks: list[tuple[NDArray[np.int64], slice]]

    def restricted(self, matrix: Floats, factor: Floats) -> Floats:
        """Return factor^T matrix factor, for a factor (n, r) with the blocks of the basis."""
        columns, result = np.empty_like(factor), np.empty((factor.shape[1],) * 2)
        for rows, places in self.blocks:
            columns[:, places] = matrix[:, rows] @ factor[rows, places]
        for rows, places in self.blocks:
            result[places] = factor[rows, places].T @ columns[rows]
        return result


class CoadjointOrbits:
    """The coadjoint orbits of a system in coordinates y = x / units: motion along them, derivatives of functions."""

    # Units are powers of two, so that scaling does not round.

    def __init__(self, system: Any, units: Floats) -> None:
        i, j, k, c = system.algebra.triples
        self.system, self.units, self.dim, self.sign = system, units, system.dim, float(system.sign)
        self._rows, self._factors, self._states = np.concatenate([i, j]), np.concatenate([j, i]), np.concatenate([k, k])
        constants = (c * (units[k] / units[i] / units[j])).astype(np.float64)
        self._constants = self.sign * np.concatenate([constants, -constants])

    def product(self, y: Floats, v: Floats) -> Floats:
        """Return D_v y = sign J(y) v."""
        return np.asarray(scatter(self._rows, self._constants * y[self._states] * v[self._factors], self.dim))

    def absolute_product(self, y: Floats, v: Floats) -> Floats:
        terms = np.abs(self._constants * y[self._states] * v[self._factors])
        return np.asarray(scatter(self._rows, terms, self.dim))

    def norm(self, v: Floats) -> float:
        """Return the largest row sum of the absolute entries of D_v."""
        return float(np.max(scatter(self._rows, np.abs(self._constants * v[self._factors]), self.dim), initial=0.0))

    def moved(self, y: Floats, v: Floats) -> Floats:
        substeps = max(1, int(np.ceil(self.norm(v))))
        for _ in range(substeps):
            term, change = y, np.zeros_like(y)
            for degree in range(1, MAX_DEGREE):
                term = self.product(term, v) / (degree * substeps)
                change = change + term
                if np.max(np.abs(term), initial=0.0) <= NEGLIGIBLE * np.max(np.abs(y), initial=0.0):
                    break
            y = y + change
        return y

    def sizes(self, y: Floats) -> tuple[float, float]:
        """Return the sizes of the state and of J(y)."""
        return float(np.max(np.abs(y))), float(np.max(self.absolute_product(y, np.ones(self.dim))))

    def field_scale(self, y: Floats) -> float:
        """Return the size of the terms of J(y) grad H(y), which cancel at an equilibrium."""
        slopes = np.abs(self.gradient(y)) + np.abs(self.hessian(y)) @ np.abs(y)
        return float(np.max(np.abs(y))) * self.norm(slopes)

    def energy(self, y: Floats) -> float:
        return float(self.system.energy(self.units * y))

    def gradient(self, y: Floats, function: Any = None) -> Floats:
        return self.units * np.asarray(self._derivative("gradient", y, function), dtype=np.float64)

    def hessian(self, y: Floats, function: Any = None) -> Floats:
        return self.units[:, None] * np.asarray(self._derivative("hessian", y, function), np.float64) * self.units

    def _derivative(self, name: str, y: Floats, function: Any) -> Any:
        if function is None:
            return getattr(self.system.hamiltonian, name)(self.units * y, 0.0)
        return getattr(function, name)(self.units * y)

    def small_motions(self, y: Floats, tangents: TangentSpace) -> Floats:
        """Return the linearized motion on the orbit, in the basis of the tangent space."""
        return tangents.restricted(self._map(self.system.jacobian(self.units * y)), tangents.basis)

    def integrals(self, y: Floats) -> list[tuple[Floats, Any]]:
        """Return the gradients of the system's integrals with second derivatives, and these integrals."""
        found = [integral for integral in self.system.integrals.values() if hasattr(integral, "hessian")]
        return [(self.gradient(y, integral), integral) for integral in found]

    def _map(self, matrix: Any) -> Floats:
        return np.asarray(matrix, dtype=np.float64) / self.units[:, None] * self.units

    def tangents(self, y: Floats) -> TangentSpace:
        """Return the tangent space of the orbit of y, by singular value decompositions of J on direct summands."""
        J = np.asarray(self.system.structure_matrix(self.units * y), dtype=np.float64)
        P = self.sign * (J / self.units[:, None] / self.units)
        parts = summands(self.system.algebra.triples, len(P))
        found = [(rows, *np.linalg.svd(P[np.ix_(rows, rows)])[:2]) for rows, _ in parts]
        smallest = RANK_TOLERANCE * max(sizes[0] for _, _, sizes in found)
        kept = [(rows, left[:, sizes > smallest]) for rows, left, sizes in found]
        basis, blocks, first = np.zeros((len(P), sum(left.shape[1] for _, left in kept))), [], 0
        for rows, left in kept:
            columns = slice(first, first := first + left.shape[1])
            basis[rows, columns] = left
            blocks.append((rows, columns))
        return TangentSpace(P, basis, blocks)

    def second_variation(self, y: Floats, tangents: TangentSpace, function: Any = None) -> Floats:
        """Return the second derivatives of F(exp(D_v) y) by v, at v = 0, in the basis of the tangent space."""
        P, U, blocks = tangents
        coadjoint = self.system.algebra.coadjoint(self.gradient(y, function) / self.units)
        D = self.sign * self._map(coadjoint)
        PU = np.zeros_like(U)
        for rows, columns in blocks:
            PU[rows, columns] = P[np.ix_(rows, rows)] @ U[rows, columns]
        Q = tangents.restricted(self.hessian(y, function), PU)
        for rows, columns in blocks:
            Q[columns, columns] -= U[rows, columns].T @ D[np.ix_(rows, rows)] @ PU[rows, columns]
        return np.asarray(0.5 * (Q + Q.T))


Orbits = CoadjointOrbits | MatrixOrbits

DIRECTIONS = {"down": 1.0, "up": -1.0, "none": 0.0}
MAX_DESCENTS, MAX_NEWTON = 500, 200
NEWTON_FROM = 1e-3  # residual, relative to its terms, below which Newton's method takes over
EIGENVALUES_BELOW = 600  # coordinates; of more, the eigenvalues of a second variation take longer than descents
MORE_DESCENTS = 50  # descents after a second variation that is not definite, and twice as many each time
MEMORY = 10  # descents from which the curvature of the energy is known
MAX_ANGLE = 1.0  # largest norm of the exponent of a Newton step
LEAST_SHARE = 0.1  # of the decrease predicted by the second variation that a Newton step must have
ARMIJO = 0.25  # share of the decrease predicted by the gradient that a step must have
ROUNDS = 64.0  # residual, in units of the round-off of its terms, at which a state is an equilibrium
STAGNANT = 1e-12  # the same, relative to the terms, if it no longer falls
ZERO = 1e-8  # eigenvalues of a second variation below this, relative to the largest, are zero
GROWTH = 1e-6  # real parts of eigenvalues below this, relative to the largest eigenvalue, are zero
DEFECTIVE = 2.0**-24  # the same, relative to the matrix: eigenvalues of a Jordan block are off by the root of round-off
SINGULAR = 1e-12  # the same in Newton's equation
UNBOUNDED = 1e5  # growth of the state, or decrease of J(x), at which there is no equilibrium
ARRAYS = 6  # of N^2 complex matrices, for the second variation on an orbit of matrices
MAX_BISECTIONS = 64  # of the shift that bounds a Newton step
MAX_SHIFTS = 200  # evaluations of the search for multipliers of integrals


@dataclass(frozen=True)
class Equilibrium:
    """A critical point of the energy on a coadjoint orbit.

    Attributes
    ----------
    x : ndarray, shape (n,) or (N, N)
        The state, on the orbit of x0, in the form of the system's states.
    energy : float
        H(x).
    frequencies : ndarray, shape (r/2,)
        Frequencies of small motions on the orbit, of dimension r, ascending: imaginary parts of the eigenvalues, one of
        each pair, in radians per unit of time.
    growth : float
        Largest real part of an eigenvalue, the rate at which small motions grow; zero if none does, to round-off.
    stability : {"stable", "unstable", "undecided"}
        "stable" if the second variation of the energy on the orbit, with any multiples of the system's integrals that
        are critical at x, is definite; "unstable" if small motions grow exponentially; otherwise "undecided".
    residual : float
        Largest component of J(x) grad H(x), of matrices the largest number in [P, W].
    """

    x: Floats
    energy: float
    frequencies: Floats
    growth: float
    stability: str
    residual: float

    def __repr__(self) -> str:
        return record_repr(self)


@suggest_keywords
@ignore_overflow
@long_operation("equilibrium")
def equilibrium(system: Any, x0: ArrayLike, relax: str = "down") -> Equilibrium:
    """Return an equilibrium on the coadjoint orbit of a state, with its frequencies and its stability.

    Choose it for ground states and textures of spins, steady rotations, steady flows of fluids, and the stability of
    any steady motion. The double-bracket flow lowers the energy on the orbit, so that every Casimir keeps its value,
    until Newton's method on the orbit converges. If x0 is an equilibrium already, it is returned, also if it is a
    saddle.

    On fluids it is the modified dynamics of Shepherd: W moves by ``U W U*``, so that every level of vorticity keeps its
    area. ``relax="up"`` ends at a flow of large scales, a local maximum of the energy: on a sphere at rest the levels
    are sorted from pole to pole; ``relax="down"`` ends at one of the smallest scales. To lower the enstrophy at
    constant energy instead, take the force `SelectiveDecay`.

    Parameters
    ----------
    system : LiePoissonSystem or MatrixSystem
        On any algebra, with a Hamiltonian that has second derivatives and does not depend on time; at most a few
        thousand coordinates. Of systems of matrices those of su(N) and u(N) with a linear stream, such as
        `sphere_euler` and `torus_euler`, up to about 40 rows; with ``relax="down"`` up to about 20, which take a
        minute, since their energy is flat near its minimum.
    x0 : array_like, shape (n,) or (N, N)
        The initial state. It selects the orbit, and of several equilibria the one that is found.
    relax : {"down", "up", "none"}
        Lower or raise the energy; "none" starts Newton's method at once, for saddles near x0.

    Returns
    -------
    Equilibrium

    Raises
    ------
    ValueError
        The orbit of x0 has a lower dimension than those around it and may not be compact (on such orbits the energy
        does not decide about stability), or the energy has no minimum on it.
    TypeError
        The system has forces, a nonlinear bracket, other or several matrices as states, or its Hamiltonian depends on
        time or has no second derivatives.
    RuntimeError
        No equilibrium was found from x0.

    Notes
    -----
    The energy-Casimir method, restricted to the tangent space of the orbit: there the second variation of H plus a
    function of the Casimirs is that of H along ``exp(D_v) x``. Definiteness on an orbit of maximal dimension implies
    nonlinear stability. Zero eigenvalues, such as those of a symmetry that x breaks, leave it undecided. On compact
    orbits it does so on those of lower dimension too, which are not refused: of matrices, and of vectors whose brackets
    preserve the sum of squares, such as those of pure states of SU(N).

    References
    ----------
    D. D. Holm, J. E. Marsden, T. Ratiu, A. Weinstein, Nonlinear stability of fluid and plasma equilibria, Physics
    Reports 123 (1985); R. W. Brockett, Dynamical systems that sort lists, Linear Algebra Appl. 146 (1991);
    T. G. Shepherd, A general method for finding extremal states of Hamiltonian dynamical systems, with applications to
    perfect fluids, J. Fluid Mech. 213 (1990) 573.

    Examples
    --------
    >>> import coadjoint as co
    >>> body = co.systems.rigid_body(inertia=(1, 2, 3))
    >>> found = co.equilibrium(body, (0.1, 0.2, 2.0))
    >>> found.stability, abs(found.x.round(12)).tolist()
    ('stable', [0.0, 0.0, 2.01246117975])
    >>> co.equilibrium(body, (0, 1, 0)).stability
    'unstable'

    The steady flow of largest energy with given levels of vorticity:

    >>> import numpy as np
    >>> fluid = co.systems.torus_euler(N=5)
    >>> W = fluid.from_modes({(1, 0): 0.3, (0, 1): 0.2j, (1, 1): 0.5})
    >>> flow = co.equilibrium(fluid, W, relax="up")
    >>> flow.stability, bool(flow.energy > fluid.energy(W))
    ('stable', True)
    >>> bool(np.abs(fluid.spectrum(flow.x) - fluid.spectrum(W)).max() < 1e-13)
    True
    """
    orbit, start = _validated(system, x0)
    direction = DIRECTIONS[read_choice(relax, "relax", tuple(DIRECTIONS))]
    y = _critical_point(orbit, start, direction)
    note_progress("frequencies")
    tangents: Any = orbit.tangents(y)
    motions = orbit.small_motions(y, tangents)
    eigenvalues = np.linalg.eigvals(motions)
    largest = float(np.max(np.abs(eigenvalues), initial=0.0))
    growth = float(np.max(eigenvalues.real))
    growth = growth if growth > max(GROWTH * largest, DEFECTIVE * float(np.linalg.norm(motions))) else 0.0
    frequencies = np.sort(np.abs(eigenvalues.imag))[::2]
    stability = "unstable" if growth else "undecided"
    if not growth and _is_definite(orbit, y, tangents):
        stability = "stable"
    x = system.states_of(orbit.units * y)
    residual = float(np.max(np.abs(system.vector_field(x))))
    return Equilibrium(x, float(system.energy(x)), frequencies, growth, stability, residual)


def _validated(system: Any, x0: ArrayLike) -> tuple[Orbits, Floats]:
    """Return the orbits of a system, and the start in their coordinates."""
    check_one_system(system)
    if system.has_matrices:
        return _orbits_of_matrices(system, x0)
    if not system.has_structure_constants or not hasattr(system.algebra, "generic_rank"):
        raise TypeError(f"{system.name} has no structure constants; equilibrium needs a LiePoissonSystem")
    momenta, single = momenta_of(system, x0)
    if not single:
        raise ValueError(f"x0 has the shape {np.shape(x0)}; {system.name} needs ({system.dim},)")
    x = momenta[0]
    if system.hamiltonian.timed:
        raise TypeError(f"the Hamiltonian of {system.name} depends on time, so that it has no equilibria")
    system.hamiltonian.hessian(x, 0.0)  # raises TypeError without second derivatives
    groups = CoordinateGroups(system)
    orbit = CoadjointOrbits(system, groups.units(groups.norms(x)))
    _check_regular(orbit, x / orbit.units)
    return orbit, x / orbit.units


def _orbits_of_matrices(system: Any, x0: ArrayLike) -> tuple[MatrixOrbits, Floats]:
    algebra = system.algebra
    if not (algebra.skew and system.complex) or algebra.blocks or len(system.matrix_shape) != 2:
        raise TypeError(
            f"the states of {system.name} are not single matrices of su(N) or u(N); equilibrium takes fluids with one "
            "field, and systems of vectors"
        )
    if system.forces or not system.linear_stream or system.timed:
        raise TypeError(
            f"{system.name} has forces, or a stream that is not linear or depends on time; equilibrium needs a "
            "quadratic energy"
        )
    check_available_memory(ARRAYS * 16 * algebra.N**4, f"equilibrium of {system.name}, with {algebra.N} rows,")
    rows = system.read(x0)
    if rows.ndim != 1:
        raise ValueError(f"x0 has the shape {np.shape(x0)}; {system.name} needs {system.shape}")
    orbit = MatrixOrbits(system, rows)
    if not orbit.tangents(rows / orbit.units).basis.size:
        raise ValueError("all eigenvalues of x0 are equal; its orbit is a point, and x0 an equilibrium")
    return orbit, rows / orbit.units


def _check_regular(orbit: CoadjointOrbits, y: Floats) -> None:
    algebra, basis = orbit.system.algebra, orbit.tangents(y).basis
    rank, generic = basis.shape[1], algebra.generic_rank()
    if rank < generic and not (has_skew_actions(algebra) and _all_move(independent_groups(algebra), basis)):
        raise ValueError(
            f"x0 lies on a singular coadjoint orbit, of dimension {rank}; those around it have dimension {generic}, "
            "and energy on the orbit does not decide about stability; move x0, or take the subalgebra or quotient in "
            "which it is regular"
        )
    if generic == 0:
        raise ValueError(f"the coadjoint orbits of {orbit.system.name} are points, and every state is an equilibrium")


def _all_move(groups: NDArray[np.int64], basis: Floats) -> bool:
    """Return whether some tangent moves each group of coordinates, such as a spin, of an orthonormal basis."""
    inside = groups >= 0
    return bool(np.all(np.bincount(groups[inside], (basis[inside] ** 2).sum(axis=1)) > 0.5))


def _critical_point(orbit: Orbits, x: Floats, direction: float) -> Floats:
    """Relax by steps of the double-bracket flow, then by Newton's method; a direction of zero is Newton's alone."""
    last, reference, scale = np.inf, orbit.sizes(x), orbit.field_scale(x)
    # On unitary orbits descents end at fluids whose energy is flat, far from definite ones.
    is_gated = len(x) > EIGENVALUES_BELOW and isinstance(orbit, CoadjointOrbits)
    # Ways of descents, and the change of the field along them: by these, directions know the second variation.
    pairs: deque[tuple[Floats, Floats]] = deque(maxlen=MEMORY)
    latest: tuple[Floats, Floats] | None = None
    # Descents take time in proportion to the nonzero structure constants, Newton's method to the third power of n.
    descents, more, until, radius = max(MAX_DESCENTS, len(x)), MORE_DESCENTS, 0, np.inf
    for count in range(descents + MAX_NEWTON):
        field = orbit.product(x, orbit.gradient(x))
        residual = float(np.max(np.abs(field)))
        stagnant = residual >= 0.5 * last and residual <= STAGNANT * scale
        if residual <= ROUNDS * UNIT_ROUNDOFF * scale or stagnant:
            return x
        note_progress(f"a state, now with the residual {residual:.1e}")
        near = residual <= NEWTON_FROM * scale and count >= until
        if direction and near and is_gated and count < descents - more:
            # Far from definite, a Newton step takes the time of many descents, which end nearer to an equilibrium.
            near = _is_semidefinite(orbit, x, direction)
            until, more = (until, more) if near else (count + more, 2 * more)
        if direction and count < descents and not near:
            if latest is not None:
                way, change = latest[0], latest[1] - field
                if way @ change > UNIT_ROUNDOFF * np.linalg.norm(way) * np.linalg.norm(change):
                    pairs.append((way, change))
            v = direction * _direction_of_descent(field, pairs)
            slope = float(direction * (field @ v))
            if not slope > 0.0:
                v, slope = direction * field, float(field @ field)
            longest = MAX_ANGLE / orbit.norm(v)
            length = min(1.0 if pairs else np.inf, longest)
            x, length = _searched(orbit, x, v, length, slope, direction)
            latest = direction * length * v, field
        else:
            last = residual
            x, radius = _newton_step(orbit, x, field, direction, radius)
        _check_bounded(orbit, reference, orbit.sizes(x), direction)
    raise RuntimeError(
        f"no equilibrium of {orbit.system.name} was found from x0: the residual is {residual:.1e} after "
        f"{descents + MAX_NEWTON} iterations; start nearer to one"
    )


def _direction_of_descent(field: Floats, pairs: Sequence[tuple[Floats, Floats]]) -> Floats:
    """Return the inverse of the second variation that pairs imply, by the method of Broyden et al., times a field."""
    # Directions are elements of the algebra, which move x by exponentials, so that those of different x are compared.
    q, parts = field.copy(), []
    for s, y in reversed(pairs):
        parts.append(float(s @ q) / float(s @ y))
        q -= parts[-1] * y
    if pairs:
        s, y = pairs[-1]
        q *= float(s @ y) / float(y @ y)
    for (s, y), part in zip(pairs, reversed(parts), strict=True):
        q += (part - float(y @ q) / float(s @ y)) * s
    return q


def _check_bounded(orbit: Orbits, first: tuple[float, float], now: tuple[float, float], direction: float) -> None:
    grown, shrunk = not now[0] < UNBOUNDED * first[0], now[1] * UNBOUNDED < first[1]
    if grown or shrunk:
        extremum = {1.0: "minimum", -1.0: "maximum", 0.0: "equilibrium near x0"}[direction]
        raise ValueError(
            f"the energy of {orbit.system.name} has no {extremum} on the orbit of x0: the state "
            f"{'grows without bound' if grown else 'approaches a singular orbit'}; take another value of relax, or x0"
        )


def _searched(orbit: Orbits, x: Floats, v: Floats, length: float, slope: float, sign: float) -> tuple[Floats, float]:
    """Return exp(D_(length v)) x with a length that lowers `sign` H, halved until it does; `slope` is its decrease."""
    energy = sign * orbit.energy(x)
    while True:
        moved = orbit.moved(x, length * v)
        change = sign * orbit.energy(moved) - energy
        if change <= -ARMIJO * length * slope or length * slope <= ROUNDS * UNIT_ROUNDOFF * (1.0 + abs(energy)):
            return moved, length
        length *= 0.5


def _newton_step(orbit: Orbits, x: Floats, field: Floats, direction: float, radius: float) -> tuple[Floats, float]:
    """Return a Newton step, and the radius of the next one; in a descent the energy must decrease as predicted."""
    # In a descent eigenvalues of the other sign are reversed, and steps are bounded by a trust region: a step that is
    # shortened as a whole would hardly move along the many soft directions near an extremum of a fluid.
    tangents: Any = orbit.tangents(x)
    gradient = tangents.basis.T @ field
    matrix = orbit.second_variation(x, tangents)
    if not direction:
        v = tangents.basis @ _solved(matrix, gradient)
        size = orbit.norm(v)
        return orbit.moved(x, v * (min(1.0, MAX_ANGLE / size) if size > 0.0 else 1.0)), radius
    downhill, energy = _Downhill(direction * matrix, gradient), direction * orbit.energy(x)
    while True:
        components = downhill.within(radius)
        length = float(np.linalg.norm(components))
        v = direction * (tangents.basis @ components)
        size = orbit.norm(v)
        if size > 1.5 * MAX_ANGLE:  # which is nearly proportional to the radius
            radius = length * MAX_ANGLE / size
            continue
        moved, slope = orbit.moved(x, v), float(gradient @ components)
        change = direction * orbit.energy(moved) - energy
        predicted = slope - 0.5 * float(components @ (direction * matrix) @ components)
        if not (change > -LEAST_SHARE * predicted and slope > ROUNDS * UNIT_ROUNDOFF * (1.0 + abs(energy))):
            is_as_predicted = change <= -0.75 * predicted and length >= 0.9 * radius
            return moved, 2.0 * radius if is_as_predicted else radius
        radius = 0.5 * length


class _Downhill:
    """Newton steps of a bounded length by the absolute values of a matrix; directions of eigenvalue zero stay."""

    def __init__(self, matrix: Floats, gradient: Floats) -> None:
        self._matrix, self._gradient = matrix, gradient

    @cached_property
    def _whole(self) -> Floats:
        """The step without a bound; eigenvalues are not computed if a factorization shows that all are positive."""
        from scipy.linalg import LinAlgError, cho_factor, solve

        matrix = self._matrix
        try:
            cho_factor(matrix - SINGULAR * np.linalg.norm(matrix, 1) * np.eye(len(matrix)), overwrite_a=True)
            return np.asarray(solve(matrix, self._gradient, assume_a="pos"))
        except LinAlgError:
            return self._shifted(0.0)

    @cached_property
    def _eigen(self) -> tuple[Floats, Floats, Floats]:
        """Absolute eigenvalues, eigenvectors, and the gradient in these; zero along eigenvalues that are zero."""
        values, vectors = np.linalg.eigh(self._matrix)
        sizes = np.abs(values)
        zero = sizes <= SINGULAR * np.max(sizes, initial=0.0)
        return np.where(zero, 1.0, sizes), vectors, np.where(zero, 0.0, vectors.T @ self._gradient)

    def _shifted(self, shift: float) -> Floats:
        sizes, vectors, gradient = self._eigen
        return np.asarray(vectors @ (gradient / (sizes + shift)))

    def within(self, radius: float) -> Floats:
        """Return the step whose length is at most a radius: eigenvalues are increased by one number."""
        if np.linalg.norm(self._whole) <= radius:
            return self._whole
        sizes, _, gradient = self._eigen
        low, high = 0.0, float(np.linalg.norm(gradient)) / radius
        for _ in range(MAX_BISECTIONS):
            middle = float(np.sqrt(max(low, 1e-6 * high) * high))
            longer = np.linalg.norm(gradient / (sizes + middle)) > radius
            low, high = (middle, high) if longer else (low, middle)
            if high - low <= 0.01 * high:
                break
        return self._shifted(high)


def _is_semidefinite(orbit: Orbits, x: Floats, direction: float) -> bool:
    """Return whether no eigenvalue of the second variation has the sign against the direction, but for zero ones."""
    tangents: Any = orbit.tangents(x)
    matrix = direction * orbit.second_variation(x, tangents)
    try:
        np.linalg.cholesky(matrix + ZERO * np.linalg.norm(matrix, 1) * np.eye(len(matrix)))
    except np.linalg.LinAlgError:
        return False
    return True


def _solved(matrix: Floats, gradient: Floats) -> Floats:
    """Return the inverse of a matrix, which is zero along eigenvalues that are zero, times a gradient."""
    values, vectors = np.linalg.eigh(matrix)
    zero = np.abs(values) <= SINGULAR * np.max(np.abs(values), initial=0.0)
    components = np.where(zero, 0.0, vectors.T @ gradient / np.where(zero, 1.0, values))
    return np.asarray(vectors @ components)


def _is_definite(orbit: Orbits, x: Floats, tangents: Any) -> bool:
    """Return whether the second variation of H plus multiples of the critical integrals is definite."""
    variations = [orbit.second_variation(x, tangents)]
    for u, integral in orbit.integrals(x):
        field = orbit.product(x, u)
        flat = np.max(np.abs(field)) <= np.sqrt(UNIT_ROUNDOFF) * orbit.sizes(x)[1] * np.max(np.abs(u), initial=0.0)
        if flat:
            variations.append(orbit.second_variation(x, tangents, integral))
    sizes = [float(np.max(np.abs(variation))) for variation in variations]
    used = [variation / size for variation, size in zip(variations, sizes, strict=True) if size > 0.0]
    if not sizes[0]:
        return False

    return any(_has_positive_sum([sign * used[0], *used[1:]]) for sign in (1.0, -1.0))


def _has_positive_sum(matrices: list[Floats]) -> bool:
    """Return whether a search finds a positive definite sum of the first matrix and multiples of the others."""
    from scipy.optimize import minimize

    def total(multipliers: Any) -> Floats:
        shifts = (m * matrix for m, matrix in zip(multipliers, matrices[1:], strict=True))
        return np.asarray(sum(shifts, start=matrices[0]))

    def height(multipliers: Any) -> float:
        note_progress("the stability")
        return -float(np.linalg.eigvalsh(total(multipliers))[0])

    multipliers = np.zeros(len(matrices) - 1)
    if len(matrices) > 1 and height(multipliers) >= -ZERO:
        options: Any = {"maxfev": MAX_SHIFTS * (len(matrices) - 1), "xatol": ZERO, "fatol": ZERO}
        multipliers = minimize(height, multipliers, method="Nelder-Mead", options=options).x
    return bool(-height(multipliers) > ZERO * np.max(np.abs(total(multipliers))))

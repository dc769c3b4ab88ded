"""Double-bracket damping, which stays on the coadjoint orbit, and the heat bath with the noise of a temperature."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import IntegrationError
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.systems.coordinates import check_moved, independent_groups, moved_by, moving_others, turned_by_bracket
from coadjoint.systems.forces.base import (
    Force,
    ForceReader,
    Noise,
    Plain,
    Tangent,
    apply_metric,
    check_dimension,
    normal_deviates,
    read_matrix,
    read_nonnegatives,
    read_seed,
)
from coadjoint.systems.forces.orbit_flow import (
    exponential,
    exponential_with_tangent,
    metric_root,
    midpoint,
)
from coadjoint.systems.matrices.conjugation import (
    acting_layers,
    check_conjugated,
    conjugated,
    damped,
    damped_along,
    damping_element,
    gaussian_element,
    units_of,
    with_layers,
)
from coadjoint.systems.matrices.conjugation import exponential as unitary
from coadjoint.validation import read_nonnegative, read_positive


@suggest_keywords
@dataclass(frozen=True)
class DoubleBracketDamping(Force):
    """Damping along the coadjoint orbit, ``x' = alpha J(x) P J(x) grad H``: reduces the energy, preserves Casimirs.

    For spins (copies of so(3), with H = -B.S and the like) this is Landau-Lifshitz damping,
    ``S' = -alpha S cross (S cross B)`` with B = -grad H; Gilbert's form, of damping constants of other codes, is
    `Gilbert`. Magnetic moments m, ``m' = -m cross B - alpha m cross (m cross B)``, are S = -m in the field -B, with the
    same alpha. The energy decreases at the rate ``alpha f . P f``, f the Hamiltonian part of x'.

    On skew-Hermitian matrices, as of fluids, it is ``W' = energy_sign alpha [[P, W], W]``, P the stream: the energy of
    a fluid decreases at alpha times the integral of the square of its advection ``u . grad omega``, for every size of
    the matrices, and each value of the vorticity keeps its area. Two matrices, a vorticity and a magnetic potential,
    move along the orbit of both; a passive scalar is carried, and does not affect the damping.

    Where axes, directions or positions are part of the state, a number as metric is that of these: they are not
    changed, and the damping is friction. A body in space has the torque ``-2 alpha Omega`` and the force ``-alpha r'``,
    and a top the torque ``-alpha gamma cross (Omega cross gamma)``.

    Its flow is the midpoint rule on the orbit, by exponentials, or by Cayley transforms of matrices: of order 2,
    symmetric; Casimirs are preserved to round-off.

    Parameters
    ----------
    alpha : float
        Strength, zero or positive.
    metric : float, (n,) or (n, n) array_like
        P, symmetric and positive semidefinite. Use 1 if the invariant form of the algebra is the sum of squares, as for
        spins and so(n). It is zero for momenta whose brackets would change axes, directions or positions. For matrices
        it is a number, a multiple of the invariant form in units of the energy: for fluids the integral of products.

    Raises
    ------
    ValueError, TypeError
        A value is negative, not finite, or of the wrong shape.

    References
    ----------
    A. Bloch, P. S. Krishnaprasad, J. E. Marsden, T. S. Ratiu, The Euler-Poincare equations and double bracket
    dissipation, Communications in Mathematical Physics 175 (1996).

    Examples
    --------
    A spin aligns with a field along the third axis, ``S_3 = tanh(alpha B t)``, and preserves its length:

    >>> import coadjoint as co
    >>> field = co.Polynomial({(0, 0, 1): -1.0})
    >>> spin = co.LiePoissonSystem(co.algebras.so(3), field).with_forces(co.forces.DoubleBracketDamping(0.1))
    >>> sol = co.integrate(spin, (1.0, 0.0, 0.0), t_span=(0, 10), step=0.125)
    >>> import numpy as np
    >>> bool(abs(sol.x[-1, 2] - np.tanh(1.0)) < 1e-5), bool(sol.balance()["|x|^2"] < 1e-14)
    (True, True)
    """

    alpha: float
    metric: Any = 1.0

    example: ClassVar = {"alpha": 0.05}
    casimirs: ClassVar[bool] = True

    def __post_init__(self) -> None:
        self._read(alpha=read_nonnegative, metric=read_matrix)
        metric_root(self.metric, f"metric of {type(self).__name__}")

    def check(self, system: Any) -> None:
        name = type(self).__name__
        if system.has_matrices:
            check_conjugated(system, name)
            if system.independent_layers:
                raise ValueError(f"{name} acts on a fluid of one layer; {system.name} has layers; take Friction")
            if np.ndim(self.metric):
                raise ValueError(
                    f"metric of {name} has the shape {np.shape(self.metric)}; on the matrices of {system.name} it is a "
                    "number"
                )
            return
        if not system.has_structure_constants:
            raise ValueError(
                f"{name} moves states along coadjoint orbits, by structure constants, which {system.name} does not "
                "have; take LinearDamping"
            )
        check_dimension(self.metric, f"metric of {name}", system)

    def _check_kinds(self, system: Any) -> None:
        if system.has_matrices:
            return
        used = np.asarray(self.metric) != 0.0
        if moving_others(system) is not None and used.ndim:
            used = used.any(axis=1) if used.ndim > 1 else used
            check_moved(f"metric of {self.label}", system, moved_by(system, used))

    def field(self, system: Any, x: NDArray[Any], t: Any) -> NDArray[Any]:
        if system.has_matrices:
            X = system.matrices(x)
            A = with_layers(system, damping_element(system, self._factor(system), X, t))
            return np.asarray(system.to_vector(system.bracket(A, X)))
        J = system.algebra.structure_matrix(x)
        return np.asarray(system.sign * (J @ self._damping_direction(system, x, t)))

    def _metric_on(self, system: Any) -> Any:
        """Return the metric; a number is that of the coordinates whose brackets change momenta only."""
        moving = None if np.ndim(self.metric) else moving_others(system)
        return self.metric if moving is None else tuple(np.where(moving, 0.0, self.metric).tolist())

    def _damping_direction(self, system: Any, x: NDArray[Any], t: Any) -> NDArray[Any]:
        return self.alpha * apply_metric(self._metric_on(system), system.vector_field(x, t))

    def _factor(self, system: Any) -> float:
        """Return the factor of the double bracket of matrices."""
        return float(self.alpha * self.metric * system.energy_sign)

    def _direction_tangent(self, system: Any, x: NDArray[Any], t: Any) -> NDArray[Any]:
        """Return the derivative of the direction of the damping by the state, (n, n)."""
        return np.asarray(self.alpha * _product_of(self._metric_on(system), system.jacobian(x, t)))

    def flow(self, system: Any, x: NDArray[Any], t: Any, tau: Any) -> NDArray[Any]:
        if system.has_matrices:
            X = damped(system, self._factor(system), system.matrices(x), float(t), float(tau))
            return np.asarray(system.to_vector(X))
        return exponential(system, self._midpoint(system, x, t, tau)[1], x)

    def _midpoint(self, system: Any, x: NDArray[Any], t: Any, tau: Any) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return the midpoint of the flow, and the direction of its exponential."""
        found = midpoint(system, lambda y: tau * self._damping_direction(system, y, t + 0.5 * tau), x)
        if found.direction is None:
            raise self._not_converged(t, found.residual)
        return found.middle, found.direction

    def scalings(self, system: Any) -> dict[str, tuple[Any, ...]]:
        if system.has_matrices:
            return {"alpha": (0.0, self.metric * system.energy_sign), "metric": (0.0, self.alpha * system.energy_sign)}
        metric = np.asarray(self.metric)
        found: dict[str, tuple[Any, ...]] = {}
        if self.alpha > 0.0:
            found["alpha"] = 0.5 / self.alpha, 1.0 / self.alpha
        if metric.ndim < 2 and np.all(metric > 0.0):
            each = np.diag(1.0 / metric) if metric.ndim else 1.0 / metric
            found["metric"] = (0.5 * each, each)
        return found

    def _not_converged(self, t: Any, last_change: float) -> IntegrationError:
        return IntegrationError(
            f"the midpoint rule of {type(self).__name__} did not converge; take a smaller step",
            step=1,
            time=float(t),
            residual=last_change,
        )

    def tangent(self, system: Any, x: NDArray[Any], t: float, tau: float) -> Tangent:
        """Return the derivative of the midpoint rule, by that of its equation."""
        if system.has_matrices:
            X, units = system.matrices(x), units_of(system)
            return np.asarray(system.to_vector(damped_along(system, self._factor(system), X, units, t, tau)[1]).T)
        middle, v = self._midpoint(system, x, t, tau)
        of_direction = tau * self._direction_tangent(system, middle, t + 0.5 * tau)
        _, by_x, by_v = exponential_with_tangent(system, 0.5 * v, x)
        of_middle = np.linalg.solve(np.eye(len(x)) - 0.5 * by_v @ of_direction, by_x)
        _, by_x, by_v = exponential_with_tangent(system, v, x)
        return np.asarray(by_x + by_v @ of_direction @ of_middle)

    def describe_to(self, reader: ForceReader, system: Any) -> Any:
        if system.has_matrices:
            return reader.on_matrix_orbit(system, self._factor(system), self.noise(system))
        metric = self._metric_on(system)
        return reader.on_orbit(self.alpha * np.asarray(metric), self._root(system), self.noise(system))

    def _root(self, system: Any) -> NDArray[np.float64]:
        return metric_root(self._metric_on(system), "metric")

    def noise(self, system: Any) -> Noise | None:
        """Return the noise that accompanies the damping; none by default."""
        return None


@suggest_keywords
@dataclass(frozen=True)
class HeatBath(DoubleBracketDamping):
    """A heat bath for spins, and for any coadjoint orbit: damping and thermal noise.

    ``dx = sign J(x) (grad H dt + alpha P sign J(x) grad H dt + sqrt(2 alpha kT) L o dW)`` in the sense of Stratonovich,
    with L L^T = P and independent Wiener processes W. The stationary density on an orbit is the Boltzmann distribution,
    exp(-H/kT), with respect to the symplectic volume of the orbit: for spins the area on their spheres. Gilbert's form
    is `Gilbert`, and thermostats of linear and angular momenta of bodies are `Langevin`.

    The flow is half of the noise, the midpoint rule of the damping, and half of the noise, all by exponentials on the
    orbit: every Casimir is preserved to round-off, in every realization. Commuting noise directions are applied
    together, with the exact distribution, and the sets of them are composed symmetrically. The noise of matrices, in
    all directions of their algebra, is one exponential: its law is invariant under conjugations, so that its mean is a
    function of the Laplacian, whose second order a corrected variance makes exact. So averages have an error of second
    order in the step, whereas the stochastic midpoint rule, which takes all directions at once, has order one.
    The noise enters no iteration, and increments need no truncation.

    The noise is a function of the seed, the number of the member and the time only: it does not depend on the number of
    threads, on other members, or on how often a run is interrupted and resumed. Consecutive spans have different noise.
    Runs backward in time raise an error.

    Parameters
    ----------
    alpha : float
        Strength of the damping, as for `DoubleBracketDamping`.
    metric : float, (n,) or (n, n) array_like
        As for `DoubleBracketDamping`.
    temperature : float or (groups,) array_like
        Boltzmann's constant times the temperature, in units of ``system.energy(x)``, in SI units 1.380649e-23 T in J
        with T in kelvin; zero or positive. Models of `co.systems.spins` in units of meV take kelvin. Several are those
        of the independent groups of coordinates in their order, such as one for each spin. Groups that the energy
        couples then exchange heat; where they are uncoupled each has its own Boltzmann distribution.
    seed : int
        Seed of the noise, from 0 to 2^62. It is required, so that no two runs share a noise by accident.
    stream : int
        Member m of a run has the noise number ``stream + m`` of the seed. With stream=m a single run is bit-identical
        to member m of an ensemble.
    boltzmann : float, optional
        Energy of a unit of `temperature`, positive; that of the system if omitted, 1 but for models in kelvin.

    Raises
    ------
    ValueError, TypeError
        A value is negative, not finite, or of the wrong shape; or the seed is missing.

    References
    ----------
    W. F. Brown, Thermal fluctuations of a single-domain particle, Physical Review 130 (1963); J. H. Mentink,
    M. V. Tretyakov, A. Fasolino, M. I. Katsnelson, Th. Rasing, Stable and fast semi-implicit integration of the
    stochastic Landau-Lifshitz equation, Journal of Physics: Condensed Matter 22 (2010); A. Arnaudon, A. L. De Castro,
    D. D. Holm, Noise and dissipation on coadjoint orbits, Journal of Nonlinear Science 28 (2018).

    Examples
    --------
    >>> import coadjoint as co
    >>> field = co.Polynomial({(0, 0, 1): -1.0})
    >>> bath = co.forces.HeatBath(0.5, temperature=0.5, seed=7)
    >>> spin = co.LiePoissonSystem(co.algebras.so(3), field).with_forces(bath)
    >>> sol = co.integrate(spin, [(0.0, 0.6, 0.8)] * 3, t_span=(0, 10), step=0.125)
    >>> bool(sol.balance()["|x|^2"] < 1e-13)
    True
    """

    temperature: Any = 0.0
    seed: Any = None
    stream: int = 0
    boltzmann: float | None = None

    selectors: ClassVar[tuple[str, ...]] = ("boltzmann",)
    example: ClassVar = {"alpha": 0.05, "temperature": 0.1, "seed": 3}
    reversible: ClassVar[bool] = False
    random: ClassVar[bool] = True

    def __post_init__(self) -> None:
        super().__post_init__()
        self._require_seed()
        self._read(temperature=read_nonnegatives, seed=read_seed, stream=read_seed, boltzmann=read_boltzmann)

    def check(self, system: Any) -> None:
        super().check(system)
        self._temperatures(system)

    def _temperatures(self, system: Any) -> Any:
        """Return the temperature, or that of each coordinate, (n,)."""
        if not np.ndim(self.temperature):
            return self.temperature
        groups, given = independent_groups(system.algebra), np.asarray(self.temperature)
        if len(given) != groups.max() + 1:
            raise ValueError(
                f"temperature of {self.label} has {len(given)} numbers, and {system.name} has {groups.max() + 1} "
                "independent groups of coordinates, such as spins; give one number, or one for each group"
            )
        found = np.where(groups < 0, 0.0, given[groups])
        metric = np.asarray(self._metric_on(system))
        if metric.ndim == 2 and (metric[found[:, None] != found] != 0.0).any():
            raise ValueError(
                f"metric of {self.label} couples coordinates of different temperatures; give a number or a diagonal"
            )
        return found

    def field(self, system: Any, x: NDArray[Any], t: Any) -> NDArray[Any]:
        raise TypeError(f"{self.label} is a noise, which has no field; its mean part is that of DoubleBracketDamping")

    def _check_kinds(self, system: Any) -> None:
        super()._check_kinds(system)
        if system.has_matrices:
            return
        metric = np.asarray(self._metric_on(system))
        used = np.broadcast_to(np.diagonal(metric) if metric.ndim > 1 else metric, system.dim)
        for k, inertia in enumerate(getattr(system, "inertias", ())):
            if inertia.rotating is not None and used[turned_by_bracket(system, k)].any():
                raise ValueError(
                    f"HeatBath turns body {k} of {system.name} about all its axes, and a rod has no momentum about its "
                    "own; give a metric that is zero for its coordinates"
                )

    @property
    def amplitude(self) -> float:
        """Factor of the Wiener processes, sqrt(2 alpha kT), at the highest temperature."""
        return float(np.sqrt(2.0 * self.alpha * self._highest_energy))

    @property
    def _highest_energy(self) -> float:
        """Boltzmann's constant times the highest temperature."""
        return float((1.0 if self.boltzmann is None else self.boltzmann) * np.max(self.temperature))

    def _root(self, system: Any) -> NDArray[np.float64]:
        """Return L with L L^T = P, where temperatures differ times their square roots relative to the highest."""
        root, temperatures = super()._root(system), self._temperatures(system)
        if not np.ndim(temperatures) or not self.amplitude:
            return root
        factor = np.sqrt(temperatures / np.max(self.temperature))
        return np.asarray(factor[:, None] * root if root.ndim == 2 else factor * root)

    def _metric_on(self, system: Any) -> Any:
        metric = super()._metric_on(system)
        return metric if np.ndim(metric) or not np.ndim(self.temperature) else (metric,) * system.dim

    def noise(self, system: Any) -> Noise | None:
        """Return the thermal noise; None at temperature zero."""
        if self.amplitude == 0.0:
            return None
        if system.has_matrices:
            amplitude = self.amplitude * float(np.sqrt(self.metric / system.energy_unit))
            return Noise(amplitude, self.seed, self.stream, ())
        return Noise(self.amplitude, self.seed, self.stream, commuting_sets(system.algebra, self._metric_on(system)))

    def flow(self, system: Any, x: NDArray[Any], t: Any, tau: Any) -> NDArray[Any]:
        self._check_forward(tau)
        x = self._apply_noise(system, x, float(t), float(tau), 0)
        return self._apply_noise(system, super().flow(system, x, t, tau), float(t), float(tau), 1)

    def tangent(self, system: Any, x: NDArray[Any], t: float, tau: float) -> Tangent:
        """Return the derivative of the flow with the same noise."""
        if system.has_matrices:
            return self._tangent_of_matrices(system, x, t, tau)
        product, y = np.eye(len(x)), x
        for v in self._noise_directions(system, t, tau, 0):
            y, by_y = self._noise_tangent(system, v, y)
            product = by_y @ product
        damping: Any = super().tangent(system, y, t, tau)  # a matrix on vectors
        y, product = super().flow(system, y, t, tau), damping @ product
        for v in self._noise_directions(system, t, tau, 1):
            y, by_y = self._noise_tangent(system, v, y)
            product = by_y @ product
        return np.asarray(product)

    def scalings(self, system: Any) -> dict[str, tuple[Any, ...]]:
        if system.has_matrices:
            noise, found = self.noise(system), super().scalings(system)
            if noise is None or not noise.amplitude:  # a square root, which has no derivative at zero
                return {} if self.temperature else {**found, "temperature": (0.0, 0.0)}
            half = 0.5 * noise.amplitude
            changes = {name: (half / getattr(self, name), factor) for name, (_, factor) in found.items()}
            return {**changes, "temperature": (half / self.temperature, 0.0)}
        if np.ndim(self.temperature):
            return super().scalings(system)
        return {**super().scalings(system), "temperature": (0.5 / self.temperature if self.temperature else 0.0, 0.0)}

    def _tangent_of_matrices(self, system: Any, x: NDArray[Any], t: float, tau: float) -> NDArray[np.float64]:
        X, dX = system.matrices(x), units_of(system)
        for half in range(2):
            if half:
                X, dX = damped_along(system, self._factor(system), X, dX, t, tau)
            for U in self._unitary_noise(system, t, tau, half):
                X, dX = conjugated(system, U, X), conjugated(system, U, dX)
        return np.asarray(system.to_vector(dX).T)

    def _unitary_noise(self, system: Any, t: float, tau: float, half: int) -> Iterator[NDArray[Any]]:
        """Yield what conjugates matrices in half of the noise: a shear of a second layer, then one exponential."""
        noise = self.noise(system)
        if noise is None:
            return
        variance, N = 0.5 * tau * noise.amplitude**2, system.algebra.N
        if acting_layers(system) == 2:
            deviates = normal_deviates(self.seed, self.stream, t, 2 + half, N * N)
            shear = gaussian_element(system.algebra, deviates, variance, corrected=False)
            yield np.stack([np.eye(N, dtype=shear.dtype), shear])
        deviates = normal_deviates(self.seed, self.stream, t, half, N * N)
        yield unitary(system, with_layers(system, gaussian_element(system.algebra, deviates, variance, corrected=True)))

    def _apply_noise(self, system: Any, x: NDArray[Any], t: float, tau: float, half: int) -> NDArray[Any]:
        if system.has_matrices:
            X = system.matrices(x)
            for U in self._unitary_noise(system, t, tau, half):
                X = conjugated(system, U, X)
            return np.asarray(system.to_vector(X))
        for v in self._noise_directions(system, t, tau, half):
            x = exponential(system, self._at(system, v, x), x)
        return x

    def _at(self, system: Any, v: NDArray[np.float64], x: NDArray[Any]) -> NDArray[Any]:
        """Return the direction v of a noise at a state."""
        return v

    def _noise_tangent(
        self, system: Any, v: NDArray[np.float64], x: NDArray[Any]
    ) -> tuple[NDArray[Any], NDArray[np.float64]]:
        """Return the state after a noise of direction v, and its derivative."""
        end, by_x, _ = exponential_with_tangent(system, v, x)
        return end, by_x

    def _noise_directions(self, system: Any, t: float, tau: float, half: int) -> Iterator[NDArray[np.float64]]:
        """Yield the directions of the exponentials of half of the noise; the second half uses the reverse order."""
        noise = self.noise(system)
        if noise is None:
            return
        deviates = normal_deviates(self.seed, self.stream, t, half, system.dim)
        root = self._root(system)
        for directions in reversed(noise.sets) if half else noise.sets:
            selected = np.zeros(system.dim)
            selected[list(directions)] = deviates[list(directions)]
            yield self.amplitude * np.sqrt(0.5 * tau) * apply_metric(root, selected)


def read_boltzmann(value: Any, what: str) -> float | None:
    """Validate the energy of a unit of temperature; None stays."""
    return None if value is None else read_positive(value, what)


def _product_of(metric: Any, matrix: NDArray[Any]) -> NDArray[Any]:
    return np.asarray(apply_metric(metric, matrix) if np.ndim(metric) != 1 else np.asarray(metric)[:, None] * matrix)


@lru_cache(maxsize=16)
def commuting_sets(algebra: Any, metric: Plain) -> tuple[tuple[int, ...], ...]:
    """Partition noise directions into commuting sets: basis elements by first fit, else one column of the root each."""
    root = metric_root(metric, "metric")
    if root.ndim == 2:
        return tuple((a,) for a in range(algebra.dim) if np.any(root[:, a]))
    noisy = np.broadcast_to(root, (algebra.dim,)) != 0.0
    neighbours: list[set[int]] = [set() for _ in range(algebra.dim)]
    for i, j in zip(algebra.triples.i.tolist(), algebra.triples.j.tolist(), strict=True):
        neighbours[i].add(j)
        neighbours[j].add(i)
    sets: list[list[int]] = []
    set_of: dict[int, int] = {}
    for a in np.flatnonzero(noisy).tolist():
        used = {set_of[b] for b in neighbours[a] if b in set_of}
        index = next(s for s in range(len(sets) + 1) if s not in used)
        if index == len(sets):
            sets.append([])
        sets[index].append(a)
        set_of[a] = index
    return tuple(map(tuple, sets))

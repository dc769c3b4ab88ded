"""Hamiltonian noise: Stratonovich noise whose every path is a composition of coadjoint flows."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.invariants.sampled_checks import sample_points
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.errors import IntegrationError
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.short_repr import short
from coadjoint.systems.coordinates import KINDS, coordinate_names
from coadjoint.systems.forces.base import Force, ForceReader, read_seed, read_state
from coadjoint.systems.forces.matrix_noise import MatrixNoise, brownian_increments, of_elements
from coadjoint.systems.forces.orbit_flow import (
    Exponential,
    bracket_of,
    exponential,
    exponential_with_tangent,
    midpoint,
)
from coadjoint.systems.hamiltonians.hamiltonian import HamiltonianLike, as_hamiltonian
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.matrices.conjugation import (
    acting_layers,
    check_conjugated,
    conjugated,
    conjugation_tangent,
    with_layers,
)
from coadjoint.validation import as_tuples, read_bool, read_finite, read_integer, to_array

Floats = NDArray[np.float64]

MAX_LEVELS = 20
MAX_SQUARES = 16  # of a quadratic function, as whose flows that of the function is composed
COMMUTING = 64 * UNIT_ROUNDOFF  # of the products: brackets below it are those of rounding
# Suzuki's fractions, by which a symmetric flow of order two has order four.
_OUTER = 1.0 / (4.0 - 4.0 ** (1.0 / 3.0))
FRACTIONS = (_OUTER, _OUTER, 1.0 - 4.0 * _OUTER, _OUTER, _OUTER)


class NoiseTerm(NamedTuple):
    """What a Brownian motion multiplies: coefficients of coordinates or of `energies`, with flows at some fractions.

    With `split` the flow of each energy is an exponential, and those of all are composed symmetrically.
    """

    indices: NDArray[np.int64]
    values: Floats
    energies: tuple[HamiltonianLike, ...] = ()
    fractions: tuple[float, ...] = (1.0,)
    split: bool = False

    @property
    def linear(self) -> bool:
        return not self.energies

    def direction(self, x: NDArray[Any]) -> NDArray[Any]:
        """Return the gradient at a state."""
        if self.linear:
            found = np.zeros(len(x))
            found[self.indices] = self.values
            return found
        return np.asarray(sum(factor * H.gradient(x) for factor, H in zip(self.values, self.energies, strict=True)))

    @property
    def is_exact(self) -> bool:
        """Whether its flow consists of exponentials, so that it is a Poisson map."""
        return self.split or len(self.fractions) == 1

    def hessian(self, x: NDArray[Any]) -> NDArray[Any]:
        """Return the second derivatives at a state, of a function that is not linear."""
        each = (factor * np.asarray(H.hessian(x)) for factor, H in zip(self.values, self.energies, strict=True))
        return np.asarray(sum(each), dtype=np.float64)


class NoiseTerms(NamedTuple):
    """The terms of a noise, one for each Brownian motion, and the sets of those that are applied together."""

    terms: tuple[NoiseTerm, ...]
    sets: tuple[tuple[int, ...], ...]

    def flows(self, increments: Floats, n: int, reverse: bool) -> Iterator[tuple[NoiseTerm | None, Any]]:
        """Yield the flows in their order: None with the direction of an exponential, or a term with its increment."""
        for members in reversed(self.sets) if reverse else self.sets:
            first = self.terms[members[0]]
            if not first.linear:
                yield first, increments[members[0]]
                continue
            v = np.zeros(n)
            for b in members:
                v[self.terms[b].indices] += increments[b] * self.terms[b].values
            yield None, v


class OrbitNoise(Force):
    """Base class of Hamiltonian noise: a strength, a seed, a stream and levels, and the terms on a system."""

    strength: Any
    seed: Any
    stream: int
    levels: int

    casimirs: ClassVar[bool] = True
    reversible: ClassVar[bool] = False
    random: ClassVar[bool] = True
    uses_energy: ClassVar[bool] = False
    around_steps: ClassVar[bool] = True
    moves: ClassVar[tuple[str, ...]] = KINDS

    def _read_numbers(self) -> None:
        """Validate the numbers of the noise."""
        if self.seed is None:
            name = type(self).__name__
            raise TypeError(f"{name} needs a seed, a whole number: runs with the same seed have the same noise")
        self._read(seed=read_seed, stream=read_seed)
        self._read(levels=lambda value, what: read_integer(value, what, 0, MAX_LEVELS))

    @abstractmethod
    def terms(self, system: Any) -> NoiseTerms:
        """Return what each Brownian motion multiplies on a system, and the sets that are applied together."""

    def check(self, system: Any) -> None:
        name = type(self).__name__
        if system.has_matrices:
            check_conjugated(system, name)
            self.on_matrices(system)
            return
        if not system.has_structure_constants:
            raise ValueError(
                f"{name} moves states along coadjoint orbits, by structure constants, which {system.name} does not have"
            )
        self.terms(system)

    def on_matrices(self, system: Any) -> MatrixNoise:
        """Return the noise on a system of matrices."""
        raise TypeError(
            f"{type(self).__name__} acts on states that are vectors, and those of {system.name} are matrices"
        )

    def field(self, system: Any, x: NDArray[Any], t: Any) -> NDArray[Any]:
        raise TypeError(f"{type(self).__name__} is a noise, which has no field; its mean part is ito_drift")

    def commutes(self, system: Any) -> bool:
        """Whether the flows of all Brownian motions commute."""
        return self.on_matrices(system).commuting if system.has_matrices else len(self.terms(system).sets) == 1

    def preserves_poisson(self, system: Any) -> bool:
        """Whether every path is a Poisson map: the flows of all H_k are exponentials."""
        return system.has_matrices or all(term.is_exact for term in self.terms(system).terms)

    def ito_drift(self, system: Any, x: NDArray[Any]) -> NDArray[Any]:
        """Return the drift that the noise has in the sense of Ito, in addition to that of Stratonovich.

        Parameters
        ----------
        system : LiePoissonSystem or MatrixSystem
            The system, with or without forces.
        x : (n,) array_like
            The state; of matrices also (N, N).

        Returns
        -------
        array
            ``1/2 sum_b D f_b(x) f_b(x)`` for the fields ``f_b = sign J(x) grad G_b`` of the Brownian motions, in the
            form of x; ``1/2 sum_k [A_k, [A_k, W]]`` for matrices.

        Examples
        --------
        >>> import coadjoint as co
        >>> import numpy as np
        >>> spin = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(0.0))
        >>> co.forces.HamiltonianNoise(np.eye(3), 0.5, seed=1).ito_drift(spin, [0.0, 0.0, 1.0])
        array([ 0.  ,  0.  , -0.25])
        """
        plain = system.unforced
        self.check(plain)
        if plain.has_matrices:
            drift = self.on_matrices(plain).ito_drift(plain, plain.matrices(x))
            return np.asarray(plain.to_vector(drift) if plain.is_in_numbers(x) else drift)
        y = np.asarray(plain._vector(x), dtype=np.float64)
        J, total = plain.structure_matrix(y), np.zeros(plain.dim)
        for term in self.terms(plain).terms:
            gradient = term.direction(y)
            field = plain.sign * (J @ gradient)
            total += 0.5 * plain.sign * (plain.product_derivative(y, gradient) @ field)
            if not term.linear:
                total += 0.5 * plain.sign * (J @ (term.hessian(y) @ field))
        return total

    def increments(self, count: int, t: float, tau: float) -> tuple[Floats, bool]:
        """Return the increments of the Brownian motions of the first member in a step, and the coin: noise first."""
        found = brownian_increments(self, count, float(t), float(tau))
        return found.sums, found.before

    def flow(self, system: Any, x: NDArray[Any], t: Any, tau: Any) -> NDArray[Any]:
        """Return the noise of a time tau, in its order or in reverse, by a fair coin."""
        x = self._apply(system, x, t, tau, 0)
        return self._apply(system, x, t, tau, 1)

    def _apply(self, system: Any, x: NDArray[Any], t: Any, tau: Any, side: int) -> NDArray[Any]:
        if system.has_matrices:
            X = system.matrices(x)
            for U in self._unitaries(system, t, tau, side):
                X = conjugated(system, U, X)
            return np.asarray(system.to_vector(X))
        for term, given in self._flows(system, t, tau, side):
            x = exponential(system, given, x) if term is None else _term_flow(system, term, given, x, t)
        return x

    def _unitaries(self, system: Any, t: Any, tau: Any, side: int) -> Iterator[NDArray[Any]]:
        """Yield what conjugates matrices on a side of a step."""
        if tau < 0.0:
            raise ValueError(f"{type(self).__name__} is a noise, which does not run backward")
        yield from self.on_matrices(system).unitaries(system, self, float(t), float(tau), side)

    def _flows(self, system: Any, t: Any, tau: Any, side: int) -> Iterator[tuple[NoiseTerm | None, Any]]:
        """Yield the flows of a side of a step: all noise, or none."""
        if tau < 0.0:
            raise ValueError(f"{type(self).__name__} is a noise, which does not run backward")
        found = self.terms(system)
        increments, first = self.increments(len(found.terms), float(t), float(tau))
        if first == (side == 0):
            yield from found.flows(increments, system.dim, reverse=side == 1)

    def on_side(self, side: int) -> Any:
        """Return the flow before (0) or after (1) a step."""
        return NoiseOnSide(self, side)

    def scalings(self) -> Mapping[str, tuple[Any, Any]]:
        scaled = np.ndim(self.strength) == 0 and self.strength != 0.0
        return {"strength": (1.0 / self.strength, 0.0)} if scaled else {}

    def describe_to(self, reader: ForceReader, system: Any) -> Any:
        return reader.hamiltonian_noise(self.terms(system), self.seed, self.stream, self.levels)


@suggest_keywords
@dataclass(frozen=True)
class HamiltonianNoise(OrbitNoise):
    """Hamiltonian noise in the sense of Stratonovich, ``dx = ... + sum_k sign J(x) grad H_k(x) o dB_k``.

    Choose it for noise that belongs to the geometry: random fields on spins, transport noise of fluids, noise in the
    parameters of a Hamiltonian. Every path is a composition of flows of Hamiltonians, so that it stays on its coadjoint
    orbit, with every Casimir at round-off; energy is not conserved. It has no damping and no temperature: for thermal
    equilibrium choose `HeatBath`, and for a torque that changes the length of a momentum `RandomTorque`.
    `ito_drift` returns the drift that is added in the sense of Ito.

    The flow of a linear H_k is an exponential, and that of a function of one linear form, or of commuting coordinates,
    is one too. Those that commute are applied together. A quadratic H_k of up to 16 coordinates is a sum of squares of
    linear forms, whose exponentials are composed to the fourth order in the increment. All of these are Poisson maps.
    Any other H_k has the midpoint rule on the orbit, by exponentials, composed to the fourth order too: it preserves
    Casimirs, and the Poisson bracket approximately. Increments are not truncated; a run in which its iteration does not
    converge raises an error that asks for a smaller step.

    By a fair coin a step begins with all noise in order, or ends with all of it in reverse. This is the composition of
    Ninomiya and Victoir with the drift as one of the fields: averages have an error of second order in the step. Paths
    converge with order one if the noise commutes, else with order one half. It draws one number for each Brownian
    motion and step; halves of the noise on both sides would have up to half of the error, at twice the cost. The noise
    acts around the whole step of schemes of higher order too, which keep their order as the strength goes to zero.

    On skew-Hermitian matrices, as of fluids, it is ``dW = [P dt + sum_k A_k o dB_k, W]``, of ``H_k = <A_k, W>`` in
    units and with the sign of the energy. A step has two exponentials for any number of matrices, or one if they
    commute: with the increments B and an independent copy D of them, ``exp(Z_1) exp(Z_2)`` with
    ``Z = sum_k (B_k/2 +- D_k/sqrt(2)) A_k`` has weak order two. `TransportNoise` has the modes of a fluid.

    The noise is a function of the seed, the number of the member and the time only, as that of `HeatBath`: it does not
    depend on threads, other members, or interruptions. Runs backward in time raise an error. With ``attitude=`` the
    group element moves by the same exponentials, so that the momentum in space is constant.

    Parameters
    ----------
    hamiltonians : sequence
        H_1, ..., H_d, each a vector of coefficients (n,) of a linear function, a formula in the coordinates of the
        system, or a Polynomial or another Hamiltonian; or a single one. They do not depend on time. On systems of
        matrices each is a matrix A of the algebra, (N, N), which is added to the stream, or a pair for two fields.
    strength : float, (d,) or (d, m) array_like
        Factors of H_k: one for all, or one each; in units of energy per unit of H_k, times the square root of a time.
        A matrix makes correlated noise, ``sum_k strength[k, b] H_k`` for each of m Brownian motions b.
    seed : int
        Seed of the noise, from 0 to 2^62. It is required, so that no two runs share a noise by accident.
    stream : int
        Member m of a run has the noise number ``stream + m`` of the seed.
    levels : int
        The increments of a step are sums of ``2^levels``, from 0 to 20: those of steps that are shorter by this factor.
        With levels 2, 1, 0 steps of h, h/2 and h/4 have the same path, as strong errors need.

    Raises
    ------
    ValueError, TypeError
        No or invalid H_k, strengths that are not finite or not one for each H_k, or a missing seed. A system without
        structure constants, and H_k not defined on its algebra, when it is added to a system.

    References
    ----------
    S. Ninomiya, N. Victoir, Weak approximation of stochastic differential equations and application to derivative
    pricing, Applied Mathematical Finance 15 (2008); D. D. Holm, Variational principles for stochastic fluid dynamics,
    Proceedings of the Royal Society A 471 (2015); S. Ephrati, E. Jansson, A. Lang, E. Luesink, An exponential map free
    implicit midpoint method for stochastic Lie-Poisson systems, arXiv:2408.16701 (2024).

    Examples
    --------
    Isotropic noise on a spin: the mean decays as ``exp(-strength^2 t)``, and each path keeps its length:

    >>> import coadjoint as co
    >>> import numpy as np
    >>> free = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(0.0))
    >>> noisy = free.with_forces(co.forces.HamiltonianNoise(np.eye(3), 0.7, seed=1))
    >>> sol = co.integrate(noisy, [(0.0, 0.0, 1.0)] * 4000, t_span=(0, 1), step=0.5)
    >>> bool(abs(sol.x[-1, :, 2].mean() - np.exp(-0.49)) < 0.03), bool(sol.balance()["|x|^2"] < 1e-13)
    (True, True)
    """

    hamiltonians: Any
    strength: Any = 1.0
    seed: Any = None
    stream: int = 0
    levels: int = 0

    example: ClassVar = {"hamiltonians": ("0.3*x1", "0.2*x2"), "strength": 0.5, "seed": 11}

    def __post_init__(self) -> None:
        self._read(hamiltonians=_read_hamiltonians, strength=_read_strength)
        self._read_numbers()
        count, shape = len(self.hamiltonians), np.shape(self.strength)
        if shape and shape[0] != count:
            raise ValueError(
                f"strength of {type(self).__name__} has the shape {shape} for {count} Hamiltonians; give a number, "
                f"({count},), or ({count}, m) for m Brownian motions"
            )

    def parameters(self) -> Mapping[str, Any]:
        """Return the parameters, with polynomials as formulas, and other Hamiltonians as functions of their values."""
        return {**super().parameters(), "hamiltonians": tuple(map(_plain_hamiltonian, self.hamiltonians))}

    def hamiltonians_on(self, system: Any) -> tuple[HamiltonianLike, ...]:
        """Return the Hamiltonians H_k on a system."""
        return tuple(_on_system(H, system, type(self).__name__) for H in self.hamiltonians)

    def linear_coefficients(self, system: Any) -> Floats | None:
        """Return the coefficients (d, n) of H_k if all are linear, else None."""
        found = [_linear_part(H, system.dim) for H in self.hamiltonians_on(system)]
        return None if any(one is None for one in found) else np.array(found)

    def terms(self, system: Any) -> NoiseTerms:
        return _terms_on(self, system)

    def on_matrices(self, system: Any) -> MatrixNoise:
        return of_elements(system, _elements_on(self, system))

    def describe_to(self, reader: ForceReader, system: Any) -> Any:
        if not system.has_matrices:
            return super().describe_to(reader, system)
        elements, noise = _elements_on(self, system), self.on_matrices(system)
        return reader.matrix_noise(system, elements, noise.commuting, self.seed, self.stream, self.levels)


@suggest_keywords
@dataclass(frozen=True)
class RandomField(OrbitNoise):
    """A random field on spins, white noise in the sense of Stratonovich: ``dS = ... + strength J(S) o dB`` at sites.

    Choose it for dephasing and rotational diffusion of spins without a temperature; `HeatBath` adds the damping that
    leads to equilibrium. Each site has three independent Brownian motions, or all sites have the same three. A free
    spin forgets its direction as ``E P_l = exp(-strength^2 l (l + 1) t/2)`` for Legendre polynomials P_l. It is the
    `HamiltonianNoise` of all coordinates, which has the scheme and its order; each site keeps its length to round-off.

    Parameters
    ----------
    strength : float or (3,) array_like
        Strength along all axes, or along each: of the field times the square root of time.
    common : bool
        Whether all sites have the same field, as of fluctuations of an external one.
    seed : int
        Seed of the noise, from 0 to 2^62. It is required, so that no two runs share a noise by accident.
    stream, levels : int
        As for `HamiltonianNoise`.

    Raises
    ------
    ValueError, TypeError
        A strength that is not finite or of the wrong shape, or a missing seed. A system other than copies of so(3),
        when it is added to a system.

    Examples
    --------
    >>> import coadjoint as co
    >>> import numpy as np
    >>> ring = co.systems.spin_lattice("ring", 8, exchange=0.0).with_forces(co.forces.RandomField(0.5, seed=1))
    >>> up = np.tile((0.0, 0.0, 1.0), (500, 8)).reshape(500, 24)
    >>> sol = co.integrate(ring, up, t_span=(0, 1), step=0.25)
    >>> bool(abs(sol.x[-1, :, 2::3].mean() - np.exp(-(0.5**2))) < 0.04)
    True
    """

    strength: Any = 1.0
    common: bool = False
    seed: Any = None
    stream: int = 0
    levels: int = 0

    example: ClassVar = {"strength": 0.3, "seed": 12}

    def __post_init__(self) -> None:
        self._read(strength=_read_strength, common=read_bool)
        self._read_numbers()
        shape = np.shape(self.strength)
        if shape not in ((), (3,)):
            raise ValueError(
                f"strength of RandomField has the shape {shape}; give a number, or one for each axis, (3,)"
            )

    def check(self, system: Any) -> None:
        super().check(system)
        i, j, k, _ = system.algebra.triples
        if system.dim % 3 or len(i) != system.dim or np.any((i // 3 != j // 3) | (i // 3 != k // 3)):
            raise TypeError(
                f"RandomField acts on spins, copies of so(3), and the algebra of {system.name} is another; take "
                "HamiltonianNoise"
            )

    def terms(self, system: Any) -> NoiseTerms:
        return _terms_of_spins(self, system.dim)


@lru_cache(maxsize=64)
def _terms_of_spins(field: RandomField, n: int) -> NoiseTerms:
    strength = np.broadcast_to(np.asarray(field.strength, dtype=np.float64), 3)
    axes = np.arange(n).reshape(-1, 3).T
    if field.common:
        terms = [NoiseTerm(sites, np.full(len(sites), size)) for sites, size in zip(axes, strength, strict=True)]
        return NoiseTerms(tuple(terms), ((0,), (1,), (2,)))
    terms = [NoiseTerm(np.array([i]), strength[i % 3 : i % 3 + 1]) for i in range(n)]
    return NoiseTerms(tuple(terms), tuple(tuple(sites.tolist()) for sites in axes))


class NoiseOnSide(NamedTuple):
    """The part of a Hamiltonian noise before or after a step, as steps and their derivatives call it."""

    noise: OrbitNoise
    side: int

    def flow_of_order(self, system: Any, x: NDArray[Any], t: Any, tau: Any, order: int) -> NDArray[Any]:
        return self.noise._apply(system, x, t, tau, self.side)

    def tangent(self, system: Any, x: NDArray[Any], t: float, tau: float) -> Floats | None:
        product, y = np.eye(len(x)), x
        if system.has_matrices:
            for U in self.noise._unitaries(system, t, tau, self.side):
                product = conjugation_tangent(system, U) @ product
            return product
        for term, v in self.noise._flows(system, t, tau, self.side):
            if term is not None:
                return None
            y, by_x, _ = exponential_with_tangent(system, v, y)
            product = by_x @ product
        return np.asarray(product)

    def scalings(self) -> Mapping[str, tuple[Any, Any]]:
        return self.noise.scalings()

    def orbit_steps(self, system: Any, x: Floats, t: float, tau: float) -> Sequence[Any]:
        if system.has_matrices:
            return ()
        steps: list[Exponential] = []
        bracket = bracket_of(system.algebra, system.sign)
        for term, v in self.noise._flows(system, t, tau, self.side):
            if term is not None:
                return ()
            steps.append(Exponential.of(bracket, v, steps[-1].end if steps else x))
        return steps


def _term_flow(system: Any, term: NoiseTerm, increment: Any, x: NDArray[Any], t: Any) -> NDArray[Any]:
    """Return the flow of a Hamiltonian over an increment, by midpoint rules on the orbit."""
    for fraction in term.fractions:
        if term.split:
            pieces = list(zip(term.values, term.energies, strict=True))
            for factor, (size, H) in zip(_halves(len(pieces)), [*pieces, *pieces[-2::-1]], strict=True):
                x = exponential(system, factor * fraction * increment * size * H.gradient(x), x)
            continue
        found = midpoint(system, _multiple(term.direction, fraction * increment), x)
        if found.direction is None:
            raise IntegrationError(
                "the midpoint rule of HamiltonianNoise did not converge; take a smaller step",
                step=1,
                time=float(t),
                residual=found.residual,
            )
        x = exponential(system, found.direction, x)
    return x


def _halves(count: int) -> list[float]:
    """Return the fractions of the flows of pieces, in their order and back."""
    return [0.5] * (count - 1) + [1.0] + [0.5] * (count - 1)


def _multiple(direction: Callable[..., Any], factor: Any) -> Callable[..., Any]:
    return lambda y: factor * direction(y)


def _read_hamiltonians(value: Any, what: str) -> tuple[Any, ...]:
    """Validate one or several Hamiltonians: coefficients as tuples, formulas, and objects."""
    one = _is_object(value)
    if isinstance(value, Mapping) and value.keys() == {"real", "imaginary"}:  # the form of matrices in records
        value = read_finite(value["real"], what) + 1j * read_finite(value["imaginary"], what)
    if not one:
        try:
            entries = list(value)
        except TypeError:
            raise TypeError(f"{what} is {short(value)}; give a sequence of vectors, formulas or Hamiltonians") from None
        if entries and all(np.ndim(entry) == 0 and not _is_object(entry) for entry in entries):
            one, value = True, entries
    found = tuple(_read_one(entry, f"{what}[{k}]") for k, entry in enumerate([value] if one else value))
    if not found:
        raise ValueError(f"{what} is empty; give one Hamiltonian or more")
    return found


def _is_object(value: Any) -> bool:
    return isinstance(value, str | Polynomial) or hasattr(value, "gradient") or callable(value)


def _read_one(value: Any, what: str) -> Any:
    if _is_object(value):
        if isinstance(value, type):
            raise TypeError(f"{what} is the class {value.__name__}; give a vector, a formula or a Hamiltonian")
        return value
    array = to_array(value, what, "iufc")
    square = array.ndim in (2, 3) and array.shape[-1] == array.shape[-2]
    if not array.size or not (array.ndim == 1 or square):
        raise ValueError(
            f"{what} has the shape {array.shape}; coefficients of a linear function have the shape (n,), and matrices "
            "(N, N)"
        )
    return read_state(array, what) if square else as_tuples(read_finite(value, what))


def _plain_hamiltonian(H: Any) -> Any:
    """Return a Hamiltonian as coefficients or a formula, which records store, or as a function, which they do not."""
    polynomial = H.to_polynomial() if getattr(H, "dim", None) and hasattr(H, "to_polynomial") else H
    if hasattr(polynomial, "monomials"):
        with suppress(ValueError):  # a formula in other names
            if Polynomial(str(polynomial), polynomial.dim) == polynomial:
                return str(polynomial)
    return getattr(H, "value", H)


def _read_strength(value: Any, what: str) -> Any:
    array = read_finite(value, what)
    if array.ndim > 2 or not array.size:
        raise ValueError(f"{what} has the shape {array.shape}; give a number, (d,) or (d, m) for d Hamiltonians")
    return as_tuples(array)


@lru_cache(maxsize=64)
def _on_system(H: Any, system: Any, owner: str) -> Any:
    """Return a Hamiltonian on a system."""
    if type(H) is tuple:
        if np.ndim(H) != 1:
            raise ValueError(
                f"a Hamiltonian of {owner} is a matrix; on {system.name} give coefficients ({system.dim},)"
            )
        held = getattr(system, "held", 0)  # numbers of sampled laws behind the coordinates
        if len(H) == system.dim - held:
            H = (*H, *[0.0] * held)
        if len(H) != system.dim:
            raise ValueError(
                f"a Hamiltonian of {owner} has {len(H)} coefficients; {system.name} has dimension {system.dim}"
            )
        return Quadratic(np.zeros(len(H)), linear=H).bind(len(H))
    try:
        found = as_hamiltonian(H, system.dim, system.name, coordinate_names(system))
    except (TypeError, ValueError) as reason:
        raise type(reason)(f"of {owner} {reason}") from None
    if found.timed:
        raise ValueError(f"a Hamiltonian of {owner} depends on time, {short(H)}; give functions of the state")
    return found


def _linear_part(H: Any, n: int) -> Floats | None:
    """Return the coefficients of a linear function (a constant is irrelevant), else None."""
    total = np.zeros(n)
    for term in H.terms():
        if term.form is None or np.any(term.form.values != 0.0):
            return None
        total = total + term.form.linear
    return total


@lru_cache(maxsize=16)
def _elements_on(noise: HamiltonianNoise, system: Any) -> NDArray[Any]:
    """Return the elements that the Brownian motions multiply on a system of matrices, (m, N, N) or (m, 2, N, N)."""
    owner, algebra, layers, elements = type(noise).__name__, system.algebra, acting_layers(system), []
    for k, H in enumerate(noise.hamiltonians):
        what = f"hamiltonians[{k}] of {owner}"
        if type(H) is not tuple:
            raise TypeError(f"{what} is {short(H)}; on the matrices of {system.name} give a matrix A, for <A, W>")
        parts = np.array(H)
        if parts.ndim not in (2, layers + 1) or (parts.ndim == 3 and len(parts) != 2):
            shapes = " or ".join(map(str, (algebra.shape, (2, *algebra.shape))[:layers]))
            raise ValueError(
                f"{what} has the shape {parts.shape}; on {system.name} give matrices of the shape {shapes}"
            )
        elements.append(np.stack([algebra.read(part, what) for part in parts.reshape(-1, *parts.shape[-2:])]))
    if any(len(one) > 1 for one in elements):
        elements = [with_layers(system, one[0]) if len(one) == 1 else one for one in elements]
    else:
        elements = [one[0] for one in elements]
    strength = np.asarray(noise.strength, dtype=np.float64)
    columns = np.diag(np.broadcast_to(strength, len(elements))) if strength.ndim < 2 else strength
    return np.asarray(np.tensordot(columns.T, np.array(elements), axes=1))


@lru_cache(maxsize=64)
def _terms_on(noise: HamiltonianNoise, system: Any) -> NoiseTerms:
    energies = noise.hamiltonians_on(system)
    linear = [_linear_part(H, system.dim) for H in energies]
    strength = np.asarray(noise.strength, dtype=np.float64)
    columns = np.diag(np.broadcast_to(strength, len(energies))) if strength.ndim < 2 else strength
    terms = []
    for b in range(columns.shape[1]):
        used = [b] if strength.ndim < 2 else list(range(len(energies)))
        factors = columns[used, b]
        coefficients = [linear[k] for k in used]
        if all(one is not None for one in coefficients):
            rows = np.array(coefficients)
            indices = np.flatnonzero(rows.any(axis=0))
            terms.append(NoiseTerm(indices, np.sum(factors[:, None] * rows, axis=0)[indices]))
            continue
        term = NoiseTerm(np.array(used), factors, tuple(energies[k] for k in used))
        term = term._replace(fractions=_fractions_of(term, system))
        squares = () if term.is_exact else _squares_of(term, system.dim)
        if squares:
            numbers = len(energies) + MAX_SQUARES * b + np.arange(len(squares))
            term = NoiseTerm(numbers, np.ones(len(squares)), squares, FRACTIONS, split=True)
        terms.append(term)
    return NoiseTerms(tuple(terms), _commuting_sets(terms, system))


def _fractions_of(term: NoiseTerm, system: Any) -> tuple[float, ...]:
    """Return the fractions of the increment of midpoint rules: one if the gradient is constant along the flow."""
    for x in sample_points(system.dim):
        try:
            with np.errstate(all="ignore"):
                gradient, hessian = term.direction(x), term.hessian(x)
        except (TypeError, ArithmeticError, ValueError):  # no second derivatives, or outside its domain
            return FRACTIONS
        J = system.structure_matrix(x)
        size = np.abs(hessian) @ (np.abs(J) @ np.abs(gradient))
        if not np.all(np.abs(hessian @ (J @ gradient)) <= COMMUTING * system.dim * size):
            return FRACTIONS
    return (1.0,)


def _squares_of(term: NoiseTerm, n: int) -> tuple[HamiltonianLike, ...]:
    """Return a quadratic function as squares of linear forms and a linear function; nothing for others or too many."""
    if n > MAX_SQUARES:
        return ()
    M, linear = np.zeros((n, n)), np.zeros(n)
    for factor, H in zip(term.values.tolist(), term.energies, strict=True):
        for one in H.terms():
            if one.form is None:
                return ()
            np.add.at(M, (one.form.rows, one.form.indices), factor * one.form.values)
            linear = linear + factor * one.form.linear
    found: list[HamiltonianLike] = []
    least = 16 * n * UNIT_ROUNDOFF * float(np.abs(M).max())
    while len(found) < MAX_SQUARES and np.abs(M).max() > least:
        i, j = np.unravel_index(int(np.argmax(np.abs(M))), M.shape)
        k = int(np.argmax(np.abs(np.diag(M))))
        # By a coordinate, or the sum of two where their product is the largest.
        large = abs(M[k, k]) >= 0.5 * abs(M[i, j])
        column, pivot = (M[:, k], M[k, k]) if large else (M[:, i] + M[:, j], M[i, i] + M[j, j] + 2.0 * M[i, j])
        square = np.multiply.outer(column, column / pivot)
        found.append(Quadratic(0.5 * (square + square.T)).bind(n))
        M = M - 0.5 * (square + square.T)
        M[np.abs(M) <= least] = 0.0
    if linear.any():
        found.append(Quadratic(np.zeros(n), linear=linear).bind(n))
    return tuple(found) if len(found) <= MAX_SQUARES else ()


def _commuting_sets(terms: Sequence[NoiseTerm], system: Any) -> tuple[tuple[int, ...], ...]:
    """Return sets of linear terms that commute, by first fit; every other term is a set of its own."""
    i, j, k, c = system.algebra.triples
    c = np.asarray(c, dtype=np.float64)
    dense: dict[int, Floats] = {}

    def commute(a: int, b: int) -> bool:
        u, v = dense[a], dense[b]
        first, second = u[i] * v[j], u[j] * v[i]
        product = np.bincount(k, c * (first - second), system.dim)
        return bool(
            np.all(np.abs(product) <= COMMUTING * np.bincount(k, np.abs(c) * (abs(first) + abs(second)), system.dim))
        )

    sets: list[list[int]] = []
    for b, term in enumerate(terms):
        if not term.linear:
            sets.append([b])
            continue
        dense[b] = np.zeros(system.dim)
        dense[b][term.indices] = term.values
        for one in sets:
            if terms[one[0]].linear and all(commute(a, b) for a in one):
                one.append(b)
                break
        else:
            sets.append([b])
    return tuple(map(tuple, sets))

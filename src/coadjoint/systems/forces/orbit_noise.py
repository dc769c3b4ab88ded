"""Base class of Hamiltonian noise: the flows of its terms on one side of a step, by a fair coin."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterator
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import IntegrationError
from coadjoint.systems.coordinates import KINDS
from coadjoint.systems.forces.base import Force, ForceReader, Tangent, read_seed
from coadjoint.systems.forces.matrix_noise import MatrixNoise, brownian_increments
from coadjoint.systems.forces.orbit_flow import (
    exponential,
    exponential_with_tangent,
    midpoint,
)
from coadjoint.systems.hamiltonians.hamiltonian import HamiltonianLike
from coadjoint.systems.matrices.conjugation import check_conjugated, conjugated, units_of
from coadjoint.validation import as_tuples, read_finite, read_integer

Floats = NDArray[np.float64]

MAX_LEVELS = 20


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
        self._require_seed()
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
        self._check_forward(tau)
        yield from self.on_matrices(system).unitaries(system, self, float(t), float(tau), side)

    def _flows(self, system: Any, t: Any, tau: Any, side: int) -> Iterator[tuple[NoiseTerm | None, Any]]:
        """Yield the flows of a side of a step: all noise, or none."""
        self._check_forward(tau)
        found = self.terms(system)
        increments, first = self.increments(len(found.terms), float(t), float(tau))
        if first == (side == 0):
            yield from found.flows(increments, system.dim, reverse=side == 1)

    def on_side(self, side: int) -> Any:
        """Return the flow before (0) or after (1) a step."""
        return NoiseOnSide(self, side)

    def describe_to(self, reader: ForceReader, system: Any) -> Any:
        return reader.hamiltonian_noise(self.terms(system), self.seed, self.stream, self.levels)


class NoiseOnSide(NamedTuple):
    """The part of a Hamiltonian noise before or after a step, as steps and their derivatives call it."""

    noise: OrbitNoise
    side: int

    def flow_of_order(self, system: Any, x: NDArray[Any], t: Any, tau: Any, order: int) -> NDArray[Any]:
        return self.noise._apply(system, x, t, tau, self.side)

    def tangent(self, system: Any, x: NDArray[Any], t: float, tau: float) -> Tangent:
        if system.has_matrices:
            dX = units_of(system)
            for U in self.noise._unitaries(system, t, tau, self.side):
                dX = conjugated(system, U, dX)
            return np.asarray(system.to_vector(dX).T)
        product, y = np.eye(len(x)), x
        for term, v in self.noise._flows(system, t, tau, self.side):
            if term is not None:
                return None
            y, by_x, _ = exponential_with_tangent(system, v, y)
            product = by_x @ product
        return np.asarray(product)


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


def read_strength(value: Any, what: str) -> Any:
    """Validate strengths: a number, one for each Hamiltonian, or a matrix."""
    array = read_finite(value, what)
    if array.ndim > 2 or not array.size:
        raise ValueError(f"{what} has the shape {array.shape}; give a number, (d,) or (d, m) for d Hamiltonians")
    return as_tuples(array)

"""Hamiltonian noise: Stratonovich noise whose every path is a composition of coadjoint flows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.invariants.sampled_checks import sample_points
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.labels import labelled
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.short_repr import short
from coadjoint.systems.coordinates import coordinate_names
from coadjoint.systems.forces.base import ForceReader, read_state
from coadjoint.systems.forces.matrix_noise import MatrixNoise, of_elements
from coadjoint.systems.forces.orbit_noise import NoiseTerm, NoiseTerms, OrbitNoise, read_strength
from coadjoint.systems.hamiltonians.hamiltonian import HamiltonianLike, as_hamiltonian
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.matrices.conjugation import (
    acting_layers,
    with_layers,
)
from coadjoint.validation import as_tuples, read_finite, to_array

Floats = NDArray[np.float64]

MAX_SQUARES = 16  # of a quadratic function, as whose flows that of the function is composed
COMMUTING = 64 * UNIT_ROUNDOFF  # of the products: brackets below it are those of rounding
# Suzuki's fractions, by which a symmetric flow of order two has order four.
_OUTER = 1.0 / (4.0 - 4.0 ** (1.0 / 3.0))
FRACTIONS = (_OUTER, _OUTER, 1.0 - 4.0 * _OUTER, _OUTER, _OUTER)


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
        self._read(hamiltonians=_read_hamiltonians, strength=read_strength)
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
        energies: tuple[Any, ...] = self.hamiltonians_on(system)
        found = [_linear_part(H, system.dim) for H in energies]
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


def _read_hamiltonians(value: Any, what: str) -> tuple[Any, ...]:
    """Validate one or several Hamiltonians: coefficients as tuples, formulas, and objects."""
    one = _is_object(value)
    if isinstance(value, Mapping) and value.keys() == {"real", "imaginary"}:  # the form of matrices in records
        value = read_finite(value["real"], what) + 1j * read_finite(value["imaginary"], what)
    if labelled(value) is not None:  # labels have no meaning here, and are refused
        value = to_array(value, what, "iufc")
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


@lru_cache(maxsize=64)
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


@lru_cache(maxsize=1024)
def _terms_on(noise: HamiltonianNoise, system: Any) -> NoiseTerms:
    energies: tuple[Any, ...] = noise.hamiltonians_on(system)
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

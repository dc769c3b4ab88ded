"""Commutator-free Lie group methods: exponentials of gradients, which act along the coadjoint orbit."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any, ClassVar, cast

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import IntegrationError
from coadjoint.kernels.interface import limit
from coadjoint.kernels.loop import CompiledLoop, loop_over
from coadjoint.kernels.tables.steps import STEP_LOOP, matrix_tables
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.methods.numerics.isospectral_stages import has_layers, slope_along
from coadjoint.methods.protocol.cost_model import Work, work_of_evaluations, work_of_products
from coadjoint.methods.protocol.method import Representation
from coadjoint.methods.protocol.properties import Properties
from coadjoint.methods.protocol.step_method import CompiledStepMethod
from coadjoint.program.numbers import Number, array_of, full_precision, roundoff
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.matrices.conjugation import units_of
from coadjoint.systems.matrices.matrix_system import MatrixSystem
from coadjoint.systems.step_derivatives import LinearizedStep, Stages
from coadjoint.systems.system import System
from coadjoint.systems.system_checks import check_one_system
from coadjoint.validation import read_integer

if TYPE_CHECKING:
    from coadjoint.methods.numerics.formal_series import FormalNumber

TYPICAL_DEGREE = 10  # typical degree of the series of an exponential, for estimates of work


def _as_fractions(denominator: int, *numerators: int) -> list[Fraction]:
    return [Fraction(numerator, denominator) for numerator in numerators]


SCHEMES = {
    2: ([(0, _as_fractions(2, 1))], [_as_fractions(1, 0, 1)]),
    3: (
        [(0, _as_fractions(3, 1)), (0, _as_fractions(3, 0, 2))],
        [_as_fractions(3, 1, 0, 0), _as_fractions(12, -1, 0, 9)],
    ),
    4: (
        [(0, _as_fractions(2, 1)), (0, _as_fractions(2, 0, 1)), (1, _as_fractions(2, -1, 0, 2))],
        [_as_fractions(12, 3, 2, 2, -1), _as_fractions(12, -1, 2, 2, 3)],
    ),
}
"""Order -> (stages, final moves). Stage i + 1 moves stage `stages[i][0]` by exp of the combination `stages[i][1]` of
earlier gradients; final combinations move the old state, in order.
"""


def _nodes(stages: Sequence[tuple[int, Sequence[Fraction]]]) -> list[Fraction]:
    nodes = [Fraction(0)]
    for start, combination in stages:
        nodes.append(nodes[start] + sum(combination))
    return nodes


@suggest_keywords
@dataclass(frozen=True)
class CommutatorFree(CompiledStepMethod):
    """Commutator-free Lie group method: explicit, on the coadjoint orbit, preserves every Casimir; no Poisson map.

    A step transforms the momentum by exponentials ``exp(h sign D_k)``, each k a combination of gradients of H at stages
    that are computed in the same way: two exponentials for order 2, four for order 3, five for order 4. The momentum
    therefore never leaves the coadjoint orbit, and the group element is computed in every representation. The scheme
    supports every Lie algebra and every Hamiltonian, including those without exact flows, and every `MatrixSystem`,
    whose W becomes ``U W U^-1``, U the exponential of a combination of stream matrices, so that the whole spectrum is
    preserved. The bracket and the energy are not preserved. It serves for comparison with the literature: for long runs
    choose `Splitting`, or `IsospectralGauss` for matrices, whose energy does not drift; for accuracy choose `Taylor`.

    Parameters
    ----------
    order : int
        2, 3 or 4.

    Raises
    ------
    ValueError
        `order` is not an integer from 2 to 4.

    Notes
    -----
    An exponential is the series of the sparse D_k, or of commutators with a matrix, in substeps of norm at most 1 (at
    most 4096 of them), up to the degree at which the remainder is below rounding.

    References
    ----------
    E. Celledoni, A. Marthinsen, B. Owren, Commutator-free Lie group methods, Future Generation Computer Systems 19
    (2003) 341; B. Owren, J. Phys. A 39 (2006) 5585.

    Examples
    --------
    >>> import coadjoint as co
    >>> top = co.LiePoissonSystem(co.algebras.e(3), co.Quadratic([1, 0.5, 0.4, 0, 0, 0], linear=[0, 0, 0, 0, 0, 1]), -1)
    >>> sol = co.integrate(top, (1, -0.5, 1.5, 0.6, 0, 0.8), t_span=(0, 100), step=0.1, method=co.CommutatorFree(4))
    >>> bool(max(sol.drift()[name] for name in top.casimirs) < 1e-13), bool(sol.drift()["energy"] > 1e-7)
    (True, True)
    """

    order: int = 4

    explicit = True
    symmetric = False
    by_stages = True  # type: ignore[assignment]
    failures: ClassVar[Mapping[str, str]] = {"UNDEFINED": "an exponential in the step is too large for its series"}

    def __post_init__(self) -> None:
        object.__setattr__(self, "order", read_integer(self.order, "order of CommutatorFree", 2, 4))

    def properties(self, system: System) -> Properties:
        """Return the properties: the coadjoint orbit is preserved, with every Casimir."""
        orbit_of(system)
        attitude = "none" if system.has_matrices else "every representation"
        return Properties(poisson=False, energy=False, casimirs="all", attitude=attitude)

    @classmethod
    def examples(cls) -> Sequence[CommutatorFree]:
        """Return the scheme of every order."""
        return [cls(order) for order in SCHEMES]

    @property
    def compiled_step(self) -> str:
        return "commutator_free"

    def constants(self) -> tuple[Sequence[int], Sequence[float]]:
        """Return the number of stages; and the number of final exponentials, the nodes, and all combinations."""
        stages, out = SCHEMES[self.order]
        count = len(stages) + 1
        combinations = [*stages, *((0, combination) for combination in out)]
        rows = [[start, *map(float, row), *[0.0] * (count - len(row))] for start, row in combinations]
        return [count], [len(out), *map(float, _nodes(stages)), *(a for row in rows for a in row)]

    def loop_of_substeps(
        self, system: System, h: float, representation: Representation, fractions: Sequence[float]
    ) -> CompiledLoop:
        if not system.has_matrices:
            return super().loop_of_substeps(system, h, representation, fractions)

        integers, coefficients = self.constants()
        tables = matrix_tables(system, "commutator_free_matrices", integers[0], coefficients, fractions)
        return loop_over(STEP_LOOP, tables)

    def step(self, system: System, x: Any, t: Any, h: Any) -> NDArray[Any]:
        """Return one step in NumPy: of vectors of any number type but fractions, or of a matrix or its coordinates."""
        orbit = orbit_of(system)
        if not system.has_matrices:
            return self._advanced(orbit, x, t, h, None)[1][0]
        matrices = cast(MatrixSystem, system)
        end = self._advanced(orbit, matrices.matrices(x), t, h, None)[1][0]
        return matrices.to_vector(end) if matrices.is_in_numbers(x) else end

    def tangent(self, system: System, x: Any, t: float, h: float) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return one step and the derivative of its series; for matrices, that of the projection on the algebra."""
        orbit = orbit_of(system)
        if not system.has_matrices:
            return self._advanced(orbit, np.asarray(x, dtype=np.float64), t, h, np.eye(len(x)))[1]
        matrices = cast(MatrixSystem, system)
        end, changes = self._advanced(orbit, matrices.matrices(x), t, h, units_of(matrices))[1]
        return matrices.to_vector(end), matrices.to_vector(changes).T

    def linearized(self, system: System, x: Any, t: float, h: float) -> LinearizedStep:
        def stages() -> Stages:
            # Each gradient is changed along each axis, as by a parameter, from a start that stays.
            n, count = len(x), len(SCHEMES[self.order][0]) + 1
            units = np.eye(count * n).reshape(count, n, -1)
            states, (_, changes) = self._advanced(orbit_of(system), x, t, h, np.zeros((n, count * n)), by=units)
            return [(y, changes[:, i * n : (i + 1) * n]) for i, (y, _) in enumerate(states)]

        return super().linearized(system, x, t, h)._replace(stages=stages)

    def tangent_by(self, system: System, x: Any, t: float, h: float) -> str:
        """Return "formula", except for matrices with a stream given as a function."""
        return orbit_of(system).derivative_by

    def formal_step(self, system: System, x: NDArray[Any], h: FormalNumber) -> NDArray[Any]:
        if system.has_matrices:
            raise TypeError(f"a step of {self} on matrices is not known as a power series in exact numbers")
        return self._advanced(orbit_of(system), x, 0 * h, h, None, type(h).count)[1][0]

    def _advanced(
        self,
        orbit: VectorOrbit | MatrixOrbit,
        x: Any,
        t: Any,
        h: Any,
        tangent: Any,
        degree: int | None = None,
        by: Any = (0,) * 4,
    ) -> tuple[list[Any], tuple[NDArray[Any], Any]]:
        """Return stages and the end, with their tangents; gradients also change `by` given amounts."""
        (stages, out), point, h = SCHEMES[self.order], np.asarray(x), full_precision(h)
        number: Number = float if point.dtype != object else type(point[0])
        states: list[Any] = [(point if point.dtype.kind == "c" else array_of(number, point), tangent)]
        gradients: list[Any] = []
        for i, node in enumerate(_nodes(stages)):
            if i > 0:
                start, combination = stages[i - 1]
                states.append(
                    apply_exponential(orbit, states[start], combined(combination, gradients, h), number, degree)
                )
            state, change = states[i]
            time = t + h * number(node.numerator) / node.denominator
            gradient_change = None if change is None else orbit.gradient_change(state, change, time) + by[i]
            gradients.append((orbit.gradient(state, time), gradient_change))
        end = states[0]
        for combination in out:
            end = apply_exponential(orbit, end, combined(combination, gradients, h), number, degree)
        return states, end

    def work_of_substeps(self, system: System, group: Representation, substeps: int) -> Work:
        stages, out = SCHEMES[self.order]
        products = TYPICAL_DEGREE * (len(stages) + len(out))
        if system.has_matrices:
            return work_of_products(system, substeps * products)
        return work_of_evaluations(system, len(stages) + 1 + products, self.explicit, substeps)


def combined(combination: Sequence[Fraction], gradients: Sequence[tuple[Any, Any]], h: Any) -> tuple[Any, Any]:
    """Return h times a combination of gradients, and of their derivatives if there are any."""
    parts = [(h * a.numerator / a.denominator, k) for a, k in zip(combination, gradients, strict=False) if a]
    k = sum(factor * gradient for factor, (gradient, _) in parts)
    return k, None if gradients[0][1] is None else sum(
        factor * gradient_change for factor, (_, gradient_change) in parts
    )


def apply_exponential(
    orbit: VectorOrbit | MatrixOrbit,
    state: tuple[Any, Any],
    combination: tuple[Any, Any],
    number: Number,
    degree: int | None,
) -> tuple[NDArray[Any], Any]:
    """Return exp(D) y and its derivative, by substeps of a series, which ends at `degree` if given."""
    (y, dy), (image, change, norm) = state, orbit.generator(*combination)
    substeps = 1
    if degree is None:
        substeps, degree = substeps_and_degree(norm(), roundoff(number))
    for _ in range(substeps):
        total, derivative = y, dy
        for power in range(degree, 0, -1):
            # Horner's scheme: y + (1/power) D total, and its derivative
            if dy is not None:
                derivative = dy + change(total, derivative) / (power * substeps)
            total = y + image(total) / (power * substeps)
        y, dy = total, derivative
    return y, dy


def substeps_and_degree(norm: float, unit: Any) -> tuple[int, int]:
    """Return the number of substeps of an exponential, each of norm at most 1, and the degree that suffices."""
    if unit == 0:
        raise TypeError(
            "the step needs exponentials, which exact fractions cannot represent; take floats or mpmath.mpf"
        )
    if not norm <= limit("MOST_SUBSTEPS"):
        message = CommutatorFree.failures["UNDEFINED"]
        raise IntegrationError(message, step=1, time=float("nan"), residual=float("nan"))
    substeps = max(1, int(np.ceil(norm)))
    theta, degree, term = norm / substeps, 1, norm / substeps / 2
    while term > float(unit) / 8:
        degree += 1
        term *= theta / (degree + 1)
    return substeps, degree


# D in exp(D) y: its image of y, the change of that image by changes of y and D, and a bound of its norm.
Generator = tuple[Callable[[Any], Any], Callable[[Any, Any], Any], Callable[[], float]]


class VectorOrbit:
    """The orbit of a momentum: ``D y = sign J(y) k``. Changes are columns."""

    def __init__(self, system: LiePoissonSystem) -> None:
        self._system, self.derivative_by = system, "formula"

    def gradient(self, y: Any, t: Any) -> Any:
        return self._system.hamiltonian.gradient(y, t)

    def gradient_change(self, y: Any, dy: Any, t: Any) -> Any:
        return self._system.hamiltonian.hessian(y, t) @ dy

    def generator(self, k: Any, dk: Any) -> Generator:
        """Return D of a combination of gradients, and of its changes if given."""
        system, J, sign = self._system, self._system.structure_matrix, self._system.sign
        D = None if dk is None else sign * np.asarray(system.algebra.coadjoint(k))
        return (
            lambda y: sign * (J(y) @ k),
            lambda y, dy: D @ dy + sign * (J(y) @ dk),
            lambda: float(max(abs(np.asarray(system.algebra.coadjoint(k))).sum(axis=1))),
        )


class MatrixOrbit:
    """The orbit of a matrix: ``D W = [P, W]`` with the stream P as gradient; or of two layers."""

    def __init__(self, system: MatrixSystem) -> None:
        self._system, self.derivative_by = system, "formula" if system.linear_stream else "differences"

    def gradient(self, W: Any, t: Any) -> Any:
        return self._system.stream_of(W, t)

    def gradient_change(self, W: Any, dW: Any, t: Any) -> Any:
        if has_layers(self._system):  # whose streams are linear
            return self._system.slope_of(dW, t)
        return slope_along(self._system, W, dW, t)

    def generator(self, P: Any, dP: Any) -> Generator:
        """Return D of a combination of streams, and of its changes if given."""
        bracket = self._system.bracket
        sizes = np.abs(P).reshape(-1, *self._system.algebra.shape).sum(axis=0)  # summed over layers
        return (
            lambda W: bracket(P, W),
            lambda W, dW: bracket(P, dW) + bracket(dP, W),
            lambda: float(sizes.sum(axis=-1).max() + sizes.sum(axis=-2).max()),
        )


def orbit_of(system: Any) -> VectorOrbit | MatrixOrbit:
    """Return the orbits of a system; raise an error if it is a batch or has no Lie algebra."""
    check_one_system(system)
    if system.has_matrices:
        return MatrixOrbit(system)
    if system.algebra is None:
        raise ValueError(
            f"CommutatorFree moves along coadjoint orbits, but {system.name} has no Lie algebra; take GaussLegendre"
        )
    return VectorOrbit(system)

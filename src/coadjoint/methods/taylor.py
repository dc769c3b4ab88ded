"""Taylor series of the motion, projected to the level set of the energy and of the Casimirs."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, cast
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.loop import CompiledLoop
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.methods.numerics.projection import (
    casimirs_restored,
    polynomial_casimirs,
    project,
    project_with_tangent,
    restored_invariants,
)
from coadjoint.methods.numerics.taylor_series import (
    TOO_SHORT_MESSAGE,
    Dual,
    advance_by_own_steps,
    expand,
    expand_quadratic,
    own_step,
)
from coadjoint.methods.protocol.cost_model import (
    LANES,
    Operations,
    Work,
    series_operations,
    work_of_operations,
    work_of_own_steps,
)
from coadjoint.methods.protocol.method import SIZE_SAMPLES, FinerRun, Method, Representation
from coadjoint.methods.protocol.properties import Properties
from coadjoint.methods.protocol.step_method import CompiledStepMethod
from coadjoint.program.generators import given_matrices
from coadjoint.program.numbers import Number
from coadjoint.systems.system import System
from coadjoint.systems.system_checks import check_vector_states, schemes_for
from coadjoint.validation import read_bool, read_integer, read_number

MAX_ORDER = 64  # higher terms are below rounding in all steps that converge
DEFAULT_ORDER, LEAST_ORDER = 16, 4  # without a tolerance, and the least with one
ORDERS = range(6, 25, 2)  # sums of higher orders are not unrolled
TOLERANCE_REDUCTION = 32.0  # factor by which the tolerance is reduced for an error estimate
TOO_FAR_MESSAGE = "the group element turns too far in one step for its series"
TYPICAL_GROUP_TERMS = 16  # in the series of a group element
# Largest dimension in which members are computed in vector lanes, see `LARGEST_CACHED` in ``stepping.cpp``.
MAX_LANE_DIMENSION = 64
MIN_TOLERANCE, MAX_TOLERANCE = 1e-18, 0.1  # relative to the size of the motion; below the least, rounding decides

# Cached operations of series of order 1, projected or not, from which those of other orders are scaled.
_OPERATIONS: WeakKeyDictionary[System, dict[bool, Operations]] = WeakKeyDictionary()


@suggest_keywords
@dataclass(frozen=True)
class Taylor(CompiledStepMethod):
    """The Taylor series of the motion, and a projection that resets energy and Casimirs to their initial values.

    Choose it for accuracy: for a given error it mostly needs the least work, and `choose` then selects it. It is not a
    Poisson map. For statistics of chaotic motion, or a bounded energy error without a projection, choose `Splitting`.

    The coefficients are computed recursively by products of series, ``x_(k+1) = f_k / (k + 1)``, where f_k are those of
    the field. A step is explicit and long, up to about the time in which the momentum rotates by one radian. It costs
    about order^2 / 2 evaluations of the products in the field. With a `tolerance` the scheme chooses its own steps, as
    long as the terms of the series allow; use this if the speed of the motion varies. The step of a run is then the
    distance of the points that can be saved, which do not affect the motion.

    It requires a polynomial Hamiltonian, of any degree, on any algebra. With ``projected`` the energy and the
    polynomial Casimirs have their initial values after every step, up to rounding, however long the run: y = z + sum_a
    lambda_a grad C_a(z), with C_a(y) = C_a(start).

    A group element is computed in every representation, as accurately as the momentum. Over a step the gradient of H is
    a polynomial of time, and the group equation with this polynomial is solved to rounding. The element therefore stays
    in its group: rotations stay orthogonal. The spatial momentum is preserved with the accuracy of the series; choose
    `Splitting` to preserve it to rounding.

    Parameters
    ----------
    order : int, optional
        Order p of the series, from 1 to 64. About 8 for errors of 1e-3, 12 for 1e-6, 18 for 1e-9, 24 for 1e-12. None is
        16, or an order that suits the `tolerance`.
    projected : bool
        Whether the invariants are reset after every step. Otherwise their errors are those of the series.
    tolerance : float, optional
        Error of each step, relative to the largest momentum so far, from 1e-18 to 0.1; the scheme then chooses its own
        steps. Errors of the steps accumulate, and grow with the motion. By default the steps are those of the run.

    Raises
    ------
    ValueError
        `order` is not an integer from 1 to 64, or `tolerance` is out of range.

    References
    ----------
    A. Jorba, M. Zou, A software package for the numerical integration of ODEs by means of high-order Taylor methods,
    Experimental Mathematics 14 (2005); E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, IV.4.

    Examples
    --------
    >>> import coadjoint as co
    >>> top = co.systems.rigid_body(inertia=(1, 2, 2.5))
    >>> sol = co.integrate(top, (0.6, 0.0, 0.8), t_span=(0, 1000), step=1.0, method=co.Taylor(order=16))
    >>> sol.drift()["energy"] < 1e-15, sol.drift()["|x|^2"] < 2e-15
    (True, True)

    A chain of particles that fly apart, in steps of increasing length:

    >>> import numpy as np
    >>> chain = co.systems.toda(5)
    >>> x0 = np.concatenate([np.zeros(5), np.full(4, 0.5)])
    >>> sol = co.integrate(chain, x0, t_span=(0, 60), step=60.0, method=co.Taylor(tolerance=1e-10))
    >>> bool(abs(sol.x[-1] - chain.exact(x0, 60.0)).max() < 1e-9), sol.stats.evaluations < 25 * sol.method.order
    (True, True)
    """

    order: int = None  # type: ignore[assignment]
    projected: bool = True
    tolerance: float | None = None

    symmetric = False
    tables_of_any_step = True
    takes_tolerance = True
    # The series of all coordinates and of all products are in memory at once.
    largest: ClassVar[float] = 10_000

    def __post_init__(self) -> None:
        if self.tolerance is not None:
            object.__setattr__(self, "tolerance", _read_tolerance(self.tolerance))
        order = (
            _order_for(self.tolerance)
            if self.order is None
            else read_integer(self.order, "order of Taylor", 1, MAX_ORDER)
        )
        object.__setattr__(self, "order", order)
        object.__setattr__(self, "projected", read_bool(self.projected, "projected"))

    @property
    def own_steps(self) -> bool:
        return self.tolerance is not None

    @property
    def explicit(self) -> bool:
        """True without a projection, whose multipliers solve equations."""
        return not self.projected

    def properties(self, system: System) -> Properties:
        """Return the properties: the group, and with `projected` the energy and polynomial Casimirs are preserved."""
        check_vector_states(system)
        if system.algebra is None:
            raise ValueError(
                f"Taylor needs a polynomial structure matrix, and that of {system.name} is a Python function; take "
                "GaussLegendre"
            )
        if any(term.degree is None for term in system.hamiltonian.terms()):
            schemes = schemes_for(system, "GaussLegendre or Splitting")
            raise ValueError(
                f"Taylor multiplies series, but the Hamiltonian of {system.name} has a function in it; give a "
                f"polynomial, or take {schemes}"
            )
        casimirs = casimirs_restored(system) if self.projected else "none"
        return Properties(poisson=False, energy=self.projected, casimirs=casimirs, attitude="group")

    @classmethod
    def examples(cls) -> Sequence[Method]:
        """Return series of several orders, projected and not."""
        return [*(cls(order) for order in (1, 2, 3, 5, 6)), *(cls(order, projected=False) for order in (2, 5))]

    @property
    def compiled_step(self) -> str:
        return "taylor" if self.tolerance is None else "taylor_variable"

    @property
    def failures(self) -> Mapping[str, str]:  # type: ignore[override]
        """The message for a group element beyond its series, or for own steps that are too short."""
        return {"UNDEFINED": TOO_FAR_MESSAGE if self.tolerance is None else TOO_SHORT_MESSAGE}

    def constants(self) -> tuple[Sequence[int], Sequence[float]]:
        return [self.order], [] if self.tolerance is None else [self.tolerance]

    def restored(self, system: System) -> Mapping[str, Any] | None:
        return polynomial_casimirs(system) if self.projected else None

    def loop_of_substeps(
        self, system: System, h: float, representation: Representation, fractions: Sequence[float]
    ) -> CompiledLoop:
        return super().loop_of_substeps(system, h, representation, fractions)

    def work_of_substeps(self, system: System, group: Representation, substeps: int) -> Work:
        operations = self.operations(system)
        if group is not None:
            operations = operations._replace(vectors=operations.vectors + self._vectors_of_group(system, group))
        if self.tolerance is not None:
            return work_of_own_steps(operations, self.order)
        in_lanes = group is None and system.dim <= MAX_LANE_DIMENSION
        return work_of_operations(operations, substeps, in_lanes)

    def _vectors_of_group(self, system: System, group: Representation) -> float:
        """Return the number of vectors of rows of a group element that are multiplied in a step."""
        assert system.algebra is not None
        matrices = given_matrices(group)
        if matrices is not None:
            size, entries = matrices.shape[1], int(np.count_nonzero(np.any(matrices != 0.0, axis=0)))
        else:
            i, j, k, _ = system.algebra.triples
            size, entries = system.dim, len(np.unique(np.concatenate([i, j]) * system.dim + np.concatenate([k, k])))
        blocks, terms = -(-size // LANES), max(self.order, TYPICAL_GROUP_TERMS)
        return float(blocks * (entries * self.order * (terms - 0.5 * self.order) + size**2))

    def reaching(self, system: System, tolerance: float) -> Taylor:
        """Return the series with another tolerance, and the order of least work for it."""
        bounded = min(max(tolerance, MIN_TOLERANCE), MAX_TOLERANCE)
        operations = self.operations(system)

        def cost(order: int) -> float:
            ratio = order / self.order
            vectors, waiting = operations.vectors * ratio**2, operations.waiting * ratio
            work = work_of_own_steps(operations._replace(vectors=vectors, waiting=waiting), order)
            return work.cost(1.0, float(order)) / min(bounded ** (1.0 / order), 0.5)

        return replace(self, order=min(ORDERS, key=cost), tolerance=bounded)

    def finer(self, steps: int, times: float) -> FinerRun | None:
        if self.tolerance is None:
            return None
        tolerance = max(self.tolerance / (TOLERANCE_REDUCTION * times), MIN_TOLERANCE)
        finer = replace(self, order=min(self.order + 2, MAX_ORDER), tolerance=tolerance)
        return FinerRun(finer, max(steps, SIZE_SAMPLES), min(0.5, tolerance / self.tolerance))

    @property
    def fixed_steps(self) -> Taylor:
        return self if self.tolerance is None else replace(self, tolerance=None)

    def next_length(self, system: System, x: NDArray[np.float64], h: float, memory: Any) -> tuple[float, Any]:
        assert self.tolerance is not None
        start = x.astype(object)
        _, _, length, memory = own_step(system.vector_field, start, h, self.order, self.tolerance, memory)
        return length, memory

    def composed(self, coefficients: Sequence[float]) -> Method:
        if self.tolerance is not None:
            raise TypeError(f"{self} chooses its own steps, which cannot be composed; give no tolerance")
        return super().composed(coefficients)

    def operations(self, system: System) -> Operations:
        cached = _OPERATIONS.setdefault(system, {})
        if self.projected not in cached:
            cached[self.projected] = series_operations(system, 1, restored_invariants(system) if self.projected else ())
        unit = cached[self.projected]
        return unit._replace(vectors=unit.vectors * self.order**2, waiting=unit.waiting * self.order)

    def step(self, system: System, x: Any, t: Any, h: Any) -> NDArray[Any]:
        """Return one step, computed in NumPy for any number type; with `projected` not for fractions."""
        self.properties(system)
        start = np.asarray(x)
        point = start.astype(np.float64) if start.dtype != object else start
        number: Number = float if point.dtype != object else type(point[0])
        if self.tolerance is not None:
            return self._advanced(system, point, number, t, h)
        terms = expand(system.vector_field, point.astype(object), number(h), self.order)
        end = np.asarray(point + np.add.reduce(terms[::-1]), dtype=point.dtype)
        return project(restored_invariants(system), point, end, number, float(t))[0] if self.projected else end

    def tangent(self, system: System, x: Any, t: float, h: float) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return one step and its exact derivative."""
        self.properties(system)
        start = np.asarray(x, dtype=np.float64)
        if self.tolerance is None and system.has_structure_constants and system.has_quadratic_energy:
            terms, changes = expand_quadratic(cast(Any, system), start, float(h), self.order)
            end, derivative = start + sum(reversed(terms)), np.eye(len(start)) + sum(reversed(changes))
            return (
                project_with_tangent(system, start, end, derivative, float(t)) if self.projected else (end, derivative)
            )

        def to_level_set(end: NDArray[Any]) -> NDArray[Any]:
            if not self.projected:
                return end
            return _duals(*project_with_tangent(system, start, *_split_duals(end), float(t)))

        duals, field = _duals(start, np.eye(len(start))), system.vector_field
        if self.tolerance is not None:
            return _split_duals(advance_by_own_steps(field, duals, float(h), self.order, self.tolerance, to_level_set))
        return _split_duals(to_level_set(duals + sum(reversed(expand(field, duals, float(h), self.order)))))

    def _advanced(self, system: System, x: NDArray[Any], number: Number, t: Any, h: Any) -> NDArray[Any]:
        """Return the motion over h in own steps."""
        invariants = restored_invariants(system)

        def to_level_set(z: NDArray[Any]) -> NDArray[Any]:
            end = np.asarray(z, dtype=x.dtype)
            return project(invariants, x, end, number, float(t))[0].astype(object) if self.projected else z

        assert self.tolerance is not None
        start = x.astype(object)
        end = advance_by_own_steps(system.vector_field, start, number(h), self.order, self.tolerance, to_level_set)
        return np.asarray(end, dtype=x.dtype)


def _duals(values: NDArray[Any], derivatives: NDArray[Any]) -> NDArray[Any]:
    duals = np.empty(len(values), dtype=object)
    duals[:] = [Dual(value, row) for value, row in zip(values, derivatives, strict=True)]
    return duals


def _split_duals(duals: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    values, derivatives = [d.value for d in duals], [d.derivative for d in duals]
    return np.array(values, dtype=np.float64), np.array(derivatives, dtype=np.float64)


def _read_tolerance(value: Any) -> float:
    tolerance = read_number(value, "tolerance of Taylor")
    if not MIN_TOLERANCE <= tolerance <= MAX_TOLERANCE:
        raise ValueError(
            f"tolerance of Taylor is {tolerance:g}; it must lie between {MIN_TOLERANCE:g} and {MAX_TOLERANCE:g}, "
            "such as 1e-9"
        )
    return tolerance


def _order_for(tolerance: float | None) -> int:
    """Return the order that reaches a tolerance at little cost, for steps of cost about p^1.5."""
    if tolerance is None:
        return DEFAULT_ORDER
    return max(LEAST_ORDER, math.ceil(math.log(1.0 / tolerance) / 1.5) + 1)

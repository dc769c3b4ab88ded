"""Isospectral Gauss methods: W' = [P, W] for matrices, with the spectrum of W constant."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from ctypes import c_double, c_int64
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.library import kernels
from coadjoint.kernels.loop import CompiledLoop, loop_over
from coadjoint.kernels.tables.steps import STEP_LOOP, matrix_tables, stream_slopes, with_slopes
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.methods.numerics.gauss_coefficients import gauss_legendre
from coadjoint.methods.numerics.isospectral_stages import increment_of, linearized_step, stages_of
from coadjoint.methods.protocol.composed import SubstepMethod
from coadjoint.methods.protocol.cost_model import Work, work_of_products
from coadjoint.methods.protocol.derivative_tables import DIFFERENCES, DerivativeTables
from coadjoint.methods.protocol.method import Representation
from coadjoint.methods.protocol.properties import Properties
from coadjoint.program.sources import NO_MULTIPLES, Multiples
from coadjoint.systems.matrices.matrix_system import MatrixSystem
from coadjoint.systems.parameter_differences import NearbySystems
from coadjoint.systems.step_derivatives import LinearizedStep
from coadjoint.systems.system import System
from coadjoint.systems.system_checks import schemes_for
from coadjoint.validation import read_integer

MAX_STAGES = 8  # order 16, which rounding limits over any step whose stages converge


@suggest_keywords
@dataclass(frozen=True)
class IsospectralGauss(SubstepMethod):
    """Isospectral Gauss methods for matrices: Poisson maps that preserve the whole spectrum; implicit, of order 2 s.

    ``V_i = 1 + h sum_j a_ij P_j V_j``, ``U_i = 1 - h sum_j a_ij U_j P_j``, ``M_i = V_i W U_i``, ``P_i = stream(M_i)``,
    and ``W += h sum_i b_i [P_i, M_i]`` with the Gauss coefficients: V and U are inverses at the end of the step, so
    that W is conjugated and its spectrum unchanged. One stage is the isospectral midpoint rule, ``W = M - (h/2)[P, M] -
    (h^2/4) P M P``. Choose it for every `MatrixSystem`: one stage for long runs, two or three for accurate ones.

    Notes
    -----
    Iterations end when the corrections stop falling, and sums are compensated. One stage of skew-Hermitian matrices is
    solved for P by Newton's method: ``M = (1 - h P/2)^-1 W (1 + h P/2)^-1`` has the spectrum of W for every P, and
    small changes of P are computed in single precision. The initial P is predicted from up to fifteen earlier steps, so
    that a step of a smooth flow takes about five products of matrices (2.6, and four or five in single precision), each
    complex one as three of real matrices. Flows of two fields and of layers take the same steps, with three products
    for each of a flow with two fields, two for a dye, and one for each layer. Several stages of skew-Hermitian matrices
    are solved one after the other, each exactly for its own ``h a_ii P_i V_i`` with the newest ones of the others,
    which are predicted from up to eight earlier steps.

    Parameters
    ----------
    stages : int
        s, from 1 to 8.

    Raises
    ------
    TypeError, ValueError
        `stages` is not an integer from 1 to 8.

    References
    ----------
    K. Modin, M. Viviani, "Lie-Poisson methods for isospectral flows", Found. Comput. Math. 20 (2020) 889; M. Viviani,
    "A minimal-variable symplectic method for isospectral flows", BIT 60 (2020) 741.

    Examples
    --------
    >>> import coadjoint as co
    >>> import numpy as np
    >>> s = co.systems.sphere_euler(N=8)
    >>> W0 = s.algebra.projected(np.random.default_rng(1).standard_normal((8, 8)) * 1j)
    >>> sol = co.integrate(s, W0, t_span=(0, 10), step=0.1, method=co.IsospectralGauss())
    >>> sol.x.shape, bool(np.abs(s.spectrum(sol.x[-1]) - s.spectrum(W0)).max() < 1e-13)
    ((101, 8, 8), True)
    """

    stages: int = 1

    explicit = False
    symmetric = True

    def __post_init__(self) -> None:
        object.__setattr__(self, "stages", read_integer(self.stages, "stages", 1, MAX_STAGES))

    @property
    def order(self) -> int:
        """2 s."""
        return 2 * self.stages

    @classmethod
    def examples(cls) -> Sequence[IsospectralGauss]:
        return [cls(1), cls(2), cls(3)]

    def properties(self, system: System) -> Properties:
        """Return the properties: the bracket and every Casimir are preserved."""
        matrices_of(system)
        return Properties(poisson=True, energy=False, casimirs="all", attitude="none")

    def loop_of_substeps(
        self, system: System, h: float, representation: Representation, fractions: Sequence[float]
    ) -> CompiledLoop:
        a, b = _coefficients(self.stages)
        tables = matrix_tables(system, "isospectral_gauss", self.stages, (*a.ravel(), *b, *a.sum(axis=1)), fractions)
        return loop_over(STEP_LOOP, tables)

    def differentiates(self, system: System) -> bool:
        """Whether matrices are skew-Hermitian, and their stream is no function."""
        matrices: Any = system
        return bool(system.has_matrices and matrices.algebra.skew and matrices.stream.kind != "BY_FUNCTION")

    @property
    def stored_states(self) -> int:
        return 1 + self.stages

    def derivative_tables_of_substeps(
        self,
        system: System,
        h: float,
        representation: Representation,
        energies: Mapping[str, Any],
        fractions: Sequence[float],
    ) -> DerivativeTables:
        if not self.differentiates(system):
            return super().derivative_tables_of_substeps(system, h, representation, energies, fractions)
        coefficients, nearby = {}, list[NearbySystems]()
        for name, energy in energies.items():
            entries = np.arange(energy.size)
            coefficients[name] = Multiples(len(nearby) + entries, entries, np.ones(energy.size))
            nearby += energy.nearby
        loop = self.loop_of_substeps(system, h, representation, fractions)
        built = with_slopes(loop, system, stream_slopes(system, nearby), len(nearby))
        return DerivativeTables(
            tables_at=lambda step: built.tables,
            keepalive=built.keepalive,
            forward="isospectral_directions",
            backward="isospectral_cotangents",
            coefficient_count=len(nearby),
            coefficients=coefficients,
            factors=dict.fromkeys(energies, NO_MULTIPLES),
            rules=dict.fromkeys(energies, DIFFERENCES),
        )

    def work_of_substeps(self, system: System, group: Representation, substeps: int) -> Work:
        """Return the work of the products of each iteration; those of all substeps are counted together."""
        # With one stage, an iteration is a Newton step.
        products = 8 if self.stages == 1 else 3 * self.stages
        return work_of_products(matrices_of(system), products, iterated=True)

    def matrix_products(self, system: System, steps: int, evaluations: int, iterations: int) -> tuple[float, float]:
        matrices = matrices_of(system)
        n, skew, layers = matrices.algebra.N, matrices.algebra.skew, len(matrices.matrix_shape) == 3
        # Two layers that are not independent are X0 + eps X1, whose product takes three.
        factor = (matrices.matrix_shape[0] if matrices.independent_layers else 3) if layers else 1
        if self.stages == 1 and skew:
            # A prediction and each midpoint are an evaluation; the others are slopes, of two products, as are changes
            # of the midpoint at the ends of steps, which follow slopes. A field that is carried takes no inverse.
            carries = factor == 3 and not matrices.independent_layers and matrices.second_stream is None
            lower = _lower_part(n)
            inverse, slope, rest = (1, 1, 2) if carries else (factor, factor, factor)
            slopes = evaluations - steps - iterations
            whole = iterations * (inverse + rest * (1.0 + lower))
            return whole, float(2 * slope * slopes + (slope + rest) * min(slopes, steps))
        if skew:
            # An iteration takes for each stage the inverse and its product, and as a step does, two with the state.
            lower = _lower_part(n)
            carries = factor == 3 and not matrices.independent_layers and matrices.second_stream is None
            inverse, rest = (1, 2) if carries else (factor, factor)
            stages = self.stages * iterations
            return stages * 2.0 * inverse + (stages + steps) * rest * (1.0 + lower), 0.0
        if self.stages == 1:
            return factor * iterations * 3.0, 0.0
        return factor * self.stages * (iterations * 4.0 + steps * 2.0), 0.0

    def step(self, system: System, x: Any, t: Any, h: Any) -> NDArray[Any]:
        """Return one step in NumPy of a matrix (N, N) or of its coordinates (dim,)."""
        matrices = matrices_of(system)
        (a, b), W = _coefficients(self.stages), matrices.matrices(x)
        end = W + increment_of(matrices, stages_of(matrices, W, t, h, a, str(self)), h, b)
        return np.asarray(matrices.to_vector(end) if matrices.is_in_numbers(x) else end)

    def tangent(self, system: System, x: Any, t: float, h: float) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return one step and its derivative in coordinates, for the projection on the algebra."""
        step = self.linearized(system, x, t, h)
        return step.end, step.tangents(np.eye(len(step.end))).T

    def linearized(self, system: System, x: Any, t: float, h: float) -> LinearizedStep:
        matrices, (a, b) = matrices_of(system), _coefficients(self.stages)
        W = matrices.matrices(x)
        return linearized_step(matrices, W, stages_of(matrices, W, t, h, a, str(self)), t, h, a, b)

    def tangent_by(self, system: System, x: Any, t: float, h: float) -> str:
        return "formula" if matrices_of(system).linear_stream else "differences"


def matrices_of(system: Any) -> MatrixSystem:
    """Return a `MatrixSystem` unchanged; raise ValueError for any other system."""
    if not system.has_matrices:
        raise ValueError(
            f"IsospectralGauss integrates matrices, but {system.name} is no MatrixSystem; "
            f"take {schemes_for(system, 'Splitting or GaussLegendre')}"
        )
    return system


def _lower_part(n: int) -> float:
    """Return the part of a skew-Hermitian product that blocks compute which have entries on or below the diagonal."""
    part = kernels().lower_part_of_product
    part.restype, part.argtypes = c_double, [c_int64]
    return float(part(n))


def _coefficients(stages: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    _, b, mu = gauss_legendre(stages)
    return mu * b[None, :], b

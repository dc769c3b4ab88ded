"""Splitting of the fluid on the torus into lines of modes: explicit, each line by its exact flow."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.loop import CompiledLoop, loop_over
from coadjoint.kernels.tables.steps import STEP_LOOP, numeric_step_tables
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.methods.protocol.composed import SubstepMethod
from coadjoint.methods.protocol.cost_model import Work
from coadjoint.methods.protocol.method import Representation
from coadjoint.methods.protocol.properties import Properties
from coadjoint.methods.splitting import DEFAULT_SCHEMES, SCHEMES
from coadjoint.program.numbers import full_precision
from coadjoint.short_repr import short
from coadjoint.systems.matrices.matrix_system import MatrixSystem
from coadjoint.systems.matrices.streams import Circulants
from coadjoint.systems.matrices.torus_modes import matrix_of_modes, modes_of_matrix
from coadjoint.systems.step_derivatives import LinearizedStep
from coadjoint.systems.system import System
from coadjoint.validation import read_integer

Complexes = NDArray[np.complex128]
Matrix = NDArray[Any]

ORDERS = (2, 4, 6, 8, 10)  # those of symmetric compositions of lines
TRANSFORM_COST = 0.08  # cost of both Fourier transforms per number and factor of 2 in N, in units of a rotation


Line = tuple[tuple[int, int], tuple[int, int]]
"""k and l of the modes ``{j k mod N}``; with l such that k x l = 1, each mode is ``j k + d l`` exactly once."""


@suggest_keywords
@dataclass(frozen=True)
class LineSplitting(SubstepMethod):
    """McLachlan's splitting of the fluid on the torus into lines of modes: an explicit, isospectral Poisson map.

    For a prime N the N^2 - 1 modes form N + 1 lines ``{j k}`` through the origin, each of N - 1 modes that commute. H
    is the sum of the energies of the lines; the flow of one line conjugates W by the exponential of the line's stream,
    ``W -> U W U*``, which is constant along the flow, and diagonal for a suitable ordering of the modes. A line
    therefore costs Fourier transforms along the N - 1 other cosets, and a step of order 2 costs O(N^3 log N): ``k = (1,
    0), (1, 1), ..., (1, N - 1)`` for half the step, (0, 1) for the whole step, and the others in reverse for half of
    it. The energy is not preserved but its error is O(step^order) for long times; steps of higher orders are
    compositions.

    Choose it for a fluid on the torus: at the same step its error is a fraction of that of `IsospectralGauss`, and
    it does not iterate.

    Parameters
    ----------
    order : {2, 4, 6, 8, 10}
        2: symmetric. 4, 6, 8, 10: the composition of 5, 11, 21, 35 of these steps that `Splitting` uses.

    Raises
    ------
    TypeError, ValueError
        Another order.

    See Also
    --------
    IsospectralGauss : For every algebra of matrices, every stream and every N.

    References
    ----------
    R. I. McLachlan, "Explicit Lie-Poisson integration and the Euler equations", Phys. Rev. Lett. 71 (1993) 3043.

    Examples
    --------
    >>> import coadjoint as co
    >>> import numpy as np
    >>> from coadjoint.systems.fluids.torus_euler import torus_euler
    >>> s = torus_euler(N=7)
    >>> W0 = s.from_modes({(1, 0): 1.0, (0, 1): 0.5, (1, 1): 0.3j})
    >>> sol = co.integrate(s, W0, t_span=(0, 100), step=0.1, method=co.LineSplitting())
    >>> bool(np.abs(s.spectrum(sol.x[-1]) - s.spectrum(W0)).max() < 1e-14)
    True
    """

    order: int = 2

    explicit = True
    symmetric = True

    def __post_init__(self) -> None:
        order = read_integer(self.order, "order of LineSplitting", min(ORDERS), max(ORDERS))
        if order not in ORDERS:
            raise ValueError(f"LineSplitting has the orders 2, 4, 6, 8 and 10, not {order}")
        object.__setattr__(self, "order", order)

    @classmethod
    def examples(cls) -> Sequence[LineSplitting]:
        """Return the schemes of the lower orders."""
        return [cls(2), cls(4), cls(6)]

    @property
    def fractions(self) -> tuple[float, ...]:
        half = [float(c) for c in SCHEMES[DEFAULT_SCHEMES[self.order]].half]
        return (*half, *half[-2::-1])

    def properties(self, system: System) -> Properties:
        """Return the properties: the bracket and every Casimir are preserved."""
        torus_of(system)
        return Properties(poisson=True, energy=False, casimirs="all", attitude="none")

    def loop_of_substeps(
        self, system: System, h: float, representation: Representation, fractions: Sequence[float]
    ) -> CompiledLoop:
        torus = torus_of(system)
        factor, constant = stream_of_modes(torus)
        integers = [torus.algebra.N, int(constant is not None), *np.ravel(lines(torus.algebra.N)).tolist()]
        numbers = [factor.ravel()] + ([] if constant is None else [constant.ravel().view(np.float64)])
        lengths = [outer * inner for outer in fractions for inner in self.fractions]
        tables = numeric_step_tables(torus, "line_splitting", integers, np.concatenate(numbers).tolist(), lengths)  # type: ignore[arg-type]
        return loop_over(STEP_LOOP, tables)

    def work_of_substeps(self, system: System, group: Representation, substeps: int) -> Work:
        numbers = system.dim / 2  # N^2 numbers, transformed for each of N lines
        cost = substeps * len(self.fractions) * TRANSFORM_COST * numbers**1.5 * np.log2(1.0 + numbers)
        return Work(lambda iterations, evaluations: cost)

    def step(self, system: System, x: Any, t: Any, h: Any) -> NDArray[Any]:
        """Return one step in NumPy of a matrix (N, N) or of its coordinates (dim,)."""
        torus = torus_of(system)
        end = matrix_of(self._modes(torus, x, h)[-1])
        return torus.to_vector(end) if torus.is_in_numbers(x) else end

    def tangent(self, system: System, x: Any, t: float, h: float) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return one step and its exact derivative in coordinates, for the projection on the algebra."""
        step = self.linearized(system, x, t, h)
        return step.end, step.tangents(np.eye(system.dim)).T

    def linearized(self, system: System, x: Any, t: float, h: float) -> LinearizedStep:
        """Return one step with its exact derivative, which is applied to modes, projected on the algebra."""
        torus = torus_of(system)
        factor, constant = stream_of_modes(torus)
        *before, end = self._modes(torus, x, h)
        flows = list(zip(before, self.flows(torus.algebra.N, h), strict=True))

        def tangents(rows: NDArray[np.float64]) -> NDArray[np.float64]:
            changes = modes_of(torus.algebra.projected(torus.from_vector(rows)))
            for v, (line, time) in flows:
                _, changes = flow(v, changes, factor, constant, line, time)
            return torus.to_vector(matrix_of(changes))

        def cotangent(row: NDArray[np.float64]) -> NDArray[np.float64]:
            # The matrices of modes are orthogonal and of one length, which cancels.
            after = modes_of(torus.from_vector(row))
            for v, (line, time) in reversed(flows):
                after = transposed_flow(v, after, factor, constant, line, time)
            return torus.to_vector(torus.algebra.projected(matrix_of(after)))

        return LinearizedStep(torus.to_vector(matrix_of(end)), tangents, cotangent)

    def _modes(self, torus: MatrixSystem, x: Any, h: float) -> list[Complexes]:
        """Return the modes of a state, and those after each flow of a step."""
        factor, constant = stream_of_modes(torus)
        modes = [modes_of(torus.matrices(x))]
        none = np.zeros((0, *modes[0].shape), dtype=np.complex128)
        for line, time in self.flows(torus.algebra.N, h):
            modes.append(flow(modes[-1], none, factor, constant, line, time)[0])
        return modes

    def flows(self, N: int, h: float) -> Iterator[tuple[Line, float]]:
        """Yield the lines whose flows make up a step, and the time of each."""
        forward, h = lines(N), full_precision(h)
        for fraction in self.fractions:
            for line in forward[:-1]:
                yield line, fraction * h / 2
            yield forward[-1], fraction * h
            for line in forward[-2::-1]:
                yield line, fraction * h / 2


@cache
def lines(N: int) -> tuple[Line, ...]:
    """Return the lines in the order of a step: all slopes of (1, slope), then (0, 1)."""
    return (*(((1, slope), (0, 1)) for slope in range(N)), ((0, 1), (N - 1, 0)))


def flow(
    v: Complexes, dv: Complexes, factor: NDArray[np.float64], constant: Complexes | None, line: Line, h: float
) -> tuple[Complexes, Complexes]:
    """Return modes v (N, N) and changes dv (directions, N, N) after the exact flow of a line over a time h."""
    N = len(v)
    indices = np.arange(N)
    d, s = indices[:, None], indices[None, :]
    index = modes_by_coset(N, line)
    p = (factor * v if constant is None else factor * v + constant)[index[0][0], index[1][0]]
    dp = (factor * dv)[:, index[0][0], index[1][0]]
    # The diagonal of the stream is i theta, also for complex changes.
    theta, dtheta = -1j * np.fft.fft(p), -1j * np.fft.fft(dp)
    phase = np.exp(1j * h * (theta[(s + d) % N] - theta[(s - d) % N]))
    phase_change = 1j * h * (dtheta[:, (s + d) % N] - dtheta[:, (s - d) % N])
    spectrum = phase * np.fft.fft(v[index], axis=-1)
    result, result_changes = np.empty_like(v), np.empty_like(dv)
    result[index] = np.fft.ifft(spectrum, axis=-1)
    result_changes[:, index[0], index[1]] = np.fft.ifft(
        phase * np.fft.fft(dv[:, index[0], index[1]], axis=-1) + phase_change * spectrum, axis=-1
    )
    return result, result_changes


def transposed_flow(
    v: Complexes, after: Complexes, factor: NDArray[np.float64], constant: Complexes | None, line: Line, h: float
) -> Complexes:
    """Return the cotangent (N, N) before the flow of a line for that after it, by real and imaginary parts."""
    N = len(v)
    indices = np.arange(N)
    d, s = indices[:, None], indices[None, :]
    index = modes_by_coset(N, line)
    first = index[0][0], index[1][0]
    theta = -1j * np.fft.fft((factor * v if constant is None else factor * v + constant)[first])
    phase = np.exp(1j * h * (theta[(s + d) % N] - theta[(s - d) % N]))
    # The transpose of an inverse Fourier transform is a transform over N, and that of a transform N times an inverse.
    of_spectrum = np.fft.fft(after[index], axis=-1) / N
    before = np.empty_like(v)
    before[index] = N * np.fft.ifft(np.conj(phase) * of_spectrum, axis=-1)
    of_phase = -1j * h * np.conj(phase * np.fft.fft(v[index], axis=-1)) * of_spectrum
    of_theta = np.sum(of_phase[d, (s - d) % N] - of_phase[d, (s + d) % N], axis=0)
    before[first] += (factor[first] * 1j * N) * np.fft.ifft(of_theta)
    return before


def modes_by_coset(N: int, line: Line) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the indices (N, N) of modes: a row for each coset of a line, of which the first is the line."""
    j, d = np.arange(N)[None, :], np.arange(N)[:, None]
    k, l = line
    return (j * k[0] + d * l[0]) % N, (j * k[1] + d * l[1]) % N


def stream_of_modes(torus: MatrixSystem) -> tuple[NDArray[np.float64], Complexes | None]:
    """Return the factors by which the stream multiplies modes, and the modes that it adds, each (N, N)."""
    N = torus.algebra.N
    stream, linear = cast(Circulants, torus.stream), torus.linear
    return stream.spectrum.T[(2 * np.arange(N)) % N], None if linear is None else modes_of(linear)


def modes_of(W: Matrix) -> Complexes:
    """Return the modes of matrices without the factor of the vorticity: ``W = sum of v_n T_n``."""
    N = W.shape[-1]
    return np.asarray(modes_of_matrix(W) * (-1j * N / (4 * np.pi)))


def matrix_of(v: Complexes) -> Complexes:
    """Return the matrices of modes: the inverse of `modes_of`."""
    N = v.shape[-1]
    return np.asarray(matrix_of_modes(v / (-1j * N / (4 * np.pi))))


def torus_of(system: Any) -> MatrixSystem:
    """Return a fluid on the torus with a prime N unchanged; raise ValueError for any other system."""
    name = getattr(system, "name", short(system))
    supported = system.has_matrices and system.stream.kind == Circulants.kind
    if not supported or system.algebra.kind not in ("u", "su") or len(system.matrix_shape) == 3:
        raise ValueError(
            f"LineSplitting integrates fluids on the torus, but {name} is not one: its stream is not a factor for each "
            "mode of su(N); take IsospectralGauss for matrices, Splitting for vectors"
        )
    N = system.algebra.N
    if any(N % p == 0 for p in range(2, int(N**0.5) + 1)):
        raise ValueError(
            f"LineSplitting needs a prime N, for which the modes fall into lines, but N of {name} is {N}; take "
            "IsospectralGauss, or another N"
        )
    return system

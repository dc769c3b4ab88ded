"""Tables of the flows of forces, with their functions compiled."""

from __future__ import annotations

import ctypes
import warnings
from collections.abc import Callable, Hashable, Mapping, Sequence
from contextlib import suppress
from functools import lru_cache, partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.functions.compiled_functions import (
    CompiledFunction,
    KernelFunction,
    compiled_function,
    python_callback,
)
from coadjoint.kernels.functions.contents import compilation_key
from coadjoint.kernels.interface import codes, limit
from coadjoint.kernels.loop import CompiledLoop, loop_over
from coadjoint.kernels.tables.compiled import CompiledTables, as_structure, raised_by
from coadjoint.kernels.tables.field import field_of
from coadjoint.kernels.tables.invariants import watch_tables
from coadjoint.kernels.tables.steps import (
    INNER_LOOP_INDEX,
    STEP_LOOP,
    blas_address,
    inner_loop_integers,
    named_step_tables,
    stream_tables,
)
from coadjoint.optional_packages import require_packages
from coadjoint.program.sources import CoefficientNumbers, Multiples, Sources
from coadjoint.rounding import COMPLEX_STEP
from coadjoint.systems.coefficients import linear_of, with_hamiltonian, with_linear
from coadjoint.systems.forces.base import MEASURED, Force, Noise, SampleNoise, SpinTerms, ThermalNoise
from coadjoint.systems.forces.orbit_noise import NoiseTerms
from coadjoint.systems.forces.random_torque import Kicks
from coadjoint.systems.forces.torque import extrapolation_columns
from coadjoint.systems.forces.traced_law import traced_law
from coadjoint.systems.hamiltonians.traced_function import TracingError
from coadjoint.systems.matrices.conjugation import acting_layers, adjoint_casimir, blocks_of_rows
from coadjoint.systems.system_stacks import SystemStack, different
from coadjoint.systems.user_functions import is_called_in_python

NO_INTEGERS = np.zeros(1, dtype=np.int64)
NO_NUMBERS = np.zeros(1)


class ForceTable(NamedTuple):
    """A force as the kernels read it, with the index of its first `work_integral`, and their number `work_integrals`.
    The directions of a noise are grouped into `sets` that commute; set s has the directions begin[s] to begin[s + 1].
    Of a flow `sets` is the number of laws with noise, with seeds and streams as `direction`, and periods as `rate`.
    A damping with noise has a root of the covariance, whose row i has the numbers `basis` in the columns `direction`
    from begin[i] on. On orbits of spins with `extent` one `turning` multiplies the Hamiltonian field, which is added.
    """

    kind: int
    work_integral: int
    work_integrals: int
    shape: int
    rate: NDArray[np.float64]
    aim: NDArray[np.float64]
    function: NDArray[np.int64]
    amplitude: NDArray[np.float64] = NO_NUMBERS
    seed: int = 0
    stream: int = 0
    sets: int = 0
    begin: NDArray[np.int64] = NO_INTEGERS
    direction: NDArray[np.int64] = NO_INTEGERS
    extent: int = 0
    position: int = 0
    turning: NDArray[np.float64] = NO_NUMBERS
    basis: NDArray[np.float64] = NO_NUMBERS


def _adapted_matrix_function(
    function: Callable[..., Any], arguments: str, shape: tuple[int, ...], kind: Any
) -> Callable[..., Any]:
    size = int(np.prod(shape))

    def flattened(W: Any) -> Any:
        return np.ascontiguousarray(W).astype(kind).reshape(size).view(np.float64)

    def state(y: Any) -> Any:
        return np.ascontiguousarray(y).view(kind).reshape(shape)

    if arguments == "t":
        return lambda y, t: flattened(function(t))
    if arguments == "x":
        return lambda y: flattened(function(state(y)))
    if arguments == "x, t":
        return lambda y, t: flattened(function(state(y), t))
    return lambda y, t: flattened(function(state(y[:-1]), t, y[-1]))


def work_integrals_of(system: Any) -> tuple[tuple[str, str], ...]:
    """Return the work integrals of a system, (force, invariant changed), behind the coordinates."""
    work_integrals: list[tuple[str, str]] = []
    hamiltonian_part = system.unforced
    tracked_casimirs = (
        hamiltonian_part.quadratic_casimirs if hamiltonian_part.has_matrices else hamiltonian_part.casimirs
    )
    for label, force in zip(system.labels, system.forces, strict=True):
        names = ["energy", *(() if force.casimirs else tracked_casimirs)]
        work_integrals += [(label, name) for name in names]
    return tuple(work_integrals)


class _ForceTableBuilder:
    """Builder of the table of a force in schemes of an order; `keepalive` holds the code of its function `called`."""

    def __init__(
        self,
        system: Any,
        work_integral: int,
        work_integrals: int,
        order: int,
        compiles: bool = True,
        beside: bool = False,
    ) -> None:
        self.called: Callable[..., Any] | None = None
        self.arguments = ""
        self._system, self._beside = system, beside
        self._compiles, self.n, self._order = compiles, system.dim, order
        self._work_integrals = work_integral, work_integrals
        self._shape = (*system.matrix_shape, bool(system.complex)) if system.has_matrices else None
        self.keepalive: tuple[KernelFunction, ...] = ()

    def _table(self, kind: str, rate: Any = 0.0, aim: Any = (), **more: Any) -> ForceTable:
        matrix, vector = np.array(rate, dtype=np.float64), np.array(aim, dtype=np.float64)
        shape = codes("Shape")[("MULTIPLE", "DIAGONAL", "FULL")[matrix.ndim]]
        function = np.array([owner.address for owner in self.keepalive], dtype=np.int64)
        return ForceTable(
            codes("ForceKind")[kind], *self._work_integrals, shape, matrix.ravel(), vector.ravel(), function, **more
        )

    def damping(self, rate: NDArray[Any], toward: NDArray[Any]) -> ForceTable:
        return self._table("DAMPING", rate, toward)

    def constant(self, torque: NDArray[Any]) -> ForceTable:
        return self._table("CONSTANT", aim=torque)

    def function(self, torque: Callable[..., Any], arguments: str) -> ForceTable:
        self._compile(torque, arguments, self.n, "the torque")
        if arguments == "t":
            return self._table("OF_TIME")
        return self._table("OF_STATE", extent=extrapolation_columns(self._order))

    def on_orbit(
        self, metric: NDArray[Any], root: NDArray[Any], noise: Noise | None, spins: SpinTerms | None = None
    ) -> ForceTable:
        of_spins: dict[str, Any] = {} if spins is None else {"turning": spins.added, "extent": 1}
        if noise is None:
            return self._table("ON_ORBIT", metric, root, **of_spins)
        begin = np.cumsum([0, *map(len, noise.sets)], dtype=np.int64)
        direction = np.array([a for directions in noise.sets for a in directions], dtype=np.int64)
        set_fields = {"sets": len(noise.sets), "begin": begin, "direction": direction}
        noise_fields = {"amplitude": np.array([noise.amplitude]), "seed": noise.seed, "stream": noise.stream}
        return self._table("ON_ORBIT", metric, root, **noise_fields, **set_fields, **of_spins)

    def thermal(self, rate: NDArray[Any], noise: ThermalNoise | None) -> ForceTable:
        if noise is None:
            return self._table("DAMPING", rate, np.zeros(self.n))
        begin = np.searchsorted(noise.rows, np.arange(self.n + 1)).astype(np.int64)
        fields = {"amplitude": np.ones(1), "seed": noise.seed, "stream": noise.stream}
        noisy = {"begin": begin, "direction": noise.columns, "basis": noise.values, **fields}
        return self._table("DAMPING", rate, np.zeros(self.n), **noisy)

    def hamiltonian_noise(self, terms: NoiseTerms, seed: int, stream: int, levels: int) -> ForceTable:
        energies: dict[int, Any] = {
            k: H for term in terms.terms for k, H in zip(term.indices.tolist(), term.energies, strict=False)
        }
        places = {k: place for place, k in enumerate(energies)}
        columns = [[*map(places.get, term.indices)] if term.energies else term.indices for term in terms.terms]
        leaders = [terms.terms[members[0]] for members in terms.sets]
        if self._compiles:
            self.keepalive = tuple(_field_of_energy(self._system, H) for H in energies.values())
        begin = [np.cumsum([0, *map(len, rows)]) for rows in (terms.sets, columns)]
        return self._table(
            "HAMILTONIAN_NOISE",
            np.concatenate([term.values for term in terms.terms]),
            [0.0 if term.linear else len(term.fractions) * (-1.0 if term.split else 1.0) for term in leaders],
            seed=seed,
            stream=stream,
            sets=len(terms.sets),
            begin=np.concatenate(begin).astype(np.int64),
            direction=np.concatenate([*terms.sets, *columns]).astype(np.int64),
            extent=len(terms.terms),
            position=levels,
        )

    def kicks(self, kicks: Kicks, seed: int, stream: int) -> ForceTable:
        direction = np.stack([kicks.changed, kicks.state, kicks.number], axis=1).ravel()
        more = {"seed": seed, "stream": stream, "extent": kicks.motions, "sets": len(kicks.factor)}
        return self._table("KICKS", kicks.factor, direction=direction, **more)

    def flow(self, function: Callable[..., Any], noises: Sequence[SampleNoise] = ()) -> ForceTable:
        count, what = 3 * len(MEASURED), "the flow of a force"
        if not noises:
            self._compile(function, "x, t, tau", self.n + 1, what)
            return self._table("BY_FLOW")
        self._compile(function, "x, t, tau, deviates", self.n + 1 + 2 * count * len(noises), what)
        direction = np.array([(one.seed, one.stream) for one in noises], dtype=np.int64).ravel()
        periods = [one.period for one in noises]
        return self._table("BY_FLOW", periods, sets=len(noises), direction=direction, extent=count)

    def mode_rates(
        self, modes: Any, numbers: Any, rates: Any, changes: Any, rest: NDArray[Any] | None, buoyancy: Any
    ) -> ForceTable:
        flat = np.concatenate(rates).astype(np.complex128)
        aim = NO_NUMBERS if rest is None else rest
        if buoyancy is not None:
            aim = np.concatenate([np.zeros(self.n) if rest is None else rest, buoyancy.table])
        more = {"turning": np.ascontiguousarray(flat.imag), "sets": int(aim is not NO_NUMBERS)}
        weights = [np.concatenate(change.weights) for change in changes]
        table = self._on_modes("MODE_RATES", modes, 0, numbers, np.concatenate([flat.real, *weights]), aim, **more)
        layers = [layer for change in changes for layer in (change.changed, change.read)]
        return table._replace(function=np.array([len(changes), int(buoyancy is not None), *layers], dtype=np.int64))

    def mode_noise(self, modes: Any, numbers: Any, amplitudes: Any, seed: int, stream: int, layer: int) -> ForceTable:
        flat = np.concatenate(amplitudes)
        return self._on_modes("MODE_NOISE", modes, layer, numbers, flat, NO_NUMBERS, seed=seed, stream=stream)

    def on_matrix_orbit(self, system: Any, factor: float, noise: Noise | None) -> ForceTable:
        integers, numbers, self.keepalive = stream_tables(system)
        blocks = [block for _, block, _ in system.algebra.parts]
        table = ForceTable(
            codes("ForceKind")["ON_MATRIX_ORBIT"],
            *self._work_integrals,
            int(system.complex),
            np.array([factor, *map(adjoint_casimir, blocks)]),
            np.array(numbers, dtype=np.float64),
            np.array([_product_of(system), blas_address("dgemm")], dtype=np.int64),
            begin=np.array(integers, dtype=np.int64),
            direction=blocks_of_rows(system.algebra),
            position=acting_layers(system),
        )
        if noise is None:
            return table
        return table._replace(amplitude=np.array([noise.amplitude]), seed=noise.seed, stream=noise.stream)

    def matrix_noise(
        self, system: Any, elements: NDArray[Any], commuting: bool, seed: int, stream: int, levels: int
    ) -> ForceTable:
        return ForceTable(
            codes("ForceKind")["MATRIX_NOISE"],
            *self._work_integrals,
            int(system.complex),
            NO_NUMBERS,
            NO_NUMBERS,
            _products_of_noise(system, levels),
            amplitude=np.array([float(commuting)]),
            seed=seed,
            stream=stream,
            sets=len(elements),
            direction=np.array([elements.ndim - 2], dtype=np.int64),
            extent=system.algebra.N,
            basis=np.ascontiguousarray(elements).view(np.float64).ravel(),
        )

    def mode_transport(
        self, system: Any, modes: Any, numbers: Any, amplitudes: Any, seed: int, stream: int, levels: int
    ) -> ForceTable:
        table = self._on_modes("MODE_TRANSPORT", modes, 0, numbers, np.concatenate(amplitudes), NO_NUMBERS)
        return table._replace(function=_products_of_noise(system, levels), seed=seed, stream=stream)

    def selective_decay(self, rate: float, system: Any) -> ForceTable:
        if not system.has_matrices:
            return self._table("SELECTIVE_DECAY", rate)
        integers, numbers, self.keepalive = stream_tables(system)
        layers, integers[1] = integers[1], 1
        if system.linear is not None:  # that of the vorticity comes first
            del numbers[system.dim // layers : system.dim]
        integers += [_product_of(system), int(system.complex)]
        return self._table(
            "SELECTIVE_DECAY",
            rate,
            direction=np.array(integers, dtype=np.int64),
            extent=system.algebra.N,
            position=system.dim - system.dim // layers,
            basis=np.array(numbers),
        )

    def _on_modes(
        self, kind: str, modes: Any, layer: int, numbers: Any, rate: Any, aim: Any, **more: Any
    ) -> ForceTable:
        return ForceTable(
            codes("ForceKind")[kind],
            *self._work_integrals,
            codes("ModeKind")[modes.kind],
            rate,
            aim,
            np.zeros(0, dtype=np.int64),
            begin=np.cumsum([0, *map(len, numbers)], dtype=np.int64),
            direction=np.concatenate(numbers).astype(np.int64),
            extent=modes.N,
            position=layer * 2 * modes.N**2,
            basis=modes.table(numbers),
            **more,
        )

    def _compile(self, function: Callable[..., Any], arguments: str, size: int, what: str) -> None:
        self.called, self.arguments = function, arguments
        if self._compiles and is_called_in_python(function):
            if self._beside:
                raise TypeError(f"{what} is called in Python, without tangents")
            adapted = _adapted_arguments(function, arguments, self.n, self._shape)
            self.keepalive = (python_callback(adapted, size, self.n),)
        elif self._compiles and self._beside:
            beside, size = _with_vector(function, arguments, self.n), size + self.n
            self.keepalive = (
                compiled_function(beside, size, 2 * self.n, scalar=False, flat=True, timed=True, what=what),
            )
        elif self._compiles:
            self.keepalive = (compiled_force_function(function, arguments, size, self.n, what, self._shape),)


def _layers_of(system: Any) -> int:
    """Return the number of matrices of a state."""
    return system.matrix_shape[0] if len(system.matrix_shape) == 3 else 1


def _product_of(system: Any) -> int:
    """Return the address of the product of the matrices of a system."""
    return blas_address("zgemm" if system.complex else "dgemm")


def _products_of_noise(system: Any, levels: int) -> NDArray[np.int64]:
    """Return the address of the product, the layers, the levels and the address of the product of real matrices."""
    return np.array([_product_of(system), _layers_of(system), levels, blas_address("dgemm")], dtype=np.int64)


def compiled_force_function(
    function: Callable[..., Any],
    arguments: str,
    size: int,
    results: int,
    what: str,
    shape: tuple[int, ...] | None = None,
) -> CompiledFunction:
    """Compile the function of a force, as a function of `size` numbers and the time; `shape` is that of a matrix."""
    require_packages(f"{what}, a Python function,", "numba")
    adapted, timed = _adapted_arguments(function, arguments, results, shape), arguments != "x"
    return compiled_function(adapted, size, results, scalar=False, flat=True, timed=timed, what=what)


def _adapted_arguments(
    function: Callable[..., Any], arguments: str, n: int, shape: tuple[int, ...] | None
) -> Callable[..., Any]:
    """Return a function of (y) or (y, t) from one with other arguments; `shape` is that of a matrix, if complex."""
    if shape is not None:
        return _adapted_matrix_function(function, arguments, shape[:-1], np.complex128 if shape[-1] else np.float64)
    if arguments in ("x", "x, t"):
        return function

    def of_time(y: Any, t: float) -> Any:
        return function(t)

    def of_flow(y: Any, t: float) -> Any:
        return function(y[:-1], t, y[-1])

    def of_noisy_flow(y: Any, t: float) -> Any:
        return function(y[:n], t, y[n], y[n + 1 :])

    return {"t": of_time, "x, t, tau": of_flow, "x, t, tau, deviates": of_noisy_flow}[arguments]


def _with_vector(function: Callable[..., Any], arguments: str, n: int) -> Callable[..., Any]:
    """Return the function of a force of a state and a vector side by side, whose tangent is a complex step.

    Its other arguments, a duration and deviates, follow them.
    """

    def values(result: Any) -> Any:
        numbers, out = np.asarray(result).ravel(), np.empty(2 * n)
        for i in range(n):
            number = numbers[i] + 0j
            out[i], out[n + i] = number.real, number.imag / COMPLEX_STEP
        return out

    def of_state(y: Any, t: float) -> Any:
        return values(function(y[:n] + COMPLEX_STEP * 1j * y[n:]))

    def of_state_and_time(y: Any, t: float) -> Any:
        return values(function(y[:n] + COMPLEX_STEP * 1j * y[n:], t))

    def of_flow(y: Any, t: float) -> Any:
        return values(function(y[:n] + COMPLEX_STEP * 1j * y[n : 2 * n], t, y[2 * n]))

    def of_noisy_flow(y: Any, t: float) -> Any:
        return values(function(y[:n] + COMPLEX_STEP * 1j * y[n : 2 * n], t, y[2 * n], y[2 * n + 1 :]))

    return {
        "x": of_state,
        "x, t": of_state_and_time,
        "x, t, tau": of_flow,
        "x, t, tau, deviates": of_noisy_flow,
    }[arguments]


class FieldTable(KernelFunction):
    """A table of a field, with the functions that it calls."""

    def raised(self) -> BaseException | None:
        """Return and clear the exception that a function raised, if any."""
        return raised_by(self._held[1])


def field_table(system: Any) -> KernelFunction:
    """Return the field of a system as a table at an address."""
    field, owners = field_of(system)
    structure = as_structure(field)
    return FieldTable(ctypes.addressof(structure), (structure, owners), lambda: (field_table, (system,)))


@lru_cache(maxsize=1024)
def _field_of_energy(system: Any, H: Any) -> KernelFunction:
    """Return the field of another Hamiltonian on a system, which members that have the function share."""
    return field_table(with_hamiltonian(system, H))


def _matrices(system: Any) -> tuple[list[int], list[float], tuple[Any, ...]]:
    """Return the tables for energy and quadratic Casimirs of a system of matrices; a zero for other systems."""
    if not system.has_matrices:
        return [0], [], ()
    integers, numbers, owners = stream_tables(system)
    kind = next(iter(system.algebra.parts))[2]
    integers += [int(system.complex), int(not system.algebra.skew), -1 if kind.conjugate else 1]
    return integers, [system.energy_factor, *numbers], owners


def forced_loop(
    system: Any, inner: Mapping[float, CompiledLoop], fractions: Sequence[float], order: int, representation: Any
) -> CompiledLoop:
    """Return a loop of substeps at fractions of the step, each between half flows of the forces, of an order."""
    work_integrals = work_integrals_of(system)
    described = _tables_of_forces(system, work_integrals, order, {}, system.unforced)
    tables = [table for table, _ in described]
    keepalive = [owner for _, owners in described for owner in owners]
    hamiltonian_part = system.unforced
    casimirs_conserved = hamiltonian_part.has_matrices or all(force.casimirs for force in system.forces)
    watched = watch_tables(hamiltonian_part, {} if casimirs_conserved else system.casimirs)
    called = [inner_loop_integers(one, hamiltonian_part, representation) for one in inner.values()]
    loop_integers = called[0][0]
    structures = [as_structure(table) for table in tables]
    matrices, numbers, owners = _matrices(hamiltonian_part)
    lengths = list(inner)
    integers = [*loop_integers, len(tables), *map(ctypes.addressof, structures), len(called) - 1]
    first_other = len(integers)
    integers += [number for numbers_of_loop, _ in called[1:] for number in numbers_of_loop]
    substeps = [(int(np.float64(c).view(np.int64)), lengths.index(c)) for c in fractions]
    integers += [len(substeps), *(number for pair in substeps for number in pair), *matrices]
    step = named_step_tables(
        hamiltonian_part,
        "forced",
        watched,
        integers,
        representation,
        (*keepalive, *owners, *structures, *(one for _, kept in called for one in kept)),
        numbers,
    )
    recorded = [
        CompiledTables(table, (), partial(_sources_of_force, system, j, force, table))
        for j, ((_, force), table) in enumerate(zip(system.flows, tables, strict=True))
    ]
    places = [INNER_LOOP_INDEX + (first_other + (k - 1) * len(loop_integers) if k else 0) for k in range(len(inner))]
    referenced: dict[int, Any] = dict(zip(places, inner.values(), strict=True))
    referenced |= dict(enumerate(recorded, len(loop_integers) + 1))
    # Members with constants of their own are lanes of one step, in the memory that 32 of them need.
    in_columns = (
        representation is None
        and not hamiltonian_part.has_matrices
        and system.dim <= limit("WIDEST")
        and all(len(table.rate) <= MAX_NUMBERS_IN_LANES for table in tables)
        and all(one.name != STEP_LOOP for one in inner.values())
    )
    return loop_over(STEP_LOOP, step, work_integrals=work_integrals, referenced=referenced, in_columns=in_columns)


def _tables_of_forces(
    system: Any, work_integrals: Sequence[tuple[str, str]], order: int, known: dict[Any, Any], common: Any
) -> list[tuple[ForceTable, tuple[KernelFunction, ...]]]:
    """Return the tables of flows with their functions; of those that do not depend on the energy, by id in `known`, as
    on a `common` system of the same algebra.
    """
    labels, found = [label for label, _ in work_integrals], []
    for k, force in system.flows:
        described = known.get(id(force))
        if described is None:
            plain = system.unforced
            shared = force is system.forces[k] and not force._needs_energy(plain)
            first, count = labels.index(system.labels[k]), labels.count(system.labels[k])
            reader = _ForceTableBuilder(common if shared else plain, first, count, order)
            described = force.describe_to(reader, common if shared else plain), reader.keepalive
            if shared:
                known[id(force)] = described
        found.append(described)
    return found


def flow_table(system: Any, j: int, order: int) -> ForceTable:
    """Return the table of the flow j of a system in schemes of an order, without its functions."""
    reader = _ForceTableBuilder(system.unforced, 0, 0, order, compiles=False)
    table: ForceTable = system.flows[j][1].describe_to(reader, system.unforced)
    return table


def law_of_flow(system: Any, j: int, order: int) -> Any:
    """Return the function of the flow j with its derivatives, a `TracedLaw` or of JAX; TracingError if impossible."""
    reader = _ForceTableBuilder(system.unforced, 0, 0, order, compiles=False)
    system.flows[j][1].describe_to(reader, system.unforced)
    if (known := getattr(reader.called, "law", None)) is not None:
        return known()
    if reader.called is None or is_called_in_python(reader.called) or "deviates" in reader.arguments:
        raise TracingError("it is called in Python, or takes deviates")
    adapted, n = _adapted_arguments(reader.called, reader.arguments, system.dim, None), system.dim
    return traced_law(adapted, n + ("tau" in reader.arguments), n, reader.arguments != "x")


def compiled_flow(
    system: Any, j: int, order: int, beside: bool = False
) -> tuple[ForceTable, tuple[KernelFunction, ...]] | None:
    """Return the table of the flow j and its function, if it is `beside` of a state and a vector side by side.

    None if the function cannot be compiled, which then must take complex numbers.
    """
    if beside and system.has_matrices:
        return None
    reader = _ForceTableBuilder(system.unforced, 0, 0, order, beside=beside)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of functions that the user did not give
            table: ForceTable = system.flows[j][1].describe_to(reader, system.unforced)
    except TypeError:
        return None
    return table, reader.keepalive


NUMBERS = ("rate", "aim", "function", "amplitude", "turning", "basis")
"""Fields of the table of a force that may differ between members that share its structure."""
STRUCTURAL = [k for k, name in enumerate(ForceTable._fields) if name not in NUMBERS]
MAX_NUMBERS_IN_LANES = 4096
"""Entries of the matrix of a damping, of which members with their own, as lanes, need some megabytes."""
SPACING = 2**40
"""Distance between the first numbers of the tables of two forces, as sources."""


def _numbers_in(system: Any, flow: int, table: ForceTable) -> dict[str, NDArray[np.int64]]:
    """Return the sources of the numbers in the table of a flow: those of constant torques come first."""
    first, k = CoefficientNumbers.of(system.unforced.hamiltonian.terms()).size, system.flows[flow][0]
    if table.kind == codes("ForceKind")["CONSTANT"]:
        return {"aim": first + k * system.dim + np.arange(system.dim)}
    sizes = [len(getattr(table, name)) for name in NUMBERS]
    starts = first + len(system.forces) * system.dim + flow * SPACING + np.cumsum([0, *sizes])
    return {name: start + np.arange(size) for name, start, size in zip(NUMBERS, starts, sizes, strict=False)}


def _sources_of_force(system: Any, flow: int, force: Force, table: ForceTable) -> Sources:
    """Return the sources of a flow: its numbers, and the linear coefficients of H that its function contains."""
    multiples = {
        name: Multiples(np.arange(len(numbers)), numbers, np.ones(len(numbers)))
        for name, numbers in _numbers_in(system, flow, table).items()
    }
    if not len(table.function) or not force._needs_energy(system.unforced):
        return Sources(multiples)
    energy = CoefficientNumbers.of(system.unforced.hamiltonian.terms())
    contained = np.array(linear_coefficients_in(force, system.unforced), dtype=np.int64)
    numbers = np.concatenate([energy.of_coordinates(contained), *energy.constants.values()])
    return Sources(multiples, computed={"function": numbers})


def with_forces(stack: SystemStack, order: int) -> list[SystemStack]:
    """Return stacks of systems with forces by the structure of their tables, with the numbers that differ."""
    known, work_integrals = dict[Any, Any](), work_integrals_of(stack.first)
    groups: dict[Hashable, list[int]] = {}
    tables: dict[int, list[Any]] = {}
    for column, m in enumerate(stack.numbers.tolist()):
        with suppress(TypeError, ValueError):  # raised again, with the number of the member
            tables[column] = _tables_of_forces(stack.systems[m], work_integrals, order, known, stack.first.unforced)
            groups.setdefault(tuple(_structure_of_force(table) for table, _ in tables[column]), []).append(column)
    return [_with_numbers(stack.take(np.array(columns)), [tables[c] for c in columns]) for columns in groups.values()]


def _structure_of_force(table: ForceTable) -> Hashable:
    """Return what members that share the structure of a table have in common."""
    common = [table[k] for k in STRUCTURAL]
    if table.kind == codes("ForceKind")["HAMILTONIAN_NOISE"]:
        common.append(table.aim)  # numbers of midpoint rules
    sizes = [len(getattr(table, name)) for name in NUMBERS]
    return *sizes, *(one.tobytes() if isinstance(one, np.ndarray) else one for one in common)


def _with_numbers(stack: SystemStack, members: list[Any]) -> SystemStack:
    """Return a stack with the numbers in tables of forces that differ between its members."""
    rows, values, system = [np.arange(0)], [np.zeros((0, stack.size))], stack.first
    for j in range(len(members[0])):
        tables = [described[j][0] for described in members]
        if all(table is tables[0] for table in tables):
            continue
        for name, numbers in _numbers_in(system, j, tables[0]).items():
            columns = [getattr(table, name).view(np.float64) for table in tables]
            found = np.ascontiguousarray(np.stack(columns, axis=1))
            differ = different(found)
            rows.append(numbers[differ])
            values.append(found[differ])
    owners = np.empty(stack.size, dtype=object)
    owners[:] = [tuple(owner for _, kept in described for owner in kept) for described in members]
    return stack._replace(rows=np.concatenate(rows), forces=np.concatenate(values), owners=owners)


def linear_coefficients_in(force: Force, system: Any) -> list[int]:
    """Return the coordinates of the linear term of H whose coefficients the compiled function of a force contains."""
    if not force._needs_energy(system) or not len(CoefficientNumbers.of(system.hamiltonian.terms()).number):
        return []
    n = system.dim

    def key_at(linear: NDArray[np.float64]) -> Any:
        reader = _ForceTableBuilder(system, 0, 0, 2, compiles=False)
        force.describe_to(reader, with_linear(system, linear))
        return None if reader.called is None else compilation_key(reader.called)

    try:
        linear = linear_of(system.hamiltonian)
        moved = 2.0 * linear + 1.0 + np.arange(n)
        own = key_at(linear)
        if own == key_at(moved):
            return []
        return [k for k in range(n) if key_at(np.where(np.arange(n) == k, moved, linear)) != own]
    except (TypeError, ValueError):
        return list(range(n))  # the terms cannot be told apart

"""Tables of the flows of forces that are differentiated by the kernels."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.functions.compiled_functions import compiled_function, python_callback
from coadjoint.kernels.interface import codes
from coadjoint.kernels.tables.compiled import addresses_by_coefficients, addresses_of, as_structure
from coadjoint.kernels.tables.field import terms_of_field
from coadjoint.kernels.tables.forces import compiled_flow, flow_table, law_of_flow
from coadjoint.kernels.tables.steps import stream_numbers
from coadjoint.program.added_part import terms_of
from coadjoint.program.sources import NO_MULTIPLES, Multiples, concatenated
from coadjoint.program.term_table import Terms, TermTable
from coadjoint.systems.coefficients import with_hamiltonian
from coadjoint.systems.energy_derivatives import EnergyDerivative
from coadjoint.systems.hamiltonians.traced_function import TracingError
from coadjoint.systems.user_functions import is_called_in_python

Floats = NDArray[np.float64]
NO_ADDRESSES = np.zeros(0, dtype=np.int64)


class ForceDerivatives(NamedTuple):
    """How the kernels differentiate the flow of a force; see `source/boundary/tables.hpp`."""

    kind: int
    first: int
    own: int
    shape: int
    matrix: Floats
    along: int
    hessians: NDArray[np.int64]
    added: Terms
    functions: NDArray[np.int64]
    function: int
    depends: bool
    moved: int
    nearby: NDArray[np.int64]
    distance: Floats
    numbered: NDArray[np.int64]


class ForcedDerivatives(NamedTuple):
    """Steps with forces that are differentiated; see `source/boundary/tables.hpp`."""

    forced: int
    inner: NDArray[np.int64]
    flows: NDArray[np.int64]
    inner_coefficients: int
    called: int
    coefficients: int
    casimirs: int
    factors: Floats
    turning: Floats
    apart: bool = False
    members: NDArray[np.int64] = NO_ADDRESSES
    stride: int = 0


class FlowCoefficients(NamedTuple):
    """How a flow is differentiated, its `own` coefficients from `first` on, and what they are of `entries`.

    `covered` are the numbers of the entries by which it is differentiated by these coefficients: of those that are
    `moved`, with a coefficient each behind the others, by differences of flows, and of those that are `rounded`, by
    differences of the coefficients. `energy` is the derivative of H by entries, and `law` has the derivatives of the
    function of a torque, the number of its coefficients, and whether it takes the time.
    """

    kind: str
    first: int
    own: int = 0
    covered: frozenset[int] = frozenset()
    multiples: Multiples = NO_MULTIPLES
    energy: EnergyDerivative | None = None
    law: tuple[Callable[..., Any], Callable[..., Any], int, bool] | None = None
    moved: tuple[int, ...] = ()
    rounded: frozenset[int] = frozenset()
    in_python: bool = True

    def of_entries(self, entries: Mapping[int, int]) -> Multiples:
        """Return the multiples of some entries, by number, with their numbers in a parameter."""
        chosen = self.multiples.take(np.isin(self.multiples.number, list(entries)))
        return chosen._replace(number=np.array([entries[k] for k in chosen.number.tolist()], dtype=np.int64))


# Kinds of flows x -> E x + b.
AFFINE_KINDS = ("DAMPING", "CONSTANT", "OF_TIME", "MODE_RATES", "MODE_NOISE", "KICKS")
# Numbers in the tables of flows by which these are differentiated.
COEFFICIENTS = {
    "DAMPING": ("rate", "aim"),
    "CONSTANT": ("aim",),
    "KICKS": ("rate",),
    "HAMILTONIAN_NOISE": ("rate",),
    "MATRIX_NOISE": ("basis",),
    "MODE_TRANSPORT": ("rate",),
}
ORDER_OF_LAWS = 2  # of schemes with one step of the classical Runge-Kutta method
# By how much derivatives of the numbers of a table, relative to the largest one or to 1, may differ from whole ones,
# which they are by numbers of the user.
ROUNDING = 1e-6


def flow_coefficients(system: Any, j: int, entries: Sequence[Any], order: int, first: int) -> FlowCoefficients:
    """Return the coefficients of the flow j of a system, which follow `first` other ones."""
    force, plain = system.flows[j][1], system.unforced
    using = [number for number, entry in enumerate(entries) if j in entry.flows]
    in_python = FlowCoefficients("IN_PYTHON", first)
    table = flow_table(system, j, order)
    kind = {code: name for name, code in codes("ForceKind").items()}[table.kind]
    found = in_python
    if kind in AFFINE_KINDS:
        found = FlowCoefficients("AFFINE", first)
    elif kind in ("OF_STATE", "BY_FLOW") and not table.extent and (law := _of_law(system, j, entries, first)):
        found = law
    elif kind in ("OF_STATE", "BY_FLOW"):
        found = (
            FlowCoefficients("ALONG", first) if compiled_flow(system, j, order, beside=True) is not None else in_python
        )
    elif kind == "ON_ORBIT" and all(term.differentiable for term in plain.hamiltonian.terms()):
        found = _on_orbit(system, j, entries, using, first, 3 if table.extent else 2)
    elif kind == "ON_MATRIX_ORBIT":
        found = _on_orbit(system, j, entries, using, first, 2)
    elif kind == "HAMILTONIAN_NOISE" and all(one.differentiable for H in _energies(force, plain) for one in H.terms()):
        found = FlowCoefficients("ON_ORBIT", first)
    elif kind in ("MATRIX_NOISE", "MODE_TRANSPORT"):
        found = FlowCoefficients("ON_ORBIT", first)
    elif kind == "SELECTIVE_DECAY" and (
        plain.has_matrices or all(term.differentiable for term in plain.hamiltonian.terms())
    ):
        found = _on_orbit(system, j, entries, using, first, 1)
    names = COEFFICIENTS.get(kind, ())
    if kind == "DAMPING" and table.amplitude.any():
        names = (*names, "basis")
    # Squares of which functions consist have the strength of a noise in them.
    if names and using and found is not in_python and not (kind == "HAMILTONIAN_NOISE" and (table.aim < 0.0).any()):
        found = _of_numbers(system, j, order, names, entries, found)
    if found.kind == "IN_PYTHON" and not plain.has_matrices:
        return found
    moved = [
        number
        for number in using
        if number not in found.covered
        # On orbits tables of vectors contain the field of the unchanged energy.
        and (found.kind != "ON_ORBIT" or entries[number].field or plain.has_matrices)
        and _moved_flows(system, j, entries[number], order) is not None
    ]
    places = [(first + found.own + k, number, 1.0) for k, number in enumerate(moved)]
    covered = found.covered.union(moved)
    return found._replace(
        moved=tuple(moved),
        covered=covered,
        multiples=concatenated([found.multiples, Multiples.of_triplets(places)]),
        in_python=found.kind == "IN_PYTHON" or not covered.issuperset(using),
    )


def _energies(force: Any, plain: Any) -> list[Any]:
    """Return the functions in the terms of a Hamiltonian noise, those of each in their order, each once."""
    found = {
        k: H for term in force.terms(plain).terms for k, H in zip(term.indices.tolist(), term.energies, strict=False)
    }
    return list(found.values())


def _of_numbers(
    system: Any, j: int, order: int, names: Sequence[str], entries: Sequence[Any], found: FlowCoefficients
) -> FlowCoefficients:
    """Return the coefficients of a flow that are numbers in its table, with their derivatives by entries."""

    def numbers_of(one: Any) -> Floats:
        own = flow_table(one, j, order)
        return np.concatenate([getattr(own, name) for name in names])

    numbers = numbers_of(system)

    def as_many(one: Any) -> Floats:
        other = numbers_of(one)
        if len(other) != len(numbers):
            raise TracingError("coefficients that are zero are not in its table")
        return other

    return _with_numbers(found, j, numbers, as_many, entries)


def _with_numbers(
    found: FlowCoefficients, j: int, numbers: Floats, numbers_of: Callable[[Any], Floats], entries: Sequence[Any]
) -> FlowCoefficients:
    """Return the coefficients of a flow that are some numbers, differentiated by the entries on which these depend."""
    triplets, covered, rounded = list[tuple[int, int, float]](), set[int](), set[int]()
    for number, entry in enumerate(entries):
        if j not in entry.flows:
            continue
        try:
            change = entry.nearby.difference(numbers_of, numbers)
        except TracingError:
            continue
        covered.add(number)
        whole = np.round(change)
        if np.max(np.abs(change - whole), initial=0.0) <= ROUNDING * min(1.0, np.max(np.abs(change), initial=0.0)):
            change = whole
        else:
            rounded.add(number)
        triplets += [(found.first + k, number, float(change[k])) for k in np.flatnonzero(change).tolist()]
    return found._replace(
        own=len(numbers),
        covered=frozenset(covered),
        rounded=frozenset(rounded),
        multiples=Multiples.of_triplets(triplets),
    )


def _of_law(system: Any, j: int, entries: Sequence[Any], first: int) -> FlowCoefficients | None:
    """Return the coefficients of a torque whose operations are known: the numbers that change; None for others."""
    if system.has_matrices:
        return None
    try:
        law = law_of_flow(system, j, ORDER_OF_LAWS)
        form = law.form()

        def numbers_of(one: Any) -> Floats:
            other = law_of_flow(one, j, ORDER_OF_LAWS)
            if other.form() != form:
                raise TracingError("its operations depend on parameters")
            return other.numbers

        found = _with_numbers(FlowCoefficients("ALONG", first), j, law.numbers, numbers_of, entries)
        moving = np.unique(found.multiples.position - first)
        pulled, pushed = law.derivatives(moving.tolist())
    except TracingError:
        return None
    place = np.searchsorted(moving, found.multiples.position - first)
    return found._replace(
        own=len(moving),
        multiples=found.multiples._replace(position=first + place),
        law=(pulled, pushed, len(moving), law.timed),
    )


def _on_orbit(
    system: Any, j: int, entries: Sequence[Any], using: Sequence[int], first: int, kinds: int
) -> FlowCoefficients:
    """Return the coefficients of a damping on orbits: `kinds`, of several by coordinate of vectors, and those of H."""
    n, known = 1 if kinds == 1 or system.has_matrices else system.dim, system.flows[j][1].scalings(system.unforced)
    triplets, covered = list[tuple[int, int, float]](), set[int]()
    energies: dict[str, EnergyDerivative] = {}
    for number in using:
        entry = entries[number]
        if entry.energy is not None and not system.has_matrices:
            energies[entry.name] = entry.energy
            covered.add(number)
        elif entry.field in known:
            covered.add(number)
            for start, factor in zip(range(first, first + n * kinds, n), known[entry.field], strict=True):
                values = np.broadcast_to(factor if np.ndim(factor) < 2 else factor[entry.entry], n)
                triplets += [(start + i, number, float(values[i])) for i in np.flatnonzero(values).tolist()]
    if system.has_matrices:
        return FlowCoefficients("ON_ORBIT", first, kinds * n, frozenset(covered), Multiples.of_triplets(triplets))
    apart = {name: one.apart for name, one in energies.items()}
    joined = EnergyDerivative.joined(list(apart.values()))
    added, of_monomials = terms_of(joined, system.dim)
    multiples = [Multiples.of_triplets(triplets)]
    for name, one in of_monomials.split({name: energy.size for name, energy in apart.items()}).items():
        of_energy = one.of_energy(energies[name])
        numbers = {entries[number].entry: number for number in using if entries[number].name == name}
        renumbered = np.array([numbers[k] for k in of_energy.number.tolist()], dtype=np.int64)
        multiples.append(Multiples(first + kinds * n + of_energy.position, renumbered, of_energy.factor))
    count = kinds * n + len(added.offset) + len(added.weight) + len(added.coefficient)
    return FlowCoefficients("ON_ORBIT", first, count, frozenset(covered), concatenated(multiples), joined)


def _moved_flows(system: Any, j: int, entry: Any, order: int) -> tuple[float, list[Any]] | None:
    """Return a distance and the tables of the flow j of systems with a moved entry; None without some of them."""
    own = flow_table(system, j, order)
    # Gradients of a stream are differentiated in the kernels, and flows with a test of what they find.
    of_stream = own.kind == codes("ForceKind")["SELECTIVE_DECAY"] and system.has_matrices
    nodes = entry.nearby.nodes((lambda one: stream_numbers(one.unforced)) if of_stream else None)
    if nodes is None:
        return None
    found = [compiled_flow(one, j, order) for one in nodes[1]]
    if any(one is None or one[0].kind != own.kind for one in found):
        return None
    return nodes[0], found


def flow_derivatives(
    system: Any,
    j: int,
    flow: FlowCoefficients,
    entries: Sequence[Any],
    lengths: Sequence[float],
    order: int,
    depends: bool,
    function: int,
) -> tuple[ForceDerivatives, Any]:
    """Return the table of the derivatives of a flow in substeps of these lengths, and the owners of its functions.

    It `depends` on entries by which the `function` in Python, at an address, differentiates it.
    """
    plain, along, owners = system.unforced, 0, tuple[Any, ...]()
    matrix, shape, hessians, functions = np.zeros(len(lengths)), "MULTIPLE", NO_ADDRESSES, NO_ADDRESSES
    added = TermTable().table(float)
    force = system.flows[j][1]
    # The kernels have the matrix of a noise, and of modes without a buoyancy, from its table.
    on_modes = flow_table(system, j, order).kind == codes("ForceKind")["MODE_RATES"]
    in_table = force.random or (on_modes and plain.buoyancy is None)
    if flow.kind == "AFFINE" and not in_table:
        tangents = [_tangent(force, plain, 0.5 * length) for length in lengths]
        shape = ("MULTIPLE", "DIAGONAL", "FULL")[tangents[0].ndim]
        unit = np.eye(system.dim) if shape == "FULL" else 1.0
        matrix = np.concatenate([np.ravel(one - unit) for one in tangents])
    elif flow.law is not None:
        n, what = system.dim, "the derivative of a force"
        pulled, pushed, own, timed = flow.law
        size = 2 * n + (flow_table(system, j, order).kind == codes("ForceKind")["BY_FLOW"])
        sizes = ((pulled, size, n + own), (pushed, size + own, n))
        kept_laws = [
            python_callback(one, size, results)
            if is_called_in_python(one)
            else compiled_function(one, size, results, scalar=False, flat=True, timed=timed, what=what)
            for one, size, results in sizes
        ]
        functions, owners = np.array([one.address for one in kept_laws], dtype=np.int64), tuple(kept_laws)
    elif flow.kind == "ALONG":
        beside = compiled_flow(system, j, order, beside=True)
        assert beside is not None
        structure = as_structure(beside[0])
        along, owners = ctypes.addressof(structure), (structure, *beside[1])
    elif flow.kind == "ON_ORBIT" and flow.energy is None and not plain.has_matrices:
        each = [terms_of_field(with_hamiltonian(plain, H)) for H in _energies(force, plain)]
        compiled = [addresses_of(terms.functions, len(terms), "hessian", force.label) for terms in each]
        hessians = np.concatenate([NO_ADDRESSES, *(addresses for addresses, _ in compiled)])
        owners = tuple(kept for _, kept in compiled)
    elif flow.kind == "ON_ORBIT" and flow.energy is not None:
        terms = terms_of_field(plain)
        hessians, owners = addresses_of(terms.functions, len(terms), "hessian", "the Hamiltonian")
        added, _ = terms_of(flow.energy, system.dim)
        functions, others = addresses_by_coefficients(flow.energy.functions, added.size)
        owners = (*owners, *others)
    nearby, distances, kept = list[Any](), list[float](), list[Any]()
    for number in flow.moved:
        found = _moved_flows(system, j, entries[number], order)
        assert found is not None
        distances.append(found[0])
        nearby += [as_structure(one[0]) for one in found[1]]
        kept += [one[1] for one in found[1]]
    table = ForceDerivatives(
        kind=codes("FlowDerivative")[flow.kind],
        first=flow.first,
        own=flow.own,
        shape=codes("Shape")[shape],
        matrix=matrix,
        along=along,
        hessians=hessians,
        added=added,
        functions=functions,
        function=function,
        depends=depends,
        moved=len(flow.moved),
        nearby=np.array([ctypes.addressof(one) for one in nearby], dtype=np.int64),
        distance=np.array(distances),
        numbered=np.array(flow.moved, dtype=np.int64),
    )
    return table, (*owners, nearby, kept)


def _tangent(force: Any, plain: Any, tau: float) -> Floats:
    """Return the derivative of an affine flow, which is that at any state and time."""
    known = force.tangent(plain, np.zeros(plain.dim), 0.0, tau)
    return np.asarray(1.0 if known is None else known, dtype=np.float64)

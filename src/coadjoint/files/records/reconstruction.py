"""Reconstruction of systems from records; errors name the damaged entry."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping, Sequence
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.numbers import Constant
from coadjoint.algebra.families.matrix_algebra import MAX_MATRIX_SIZE, SUM, MatrixAlgebra
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.algebra.polynomials.formula_tree import MAX_CHARACTERS, names_in
from coadjoint.algebra.polynomials.formulas import add_term, parse_polynomial
from coadjoint.algebra.polynomials.monomials import Exponents
from coadjoint.algebra.polynomials.polynomial import MAX_DEGREE, Polynomial, SparseMonomials, SparsePolynomial
from coadjoint.files.records.entries import CASIMIR, EXACT, INTEGRAL, Entry, as_value_errors, parsed
from coadjoint.memory import check_available_memory
from coadjoint.runs.events import Event
from coadjoint.short_repr import short
from coadjoint.systems.batch import Axis, Batch, axis_coordinates, check_axis_name
from coadjoint.systems.coefficients import with_linear
from coadjoint.systems.coordinates import coordinates_of
from coadjoint.systems.fluids.carried_fields import TwoLayerSystem
from coadjoint.systems.forces import registry as described
from coadjoint.systems.hamiltonians.hamiltonian import Hamiltonian
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.hamiltonians.split_hamiltonian import SplitHamiltonian
from coadjoint.systems.hamiltonians.summable import SeparatePolynomial
from coadjoint.systems.hamiltonians.user_hamiltonian import ParsedFunction
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.matrices.matrix_system import MAX_POWERS, MatrixSystem
from coadjoint.systems.matrices.streams import Circulants, DiagonalSolve, Inverse, Weights
from coadjoint.systems.system import System
from coadjoint.validation import from_description, read_integer

Axes = dict[str, Axis]

MATRIX_KEYS = ("name", "matrices", "layers", "stream", "second_stream", "linear", "energy_sign", "powers", "not_stored")

BYTES_PER_MEMBER = 100  # of a batch; a reference and its start


def system_of(entry: Entry, dim: int | None = None) -> System | Batch:
    """Rebuild the system of a record of `record_of`, of dimension `dim` if given, without non-polynomial invariants."""
    if "members" not in entry:
        return _system_of(entry, dim)
    entry.reject_unknown("name", "members", "repeated", "axes", "not_stored")
    members = [_system_of(member, dim) for member in entry["members"].entries()]
    if "repeated" in entry:
        pairs = [pair.entries(2) for pair in entry["repeated"].entries()]
        runs = [(number.integer(0, len(members) - 1), count.integer(1)) for number, count in pairs]
        check_available_memory(BYTES_PER_MEMBER * sum(count for _, count in runs), "the members of the stored batch")
        members = [members[number] for number, count in runs for _ in range(count)]
    axes = entry.optional("axes", lambda record: axes_of_record(record, len(members)))
    with as_value_errors(entry["members"]):
        return Batch(members, axes or {})


def axes_of_record(record: Entry, members: int) -> Axes:
    """Return the axes of a record; ValueError unless they have as many combinations as members."""
    axes: Axes = {}
    for entry in record.entries():
        name, length, values = entry.entries(3)
        with as_value_errors(name):
            check_axis_name(name.text(), axes)
        count = length.integer(1)
        array = None if values.value is None else axis_coordinates([value.plain() for value in values.entries(count)])
        if values.value is not None and array is None:
            raise values.invalid_error("a list of numbers or text, or null")
        axes[name.text()] = Axis(count, array)
    if axes and prod(axis.length for axis in axes.values()) != members:
        raise record.invalid_error(f"axes with {members} combinations")
    return axes


def _system_of(record: Entry, dim: int | None) -> System:
    if "forces" not in record:
        return _unforced_system_of(record, dim)
    record.reject_unknown("name", "forces", "system", "not_stored")
    _check_stored(record, record["name"].text())
    forces = []
    for force in record["forces"].entries():
        with as_value_errors(force):
            forces.append(from_description("force", described.kinds(), force.plain()))
    system = _unforced_system_of(record["system"], dim)
    with as_value_errors(record["forces"]):
        return system.with_forces(*forces)


def _unforced_system_of(record: Entry, dim: int | None) -> Any:
    name = record["name"].text()
    if "parameters" in record:
        record.reject_unknown("name", "parameters", "linear")
        parameters = record["parameters"].plain_table()
        with as_value_errors(record["parameters"]):
            system = importlib.import_module("coadjoint.systems").get(name, **parameters)
        _check_dimension(record, system.dim, dim)
        linear = record.optional("linear", lambda entry: entry.numbers(system.dim))
        with as_value_errors(record):
            return system if linear is None else with_linear(system, linear)
    _check_stored(record, name)
    if "matrices" in record:
        matrices = matrix_system_of(record)
        _check_dimension(record, matrices.dim, dim)
        return matrices
    record.reject_unknown(
        "name", "sign", "algebra", "hamiltonian", "casimirs", "integrals", "representation", "layout", "not_stored"
    )
    algebra = _algebra_of(record["algebra"], dim)
    hamiltonian = _hamiltonian_of(record["hamiltonian"], algebra.dim)
    casimirs = invariants_of(record["casimirs"], algebra.dim)
    integrals = record.optional("integrals", lambda entry: invariants_of(entry, algebra.dim))
    representation = record.optional("representation", lambda entry: _matrices_of(entry, algebra.dim))
    layout = record.optional("layout", Entry.plain_table)
    sign = record["sign"].integer(-1, 1)
    with as_value_errors(record):
        return LiePoissonSystem(
            algebra,
            hamiltonian,
            sign=sign,
            casimirs=casimirs,
            representation=representation,
            name=name,
            integrals=integrals,
            layout=layout,
        )


def _check_stored(record: Entry, name: str) -> None:
    """Reject a record of a system whose motion depends on functions."""
    missing = record.optional("not_stored", Entry.texts) or []
    required = [what for what in missing if not what.startswith((CASIMIR, EXACT, INTEGRAL))]
    if required:
        raise ValueError(
            f"{short(name)[1:-1]} cannot be rebuilt from its record, since functions are not stored "
            f"({short(', '.join(required), 200)[1:-1]}); make the system in Python, and give it as `system` to load or "
            "open_archive, or to integrate"
        )


def _check_dimension(record: Entry, dim: int, expected: int | None) -> None:
    if expected is not None and dim != expected:
        raise ValueError(f"{record.path} has dimension {dim}, but the stored states have dimension {expected}")


def _algebra_of(record: Entry, expected: int | None) -> LieAlgebra:
    record.reject_unknown("name", "dim", "basis", "constants", "representation", "casimirs")
    dim = record["dim"].integer(1)
    _check_dimension(record, dim, expected)
    basis = record["basis"].texts(dim)
    constants = record["constants"].rows(dim, dim, dim)
    name = None if record["name"].value is None else record["name"].text()
    representation = record.optional("representation", lambda entry: _matrices_of(entry, dim))
    casimirs = record.optional("casimirs", lambda entry: invariants_of(entry, dim))
    with as_value_errors(record):
        return LieAlgebra(
            constants,
            dim=dim,
            basis=basis,
            name=name,
            representation=representation,
            casimirs=casimirs,
        )


def _matrices_of(record: Entry, dim: int) -> NDArray[np.float64]:
    size = record.reject_unknown("size", "entries")["size"].integer(1)
    with as_value_errors(record):
        check_available_memory(8 * dim * size**2, "a representation")
        matrices = np.zeros((dim, size, size))
    *indices, values = record["entries"].rows(dim, size, size).T
    matrices[tuple(index.astype(np.int64) for index in indices)] = values
    return matrices


def invariants_of(record: Entry, dim: int) -> dict[str, Any]:
    """Return polynomials, quadratic forms and formulas by name."""
    return {
        name: _form_of(entry, dim) if entry.is_table else _polynomial_of(entry, dim)
        for name, entry in record.table().items()
    }


def _form_of(record: Entry, dim: int) -> Any:
    form: Any = _hamiltonian_of(record, dim)
    with as_value_errors(record):
        return Quadratic.from_polynomial(form) if isinstance(form, Polynomial) and form.degree < 3 else form


def _polynomial_of(record: Entry, dim: int) -> Polynomial:
    monomials = {}
    for term in record.entries():
        coefficient, exponents = term.entries(2)
        powers = tuple(exponents.integers(MAX_DEGREE, dim))
        if sum(powers) > MAX_DEGREE or powers in monomials:
            raise exponents.invalid_error(f"of a degree up to {MAX_DEGREE}, and in no other term")
        monomials[powers] = coefficient.exact()
    with as_value_errors(record):
        return Polynomial(monomials, dim=dim)


def _hamiltonian_of(record: Entry, dim: int) -> Any:
    kind = record["kind"].text()
    if kind not in HAMILTONIANS:
        raise record["kind"].invalid_error(", ".join(map(repr, HAMILTONIANS)))
    if kind not in ("split", "sum") and record["dim"].integer(1) != dim:
        raise record["dim"].invalid_error(f"{dim}, the number of its coordinates")
    return HAMILTONIANS[kind](record, dim)


def _function_of(record: Entry, dim: int) -> Hamiltonian:
    record.reject_unknown("kind", "dim", "text", "names", "parameters", "factors")
    names = record["names"]
    words = None if names.value is None else names.texts(dim)
    parameters = {name: value.exact() for name, value in record["parameters"].table().items()}
    text, factors = record["text"].text(MAX_CHARACTERS), [factor.exact() for factor in record["factors"].entries()]
    with as_value_errors(record):
        H = Hamiltonian(ParsedFunction(text, dim, words, parameters)).bind(dim)
        for factor in factors:
            H = H.times(factor)
        return H


def _split_of(record: Entry, dim: int) -> SplitHamiltonian:
    pieces = []
    for piece in record.reject_unknown("kind", "pieces")["pieces"].entries():
        coordinates, inner = piece.entries(2)
        chosen = coordinates.integers(dim - 1)
        pieces.append((chosen, _hamiltonian_of(inner, len(chosen))))
    with as_value_errors(record):
        return SplitHamiltonian(pieces)


def _sum_of(record: Entry, dim: int) -> Any:
    entries = record.reject_unknown("kind", "summands")["summands"]
    summands = [_hamiltonian_of(summand, dim) for summand in entries.entries()]
    if not summands:
        raise entries.invalid_error("a list of at least one Hamiltonian")
    with as_value_errors(record):
        return sum(summands[1:], summands[0])


def _quadratic_of(record: Entry, dim: int) -> Quadratic:
    from scipy.sparse import coo_array

    record.reject_unknown("kind", "dim", "M", "linear", "constant")
    upper = record["M"].rows(dim, dim)
    indices = upper[:, :2].astype(np.int64)
    if len(np.unique(indices, axis=0)) < len(indices) or (indices[:, 0] > indices[:, 1]).any():
        raise record["M"].invalid_error("rows (i, j, value) with i up to j, each pair once")
    mirrored = indices[indices[:, 0] < indices[:, 1]][:, ::-1]
    (rows, columns), values = np.concatenate([indices, mirrored]).T, upper[:, 2]
    linear, constant = record["linear"].numbers(dim), record["constant"].exact()
    with as_value_errors(record):
        values = np.concatenate([values, values[indices[:, 0] < indices[:, 1]]])
        return Quadratic(coo_array((values, (rows, columns)), shape=(dim, dim)), linear=linear, constant=constant)


def _sparse_polynomial_of(record: Entry, dim: int) -> SeparatePolynomial:
    monomials: SparseMonomials = {}
    for term in record.reject_unknown("kind", "dim", "monomials")["monomials"].entries():
        coefficient, factors = term.entries(2)
        pairs = [pair.integers(max(dim - 1, MAX_DEGREE), 2) for pair in factors.entries()]
        key = tuple((k, e) for k, e in pairs)
        coordinates = [k for k, _ in key]
        is_valid = coordinates == sorted({*coordinates}) and max(coordinates, default=0) < dim
        if not is_valid or not all(e for _, e in key) or sum(e for _, e in key) > MAX_DEGREE or key in monomials:
            raise factors.invalid_error(f"ascending coordinates with exponents, of a degree up to {MAX_DEGREE}, once")
        monomials[key] = coefficient.exact()
    with as_value_errors(record):
        return SeparatePolynomial(SparsePolynomial(monomials, dim))


HAMILTONIANS: Mapping[str, Callable[[Entry, int], Any]] = {
    "polynomial": lambda record, dim: _polynomial_of(
        record.reject_unknown("kind", "dim", "monomials")["monomials"], dim
    ),
    "sparse polynomial": _sparse_polynomial_of,
    "quadratic": _quadratic_of,
    "formula": _function_of,
    "split": _split_of,
    "sum": _sum_of,
}
"""Kind of a Hamiltonian -> the function that rebuilds it."""


def matrix_system_of(record: Entry) -> MatrixSystem:
    """Rebuild the matrix system of a record; ValueError if the record is damaged."""
    algebra = _matrix_algebra_of(record.reject_unknown(*MATRIX_KEYS)["matrices"])
    with as_value_errors(record):
        check_available_memory(300 * algebra.N**2, f"matrices of {algebra}")
    stream = _stream_of(record["stream"], algebra.N)
    linear = record.optional("linear", lambda entry: _matrix_of(entry, algebra))
    sign, powers, name = record["energy_sign"].integer(-1, 1), record["powers"].integer(0, MAX_POWERS), record["name"]
    if "layers" in record:
        record["layers"].integer(2, 2)
        second = record.optional("second_stream", lambda entry: _stream_of(entry, algebra.N))
        with as_value_errors(record):
            return TwoLayerSystem(algebra, stream, second, energy_sign=sign, name=name.text(), powers=powers)
    with as_value_errors(record):
        return MatrixSystem(algebra, stream, linear=linear, energy_sign=sign, name=name.text(), powers=powers)


def _matrix_algebra_of(record: Entry) -> MatrixAlgebra:
    if "blocks" in record:
        blocks = [_matrix_algebra_of(block) for block in record.reject_unknown("blocks")["blocks"].entries()]
        with as_value_errors(record):
            return MatrixAlgebra.sum(*blocks)
    record.reject_unknown("kind", "N", "q")
    kind, N, q = record["kind"].text(), record["N"].integer(2, MAX_MATRIX_SIZE), record["q"].integer(0, MAX_MATRIX_SIZE)
    with as_value_errors(record):
        if kind == SUM:
            raise ValueError("a sum has blocks")
        return MatrixAlgebra(kind, N, q)


def _stream_of(record: Entry, N: int) -> Any:
    for key, kind in {"weights": Weights, "spectrum": Circulants}.items():
        if key in record:
            numbers = _square(record.reject_unknown(key)[key], N)
            with as_value_errors(record):
                return kind(numbers)
    if "inverse of" in record:
        of = _stream_of(record.reject_unknown("inverse of")["inverse of"], N)
        with as_value_errors(record):
            if not isinstance(of, DiagonalSolve):
                raise ValueError("the inverse is that of a stream with main and beside")
            return Inverse(of)
    record.reject_unknown("main", "beside", "factor")
    main, beside, factor = _square(record["main"], N), _square(record["beside"], N), record["factor"].number()
    with as_value_errors(record):
        return DiagonalSolve(main, beside, factor)


def _square(record: Entry, N: int) -> NDArray[np.float64]:
    return np.array([row.numbers(N) for row in record.entries(N)])


def _matrix_of(record: Entry, algebra: MatrixAlgebra) -> NDArray[Any]:
    parts = [_square(part, algebra.N) for part in record.entries(1 + algebra.complex)]
    return parts[0] + 1j * parts[1] if algebra.complex else parts[0]


def polynomial_of(source: Any, dim: int, names: Sequence[str] | None = None) -> Polynomial:
    """Return a polynomial from text or from a list of terms ``[coefficient, [exponent of x1, ...]]``."""
    if isinstance(source, str):
        return parse_polynomial(source, dim, names_in(source, dim, names))
    total: dict[Exponents, Constant] = {}
    for coefficient, exponents in source:
        for key, value in Polynomial({tuple(exponents): coefficient}, dim=dim).monomials.items():
            add_term(total, key, value)
    return Polynomial(total, dim=dim)


def event_of_file(name: str, table: Mapping[str, Any], system: Any) -> Event:
    """Return the event of a table: ``g``, an index or name of a coordinate or a polynomial, and options of `Event`."""
    names = coordinates_of(system)
    if not names:
        raise ValueError(f"an event of a file needs coordinates; the states of {system.unforced.name} are matrices")
    options = dict(table)
    g = options.pop("g")
    if isinstance(g, str | list):
        g = g if g in names else polynomial_of(g, system.dim, names)
    else:
        g = read_integer(g, "g", 0, system.dim - 1)
    return Event(g, name=name, **options)


def not_stored(x: NDArray[Any], t: float) -> float:
    """Raise an error in place of the function of an event, which datasets do not contain."""
    raise ValueError("the function of this event was not stored; give the events again")


def events_of(attribute: Any, path: str, system: Any) -> tuple[Event, ...]:
    """Parse the events of `event_record`, with `not_stored` for functions or without system; ValueError if damaged."""
    return tuple(_event_of(name, table, system) for name, table in parsed(attribute, path).table().items())


def _event_of(name: str, record: Entry, system: Any) -> Event:
    g = record.reject_unknown("g", "direction", "count", "terminal")["g"]
    with as_value_errors(record):
        if g.value is None or system is None:
            return Event(**{**record.value, "g": not_stored}, name=name)
        if g.is_table:
            return Event(**{**record.value, "g": _form_of(g, system.dim)}, name=name)
        if isinstance(g.value, str) and g.value not in coordinates_of(system):
            # `event_record` writes polynomials in x1, x2, ..., whatever the names of the coordinates are.
            return Event(**{**record.value, "g": polynomial_of(g.value, system.dim)}, name=name)
        return event_of_file(name, record.value, system)

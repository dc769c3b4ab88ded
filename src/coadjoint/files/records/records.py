"""Records: systems as plain numbers, lists and text, from which a run can be repeated."""

from __future__ import annotations

import importlib
import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.families.matrix_algebra import MatrixAlgebra
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.algebra.polynomials.monomials import coordinate_names as default_names
from coadjoint.algebra.polynomials.monomials import plain as text_of
from coadjoint.algebra.polynomials.monomials import special_names
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.files.records.entries import CASIMIR, ENERGY, EXACT, INTEGRAL, STREAM
from coadjoint.files.records.reconstruction import system_of
from coadjoint.runs.events import Event
from coadjoint.short_repr import plain
from coadjoint.systems.batch import Axis, Batch
from coadjoint.systems.coefficients import linear_of
from coadjoint.systems.forces import registry as described
from coadjoint.systems.forces.base import Force
from coadjoint.systems.hamiltonians.hamiltonian import HamiltonianLike, as_hamiltonian, formula_of
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.hamiltonians.split_hamiltonian import SplitHamiltonian
from coadjoint.systems.hamiltonians.sum_of_hamiltonians import SumOfHamiltonians
from coadjoint.systems.hamiltonians.summable import PolynomialHamiltonian, SeparatePolynomial, Summable
from coadjoint.systems.hamiltonians.terms import FunctionTerm, QuadraticTerm
from coadjoint.systems.hamiltonians.user_hamiltonian import ParsedFunction
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.matrices.matrix_system import MatrixSystem
from coadjoint.systems.matrices.streams import Circulants, DiagonalSolve, Inverse, Weights
from coadjoint.systems.system import System

__all__ = ["record_of", "safe_name", "system_of"]

MAX_NAME_LENGTH = 64  # characters of a name in a variable; short of the length of file names


def record_of(system: System | Batch) -> dict[str, Any]:
    """Return a system as plain numbers, lists and text for `json`; `system_of` rebuilds it, bitwise."""
    # A ready-made system is its name and parameters; functions of Python are listed under "not_stored".
    missing: list[str] = []
    record: dict[str, Any] = {"name": system.name, **_entries(system, missing)}
    return {**record, "not_stored": missing} if missing else record


def _entries(system: Any, missing: list[str]) -> dict[str, Any]:
    """Return the entries of a record beside the name; append the functions that cannot be stored to `missing`."""
    if system.is_batch:
        return _batch_entries(system, missing)
    if system.forces:
        return _forced_entries(system, missing)
    base = system._base_parameters
    parameters = system.parameters if base is None else base
    if parameters is not None and system.name in importlib.import_module("coadjoint.systems").names():
        functions = [f"{system.name}: {key}" for key, value in parameters.items() if callable(value)]
        if base is None or not functions:
            missing += functions
            linear = {} if base is None else {"linear": linear_of(system.hamiltonian).tolist()}
            return {} if functions else {"parameters": {key: plain(v) for key, v in parameters.items()}, **linear}
    match system:
        case MatrixSystem():
            return _matrix_entries(system, missing)
        case LiePoissonSystem():
            return _lie_poisson_entries(system, missing)
    function = system.structure_function
    source = f"class {type(system).__qualname__}" if function is None else _function_name(function)
    missing.append(f"structure matrix: {source}")
    return {}


def _lie_poisson_entries(system: LiePoissonSystem, missing: list[str]) -> dict[str, Any]:
    casimirs = system.casimirs
    record: dict[str, Any] = {
        "sign": system.sign,
        "algebra": _algebra_record(system.algebra),
        "hamiltonian": _hamiltonian_record(system.hamiltonian, missing),
        "casimirs": invariants_record(casimirs),
    }
    if system.representation is not None and system.representation is not system.algebra.representation:
        record["representation"] = _matrices_record(system.representation)
    if system.integrals:
        record["integrals"] = invariants_record(system.integrals)
    if system.layout:
        record["layout"] = {key: plain(value) for key, value in system.layout.items()}
    without_record = dict.fromkeys([*functions_among(casimirs), *functions_among(system.algebra.casimirs_known)])
    missing += [f"{CASIMIR}{name}" for name in without_record]
    missing += [f"{INTEGRAL}{name}" for name in functions_among(system.integrals)]
    missing += _named_functions(EXACT, system.closed_form)
    return record


def functions_among(invariants: Mapping[str, Any]) -> list[str]:
    """Return the names of the invariants that are functions, which cannot be stored."""
    return [name for name, value in invariants.items() if _invariant_record(value) is None]


def _algebra_record(algebra: LieAlgebra) -> dict[str, Any]:
    i, j, k, c = (column.tolist() for column in algebra.triples)
    record: dict[str, Any] = {
        "name": algebra.name,
        "dim": algebra.dim,
        "basis": list(algebra.basis),
        "constants": [list(row) for row in zip(i, j, k, c, strict=True)],
    }
    if algebra.representation is not None:
        record["representation"] = _matrices_record(algebra.representation)
    if algebra.casimirs_known:
        record["casimirs"] = invariants_record(algebra.casimirs_known)
    return record


def _matrices_record(matrices: NDArray[np.float64]) -> dict[str, Any]:
    indices = np.nonzero(matrices)
    columns = [*(index.tolist() for index in indices), matrices[indices].tolist()]
    return {"size": matrices.shape[1], "entries": [list(row) for row in zip(*columns, strict=True)]}


def invariants_record(casimirs: Mapping[str, Any]) -> dict[str, Any]:
    """Return polynomials as monomials, and others as Hamiltonians; functions are omitted."""
    records = {name: _invariant_record(value) for name, value in casimirs.items()}
    return {name: record for name, record in records.items() if record is not None}


def _invariant_record(value: Any) -> Any:
    """Return a polynomial as monomials, and a quadratic form or formula as a Hamiltonian; None for other functions."""
    if isinstance(value, Polynomial):
        return _monomials(value)
    missing: list[str] = []
    record = _hamiltonian_record(value, missing) if isinstance(value, HamiltonianLike) else None
    return None if missing else record


def _batch_entries(batch: Batch, missing: list[str]) -> dict[str, Any]:
    members, firsts = [record_of(member) for member in batch.distinct], np.unique(batch.owners, return_index=True)[1]
    for m, record in zip(firsts.tolist(), members, strict=True):
        missing += [f"{what} (member {m})" for what in record.get("not_stored", [])]
    entries: dict[str, Any] = {"members": members}
    if len(members) < len(batch):
        edges = np.flatnonzero(np.diff(batch.owners, prepend=-1))
        counts = np.diff(edges, append=len(batch))
        entries["repeated"] = [list(pair) for pair in zip(batch.owners[edges].tolist(), counts.tolist(), strict=True)]
    return {**entries, "axes": axes_record(batch.axes)} if batch.axes else entries


def _forced_entries(system: System, missing: list[str]) -> dict[str, Any]:
    """Return the Hamiltonian part, and the forces by name and parameters."""
    inner = record_of(system.unforced)
    forces = dict(zip(system.labels, map(_force_record, system.forces), strict=True))
    missing += inner.get("not_stored", ())
    missing += [f"force: {label}" for label, force in forces.items() if force is None]
    return {"forces": [force for force in forces.values() if force is not None], "system": inner}


def _force_record(force: Force) -> dict[str, Any] | None:
    """Return the name and the parameters of a force, and of a law in it; None if there is a function in it."""
    record: dict[str, Any] = {"name": type(force).__name__}
    if described.kinds().get(record["name"]) is not type(force):
        return None
    for key, value in force.parameters().items():
        unknown = any(map(callable, value if type(value) is tuple else (value,)))
        entry = _force_record(value) if isinstance(value, Force) else None if unknown else plain(value)
        if entry is None and value is not None:
            return None
        record[key] = entry
    return record


def _function_name(function: Any) -> str:
    return str(getattr(function, "__name__", type(function).__name__))


def _named_functions(prefix: str, function: Any) -> list[str]:
    """Return the name of a function that cannot be stored, with a prefix; nothing if there is none."""
    return [] if function is None else [f"{prefix}{_function_name(function)}"]


def _monomials(polynomial: Polynomial) -> list[list[Any]]:
    return [[plain(value), list(exponents)] for exponents, value in polynomial.monomials.items()]


def _hamiltonian_record(H: HamiltonianLike, missing: list[str]) -> dict[str, Any]:
    match H:
        case SeparatePolynomial():
            factors = [[plain(c), [list(pair) for pair in one.items()]] for _, c, one in H.polynomial._factors]
            return {"kind": "sparse polynomial", "dim": H.dim, "monomials": factors}
        case PolynomialHamiltonian():
            return _polynomial_record(H.polynomial)
        case Quadratic():
            return _form_record(H)
        case SplitHamiltonian():
            inner = [_hamiltonian_record(piece, missing) for piece in H.pieces]
            pieces = [list(pair) for pair in zip(map(list, H.coordinates), inner, strict=True)]
            return {"kind": "split", "pieces": pieces}
        case SumOfHamiltonians():
            return {"kind": "sum", "summands": [_hamiltonian_record(summand, missing) for summand in H.summands]}
    formula = formula_of(H)
    if formula is not None:
        return _formula_record(*formula)
    names = [_function_name(term.value) for term in H.terms() if isinstance(term, FunctionTerm)]
    missing += [f"hamiltonian: {name}" for name in names or [type(H).__name__]]
    return {"kind": type(H).__name__}


def _polynomial_record(polynomial: Polynomial) -> dict[str, Any]:
    return {"kind": "polynomial", "dim": polynomial.dim, "monomials": _monomials(polynomial)}


def _formula_record(function: ParsedFunction, factors: Sequence[Any]) -> dict[str, Any]:
    """Return the formula of a function as its text, and the factors that multiply it."""
    names = None if function.names is None else special_names(function.names)
    parameters = {name: plain(value) for name, value in function.parameters.items()}
    return {
        "kind": "formula",
        "dim": function.dim,
        "text": function.text,
        "names": None if names is None else list(names),
        "parameters": parameters,
        "factors": list(factors),
    }


def _form_record(H: Quadratic) -> dict[str, Any]:
    """Return a quadratic form, as a polynomial if it has fractions."""
    if H.exact:
        return _polynomial_record(H.to_polynomial())
    (term,) = H.terms()
    assert isinstance(term, QuadraticTerm)
    entries = zip(term.rows.tolist(), term.indices.tolist(), term.values.tolist(), strict=True)
    return {
        "kind": "quadratic",
        "dim": H.dim,
        "M": [[i, j, value] for i, j, value in entries if i <= j],
        "linear": term.linear.tolist(),
        "constant": H.constant,
    }


def safe_name(name: str) -> str:
    """Convert a name to at most 64 letters, digits and underscores, for variables and files."""
    letters = "".join(letter if letter.isascii() and letter.isalnum() else " " for letter in name)
    return "_".join(letters.split())[:MAX_NAME_LENGTH] or "unnamed"


def axes_record(axes: Mapping[str, Axis]) -> list[list[Any]]:
    """Return axes as plain lists for `json`."""
    return [[name, axis.length, None if axis.values is None else axis.values.tolist()] for name, axis in axes.items()]


def _matrix_entries(system: MatrixSystem, missing: list[str]) -> dict[str, Any]:
    record: dict[str, Any] = {
        "matrices": _matrix_algebra_record(system.algebra),
        "energy_sign": system.energy_sign,
        "powers": system.powers,
    }
    record |= _stream_entries("stream", system.stream, missing)
    if len(system.shape) > 2:
        record["layers"] = 2
        record |= _stream_entries("second_stream", system.second_stream, missing)
    if system.linear is not None:
        parts = [system.linear.real, system.linear.imag] if np.iscomplexobj(system.linear) else [system.linear]
        record["linear"] = [part.tolist() for part in parts]
    missing += [*_named_functions(ENERGY, system.energy_function), *_named_functions(EXACT, system.closed_form)]
    return record


def _matrix_algebra_record(algebra: MatrixAlgebra) -> dict[str, Any]:
    if algebra.blocks:
        return {"blocks": [_matrix_algebra_record(block) for block in algebra.blocks]}
    return {"kind": algebra.kind, "N": algebra.N, "q": algebra.q}


STREAMS: Mapping[type, Callable[[Any], dict[str, Any]]] = {
    Weights: lambda stream: {"weights": stream.weights.tolist()},
    DiagonalSolve: lambda stream: {
        "main": stream.main.tolist(),
        "beside": stream.beside.tolist(),
        "factor": float(stream.factor),
    },
    Inverse: lambda stream: {"inverse of": STREAMS[DiagonalSolve](stream.of)},
    Circulants: lambda stream: {"spectrum": stream.spectrum.tolist()},
}
"""Class of a stream -> its record; of derived classes nothing is known."""


def _stream_entries(key: str, stream: Any, missing: list[str]) -> dict[str, Any]:
    """Return the entry of a stream; streams that are functions are not stored."""
    record = STREAMS.get(type(stream))
    if record is None:
        missing += _named_functions(STREAM, getattr(stream, "function", stream))
    return {} if record is None else {key: record(stream)}


def event_record(events: Sequence[Event], names: Sequence[str], dim: int) -> tuple[str, list[str]]:
    """Return events as JSON, and the names of events whose g is a function; these have a null g."""
    tables, missing = {}, []
    for event, name in zip(events, names, strict=True):
        g = _crossed_record(event.g, dim)
        if g is None:
            missing.append(name)
        tables[name] = {"g": g, "direction": event.direction, "count": event.count, "terminal": event.terminal}
    return json.dumps(tables), missing


def _crossed_record(g: Any, dim: int) -> Any:
    """Return the function of an event as a coordinate, text, monomials or a Hamiltonian; None for other ones."""
    match g:
        case Polynomial():
            text, names = text_of(g.monomials, default_names(g.dim)), default_names(g.dim)
            # A coordinate alone would be read as a name, which may be that of another coordinate of the system.
            return _monomials(g) if text in names else text
        case Summable():
            return _invariant_record(as_hamiltonian(g, dim))
        case int() | str():
            return g
    return None

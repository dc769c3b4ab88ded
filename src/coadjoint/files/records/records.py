"""Records: systems as plain numbers, lists and text, from which a run can be repeated."""

from __future__ import annotations

import importlib
import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.families.matrix_algebra import MatrixAlgebra
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.algebra.polynomials.polynomial_format import coordinate_names as default_names
from coadjoint.algebra.polynomials.polynomial_format import plain as text_of
from coadjoint.files.records.entries import CASIMIR, ENERGY, EXACT, INTEGRAL, STREAM
from coadjoint.files.records.reconstruction import system_of
from coadjoint.runs.events import Event
from coadjoint.short_repr import plain
from coadjoint.systems.batch import Axis, Batch
from coadjoint.systems.forces import registry as described
from coadjoint.systems.forces.base import Force
from coadjoint.systems.hamiltonians.hamiltonian import HamiltonianLike, formula_of
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.hamiltonians.split_hamiltonian import SplitHamiltonian
from coadjoint.systems.hamiltonians.sum_of_hamiltonians import SumOfHamiltonians
from coadjoint.systems.hamiltonians.summable import PolynomialHamiltonian
from coadjoint.systems.hamiltonians.terms import FunctionTerm, QuadraticTerm
from coadjoint.systems.hamiltonians.user_hamiltonian import ParsedFunction
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.matrices.matrix_system import MatrixSystem
from coadjoint.systems.matrices.streams import Circulants, DiagonalSolve, Inverse, Weights
from coadjoint.systems.matrices.two_layer_system import TwoLayerSystem
from coadjoint.systems.system import System

__all__ = ["record_of", "safe_name", "system_of"]

MAX_NAME_LENGTH = 64  # characters of a name in a variable; short of the length of file names
STORABLE_TYPES = (Polynomial, Quadratic)


def record_of(system: System | Batch) -> dict[str, Any]:
    """Return a system as plain numbers, lists and text for `json`; `system_of` rebuilds it, bitwise."""
    # A ready-made system is its name and parameters; functions of Python are listed under "not_stored".
    if isinstance(system, Batch):
        return _batch_record(system)
    if system.forces:
        return _forced_record(system)
    ready_made = importlib.import_module("coadjoint.systems").names()
    parameters = system.parameters
    if parameters is not None and system.name in ready_made:
        functions = [f"{system.name}: {key}" for key, value in parameters.items() if callable(value)]
        if functions:
            return {"name": system.name, "not_stored": functions}
        return {"name": system.name, "parameters": {key: plain(value) for key, value in parameters.items()}}
    if isinstance(system, MatrixSystem):
        return matrix_record(system)
    if not isinstance(system, LiePoissonSystem):
        function = system.structure_function
        source = f"class {type(system).__qualname__}" if function is None else _function_name(function)
        return {"name": system.name, "not_stored": [f"structure matrix: {source}"]}
    hamiltonian, missing = _hamiltonian_record(system.hamiltonian)
    casimirs = system.casimirs
    without_record = dict.fromkeys([*_functions_in(casimirs), *_functions_in(system.algebra.casimirs_known)])
    missing += [f"{CASIMIR}{name}" for name in without_record]
    missing += [f"{INTEGRAL}{name}" for name in _functions_in(system.integrals)]
    missing += [] if system.closed_form is None else [f"{EXACT}{_function_name(system.closed_form)}"]
    record: dict[str, Any] = {
        "name": system.name,
        "sign": system.sign,
        "algebra": _algebra_record(system.algebra),
        "hamiltonian": hamiltonian,
        "casimirs": invariants_record(casimirs),
    }
    if system.representation is not None and system.representation is not system.algebra.representation:
        record["representation"] = _matrices_record(system.representation)
    if system.integrals:
        record["integrals"] = invariants_record(system.integrals)
    if system.layout:
        record["layout"] = {key: plain(value) for key, value in system.layout.items()}
    if missing:
        record["not_stored"] = missing
    return record


def _functions_in(invariants: Mapping[str, Any]) -> list[str]:
    return [name for name, value in invariants.items() if not isinstance(value, STORABLE_TYPES)]


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
    """Return polynomials as monomials, and quadratic forms as for a Hamiltonian; functions are omitted."""
    return {
        name: _monomials(value) if isinstance(value, Polynomial) else _form_record(value)
        for name, value in casimirs.items()
        if isinstance(value, STORABLE_TYPES)
    }


def _batch_record(batch: Batch) -> dict[str, Any]:
    members, firsts = [record_of(member) for member in batch.distinct], np.unique(batch.owners, return_index=True)[1]
    missing = [
        f"{what} (member {m})"
        for m, record in zip(firsts.tolist(), members, strict=True)
        for what in record.get("not_stored", [])
    ]
    record: dict[str, Any] = {"name": batch.name, "members": members}
    if len(members) < len(batch):
        edges = np.flatnonzero(np.diff(batch.owners, prepend=-1))
        counts = np.diff(edges, append=len(batch))
        record["repeated"] = [list(pair) for pair in zip(batch.owners[edges].tolist(), counts.tolist(), strict=True)]
    if batch.axes:
        record["axes"] = axes_record(batch.axes)
    return {**record, "not_stored": missing} if missing else record


def _forced_record(system: System) -> dict[str, Any]:
    """Return the Hamiltonian part, and the forces by name and parameters."""
    inner, forces, missing = record_of(system.unforced), [], []
    for label, force in system.labelled_forces:
        described_force = _force_record(force)
        if described_force is None:
            missing.append(f"force: {label}")
        else:
            forces.append(described_force)
    missing = [*inner.get("not_stored", ()), *missing]
    record: dict[str, Any] = {"name": system.name, "forces": forces, "system": inner}
    return {**record, "not_stored": missing} if missing else record


def _force_record(force: Force) -> dict[str, Any] | None:
    """Return the name and the parameters of a force, and of a law in it; None if there is a function in it."""
    record: dict[str, Any] = {"name": type(force).__name__}
    if described.kinds().get(record["name"]) is not type(force):
        return None
    for key, value in force.parameters().items():
        entry = _force_record(value) if isinstance(value, Force) else None if callable(value) else plain(value)
        if entry is None and value is not None:
            return None
        record[key] = entry
    return record


def _function_name(function: Any) -> str:
    return str(getattr(function, "__name__", type(function).__name__))


def _monomials(polynomial: Polynomial) -> list[list[Any]]:
    return [[plain(value), list(exponents)] for exponents, value in polynomial.monomials.items()]


def _hamiltonian_record(H: HamiltonianLike) -> tuple[dict[str, Any], list[str]]:
    """Return the record of a Hamiltonian, and its functions that cannot be stored."""
    if isinstance(H, PolynomialHamiltonian):
        return _polynomial_record(H.polynomial), []
    if isinstance(H, Quadratic):
        return _form_record(H), []
    formula = formula_of(H)
    if formula is not None:
        return _formula_record(*formula), []
    if isinstance(H, SplitHamiltonian):
        inner = [_hamiltonian_record(piece) for piece in H.pieces]
        pieces = [[list(coordinates), record] for coordinates, (record, _) in zip(H.coordinates, inner, strict=True)]
        return {"kind": "split", "pieces": pieces}, [name for _, names in inner for name in names]
    if isinstance(H, SumOfHamiltonians):
        parts = [_hamiltonian_record(summand) for summand in H.summands]
        missing = [name for _, names in parts for name in names]
        return {"kind": "sum", "summands": [record for record, _ in parts]}, missing
    names = [_function_name(term.value) for term in H.terms() if isinstance(term, FunctionTerm)]
    return {"kind": type(H).__name__}, [f"hamiltonian: {name}" for name in names or [type(H).__name__]]


def _polynomial_record(polynomial: Polynomial) -> dict[str, Any]:
    return {"kind": "polynomial", "dim": polynomial.dim, "monomials": _monomials(polynomial)}


def _formula_record(function: ParsedFunction, factors: Sequence[Any]) -> dict[str, Any]:
    """Return the formula of a function as its text, and the factors that multiply it."""
    names = None if function.names is None else list(function.names)
    parameters = {name: plain(value) for name, value in function.parameters.items()}
    return {
        "kind": "formula",
        "dim": function.dim,
        "text": function.text,
        "names": names,
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


def matrix_record(system: MatrixSystem) -> dict[str, Any]:
    """Return a matrix system as plain numbers, lists and text; streams that are functions are not stored."""
    record: dict[str, Any] = {
        "name": system.name,
        "matrices": _matrix_algebra_record(system.algebra),
        "energy_sign": system.energy_sign,
        "powers": system.powers,
    }
    missing = []
    stream = _stream_record(system.stream)
    if stream is None:
        missing.append(f"{STREAM}{_function_name(getattr(system.stream, 'function', system.stream))}")
    else:
        record["stream"] = stream
    if isinstance(system, TwoLayerSystem):
        record["layers"] = 2
        second = None if system.second_stream is None else _stream_record(system.second_stream)
        if second is not None:
            record["second_stream"] = second
        elif system.second_stream is not None:
            missing.append(f"{STREAM}{type(system.second_stream).__name__}")
    if system.linear is not None:
        parts = [system.linear.real, system.linear.imag] if np.iscomplexobj(system.linear) else [system.linear]
        record["linear"] = [part.tolist() for part in parts]
    if system.energy_function is not None:
        missing.append(f"{ENERGY}{_function_name(system.energy_function)}")
    if system.closed_form is not None:
        missing.append(f"{EXACT}{_function_name(system.closed_form)}")
    return {**record, "not_stored": missing} if missing else record


def _matrix_algebra_record(algebra: MatrixAlgebra) -> dict[str, Any]:
    if algebra.blocks:
        return {"blocks": [_matrix_algebra_record(block) for block in algebra.blocks]}
    return {"kind": algebra.kind, "N": algebra.N, "q": algebra.q}


def _stream_record(stream: Any) -> dict[str, Any] | None:
    if type(stream) is Weights:
        return {"weights": stream.weights.tolist()}
    if type(stream) is DiagonalSolve:
        return {"main": stream.main.tolist(), "beside": stream.beside.tolist(), "factor": float(stream.factor)}
    if type(stream) is Inverse:
        return {"inverse of": _stream_record(stream.of)}
    if type(stream) is Circulants:
        return {"spectrum": stream.spectrum.tolist()}
    return None


def event_record(events: Sequence[Event], names: Sequence[str]) -> tuple[str, list[str]]:
    """Return events as JSON, and the names of events whose g is a function; these have a null g."""
    tables, missing = {}, []
    for event, name in zip(events, names, strict=True):
        g: Any = event.g
        if isinstance(g, Polynomial):
            text = text_of(g.monomials, default_names(g.dim))
            # A coordinate alone would be read as a name, which may be that of another coordinate of the system.
            g = invariants_record({name: g})[name] if text in default_names(g.dim) else text
        if isinstance(g, Quadratic):
            g = invariants_record({name: g})[name]
        if not isinstance(g, int | str | dict | list):
            missing.append(name)
            g = None
        tables[name] = {"g": g, "direction": event.direction, "count": event.count, "terminal": event.terminal}
    return json.dumps(tables), missing

"""Systems as plain numbers, lists and text, so that a result says what was run and can be run again."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from fractions import Fraction
from typing import Any

import numpy as np

from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.algebra.polynomial import Polynomial
from coadjoint.methods.base import System
from coadjoint.systems.batch import Batch
from coadjoint.systems.hamiltonian import HamiltonianLike, PolynomialHamiltonian
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.quadratic import Quadratic
from coadjoint.systems.split_hamiltonian import SplitHamiltonian
from coadjoint.systems.terms import FunctionTerm, QuadraticTerm

LONGEST_NAME = 64


def record_of(system: System | Batch) -> dict[str, Any]:
    """Return a system as plain numbers, lists and text.

    A ready-made system is its name and parameters. Any other is its structure constants (i, j, k, c), its Hamiltonian,
    sign, polynomial Casimirs and representation; functions cannot be stored, and are named under ``"not_stored"``. A
    batch is the list of its members.

    Parameters
    ----------
    system : LiePoissonSystem, PoissonSystem or Batch
        The system.

    Returns
    -------
    dict
        For `json`; `system_of` makes the system again, to the same bits.

    Examples
    --------
    >>> from coadjoint.systems.rigid_body import rigid_body
    >>> record_of(rigid_body((1, 2, 3)))
    {'name': 'rigid_body', 'parameters': {'inertia': [1.0, 2.0, 3.0]}}
    """
    if isinstance(system, Batch):
        return _batch_record(system)
    ready_made = importlib.import_module("coadjoint.systems").names()
    if system.parameters is not None and system.name in ready_made:
        functions = [f"{system.name}: {key}" for key, value in system.parameters.items() if callable(value)]
        if functions:
            return {"name": system.name, "not_stored": functions}
        return {"name": system.name, "parameters": {key: _plain(value) for key, value in system.parameters.items()}}
    if not isinstance(system, LiePoissonSystem):
        return {"name": system.name, "not_stored": [f"structure matrix: {_function_name(system.structure_function)}"]}
    hamiltonian, missing = _hamiltonian_record(system.hamiltonian)
    casimirs = {name: _monomials(value) for name, value in system.casimirs.items() if isinstance(value, Polynomial)}
    missing += [f"casimir: {name}" for name in system.casimirs if name not in casimirs]
    i, j, k, c = (column.tolist() for column in system.algebra.triples)
    record: dict[str, Any] = {
        "name": system.name,
        "sign": system.sign,
        "algebra": {
            "name": system.algebra.name,
            "dim": system.dim,
            "basis": list(system.algebra.basis),
            "constants": [list(row) for row in zip(i, j, k, c, strict=True)],
        },
        "hamiltonian": hamiltonian,
        "casimirs": casimirs,
    }
    if system.representation is not None:
        where = [index.tolist() for index in np.nonzero(system.representation)]
        values = system.representation[np.nonzero(system.representation)].tolist()
        entries = [list(row) for row in zip(*where, values, strict=True)]
        record["representation"] = {"size": system.representation.shape[1], "entries": entries}
    if missing:
        record["not_stored"] = missing
    return record


def _batch_record(batch: Batch) -> dict[str, Any]:
    members = [record_of(member) for member in batch]
    missing = [f"{what} (member {m})" for m, record in enumerate(members) for what in record.get("not_stored", [])]
    record: dict[str, Any] = {"name": batch.name, "members": members}
    return {**record, "not_stored": missing} if missing else record


def system_of(record: Mapping[str, Any]) -> System | Batch:
    """Return the system that a record describes.

    Parameters
    ----------
    record : mapping
        From `record_of`.

    Returns
    -------
    LiePoissonSystem, PoissonSystem or Batch
        Without Casimirs that are functions.

    Raises
    ------
    ValueError
        The motion depends on functions, which were not stored.

    Examples
    --------
    >>> from coadjoint.systems.rigid_body import rigid_body
    >>> system_of(record_of(rigid_body((1, 2, 4)))).parameters
    {'inertia': (1.0, 2.0, 4.0)}
    """
    if "members" in record:
        return Batch([_member_of(member) for member in record["members"]])
    return _member_of(record)


def _member_of(record: Mapping[str, Any]) -> System:
    if "parameters" in record:
        return importlib.import_module("coadjoint.systems").get(record["name"], **record["parameters"])
    lost = [what for what in record.get("not_stored", []) if not what.startswith("casimir: ")]
    if lost:
        raise ValueError(
            f"{record['name']} cannot be made again from its record: functions are not stored ({', '.join(lost)}); "
            "make the system in Python and integrate it there"
        )
    given = record["algebra"]
    dim = given["dim"]
    algebra = LieAlgebra(given["constants"], dim=dim, basis=given["basis"], name=given["name"])
    representation = None
    if "representation" in record:
        size = record["representation"]["size"]
        representation = np.zeros((dim, size, size))
        for i, row, column, value in record["representation"]["entries"]:
            representation[i, row, column] = value
    return LiePoissonSystem(
        algebra,
        _hamiltonian_of(record["hamiltonian"]),
        sign=record["sign"],
        casimirs={name: _polynomial(monomials, dim) for name, monomials in record["casimirs"].items()},
        representation=representation,
        name=record["name"],
    )


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, tuple | list):
        return [_plain(entry) for entry in value]
    return {str(key): _plain(entry) for key, entry in value.items()} if isinstance(value, Mapping) else value


def _function_name(function: Any) -> str:
    return str(getattr(function, "__name__", type(function).__name__))


def _monomials(polynomial: Polynomial) -> list[list[Any]]:
    def number(value: Any) -> Any:
        return f"{value.numerator}/{value.denominator}" if isinstance(value, Fraction) else value

    return [[number(value), list(exponents)] for exponents, value in polynomial.monomials.items()]


def _polynomial(monomials: list[list[Any]], dim: int) -> Polynomial:
    pairs = {tuple(exponents): Fraction(c) if isinstance(c, str) else c for c, exponents in monomials}
    return Polynomial(pairs, dim=dim)


def _hamiltonian_record(H: HamiltonianLike) -> tuple[dict[str, Any], list[str]]:
    """Return the record of a Hamiltonian, and the functions in it that cannot be stored."""
    if isinstance(H, PolynomialHamiltonian):
        return {"kind": "polynomial", "dim": H.dim, "monomials": _monomials(H.polynomial)}, []
    if isinstance(H, SplitHamiltonian):
        inner = [_hamiltonian_record(piece) for piece in H.pieces]
        pieces = [[list(chosen), record] for chosen, (record, _) in zip(H.coordinates, inner, strict=True)]
        return {"kind": "split", "pieces": pieces}, [name for _, names in inner for name in names]
    terms = H.terms()
    if len(terms) == 1 and isinstance(terms[0], QuadraticTerm):
        term = terms[0]
        entries = zip(term.rows.tolist(), term.indices.tolist(), term.values.tolist(), strict=True)
        upper = [[i, j, value] for i, j, value in entries if i <= j]
        record = {
            "kind": "quadratic",
            "dim": H.dim,
            "M": upper,
            "linear": term.linear.tolist(),
            "constant": term.constant,
        }
        return record, []
    names = [f"hamiltonian: {_function_name(term.value)}" for term in terms if isinstance(term, FunctionTerm)]
    return {"kind": type(H).__name__}, names


def _hamiltonian_of(record: Mapping[str, Any]) -> Any:
    from scipy.sparse import coo_array

    if record["kind"] == "polynomial":
        return PolynomialHamiltonian(_polynomial(record["monomials"], record["dim"]))
    if record["kind"] == "split":
        return SplitHamiltonian([(chosen, _hamiltonian_of(piece)) for chosen, piece in record["pieces"]])
    rows, columns, values = [], [], []
    for i, j, value in record["M"]:
        for row, column in {(i, j), (j, i)}:
            rows.append(row)
            columns.append(column)
            values.append(float(value))
    shape = (record["dim"], record["dim"])
    M = coo_array((np.array(values, dtype=np.float64), (rows, columns)), shape=shape)
    return Quadratic(M, linear=record["linear"], constant=record["constant"])


def safe_name(name: str) -> str:
    """Return a name of at most 64 letters, digits and underscores, for a variable in a file, or a file in a store.

    Parameters
    ----------
    name : str
        Any name, such as that of a Casimir.

    Returns
    -------
    str

    Examples
    --------
    >>> safe_name("x1*x3 + x2^2")
    'x1_x3_x2_2'
    """
    letters = "".join(letter if letter.isascii() and letter.isalnum() else " " for letter in name)
    return "_".join(letters.split())[:LONGEST_NAME] or "unnamed"

"""Construction of the system and the scheme of a configuration file."""

from __future__ import annotations

import inspect
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from coadjoint.algebra import catalogue
from coadjoint.algebra.bracket_parser import parse_brackets
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.errors import OneLineError, in_one_line
from coadjoint.files.configuration.polynomials import parse_polynomial
from coadjoint.memory import check_available_memory
from coadjoint.methods import registry
from coadjoint.methods.protocol.method import Method
from coadjoint.short_repr import short
from coadjoint.systems.forced import ForcedSystem
from coadjoint.systems.forces import registry as described
from coadjoint.systems.hamiltonians.hamiltonian import as_hamiltonian
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.system_checks import System
from coadjoint.validation import read_choice

MAX_LENGTH = 300
BYTES_PER_COORDINATE = 400

if TYPE_CHECKING:
    from coadjoint.files.configuration.models import AlgebraTable, File, HamiltonianTable


class ConfigurationError(OneLineError):
    """A configuration file is invalid; the message has the file, the key, and the correction."""

    error_lines: tuple[str, ...] = ()
    """One line for each error, if there are several."""


@contextmanager
def section(name: str, key: str) -> Iterator[None]:
    """Convert errors inside the context to `ConfigurationError` with the file `name` and the dotted `key`.

    Converted are ValueError, TypeError, arithmetic and recursion errors, and MemoryError.

    Examples
    --------
    >>> with section("run.toml", "run.step"):
    ...     raise ValueError("step is 0")
    Traceback (most recent call last):
    ...
    coadjoint.files.configuration.construction.ConfigurationError: run.toml: run.step: step is 0
    """
    cause: Exception
    try:
        yield
        return
    except ConfigurationError:
        raise
    except (ValueError, TypeError) as reason:
        said, cause = str(reason), reason
    except ArithmeticError as reason:
        said, cause = f"a number is too large, or too small, to compute with ({reason})", reason
    except RecursionError as reason:
        said, cause = "lists or tables are nested too deeply; nest less", reason
    except MemoryError as reason:
        said, cause = "does not fit into memory; take something smaller", reason
    raise ConfigurationError(f"{name}: {in_one_line(key, 80)}: {in_one_line(said, MAX_LENGTH)}") from cause


def system_of_file(name: str, file: File) -> System | ForcedSystem:
    """Return the system of the validated tables of a file, with its forces; ConfigurationError with the key."""
    system, forces = _hamiltonian_part(name, file), []
    for k, description in enumerate(file.forces):
        with section(name, f"forces[{k}]"):
            forces.append(described.from_description(description))
    with section(name, "forces"):
        return ForcedSystem(system, forces) if forces else system


def _hamiltonian_part(name: str, file: File) -> System:
    if (file.system is None) == (file.algebra is None):
        raise ConfigurationError(f"{name}: give either [system], a ready-made one, or [algebra] with [hamiltonian]")
    if file.system is not None:
        from coadjoint.files.configuration.error_collector import ErrorCollector

        wrong = ErrorCollector(name)
        for key in ("name", "sign", "hamiltonian", "casimirs"):
            if getattr(file, key) is not None:
                wrong.add(f"{key}: belongs to [algebra]; the system {file.system.name!r} has its own")
        with wrong.collect():
            made = _ready_made(name, file.system.name, file.system.parameters)
        wrong.raise_collected()
        return made
    if file.hamiltonian is None:
        raise ConfigurationError(f"{name}: hamiltonian: is missing; give it with [algebra]")
    assert file.algebra is not None
    if file.algebra.brackets is not None:
        _check_dimension(name, file.algebra, file.initial.x)
    algebra = _algebra(name, file.algebra)
    hamiltonian = _hamiltonian(name, file.hamiltonian, algebra)
    casimirs: dict[str, Polynomial] | None = None if file.casimirs is None else {}
    for key, written in (file.casimirs or {}).items():
        assert casimirs is not None
        with section(name, f"casimirs.{key}"):
            casimirs[key] = parse_polynomial(written, algebra.dim)
    with section(name, "casimirs"):
        LiePoissonSystem(algebra, 0 * Polynomial.variable(0, algebra.dim), casimirs=casimirs)
    with section(name, "hamiltonian"):
        return LiePoissonSystem(algebra, hamiltonian, sign=file.sign or 1, casimirs=casimirs, name=file.name)


def _ready_made(name: str, system: str, parameters: Mapping[str, Any]) -> System:
    from coadjoint import systems
    from coadjoint.files.configuration.models import unknown_key
    from coadjoint.systems.registry import ready_made_systems

    with section(name, "system"):
        builder = ready_made_systems()[read_choice(system, "system", ready_made_systems())]
    known = inspect.signature(builder).parameters
    for key in parameters:
        if key not in known:
            raise ConfigurationError(f"{name}: system.parameters.{key}: {unknown_key(key, known)}")
    with section(name, "system"):
        return systems.get(system, **parameters)


def method_of_file(name: str, table: Mapping[str, Any]) -> Method:
    """Return the scheme of the table ``[method]``; ConfigurationError with the key."""
    from coadjoint.files.configuration.models import unknown_key

    scheme = table.get("name")
    if isinstance(scheme, str) and scheme in registry.names():
        known = registry.parameters_of(scheme)
        for key in table:
            if key not in known and key not in ("name", "parameters"):
                raise ConfigurationError(f"{name}: method.{key}: {unknown_key(key, known)}")
    with section(name, "method"):
        return registry.from_description(table)


def _check_dimension(name: str, table: AlgebraTable, states: Any) -> None:
    """Reject a dimension other than the length of the state, before anything of that size is allocated."""
    if table.dim is None or isinstance(states, str):
        return
    with section(name, "algebra.dim"):
        check_available_memory(BYTES_PER_COORDINATE * table.dim, f"an algebra of dimension {short(table.dim)}")
    shape = np.shape(states)
    if shape[-1] != table.dim and table.basis is None:
        raise ConfigurationError(
            f"{name}: initial.x: x0 has the shape {shape}; it must be ({table.dim},) or (members, {table.dim})"
        )


def _algebra(name: str, table: AlgebraTable) -> LieAlgebra:
    own = table.brackets is not None
    for key in ("dim", "basis"):
        if getattr(table, key) is not None and not own:
            raise ConfigurationError(
                f"{name}: algebra.brackets: is missing; give it with {key}, or a name of the catalogue"
            )
    if not own:
        if table.name is None:
            raise ConfigurationError(f"{name}: algebra.name: is missing; give it, or brackets with dim or basis")
        if "name" in table.parameters:
            raise ConfigurationError(f"{name}: algebra.parameters.name: no algebra has a parameter of this name")
        with section(name, "algebra"):
            return catalogue.get(table.name, **table.parameters)
    if table.name is not None:
        raise ConfigurationError(
            f"{name}: algebra.name: is for an algebra of the catalogue; give it or brackets, not both "
            "(a title goes into the key name at the top)"
        )
    if table.parameters:
        raise ConfigurationError(
            f"{name}: algebra.parameters: belongs to an algebra of the catalogue; write numbers in brackets"
        )
    dim = table.dim if table.dim is not None else len(table.basis or ())
    if dim == 0:
        raise ConfigurationError(f"{name}: algebra.dim: is missing; give it, or basis")
    basis = table.basis if table.basis is not None else [f"e{i + 1}" for i in range(dim)]
    if len(basis) != dim:
        raise ConfigurationError(f"{name}: algebra.basis: has {len(basis)} names; dim is {dim}")
    with section(name, "algebra.brackets"):
        return LieAlgebra.from_brackets(dim, parse_brackets(table.brackets or [], basis), basis=basis)


def _hamiltonian(name: str, table: HamiltonianTable, algebra: LieAlgebra) -> Any:
    if table.polynomial is not None:
        for key in ("M", "linear", "constant"):
            if getattr(table, key) is not None:
                raise ConfigurationError(f"{name}: hamiltonian.{key}: is given with polynomial; include it there")
        with section(name, "hamiltonian.polynomial"):
            return parse_polynomial(table.polynomial, algebra.dim)
    if table.M is None and table.linear is None:
        raise ConfigurationError(f"{name}: hamiltonian.M: is missing; give M, linear or both, or polynomial")
    with section(name, "hamiltonian"):
        M, constant = 0.0 if table.M is None else table.M, table.constant or 0.0
        return as_hamiltonian(
            Quadratic(M, linear=table.linear, constant=constant), algebra.dim, algebra.name or "the algebra"
        )

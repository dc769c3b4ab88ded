"""Systems, schemes and initial states of configuration files, and the errors of configuration files."""

from __future__ import annotations

import inspect
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from coadjoint import systems
from coadjoint.algebra import catalogue
from coadjoint.algebra.exact.numbers import TOO_LARGE, Constant, fits
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.algebra.polynomials import formulas
from coadjoint.algebra.polynomials.formula_tree import names_in, read_parameters
from coadjoint.algebra.polynomials.formulas import add_term, too_high
from coadjoint.algebra.polynomials.monomials import Exponents
from coadjoint.algebra.polynomials.polynomial import MAX_DEGREE, Polynomial
from coadjoint.errors import ConfigurationError, in_one_line
from coadjoint.methods import registry
from coadjoint.methods.protocol.method import Method
from coadjoint.regular_files import read_array_file
from coadjoint.short_repr import short
from coadjoint.systems.coordinates import declared_names
from coadjoint.systems.forces import registry as described
from coadjoint.systems.hamiltonians.hamiltonian import as_hamiltonian, formula_in
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.registry import ready_made_systems
from coadjoint.systems.system import System
from coadjoint.validation import check_parameters, from_description, read_choice

NPY_SUFFIX = ".npy"


def parse_polynomial(source: Any, dim: int, names: Sequence[str] | None = None) -> Polynomial:
    """Parse a polynomial from text or a list of terms ``[coefficient, [exponent of x1, ...]]``."""
    if isinstance(source, str):
        return formulas.parse_polynomial(source, dim, names_in(source, dim, names))
    if not isinstance(source, list):
        raise TypeError(f"a polynomial is text such as '0.5*x1^2 + x2*x3' or a list of terms, not {short(source)}")
    total: dict[Exponents, Constant] = {}
    for term in source:
        if not (isinstance(term, list) and len(term) == 2 and isinstance(term[1], list)):
            raise TypeError(f"{short(term)} is not a term; write [coefficient, [exponents]], such as [0.5, [2, 0, 0]]")
        coefficient, exponents = term
        if len(exponents) != dim:
            raise ValueError(f"the term {short(term)} has {len(exponents)} exponents; the system has {dim} coordinates")
        for exponent in exponents:
            if type(exponent) is not int:
                raise TypeError(f"the term {short(term)} has the exponent {short(exponent)}; give whole numbers")
        degree = sum(exponents)
        if degree > MAX_DEGREE:
            raise too_high(f"the term {short(term)}", degree)
        if type(coefficient) is int and not fits(coefficient):
            raise ValueError(f"a coefficient {TOO_LARGE}")
        for key, value in Polynomial({tuple(exponents): coefficient}).monomials.items():
            add_term(total, key, value)
    return Polynomial(total, dim=dim)


MAX_LENGTH = 300  # characters of a problem in an error, some lines of a terminal

if TYPE_CHECKING:
    from coadjoint.files.configuration.models import AlgebraTable, File, HamiltonianTable, InitialTable


@contextmanager
def section(name: str, key: str) -> Iterator[None]:
    """Convert errors inside the context to `ConfigurationError` with the file `name` and the dotted `key`."""
    cause: Exception
    try:
        yield
        return
    except ConfigurationError:
        raise
    except (ValueError, TypeError) as reason:
        problem, cause = str(reason), reason
    except ArithmeticError as reason:
        problem, cause = f"a number is too large, or too small, to compute with ({reason})", reason
    except RecursionError as reason:
        problem, cause = "lists or tables are nested too deeply; nest less", reason
    except MemoryError as reason:
        problem, cause = "does not fit into memory; take something smaller", reason
    raise ConfigurationError(f"{name}: {in_one_line(key, 80)}: {in_one_line(problem, MAX_LENGTH)}") from cause


def system_of_file(name: str, file: File) -> System:
    """Return the system of the validated tables of a file, with its forces; ConfigurationError with the key."""
    system, forces = _hamiltonian_part(name, file), []
    for k, description in enumerate(file.forces):
        with section(name, f"forces[{k}]"):
            forces.append(from_description("force", described.kinds(), description))
    with section(name, "forces"):
        return system.with_forces(*forces) if forces else system


def _hamiltonian_part(name: str, file: File) -> System:
    if (file.system is None) == (file.algebra is None):
        raise ConfigurationError(f"{name}: give either [system], a ready-made one, or [algebra] with [hamiltonian]")
    if file.system is not None:
        errors = ErrorCollector(name)
        for key in ("name", "sign", "hamiltonian", "casimirs"):
            if getattr(file, key) is not None:
                errors.add(f"{key}: belongs to [algebra]; the system {file.system.name!r} has its own")
        with errors.collect():
            with section(name, "system"):
                ready_made = read_choice(file.system.name, "system", ready_made_systems())
                system = systems.get(ready_made, **file.system.parameters)
        errors.raise_collected()
        return system
    if file.hamiltonian is None:
        raise ConfigurationError(f"{name}: hamiltonian: is missing; give it with [algebra]")
    assert file.algebra is not None
    if file.algebra.brackets is not None:
        _check_dimension(name, file.algebra, file.initial.x)
    algebra = _algebra(name, file.algebra)
    names = declared_names(file.name, algebra, algebra.dim)
    hamiltonian = _hamiltonian(name, file.hamiltonian, algebra, names)
    casimirs: dict[str, Polynomial] | None = None if file.casimirs is None else {}
    for key, polynomial in (file.casimirs or {}).items():
        assert casimirs is not None
        with section(name, f"casimirs.{key}"):
            casimirs[key] = parse_polynomial(polynomial, algebra.dim, names)
    with section(name, "casimirs"):
        LiePoissonSystem(algebra, 0 * Polynomial.variable(0, algebra.dim), casimirs=casimirs)
    with section(name, "hamiltonian"):
        return LiePoissonSystem(algebra, hamiltonian, sign=file.sign or 1, casimirs=casimirs, name=file.name)


def method_of_file(name: str, table: Mapping[str, Any]) -> Method:
    """Return the scheme of the table ``[method]``; ConfigurationError with the key."""
    with section(name, "method"):
        return registry.from_description(table)


def _check_dimension(name: str, table: AlgebraTable, states: Any) -> None:
    """Reject a dimension other than the length of the state, before anything of that size is allocated."""
    if table.dim is None or isinstance(states, str):
        return
    shape = np.shape(states)
    if shape[-1] != table.dim and table.basis is None:
        raise ConfigurationError(
            f"{name}: initial.x: x0 has the shape {shape}; it must be ({short(table.dim)},), or that of members"
        )


def _algebra(name: str, table: AlgebraTable) -> LieAlgebra:
    has_brackets, has_matrices = table.brackets is not None, table.matrices is not None
    if has_brackets and has_matrices:
        raise ConfigurationError(f"{name}: algebra.matrices: is given with brackets, which follow from it; give one")
    for key in ("dim", "basis"):
        if getattr(table, key) is not None and not has_brackets and not has_matrices:
            raise ConfigurationError(
                f"{name}: algebra.brackets: is missing; give it with {key}, or a name of the catalogue"
            )
    if not has_brackets and not has_matrices:
        if table.name is None:
            raise ConfigurationError(
                f"{name}: algebra.name: is missing; give it, or brackets with dim or basis, or matrices"
            )
        if "name" in table.parameters:
            raise ConfigurationError(f"{name}: algebra.parameters.name: no algebra has a parameter of this name")
        with section(name, "algebra"):
            return catalogue.get(table.name, **table.parameters)
    if table.name is not None:
        given = "brackets" if has_brackets else "matrices"
        raise ConfigurationError(
            f"{name}: algebra.name: is for an algebra of the catalogue; give it or {given}, not both "
            "(a title goes into the key name at the top)"
        )
    if table.parameters:
        raise ConfigurationError(
            f"{name}: algebra.parameters: belongs to an algebra of the catalogue; write numbers in brackets"
        )
    if table.matrices is not None:
        if table.dim not in (None, len(table.matrices)):
            raise ConfigurationError(
                f"{name}: algebra.dim: is {table.dim}, and there are {len(table.matrices)} matrices"
            )
        with section(name, "algebra.matrices"):
            return LieAlgebra.from_matrices(table.matrices, basis=table.basis)
    dim = table.dim if table.dim is not None else len(table.basis or ())
    if dim == 0:
        raise ConfigurationError(f"{name}: algebra.dim: is missing; give it, or basis")
    basis = table.basis if table.basis is not None else [f"e{i + 1}" for i in range(dim)]
    if len(basis) != dim:
        raise ConfigurationError(f"{name}: algebra.basis: has {len(basis)} names; dim is {dim}")
    with section(name, "algebra.brackets"):
        return LieAlgebra.from_brackets(dim, table.brackets or {}, basis=basis)


def _hamiltonian(name: str, table: HamiltonianTable, algebra: LieAlgebra, names: Sequence[str]) -> Any:
    whole = "formula" if table.formula is not None else "polynomial"
    if getattr(table, whole) is not None:
        for key in ("M", "linear", "constant", "polynomial"):
            if key != whole and getattr(table, key) is not None:
                raise ConfigurationError(f"{name}: hamiltonian.{key}: is given with {whole}; include it there")
    if table.parameters and table.formula is None:
        raise ConfigurationError(f"{name}: hamiltonian.parameters: belongs to a formula; give formula, or omit them")
    if table.formula is not None:
        for key in table.parameters:
            with section(name, f"hamiltonian.parameters.{key}"):
                read_parameters({key: table.parameters[key]}, names)
        with section(name, "hamiltonian.formula"):
            return formula_in(table.formula, algebra.dim, names, table.parameters)
    if table.polynomial is not None:
        with section(name, "hamiltonian.polynomial"):
            return parse_polynomial(table.polynomial, algebra.dim, names)
    if table.M is None and table.linear is None:
        raise ConfigurationError(f"{name}: hamiltonian.M: is missing; give M, linear or both, or formula")
    with section(name, "hamiltonian"):
        M, constant = 0.0 if table.M is None else table.M, table.constant or 0.0
        return as_hamiltonian(
            Quadratic(M, linear=table.linear, constant=constant), algebra.dim, algebra.name or "the algebra"
        )


MAX_REPORTED = 4  # errors joined in one message
MAX_LINES = 20  # lines of errors that the command prints: one screen
MAX_LINE_LENGTH = 360  # of a joined message, without file name and separators


class ErrorCollector:
    """Collector of errors in the sections of the file `name`."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._errors: list[ConfigurationError] = []

    @contextmanager
    def collect(self) -> Iterator[None]:
        """Collect an error raised inside, and continue."""
        try:
            yield
        except ConfigurationError as error:
            self._errors.append(error)

    def add(self, message: str) -> None:
        """Add an error: key and reason."""
        self._errors.append(ConfigurationError(f"{self._name}: {message}"))

    def raise_collected(self) -> None:
        """Raise the collected errors: a single one unchanged, several joined in one line, with `error_lines`."""
        if not self._errors:
            return
        lines = list(dict.fromkeys(line for error in self._errors for line in error.error_lines or (str(error),)))
        if len(lines) == 1:
            raise self._errors[0]
        joined = join_messages([line.removeprefix(f"{self._name}: ") for line in lines])
        error = ConfigurationError(f"{self._name}: {joined}")
        omitted = len(lines) - MAX_LINES
        error.error_lines = (*lines[:MAX_LINES], *([f"{self._name}: {omitted} more"] if omitted > 0 else []))
        raise error from self._errors[0].__cause__


def join_messages(messages: Sequence[str]) -> str:
    """Join messages in one line, each truncated; of those beyond the fourth, only the number is given."""
    unique = list(dict.fromkeys(messages))
    if len(unique) == 1:
        return unique[0]
    reported, omitted = unique[:MAX_REPORTED], len(unique) - MAX_REPORTED
    lines = [in_one_line(message, MAX_LINE_LENGTH // len(reported)) for message in reported]
    return "; and ".join([*lines, *([f"{omitted} more"] if omitted > 0 else [])])


def initial_state(system: Any, value: Any, folder: Path) -> Any:
    """Return initial states from numbers or a ``.npy`` file; entries of complex matrices may be pairs."""
    if isinstance(value, str):
        return array_of_file(folder / value, value)
    if not system.has_matrices or not system.complex:
        return value
    array = np.array(value, dtype=np.float64)
    pairs = array.ndim > 2 and array.shape[-1] == 2 and array.shape[-3:-1] == system.algebra.shape
    return array[..., 0] + 1j * array[..., 1] if pairs else array


def array_of_file(path: Path, named: str) -> NDArray[Any]:
    """Return the array of numbers in a file ``.npy``, without unpickling; errors refer to the file as `named`."""
    if path.suffix != NPY_SUFFIX:
        raise ValueError(f"{short(named)} is no state; give numbers, or the name of a file {NPY_SUFFIX}")
    try:
        return read_array_file(path, named)
    except OSError as reason:
        raise ValueError(f"{short(named)} cannot be read ({reason.strerror or reason})") from None


def check_named(name: str, file: File) -> None:
    """Reject a named state without a ready-made system; ConfigurationError with the key."""
    if file.initial.kind is not None and file.system is None:
        raise ConfigurationError(f"{name}: initial.kind: only ready-made systems have named states; give x")


def _numbers_of_field(value: Any, folder: Path, key: str) -> Any:
    """Return modes from rows ``[l, m, real]`` or ``[l, m, real, imaginary]``, values as given, or those of a file."""
    if isinstance(value, str):
        return array_of_file(folder / value, value)
    if key == "values":
        return value
    rule = "give a list of [number, number, real] or [number, number, real, imaginary], or a file .npy"
    rows = value if isinstance(value, list) else [value]
    if not all(isinstance(row, list) and len(row) in (3, 4) for row in rows):
        raise ValueError(f"modes is {short(value)}; {rule}")
    if len({(row[0], row[1]) for row in rows}) < len(rows):
        raise ValueError(f"modes has a mode twice, {short(value)}; give each once")
    return {(row[0], row[1]): row[2] if len(row) == 3 else complex(row[2], row[3]) for row in rows}


def state_by_name(name: str, table: InitialTable, system: Any) -> Any:
    """Return the state named in ``states_by_name`` of its system, or None if the file names none."""
    from coadjoint.files.configuration.parsing import keys_by_table, unknown_key

    if table.kind is None:
        return None
    family = system.unforced
    with section(name, "initial.kind"):
        if not (known := getattr(family, "states_by_name", ())):
            raise ValueError(f"{family.name} has no named initial states; give x")
        function = getattr(family, read_choice(table.kind, "initial state", known))
    parameters = inspect.signature(function).parameters
    for key in table.parameters:
        if key not in parameters:
            elsewhere = {table: keys for table, keys in keys_by_table().items() if table != "[initial]"}
            raise ConfigurationError(f"{name}: initial.{key}: {unknown_key(key, parameters, elsewhere)}")
    arguments, folder = dict(table.parameters), Path(name).parent
    if isinstance(arguments.get("path"), str):
        arguments["path"] = str(folder / arguments["path"])
    with section(name, "initial"):
        for key in {"modes", "values"} & arguments.keys():
            arguments[key] = _numbers_of_field(arguments[key], folder, key)
        required = [key for key, parameter in parameters.items() if parameter.default is inspect.Parameter.empty]
        check_parameters(table.kind, arguments, parameters, required)
        try:
            return function(**arguments)
        except OSError as reason:
            raise ValueError(f"{reason.filename or table.kind}: {reason.strerror or reason}") from None

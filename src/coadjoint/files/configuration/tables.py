"""Tables of configuration files about the system and its state: their models, and what they describe."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    FiniteFloat,
    Tag,
    ValidationError,
    WrapValidator,
    model_validator,
)
from pydantic_core import PydanticCustomError

from coadjoint.algebra import catalogue
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.algebra.polynomials.formula_tree import read_parameters
from coadjoint.files.records.reconstruction import polynomial_of
from coadjoint.memory import check_available_memory
from coadjoint.regular_files import read_array_file
from coadjoint.short_repr import short
from coadjoint.systems.hamiltonians.hamiltonian import as_hamiltonian, formula_in
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.validation import check_parameters, read_choice

MAX_SHOWN_LENGTH = 60  # characters of a value in an error, most of a line
NPY_SUFFIX = ".npy"
BYTES_PER_COORDINATE = 400  # of an algebra with names of coordinates; measured, with a margin


def as_written(rule: str) -> WrapValidator:
    """Return a validator that does not convert values; the error is that a value must be `rule`."""

    def check(value: Any, handler: Callable[[Any], Any]) -> Any:
        try:
            handler(value)
        except ValidationError:
            raise ValueError(f"must be {rule}, not {short(value, MAX_SHOWN_LENGTH)}") from None
        return value

    return WrapValidator(check)


def _printable(value: str) -> str:
    if not value.isprintable():
        raise ValueError(f"must be printable characters in one line, not {short(value, MAX_SHOWN_LENGTH)}")
    return value


def by_key(default: str, **tags: str) -> Discriminator:
    """Return the discriminator of tables by the first of these keys that a table has."""

    def tag(table: Any) -> str:
        return next((tags[key] for key in tags if isinstance(table, Mapping) and key in table), default)

    return Discriminator(tag)


Row = list[FiniteFloat]
Rows = list[list[FiniteFloat]]
Term = Annotated[tuple[FiniteFloat, list[int]], Field(strict=False)]
NpyFile = Annotated[str, Field(pattern=r"\.npy$")]

Name = Annotated[str, AfterValidator(_printable)]
Number = Annotated[FiniteFloat, as_written("a number")]
Vector = Annotated[Row, Field(min_length=1), as_written("a list of numbers")]
Span = Annotated[Row, Field(min_length=2, max_length=2), as_written("a list of two numbers")]
Matrix = Annotated[FiniteFloat | Row | Rows, as_written("a number, a list of numbers or a list of lists of numbers")]
States = Annotated[
    Row | Rows | list[Rows] | list[list[Rows]] | NpyFile,
    as_written("a list of numbers or of lists of numbers; matrices may be lists of these, or in a file .npy"),
]
Attitude = Annotated[
    bool | Literal["coadjoint"] | Row | Rows,
    as_written("true, false, 'coadjoint', or the initial group element, a matrix or a quaternion"),
]
Polynomial = Annotated[
    str | list[Term], as_written("text such as '0.5*x1^2 + x2*x3' or a list of [coefficient, [exponents]]")
]
WholeNumber = Annotated[int, Field(ge=1)]


CONFIG = ConfigDict(extra="forbid", strict=True, use_attribute_docstrings=True)
"""No unknown keys, no type conversion; attribute docstrings become schema descriptions."""


def wrong_keys(table: type[BaseModel], keys: Collection[str]) -> list[str]:
    """Return the unknown keys of a table, or else its missing ones, of which an unknown one may be the misspelling."""
    fields, is_open = table.model_fields, table.model_config["extra"] == "allow"
    unknown = [key for key in keys if key not in fields and not is_open]
    return unknown or [key for key, field in fields.items() if field.is_required() and key not in keys]


class Table(BaseModel):
    """Base of all tables."""

    model_config = CONFIG

    @model_validator(mode="before")
    @classmethod
    def _check_keys(cls, table: Any) -> Any:
        if isinstance(table, Mapping) and (wrong := wrong_keys(cls, table.keys())):
            raise PydanticCustomError("wrong_keys", "wrong keys", {"keys": wrong, "table": cls})
        return table


class SystemTable(Table):
    """A ready-made system; `coadjoint systems` lists them."""

    name: str
    """The name of the system."""
    parameters: dict[str, Any] = {}
    """Its parameters; omitted ones have their defaults."""


class CatalogueAlgebra(Table):
    """An algebra of the catalogue; `coadjoint algebras` lists them."""

    name: str
    """An algebra of the catalogue, such as "so(4)" or "A3,7"."""
    parameters: dict[str, Any] = {}
    """Its parameters: numbers without unit."""

    def algebra(self) -> LieAlgebra:
        """Return the algebra."""
        return catalogue.get(self.name, **self.parameters)


class BracketAlgebra(Table):
    """An algebra of your own, by its brackets."""

    model_config = ConfigDict(json_schema_extra={"anyOf": [{"required": ["dim"]}, {"required": ["basis"]}]})

    dim: WholeNumber | None = None
    """The dimension; the basis is then e1, e2, ..."""
    basis: list[Name] | None = None
    """The names of its basis elements, in the order of the coordinates."""
    brackets: list[str]
    """Its brackets, such as "[e1, e2] = 2 e3 - e1"; those that are not listed are zero."""

    @model_validator(mode="after")
    def _one_dimension(self) -> BracketAlgebra:
        if self.dim is None and not self.basis:
            raise ValueError("dim is missing; give it, or basis")
        if self.dim is not None and self.basis is not None and len(self.basis) != self.dim:
            raise ValueError(f"basis has {len(self.basis)} names; dim is {self.dim}")
        return self

    def algebra(self) -> LieAlgebra:
        """Return the algebra."""
        dim = self.dim or len(self.basis or ())
        check_available_memory(BYTES_PER_COORDINATE * dim, f"an algebra of dimension {short(dim)}")
        basis = self.basis or [f"e{i + 1}" for i in range(dim)]
        return LieAlgebra.from_brackets(dim, self.brackets or {}, basis=basis)


class MatrixAlgebra(Table):
    """An algebra of your own, by square matrices, which are a basis and a representation."""

    basis: list[Name] | None = None
    """The names of its basis elements, in the order of the coordinates."""
    matrices: list[list[list[Number]]]
    """The matrices; the brackets are their commutators."""

    def algebra(self) -> LieAlgebra:
        """Return the algebra."""
        return LieAlgebra.from_matrices(self.matrices, basis=self.basis)


class QuadraticTable(Table):
    """The energy H = x.Mx/2 + linear.x + constant."""

    M: Matrix | None = None
    """A number, the diagonal, or the symmetric matrix (energy per momentum squared)."""
    linear: Vector | None = None
    """The linear term (energy per momentum)."""
    constant: Number | None = None
    """A constant that is added to H (an energy)."""

    @model_validator(mode="after")
    def _not_empty(self) -> QuadraticTable:
        if self.M is None and self.linear is None:
            raise ValueError("M is missing; give M, linear or both, or formula")
        return self

    def energy(self, algebra: LieAlgebra, names: Sequence[str]) -> Any:
        """Return the Hamiltonian."""
        M, constant = 0.0 if self.M is None else self.M, self.constant or 0.0
        H = Quadratic(M, linear=self.linear, constant=constant)
        return as_hamiltonian(H, algebra.dim, algebra.name or "the algebra")


class FormulaTable(Table):
    """The energy H as a formula."""

    formula: str
    """All of H: text such as "a*(x1 + x2)^2/2 + cos(x3)" (an energy)."""
    parameters: dict[Name, Number] = {}
    """Numbers in the formula by name."""

    def energy(self, algebra: LieAlgebra, names: Sequence[str]) -> Any:
        """Return the Hamiltonian."""
        read_parameters(self.parameters, names)
        return formula_in(self.formula, algebra.dim, names, self.parameters)


class PolynomialTable(Table):
    """The energy H as a polynomial."""

    polynomial: Polynomial
    """All of H, a polynomial: text, or a list of [coefficient, [exponents]] (an energy)."""

    def energy(self, algebra: LieAlgebra, names: Sequence[str]) -> Any:
        """Return the Hamiltonian."""
        return polynomial_of(self.polynomial, algebra.dim, names)


class InitialTable(Table):
    """The initial group element."""

    attitude: Attitude = False
    """Whether the group element (attitude) is computed: true, "coadjoint", or its start: a matrix or a quaternion."""


class StateTable(InitialTable):
    """The initial state, or states, as numbers."""

    x: States
    """The initial momentum; a list of them is an ensemble. Or the name of a file .npy, from the folder of this file."""

    def state(self, system: Any, folder: Path) -> Any:
        """Return the states; entries of complex matrices may be pairs."""
        if isinstance(self.x, str):
            return array_of_file(folder / self.x, self.x)
        if not system.has_matrices or not system.complex:
            return self.x
        array = np.array(self.x, dtype=np.float64)
        pairs = array.ndim > 2 and array.shape[-1] == 2 and array.shape[-3:-1] == system.algebra.shape
        return array[..., 0] + 1j * array[..., 1] if pairs else array


class NamedStateTable(InitialTable):
    """A state that the system provides, with its parameters as further keys."""

    model_config = ConfigDict(extra="allow")

    kind: str
    """The name of the state."""

    def state(self, system: Any, folder: Path) -> Any:
        """Return the state."""
        family = system.unforced
        if not (known := getattr(family, "states_by_name", ())):
            raise ValueError(f"{family.name} has no named initial states; give x in place of kind")
        function = getattr(family, read_choice(self.kind, "initial state", known))
        parameters = inspect.signature(function).parameters
        arguments = dict(self.model_extra or {})
        required = [key for key, parameter in parameters.items() if parameter.default is inspect.Parameter.empty]
        check_parameters(self.kind, arguments, parameters, required)
        if isinstance(arguments.get("path"), str):
            arguments["path"] = str(folder / arguments["path"])
        for key in {"modes", "values"} & arguments.keys():
            arguments[key] = _field_values(arguments[key], folder, key)
        return function(**arguments)


def array_of_file(path: Path, named: str) -> NDArray[Any]:
    """Return the array of numbers in a file ``.npy``, without unpickling; errors refer to the file as `named`."""
    if path.suffix != NPY_SUFFIX:
        raise ValueError(f"{short(named)} is no array; give the name of a file {NPY_SUFFIX}")
    return read_array_file(path, named)


def _field_values(value: Any, folder: Path, key: str) -> Any:
    """Return modes from rows ``[l, m, real]`` or ``[l, m, real, imaginary]``, values as given, or those of a file."""
    if isinstance(value, str):
        return array_of_file(folder / value, value)
    if key == "values":
        return value
    rows = value if isinstance(value, list) else [value]
    if not all(isinstance(row, list) and len(row) in (3, 4) for row in rows):
        rule = "give a list of [number, number, real] or [number, number, real, imaginary], or a file .npy"
        raise ValueError(f"modes is {short(value)}; {rule}")
    if len({(row[0], row[1]) for row in rows}) < len(rows):
        raise ValueError(f"modes has a mode twice, {short(value)}; give each once")
    return {(row[0], row[1]): row[2] if len(row) == 3 else complex(row[2], row[3]) for row in rows}


Algebra = Annotated[
    Annotated[CatalogueAlgebra, Tag("<name>")]
    | Annotated[BracketAlgebra, Tag("<brackets>")]
    | Annotated[MatrixAlgebra, Tag("<matrices>")],
    by_key("<name>", matrices="<matrices>", brackets="<brackets>", dim="<brackets>", basis="<brackets>"),
]
Energy = Annotated[
    Annotated[QuadraticTable, Tag("<M>")]
    | Annotated[FormulaTable, Tag("<formula>")]
    | Annotated[PolynomialTable, Tag("<polynomial>")],
    by_key("<M>", formula="<formula>", polynomial="<polynomial>"),
]
Initial = Annotated[
    Annotated[StateTable, Tag("<x>")] | Annotated[NamedStateTable, Tag("<kind>")], by_key("<x>", kind="<kind>")
]

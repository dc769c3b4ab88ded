"""The models of configuration files: keys, types, defaults, rules and descriptions; errors with key and reason."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

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
    WithJsonSchema,
    WrapValidator,
    model_validator,
)

from coadjoint import systems
from coadjoint.algebra import catalogue
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.algebra.polynomials.formula_tree import read_parameters
from coadjoint.algebra.polynomials.polynomial import Polynomial as ExactPolynomial
from coadjoint.errors import ConfigurationError, in_one_line, nearest
from coadjoint.files.records.reconstruction import polynomial_of
from coadjoint.keyword_hints import vocabulary
from coadjoint.methods.registry import from_description
from coadjoint.regular_files import read_array_file
from coadjoint.runs.times import output_times_of, times_of
from coadjoint.short_repr import short
from coadjoint.systems.coordinates import declared_names
from coadjoint.systems.forces.registry import kinds as kinds_of_forces
from coadjoint.systems.hamiltonians.hamiltonian import as_hamiltonian, formula_in
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.registry import ready_made_systems
from coadjoint.systems.system import System
from coadjoint.validation import check_parameters, read_choice
from coadjoint.validation import from_description as described

GRIDS = ("linear", "logarithmic")
DISTRIBUTIONS = ("uniform", "normal", "sphere", "orbit")
SETTING_KINDS = ("values", *GRIDS, *DISTRIBUTIONS, "file")
STATE_KEY = "initial.x"
SWEPT_TABLES = ("system.parameters", "algebra.parameters", "hamiltonian", "forces", "initial")
_KEY = re.compile(r"[A-Za-z_][\w-]*(\[\d{1,9}\])*(\.[A-Za-z_][\w-]*(\[\d{1,9}\])*)*")
MAX_SEED = 2**63 - 1
MAX_SHOWN_LENGTH = 60  # characters of a value in an error, most of a line
MAX_REASON = 300  # characters of a reason, some lines of a terminal
MAX_LINES = 20  # lines of errors that the command prints: one screen
NPY_SUFFIX = ".npy"


@contextmanager
def section(name: str | Path, key: str) -> Iterator[None]:
    """Convert errors inside the context to `ConfigurationError` with the file `name` and the dotted `key`."""
    try:
        yield
    except ConfigurationError:
        raise
    except REPORTED as error:
        raise ConfigurationError(f"{name}: {_line(key, _reason(error))}") from error


REPORTED = ValueError, TypeError, OSError, ArithmeticError, RecursionError, MemoryError


def _reason(error: Exception) -> str:
    if isinstance(error, OSError):
        return f"cannot be read ({error.strerror or error}: {error.filename})"
    if isinstance(error, ValueError | TypeError):
        return str(error)
    return f"is too large, or nested too deeply: {type(error).__name__}, {error}"


def _line(key: str, reason: str) -> str:
    return (f"{in_one_line(key, 80)}: " if key else "") + in_one_line(reason, MAX_REASON)


def built(build: Callable[[Any], Any]) -> AfterValidator:
    """Return a validator that replaces a table by the object that it describes."""

    def validate(table: Any) -> Any:
        try:
            return build(table)
        except REPORTED as error:
            raise ValueError(_reason(error)) from error

    return AfterValidator(validate)


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


def by_key(default: str, **tables: str) -> Discriminator:
    """Return the discriminator of tables, tagged by their classes, by the first of these keys that a table has."""

    def tag(table: Any) -> str:
        return f"<{next((tables[key] for key in tables if isinstance(table, Mapping) and key in table), default)}>"

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


class Table(BaseModel):
    """Base of all tables."""

    model_config = CONFIG


class SystemTable(Table):
    """A ready-made system; `coadjoint systems` lists them."""

    name: str
    """The name of the system."""
    parameters: dict[str, Any] = {}
    """Its parameters; omitted ones have their defaults."""


class CatalogueTable(Table):
    """An algebra of the catalogue; `coadjoint algebras` lists them."""

    name: str
    """An algebra of the catalogue, such as "so(4)" or "A3,7"."""
    parameters: dict[str, Any] = {}
    """Its parameters: numbers without unit."""

    def algebra(self) -> LieAlgebra:
        """Return the algebra."""
        return catalogue.get(self.name, **self.parameters)


class BracketsTable(Table):
    """An algebra of your own, by its brackets."""

    model_config = ConfigDict(json_schema_extra={"anyOf": [{"required": ["dim"]}, {"required": ["basis"]}]})

    dim: WholeNumber | None = None
    """The dimension; the basis is then e1, e2, ..."""
    basis: list[Name] | None = None
    """The names of its basis elements, in the order of the coordinates."""
    brackets: list[str]
    """Its brackets, such as "[e1, e2] = 2 e3 - e1"; those that are not listed are zero."""

    @model_validator(mode="after")
    def _one_dimension(self) -> BracketsTable:
        if self.dim is None and not self.basis:
            raise ValueError("dim is missing; give it, or basis")
        if self.dim is not None and self.basis is not None and len(self.basis) != self.dim:
            raise ValueError(f"basis has {len(self.basis)} names; dim is {self.dim}")
        return self

    def algebra(self) -> LieAlgebra:
        """Return the algebra."""
        return LieAlgebra.from_brackets(self.dim or len(self.basis or ()), self.brackets or {}, basis=self.basis)


class MatricesTable(Table):
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
    Annotated[CatalogueTable, Tag("<CatalogueTable>")]
    | Annotated[BracketsTable, Tag("<BracketsTable>")]
    | Annotated[MatricesTable, Tag("<MatricesTable>")],
    by_key("CatalogueTable", matrices="MatricesTable", **dict.fromkeys(("brackets", "dim", "basis"), "BracketsTable")),
    built(lambda table: table.algebra()),
]
Energy = Annotated[
    Annotated[QuadraticTable, Tag("<QuadraticTable>")]
    | Annotated[FormulaTable, Tag("<FormulaTable>")]
    | Annotated[PolynomialTable, Tag("<PolynomialTable>")],
    by_key("QuadraticTable", formula="FormulaTable", polynomial="PolynomialTable"),
]
Initial = Annotated[
    Annotated[StateTable, Tag("<StateTable>")] | Annotated[NamedStateTable, Tag("<NamedStateTable>")],
    by_key("StateTable", kind="NamedStateTable"),
]

Two = Annotated[list[Any], Field(min_length=2, max_length=2)]
Positive = Annotated[FiniteFloat, Field(gt=0)]
DatasetFile = Annotated[str, WithJsonSchema({"type": "string", "pattern": r"\.(nc|zarr)(/\.?)*$"})]
FigureFile = Annotated[str, WithJsonSchema({"type": "string", "pattern": r"\.(png|pdf|svg)(/\.?)*$"})]
MovieFile = Annotated[str, WithJsonSchema({"type": "string", "pattern": r"\.(mp4|gif)(/\.?)*$"})]


class RunTable(Table):
    """The times of the run, and what is saved and watched. Either `step` or `accuracy`."""

    model_config = ConfigDict(json_schema_extra={"oneOf": [{"required": ["step"]}, {"required": ["accuracy"]}]})

    t_span: Span
    """Start and end (time); the run goes backward if the end is the smaller one."""
    step: Positive | None = None
    """Length of a step (time); it divides the span."""
    accuracy: Annotated[float, Field(gt=0, lt=1)] | None = None
    """Instead of `step`: the required error of the momentum at the end, relative to the largest momentum during the run
    (no unit). The step is chosen, and without `method` also the scheme."""
    save_every: WholeNumber = 1
    """Number of steps from one saved state to the next."""
    t_eval: Vector | None = None
    """Times at which states are saved, instead of `save_every` (time)."""
    watch: bool = True
    """Whether the invariants are computed after every step, or only at the saved states."""
    threads: WholeNumber | None = None
    """Number of threads for the members of an ensemble; by default all cores. Results do not depend on it."""
    workers: WholeNumber | None = None
    """Number of processes of this machine that run the members in blocks; by default this process only."""

    @model_validator(mode="after")
    def _check_times(self) -> RunTable:
        if (self.step is None) == (self.accuracy is None):
            problem = "step is missing" if self.step is None else "step and accuracy are both given"
            raise ValueError(f"{problem}; give step, or accuracy to have it chosen")
        if self.step is not None:
            times = times_of(self.t_span, self.step, self.save_every)
            if self.t_eval is not None:
                output_times_of(self.t_eval, times, self.save_every)
        return self

    @property
    def span(self) -> tuple[float, float]:
        """Start and end."""
        return float(self.t_span[0]), float(self.t_span[1])


class EventTable(Table):
    """An event: a function of the state passes through zero."""

    g: Annotated[int | Polynomial, as_written("the number of a coordinate, its name, or a polynomial")]
    """The function: the number of a coordinate, from 0, its name, or a polynomial."""
    direction: Annotated[int, WithJsonSchema({"enum": [-1, 0, 1]})] = 0
    """1 where g rises, -1 where it falls, 0 for both."""
    count: WholeNumber | None = None
    """Number of crossings recorded for each member; by default all."""
    terminal: bool = False
    """Whether the run ends at the last recorded crossing."""


class OutputTable(Table):
    """Paths of the results, relative to the current directory."""

    file: DatasetFile | None = None
    """The solution as a dataset, .nc or .zarr."""
    archive: str | None = None
    """A new folder, such as run.zarr, to which the run is written while it runs; `coadjoint resume` continues it."""
    figure: FigureFile | None = None
    """A figure of the run, .png, .pdf or .svg."""
    movie: MovieFile | None = None
    """A movie of the run, .mp4 or .gif."""


class SettingsTable(Table):
    """The values of one key of the file: listed values, a grid, random numbers, or the rows of an array."""

    values: Annotated[list[Any], Field(min_length=1)] | None = None
    """The values themselves; a plain list means the same."""
    linear: Two | None = None
    """A grid from the first number to the last, in equal steps (unit of the key)."""
    logarithmic: Two | None = None
    """A grid from the first number to the last, in equal ratios (unit of the key)."""
    count: Annotated[int, Field(ge=2)] | None = None
    """Number of values of a grid."""
    uniform: Two | None = None
    """Random numbers between the first and the second (unit of the key)."""
    normal: Two | None = None
    """Random numbers of this mean and this standard deviation (unit of the key)."""
    sphere: Positive | None = None
    """Random vectors of this length (unit of the key)."""
    orbit: Positive | None = None
    """States on the coadjoint orbit of the state in the file, moved by random group elements of this size."""
    file: str | None = None
    """The rows of an array in a file .npy, relative to the folder of this file."""
    column: Annotated[int, Field(ge=0)] | None = None
    """The column of the array, from 0; by default the whole row."""

    @model_validator(mode="before")
    @classmethod
    def _listed(cls, value: Any) -> Any:
        return {"values": value} if isinstance(value, list) else value

    @model_validator(mode="after")
    def _exactly_one_kind(self) -> SettingsTable:
        kinds = [kind for kind in SETTING_KINDS if getattr(self, kind) is not None]
        if len(kinds) != 1:
            problem = f"has {' and '.join(kinds)}; give one" if kinds else "has none"
            raise ValueError(f"{problem} of {', '.join(SETTING_KINDS)}")
        if (self.count is None) == (kinds[0] in GRIDS):
            raise ValueError(f"count belongs to a grid, {' or '.join(GRIDS)}, and is its number of values")
        if self.column is not None and self.file is None:
            raise ValueError("column belongs to file, and selects a column of the array")
        return self

    @property
    def kind(self) -> str:
        """The kind of settings, one of `SETTING_KINDS`."""
        return next(kind for kind in SETTING_KINDS if getattr(self, kind) is not None)


def parse_key(text: str) -> tuple[str | int, ...]:
    """Return the names and indices of a key, such as 'initial.x[0]'."""
    return tuple(int(part) if part.isdecimal() else part for part in re.findall(r"[\w-]+", text))


def _swept_key(text: str) -> str:
    if not _KEY.fullmatch(text):
        raise ValueError(
            f"{short(text)} is no key of a file; give one such as 'initial.x[0]' or 'system.parameters.inertia[2]'"
        )
    if not text.startswith(tuple(f"{root}{mark}" for root in SWEPT_TABLES for mark in ".[")):
        raise ValueError(f"only keys within {', '.join(SWEPT_TABLES)} can be swept")
    if parse_key(text)[:2] in (("initial", "attitude"), ("initial", "kind")):
        raise ValueError(f"{text} is the same for all members")
    return text


class SweepTable(Table):
    """The keys of the file that change from member to member, and the number of random members."""

    samples: WholeNumber | None = None
    """Number of random members."""
    seed: Annotated[int, Field(ge=0, le=MAX_SEED)] | None = None
    """The seed of the random numbers."""
    over: Annotated[dict[Annotated[str, AfterValidator(_swept_key)], SettingsTable], Field(min_length=1)]
    """Keys of the file, such as "initial.x[0]", and the values of each. Every combination is a member."""

    @model_validator(mode="after")
    def _check_samples(self) -> SweepTable:
        random_keys = [key for key, settings in self.over.items() if settings.kind in DISTRIBUTIONS]
        if random_keys and (self.samples is None or self.seed is None):
            raise ValueError(f"over {short(random_keys[0])} is random; give samples (their number) and seed")
        if not random_keys and (self.samples is not None or self.seed is not None):
            raise ValueError(f"samples and seed belong to random settings, {', '.join(DISTRIBUTIONS)}; there are none")
        for key, settings in self.over.items():
            if settings.kind == "orbit" and key != STATE_KEY:
                raise ValueError(f"over {key} has an orbit, which applies to states only; give it for {STATE_KEY!r}")
            if outer := [other for other in self.over if key.startswith((f"{other}.", f"{other}["))]:
                raise ValueError(f"over {key} is within {outer[0]}, which is swept too; omit one")
        return self


def _ready_made(table: SystemTable) -> Any:
    return systems.get(read_choice(table.name, "system", ready_made_systems()), **table.parameters)


def _force(description: dict[str, Any]) -> Any:
    return described("force", kinds_of_forces(), description)


class File(Table):
    """A run: the system, the initial state, the scheme, the times, and the paths of the results."""

    model_config = ConfigDict(validate_assignment=True)

    name: Name | None = None
    """The name of the system, for pictures and messages."""
    sign: Annotated[int, WithJsonSchema({"enum": [1, -1]})] | None = None
    """1: x' = J grad H, the default. -1: x' = -J grad H, the convention of the body."""
    system: Annotated[SystemTable, built(_ready_made)] | None = None
    """A ready-made system; `coadjoint systems` lists them."""
    algebra: Algebra | None = None
    """In place of `system`: an algebra of the catalogue, or one given by brackets or matrices."""
    hamiltonian: Energy | None = None
    """The energy H on the dual of `algebra`: x.Mx/2 + linear.x + constant, or a formula or polynomial."""
    casimirs: dict[Name, Polynomial] | None = None
    """Polynomials by name, checked to be Casimirs and recorded during the run."""
    forces: list[Annotated[dict[str, Any], built(_force)]] = []
    """Forces in addition to H, one table for each: its name and its parameters."""
    initial: Initial
    """The initial state, or several; or a kind of state, with its parameters as further keys."""
    sweep: SweepTable | None = None
    """The keys of the file that change from member to member, and the number of random members."""
    method: Annotated[dict[str, Any], built(from_description)] | None = None
    """The scheme: its name and its parameters. `coadjoint methods` lists them."""
    run: RunTable
    """The times of the run, and what is saved and watched."""
    observe: dict[Name, Polynomial] = {}
    """Polynomials by name, evaluated at the saved states."""
    events: dict[Name, EventTable] = {}
    """Events by name."""
    output: OutputTable = Field(default_factory=OutputTable)
    """Paths of the results, relative to the current directory."""


def validate(name: str, raw: Mapping[str, Any], only: str = "") -> File:
    """Return the file of these tables, or of `only` one; ConfigurationError has a line for each error."""
    try:
        if not only:
            return File.model_validate(raw)
        file = File.model_construct()
        if only in raw:
            setattr(file, only, raw[only])
        return file
    except ValidationError as invalid:
        lines = [f"{name}: {_line(key, reason)}" for key, reason in dict.fromkeys(_errors_in(invalid))]
    error = ConfigurationError("; ".join([lines[0], *(line.removeprefix(f"{name}: ") for line in lines[1:])]))
    omitted = [f"{name}: {len(lines) - MAX_LINES} more"] if len(lines) > MAX_LINES else []
    error.error_lines = (*lines[:MAX_LINES], *omitted)
    raise error


def _errors_in(invalid: ValidationError) -> Iterator[tuple[str, str]]:
    """Yield dotted key and reason of each error; a missing key may be misspelled as an unknown one beside it."""
    entries = invalid.errors(include_url=False)
    misspelled = {entry["loc"][:-1] for entry in entries if entry["type"] == "extra_forbidden"}
    for entry in entries:
        kind, (*place, key) = entry["type"], entry["loc"]
        if kind == "missing" and entry["loc"][:-1] in misspelled:
            continue
        # Variants of tables have tags in brackets, and pydantic appends "[key]" for an invalid key of a table.
        parts = [part for part in entry["loc"] if isinstance(part, int) or part[:1] not in ("<", "[")]
        path = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in parts).lstrip(".")
        if kind in ("missing", "extra_forbidden"):
            yield path, wrong_key(str(key), _table_at(place))
        elif (reason := entry.get("ctx", {}).get("error")) is not None:
            yield path, str(reason)
        else:
            rule = "must be a table" if kind in ("model_type", "dict_type") else entry["msg"]
            rule = rule.replace("Input should", "must")
            yield path, f"{rule[:1].lower()}{rule[1:]}; it is {short(entry['input'], MAX_SHOWN_LENGTH)}"


def _table_at(place: Sequence[str | int]) -> type[BaseModel]:
    """Return the model of the table at a place, of the variants the one with its tag."""
    tables: list[type[BaseModel]] = [File]
    for part in place:
        fields = [table.model_fields[part] for table in tables if part in table.model_fields]
        inner = [one for field in fields for one in _tables_in(field.annotation)]
        tables = [one for one in tables if f"<{one.__name__}>" == part] or inner or tables
    return tables[0]


def _tables_in(annotation: Any) -> Iterator[type[BaseModel]]:
    """Yield the models in an annotation."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for argument in get_args(annotation):
        yield from _tables_in(argument)


def wrong_key(key: str, table: type[BaseModel]) -> str:
    """Describe a missing key, or an unknown one with its table, the key that is meant, or all known ones."""
    if key in table.model_fields:
        return f"is missing; give it: {table.model_fields[key].description}"
    tables = {name: list(_tables_in(field.annotation)) for name, field in File.model_fields.items()}
    near, known = nearest(key, table.model_fields), ", ".join(sorted(table.model_fields))
    if any(table in variants and any(key in one.model_fields for one in variants) for variants in tables.values()):
        return f"unknown key beside the others; known with them: {known}"
    usual = (vocabulary(kind).get(key, "") for kind in ("keys of files", "arguments"))
    for meant in (key, *(text.partition("=")[0] for text in usual)):
        meant = "x" if meant == "x0" else meant
        if meant in table.model_fields:
            return f"unknown key; did you mean {meant!r}?"
        for name, variants in tables.items():
            if meant == name or any(meant in one.model_fields for one in variants):
                return f"unknown key; give [{name}]{'' if meant == name else f' {meant}'}"
    return f"unknown key; did you mean {near!r}?" if near else f"unknown key; known here: {known}"


def system_of_file(name: str, file: File) -> System:
    """Return the system of the tables of a file, with its forces."""
    system: Any = _own_system(name, file) if file.system is None else file.system
    others = [key for key in ("algebra", "casimirs", "hamiltonian", "name", "sign") if getattr(file, key) is not None]
    if file.system is not None and others:
        raise ConfigurationError(f"{name}: {others[0]}: belongs to [algebra]; the system {system.name!r} has its own")
    forces: Any = file.forces
    with section(name, "forces"):
        return system.with_forces(*forces) if forces else system  # type: ignore[no-any-return]


def _own_system(name: str, file: File) -> System:
    algebra: Any = file.algebra
    if algebra is None or file.hamiltonian is None:
        raise ConfigurationError(f"{name}: give either [system], a ready-made one, or [algebra] with [hamiltonian]")
    names = declared_names(file.name, algebra, algebra.dim)
    with section(name, "hamiltonian"):
        hamiltonian = file.hamiltonian.energy(algebra, names)
    casimirs: dict[str, ExactPolynomial] | None = None
    if file.casimirs is not None:
        casimirs = {}
        for key, polynomial in file.casimirs.items():
            with section(name, f"casimirs.{key}"):
                casimirs[key] = polynomial_of(polynomial, algebra.dim, names)
        with section(name, "casimirs"):  # their errors come from a system without energy
            LiePoissonSystem(algebra, 0 * ExactPolynomial.variable(0, algebra.dim), casimirs=casimirs)
    with section(name, "hamiltonian"):
        sign = 1 if file.sign is None else file.sign
        return LiePoissonSystem(algebra, hamiltonian, sign=sign, casimirs=casimirs, name=file.name)

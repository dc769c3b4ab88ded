"""Models of configuration files: the keys, the types of their values, and the schemas of these types."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, WithJsonSchema, model_validator

from coadjoint.algebra.exact.numbers import fits
from coadjoint.short_repr import short
from coadjoint.validation import is_real

MAX_SHOWN_LENGTH = 60  # characters of a value in an error, most of a line
SHAPES = {0: "a number", 1: "a list of numbers", 2: "a list of equally long lists of numbers"}


def _number(value: Any) -> bool:
    if not is_real(value):
        return False
    if not fits(value):
        raise ValueError(
            f"every number must be finite, and {value} is not"
            if isinstance(value, float)
            else f"{short(value)} is too large; every number must be finite in float64"
        )
    return True


def _depth(value: Any) -> int | None:
    """Nesting depth, at most 4, of equally long lists of numbers; None for anything else."""
    if not isinstance(value, list):
        return 0 if _number(value) else None
    inner = {_depth(entry) for entry in value}
    if inner == {0}:
        return 1
    depth = inner.pop() if len(inner) == 1 else None
    return depth + 1 if depth in (1, 2, 3) and len({len(row) for row in value}) == 1 else None


def _must_be(rule: str, valid: Callable[[Any], bool], hint: str = "") -> AfterValidator:
    """Return a validator of values that `valid` accepts; the error is that a value must be `rule`, and the hint."""

    def check(value: Any) -> Any:
        if not valid(value):
            raise ValueError(f"must be {rule}, not {short(value, MAX_SHOWN_LENGTH)}{hint}")
        return value

    return AfterValidator(check)


def _numbers(*depths: int) -> AfterValidator:
    return _must_be(" or ".join(SHAPES[depth] for depth in depths), lambda value: _depth(value) in depths)


def nested_schema(*depths: int, **more: int) -> WithJsonSchema:
    """Return the schema of numbers nested in lists to one of these depths."""
    return WithJsonSchema({**union_schema(*map(list_schema, depths)), **more})


def list_schema(depth: int) -> dict[str, Any]:
    """Return the schema of numbers nested in lists."""
    return {"type": "array", "items": list_schema(depth - 1), "minItems": 1} if depth else {"type": "number"}


def union_schema(*schemas: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of a union."""
    return schemas[0] if len(schemas) == 1 else {"anyOf": list(schemas)}


def _is_attitude(value: Any) -> bool:
    return isinstance(value, bool) or value == "coadjoint" or _depth(value) in (1, 2)


def _are_states(value: Any) -> bool:
    return (isinstance(value, str) and value.endswith(".npy")) or _depth(value) in (1, 2, 3, 4)


def file_name_schema(*suffixes: str) -> WithJsonSchema:
    """Return the schema of a file name with one of these suffixes; the commands validate the name."""
    endings = "|".join(suffix.removeprefix(".") for suffix in suffixes)
    return WithJsonSchema({"type": "string", "pattern": rf"\.({endings})(/\.?)*$"})


TERM = {
    "type": "array",
    "prefixItems": [list_schema(0), {"type": "array", "items": {"type": "integer"}}],
    "minItems": 2,
}
FORMULA = union_schema({"type": "string"}, {"type": "array", "items": {**TERM, "maxItems": 2}})
FILE = {"type": "string", "pattern": r"\.npy$"}
ANY_ATTITUDE = union_schema({"type": "boolean"}, {"const": "coadjoint"}, list_schema(1), list_schema(2))

Name = Annotated[str, _must_be("printable characters in one line", str.isprintable)]
Number = Annotated[Any, _numbers(0), nested_schema(0)]
Vector = Annotated[Any, _numbers(1), nested_schema(1)]
Span = Annotated[Any, _numbers(1), nested_schema(1, minItems=2, maxItems=2)]
Matrix = Annotated[Any, _numbers(0, 1, 2), nested_schema(0, 1, 2)]
Sign = Annotated[
    Any,
    _must_be("1 or -1", lambda value: is_real(value) and value in (1, -1)),
    WithJsonSchema({"enum": [1, -1]}),
]
States = Annotated[
    Any,
    _must_be(f"{SHAPES[1]} or {SHAPES[2]}", _are_states, "; matrices may be lists of these, or in a file .npy"),
    WithJsonSchema(union_schema(*map(list_schema, (1, 2, 3, 4)), FILE)),
]
Attitude = Annotated[
    Any,
    _must_be("true, false, 'coadjoint', or the initial group element, a matrix or a quaternion", _is_attitude),
    WithJsonSchema(ANY_ATTITUDE),
]
PolynomialValue = Annotated[
    Any,
    _must_be(
        "text such as '0.5*x1^2 + x2*x3' or a list of [coefficient, [exponents]]",
        lambda value: isinstance(value, str | list),
    ),
    WithJsonSchema(FORMULA),
]
WholeNumber = Annotated[int, Field(ge=1)]
Two = Annotated[
    Any,
    _must_be("a list of two", lambda value: isinstance(value, list) and len(value) == 2),
    WithJsonSchema({"type": "array", "minItems": 2, "maxItems": 2}),
]
Positive = Annotated[
    Any,
    _must_be("a positive number", lambda value: is_real(value) and fits(value) and value > 0),
    WithJsonSchema({"type": "number", "exclusiveMinimum": 0}),
]

GRIDS = ("linear", "logarithmic")
DISTRIBUTIONS = ("uniform", "normal", "sphere", "orbit")
SETTING_KINDS = ("values", *GRIDS, *DISTRIBUTIONS, "file")
MAX_SEED = 2**63 - 1


class Table(BaseModel):
    """Base of all tables: no unknown keys, no type conversion; attribute docstrings become schema descriptions."""

    model_config = ConfigDict(extra="forbid", strict=True, use_attribute_docstrings=True)


class SystemTable(Table):
    """A ready-made system; `coadjoint systems` lists them."""

    name: str
    """The name of the system."""
    parameters: dict[str, Any] = {}
    """Its parameters; omitted ones have their defaults."""


class AlgebraTable(Table):
    """An algebra of the catalogue, or one given by brackets or matrices."""

    name: str | None = None
    """An algebra of the catalogue, such as "so(4)" or "A3,7"."""
    parameters: dict[str, Any] = {}
    """Its parameters: numbers without unit."""
    dim: WholeNumber | None = None
    """The dimension of an algebra of your own; the basis is then e1, e2, ..."""
    basis: list[Name] | None = None
    """The names of its basis elements, in the order of the coordinates."""
    brackets: list[str] | None = None
    """Its brackets, such as "[e1, e2] = 2 e3 - e1"; those that are not listed are zero."""
    matrices: list[list[list[Number]]] | None = None
    """In place of brackets: square matrices that are a basis and a representation; brackets are their commutators."""


class HamiltonianTable(Table):
    """The energy H: x.Mx/2 + linear.x + constant, or a formula or polynomial."""

    M: Matrix | None = None
    """A number, the diagonal, or the symmetric matrix (energy per momentum squared)."""
    linear: Vector | None = None
    """The linear term (energy per momentum)."""
    constant: Number | None = None
    """A constant that is added to H (an energy)."""
    formula: str | None = None
    """All of H: text such as "a*(x1 + x2)^2/2 + cos(x3)" (an energy)."""
    polynomial: PolynomialValue | None = None
    """All of H, a polynomial: text, or a list of [coefficient, [exponents]] (an energy)."""
    parameters: dict[Name, Number] = {}
    """Numbers in the formula by name."""


class InitialTable(Table):
    """The initial state, or several; or a kind of state, with its parameters as further keys."""

    x: States | None = None
    """The initial momentum; a list of them is an ensemble. Or the name of a file .npy, from the folder of this file."""
    kind: str | None = None
    """A named state of the system; its parameters are the further keys."""
    parameters: dict[str, Any] = {}
    """The further keys beside `kind`."""
    attitude: Attitude = False
    """Whether the group element (attitude) is computed: true, "coadjoint", or its start: a matrix or a quaternion."""

    @model_validator(mode="before")
    @classmethod
    def _check_state_keys(cls, table: Any) -> Any:
        if not isinstance(table, dict) or "kind" not in table:
            return table
        reserved = {key: table[key] for key in ("kind", "attitude") if key in table}
        return {**reserved, "parameters": {key: value for key, value in table.items() if key not in reserved}}

    @model_validator(mode="after")
    def _exactly_one(self) -> InitialTable:
        if self.kind is None and self.x is None:
            raise ValueError("x is missing; give it, or the kind of an initial state")
        if self.kind is None and self.parameters:
            raise ValueError("parameters belong to a kind of initial state; give kind too")
        return self


class RunTable(Table):
    """The times of the run, and what is saved and watched. Either `step` or `accuracy`."""

    model_config = ConfigDict(json_schema_extra={"oneOf": [{"required": ["step"]}, {"required": ["accuracy"]}]})

    t_span: Span
    """Start and end (time); the run goes backward if the end is the smaller one."""
    step: Annotated[float, Field(gt=0)] | None = None
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
    def _step_or_accuracy(self) -> RunTable:
        if self.step is None and self.accuracy is None:
            raise ValueError("step is missing; give step, or accuracy to have it chosen")
        if self.step is not None and self.accuracy is not None:
            raise ValueError("step and accuracy are both given; give step, or accuracy to have it chosen")
        return self


class EventTable(Table):
    """An event: a function of the state passes through zero."""

    g: int | PolynomialValue
    """The function: the number of a coordinate, from 0, its name, or a polynomial."""
    direction: Annotated[int, Field(json_schema_extra={"enum": [-1, 0, 1]})] = 0
    """1 where g rises, -1 where it falls, 0 for both."""
    count: WholeNumber | None = None
    """Number of crossings recorded for each member; by default all."""
    terminal: bool = False
    """Whether the run ends at the last recorded crossing."""


class OutputTable(Table):
    """Paths of the results, relative to the current directory."""

    file: Annotated[str, file_name_schema(".nc", ".zarr")] | None = None
    """The solution as a dataset, .nc or .zarr."""
    archive: str | None = None
    """A new folder, such as run.zarr, to which the run is written while it runs; `coadjoint resume` continues it."""
    figure: Annotated[str, file_name_schema(".png", ".pdf", ".svg")] | None = None
    """A figure of the run, .png, .pdf or .svg."""
    movie: Annotated[str, file_name_schema(".mp4", ".gif")] | None = None
    """A movie of the run, .mp4 or .gif."""


class SettingsTable(Table):
    """The values of one key of the file: listed values, a grid, random numbers, or the rows of an array."""

    values: list[Any] | None = None
    """The values themselves; a plain list means the same."""
    linear: Two | None = None
    """A grid from the first number to the last, in equal steps (unit of the key)."""
    logarithmic: Two | None = None
    """A grid from the first number to the last, in equal ratios (unit of the key)."""
    count: Annotated[int, Field(ge=1)] | None = None
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
        if self.values == []:
            raise ValueError("is an empty list; give at least one value")
        return self

    @property
    def kind(self) -> str:
        """The kind of settings, one of `SETTING_KINDS`."""
        return next(kind for kind in SETTING_KINDS if getattr(self, kind) is not None)


class SweepTable(Table):
    """The keys of the file that change from member to member, and the number of random members."""

    samples: Annotated[int, Field(ge=1)] | None = None
    """Number of random members."""
    seed: Annotated[int, Field(ge=0, le=MAX_SEED)] | None = None
    """The seed of the random numbers."""
    over: dict[str, SettingsTable]
    """Keys of the file, such as "initial.x[0]", and the values of each. Every combination is a member."""

    @model_validator(mode="after")
    def _check_samples(self) -> SweepTable:
        random_keys = [key for key, settings in self.over.items() if settings.kind in DISTRIBUTIONS]
        if not self.over:
            raise ValueError("over is empty; give at least one key of the file, such as 'initial.x[0]'")
        if random_keys and (self.samples is None or self.seed is None):
            raise ValueError(f"over {short(random_keys[0])} is random; give samples (their number) and seed")
        if not random_keys and (self.samples is not None or self.seed is not None):
            raise ValueError(f"samples and seed belong to random settings, {', '.join(DISTRIBUTIONS)}; there are none")
        return self


class File(Table):
    """A run: the system, the initial state, the scheme, the times, and the paths of the results."""

    name: Name | None = None
    """The name of the system, for pictures and messages."""
    sign: Sign | None = None
    """1: x' = J grad H, the default. -1: x' = -J grad H, the convention of the body."""
    system: SystemTable | None = None
    algebra: AlgebraTable | None = None
    hamiltonian: HamiltonianTable | None = None
    casimirs: dict[Name, PolynomialValue] | None = None
    """Polynomials by name, checked to be Casimirs and recorded during the run."""
    forces: list[dict[str, Any]] = []
    """Forces in addition to H, one table for each: its name and its parameters."""
    initial: InitialTable
    sweep: SweepTable | None = None
    method: dict[str, Any] | None = None
    """The scheme: its name and its parameters. `coadjoint methods` lists them."""
    run: RunTable
    observe: dict[Name, PolynomialValue] = {}
    """Polynomials by name, evaluated at the saved states."""
    events: dict[Name, EventTable] = {}
    """Events by name."""
    output: OutputTable = OutputTable()

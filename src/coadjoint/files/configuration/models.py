"""Models of configuration files: the keys, their types, and the errors of validation."""

from __future__ import annotations

import types
import typing
from collections.abc import Iterable, Mapping, Sequence
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from coadjoint.errors import in_one_line, nearest
from coadjoint.files.configuration.values import (
    MAX_SHOWN_LENGTH,
    Attitude,
    Matrix,
    Name,
    Number,
    PolynomialValue,
    Positive,
    Sign,
    Span,
    States,
    Two,
    Vector,
    WholeNumber,
    file_name_schema,
)
from coadjoint.keyword_hints import KEYWORDS
from coadjoint.short_repr import short

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


class SweepOnly(BaseModel):
    """The table of a sweep alone; it generates the rest of the file."""

    sweep: SweepTable


CLOSE = 0.75
"""Smallest similarity of an unknown key and the key of another table that is suggested."""
NO_TABLES: Mapping[str, Iterable[str]] = types.MappingProxyType({})


def keys_by_table() -> dict[str, Iterable[str]]:
    """Return the keys of each table of a file; names and parameters, which several have, are omitted."""
    tables: dict[str, Iterable[str]] = {"the top of the file": ["sign"], "[[forces]]": []}
    tables |= {f"[{key}]": [] for key in File.model_fields if key not in ("name", "sign", "forces")}
    for key in ("algebra", "hamiltonian", "initial", "run", "output"):
        tables[f"[{key}]"] = [name for name in known_keys((key,)) if name not in ("name", "parameters")]
    return tables


def places_of(key: str, elsewhere: Mapping[str, Iterable[str]]) -> tuple[str | None, list[str]]:
    """Return the table of this name, and the tables that have a key of this name."""
    own_table = next((table for table in elsewhere if table.strip("[]") == key), None)
    return own_table, [table for table, keys in elsewhere.items() if key in keys]


PLACES: Mapping[str, str] = types.MappingProxyType(
    {
        "x0": "[initial] x",
        "system": "[system] name",
        "method": "[method] name",
        "t_span": "[run] t_span",
        "step": "[run] step",
        "accuracy": "[run] accuracy",
        "t_eval": "[run] t_eval",
        "save_every": "[run] save_every",
        "threads": "[run] threads",
        "events": "[events.NAME] g",
        "observe": "[observe] NAME",
        "archive": "[output] archive",
        "inertia": "[system.parameters] inertia",
        "parameters": "[system.parameters]",
        "file": "[output] file",
        "figure": "[output] figure",
        "movie": "[output] movie",
        "polynomial": "[hamiltonian] polynomial",
        "samples": "[sweep] samples",
    }
)
"""Argument of `integrate`, or key of a file -> its place in a file."""
OTHER_NAMES: Mapping[str, str] = types.MappingProxyType(
    {
        **dict.fromkeys(("params", "args", "p"), "parameters"),
        **dict.fromkeys(("out", "output_file", "filename", "netcdf", "results"), "file"),
        **dict.fromkeys(("plot", "picture", "image"), "figure"),
        **dict.fromkeys(("animation", "video"), "movie"),
        **dict.fromkeys(("H", "energy", "formula"), "polynomial"),
        **dict.fromkeys(("observables", "outputs"), "observe"),
        **dict.fromkeys(("members", "ensemble", "count"), "samples"),
        **dict.fromkeys(("duration", "end"), "t_span"),
        **dict.fromkeys(("rtol", "atol"), "accuracy"),
    }
)
"""Usual name of a key -> the argument or key of `PLACES`, beside the names of `keyword_hints.KEYWORDS`."""


def place_meant(key: str) -> str | None:
    """Return the place in a file of what an argument or a usual name means, or None."""
    argument = OTHER_NAMES.get(key) or KEYWORDS.get(key, key).partition("=")[0]
    return PLACES.get(argument)


def unknown_key(key: str, known: Iterable[str], elsewhere: Mapping[str, Iterable[str]] = NO_TABLES) -> str:
    """Describe an unknown key, with its place, the nearest known one, or all known ones if none is near."""
    own_table, tables = places_of(key, elsewhere)
    if own_table is not None:
        return f"unknown key; {key!r} is a table of its own, {own_table}"
    if tables:
        return f"unknown key; {key!r} belongs to {' or '.join(tables)}"
    if (place := place_meant(key)) is not None:
        return f"unknown key; give {place}"
    names = sorted(known)
    near = nearest(key, names)
    if near is not None:
        return f"unknown key; did you mean {near!r}?"
    for table, keys in elsewhere.items():
        near = nearest(key, keys, CLOSE)
        if near is not None:
            return f"unknown key; did you mean {near!r}, which belongs to {table}?"
    return f"unknown key; known here: {', '.join(names)}" if names else "unknown key; there are none here"


def known_keys(table_path: Sequence[str | int], value: Any = None) -> list[str]:
    """Return the keys that a table of a file may have; in the file itself those of tables, if the value is one."""
    is_table = not table_path and isinstance(value, Mapping)
    return [key for key in _table_at(table_path).model_fields if not is_table or key not in ("name", "sign")]


def all_errors(error: ValidationError, elsewhere: Mapping[str, Iterable[str]] = NO_TABLES) -> list[str]:
    """Return the errors in the tables of a file, dotted key and reason: unknown keys first."""
    # A missing key is omitted if an unknown one is its misspelling.
    rank = {"extra_forbidden": 0, "missing": 2}
    entries = sorted(error.errors(), key=lambda entry: rank.get(entry["type"], 1))
    messages: dict[str, str] = {}
    elsewhere = elsewhere or keys_by_table()
    for entry in entries:
        # pydantic appends "[key]" for an invalid key of a table.
        key_path = [key for key in entry["loc"] if key != "[key]"]
        path = "".join(
            f"[{key}]" if isinstance(key, int) else f".{in_one_line(key, MAX_SHOWN_LENGTH)}" for key in key_path
        )
        path = path.lstrip(".")
        reason = _reason(entry["type"], entry["msg"], entry["input"], entry.get("ctx", {}), key_path, elsewhere)
        misspelled = entry["type"] == "missing" and _is_named(key_path, messages.values())
        # For a union, pydantic lists one error per alternative; report the first.
        if not misspelled:
            messages.setdefault(".".join(map(str, key_path[:2])), f"{path}: {reason}" if path else f": {reason}")
    return list(messages.values())


def _is_named(key_path: Sequence[int | str], messages: Iterable[str]) -> bool:
    """Return whether messages about unknown keys name a missing key or table as the one that is meant."""
    path = ".".join(map(str, key_path))
    table, _, key = path.rpartition(".")
    names = (f"did you mean {key!r}?", f"give [{table}] {key}", f"give [{path}] ")
    return any(name in message for name in names for message in messages)


def _reason(
    kind: str,
    message: str,
    value: Any,
    context: Mapping[str, Any],
    key_path: list[int | str],
    elsewhere: Mapping[str, Iterable[str]],
) -> str:
    if kind == "extra_forbidden":
        return unknown_key(str(key_path[-1]), known_keys(key_path[:-1], value), elsewhere)
    if kind == "missing":
        return "is missing; give it"
    if kind == "value_error":
        return str(context["error"])
    expected = {
        "string_type": "text in quotes",
        "int_type": "a whole number",
        "int_from_float": "a whole number",
        "float_type": "a number",
        "bool_type": "true or false",
        "list_type": "a list",
        "dict_type": "a table",
        "model_type": "a table",
        "model_attributes_type": "a table",
        "greater_than": f"greater than {context.get('gt')}",
        "greater_than_equal": f"{context.get('ge')} or more",
        "finite_number": "finite",
    }.get(kind)
    # A name in place of a table.
    place = PLACES.get(str(key_path[-1])) if expected == "a table" and isinstance(value, str) and key_path else None
    return (
        f"must be {expected}, not {short(value, MAX_SHOWN_LENGTH)}" + (f"; give {place}" if place else "")
        if expected
        else f"{message[:1].lower()}{message[1:]}, not {short(value, MAX_SHOWN_LENGTH)}"
    )


def _table_at(table_path: Sequence[int | str]) -> type[BaseModel]:
    table: type[BaseModel] = File
    keys = iter(table_path)
    for key in keys:
        annotation: Any = table.model_fields[str(key)].annotation
        if typing.get_origin(annotation) is dict:  # tables by name
            next(keys)
            annotation = typing.get_args(annotation)[1]
        options = typing.get_args(annotation) if isinstance(annotation, types.UnionType) else (annotation,)
        table = next(option for option in options if isinstance(option, type) and issubclass(option, BaseModel))
    return table

"""Which keys may a configuration file have, of which types? Models, and what is said when a file does not fit them."""

from __future__ import annotations

import types
import typing
from collections.abc import Iterable, Mapping
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_validator

from coadjoint.algebra.exact import fits
from coadjoint.errors import in_one_line, nearest
from coadjoint.files.sweep_models import SweepTable
from coadjoint.wording import short

SHOWN = 60
SHAPES = {0: "a number", 1: "a list of numbers", 2: "a list of equally long lists of numbers"}


def _number(value: Any) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    if not fits(value):
        raise ValueError(
            f"every number must be finite, and {value} is not"
            if isinstance(value, float)
            else f"{short(value)} is too large; every number must be finite in float64"
        )
    return True


def _depth(value: Any) -> int | None:
    """Return how many lists lie in one another, of equal lengths and with numbers inside, at most 4; else None."""
    if not isinstance(value, list):
        return 0 if _number(value) else None
    inner = {_depth(entry) for entry in value}
    if inner == {0}:
        return 1
    depth = inner.pop() if len(inner) == 1 else None
    return depth + 1 if depth in (1, 2, 3) and len({len(row) for row in value}) == 1 else None


def _numbers(*depths: int) -> AfterValidator:
    def check(value: Any) -> Any:
        if _depth(value) not in depths:
            raise ValueError(f"must be {' or '.join(SHAPES[depth] for depth in depths)}, not {short(value, SHOWN)}")
        return value

    return AfterValidator(check)


def _attitude(value: Any) -> Any:
    if not (isinstance(value, bool) or value == "coadjoint" or _depth(value) == 2):
        raise ValueError(
            f"must be true, false, 'coadjoint' or a matrix, the initial group element, not {short(value, SHOWN)}"
        )
    return value


def _states(value: Any) -> Any:
    named = isinstance(value, str) and value.endswith(".npy")
    if not (named or _depth(value) in (1, 2, 3, 4)):
        raise ValueError(
            f"must be {SHAPES[1]} or {SHAPES[2]}, not {short(value, SHOWN)}; matrices may be lists of these, or in a "
            "file .npy"
        )
    return value


def _polynomial(value: Any) -> Any:
    if not isinstance(value, str | list):
        raise ValueError(
            "must be text such as '0.5*x1^2 + x2*x3' or a list of [coefficient, [exponents]], "
            f"not {short(value, SHOWN)}"
        )
    return value


def _sign(value: Any) -> Any:
    if isinstance(value, bool) or value not in (1, -1):
        raise ValueError(f"must be 1 or -1, not {short(value, SHOWN)}")
    return value


def _name(value: str) -> str:
    if not value.isprintable():
        raise ValueError(f"must be printable letters in one line, not {short(value, SHOWN)}")
    return value


Name = Annotated[str, AfterValidator(_name)]
Number = Annotated[Any, _numbers(0)]
Matrix = Annotated[Any, _numbers(0, 1, 2)]
Sign = Annotated[Any, AfterValidator(_sign)]
Vector = Annotated[Any, _numbers(1)]
States = Annotated[Any, AfterValidator(_states)]
Written = Annotated[Any, AfterValidator(_polynomial)]
Whole = Annotated[int, Field(ge=1)]


class Table(BaseModel):
    """A table of the file: no other keys, no conversions of type."""

    model_config = ConfigDict(extra="forbid", strict=True)


class SystemTable(Table):
    """A ready-made system."""

    name: str
    parameters: dict[str, Any] = {}


class AlgebraTable(Table):
    """An algebra of the catalogue, or one given by brackets."""

    name: str | None = None
    parameters: dict[str, Any] = {}
    dim: Whole | None = None
    basis: list[Name] | None = None
    brackets: list[str] | None = None


class HamiltonianTable(Table):
    """A quadratic Hamiltonian, or a polynomial."""

    M: Matrix | None = None
    linear: Vector | None = None
    constant: Number | None = None
    polynomial: Written | None = None


class InitialTable(Table):
    """The initial state, or states; or the kind of one, whose parameters are the further keys."""

    x: States | None = None
    kind: str | None = None
    parameters: dict[str, Any] = {}
    attitude: Annotated[Any, AfterValidator(_attitude)] = False

    @model_validator(mode="before")
    @classmethod
    def _further_keys(cls, given: Any) -> Any:
        if not isinstance(given, dict) or "kind" not in given:
            return given
        own = {key: given[key] for key in ("kind", "attitude") if key in given}
        return {**own, "parameters": {key: value for key, value in given.items() if key not in own}}

    @model_validator(mode="after")
    def _one_of_both(self) -> InitialTable:
        if self.kind is None and self.x is None:
            raise ValueError("x is missing; give it, or the kind of an initial state")
        if self.kind is None and self.parameters:
            raise ValueError("parameters belong to a kind of initial state; give kind, and them beside it")
        return self


class RunTable(Table):
    """The times of the run, and what is saved and watched."""

    t_span: Annotated[Any, _numbers(1)]
    step: Annotated[float, Field(gt=0)]
    save_every: Whole = 1
    t_eval: Annotated[Any, _numbers(1)] | None = None
    watch: bool = True
    threads: Whole | None = None


class EventTable(Table):
    """An event that is looked for."""

    g: int | Written
    direction: int = 0
    count: Whole | None = None
    terminal: bool = False


class OutputTable(Table):
    """Where the results go."""

    file: str | None = None
    figure: str | None = None
    movie: str | None = None


class File(Table):
    """The whole file."""

    name: Name | None = None
    sign: Sign | None = None
    system: SystemTable | None = None
    algebra: AlgebraTable | None = None
    hamiltonian: HamiltonianTable | None = None
    casimirs: dict[Name, Written] | None = None
    forces: list[dict[str, Any]] = []
    initial: InitialTable
    sweep: SweepTable | None = None
    method: dict[str, Any] | None = None
    run: RunTable
    observe: dict[Name, Written] = {}
    events: dict[Name, EventTable] = {}
    output: OutputTable = OutputTable()


class OfSweep(BaseModel):
    """The sweep of a file alone, which says what the rest of it is."""

    sweep: SweepTable


def unknown_key(key: str, known: Iterable[str]) -> str:
    """Say that a key is unknown, with the nearest known one, or all of them where none is near.

    Examples
    --------
    >>> unknown_key("stpe", ["t_span", "step"])
    "unknown key; did you mean 'step'?"
    """
    names = sorted(known)
    near = nearest(key, names)
    if near is not None:
        return f"unknown key; did you mean {near!r}?"
    return f"unknown key; known here: {', '.join(names)}" if names else "unknown key; there are none here"


def first_error(error: ValidationError) -> tuple[str, str]:
    """Return the dotted path of what is wrong first, and the reason.

    An unknown key comes first, since a missing one is often the same key, misspelled.

    Parameters
    ----------
    error : pydantic.ValidationError
        Of a `File`.

    Returns
    -------
    path : str
    reason : str

    Examples
    --------
    >>> try:
    ...     File.model_validate({"initial": {"x": [1.0]}, "run": {"t_span": [0, 1], "stpe": 0.1}})
    ... except ValidationError as error:
    ...     first_error(error)
    ('run.stpe', "unknown key; did you mean 'step'?")
    """
    rank = {"extra_forbidden": 0, "missing": 2}
    found = sorted(error.errors(), key=lambda entry: rank.get(entry["type"], 1))[0]
    # Where a key of a table is wrong, "[key]" follows it.
    place = [key for key in found["loc"] if key != "[key]"]
    path = "".join(f"[{key}]" if isinstance(key, int) else f".{in_one_line(key, SHOWN)}" for key in place)
    path = path.lstrip(".")
    return path, _reason(found["type"], found["msg"], found["input"], found.get("ctx", {}), place)


def _reason(kind: str, message: str, given: Any, context: Mapping[str, Any], place: list[int | str]) -> str:
    if kind == "extra_forbidden":
        return unknown_key(str(place[-1]), _table_at(place[:-1]).model_fields)
    if kind == "missing":
        return "is missing; give it"
    if kind == "value_error":
        return str(context["error"])
    wanted = {
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
    return (
        f"must be {wanted}, not {short(given, SHOWN)}"
        if wanted
        else f"{message[:1].lower()}{message[1:]}, not {short(given, SHOWN)}"
    )


def _table_at(place: list[int | str]) -> type[BaseModel]:
    table: type[BaseModel] = File
    keys = iter(place)
    for key in keys:
        annotation: Any = table.model_fields[str(key)].annotation
        if typing.get_origin(annotation) is dict:  # of tables by name
            next(keys)
            annotation = typing.get_args(annotation)[1]
        options = typing.get_args(annotation) if isinstance(annotation, types.UnionType) else (annotation,)
        table = next(option for option in options if isinstance(option, type) and issubclass(option, BaseModel))
    return table

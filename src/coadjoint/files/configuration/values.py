"""Types of values in configuration files: validators and their schemas."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import AfterValidator, Field, WithJsonSchema

from coadjoint.algebra.exact.numbers import fits
from coadjoint.short_repr import short

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
    """Nesting depth, at most 4, of equally long lists of numbers; None for anything else."""
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


def in_schema(*depths: int, **more: int) -> WithJsonSchema:
    """Schema of numbers nested in lists to one of these depths.

    Examples
    --------
    >>> in_schema(1, maxItems=2).json_schema
    {'type': 'array', 'items': {'type': 'number'}, 'minItems': 1, 'maxItems': 2}
    """
    return WithJsonSchema({**any_of(*map(lists, depths)), **more})


def lists(depth: int) -> dict[str, Any]:
    """Schema of numbers nested in lists.

    Examples
    --------
    >>> lists(1)
    {'type': 'array', 'items': {'type': 'number'}, 'minItems': 1}
    """
    return {"type": "array", "items": lists(depth - 1), "minItems": 1} if depth else {"type": "number"}


def any_of(*schemas: dict[str, Any]) -> dict[str, Any]:
    """Schema of a union.

    Examples
    --------
    >>> any_of({"type": "string"})
    {'type': 'string'}
    """
    return schemas[0] if len(schemas) == 1 else {"anyOf": list(schemas)}


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
        raise ValueError(f"must be printable characters in one line, not {short(value, SHOWN)}")
    return value


def ending(*suffixes: str) -> WithJsonSchema:
    r"""Schema of a file name with one of these suffixes; the commands validate the name.

    Examples
    --------
    >>> ending(".nc", ".zarr").json_schema["pattern"]
    '\\.(nc|zarr)(/\\.?)*$'
    """
    endings = "|".join(suffix.removeprefix(".") for suffix in suffixes)
    return WithJsonSchema({"type": "string", "pattern": rf"\.({endings})(/\.?)*$"})


TERM = {"type": "array", "prefixItems": [lists(0), {"type": "array", "items": {"type": "integer"}}], "minItems": 2}
FORMULA = any_of({"type": "string"}, {"type": "array", "items": {**TERM, "maxItems": 2}})
FILE = {"type": "string", "pattern": r"\.npy$"}
ANY_ATTITUDE = any_of({"type": "boolean"}, {"const": "coadjoint"}, lists(2))

Name = Annotated[str, AfterValidator(_name)]
Number = Annotated[Any, _numbers(0), in_schema(0)]
Vector = Annotated[Any, _numbers(1), in_schema(1)]
Span = Annotated[Any, _numbers(1), in_schema(1, minItems=2, maxItems=2)]
Matrix = Annotated[Any, _numbers(0, 1, 2), in_schema(0, 1, 2)]
Sign = Annotated[Any, AfterValidator(_sign), WithJsonSchema({"enum": [1, -1]})]
States = Annotated[Any, AfterValidator(_states), WithJsonSchema(any_of(*map(lists, (1, 2, 3, 4)), FILE))]
Attitude = Annotated[Any, AfterValidator(_attitude), WithJsonSchema(ANY_ATTITUDE)]
Written = Annotated[Any, AfterValidator(_polynomial), WithJsonSchema(FORMULA)]
Whole = Annotated[int, Field(ge=1)]

"""Types of values in configuration files: validators and their schemas."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import AfterValidator, Field, WithJsonSchema

from coadjoint.algebra.exact.numbers import fits
from coadjoint.short_repr import short
from coadjoint.validation import is_real

MAX_SHOWN_LENGTH = 60  # characters of a value in an error, most of a line
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
            raise ValueError(
                f"must be {' or '.join(SHAPES[depth] for depth in depths)}, not {short(value, MAX_SHOWN_LENGTH)}"
            )
        return value

    return AfterValidator(check)


def nested_schema(*depths: int, **more: int) -> WithJsonSchema:
    """Return the schema of numbers nested in lists to one of these depths."""
    return WithJsonSchema({**union_schema(*map(list_schema, depths)), **more})


def list_schema(depth: int) -> dict[str, Any]:
    """Return the schema of numbers nested in lists."""
    return {"type": "array", "items": list_schema(depth - 1), "minItems": 1} if depth else {"type": "number"}


def union_schema(*schemas: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of a union."""
    return schemas[0] if len(schemas) == 1 else {"anyOf": list(schemas)}


def _attitude(value: Any) -> Any:
    if not (isinstance(value, bool) or value == "coadjoint" or _depth(value) in (1, 2)):
        raise ValueError(
            "must be true, false, 'coadjoint', or the initial group element, a matrix or a quaternion, not "
            f"{short(value, MAX_SHOWN_LENGTH)}"
        )
    return value


def _states(value: Any) -> Any:
    named = isinstance(value, str) and value.endswith(".npy")
    if not (named or _depth(value) in (1, 2, 3, 4)):
        raise ValueError(
            f"must be {SHAPES[1]} or {SHAPES[2]}, not {short(value, MAX_SHOWN_LENGTH)}; matrices may be lists of "
            "these, or in a file .npy"
        )
    return value


def _polynomial(value: Any) -> Any:
    if not isinstance(value, str | list):
        raise ValueError(
            "must be text such as '0.5*x1^2 + x2*x3' or a list of [coefficient, [exponents]], "
            f"not {short(value, MAX_SHOWN_LENGTH)}"
        )
    return value


def _sign(value: Any) -> Any:
    if isinstance(value, bool) or value not in (1, -1):
        raise ValueError(f"must be 1 or -1, not {short(value, MAX_SHOWN_LENGTH)}")
    return value


def _name(value: str) -> str:
    if not value.isprintable():
        raise ValueError(f"must be printable characters in one line, not {short(value, MAX_SHOWN_LENGTH)}")
    return value


def _two(value: Any) -> Any:
    if not isinstance(value, list) or len(value) != 2:
        raise ValueError(f"must be a list of two, not {short(value, MAX_SHOWN_LENGTH)}")
    return value


def _positive(value: Any) -> Any:
    if not is_real(value) or not fits(value) or value <= 0:
        raise ValueError(f"must be a positive number, not {short(value, MAX_SHOWN_LENGTH)}")
    return value


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

Name = Annotated[str, AfterValidator(_name)]
Number = Annotated[Any, _numbers(0), nested_schema(0)]
Vector = Annotated[Any, _numbers(1), nested_schema(1)]
Span = Annotated[Any, _numbers(1), nested_schema(1, minItems=2, maxItems=2)]
Matrix = Annotated[Any, _numbers(0, 1, 2), nested_schema(0, 1, 2)]
Sign = Annotated[Any, AfterValidator(_sign), WithJsonSchema({"enum": [1, -1]})]
States = Annotated[Any, AfterValidator(_states), WithJsonSchema(union_schema(*map(list_schema, (1, 2, 3, 4)), FILE))]
Attitude = Annotated[Any, AfterValidator(_attitude), WithJsonSchema(ANY_ATTITUDE)]
PolynomialValue = Annotated[Any, AfterValidator(_polynomial), WithJsonSchema(FORMULA)]
WholeNumber = Annotated[int, Field(ge=1)]
Two = Annotated[Any, AfterValidator(_two), WithJsonSchema({"type": "array", "minItems": 2, "maxItems": 2})]
Positive = Annotated[Any, AfterValidator(_positive), WithJsonSchema({"type": "number", "exclusiveMinimum": 0})]

"""Validation of arguments: numbers, arrays, names and flags."""

from __future__ import annotations

import importlib
import inspect
import math
import numbers
import pkgutil
import sys
from collections.abc import Callable, Collection, Iterable, Mapping
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import unknown_name
from coadjoint.labels import lost_labels
from coadjoint.memory import UNCHECKED_BYTES, check_available_memory
from coadjoint.short_repr import short

Floats = NDArray[np.float64]
Kind = TypeVar("Kind")

REAL_KINDS = "iuf"
FLOAT64 = np.dtype(np.float64)
SMALL_SIZE = 64  # up to this many numbers plain Python is faster than NumPy
MAX_TITLE_LENGTH = 200  # characters of a name, so that messages that contain two stay readable
MAX_DIMENSIONS = 32  # maximum of an object array whose entries can be examined
MAX_DEPTH = 64  # maximum depth of nested lists: that of array dimensions


def is_real(value: Any) -> bool:
    """Return whether a value is a real number; booleans, text, arrays and objects merely convertible to float are not.

    >>> is_real(2.5), is_real(np.uint8(3)), is_real(True), is_real("2.5"), is_real(1j)
    (True, True, False, False, False)
    """
    if isinstance(value, numbers.Real):
        return not isinstance(value, bool | np.timedelta64)  # a duration is registered as an integer
    # Decimal is a number but not registered with numbers.Real.
    return isinstance(value, numbers.Number) and not isinstance(value, numbers.Complex)


def is_integer(value: Any) -> bool:
    """Return whether a value is an integer; booleans and durations of NumPy are not.

    >>> is_integer(np.int8(3)), is_integer(True), is_integer(np.timedelta64(3, "s")), is_integer(3.0)
    (True, False, False, False)
    """
    return isinstance(value, numbers.Integral) and not isinstance(value, bool | np.timedelta64)


def supports_arithmetic(value: Any) -> bool:
    """Return whether a value supports addition and multiplication with numbers."""
    return hasattr(type(value), "__radd__") and hasattr(type(value), "__rmul__")


def to_array(values: Any, what: str, kinds: str = REAL_KINDS) -> NDArray[Any]:
    """Convert numbers of some NumPy kinds to an array, without a copy if already one; `what` names it in messages."""
    # With the kind "c" any value that can be added and multiplied counts as a number.
    if type(values) is np.ndarray:
        array = values
    else:
        reject_lossy_conversion(values, what)
        try:
            array = np.asarray(values)
        except MemoryError:
            raise ValueError(f"{what} does not fit into memory; give fewer numbers") from None
        except Exception:  # conversion of a foreign object can raise anything
            raise not_numbers_error(values, what) from None
    kind = array.dtype.kind
    if kind in kinds:
        return array
    if (
        kind != "O"
        or array.ndim > MAX_DIMENSIONS
        or not all(map(supports_arithmetic if "c" in kinds else is_real, array.flat))
    ):
        raise not_numbers_error(values, what)
    return array


def read_numbers(values: Any, what: str) -> Floats:
    """Validate real numbers and return a float64 copy."""
    if type(values) is np.ndarray and values.dtype is FLOAT64 and values.nbytes <= UNCHECKED_BYTES:
        return np.array(values)
    return _copied(values, what, REAL_KINDS, FLOAT64)


def read_complex(values: Any, what: str) -> NDArray[np.complex128]:
    """Validate real or complex numbers and return a complex copy, as in `read_numbers`."""
    return _copied(values, what, "iufc", np.dtype(np.complex128))


def _copied(values: Any, what: str, kinds: str, kind: np.dtype[Any]) -> NDArray[Any]:
    array = to_array(values, what, kinds)
    check_available_memory(kind.itemsize * array.size, f"a copy of {what}, of shape {array.shape},")
    try:
        if array.dtype.itemsize <= 8 and array.dtype.kind != "O":
            return np.array(array, dtype=kind)
        with np.errstate(over="ignore"):  # gives infinity, refused by callers that require finite numbers
            return np.array(array, dtype=kind)
    except OverflowError:
        raise ValueError(f"{what} holds a number that is too large for float64") from None
    except (TypeError, ValueError):
        raise not_numbers_error(values, what) from None


def read_finite(values: Any, what: str) -> Floats:
    """Validate finite real numbers and return a float64 copy; the message names the first entry that is not finite."""
    array = read_numbers(values, what)
    check_finite(array, what)
    return array


def are_finite(values: Floats) -> bool:
    """Return whether all numbers are finite; five times faster than NumPy for few numbers."""
    # Numbers with a finite sum are finite.
    few = values.size <= SMALL_SIZE
    return (few and math.isfinite(sum(values.ravel().tolist()))) or bool(np.isfinite(values).all())


def check_finite(values: Floats, what: str) -> None:
    """Raise a ValueError that names the first NaN or infinity."""
    if not np.isfinite(values).all():
        index = np.argwhere(~np.isfinite(values))[0].tolist()
        where = f"[{', '.join(map(str, index))}]" if index else ""
        raise ValueError(f"{what}{where} is {values[tuple(index)]}; give finite numbers")


def not_numbers_error(values: Any, what: str) -> TypeError:
    """Return the error for a value that is not an array of real numbers."""
    hint = unit_hint(values)
    rule = f"numbers{hint}" if hint else "an array of real numbers, all rows of the same length"
    if is_of_torch(values):
        rule += "; inside of transformations of PyTorch use co.torch, a run as a function of tensors"
    return TypeError(f"{what} is {short(values, 60)}; it must be {rule}")


def unit_hint(value: Any, depth: int = 2) -> str:
    """Return what to give in place of a duration, a date or a quantity with a unit, or of the first one in a list.

    >>> unit_hint(np.timedelta64(1, "s"))
    " in the units of the system, such as the duration divided by np.timedelta64(1, 's')"
    >>> unit_hint("1")
    ''
    """
    is_object_array = isinstance(value, np.ndarray) and value.dtype == object and value.ndim <= MAX_DIMENSIONS
    if isinstance(value, list | tuple) or is_object_array:
        entries = value.flat if isinstance(value, np.ndarray) else value
        hints = (unit_hint(entry, depth - 1) for entry in islice(entries, SMALL_SIZE)) if depth else ()
        return next(filter(None, hints), "")
    kind = getattr(getattr(value, "dtype", None), "kind", "")
    if kind == "m":
        return " in the units of the system, such as the duration divided by np.timedelta64(1, 's')"
    if hasattr(value, "total_seconds"):
        return " in the units of the system, such as its total_seconds()"
    if kind == "M" or hasattr(value, "toordinal"):
        return " in the units of the system, such as the seconds since the start"
    return " in the units of the system, such as its magnitude in these" if has_unit(value) else ""


def has_unit(value: Any) -> bool:
    """Return whether a value is a quantity with a unit, such as those of astropy, pint and unyt."""
    if isinstance(value, np.ndarray):
        return type(value) is not np.ndarray and (hasattr(value, "unit") or hasattr(value, "units"))
    return hasattr(type(value), "magnitude") and hasattr(type(value), "units")


def reject_lossy_conversion(values: Any, what: str, depth: int = 0) -> None:
    """Raise an error for masks, labels and booleans, which conversion to float would lose."""
    if isinstance(values, list | tuple):
        kinds = set(map(type, values))
        if kinds <= {float, int} or depth == MAX_DEPTH:
            return
        if bool in kinds or np.bool_ in kinds:
            raise not_numbers_error(values, what)
        for entry in values:
            reject_lossy_conversion(entry, what, depth + 1)
    elif isinstance(values, np.ma.MaskedArray):
        if np.ma.is_masked(values):
            raise ValueError(f"{what} has masked entries, which have no value; fill or remove them")
    elif has_unit(values):
        raise not_numbers_error(values, what)
    elif getattr(values, "requires_grad", False) is True:
        raise TypeError(
            f"{what} is a tensor with requires_grad, whose gradients would be lost; use co.torch, or give its detach()"
        )
    else:
        _reject_traced(values, what)
        reject_lost_labels(values, what)


def _reject_traced(values: Any, what: str) -> None:
    """Raise a TypeError for a tracer of JAX, without importing JAX."""
    jax = sys.modules.get("jax")
    if jax is not None and isinstance(values, jax.core.Tracer):
        raise TypeError(
            f"{what} is a value that JAX traces, in grad, jit or vmap, and no number; use co.jax.solution, a run as a "
            "function of JAX"
        )


def is_of_torch(value: Any) -> bool:
    """Return whether a value is a tensor or module of PyTorch, without importing PyTorch."""
    return any(kind.__module__.partition(".")[0] == "torch" for kind in type(value).__mro__)


def reject_lost_labels(values: Any, what: str) -> None:
    """Raise a TypeError for arrays of xarray and pandas whose names and labels would be lost."""
    if lost := lost_labels(values):
        raise TypeError(f"{what} is {lost} would be lost; give its to_numpy() if its order is right")


def read_number(value: Any, what: str) -> float:
    """Validate one finite real number and return a float."""
    if type(value) is not float:
        if type(value) is not int:
            if isinstance(value, np.ndarray) and value.ndim == 0 and not isinstance(value, np.ma.MaskedArray):
                value = value if has_unit(value) else value[()]
            if not is_real(value):
                _reject_traced(value, what)
                raise TypeError(f"{what} is {short(value)}; it must be a number{unit_hint(value)}")
        try:
            value = float(value)
        except (OverflowError, ValueError):
            raise ValueError(f"{what} is {short(value)}, which is too large for float64") from None
    if not math.isfinite(value):
        raise ValueError(f"{what} is {value!r}; it must be finite")
    return value


def read_positive(value: Any, what: str) -> float:
    """Validate one positive number and return a float."""
    number = read_number(value, what)
    if number <= 0.0:
        raise ValueError(f"{what} is {number!r}; it must be positive")
    return number


def read_nonnegative(value: Any, what: str) -> float:
    """Validate one number that is zero or positive and return a float."""
    number = read_number(value, what)
    if number < 0.0:
        raise ValueError(f"{what} is {number!r}; it must be zero or positive")
    return number


def check_power(number: float, power: int, what: str) -> None:
    """Raise a ValueError if a power of a number is beyond float64."""
    if power * math.log2(max(abs(number), 1.0)) >= 1024.0:
        raise ValueError(
            f"{what} is {number!r}, and its power {power} leaves the range of float64; give a smaller number"
        )


def read_integer(
    value: Any, what: str, minimum: int = 1, maximum: int | None = None, *, floats: bool = False, reason: str = ""
) -> int:
    """Validate a whole number and return a Python int, which does not wrap; `reason` is that of the upper bound."""
    is_whole = type(value) is int or is_integer(value)
    if floats and not is_whole and isinstance(value, float | np.floating):
        value = float(value)  # small float types cannot represent the bounds
        is_whole = value.is_integer()
    if not is_whole or value < minimum or (maximum is not None and value > maximum and not reason):
        bounds = f"from {minimum} up" if maximum is None or reason else f"from {minimum} to {short(maximum)}"
        raise ValueError(f"{what} must be a whole number {bounds}, not {short(value)}")
    if maximum is not None and value > maximum:
        raise ValueError(f"{what} must be at most {maximum}, not {short(value)}; {reason}")
    return int(value)


def read_bool(value: Any, what: str) -> bool:
    """Validate True or False."""
    if not isinstance(value, bool | np.bool_):
        raise TypeError(f"{what} is {short(value)}; it must be True or False")
    return bool(value)


def read_title(value: Any, what: str) -> str:
    """Validate a name for messages and plots: one nonempty line of bounded length."""
    if not isinstance(value, str) or not value:
        raise TypeError(f"{what} must be a nonempty string, not {short(value)}")
    if len(value) > MAX_TITLE_LENGTH or not value.isprintable():
        raise ValueError(f"{what} is {short(value)}; it must be one line of at most {MAX_TITLE_LENGTH} characters")
    return value


def truncate_title(text: str) -> str:
    """Truncate a composed name to the maximum length of a title."""
    return text if len(text) <= MAX_TITLE_LENGTH else f"{text[: MAX_TITLE_LENGTH - 3]}..."


def as_tuples(values: Any) -> Any:
    """Return an array or nested lists as nested tuples of Python numbers; a single number stays one."""
    entries = values.tolist() if isinstance(values, np.ndarray) else values
    return tuple(map(as_tuples, entries)) if isinstance(entries, list) else entries


def set_fields(instance: Any, **fields: Any) -> None:
    """Set fields of an object that is frozen, in its constructor."""
    for name, value in fields.items():
        object.__setattr__(instance, name, value)


class Immutable:
    """Base class of objects that runs share: fields are set once, in constructors; private ones are caches."""

    def __setattr__(self, name: str, value: Any) -> None:
        if not name.startswith("_") and name in vars(self):
            kind = type(self).__name__
            raise AttributeError(f"{name} of a {kind} cannot be changed, since runs share it; make another {kind}")
        object.__setattr__(self, name, value)


def read_path(value: Any, what: str) -> Path:
    """Validate the name of a file or folder and return a Path."""
    if not isinstance(value, str | Path):
        raise TypeError(f"{what} is {short(value)}; give the name of a file, as text or as a pathlib.Path")
    return Path(value)


def read_list(values: Any, what: str, rule: str) -> tuple[Any, ...]:
    """Return the entries of an iterable, or raise a TypeError that ends with `rule`."""
    reject_lost_labels(values, what)
    try:
        if not isinstance(values, str | bytes | Mapping):
            return tuple(values)
    except TypeError:
        pass
    raise TypeError(f"{what} is {short(values)}; {rule}")


def check_parameters(name: str, names: Iterable[str], known: Iterable[str], required: Iterable[str] = ()) -> None:
    """Raise a ValueError for unknown or missing parameters of `name`.

    >>> check_parameters("Torque", ["torqe"], ["torque"])
    Traceback (most recent call last):
    ValueError: unknown parameter of Torque 'torqe'; did you mean 'torque'?
    """
    names, known = list(names), list(known)
    for parameter in names:
        if parameter not in known:
            raise unknown_name(f"parameter of {name}", parameter, known or ["(none)"])
    missing = [key for key in required if key not in names]
    if missing:
        raise ValueError(f"{name} needs the parameter {missing[0]!r}")


def read_choice(value: Any, what: str, known: Collection[str]) -> str:
    """Validate a name among known ones; the error suggests the nearest."""
    if not isinstance(value, str) or value not in known:
        raise unknown_name(what, value, known)
    return str(value)


def classes_in(package: str, base: type[Kind]) -> dict[str, type[Kind]]:
    """Return the concrete classes with a base that are defined in the files of a package, by name."""
    found: dict[str, type[Kind]] = {}
    for module_info in pkgutil.iter_modules(importlib.import_module(package).__path__):
        module = importlib.import_module(f"{package}.{module_info.name}")
        for name, value in vars(module).items():
            defined = isinstance(value, type) and value.__module__ == module.__name__ and not name.startswith("_")
            if defined and issubclass(value, base) and not inspect.isabstract(value):
                found[name] = value
    return found


def construct(what: str, kinds: Mapping[str, Callable[..., Any]], name: Any, parameters: Mapping[str, Any]) -> Any:
    """Return what is made by its name in `kinds` and its parameters, of which objects may be described by mappings."""
    made = kinds[read_choice(name, what, kinds)]
    known = inspect.signature(made).parameters
    required = [key for key, parameter in known.items() if parameter.default is inspect.Parameter.empty]
    check_parameters(str(name), parameters, known, required)

    def read(value: Any) -> Any:
        if isinstance(value, Mapping):
            if "name" in value:
                return from_description(what, kinds, value)
            return {key: read(entry) for key, entry in value.items()}
        return tuple(map(read, value)) if isinstance(value, list) else value

    return made(**{key: read(value) for key, value in parameters.items()})


def from_description(what: str, kinds: Mapping[str, Callable[..., Any]], description: Any) -> Any:
    """Return the object that a mapping describes: its name, and parameters beside it or in ``"parameters"``.

    >>> from_description("number", {"complex": complex}, {"name": "complex", "parameters": {"real": 1, "imag": 2}})
    (1+2j)
    """
    if not isinstance(description, Mapping):
        raise TypeError(
            f"a {what} is described by a mapping, not by {short(description)}; give its name and parameters"
        )
    parameters = dict(description)
    name, nested = parameters.pop("name", None), parameters.pop("parameters", {})
    if not isinstance(name, str) or not isinstance(nested, Mapping):
        raise ValueError(
            f"{short(dict(description))} is not a {what}; give its name and parameters, such as name = {min(kinds)!r}"
        )
    repeated = sorted(parameters.keys() & nested.keys())
    if repeated:
        raise ValueError(f"the parameter {short(repeated[0])} of {name} is given twice; give it once")
    return construct(what, kinds, name, {**parameters, **nested})

"""What was given? Numbers, arrays, names and flags from outside: read, or refused by name."""

from __future__ import annotations

import math
import numbers
from collections.abc import Collection, Iterable, Mapping, Sized
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import unknown_name
from coadjoint.memory import check_room
from coadjoint.wording import short

Floats = NDArray[np.float64]

REAL = "iuf"
FEW = 64  # numbers that Python looks at quicker than NumPy
SMALL = 2**16  # numbers for which there is always room
LONGEST_TITLE = 200
BYTES_PER_ENTRY = 64
MOST_DIMENSIONS = 32  # of an array of objects whose entries can be looked at
DEEPEST = 64  # lists in lists, as many as an array has dimensions at most


def is_real(value: Any) -> bool:
    """Say whether a value is a real number: no truth value, no text, no array, nothing that merely turns into a float.

    Examples
    --------
    >>> is_real(2.5), is_real(np.uint8(3)), is_real(True), is_real("2.5"), is_real(1j)
    (True, True, False, False, False)
    """
    if isinstance(value, numbers.Real):
        return not isinstance(value, bool)
    # Decimal is a number, but registered as no kind of it.
    return isinstance(value, numbers.Number) and not isinstance(value, numbers.Complex)


def size_of_range(values: range) -> int:
    """Return how many numbers a range says, which may be more than `len` can.

    Examples
    --------
    >>> size_of_range(range(10**30)) == 10**30
    True
    """
    return max(0, -((values.start - values.stop) // values.step))


def is_of_a_ring(value: Any) -> bool:
    """Say whether a value can be added to numbers and multiplied by them, as numbers of any kind can.

    Examples
    --------
    >>> is_of_a_ring(1j), is_of_a_ring("2.5"), is_of_a_ring(None)
    (True, False, False)
    """
    return hasattr(type(value), "__radd__") and hasattr(type(value), "__rmul__")


def array_given(values: Any, what: str, kinds: str = REAL) -> NDArray[Any]:
    """Return an array of what was given, or say by name what is wrong with it; not copied where it is an array.

    Parameters
    ----------
    values : array_like
        Of real numbers. An array of objects may hold any real numbers, such as fractions.
    what : str
        What it is called in a message.
    kinds : str, optional
        NumPy's kinds of numbers that are accepted beside objects; with ``"c"`` in them whatever can be added and
        multiplied counts as a number.

    Returns
    -------
    ndarray

    Raises
    ------
    TypeError
        Not numbers, truth values among them, ragged, or a pandas object whose labels would be lost.
    ValueError
        Masked entries.

    Examples
    --------
    >>> array_given([[1, 2]], "M")
    array([[1, 2]])
    """
    if type(values) is np.ndarray:
        array = values
    else:
        refuse_what_is_lost(values, what)
        if isinstance(values, range):  # which may say more numbers than it holds
            check_room(8 * size_of_range(values), f"{what}, {short(values)},")
        try:
            array = np.asarray(values)
        except MemoryError:
            raise ValueError(f"{what} does not fit into memory; give fewer numbers") from None
        except Exception:  # whatever an object raises that is asked for its numbers
            raise no_numbers(values, what) from None
    kind = array.dtype.kind
    if kind in kinds:
        return array
    if (
        kind != "O"
        or array.ndim > MOST_DIMENSIONS
        or not all(map(is_of_a_ring if "c" in kinds else is_real, array.flat))
    ):
        raise no_numbers(values, what)
    return array


def read_numbers(values: Any, what: str) -> Floats:
    """Return a float64 copy of real numbers, or say by name what is wrong with them.

    Examples
    --------
    >>> read_numbers([[1, 2]], "M")
    array([[1., 2.]])
    """
    array = array_given(values, what)
    if array.size > SMALL:
        check_room(8 * array.size, f"a copy of {what}, of shape {array.shape},")
    try:
        if array.dtype.itemsize <= 8 and array.dtype.kind != "O":
            return np.array(array, dtype=np.float64)
        with np.errstate(over="ignore"):  # infinity, which is refused where numbers must be finite
            return np.array(array, dtype=np.float64)
    except OverflowError:
        raise ValueError(f"{what} holds a number that is too large for float64") from None
    except (TypeError, ValueError):
        raise no_numbers(values, what) from None


def read_complex(values: Any, what: str) -> NDArray[np.complex128]:
    """Return a complex copy of real or complex numbers, refused as in `read_numbers`.

    Examples
    --------
    >>> read_complex([1, 2j], "modes")
    array([1.+0.j, 0.+2.j])
    """
    array = array_given(values, what, "iufc")
    try:
        return np.array(array, dtype=np.complex128)
    except OverflowError:
        raise ValueError(f"{what} holds a number that is too large for float64") from None
    except (TypeError, ValueError):
        raise no_numbers(values, what) from None


def read_finite(values: Any, what: str) -> Floats:
    """Return a float64 copy of finite real numbers; the first entry that is not finite is named.

    Examples
    --------
    >>> read_finite([1, 2], "axis")
    array([1., 2.])
    """
    found = read_numbers(values, what)
    check_finite(found, what)
    return found


def are_finite(numbers: Floats) -> bool:
    """Return whether all numbers are finite; of few of them that is found five times quicker than by NumPy.

    Examples
    --------
    >>> are_finite(np.array([1.0, 2.0])), are_finite(np.array([1.0, np.inf]))
    (True, False)
    """
    # Numbers with a finite sum are finite.
    few = numbers.size <= FEW
    return (few and math.isfinite(sum(numbers.ravel().tolist()))) or bool(np.isfinite(numbers).all())


def check_finite(values: Floats, what: str) -> None:
    """Refuse NaN and infinity; the first of them is named."""
    if not np.isfinite(values).all():
        place = np.argwhere(~np.isfinite(values))[0].tolist()
        where = f"[{', '.join(map(str, place))}]" if place else ""
        raise ValueError(f"{what}{where} is {values[tuple(place)]}; give finite numbers")


def no_numbers(values: Any, what: str) -> TypeError:
    """Return the error for what is no array of real numbers."""
    return TypeError(f"{what} is {short(values, 60)}; it must be an array of real numbers, all rows of the same length")


def refuse_what_is_lost(values: Any, what: str, depth: int = 0) -> None:
    """Refuse masks, labels and truth values, which an array of floats would not have."""
    if isinstance(values, list | tuple):
        kinds = set(map(type, values))
        if kinds <= {float, int} or depth == DEEPEST:
            return
        if bool in kinds or np.bool_ in kinds:
            raise no_numbers(values, what)
        for entry in values:
            refuse_what_is_lost(entry, what, depth + 1)
    elif isinstance(values, np.ma.MaskedArray):
        if np.ma.is_masked(values):
            raise ValueError(f"{what} has masked entries, which no number stands for; fill them in, or leave them out")
    elif hasattr(values, "iloc") and hasattr(values, "axes"):
        # Of pandas, which is not imported for it. Labels other than 0, 1, ... could say another order.
        if any(list(axis) != list(range(len(axis))) for axis in values.axes):
            raise TypeError(
                f"{what} is a {type(values).__name__} with labels other than 0, 1, 2, ..., and they would be lost; "
                "give its to_numpy(), where the order is right"
            )


def read_number(value: Any, what: str) -> float:
    """Return one finite real number as a float, or refuse it by name.

    Examples
    --------
    >>> read_number(2, "step")
    2.0
    """
    if type(value) is not float:
        if type(value) is not int:
            if isinstance(value, np.ndarray) and value.ndim == 0 and not isinstance(value, np.ma.MaskedArray):
                value = value[()]
            if not is_real(value):
                raise TypeError(f"{what} is {short(value)}; it must be a number")
        try:
            value = float(value)
        except (OverflowError, ValueError):
            raise ValueError(f"{what} is {short(value)}, which is too large for float64") from None
    if not math.isfinite(value):
        raise ValueError(f"{what} is {value!r}; it must be finite")
    return value


def read_positive(value: Any, what: str) -> float:
    """Return one positive number as a float, or refuse it by name.

    Examples
    --------
    >>> read_positive(0.5, "step")
    0.5
    """
    number = read_number(value, what)
    if number <= 0.0:
        raise ValueError(f"{what} is {number!r}; it must be positive")
    return number


def check_power(number: float, power: int, what: str) -> None:
    """Refuse a number whose power leaves the range of float64.

    Examples
    --------
    >>> check_power(1e30, 10, "step")
    """
    if power * math.log2(max(abs(number), 1.0)) >= 1024.0:
        raise ValueError(
            f"{what} is {number!r}, and its power {power} leaves the range of float64; give a smaller number"
        )


def read_whole(
    value: Any, what: str, least: int = 1, most: int | None = None, *, floats: bool = False, why: str = ""
) -> int:
    """Return a whole number between bounds as an int of Python, which does not wrap, or refuse it by name.

    Parameters
    ----------
    value : object
        What was given. A truth value is no number.
    what : str
        What it is called in a message.
    least, most : int
        The bounds.
    floats : bool, optional
        Whether a float that is whole is taken, such as 1e6 for a number of steps.
    why : str, optional
        Why there is no more; said where the value is too large.

    Examples
    --------
    >>> read_whole(np.uint8(200), "stages") * 2
    400
    """
    whole = type(value) is int or (isinstance(value, numbers.Integral) and not isinstance(value, bool))
    if floats and not whole and isinstance(value, float | np.floating):
        value = float(value)  # a small kind of float does not hold the bounds
        whole = value.is_integer()
    if not whole or value < least or (most is not None and value > most and not why):
        bounds = f"from {least} up" if most is None or why else f"from {least} to {short(most)}"
        raise ValueError(f"{what} must be a whole number {bounds}, not {short(value)}")
    if most is not None and value > most:
        raise ValueError(f"{what} must be at most {most}, not {short(value)}; {why}")
    return int(value)


def read_flag(value: Any, what: str) -> bool:
    """Return True or False, or refuse anything else by name.

    Examples
    --------
    >>> read_flag(True, "watch")
    True
    """
    if not isinstance(value, bool | np.bool_):
        raise TypeError(f"{what} is {short(value)}; it must be True or False")
    return bool(value)


def read_title(value: Any, what: str) -> str:
    """Return a name that messages and pictures can show, or refuse it by name.

    Examples
    --------
    >>> read_title("so(3)", "name of the algebra")
    'so(3)'
    """
    if not isinstance(value, str) or not value:
        raise TypeError(f"{what} must be a nonempty string, not {short(value)}")
    if len(value) > LONGEST_TITLE or not value.isprintable():
        raise ValueError(f"{what} is {short(value)}; it must be one line of at most {LONGEST_TITLE} characters")
    return value


def title(text: str) -> str:
    """Return a name that is made of others, cut where it is too long to be shown.

    Examples
    --------
    >>> title("so(3) + so(4)")
    'so(3) + so(4)'
    """
    return text if len(text) <= LONGEST_TITLE else f"{text[: LONGEST_TITLE - 3]}..."


def read_path(value: Any, what: str) -> Path:
    """Return the name of a file or a folder, or refuse what is none.

    Examples
    --------
    >>> read_path("run.nc", "path").suffix
    '.nc'
    """
    if not isinstance(value, str | Path):
        raise TypeError(f"{what} is {short(value)}; give the name of a file, as text or as a pathlib.Path")
    return Path(value)


def read_list(values: Any, what: str, rule: str) -> tuple[Any, ...]:
    """Return the entries of what can be gone through, or refuse it by name, saying what would be right.

    Examples
    --------
    >>> read_list([1, 2], "methods", "give a list of schemes")
    (1, 2)
    """
    try:
        if not isinstance(values, str | bytes | Mapping):
            size = values.size if isinstance(values, np.ndarray) else len(values) if isinstance(values, Sized) else 0
            check_room(BYTES_PER_ENTRY * size, f"{what}, of {size} entries,")
            return tuple(values)
    except TypeError:
        pass
    raise TypeError(f"{what} is {short(values)}; {rule}")


def check_parameters(name: str, given: Iterable[str], known: Iterable[str], required: Iterable[str] = ()) -> None:
    """Refuse parameters that something with this name does not have, or lacks.

    Examples
    --------
    >>> check_parameters("Torque", ["torqe"], ["torque"])
    Traceback (most recent call last):
    ValueError: unknown parameter of Torque 'torqe'; did you mean 'torque'?
    """
    given, known = list(given), list(known)
    for parameter in given:
        if parameter not in known:
            raise unknown_name(f"parameter of {name}", parameter, known or ["(none)"])
    missing = [key for key in required if key not in given]
    if missing:
        raise ValueError(f"{name} needs the parameter {missing[0]!r}")


def read_choice(value: Any, what: str, known: Collection[str]) -> str:
    """Return a name that is known, or refuse it with the nearest known one.

    Examples
    --------
    >>> read_choice("exact", "rotation", ("exact", "rational"))
    'exact'
    """
    if not isinstance(value, str) or value not in known:
        raise unknown_name(what, value, known)
    return str(value)

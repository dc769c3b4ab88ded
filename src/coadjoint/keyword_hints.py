"""Messages about names that a function or object does not have: the name that is meant, or the nearest one."""

from __future__ import annotations

import abc
import functools
import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, TypeVar, cast

from coadjoint.errors import nearest, unknown_name
from coadjoint.rounding import in_standard_mode
from coadjoint.short_repr import short

Function = TypeVar("Function", bound=Callable[..., Any])
Kind = inspect.Parameter


@functools.cache
def vocabulary(kind: str) -> Mapping[str, str]:
    """Return the names of other libraries -> the name here, from a table of `vocabulary.json`."""
    import json
    from importlib.resources import files

    table = json.loads(files("coadjoint").joinpath("vocabulary.json").read_text("utf-8"))[kind]
    return {name: meant for meant, names in table.items() for name in names}


class Abstract:
    """Base of classes with abstract methods that cannot be constructed without them; `abc.ABC` has a metaclass."""

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        cls.__abstractmethods__ = frozenset()  # type: ignore[attr-defined]
        abc.update_abstractmethods(cls)


def suggest_keywords(function: Function) -> Function:
    """Decorate a public function, method or class: it computes in the standard floating-point mode, and calls with
    wrong arguments raise a TypeError that says what to give.

    A class is decorated in the constructor and the public class methods that it defines, above ``@dataclass``; a class
    method below ``@classmethod``.

    >>> @suggest_keywords
    ... def run(x0, step=None): ...
    >>> run((1, 2), dt=0.1)
    Traceback (most recent call last):
    TypeError: run has no dt; give step=, the size of a step, which is used as given
    >>> run((1, 2), stepp=0.1)
    Traceback (most recent call last):
    TypeError: run has no stepp; did you mean step=?
    >>> run((1, 2), x0=(1, 2))
    Traceback (most recent call last):
    TypeError: run was given x0 twice, by position and by name; its arguments are x0, step
    """
    if isinstance(function, type):
        kind: Any = function
        for name, value in list(vars(kind).items()):
            if name == "__init__":
                kind.__init__ = suggest_keywords(value)
            elif isinstance(value, classmethod) and not name.startswith("_"):
                setattr(kind, name, classmethod(suggest_keywords(value.__func__)))
        return cast(Function, kind)
    compute, parameters = in_standard_mode(function), list(inspect.signature(function).parameters.values())
    is_method = parameters[:1] != [] and parameters[0].name in ("self", "cls")
    signature = inspect.Signature(parameters[is_method:])

    @functools.wraps(function)
    def wrapped_function(*args: Any, **keywords: Any) -> Any:
        try:
            return compute(*args, **keywords)
        except TypeError:
            name = function.__name__
            if is_method and args:
                kind = args[0] if isinstance(args[0], type) else type(args[0])
                name = kind.__name__ if name == "__init__" else f"{kind.__name__}.{name}"
            if (error := _wrong_arguments(name, signature, args[is_method:], keywords)) is not None:
                raise error from None
            raise

    return cast(Function, wrapped_function)


def _wrong_arguments(
    function: str, signature: inspect.Signature, given: Sequence[Any], keywords: Mapping[str, Any]
) -> TypeError | None:
    """Return the TypeError for arguments that a function does not take, or None if it takes them."""
    try:
        signature.bind(*given, **keywords)
    except TypeError:
        pass
    else:
        return None
    kinds = {name: parameter.kind for name, parameter in signature.parameters.items()}
    known = [name for name, kind in kinds.items() if kind not in (Kind.VAR_POSITIONAL, Kind.VAR_KEYWORD)]
    positional = [name for name in known if kinds[name] is not Kind.KEYWORD_ONLY]
    unknown = [name for name in keywords if name not in known]
    if unknown and Kind.VAR_KEYWORD not in kinds.values():
        return TypeError(f"{function} has no {unknown[0]}; {_keyword_meant(unknown[0], known)}")
    listing = f"its arguments are {', '.join(known)}"
    if twice := [name for name in positional[: len(given)] if name in keywords]:
        return TypeError(f"{function} was given {twice[0]} twice, by position and by name; {listing}")
    if len(given) > len(positional) and Kind.VAR_POSITIONAL not in kinds.values():
        remedy = f", those after {positional[-1]} by name" if 0 < len(positional) < len(known) else ""
        if len(positional) == 1 == len(known):
            remedy = f"; give several values as one, {known[0]}={short(tuple(given))}"
        return TypeError(f"{function} was given {len(given)} arguments, and takes {', '.join(known) or 'none'}{remedy}")
    required = [name for name in known if signature.parameters[name].default is inspect.Parameter.empty]
    missing = [name for name in required if name not in keywords and name not in positional[: len(given)]]
    return TypeError(f"{function} needs {', '.join(missing)}; {listing}")


def _keyword_meant(name: str, known: Sequence[str]) -> str:
    """Return what to give instead of an unknown keyword of a function."""
    meant = vocabulary("arguments").get(name, "")
    if meant.partition("=")[0] not in known:  # suggest only an argument that this function has
        meant = vocabulary("arguments elsewhere").get(name, "")
    if meant:
        return meant if meant.startswith("it ") else f"give {meant}"
    near = nearest(name, known)
    return f"did you mean {near}=?" if near else f"it takes {', '.join(known)}"


def not_by_position(function: str, others: Sequence[Any], known: Iterable[str]) -> TypeError:
    """Return the TypeError for arguments by position beside x0; the first `known` name is the example.

    >>> print(not_by_position("f", [1.0], ["inertia"]))
    f was given 2 arguments by position, and takes x0 alone; give the others by name, such as inertia=
    """
    return TypeError(
        f"{function} was given {1 + len(others)} arguments by position, and takes x0 alone; give the others by name, "
        f"such as {next(iter(known), 'attitude0')}="
    )


def unknown_solution_attribute(name: str, known: Sequence[str]) -> AttributeError:
    """Return the AttributeError for an unknown attribute of a solution.

    >>> print(unknown_solution_attribute("y", ["x", "t"]), unknown_solution_attribute("enregy", ["energy"]), sep="; ")
    a Solution has no attribute 'y'; here it is x; a Solution has no attribute 'enregy'; did you mean 'energy'?
    """
    meant, near = vocabulary("attributes of solutions").get(name), None if name[:1] == "_" else nearest(name, known)
    remedy = f"; here it is {meant}" if meant else f"; did you mean {near!r}?" if near else ""
    return AttributeError(f"a Solution has no attribute {name!r}{remedy}")


def unknown_picture(name: str, known: Iterable[str]) -> ValueError:
    """Return the ValueError for an unknown kind of picture, with the kind that is meant or the nearest one."""
    names = list(known)
    meant = vocabulary("pictures").get(name.strip().casefold().replace("_", " ").replace("-", " "))
    if meant in names:
        return ValueError(f"unknown kind of picture {short(name)}; here it is {meant!r}")
    return unknown_name("kind of picture", name, names)


def unknown_function(name: str) -> AttributeError | None:
    """Return the AttributeError for a usual name of a function that has another one here, or None."""
    meant = vocabulary("functions").get(name)
    return None if meant is None else AttributeError(f"coadjoint has no attribute {name!r}; here it is {meant}")

"""Schemes by name, collected from the files of this folder, entry points and `register`; and schemes for a purpose."""

from __future__ import annotations

import dataclasses
import importlib.metadata
import inspect
import warnings
from collections.abc import Iterator, Mapping
from functools import cache
from typing import TYPE_CHECKING, Any, TypeVar, cast

from coadjoint.keyword_hints import suggest_keywords
from coadjoint.methods.protocol.method import Method
from coadjoint.methods.splitting import Splitting
from coadjoint.short_repr import plain, short
from coadjoint.systems.system import System
from coadjoint.systems.system_checks import check_one_system
from coadjoint.validation import classes_in, construct, read_choice
from coadjoint.validation import from_description as described

if TYPE_CHECKING:
    from coadjoint.systems.matrices.matrix_system import MatrixSystem

Scheme = TypeVar("Scheme", bound=type[Method])

ENTRY_POINTS = "coadjoint.methods"
"""Group of entry points with which other packages register schemes: name = "package.module:Scheme"."""

_registered: dict[str, type[Method]] = {}
_loaded: dict[str, type[Method]] = {}
"""Schemes loaded from entry points."""


@suggest_keywords
def register(scheme: Scheme) -> Scheme:
    """Register a scheme under its name: for `get`, configuration files, saved runs, and ``coadjoint methods``.

    Parameters
    ----------
    scheme : type
        A concrete subclass of `Method` that is a dataclass; registered by the name of the class.

    Returns
    -------
    type
        The class itself, for use as a decorator.

    Raises
    ------
    TypeError
        It is not such a class.
    ValueError
        Another scheme has this name.

    Examples
    --------
    >>> import dataclasses
    >>> import coadjoint as co
    >>> @co.methods.register
    ... @dataclasses.dataclass(frozen=True)
    ... class ForwardEuler(co.methods.StepMethod):
    ...     order, explicit, symmetric = 1, True, False
    ...     def properties(self, system):
    ...         return co.methods.Properties(poisson=False, energy=False, casimirs="none", attitude="none")
    ...     def step(self, system, x, t, h):
    ...         return x + h * system.vector_field(x, t)
    >>> co.methods.get("ForwardEuler").order
    1
    >>> co.methods.registry.forget("ForwardEuler")
    """
    if not (isinstance(scheme, type) and issubclass(scheme, Method)):
        raise TypeError(f"{short(scheme)} is not a scheme; register a class that derives from coadjoint.methods.Method")
    missing = sorted(getattr(scheme, "__abstractmethods__", ()))
    if missing:
        raise TypeError(f"{scheme.__name__} has no {missing[0]}; a scheme must define its order, properties and step")
    if not dataclasses.is_dataclass(scheme):
        raise TypeError(f"{scheme.__name__} is not a dataclass, so its parameters cannot be stored; make it one")
    name = scheme.__name__
    known = _built_in().get(name) or _loaded.get(name) or _registered.get(name)
    if known is not None and (known.__module__, known.__qualname__) != (scheme.__module__, scheme.__qualname__):
        raise ValueError(f"there is another scheme {name}, in {known.__module__}; give this one another name")
    _registered[name] = scheme
    return scheme


def forget(name: str) -> None:
    """Undo `register`; raise ValueError if no such scheme was registered."""
    read_choice(name, "registered method", _registered)
    del _registered[name]


def _schemes() -> dict[str, type[Method]]:
    return dict(sorted((_built_in() | _entry_point_schemes() | _registered).items()))


@cache
def _entry_point_schemes() -> dict[str, type[Method]]:
    for point in importlib.metadata.entry_points(group=ENTRY_POINTS):
        try:
            scheme = point.load()
            register(scheme)
            _loaded[scheme.__name__] = _registered.pop(scheme.__name__)
        except Exception as error:
            # A broken package must not prevent the use of the others.
            warnings.warn(f"the scheme {point.name} ({point.value}) is skipped: {error}", RuntimeWarning, stacklevel=2)
    return _loaded


@cache
def _built_in() -> dict[str, type[Method]]:
    """Return the concrete schemes defined in the files of this folder, by name."""
    found = classes_in("coadjoint.methods", Method)  # type: ignore[type-abstract]
    return {name: scheme for name, scheme in found.items() if scheme.offered}


@suggest_keywords
def names() -> tuple[str, ...]:
    """Return the names of the schemes, sorted.

    Returns
    -------
    tuple of str

    Examples
    --------
    >>> "Splitting" in names()
    True
    """
    return tuple(_schemes())


def scheme(name: str) -> type[Method]:
    """Return a scheme as a class, by its name."""
    schemes = _schemes()
    return schemes[read_choice(name, "method", schemes)]


@suggest_keywords
def get(name: str, /, **parameters: Any) -> Method:
    """Return a scheme by its name.

    Parameters
    ----------
    name : str
        One of `names`.
    **parameters
        Parameters of the scheme. A scheme among them (the base of a `Composition`) may be a mapping, as for
        `from_description`.

    Returns
    -------
    Method

    Raises
    ------
    ValueError, TypeError
        There is no such scheme or parameter (the message suggests the nearest name), or a value is invalid.

    Examples
    --------
    >>> get("Splitting", order=4).order
    4
    >>> get("Composition", base={"name": "Splitting"}, coefficients=[1.0]).order
    2
    """
    return construct("method", _schemes(), name, parameters)  # type: ignore[no-any-return]


def from_description(description: Mapping[str, Any]) -> Method:
    """Return the scheme of a mapping of its name and parameters, as in configuration files."""
    return described("method", _schemes(), description)  # type: ignore[no-any-return]


SCHEME_RULE = "it must be a scheme such as Splitting(order=2)"


def read_method(value: Any, what: str = "method", rule: str = SCHEME_RULE) -> Method:
    """Return the scheme for an instance, a name or a mapping, as `integrate` takes it; errors name the nearest name."""
    if isinstance(value, Method):
        return value
    if isinstance(value, Mapping):
        return from_description(value)
    if isinstance(value, str):
        if value.lower() in ADAPTIVE_NAMES:
            raise ValueError(
                f"{value} chooses each step by an estimate of the error, and so loses invariants; give "
                "Splitting(order=4), GaussLegendre(stages=3), or accuracy= in place of method="
            )
        if value.lower() in TABLEAU_NAMES:
            return get("ExplicitRungeKutta", name=value.lower())
        return get(value)
    if isinstance(value, type) and issubclass(value, Method):
        raise TypeError(f"{what} is the class {value.__name__}; give a scheme, such as {value.__name__}()")
    raise TypeError(f"{what} is {short(value)}; {rule}")


ADAPTIVE_NAMES = frozenset(("rk45", "rk23", "dop853", "radau", "bdf", "lsoda", "dopri5", "vode", "tsit5", "odeint"))
TABLEAU_NAMES = frozenset(("rk4", "runge2"))


def parameters_of(name: str) -> dict[str, Any]:
    """Return the parameters of a scheme with their defaults (``inspect.Parameter.empty`` if there is none)."""
    return {key: p.default for key, p in inspect.signature(scheme(name)).parameters.items()}


def documentation_of(name: str) -> str:
    """Return the docstring of a scheme without its examples; raise ValueError for an unknown name."""
    return (inspect.getdoc(scheme(name)) or "").partition("\nExamples\n")[0].rstrip()


@plain.register(Method)
def description_of(method: Method) -> dict[str, Any]:
    """Return the name and parameters of a scheme, for `from_description`; TypeError if it is no dataclass."""
    if not dataclasses.is_dataclass(method):
        raise TypeError(f"{short(method)} is not a dataclass, so its parameters cannot be stored; make it one")
    values = {field.name: getattr(method, field.name) for field in dataclasses.fields(method) if field.init}
    return {"name": type(method).__name__, "parameters": plain(values)}


DEFAULT_SCHEME: Method = Splitting()
"""For systems of vectors that it supports."""
ANY_TOLERANCE = 1e-9
"""Relative tolerance of a candidate, which `choose` replaces by that for the accuracy."""


def default_scheme(system: Any) -> Method:
    """Return the scheme of a run or a batch for which none is given."""
    if system.has_matrices:
        return suggested_scheme(system.unforced)
    supported = all(_supports(DEFAULT_SCHEME, one.unforced) for one in system.distinct)
    return DEFAULT_SCHEME if supported else reference_scheme(6)


def _supports(method: Method, system: Any) -> bool:
    try:
        method.properties(system)
    except (TypeError, ValueError):
        return False
    return True


def reference_scheme(order: int) -> Method:
    """Return the scheme of this even order for numerical references: symplectic, symmetric, and for every system."""
    from coadjoint.methods.gauss_legendre import GaussLegendre

    return GaussLegendre(order // 2)


@cache
def candidate_schemes(processed: bool = False) -> tuple[Method, ...]:
    """Return the schemes from which `choose` selects, family after family."""
    from coadjoint.methods.taylor import Taylor

    return (
        Taylor(tolerance=ANY_TOLERANCE),
        *(Taylor(p) for p in (6, 8, 10, 12, 14, 16, 20, 24)),
        *(reference_scheme(2 * s) for s in (2, 3, 4, 6, 8, 10, 12)),
        *(Splitting(order=p) for p in (2, 4, 6, 8, 10)),
        *(Splitting(scheme=f"blanes_casas_murua{p}") for p in (6, 8, 10) if processed),
    )


def suggested_scheme(system: System) -> Method:
    """Return the suggested scheme for a system; for matrices preferably one that is a Poisson map."""
    check_one_system(system)
    if system.has_matrices:
        matrices = cast(Any, system)
        for method in sorted(_supporting_schemes(matrices), key=lambda method: not method.properties(matrices).poisson):
            return method
    elif _supports(splitting := Splitting(order=4), system):
        return splitting
    last = reference_scheme(6)
    last.properties(system)
    return last


def _supporting_schemes(system: MatrixSystem) -> Iterator[Method]:
    """Yield the registered schemes that support a system, each as its first example."""
    for name in names():
        method = scheme(name).examples()[0]
        if _supports(method, system):
            yield method

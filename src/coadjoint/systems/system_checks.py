"""Validation of systems, and of their arguments: name, sign, parameters, layout, functions, Casimirs and integrals."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from coadjoint.algebra.invariants.invariant import Invariant
from coadjoint.algebra.invariants.sampled_checks import (
    SEED,
    VALID,
    check_casimir,
    evaluate,
    gradient_and_scale,
    rate_along,
    sample_points,
)
from coadjoint.algebra.polynomials.monomials import check_names
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.errors import unknown_name
from coadjoint.long_operations import warn_caller
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.short_repr import short
from coadjoint.systems.coordinates import KINDS, coordinate_names, numberless
from coadjoint.systems.evaluation import ignore_overflow
from coadjoint.systems.hamiltonians.hamiltonian import Hamiltonian
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.user_functions import check_places, check_skew, takes_time, without_multiples
from coadjoint.validation import is_integer, is_real, read_integer, read_list, read_title, set_fields


def read_name(name: Any, default: str) -> str:
    """Return the validated name, or `default` if it is None."""
    return default if name is None else read_title(name, "name of a system")


def schemes_for(system: Any, usual: str) -> str:
    """Return the schemes to name where one refuses a system: those of a function that is not split, or usual ones."""
    functions = (without_multiples(getattr(term, "value", None))[0] for term in system.hamiltonian.terms())
    return next((one.other_schemes for one in functions if hasattr(one, "other_schemes")), usual)


def read_sign(sign: int, what: str = "sign") -> int:
    """Validate a sign, +1 or -1; `what` is its name in messages."""
    if not is_real(sign) or sign not in (1, -1):
        rule = "+1 (x' = J(x) grad H) or -1 (body systems)" if what == "sign" else "+1 or -1"
        raise ValueError(f"{what} is {short(sign)}; give {rule}")
    return int(sign)


def read_parameters(parameters: Mapping[str, Any] | None) -> dict[str, Any] | None:
    """Validate the parameters of a system and return a copy."""
    if not isinstance(parameters, Mapping | None):
        raise TypeError(f"parameters is {short(parameters)}; give a mapping from names to values, or None")
    return None if parameters is None else dict(parameters)


def _read_kinds(given: Any, names: Callable[[], tuple[str, ...]]) -> dict[str, tuple[str, str]]:
    """Validate kinds and units of coordinates, by their names or these without numbers."""
    if not isinstance(given, Mapping):
        raise TypeError(f'coordinates of layout is {short(given)}; give a mapping such as {{"r": "position"}}')
    known = {part for name in names() for part in (name, numberless(name))}
    found: dict[str, tuple[str, str]] = {}
    for name, value in given.items():
        if name not in known:
            raise unknown_name("coordinate", name, sorted(known))
        pair = (value, "") if isinstance(value, str) else tuple(value) if isinstance(value, list | tuple) else ()
        if len(pair) != 2 or pair[0] not in KINDS or not isinstance(pair[1], str):
            raise ValueError(
                f"{name} of layout is {short(value)}; give its kind, one of {', '.join(KINDS)}, or the kind and a unit"
            )
        found[name] = pair
    return found


def read_layout(layout: Mapping[str, Any] | None, names: Callable[[], tuple[str, ...]]) -> dict[str, Any]:
    """Validate the layout (lattice and shape of sites, kinds and units of coordinates) and return a copy."""
    if layout is None:
        return {}
    rule = (
        'give a mapping such as {"lattice": "square", "shape": (10, 10)} or {"coordinates": {"r": "position"}}, or None'
    )
    if not isinstance(layout, Mapping) or not layout.keys() <= {"lattice", "shape", "coordinates"}:
        raise TypeError(f"layout is {short(layout)}; {rule}")
    result = dict(layout)
    if "coordinates" in layout:
        result["coordinates"] = _read_kinds(layout["coordinates"], names)
        if layout.keys() == {"coordinates"}:
            return result
    if not isinstance(result.get("lattice"), str):
        raise TypeError(f"the lattice of layout is {short(result.get('lattice'))}; {rule}")
    if result.get("shape") is not None:
        shape = result["shape"]
        cells = (shape,) if is_integer(shape) else read_list(shape, "the shape of layout", rule)
        result["shape"] = tuple(read_integer(count, "the shape of layout") for count in cells)
    return result


def read_closed_form(exact: Callable[..., Any] | None) -> Callable[..., Any] | None:
    """Validate the closed form of a system: a function of (x0, t, attitude), or None."""
    if exact is not None and not callable(exact):
        raise TypeError(f"exact is {short(exact)}; give a function of (x0, t, attitude), or None")
    if exact is not None:
        check_places(exact, "exact", "x0, t, attitude")
    return exact


class KnownInvariants(Mapping[str, Any]):
    """Invariants that are valid by construction, each by a function that makes it whenever it is read."""

    def __init__(self, makers: Mapping[str, Callable[[], Any]]) -> None:
        self._makers = dict(makers)

    def __getitem__(self, name: str) -> Any:
        return self._makers[name]()

    def __iter__(self) -> Iterator[str]:
        return iter(self._makers)

    def __len__(self) -> int:
        return len(self._makers)


def read_casimirs(casimirs: Mapping[str, Any], system: Any) -> dict[str, Any]:
    """Validate Casimirs by name; wrap plain functions, and check ``J(x) grad C(x) = 0`` at sample points."""
    if isinstance(casimirs, KnownInvariants):
        return dict(casimirs)
    result = read_invariants(casimirs, system, "Casimir")
    for name, casimir in () if VALID.get() else result.items():
        check_casimir(name, casimir, system.dim, system._product, system._absolute_product)
    return result


def read_invariants(argument: Any, system: Any, kind: str) -> dict[str, Any]:
    """Validate invariants of a system by name; functions are wrapped. `kind` is their name in messages."""
    n = system.dim
    if not isinstance(argument, Mapping):
        raise TypeError(
            f"{kind.lower()}s is a {type(argument).__name__}; give a mapping from name to Polynomial or Invariant"
        )
    result: dict[str, Any] = {}
    for name, invariant in argument.items():
        if getattr(invariant, "_written_names", None) is not None:
            check_names(invariant, coordinate_names(system), f"the {kind} {short(name)}")
        if name == "energy":
            article = "an" if kind[0] in "aeiou" else "a"
            raise ValueError(
                f"{article} {kind} is called 'energy', which is the name of the Hamiltonian; choose another name"
            )
        if isinstance(invariant, Hamiltonian) and not invariant.timed:
            term: Any
            (term,) = invariant.bind(n).terms()
            invariant = Invariant(term.value, term.gradient)
        if not isinstance(invariant, Polynomial | Quadratic | Invariant):
            if not callable(invariant):
                raise TypeError(
                    f"the {kind} {short(name)} is {short(invariant)}; "
                    "give a Polynomial, a Quadratic, an Invariant or a function of x"
                )
            invariant = Invariant(invariant)
        if isinstance(invariant, Invariant) and takes_time(invariant.value, f"the {kind} {short(name)}"):
            raise TypeError(
                f"the {kind} {short(name)} is a function of (x, t), and {kind}s are functions of x; give one, or "
                "record a function of (x, t) by observe="
            )
        if isinstance(invariant, Polynomial) and invariant.dim != n:
            raise ValueError(f"the {kind} {short(name)} has {invariant.dim} variables but the system has dimension {n}")
        result[str(name)] = invariant.bind(n) if isinstance(invariant, Quadratic) else invariant
    return result


TIMES = (0.0, 1.0)  # at which integrals are checked: a field may rest at time zero


@ignore_overflow
def read_integrals(integrals: Any, system: Any) -> Mapping[str, Any]:
    """Validate integrals by name; check ``grad F(x) . J(x) grad H(x) = 0`` at sample points, or by differences."""
    if isinstance(integrals, KnownInvariants):
        return integrals
    result, H = read_invariants(integrals, system, "integral"), system.hamiltonian
    for x in sample_points(system.dim) if result and not VALID.get() else []:
        for t in TIMES if H.timed else TIMES[:1]:
            force = evaluate(lambda y, t=t: H.gradient(y, t), x, False)
            if force is None or not np.all(np.isfinite(force)):
                continue
            bound, work = np.abs(force), 2**20
            if hasattr(H, "gradient_and_size"):
                _, bound, work = gradient_and_scale("energy", H, x) or (force, bound, work)
            field, sizes = system._product(x, force), system._absolute_product(x, bound)
            for name, F in result.items():
                if F.gradient is None:
                    found = rate_along(F.value, x, field, sizes * max(1.0, work / 2**10))
                else:
                    scaled = gradient_and_scale(name, F, x, "integral")
                    if scaled is None:
                        continue
                    gradient, scale, operations = scaled
                    # Products of long vectors by BLAS wait for its threads.
                    rounding = (work + operations) * UNIT_ROUNDOFF * float(np.sum(scale * sizes))
                    found = float(np.sum(gradient * field)), rounding
                if found is not None and abs(found[0]) > found[1]:
                    raise ValueError(
                        f"{short(name)} is not an integral: it changes at the rate {abs(found[0]):.3g} at a sample "
                        "point, and its bracket with the Hamiltonian must vanish everywhere"
                    )
    return result


def check_structure(system: Any) -> None:
    """Check that `structure_function` returns skew (n, n) at sample points; warn unless the Jacobi identity holds."""
    function = system.structure_function
    if function is None or function is system._checked_function:
        return
    if getattr(function, "__self__", function) is system:
        raise TypeError(
            f"structure_function of {system.name} is its method, which is not compiled; make it a function of x, "
            "by @staticmethod or in __init__"
        )
    check_skew(function, system.dim)
    set_fields(system, _checked_function=function)
    defect = jacobi_defect(system) if system.jacobi else None
    if defect is not None:
        warn_caller(
            f"J(x) of {system.name} violates the Jacobi identity, by {defect:.3g} in a sample direction, so that it is "
            "no Poisson bracket; correct it, or give jacobi=False if it need not be one, as of a nonholonomic system",
            UserWarning,
        )


def jacobi_defect(system: Any) -> float | None:
    """Return the cyclic sum of (J u . grad)(v . J w) at a sample point if it exceeds its error, else None."""
    # By differences, or by `derivative_function`, whose values may lose 20 bits.
    n, function, slope = system.dim, system.structure_function, system.derivative_function
    vectors = np.random.default_rng(SEED + 4).standard_normal((3, n))
    for x in sample_points(n) if n > 2 else []:
        J, dJ = evaluate(function, x, False), None if slope is None else evaluate(slope, x, False)
        if J is None or not np.all(np.isfinite(J)):
            continue
        total = error = 0.0
        for shift in range(3):
            u, v, w = np.roll(vectors, shift, axis=0)
            if dJ is not None:
                total += float(v @ (dJ @ (J @ u)) @ w)
                size = np.abs(v) @ (np.abs(dJ) @ (np.abs(J) @ np.abs(u))) @ np.abs(w)
                error += 2.0**20 * UNIT_ROUNDOFF * float(size)
                continue
            found = rate_along(lambda y, v=v, w=w: v @ function(y) @ w, x, J @ u, np.abs(J) @ np.abs(u))
            if found is None:
                error = np.inf
                break
            total, error = total + found[0], error + found[1]
        if abs(total) > error:
            return abs(total)
    return None


def check_system(system: Any) -> None:
    """Raise TypeError unless given a complete `System`, or a `Batch`."""
    if isinstance(system, type) or not hasattr(system, "is_batch"):
        raise TypeError(
            f"system is {short(system)}; it must be a LiePoissonSystem or another System, such as "
            "co.systems.rigid_body()"
        )
    if not system.is_batch:
        missing = [field for field in ("name", "sign", "dim", "hamiltonian") if not hasattr(system, field)]
        if missing:
            kind = type(system).__name__
            raise TypeError(f"the system, a {kind}, has no {', no '.join(missing)}; set each in its class")


def check_one_system(system: Any, forces: bool = False) -> None:
    """Raise TypeError for a batch, an object that is not a system, and a system with forces unless they are allowed."""
    check_system(system)
    if system.is_batch:
        raise TypeError(f"system is {short(system)}; it must be one system, such as a member of the batch, batch[0]")
    if system.forces and not forces:
        raise TypeError(
            f"{system.name} has forces, which only runs and steppers support; take its Hamiltonian part, .unforced"
        )


def check_vector_states(system: Any, advice: str = "use IsospectralGauss") -> None:
    """Raise an error unless given a single system with vector states; `advice` ends the message for matrix systems."""
    check_one_system(system)
    if system.has_matrices:
        raise ValueError(f"{system.name} has matrix states, in {system.algebra}; {advice}")

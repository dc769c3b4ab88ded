"""Parameters by which a run can be differentiated: of ready-made systems, of Hamiltonians, and of forces."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import is_dataclass, replace
from functools import cache, partial
from itertools import islice
from typing import Any, NamedTuple, cast
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.invariants.sampled_checks import sample_points
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.errors import in_one_line, unknown_name
from coadjoint.short_repr import distinct, short
from coadjoint.systems.batch import Batch
from coadjoint.systems.coefficients import (
    EnergyCoefficients,
    Key,
    coefficients_in,
    coefficients_of,
    coordinates_of,
    with_hamiltonian,
)
from coadjoint.systems.coordinates import in_coordinates_of
from coadjoint.systems.energy_derivatives import (
    DerivativeMonomial,
    EnergyDerivative,
    derivative_by_steps,
    functions_by_steps,
)
from coadjoint.systems.forces.base import Force
from coadjoint.systems.hamiltonians.hamiltonian import FunctionOfConstants, HamiltonianLike, as_hamiltonian
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.hamiltonians.sum_of_hamiltonians import SumOfHamiltonians
from coadjoint.systems.hamiltonians.summable import PolynomialHamiltonian, SeparatePolynomial
from coadjoint.systems.parameter_differences import (
    DISTANCE,
    MOST_DISTANCES,
    NEARER,
    NODES,
    RADIUS,
    EnergyDifferences,
    moved_entry,
    sizes_of_entries,
)
from coadjoint.systems.registry import DeclaredEnergy, energy_of, ready_made_systems
from coadjoint.systems.system import System

Floats = NDArray[np.float64]

# Changes of parameters, relative to their values, of a complex step and of differences that test it, to some digits.
TINY_STEP, SMALL_STEPS, AGREEMENT = 2.0**-70, (2.0**-17, 2.0**-21), 2.0**-10
# Entries of a parameter of which it is tried whether they may change.
MAX_TRIED = 16


class Parameter(NamedTuple):
    """Value of a parameter, a function of no argument for the derivative of the energy by its entries, and its kind."""

    # A symmetric matrix enters the energy by its symmetric part only. A parameter of a force is a `field` of the force
    # at a `position`.

    value: Floats
    energy: Callable[[], EnergyDerivative]
    symmetric: bool = False
    position: int | None = None
    field: str = ""


def with_value(force: Any, field: str, value: Floats) -> Force:
    """Return the force with another value of a parameter."""
    outer, _, inner = field.partition(".")
    if outer in force.named_values:
        return replace(force, **{outer: {**dict(getattr(force, outer)), inner: value}})
    if inner:
        return replace(force, **{outer: with_value(getattr(force, outer), inner, value)})
    return replace(force, **{field: value if value.ndim else float(value)})


def force_numbers(system: System) -> dict[str, Parameter]:
    """Return the real numbers and arrays of them of the forces, also those that cannot change, by "label.field"."""
    return {
        f"{label}.{field}": Parameter(
            value,
            cache(partial(EnergyDerivative.of_monomials, value.size)),
            value.ndim == 2 and field == "metric",
            position,
            field,
        )
        for position, (label, force) in enumerate(zip(system.labels, system.forces, strict=True))
        for field, value in _numbers_of(force)
    }


def _numbers_of(force: Force) -> Iterator[tuple[str, Floats]]:
    """Yield the numbers of a force, and those of a law in it, such as ``law.damping``."""
    for field, given in (force.parameters() if is_dataclass(type(force)) else {}).items():
        if isinstance(given, Force):
            yield from ((f"{field}.{inner}", value) for inner, value in _numbers_of(given))
        elif field in force.named_values:
            yield from ((f"{field}.{name}", np.asarray(value, dtype=np.float64)) for name, value in given)
        elif field not in force.selectors and (value := real_numbers(given)) is not None:
            yield field, value


def with_force_values(system: System, plain: Any, values: Mapping[str, Floats]) -> System:
    """Return another Hamiltonian part with the same forces, of which these parameters have other values."""
    forces, known = list(system.forces), force_numbers(system)
    for name, value in values.items():
        position: Any = known[name].position
        forces[position] = with_value(forces[position], known[name].field, value)
    return plain._with_acting(forces)


def real_numbers(given: Any) -> Floats | None:
    """Return real numbers, not whole ones by type, as an array; None for anything else."""
    try:
        array = np.asarray(given)
    except ValueError:
        return None
    return array.astype(np.float64) if array.dtype.kind == "f" and array.size else None


def check_may_change(system: System, name: str) -> None:
    """Raise ValueError for a value that cannot change in both directions, such as zero, where roots have no slope."""
    one = force_numbers(system)[name]
    if not _may_change(one, system):
        raise ValueError(
            f"{name} cannot be differentiated at {short(one.value.tolist())}: the force accepts no values on both sides"
        )


def _may_change(one: Parameter, system: System) -> bool:
    """Return whether the force is defined at the nodes of some differences that are farthest from the value."""
    position: Any = one.position
    force, farthest = system.forces[position], NODES[-1] * DISTANCE * RADIUS * sizes_of_entries(one.value)
    for scale in NEARER ** np.arange(MOST_DISTANCES):
        try:
            for index in islice(np.ndindex(one.value.shape), MAX_TRIED):
                for by in (scale * farthest[index], -scale * farthest[index]):
                    moved = moved_entry(one.value, index, float(by), one.symmetric)
                    with_value(force, one.field, moved).check(system.unforced)
        except (TypeError, ValueError):
            continue
        return True
    return False


# Largest dimension of a matrix M with all entries as parameters; of larger ones those that are stored.
MAX_DENSE_DIMENSION = 128


# Systems are immutable.
_PARAMETERS: WeakKeyDictionary[Any, dict[str, Parameter]] = WeakKeyDictionary()


def parameters_of(system: Any) -> Mapping[str, Parameter]:
    """Return the parameters of a system by name; none for Hamiltonians that are functions of the user."""
    # Those of a ready-made system are those of the energy that it declares. Otherwise they are `M` and `linear` of a
    # `Quadratic`, and `coefficients` of a polynomial. Those of forces follow, each after its label.
    if system not in _PARAMETERS:
        _PARAMETERS[system] = _find_parameters(system)
    return _PARAMETERS[system]


def parameters_at(system: Any, values: Mapping[str, Floats]) -> dict[str, Parameter]:
    """Return the parameters in `values` of the system that `with_parameters` returns, also if they are zero."""
    found = _find_parameters(system, values)
    return {name: found[name] for name in values}


def _find_parameters(system: Any, values: Mapping[str, Floats] | None = None) -> dict[str, Parameter]:
    """Return the parameters of a system, or those with other values, which are some of them."""
    given = values or {}
    if system.forces:
        numbers = force_numbers(system)
        if values is None:
            numbers = {name: one for name, one in numbers.items() if _may_change(one, system)}
        rest = {name: value for name, value in given.items() if name not in numbers}
        plain = _find_parameters(system.unforced, rest) if rest else parameters_of(system.unforced)
        return {**plain, **_with_values(numbers, given)}
    if system.has_matrices:
        return _of_matrix_builder(system, given)
    if not system.hamiltonian.terms():
        return {}
    own = _with_values(_of_constants(system), given)
    rest = {name: value for name, value in given.items() if name not in own}
    declared = _declaration(system, rest) if rest or not given else None
    if declared is not None:
        return _of_declared(declared, {**system.parameters, **rest}) | own
    found = _with_values(_of_hamiltonian(system.hamiltonian, system.dim), rest) | own
    return {name: one for name, one in found.items() if name != "coefficients" or not own}


def _of_constants(system: Any) -> dict[str, Parameter]:
    """Return the constants of a system by name."""

    def derivative(coefficients: Callable[[], EnergyCoefficients]) -> EnergyDerivative:
        found = coefficients()
        return EnergyDerivative.of_coefficients(1, [(np.zeros(found.monomials.size, dtype=np.int64), found)])

    constants = system._constants or {}
    return {name: _linear(np.array(value), partial(derivative, one)) for name, (value, one) in constants.items()}


def _with_values(parameters: Mapping[str, Parameter], values: Mapping[str, Floats]) -> dict[str, Parameter]:
    return {name: one._replace(value=values.get(name, one.value)) for name, one in parameters.items()}


def _of_hamiltonian(H: Any, n: int) -> dict[str, Parameter]:
    if isinstance(H, Quadratic):
        return _of_quadratic(H, n)
    if isinstance(H, PolynomialHamiltonian):
        monomials = list(H.polynomial.monomials.items())
        derivative = [
            DerivativeMonomial(coordinates_of(exponents), k, 1.0) for k, (exponents, _) in enumerate(monomials)
        ]
        value = np.array([float(coefficient) for _, coefficient in monomials])
        return {"coefficients": _linear(value, lambda: EnergyDerivative.of_monomials(len(derivative), derivative))}
    if _is_form_and_polynomial(H):
        form, polynomial = H.summands
        return _of_hamiltonian(form, n) | _of_hamiltonian(polynomial, n)
    return {}


def _is_form_and_polynomial(H: Any) -> bool:
    kinds = [type(one) for one in getattr(H, "summands", ())]
    return kinds == [Quadratic, SeparatePolynomial]


def _linear(value: Floats, energy: Callable[[], EnergyDerivative], symmetric: bool = False) -> Parameter:
    """Return a parameter on which the energy depends linearly, or not at all."""
    return Parameter(value, cache(energy), symmetric)


def parameter_of(system: Any, name: str) -> Parameter:
    """Return the parameter of this name; raise ValueError for another one, with those there are."""
    found = parameters_of(system)
    if name not in found:
        raise unknown_name(f"parameter of {system.name}", name, found)
    return found[name]


def with_parameters(system: Any, values: Mapping[str, Floats]) -> Any:
    """Return the system with these values of its parameters, those of `parameters_of`, in their shapes."""
    if system.forces:
        of_forces = {name: value for name, value in values.items() if name in force_numbers(system)}
        rest = {name: value for name, value in values.items() if name not in of_forces}
        return with_force_values(system, with_parameters(system.unforced, rest) if rest else system.unforced, of_forces)
    constants = {name: float(value) for name, value in values.items() if name in (system._constants or {})}
    if constants:
        original, system = system, system._with_constants(constants)
        values = {name: value for name, value in values.items() if name not in constants}
        if not values:
            return system
        known, changed = parameters_of(original), parameters_of(system)
        for name in values:
            if name == "M" or not np.array_equal(known[name].value, changed[name].value):
                raise ValueError(f"{name} is given with {', '.join(constants)}, which it contains; give values of one")
    builder = _builder_of(system, values)
    if builder is not None:
        found = builder(**{**system.parameters, **{name: _plain(value) for name, value in values.items()}})
        return found.in_numbers if system.has_matrices and system.shape == (system.dim,) else found
    return with_hamiltonian(
        system, in_coordinates_of(system, _with_coefficients(system.hamiltonian, system.dim, values))
    )


def with_entry_moved(system: Any, name: str, parameter: Parameter, index: tuple[int, ...], by: float) -> Any:
    """Return the system with one entry of a parameter moved."""
    return with_parameters(system, {name: moved_entry(parameter.value, index, by, parameter.symmetric)})


def _builder_of(system: Any, names: Iterable[str]) -> Callable[..., Any] | None:
    """Return the function that makes a ready-made system with these parameters; None for those of a Hamiltonian."""
    builder = ready_made_systems().get(system.name)
    return builder if builder is not None and set(names) <= set(system.parameters or {}) else None


def _with_coefficients(H: Any, n: int, values: Mapping[str, Floats]) -> HamiltonianLike:
    """Return a Hamiltonian with other values of the parameters of `_of_hamiltonian`."""
    if _is_form_and_polynomial(H):
        form, polynomial = H.summands
        if values.keys() - {"coefficients"}:
            form = _with_coefficients(form, n, values)
        if "coefficients" in values:
            polynomial = _with_coefficients(polynomial, n, values)
        return SumOfHamiltonians([form, polynomial])
    if isinstance(H, PolynomialHamiltonian):
        coefficients = dict(zip(H.polynomial.monomials, values["coefficients"].tolist(), strict=True))
        moved = Polynomial(coefficients, dim=n)
        return SeparatePolynomial(moved) if isinstance(H, SeparatePolynomial) else as_hamiltonian(moved, n)
    stored = H.bind(n).as_given()
    linear = values.get("linear", stored.linear)
    if "M" not in values:
        return H.bind(n).with_linear(linear)
    M = values["M"]
    if M.ndim == 1 and not np.array_equal(stored.rows, stored.columns):
        import scipy.sparse

        entries = scipy.sparse.csr_array((M, (stored.rows, stored.columns)), shape=(n, n))
        return Quadratic(0.5 * (entries + entries.T), linear, H.constant)
    return Quadratic(M if M.ndim == 1 else 0.5 * (M + M.T), linear, H.constant)


def _of_quadratic(H: Quadratic, n: int) -> dict[str, Parameter]:
    entries = H.bind(n).as_given()
    rows, columns = entries.rows, entries.columns
    values = np.asarray(entries.entries, dtype=np.float64)
    if np.array_equal(rows, columns):
        value = np.zeros(n)
        value[rows] = values
        i, j = np.arange(n), np.arange(n)
    elif n <= MAX_DENSE_DIMENSION:
        value = np.zeros((n, n))
        value[rows, columns] = values
        i, j = (index.ravel() for index in np.indices((n, n)))
    else:
        value, i, j = values, rows, columns

    def by_matrix() -> EnergyDerivative:
        return EnergyDerivative.of_monomials(len(i))._replace(
            quadratic=np.stack([i, j], axis=1), quadratic_entry=np.arange(len(i)), quadratic_factor=np.full(len(i), 0.5)
        )

    def by_linear() -> EnergyDerivative:
        return EnergyDerivative.of_monomials(n)._replace(
            linear=np.arange(n), linear_entry=np.arange(n), linear_factor=np.ones(n)
        )

    return {
        "M": _linear(value, by_matrix, value.ndim == 2),
        "linear": _linear(np.asarray(entries.linear, dtype=np.float64), by_linear),
    }


def _declaration(system: Any, values: Mapping[str, Floats]) -> DeclaredEnergy | None:
    """Return the declared energy of a ready-made system; None if not that of the system or of these values."""
    declared, arguments = energy_of(system.name), system.parameters or {}
    if declared is None or not arguments:
        return None
    if values:
        return declared if set(values) <= set(declared.parameters) else None
    problem = _contradiction(declared, arguments, system)
    # A system of the user may have the name of a ready-made one, and arguments as a note.
    if problem and _is_made_by_builder(system):
        raise TypeError(f"the energy that {system.name} declares {problem}")
    return declared if problem is None else None


def _is_made_by_builder(system: Any) -> bool:
    """Return whether a system has the energy of the ready-made one of its name and parameters."""
    try:
        made = coefficients_of(ready_made_systems()[system.name](**system.parameters))
    except (ArithmeticError, LookupError, TypeError, ValueError):
        return False
    return made.without_zeros().equal(coefficients_of(system).without_zeros())


def _declared_coefficients(declared: DeclaredEnergy, arguments: Mapping[str, Any]) -> EnergyCoefficients:
    return coefficients_in(declared.function(**declared.chosen(arguments)))


def _contradiction(declared: DeclaredEnergy, arguments: Mapping[str, Any], system: Any) -> str | None:
    """Return how it differs from the energy of a system; None if it fits, no text if it cannot be evaluated."""
    missing = [name for name in (*declared.parameters, *declared.others) if name not in arguments]
    if missing:
        return f"is a function of {missing[0]}, which its parameters do not have: {', '.join(arguments)}"
    try:
        numbers = {name: np.asarray(arguments[name], dtype=np.float64) for name in declared.parameters}
    except (TypeError, ValueError):
        return ""
    found, x = None, sample_points(system.dim)[0]

    def value_at(step: complex) -> Any:
        moved = {name: value + step * _direction(value) for name, value in numbers.items()}
        return _declared_coefficients(declared, {**arguments, **moved}).at(x)

    try:
        found = _declared_coefficients(declared, {**arguments, **numbers}).without_zeros()
        own = coefficients_of(system).without_zeros()
        if not found.equal(own):
            return _difference(found.by_key(), own.by_key())
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")  # of imaginary parts that are dropped
            exact = value_at(TINY_STEP * 1j).imag / TINY_STEP
            near, nearer = ((value_at(step) - value_at(-step)) / (2.0 * step) for step in SMALL_STEPS)
    except ValueError:  # parameters that are tied to each other
        return "" if found is None else None
    except (ArithmeticError, LookupError, TypeError) as reason:
        return f"fails: {in_one_line(str(reason), 200)}"
    size = found._replace(values=np.abs(found.values)).at(np.abs(x))
    # Where differences do not agree, as near poles, they tell nothing.
    allowed = AGREEMENT * abs(nearer) + 2.0**-28 * size
    if abs(near - nearer) <= allowed < abs(exact - nearer):
        return f"is not analytic: it changes by {nearer:.6g} with its parameters, and by {exact:.6g} in complex steps"
    return None


def _difference(declared: Mapping[Key, float], own: Mapping[Key, float]) -> str:
    """Return as text in which coefficient energies differ."""
    key = min((k for k in {**declared, **own} if declared.get(k) != own.get(k)), key=lambda k: (len(k), k))
    declares, has = distinct(declared.get(key, 0.0), own.get(key, 0.0))
    return f"has the coefficient {declares} of {'*'.join(f'x{k + 1}' for k in key) or 1}, and its H has {has}"


def _direction(value: Floats) -> Floats:
    """Return a change of a parameter, symmetric for matrices, and zero where the value is."""
    change = value * np.cos(1.0 + np.arange(value.size)).reshape(value.shape)
    return change + change.swapaxes(-1, -2) if value.ndim > 1 and value.shape[-1] == value.shape[-2] else change


def _of_declared(declared: DeclaredEnergy, arguments: Mapping[str, Any]) -> dict[str, Parameter]:
    """Return the parameters of a declared energy at arguments of its builder."""
    numbers = {name: np.asarray(arguments[name], dtype=np.float64) for name in declared.parameters}

    def coefficients_at(name: str, value: NDArray[np.complex128]) -> EnergyCoefficients:
        return _declared_coefficients(declared, {**arguments, **numbers, name: value})

    def parameter(name: str, value: Floats) -> Parameter:
        symmetric = name in declared.symmetric and value.ndim == 2

        def energy() -> EnergyDerivative:
            polynomial = derivative_by_steps(partial(coefficients_at, name), value, symmetric)
            potential = declared.potential
            if potential is None:
                return polynomial

            def function_at(moved: NDArray[np.complex128]) -> FunctionOfConstants:
                return potential(**declared.chosen({**arguments, **numbers, name: moved}))

            return polynomial._replace(functions=functions_by_steps(function_at, value))

        return Parameter(value, cache(energy), symmetric)

    # The entries of several symmetric matrices are tied to each other.
    tied = {name for name in declared.symmetric if numbers[name].ndim > 2}
    return {name: parameter(name, value) for name, value in numbers.items() if value.size and name not in tied}


def _of_matrix_builder(system: Any, values: Mapping[str, Floats]) -> dict[str, Parameter]:
    """Return the real numbers among the arguments of a system of matrices, on which only the energy depends."""
    builder = ready_made_systems().get(system.name)
    if builder is None or not system.parameters:
        return {}
    arguments = {**system.parameters, **values}

    def parameter(name: str, value: Floats) -> Parameter:
        def moved(index: tuple[int, ...], by: float) -> Any:
            return builder(**{**arguments, name: _plain(moved_entry(value, index, by, False))})

        return Parameter(value, cache(cast(Any, partial(EnergyDifferences, name, value, moved))))

    def is_fixed(name: str, value: Floats) -> bool:
        """Return whether values on one side of zero are refused, or of rows, which begin with numbers of modes."""
        try:
            for by in (-DISTANCE, DISTANCE) if (value.ndim == 2 or not value.any()) and name not in values else ():
                builder(**{**arguments, name: _plain(moved_entry(value, (0,) * value.ndim, by, False))})
        except ValueError:
            return True
        return False

    names = arguments if system.energy_parameters is None else system.energy_parameters
    found = {name: real_numbers(arguments[name]) for name in names}
    return {
        name: parameter(name, value) for name, value in found.items() if value is not None and not is_fixed(name, value)
    }


def _plain(value: Floats) -> Any:
    return value if value.ndim else float(value)


def values_of_member(values: Mapping[str, Floats] | None, member: int) -> dict[str, Floats] | None:
    """Return the values of a member of a batch; None without values."""
    return None if values is None else {name: np.array(value[member]) for name, value in values.items()}


def with_parameters_of_members(system: Any, values: Mapping[str, Floats]) -> Any:
    """Return the system, or the batch, with these values of its parameters, those of `parameters_of_members`."""
    if not system.is_batch:
        return with_parameters(system, values)
    changed = [with_parameters(one, values_of_member(values, m) or {}) for m, one in enumerate(system)]
    return Batch(changed, system.axes, system.combined)


def parameters_of_members(system: Any, values: Mapping[str, Floats] | None = None) -> Mapping[str, Parameter]:
    """Return the parameters of a system; of a batch those of all members, with an axis of members.

    With `values` they are those of `parameters_at`.
    """
    if not system.is_batch:
        return parameters_of(system) if values is None else parameters_at(system, values)
    members = [parameters_of_members(one, values_of_member(values, m)) for m, one in enumerate(system)]
    found = {}
    for name, first in members[0].items():
        if all(name in one and one[name].value.shape == first.value.shape for one in members):
            found[name] = first._replace(value=np.stack([one[name].value for one in members]))
    return found


def unknown_parameter(system: Any, kind: str, name: Any, known: Iterable[str]) -> ValueError:
    """Return the ValueError for an unknown parameter, with the reason if it is one of some members only."""
    for m, one in enumerate(system) if system.is_batch else [(None, system)]:
        numbers = force_numbers(one)
        if name not in numbers:
            continue
        where, value = "" if m is None else f" of member {m}", short(numbers[name].value.tolist())
        if not _may_change(numbers[name], one):
            return ValueError(
                f"{name}{where} is {value}, at the limit of its domain: no run can be differentiated by it"
            )
        first = force_numbers(system[0]).get(name) if system.is_batch else None
        if m and (first is None or first.value.shape != numbers[name].value.shape):
            return ValueError(
                f"{name}{where} has another shape than that of member 0, and is no parameter; give equal shapes"
            )
    return unknown_name(kind, name, known)

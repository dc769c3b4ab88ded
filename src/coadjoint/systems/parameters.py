"""Parameters by which a run can be differentiated: those of ready-made systems, and coefficients of Hamiltonians."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Mapping
from functools import cache, partial
from itertools import islice
from typing import Any, NamedTuple, cast
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.errors import unknown_name
from coadjoint.short_repr import short
from coadjoint.systems.coefficient_derivatives import RADIUS, SMALL_ENTRY, derivatives_by_entries, largest_entry
from coadjoint.systems.coefficients import Coefficients, coefficients_of, coordinates_of
from coadjoint.systems.coordinates import in_coordinates_of
from coadjoint.systems.energy_derivatives import EnergyDerivative, Monomial
from coadjoint.systems.force_parameters import force_parameters, with_force_values
from coadjoint.systems.forced import ForcedSystem
from coadjoint.systems.hamiltonians.hamiltonian import HamiltonianLike, PolynomialHamiltonian, as_hamiltonian
from coadjoint.systems.hamiltonians.linear_term import with_hamiltonian
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.hamiltonians.terms import FunctionTerm
from coadjoint.systems.parameter_differences import EnergyDifferences
from coadjoint.systems.protocol import is_matrix_system
from coadjoint.systems.registry import ready_made_systems

Floats = NDArray[np.float64]

# Entries of which it is tried whether they may change alone.
MAX_TRIED = 16
# Largest dimension of a matrix M with all entries as parameters; of larger ones those that are stored.
MAX_DENSE_DIMENSION = 128
SEED = 1993
# Largest difference of derivatives by an entry and its mirror image, relative to them, of a symmetric matrix.
ASYMMETRY = 1e-6


class Parameter(NamedTuple):
    """Value of a parameter, and functions of no argument for its derivatives.

    `energy` returns the derivative of the energy by the entries, and `radii` by how much each of these may change so
    that the energy remains an analytic function without near poles.
    """

    value: Floats
    energy: Callable[[], EnergyDerivative]
    radii: Callable[[], Floats]


# Systems are immutable, and finding their parameters takes many calls of the functions that make them.
_PARAMETERS: WeakKeyDictionary[Any, dict[str, Parameter]] = WeakKeyDictionary()


def parameters_of(system: Any) -> Mapping[str, Parameter]:
    """Return the parameters of a system by name; none for Hamiltonians that are functions of the user.

    Those of a ready-made system are its arguments that enter coefficients of its Hamiltonian. Otherwise they are `M`
    and `linear` of a `Quadratic`, and `coefficients` of a polynomial. Those of forces follow, each after its label.
    """
    if system not in _PARAMETERS:
        _PARAMETERS[system] = _find_parameters(system)
    return _PARAMETERS[system]


def _find_parameters(system: Any) -> dict[str, Parameter]:
    if isinstance(system, ForcedSystem):
        return {**parameters_of(system.system), **_of_forces(system)}
    if is_matrix_system(system):
        builder = ready_made_systems().get(system.name)
        return {} if builder is None or not system.parameters else _of_matrix_builder(system, builder)
    if not getattr(system, "hamiltonian", None) or not system.hamiltonian.terms():
        return {}
    if system.parameters and (builder := ready_made_systems().get(system.name)) is not None:
        found = _of_builder(system, builder)
        if found:
            return found
    return _of_hamiltonian(system)


def _of_forces(system: ForcedSystem) -> dict[str, Parameter]:
    def parameter(value: Floats, radii: Floats) -> Parameter:
        return Parameter(value, lambda: EnergyDerivative.of_monomials(value.size), lambda: radii)

    return {name: parameter(one.value, one.radii) for name, one in force_parameters(system).items()}


def _of_hamiltonian(system: Any) -> dict[str, Parameter]:
    H = system.hamiltonian
    if isinstance(H, Quadratic):
        return _of_quadratic(H, system.dim)
    if isinstance(H, PolynomialHamiltonian):
        monomials = list(H.polynomial.monomials.items())
        derivative = [Monomial(coordinates_of(exponents), k, 1.0) for k, (exponents, _) in enumerate(monomials)]
        value = np.array([float(coefficient) for _, coefficient in monomials])
        return {"coefficients": _linear(value, lambda: EnergyDerivative.of_monomials(len(derivative), derivative))}
    return {}


def is_symmetric_parameter(system: Any, name: str) -> bool:
    """Return whether a parameter is a symmetric matrix that enters the energy by its symmetric part only."""
    parameter = parameter_of(system, name)
    value = parameter.value
    if value.ndim != 2 or len(value) < 2 or not np.array_equal(value, value.T):
        return False
    if isinstance(system, ForcedSystem) and name in (of_forces := force_parameters(system)):
        return of_forces[name].symmetric
    by_entry = parameter.energy().at(np.random.default_rng(SEED).standard_normal((4, system.dim)))
    by_entry = by_entry.reshape(-1, *value.shape)
    asymmetry = np.abs(by_entry - by_entry.swapaxes(1, 2)).max()
    return bool(asymmetry <= ASYMMETRY * np.abs(by_entry).max())


def _linear(value: Floats, energy: Callable[[], EnergyDerivative]) -> Parameter:
    """Return a parameter on which the energy depends linearly."""
    return Parameter(value, cache(energy), lambda: np.full(value.shape, RADIUS * largest_entry(value)))


def parameter_of(system: Any, name: str) -> Parameter:
    """Return the parameter of this name; raise ValueError for another one, with those there are."""
    found = parameters_of(system)
    if name not in found:
        raise unknown_name(f"parameter of {system.name}", name, found)
    return found[name]


def with_parameters(system: Any, values: Mapping[str, Floats]) -> Any:
    """Return the system with these values of its parameters, those of `parameters_of`, in their shapes.

    M counts with its symmetric part, as in the energy. Raises the errors of the builder or the Hamiltonian for values
    that these refuse.
    """
    if isinstance(system, ForcedSystem):
        of_forces = {name: value for name, value in values.items() if name in force_parameters(system)}
        rest = {name: value for name, value in values.items() if name not in of_forces}
        return with_force_values(system, with_parameters(system.system, rest) if rest else system.system, of_forces)
    builder = _builder_of(system, values)
    if builder is not None:
        found = builder(**{**system.parameters, **{name: _plain(value) for name, value in values.items()}})
        return found.in_numbers if is_matrix_system(system) and system.shape == (system.dim,) else found
    return with_hamiltonian(system, in_coordinates_of(system, _with_coefficients(system, values)))


def parameters_at(system: Any, values: Mapping[str, Floats]) -> dict[str, Parameter]:
    """Return the parameters in `values` of the system that `with_parameters` returns.

    They have the shapes of `values` also where coefficients of that system are zero.
    """
    if isinstance(system, ForcedSystem):
        known = force_parameters(system)
        of_forces = _of_forces(with_parameters(system, values))
        moved = {name: of_forces.get(name) or _at_limit(name, values[name]) for name in values if name in known}
        return moved | parameters_at(
            system.system, {name: value for name, value in values.items() if name not in known}
        )
    builder = _builder_of(system, values)
    if builder is None or is_matrix_system(system):
        found = parameters_of(with_parameters(system, values)) if is_matrix_system(system) else _of_hamiltonian(system)
        return (
            {name: found[name]._replace(value=value) for name, value in values.items()}
            if is_matrix_system(system)
            else {name: _linear(value, found[name].energy) for name, value in values.items()}
        )
    arguments = {**system.parameters, **{name: _plain(value) for name, value in values.items()}}
    return {
        name: _argument(builder, arguments, name, value, _is_symmetric(builder, arguments, name, value))
        for name, value in values.items()
    }


def _at_limit(name: str, value: Floats) -> Parameter:
    """Return a parameter of a force at a value that cannot change in both directions, such as zero."""

    def radii() -> Floats:
        raise ValueError(
            f"{name} cannot be differentiated at {short(_plain(value))}: the force accepts no values on both sides"
        )

    return Parameter(value, lambda: EnergyDerivative.of_monomials(value.size), radii)


def with_entry_moved(system: Any, name: str, value: Floats, index: tuple[int, ...], by: float) -> Any:
    """Return the system with one entry of a parameter moved; half its mirror image if the matrix must be symmetric."""
    if isinstance(system, ForcedSystem):
        found = force_parameters(system).get(name)
        if found is None:
            return ForcedSystem(with_entry_moved(system.system, name, value, index, by), system.forces)
        forces = list(system.forces)
        forces[found.position] = found.moved(forces[found.position], value, index, by)
        return ForcedSystem(system.system, forces)
    builder = _builder_of(system, [name])
    symmetric = builder is not None and _is_symmetric(builder, dict(system.parameters), name, value)
    return with_parameters(system, {name: np.asarray(_moved(value, index, by, symmetric))})


def _builder_of(system: Any, names: Iterable[str]) -> Callable[..., Any] | None:
    """Return the function that makes a ready-made system with these parameters; None for those of a Hamiltonian."""
    builder = ready_made_systems().get(system.name)
    return builder if builder is not None and set(names) <= set(system.parameters or {}) else None


def _with_coefficients(system: Any, values: Mapping[str, Floats]) -> HamiltonianLike:
    """Return the Hamiltonian of a system with other values of the parameters of `_of_hamiltonian`."""
    H, n = system.hamiltonian, system.dim
    if isinstance(H, PolynomialHamiltonian):
        coefficients = dict(zip(H.polynomial.monomials, values["coefficients"].tolist(), strict=True))
        return as_hamiltonian(Polynomial(coefficients, dim=n), n)
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
        "M": _linear(value, by_matrix),
        "linear": _linear(np.asarray(entries.linear, dtype=np.float64), by_linear),
    }


def _of_builder(system: Any, builder: Callable[..., Any]) -> dict[str, Parameter] | None:
    """Return the parameters that enter only coefficients of H; None if the arguments do not give the system."""
    arguments = dict(system.parameters)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            if not coefficients_of(builder(**arguments)).equal(coefficients_of(system)):
                return None
        except (TypeError, ValueError):
            return None
        found = {}
        for name, given in arguments.items():
            value = _numbers(given)
            if value is None:
                continue
            symmetric = _is_symmetric(builder, arguments, name, value)
            if _enters_coefficients(system, builder, arguments, name, value, symmetric):
                found[name] = _argument(builder, arguments, name, value, symmetric)
    return found


def _of_matrix_builder(system: Any, builder: Callable[..., Any]) -> dict[str, Parameter]:
    """Return the parameters that enter only the energy of a system of matrices, by differences."""
    arguments, found = dict(system.parameters), {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name, given in arguments.items():
            value = _numbers(given)
            if value is None:
                continue
            symmetric = _is_symmetric(builder, arguments, name, value)

            def moved(
                index: tuple[int, ...], by: float, name: str = name, value: Floats = value, symmetric: bool = symmetric
            ) -> Any:
                return builder(**{**arguments, name: _moved(value, index, by, symmetric)})

            try:
                other = builder(**{**arguments, name: _changed(value, 1.0 + 2.0**-10)})
                for index in islice(np.ndindex(value.shape), MAX_TRIED):
                    moved(index, 2.0**-20 * largest_entry(value))
            except (TypeError, ValueError):
                continue
            if (other.algebra, other.energy_sign) == (system.algebra, system.energy_sign):
                largest = largest_entry(value)
                radii = RADIUS * np.where(np.abs(value) > SMALL_ENTRY * largest, np.abs(value), largest)
                energy = partial(cast(Any, EnergyDifferences), radii, moved)
                found[name] = Parameter(value, energy, partial(np.copy, radii))
    return found


def _numbers(value: Any) -> Floats | None:
    """Return real numbers as an array, None for anything else."""
    if isinstance(value, bool | str) or value is None:
        return None
    try:
        numbers = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        return None
    return numbers if numbers.size else None


def _is_symmetric(builder: Callable[..., Any], arguments: dict[str, Any], name: str, value: Floats) -> bool:
    """Test whether a parameter is a matrix that must be symmetric."""
    if value.ndim != 2 or len(value) < 2 or not np.array_equal(value, value.T):
        return False
    try:
        builder(**{**arguments, name: _moved(value, (0, 1), 2.0**-20 * largest_entry(value), False)})
    except (TypeError, ValueError):
        return True
    return False


def _enters_coefficients(
    system: Any, builder: Callable[..., Any], arguments: dict[str, Any], name: str, value: Floats, symmetric: bool
) -> bool:
    """Test whether a parameter may be a real number, and changes neither the algebra nor a function."""
    try:
        other = builder(**{**arguments, name: _changed(value, 1.0 + 2.0**-10)})
        for index in islice(np.ndindex(value.shape), MAX_TRIED):
            # Entries may be tied to each other.
            builder(**{**arguments, name: _moved(value, index, 2.0**-20 * largest_entry(value), symmetric)})
    except (TypeError, ValueError):
        return False
    if other.dim != system.dim or other.sign != system.sign:
        return False
    x = np.random.default_rng(SEED).standard_normal(system.dim)
    same = (
        np.array_equal(other.structure_matrix(x), system.structure_matrix(x))
        if system.algebra is None
        else other.algebra == system.algebra
    )
    if not same:
        return False
    functions = [
        [term for term in one.hamiltonian.terms() if isinstance(term, FunctionTerm)] for one in (system, other)
    ]
    if len(functions[0]) != len(functions[1]):
        return False
    return all(
        np.array_equal(first.coordinates, second.coordinates) and np.array_equal(_value(first, x), _value(second, x))
        for first, second in zip(*functions, strict=True)
    )


def _value(term: FunctionTerm, x: Floats) -> Any:
    y = x[term.coordinates]
    return np.asarray(term.gradient(y[0] if term.scalar else y, *((0.0,) if term.timed else ())))


def _changed(value: Floats, factor: float) -> Any:
    return _plain(np.where(value == 0.0, factor - 1.0, factor * value))


def _plain(value: Floats) -> Any:
    return value if value.ndim else float(value)


def _moved(value: Floats, index: tuple[int, ...], by: float, symmetric: bool) -> Any:
    """Add to an entry; if the matrix must be symmetric half to it and half to its mirror image."""
    moved = value.copy()
    if symmetric and index[0] != index[1]:
        moved[index] += 0.5 * by
        moved[index[::-1]] = moved[index]
    else:
        moved[index] += by
    return _plain(moved)


def _argument(
    builder: Callable[..., Any], arguments: dict[str, Any], name: str, value: Floats, symmetric: bool
) -> Parameter:
    """Return the parameter of an argument of a function that makes systems."""

    def coefficients_at(shifts: Floats) -> Coefficients:
        moved = value + (0.5 * (shifts + shifts.T) if symmetric else shifts)
        return coefficients_of(builder(**{**arguments, name: _plain(moved)}))

    @cache
    def found() -> tuple[EnergyDerivative, Floats]:
        energy, radii = derivatives_by_entries(coefficients_at, value)
        refused = value[np.isnan(radii)]
        if refused.size:
            raise ValueError(
                f"{name} cannot be differentiated: {builder.__name__} accepts no values near "
                f"{refused[0]:g}; build the system from its own Quadratic, and differentiate by M"
            )
        return energy, radii

    return Parameter(value, lambda: found()[0], lambda: found()[1])

"""Parameters by which a run can be differentiated: those of ready-made systems, and coefficients of Hamiltonians."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.polynomials.monomials import factors_of
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.errors import unknown_name
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.systems.coordinates import in_coordinates_of
from coadjoint.systems.energy_derivatives import EnergyDerivative, Monomial
from coadjoint.systems.hamiltonians.hamiltonian import HamiltonianLike, PolynomialHamiltonian, as_hamiltonian
from coadjoint.systems.hamiltonians.linear_term import with_hamiltonian
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.hamiltonians.terms import FunctionTerm, PolynomialTerm
from coadjoint.systems.registry import ready_made_systems

Floats = NDArray[np.float64]
Coefficients = dict[tuple[int, ...], float]

# Nodes of the interpolation by which coefficients are differentiated, and its first radius relative to the parameter.
# The nearest pole of a reciprocal is at four radii: the truncation is 7.9^-20, and rounding is amplified by 80.
NODES = 20
RADIUS = 0.25
# Entries of which it is tried whether they may change alone.
MAX_TRIED = 16
# Smaller radii are tried where the builder refuses values, or a pole is near.
MAX_REDUCTIONS = 6
# Changes of the coefficients below this multiple of their rounding are zero.
ZERO_DERIVATIVE = 256 * UNIT_ROUNDOFF
# Largest dimension of a matrix M with all entries as parameters; of larger ones those that are stored.
MAX_DENSE_DIMENSION = 128
SEED = 1993


class Parameter(NamedTuple):
    """Value of a parameter, and a function that returns the derivative of the energy by its entries."""

    value: Floats
    energy: Callable[[], EnergyDerivative]


def parameters_of(system: Any) -> dict[str, Parameter]:
    """Return the parameters of a system by name; none for Hamiltonians that are functions of the user.

    Those of a ready-made system are its arguments that enter coefficients of its Hamiltonian. Otherwise they are `M`
    and `linear` of a `Quadratic`, and `coefficients` of a polynomial.
    """
    if not getattr(system, "hamiltonian", None) or not system.hamiltonian.terms():
        return {}
    if system.parameters and (builder := ready_made_systems().get(system.name)) is not None:
        found = _of_builder(system, builder)
        if found:
            return found
    return _of_hamiltonian(system)


def _of_hamiltonian(system: Any) -> dict[str, Parameter]:
    H = system.hamiltonian
    if isinstance(H, Quadratic):
        return _of_quadratic(H, system.dim)
    if isinstance(H, PolynomialHamiltonian):
        monomials = list(H.polynomial.monomials.items())
        derivative = [Monomial(_coordinates(exponents), k, 1.0) for k, (exponents, _) in enumerate(monomials)]
        value = np.array([float(coefficient) for _, coefficient in monomials])
        return {"coefficients": Parameter(value, lambda: EnergyDerivative.of_monomials(len(derivative), derivative))}
    return {}


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
    builder = _builder_of(system, values)
    if builder is not None:
        return builder(**{**system.parameters, **{name: _plain(value) for name, value in values.items()}})
    return with_hamiltonian(system, in_coordinates_of(system, _with_coefficients(system, values)))


def parameters_at(system: Any, values: Mapping[str, Floats]) -> dict[str, Parameter]:
    """Return the parameters in `values` of the system that `with_parameters` returns.

    They have the shapes of `values` also where coefficients of that system are zero.
    """
    builder = _builder_of(system, values)
    if builder is None:
        found = _of_hamiltonian(system)
        return {name: found[name]._replace(value=value) for name, value in values.items()}
    arguments = {**system.parameters, **{name: _plain(value) for name, value in values.items()}}
    return {
        name: Parameter(
            value,
            _derivative(builder, arguments, name, value, _is_symmetric(builder, arguments, name, value)),
        )
        for name, value in values.items()
    }


def with_entry_moved(system: Any, name: str, value: Floats, index: tuple[int, ...], by: float) -> Any:
    """Return the system with one entry of a parameter moved; half its mirror image if the matrix must be symmetric."""
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


def _coordinates(exponents: tuple[int, ...]) -> tuple[int, ...]:
    """Return the coordinates of a monomial, each as often as its exponent."""
    return tuple(factors_of(exponents))


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
        "M": Parameter(value, by_matrix),
        "linear": Parameter(np.asarray(entries.linear, dtype=np.float64), by_linear),
    }


def _of_builder(system: Any, builder: Callable[..., Any]) -> dict[str, Parameter] | None:
    """Return the parameters that enter only coefficients of H; None if the arguments do not give the system."""
    arguments = dict(system.parameters)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            if coefficients_of(builder(**arguments)) != coefficients_of(system):
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
                found[name] = Parameter(value, _derivative(builder, arguments, name, value, symmetric))
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
        builder(**{**arguments, name: _moved(value, (0, 1), 2.0**-20 * _size(value, (0, 1)), False)})
    except (TypeError, ValueError):
        return True
    return False


def _enters_coefficients(
    system: Any, builder: Callable[..., Any], arguments: dict[str, Any], name: str, value: Floats, symmetric: bool
) -> bool:
    """Test whether a parameter may be a real number, and changes neither the algebra nor a function."""
    try:
        other = builder(**{**arguments, name: _changed(value, 1.0 + 2.0**-10)})
        for index in list(np.ndindex(value.shape))[:MAX_TRIED]:
            # Entries may be tied to each other.
            builder(**{**arguments, name: _moved(value, index, 2.0**-20 * _size(value, index), symmetric)})
    except (TypeError, ValueError):
        return False
    if other.dim != system.dim or other.sign != system.sign:
        return False
    x = np.random.default_rng(SEED).standard_normal(system.dim)
    if not np.array_equal(other.structure_matrix(x), system.structure_matrix(x)):
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


def _size(value: Floats, index: tuple[int, ...]) -> float:
    """Return the size of an entry, of a zero that of the largest one, else one."""
    return abs(float(value[index])) or float(np.max(np.abs(value))) or 1.0


def _moved(value: Floats, index: tuple[int, ...], by: float, symmetric: bool) -> Any:
    """Add to an entry; if the matrix must be symmetric half to it and half to its mirror image."""
    moved = value.copy()
    if symmetric and index[0] != index[1]:
        moved[index] += 0.5 * by
        moved[index[::-1]] = moved[index]
    else:
        moved[index] += by
    return _plain(moved)


def coefficients_of(system: Any) -> Coefficients:
    """Return the coefficients of the monomials of H, each by its coordinates; functions of the user have none."""
    found: Coefficients = {}
    for term in system.hamiltonian.terms():
        found[()] = found.get((), 0.0) + term.constant
        if term.form is not None:
            for i, value in enumerate(term.form.linear.tolist()):
                if value:
                    found[i,] = found.get((i,), 0.0) + value
            pairs = zip(term.form.rows.tolist(), term.form.indices.tolist(), term.form.values.tolist(), strict=True)
            for i, j, value in pairs:
                if i <= j:
                    found[i, j] = found.get((i, j), 0.0) + (0.5 * value if i == j else value)
        elif isinstance(term, PolynomialTerm):
            for exponents, value in term.polynomial.monomials.items():
                key = _coordinates(exponents)
                found[key] = found.get(key, 0.0) + float(value)
    return found


def _derivative(
    builder: Callable[..., Any], arguments: dict[str, Any], name: str, value: Floats, symmetric: bool
) -> Callable[[], EnergyDerivative]:
    def derivative() -> EnergyDerivative:
        monomials: list[Monomial] = []
        for index in np.ndindex(value.shape):
            radius = RADIUS * _size(value, index)

            def coefficients_at(shift: float, index: tuple[int, ...] = index) -> Coefficients:
                return coefficients_of(builder(**{**arguments, name: _moved(value, index, shift, symmetric)}))

            by_key = _by_interpolation(coefficients_at, radius)
            if by_key is None:
                raise ValueError(
                    f"{name} cannot be differentiated: {builder.__name__} accepts no values near {value[index]:g}; "
                    "build the system from its own Quadratic, and differentiate by M"
                )
            entry = int(np.ravel_multi_index(index, value.shape)) if index else 0
            monomials += [Monomial(key, entry, factor) for key, factor in by_key.items() if factor]
        return EnergyDerivative.of_monomials(value.size, monomials)

    return derivative


def _by_interpolation(coefficients_at: Callable[[float], Coefficients], largest: float) -> Coefficients | None:
    """Return the derivatives of all coefficients by one entry, by interpolation in Chebyshev nodes.

    The radius is reduced from the largest one where values are refused, and until the last terms of the series are
    below rounding; the smallest last terms decide otherwise. None if all radii are refused.
    """
    nodes = np.cos((np.arange(NODES) + 0.5) * np.pi / NODES)
    series = 2.0 / NODES * np.cos(np.outer(np.arange(NODES), np.arccos(nodes)))
    orders = np.arange(1, NODES, 2)
    # Of odd order, T_j has the derivative j (-1)^((j - 1) / 2) at zero.
    weights = (orders * (-1.0) ** (orders // 2)) @ series[orders]
    found, least = None, np.inf
    for reduction in range(MAX_REDUCTIONS):
        radius = largest * 0.25**reduction
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                samples = [coefficients_at(radius * node) for node in nodes.tolist()]
        except (TypeError, ValueError):
            continue
        keys = sorted(set().union(*samples), key=lambda key: (len(key), key))
        table = np.array([[sample.get(key, 0.0) for key in keys] for sample in samples])
        size, last = np.max(np.abs(table), axis=0), np.sum(np.abs(series[-2:] @ table), axis=0)
        if (error := float(np.sum(last)) / radius) < least:
            straight = table[0] + np.outer((nodes - nodes[0]) / (nodes[-1] - nodes[0]), table[-1] - table[0])
            affine = np.all(np.abs(table - straight) <= 4 * UNIT_ROUNDOFF * size, axis=0)
            slope = np.where(affine, (table[-1] - table[0]) / (nodes[-1] - nodes[0]), weights @ table) / radius
            slope[np.abs(slope) * radius <= ZERO_DERIVATIVE * size] = 0.0
            found, least = dict(zip(keys, slope.tolist(), strict=True)), error
        if np.all(last <= ZERO_DERIVATIVE * size):
            break
    return found

"""Records preserve every public parameter of Hamiltonians, algebras and systems."""

import copy
import json
import pickle

import numpy as np
import pytest
from record_values import (
    FULL,
    REQUIRED,
    SL2,
    VALUES,
    X,
    algebra_properties,
    hamiltonian_properties,
    parameters,
    quadratic_reference,
    system_properties,
    variants,
)

import coadjoint as co
from coadjoint.files.datasets.export import rebuild
from coadjoint.files.records.records import record_of, system_of
from coadjoint.methods.gauss_legendre import GaussLegendre
from coadjoint.methods.suggested_scheme import suggested_scheme
from coadjoint.systems.hamiltonians.hamiltonian import as_hamiltonian
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.registry import ready_made_systems
from long import long_where
from served import state_of

HAMILTONIANS = {"Quadratic": Quadratic, "Polynomial": co.Polynomial, "SplitHamiltonian": co.SplitHamiltonian}


def from_record(system):
    return system_of(json.loads(json.dumps(record_of(system))))


def assert_same_motion(system, **kwargs):
    """Compare the run of a system with that of its record, bit for bit."""
    arguments = {"x0": X, "t_span": (0.0, 0.5), "step": 0.125, "method": GaussLegendre(2)}
    first = co.integrate(system, **{**arguments, **kwargs})
    again = rebuild(first.to_xarray())
    if "parameters" in record_of(system):
        assert behaviour(again.system) == behaviour(system)
    elif hasattr(system, "algebra"):
        assert system_properties(again.system) == system_properties(system)
    for actual, other in ((first.x, again.x), (first.energy, again.energy), (first.t, again.t)):
        assert np.array_equal(actual, other)
    assert first.casimirs.keys() >= again.casimirs.keys()
    assert all(np.array_equal(first.casimirs[name], values) for name, values in again.casimirs.items())
    assert (first.attitude is None) == (again.attitude is None)
    assert first.attitude is None or np.array_equal(first.attitude, again.attitude)


def system_on_sl2(hamiltonian):
    return co.LiePoissonSystem(SL2, hamiltonian)


@pytest.mark.thinned(4)
@pytest.mark.parametrize(
    ("kind", "parameter"),
    [
        (kind, p)
        for kind, make in HAMILTONIANS.items()
        for p in parameters(make)
        if p not in ("dim", "basis", "parameters")
    ],
)
def test_hamiltonian_parameters_are_stored(kind, parameter):
    make = HAMILTONIANS[kind]

    def same(one, other):
        return hamiltonian_properties(as_hamiltonian(one, 3)) == hamiltonian_properties(as_hamiltonian(other, 3))

    def fitting(**kwargs):
        H = make(**kwargs)
        system_on_sl2(H)
        return H

    for H in variants(fitting, REQUIRED[kind], parameter, same):
        system = system_on_sl2(H)
        assert system_properties(from_record(system)) == system_properties(system)
        assert_same_motion(system)


@pytest.mark.thinned(6)
@pytest.mark.parametrize("parameter", parameters(Quadratic))
@pytest.mark.parametrize("M", [1.5, [1.0, 2.0, 4.0], FULL], ids=["number", "diagonal", "matrix"])
def test_nested_quadratic_parameters_are_stored(parameter, M):
    def bound(**kwargs):
        H = Quadratic(**kwargs).bind(3)
        wanted.append((H, *quadratic_reference(**kwargs)))
        return H

    def same(one, other):
        return hamiltonian_properties(one) == hamiltonian_properties(other)

    wanted = []
    free, turned = co.LieAlgebra([], dim=3), [X[1], X[2], X[0]]
    found = variants(bound, {"M": M, "constant": 0.75}, parameter, same)
    for H in found:
        value, rounding = next((value, rounding) for one, value, rounding in wanted if one is H)
        once = co.SplitHamiltonian([((0, 1, 2), H)])
        twice, moved = co.SplitHamiltonian([((0, 1, 2), once)]), co.SplitHamiltonian([((2, 0, 1), H)])
        for wrapped, x in ((H, X), (once, X), (twice, X), (moved, turned)):
            system = co.LiePoissonSystem(free, wrapped)
            for again in (system, from_record(system), copy.deepcopy(system), pickle.loads(pickle.dumps(system))):
                assert abs(again.energy(x) - value) <= rounding
                assert hamiltonian_properties(again.hamiltonian) == hamiltonian_properties(system.hamiltonian)
                assert abs(co.integrate(again, x, (0.0, 0.25), 0.125).energy[0] - value) <= rounding
    batch = co.batch([system_on_sl2(Quadratic(FULL)), *map(system_on_sl2, found)])
    again = from_record(batch)
    assert [system_properties(one) for one in again] == [system_properties(one) for one in batch]
    sol = co.integrate(batch, X, (0.0, 0.25), 0.125, GaussLegendre(2))
    for energy, H in zip(sol.energy[0, 1:], found, strict=True):
        value, rounding = next((value, rounding) for one, value, rounding in wanted if one is H)
        assert abs(energy - value) <= rounding
    assert np.array_equal(rebuild(sol.to_xarray()).energy, sol.energy)


@pytest.mark.thinned(2)
@pytest.mark.parametrize("parameter", [p for p in parameters(co.LieAlgebra) if p not in ("constants", "dim")])
def test_algebra_parameters_are_stored(parameter):
    def same(one, other):
        return algebra_properties(one) == algebra_properties(other)

    for algebra in variants(co.LieAlgebra, REQUIRED["LieAlgebra"], parameter, same):
        system = co.LiePoissonSystem(algebra, Quadratic(FULL))
        assert system_properties(from_record(system)) == system_properties(system)
        assert_same_motion(system, attitude=algebra.representation is not None)


def algebras():
    """Yield one algebra for each name of the catalogue, with parameters where needed."""
    numbers = {"a": 0.5, "b": 0.25, "c": -0.75, "n": 3, "p": 2, "q": 1}
    for name in co.algebras.names():
        arguments = {}
        while True:
            try:
                yield name, co.algebras.get(name, **arguments)
                break
            except ValueError as refused:
                needed = next((key for key in numbers if f"'{key}'" in str(refused) and key not in arguments), None)
                needed = needed or next((key for key in numbers if f" {key} " in str(refused)), None)
                if needed is None or needed in arguments:
                    break
                arguments[needed] = numbers[needed]


def test_catalogue_algebras_are_stored():
    found = dict(algebras())
    assert len(found) > 0.9 * len(co.algebras.names())
    for name, algebra in found.items():
        n = algebra.dim
        system = co.LiePoissonSystem(algebra, Quadratic(np.linspace(1.0, 2.0, n), constant=0.5), casimirs={})
        again = from_record(system)
        assert again.algebra == algebra and again.algebra.basis == algebra.basis, name
        assert again.algebra.name == algebra.name and again.representation is again.algebra.representation
        assert np.array_equal(again.representation, algebra.representation) or algebra.representation is None
        x = np.linspace(-1.0, 1.0, n)
        assert again.energy(x) == system.energy(x) and np.array_equal(again.vector_field(x), system.vector_field(x))


# Functions are not stored; parameters of ready-system_on_sl2 systems are tested below.
NOT_HERE = {"exact": "a function", "parameters": "those of ready-system_on_sl2 systems, below"}


@pytest.mark.thinned(2)
@pytest.mark.parametrize("parameter", [p for p in parameters(co.LiePoissonSystem) if p not in NOT_HERE])
def test_system_parameters_are_stored(parameter):
    others = {
        "algebra": [co.LieAlgebra.from_brackets(3, {(0, 2): {0: 2.0, 1: -1.0}, (1, 2): {0: 1.0, 1: 2.0}}), SL2],
        "name": ["mine", "é's, of 3"],
        "hamiltonian": [Quadratic(FULL, [0.1, 0.2, 0.3], 0.5), co.Polynomial({(4, 0, 0): 0.25})],
    }
    values = others.get(parameter, VALUES)
    found = variants(
        co.LiePoissonSystem,
        REQUIRED["LiePoissonSystem"],
        parameter,
        lambda a, b: system_properties(a) == system_properties(b),
        values,
    )
    for system in found:
        assert system_properties(from_record(system)) == system_properties(system)
        assert_same_motion(system, attitude=system.representation is not None)
        assert_same_motion(system, attitude="coadjoint", t_span=(0.25, -0.25))


# Parameters that are no numbers or depend on another one: required arguments, and other values.
OTHERS = {
    ("clebsch_body", "inertia"): ({}, [(2.0, 2.0, 2.0)]),
    ("double_spherical_pendulum", "masses"): ({}, [(1.5, 0.75)]),  # compiled for each
    ("kirchhoff_body", "coupling"): ({}, [[[0.2, 0.5, -0.1], [0.0, -0.3, 0.4], [0.3, 0.1, 0.25]]]),
    ("satellite", "inertia"): ({}, [(2.0, 1.5, 1.0)]),
    ("rigid_body", "inertia"): ({}, [(2.0, 2.5, 1.0)]),
    ("gyrostat", "inertia"): ({}, [(2.0, 2.5, 1.0)]),
    ("separable_cosh", "algebra"): ({}, ["sl(2)"]),
    ("reduced_mhd", "N"): ({}, [5]),
    ("reduced_mhd", "surface"): ({"N": 5}, ["torus"]),
    ("passive_scalar", "N"): ({}, [5]),
    ("passive_scalar", "surface"): ({"N": 5}, ["torus"]),
    ("sphere_euler", "N"): ({}, [5]),
    ("torus_euler", "N"): ({}, [5]),
    ("spin_lattice", "dm"): ({}, [(0.1, 0.2, 0.3)]),
    ("spin_lattice", "field"): ({}, [(0.1, 0.2, 0.3)]),
    ("spin_lattice", "lattice"): ({"shape": 3}, ["ring"]),
    ("spin_lattice", "periodic"): ({"shape": 3}, [True]),
    ("vlasov_moments", "degree"): ({}, [6]),
    ("vlasov_moments", "potential"): ({}, ["1/4*x20 + 0.1*x20^2"]),
    ("separable_cosh", "constants"): ({"algebra": "A3,7", "constants": {"a": 2.0}}, [{"a": 0.5}]),
}


LONGER = [("sphere_euler", "rotation"), ("double_spherical_pendulum", "masses")]


@pytest.mark.thinned(28)
@pytest.mark.parametrize(
    ("name", "parameter"),
    long_where(LONGER, [(name, p) for name, make in ready_made_systems().items() for p in parameters(make)]),
)
def test_ready_made_parameters_are_stored(name, parameter):
    make = ready_made_systems()[name]
    default = make.__wrapped__ if hasattr(make, "__wrapped__") else make
    usual = default.__defaults__[parameters(make).index(parameter)]
    arguments, values = OTHERS.get((name, parameter), ({}, None))
    if values is None and isinstance(usual, int):
        values = [usual + 1]
    elif values is None:
        usual = np.asarray(usual, dtype=float)
        values = [(usual * (1.25 + 0.125 * np.arange(usual.size))).tolist() if usual.ndim else float(usual) + 0.75]
        values.append(np.array([[2.0, 0.1, 0.2], [0.1, 3.0, -0.3], [0.2, -0.3, 4.0]]))

    def same(one, other):
        return one.dim == other.dim and behaviour(one) == behaviour(other)

    for system in variants(make, arguments, parameter, same, values):
        again = from_record(system)
        assert behaviour(again) == behaviour(system) and (again.closed_form is None) == (system.closed_form is None)
        attitude = system.algebra is not None and (system.representation is not None or "coadjoint")
        method = GaussLegendre(2) if system.algebra is None else co.Splitting(order=2)
        if name == "double_spherical_pendulum":  # has no exact flows of parts
            method, attitude = GaussLegendre(2), "coadjoint"
        x0 = np.cos(np.arange(system.dim))
        if isinstance(system, co.MatrixSystem):
            method, attitude, x0 = suggested_scheme(system), False, state_of(system)
        functions = any(term.called for term in system.hamiltonian.terms())
        if parameter == parameters(make)[0] or not functions:  # compiled once
            assert_same_motion(system, attitude=attitude, method=method, x0=x0)


def behaviour(system):
    """Return properties of a system; functions, which are not stored, by their values."""
    x = np.cos(np.arange(1.0, system.dim + 1.0))
    casimirs = {name: C.value if isinstance(C, Quadratic) else C for name, C in system.casimirs.items()}
    motion = system.vector_field(x).tolist(), system.energy(x), system.structure_matrix(x).tolist()
    followed = {name: C(x) for name, C in casimirs.items()}
    return type(system), system.dim, system.sign, system.name, system.parameters, motion, followed

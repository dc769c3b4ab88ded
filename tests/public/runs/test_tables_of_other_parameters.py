"""Tables at other parameters, by the reader in `examples/` alone: those of the library, bit for bit."""

import dataclasses
import runpy
from pathlib import Path

import numpy as np
import pytest

import coadjoint as co
from refusals import refused

READER = Path(__file__).parents[3] / "examples" / "read_table.py"
C1 = 1 / (2 - 2 ** (1 / 3))
SCHEMES = {
    "1": co.Splitting(order=1),
    "2": co.Splitting(order=2),
    "4": co.Splitting(order=4),
    "coordinates": co.Splitting(order=2, parts="coordinates"),
    "rational": co.Splitting(order=2, rotation="rational"),
    "processed": co.Splitting(scheme="blanes_casas_murua6"),
    "free_body": co.Splitting(order=2, parts="free_body"),
    "bonds": co.Splitting(order=2, parts="bonds"),
    "composition": co.Composition(co.Splitting(order=2), (C1, 1 - 2 * C1, C1)),
}
TENSOR = ((2.0, 0.1, 0.2), (0.1, 2.3, -0.3), (0.2, -0.3, 2.6))
E3 = co.algebras.e(3)
# The last three coordinates commute, so that their monomials share a part.
POLYNOMIAL = {
    (0, 0, 0, 2, 1, 0): 0.3,
    (0, 0, 0, 0, 1, 1): -0.2,
    (0, 0, 0, 0, 0, 4): 0.1,
    (1, 0, 0, 0, 0, 0): 0.4,
    (0, 2, 0, 0, 0, 0): 0.5,
}


# Squares, shifts, several components, and energies that are no arguments of a builder.
OTHERS = {
    "a tensor": lambda: co.systems.rigid_body(TENSOR),
    "a top with a tensor": lambda: co.systems.heavy_top(TENSOR),
    "a coupled body": lambda: co.systems.kirchhoff_body(coupling=np.diag([0.1, 0.2, 0.3])),
    "a chain": lambda: co.systems.spin_lattice("chain", 4, field=(0.1, 0.2, 0.3), on_site=(0.0, 0.0, 0.4)),
    "a lattice": lambda: co.systems.spin_lattice("square", (3, 3), dm=(0.1, 0.2, 0.3), field=(0.0, 0.0, 0.2)),
    "a diagonal": lambda: co.LiePoissonSystem(E3, co.Quadratic([1.0, 0.6, 0.3, 0.2, 0.4, 0.1], [0.1, 0, 0, 0.2, 0, 1])),
    "a matrix": lambda: co.LiePoissonSystem(
        co.algebras.so(4), co.Quadratic(np.diag([1.0, 0.7, 0.5, 0.4, 0.2, 0.9]) + 0.1)
    ),
    "a polynomial": lambda: co.LiePoissonSystem(E3, co.Polynomial(POLYNOMIAL)),
}


@pytest.fixture(scope="module")
def page():
    """The functions of the example."""
    for part in READER.read_text().split("\n\n\ndef coefficients"):
        assert len(part.splitlines()) <= 100
    return runpy.run_path(str(READER))


def rebuilt(system, table, name, value):
    """The system with another value of a parameter of its table; None if it refuses this value."""
    H, parameter = system.hamiltonian, table["parameters"][name]
    try:
        if name in (system.parameters or {}):
            return co.systems.get(system.name, **{**system.parameters, name: value if value.ndim else float(value)})
        if name == "coefficients":
            keys = [table["energy"]["monomials"][k] for k in parameter["monomial"]]
            energy = co.Polynomial(
                {tuple(np.bincount(k, minlength=system.dim)): c for k, c in zip(keys, value, strict=True)}
            )
        elif name == "M":
            energy = co.Quadratic(value, H.gradient(np.zeros(system.dim)))
        else:
            energy = co.Quadratic(H.hessian(np.zeros(system.dim)), value)
        return co.LiePoissonSystem(system.algebra, energy, sign=system.sign, casimirs=system.casimirs)
    except (TypeError, ValueError):
        return None


def draws(parameter):
    """Other values of a parameter: all numbers changed, and then some zeros replaced, each alone."""
    rng, value = np.random.default_rng(17), parameter["value"].reshape(parameter["shape"])
    symmetric = value.ndim == 2 and np.array_equal(value, value.T)
    factor = rng.uniform(0.97, 1.03, value.shape)
    yield value * (0.5 * (factor + factor.T) if symmetric else factor)
    zeros = np.argwhere(value == 0.0)
    for index in map(tuple, zeros[rng.permutation(len(zeros))[:3]]):
        other = value.copy()
        other[index] = 0.01
        if symmetric:
            other[index[::-1]] = 0.01
        yield other


def energy_in(table, other):
    """The coefficients of another table in the order of the first one, which has all of them."""
    found = dict(zip(map(tuple, other["energy"]["monomials"]), other["energy"]["coefficients"].tolist(), strict=True))
    known = [tuple(key) for key in table["energy"]["monomials"]]
    assert all(key in known for key, value in found.items() if value)
    return np.array([found.get(key, 0.0) for key in known])


def differences(found, wanted):
    """The names of the entries that differ; parameters and what depends on them are described at other values."""
    described = {"parameters", "energy", "provenance", "fixed", "shift"}
    factors = [[(shift["factor"], shift["exponents"]) for shift in table["shift"]] for table in (found, wanted)]
    different = {name for name in wanted.keys() - described if not np.array_equal(found[name], wanted[name])}
    return different | ({"shift"} if factors[0] != factors[1] else set())


def program_of(scheme, system):
    """The table of a scheme with the group element; None if the system has no such parts."""
    try:
        return scheme.flow_table(system, group="coadjoint")
    except (TypeError, ValueError):
        return None


def with_parts(scheme, program, shift):
    """The scheme with the parts of a program, and other factors of the Casimirs."""
    if isinstance(scheme, co.Composition):
        return co.Composition(with_parts(scheme.base, program, shift), scheme.coefficients)
    if scheme.parts != "auto":
        return scheme
    factors = {name: one["factor"] for (name, _), one in zip(program.choice.shift, shift, strict=True)}
    return dataclasses.replace(scheme, parts={"order": program.choice.order, "shift": factors})


@pytest.mark.thinned(12)
@pytest.mark.filterwarnings("ignore:.*principal moment", "ignore:inertia")
@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("name", [*co.systems.names(), *OTHERS])
def test_tables_at_other_parameters_are_those_of_the_library(page, name, scheme):
    system, scheme = OTHERS[name]() if name in OTHERS else co.systems.get(name), SCHEMES[scheme]
    program = program_of(scheme, system)
    if program is None:
        return
    table = program.to_mapping()
    assert differences(page["with_coefficients"](table, table["energy"]["coefficients"]), table) == set()
    for label, parameter in table["parameters"].items():
        for value in draws(parameter):
            changed = rebuilt(system, table, label, value)
            other = None if changed is None else program_of(scheme, changed)
            if other is None:
                continue
            automatic = other.to_mapping()
            energy = energy_in(table, automatic)
            if parameter["linear"]:
                own = page["coefficients"](table, {label: value})
                assert np.array_equal(own, energy)
            try:
                found = page["with_coefficients"](table, energy)
            except ValueError as refusal:
                assert "fixed" in str(refusal)
                # It is no excuse: the rules alone do not give the table of the changed system.
                rules = {**table, "fixed": []}
                assert differences(page["with_coefficients"](rules, energy), automatic), (label, value)
                continue
            wanted = with_parts(scheme, program, found["shift"]).flow_table(changed, group="coadjoint").to_mapping()
            assert differences(found, wanted) == set(), (label, value)
            # With the same choice of parts, also the factors are those that the library chooses.
            numbers = {*table["provenance"], "shift"}
            if len(found["shift"]) == len(automatic["shift"]) and not differences(table, automatic) - numbers:
                assert differences(found, automatic) == set(), (label, value)


def test_the_library_chooses_the_factors_of_shifts_by_the_rules_of_the_page(page):
    tables = [co.Splitting().flow_table(co.systems.rigid_body((1.0, i, 3.0))).to_mapping() for i in (2.0, 2.1)]
    assert [shift["monomial"] is not None for shift in tables[0]["shift"]] == [True]
    found = page["with_coefficients"](tables[0], energy_in(*tables))
    assert found["shift"][0]["factor"] == tables[1]["shift"][0]["factor"] != tables[0]["shift"][0]["factor"]
    assert differences(found, tables[1]) == set()


def test_factors_that_were_given_are_numbers(page):
    """0.25 removes the second square, as the library chooses; the next number does so to rounding, and 0.2 does not."""
    for factor, parts, monomial, fixed in (
        (0.25, 2, 1, []),
        (np.nextafter(0.25, 1.0), 2, None, [1]),
        (0.2, 3, None, []),
    ):
        scheme = co.Splitting(parts={"order": tuple(range(parts)), "shift": {"|x|^2": factor}})
        table = scheme.flow_table(co.systems.rigid_body()).to_mapping()
        assert ([shift["monomial"] for shift in table["shift"]], table["fixed"]) == ([monomial], fixed)


FOLLOWED = {
    ("rigid_body", "2"): "inertia",
    ("rigid_body", "free_body"): "inertia",
    ("a tensor", "free_body"): "inertia",
    ("heavy_top", "free_body"): "inertia lever",
    ("heavy_top", "4"): "inertia lever",
    ("a top with a tensor", "2"): "lever",
    ("gyrostat", "2"): "inertia rotors",
    ("kirchhoff_body", "processed"): "inertia mass",
    ("spin_lattice", "composition"): "exchange field",
    ("toda", "2"): "M linear",
    ("bodies", "coordinates"): "inertias masses",
    ("a diagonal", "coordinates"): "M linear",
    ("a polynomial", "2"): "coefficients",
}


@pytest.mark.filterwarnings("ignore:.*principal moment", "ignore:inertia")
def test_parameters_that_tables_follow():
    for (name, scheme), parameters in FOLLOWED.items():
        system = OTHERS[name]() if name in OTHERS else co.systems.get(name)
        table = SCHEMES[scheme].flow_table(system).to_mapping()
        for parameter in map(table["parameters"].get, parameters.split()):
            moved = parameter["monomial"][parameter["derivative"] != 0.0]
            assert len(moved) and not np.isin(moved, table["fixed"]).any(), (name, scheme)


def test_coefficients_of_completed_squares_are_refused_by_name(page):
    table = SCHEMES["coordinates"].flow_table(co.systems.rigid_body(TENSOR)).to_mapping()
    assert sorted(table["fixed"]) == list(range(6)) and not len(table["provenance"]["weight"]["index"])
    for monomial, key in enumerate(table["energy"]["monomials"]):
        energy = table["energy"]["coefficients"].copy()
        energy[monomial] *= 1.1
        with refused(ValueError, key):
            page["with_coefficients"](table, energy)
    # The last square has the weight M_33, as long as M_12 is larger.
    M = np.array([[0.0, 1.0, 0.3], [1.0, 0.0, 0.0], [0.3, 0.0, 0.2]])
    table = SCHEMES["coordinates"].flow_table(co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(M))).to_mapping()
    assert 0.2 in table["weight"] and table["energy"]["monomials"].index([2, 2]) in table["fixed"]

"""The table as plain arrays, its provenance, and the reader of `docs/table.md`, which knows nothing of this library."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

import coadjoint as co
from catalogue_cases import EXAMPLES, NAMES
from long import long_beyond
from refusals import refused

pytestmark = pytest.mark.thinned(6)

PAGE = Path(__file__).parents[3] / "docs" / "table.md"
RNG = np.random.default_rng(30)
C1 = 1 / (2 - 2 ** (1 / 3))


def python_of_the_page():
    return re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)


@pytest.fixture(scope="module")
def reader():
    known: dict = {}
    exec(python_of_the_page()[0], known)
    return known["run"]


def full(n):
    half = 0.2 * RNG.standard_normal((n, n))
    return co.Quadratic(half @ half.T + np.diag(RNG.uniform(0.3, 1.0, n)), 0.2 * RNG.standard_normal(n))


def cubic(n):
    return co.Polynomial(
        {tuple(2 * int(k == i) + int(k == (i + 1) % n) for k in range(n)): 0.05 * (i + 1) for i in range(n)}
    )


def commuting(algebra):
    """A cubic energy in the coordinates of an abelian set, and squares."""
    n = algebra.dim
    squares = {tuple(2 * int(k == i) for k in range(n)): 0.2 + 0.1 * i for i in range(n)}
    return co.Polynomial(squares | {tuple(3 * int(k == n - 1) for k in range(n)): 0.1})


ALGEBRAS = {
    "so(3)": co.algebras.so(3),
    "e(3)": co.algebras.e(3),
    "so(5)": co.algebras.so(5),
    "sl(2)": co.algebras.sl(2),
    "A3,7": co.algebras.get("A3,7", a=0.5),
    "A4,10": co.algebras.get("A4,10"),
    "su(3)": co.algebras.su(3),
    "heisenberg": co.algebras.heisenberg(2),
    "copies": co.algebras.copies(co.algebras.so(3), 3),  # one run of blocks turns by several angles
}
METHODS = {
    "1": co.Splitting(order=1),
    "1 adjoint": co.Splitting(order=1, adjoint=True),
    "2": co.Splitting(order=2),
    "4": co.Splitting(order=4),
    "coordinates": co.Splitting(order=2, parts="coordinates"),
    "processed": co.Splitting(scheme="blanes_casas_murua6"),
    "composition": co.Composition(co.Splitting(order=2), (C1, 1 - 2 * C1, C1)),
}


def agrees(reader, system, scheme, x0, h, steps=4):
    sol = co.integrate(system, x0, (0.5, 0.5 + steps * h), abs(h), scheme, save_every=steps, watch=False)
    found = reader(scheme.program(system).to_mapping(), x0, h, steps)
    # expm has a few units of rounding in each of the flows, some hundred of them at most.
    return np.max(np.abs(found - sol.x[-1])) < 4000 * system.dim * 2.0**-53 * max(1.0, np.max(np.abs(sol.x)))


@pytest.mark.thinned(13)
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("algebra", ALGEBRAS)
@pytest.mark.parametrize("h", long_beyond(1, [0.1, -0.1]))
def test_the_reader_of_the_page_agrees_with_the_library(reader, algebra, method, h):
    g, scheme = ALGEBRAS[algebra], METHODS[method]
    energies = [full(g.dim), commuting(g)] if "coordinates" not in method else [commuting(g)]
    for number, H in enumerate(energies):
        system = co.LiePoissonSystem(g, H, sign=1 - 2 * number)
        assert agrees(reader, system, scheme, 0.4 * RNG.standard_normal(g.dim), h)


@pytest.mark.thinned(6)
@pytest.mark.parametrize("name", NAMES)
def test_the_reader_reads_a_full_matrix_on_every_algebra_of_the_catalogue(reader, name):
    algebra = co.algebras.get(name, **EXAMPLES.get(name, {}))
    system = co.LiePoissonSystem(algebra, full(algebra.dim))
    assert agrees(reader, system, co.Splitting(order=4), 0.4 * RNG.standard_normal(algebra.dim), 0.1)


@pytest.mark.parametrize("parts", ["auto", "coordinates"])
def test_the_reader_turns_by_rational_angles(reader, parts):
    stretched = co.LieAlgebra.from_brackets(3, {(0, 1): {2: 2.5}, (1, 2): {0: 2.5}, (0, 2): {1: -2.5}})
    frequencies = []
    for algebra in (co.algebras.so(3), co.algebras.e(3), stretched):
        n = algebra.dim
        diagonal = co.Quadratic([1.0, 0.6, 0.3, 0.0, 0.0, 0.0][:n], linear=[0.1, 0.0, 0.2, 0.3, 0.1, 0.2][:n])
        system = co.LiePoissonSystem(algebra, diagonal, sign=-1)
        scheme = co.Splitting(order=4, parts=parts, rotation="rational")
        frequencies += scheme.program(system).to_mapping()["frequency"].tolist()
        for h in (0.3, -0.3):
            assert agrees(reader, system, scheme, RNG.standard_normal(n), h)
    assert len({w for w in frequencies if w}) > 1


@pytest.mark.parametrize("h", [0.4, -1.5])
def test_the_reader_moves_free_bodies_and_bonds(reader, h):
    top = co.systems.heavy_top()
    assert agrees(reader, top, co.Splitting(order=2, parts="free_body"), RNG.standard_normal(6), h)
    chain = co.systems.spin_lattice("chain", 3, field=(0.1, 0.2, 0.3))
    assert agrees(reader, chain, co.Splitting(order=2, parts="bonds"), RNG.standard_normal(9), h)


def read(written):
    """The arrays of a table in JSON."""
    return {name: np.array(value) if isinstance(value, list) else value for name, value in json.loads(written).items()}


def test_it_is_json_and_comes_back(reader):
    system = co.LiePoissonSystem(co.algebras.so(4), full(6))
    table = co.Splitting(order=2).program(system).to_mapping()
    back = read(json.dumps(table, default=lambda array: array.tolist()))
    x0 = RNG.standard_normal(6)
    assert np.array_equal(reader(back, x0, 0.1, 3), reader(table, x0, 0.1, 3))
    assert table["shift"] and {"factor", "exponents", "coefficients"} == set(table["shift"][0])
    integers = [v.dtype for v in table.values() if isinstance(v, np.ndarray) and v.dtype.kind != "f"]
    assert set(integers) == {np.dtype(np.int64)}


def test_a_reader_refuses_newer_tables_and_functions(reader):
    table = co.Splitting().program(co.systems.rigid_body(inertia=(1, 2, 2.5))).to_mapping()
    reader(table, np.ones(3), 0.1, 1)
    for other in ({"version": table["version"] + 1}, {"functions": [0]}):
        with refused(ValueError, "version"):
            reader(table | other, np.ones(3), 0.1, 1)


def with_parameter(table, name, value):
    """The table at another value of a parameter, through its provenance, as on the page."""
    parameter, energy = table["parameters"][name], table["energy"]["coefficients"].copy()
    grown = parameter["derivative"] * (np.ravel(value) - parameter["value"])[parameter["entry"]]
    assert not np.any(grown[np.isin(parameter["monomial"], table["fixed"])])
    np.add.at(energy, parameter["monomial"], grown)
    changed = dict(table)
    for array in ("offset", "weight", "coefficient_of_monomial"):
        source, changed[array] = table["provenance"][array], table[array].copy()
        change = (energy - table["energy"]["coefficients"])[source["monomial"]]
        np.add.at(changed[array], source["index"], source["factor"] * change)
    changed["energy"] = {**table["energy"], "coefficients": energy}
    return changed


def system_with(name):
    e3 = co.algebras.e(3)
    M, linear = np.array([1.0, 0.6, 0.3, 0.2, 0.4, 0.1]), np.array([0.1, -0.2, 0.3, 0.3, 0.1, 0.2])
    # The last three coordinates commute, so that their monomials share a part.
    of_commuting = {(0, 0, 0, 2, 1, 0): 0.3, (0, 0, 0, 0, 1, 1): -0.2, (0, 0, 0, 0, 0, 4): 0.1}
    polynomial = co.Polynomial(of_commuting | {(1, 0, 0, 0, 0, 0): 0.4, (0, 2, 0, 0, 0, 0): 0.5})
    coefficients = np.array(list(polynomial.monomials.values()))
    energy, value = {
        "M": (lambda v: co.Quadratic(v, linear=linear), M),
        "linear": (lambda v: co.Quadratic(M, linear=v), linear),
        "coefficients": (lambda v: co.Polynomial(dict(zip(polynomial.monomials, v, strict=True))), coefficients),
    }[name]
    return lambda v: co.LiePoissonSystem(e3, energy(v)), value


@pytest.mark.parametrize("name", ["M", "linear", "coefficients"])
def test_a_parameter_changes_the_table_through_its_provenance(reader, name):
    build, value = system_with(name)
    # At another value another order of the parts might be chosen.
    scheme = co.Splitting(order=2, parts="coordinates" if name != "coefficients" else [[0], [1], [3, 4, 5]])
    other = value * np.random.default_rng(17).uniform(0.5, 1.5, value.shape)
    table = scheme.program(build(value)).to_mapping()
    assert table["parameters"][name]["linear"] and np.array_equal(table["parameters"][name]["value"], value)
    changed, wanted = with_parameter(table, name, other), scheme.program(build(other)).to_mapping()
    for array in ("part", "offset", "weight", "coefficient_of_monomial"):
        assert np.allclose(changed[array], wanted[array], rtol=2.0**-50, atol=2.0**-50), array
    energies = [
        dict(zip(map(tuple, t["energy"]["monomials"]), t["energy"]["coefficients"], strict=True))
        for t in (changed, wanted)
    ]
    assert energies[0].keys() == energies[1].keys()
    assert all(abs(energies[0][key] - energies[1][key]) < 2.0**-50 for key in energies[0])
    x0 = RNG.standard_normal(build(value).dim)
    assert np.allclose(reader(changed, x0, 0.1, 3), reader(wanted, x0, 0.1, 3), rtol=0, atol=1e-13)


def test_a_shift_depends_on_the_coefficient_that_it_removes():
    """H - c |x|^2 without x2^2: c is half of M_22, and so are the changes of the other squares."""
    tables = [
        co.Splitting().program(co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1.0, m, 0.25]))).to_mapping()
        for m in (0.5, 0.53)
    ]
    changed = with_parameter(tables[0], "M", [1.0, 0.53, 0.25])
    assert np.allclose(changed["weight"], tables[1]["weight"], rtol=2.0**-50)
    source = tables[0]["provenance"]["shift"]
    assert len(source["index"]) == 1
    squares = tables[1]["energy"]["coefficients"] - tables[0]["energy"]["coefficients"]
    factors = [table["shift"][0]["factor"] for table in tables]
    assert np.isclose(source["factor"][0] * squares[source["monomial"][0]], factors[1] - factors[0], rtol=1e-12)


def test_the_derivatives_by_arguments_of_ready_made_systems():
    tables = [
        co.Splitting(order=2).program(co.systems.heavy_top(inertia=(1, i, 2.5))).to_mapping() for i in (2, 2 + 1e-6)
    ]
    parameter = tables[0]["parameters"]["inertia"]
    assert not parameter["linear"] and parameter["shape"] == [3] and parameter["value"].tolist() == [1, 2, 2.5]
    changed = with_parameter(tables[0], "inertia", [1, 2 + 1e-6, 2.5])
    # The second derivative of 1/I by I is 1/4.
    assert 0 < np.max(np.abs(changed["weight"] - tables[1]["weight"])) < 1e-12
    assert np.max(np.abs(tables[0]["weight"] - tables[1]["weight"])) > 1e-7


def test_coefficients_on_which_forms_depend_are_fixed():
    table = co.Splitting().program(co.LiePoissonSystem(co.algebras.so(3), full(3))).to_mapping()
    monomials = [table["energy"]["monomials"][k] for k in table["fixed"]]
    assert [0, 1] in monomials and not np.isin(table["provenance"]["weight"]["monomial"], table["fixed"]).any()


def test_a_group_element_has_its_generators():
    system = co.systems.rigid_body(inertia=(1, 2, 2.5))
    table = co.Splitting(parts="coordinates").program(system, group="coadjoint").to_mapping()
    # The coadjoint matrix is turned by the same generators, as -rho^T.
    for name in ("part", "kind", "lambda", "block"):
        assert np.array_equal(table[f"group_{name}"], table[f"state_{name}"])
    assert "group_part" not in co.Splitting().program(system).to_mapping()


def test_functions_are_named_by_their_terms():
    H = co.Separable({0: (np.cosh, np.sinh), 2: (lambda y: y**2, lambda y: 2 * y)})
    system = co.LiePoissonSystem(co.algebras.so(3), H)
    table = co.Splitting(order=2).program(system).to_mapping()
    assert table["functions"] == [k for k, kind in enumerate(table["term_kind"]) if kind == 2] != []


@pytest.mark.parametrize(
    "method", [co.GaussLegendre(2), co.Taylor(4), co.Composition(co.GaussLegendre(1), (C1, 1 - 2 * C1, C1))]
)
def test_what_is_not_made_of_flows_has_no_program(method):
    with refused(TypeError, "no program", "Splitting"):
        method.program(co.systems.rigid_body(inertia=(1, 2, 2.5)))

"""The table as plain arrays, and its reader in `examples/`, which knows nothing of this library."""

import json
import runpy
from pathlib import Path

import numpy as np
import pytest

import coadjoint as co
from catalogue_cases import EXAMPLES, NAMES
from long import long_beyond
from refusals import refused

pytestmark = pytest.mark.thinned(6)

READER = Path(__file__).parents[3] / "examples" / "read_table.py"
RNG = np.random.default_rng(30)
C1 = 1 / (2 - 2 ** (1 / 3))


@pytest.fixture(scope="module")
def reader():
    return runpy.run_path(str(READER))["run"]


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
    found = reader(scheme.flow_table(system).to_mapping(), x0, h, steps)
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
        frequencies += scheme.flow_table(system).to_mapping()["frequency"].tolist()
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
    table = co.Splitting(order=2).flow_table(system).to_mapping()
    back = read(json.dumps(table, default=lambda array: array.tolist()))
    x0 = RNG.standard_normal(6)
    assert np.array_equal(reader(back, x0, 0.1, 3), reader(table, x0, 0.1, 3))
    assert table["shift"] and {"factor", "monomial", "exponents", "coefficients"} == set(table["shift"][0])
    integers = [v.dtype for v in table.values() if isinstance(v, np.ndarray) and v.dtype.kind != "f"]
    assert set(integers) == {np.dtype(np.int64)}


def test_a_reader_refuses_newer_tables_and_functions(reader):
    table = co.Splitting().flow_table(co.systems.rigid_body(inertia=(1, 2, 2.5))).to_mapping()
    reader(table, np.ones(3), 0.1, 1)
    for other in ({"version": table["version"] + 1}, {"functions": [0]}):
        with refused(ValueError, "version"):
            reader(table | other, np.ones(3), 0.1, 1)


def test_the_derivatives_by_arguments_of_ready_made_systems():
    tables = [
        co.Splitting(order=2).flow_table(co.systems.heavy_top(inertia=(1, i, 2.5))).to_mapping() for i in (2, 2 + 1e-6)
    ]
    parameter = tables[0]["parameters"]["inertia"]
    assert not parameter["linear"] and parameter["shape"] == [3] and parameter["value"].tolist() == [1, 2, 2.5]
    grown = tables[0]["energy"]["coefficients"].copy()
    change = parameter["derivative"] * (np.array([1, 2 + 1e-6, 2.5]) - parameter["value"])[parameter["entry"]]
    np.add.at(grown, parameter["monomial"], change)
    # The second derivative of 1/I by I is 1/4.
    assert 0 < np.max(np.abs(grown - tables[1]["energy"]["coefficients"])) < 1e-12
    assert np.max(np.abs(tables[0]["energy"]["coefficients"] - grown)) > 1e-7


def test_coefficients_on_which_forms_depend_are_fixed():
    table = co.Splitting().flow_table(co.LiePoissonSystem(co.algebras.so(3), full(3))).to_mapping()
    monomials = [table["energy"]["monomials"][k] for k in table["fixed"]]
    assert [0, 1] in monomials and not np.isin(table["provenance"]["weight"]["monomial"], table["fixed"]).any()


def test_a_group_element_has_its_generators():
    system = co.systems.rigid_body(inertia=(1, 2, 2.5))
    table = co.Splitting(parts="coordinates").flow_table(system, group="coadjoint").to_mapping()
    # The coadjoint matrix is turned by the same generators, as -rho^T.
    for name in ("part", "kind", "lambda", "block"):
        assert np.array_equal(table[f"group_{name}"], table[f"state_{name}"])
    assert "group_part" not in co.Splitting().flow_table(system).to_mapping()


def test_functions_are_named_by_their_terms():
    H = co.Separable({0: (np.cosh, np.sinh), 2: (lambda y: y**2, lambda y: 2 * y)})
    system = co.LiePoissonSystem(co.algebras.so(3), H)
    table = co.Splitting(order=2).flow_table(system).to_mapping()
    assert table["functions"] == [k for k, kind in enumerate(table["term_kind"]) if kind == 2] != []


@pytest.mark.parametrize(
    "method", [co.GaussLegendre(2), co.Taylor(4), co.Composition(co.GaussLegendre(1), (C1, 1 - 2 * C1, C1))]
)
def test_what_is_not_made_of_flows_has_no_program(method):
    with refused(TypeError, "no flow table", "Splitting"):
        method.flow_table(co.systems.rigid_body(inertia=(1, 2, 2.5)))

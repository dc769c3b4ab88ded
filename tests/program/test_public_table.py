"""The table as plain arrays, and the reader of `docs/table.md`, which knows nothing of this library."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

import coadjoint as co
from long import long_beyond

pytestmark = pytest.mark.thinned(6)

PAGE = Path(__file__).parents[2] / "docs" / "table.md"
RNG = np.random.default_rng(30)
C1 = 1 / (2 - 2 ** (1 / 3))


@pytest.fixture(scope="module")
def reader():
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)
    known: dict = {}
    exec(blocks[0], known)
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


@pytest.mark.thinned(13)
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("algebra", ALGEBRAS)
@pytest.mark.parametrize("h", long_beyond(1, [0.1, -0.1]))
def test_the_reader_of_the_page_agrees_with_the_library(reader, algebra, method, h):
    g, scheme = ALGEBRAS[algebra], METHODS[method]
    energies = [full(g.dim), commuting(g)] if "coordinates" not in method else [commuting(g)]
    for number, H in enumerate(energies):
        system = co.LiePoissonSystem(g, H, sign=1 - 2 * number)
        x0 = 0.4 * RNG.standard_normal(g.dim)
        sol = co.integrate(system, x0, (0, 4 * h), abs(h), scheme, save_every=4, watch=False)
        found = reader(scheme.program(system).to_mapping(), x0, h, 4)
        # expm has a few units of rounding in each of the flows, some hundred of them at most.
        assert np.max(np.abs(found - sol.x[-1])) < 2000 * g.dim * 2.0**-53 * max(1.0, np.max(np.abs(sol.x)))


def test_it_is_json_and_comes_back(reader):
    system = co.LiePoissonSystem(co.algebras.so(4), full(6))
    table = co.Splitting(order=2).program(system).to_mapping()
    written = json.dumps({k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in table.items()})
    back = {k: np.array(v) if isinstance(v, list) else v for k, v in json.loads(written).items()}
    x0 = RNG.standard_normal(6)
    assert np.array_equal(reader(back, x0, 0.1, 3), reader(table, x0, 0.1, 3))
    assert table["shift"] and {"factor", "exponents", "coefficients"} == set(table["shift"][0])


def test_a_group_element_has_its_generators():
    system = co.systems.rigid_body(inertia=(1, 2, 2.5))
    table = co.Splitting(parts="coordinates").program(system, group="coadjoint").to_mapping()
    # The coadjoint matrix is turned by the same generators, as -rho^T.
    assert np.array_equal(table["group_part"], table["state_part"])
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
    with pytest.raises(TypeError, match="is not made of exact flows, so it has no program; Splitting has one"):
        method.program(co.systems.rigid_body(inertia=(1, 2, 2.5)))

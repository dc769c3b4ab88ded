"""Systems on several algebras: field, derivative, copies, names."""

from fractions import Fraction

import numpy as np
import pytest

import coadjoint as co
from refusals import refused

U = 2.0**-53

ALGEBRAS = {
    "so(3)": co.algebras.so(3),
    "A3,7": co.algebras.get("A3,7", a=1.75),
    "e(3)": co.algebras.e(3),
    "sl(2)": co.algebras.sl(2),
    "so(4)": co.algebras.so(4),
    "heisenberg": co.algebras.heisenberg(2),
}


def dense_constants(algebra):
    c = np.zeros((algebra.dim,) * 3)
    for i, j, k, value in zip(*algebra.triples, strict=True):
        c[i, j, k], c[j, i, k] = value, -value
    return c


def changed_basis(algebra, seed=5):
    """The constants in a random basis of determinant one: no longer sparse, and exact, being sums of few bits."""
    n = algebra.dim
    draw = np.random.default_rng(seed).integers(-1, 2, (2, n, n)).astype(float)
    P = (np.tril(draw[0], -1) + np.eye(n)) @ (np.triu(draw[1], 1) + np.eye(n))
    inverse = np.rint(np.linalg.inv(P))
    assert np.array_equal(P @ inverse, np.eye(n))
    return np.einsum("ai,bj,ijk,kc->abc", P, P, dense_constants(algebra), inverse)


def random_system(algebra, sign, seed=11):
    n = algebra.dim
    rng = np.random.default_rng(seed)
    A, b = rng.standard_normal((n, n)), rng.standard_normal(n)
    return co.LiePoissonSystem(algebra, co.Quadratic(A + A.T, linear=b), sign=sign), rng.standard_normal(n), A + A.T, b


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("name", ALGEBRAS)
def test_vector_field_is_the_dense_formula(name, sign):
    for basis_change in (False, True):
        algebra = ALGEBRAS[name]
        n = algebra.dim
        c = changed_basis(algebra) if basis_change else dense_constants(algebra)
        system, x, M, b = random_system(co.LieAlgebra(c) if basis_change else algebra, sign)
        u = M @ x + b
        expected = sign * np.einsum("ijk,k,j->i", c, x, u)
        size = np.einsum("ijk,k,j->i", np.abs(c), np.abs(x), np.abs(M) @ np.abs(x) + np.abs(b))
        assert np.all(np.abs(system.vector_field(x) - expected) <= 64 * n * n * U * size.max())
        np.testing.assert_allclose(sign * system.structure_matrix(x) @ u, expected, atol=64 * n * n * U * size.max())
        assert system.energy(x) == pytest.approx(x @ M @ x / 2 + b @ x, rel=1e-13)


@pytest.mark.parametrize("sign", [1, -1])
def test_time_reaches_the_jacobian(sign):
    """H = x . M(t) x / 2 + c(t) . x, on a linear bracket and on the same one as a function of x."""
    g, M = co.algebras.get("A3,7", a=1.75), np.array([[1.0, 0.25, 0.0], [0.25, -2.0, 0.5], [0.0, 0.5, 0.75]])

    def slope(x, t):
        return np.cos(t) * (M @ x) + np.array([t, 0.0, -t * t])

    H = co.Hamiltonian(lambda x, t: np.cos(t) * (x @ (M @ x)) / 2 + t * x[0] - t * t * x[2])
    constants = dense_constants(g)
    linear = co.LiePoissonSystem(g, H, sign=sign)
    curved = co.PoissonSystem(lambda x: constants @ x, H, dim=3, derivative=lambda x: constants, sign=sign)
    x = np.array([0.5, -1.5, 0.75])
    for system in (linear, curved):
        for t in (0.0, 0.7, -2.0):
            wanted = sign * (np.einsum("ijk,j->ik", constants, slope(x, t)) + np.cos(t) * (constants @ x) @ M)
            np.testing.assert_allclose(system.jacobian(x, t), wanted, rtol=0, atol=64 * U)
            np.testing.assert_allclose(system.vector_field(x, t), sign * (constants @ x) @ slope(x, t), atol=64 * U)


def test_known_casimirs_keep_their_names_unless_a_search_finds_more():
    # The weights are roots of s^2 - s - 1, so that a search in the sums below finds those of so(3) again.
    other = co.LieAlgebra.from_brackets(3, {(0, 2): {0: 1.0, 1: 1.0}, (1, 2): {0: 1.0}})
    both = co.algebras.direct_sum(co.algebras.so(3), other)
    assert both.dim - both.generic_rank() == 2
    assert co.LiePoissonSystem(both, co.Quadratic(1.0)).casimirs == {
        "|x|^2 [1]": co.Polynomial.variable(0, 6) ** 2
        + sum((co.Polynomial.variable(k, 6) ** 2 for k in (1, 2)), 0 * co.Polynomial.variable(0, 6))
    }
    # Of so(3) by its brackets none is known: the search finds both.
    c = dense_constants(co.algebras.so(3))
    unknown = co.algebras.direct_sum(co.LieAlgebra(c), co.algebras.so(3))
    found = co.LiePoissonSystem(unknown, co.Quadratic(1.0)).casimirs
    assert len(unknown.casimirs_known) < len(found) == 2
    gradients = [F.gradient(np.cos(np.arange(6.0))) for F in found.values()]
    assert np.linalg.matrix_rank(gradients) == 2


def test_functions_become_invariants():
    system = co.LiePoissonSystem(
        co.algebras.sl(2), co.Quadratic(1.0), casimirs={"C": lambda x: x[0] * x[2] + x[1] ** 2}
    )
    assert isinstance(system.casimirs["C"], co.Invariant)
    assert system.casimirs["C"]([1.0, 2.0, 3.0]) == 7.0
    by_number = co.LiePoissonSystem(co.algebras.sl(2), co.Quadratic(1.0), casimirs={2: system.casimirs["C"]})
    assert list(by_number.casimirs) == ["2"]


def test_pieces_must_commute():
    e3 = co.algebras.e(3)
    co.LiePoissonSystem(
        e3,
        co.SplitHamiltonian([((3, 4, 5), co.Quadratic(1.0)), ((0, 3), co.Quadratic(1.0)), ((1,), co.Quadratic(2.0))]),
    )
    wrong = co.SplitHamiltonian([((3, 4, 5), co.Quadratic(1.0)), ((4, 0), co.Quadratic(1.0))])
    for H in (wrong, co.Quadratic(np.arange(6.0)) + wrong):
        with refused(ValueError, "piece 1", "0 and 4"):
            co.LiePoissonSystem(e3, H)


@pytest.mark.parametrize("sign", [1, -1])
def test_everything_given_is_found_again(sign):
    so3 = co.algebras.so(3)
    turn = np.array([[0.0, 0.6, 0.8], [1.0, 0.0, 0.0], [0.0, 0.8, -0.6]])
    representation = np.array([turn @ E @ turn.T for E in so3.representation])

    def exact(x0, t, attitude):
        return x0, t, attitude

    layout = {"lattice": "graph", "shape": None}
    given = co.LiePoissonSystem(
        so3, co.Quadratic(1.0), np.float64(sign), representation=representation, name="own", exact=exact, layout=layout
    )
    np.testing.assert_array_equal(given.representation, representation)
    assert given.sign == sign and type(given.sign) is int and given.name == "own" and given.layout == layout
    assert given.exact(1, 2) == (1, 2, False) and given.exact(1, 2, 3) == (1, 2, 3)
    assert repr(given).startswith("<own: ") and f"on so(3), sign={sign:+d}: x'" in repr(given)
    plain = co.LiePoissonSystem(co.LieAlgebra(dense_constants(so3)), co.Quadratic(1.0), sign)
    assert plain.name == "Lie-Poisson system on g*" and plain.layout == {} and plain.representation is None
    assert f"on an algebra of dimension 3, sign={sign:+d}: " in repr(plain)
    curved = co.PoissonSystem(so3.structure_matrix, co.Quadratic(1.0), np.int8(sign), dim=np.int64(3), exact=exact)
    assert (curved.sign, curved.dim, curved.name) == (sign, 3, "Poisson system of dimension 3")
    assert type(curved.sign) is type(curved.dim) is int and curved.exact(1, 2, 3) == (1, 2, 3)
    assert repr(curved).endswith(f"J a function of x, sign={sign:+d}>")
    for system in (given, curved):
        forces = co.forces.LinearDamping(0.1), co.forces.LinearDamping(0.2), co.forces.LinearDamping(0.3)
        assert system.with_forces(*forces).forces == forces


def test_what_is_given_and_returned_is_copied():
    so3, square = co.algebras.so(3), co.Polynomial({(2, 0, 0): 1, (0, 2, 0): 1, (0, 0, 2): 1})
    given = {
        "casimirs": {"C": square},
        "integrals": {"x3": co.Polynomial({(0, 0, 1): 1})},
        "parameters": {"size": 2.0},
        "layout": {"lattice": "square", "shape": [2, 3]},
    }
    wanted = {key: dict(value) for key, value in given.items()} | {"layout": {"lattice": "square", "shape": (2, 3)}}
    system = co.LiePoissonSystem(so3, co.Quadratic([1.0, 1.0, 2.0]), **given)
    J = co.PoissonSystem(so3.structure_matrix, co.Quadratic(1.0), dim=3, casimirs=given["casimirs"])
    for mapping in given.values():
        mapping.clear()
    forced = system.with_forces(co.forces.LinearDamping(0.1))
    for one, key in ((J, "casimirs"), (forced, "casimirs"), *((system, key) for key in wanted)):
        getattr(one, key).clear()
        assert getattr(one, key) == wanted[key]
    with refused(AttributeError, "sign"):
        system.sign = -1
    x = np.array([1.0, 2.0, 3.0])
    system.structure_matrix(x)[0, 1] = system.hamiltonian.hessian(x)[0, 0] = system.hamiltonian.gradient(x)[0] = 9.0
    np.testing.assert_array_equal(system.vector_field(x), np.cross([1.0, 2.0, 6.0], x))


def _driven():
    def slope(x, t):
        return np.array([np.sinh(x[0]), 0.0, np.cos(t)])

    return co.LiePoissonSystem(co.algebras.so(3), co.Hamiltonian(lambda x, t: np.cosh(x[0]) + np.cos(t) * x[2], slope))


def _curved():
    J = lambda x: (x @ x) * np.array([[0, x[2], -x[1]], [-x[2], 0, x[0]], [x[1], -x[0], 0]])  # noqa: E731
    return co.PoissonSystem(J, co.Quadratic([1.0, 2.0, 3.0]))


SYSTEMS = {
    "quadratic": lambda: co.systems.rigid_body((1, 2, 3)),
    "non-unimodular": co.systems.paper_a37,
    "cubic": lambda: co.LiePoissonSystem(
        co.algebras.get("A4_8"), co.Polynomial({(1, 1, 1, 0): 1.0, (0, 0, 0, 2): 0.5})
    ),
    "functions of time": _driven,
    "a function J": _curved,
    "forces": lambda: co.systems.heavy_top().with_forces(
        co.forces.LinearDamping(0.1), co.forces.Torque((0.1, 0.1, 0.1))
    ),
    "tops": co.systems.kovalevskaya_top,
}


@pytest.mark.thinned(6)
@pytest.mark.parametrize("name", SYSTEMS)
@pytest.mark.parametrize("lead", [(5,), (3, 3), (2, 3, 2), (1,), (0,), (2, 0), (0, 3)])
def test_each_of_many_states_has_the_bits_that_it_has_alone(name, lead):
    system = SYSTEMS[name]()
    x = np.random.default_rng(3).normal(size=(*lead, system.dim))
    t = np.linspace(0.0, 2.0, lead[0])
    field, energy = system.vector_field(x, t), system.energy(x, t)
    assert field.shape == x.shape and energy.shape == lead
    for place in np.ndindex(*lead):
        assert (field[place] == system.vector_field(x[place], t[place[0]])).all()
        assert energy[place] == system.energy(x[place], t[place[0]])
    for casimir in system.casimirs.values():
        values = casimir(x)
        assert values.shape == lead
        for place in np.ndindex(*lead):
            # Polynomials of many states are summed monomial by monomial: some 20 terms of degree 4 at most.
            size = (1.0 + np.abs(x[place]).sum()) ** 4
            assert abs(values[place] - casimir(x[place])) <= 20 * 2.0**-53 * size


def test_one_time_serves_all_and_exact_numbers_stay_exact():
    system = _driven()
    x = np.random.default_rng(4).normal(size=(3, 3))
    assert (system.energy(x, 0.7) == [system.energy(row, 0.7) for row in x]).all()
    form = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1, 0.5, 0.25]), sign=-1)
    exact = form.vector_field(np.array([[Fraction(1), Fraction(2), Fraction(4)]] * 2))
    assert exact.dtype == object and exact.tolist() == [[Fraction(-2), Fraction(3), Fraction(-1)]] * 2

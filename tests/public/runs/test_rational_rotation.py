"""Rational rotations, tan(phi/2) := half the angle: Poisson where they are offered, refused elsewhere."""

import mpmath
import numpy as np
import pytest
import scipy.linalg

import coadjoint as co
from refusals import refused

pytestmark = pytest.mark.thinned(6)

U = 2.0**-53
I4 = np.array([[0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 0, -1], [0, 0, 1, 0]]) / 2
J4 = np.array([[0, 0, -1, 0], [0, 0, 0, 1], [1, 0, 0, 0], [0, -1, 0, 0]]) / 2
QUATERNIONS = np.array([I4, J4, 2 * I4 @ J4])  # spin one half: half the frequency of the coadjoint action
FULL = [[1.0, 0.25, 0.125], [0.25, 0.75, 0.375], [0.125, 0.375, 0.5]]
SO3, E3, SO4 = co.algebras.so(3), co.algebras.e(3), co.algebras.so(4)
TOP = co.Quadratic([1.0, 0.5, 0.375, 0, 0, 0], linear=[0, 0, 0, 0.75, 0.5, 1.0])


SCALED = co.LieAlgebra.from_brackets(3, {(0, 1): {2: 1.5}, (1, 2): {0: 1.5}, (0, 2): {1: -1.5}})
SYSTEMS = {
    "so(3) diagonal": co.LiePoissonSystem(SO3, co.Quadratic([1.0, 0.5, 0.25])),
    "so(3) full": co.LiePoissonSystem(SO3, co.Quadratic(FULL), sign=-1),
    "so(3) quartic": co.LiePoissonSystem(SO3, co.Polynomial({(4, 0, 0): 0.25, (0, 3, 0): 0.5, (0, 0, 2): 1.0})),
    "so(3) with another frequency": co.LiePoissonSystem(SCALED, co.Quadratic([1.0, 0.5, 0.25])),
    "e(3) heavy top": co.LiePoissonSystem(E3, TOP, sign=-1),
    "so(4) diagonal": co.LiePoissonSystem(SO4, co.Quadratic([2.0, 0.5, 0.75, 0.25, 0.5, 1.0])),
}
METHODS = {
    "order 1": co.Splitting(order=1, rotation="rational", parts="coordinates"),
    "order 2": co.Splitting(rotation="rational", parts="coordinates"),
    "order 4": co.Splitting(order=4, rotation="rational", parts="coordinates"),
    "first-order steps": co.Splitting(scheme="blanes_moan4", rotation="rational", parts="coordinates"),
    "processed": co.Splitting(scheme="blanes_casas_murua6", rotation="rational", parts="coordinates"),
}


def state(s):
    return np.linspace(-0.75, 1.25, s.dim)


@pytest.mark.thinned(28)
@pytest.mark.parametrize("name", SYSTEMS)
@pytest.mark.parametrize("method", METHODS)
def test_poisson_in_40_digits(name, method):
    """P J P^T = J, with the derivative by central differences in 80 digits, with an error of d^2."""
    s, method = SYSTEMS[name], METHODS[method]
    with mpmath.workdps(80):
        x0, h, d = np.array([mpmath.mpf(v) for v in state(s)], dtype=object), mpmath.mpf(0.5), mpmath.mpf(10) ** -22
        x = method.step(s, x0, 0, h)
        columns = [
            (method.step(s, x0 + d * unit, 0, h) - method.step(s, x0 - d * unit, 0, h)) / (2 * d)
            for unit in np.eye(s.dim, dtype=int).astype(object)
        ]
        P = np.stack(columns, axis=1)
        defect = P @ s.structure_matrix(x0) @ P.T - s.structure_matrix(x)
        assert np.max(np.abs(defect)) < 1e-35
        found = method.tangent(s, state(s), 0.0, 0.5)[1]
        assert np.max(np.abs(found - P)) < 1e-12 * np.max(np.abs(P))
        exact = co.Splitting(order=method.order).step(s, x0, 0, h)
        assert np.max(np.abs(exact - x)) > 1e-8  # it is another map


def test_nilpotent_generators_are_untouched():
    """On a Heisenberg algebra nothing turns: the same bits."""
    s = co.LiePoissonSystem(co.algebras.heisenberg(2), co.Quadratic([1.0, 2.0, 0.5, 0.25, 1.0]))
    runs = [co.integrate(s, state(s), (0, 1), 0.1, co.Splitting(rotation=r)) for r in ("exact", "rational")]
    assert np.array_equal(runs[0].x, runs[1].x)


VECTORS = SO3.representation


BOTH = np.array([scipy.linalg.block_diag(q, v) for q, v in zip(QUATERNIONS, VECTORS, strict=True)])
# The frequencies of a tensor product are the sums and differences of those of the factors.
PRODUCT = np.array([np.kron(q, np.eye(3)) + np.kron(np.eye(4), v) for q, v in zip(QUATERNIONS, VECTORS, strict=True)])
REPRESENTATIONS = {"1": VECTORS, "1/2": QUATERNIONS, "1/2 + 1": BOTH, "1/2 + 3/2": PRODUCT}


@pytest.mark.thinned(4)
@pytest.mark.parametrize("spins", REPRESENTATIONS)
@pytest.mark.parametrize("system", ["so(3) diagonal", "so(3) full", "so(3) quartic"])
@pytest.mark.parametrize("method", ["order 2", "first-order steps"])
def test_representations_with_several_frequencies(spins, system, method):
    """g rho(x) g^-1 is constant only if all blocks turn like the state, x -> A x; A agrees with that of vectors."""
    matrices, known = REPRESENTATIONS[spins], SYSTEMS[system]
    s = co.LiePoissonSystem(SO3, known.hamiltonian, sign=known.sign, representation=matrices)
    x0 = np.array([1.0, -0.5, 0.75])
    run = co.integrate(s, x0, (0, 4), 0.25, METHODS[method], attitude=True, save_every=16)
    g, rho = run.attitude[-1], [np.einsum("i,ijk->jk", x, matrices) for x in (x0, run.x[-1])]
    bound = 12 * len(g) * U * run.stats.evaluations
    assert np.max(np.abs(g.T @ g - np.eye(len(g)))) <= bound
    assert np.max(np.abs(g @ rho[1] @ g.T - rho[0])) <= 4 * bound * np.max(np.abs(rho[0]))
    turned = np.array([[-np.trace(g @ r @ g.T @ t) for r in matrices] for t in matrices]) / np.sum(matrices[0] ** 2)
    vectors = co.LiePoissonSystem(SO3, known.hamiltonian, sign=known.sign, representation=VECTORS)
    A = co.integrate(vectors, x0, (0, 4), 0.25, METHODS[method], attitude=True, save_every=16).attitude[-1]
    assert np.max(np.abs(turned - A)) <= 4 * bound and np.max(np.abs(A - np.eye(3))) > 0.1


RING = np.array([[0.5, 0.25], [0.25, 0.5]])
PRODUCT_OF_TWO = co.Hamiltonian(lambda y: y[0] * y[1], lambda y: np.array([y[1], y[0]]))
OTHERS = ("angle depends on other quantities",)
REFUSED = {
    "so(4) full": (co.LiePoissonSystem(SO4, co.Quadratic(np.eye(6) + 0.125)), ("x1", "x2", "nilpotent")),
    "sl(2)": (co.LiePoissonSystem(co.algebras.sl(2), co.Quadratic([2.0, 0.5, 0.75])), ("nilpotent",)),
    "A3,7": (co.systems.paper_a37(2.0, (1.0, 2.0, 0.01)), ("x3", "nilpotent")),
    "coupled angles": (
        co.LiePoissonSystem(SO4, co.SplitHamiltonian([((0, 5), co.Quadratic(RING)), ((1, 4), co.Quadratic(1.0))])),
        OTHERS,
    ),
    "a coupling function": (
        co.LiePoissonSystem(SO4, co.SplitHamiltonian([((0, 5), PRODUCT_OF_TWO), ((1, 4), co.Quadratic(1.0))])),
        OTHERS,
    ),
    "a coupling polynomial": (
        co.LiePoissonSystem(SO4, co.Polynomial({(1, 0, 0, 0, 0, 2): 0.5, (0, 2, 0, 0, 0, 0): 0.5})),
        OTHERS,
    ),
}


@pytest.mark.thinned(1)
@pytest.mark.parametrize("name", REFUSED)
def test_refused_where_it_would_not_be_poisson(name):
    s, named = REFUSED[name]
    with refused(ValueError, 'rotation="exact"', *named):
        co.integrate(s, state(s), (0, 1), 0.1, co.Splitting(rotation="rational", parts="coordinates"))

"""Geometry of steps: group elements of every scheme, and Gauss methods, Poisson maps where all brackets are central."""

import numpy as np
import pytest
from scipy.linalg import expm

import coadjoint as co
from digests.measures import drift_bounds, group_bound, order_of, poisson_defect
from digests.schemes_under_test import schemes, serves
from digests.systems_under_test import cases, full_matrix

pytestmark = pytest.mark.thinned(6)

BODY = cases()["so(3), diagonal"].system
ATTITUDES = {n: m.properties(BODY).attitude for n, m in schemes().items() if serves(m, BODY)}
SPLITTINGS = [n for n, kind in ATTITUDES.items() if kind == "every representation" and "free body" not in n]
REPRESENTED = [c for c, case in cases().items() if case.system.representation is not None]


def run_of(scheme, case, attitude, count=400, step=0.05):
    system, x0, _ = cases()[case]
    return co.integrate(
        system, x0, (0.0, count * step), step, schemes()[scheme], attitude=attitude, save_every=count // 4
    )


@pytest.mark.thinned(18)
@pytest.mark.parametrize("scheme", SPLITTINGS)
@pytest.mark.parametrize("case", REPRESENTED)
def test_representation_agrees_with_the_coadjoint_matrix(case, scheme):
    """g^(-1) rho(e_i) g = sum_j K_ij rho(e_j), where K x is constant."""
    system = cases()[case].system
    step = 0.01 if case in ("sl(2), driven", "A3,7, diagonal", "A3,7, full") else 0.05
    in_rho, in_K = (run_of(scheme, case, how, count=100, step=step) for how in (True, "coadjoint"))
    rho = system.representation
    for g, K in zip(in_rho.attitude, in_K.attitude, strict=True):
        turned = np.linalg.solve(g, rho @ g)
        size = np.linalg.cond(g) ** 2 * np.linalg.norm(K) * np.linalg.norm(rho)
        assert np.max(np.abs(turned - np.einsum("ij,jab->iab", K, rho))) <= group_bound(in_K, size)


@pytest.mark.thinned(12)
@pytest.mark.parametrize("scheme", SPLITTINGS)
@pytest.mark.parametrize("case", ["so(3), full, axes turned", "so(4), diagonal", "e(3), heavy top", "A3,7, full"])
def test_initial_elements_are_kept_bitwise_and_multiply_from_the_left(case, scheme):
    """Forward and backward, alone and in ensembles."""
    (system, x0, _), method = cases()[case], schemes()[scheme]
    # The first generator moves few axes: the other entries are zeros, of which half are made negative.
    given = expm(0.7 * system.representation[0])
    given[:2][given[:2] == 0.0] = -0.0
    for span in ((0.0, 0.1), (3.0, 2.9)):
        for x in (x0, np.array([x0, 0.5 * x0])):
            run, plain = (co.integrate(system, x, span, 0.05, method, attitude=each) for each in (given, True))
            assert run.attitude[0].tobytes() == np.broadcast_to(given, run.attitude[0].shape).tobytes()
            assert np.array_equal(plain.x, run.x)
            assert np.max(np.abs(run.attitude - given @ plain.attitude)) <= group_bound(plain, 3.0 * np.max(given))


@pytest.mark.thinned(1)
@pytest.mark.parametrize(
    "scheme", ["Splitting 2", "Splitting 4", "GaussLegendre 2", "Modified 1 gradient", "Modified 2 gradient", "rk4"]
)
@pytest.mark.parametrize("sign", [1, -1])
def test_attitude_has_the_order_of_the_scheme(scheme, sign):
    """Against the closed form in the principal axes of a full inertia tensor, for both signs."""
    moments, R = np.linalg.eigh(full_matrix(1, 3))
    R = R * np.linalg.det(R)
    system = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(R @ np.diag(moments) @ R.T), sign=sign)
    closed = co.systems.paper_rigid_body(tuple(moments))
    x0, method = np.array([1.0, -1.5, 1.2]), schemes()[scheme]
    # The closed form is that of the sign 1; the other sign is the motion backward.
    exact = R @ closed.exact(R.T @ x0, 2.0 * sign, attitude=True)[1] @ R.T
    counts = (32, 45, 64, 91, 128)
    errors = [
        np.linalg.norm(
            co.integrate(system, x0, (0.0, 2.0), 2.0 / n, method, attitude=True, save_every=n).attitude[-1] - exact
        )
        for n in counts
    ]
    found = order_of([2.0 / n for n in counts], errors, 2 if method.symmetric else 1)
    assert found.agrees_with(method.order), found


def nilpotent_and_other_algebras():
    """Return algebras whose brackets are all central, and others, by name."""
    brackets, named = co.LieAlgebra.from_brackets, co.algebras.get
    return {
        "abelian": brackets(3, {}),
        "heisenberg": named("heisenberg(n)", n=2),
        "three generators": brackets(6, {(0, 1): {3: 1.0}, (0, 2): {4: 1.0}, (1, 2): {5: 1.0, 3: -0.5}}),
        "affine": brackets(6, {(0, 1): {1: 1.0}}),
        "affine and heisenberg": brackets(6, {(0, 1): {1: 1.0}, (2, 3): {4: 1.0}}),
        "three steps": brackets(4, {(0, 1): {2: 1.0}, (0, 2): {3: 1.0}}),
        "oscillator": brackets(4, {(0, 1): {2: 1.0}, (0, 2): {1: -1.0}, (1, 2): {3: 1.0}}),
        "se(2)": named("se(n)", n=2),
        "so(4)": named("so(n)", n=4),
    }


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("name", list(nilpotent_and_other_algebras()))
def test_gauss_is_poisson_where_brackets_are_central(name, seed):
    """J is constant along all motions if and only if [[a, b], c] = 0."""
    rng, algebra = np.random.default_rng([11, seed]), nilpotent_and_other_algebras()[name]
    n = algebra.dim
    algebra = co.algebras.change_of_basis(algebra, np.eye(n, dtype=int)[rng.permutation(n)])
    B = rng.uniform(-0.2, 0.2, (n, n))
    H = co.Quadratic(np.diag(rng.uniform(0.5, 1.0, n)) + B + B.T, linear=rng.uniform(0.2, 0.5, n))
    system, x = co.LiePoissonSystem(algebra, H, sign=(-1, 1)[seed % 2]), rng.uniform(0.5, 1.0, n)
    constants = np.array([system.structure_matrix(unit) for unit in np.eye(n)])  # (k, i, j)
    central = not np.einsum("kij,mkl->ijlm", constants, constants).any()
    halves = co.Composition(co.GaussLegendre(1), (0.5, 0.5))
    for method in (co.GaussLegendre(1), co.GaussLegendre(2), halves):
        found = poisson_defect(co.stepper(system, method, 0.25), x)
        assert method.properties(system).poisson == central
        # The defect is h^3 or h^5 times a derivative of size one.
        assert found.value <= found.bound if central else found.value > 1000 * found.bound, found


def quadratic_bracket(x):
    """Lotka-Volterra, a Poisson bracket that is not linear in x."""
    a, b, c = x[0] * x[1], x[1] * x[2], x[2] * x[0]
    return np.array([[0.0, a, -c], [-a, 0.0, b], [c, -b, 0.0]])


def test_gauss_on_a_nonlinear_bracket():
    """A linear H is preserved, the Casimir x1 x2 x3 is not."""
    casimir = co.Polynomial({(1, 1, 1): 1})
    system = co.PoissonSystem(
        quadratic_bracket, co.Polynomial({(1, 0, 0): 1, (0, 1, 0): 1, (0, 0, 1): 1}), casimirs={"x1 x2 x3": casimir}
    )
    run = co.integrate(system, (1.0, 0.5, 0.7), (0.0, 50.0), 0.25, co.GaussLegendre(2), save_every=10)
    bounds = drift_bounds(run)
    assert run.drift()["energy"] <= bounds["energy"]
    assert run.drift()["x1 x2 x3"] > 1000 * bounds["x1 x2 x3"]
    assert run.drift()["x1 x2 x3"] < 1e-3

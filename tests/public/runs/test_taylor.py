"""Taylor series: exact numbers, the compiled step against the plain one, the projection."""

from concurrent.futures import ThreadPoolExecutor
from fractions import Fraction

import numpy as np
import pytest

import coadjoint as co
from energies import polynomial
from refusals import refused

pytestmark = pytest.mark.thinned(3)

U = 2.0**-53


def random_matrix(n, seed, density=1.0):
    rng = np.random.default_rng(seed)
    B = rng.uniform(-1.0, 1.0, (n, n)) * (rng.uniform(size=(n, n)) < density)
    return np.round(np.diag(np.linspace(0.5, 1.5, n)) + 0.2 * (B + B.T), 3)


def spins(count, M):
    return co.LiePoissonSystem(co.algebras.copies(co.algebras.so(3), count), co.Quadratic(M))


def affine(n, M, linear=0.0):
    """Return a system in which one coordinate acts on the others by a random matrix: many products have one factor."""
    A = np.random.default_rng(n).integers(-4, 5, (n - 1, n - 1)) / 4
    brackets = {(n - 1, i): {k: A[k, i] for k in range(n - 1) if A[k, i]} for i in range(n - 1)}
    return co.LiePoissonSystem(co.LieAlgebra.from_brackets(n, brackets), co.Quadratic(M, linear=np.full(n, linear)))


def systems():
    """One to many vectors of rows, products written out, factored and with a gradient, linear parts, every degree."""
    e3, so4 = co.algebras.e(3), co.algebras.so(4)
    return {
        "so(3), diagonal": co.systems.rigid_body(inertia=(1, 2, 2.5)),
        "so(3), full": co.LiePoissonSystem(
            co.algebras.so(3), co.Quadratic(random_matrix(3, 1), linear=[0.5, 0, -0.25])
        ),
        "sl(2)": co.LiePoissonSystem(co.algebras.sl(2), co.Quadratic(random_matrix(3, 2)), sign=-1),
        "gl(2)": co.LiePoissonSystem(co.algebras.gl(2), co.Quadratic(random_matrix(4, 3))),
        "A3,7": co.LiePoissonSystem(co.algebras.A3_7(2.0), co.Quadratic([1.0, 0.5, 0.25])),
        "heavy top": co.LiePoissonSystem(
            e3, co.Quadratic([1.0, 0.5, 0.25, 0, 0, 0], linear=[0, 0, 0, 0.75, 0.5, 1.0]), sign=-1
        ),
        "so(4), full": co.LiePoissonSystem(so4, co.Quadratic(random_matrix(6, 4))),
        "su(3), full": co.LiePoissonSystem(co.algebras.su(3), co.Quadratic(random_matrix(8, 5))),
        "so(5)": co.LiePoissonSystem(co.algebras.so(5), co.Quadratic(np.linspace(0.5, 1.5, 10))),
        "5 spins": spins(5, random_matrix(15, 6, 0.2)),
        "8 spins": spins(8, random_matrix(24, 7, 0.1)),
        "10 spins": spins(10, random_matrix(30, 8, 0.1)),
        "13 spins": spins(13, random_matrix(39, 9, 0.05)),
        "5 particles": co.systems.toda(5),
        "8 particles": co.systems.toda(8),
        "affine, 3": affine(3, [1.0, 0.5, 0.75], 0.25),
        "affine, 4": affine(4, random_matrix(4, 14), 0.25),
        "affine, 6": affine(6, np.linspace(0.5, 1.5, 6), 0.25),
        "affine, 6, full": affine(6, random_matrix(6, 15)),
        "affine, 8": affine(8, np.linspace(0.5, 1.5, 8)),
        "affine, 9, full": affine(9, random_matrix(9, 16), 0.25),
        "affine, 14": affine(14, np.linspace(0.5, 1.5, 14), 0.25),
        "so(3), cubic": co.LiePoissonSystem(co.algebras.so(3), polynomial(3, 3, 10)),
        "e(3), quartic": co.LiePoissonSystem(e3, polynomial(6, 4, 11), sign=-1),
        "so(4), quintic": co.LiePoissonSystem(so4, polynomial(6, 5, 12)),
        "4 spins, quartic": co.LiePoissonSystem(co.algebras.copies(co.algebras.so(3), 4), polynomial(12, 4, 13)),
    }


def start_of(system):
    x = np.random.default_rng(system.dim).uniform(-1.0, 1.0, system.dim)
    return x / np.linalg.norm(x) * np.sqrt(max(1.0, system.dim / 6))


def one_step(system, method, x, h):
    return co.integrate(system, x, (0.0, h), abs(h), method, watch=False).x[-1]


@pytest.mark.thinned(12)
@pytest.mark.parametrize("order", [12, 16, 23, 24, 25, 26, 33, 64])
@pytest.mark.parametrize("name", ["so(3), full", "heavy top", "so(4), full", "8 spins", "13 spins", "so(3), cubic"])
def test_high_orders_are_exact(name, order):
    """A step so short that the series has converged to round-off is that of Gauss with 10 stages."""
    system = systems()[name]
    x, h = start_of(system), 0.125
    exact = co.integrate(system, x, (0.0, h), h / 2, co.GaussLegendre(10), watch=False).x[-1]
    found = one_step(system, co.Taylor(order, projected=False), x, h)
    assert np.max(np.abs(found - exact)) < 64 * np.sqrt(system.dim) * U * np.linalg.norm(x)


@pytest.mark.thinned(1)
@pytest.mark.parametrize("order", [2, 8, 25])
def test_products_that_cancel_move_nothing(order):
    """A sphere rests exactly where products are of coordinates, also beside rows of more products in other vectors."""
    affine = {(3 + 2 * k, 4 + 2 * k): {4 + 2 * k: 1.0} for k in range(2)}
    algebra = co.LieAlgebra.from_brackets(7, {(0, 1): {2: 1.0}, (1, 2): {0: 1.0}, (0, 2): {1: -1.0}, **affine})
    M = np.diag([0.7, 0.7, 0.7, 1.0, 0.8, 0.6, 1.2])
    M[[3, 4, 5, 6], [4, 3, 6, 5]] = 0.3
    x0 = np.array([0.3, -0.7, 0.61, 0.2, 0.5, -0.4, 0.1])
    x = co.integrate(co.LiePoissonSystem(algebra, co.Quadratic(M)), x0, (0.0, 4.0), 0.25, co.Taylor(order, False)).x
    assert np.array_equal(x[:, :3], np.tile(x0[:3], (len(x), 1)))
    assert np.all(np.abs(x[-1, 3:] - x0[3:]) > 1e-3)


def test_fractions_give_the_exact_polynomial_in_the_step():
    system = co.systems.rigid_body(inertia=(1, 2, 2.5))
    x = np.array([Fraction(1), Fraction(1, 2), Fraction(-1, 3)], dtype=object)
    f = system.vector_field
    h = Fraction(1, 10)
    euler = co.Taylor(1, projected=False).step(system, x, 0, h)
    assert list(euler) == list(x + h * f(x))
    # The second coefficient of a quadratic field is f'(x) f(x) / 2, and f' v = (f(x + v) - f(x - v)) / 2.
    bent = (f(x + f(x)) - f(x - f(x))) / 2
    assert list(co.Taylor(2, projected=False).step(system, x, 0, h)) == list(euler + h * h * bent / 2)
    with refused(TypeError, "projected=False"):
        co.Taylor(2).step(system, x, 0, h)


@pytest.mark.thinned(6)
@pytest.mark.parametrize("name", list(systems()))
def test_invariants_stay_for_ever(name):
    """Not a random walk: after every step they are what they were at the start, up to rounding."""
    system = systems()[name]
    steps = 20_000 if system.dim <= 6 else 2_000
    sol = co.integrate(system, start_of(system), (0.0, steps / 16), 1 / 16, co.Taylor(6), save_every=steps)
    for invariant, drift in sol.drift(relative=False).items():
        what = system.hamiltonian if invariant == "energy" else system.casimirs[invariant]
        if isinstance(what, co.Invariant):
            continue
        size = float(np.abs(sol.x[0]) @ np.abs(what.gradient(sol.x[0])))
        assert drift < 64 * U * (size + abs(float(sol.energy[0]))), invariant
    lost = co.integrate(system, start_of(system), (0.0, 20.0), 1 / 16, co.Taylor(3, projected=False)).drift()["energy"]
    assert lost.absolute > 1e-9


@pytest.mark.thinned(1)
@pytest.mark.parametrize(
    ("system", "x0"),
    [
        (co.systems.rigid_body(inertia=(1, 2, 2.5)), (0.0, 0.0, 2.0)),
        (co.systems.rigid_body(inertia=(1, 2, 2.5)), (0.0, 1e-9, 2.0)),
        (co.systems.rigid_body(inertia=(2, 2, 2)), (0.5, 1.0, -0.25)),
        (spins(2, np.ones((6, 6)) * 0), (1.0, 0.0, 0.0, 0.0, 1.0, 0.0)),
        (co.systems.rigid_body(inertia=(1, 2, 2.5)), (0.0, 0.0, 0.0)),
    ],
    ids=["steady", "nearly steady", "sphere", "no energy", "zero"],
)
def test_dependent_gradients_are_no_obstacle(system, x0):
    """Where the energy is a function of the Casimirs there is nothing to restore in its direction."""
    sol = co.integrate(system, x0, (0.0, 50.0), 0.25, co.Taylor(8))
    assert np.max(np.abs(np.linalg.norm(sol.x, axis=1) - np.linalg.norm(x0))) <= 8 * U * np.linalg.norm(x0)
    if system.name == "rigid_body" and x0[0] == 0.0:
        assert np.max(np.abs(sol.x - x0)) < 1e-6 * max(1.0, np.linalg.norm(x0))


@pytest.mark.parametrize("size", [1.0, 2.0**-20, 2.0**20])
@pytest.mark.parametrize("method", [co.Taylor(16), co.Taylor(tolerance=1e-12)], ids=str)
def test_terms_of_a_gradient_may_cancel(method, size):
    """Where C = (x2 + x3)^2 (2 x2 - x3) is all but flat, its rounding is larger than all that its slope can tell."""
    algebra = co.LieAlgebra.from_brackets(3, {(0, 1): {1: -1.0, 2: 1.0}, (0, 2): {1: 2.0}})
    shape = {(1, 0, 2): -0.25, (3, 1, 0): 0.375, (1, 0, 0): 0.5, (2, 0, 1): -1.125, (0, 1, 2): -1.25}
    # The motion of states of another size is the same.
    H = co.Polynomial({powers: value * size ** (1 - sum(powers)) for powers, value in shape.items()})
    system = co.LiePoissonSystem(algebra, H)
    (C,) = system.casimirs.values()
    for start in (1e-3, 1e-4, 1e-5):
        x0 = size * start * np.array([-0.5, -0.04, 0.56])
        exact = co.integrate(system, x0, (0.0, 8.0), 1 / 64, co.Taylor(24, projected=False), watch=False).x[-1]
        sol = co.integrate(system, x0, (0.0, 8.0), 1 / 16, method)
        rounding = [4 * U * 3 * np.sum(np.abs([2, 3, -1]) * np.abs(x[1:]).max() ** 3) for x in sol.x]
        moved = [error / np.linalg.norm(C.gradient(x)) for error, x in zip(rounding, sol.x, strict=True)]
        assert np.max(np.abs(sol.x[-1] - exact)) < 2 * max(moved)
        assert sol.drift(relative=False)["C3"] < 2 * max(rounding)
        ensemble = co.integrate(system, np.array([x0, 0.5 * x0, x0]), (0.0, 8.0), 1 / 16, method, save_every=128)
        assert np.array_equal(ensemble.x[-1, [0, 2]], sol.x[[-1, -1]])
        for x in sol.x[80:128:8]:
            # Here the reading and the loops differ by no more than a defect that both take for rounding.
            read, found = method.step(system, x, 0.0, 1 / 16), one_step(system, method, x, 1 / 16)
            assert np.max(np.abs(read - found)) < 4 * max(moved)


def test_a_step_that_is_too_long_says_so():
    system = systems()["so(4), full"]
    with refused(co.IntegrationError, "smaller step"):
        co.integrate(system, start_of(system), (0.0, 200.0), 20.0, co.Taylor(12))
    with refused(co.IntegrationError, "smaller step"):
        co.Taylor(12).step(system, start_of(system), 0.0, 40.0)


def test_short_calls_of_many_systems_do_not_meet():
    """A thread remembers the steps that it made last, by the number of their tables: more systems than it remembers."""
    bodies = [co.systems.rigid_body(inertia=(1.0, 2.0, 2.25 + k / 64)) for k in range(40)]
    ready = [co.prepare(body, co.Taylor(10), 0.25, threads=1) for body in bodies]
    x0, span = (0.6, 0.1, -0.7), (0.0, 1.0)
    alone = [co.integrate(body, x0, span, 0.25, co.Taylor(10)).x for body in bodies]
    assert not np.array_equal(alone[0], alone[16])
    for _ in range(2):
        for run, x in zip(ready, alone, strict=True):
            assert np.array_equal(run.run(x0, span).x, x)
    with ThreadPoolExecutor(4) as pool:
        for found, x in zip(pool.map(lambda run: run.run(x0, span).x, ready), alone, strict=True):
            assert np.array_equal(found, x)


@pytest.mark.parametrize("scale", [2.0**-20, 1.0, 2.0**20])
def test_weights_of_any_size_are_factored(scale):
    """A sum whose weights cannot be divided by its first one without loss is not scaled."""
    brackets = {(3, 1): {0: 2.0**500, 1: 0.25, 2: -0.7 * 2.0**-540}}
    system = co.LiePoissonSystem(co.LieAlgebra.from_brackets(4, brackets), co.Quadratic([0, 0, 0, scale]))
    x, h = np.array([2.0**-500, 1.0, 2.0**540, 1.0]), 0.5 / scale
    found = one_step(system, co.Taylor(4, projected=False), x, h)
    read = co.Taylor(4, projected=False).step(system, x, 0.0, h)
    assert np.allclose(found, read, rtol=64 * U, atol=0.0)


def test_casimirs_that_are_functions_are_not_restored():
    system = co.LiePoissonSystem(co.algebras.A3_7(2.0), co.Quadratic([1.0, 0.5, 0.25]))
    assert all(isinstance(C, co.Invariant) for C in system.casimirs.values())
    assert co.Taylor(4).properties(system).casimirs == "none"
    square = co.Polynomial({(2, 0, 0): 1.0, (0, 2, 0): 1.0, (0, 0, 2): 1.0})
    both = {"|x|^2": square, "|x|": co.Invariant(lambda x: np.sqrt(x[0] ** 2 + x[1] ** 2 + x[2] ** 2))}
    mixed = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1.0, 0.5, 0.25]), casimirs=both)
    assert co.Taylor(4).properties(mixed).casimirs == "polynomial"
    assert co.Taylor(4).properties(systems()["heavy top"]).casimirs == "all"
    assert co.Taylor(4, projected=False).properties(systems()["heavy top"]).casimirs == "none"


def test_a_finer_series_has_a_tolerance_that_exists():
    for tolerance in (1e-3, 3e-17, 1e-18):
        found = co.Taylor(12, tolerance=tolerance).finer(20, 1.5)
        assert found.method.tolerance == max(tolerance / 48.0, 1e-18) and found.method.order == 14
        assert found.left == min(0.5, found.method.tolerance / tolerance)
        assert co.Taylor(64, tolerance=tolerance).finer(20, 1.5).method.order == 64

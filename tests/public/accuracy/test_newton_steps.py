"""Steps by Newton's method, dense, banded or without a matrix."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest
from scipy.optimize import root
from stage_systems import spin_chain, systems

import coadjoint as co
from rounding import UNIT_ROUNDOFF as U

X0 = np.array([2.0, -1.0, 1.5, 1.0, 0.5, -0.75])


def solved(system, method, x, t, h):
    """One step, its stages by SciPy from X = x; also the defect of its stages."""
    node, scale, mix, out = method.coefficients()

    def slopes(X):
        return np.stack([h * b * system.vector_field(y, t + c * h) for y, c, b in zip(X, node, scale, strict=True)])

    def defect(flat):
        X = flat.reshape(node.size, x.size)
        return (X - x - mix @ slopes(X)).ravel()

    found = root(defect, np.tile(x, node.size), tol=1e-14)
    return x + out @ slopes(found.x.reshape(node.size, x.size)), np.max(np.abs(defect(found.x)))


@pytest.mark.thinned(10)
@pytest.mark.parametrize("stages", [1, 3, 8])
@pytest.mark.parametrize("name", list(systems()))
def test_large_steps_against_scipy(name, stages):
    """Wherever SciPy finds the solution that we find; errors are those of the defect, times what solving amplifies."""
    system, x = systems()[name]
    method, agreed = co.GaussLegendre(stages), 0
    # driven solutions blow up soon after
    for h in (0.5, 1.0) if name == "driven" else (0.5, 1.0, 2.0):
        expected, defect = solved(system, method, x, 0.3, h)
        if defect > 1e-13:
            continue
        run = co.integrate(system, x, (0.3, 0.3 + h), h, method)
        # iterations beyond two looks: by Newton
        agreed += run.stats.iterations > 32
        assert np.max(np.abs(run.x[-1] - expected)) < 1e-11 * np.max(np.abs(expected))
    # eight stages of these systems converge up to h = 1 or 2 by iteration alone
    assert agreed >= (0 if stages == 8 else 1)


def test_a_stiff_system_against_30_digits():
    """Rates 1 and 100 on so(3) x so(3): h f' is 10, and Newton's method is taken at every step."""
    rows = [(0, 1, 2, 1.0), (1, 2, 0, 1.0), (2, 0, 1, 1.0), (3, 4, 5, 1.0), (4, 5, 3, 1.0), (5, 3, 4, 1.0)]
    moments = [1.0, 0.5, 0.25, 100.0, 50.0, 25.0]
    system = co.LiePoissonSystem(co.LieAlgebra(rows, dim=6), co.Quadratic(moments))
    x = np.array([1.0, 0.5, -0.75, 0.5, 1.0, -0.25])
    method, h, steps = co.GaussLegendre(2), 0.1, 5
    run = co.integrate(system, x, (0.0, steps * h), h, method)
    with mpmath.workdps(30):
        exact = np.array([mpmath.mpf(float(v)) for v in x], dtype=object)
        for _ in range(steps):
            exact = exact + stages_by_newton(system, method, exact, h, mpmath.mpf)[1].sum(axis=0)
        error = max(abs(float(a) - b) for a, b in zip(exact, run.x[-1], strict=True))
    # each step rounds h f, of size 10, and a later one amplifies that by at most its condition, here below 20
    assert error < steps * 10 * 20 * 8 * U
    assert run.stats.iterations < 16 + 50 * steps
    assert max(run.drift().values()) < 6 * 4 * 6 * U * 100 * np.sqrt(steps)


RATES = np.array([4.0, 2.0, 3.0, 1.0, 5.0, 2.5])
# Rates at time 0 would have the opposite sign.
LATE = 64.5 * np.pi / 4.0


@pytest.mark.filterwarnings("ignore::coadjoint.LargeStepWarning")
@pytest.mark.parametrize(
    ("algebra", "h"), [(co.algebras.e(3), 0.3), (co.algebras.copies(co.algebras.so(3), 2), 0.15)], ids=repr
)
@pytest.mark.parametrize("span", [(0.0, 0.6), (0.6, 0.0)])
def test_the_jacobian_is_that_of_the_time_of_the_step(algebra, h, span):
    """Rates that change with time: the same motion, in few corrections, when all times are later."""

    def run(late):
        H = co.Hamiltonian(
            lambda x, t: 0.5 * (0.5 + np.sin(4.0 * (t - late))) * np.sum(RATES * x**2),
            lambda x, t: (0.5 + np.sin(4.0 * (t - late))) * RATES * x,
        )
        times = (span[0] + late, span[1] + late)
        return co.integrate(co.LiePoissonSystem(algebra, H), X0, times, h, co.GaussLegendre(2))

    now, later = run(0.0), run(LATE)
    # Newton's method follows the first test for slow convergence, after 16 iterations, and takes less than ten.
    assert 16 < now.stats.iterations / round(0.6 / h) < 26
    assert 16 < later.stats.iterations / round(0.6 / h) < 26
    # Times are rounded by LATE u, the rates by as much, and angles are below 100.
    np.testing.assert_allclose(later.x, now.x, rtol=0, atol=100 * LATE * U * np.linalg.norm(X0))


def stages_by_newton(system, method, x, h, number=float):
    """Newton iterations in NumPy, their defects in any number type."""
    _, scale, mix, _ = method.coefficients(number)
    s, n = scale.size, x.size
    X = np.stack([x] * s)
    lengths = [number(h) * b for b in scale]
    for _ in range(50):
        L = np.stack([length * system.vector_field(y) for y, length in zip(X, lengths, strict=True)])
        W = [float(length) * system.jacobian(y.astype(float)) for y, length in zip(X, lengths, strict=True)]
        J = np.eye(s * n) - np.block([[float(mix[i, j]) * W[j] for j in range(s)] for i in range(s)])
        defect = (x + mix @ L - X).ravel()
        size = float(np.max(np.abs(defect)))
        change = np.linalg.solve(J, (defect / (size or 1.0)).astype(float))
        X = X + change.reshape(s, n) * size
        if size < (1e-13 if number is float else 1e-25):
            return X, L
    raise AssertionError("Newton's method in NumPy did not converge")


@pytest.mark.parametrize("freeze", ["structure", "gradient"])
def test_large_linear_stages_beyond_the_iteration(freeze):
    """60 spins with a step at which iterating the linear system diverges: solved without a matrix, invariants kept."""
    system, x0 = spin_chain(60)
    method, h = co.ModifiedGaussLegendre(1, freeze=freeze), 2.0
    found = co.stepper(system, method, h)(x0)
    # both are backward stable: 64 u times the condition of the system in the frozen point, reached by one iteration
    frozen = x0 + 0.5 * h * system.vector_field(x0)
    gradient, M = system.hamiltonian.gradient(frozen), system.hamiltonian.hessian(frozen)
    W = system.structure_matrix(frozen) @ M if freeze == "structure" else system.algebra.coadjoint(gradient)
    bound = 64 * U * np.linalg.cond(np.eye(x0.size) - 0.5 * h * W) * np.max(np.abs(found))
    assert np.max(np.abs(found - method.step(system, x0, 0.0, h))) < bound < 1e-8
    run = co.integrate(system, x0, (0.0, 3 * h), h, method)
    size = 180 * np.max(np.abs(run.x)) ** 2
    assert run.drift()["energy" if freeze == "structure" else "S"] < 6 * 4 * size * U * np.sqrt(3)


@pytest.mark.thinned(5)
@pytest.mark.parametrize("algebra", [co.algebras.so(3), co.algebras.e(3), co.algebras.su(3)], ids=repr)
@pytest.mark.parametrize("stages", [16, 20])
@pytest.mark.parametrize("span", [(0, 3), (3, 0)])
def test_many_stages_of_a_large_rotation_carry_the_group_element(algebra, stages, span):
    """Six turns in a step: the momentum is solved for, so the group element is."""
    direction = np.linspace(1.0, 2.0, algebra.dim)
    fast = 36.0 * direction / np.linalg.norm(direction)
    system = co.LiePoissonSystem(algebra, co.Quadratic(0.1 * direction, linear=fast))
    x0 = np.cos(np.arange(algebra.dim))
    run = co.integrate(system, x0, span, 1.0, co.GaussLegendre(stages), attitude="coadjoint")
    assert np.array_equal(run.x, co.integrate(system, x0, span, 1.0, co.GaussLegendre(stages)).x)
    # Each step rounds a product of the element with vectors of size |x|, and what a solution of stages amplifies.
    returned = np.einsum("kij,kj->ki", run.attitude, run.x)
    size = np.abs(run.attitude).max() * np.abs(run.x).max()
    assert np.abs(returned - x0).max() <= 64 * U * algebra.dim * stages * size

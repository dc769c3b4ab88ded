"""Runge-Kutta methods: steps of the loops and of `Method.step`, Newton's method, the end of iterations, failures."""

from __future__ import annotations

import math

import mpmath
import numpy as np
import pytest
from scipy.optimize import root

import coadjoint as co
from drawn_matrices import full
from refusals import refused
from rounding import UNIT_ROUNDOFF as U

TWO_SPINS = co.algebras.copies(co.algebras.so(3), 2)


def nonlinear_structure(x):
    a, b, c = x[1] * x[2], x[0] * x[2], x[0] * x[1] + 2.0 * x[2]
    return np.array([[0.0, -c, b], [c, 0.0, -a], [-b, a, 0.0]])


def driven(x, t):
    return 0.5 * x[0] * x[0] * (1.0 + math.sin(t)) + x[1] * x[2] + math.cos(2.0 * t) * x[1] * x[1]


def driven_gradient(x, t):
    return np.array([x[0] * (1.0 + math.sin(t)), x[2] + 2.0 * math.cos(2.0 * t) * x[1], x[1]])


def coupled(n):
    return co.Quadratic(full(n, 0, 0.4, (0.5, 1.5)))


def systems():
    """Systems with stages of every kind: quadratic, quartic and driven Hamiltonians, and a nonlinear bracket."""
    so4, e3 = co.algebras.so(4), co.algebras.e(3)
    gravity = co.Quadratic([1.0, 0.5, 0.4, 0.0, 0.0, 0.0], linear=[0.0, 0.0, 0.0, 0.75, 0.5, 1.0])
    quartic = co.Polynomial(
        {(2, 0, 0, 0, 0, 0): 0.5, (0, 1, 0, 0, 1, 0): 0.25, (0, 0, 0, 1, 1, 1): 1.0, (0, 0, 4, 0, 0, 0): 0.5}
    )
    six = np.array([1.0, 0.5, -0.25, 0.75, -1.0, 0.375])
    return {
        "top": (co.LiePoissonSystem(e3, gravity, sign=-1), np.array([1.0, -0.5, 1.5, 0.6, 0.0, 0.8])),
        "so(4)": (co.LiePoissonSystem(so4, coupled(6)), six),
        "A3,7": (
            co.LiePoissonSystem(co.algebras.A3_7(1.5), co.Quadratic(full(3, 0, 0.4, (0.5, 1.5)))),
            np.array([0.75, 0.5, 0.625]),
        ),
        "sl(2)": (co.LiePoissonSystem(co.algebras.sl(2), co.Quadratic([1.0, 2.0, 3.0])), np.array([1.0, 0.5, -0.25])),
        "quartic": (co.LiePoissonSystem(e3, quartic, sign=-1), six),
        "driven": (
            co.LiePoissonSystem(co.algebras.sl(2), co.Hamiltonian(driven, driven_gradient)),
            np.array([1.0, 0.5, -0.25]),
        ),
        "nonlinear J": (
            co.PoissonSystem(nonlinear_structure, co.Quadratic([1.0, 0.5, 0.25]), sign=-1),
            np.array([0.75, 0.5, -0.625]),
        ),
    }


def spin_chain(spins):
    algebra = co.algebras.copies(co.algebras.so(3), spins)
    M = np.zeros((3 * spins, 3 * spins))
    for i in range(spins):
        j = (i + 1) % spins
        for a, coupling in enumerate((1.0, 0.5, 0.25)):
            M[3 * i + a, 3 * j + a] += coupling
            M[3 * j + a, 3 * i + a] += coupling
    S = co.Polynomial({tuple(2 * (k == i) for k in range(3 * spins)): 1 for i in range(3 * spins)})
    x0 = np.random.default_rng(5).standard_normal((spins, 3))
    x0 /= np.linalg.norm(x0, axis=1, keepdims=True)
    return co.LiePoissonSystem(algebra, co.Quadratic(M), casimirs={"S": S}), x0.ravel()


def test_round_off_of_gauss_8_has_no_bias():
    """At t = 20000 a random walk: with plainly rounded coefficients the energy is off by 3e-13, with one sign."""
    body = co.systems.rigid_body(inertia=(1, 2, 3))
    run = co.integrate(body, (1.0, 2.0, 0.5), (0.0, 20000.0), 0.25, co.GaussLegendre(8), save_every=10**6)
    assert run.drift()["energy"] < 2 * U * run.energy[0] * math.sqrt(run.stats.steps)


@pytest.mark.parametrize("stages", [2, 3, 4, 5, 7, 8, 9, 12, 16, 17, 33])
@pytest.mark.parametrize("name", ["top", "quartic", "driven"])
def test_any_number_of_stages(name, stages):
    """Blocks of 4, 8 and 16 lanes, full and not: both round n products in each of the s stages, times h |f'| < 1."""
    system, x = systems()[name]
    method = co.GaussLegendre(stages)
    found, expected = co.stepper(system, method, 0.125)(x, 0.75), method.step(system, x, 0.75, 0.125)
    assert np.max(np.abs(found - expected)) <= 8 * len(x) * U * np.max(np.abs(x))


def test_an_equilibrium_stays():
    """All corrections vanish at once: no iteration is left hanging, and no step is lost."""
    body = co.systems.rigid_body(inertia=(1, 2, 3))
    for x0 in ((0.0, 0.0, 2.0), (0.0, 0.0, 0.0)):
        run = co.integrate(body, x0, (0.0, 1.0), 0.1, co.GaussLegendre(3))
        assert np.array_equal(run.x[-1], x0)
        assert run.stats.iterations == 10


def test_components_of_different_size_are_all_converged():
    """|x1| = 1e6 against 1e-3: the small component is as accurate, relatively, as where it stands alone."""
    system = co.LiePoissonSystem(
        co.algebras.copies(co.algebras.so(3), 2), co.Quadratic([1e-6, 2e-6, 3e-6, 1e3, 2e3, 3e3])
    )
    large, small = np.array([1.0, 0.5, -0.75]) * 1e6, np.array([0.5, 1.0, -0.25]) * 1e-3
    found = co.stepper(system, co.GaussLegendre(4), 0.5)(np.concatenate([large, small]))
    with mpmath.workdps(40):
        x = np.array([mpmath.mpf(v) for v in np.concatenate([large, small])], dtype=object)
        exact = co.GaussLegendre(4).step(system, x, 0, 0.5)
    error = np.array([float(v) for v in exact - found])
    assert np.max(np.abs(error[:3])) < 32 * U * 1e6
    assert np.max(np.abs(error[3:])) < 32 * U * 1e-3


def test_slopes_of_the_step_before_save_iterations():
    """Against steps each of which begins without them."""
    (system, x0), method = systems()["top"], co.GaussLegendre(8)
    run, alone = co.integrate(system, x0, (0.0, 6.0), 0.1, method), 0
    for x in run.x[:-1]:
        step = co.integrate(system, x, (0.0, 0.1), 0.1, method)
        alone += step.stats.iterations
    assert run.stats.iterations < 0.75 * alone


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


@pytest.mark.thinned(1)
@pytest.mark.parametrize("freeze", ["structure", "gradient"])
@pytest.mark.parametrize(("spins", "h", "steps"), [(12, 0.1, 100), (60, 0.1, 100), (60, 2.0, 3)])
def test_linear_stages_of_large_systems(spins, h, steps, freeze):
    """By factors, by iteration, and where iteration diverges; one invariant is kept, and the other is not.

    Both readings are backward stable: 64 u times the condition of the system in the frozen point, reached by iteration.
    """
    (system, x0), method = spin_chain(spins), co.ModifiedGaussLegendre(1, freeze=freeze)
    found = co.stepper(system, method, h)(x0)
    frozen = x0 + 0.5 * h * system.vector_field(x0)
    gradient, M = system.hamiltonian.gradient(frozen), system.hamiltonian.hessian(frozen)
    W = system.structure_matrix(frozen) @ M if freeze == "structure" else system.algebra.coadjoint(gradient)
    bound = 64 * U * np.linalg.cond(np.eye(x0.size) - 0.5 * h * W) * np.max(np.abs(found))
    assert np.max(np.abs(found - method.step(system, x0, 0.0, h))) < bound < 1e-8
    run = co.integrate(system, x0, (0.0, steps * h), h, method)
    kept, lost = ("energy", "S") if freeze == "structure" else ("S", "energy")
    size = 3 * spins * max(1.0, np.max(np.abs(run.x)) ** 2)
    assert run.drift()[kept] < 6 * 4 * size * U * math.sqrt(steps) and run.drift()[lost] > 1e-6


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


RATIOS = (1.0, 1e4, 1e8, 1e12)
STRONG, WEAK = np.array([0.6, -0.9, 1.1]), np.array([-0.4, 0.8, 0.7])


def coupled_spins(ratio):
    """A weak spin that turns fast in the field of a strong one, which it hardly moves."""
    M = np.zeros((6, 6))
    M[:3, 3:] = M[3:, :3] = np.diag([1.0, 0.8, 0.6])
    M[:3, :3] = np.diag([0.3, 0.5, 0.9])
    return co.LiePoissonSystem(TWO_SPINS, co.Quadratic(M / ratio)), np.concatenate([ratio * STRONG, WEAK])


def two_bodies(ratio):
    """Two free bodies, of which the small one turns faster."""
    moments = np.concatenate([np.array([0.1, 0.2, 0.3]) / ratio, [0.6, 1.05, 1.65]])
    return co.LiePoissonSystem(TWO_SPINS, co.Quadratic(moments)), np.concatenate([ratio * STRONG, WEAK])


def long_lever(ratio):
    """A body in a fluid with a large linear momentum."""
    moments = np.concatenate([[0.4, 0.7, 1.1], np.array([0.3, 0.5, 0.45]) / ratio**2])
    return co.LiePoissonSystem(co.algebras.e(3), co.Quadratic(moments)), np.concatenate([WEAK, ratio * STRONG])


MIXED = {f.__name__: f for f in (coupled_spins, two_bodies, long_lever)}
ROUNDINGS = 20  # of a step: of the sums, and of some ten terms of the slopes, times a step of less than one


def groups(system):
    return slice(0, system.dim - 3), slice(system.dim - 3, None)


@pytest.mark.parametrize("ratio", RATIOS)
@pytest.mark.parametrize("name", MIXED)
@pytest.mark.parametrize("method", [co.GaussLegendre(1), co.GaussLegendre(3)], ids=str)
def test_small_coordinates_beside_large_ones_in_50_digits(method, name, ratio):
    system, x0 = MIXED[name](ratio)
    h, steps = 0.5, 2
    with mpmath.workdps(50):
        exact = np.array([mpmath.mpf(float(v)) for v in x0])
        for k in range(steps):
            exact = method.step(system, exact, mpmath.mpf(k * h), mpmath.mpf(h))
    alone = co.integrate(system, x0, (0.0, steps * h), h, method).x[-1]
    members = np.array([x0, 0.5 * x0, x0, 1.5 * x0])
    np.testing.assert_array_equal(co.integrate(system, members, (0.0, steps * h), h, method).x[-1, 2], alone)
    plain = x0
    for k in range(steps):
        plain = method.step(system, plain, k * h, h)
    for found in (alone, plain):
        for part in groups(system):
            error = np.abs((found - exact)[part]).astype(float).max()
            assert error < steps * ROUNDINGS * U * np.abs(x0[part]).max()


@pytest.mark.parametrize("ratio", RATIOS)
@pytest.mark.parametrize("name", MIXED)
@pytest.mark.parametrize("h", [3.0, 9.0])
@pytest.mark.filterwarnings("ignore::coadjoint.LargeStepWarning")
def test_small_coordinates_by_newton(name, ratio, h):
    """The midpoint rule at steps where function iteration diverges: its defect in each coordinate, in 50 digits."""
    system, x0 = MIXED[name](ratio)
    x1 = co.integrate(system, x0, (0.0, h), h, co.GaussLegendre(1)).x[-1]
    with mpmath.workdps(50):
        start, end = (np.array([mpmath.mpf(float(v)) for v in x]) for x in (x0, x1))
        defect = end - start - h * system.vector_field((start + end) / 2, 0.0)
    for part in groups(system):
        size = max(np.abs(x0[part]).max(), np.abs(x1[part]).max())
        assert np.abs(defect[part]).astype(float).max() < ROUNDINGS * h * U * size


@pytest.mark.parametrize("ratio", RATIOS)
@pytest.mark.parametrize("stages", [1, 2, 3, 5])
@pytest.mark.parametrize("h", [0.25, 1.0])
def test_corrections_that_vanish_in_turns(stages, ratio, h):
    """A spin turns about x1, from an axis: x2 moves x3, which moves x2. The other spin rests."""
    moments = np.array([0.4, 0.7, 1.1, 0.0, 0.0, 0.0]) / ratio
    system = co.LiePoissonSystem(TWO_SPINS, co.Quadratic(moments, linear=[0.0, 0.0, 0.0, 1.0, 0.0, 0.0]))
    x0, method = np.array([ratio, 0.0, 0.0, 0.0, 0.0, 1.0]), co.GaussLegendre(stages)
    with mpmath.workdps(50):
        exact = method.step(system, np.array([mpmath.mpf(float(v)) for v in x0]), mpmath.mpf(0), mpmath.mpf(h))
    for found in (co.integrate(system, x0, (0.0, h), h, method).x[-1], method.step(system, x0, 0.0, h)):
        assert np.abs(found - exact)[3:].astype(float).max() < 8 * U


def in_a_cancelling_force():
    """A body, and p that it turns: p x dH/dp vanishes, except for round-off that is a thousandth of the momentum.

    One coefficient is the next float: products that cancel identically would be left out.
    """
    inertia, P, rate, h = np.array([0.7, 1.0, 1.2]), 1e6, 0.1, 0.25
    strength = 1e-3 * rate / (h * U * P**4)
    terms = {}
    for i in range(3):
        terms[tuple(2 * (j == i) for j in range(6))] = 0.5 / inertia[i]
        for j in range(i, 3):
            powers = [0] * 6
            powers[3 + i] += 2
            powers[3 + j] += 2
            terms[tuple(powers)] = strength * (0.25 if i == j else 0.5)
    terms[tuple(powers)] = np.nextafter(terms[tuple(powers)], np.inf)
    system = co.LiePoissonSystem(co.algebras.e(3), co.Polynomial(terms), sign=-1)
    return system, np.concatenate([rate * WEAK, P * STRONG]), inertia, h


@pytest.mark.parametrize(
    "method", [co.GaussLegendre(1), co.GaussLegendre(2), co.GaussLegendre(3), co.RadauEnergy(2)], ids=str
)
@pytest.mark.filterwarnings("ignore:rounding changes")
def test_corrections_that_are_round_off_of_large_terms(method):
    """Corrections of p stagnate far above its own round-off; the body turns as without the force, up to round-off."""
    system, x0, inertia, h = in_a_cancelling_force()
    steps = 40
    run = co.integrate(system, x0, (0.0, steps * h), h, method)
    members = co.integrate(system, np.array([x0, x0, x0, 2.0 * x0]), (0.0, steps * h), h, method)
    np.testing.assert_array_equal(members.x[:, 1], run.x)
    free = co.LiePoissonSystem(co.algebras.e(3), co.Quadratic(np.concatenate([1.0 / inertia, np.zeros(3)])), sign=-1)
    wanted = co.integrate(free, x0, (0.0, steps * h), h, method)
    rate = np.abs(x0[:3]).max()
    # The round-off of each step is about a thousandth of the momentum, and so may be the next corrections.
    assert np.abs(run.x[:, :3] - wanted.x[:, :3]).max() < 0.01 * steps * rate
    assert np.abs(run.x[1:, :3] - wanted.x[1:, :3]).max() > 1e-6 * rate, "nothing but round-off of p is left"
    assert np.abs(run.x[1, :3] - method.step(system, x0, 0.0, h)[:3]).max() < 0.03 * rate


GAUSS = [(co.GaussLegendre(s), h) for s, h in ((1, 0.85), (1, 1.0), (2, 1.5), (3, 2.25), (6, 2.25))]


@pytest.mark.filterwarnings("ignore::coadjoint.LargeStepWarning")
@pytest.mark.parametrize(("method", "h"), [*GAUSS, (co.RadauEnergy(2), 1.0), (co.RadauEnergy(2), 1.5)])
@pytest.mark.thinned(4)
def test_motions_die_out_through_subnormal_numbers(method, h):
    """Their equations are linear beside the coordinate that rests: a larger state takes the same step.

    Corrections fall by a tenth or less in each iteration, and end within 32 spacings of subnormal numbers.
    """
    algebra = co.LieAlgebra.from_brackets(3, {(0, 2): {0: 1.0}, (1, 2): {0: 1.0, 1: 1.0}})
    system, scale = co.LiePoissonSystem(algebra, co.Quadratic([0.93, 1.49, 1.49]), sign=-1), [2.0**100, 2.0**100, 1.0]
    for x in ([factor * 10.0**-k, 10.0 ** (3 - k), -1.3] for k in range(300, 324) for factor in (1.0, -3.0, 7.0)):
        end, larger = (co.integrate(system, start, (1, 1 - h), h, method).x[-1] for start in (x, np.multiply(x, scale)))
        ends = [end] if h > 0.85 else [end, method.step(system, x, 1.0, -h)]  # longer ones need Newton's method
        assert np.abs(ends - larger / scale)[:, :2].max() <= 2.0**-1058 + 256 * U * x[1]


@pytest.mark.filterwarnings("ignore::coadjoint.LargeStepWarning")
@pytest.mark.parametrize("method", [co.GaussLegendre(2), co.RadauEnergy(2), co.SphericalMidpoint()], ids=str)
def test_divergence_is_not_taken_for_round_off(method):
    """At steps of many turns the stages of a field that depends on the state have no solution that is found."""
    ring = co.systems.spin_lattice([(0, 1), (1, 2), (2, 3), (3, 0)], 4, tensor=(1.0, 0.7, 0.4))
    system = ring if isinstance(method, co.SphericalMidpoint) else co.systems.rigid_body()
    rng = np.random.default_rng(1)
    failed = 0
    for _ in range(5):
        try:
            run = co.integrate(system, 50.0 * rng.standard_normal(system.dim), (0.0, 40.0), 20.0, method)
        except co.IntegrationError as error:
            failed += 1
            assert not error.residual < 1e-3
        else:
            for casimir in run.casimirs.values():
                np.testing.assert_allclose(casimir, casimir[0], rtol=1e-9)
    assert failed or isinstance(method, co.GaussLegendre)


def test_a_change_of_sign_of_x_grad_h_is_told_and_not_stepped_over():
    """Beyond it the scheme follows another solution: left to itself its error stays at 4e-3 whatever the step."""
    system, x0 = systems()["quartic"]
    truth = co.integrate(system, x0, (0.0, 1.0), 1 / 128, co.GaussLegendre(4))
    signs = [np.sign(x @ system.hamiltonian.gradient(x)) for x in truth.x]
    crossing = next(k for k in range(128) if signs[k + 1] != signs[0])
    told = []
    for steps in (16, 32, 64, 128, 256):
        with pytest.raises(co.IntegrationError) as failure:
            co.integrate(system, x0, (0.0, 1.0), 1 / steps, co.RadauEnergy(2))
        assert abs(failure.value.step / steps - (crossing + 1) / 128) <= 0.1
        told.append(str(failure.value))
    # Near the crossing the multiplier grows without bound: it may also be that the iteration does not get there.
    assert all("vanishes" in one or "converge" in one for one in told) and any("vanishes" in one for one in told)
    # In one step, in which the sign changes before the first stage or between stages, and in Python.
    for h in (1 / 16, 1 / 32, 1 / 64, 1 / 128):
        with pytest.raises(co.IntegrationError, match=r"vanishes|converge"):
            co.stepper(system, co.RadauEnergy(2), h)(truth.x[crossing])
        with pytest.raises(co.IntegrationError, match=r"vanishes|converge"):
            co.RadauEnergy(2).step(system, truth.x[crossing], 0.0, h)


def test_failures_on_energy_surfaces():
    """No convergence, and no multiplier where x . grad H = 0; other members go on."""
    system, x0 = systems()["so(4)"]
    with refused(co.IntegrationError, "converge") as failure:
        co.integrate(system, x0, (0.0, 60.0), 20.0, co.RadauEnergy(2))
    assert failure.value.step == 1
    saddle = co.LiePoissonSystem(co.algebras.sl(2), co.Quadratic([1.0, -1.0, 2.0]))
    with refused(co.IntegrationError, "x . grad H(x) vanishes", "member 0") as failure:
        co.integrate(saddle, [[1.0, 1.0, 0.0], [1.0, 0.5, 0.25]], (0.0, 0.05), 0.01, co.RadauEnergy(2))
    partial = failure.value.partial
    assert partial.failed.tolist() == [True, False] and np.abs(partial.x[-1, 1] - [1.0, 0.5, 0.25]).max() > 1e-3
    with refused(co.IntegrationError, "vanishes"):
        co.RadauEnergy(2).step(saddle, [1.0, 1.0, 0.0], 0.0, 0.01)

"""Compiled loops against the interpreter for both signs and directions, all orders of axes and members, and layouts."""

from __future__ import annotations

import numpy as np
import pytest

import coadjoint as co
from coadjoint.choosing.pilot import short_run
from coadjoint.program.blocks import Kind
from coadjoint.program.interpreter import Interpreter
from coadjoint.runs import run as run_module
from coadjoint.systems.bodies.rigid_body import so3_body
from group_elements import random_element

from .measures import U
from .random_systems import ALGEBRAS, drawn, drawn_bracket
from .schemes_under_test import serves
from .systems_under_test import cases

pytestmark = pytest.mark.thinned(6)

STEP = 0.125
COUNT = 2
T0 = 0.75
DIRECTIONS = [(sign, direction) for sign in (1, -1) for direction in (1, -1)]
SCHEMES = {
    "Splitting 1": co.Splitting(order=1),
    "Splitting 1 adjoint": co.Splitting(order=1, adjoint=True),
    "Splitting 2": co.Splitting(order=2),
    "Splitting 4 compensated": co.Splitting(order=4, compensated=True),
    "Splitting processed": co.Splitting(scheme="blanes_casas_murua6"),
    "GaussLegendre 1": co.GaussLegendre(1),
    "GaussLegendre 3": co.GaussLegendre(3),
    "Modified structure": co.ModifiedGaussLegendre(2, iterations=2),
    "Modified gradient": co.ModifiedGaussLegendre(2, iterations=2, freeze="gradient"),
    "Iterated": co.IteratedGaussLegendre(2),
    "rk4": co.ExplicitRungeKutta("rk4"),
    "RadauEnergy": co.RadauEnergy(2),
    "Taylor": co.Taylor(5),
    "Composition": co.Composition(co.GaussLegendre(1), (0.75, -0.5, 0.75)),
    # Its first and last flows are different fractions of a step.
    "lopsided": co.Composition(co.Splitting(order=2), (0.25, 0.75)),
}
# Schemes that support Poisson systems without a Lie algebra.
WITHOUT_ALGEBRA = [n for n in SCHEMES if not n.startswith(("Splitting", "Taylor", "Modified gradient", "lopsided"))]


def without_linear(system):
    """Return the system with a homogeneous energy."""
    M = system.hamiltonian.hessian(np.zeros(system.dim))
    return co.LiePoissonSystem(system.algebra, co.Quadratic(M), sign=system.sign, casimirs={})


def pairs():
    """Return pairs of schemes and algebras: each scheme with half of the algebras."""
    algebras = list(ALGEBRAS)
    return [(s, a) for i, s in enumerate(SCHEMES) for j, a in enumerate(algebras) if (i + j) % 2 == 0]


def system_for(scheme, algebra, sign, seed=1):
    system, x0 = drawn(algebra, seed, sign)
    return (system if serves(SCHEMES[scheme], system) else without_linear(system)), x0


def read_steps(method, system, x, t, h):
    """Take single steps by the interpreter; no flows are joined between steps."""
    for k in range(COUNT):
        x = method.step(system, np.array(x), t + k * h, h)
    return x


def check_steps(method, system, x0, h):
    """Compare runs of one state and of five with the interpreter; return the end of the first."""
    span = (T0, T0 + COUNT * h)
    ensemble = x0 * np.array([[1.0], [0.75], [-1.0], [0.5], [1.25]])
    x, ends = (co.integrate(system, start, span, abs(h), method).x[-1] for start in (x0, ensemble))
    for start, end in ((x0, x), (ensemble[1], ends[1]), (ensemble[4], ends[4])):
        expected = read_steps(method, system, start, T0, h)
        np.testing.assert_allclose(end, expected, rtol=0, atol=rounding(system, expected))
    # The motion follows the field: the rest is of order t^2, with derivatives of size one in these systems.
    moved = system.vector_field(x0, T0)
    assert (x - x0) @ moved * h > 0.25 * COUNT * h * h * (moved @ moved)
    return x


def rounding(system, x):
    """Return the rounding of some hundred operations on each component, in systems of size one."""
    return 2.0**10 * system.dim * U * np.max(np.abs(x))


@pytest.mark.thinned(32)
@pytest.mark.parametrize(("scheme", "algebra"), pairs())
def test_compiled_steps_for_both_signs_and_directions(scheme, algebra):
    ends = []
    for sign, direction in DIRECTIONS:
        system, x0 = system_for(scheme, algebra, sign)
        ends.append(check_steps(SCHEMES[scheme], system, x0, direction * STEP))
    assert np.max(np.abs(ends[0] - ends[2])) > 0.05 * STEP


@pytest.mark.thinned(16)
@pytest.mark.parametrize("scheme", WITHOUT_ALGEBRA)
@pytest.mark.parametrize("seed", range(2))
def test_compiled_steps_where_j_is_a_function(scheme, seed):
    for sign, direction in DIRECTIONS:
        check_steps(SCHEMES[scheme], *drawn_bracket(seed, sign), direction * STEP)


@pytest.mark.thinned(7)
@pytest.mark.parametrize("scheme", [s for s, m in SCHEMES.items() if serves(m, cases()["sl(2), driven"].system)])
def test_compiled_steps_of_a_driven_system(scheme):
    system, x0, _ = cases()["sl(2), driven"]
    ends = [check_steps(SCHEMES[scheme], system, x0, direction * STEP) for direction in (1, -1)]
    assert np.max(np.abs(ends[0] - ends[1])) > 0.05 * STEP


def check_tangent(method, system, x0, h):
    """Compare with central differences, e = 2^-17: errors e^2 psi'''/6 with psi''' below 2^5, and u/e."""
    step, e = co.stepper(system, method, h), 2.0**-17
    P = step.tangent(x0, T0)
    columns = [(step(x0 + e * d, T0) - step(x0 - e * d, T0)) / (2 * e) for d in np.eye(system.dim)]
    bound = 2.0**5 * e * e + rounding(system, x0) / e
    np.testing.assert_allclose(P, np.array(columns).T, rtol=0, atol=bound)
    assert np.max(np.abs(P - np.eye(system.dim))) > 2.0**10 * bound


@pytest.mark.thinned(13)
@pytest.mark.parametrize(("scheme", "algebra"), pairs())
def test_tangents_for_both_signs_and_directions(scheme, algebra):
    for sign, direction in DIRECTIONS:
        check_tangent(SCHEMES[scheme], *system_for(scheme, algebra, sign), direction * STEP)


@pytest.mark.parametrize("scheme", WITHOUT_ALGEBRA)
@pytest.mark.parametrize("seed", range(2))
def test_tangents_where_j_is_a_function(scheme, seed):
    for sign, direction in DIRECTIONS:
        check_tangent(SCHEMES[scheme], *drawn_bracket(seed, sign), direction * STEP)


def attitudes(method, system):
    """Return the kinds of group elements of a scheme on a system."""
    kind = method.properties(system).attitude
    if kind == "none":
        return [False]
    return (
        ["coadjoint", True] if kind == "every representation" and system.representation is not None else ["coadjoint"]
    )


CARRIED = [(s, a) for s, a in pairs() if SCHEMES[s].properties(system_for(s, a, 1)[0]).attitude != "none"]


@pytest.mark.thinned(12)
@pytest.mark.parametrize(("scheme", "algebra"), CARRIED)
def test_group_elements_for_both_signs_and_directions(scheme, algebra):
    """K x is constant, and g^-1 rho(e_i) g = sum_j K_ij rho(e_j), from any initial element and any t0."""
    method, (system, x0) = SCHEMES[scheme], system_for(scheme, algebra, 1)
    for sign, direction in DIRECTIONS:
        system, x0 = system_for(scheme, algebra, sign)
        span, kind = (T0, T0 + direction * 4 * STEP), method.properties(system).attitude
        # Alone, and as the last of three members in lanes.
        run, ensemble = (
            co.integrate(system, start, span, STEP, method, attitude="coadjoint")
            for start in (x0, np.array([-0.5 * x0, 1.25 * x0, x0]))
        )
        size = np.linalg.norm(run.attitude[-1]) * np.linalg.norm(run.x[-1])
        ends = ((run.attitude[-1], run.x[-1]), (ensemble.attitude[-1, 2], ensemble.x[-1, 2]))
        for K, x in ends if kind in ("every representation", "coadjoint") else ():
            np.testing.assert_allclose(K @ x, x0, rtol=0, atol=2.0**4 * rounding(system, size))
        if True not in attitudes(method, system) or kind == "integrated":
            continue
        rho = system.representation
        first = random_element(rho, 5)
        g = co.integrate(system, x0, span, STEP, method, attitude=first).attitude[-1]
        turned = np.linalg.solve(first, g)
        expected = np.einsum("ij,jab->iab", run.attitude[-1], rho)
        bound = 2.0**6 * rounding(system, np.linalg.cond(g) ** 2 * np.linalg.norm(expected))
        np.testing.assert_allclose(np.linalg.solve(turned, rho @ turned), expected, rtol=0, atol=bound)


@pytest.mark.parametrize("n", range(2, 10))
def test_rotations_in_any_number_of_planes(n):
    """so(n): n - 2 planes turn by one angle, and n rows are moved in vectors of four."""
    algebra, rng = co.algebras.so(n), np.random.default_rng(n)
    method = co.Splitting(order=2, parts="coordinates")
    x0 = rng.uniform(0.5, 1.0, algebra.dim) * rng.choice([-1.0, 1.0], algebra.dim)
    first = random_element(algebra.representation, n)
    system = co.LiePoissonSystem(algebra, co.Quadratic(rng.uniform(0.5, 1.5, algebra.dim)), sign=-1, casimirs={})
    for direction in (1, -1):
        span, h = (0.0, 2 * direction * STEP), direction * STEP
        read = Interpreter(method.program(system, group=system.representation))
        x, g = read.steps(x0, h, 2, group=first)
        for start in (x0, np.tile(x0, (3, 1))):
            run = co.integrate(system, start, span, STEP, method, attitude=first)
            found = run.x[-1], run.attitude[-1]
            for one, two in zip(found, (x, g), strict=True):
                np.testing.assert_allclose(one.reshape(-1, *two.shape)[-1], two, rtol=0, atol=rounding(system, two))


@pytest.mark.parametrize("count", [3, 8, 9, 17])
@pytest.mark.parametrize("compensated", [False, True])
def test_rotations_with_different_frequencies(count, compensated):
    """Copies of so(3) with brackets of different sizes: eight angles of one part are computed at a time."""
    rng = np.random.default_rng(count)
    sizes = rng.uniform(0.5, 1.5, count) * rng.choice([-1.0, 1.0], count)
    rows = [(3 * k + i, 3 * k + (i + 1) % 3, 3 * k + (i + 2) % 3, w) for k, w in enumerate(sizes) for i in range(3)]
    algebra = co.LieAlgebra(rows, dim=3 * count)
    system = co.LiePoissonSystem(algebra, co.Quadratic(rng.uniform(0.5, 1.5, 3 * count)), sign=-1, casimirs={})
    x0 = rng.uniform(0.5, 1.0, 3 * count) * rng.choice([-1.0, 1.0], 3 * count)
    parts = [[3 * k + i for k in range(count)] for i in range(3)]
    method = co.Splitting(order=2, parts=parts, compensated=compensated)
    expected = Interpreter(method.program(system)).steps(x0, STEP, 4)
    for start in (x0, np.tile(x0, (5, 1))):
        found = co.integrate(system, start, (0.0, 4 * STEP), STEP, method).x[-1].reshape(-1, 3 * count)
        np.testing.assert_allclose(found[-1], expected, rtol=0, atol=rounding(system, expected))


@pytest.mark.parametrize("freeze", ["structure", "gradient"])
@pytest.mark.parametrize("stages", [1, 2])
def test_linear_stages_pivot_for_each_member(stages, freeze):
    """From small states, with matrices near one, to large ones, in any order."""
    system, method = (
        without_linear(drawn("so(4)", 7, -1)[0]),
        co.ModifiedGaussLegendre(stages, iterations=1, freeze=freeze),
    )
    rng = np.random.default_rng(12)
    states = rng.permutation(np.geomspace(0.1, 30.0, 24))[:, None] * rng.standard_normal((24, 6))
    ends = co.integrate(system, states, (0.0, 0.5), 0.5, method).x[-1]
    for x0, end in zip(states, ends, strict=True):
        expected = method.step(system, x0, 0.0, 0.5)
        assert np.array_equal(co.integrate(system, x0, (0.0, 0.5), 0.5, method).x[-1], end)
        # The matrices are one plus h/2 times what turns by up to 30 in a unit of time: of conditions below 2^12.
        np.testing.assert_allclose(end, expected, rtol=0, atol=2.0**12 * rounding(system, expected))


@pytest.mark.thinned(18)
@pytest.mark.parametrize("algebra", ["so(3)", "so(4)", "A4,7", "sl(2)"])
@pytest.mark.parametrize("scheme", SCHEMES)
def test_run_in_one_call_or_in_many(scheme, algebra, monkeypatch, capfd):
    """Interrupted after every step: initialization is not repeated."""
    method, (system, x0) = SCHEMES[scheme], system_for(scheme, algebra, -1)
    for start in (x0, x0 * np.array([[1.0], [0.75], [-1.0], [0.5], [1.25]])):
        for attitude in {False, attitudes(method, system)[0]}:
            options = {"method": method, "attitude": attitude, "save_every": 3}
            whole = co.integrate(system, start, (T0, T0 - 1.0), STEP, **options)
            with monkeypatch.context() as patched:
                patched.setattr(run_module, "SECONDS_BETWEEN_UPDATES", 0.0)
                pieces = co.integrate(system, start, (T0, T0 - 1.0), STEP, progress=True, **options)
            assert np.array_equal(whole.x, pieces.x) and np.array_equal(whole.energy, pieces.energy)
            assert attitude is False or np.array_equal(whole.attitude, pieces.attitude)
    assert "step" in capfd.readouterr().err


@pytest.mark.parametrize("method", [co.Splitting(order=2), co.ExplicitRungeKutta("rk4"), co.GaussLegendre(2)], ids=str)
def test_failed_member_keeps_its_drifts(method):
    """In the tenths before its failure, alone or among others."""
    # x1' = -x1 x2, x2' = -x1^2: beyond x2 = -c, c^2 = x2^2 - x1^2, it blows up, elsewhere x2 goes to c.
    system = co.LiePoissonSystem(co.LieAlgebra.from_brackets(2, {(0, 1): {0: 1.0}}), co.Quadratic([1.0, -1.0]))
    states = np.column_stack([np.linspace(0.1, 0.2, 9), np.where(np.arange(9) % 4 == 1, -1.0, 0.5)])
    span = (0.0, 64.0)
    with pytest.raises(co.IntegrationError) as together:
        co.integrate(system, states, span, STEP, method, save_every=100)
    partial = together.value.partial
    assert partial.failed.tolist() == [m % 4 == 1 for m in range(9)]
    for m, x0 in enumerate(states):
        if partial.failed[m]:
            with pytest.raises(co.IntegrationError) as alone:
                co.integrate(system, x0, span, STEP, method, save_every=100)
            own = alone.value.partial
        else:
            own = co.integrate(system, x0, span, STEP, method, save_every=100)
        tenths = own.drift()["energy"].tenths
        assert np.array_equal(partial.drift()["energy"].tenths[m], tenths) and tenths.max() > 0.0


@pytest.mark.parametrize("compensated", [False, True])
def test_series_of_different_lengths_in_lanes(compensated):
    """Small angles take fewer terms and substeps, independently of neighbouring lanes."""
    system, x0 = drawn("so(4)", 1, -1)
    method = co.Splitting(order=2, compensated=compensated)
    assert Kind.SERIES in method.program(system).state.kind
    sizes = np.random.default_rng(9).permutation(np.geomspace(1e-6, 16.0, 33))
    span = (0.0, 400 * STEP)
    ensemble = co.integrate(system, sizes[:, None] * x0, span, STEP, method, save_every=100)
    for m, size in enumerate(sizes):
        alone = co.integrate(system, size * x0, span, STEP, method, save_every=100)
        assert np.array_equal(alone.x, ensemble.x[:, m])


AXES = [sense * axis for axis in np.eye(3) for sense in (1.0, -1.0)]


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("x0", [*AXES, np.array([0.6, 0.0, -0.8]), np.array([0.5, -0.75, 0.25])], ids=str)
def test_shifted_runs_about_every_axis(x0, sign):
    """The Casimir shift turns the body about its momentum: against the closed form, both ways in time."""
    system = so3_body(np.array([1.0, 0.5, 0.25]), sign=sign, name="body", parameters={})
    method = co.Splitting(order=8)
    assert method.program(system).shift
    first = random_element(system.representation, 2)
    for direction in (1, -1):
        span = (T0, T0 + direction * 2.0)
        x, g = system.exact(x0, span[1] - span[0], attitude=first)
        run = co.integrate(system, x0, span, 2.0**-5, method, attitude=first)
        # Order 8 with 2^-5 of a unit of time, in which nothing turns by more than a radian.
        np.testing.assert_allclose(run.x[-1], x, rtol=0, atol=2.0**-36)
        np.testing.assert_allclose(run.attitude[-1], g, rtol=0, atol=2.0**-36)


def test_arrays_of_any_memory_layout():
    """C, Fortran, and every other row of a larger array: the same bits."""
    system, x0 = drawn("so(4)", 2, -1)
    rng = np.random.default_rng(7)
    ensemble = x0 + 0.25 * rng.standard_normal((5, 6))
    element = random_element(system.representation, 7, 5)
    M, linear = system.hamiltonian.hessian(x0), system.hamiltonian.gradient(np.zeros(6))
    rho = system.algebra.representation

    def every_other(array):
        return np.repeat(array, 2, axis=0)[::2]

    runs = []
    for layout in (np.ascontiguousarray, np.asfortranarray, every_other):
        given = co.LiePoissonSystem(
            system.algebra,
            co.Quadratic(layout(M), linear=layout(linear)),
            sign=-1,
            representation=layout(rho),
            casimirs={},
        )
        runs.append(
            co.integrate(given, layout(ensemble), (0.0, -1.0), STEP, co.Splitting(order=4), attitude=layout(element))
        )
    assert not np.array_equal(element, element.transpose(0, 2, 1))
    for run in runs[1:]:
        assert np.array_equal(run.x, runs[0].x) and np.array_equal(run.attitude, runs[0].attitude)
    for m in range(5):
        alone = co.integrate(system, ensemble[m], (0.0, -1.0), STEP, co.Splitting(order=4), attitude=element[m])
        assert np.array_equal(alone.attitude, runs[0].attitude[:, m])


def test_functions_returning_either_layout():
    """J, and the same numbers in Fortran order."""
    system, x0 = drawn_bracket(4, -1)
    structure = system.structure_function

    def transposed(x):
        return (-structure(x)).T

    # Numba compiles only what it sees: the same formula written once more.
    a = structure.__closure__[0].cell_contents

    def in_fortran_order(x):
        w0, w1, w2 = x[0] + a[0] * x[1] * x[2], x[1] + a[1] * x[0] * x[0], x[2] + a[2] * x[0] * x[1]
        return np.array([[0.0 * w0, w2, -w1], [-w2, 0.0 * w0, w0], [w1, -w0, 0.0 * w0]]).T

    assert np.array_equal(in_fortran_order(x0), structure(x0)) and np.array_equal(transposed(x0), structure(x0))
    other = co.PoissonSystem(in_fortran_order, system.hamiltonian, sign=-1, dim=3)
    for method in (co.GaussLegendre(2), co.ModifiedGaussLegendre(2), co.ExplicitRungeKutta("rk4")):
        one, two = (co.integrate(s, x0, (0.0, 1.0), STEP, method) for s in (system, other))
        np.testing.assert_allclose(two.x, one.x, rtol=0, atol=rounding(system, x0))


@pytest.mark.thinned(8)
@pytest.mark.parametrize("seed", range(4))
def test_batch_members_in_any_order(seed):
    """Members of several structures (shifted, other parts, diagonal M), with attitudes."""
    rng = np.random.default_rng(seed)
    so4 = co.algebras.so(4)
    energies = [co.Quadratic(rng.uniform(0.5, 1.5, 6)) for _ in range(3)]
    energies += [drawn("so(4)", int(s), 1)[0].hamiltonian for s in rng.integers(1, 100, 3)]
    energies += [co.Quadratic([1.0, 1.0, 2.0, 1.0, 2.0, 2.0])]
    systems = [co.LiePoissonSystem(so4, H, sign=-1) for H in energies]
    x0 = rng.standard_normal((7, 6))
    first = random_element(so4.representation, seed, 7)
    runs = {}
    for order in (np.arange(7), rng.permutation(7)):
        run = co.integrate(
            co.batch([systems[m] for m in order]), x0[order], (T0, T0 - 1.0), STEP, attitude=first[order]
        )
        for column, m in enumerate(order):
            found = run.x[:, column], run.attitude[:, column], run.energy[:, column]
            for one, two in zip(found, runs.setdefault(int(m), found), strict=True):
                assert np.array_equal(one, two)
    for m, (x, attitude, energy) in runs.items():
        alone = co.integrate(systems[m], x0[m], (T0, T0 - 1.0), STEP, attitude=first[m])
        assert np.array_equal(alone.x, x) and np.array_equal(alone.energy, energy)
        assert np.array_equal(alone.attitude, attitude)


@pytest.mark.parametrize("method", [co.GaussLegendre(1), co.GaussLegendre(2), co.RadauEnergy(2), co.Taylor(6)], ids=str)
def test_batch_members_solved_by_newtons_method(method):
    """Newton's method uses the constants of its member, and so do schemes without lanes."""
    systems = [drawn("so(4)", seed, -1)[0] for seed in range(1, 8)]
    systems = [without_linear(system) for system in systems]
    states = np.array([drawn("so(4)", seed, -1)[1] for seed in range(1, 8)])
    newton = isinstance(method, co.GaussLegendre)
    states *= ((24.0 if method.stages == 1 else 32.0) if newton else 1.0) * np.linspace(0.5, 1.0, 7)[:, None]
    together = co.integrate(co.batch(systems), states, (0.0, 6 * STEP), STEP, method)
    for m, (system, x0) in enumerate(zip(systems, states, strict=True)):
        alone = co.integrate(system, x0, (0.0, 6 * STEP), STEP, method)
        assert np.array_equal(alone.x, together.x[:, m]) and np.array_equal(alone.energy, together.energy[:, m])
    # The first number in the memory of implicit schemes counts the remaining steps by Newton's method.
    runs = [short_run(s, method, x0[None], 0.0, 6 * STEP, 6) for s, x0 in zip(systems, states, strict=True)]
    assert not newton or any(run.state["memory"][0, 0] > 0.0 for run in runs)


PERMUTED = [
    co.GaussLegendre(2),
    co.Taylor(8),
    co.ExplicitRungeKutta("rk4"),
    co.ModifiedGaussLegendre(2, freeze="gradient"),
]


@pytest.mark.parametrize("name", list(ALGEBRAS))
def test_permuted_axes_give_the_permuted_motion(name):
    """Even and odd permutations: the same motion and coadjoint matrix."""
    system, x0 = drawn(name, 3, -1)
    n, rng = system.dim, np.random.default_rng(11)
    i, j, k, c = system.algebra.triples
    M, linear = system.hamiltonian.hessian(x0), system.hamiltonian.gradient(np.zeros(n))
    orders = [rng.permutation(n) for _ in range(4)]
    orders.append(np.r_[orders[0][1::-1], orders[0][2:]])  # of the other parity
    for order in orders:
        inverse = np.argsort(order)
        rows = np.stack([inverse[i], inverse[j], inverse[k], c], axis=1)
        H = co.Quadratic(M[np.ix_(order, order)], linear=linear[order])
        other = co.LiePoissonSystem(co.LieAlgebra(rows, dim=n), H, sign=-1, casimirs={})
        for method in PERMUTED:
            attitude = "coadjoint" if method.properties(other).attitude != "none" else False
            one, two = (
                co.integrate(s, x, (0.0, 4 * STEP), STEP, method, attitude=attitude)
                for s, x in ((system, x0), (other, x0[order]))
            )
            bound = 2.0**4 * rounding(system, one.x)
            np.testing.assert_allclose(two.x, one.x[:, order], rtol=0, atol=bound)
            if attitude:
                np.testing.assert_allclose(two.attitude, one.attitude[:, order][:, :, order], rtol=0, atol=bound)

"""Orders from slopes, tangents that are Poisson maps or not, round-off of ensembles, and sizes of drifts."""

import copy
import pickle

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.stats import norm, ttest_1samp

import coadjoint as co
from refusals import refused

pytestmark = pytest.mark.thinned(1)

STEPS = 0.4 / 2.0 ** np.arange(8)


@pytest.mark.parametrize("order", [1, 2, 4, 6])
def test_exact_power_has_its_exponent(order):
    fit = co.analysis.fit_order(STEPS, 3.0 * STEPS**order)
    # Logarithms are rounded to u times their size, at most 40; the least squares of 8 points lose a few bits.
    assert fit.order == pytest.approx(order, abs=64 * 2.0**-53 * 40)
    assert fit.dropped == 0


def test_plateau_is_dropped_without_a_stated_floor():
    noise = np.array([1.0, 1.3, 0.8, 1.1])
    errors = np.concatenate([STEPS[:4] ** 4, 1e-4 * noise])
    fit = co.analysis.fit_order(STEPS, errors)
    assert fit.order == pytest.approx(4.0, abs=0.4)
    assert 3 <= len(fit.steps) <= 5
    without = float(np.polyfit(np.log(STEPS), np.log(errors), 1)[0])
    assert abs(without - 4.0) > 1.0


def test_a_plateau_above_the_stated_floor_is_lack_of_convergence():
    """An error that tends to a constant far above round-off has order 0 there; without a floor it is left out."""
    errors = STEPS**4 + 1e-2
    fit = co.analysis.fit_order(STEPS, errors, 1e-12)
    # The local power is at most 4 times the part that is not constant, largest at the first of the last three steps.
    assert 0.0 < fit.order < 4 * STEPS[5] ** 4 / 1e-2 and fit.steepening < 0.0 and fit.dropped == 0
    with refused(ValueError, "2 of 8"):
        co.analysis.fit_order(STEPS, errors)


@pytest.mark.parametrize("seed", range(4))
def test_each_point_keeps_its_own_floor_in_any_order_and_unit(seed):
    rng = np.random.default_rng(seed)
    steps = 0.5 * np.cumprod(rng.uniform(0.5, 0.8, 9))
    errors = steps**3 * rng.uniform(0.95, 1.05, 9)
    floor = np.where(np.arange(9) == 6, errors, 0.1 * errors)  # the seventh is at its floor, and no other one
    fit = co.analysis.fit_order(steps, errors, floor)
    # Of the five smallest steps above their floors, three have the slope.
    assert fit.order == pytest.approx(np.polyfit(np.log(steps[3:6]), np.log(errors[3:6]), 1)[0], rel=1e-12)
    assert fit.dropped == 3 and np.array_equal(fit.steps, steps[1:6]) and np.array_equal(fit.errors, errors[1:6])
    mixed = rng.permutation(9)
    again = co.analysis.fit_order(1e3 * steps[mixed], 1e-5 * errors[mixed], 1e-5 * floor[mixed])
    assert again.order == pytest.approx(fit.order, rel=1e-12) and again.dropped == 3
    assert again.steps == pytest.approx(1e3 * fit.steps) and again.errors == pytest.approx(1e-5 * fit.errors)


@pytest.mark.parametrize("ratio", [1.1, 2.0, 9.0])
def test_a_plateau_is_what_falls_more_slowly_than_the_root_of_the_step(ratio):
    steps = ratio ** -np.arange(6.0)
    assert co.analysis.fit_order(steps, steps**0.51).dropped == 0
    with refused(ValueError, "only 1 of 6"):
        co.analysis.fit_order(steps, steps**0.49)


@pytest.mark.parametrize("name", ["so(3)", "sl(2)", "e(3)", "so(4)", "A3,7"])
def test_coadjoint_action_is_poisson_and_its_transpose_not(name: str):
    """exp(D_u) is linear, and Poisson on every dual of a Lie algebra."""
    algebra = co.algebras.get(name, **({"a": 2.0} if name == "A3,7" else {}))
    u, x = np.random.default_rng(3).normal(size=(2, algebra.dim))
    P = expm(algebra.coadjoint(0.5 * u))
    J = algebra.structure_matrix
    found = co.analysis.defect_of_tangent(P, J(x), J(P @ x), operations=20 * algebra.dim)
    assert found.poisson and found.bound < 1e-10
    assert not co.analysis.defect_of_tangent(P.T, J(x), J(P @ x), operations=20 * algebra.dim).poisson


def test_defect_of_the_midpoint_rule_is_of_third_order_in_the_step():
    body, x = co.systems.paper_rigid_body(), (1.0, 2.0, 0.5)
    steps = [0.1 / 2**k for k in range(5)]
    defects = [co.analysis.poisson_defect(co.stepper(body, co.GaussLegendre(1), h), x).defect for h in steps]
    # A method of order 2 differs from the flow, which is Poisson, by h^3; the next terms are of relative size h.
    assert co.analysis.fit_order(steps, defects).order == pytest.approx(3.0, abs=0.1)


@pytest.mark.parametrize("h", [0.1, -0.07])
@pytest.mark.parametrize("sign", [1, -1])
def test_the_defect_and_its_bound_are_those_of_their_definition(sign: int, h: float):
    system = co.LiePoissonSystem(co.algebras.get("A3,7", a=0.5), co.Quadratic([1.0, 2.0, 0.3]), sign=sign)
    x = np.array([3.0, -1.0, 2.0])
    step = co.stepper(system, co.GaussLegendre(1), h)
    P, J, after = step.tangent(x), system.structure_matrix(x), system.structure_matrix(step(x))
    entries = np.array([[P[i] @ J @ P[j] - after[i, j] for j in range(3)] for i in range(3)])
    for operations in (0, 1, 50):
        found = co.analysis.poisson_defect(step, x, operations)
        assert found.defect == pytest.approx(np.sqrt(np.sum(entries**2)), rel=1e-10)
        assert found.bound == pytest.approx(64 * 2.0**-53 * operations * np.sum(P**2) * np.sqrt(np.sum(J**2)))
    assert not found.poisson and co.analysis.poisson_defect(step, x).bound > found.bound * 3 * 4 / 50
    assert co.analysis.poisson_defect(co.stepper(system, co.Splitting(order=4), h), x).poisson
    for wrong, named in ((np.ones((2, 3)), "one state"), (np.ones(2), "shape")):
        with refused(ValueError, named):
            co.analysis.poisson_defect(step, wrong)
    for matrices in ([np.ones((2, 3))] * 3, [np.eye(2), np.eye(2), np.eye(3)]):
        with refused(ValueError, "(n, n)"):
            co.analysis.defect_of_tangent(*matrices, operations=1)


@pytest.mark.parametrize(("share", "poisson"), [(0.5, True), (2.0, False)])
def test_the_bound_of_a_defect_at_its_threshold(share, poisson):
    """64 u for each operation, times |P|^2 |J|; here |P|^2 is 2."""
    J, off = np.array([[0.0, 1.0], [-1.0, 0.0]]), share * 64 * 2.0**-53 * 10 * 2
    assert co.analysis.defect_of_tangent(np.eye(2), J, (1.0 + off) * J, operations=10).poisson is poisson


STARTS = np.array([[1.0, 0.2, 0.5], [-0.1, 1.0, 0.2], [30.0, -10.0, 20.0], [0.01, -0.02, 0.03], [0.3, 0.3, -0.9]])


@pytest.mark.parametrize("shape", [(6, 1), (6, 5), (6, 5, 3), (6, 5, 2, 2), (1, 4)])
def test_a_walk_has_the_numbers_of_its_definition(shape):
    rng = np.random.default_rng(len(shape))
    deviations = rng.normal(-0.3, 1.0, shape)
    deviations[-1].ravel()[-1] = -9.0  # the largest one is negative, and not the first
    for early in (0, shape[0] // 2, shape[0] - 1):
        walk = co.analysis.random_walk(deviations, early)
        means = np.array([member.mean() for member in deviations[-1]])
        assert walk.early == pytest.approx(np.sqrt((deviations[early] ** 2).mean()), rel=1e-14)
        assert walk.late == pytest.approx(np.sqrt((deviations[-1] ** 2).mean()), rel=1e-14)
        assert walk.worst == 9.0
        assert walk.growth == pytest.approx(walk.late / walk.early, rel=1e-15)
        # The probability of Student's t as that of a normal deviate.
        wanted = norm.ppf(ttest_1samp(means, 0.0, alternative="less").pvalue) if len(means) > 1 else np.nan
        assert walk.bias == pytest.approx(wanted, rel=1e-9, nan_ok=True)


def test_a_walk_from_nothing_grows_without_bound():
    assert co.analysis.random_walk(np.array([[0.0, 0.0], [1.0, 2.0]]), 0).growth == np.inf
    for early in (-1, 2):
        with refused(ValueError, "early"):
            co.analysis.random_walk(np.ones((2, 3)), early)
    for wrong in (np.ones(3), np.ones((3, 0))):
        with refused(ValueError, "shape"):
            co.analysis.random_walk(wrong, 0)


@pytest.mark.parametrize("batch", [False, True])
@pytest.mark.parametrize("order", [slice(None), slice(None, None, -1)])
def test_round_off_of_members_of_all_sizes(batch, order):
    """By the definition, with the gradient and the system of each member, in whichever order they are."""
    bodies = [co.systems.rigid_body((1.0, 2.0, third)) for third in (2.5, 3.0, 2.2, 1.5, 2.9)][order]
    systems = bodies if batch else bodies[:1] * 5
    starts = STARTS[order]
    sol = co.integrate(co.batch(systems) if batch else systems[0], starts, (0, 4.0), 0.1, save_every=10)
    for early in (1, 3):
        found = co.analysis.round_off(sol, early)
        assert list(found) == ["energy", *sol.casimirs]
        for name, values in {"energy": sol.energy, **sol.casimirs}.items():
            relative = []
            for m, own in enumerate(systems):
                invariant = own.hamiltonian if name == "energy" else own.casimirs[name]
                size = np.linalg.norm(invariant.gradient(starts[m])) * np.linalg.norm(starts[m])
                relative.append((values[:, m] - values[0, m]) / size)
            wanted = co.analysis.random_walk(np.array(relative).T, early)
            for field in ("early", "late", "worst", "bias"):
                assert getattr(found[name], field) == pytest.approx(getattr(wanted, field), rel=1e-12), field


def test_orthogonality_and_spatial_momentum_by_their_definitions():
    top = co.systems.heavy_top()
    starts = np.random.default_rng(3).normal(size=(4, 6)) * [[1.0], [30.0], [0.1], [2.0]]
    sol = co.integrate(top, starts, (0, 3.0), 0.1, save_every=5, attitude=True)
    for size in (None, 3):
        g = sol.attitude[..., :size, :size]
        wanted = np.array([[one @ one.T - np.eye(len(one)) for one in members] for members in g])
        assert co.analysis.orthogonality(sol, size) == co.analysis.random_walk(wanted, 1)
    moved = co.integrate(top, starts, (0, 3.0), 0.1, save_every=5, attitude="coadjoint")
    assert co.analysis.spatial_momentum(moved).worst < 1e-12
    # Deviations of a thousandth, beside which the rounding of the products is nothing.
    moved.attitude[1:] *= 1.0 + 1e-3 * np.arange(1.0, len(moved.t))[:, None, None, None]
    relative = np.zeros((len(moved.t), 4, 6))
    for k, m in np.ndindex(len(moved.t), 4):
        K, x = moved.attitude[k, m], moved.x[k, m]
        off = K @ x - moved.attitude[0, m] @ moved.x[0, m]
        relative[k, m] = off / (np.linalg.norm(K, 2) * np.linalg.norm(x))
    found, wanted = co.analysis.spatial_momentum(moved), co.analysis.random_walk(relative, 1)
    for field in ("early", "late", "worst", "bias"):
        assert getattr(found, field) == pytest.approx(getattr(wanted, field), rel=1e-9)


def test_invariants_that_are_functions_are_relative_to_their_largest_value_of_each_member():
    """The largest one of a member may be negative, and at any time."""
    system = co.LiePoissonSystem(co.algebras.A3_7(0.3), co.Quadratic([1.0, 0.5, 0.25]))
    sol = co.integrate(system, STARTS, (0, 0.4), 0.1)
    rng = np.random.default_rng(2)
    changed = rng.normal(size=sol.casimirs["log C"].shape)
    changed[2, 1] = -7.0
    sol.casimirs["log C"][:] = changed
    wanted = co.analysis.random_walk((changed - changed[0]) / np.abs(changed).max(axis=0), 2)
    found = co.analysis.round_off(sol, 2)["log C"]
    for field in ("early", "late", "worst", "bias"):
        assert getattr(found, field) == pytest.approx(getattr(wanted, field), rel=1e-12), field


BODY = co.systems.rigid_body(inertia=(1, 2, 3))
TOP = co.systems.heavy_top()


def test_relative_to_the_initial_value_and_absolute_on_request():
    sol = co.integrate(BODY, (10.0, 2.0, -3.0), (0, 10), 0.01)
    relative, absolute = sol.drift(), sol.drift(relative=False)
    for name, values in {"energy": sol.energy, **sol.casimirs}.items():
        largest = np.abs(values - values[0]).max()
        assert relative[name].scale == abs(values[0]) and absolute[name].scale == 1.0
        assert absolute[name] == relative[name].absolute == largest
        assert relative[name] == pytest.approx(largest / abs(values[0]), rel=1e-15)
        assert relative[name].tenths == pytest.approx(absolute[name].tenths / abs(values[0]), rel=1e-15)
        assert relative[name].growth == pytest.approx(absolute[name].growth, rel=1e-14)


def test_a_casimir_that_vanishes_is_compared_with_its_terms():
    x0 = np.array([0.3, 0.0, 0.0, 0.0, 0.6, 0.8])  # m.p = 0, each term is zero
    crossed = np.array([0.8, -0.6, 0.0, 0.6, 0.8, 0.0])  # m.p = 0.48 - 0.48
    sol = co.integrate(TOP, x0, (0, 10), 0.01)
    assert sol.drift()["m.p"].scale == 1.0
    sol = co.integrate(TOP, crossed, (0, 10), 0.01)
    assert abs(sol.initial["m.p"]) < 1e-15 and sol.drift()["m.p"].scale == pytest.approx(0.96, rel=1e-14)
    assert sol.drift()["m.p"] < 1e-14


@pytest.mark.parametrize("factor, cancels", [(0.98, True), (1.02, False)])
def test_where_cancellation_begins(factor, cancels):
    """H = x1^2/2 + x3^2/2 - x2^2/2 is small by cancellation if it is below a 64th of the sum of terms, 1 + d.

    A Casimir always has the size of its terms.
    """
    d = factor * 2 / 63
    system = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1.0, -1.0, 1.0]))
    sol = co.integrate(system, (np.sqrt(1.0 + d), 1.0, 0.0), (0, 0.1), 0.01)
    assert sol.drift()["energy"].scale == pytest.approx(1.0 + d / 2 if cancels else d / 2, rel=1e-12)
    x0 = np.array([1.0 + d, -1.0, 0.0, 1.0, 1.0, 0.0])
    assert co.integrate(TOP, x0, (0, 0.1), 0.01).drift()["m.p"].scale == pytest.approx(2 + d, rel=1e-12)


def test_members_have_their_own_sizes():
    states = np.array([[1.0, 0.0, 0.0, 0.0, 0.6, 0.8], [0.8, -0.6, 0.0, 0.6, 0.8, 0.0], [3.0, 1.0, 2.0, 1.0, 0.0, 1.0]])
    sol = co.integrate(TOP, states, (0, 10), 0.01)
    drift = sol.drift()["m.p"]
    singles = [co.integrate(TOP, x, (0, 10), 0.01).drift()["m.p"] for x in states[1:]]
    assert drift.scale[1:].tolist() == [single.scale for single in singles]
    assert drift.members[1:].tolist() == [float(single) for single in singles]
    assert drift == drift.members.max() and drift.absolute == sol.drift(relative=False)["m.p"]


@pytest.mark.parametrize("algebra", [co.algebras.so(4), co.algebras.get("A5,40")], ids=["so(4)", "A5,40"])
def test_energies_of_batches_that_cancel_are_compared_with_their_own_terms(algebra):
    """Systems of different sizes, some with several members in any order: each member as in a run of it alone."""
    rng, n = np.random.default_rng(7), algebra.dim
    x0 = rng.uniform(0.5, 1.0, n)
    signs = rng.standard_normal(n)
    signs -= signs.mean()  # the terms of the energy, which cancel
    systems = [co.LiePoissonSystem(algebra, co.Quadratic(size * signs / x0**2)) for size in (0.25, 1.0, 3.0)]
    order = [0, 1, 0, 2, 1, 2, 2]
    scale = co.integrate(co.batch([systems[k] for k in order]), x0, (0, 0.1), 0.05).drift()["energy"].scale
    alone = [co.integrate(system, x0, (0, 0.1), 0.05).drift()["energy"].scale for system in systems]
    assert alone == pytest.approx(0.5 * np.abs(signs).sum() * np.array([0.25, 1.0, 3.0]), rel=1e-13)
    assert scale.tolist() == [alone[k] for k in order]


def test_traces_of_matrices_by_their_singular_values():
    fluid = co.systems.sphere_euler(N=5)
    W = fluid.matrices(np.random.default_rng(1).normal(size=fluid.dim))
    W = W - np.swapaxes(W, 0, 1)  # odd traces vanish
    sol = co.integrate(fluid, W, (0, 1), 0.05)
    name = "tr W^3"
    assert abs(sol.initial[name]) < 1e-13 * abs(sol.initial["tr W^2"])
    assert sol.drift()[name].scale == pytest.approx(np.sum(np.linalg.svd(W, compute_uv=False) ** 3), rel=1e-12)
    two = co.systems.reduced_mhd(N=5)
    X = two.matrices(np.random.default_rng(2).normal(size=two.dim))
    X[1] = X[1] - np.swapaxes(X[1], 0, 1)
    theta, w = np.linalg.svd(X, compute_uv=False)
    wanted = {"tr Theta^3": theta**3, "tr W Theta^2": w * theta**2}
    for name, terms in wanted.items():
        assert two.casimirs[name].sum_of_absolute_terms(X) == pytest.approx(terms.sum(), rel=1e-12)
    dyed = co.systems.passive_scalar(N=5)
    for name, terms in {"tr Theta^3": theta**3, "tr W^3": w**3, "tr W^2": w**2, "tr W Theta": w * theta}.items():
        assert dyed.casimirs[name].sum_of_absolute_terms(X) == pytest.approx(terms.sum(), rel=1e-12)


def test_many_invariants_are_compared_with_each_other():
    """Beyond the first 64, terms are summed only of values that are far smaller than others."""
    spins = np.tile([[0.6, 0.0, 0.8], [0.0, 1e-3, 0.0]], (64, 1))
    ring = co.systems.spin_lattice("ring", 128)
    drift = co.integrate(ring, spins.ravel(), (0, 0.1), 0.1).drift()
    assert [drift[name].scale for name in list(drift)[1:]] == pytest.approx([1.0, 1e-6] * 64, rel=1e-15)


def test_forces_and_copies():
    damped = BODY.with_forces(co.forces.LinearDamping(0.1))
    sol = co.integrate(damped, (1.0, 0.2, 0.5), (0, 10), 0.1)
    for relative in (True, False):
        change, balance = sol.change(relative)["energy"], sol.balance(relative)["energy"]
        assert change.scale == balance.scale == (sol.initial["energy"] if relative else 1.0)
        again = [pickle.loads(pickle.dumps(change)), copy.deepcopy(change), copy.copy(change)]
        for each in again:
            assert each == pytest.approx(change, rel=1e-15) and each.scale == change.scale
            assert each.tenths == pytest.approx(change.tenths, rel=1e-15)
            assert each.absolute == pytest.approx(change.absolute, rel=1e-15)

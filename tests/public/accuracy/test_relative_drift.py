"""The sizes to which drifts are relative: initial values, sums of terms where these cancel, or one."""

import copy
import pickle

import numpy as np
import pytest

import coadjoint as co

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
    """m.p = (1 + d) - 1 is small by cancellation if it is below a 1024th of the sum of terms, 2 + d."""
    d = factor * 2 / 1023
    x0 = np.array([1.0 + d, -1.0, 0.0, 1.0, 1.0, 0.0])
    scale = co.integrate(TOP, x0, (0, 0.1), 0.01).drift()["m.p"].scale
    assert scale == pytest.approx(2 + d if cancels else d, rel=1e-12)


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
    assert all(each == change and each.scale == change.scale and (each.tenths == change.tenths).all() for each in again)

"""The attitude of a run whose Hamiltonian was shifted by a Casimir is that of the whole Hamiltonian."""

import numpy as np
import pytest

import coadjoint as co
from coadjoint.program.decompose import decompose

U = 2.0**-53


def cases():
    rng = np.random.default_rng(7)
    e3 = co.algebras.e(3)
    return {
        "so(3), body": (co.systems.rigid_body((1.0, 2.0, 3.0)), True),
        "so(3), paper": (co.systems.paper_rigid_body(), True),
        "so(3), coadjoint": (co.systems.rigid_body((1.0, 2.0, 3.5)), "coadjoint"),
        "e(3)": (co.LiePoissonSystem(e3, co.Quadratic((1, 0.5, 0.3, 0.2, 0.4, 0.9)), sign=-1), True),
        "e(3), coadjoint": (co.LiePoissonSystem(e3, co.Quadratic((1, 0.5, 0.3, 0.2, 0.4, 0.9))), "coadjoint"),
        "so(4)": (co.LiePoissonSystem(co.algebras.so(4), co.Quadratic(rng.uniform(0.5, 2, 6)), sign=-1), True),
        "sl(2)": (co.LiePoissonSystem(co.algebras.sl(2), co.Quadratic((0.5, 1.0, 0.3))), True),
    }


@pytest.mark.parametrize("name", list(cases()))
def test_shifted_and_unshifted_attitudes_converge_to_each_other(name):
    system, attitude = cases()[name]
    assert decompose(system, "auto").shift, "the case must be one that is shifted"
    x0 = 0.6 * np.random.default_rng(4).standard_normal(system.dim)
    reference = co.integrate(
        system, x0, (0, 2), 0.0025, co.Splitting(order=4, parts="coordinates"), attitude=attitude, save_every=800
    ).attitude[-1]
    errors = []
    for h in (0.1, 0.05):
        sol = co.integrate(system, x0, (0, 2), h, co.Splitting(order=4), attitude=attitude, save_every=100)
        errors.append(np.abs(sol.attitude[-1] - reference).max())
    assert errors[0] < 0.05 and errors[1] < errors[0] / 8 + 1e-12  # order 4: a factor 16


def test_against_the_closed_form():
    system = cases()["so(3), body"][0]
    x0 = np.array([0.3, 1.0, -0.5])
    start = system.exact((1.0, 0.2, 0.4), 1.7, attitude=True)[1]
    sol = co.integrate(system, x0, (3, 13), 1 / 512, co.Splitting(order=4), attitude=start, save_every=640)
    exact = system.exact(x0, sol.t - 3, attitude=start)[1]
    assert np.abs(sol.attitude - exact).max() < 1e-10


@pytest.mark.parametrize("name", list(cases()))
def test_spatial_momentum_is_kept(name):
    system, attitude = cases()[name]
    if attitude is True and name.startswith(("e(3)", "so(4)", "sl(2)")):
        attitude = "coadjoint"  # the matrix that acts on momenta
    x0 = 0.6 * np.random.default_rng(4).standard_normal((3, system.dim))
    sol = co.integrate(system, x0, (0, 20), 0.05, co.Splitting(order=2), attitude=attitude, save_every=40)
    space = np.einsum("kmij,kmj->kmi", sol.attitude, sol.x)
    size = np.abs(sol.attitude).max(axis=(2, 3)).max() * np.abs(sol.x).max()
    # 400 steps of at most 5 flows each, every one rounding sums of at most n products, and the shift's exponential.
    assert np.abs(space - sol.x[0]).max() <= 400 * 5 * system.dim * U * size


def test_members_and_backward_runs():
    system, _ = cases()["so(3), body"]
    x0 = np.array([[0.3, 1.0, -0.5], [1.0, -0.2, 0.4]])
    together = co.integrate(system, x0, (0, 5), 0.05, attitude=True)
    for member, x in enumerate(x0):
        alone = co.integrate(system, x, (0, 5), 0.05, attitude=True)
        np.testing.assert_array_equal(alone.attitude, together.attitude[:, member])
    back = co.integrate(system, together.x[-1, 0], (5, 0), 0.05, attitude=together.attitude[-1, 0])
    assert np.abs(back.attitude[-1] - np.eye(3)).max() < 1e-13


def test_the_stepper_gives_the_whole_group_element():
    system, _ = cases()["so(3), body"]
    x = np.array([0.3, 1.0, -0.5])
    g = co.stepper(system, co.Splitting(order=2), 0.01).group(x)
    assert np.abs(g - system.exact(x, 0.01, attitude=True)[1]).max() < 1e-6

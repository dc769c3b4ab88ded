"""Langevin dynamics of bodies and molecules: equipartition, rotational and translational diffusion."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import coadjoint as co
from long import long_beyond, long_where
from refusals import refused
from rounding import UNIT_ROUNDOFF

F, FREE = co.forces, co.Splitting(parts="free_body")
MOMENTS = np.array([1.0, 2.0, 2.5])
TENSOR = np.array([[2.0, 0.3, 0.1], [0.3, 2.2, 0.2], [0.1, 0.2, 1.5]])
BODY = co.systems.body(MOMENTS)
THREE = co.systems.bodies([TENSOR, (2.0, 2.0, 0.0), MOMENTS], [1.0, 2.0, 3.0])


def mean_with_error(values):
    """Return the mean over times and members, (times, members, ...), and its standard error by the members."""
    each = values.mean(axis=0)
    return each.mean(axis=0), each.std(axis=0, ddof=1) / np.sqrt(len(each))


@pytest.mark.parametrize(
    ("system", "force"),
    [
        (BODY, F.Langevin(0.5, 0.3, seed=1)),
        (BODY, F.Langevin((0.5, 1.0, 0.0), 0.3, seed=1, stream=2)),
        (BODY, F.Langevin(np.r_[0.5, 0.1, 0.2, np.zeros(9)], 0.0, seed=1)),
        (THREE, F.Langevin(0.5, (0.3, 0.2, 0.0), seed=1)),
        (co.systems.heavy_top(), F.Langevin(0.7, 0.2, seed=2**40)),
        (co.systems.rigid_body(MOMENTS), F.Langevin((0.7, 0.2, 0.1), 0.2, seed=1)),
    ],
)
def test_the_flow_is_the_one_in_python(system, force):
    method = FREE if system in (BODY, THREE) else co.GaussLegendre(1)
    forced = system.with_forces(force)
    x0 = np.r_[np.resize([0.3, -0.2, 0.5], system.dim - 1), 1.0]
    if system is THREE:
        x0 = THREE.state(np.eye(3), 0.3 * np.eye(3), angular_velocities=np.array([[0.1, 0.2, 0.3]] * 3) * [1, 1, 0])
    found, plain = co.stepper(forced, method, 0.25)(x0, 0.7), co.methods.Forced(method).step(forced, x0, 0.7, 0.25)
    assert np.abs(found - plain).max() < 64 * UNIT_ROUNDOFF * np.abs(plain).max()
    _, tangents = co.prepare(forced, method, step=0.25).jvp(x0, (0.7, 0.95), {"x0": np.eye(system.dim)[:, :3]})
    each = [
        co.stepper(forced, method, 0.25)(x0 + d, 0.7)
        for side in (1, -1)
        for d in side * 2.0**-16 * np.eye(3, system.dim)
    ]
    expected = (np.array(each[:3]) - each[3:]).T * 2.0**15
    np.testing.assert_allclose(tangents.x[-1], expected, rtol=0, atol=1e-8 * np.abs(plain).max())


@pytest.mark.parametrize("unit", long_beyond(1, [1e30, 1.0, 1e-7]))
def test_free_bodies_have_the_density_of_the_temperature_at_any_step(unit):
    """In steps as long as the rotation: momenta of a general tensor, of a rod, and of linear motion, two at rest."""
    system, members, kT = THREE, 3000, np.array([0.3, 0.6, 1.2])
    hot = system.with_forces(F.Langevin(0.7 * unit, tuple(kT * unit**2), seed=3))
    x0 = np.tile(system.state(3.0 * np.eye(3)), (members, 1))
    x = co.integrate(hot, x0, (-2.0 / unit, 10.0 / unit), 1.0 / unit, FREE, save_every=12, watch=False).x[-1]
    L, v = system.angular_momentum(x) / unit, system.velocities(x) / unit
    error = np.sqrt(2.0 / members)
    for k, inverse in enumerate((np.linalg.inv(TENSOR), np.diag([0.5, 0.5, 0.0]), np.diag(1.0 / MOMENTS))):
        found = np.einsum("mi,ij,mj->m", L[:, k], inverse, L[:, k]) / kT[k]
        degrees = np.linalg.matrix_rank(inverse)
        assert abs(found.mean() / degrees - 1.0) < 3.0 * error / np.sqrt(degrees)
        assert abs((v[:, k] ** 2).mean() * system.masses[k] / kT[k] - 1.0) < 3.0 * error / np.sqrt(3.0)
    covariance = L[:, 0].T @ L[:, 0] / members / kT[0]
    scale = np.sqrt(np.outer(np.diag(TENSOR), np.diag(TENSOR)))
    assert np.all(np.abs(covariance - TENSOR) < 3.0 * error * scale)
    assert np.abs(L[:, 1, 2]).max() < 16 * UNIT_ROUNDOFF * np.abs(L[:, 1]).max()


def test_linear_motion_diffuses_as_the_steps_predict():
    """The exact variance of sums of the velocities of a chain with correlation exp(-rate h), from rest at r = 0."""
    system, members, kT, rate, h, steps = co.systems.bodies([MOMENTS], [2.0]), 2000, 0.5, 1.5, 0.8, 30
    x0 = np.tile(system.state([[0.0, 0.0, 0.0]]), (members, 1))
    x0[:, 12:15] = np.random.default_rng(1).standard_normal((members, 3)) * np.sqrt(2.0 * kT)
    hot = system.with_forces(F.Langevin(rate, kT, seed=3))
    r = system.positions(co.integrate(hot, x0, (0.0, steps * h), h, FREE, save_every=steps, watch=False).x[-1])
    c = np.exp(-rate * h)
    sums = steps * (1.0 + c) / (1.0 - c) - 2.0 * c * (1.0 - c**steps) / (1.0 - c) ** 2
    expected = h * h * kT / 2.0 * sums
    assert abs((r**2).mean() / expected - 1.0) < 3.0 * np.sqrt(2.0 / (3 * members))
    # At long times that of the diffusion constant, times (rate h/2) coth(rate h/2).
    long = 2.0 * kT / (2.0 * rate) * steps * h * 0.5 * rate * h / np.tanh(0.5 * rate * h)
    assert abs(expected / long - 1.0) < 1.0 / (rate * steps * h)


@pytest.mark.parametrize("h", [0.1, 0.05])
def test_rotational_diffusion_of_an_asymmetric_body(h):
    """Perrin (1934), Favro (1960): D_i = kT/(rate_i I_i); axes decorrelate at D_j + D_k, products of two at D_j + D_k +
    4 D_i. In D t inertia takes 1 - exp(-rate t) off rate t, and the step adds (rate h/2) coth(rate h/2).
    """
    members, rate, kT, end = 1200, np.array([8.0, 10.0, 16.0]), 0.3, 8.0
    hot = BODY.with_forces(F.Langevin(rate, kT, seed=4))
    omega = np.random.default_rng(2).standard_normal((members, 3)) * np.sqrt(kT / MOMENTS)
    x0 = BODY.state(np.tile(np.eye(3), (members, 1, 1)), omega)
    sol = co.integrate(hot, x0, (0.0, end), h, FREE, save_every=round(2.0 / h), watch=False)
    A = BODY.attitudes(sol.x)
    t = sol.t[1:, None]
    half = 0.5 * rate * h
    turned = kT / (MOMENTS * rate**2) * (rate * t - 1.0 + np.exp(-rate * t)) * half / np.tanh(half)
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        axis = A[..., i]
        of_axes = (axis[1:] * axis[0]).sum(axis=-1)
        product = A[..., :, None, j] * A[..., None, :, k]
        symmetric = (product + np.swapaxes(product, -1, -2)) / np.sqrt(2.0)
        of_products = (symmetric[1:] * symmetric[0]).sum(axis=(-2, -1))
        for found, decay in (
            (of_axes, turned[:, j] + turned[:, k]),
            (of_products, turned.sum(axis=1) + 3.0 * turned[:, i]),
        ):
            error = found.std(axis=1, ddof=1) / np.sqrt(members)
            assert np.all(error < 0.02) and np.all(np.abs(found.mean(axis=1) - np.exp(-decay)) < 3.0 * error)
    # Of other axes or of a sphere of the mean rate they would be off by more.
    sphere = np.exp(-2.0 * turned.mean(axis=1))
    assert np.abs(sphere - np.exp(-turned[:, 1] - turned[:, 2]))[-1] > 0.06


@pytest.mark.parametrize("h", long_where([0.001], [0.001, 0.002]))
def test_equipartition_of_a_water_cluster(h):
    """Linear and angular velocities of eight molecules of water at 298 K, in nm, ps and kJ/mol."""
    count, members, kT = 8, 16, 0.0083145 * 298.15
    water = co.systems.rigid_molecules(count=count)
    moments, masses = np.diag(water.inertias[0].tensor), water.masses[:, None]
    rng = np.random.default_rng(1)
    corners = 0.31 * np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    x0 = water.state(
        np.tile(corners, (members, 1, 1)),
        rng.standard_normal((members, count, 3)) * np.sqrt(kT / masses),
        Rotation.random(members * count, rng=rng).as_matrix().reshape(members, count, 3, 3),
        rng.standard_normal((members, count, 3)) * np.sqrt(kT / moments),
    )
    hot = water.with_forces(F.Langevin(10.0, kT, seed=3))
    sol = co.integrate(hot, x0, (0.0, 1.5), h, FREE, save_every=round(0.1 / h), watch=False)
    kinetic = np.stack([moments * sol.angular_velocity[5:] ** 2, masses * sol.velocities[5:] ** 2], axis=-2)
    found, error = mean_with_error(kinetic.mean(axis=2) / kT)
    assert np.all(error < 0.07) and np.all(np.abs(found - 1.0) < 3.0 * error), (found, error)
    total, error = mean_with_error(kinetic.mean(axis=(2, 3, 4)) / kT)
    assert error < 0.025 and abs(total - 1.0) < 3.0 * error


def test_balance_members_and_resumption(tmp_path):
    """The work is on H, members have the noise of their streams, and an archived run resumes with the same bits."""
    hot = THREE.with_forces(F.Langevin(0.5, 0.3, seed=1))
    x0 = np.tile(THREE.state(3.0 * np.eye(3)), (3, 1))
    sol = co.integrate(hot, x0, (0.5, 4.5), 0.25, FREE)
    np.testing.assert_allclose(sol.energy - sol.energy[0], sol.work["Langevin"]["energy"], rtol=0, atol=1e-13)
    assert sol.balance()["X.Y [1]"] < 1e-14
    alone = THREE.with_forces(F.Langevin(0.5, 0.3, seed=1, stream=2))
    assert np.array_equal(co.integrate(alone, x0[0], (0.5, 4.5), 0.25, FREE).x, sol.x[:, 2])
    co.integrate(hot, x0, (0.5, 2.5), 0.25, FREE, archive=tmp_path / "run.zarr")
    assert np.array_equal(co.resume(tmp_path / "run.zarr", 4.5).x, sol.x)


REFUSED = [
    (lambda: F.Langevin(0.1, 0.3), TypeError, ("Langevin", "seed")),
    (lambda: F.Langevin(-0.1, 0.3, seed=1), ValueError, ("rate", "-0.1")),
    (lambda: F.Langevin(((0.1, 0.2, -0.5),), 0.3, seed=1), ValueError, ("rate", "-0.5")),
    (lambda: F.Langevin(np.ones((2, 2)), 0.3, seed=1), ValueError, ("rate", "(2, 2)")),
    (lambda: F.Langevin(0.1, (0.3, -0.2), seed=1), ValueError, ("temperature", "-0.2")),
    (lambda: BODY.with_forces(F.Langevin((0.1, 0.2), 0.3, seed=1)), ValueError, ("rate", "(2,)", "(12,)")),
    (lambda: BODY.with_forces(F.Langevin(np.ones(12), 0.3, seed=1)), ValueError, ("X1", "axis")),
    (lambda: THREE.with_forces(F.Langevin(0.1, (0.3, 0.2), seed=1)), ValueError, ("temperature", "2", "3 bodies")),
    (
        lambda: THREE.with_forces(F.Langevin(((0.1, 0.2, 0.3),) * 3, 0.3, seed=1)),
        ValueError,
        ("rate", "bodies", "principal"),
    ),
    (lambda: co.systems.spin_lattice().with_forces(F.Langevin(0.1, 0.3, seed=1)), ValueError, ("spin", "HeatBath")),
    (
        lambda: co.systems.body(MOMENTS, wheels=0.1 * np.eye(3)).with_forces(F.Langevin(0.1, 0.3, seed=1)),
        ValueError,
        ("kinetic energy", "body"),
    ),
    (
        lambda: co.systems.satellite_on_orbit().with_forces(F.Langevin(0.1, 0.3, seed=1)),
        ValueError,
        ("satellite_on_orbit", "turns"),
    ),
    (lambda: co.systems.sphere_euler(N=4).with_forces(F.Langevin(0.1, 0.3, seed=1)), ValueError, ("matrices",)),
    (
        lambda: co.integrate(BODY.with_forces(F.Langevin(0.1, 0.3, seed=1)), BODY.state(), (1, 0), 0.1),
        ValueError,
        ("Langevin", "backward"),
    ),
]


@pytest.mark.parametrize(("call", "error", "named"), REFUSED)
def test_refusals(call, error, named):
    with refused(error, *named):
        call()

"""Selective decay: against DOP853, energy and enstrophy, end states, other forces, units, members, refusals."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import coadjoint as co
from refusals import refused
from rounding import UNIT_ROUNDOFF
from same_runs import same_bits

Decay = co.forces.SelectiveDecay
GAUSS = co.IsospectralGauss(2)
SPHERE, TURNING = co.systems.sphere_euler(N=6), co.systems.sphere_euler(N=6, rotation=1.5)
TORUS, TINY_TORUS = co.systems.torus_euler(N=7), co.systems.torus_euler(N=3)
SYSTEMS = [SPHERE, TURNING, TORUS, co.systems.matrix_body((1.0, 2.0, 3.5, 4.0)), co.systems.rigid_body((1.0, 2.0, 2.5))]
SYSTEMS += [co.systems.spin_lattice("chain", 3), co.systems.so_n_body((1.0, 2.0, 3.5, 4.0))]
NAMES = ["sphere", "rotating sphere", "torus", "so(4) as matrices", "body", "spins", "so(4) as vectors"]


def commutator(A, B):
    return A @ B - B @ A


def field_of(s, rate, friction=0.0):
    """Return the vector field of a system with selective decay and linear friction, in NumPy."""

    def of_matrices(t, y):
        W = s.from_vector(y)
        P = s.stream(W) if s.linear is None else s.stream(W) + s.linear
        K = commutator(P, W)
        return s.to_vector(K + rate * commutator(P, K)) - friction * y

    def of_vectors(t, x):
        D = s.sign * s.algebra.coadjoint(s.hamiltonian.gradient(x, t))
        return D @ x + rate * (D @ (D @ x)) - friction * x

    return of_matrices if s.has_matrices else of_vectors


def reference(field, y0, span):
    return solve_ivp(field, span, y0, method="DOP853", rtol=1e-12, atol=1e-14).y[:, -1]


def start_of(s):
    if s in (SPHERE, TURNING, TORUS):
        return s.random(seed=1, degrees=(1, 3), energy=1.0)
    x = np.cos(1.0 + 2.0 * np.arange(s.dim))
    return s.algebra.projected(x.reshape(s.shape)) if s.has_matrices else x


def scheme_of(s):
    return GAUSS if s.has_matrices else co.GaussLegendre(2)


def in_numbers(s, x):
    return s.to_vector(x) if s.has_matrices else np.asarray(x)


def ends_of(s, forces, span, steps, **options):
    """Return the ends of runs with steps of these numbers, as vectors."""
    driven = s.with_forces(*forces)
    h = abs(span[1] - span[0]) / np.array(steps)
    runs = (co.integrate(driven, start_of(s), span, one, scheme_of(s), **options) for one in h)
    return [in_numbers(s, run.x[-1]) for run in runs]


@pytest.mark.parametrize("s", SYSTEMS, ids=NAMES)
def test_runs_converge_to_the_equation_with_order_two(s):
    x0, rate = start_of(s), 0.3
    exact = reference(field_of(s, rate), in_numbers(s, x0), (0.5, 1.5))
    coarse, fine = (np.abs(x - exact).max() for x in ends_of(s, [Decay(rate)], (0.5, 1.5), (16, 32)))
    assert 3.5 < coarse / fine < 4.5
    assert np.abs(in_numbers(s, x0) - exact).max() > 64 * fine


@pytest.mark.parametrize("s", SYSTEMS, ids=NAMES)
@pytest.mark.parametrize("stiff", [False, True], ids=["", "stiff"])
def test_the_energy_is_kept_and_the_enstrophy_falls_in_every_step(s, stiff):
    x0 = start_of(s)
    u = s.hamiltonian.gradient(in_numbers(s, x0)) if not s.has_matrices else s.stream_of(x0)
    size = np.linalg.norm(u, 2)
    h = 0.25 / size  # half of it at each end of a step; rate h |P|^2 is about one, or about 1/16
    rate = (1.0 if stiff else 0.0625) / (h * size**2)
    sol = co.integrate(s.with_forces(Decay(rate)), x0, (0.0, 40 * h), h, scheme_of(s))
    squares = np.sum(np.abs(sol.x.reshape(len(sol.t), -1)) ** 2, axis=-1)
    # Two flows a step, each off by the round-off of |P| |W| of all numbers.
    bound = (
        64 * UNIT_ROUNDOFF * 80 * np.sqrt(s.dim) * abs(size * np.sqrt(squares[0])) * abs(getattr(s, "energy_unit", 1))
    )
    assert np.abs(sol.work["SelectiveDecay"]["energy"]).max() < bound
    assert np.all(np.diff(squares) < 4 * UNIT_ROUNDOFF * squares[0]) and squares[-1] < 0.999 * squares[0]


def test_on_the_smallest_torus_the_gravest_modes_are_left():
    # P = -W of |n|^2 = 1 and -W/2 of |n|^2 = 2, so that all steady flows commute with both parts; those of the second
    # are unstable. At the end enstrophy is twice the energy.
    s = TINY_TORUS
    W0 = s.from_modes({(1, 0): 0.3, (0, 1): 0.4 - 0.2j, (1, 1): 0.5j, (1, -1): 0.2})
    sol = co.integrate(s.with_forces(Decay(4.0)), W0, (0.0, 400.0), 0.5, GAUSS, save_every=100)
    end, energy = sol.x[-1], s.energy(sol.x[-1])
    assert np.abs(end + s.stream_of(end)).max() < 1e-6 * np.abs(end).max()
    assert abs(s.enstrophy_spectrum(end)[1].sum() / energy - 1.0) < 1e-12
    assert s.enstrophy_spectrum(W0)[1].sum() / s.energy(W0) > 1.1


def test_a_body_ends_in_the_rotation_of_least_momentum():
    body = co.systems.rigid_body((1.0, 2.0, 2.5))
    sol = co.integrate(body.with_forces(Decay(0.5)), (1.0, 2.0, 3.0), (0.0, 200.0), 0.125)
    least = np.sqrt(2.0 * body.energy((1.0, 2.0, 3.0)) * 1.0)
    assert np.abs(np.abs(sol.x[-1]) - (least, 0.0, 0.0)).max() < 1e-3
    u = body.hamiltonian.gradient(sol.x[-1])
    assert np.abs(sol.x[-1] - (sol.x[-1] @ u) / (u @ u) * u).max() < 1e-6


def test_steady_flows_stay_also_those_that_are_no_multiples_of_their_stream():
    zonal = SPHERE.from_modes({(1, 0): 1.0, (3, 0): 0.5, (4, 0): -0.3})
    sol = co.integrate(SPHERE.with_forces(Decay(5.0)), zonal, (0.0, 4.0), 0.5, GAUSS)
    assert np.abs(sol.x - zonal).max() < 64 * UNIT_ROUNDOFF * np.abs(zonal).max()


def test_a_fluid_ends_at_a_steady_flow():
    s = co.systems.sphere_euler(N=3)
    W0 = s.random(seed=2, degrees=(1, 2), energy=1.0)
    sol = co.integrate(s.with_forces(Decay(2.0)), W0, (0.0, 200.0), 0.25, GAUSS, save_every=100)
    W = sol.x[-1]
    P = s.stream_of(W)
    assert np.abs(commutator(P, W)).max() < 1e-6 * np.abs(P).max() * np.abs(W).max()
    assert np.abs(s.angular_momentum(W) - s.angular_momentum(W0)).max() > 1e-3 * np.abs(s.angular_momentum(W0)).max()
    # The rest of degree 2 is zonal about the axis of degree 1, and stays, so that W is no multiple of P.
    assert np.abs(W + 2.0 * P).max() > 1e-3 * np.abs(W).max()
    assert 1.0 < s.enstrophy_spectrum(W)[1].sum() / (2.0 * s.energy(W)) < s.enstrophy_spectrum(W0)[1].sum() / 2.0


@pytest.mark.parametrize("other", [co.forces.Friction(0.2), co.forces.LinearDamping(0.2)], ids=["Friction", "damping"])
@pytest.mark.parametrize("turned", [False, True], ids=["first", "last"])
def test_beside_another_force_in_both_orders(other, turned):
    forces = [Decay(0.3), other][:: -1 if turned else 1]
    exact = reference(field_of(SPHERE, 0.3, 0.2), SPHERE.to_vector(start_of(SPHERE)), (0.0, 1.0))
    coarse, fine = (np.abs(x - exact).max() for x in ends_of(SPHERE, forces, (0.0, 1.0), (16, 32)))
    assert 3.5 < coarse / fine < 4.5


@pytest.mark.parametrize("unit", [2.0**-23, 2.0**100], ids=["1e-7", "1e30"])
def test_in_other_units(unit):
    (plain,) = ends_of(SPHERE, [Decay(0.3)], (0.0, 1.0), (16,))
    W0, span = unit * start_of(SPHERE), (0.0, 1.0 / unit)
    sol = co.integrate(SPHERE.with_forces(Decay(0.3 / unit)), W0, span, span[1] / 16, GAUSS)
    assert np.abs(SPHERE.to_vector(sol.x[-1]) / unit - plain).max() < 1e-13 * np.abs(plain).max()


def test_members_on_threads_and_resumed_archives_have_the_bits_of_one_run(tmp_path):
    driven, starts = TORUS.with_forces(Decay(0.5)), [start_of(TORUS), 2.0 * start_of(TORUS), -start_of(TORUS)]
    together = co.integrate(driven, starts, (1.0, 2.0), 0.125, GAUSS, threads=2)
    for m, start in enumerate(starts):
        assert same_bits(together.x[:, m], co.integrate(driven, start, (1.0, 2.0), 0.125, GAUSS).x)
    archive = tmp_path / "run.zarr"
    co.integrate(driven, starts, (1.0, 1.5), 0.125, GAUSS, archive=archive)
    assert same_bits(np.asarray(co.resume(archive, t_end=2.0).x[-1]), together.x[-1])


def test_batches_of_bodies_and_threads_that_share_a_lattice():
    bodies = [
        co.systems.rigid_body((1.0, 2.0, 2.0 + 0.25 * m)).with_forces(Decay(0.1 * m), co.forces.LinearDamping(0.1))
        for m in range(3)
    ]
    together = co.integrate(co.batch(bodies), [(1.0, 2.0, 3.0)] * 3, (0.0, 1.0), 0.125)
    for m, body in enumerate(bodies):
        assert same_bits(together.x[:, m], co.integrate(body, (1.0, 2.0, 3.0), (0.0, 1.0), 0.125).x)
    lattice = co.systems.spin_lattice("chain", 4000).with_forces(Decay(0.1))
    x0 = np.cos(1.0 + np.arange(lattice.dim))
    one, two = (co.integrate(lattice, x0, (0.0, 0.25), 0.125, threads=threads).x for threads in (1, 2))
    assert same_bits(one, two) and np.abs(one[-1] - one[0]).max() > 1e-3


@pytest.mark.parametrize("family", ["su", "so"])
def test_a_stream_that_is_a_function(family):
    weights = (0.2 + np.add.outer(np.arange(4.0), np.arange(4.0))) * (1.0 - np.eye(4))
    algebra, rng = co.MatrixAlgebra(family, 4), np.random.default_rng(1)
    W0, linear = (
        algebra.projected(rng.normal(size=(4, 4)) + (1j * rng.normal(size=(4, 4)) if family == "su" else 0.0))
        for _ in range(2)
    )
    ends = []
    for stream in (co.systems.Weights(weights), lambda W: weights * W):
        s = co.MatrixSystem(algebra, stream, linear).with_forces(Decay(0.05))
        sol = co.integrate(s, W0, (0.0, 0.5), 0.03125, GAUSS)
        assert np.abs(sol.work["SelectiveDecay"]["energy"]).max() < 1e-13
        ends.append(sol.x[-1])
    assert np.abs(ends[0] - ends[1]).max() < 1e-12 and np.abs(ends[0] - W0).max() > 0.1


def test_a_dye_stays_with_the_fluid():
    s = co.systems.passive_scalar(N=6)
    dye, W = s.fluid.from_modes({(1, 0): 1.0, (2, 1): 0.3}), start_of(SPHERE)
    sol = co.integrate(s.with_forces(Decay(0.3)), np.stack([dye, W]), (0.0, 1.0), 0.0625, GAUSS)
    (alone,) = ends_of(SPHERE, [Decay(0.3)], (0.0, 1.0), (16,))
    assert np.abs(SPHERE.to_vector(sol.x[-1, 1]) - alone).max() < 1e-12
    assert np.array_equal(sol.work["SelectiveDecay"]["tr Theta^2"], np.zeros(len(sol.t)))
    assert np.abs(sol.work["SelectiveDecay"]["energy"]).max() < 1e-13


@pytest.mark.parametrize("s", [co.systems.sphere_euler(N=3), SYSTEMS[4]], ids=["fluid", "body"])
def test_derivatives(s):
    s = s.in_numbers if s.has_matrices else s
    x0 = s.to_vector(s.fluid.random(seed=1, degrees=(1, 2))) if s.has_matrices else start_of(s)
    driven, rng = s.with_forces(Decay(0.4)), np.random.default_rng(2)
    v = rng.standard_normal(s.dim)
    if s.has_matrices:
        v = s.to_vector(s.algebra.projected(s.from_vector(v)))
    step = co.methods.Forced(scheme_of(s))
    found = step.tangent(driven, x0, 0.0, 0.125)[1] @ v
    e = 2.0**-17
    ahead, behind = (step.step(driven, x0 + side * e * v, 0.0, 0.125) for side in (1.0, -1.0))
    assert np.abs(found - (ahead - behind) / (2.0 * e)).max() < 1e-8


@pytest.mark.parametrize(
    ("call", "named"),
    [
        (lambda: Decay(-0.1), ("rate", "-0.1")),
        (lambda: Decay(np.nan), ("rate",)),
        (lambda: co.systems.reduced_mhd(5).with_forces(Decay(0.1)), ("reduced_mhd", "passive_scalar")),
        (lambda: co.systems.heavy_top().with_forces(Decay(0.1)), ("Casimir", "heavy_top")),
        (lambda: co.systems.toda(4).with_forces(Decay(0.1)), ("SelectiveDecay",)),
        (lambda: co.systems.riccati().with_forces(Decay(0.1)), ("Casimir",)),
        (
            lambda: co.MatrixSystem(co.MatrixAlgebra("gl", 3), lambda W: 2.0 * W).with_forces(Decay(0.1)),
            ("gl", "skew-Hermitian"),
        ),
        (lambda: ends_of(SPHERE, [Decay(0.1)], (1.0, 0.0), (8,)), ("SelectiveDecay", "backward")),
        (
            lambda: co.integrate(SYSTEMS[4].with_forces(Decay(0.1)), (1, 2, 3), (0, 1), 0.125, co.Splitting(order=4)),
            ("SelectiveDecay", "backward"),
        ),
    ],
)
def test_refused(call, named):
    with refused((ValueError, TypeError), *named):
        call()


def test_a_step_that_is_too_stiff_is_named():
    with pytest.raises(co.IntegrationError, match=r"smaller step than 0\.125") as caught:
        ends_of(SPHERE, [Decay(1e5)], (0.0, 1.0), (8,))
    assert caught.value.step == 1


def test_derivatives_in_a_field_that_depends_on_time():
    """Begun at a time other than zero: derivatives of the decay have the field of its midpoint."""
    field = co.Hamiltonian(
        lambda x, t: np.cos(t) * x[2] + 0.5 * x[0] ** 2,
        lambda x, t: np.array([x[0], 0.0, np.cos(t)]),
        lambda x, t: np.diag([1.0, 0.0, 0.0]),
    )
    driven = co.LiePoissonSystem(co.algebras.so(3), field).with_forces(Decay(0.4))
    step, x0, e = co.methods.Forced(co.GaussLegendre(2)), np.array([0.6, -0.4, 0.9]), 2.0**-17
    found = step.tangent(driven, x0, 2.0, 0.125)[1]
    ends = [[step.step(driven, x0 + side * e * v, 2.0, 0.125) for side in (1.0, -1.0)] for v in np.eye(3)]
    wanted = np.stack([(ahead - behind) / (2.0 * e) for ahead, behind in ends], axis=1)
    assert np.abs(found - wanted).max() < 1e-8

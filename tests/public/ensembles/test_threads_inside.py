"""Threads that share one large member: the same bits on any number of them."""

import os
import signal
import threading

import numpy as np
import pytest
import scipy.sparse as sparse

import coadjoint as co
from guards import FORKS
from long import long_where
from served import state_of

SPINS = 2500  # more angles of a part than one thread takes alone


def spins(seed, members=()):
    x = np.random.default_rng(seed).standard_normal((*members, SPINS, 3))
    return (x / np.linalg.norm(x, axis=-1, keepdims=True)).reshape(*members, 3 * SPINS)


def disordered():
    rng = np.random.default_rng(1)
    return co.systems.spin_lattice("chain", SPINS, exchange=rng.standard_normal(SPINS - 1), field=(0.1, 0.2, 0.3))


def coupled_copies():
    """Linear terms, whose rates are polynomials of other copies, on copies of sl(2), which shear and scale."""
    diagonal = np.tile([0.3, 0.0, 0.1], SPINS)
    return co.LiePoissonSystem(co.algebras.copies(co.algebras.sl(2), SPINS), co.Quadratic(diagonal), sign=-1)


SYSTEMS = {
    "uniform chain": lambda: co.systems.spin_lattice("chain", SPINS, periodic=True),
    "square": lambda: co.systems.spin_lattice("square", (50, 50), periodic=True, field=(0, 0, 0.5)),
    "vectors between components": lambda: co.systems.spin_lattice("square", (50, 50), dm=(0.1, 0.2, 0.3)),
    "disorder": disordered,
    "sl(2)": coupled_copies,
}
METHODS = {
    "plain": co.Splitting(order=2, compensated=False),
    "compensated": co.Splitting(order=4, compensated=True),
    "rational": co.Splitting(order=2, rotation="rational", parts="coordinates"),
}


STEPS = 70  # of every 64, those of earlier calls included, some are shared, whatever is faster


def run(system, x0, threads, method=METHODS["plain"], step=0.01, steps=STEPS, **options):
    given = {"watch": False, "save_every": 23} | options
    end = 1.0 + steps * step if system.forces else 1.0 - steps * step
    return co.integrate(system, x0, (1.0, end), step, method, threads=threads, **given)


def equal_ends():
    """Couplings of which the first and the last are equal, but not those between them."""
    exchange = np.random.default_rng(1).standard_normal(SPINS - 1)
    exchange[-1] = exchange[0]
    return co.systems.spin_lattice("chain", SPINS, exchange=exchange, field=(0.1, 0.2, 0.3))


@pytest.mark.thinned(12)
@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("make", [equal_ends, *SYSTEMS.values()])
def test_two_steps_are_those_of_the_plain_reading_of_the_program(make, threads):
    system, x0 = make(), spins(4)
    plain, method = x0, METHODS["plain"]
    for t in (1.0, 0.95):
        plain = method.step(system, plain, t, -0.05)
    sol = run(system, x0, threads, step=0.05, steps=2)
    # Each spin is rotated about three axes, forward and backward, by angles of a few products.
    assert np.abs(sol.x[-1] - plain).max() <= 2.0**-53 * 2 * 6 * 16 * np.abs(x0).max()


def copies(algebra, seed):
    """Copies of an algebra, each with a full quadratic energy of its own."""
    rng, n = np.random.default_rng(seed), algebra.dim
    count = SPINS
    blocks = rng.uniform(-0.2, 0.2, (count, n, n))
    blocks = blocks + blocks.transpose(0, 2, 1) + np.diag(np.linspace(1.0, 2.0, n))
    return co.LiePoissonSystem(co.algebras.copies(algebra, count), co.Quadratic(sparse.block_diag(blocks)), casimirs={})


def bodies():
    return copies(co.algebras.so(3), 7)


def unequal_heisenberg():
    """Heisenberg algebras of different structure constants, as one algebra."""
    triples = [(3 * k, 3 * k + 1, 3 * k + 2, 1.0 + k / SPINS) for k in range(SPINS)]
    return co.LiePoissonSystem(co.LieAlgebra(triples, dim=3 * SPINS), co.Quadratic(np.ones(3 * SPINS)), casimirs={})


def isotropic():
    return co.systems.spin_lattice("square", (50, 50), periodic=True, exchange=0.7)


def in_a_bath():
    system = co.systems.spin_lattice("square", (50, 50), periodic=True, on_site=(0, 0, 0.3))
    return system.with_forces(co.forces.HeatBath(0.2, temperature=0.4, seed=3))


def in_a_bath_of_gilbert():
    system = co.systems.spin_lattice("square", (50, 50), periodic=True, moments=np.linspace(1.0, 2.0, 2500))
    return system.with_forces(co.forces.Gilbert(0.2, temperature=0.4, seed=3))


def driven_in_a_bath():
    system = co.systems.spin_lattice("chain", SPINS, field=lambda t: np.array([0.3 * t, 0.0, 0.1]))
    return system.with_forces(co.forces.HeatBath(0.2, temperature=0.4, seed=3))


affine = co.LieAlgebra([(0, 1, 1, 1.0)], dim=2)
MORE = {
    **{
        f"{name}, {scheme}": (make, METHODS[scheme], 0.01)
        for name, make in SYSTEMS.items()
        for scheme in ("compensated", "plain")
    },
    "rational": (SYSTEMS["uniform chain"], METHODS["rational"], 0.01),
    "bonds": (isotropic, co.Splitting(parts="bonds"), 0.01),
    "free bodies": (bodies, co.Splitting(parts="free_body"), 0.01),
    "free bodies, compensated": (bodies, co.Splitting(parts="free_body", compensated=True), 0.01),
    "squares of each copy": (bodies, co.Splitting(), 0.01),
    "full copies of sl(2)": (lambda: copies(co.algebras.sl(2), 8), co.Splitting(), 0.01),
    "scalings and shears": (lambda: copies(affine, 9), co.Splitting(), 0.01),
    "shears by different constants": (unequal_heisenberg, co.Splitting(), 0.01),
    "Gauss": (isotropic, co.GaussLegendre(2), 0.05),
    "midpoint": (disordered, co.GaussLegendre(1), 0.05),
    "midpoint by Newton and Krylov": (isotropic, co.GaussLegendre(1), 0.8),
    "frozen": (disordered, co.ModifiedGaussLegendre(2), 0.05),
    "explicit": (disordered, co.ExplicitRungeKutta(), 0.05),
    "spherical midpoint": (isotropic, co.SphericalMidpoint(), 0.05),
    "Taylor": (isotropic, co.Taylor(order=6), 0.05),
    "heat bath": (in_a_bath, co.Splitting(), 0.01),
    "heat bath of Gilbert": (in_a_bath_of_gilbert, co.Splitting(), 0.01),
    "heat bath of driven spins": (driven_in_a_bath, co.Splitting(), 0.01),
    "two stages by Newton and Krylov": (isotropic, co.GaussLegendre(2), 0.8),
}


@pytest.mark.thinned(14)
@pytest.mark.filterwarnings("ignore::coadjoint.LargeStepWarning")
@pytest.mark.parametrize("name", long_where(["two stages by Newton and Krylov", "midpoint by Newton and Krylov"], MORE))
def test_every_scheme_on_large_states_has_the_same_bits_and_energies(name):
    make, method, step = MORE[name]
    system = make()
    x0 = spins(11).ravel()[: system.dim] if system.dim <= 3 * SPINS else None
    if x0 is None or system.dim != len(x0):
        x0 = 0.5 + 0.3 * np.random.default_rng(11).standard_normal(system.dim)
    # Steps by Newton's method take long. The first four of a call with another number of threads are two of each kind.
    few = step > 0.5
    options = {"watch": True, "step": step, "steps": 5 if few else 66}
    alone = run(system, x0, 1, method, **options)
    for threads in (3,) if few else (2, 7):
        shared = run(system, x0, threads, method, **options)
        np.testing.assert_array_equal(shared.x, alone.x)
        np.testing.assert_array_equal(shared.energy, alone.energy)
        changes = [sol.change() if system.forces else sol.drift() for sol in (shared, alone)]
        assert str(changes[0]) == str(changes[1])
        assert shared.stats.iterations == alone.stats.iterations


DIRECTIONS = 9  # more than the lanes of a register
WITHOUT = ("compensated", "rational", "Newton", "spherical", "Taylor", "heat bath")
DIFFERENTIATED = [name for name in MORE if not any(word in name for word in WITHOUT)]


def derivatives(system, method, step, threads, reverse="exact"):
    """Return tangents of a run, and the gradient of the sum of its last state by given weights."""
    rng, n = np.random.default_rng(5), system.dim
    x0, weights = 0.5 + 0.3 * rng.standard_normal(n), rng.standard_normal(n)
    directions = rng.standard_normal((n, DIRECTIONS))
    span, steps = (1.0, 1.0 + STEPS * step), STEPS
    forward, backward = [co.prepare(system, method, step, watch=False, threads=one) for one in threads]
    _, tangents = forward.jvp(x0, span, {"x0": directions}, save_every=steps)
    sol, pull = backward.vjp(x0, span, save_every=steps // 2, reverse=reverse)
    of_x = np.zeros(sol.x.shape)
    of_x[-1] = weights
    gradient = pull(of_x)
    # Adjoint to each other, to about 100 roundings of each vector in a step.
    difference = np.abs(weights @ tangents.x[-1] - gradient["x0"] @ directions)
    pairs = (weights, tangents.x[-1]), (gradient["x0"], directions)
    sizes = sum(np.linalg.norm(vector) * np.linalg.norm(columns, axis=0) for vector, columns in pairs)
    assert np.all(difference <= 2.0**-53 * 100 * steps * sizes)
    return tangents.x, tangents.energy, gradient


@pytest.mark.thinned(24)
@pytest.mark.parametrize(
    ("name", "reverse"),
    [(name, "exact") for name in DIFFERENTIATED]
    + [(name, "reversible") for name in ("square, plain", "disorder, plain", "bonds")],
)
def test_derivatives_have_the_same_bits(name, reverse):
    make, method, step = MORE[name]
    system = make()
    *alone, gradient = derivatives(system, method, step, (1, 1), reverse)
    *shared, other = derivatives(system, method, step, (2, 7), reverse)
    for found, expected in zip(shared, alone, strict=True):
        np.testing.assert_array_equal(found, expected)
    assert list(other) == list(gradient)
    for parameter in gradient:
        np.testing.assert_array_equal(other[parameter], gradient[parameter])


@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("fast", [(0, -1), (-1, 0)])
def test_leading_exponents_of_many_coordinates_are_their_rates(fast, threads):
    rates = np.random.default_rng(17).uniform(0.0, 0.1, SPINS)
    rates[list(fast)] = 3.0, 2.0
    # Of the two coordinates of a copy the second one grows at the rate, and the first one is constant.
    H = co.Quadratic(np.zeros(2 * SPINS), linear=np.stack([rates, np.zeros(SPINS)], axis=1).ravel())
    system = co.LiePoissonSystem(co.algebras.copies(affine, SPINS), H, sign=-1, casimirs={})
    step, counted, transient = 0.05, 5.0, 40.0  # by the transient the vectors have aligned, to exp(-40)
    x0 = np.zeros(2 * SPINS)
    options = {"exponents": 2, "transient": transient, "threads": threads}
    found = co.lyapunov(system, x0, (0.0, transient + counted), step, METHODS["plain"], **options)
    # In a step a rotation or growth of few operations, whose length is measured once for ten steps.
    np.testing.assert_allclose(found.exponents, [3.0, 2.0], rtol=0.0, atol=2.0**-53 * 16 / step)


spirals = co.LieAlgebra.from_brackets(
    5, {(0, i): {i: 0.1, j: w} for i, j, w in ((1, 2, 1), (2, 1, -1), (3, 4, 1), (4, 3, -1))}
)


@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("algebra", [co.algebras.so(3), co.algebras.e(3), spirals], ids=["so(3)", "e(3)", "spirals"])
@pytest.mark.thinned(2)
def test_copies_of_an_algebra_move_as_each_alone(algebra, threads):
    rng, count, steps, n = np.random.default_rng(20), 1100, STEPS, algebra.dim
    M, x0, weights = rng.uniform(0.5, 1.5, (count, n)), *rng.standard_normal((2, count, n))
    # The first coefficient of a row of equal ones, and the last, but not those between them.
    M[-1] = M[0]
    # A part of each coordinate of all copies: one slice of its angles for each thread.
    span, scheme = (1.0, 1.0 - 0.05 * steps), co.Splitting(order=2, parts=[range(k, n * count, n) for k in range(n)])
    copies = co.LiePoissonSystem(co.algebras.copies(algebra, count), co.Quadratic(M.ravel()), sign=-1, casimirs={})
    prepared = co.prepare(copies, scheme, 0.05, threads=threads)
    sol, pull = prepared.vjp(x0.ravel(), span, save_every=steps)
    gradient = pull(np.stack([np.zeros(n * count), weights.ravel()]))["x0"].reshape(count, n)
    directions = rng.standard_normal((count, n, DIRECTIONS))
    _, tangents = prepared.jvp(x0.ravel(), span, {"x0": directions.reshape(-1, DIRECTIONS)}, save_every=steps)
    changes = tangents.x[-1].reshape(count, n, DIRECTIONS)
    each = co.Splitting(order=2, parts=[[k] for k in range(n)])
    for one in (0, 1, 500, count - 2, count - 1):
        own = co.prepare(co.LiePoissonSystem(algebra, co.Quadratic(M[one]), sign=-1), each, 0.05)
        alone, pull = own.vjp(x0[one], span, save_every=steps)
        of_alone = pull(np.stack([np.zeros(n), weights[one]]))["x0"]
        _, tangents = own.jvp(x0[one], span, {"x0": directions[one]}, save_every=steps)
        # Of the angles and rotations of each part in a step, forward and backward.
        roundings = 2.0**-53 * 8 * n * steps
        assert np.abs(sol.x[:, n * one : n * one + n] - alone.x).max() <= roundings * np.abs(alone.x).max()
        assert np.abs(gradient[one] - of_alone).max() <= roundings * 4 * np.linalg.norm(of_alone)
        assert (
            np.abs(changes[one] - tangents.x[-1]).max() <= roundings * 4 * np.linalg.norm(tangents.x[-1], axis=0).max()
        )


def test_energies_summed_in_blocks_are_those_of_the_system():
    system, x0 = disordered(), spins(12)
    sol = run(system, x0, 3, watch=True)
    sizes = np.abs(system.hamiltonian.terms()[0].values) @ np.abs(
        x0[system.hamiltonian.terms()[0].rows] * x0[system.hamiltonian.terms()[0].indices]
    )
    for x, energy in zip(sol.x, sol.energy, strict=True):
        assert abs(energy - system.energy(x)) <= 2.0**-53 * len(x0) * sizes


@pytest.mark.parametrize("threads", [1, 5])
def test_spins_without_neighbours_at_the_end_of_a_lattice_precess(threads):
    edges = np.stack([np.arange(1499), np.arange(1, 1500)], axis=1)
    system = co.systems.spin_lattice(edges, SPINS, exchange=0.7, field=(0.0, 0.0, 0.5))
    x0 = spins(16)
    sol = co.integrate(system, x0, (0, 0.7), 0.01, METHODS["plain"], save_every=STEPS, threads=threads)
    alone = co.systems.spin_lattice(np.zeros((0, 2), dtype=int), SPINS - 1500, field=(0.0, 0.0, 0.5))
    exact = alone.exact(x0[4500:], 0.7)
    assert np.abs(sol.x[-1][4500:] - exact).max() < 16 * STEPS * 2.0**-53


def forced_fluid(system):
    noise = co.forces.RandomForcing(0.1, (2, 9), seed=4)
    return system.with_forces(co.forces.Viscosity(1e-3), noise)


LARGE_PRIME = 61  # whose transforms are convolutions
FLUIDS = {
    "lines": (lambda: co.systems.torus_euler(LARGE_PRIME), co.LineSplitting()),
    "torus": (lambda: co.systems.torus_euler(45), co.IsospectralGauss()),
    "torus, two stages": (lambda: co.systems.torus_euler(LARGE_PRIME), co.IsospectralGauss(stages=2)),
    "sphere": (lambda: co.systems.sphere_euler(48), co.IsospectralGauss()),
    "blocks of products": (lambda: co.systems.sphere_euler(133), co.IsospectralGauss()),
    "layers": (lambda: co.systems.layered_qg(N=66, gamma=((2.0, -1.0), (-1.0, 1.0))), co.IsospectralGauss()),
    "two fields": (lambda: co.systems.thermal_qg(N=70), co.IsospectralGauss(stages=2)),
    "products of general matrices": (lambda: co.systems.sphere_euler(40), co.CommutatorFree()),
    "waves": (lambda: forced_fluid(co.systems.torus_euler(LARGE_PRIME)), co.LineSplitting()),
    "harmonics": (lambda: forced_fluid(co.systems.sphere_euler(80)), co.IsospectralGauss()),
}


@pytest.mark.thinned(2)
@pytest.mark.parametrize("name", FLUIDS)
def test_fluids_have_the_same_bits(name):
    make, method = FLUIDS[name]
    system = make()
    W = state_of(system.unforced, 3)
    # The first four steps with another number of threads are two of each kind.
    alone, *others = [
        co.integrate(system, W, (1.0, 1.1), 0.02, method, save_every=1, threads=threads) for threads in (1, 2, 3)
    ]
    for shared in others:
        np.testing.assert_array_equal(shared.x, alone.x)
        np.testing.assert_array_equal(shared.energy, alone.energy)


def test_overflow_is_found_by_any_thread():
    system = SYSTEMS["sl(2)"]()
    for entry in (2, 3 * SPINS - 2):
        x0 = spins(5)
        x0[entry] = 1e300
        messages = set()
        for threads in (1, 2, 5):
            with pytest.raises(co.IntegrationError) as raised:
                run(system, x0, threads)
            messages.add(str(raised.value))
        assert len(messages) == 1


def test_threads_wait_between_calls():
    system, x0 = isotropic(), spins(14)
    body, states = co.systems.rigid_body(inertia=(1, 2, 2.5)), np.random.default_rng(3).standard_normal((200, 3))
    inside = co.prepare(system, METHODS["plain"], 0.01, watch=False, threads=4)
    members = co.prepare(body, co.Splitting(order=4), 0.05, threads=3)

    def count():
        return len(os.listdir("/proc/self/task")) if os.path.isdir("/proc/self/task") else threading.active_count()

    before = count()
    for _ in range(20):
        inside.run(x0, (0, 0.1))
        members.run(states, (0, 1))
    assert count() <= before + 3 + 3


@FORKS
@pytest.mark.skipif(not hasattr(os, "fork"), reason="processes of this system are not forked")
def test_a_forked_process_has_threads_of_its_own():
    system, x0 = isotropic(), spins(15)
    body, states = co.systems.rigid_body(inertia=(1, 2, 2.5)), np.random.default_rng(4).standard_normal((200, 3))
    inside = co.prepare(system, METHODS["plain"], 0.01, watch=False, threads=4)
    members = co.prepare(body, co.Splitting(order=4), 0.05, threads=3)
    wanted = inside.run(x0, (0, 0.7)).x, members.run(states, (0, 1)).x
    child = os.fork()
    if child == 0:
        signal.alarm(60)
        found = inside.run(x0, (0, 0.7)).x, members.run(states, (0, 1)).x
        os._exit(0 if all(np.array_equal(a, b) for a, b in zip(found, wanted, strict=True)) else 1)
    assert os.waitpid(child, 0)[1] == 0

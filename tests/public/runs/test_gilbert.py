"""Gilbert's damping and bath of spins: closed forms, the implicit equation, moments of sites, and two temperatures."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import coadjoint as co
from long import long_beyond
from refusals import refused
from rounding import UNIT_ROUNDOFF

F = co.forces
MOMENTS = (7.63, 2.2)  # of two sublattices of a ferrimagnet
LATTICE = {"tensor": (1.0, 0.8, 0.5), "dm": (0.1, 0.2, -0.3), "field": np.linspace(-1.0, 1.0, 15).reshape(5, 3)}
ALPHA, T = (0.1, 0.5, 0.0, 1.0, 2.0), (0.1, 0.2, 0.3, 0.0, 0.5)


def unit_spins(count, seed):
    S = np.random.default_rng(seed).standard_normal((count, 3))
    return S / np.linalg.norm(S, axis=1, keepdims=True)


def langevin(k):
    return 1.0 / np.tanh(k) - 1.0 / k


@pytest.mark.parametrize("unit", [1.0, 1e-7, 1e30])
@pytest.mark.parametrize("t0", [0.0, -3.0])
def test_a_spin_in_a_field_precesses_and_relaxes(unit, t0):
    """About its field B/mu at the rate f B/mu with f = 1/(1 + alpha^2), and to it as tanh(alpha f B t/mu)."""
    alpha, B = np.array([0.5, 0.05]), unit * np.array([2.0, 0.7])
    field = np.array([[0.0, 0.0, b] for b in B])
    free = co.systems.spin_lattice([], 2, field=field, moments=MOMENTS)
    system = free.with_forces(F.Gilbert(alpha))
    span, h = (t0 / unit, (t0 + 12.0) / unit), 0.25 / unit
    sol = co.integrate(system, [1.0, 0.0, 0.0, 0.6, 0.0, 0.8], span, h, co.Splitting(order=8))
    rate, t = B / MOMENTS / (1.0 + alpha**2), (sol.t - span[0])[:, None]
    along = np.tanh(alpha * rate * t + np.arctanh([0.0, 0.8]))
    across = np.sqrt(1.0 - along**2)
    expected = np.stack([across * np.cos(rate * t), -across * np.sin(rate * t), along], axis=-1)
    np.testing.assert_allclose(sol.x.reshape(-1, 2, 3), expected, rtol=0, atol=1e-9)
    # The energy is that of H, and what it loses is the work of the bath.
    np.testing.assert_allclose(sol.energy, -expected[..., 2] @ B, rtol=1e-9)
    np.testing.assert_allclose(sol.work["Gilbert"]["energy"], sol.energy - sol.energy[0], rtol=1e-9, atol=1e-9 * unit)


def implicit_equation(system, alpha, moments):
    """Return the field of ``S' = S cross B + alpha/|S| S' cross S``, solved for S' of each spin."""

    def field(t, y):
        S = y.reshape(-1, 3)
        B = -system.hamiltonian.gradient(y, t).reshape(-1, 3) / np.reshape(moments, (-1, 1))
        rates = []
        for s, b, a in zip(S, B, alpha, strict=True):
            across = np.cross(np.eye(3), s)  # rows e_i cross s: S' cross s is across.T S'
            rates.append(np.linalg.solve(np.eye(3) - a / np.linalg.norm(s) * across.T, np.cross(s, b)))
        return np.ravel(rates)

    return field


@pytest.mark.parametrize("way", [1.0, -1.0])
@pytest.mark.parametrize("moments", [1.0, (1.0, 3.0, 0.5, 2.0, 7.63)], ids=["equal", "moments"])
def test_orders_against_the_implicit_equation(moments, way):
    """Spins of different lengths, in a field of the time beside their own, from a time other than zero."""
    fields = LATTICE["field"]

    def turning(t):
        return fields + 0.3 * np.sin(2.0 * t)

    free = co.systems.spin_lattice("chain", 5, **{**LATTICE, "field": turning}, moments=moments)
    lengths = np.array([[1.0], [2.0], [0.5], [1.0], [3.0]])
    x0, span = (lengths * unit_spins(5, 1)).ravel(), (0.7, 0.7 + 1.5 * way)
    equation = implicit_equation(free, ALPHA, np.broadcast_to(moments, 5))
    wanted = solve_ivp(equation, span, x0, "DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
    damped = free.with_forces(F.Gilbert(ALPHA))
    np.testing.assert_allclose(damped.vector_field(x0, 0.7), equation(0.7, x0), rtol=0, atol=1e-14)
    for method, order in ((co.Splitting(), 2), (co.Splitting(order=4), 4), (co.GaussLegendre(2), 2)):
        errors = [np.abs(co.integrate(damped, x0, span, h, method).x[-1] - wanted).max() for h in (0.05, 0.025)]
        assert errors[1] < 0.02 and abs(np.log2(errors[0] / errors[1]) - order) < 0.3, (method, errors)


def of_third_degree():
    cubic = co.Polynomial({(1, 0, 0) * 3: 1.0, (0, 0, 1, 0, 0, 2, 0, 0, 0): -0.5, (0, 1) + (0,) * 7: 0.3})
    return co.LiePoissonSystem(co.algebras.copies(co.algebras.so(3), 3), cubic)


def alternating():
    """Two spins whose coordinates alternate, of brackets 2 and -1, and a coordinate that commutes with all others."""
    brackets = {}
    for (i, j, k), c in {(0, 2, 4): 2.0, (1, 3, 6): -1.0}.items():
        brackets.update({(i, j): {k: c}, (j, k): {i: c}, (i, k): {j: -c}})
    M = np.eye(7) + 0.2 * np.add.outer(np.arange(7.0), np.arange(7.0)) ** 0.5
    return co.LiePoissonSystem(co.LieAlgebra.from_brackets(7, brackets), co.Quadratic(M))


SYSTEMS = {
    "chain": lambda: co.systems.spin_lattice("chain", 5, **LATTICE, moments=(1.0, 3.0, 0.5, 2.0, 7.63)),
    "seventeen": lambda: co.systems.spin_lattice("chain", 17, moments=2.0, field=(0.0, 0.1, 0.4)),
    "dipoles": lambda: co.systems.spin_lattice("square", (2, 3), dipolar=0.5, moments=2.0),
    "third degree": of_third_degree,
    "alternating": alternating,
}


@pytest.mark.parametrize("name", SYSTEMS)
def test_the_flow_is_the_one_in_python(name):
    """Damping and bath, also of each spin, of different lengths, one of them zero."""
    system = SYSTEMS[name]()
    spins = system.dim // 3
    x0 = np.resize([0.4, -0.9, 0.3, 2.0, -1.2, 0.3, 0.7], system.dim)
    if name != "alternating":
        x0[3:6] = 0.0
    some = np.resize(ALPHA, spins), np.resize(T, spins)
    for force in (F.Gilbert(0.3), F.Gilbert(some[0]), F.Gilbert(0.7, 0.5, seed=3, stream=2), F.Gilbert(*some, seed=5)):
        forced, method = system.with_forces(force), co.GaussLegendre(1)
        found = co.stepper(forced, method, 0.125)(x0, 0.7)
        plain = co.methods.Forced(method).step(forced, x0, 0.7, 0.125)
        assert np.abs(found - plain).max() < 2048 * UNIT_ROUNDOFF * np.abs(x0).max(), force
        assert np.abs(found - co.stepper(system, method, 0.125)(x0, 0.7)).max() > 1e-3


@pytest.mark.parametrize("name", long_beyond(1, ["chain", "alternating"]))
def test_derivatives_along_a_path(name):
    """By the state and both parameters, forward and backward, against differences of runs with the same noise."""
    system, d = SYSTEMS[name](), 2.0**-16
    x0, spins = np.resize([0.4, -0.9, 0.3, 2.0, -1.2, 0.3, 0.7], system.dim), len(np.resize(ALPHA, system.dim // 3))
    values = {"Gilbert.alpha": np.linspace(0.2, 0.9, spins), "Gilbert.temperature": np.linspace(0.1, 0.6, spins)}

    def ready(alpha, kT):
        return co.prepare(system.with_forces(F.Gilbert(tuple(alpha), tuple(kT), seed=3)), co.GaussLegendre(2), 0.125)

    run, weights = ready(*values.values()), np.cos(np.arange(system.dim))
    span = (0.5, 0.75)
    direction = {"x0": np.sin(1.0 + np.arange(system.dim)), **{key: np.cos(one) for key, one in values.items()}}
    moved = [
        ready(*(one + way * d * direction[key] for key, one in values.items()))
        .run(x0 + way * d * direction["x0"], span)
        .x[-1]
        for way in (1.0, -1.0)
    ]
    expected = weights @ (moved[0] - moved[1]) / (2.0 * d)
    _, tangents = run.jvp(x0, span, direction)
    assert abs(weights @ tangents.x[-1] - expected) < 1e-7 * max(1.0, abs(expected))
    sol, pullback = run.vjp(x0, span)
    gradient = pullback(x=np.where(np.arange(len(sol.t))[:, None] == len(sol.t) - 1, weights, 0.0))
    found = sum(np.sum(gradient[key] * direction[key]) for key in direction)
    assert abs(found - expected) < 1e-7 * max(1.0, abs(expected))


def mean_with_error(values):
    """Return the mean over times and members, (times, members, ...), and its standard error by the members."""
    each = values.mean(axis=0)
    return each.mean(axis=0), each.std(axis=0, ddof=1) / np.sqrt(len(each))


def after_relaxation(system, force, h, members, end, seed):
    starts = np.stack([unit_spins(system.dim // 3, seed + k).ravel() for k in range(members)])
    every = max(1, round(end / 20 / h))
    run = co.integrate(system.with_forces(force), starts, (0.0, end), h, save_every=every, watch=False)
    return run.x[10:].reshape(-1, members, system.dim // 3, 3), run


@pytest.mark.parametrize(("h", "unit"), long_beyond(2, [(0.5, 1.0), (0.25, 1e30), (0.25, 1e-7)]))
@pytest.mark.parametrize("kT", [0.8, (0.4, 1.6)], ids=["one temperature", "two temperatures"])
def test_sublattices_of_different_moments_have_their_temperatures(kT, h, unit):
    """Each spin has the magnetization L(B/kT) for any moments and damping constants; errors of 0.6 per cent."""
    B = np.array([2.0, 0.7])
    system = co.systems.spin_lattice([], 2, field=[[0.0, 0.0, unit * b] for b in B], moments=(2.0, 0.6))
    bath = F.Gilbert((0.8, 0.3), unit * np.asarray(kT), seed=1)
    S, _ = after_relaxation(system, bath, h / unit, 600, 40.0 / unit, 10)
    mean, error = mean_with_error(S[..., 2])
    assert np.all(error < 0.012) and np.all(np.abs(mean - langevin(B / np.asarray(kT))) < 3.0 * error)


@pytest.mark.parametrize("h", [0.25, 0.125])
def test_a_dimer_of_different_moments_in_a_bath(h):
    """Two coupled spins with anisotropy: the mean energy and its parts, by quadrature over both directions."""
    J, B, K, kT = -1.0, np.array([1.2, 0.3]), 0.5, 0.6
    system = co.systems.spin_lattice(
        "chain", 2, exchange=J, field=[[0.0, 0.0, b] for b in B], on_site=(0.0, 0.0, K), moments=(2.0, 0.6)
    )
    z, weight = np.polynomial.legendre.leggauss(40)
    turn = 2.0 * np.pi * np.arange(40) / 40
    first, second = z[:, None, None], z[None, :, None]
    bond = first * second + np.sqrt((1.0 - first**2) * (1.0 - second**2)) * np.cos(turn)
    energy = -J * bond - B[0] * first - B[1] * second - K * (first**2 + second**2)
    density = weight[:, None, None] * weight[None, :, None] * np.exp(-energy / kT)
    S, _ = after_relaxation(system, F.Gilbert(1.0, kT, seed=2), h, 600, 40.0, 1000)
    found = -J * (S[:, :, 0] * S[:, :, 1]).sum(axis=-1) - S[..., 2] @ B - K * (S[..., 2] ** 2).sum(axis=-1)
    for values, exact in ((found, energy), (S[:, :, 0, 2], first), (S[:, :, 1, 2], second)):
        mean, error = mean_with_error(values)
        assert error < 0.015 and abs(mean - (density * exact).sum() / density.sum()) < 3.0 * error


def test_heat_flows_from_the_hot_to_the_cold_site():
    """What one bath gives the other takes, and the energy between them stays; with equal temperatures nothing flows."""
    dimer = co.systems.spin_lattice("chain", 2, moments=(1.0, 2.0))
    starts = np.stack([unit_spins(2, k).ravel() for k in range(300)])
    for hot, cold in ((2.0, 0.2), (0.7, 0.7)):
        baths = F.Gilbert((0.5, 0.0), hot, seed=1), F.Gilbert((0.0, 0.3), cold, seed=2)
        sol = co.integrate(dimer.with_forces(*baths), starts, (0.0, 40.0), 0.25, co.GaussLegendre(2), save_every=40)
        given, taken = (sol.work[name]["energy"][-1] - sol.work[name]["energy"][1] for name in ("Gilbert", "Gilbert 2"))
        flow, error = given.mean(), given.std(ddof=1) / np.sqrt(len(given))
        assert np.abs(given + taken - (sol.energy[-1] - sol.energy[1])).max() < 1e-10
        assert flow > 10.0 * error if hot > cold else abs(flow) < 3.0 * error
    together = F.Gilbert((0.2, 1.0), (1.0, 0.2), seed=1)
    S, _ = after_relaxation(dimer, together, 0.25, 300, 40.0, 5)
    mean, error = mean_with_error(-(S[:, :, 0] * S[:, :, 1]).sum(axis=-1))
    cold_energy, hot_energy = -langevin(1.0 / 0.2), -langevin(1.0)
    assert cold_energy + 3.0 * error < mean < hot_energy - 3.0 * error


def test_temperatures_of_groups_in_the_bath_of_landau_and_lifshitz():
    B, kT = np.array([2.0, 0.7]), (0.4, 1.6)
    system = co.systems.spin_lattice([], 2, field=[[0.0, 0.0, b] for b in B])
    S, _ = after_relaxation(system, F.HeatBath(0.5, temperature=kT, seed=1), 0.25, 600, 40.0, 10)
    mean, error = mean_with_error(S[..., 2])
    assert np.all(error < 0.012) and np.all(np.abs(mean - langevin(B / np.asarray(kT))) < 3.0 * error)
    metric = np.linspace(0.5, 1.0, 6)
    both = [system.with_forces(F.HeatBath(0.3, metric, temperature=one, seed=1)) for one in (0.4, (0.4, 0.4))]
    x0 = unit_spins(2, 1).ravel()
    ends = [co.stepper(one, co.Splitting(), 0.25)(x0, 0.5) for one in both]
    np.testing.assert_allclose(*ends, rtol=0, atol=64 * UNIT_ROUNDOFF)


def su3_of_directions(vectors):
    """Return the coordinates of states of three levels on the dual of su(3), by its representation on R^6."""
    matrices = co.algebras.su(3).representation
    i = np.kron([[0.0, -1.0], [1.0, 0.0]], np.eye(3))
    assert np.allclose(matrices @ i, i @ matrices)
    real = np.concatenate([vectors.real, vectors.imag], axis=-1)
    return np.einsum("...a,ab,kbc,...c->...k", real, i, matrices, real)


@pytest.mark.parametrize(("kT", "expected"), long_beyond(1, [(0.125, 0.2473082), (0.5, 0.5443212)]))
def test_su3_spins_with_anisotropy_in_a_bath(kT, expected):
    """H = D (S^z)^2 of states of spin one: the energy is D u, u of the density 2 u on CP^2."""
    u, weight = np.polynomial.legendre.leggauss(60)
    u = 0.5 * (u + 1.0)
    density = weight * u * np.exp(-u / kT)
    assert abs((density * u).sum() / density.sum() - expected) < 1e-7
    rng = np.random.default_rng(3)
    psi = rng.standard_normal((200, 3)) + 1j * rng.standard_normal((200, 3))
    psi /= np.linalg.norm(psi, axis=1, keepdims=True)
    x0 = su3_of_directions(psi)
    linear, *_ = np.linalg.lstsq(np.column_stack([x0, np.ones(200)]), 1.0 - abs(psi[:, 1]) ** 2, rcond=None)
    energy = co.Quadratic(np.zeros(8), linear=linear[:8], constant=float(linear[8]))
    system = co.LiePoissonSystem(co.algebras.su(3), energy).with_forces(F.HeatBath(2.0, temperature=kT, seed=5))
    run = co.integrate(system, x0, (0.0, 20.0), 0.125, save_every=8)
    mean, error = mean_with_error(run.energy[5:])
    assert error < 0.006 * expected / 0.2473082 and abs(mean - expected) < 3.0 * error
    assert max(run.balance()[name] for name in run.balance() if name != "energy") < 1e-12


REFUSED = [
    (lambda: F.Gilbert(-0.1), ValueError, ("alpha", "Gilbert", "-0.1")),
    (lambda: F.Gilbert((0.1, -0.1)), ValueError, ("alpha", "-0.1")),
    (lambda: F.Gilbert(np.eye(3)), ValueError, ("alpha", "(3, 3)")),
    (lambda: F.Gilbert(0.1, (0.1, -2.0), seed=1), ValueError, ("temperature", "-2")),
    (lambda: F.Gilbert(0.1, 0.5), TypeError, ("Gilbert", "seed")),
    (lambda: co.systems.heavy_top().with_forces(F.Gilbert(0.1)), ValueError, ("heavy_top", "so(3)", "HeatBath")),
    (lambda: co.systems.sphere_euler(N=4).with_forces(F.Gilbert(0.1)), ValueError, ("sphere_euler", "so(3)")),
    (lambda: co.systems.spin_lattice().with_forces(F.Gilbert((0.1,) * 3)), ValueError, ("alpha", "3", "2 spins")),
    (
        lambda: co.systems.spin_lattice().with_forces(F.Gilbert(0.1, (0.1,) * 6, seed=1)),
        ValueError,
        ("temperature", "6", "2 spins"),
    ),
    (
        lambda: co.systems.spin_lattice().with_forces(F.HeatBath(0.1, temperature=(0.1,) * 6, seed=1)),
        ValueError,
        ("temperature", "6", "2 independent"),
    ),
    (
        lambda: co.systems.spin_lattice().with_forces(F.HeatBath(0.1, np.ones((6, 6)), (0.1, 0.2), seed=1)),
        ValueError,
        ("metric", "temperatures"),
    ),
    (lambda: co.systems.spin_lattice(moments=(1.0, 2.0, 3.0)), ValueError, ("moments", "(3,)", "(2,)")),
    (lambda: co.systems.spin_lattice(moments=(1.0, 0.0)), ValueError, ("moments", "0", "positive")),
    (lambda: co.systems.spin_lattice(moments=(1.0, 2.0), dipolar=0.1), ValueError, ("dipolar", "moments")),
]


@pytest.mark.parametrize(("call", "error", "named"), REFUSED)
def test_refusals(call, error, named):
    with refused(error, *named):
        call()


def test_only_a_bath_acts_forward_alone():
    x0, chain = unit_spins(2, 1).ravel(), co.systems.spin_lattice(moments=MOMENTS)
    forth = co.integrate(chain.with_forces(F.Gilbert(0.1)), x0, (0.5, 1.5), 0.125)
    back = co.integrate(chain.with_forces(F.Gilbert(0.1, seed=4)), forth.x[-1], (1.5, 0.5), 0.125)
    np.testing.assert_allclose(back.x[-1], x0, rtol=0, atol=64 * UNIT_ROUNDOFF)
    with refused(ValueError, "Gilbert", "backward"):
        co.integrate(chain.with_forces(F.Gilbert(0.1, 0.1, seed=4)), x0, (1.5, 0.5), 0.125)


def test_lattices_of_moments_are_those_of_their_momenta():
    """Directions S of moments mu move as the spins mu S of the energy of S: all integrals, and closed forms."""
    mu = np.array([1.0, 3.0, 0.5, 2.0])
    edges = [(0, 1), (1, 2), (2, 3), (3, 0)]
    J, B = np.array([1.0, -0.5, 0.7, 0.3]), np.array([0.0, 0.0, 0.4])
    lattice = co.systems.spin_lattice(edges, 4, exchange=J, field=B, moments=mu)
    scaled = [J[k] / mu[a] / mu[b] for k, (a, b) in enumerate(edges)]
    momenta = co.systems.spin_lattice(edges, 4, exchange=scaled, field=B / mu[:, None])
    S = unit_spins(4, 3)
    x0, y0 = S.ravel(), (mu[:, None] * S).ravel()
    for method in (co.Splitting(order=4), co.SphericalMidpoint(), co.GaussLegendre(2)):
        first, second = (
            co.integrate(one, x, (0.5, 2.5), 0.05, method).x[-1] for one, x in ((lattice, x0), (momenta, y0))
        )
        # The spherical midpoint is a method of the directions, and equal for those of both.
        np.testing.assert_allclose((mu[:, None] * first.reshape(4, 3)).ravel(), second, rtol=0, atol=1e-13)
    assert set(lattice.integrals) == {"total S3"}
    sol = co.integrate(lattice, x0, (0.0, 5.0), 0.05, co.GaussLegendre(2))
    assert np.abs(np.diff((mu * sol.x.reshape(-1, 4, 3)[..., 2]).sum(axis=1))).max() < 1e-14
    pair = co.systems.spin_lattice("complete", 3, exchange=0.8, field=B, moments=2.5)
    found = co.integrate(pair, x0[:9], (0.0, 3.0), 0.05, co.Splitting(order=8)).x[-1]
    np.testing.assert_allclose(found, pair.exact(x0[:9], 3.0), rtol=0, atol=1e-10)
    assert "|total S|^2" in pair.integrals
    apart = co.systems.spin_lattice([], 4, field=B, moments=mu)
    found = co.integrate(apart, x0, (0.0, 3.0), 0.5).x[-1]
    np.testing.assert_allclose(found, apart.exact(x0, 3.0), rtol=0, atol=1e-14)
    kT = 0.5
    states = co.thermal_states(apart, kT, 2000, sweeps=20, seed=4)
    error = states.x[:, 2::3].std(axis=0) / np.sqrt(2000)
    assert np.all(np.abs(states.x[:, 2::3].mean(axis=0) - langevin(0.4 / kT)) < 3.5 * error)

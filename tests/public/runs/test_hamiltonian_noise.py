"""Hamiltonian noise: closed forms, order, orbits, equal paths for every partition of a run, derivatives, refusals."""

from dataclasses import replace
from itertools import pairwise, product

import numpy as np
import pytest
from scipy.linalg import expm

import coadjoint as co
from refusals import refused
from rounding import UNIT_ROUNDOFF

F = co.forces
FREE = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(np.zeros((3, 3))))
UP = np.array([0.0, 0.0, 1.0])


def on(algebra, sign=1):
    n = algebra.dim
    B = np.random.default_rng(4).uniform(-0.2, 0.2, (n, n))
    H = co.Quadratic(np.diag(np.linspace(0.6, 1.4, n)) + B + B.T, linear=np.linspace(-0.3, 0.4, n))
    return co.LiePoissonSystem(algebra, H, sign=sign)


SYSTEMS = {
    "so(3)": lambda: co.systems.rigid_body((1.0, 2.0, 3.0)),
    "so(4)": lambda: on(co.algebras.so(4), -1),
    "e(3)": lambda: on(co.algebras.e(3)),
    "A3,7": lambda: on(co.algebras.A3_7(0.7)),
    "A5,40": lambda: on(co.algebras.get("A5,40")),
    "two spins": lambda: on(co.algebras.copies(co.algebras.so(3), 2)),
    "a body in space": lambda: co.systems.body((1.0, 2.0, 2.5)),
}


def start(system):
    return np.linspace(0.7, -0.5, system.dim) if system.dim != 12 else system.state(np.eye(3), (0.3, 1.0, 0.2))


def noises(n):
    """Noise of every kind: linear, correlated, of one linear form, of sums of squares, and of none of these."""
    rows = np.random.default_rng(7).uniform(-0.5, 0.5, (3, n))
    yield "linear", F.HamiltonianNoise(rows, (0.5, 0.8, 0.3), seed=3, stream=2)
    yield "correlated", F.HamiltonianNoise(rows, rows[:, :2], seed=3)
    yield "coordinates", F.HamiltonianNoise(np.eye(n), 0.4, seed=5)
    yield "square", F.HamiltonianNoise(["(x1 + x2)^2/2", rows[0]], 0.4, seed=5)
    yield "cosh", F.HamiltonianNoise(["cosh(x2/2)"], 0.4, seed=5)
    yield "squares", F.HamiltonianNoise(["x1^2/2 + x2*x3 - x2^2/3 + x1/4", "x1*x2"], 0.1, seed=5, levels=1)
    yield "neither", F.HamiltonianNoise(["x1^2*x2/2 + x3^2"], 0.4, seed=5)


@pytest.mark.thinned(3)
@pytest.mark.parametrize("kind", dict(noises(3)))
@pytest.mark.parametrize("name", [name for name in SYSTEMS if name not in ("a body in space", "vortices")])
def test_compiled_steps_are_those_in_numpy_and_stay_on_the_orbit(name, kind):
    """Midpoint rules end at corrections of 2^-40 of the state at the latest."""
    system = SYSTEMS[name]()
    noise, x0 = dict(noises(system.dim))[kind], start(system)
    noisy = system.with_forces(noise)
    for method in (co.Splitting(), co.Splitting(order=4), co.GaussLegendre(2)):
        found = co.stepper(noisy, method, 0.1)(x0, 0.7)
        plain = co.methods.Forced(method).step(noisy, x0, 0.7, 0.1)
        assert np.max(np.abs(found - plain)) < 2.0**-36
    # On A5,40 noise drives the motion away without bound, too far for steps of 0.1 after t = 0.3.
    left = co.integrate(noisy, x0, (-0.5, 0.2 if name == "A5,40" else 4.5), 0.1).balance()
    assert left.pop("energy") > 0.0 and all(value < 1e-11 for value in left.values()), left
    assert co.methods.Forced(co.Splitting()).properties(noisy).poisson == (kind != "neither")


def legendre(z):
    return np.array([z, (3 * z**2 - 1) / 2, (5 * z**3 - 3 * z) / 2])


def test_rotational_brownian_motion():
    """E P_l = exp(-strength^2 l(l + 1) t/2); the error of 16 steps is below 1e-3, |P_l| at most one."""
    members, sigma = 20_000, 0.7
    noisy = FREE.with_forces(F.HamiltonianNoise(np.eye(3), sigma, seed=11))
    sol = co.integrate(noisy, np.tile(UP, (members, 1)), (0, 1), 1 / 16, save_every=16, watch=False)
    found = legendre(sol.x[-1, :, 2])
    exact = np.exp(-(sigma**2) * np.array([2, 6, 12]) / 2)
    np.testing.assert_allclose(exact, [0.612626, 0.229925, 0.052866], atol=1e-6)
    assert np.all(np.abs(found.mean(axis=1) - exact) < 4 * found.std(axis=1) / np.sqrt(members) + 1e-3)


def quadratic_operators():
    """Return i times the angular momenta on functions of degree two, in the basis of spherical harmonics."""
    m = np.arange(-2, 3)
    up = np.diag(np.sqrt(6.0 - m[:-1] * (m[:-1] + 1.0)), -1)
    return [1j * (up + up.T) / 2, (up - up.T) / 2, 1j * np.diag(m)]


def midpoint_operator(strengths, h):
    """Return the mean operator of a step of the midpoint rule with all noise at once: rotations by Cayley's formula."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(9)
    total, unit = np.zeros((5, 5), dtype=complex), np.eye(5)
    for (a, b, c), (u, v, w) in zip(product(nodes, repeat=3), product(weights, repeat=3), strict=True):
        turn = np.sqrt(h) * np.array((a, b, c)) * strengths
        angle = np.linalg.norm(turn)
        turn *= 2 * np.arctan(angle / 2) / (angle or 1.0)
        generator = sum(t * L for t, L in zip(turn, quadratic_operators(), strict=True))
        total += u * v * w * (expm(generator) if angle else unit)
    return total / (2 * np.pi) ** 1.5


def mean_operators(strengths, steps, kind="coin"):
    """Return the mean operator of steps of noise alone over t = 1, and the limit."""
    squares = [s**2 / 2 * L @ L for s, L in zip(strengths, quadratic_operators(), strict=True)]
    one, two, three = (expm(A / steps) for A in squares)
    step = {
        "ordered": lambda: one @ two @ three,
        "coin": lambda: 0.5 * (one @ two @ three + three @ two @ one),
        "midpoint": lambda: midpoint_operator(strengths, 1 / steps),
    }[kind]()
    return np.linalg.matrix_power(step, steps), expm(sum(squares))


def test_order_two_by_the_coin_and_one_without():
    """The means of the functions of degree two from an ensemble are those of the composition, to their standard error.

    Errors against the limit fall as the square of the step. In a fixed order, which an ensemble of this size tells
    apart from the coin, and in the midpoint rule with all noise at once, they fall as the step.
    """
    strengths = (0.7, 1.1, 0.4)
    errors = {
        kind: [np.linalg.norm(np.subtract(*mean_operators(strengths, n, kind)), 2) for n in (2, 4, 8, 16)]
        for kind in ("coin", "ordered", "midpoint")
    }
    np.testing.assert_allclose(errors["coin"], [1.5e-2, 4.5e-3, 1.2e-3, 3.2e-4], rtol=0.05)
    ratios = {kind: found[2] / found[3] for kind, found in errors.items()}
    assert ratios["coin"] > 3.6 and ratios["ordered"] < 2.3 and ratios["midpoint"] < 2.3, ratios
    members, x0 = 30_000, np.array([1.0, 0.0, 0.0])
    noisy = FREE.with_forces(F.HamiltonianNoise(np.diag(strengths), seed=12))
    x = co.integrate(noisy, np.tile(x0, (members, 1)), (0, 1), 0.5, save_every=2, watch=False).x[-1]
    found = x[:, :, None] * x[:, None, :]
    means = {ordered: mean_of_products(strengths, x0, 2, ordered) for ordered in (False, True)}
    error = found.std(axis=0) / np.sqrt(members)
    assert np.all(np.abs(found.mean(axis=0) - means[False]) < 4 * error)
    assert np.max(np.abs(means[True] - means[False]) / error) > 8


def mean_of_products(strengths, x0, steps, ordered):
    """Return the mean of x_i x_j after steps of the noise, from that of the rotations about each axis."""
    generators = [np.cross(np.eye(3)[k], np.eye(3)) for k in range(3)]
    each = [
        expm(s**2 / (2 * steps) * np.linalg.matrix_power(np.kron(G, np.eye(3)) + np.kron(np.eye(3), G), 2))
        for s, G in zip(strengths, generators, strict=True)
    ]
    in_order, reversed_order = each[2] @ each[1] @ each[0], each[0] @ each[1] @ each[2]
    step = in_order if ordered else 0.5 * (in_order + reversed_order)
    return (np.linalg.matrix_power(step, steps) @ np.outer(x0, x0).ravel()).reshape(3, 3)


def log_energy(x):
    """Return the energy of three vortices on a sphere, of strengths 1, 0.6 and -0.8."""

    def pair(i, j, strength):
        return strength * np.log(1.0 - x[3 * i] * x[3 * j] - x[3 * i + 1] * x[3 * j + 1] - x[3 * i + 2] * x[3 * j + 2])

    return -(pair(0, 1, 0.6) + pair(0, 2, -0.8) + pair(1, 2, -0.48)) / 4.0


def vortices():
    """Return three vortices, whose strengths are factors of the brackets."""
    c = {}
    for s, strength in enumerate((1.0, 0.6, -0.8)):
        i, j, k = range(3 * s, 3 * s + 3)
        c |= {(i, j): {k: 1 / strength}, (j, k): {i: 1 / strength}, (i, k): {j: -1 / strength}}
    return co.LiePoissonSystem(co.LieAlgebra.from_brackets(9, c), co.Hamiltonian(log_energy))


SYSTEMS["vortices"] = vortices

STRONG = {
    "vortices, three common noises": ("vortices", 3, 0.5),
    "vortices, one common noise": ("vortices", 1, 1.0),
    "rigid body, one noise": ("so(3)", 1, 1.0),
    "rigid body, three noises": ("so(3)", 3, 0.5),
    "so(4), commuting noises": ("so(4)", 2, 1.0),
    "two spins, four noises": ("two spins", 4, 0.5),
}


def strong_slope(system, noise, method, steps=(4, 8, 16, 32), members=200):
    """Return the slope of distances between paths of steps that are halved, with its standard error."""
    x0, ends = np.tile(start(system), (members, 1)), []
    for count in steps:
        levels = int(np.log2(steps[-1] // count))
        noisy = system.with_forces(replace(noise, levels=levels))
        ends.append(co.integrate(noisy, x0, (0.3, 1.3), 1 / count, method, save_every=count, watch=False).x[-1])
    squares = [np.sum((one - other) ** 2, axis=1) for one, other in pairwise(ends)]
    logs = np.array([np.log2(one.mean()) / 2 for one in squares])
    errors = np.array([one.std() / one.mean() / np.sqrt(members) / 2 / np.log(2) for one in squares])
    return (logs[0] - logs[-1]) / (len(logs) - 1), np.hypot(errors[0], errors[-1]) / (len(logs) - 1)


@pytest.mark.parametrize("case", STRONG)
def test_strong_order(case):
    name, count, order = STRONG[case]
    system = SYSTEMS[name]()
    rows = np.eye(system.dim)[:count]
    if case == "so(4), commuting noises":
        rows = np.array([[1.0, 0, 0, 0, 0, 0], [0, 0, 0, 0, 0, 1.0]])
        assert not np.any(system.algebra.structure_matrix(np.ones(6))[0, 5])
    if name == "vortices":  # the same field turns all of them
        rows = np.tile(np.eye(3), 3)[:count]
    noise = F.HamiltonianNoise(rows, 0.4, seed=9)
    assert (len(noise.terms(system).sets) == 1) == (order == 1.0)
    slope, error = strong_slope(system, noise, co.GaussLegendre(1) if name == "vortices" else co.Splitting())
    assert error < 0.1 and abs(slope - order) < 0.2 + 3 * error, (slope, error)


@pytest.mark.parametrize("order", [2, 4])
def test_the_order_of_the_drift_remains_as_the_strength_goes_to_zero(order):
    system, x0 = SYSTEMS["so(3)"](), start(SYSTEMS["so(3)"]())
    weak = system.with_forces(F.HamiltonianNoise(np.eye(3), 1e-12, seed=4))
    found = [co.integrate(weak, x0, (0, 2), 1 / n, co.Splitting(order=order)).x[-1] for n in (4, 8)]
    errors = [np.linalg.norm(x - system.exact(x0, 2.0)) for x in found]
    assert abs(np.log2(errors[0] / errors[1]) - order) < 0.3
    assert errors[1] > 1e-9  # far above the noise


def test_every_path_is_a_poisson_map():
    """Tangents of linear noise are exact, and those of squares are differences of nine digits."""
    for name, kind, tolerance in (
        ("so(4)", "correlated", 1e-13),
        ("e(3)", "correlated", 1e-13),
        ("A5,40", "correlated", 1e-13),
        ("so(4)", "squares", 1e-7),
        ("A3,7", "squares", 1e-7),
    ):
        system = SYSTEMS[name]()
        noisy, x0 = system.with_forces(dict(noises(system.dim))[kind]), start(system)
        assert co.methods.Forced(co.Splitting()).properties(noisy).poisson
        ready = co.prepare(noisy, co.Splitting(), 0.1)
        columns = [ready.jvp(x0, (0, 1), {"x0": e})[1].x[-1] for e in np.eye(system.dim)]
        P, J = np.array(columns).T, system.algebra.structure_matrix
        after = ready.run(x0, (0, 1)).x[-1]
        size = np.abs(P).sum(axis=1).max() ** 2 * np.abs(J(x0)).max()
        assert np.max(np.abs(P @ J(x0) @ P.T - J(after))) < tolerance * size


@pytest.mark.parametrize("steps", [20_000, pytest.param(1_000_000, marks=pytest.mark.long)])
def test_casimirs_over_many_steps(steps):
    """Rounding of each of four exponentials moves the square by at most some units; unbiased, as the square root."""
    noisy = SYSTEMS["so(3)"]().with_forces(F.HamiltonianNoise(np.eye(3), 0.5, seed=8))
    sol = co.integrate(noisy, (0.3, 1.0, 0.2), (0, steps / 16), 1 / 16, save_every=steps)
    assert sol.balance()["|x|^2"] < 64 * UNIT_ROUNDOFF * np.sqrt(steps)


@pytest.mark.parametrize("kind", ["linear", "squares", "neither"])
def test_the_group_element_moves_with_the_momentum(kind):
    """The momentum in space is constant on every path, for rotations and for the coadjoint matrix of so(4)."""
    for name, attitude in (("so(3)", True), ("so(4)", "coadjoint")):
        system = SYSTEMS[name]()
        noisy, x0 = system.with_forces(dict(noises(system.dim))[kind]), start(system)
        sol = co.integrate(noisy, x0, (0, 5), 0.1, co.Splitting(), attitude=attitude)
        assert np.max(np.abs(np.einsum("kij,kj->ki", sol.attitude, sol.x) - x0)) < 1e-13
        assert np.array_equal(sol.x, co.integrate(noisy, x0, (0, 5), 0.1, co.Splitting()).x)
        assert np.max(np.abs(sol.attitude[-1] - np.eye(system.dim))) > 0.1


def test_the_same_paths_for_every_partition_of_a_run(tmp_path):
    system = SYSTEMS["so(3)"]()
    noise = F.HamiltonianNoise(["x1", "x2^2/2"], 0.6, seed=5, stream=3)
    noisy, x0 = system.with_forces(noise), start(system)
    starts = np.linspace(0.5, 1.5, 70)[:, None] * x0  # more than are taken together
    whole = co.integrate(noisy, starts, (0.25, 1.5), 1 / 8)
    threaded = co.integrate(noisy, starts, (0.25, 1.5), 1 / 8, threads=2, save_every=5)
    assert np.array_equal(threaded.x, whole.x[::5])
    alone = system.with_forces(replace(noise, stream=3 + 20))
    assert np.array_equal(co.integrate(alone, starts[20], (0.25, 1.5), 1 / 8).x, whole.x[:, 20])
    first = co.integrate(noisy, starts, (0.25, 0.75), 1 / 8)
    rest = co.integrate(noisy, first.x[-1], (0.75, 1.5), 1 / 8)
    assert np.array_equal(rest.x[-1], whole.x[-1])
    stored = co.integrate(noisy, starts, (0.25, 1.5), 1 / 8, archive=tmp_path / "noisy.zarr")
    loaded = co.load(tmp_path / "noisy.zarr")
    assert np.array_equal(loaded.x, whole.x) and np.array_equal(stored.x, whole.x)
    assert loaded.system.forces == noisy.forces
    for H in (co.Polynomial({(2, 0, 0): 0.1, (0, 1, 1): 1.0 / 3.0}), co.Quadratic((1.0, 2.0, 3.0))):
        with_object = system.with_forces(F.HamiltonianNoise([H, (1.0, 0.0, 0.5)], 0.3, seed=1))
        kept = co.integrate(with_object, x0, (0, 0.5), 1 / 8, archive=tmp_path / f"{type(H).__name__}.zarr")
        again = co.load(tmp_path / f"{type(H).__name__}.zarr").system
        assert np.array_equal(co.integrate(again, x0, (0, 0.5), 1 / 8).x, kept.x)
    others = [replace(noise, seed=6), replace(noise, stream=4), replace(noise, levels=1)]
    ends = [co.integrate(system.with_forces(one), x0, (0.25, 1.5), 1 / 8).x[-1].tobytes() for one in (noise, *others)]
    assert len(set(ends)) == 4


@pytest.mark.parametrize("h", [0.1, 1 / 8, 0.37])
def test_increments_of_a_step_are_sums_of_those_of_shorter_ones(h):
    """Without drift commuting noise is exact: the ends are those of the path, from any time and by any step."""
    spin = FREE.with_forces(F.HamiltonianNoise(UP, 0.8, seed=6))
    ends = []
    for levels, count in ((3, 3), (2, 6), (0, 24)):
        noisy = FREE.with_forces(replace(spin.forces[0], levels=levels))
        ends.append(co.integrate(noisy, (1.0, 0.0, 0.5), (0.7, 0.7 + 24 * h), 24 * h / count).x[-1])
    assert np.max(np.abs(ends[0] - ends[-1])) < 1e-13 and np.max(np.abs(ends[1] - ends[-1])) < 1e-13
    other = co.integrate(spin, (1.0, 0.0, 0.5), (0.7, 0.7 + 24 * h), 8 * h).x[-1]
    assert np.max(np.abs(other - ends[-1])) > 1e-3


@pytest.mark.parametrize("kind", ["linear", "squares", "neither"])
def test_derivatives_along_a_path(kind):
    system = SYSTEMS["so(4)"]()
    noise, x0 = dict(noises(6))[kind], start(system)
    noisy, direction = system.with_forces(noise), np.cos(np.arange(6.0))
    ready = co.prepare(noisy, co.Splitting(), 0.1)
    _, along = ready.jvp(x0, (0, 0.5), {"x0": direction})
    eps = 2.0**-17
    moved = [ready.run(x0 + s * eps * direction, (0, 0.5)).x[-1] for s in (1, -1)]
    assert np.max(np.abs(along.x[-1] - (moved[0] - moved[1]) / (2 * eps))) < 1e-7
    row = np.sin(np.arange(6.0))
    back = ready.vjp(x0, (0, 0.5), save_every=5)[1](x=np.stack([0 * row, row]))
    assert abs(row @ along.x[-1] - back["x0"] @ direction) < 1e-9


@pytest.mark.parametrize("strength", [0.4, (0.5, 0.8, 0.3)])
def test_derivatives_by_the_strength(strength):
    system, rows = SYSTEMS["so(4)"](), np.random.default_rng(7).uniform(-0.5, 0.5, (3, 6))
    noise, x0 = F.HamiltonianNoise(rows, strength, seed=3), start(SYSTEMS["so(4)"]())
    row, eps, along = np.sin(np.arange(6.0)), 2.0**-16, np.cos(np.arange(np.size(strength)))
    along = along.reshape(np.shape(strength))
    ready = co.prepare(system.with_forces(noise), co.Splitting(), 0.1)
    back = ready.vjp(x0, (0, 0.5), save_every=5)[1](x=np.stack([0 * row, row]))
    found = np.sum(np.asarray(back["HamiltonianNoise.strength"]) * along)
    moved = [
        co.integrate(
            system.with_forces(replace(noise, strength=np.asarray(strength) + s * eps * along)), x0, (0, 0.5), 0.1
        )
        for s in (1, -1)
    ]
    assert abs(found - row @ (moved[0].x[-1] - moved[1].x[-1]) / (2 * eps)) < 1e-7


CERTIFIED = {
    "rigid body": ("so(3)", 0.02, 0.125),
    "Manakov's top": ("so(4)", 0.02, 0.25),
}


@pytest.mark.parametrize("case", ["Manakov's top", pytest.param("rigid body", marks=pytest.mark.long)])
def test_certified_orders(case):
    """Weak order two of weak noise, whose averages show the drift between noise, and strong order one half."""
    name, strength, step = CERTIFIED[case]
    system = SYSTEMS[name]()
    noisy = system.with_forces(F.HamiltonianNoise(np.eye(system.dim)[:3], strength, seed=1))
    certificate = co.certify(noisy, co.Splitting(), start(system), step, steps=20)
    weak, strong = certificate["weak order of HamiltonianNoise"], certificate["strong order of HamiltonianNoise"]
    assert weak.verdict == strong.verdict == "holds" and "paths" in weak.measured
    assert abs(weak.value - 2.0) < 0.5 and strong.value > 0.4


def test_units():
    """States, energies and times in other units give the same path in those units."""
    for size, second in ((1e-7, 1e30), (1e30, 1e-7)):
        body = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(np.array([1.0, 0.5, 0.3]) / size / second))
        noisy = body.with_forces(F.HamiltonianNoise(np.eye(3), 0.3 / np.sqrt(second), seed=2))
        sol = co.integrate(noisy, size * np.array([0.3, 1.0, 0.2]), (0, 2 * second), second / 8)
        assert np.isfinite(sol.x).all() and sol.balance()["|x|^2"] < 1e-13
        assert np.linalg.norm(sol.x[-1] - sol.x[0]) > 0.05 * size


def test_work_of_each_noise():
    system, x0 = SYSTEMS["so(3)"](), np.array([0.3, 1.0, 0.2])
    noisy = system.with_forces(
        F.HamiltonianNoise("x1", 0.5, seed=1), F.LinearDamping(0.1), F.HamiltonianNoise("x3^2/2", 0.5, seed=2)
    )
    sol = co.integrate(noisy, x0, (0, 5), 1 / 32, co.Splitting(parts="free_body"))
    assert list(sol.work) == ["HamiltonianNoise", "LinearDamping", "HamiltonianNoise 2"]
    total = sum(sol.work[label]["energy"][-1] for label in sol.work)
    assert all(abs(sol.work[label]["energy"][-1]) > 1e-3 for label in sol.work)
    assert abs(sol.energy[-1] - sol.energy[0] - total) < 1e-13  # the free body itself is exact


@pytest.mark.parametrize("H", ["x1", "x1^2/2", "x1*x2 + x3^2"])
def test_ito_drift(H):
    """Half of D f f for f = J grad H, by differences of the field of H."""
    for name in ("so(3)", "A3,7"):
        system, x = SYSTEMS[name](), np.array([0.3, 1.0, 0.2])
        field = co.LiePoissonSystem(system.algebra, H, sign=system.sign).vector_field
        f, eps = 0.4 * field(x), 2.0**-18
        wanted = 0.5 * 0.4 * (field(x + eps * f) - field(x - eps * f)) / (2 * eps)
        noise = F.HamiltonianNoise(H, 0.4, seed=1)
        assert np.max(np.abs(noise.ito_drift(system, x) - wanted)) < 1e-9


def test_fields_on_spins():
    lattice = co.systems.spin_lattice("square", (3, 4), field=(0.0, 0.0, 0.3))
    x0 = np.random.default_rng(3).standard_normal((12, 3))
    x0 = (x0 / np.linalg.norm(x0, axis=1, keepdims=True)).ravel()
    for common, rows in ((False, np.eye(36)), (True, np.tile(np.eye(3), 12))):
        field = lattice.with_forces(F.RandomField((0.5, 0.2, 0.4), common=common, seed=3))
        strengths = np.tile((0.5, 0.2, 0.4), 1 if common else 12)
        plain = lattice.with_forces(F.HamiltonianNoise(rows, strengths, seed=3))
        found, wanted = (co.integrate(one, x0, (0, 1), 1 / 16, co.Splitting()).x[-1] for one in (field, plain))
        assert np.array_equal(found, wanted)
        assert np.max(np.abs(np.linalg.norm(found.reshape(12, 3), axis=1) - 1)) < 1e-13
    with refused(TypeError, "RandomField", "so(3)"):
        co.systems.heavy_top().with_forces(F.RandomField(0.5, seed=3))


@pytest.mark.parametrize("axes", ["body", "space"])
def test_random_torques(axes):
    """The momentum in the axes of the torque is that of Brownian motion: mean and covariance t S S^T, exactly."""
    body, S, members = co.systems.body((1.0, 2.0, 2.5)), np.array([[0.3, 0, 0], [0.1, 0.2, 0], [0, 0.1, 0.4]]), 20_000
    noisy = body.with_forces(F.RandomTorque(S, axes, seed=4))
    x0 = body.state(np.linalg.qr(np.random.default_rng(1).standard_normal((3, 3)))[0], (0.3, 1.0, 0.2))
    plain = co.methods.Forced(co.Splitting()).step(noisy, x0, 0.7, 0.1)
    assert np.max(np.abs(co.stepper(noisy, co.Splitting(), 0.1)(x0, 0.7) - plain)) < 64 * UNIT_ROUNDOFF
    if axes == "body":  # a ball at rest does not turn the axes of its torque by much
        noisy = co.systems.body((1e6, 1e6, 1e6)).with_forces(noisy.forces[0])
    x = co.integrate(noisy, np.tile(x0, (members, 1)), (0, 2), 0.5, save_every=4, watch=False).x[-1]
    L, L0, A = body.angular_momentum(x), body.angular_momentum(x0), body.attitudes(x)
    if axes == "space":
        L, L0 = np.einsum("mij,mj->mi", A, L), body.attitudes(x0) @ L0
    mean, covariance = L.mean(axis=0) - L0, np.cov(L.T)
    wanted = 2 * S @ S.T
    assert np.all(np.abs(mean) < 4 * np.sqrt(np.diag(wanted) / members))
    errors = np.sqrt((np.outer(np.diag(wanted), np.diag(wanted)) + wanted**2) / members)
    assert np.all(np.abs(covariance - wanted) < 4 * errors)


def test_refusals():
    body = SYSTEMS["so(3)"]()
    noise = F.HamiltonianNoise("x1", 0.5, seed=1)
    for arguments, named_values in (
        (([],), ("hamiltonians", "empty")),
        ((np.eye(3), (0.1, 0.2)), ("strength", "(2,)", "3")),
        ((np.eye(3), np.ones((2, 2))), ("strength", "(2, 2)", "3")),
        (([[1.0, np.nan, 0.0]],), ("hamiltonians", "nan")),
        ((np.ones((2, 2, 3)),), ("hamiltonians", "(2, 3)")),
        ((np.eye(3), np.inf), ("strength", "inf")),
    ):
        with refused(ValueError, *named_values):
            F.HamiltonianNoise(*arguments, seed=1)
    with refused(TypeError, "HamiltonianNoise", "seed"):
        F.HamiltonianNoise(np.eye(3))
    with refused(TypeError, "hamiltonians", "3"):
        F.HamiltonianNoise(3, seed=1)
    for wrong in (np.eye(4), "x4", "x1 + t", co.Polynomial({(1, 1): 1.0})):
        with refused(ValueError, "HamiltonianNoise"):
            body.with_forces(F.HamiltonianNoise(wrong, seed=1))
    with refused(ValueError, "HamiltonianNoise", "backward"):
        co.integrate(body.with_forces(noise), (0.3, 1.0, 0.2), (1, 0), 0.1)
    with refused(ValueError, "seed"):
        body.with_forces(noise, noise)
    for call in (body.with_forces(noise).vector_field, body.with_forces(noise).power):
        with refused(TypeError, "HamiltonianNoise", "ito_drift"):
            call((0.3, 1.0, 0.2))
    with refused(TypeError, "HamiltonianNoise", "matrices"):
        co.systems.sphere_euler(N=4).with_forces(noise)
    with refused(ValueError, "HamiltonianNoise", "structure constants"):
        co.systems.separable_cosh and co.PoissonSystem(
            lambda x: np.array([[0.0, x[0]], [-x[0], 0.0]]), "x1^2 + x2^2", dim=2
        ).with_forces(F.HamiltonianNoise("x1", seed=1))
    with refused(TypeError, "RandomTorque", "bodies"):
        FREE.with_forces(F.RandomTorque(0.1, seed=1))
    with refused(TypeError, "RandomTorque", "attitude"):
        body.with_forces(F.RandomTorque(0.1, "space", seed=1))


@pytest.mark.parametrize("axes", ["body", "space"])
def test_the_random_torques_of_two_bodies_are_independent(axes):
    pair, S, count = co.systems.gravitating_bodies(), np.array([[0.3, 0, 0], [0.1, 0.2, 0], [0, 0.1, 0.4]]), 4000
    x0, torque = pair.state([[0.0, 0.0, 0.0], [9.0, 0.0, 0.0]]), F.RandomTorque(S, axes, seed=4)
    L = [pair.angular_momentum(torque.flow(pair, x0, float(t), 2.0)).ravel() for t in range(count)]
    wanted = 2 * np.kron(np.eye(2), S @ S.T)
    errors = np.sqrt((np.outer(np.diag(wanted), np.diag(wanted)) + wanted**2) / count)
    assert np.all(np.abs(np.cov(np.transpose(L)) - wanted) < 4 * errors)


def test_certified_orders_are_those_of_as_many_paths_as_are_named():
    """Distances between the ends of members 0 to M - 1 of two runs, the finer of which has levels of one less."""
    system, noise, h = SYSTEMS["so(3)"](), F.HamiltonianNoise("x1", 1.0, seed=3), 0.125
    certificate = co.certify(system.with_forces(noise), co.Splitting(), start(system), h, steps=20)
    evidence = certificate["strong order of HamiltonianNoise"].evidence
    x0, ends = np.tile(start(system), (evidence["paths"], 1)), []
    for step, levels in ((0.5, 3), (0.25, 2)):
        noisy = system.with_forces(replace(noise, levels=levels))
        ends.append(co.integrate(noisy, x0, (0.0, 2.0), step, co.Splitting(), watch=False).x[-1])
    distance = np.sqrt(np.mean(np.sum((ends[0] - ends[1]) ** 2, axis=1)))
    assert evidence["differences"][0] == pytest.approx(distance, rel=1e-9)  # of several batches, but on slow machines
    with refused(ValueError, "axes of RandomTorque", "body, space"):
        F.RandomTorque(0.1, [(1, 0, 0)], seed=1)

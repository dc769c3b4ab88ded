"""Heat baths: the compiled flow against the plain one, Casimirs on every algebra, seeds, the law of the noise."""

import numpy as np
import pytest

import coadjoint as co
from refusals import refused
from rounding import UNIT_ROUNDOFF

ALGEBRAS = {
    "e(3)": co.algebras.e(3),
    "so(4)": co.algebras.so(4),
    "A3,7": co.algebras.A3_7(0.7),
    "A5,40": co.algebras.get("A5,40"),
    "two spins": co.algebras.copies(co.algebras.so(3), 2),
}


def on(name, sign):
    algebra = ALGEBRAS[name]
    n = algebra.dim
    B = np.random.default_rng(4).uniform(-0.2, 0.2, (n, n))
    H = co.Quadratic(np.diag(np.linspace(0.6, 1.4, n)) + B + B.T, linear=np.linspace(-0.3, 0.4, n))
    return co.LiePoissonSystem(algebra, H, sign=sign)


def metrics(n):
    B = np.random.default_rng(6).uniform(-0.5, 0.5, (n, n))
    thin = B[:, : n - 1] @ B[:, : n - 1].T  # of less than full rank
    return 0.7, np.linspace(0.0, 1.0, n), B @ B.T, 0.5 * (thin + thin.T)


@pytest.mark.thinned(1)
@pytest.mark.parametrize("name", ALGEBRAS)
@pytest.mark.parametrize("sign", [1, -1])
def test_the_flow_is_the_one_that_is_read_in_python(name, sign):
    system = on(name, sign)
    x0 = np.linspace(0.7, -0.5, system.dim)
    for metric in metrics(system.dim):
        hot, cold, damped = (
            system.with_forces(force)
            for force in (
                co.forces.HeatBath(0.3, metric, temperature=0.5, seed=3, stream=2),
                co.forces.HeatBath(0.3, metric, temperature=0.0, seed=3),
                co.forces.DoubleBracketDamping(0.3, metric),
            )
        )
        found = co.stepper(hot, co.Splitting(), 0.1)(x0, 0.7)
        assert np.max(np.abs(found - co.methods.Forced(co.Splitting()).step(hot, x0, 0.7, 0.1))) < 256 * UNIT_ROUNDOFF
        still = co.stepper(damped, co.Splitting(), 0.1)(x0, 0.7)
        assert np.array_equal(co.stepper(cold, co.Splitting(), 0.1)(x0, 0.7), still)
        assert np.max(np.abs(found - still)) > 1e-3


def test_noises_differ_by_seed_stream_and_time():
    system, x0 = on("e(3)", 1), np.linspace(0.7, -0.5, 6)

    def after(t=0.0, x=x0, **more):
        bath = co.forces.HeatBath(0.2, temperature=0.1, **{"seed": 1, **more})
        return tuple(np.ravel(co.stepper(system.with_forces(bath), co.Splitting(), 0.1)(x, t)))

    found = [after(), after(seed=2), after(stream=1), after(t=0.1), after(stream=2)]
    assert len(set(found)) == 5 and after() == found[0]
    assert after(x=[x0, x0, x0]) == (*found[0], *found[2], *found[4])
    two = [co.forces.HeatBath(0.2, temperature=0.1, seed=seed) for seed in (1, 1)]
    with refused(ValueError, "seed", "stream"):
        system.with_forces(*two)


def test_the_law_of_the_noise_is_exact_at_any_step():
    """Without a field the mean of a spin decays as exp(-2 alpha kT t); a turn by all axes at once misses by 0.012."""
    members, strength = 40_000, 0.5
    free = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(1.0))
    bath = co.forces.HeatBath(0.5, temperature=strength, seed=5)
    sol = co.integrate(free.with_forces(bath), np.tile((0.6, 0.0, 0.8), (members, 1)), (0, 4), 4.0, watch=False)
    mean, each = sol.x[-1].mean(axis=0), sol.x[-1].std(axis=0) / np.sqrt(members)
    assert np.all(np.abs(mean - np.exp(-2 * 0.5 * strength * 4.0) * np.array([0.6, 0.0, 0.8])) < 3 * each)
    assert np.all(each < 0.003)


def lattices():
    yield "square", co.systems.spin_lattice("square", (3, 5), True, tensor=(1.0, 0.8, 0.5), dm=(0.1, 0.2, -0.3))
    yield "rows that end within eight spins", co.systems.spin_lattice("square", (3, 13), True, tensor=(1.0, 0.8, 0.5))
    yield "open chain of 17, in fields", co.systems.spin_lattice(shape=17, field=np.linspace(-1, 1, 51).reshape(17, 3))
    algebra = co.algebras.copies(co.algebras.so(3), 3)
    cubic = co.Polynomial({(1, 0, 0) * 3: 1.0, (0, 0, 1, 0, 0, 2, 0, 0, 0): -0.5, (0, 1) + (0,) * 7: 0.3})
    yield "of third degree", co.LiePoissonSystem(algebra, cubic)
    yield "of other constants", scaled_spins()


def scaled_spins():
    """Two spins whose coordinates alternate, of brackets 2 and -1, and a coordinate that commutes with all others."""
    brackets = {}
    for (i, j, k), c in {(0, 2, 4): 2.0, (1, 3, 6): -1.0}.items():
        brackets.update({(i, j): {k: c}, (j, k): {i: c}, (i, k): {j: -c}})
    M = np.eye(7) + 0.2 * np.add.outer(np.arange(7.0), np.arange(7.0)) ** 0.5
    return co.LiePoissonSystem(co.LieAlgebra.from_brackets(7, brackets), co.Quadratic(M))


@pytest.mark.parametrize("name", dict(lattices()))
@pytest.mark.parametrize("strength", [0.2, 3.0])  # angles below and above 1/8, where the series of rotations ends
def test_rotations_of_spins_are_those_of_the_exponential(name, strength):
    system = dict(lattices())[name]
    x0 = np.sin(1.0 + np.arange(system.dim) ** 2)
    for metric in (1.0, np.where(np.arange(system.dim) % 5, 0.7, 0.0)):
        bath = co.forces.HeatBath(0.1 * strength, metric, temperature=strength, seed=5)
        hot = system.with_forces(bath)
        found = co.stepper(hot, co.Splitting(), 0.125)(x0, 0.5)
        plain = co.methods.Forced(co.Splitting()).step(hot, x0, 0.5, 0.125)
        assert np.max(np.abs(found - plain)) < 1024 * UNIT_ROUNDOFF * np.max(np.abs(x0))
        together = co.integrate(hot, [x0, x0[::-1]], (0.5, 1.0), 0.125, co.GaussLegendre(2))
        left = together.energy[-1] - together.energy[0] - together.work["HeatBath"]["energy"][-1]
        assert np.max(np.abs(left)) < 1e-3 * np.max(np.abs(together.energy))


LONG_CHAINS = {
    "damping": co.forces.DoubleBracketDamping(0.4),
    "noise": co.forces.HeatBath(0.4, temperature=0.5, seed=7),
    "Gilbert": co.forces.Gilbert(np.linspace(0.1, 0.9, 130), temperature=0.5, seed=7),
}


@pytest.mark.parametrize("force", LONG_CHAINS)
def test_the_spins_of_every_slice_have_their_own_noise_and_converge(force):
    """The first 70 of 130 spins are aligned, so that damping moves them after the others."""
    system = co.systems.spin_lattice(shape=130).with_forces(LONG_CHAINS[force])
    x0 = np.tile((0.0, 0.0, 1.0), (130, 1))
    x0[70:] = np.random.default_rng(2).standard_normal((60, 3))
    x0 /= np.linalg.norm(x0, axis=1, keepdims=True)
    found = co.stepper(system, co.Splitting(), 0.25)(x0.ravel(), 0.5)
    plain = co.methods.Forced(co.Splitting()).step(system, x0.ravel(), 0.5, 0.25)
    assert np.max(np.abs(found - plain)) < 1024 * UNIT_ROUNDOFF

"""Splittings into bonds: each flow is the closed form; what they keep, tangents, and any size of spins."""

import numpy as np
import pytest

import coadjoint as co
from rounding import UNIT_ROUNDOFF as U


def by_bonds(**options):
    return co.Splitting(parts="bonds", **options)


def turned(c, x, t):
    """H = c S.T with S' = sign J grad H: S' = c K cross S for K = S + T, which is constant, and the same for T."""
    S, T = x.reshape(2, 3)
    K = S + T
    k = np.linalg.norm(K)
    if k == 0.0:
        return x.copy()
    n, phi = K / k, c * k * t
    change = [np.sin(phi) * np.cross(n, v) + 2 * np.sin(phi / 2) ** 2 * np.cross(n, np.cross(n, v)) for v in (S, T)]
    return x + np.concatenate(change)


def pair(c, sign):
    M = np.kron([[0.0, c], [c, 0.0]], np.eye(3))
    return co.LiePoissonSystem(co.algebras.copies(co.algebras.so(3), 2), co.Quadratic(M), sign=sign)


@pytest.mark.thinned(2)
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("compensated", [False, True])
def test_one_bond_is_the_closed_form_at_any_step(sign, compensated):
    rng = np.random.default_rng(1)
    x0 = rng.standard_normal((20, 6))
    x0[0, 3:] = -x0[0, :3]  # no sum: at rest
    x0[1, 3:] = -x0[1, :3] * (1 + 2.0**-40)
    x0[2, 3:] = 2.0 * x0[2, :3]
    x0[3] = 0.0
    for c, h in ((-0.7, 0.03), (1.3, 2.5), (-2.0, -11.0), (0.4, 1000.0)):
        found = co.integrate(pair(c, sign), x0, (0.0, 2 * h), abs(h), by_bonds(compensated=compensated)).x[-1]
        for x, start in zip(found, x0, strict=True):
            size = np.linalg.norm(start)
            # Rounding of |K| moves the phase.
            bound = 2.0**5 * U * size * (1.0 + abs(c * h) * size)
            # J grad H on so(3) with sign +1 is x cross grad H.
            assert np.abs(x - turned(sign * c, start, 2 * h)).max() <= bound, (c, h, start)


def lattices():
    rng = np.random.default_rng(3)
    edges = [(i, j) for i in range(5) for j in range(i + 1, 5) if rng.random() < 0.7]
    J = rng.standard_normal(len(edges))
    yield co.systems.spin_lattice(edges, 5, exchange=J)
    yield co.systems.spin_lattice(edges, 5, exchange=J, field=rng.standard_normal((5, 3)), on_site=(0.0, 0.0, 0.4))
    yield co.systems.spin_lattice("ring", 19, exchange=rng.standard_normal(19))
    stretched = co.LieAlgebra.from_brackets(3, {(0, 1): {2: 1.0}, (1, 2): {0: 2.0}, (0, 2): {1: -1.0}})
    M = np.kron(np.ones((3, 3)) - np.eye(3), np.diag([1.0, 0.5, 0.5]))
    yield co.LiePoissonSystem(co.algebras.copies(stretched, 3), co.Quadratic(M, linear=np.arange(9.0) / 8), sign=-1)


LATTICES = list(lattices())


@pytest.mark.parametrize("system", [LATTICES[0], LATTICES[2]], ids=["graph", "ring"])
@pytest.mark.parametrize("order", [2, 4])
@pytest.mark.parametrize("compensated", [False, True])
def test_total_spin_and_lengths_are_kept(system, order, compensated):
    x0 = np.random.default_rng(2).standard_normal(system.dim)
    steps = 400
    run = co.integrate(
        system, x0, (0.0, -0.25 * steps), 0.25, by_bonds(order=order, compensated=compensated), watch=False
    )
    spins, start = run.x.reshape(len(run.x), -1, 3), x0.reshape(-1, 3)
    size = np.linalg.norm(start, axis=1).max()
    # A flow of a bond rounds six numbers, which add up like a random walk; 5 steps of order 2 make one of order 4.
    flows = steps * (6 if order == 2 else 30) * len(start)
    assert np.abs(spins.sum(axis=1) - start.sum(axis=0)).max() <= 4 * U * size * np.sqrt(flows)
    lengths = np.linalg.norm(spins, axis=2) / np.linalg.norm(start, axis=1) - 1
    assert np.abs(lengths).max() <= 8 * U * np.sqrt(flows)
    assert np.abs(run.x[-1] - x0).max() > 0.1


@pytest.mark.parametrize("system", [LATTICES[1], LATTICES[3]], ids=["field", "stretched"])
def test_the_plain_reading_and_its_tangent_agree_with_the_loops(system):
    x0, h, n = np.random.default_rng(6).standard_normal(system.dim), 0.25, system.dim
    method = by_bonds()
    run = co.integrate(system, x0, (0.0, h), h, method, attitude="coadjoint")
    x, step = method.step(system, x0, 0.0, h), co.stepper(system, method, h)
    size = max(1.0, np.abs(x).max())
    np.testing.assert_allclose(run.x[-1], x, rtol=0, atol=2.0**8 * U * size)
    P, J = step.tangent(x0), system.algebra.structure_matrix
    defect = P @ J(x0) @ P.T - J(x)
    assert np.abs(defect).max() <= 2.0**10 * U * max(1.0, np.abs(P).max()) ** 2 * size
    d = 2.0**-18
    differences = [(step(x0 + d * e) - step(x0 - d * e)) / (2 * d) for e in np.eye(n)]
    assert np.abs(np.transpose(differences) - P).max() < 1e-8 * np.abs(P).max() ** 2 * size
    np.testing.assert_allclose(np.linalg.solve(run.attitude[-1], x0), run.x[-1], rtol=0, atol=2.0**10 * U * size)


@pytest.mark.parametrize("scale", [2.0**-600, 2.0**400])
def test_any_size_of_spins(scale):
    x0 = np.random.default_rng(9).standard_normal(15)
    one = co.integrate(LATTICES[0], x0, (0.0, 1.0), 0.25, by_bonds())
    other = co.integrate(LATTICES[0], scale * x0, (0.0, 1.0 / scale), 0.25 / scale, by_bonds(), watch=False)
    np.testing.assert_array_equal(other.x, scale * one.x)

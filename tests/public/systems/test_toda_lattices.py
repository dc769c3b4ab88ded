"""The Toda lattice: against QR and the particles in many digits, and its traces."""

import mpmath as mp
import numpy as np
import pytest
from brackets import bracket, exact, rational_points

import coadjoint as co

LENGTHS = [2, 3, 5]
MADE = {"open": co.systems.toda, "ring": co.systems.toda_ring}


def state(n, kind, seed=0):
    rng = np.random.default_rng(seed)
    return np.concatenate([rng.uniform(-1, 1, n), rng.uniform(0.3, 1.2, n - (kind == "open"))])


def matrix(n, x):
    """L: b on the diagonal, a beside it, and a_n in the corners of a ring (added, where the ring has two sites)."""
    L = np.diag(x[:n])
    for i, a in enumerate(x[n:]):
        j = (i + 1) % n
        L[i, j] += a
        L[j, i] += a
    return L


def by_hand(n, kind, x):
    b, a = x[:n], x[n:]
    slope = []
    for i in range(n):
        after = a[i] if kind == "ring" or i < n - 1 else 0.0
        before = a[i - 1] if kind == "ring" or i > 0 else 0.0
        slope.append(2 * (after**2 - before**2))
    slope += [a[i] * (b[(i + 1) % n] - b[i]) for i in range(len(a))]
    return np.array(slope)


def by_qr(n, x, t, digits=200):
    """L(t) = Q^T L(0) Q with exp(t L(0)) = Q R, the diagonal of R positive."""
    with mp.workdps(digits):
        L = mp.matrix(matrix(n, x).tolist())
        Q, R = mp.qr(mp.expm(L * mp.mpf(t), method="taylor"))
        for j in range(n):
            if R[j, j] < 0:
                Q[:, j] = -Q[:, j]
        late = Q.T * L * Q
        return np.array([float(late[i, i]) for i in range(n)] + [float(late[i, i + 1]) for i in range(n - 1)])


@pytest.mark.parametrize("kind", MADE)
@pytest.mark.parametrize("n", [*LENGTHS, 200])
def test_field_energy_and_sign(kind, n):
    system, x = MADE[kind](n), state(n, kind)
    np.testing.assert_allclose(system.vector_field(x), by_hand(n, kind, x), rtol=0, atol=1e-14)
    if n > 2 or kind == "open":
        assert system.energy(x) == pytest.approx(np.trace(matrix(n, x) @ matrix(n, x)) / 2, rel=1e-13)
    assert system.sign == 1 and system.dim == len(x) and system.parameters == {"sites": n}


@pytest.mark.parametrize(("n", "t"), [(2, 3.0), (3, -4.0), (4, 40.0), (6, 1.5)])
def test_exact_is_qr(n, t):
    x = state(n, "open", seed=1)
    x[n] *= -1  # nothing asks for positive a
    found = co.systems.toda(n).exact(x, t)
    wanted = by_qr(n, x, t)
    np.testing.assert_allclose(found[:n], wanted[:n], rtol=0, atol=4e-16)
    np.testing.assert_allclose(found[n:], wanted[n:], rtol=4e-16, atol=1e-300)  # the smallest of them to the last bit


def test_exact_of_a_lattice_that_is_cut_and_of_springs_that_are_nothing():
    x = state(4, "open")
    x[5] = 0.0
    late = co.systems.toda(4).exact(x, 2.0)
    left = co.systems.toda(2).exact([x[0], x[1], x[4]], 2.0)
    right = co.systems.toda(2).exact([x[2], x[3], x[6]], 2.0)
    np.testing.assert_array_equal(late, [left[0], left[1], right[0], right[1], left[2], 0.0, right[2]])
    tiny = np.array([1.0, -1.0, 1e-20])  # meets after ln(1e20)/2 = 23 units, if a keeps its digits
    np.testing.assert_allclose(co.systems.toda(2).exact(tiny, -40.0), by_qr(2, tiny, -40.0), rtol=0, atol=4e-16)


@pytest.mark.parametrize("kind", MADE)
@pytest.mark.parametrize("n", [2, 3, 4, 5])
def test_traces_are_integrals_in_involution(kind, n):
    system = MADE[kind](n)
    integrals = system.integrals
    assert list(integrals) == [f"tr L^{k}" for k in range(3, n + 1)]
    known = [system.hamiltonian, *integrals.values()]
    for point in rational_points(system.dim):
        assert all(bracket(system, f, g, point) == 0 for f in known for g in known)
    x = state(n, kind, seed=n)
    for k in range(3, n + 1):
        wanted = np.trace(np.linalg.matrix_power(matrix(n, x), k))
        assert integrals[f"tr L^{k}"](x) == pytest.approx(wanted, rel=1e-12, abs=1e-12)
    functions = [*system.casimirs.values(), exact(system.hamiltonian), *integrals.values()]
    gradients = [np.asarray(f.gradient(x), dtype=float) for f in functions]
    assert np.linalg.matrix_rank(gradients) == len(functions) == n + (kind == "ring")


@pytest.mark.parametrize("kind", MADE)
@pytest.mark.parametrize(("n", "highest"), [(8, 8), (9, 4), (64, 4), (65, 2)])
def test_traces_of_long_lattices(kind, n, highest):
    """All of them up to 8 sites, those of the third and fourth powers up to 64, none beyond."""
    system, x = MADE[kind](n), state(n, kind, seed=n)
    assert list(system.integrals) == [f"tr L^{k}" for k in range(3, highest + 1)]
    for k in range(3, highest + 1):
        wanted = np.trace(np.linalg.matrix_power(matrix(n, x), k))
        assert system.integrals[f"tr L^{k}"](x) == pytest.approx(wanted, rel=1e-12)


@pytest.mark.thinned(2)
@pytest.mark.parametrize("n", [5, 64, 65, 80])
def test_rings_with_a_of_either_sign(n):
    """The product, or from 65 sites on the logarithm of its magnitude: value, derivatives, and along a run."""
    system, x = co.systems.toda_ring(n), state(n, "ring", seed=n)
    x[n:] *= np.random.default_rng(n).choice([-1.0, 1.0], n)
    assert (x[n:] < 0).any() and (x[n:] > 0).any()
    casimir = system.casimirs["product of a" if n < 65 else "log of the product of a"]
    value = np.prod(x[n:]) if n < 65 else np.log(np.abs(x[n:])).sum()
    assert casimir(x) == pytest.approx(value, rel=1e-13)
    slope = np.concatenate([np.zeros(n), (value if n < 65 else 1.0) / x[n:]])
    np.testing.assert_allclose(casimir.gradient(x), slope, rtol=1e-13)
    np.testing.assert_allclose(system.structure_matrix(x) @ slope, 0.0, atol=1e-13 * np.abs(slope).max())
    run = co.integrate(system, x, (0.0, 0.5), 0.05, co.Splitting(order=2))
    name = next(name for name, one in system.casimirs.items() if one is casimir)
    # Ten steps with n products each.
    assert np.abs(run.casimirs[name] - value).max() < 20 * n * 2.0**-53 * max(1.0, abs(value))

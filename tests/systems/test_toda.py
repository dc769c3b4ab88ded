"""The Toda lattice: against QR and the particles in many digits, its traces, and its two parts."""

import mpmath as mp
import numpy as np
import pytest
from two_steps import assert_bounded_by_order, assert_order

import coadjoint as co
from coadjoint.algebra.polynomials.exact_polynomials import ExactPolynomials
from coadjoint.systems.hamiltonians.polynomial_form import polynomial_of
from coadjoint.systems.lattices.toda import traces

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


def particles(kind, mass, strength, reach, q, p, time):
    """Positions and momenta in 20 digits, from Newton's equations of exponential forces; a ring has the length 3."""
    n = len(q)
    with mp.workdps(20):

        def forces(t, y):
            gaps = [y[i + 1] - y[i] for i in range(n - 1)]
            if kind == "ring":
                gaps.append(y[0] + 3 - y[n - 1])
            push = [strength * mp.exp(-reach * gap) for gap in gaps]  # on the right one of the pair
            after = push if kind == "ring" else [*push, 0]
            before = [push[-1], *push[:-1]] if kind == "ring" else [0, *push]
            return [y[n + i] / mass for i in range(n)] + [before[i] - after[i] for i in range(n)]

        y = mp.odefun(forces, 0, [mp.mpf(v) for v in (*q, *p)])(time)
        return np.array([float(v) for v in y])


def flaschka(kind, mass, strength, reach, q, p):
    gaps = [*np.diff(q), *([q[0] + 3 - q[-1]] if kind == "ring" else [])]
    a = np.sqrt(strength * reach / mass) * np.exp(-reach * np.array(gaps) / 2) / 2
    return np.concatenate([-reach * np.asarray(p) / (2 * mass), a])


@pytest.mark.parametrize("kind", MADE)
@pytest.mark.parametrize("n", [*LENGTHS, 200])
def test_field_energy_and_sign(kind, n):
    system, x = MADE[kind](n), state(n, kind)
    np.testing.assert_allclose(system.vector_field(x), by_hand(n, kind, x), rtol=0, atol=1e-14)
    if n > 2 or kind == "open":
        assert system.energy(x) == pytest.approx(np.trace(matrix(n, x) @ matrix(n, x)) / 2, rel=1e-13)
    assert system.sign == 1 and system.dim == len(x) and system.parameters == {"sites": n}


@pytest.mark.parametrize("kind", MADE)
def test_it_is_the_lattice_of_particles(kind):
    mass, strength, reach = 1.5, 0.7, 1.25
    q, p = [0.0, 0.8, 2.1], [0.6, -0.3, 0.2]
    late = particles(kind, mass, strength, reach, q, p, 1)
    system, x0 = MADE[kind](3), flaschka(kind, mass, strength, reach, q, p)
    wanted = flaschka(kind, mass, strength, reach, late[:3], late[3:])
    if kind == "open":
        np.testing.assert_allclose(system.exact(x0, 1.0), wanted, rtol=0, atol=4e-16)
    for method in (co.Splitting(order=2), co.Splitting(order=4), co.GaussLegendre(stages=2)):
        assert_order(system, x0, 1.0, 0.1, method, wanted)


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


def test_exact_shapes_and_refusals():
    system, x = co.systems.toda(3), state(3, "open")
    assert system.exact(x, 1.0).shape == (5,) and system.exact(x, [0.0, 1.0]).shape == (2, 5)
    np.testing.assert_array_equal(system.exact(x, 0.0), x)
    np.testing.assert_array_equal(system.exact(np.zeros(5), 1.0), np.zeros(5))
    with pytest.raises(TypeError, match="toda has a closed form of the state alone"):
        system.exact(x, 1.0, attitude=True)
    with pytest.raises(ValueError, match="x0 has shape"):
        system.exact(x[:4], 1.0)
    with pytest.raises(ValueError, match="t is 1e\\+09, too long"):
        system.exact(x, 1e9)
    with pytest.raises(TypeError, match="no closed form is known for toda_ring"):
        co.systems.toda_ring(3).exact(state(3, "ring"), 1.0)


@pytest.mark.parametrize("kind", MADE)
@pytest.mark.parametrize("n", [2, 3, 4, 5])
def test_traces_are_integrals_in_involution(kind, n):
    system = MADE[kind](n)
    integrals = system.integrals
    assert list(integrals) == [f"tr L^{k}" for k in range(3, n + 1)]
    ring = ExactPolynomials(system.algebra)
    exact = [ring.from_polynomial(p) for p in (polynomial_of(system.hamiltonian), *integrals.values())]
    assert all(ring.bracket(f, g) == ring.zero for f in exact for g in exact)
    x = state(n, kind, seed=n)
    for k in range(3, n + 1):
        wanted = np.trace(np.linalg.matrix_power(matrix(n, x), k))
        assert integrals[f"tr L^{k}"](x) == pytest.approx(wanted, rel=1e-12, abs=1e-12)
    functions = [*system.casimirs.values(), polynomial_of(system.hamiltonian), *integrals.values()]
    assert np.linalg.matrix_rank([f.gradient(x) for f in functions]) == len(functions) == n + (kind == "ring")


def test_how_many_traces():
    assert list(traces(8, False)) == [f"tr L^{k}" for k in range(3, 9)]
    assert list(traces(9, True)) == ["tr L^3", "tr L^4"] == list(traces(64, False)) and traces(65, True) == {}
    x = state(20, "ring")
    assert traces(20, True)["tr L^4"](x) == pytest.approx(np.trace(np.linalg.matrix_power(matrix(20, x), 4)), rel=1e-13)


@pytest.mark.parametrize("kind", MADE)
def test_a_splitting_has_two_parts_and_keeps_the_casimirs(kind):
    n = 5
    system, x0 = MADE[kind](n), state(n, kind, seed=1)
    assert "H in 2 parts" in str(co.Splitting(order=2).describe(system))
    run = co.integrate(system, x0, (0.0, 10.0), 0.05, co.Splitting(order=2))
    kept = {"tr L": np.sum(x0[:n])} | ({"product of a": np.prod(x0[n:])} if kind == "ring" else {})
    assert {name: values[0] for name, values in run.casimirs.items()} == pytest.approx(kept, rel=1e-14)
    # 200 steps, each of n additions and products: rounding alone, and it has no sign that it prefers
    assert all(run.drift()[name] < 2e-15 * 200 for name in kept)
    for trace in system.integrals.values():
        assert_bounded_by_order(trace, system, x0, 4.0, 0.05, co.Splitting(order=2))


def test_a_long_ring_follows_the_logarithm_of_the_product():
    system, x = co.systems.toda_ring(1000), state(1000, "ring")
    assert list(system.casimirs) == ["tr L", "log of the product of a"]
    run = co.integrate(system, x, (0.0, 0.5), 0.05, co.Splitting(order=2))
    assert run.casimirs["log of the product of a"][0] == pytest.approx(np.log(x[1000:]).sum(), rel=1e-14)
    assert run.drift()["log of the product of a"] < 1e-14 * np.abs(np.log(x[1000:])).sum()


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


def test_what_does_not_fit_is_refused_with_the_estimate():
    with pytest.raises(ValueError, match="GB"):
        co.systems.toda(10**13)

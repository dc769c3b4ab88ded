"""Moments of Vlasov-Poisson and particles with a width: clouds of particles, forces by hand, 40 digits, integrals."""

import functools
import json
from pathlib import Path

import numpy as np
import pytest
from brackets import bracket, rational_points

import coadjoint as co
import refusals
from moments import moments as moments_by_brackets
from refusals import refused

vlasov_moments, decorated_particles = co.systems.vlasov_moments, co.systems.decorated_particles
canonical_state = co.systems.canonical_state
(FILE,) = Path(refusals.__file__).parent.rglob("lie_poisson_systems.json")
BEAM = next(s for s in json.loads(FILE.read_text())["systems"] if s["name"] == "moments_2")


def powers_of(degree):
    """The powers (i, j) of q and p, of even degrees in ascending order, of q descending."""
    return [(d - j, j) for d in range(2, degree + 1, 2) for j in range(d + 1)]


@functools.cache
def system_of(degree):
    return vlasov_moments(degree, "1/2*x20")


def algebra_of(degree):
    return system_of(degree).algebra


def cloud(seed, count=40):
    """Particles symmetric about the origin, of small weight."""
    q, p = np.random.default_rng(seed).standard_normal((2, count))
    return np.concatenate([q, -q]), np.concatenate([p, -p])


def moments_of(q, p, degree):
    return np.array([np.mean(q**i * p**j) for i, j in powers_of(degree)])


@pytest.mark.parametrize("degree", [2, 4, 6, 8])
def test_algebra(degree):
    g, powers = algebra_of(degree), powers_of(degree)
    triples = list(zip(*(column.tolist() for column in g.triples), strict=True))
    co.LieAlgebra(triples, dim=g.dim)  # antisymmetry and the Jacobi identity
    for a, b, k, c in triples:
        (i, j), (m, n) = powers[a], powers[b]
        assert powers[k] == (i + m - 1, j + n - 1) and c == i * n - j * m


@pytest.mark.parametrize("degree", [2, 8, 10, 12])
def test_moments_are_named_by_their_powers(degree):
    """With a comma where a power has two digits."""
    g, powers = algebra_of(degree), powers_of(degree)
    names = g.basis
    assert names == tuple(f"x{i},{j}" if i > 9 or j > 9 else f"x{i}{j}" for i, j in powers)
    assert len(set(names)) == len(names) == degree // 2 * (degree // 2 + 2)
    assert g.name == f"moments({degree})"
    assert list(system_of(degree).casimirs) == (
        ["emittance^2"] if degree == 2 else [f"(form, form)_{degree}"] + ["catalecticant"] * (degree <= 10)
    )


def test_algebra_of_degree_4_and_2():
    assert algebra_of(4) == moments_by_brackets()
    assert algebra_of(4).generic_rank() == 6
    x = dict(zip(algebra_of(4).basis, np.random.default_rng(0).standard_normal(8), strict=True))
    form, determinant = system_of(4).casimirs.values()
    catalecticant = [["x40", "x31", "x22"], ["x31", "x22", "x13"], ["x22", "x13", "x04"]]
    values = list(x.values())
    assert form(values) == pytest.approx(x["x40"] * x["x04"] - 4 * x["x31"] * x["x13"] + 3 * x["x22"] ** 2, rel=1e-14)
    wanted = np.linalg.det([[x[name] for name in row] for row in catalecticant])
    assert determinant(values) == pytest.approx(wanted, rel=1e-12)
    g = algebra_of(2)
    co.LieAlgebra(list(zip(*g.triples, strict=True)), dim=3, representation=g.representation)  # checks it
    assert system_of(2).casimirs["emittance^2"] == co.Polynomial({(1, 0, 1): 1, (0, 2, 0): -1})


def test_field_by_hand():
    system = vlasov_moments(4, "1/2*x20 + 0.1*x20^2 + 1/4*x40 + 0.05*x20*x40")
    x = np.random.default_rng(3).standard_normal(8)
    m = dict(zip(powers_of(4), x, strict=True))
    slope = {2: 0.5 + 0.2 * m[2, 0] + 0.05 * m[4, 0], 4: 0.25 + 0.05 * m[2, 0]}
    wanted = [
        i * m.get((i - 1, j + 1), 0.0) - j * sum(k * slope[k] * m.get((i + k - 1, j - 1), 0.0) for k in (2, 4))
        for i, j in powers_of(4)
    ]
    np.testing.assert_allclose(system.vector_field(x), wanted, rtol=0, atol=1e-13)
    assert system.sign == 1 and system.integrals == {}


def test_reference_in_40_digits():
    system = vlasov_moments(2, "1/2*x20 + 0.1*x20^2")
    x0 = np.array([1.0, 0.2, 0.5])
    for late in BEAM["states"]:
        if late["t"] <= 5:
            wanted = np.array([float(v) for v in late["x"]])
            run = co.integrate(system, x0, (0, float(late["t"])), 0.05, co.GaussLegendre(6))
            np.testing.assert_allclose(run.x[-1], wanted, rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize("degree", [4, 6, 8])
def test_integrals_by_polynomial_identity(degree):
    text = "1/2*x20 + 3/4*x40" + (" - 1/8*x60" if degree > 4 else "")
    system = vlasov_moments(degree, text)
    assert list(system.integrals) == [f"<h^{m}>" for m in range(2, degree // 2 + 1)]
    for F in system.integrals.values():
        assert all(bracket(system, F, system.hamiltonian, x) == 0 for x in rational_points(system.dim))
    q, p = cloud(0)
    if degree == 4:
        harmonic = vlasov_moments(4, "0.5*x20").integrals["<h^2>"]
        assert harmonic.value(moments_of(q, p, 4)) == pytest.approx(np.mean((p**2 + q**2) ** 2 / 4), rel=1e-13)


def test_potentials_of_every_kind():
    x = moments_of(*cloud(2), 4)
    text = vlasov_moments(4, "1/2*x20 + 0.1*x20^2 + 1/4*x40")
    polynomial = vlasov_moments(4, co.Polynomial({(1, 0): 0.5, (2, 0): 0.1, (0, 1): 0.25}))

    def value(m):
        return m[0] / 2 + m[0] ** 2 / 10 + m[1] / 4

    def slope(m):
        return np.array([0.5 + m[0] / 5, 0.25])

    functions = vlasov_moments(4, co.Hamiltonian(value, slope))
    for other in (polynomial, functions):
        np.testing.assert_allclose(other.vector_field(x), text.vector_field(x), rtol=0, atol=1e-14)
        assert other.parameters is None
        assert "H in 2 parts" in str(co.Splitting().describe(other))
    assert "H in 2 parts" in str(co.Splitting().describe(text))
    runs = [co.integrate(s, x, (0, 1), 0.1, co.GaussLegendre(2)).x[-1] for s in (text, functions)]
    np.testing.assert_allclose(runs[0], runs[1], rtol=1e-12)
    high = vlasov_moments(12, "x10,0 + 1/2*x100 + x120")
    assert high.energy(np.eye(high.dim)[high.algebra.basis.index("x10,0")]) == 1.5


def by_hand(x, w, W, U):
    """q' = p/w, p' = -dH/dq, and the widths under their own curvature; W and U are numpy polynomials."""
    n = len(w)
    q, p, widths = x[:n], x[n : 2 * n], x[2 * n + 1 :].reshape(n, 3)
    force = -w * W.deriv(1)(q) - W.deriv(3)(q) * widths[:, 0] / 2
    curvature = W.deriv(2)(q) + U.deriv(2)(0.0) * w
    for a in range(n):
        for b in range(n):
            if a != b:
                r = q[a] - q[b]
                force[a] -= w[a] * w[b] * U.deriv(1)(r)
                force[a] -= U.deriv(3)(r) * (w[b] * widths[a, 0] + w[a] * widths[b, 0]) / 2
                curvature[a] += U.deriv(2)(r) * w[b]
    x20, x11, x02 = widths.T
    moving = np.stack([2 * x11, x02 - curvature * x20, -2 * curvature * x11], axis=1)
    return np.concatenate([p / w, force, [0.0], moving.ravel()])


@pytest.mark.parametrize("count", [1, 2, 4])
def test_particles_by_hand(count):
    rng = np.random.default_rng(count)
    w, W = rng.uniform(0.5, 2.0, count), np.polynomial.Polynomial(rng.standard_normal(6))
    even = rng.standard_normal(7) * (np.arange(7) % 2 == 0)
    U = np.polynomial.Polynomial(even)
    system = decorated_particles(w, W.coef, even)
    x = rng.standard_normal(system.dim)
    x[2 * count] = 1.0
    wanted = by_hand(x, w, W, U)
    np.testing.assert_allclose(system.vector_field(x), wanted, rtol=0, atol=1e-12 * np.abs(wanted).max())
    for mixed in (
        decorated_particles(w, tuple(W.deriv(k) if k else W for k in range(4)), even),
        decorated_particles(w, W.coef, tuple(U.deriv(k) if k else U for k in range(4))),
    ):
        np.testing.assert_allclose(mixed.vector_field(x), wanted, rtol=0, atol=1e-12 * np.abs(wanted).max())
        assert mixed.energy(x) == pytest.approx(system.energy(x), rel=1e-12)
        assert mixed.parameters is None
        with refused(TypeError, "closed form", "decorated_particles"):
            mixed.exact(x, 1.0)
    assert "H in 2 parts" in str(co.Splitting().describe(system))
    assert next(iter(system.casimirs)) == "z" and len(system.casimirs) == count + 1


def test_integrals_of_particles():
    free = decorated_particles((1.0, 2.0, 0.5), (3.0,), (0, 0, 1, 0, 0.5))
    trapped = decorated_particles((1.0, 2.0, 0.5), (0, 0, 0.5), (0, 0, 1, 0, 0.5))
    for system, names in ((free, ["total momentum"]), (trapped, ["energy of the centre"])):
        assert list(system.integrals) == names
    for point in rational_points(free.dim):
        assert bracket(free, free.integrals["total momentum"], free.hamiltonian, point) == 0
    x = np.random.default_rng(0).standard_normal(trapped.dim)
    F = trapped.integrals["energy of the centre"]
    w, q, p = np.array([1.0, 2.0, 0.5]), x[:3], x[3:6]
    assert F.value(x) == pytest.approx(p.sum() ** 2 / 7 + 0.5 / 3.5 * (w @ q) ** 2, rel=1e-13)
    assert abs(F.gradient(x) @ trapped.vector_field(x)) < 1e-13
    for count, known in ((64, ["energy of the centre"]), (65, [])):
        assert list(decorated_particles(np.ones(count), (0, 0, 0.5), (0.0,)).integrals) == known
    for other in ((0, 1.0), (0, 0, 1, 1)):
        assert decorated_particles((1.0, 2.0), other).integrals == {}


@pytest.mark.parametrize("size", [1e-25, 1.0, 1e25])
def test_potentials_of_pairs_as_functions_are_even_relative_to_their_size(size):
    """Near zero as well as far away; rounding of an even one is accepted."""

    def scaled(*chain):
        return tuple(functools.partial(lambda f, r: size * f(r), f) for f in chain)

    # 0.1 r^2 from (r + 1)^2: rounded differently at r and -r
    even = scaled(
        lambda r: 0.1 * ((r + 1.0) ** 2 - 2.0 * r), lambda r: 0.2 * r, lambda r: 0.2 + 0.0 * r, lambda r: 0.0 * r
    )
    assert decorated_particles((1.0, 2.0), (0.0,), even).dim == 11

    def chain(*coefficients):
        p = np.polynomial.Polynomial(coefficients)
        return scaled(p, p.deriv(1), p.deriv(2), p.deriv(3))

    # the second one, (r^2 - 9/64)^2 r, is even to rounding at 0.375 alone
    for odd, place in ((chain(0, 1), "0.375"), (chain(0, 81 / 4096, 0, -18 / 64, 0, 1), "1.5")):
        with refused(ValueError, "pair", place, f"-{place}", "even"):
            decorated_particles((1.0, 2.0), (0.0,), odd)


@pytest.mark.parametrize("what", ["external", "pair"])
@pytest.mark.parametrize("wrong", [1, 2, 3])
def test_the_wrong_one_of_four_functions_is_named(what, wrong):
    chain = [np.cosh, np.sinh, np.cosh, np.sinh]
    chain[wrong] = lambda r: 1.5 + r
    with refused(ValueError, f"{what}[{wrong}]", f"{what}[{wrong - 1}]"):
        decorated_particles(**{what: tuple(chain)})


def test_states_of_pairs():
    np.testing.assert_array_equal(canonical_state([1, 2], [3, 4], [5]), [1, 2, 3, 4, 1, 5])
    for given, named in (
        (([1, 2], [3]), ("q has shape (2,)", "p (1,)")),
        ((np.ones((2, 2)), np.ones((2, 2))), ("q has shape (2, 2)",)),
        (("q", 1, 2), ("q is 'q'",)),
        ((1.0, np.inf), ("p is inf",)),
        ((1.0, 1.0, [0, np.nan]), ("x[1]", "nan")),
    ):
        with refused((TypeError, ValueError), *named):
            canonical_state(*given)

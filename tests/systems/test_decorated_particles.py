"""Particles with a width: against clouds of particles, forces by hand, and what the centre of mass does."""

import functools

import numpy as np
import pytest
from two_steps import assert_bounded_by_order, assert_order

import coadjoint as co
from coadjoint.algebra.families.products import copies
from coadjoint.algebra.polynomials.exact_polynomials import ExactPolynomials
from coadjoint.systems.canonical import canonical_state, with_canonical_pairs

decorated_particles = co.systems.decorated_particles


def lumps(seed, weights, count=30):
    """Clouds of point masses: positions and velocities, each cloud of its mass."""
    rng = np.random.default_rng(seed)
    centres = rng.standard_normal((2, len(weights), 1))
    return centres[0] + 0.3 * rng.standard_normal((len(weights), count)), centres[1] + rng.standard_normal(
        (len(weights), count)
    )


def state_of(q, v, w):
    centre, speed = q.mean(axis=1), v.mean(axis=1)
    a, b = q - centre[:, None], v - speed[:, None]
    widths = w[:, None] * np.stack([(a * a).mean(axis=1), (a * b).mean(axis=1), (b * b).mean(axis=1)], axis=1)
    return canonical_state(centre, w * speed, widths.ravel())


def test_beside_names_and_brackets():
    g = with_canonical_pairs(2, co.algebras.so(3))
    assert g.basis == ("q1", "q2", "p1", "p2", "z", "e1", "e2", "e3")
    assert list(g.casimirs_known) == ["z", "|x|^2"]
    ring = ExactPolynomials(g)
    q1, q2, p1, p2, z, *_ = ring.coordinates
    assert ring.bracket(q1, p1) == z == ring.bracket(q2, p2)
    assert ring.bracket(q1, p2) == ring.zero == ring.bracket(q1, ring.coordinates[5])
    for casimir in g.casimirs_known.values():
        assert all(ring.bracket(ring.from_polynomial(casimir), x) == ring.zero for x in ring.coordinates)
    # a number in the name of a Casimir of g belongs to it
    spins = with_canonical_pairs(1, copies(co.algebras.so(3), 2))
    assert list(spins.casimirs_known) == ["z", *copies(co.algebras.so(3), 2).casimirs_known]
    # no Casimirs are known of a sum with one that has none, but z
    assert list(with_canonical_pairs(1, co.algebras.get("A2,1")).casimirs_known) == ["z"]
    with pytest.raises(ValueError, match=r"q has shape \(2,\) and p \(1,\)"):
        canonical_state([1, 2], [3])
    with pytest.raises(ValueError, match=r"q has shape \(2, 2\) and p \(2, 2\); give one number for each pair"):
        canonical_state(np.ones((2, 2)), np.ones((2, 2)))
    for given, message in (
        (("q", 1, 2), "q is 'q'"),
        ((1.0, np.inf), "p is inf"),
        ((1.0, 1.0, [0, np.nan]), r"x\[1\]"),
    ):
        with pytest.raises((TypeError, ValueError), match=message):
            canonical_state(*given)


@pytest.mark.parametrize("seed", range(3))
def test_energy_and_motion_are_those_of_clouds(seed):
    """Potentials of second degree: lumps of point masses move so without any expansion."""
    w = np.array([1.0, 2.5, 0.5])
    push, k, u = np.random.default_rng(seed).standard_normal(3)
    q, v = lumps(seed, w)
    system, x0 = decorated_particles(w, (0.0, push, k / 2), (0.0, 0.0, u / 2)), state_of(q, v, w)
    m = np.broadcast_to(w[:, None] / q.shape[1], q.shape).ravel()
    flat = q.ravel()
    energy = np.sum(m * (v.ravel() ** 2 / 2 + push * flat + k * flat**2 / 2))
    energy += u / 4 * np.sum(m[:, None] * m * (flat[:, None] - flat) ** 2)
    assert system.energy(x0) == pytest.approx(energy, rel=1e-12)
    # every point: q'' = -push - k q - u sum of m (q - q_b); solved by eigenvectors of the whole matrix
    matrix = k * np.eye(len(m)) + u * (m.sum() * np.eye(len(m)) - np.broadcast_to(m, (len(m), len(m))))
    t, steps = 0.7, 20
    full = np.block([[np.zeros_like(matrix), np.eye(len(m))], [-matrix, np.zeros_like(matrix)]])
    force = np.concatenate([np.zeros(len(m)), np.full(len(m), -push)])
    y, term = np.concatenate([flat, v.ravel()]), np.concatenate([flat, v.ravel()])
    drive = force * t
    y, last = y + drive, drive
    for order in range(1, steps + 20):  # the series of exp, and of its integral on the constant force
        term = t / order * full @ term
        last = t / (order + 1) * full @ last
        y = y + term + last
    wanted = state_of(y[: len(m)].reshape(q.shape), y[len(m) :].reshape(q.shape), w)
    np.testing.assert_allclose(system.exact(x0, t), wanted, rtol=0, atol=1e-12)
    np.testing.assert_allclose(system.exact(x0, [0.0, t]), [x0, system.exact(x0, t)], rtol=0, atol=1e-15)
    for method in (co.Splitting(order=2), co.Splitting(order=4), co.GaussLegendre(stages=2)):
        assert_order(system, x0, t, 0.1, method, wanted)


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
def test_field_by_hand(count):
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
        assert mixed.parameters is None and mixed.closed_form is None
    assert "H in 2 parts" in str(co.Splitting().describe(system))
    ring = ExactPolynomials(system.algebra)
    for casimir in system.casimirs.values():
        assert all(ring.bracket(ring.from_polynomial(casimir), y) == ring.zero for y in ring.coordinates)
    assert next(iter(system.casimirs)) == "z" and len(system.casimirs) == count + 1


@pytest.mark.long
def test_functions_are_compiled():
    def gauss(r):
        return np.exp(-r * r)

    def first(r):
        return -2 * r * np.exp(-r * r)

    def second(r):
        return (4 * r * r - 2) * np.exp(-r * r)

    def third(r):
        return (12 * r - 8 * r**3) * np.exp(-r * r)

    w = np.array([1.0, 0.5, 0.25])
    system = decorated_particles(w, (0.0,), (gauss, first, second, third))
    x0 = canonical_state([-1.0, 0.2, 0.9], [0.2, 0.1, -0.3], [0.1, 0.0, 0.1, 0.2, 0.1, 0.2, 0.1, -0.05, 0.3])
    exact = co.integrate(system, x0, (0, 1), 1 / 32, co.GaussLegendre(stages=6)).x[-1]
    assert_order(system, x0, 1.0, 0.1, co.Splitting(), exact)
    run = co.integrate(system, x0, (0, 1), 0.1, co.Splitting(), observe=system.integrals)
    assert list(system.integrals) == ["total momentum"]
    assert max(value for name, value in run.drift().items() if name != "energy") < 1e-14
    wrong = (gauss, first, first, third)
    with pytest.raises(ValueError, match=r"pair\[2\] contradicts pair\[1\]"):
        decorated_particles(w, (0.0,), wrong)
    with pytest.raises(ValueError, match="the potential of a pair is even"):
        decorated_particles(w, (0.0,), (np.sin, np.cos, lambda r: -np.sin(r), lambda r: -np.cos(r)))


def test_integrals_by_polynomial_identity():
    free = decorated_particles((1.0, 2.0, 0.5), (3.0,), (0, 0, 1, 0, 0.5))
    trapped = decorated_particles((1.0, 2.0, 0.5), (0, 0, 0.5), (0, 0, 1, 0, 0.5))
    for system, names in ((free, ["total momentum"]), (trapped, ["energy of the centre"])):
        assert list(system.integrals) == names
    ring = ExactPolynomials(free.algebra)
    total = ring.from_polynomial(free.integrals["total momentum"].to_polynomial())
    assert ring.bracket(total, ring.from_polynomial(free.hamiltonian.polynomial)) == ring.zero
    x = np.random.default_rng(0).standard_normal(trapped.dim)
    F = trapped.integrals["energy of the centre"]
    w, q, p = np.array([1.0, 2.0, 0.5]), x[:3], x[3:6]
    assert F.value(x) == pytest.approx(p.sum() ** 2 / 7 + 0.5 / 3.5 * (w @ q) ** 2, rel=1e-13)
    assert abs(F.gradient(x) @ trapped.vector_field(x)) < 1e-13
    x0 = canonical_state([-1.0, 0.2, 0.9], [0.2, 0.1, -0.3], [0.1, 0.0, 0.1] * 3)
    assert_bounded_by_order(F.value, trapped, x0, 2.0, 0.05, co.Splitting())
    for count, known in ((64, ["energy of the centre"]), (65, [])):
        assert list(decorated_particles(np.ones(count), (0, 0, 0.5), (0.0,)).integrals) == known
    for other in ((0, 1.0), (0, 0, 1, 1)):
        assert decorated_particles((1.0, 2.0), other).integrals == {}


@pytest.mark.parametrize(
    ("external", "pair", "known"),
    [
        ((0.0, 0.5, 1.0, 0.0, 0.0), (0.0, 0.0, 0.5, 0.0), True),
        ((1.0,), (0.5,), True),
        ((0.0, 0.0, 1.0, 0.5), (0.0,), False),
        ((0.0, 0.0, 1.0, 0.0, 0.5), (0.0,), False),
        ((0.0, 0.0, 1.0), (0.0, 0.0, 0.5, 0.0, 0.25), False),
    ],
)
def test_closed_forms_of_potentials_up_to_the_second_degree(external, pair, known):
    """Whatever zeros follow."""
    assert (decorated_particles((1.0, 2.5, 0.5), external, pair).closed_form is not None) == known


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
    odd = scaled(lambda r: r, lambda r: 1.0 + 0.0 * r, lambda r: 0.0 * r, lambda r: 0.0 * r)
    with pytest.raises(ValueError, match=r"pair is .* at 0.375 and -.* at -0.375; the potential of a pair is even"):
        decorated_particles((1.0, 2.0), (0.0,), odd)

    def beyond(power):  # (r^2 - 9/64)^2 r: even to rounding at 0.375 alone
        p = np.polynomial.Polynomial([0, 81 / 4096, 0, -18 / 64, 0, 1]).deriv(power)
        return lambda r: sum(c * r**k for k, c in enumerate(p.coef))

    flat = scaled(*(beyond(power) if power else (lambda r: (r * r - 9 / 64) ** 2 * r) for power in range(4)))
    with pytest.raises(ValueError, match=r"at 1.5 and .* at -1.5; the potential of a pair is even"):
        decorated_particles((1.0, 2.0), (0.0,), flat)


@pytest.mark.parametrize("what", ["external", "pair"])
@pytest.mark.parametrize("wrong", [1, 2, 3])
def test_the_wrong_one_of_four_functions_is_named(what, wrong):
    chain = [np.cosh, np.sinh, np.cosh, np.sinh]
    chain[wrong] = lambda r: 1.5 + r
    with pytest.raises(ValueError, match=rf"{what}\[{wrong}\] contradicts {what}\[{wrong - 1}\]"):
        decorated_particles(**{what: tuple(chain)})


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"weights": (1.0, 2.0, 1e51)}, r"weights\[2\] is 1e\+51; masses are positive, from 1e-50 to 1e\+50"),
        ({"weights": (1.0, 1e-51)}, r"weights\[1\] is 1e-51; masses are positive"),
        ({"external": (1e60,)}, "external has coefficients beyond"),
    ],
)
def test_wrong_values(given, message):
    with pytest.raises((ValueError, TypeError), match=message):
        decorated_particles(**given)

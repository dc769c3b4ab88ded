"""The group element of Taylor series: against forty digits, closed forms and other schemes; in its group."""

from itertools import pairwise

import mpmath
import numpy as np
import pytest

import coadjoint as co
from drawn_matrices import full
from energies import polynomial
from long import long_where
from moments import moments
from refusals import refused
from rounding import UNIT_ROUNDOFF

pytestmark = pytest.mark.thinned(6)

ALGEBRAS = {
    "so(3)": co.algebras.so(3),
    "sl(2)": co.algebras.sl(2),
    "A3,7": co.algebras.A3_7(0.7),
    "A5,3": co.algebras.get("A5,3"),
    "e(3)": co.algebras.e(3),
    "so(4)": co.algebras.so(4),
    "so(2,2)": co.algebras.get("so(2,2)"),
    "su(3)": co.algebras.su(3),
    "moments": moments(),
    "so(5)": co.algebras.so(5),
}


def system_on(name, degree=2, sign=-1):
    algebra = ALGEBRAS[name]
    n = algebra.dim
    if degree > 2:
        return co.LiePoissonSystem(algebra, polynomial(n, degree, n), sign=sign)
    H = co.Quadratic(full(n, n), linear=np.linspace(-0.3, 0.4, n))
    return co.LiePoissonSystem(algebra, H, sign=sign)


def start_of(system):
    x = np.random.default_rng(system.dim).uniform(-1.0, 1.0, system.dim)
    return x / np.linalg.norm(x)


def matrices_of(system, attitude):
    if attitude is True:
        return system.representation
    return np.stack([system.algebra.coadjoint(e) for e in np.eye(system.dim)])


def attitudes(system):
    return ["coadjoint", True] if system.representation is not None else ["coadjoint"]


def element_of_the_series(system, degree, attitude, x, h, order):
    """Return the flow of g' = -sign g rho(u) in 40 digits, u the gradient of H on the series as far as it is known."""
    rho, n = matrices_of(system, attitude), system.dim
    with mpmath.workdps(60):
        point = np.array([mpmath.mpf(v) for v in x], dtype=object)
        # The products in a gradient of higher degree stop one order before the coordinates.
        known = order + 1 if degree == 2 else order
        ends = [point] + [co.Taylor(p, projected=False).step(system, point, 0, mpmath.mpf(h)) for p in range(1, known)]
        terms = [point, *(more - fewer for fewer, more in pairwise(ends))]
        # Coefficients of the gradient along the series, a polynomial, from its values at points.
        count = (degree - 1) * (known - 1) + 1
        places = [mpmath.mpf(2 * k - count) / count for k in range(count)]
        values = [system.hamiltonian.gradient(sum(s**k * term for k, term in enumerate(terms))) for s in places]
        powers = mpmath.matrix([[s**k for k in range(count)] for s in places]) ** -1
        u = [list(powers * mpmath.matrix([value[i] for value in values]))[:known] for i in range(n)]
        zero = mpmath.matrix(rho.shape[1], rho.shape[1])
        A = [
            sum((u[i][k] * mpmath.matrix(-system.sign * rho[i]) for i in range(n) if k < len(u[i])), zero)
            for k in range(known)
        ]
        P = [mpmath.eye(rho.shape[1])]
        while len(P) < 8 or max(mpmath.norm(term, "inf") for term in P[-known:]) > 1e-30:
            k = len(P) - 1
            P.append(sum((P[k - i] * A[i] for i in range(min(known, k + 1))), zero) * mpmath.mpf(h) / (k + 1))
        return np.array(sum(P[1:], P[0]).tolist(), dtype=float)


@pytest.mark.thinned(16)
@pytest.mark.parametrize(
    ("name", "degree"),
    long_where(
        [("moments", 2), ("so(5)", 2)],
        [(name, d) for name, g in ALGEBRAS.items() for d in (2, 3, 4) if d == 2 or g.dim <= 6],
    ),
)
def test_one_step_is_the_flow_of_the_polynomial_that_the_gradient_is(name, degree):
    """In 40 digits. Entries are rounded some d times; those of what grows and shrinks again by the growth."""
    system = system_on(name, degree, sign=-1 if degree % 2 else 1)
    x = start_of(system)
    for attitude in attitudes(system):
        for order, h in ((1, 0.25), (4, -0.5), (7, 0.75)):
            method = co.Taylor(order, projected=False)
            found = co.integrate(system, x, (0, h), abs(h), method, attitude=attitude).attitude[-1]
            exact = element_of_the_series(system, degree, attitude, x, h, order)
            assert np.max(np.abs(exact - np.eye(len(exact)))) > 1e-3
            assert np.max(np.abs(found - exact)) < 32 * len(exact) * UNIT_ROUNDOFF * np.max(np.abs(exact))


def test_closed_forms():
    """A free body over twenty times its period, and one that is nearly a sphere, which turns 60 times in a step."""
    bodies = (((1, 2, 3), (0.3, 1.0, -0.5), 100.0, 0.5), ((1, 1.001, 1.002), (30.0, 10.0, 5.0), 48.0, 12.0))
    for inertia, x0, t, h in bodies:
        body = co.systems.rigid_body(inertia=inertia)
        _, A = body.exact(x0, t, attitude=True)
        run = co.integrate(body, x0, (0, t), h, co.Taylor(24), attitude=True)
        # the angle is |x| t, which is known to its rounding, of which there is one in a step
        assert np.max(np.abs(run.attitude[-1] - A)) < 64 * UNIT_ROUNDOFF * np.linalg.norm(x0) * t
        assert np.max(np.abs(run.attitude[-1] @ run.x[-1] - x0)) < 64 * UNIT_ROUNDOFF * np.linalg.norm(x0) * t / h


def invariant_form(rho):
    """Return a regular form P with rho_i^T P + P rho_i = 0."""
    d = rho.shape[1]
    conditions = np.concatenate([np.kron(r.T, np.eye(d)) + np.kron(np.eye(d), r.T) for r in rho])
    _, values, rows = np.linalg.svd(conditions)
    kernel = rows[values < 1e-12 * values[0]]
    return np.reshape(np.linspace(1.0, 1.5, len(kernel)) @ kernel, (d, d))


@pytest.mark.parametrize("name", ["so(3)", "so(4)", "so(2,2)", "su(3)", "sl(2)", "so(5)"])
@pytest.mark.parametrize("order", [2, 6])
def test_the_element_stays_in_its_group(name, order):
    """The bilinear form of a representation, though the series is far from the motion; by rounding at random."""
    system = system_on(name)
    x = start_of(system)
    steps = 40 if name in ("so(2,2)", "sl(2)") else 4000  # elements of these grow
    for attitude in attitudes(system):
        form = invariant_form(matrices_of(system, attitude))
        run = co.integrate(system, x, (0, 0.25 * steps), 0.25, co.Taylor(order), attitude=attitude, save_every=steps)
        g = run.attitude[-1]
        inverse = np.linalg.inv(form)
        size = np.linalg.norm(g, 2) ** 2 * np.linalg.cond(form)
        bound = 4 * len(form) * UNIT_ROUNDOFF * np.sqrt(steps) * size * np.max(np.abs(inverse))
        assert np.max(np.abs(g @ inverse @ g.T - inverse)) < bound


def test_elements_that_cannot_be_followed():
    growing = co.LiePoissonSystem(co.algebras.A3_7(2.0), co.Quadratic(np.zeros(3), linear=[0, 0, 3.0]))
    with refused(co.IntegrationError, "overflow"):
        co.integrate(growing, (0, 0, 1), (0, -400), 1.0, co.Taylor(4), attitude="coadjoint")
    sphere = co.systems.rigid_body(inertia=(1, 1, 1))
    with refused(co.IntegrationError, "group element", "too far"):
        co.integrate(sphere, (1, 1, 1), (0, 1e6), 1e6, co.Taylor(4), attitude=True)
    states = np.array([[1.0, 1.0, 1.0], [1e9, 0.0, 0.0]])
    with refused(co.IntegrationError, "1 of 2 members"):
        co.integrate(sphere, states, (0, 3), 1.0, co.Taylor(4), attitude=True)


@pytest.mark.parametrize("span", [(0.0, 3.0), (3.0, 0.0)])
def test_terms_that_vanish_by_chance_end_no_series(span):
    """A body that turns about one axis by t^3: of the terms of its group element two of three are zero."""
    algebra = co.algebras.direct_sum(co.algebras.so(3), co.algebras.heisenberg(1))
    system = co.LiePoissonSystem(algebra, co.Polynomial({(1, 0, 0, 2, 0, 0): 0.5, (0, 0, 0, 0, 1, 0): 1.0}))
    x0 = np.array([0.3, 0.5, -0.2, 0.0, 0.1, 1.5])
    run = co.integrate(system, x0, span, 3.0, co.Taylor(order=6, projected=False), attitude="coadjoint")
    angle = 1.5**2 * 3.0**3 / 6.0
    turned = run.attitude[-1][:3, :3]
    there = np.array([[np.cos(angle), abs(np.sin(angle))], [abs(np.sin(angle)), np.cos(angle)]])
    # Turned in parts: each is a product of matrices that rounds some entries of size 1.
    bound = 512 * 2.0**-53 * angle
    assert np.abs(np.abs(turned[1:, 1:]) - np.abs(there)).max() <= bound
    assert np.sign(turned[1, 1]) == np.sign(np.cos(angle)) and abs(turned[0, 0] - 1.0) <= bound


def test_what_rounding_leaves_of_the_group_element_is_kept():
    """Of short steps the change is rounded, not the element: 10^5 roundings of that would add up to hundreds of u."""
    body, step, count = co.systems.rigid_body(inertia=(1, 2, 3)), 2.0**-10, 10**5
    run = co.integrate(
        body, (0.3, 0.5, -0.4), (0, count * step), step, co.Taylor(order=6), attitude=True, save_every=count
    )
    element = run.attitude[-1]
    turned = np.linalg.norm((0.3, 0.25, 0.4 / 3)) * count * step
    assert np.abs(element.T @ element - np.eye(3)).max() <= 2.0 * turned * 2.0**-53

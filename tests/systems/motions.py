"""What is asked of a ready-made body or top: the order of its errors, and integrals that are some."""

import numpy as np
from scipy.integrate import solve_ivp

import coadjoint as co
from coadjoint.algebra.exact.numbers import fraction
from coadjoint.algebra.polynomials.exact_polynomials import ExactPolynomials

U = 2.0**-53
FULL = np.array([[2.0, 0.25, -0.1], [0.25, 3.0, 0.5], [-0.1, 0.5, 4.0]])
ORDERS = [(0, 1, 2), (1, 2, 0), (2, 0, 1), (1, 0, 2), (0, 2, 1), (2, 1, 0)]


def errors(system, x0, exact, T, h, method):
    """Largest errors at the end of runs with steps h and h/2."""
    ends = [co.integrate(system, x0, (0.0, T), step, method, save_every=10**6).x[-1] for step in (h, h / 2)]
    return [float(np.abs(end - exact).max()) for end in ends]


def assert_order(system, x0, exact, T, h, method=None):
    """The error falls by 2^p where the step is halved, to a power within 0.4, and is above the round-off."""
    for scheme in [co.Splitting(order=2), co.GaussLegendre(2)] if method is None else [method]:
        coarse, fine = errors(system, x0, exact, T, h, scheme)
        assert fine > 1e3 * U * T / h
        assert abs(np.log2(coarse / fine) - scheme.order) < 0.4, (coarse, fine, scheme)
    (fine,) = errors(system, x0, exact, T, h, co.Taylor(order=20))[1:]
    assert fine < 64 * U * (1.0 + T / h) * max(1.0, np.abs(exact).max())


def by_hand(field, x0, T):
    """The end of a motion by an independent code; its tolerance per step leaves about 1e-12."""
    return solve_ivp(lambda t, x: field(x), (0.0, T), x0, method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]


def bracket(system, F, G):
    ring = ExactPolynomials(system.algebra)
    return ring.bracket(ring.from_polynomial(polynomial_of(F)), ring.from_polynomial(polynomial_of(G)))


def polynomial_of(F):
    return F.to_polynomial() if hasattr(F, "to_polynomial") else getattr(F, "polynomial", F)


def assert_integrals(system, names, rounded=False):
    """Each bracket with the energy vanishes as a polynomial; none is a constant.

    Return how many of them, of energy and Casimirs are independent. `rounded`: coefficients are, by u of them.
    """
    assert list(system.integrals) == names
    x = np.cos(np.arange(1.0, system.dim + 1.0))
    known = [system.hamiltonian.gradient(x), *(C.gradient(x) for C in system.casimirs.values())]
    for F in system.integrals.values():
        rest = bracket(system, F, system.hamiltonian).to_dict().values()
        assert not rest or (rounded and max(abs(float(fraction(c))) for c in rest) < 4 * U)
        assert np.linalg.matrix_rank([*known, F.gradient(x)], tol=1e-9) >= len(system.casimirs) + 1
    gradients = [*known, *(F.gradient(x) for F in system.integrals.values())]
    return int(np.linalg.matrix_rank(gradients, tol=1e-9))


def assert_bounded(system, x0, h=0.1, F=None, T=40.0):
    """The integrals of a run of a Poisson method stay within c h^2 for all times: a quarter for half the step."""
    followed = system.integrals if F is None else F
    worst = []
    for step in (h, h / 2):
        sol = co.integrate(system, x0, (0.0, T), step, co.Splitting(order=2), observe=followed)
        worst.append({name: np.abs(values - values[0]).max() for name, values in sol.observed.items()})
    assert len(followed) == len(worst[0]) > 0
    for name in followed:
        coarse, fine = worst[0][name], worst[1][name]
        if coarse > 1e-11:  # an integral that is linear may be kept exactly
            assert 3.0 < coarse / fine < 5.4, (name, coarse, fine)


def turned(order, *triples):
    """The same vectors with their axes in another order."""
    return [np.asarray(v)[list(order)] for v in triples]

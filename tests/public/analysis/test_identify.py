"""Identified Hamiltonians: exact without noise, within their uncertainties with it, and refused where undetermined."""

from functools import cache

import numpy as np
import pytest
from scipy.stats import chi2

import coadjoint as co
from refusals import refused

SIGMA = 1e-3


def random_form(n, seed, linear=True):
    B = np.random.default_rng(seed).standard_normal((n, n))
    b = np.random.default_rng(seed + 1).standard_normal(n) if linear else None
    return co.Quadratic(0.2 * (B + B.T), b).to_polynomial()


def system_on(algebra, seed, sign=1):
    return co.LiePoissonSystem(algebra, random_form(algebra.dim, seed), sign=sign)


def solvable():
    """Return a solvable algebra: e4 acts on the other three by a random matrix, which is no derivation of so(3)."""
    D = np.array([[0.0, 1.0, 0.25], [-1.0, 0.0, 0.5], [0.125, -0.5, -0.125]])
    entries = {(3, j): {k: D[k, j] for k in range(3) if D[k, j]} for j in range(3)}
    return co.LieAlgebra.from_brackets(4, entries)


def cubic():
    H = random_form(3, 8) + co.Polynomial({(3, 0, 0): 0.25, (1, 1, 1): -0.125, (0, 2, 1): 0.375})
    return co.LiePoissonSystem(co.algebras.so(3), H)


CASES = {
    "so(3)": (lambda: system_on(co.algebras.so(3), 1), 2, 6.0, 0.02),
    "body": (lambda: system_on(co.algebras.so(3), 2, sign=-1), 2, 6.0, 0.02),
    "e(3)": (lambda: co.systems.heavy_top(), 2, 8.0, 0.02),
    "so(4)": (lambda: system_on(co.algebras.so(4), 3), 2, 6.0, 0.02),
    "sl(2)": (lambda: system_on(co.algebras.sl(2), 4), 2, 1.5, 0.01),
    "solvable": (lambda: system_on(solvable(), 5), 2, 3.0, 0.01),
    "degree 3": (lambda: cubic(), 3, 6.0, 0.02),
}


def truth(system):
    H = system.hamiltonian
    return H if isinstance(H, co.Polynomial) else getattr(H, "polynomial", None) or H.to_polynomial()


@cache
def identified(name, backward=False):
    system, degree, t, x = data(name, 4, backward)
    return system, degree, t, co.identify(system.algebra, t, x, degree, sign=system.sign)


@cache
def data(name, members=8, backward=False):
    make, degree, end, step = CASES[name]
    system = make()
    x0 = 0.7 * np.random.default_rng(11).standard_normal((members, system.dim))
    span = (end, 0.0) if backward else (0.0, end)
    sol = co.integrate(system, x0, span, step / 4, co.GaussLegendre(4), save_every=4)
    return system, degree, sol.t, sol.x


def found_coefficients(found):
    return np.array([float(found.hamiltonian.monomials.get(e, 0.0)) for e in found.exponents])


@pytest.mark.parametrize("backward", [False, True])
@pytest.mark.parametrize("name", CASES)
@pytest.mark.thinned(6)
def test_exact_trajectories_give_the_hamiltonian(name, backward):
    system, _, t, found = identified(name, backward)
    expected = found.coefficients_of(truth(system))
    # Integrals are accurate to 2e-15 of the largest test function, and the data to about 1e-12.
    np.testing.assert_allclose(found_coefficients(found), expected, rtol=0, atol=1e-8 * np.abs(expected).max())
    assert found.run_error < 1e-6 and found.solution.t[-1] == t[-1]
    assert found.undetermined == () and found.system.sign == system.sign


@pytest.mark.parametrize("name", CASES)
@pytest.mark.thinned(2)
def test_vector_fields_agree_although_casimirs_are_not_found(name):
    system, _, _, found = identified(name)
    states = np.random.default_rng(2).standard_normal((20, system.dim))
    for state in states:
        field = system.vector_field(state)
        np.testing.assert_allclose(found.system.vector_field(state), field, rtol=0, atol=1e-7 * np.abs(field).max())
    for casimir in system.casimirs.values():
        vector = np.array([float(casimir.monomials.get(e, 0.0)) for e in found.exponents])
        assert abs(vector @ found_coefficients(found)) < 1e-10, "least norm"
        assert vector @ found.covariance @ vector < 1e-12 * np.abs(found.covariance).max()
        assert not found.hamiltonian.monomials.get((0,) * system.dim), "no constant"


def squared_error(found, system):
    """Return the squared error of the coefficients in units of their covariance, and their number."""
    error = found_coefficients(found) - found.coefficients_of(truth(system))
    basis = np.linalg.qr(found.basis)[0]
    z, C = basis.T @ error, basis.T @ found.covariance @ basis
    return z @ np.linalg.solve(C, z), len(z)


def test_errors_have_the_stated_covariance():
    """Squared errors in units of the covariance are those of chi-squared: neither larger nor smaller."""
    total, count = 0.0, 0
    for name in CASES:
        system, degree, t, x = data(name)
        of_case, number = 0.0, 0
        for seed in range(2):
            noisy = x + SIGMA * np.random.default_rng(100 + seed).standard_normal(x.shape)
            found = co.identify(system.algebra, t, noisy, degree, sign=system.sign, radius=24)
            np.testing.assert_allclose(found.noise, SIGMA, rtol=0.3)
            square, unknowns = squared_error(found, system)
            of_case, number = of_case + square, number + unknowns
        # The noise is itself estimated, from about a thousand equations.
        assert chi2.ppf(1e-4, number) / 1.2 < of_case < 1.2 * chi2.ppf(1 - 1e-4, number), name
        total, count = total + of_case, count + number
    assert chi2.ppf(1e-4, count) / 1.05 < total < 1.05 * chi2.ppf(1 - 1e-4, count), total / count


def test_noise_of_each_component_is_found():
    system, degree, t, x = data("e(3)", 4)
    sizes = np.array([1e-3, 1e-3, 1e-3, 5e-3, 5e-3, 5e-3])
    noisy = x + sizes * np.random.default_rng(3).standard_normal(x.shape)
    found = co.identify(system.algebra, t, noisy, degree, sign=system.sign)
    np.testing.assert_allclose(found.noise, sizes, rtol=0.3)
    assert f"noise {found.noise.max():.2g}" in repr(found)


def test_covariance_scales_with_the_square_of_the_noise():
    system, degree, t, x = data("so(3)")
    errors = np.random.default_rng(3).standard_normal(x.shape)
    small, large = (co.identify(system.algebra, t, x + s * errors, degree, radius=24) for s in (1e-4, 1e-3))
    np.testing.assert_allclose(large.standard_deviation, 10 * small.standard_deviation, rtol=0.1)


def test_units_do_not_matter():
    """Scaled states and times give the scaled Hamiltonian: x = a y(t / b) is moved by H(y) scaled."""
    system, degree, t, x = data("so(3)")
    one = co.identify(system.algebra, t, x, degree, radius=16)
    far = co.identify(system.algebra, 1e3 * t, x * 1e-4, degree, radius=16)
    for exponents in one.exponents:
        factor = 1e-3 * (1e-4) ** (1 - sum(exponents))
        a, b = (float(found.hamiltonian.monomials.get(exponents, 0.0)) for found in (one, far))
        assert abs(b - factor * a) < 1e-8 * factor


def test_a_single_orbit_leaves_directions_undetermined():
    """On one sphere the function |x|^2 x_i equals r^2 x_i, and |x|^4 and |x|^2 are constant."""
    system = system_on(co.algebras.so(3), 1)
    sol = co.integrate(system, (0.6, -0.3, 0.8), (0, 60), 0.0125, co.GaussLegendre(4), save_every=4)
    t, x = sol.t, sol.x[:, None]
    found = co.identify(system.algebra, t, x, 3)
    assert len(found.undetermined) == 3 and "3 undetermined" in repr(found)
    states = np.random.default_rng(5).standard_normal((6, 3))
    states *= np.linalg.norm(x[0, 0]) / np.linalg.norm(states, axis=1)[:, None]
    for direction in found.undetermined:
        moved = co.LiePoissonSystem(system.algebra, direction)
        assert max(np.abs(moved.vector_field(state)).max() for state in states) < 1e-6
    for state in states:
        field = system.vector_field(state)
        np.testing.assert_allclose(found.system.vector_field(state), field, atol=1e-6 * np.abs(field).max())


def test_a_wrong_degree_shows_in_the_run():
    system, _, t, x = data("degree 3", 4)
    low, high = (co.identify(system.algebra, t, x, degree) for degree in (2, 3))
    assert low.run_error > 0.01 > 1e-6 > high.run_error
    assert low.standard_deviation.max() > 1e4 * high.standard_deviation.max()


def test_one_trajectory_is_a_member():
    system, degree, t, x = data("so(3)", members=1)
    plain, member = (co.identify(system.algebra, t, states, degree) for states in (x[:, 0], x))
    assert plain.hamiltonian == member.hamiltonian and plain.solution.x.shape == (len(t), 3)


SO3, T = co.algebras.so(3), np.linspace(0.0, 4.0, 41)
X = np.stack([np.cos(T), np.sin(T), 0.5 + 0 * T], axis=1)
REFUSED = {
    "algebra": (lambda: co.identify("so(3)", T, X), TypeError, "algebra is 'so.3.'.*LieAlgebra"),
    "shape": (lambda: co.identify(SO3, T, X[:, :2]), ValueError, r"shape \(41, 2\); it must be \(k, 3\)"),
    "times": (lambda: co.identify(SO3, T[:-1], X), ValueError, "a time for each sample"),
    "unequal": (lambda: co.identify(SO3, T**2, X), ValueError, "steps from .* must be equal"),
    "nearly equal": (
        lambda: co.identify(SO3, np.linspace(0, 8, 41) + 3e-7 * (np.arange(41) == 9), X),
        ValueError,
        r"steps from 0\.1999997 to 0\.2000003; they",
    ),
    "equal times": (lambda: co.identify(SO3, 0 * T, X), ValueError, "must be equal"),
    "not finite": (lambda: co.identify(SO3, T, np.where(X > 0.99, np.nan, X)), ValueError, "not finite"),
    "few": (lambda: co.identify(SO3, T[:16], X[:16]), ValueError, "16 samples .* at least 17"),
    "zero": (lambda: co.identify(SO3, T, 0 * X), ValueError, "zero everywhere"),
    "degree": (lambda: co.identify(SO3, T, X, 0), ValueError, "degree"),
    "unknowns": (lambda: co.identify(SO3, T[:17], X[:17], 4), ValueError, "fewer equations than there are unknowns"),
    "radius": (lambda: co.identify(SO3, T, X, radius=21), ValueError, "radius"),
    "sign": (lambda: co.identify(SO3, T, X, sign=2), ValueError, "sign is 2"),
    "memory": (lambda: co.identify(SO3, T, X, 5000), ValueError, "needs about .* GB"),
    "abelian": (lambda: co.identify(co.LieAlgebra.from_brackets(3, {}), T, X), ValueError, "do not move"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_data_that_are_refused(case):
    make, kind, message = REFUSED[case]
    with pytest.raises(kind, match=message):
        make()


def test_polynomials_beyond_the_degree_are_refused():
    found = co.identify(SO3, *data("so(3)")[2:], 2)
    with refused(ValueError, "beyond the degree"):
        found.coefficients_of(co.Polynomial({(3, 0, 0): 1.0}))

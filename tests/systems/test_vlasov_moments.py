"""Moments of Vlasov-Poisson: against clouds of particles, 40 digits, brackets by hand, and polynomial identities."""

import json
from pathlib import Path

import numpy as np
import pytest
from two_steps import assert_bounded_by_order, assert_order

import coadjoint as co
from coadjoint.algebra.families.phase_space import moments, powers_of
from coadjoint.algebra.polynomials.exact_polynomials import ExactPolynomials
from coadjoint.algebra.representation import check_representation
from moments import moments as moments_by_brackets

vlasov_moments = co.systems.vlasov_moments
REFERENCES = Path(__file__).parents[1] / "verification" / "references" / "lie_poisson_systems.json"
BEAM = next(s for s in json.loads(REFERENCES.read_text())["systems"] if s["name"] == "moments_2")


def cloud(seed, count=40):
    """Particles symmetric about the origin, of small weight."""
    q, p = np.random.default_rng(seed).standard_normal((2, count))
    return np.concatenate([q, -q]), np.concatenate([p, -p])


def moments_of(q, p, degree):
    return np.array([np.mean(q**i * p**j) for i, j in powers_of(degree)])


@pytest.mark.parametrize("degree", [2, 4, 6, 8])
def test_algebra(degree):
    g, powers = moments(degree), powers_of(degree)
    triples = list(zip(*(column.tolist() for column in g.triples), strict=True))
    co.LieAlgebra(triples, dim=g.dim)  # antisymmetry and the Jacobi identity
    for a, b, k, c in triples:
        (i, j), (m, n) = powers[a], powers[b]
        assert powers[k] == (i + m - 1, j + n - 1) and c == i * n - j * m
    ring = ExactPolynomials(g)
    for casimir in g.casimirs_known.values():
        assert all(ring.bracket(ring.from_polynomial(casimir), x) == ring.zero for x in ring.coordinates)


@pytest.mark.parametrize("degree", [2, 8, 10, 12])
def test_moments_are_named_by_their_powers(degree):
    """With a comma where a power has two digits."""
    names, powers = moments(degree).basis, powers_of(degree)
    assert names == tuple(f"x{i},{j}" if i > 9 or j > 9 else f"x{i}{j}" for i, j in powers)
    assert len(set(names)) == len(names) == degree // 2 * (degree // 2 + 2)
    assert moments(degree).name == f"moments({degree})"
    assert list(moments(degree).casimirs_known) == (
        ["emittance^2"] if degree == 2 else [f"(form, form)_{degree}"] + ["catalecticant"] * (degree <= 10)
    )


def test_algebra_of_degree_4_and_2():
    assert moments(4) == moments_by_brackets()
    assert moments(4).generic_rank() == 6
    x = dict(zip(moments(4).basis, np.random.default_rng(0).standard_normal(8), strict=True))
    form, determinant = moments(4).casimirs_known.values()
    catalecticant = [["x40", "x31", "x22"], ["x31", "x22", "x13"], ["x22", "x13", "x04"]]
    values = list(x.values())
    assert form(values) == pytest.approx(x["x40"] * x["x04"] - 4 * x["x31"] * x["x13"] + 3 * x["x22"] ** 2, rel=1e-14)
    wanted = np.linalg.det([[x[name] for name in row] for row in catalecticant])
    assert determinant(values) == pytest.approx(wanted, rel=1e-12)
    g = moments(2)
    check_representation(g.representation, g.triples, 3, g.basis)
    assert g.casimirs_known["emittance^2"] == co.Polynomial({(1, 0, 1): 1, (0, 2, 0): -1})


@pytest.mark.parametrize("degree", [2, 4, 6])
def test_moments_move_as_the_particles_do(degree):
    """d<q^i p^j>/dt = <i q^(i-1) p^(j+1) - j q^i p^(j-1) W'(q)>, where no moment above the degree comes in."""
    q, p = cloud(degree)
    coefficients = np.random.default_rng(1).standard_normal(degree // 2)
    text = " + ".join(f"{c!r}*x{2 * k}0" for k, c in enumerate(coefficients.tolist(), 1)).replace("+ -", "- ")
    system = vlasov_moments(degree, text)
    force = -sum(2 * k * c * q ** (2 * k - 1) for k, c in enumerate(coefficients, 1))
    field = system.vector_field(moments_of(q, p, degree))
    for k, (i, j) in enumerate(powers_of(degree)):
        if i + j == 2:
            rate = np.mean(i * q ** max(i - 1, 0) * p ** (j + 1) + j * q**i * p ** max(j - 1, 0) * force)
            assert field[k] == pytest.approx(rate, rel=1e-12)
    energy = np.mean(p**2 / 2 + sum(c * q ** (2 * k) for k, c in enumerate(coefficients, 1)))
    assert system.energy(moments_of(q, p, degree)) == pytest.approx(energy, rel=1e-13)


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
    assert system.sign == 1 and system.integrals == {} and system.closed_form is None


@pytest.mark.parametrize("stiffness", [2.25, 0.0, -0.64])
@pytest.mark.parametrize("degree", [2, 4, 6])
def test_exact_is_a_cloud_of_oscillators(degree, stiffness):
    q, p = cloud(7)
    t = 1.3
    if stiffness > 0:
        c, s = np.cos(1.5 * t), np.sin(1.5 * t) / 1.5
    elif stiffness < 0:
        c, s = np.cosh(0.8 * t), np.sinh(0.8 * t) / 0.8
    else:
        c, s = 1.0, t
    later = moments_of(c * q + s * p, c * p - stiffness * s * q, degree)
    system, x0 = vlasov_moments(degree, f"{stiffness / 2}*x20"), moments_of(q, p, degree)
    np.testing.assert_allclose(system.exact(x0, t), later, rtol=1e-12)
    np.testing.assert_array_equal(system.exact(x0, [0.0, t]), [x0, system.exact(x0, t)])
    if stiffness:
        for method in (co.Splitting(order=2), co.Splitting(order=4), co.GaussLegendre(stages=2)):
            assert_order(system, x0, t, 0.065, method, later)


def test_reference_in_40_digits():
    system = vlasov_moments(2, "1/2*x20 + 0.1*x20^2")
    x0 = np.array([1.0, 0.2, 0.5])
    for late in BEAM["states"]:
        if late["t"] <= 5:
            wanted = np.array([float(v) for v in late["x"]])
            for method in (co.Splitting(order=2), co.Splitting(order=4), co.GaussLegendre(stages=2)):
                assert_order(system, x0, float(late["t"]), 0.1, method, wanted)


@pytest.mark.parametrize("degree", [4, 6, 8])
def test_integrals_by_polynomial_identity(degree):
    text = "1/2*x20 + 3/4*x40" + (" - 1/8*x60" if degree > 4 else "")
    system = vlasov_moments(degree, text)
    assert list(system.integrals) == [f"<h^{m}>" for m in range(2, degree // 2 + 1)]
    ring = ExactPolynomials(system.algebra)
    H = ring.from_polynomial(system.hamiltonian.to_polynomial())
    for F in system.integrals.values():
        assert ring.bracket(ring.from_polynomial(F.to_polynomial()), H) == ring.zero
    q, p = cloud(0)
    if degree == 4:
        harmonic = vlasov_moments(4, "0.5*x20").integrals["<h^2>"]
        assert harmonic.value(moments_of(q, p, 4)) == pytest.approx(np.mean((p**2 + q**2) ** 2 / 4), rel=1e-13)
    x0 = 0.5 * moments_of(q, p, degree)
    assert_bounded_by_order(system.integrals["<h^2>"].value, system, x0, 1.0, 0.02, co.Splitting())


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


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"degree": 10, "potential": "x22"}, "the moments of q are x20, x40, x60, x80, x100$"),
        ({"degree": 12, "potential": "x22"}, "the moments of q are x20, x40, ..., x120$"),
        ({"degree": 12, "potential": "x140"}, "potential has 'x140'; the moments of q are x20, x40, ..., x120"),
        ({"potential": "0*x20+" * 2000 + "x20"}, "potential has 12003 characters; give at most 10000"),
        ({"potential": "sin(x20)"}, "potential: "),
    ],
)
def test_wrong_values(given, message):
    with pytest.raises((ValueError, TypeError), match=message):
        vlasov_moments(**given)

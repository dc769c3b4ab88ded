"""Casimir shifts of sums of algebras: each factor by its own Casimir, whatever the coefficients of the Casimirs."""

import numpy as np
import pytest

import coadjoint as co
from coadjoint.program.parts.decompose import decompose
from coadjoint.program.parts.split import split
from coadjoint.program.shifts.shift import candidate_shifts, quadratic_casimirs, shifted_terms

# Algebras with a nondegenerate quadratic Casimir x.A x/2, diagonal in the basis, up to a factor.
FACTORS = {
    "so(3)": (co.algebras.so(3), [1.0, 1.0, 1.0]),
    "so(2,1)": (
        co.LieAlgebra.from_brackets(3, {(0, 1): {2: -1.0}, (1, 2): {0: 1.0}, (0, 2): {1: -1.0}}),
        [1.0, 1.0, -1.0],
    ),
    "so(4)": (co.algebras.so(4), [1.0] * 6),
}


def drawn(names, seed):
    """Return a sum of the algebras with Casimirs of random coefficients, and the diagonals A (factors, n)."""
    rng, parts = np.random.default_rng(seed), [FACTORS[name] for name in names]
    algebra = co.algebras.direct_sum(*(algebra for algebra, _ in parts)) if len(parts) > 1 else parts[0][0]
    edges = np.cumsum([0, *(len(form) for _, form in parts)])
    A = np.zeros((len(parts), algebra.dim))
    for k, (_, form) in enumerate(parts):
        A[k, edges[k] : edges[k + 1]] = np.array(form) * rng.choice([-1.0, 1.0]) * rng.uniform(0.2, 5.0)
    casimirs = {
        f"C{k}": co.Polynomial({tuple(2 * (i == j) for j in range(algebra.dim)): a / 2 for i, a in enumerate(row) if a})
        for k, row in enumerate(A)
    }
    return rng, algebra, casimirs, A, edges


SUMS = [
    ("so(3)",),
    ("so(4)",),
    ("so(3)", "so(3)"),
    ("so(3)", "so(2,1)"),
    ("so(2,1)", "so(4)"),
    ("so(3)", "so(2,1)", "so(4)"),
    ("so(2,1)", "so(3)", "so(3)", "so(2,1)", "so(3)"),
]


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("names", SUMS, ids=" + ".join)
def test_a_sum_of_symmetric_bodies_is_one_exact_flow(names, seed):
    """H = sum_f c_f C_f + m_f x_i^2/2 turns each factor about its axis i, and nothing else."""
    rng, algebra, casimirs, A, edges = drawn(names, seed)
    factor = rng.choice([-1.0, 1.0], len(names)) * rng.uniform(0.3, 3.0, len(names))
    axes = edges[:-1] + 2
    M = factor @ A
    M[axes] += rng.uniform(0.5, 2.0, len(names))
    system = co.LiePoissonSystem(algebra, co.Quadratic(M), casimirs=casimirs)
    found = decompose(system, "auto")
    assert len(split(system)) > len(found.parts) == 1
    assert found.parts.forms.coordinate.tolist() == axes.tolist()
    assert dict(found.choice.shift) == pytest.approx({f"C{k}": c for k, c in enumerate(factor)}, rel=4 * 2.0**-53)
    # One step of any length is the motion.
    x = rng.normal(size=algebra.dim) / 2
    exact = co.integrate(system, x, (0.0, 1.0), 1 / 16, co.GaussLegendre(6), watch=False).x[-1]
    np.testing.assert_allclose(co.stepper(system, co.Splitting(order=2), 1.0)(x), exact, rtol=0, atol=1e-11)


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("names", SUMS, ids=" + ".join)
def test_shifts_take_a_coordinate_of_every_factor_off_each_part(names, seed):
    """Up to four Casimirs are also tried one by one, for every coordinate."""
    rng, algebra, casimirs, A, _ = drawn(names, seed)
    M = rng.choice([-1.0, 1.0], algebra.dim) * rng.uniform(0.3, 3.0, algebra.dim)
    system = co.LiePoissonSystem(algebra, co.Quadratic(M), casimirs=casimirs)
    known, parts = quadratic_casimirs(system), split(system)
    shifts = list(candidate_shifts(system, parts, known))
    factors = np.array([[dict(shift).get(f"C{k}", 0.0) for k in range(len(names))] for shift in shifts])
    left = M - factors @ A
    gone = np.abs(left) <= 4 * 2.0**-53 * np.abs(M)
    home = np.argmax(A != 0.0, axis=0)
    for p in range(len(parts)):
        rows = parts.forms
        own = np.unique(rows.coordinate[slice(*rows.start[parts.angle[[p, p + 1]]])])
        assert any({*home[own].tolist()} == {*home[own[row[own]]].tolist()} for row in gone)
    if len(names) <= 4:
        alone = np.count_nonzero(factors, axis=1) == 1
        assert np.all(np.any(gone[alone], axis=0))
    for shift, row, zero in zip(shifts, left, gone, strict=True):
        (term,) = (one.form for one in shifted_terms(system.hamiltonian.terms(), known, shift))
        assert term.rows.tolist() == term.indices.tolist() == np.flatnonzero(~zero).tolist()
        np.testing.assert_allclose(term.values, row[~zero], rtol=0, atol=4 * 2.0**-53 * np.abs(M).max())

"""Random algebras, Hamiltonians, signs and splittings: a step is the flow of the modified Hamiltonian."""

import mpmath
import numpy as np
import pytest

import coadjoint as co
from digests.explicit_systems import extrapolated
from long import long_beyond
from random_runs.algebras import some_algebra
from random_runs.hamiltonians import matrix, polynomial

LARGEST = 6
MAX_MONOMIALS = 200
SEEDS = 24


def some_scheme(rng):
    """Return a splitting of order 1, 2 or 4, or a composition."""
    parts = ("auto", "coordinates")[rng.integers(2)]
    rotation = ("exact", "rational")[rng.integers(2)]
    kind = rng.integers(4)
    if kind == 0:
        return co.Splitting(order=1, adjoint=bool(rng.integers(2)), parts=parts, rotation=rotation)
    if kind == 3:
        base = co.Splitting(order=2, parts=parts, rotation=rotation)
        return co.Composition(base, ((0.5, 0.5), (0.75, -0.25, 0.5))[rng.integers(2)])
    return co.Splitting(order=2 * int(kind), parts=parts, rotation=rotation)


def case_of(seed, largest=LARGEST, highest=4):
    """Return system, scheme, modified Hamiltonian with two terms, and a state of size one."""
    rng = np.random.default_rng([8, seed])
    while True:
        algebra, sign, scheme = some_algebra(rng), (1, -1)[seed % 2], some_scheme(rng)
        if algebra.dim > largest or scheme.order > highest:
            continue
        n = algebra.dim
        H = polynomial(rng, n) if rng.random() < 0.5 else co.Quadratic(matrix(rng, n), linear=rng.standard_normal(n))
        try:
            system = co.LiePoissonSystem(algebra, H, sign=sign)
            modified = co.modified_hamiltonian(system, scheme, scheme.order + 2)
        except ValueError:
            continue  # refused by name, as the tests of refusals see: a piece that no flow is known for
        if sum(len(term.monomials) for term in modified.terms.values()) <= MAX_MONOMIALS:
            return system, scheme, modified, rng.uniform(-1.0, 1.0, n)


def field_of(system, modified, x, h):
    """Return sign J grad H~ in any number type, from the structure constants."""
    slope = modified.gradient(x, h)
    found = [0 * x[0]] * system.dim
    for i, j, k, c in zip(*(np.asarray(column).tolist() for column in system.algebra.triples), strict=True):
        found[i] = found[i] + system.sign * c * (x[k] * slope[j])
        found[j] = found[j] - system.sign * c * (x[k] * slope[i])
    return np.array(found, dtype=object)


@pytest.mark.parametrize("seed", long_beyond(2, range(SEEDS)))
def test_step_is_the_flow_of_the_modified_hamiltonian(seed):
    system, scheme, modified, x0 = case_of(seed)
    size = max(1.0, float(np.max(np.abs(system.jacobian(x0)))), float(np.max(np.abs(system.vector_field(x0)))))
    for direction in (1, -1):
        errors = []
        with mpmath.workdps(40):
            x = np.array([mpmath.mpf(v) for v in x0], dtype=object)
            for k in (9, 10):
                h = direction * mpmath.mpf(2) ** -k / mpmath.mpf(size)
                end, _ = extrapolated(lambda y, h=h: field_of(system, modified, y, h), x, h)
                errors.append(max(abs(end - scheme.step(system, x, mpmath.mpf(0), h))))
        # Coefficients of irrational schemes, of completed squares and of their roots are rounded to float64.
        if errors[1] > 2.0**-50 * 2.0**-10:
            slope = float(mpmath.log(errors[0] / errors[1], 2))
            assert slope > modified.order + 0.6, (str(scheme), repr(system), slope, errors)

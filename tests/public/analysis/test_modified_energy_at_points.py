"""Modified Hamiltonians of Hamiltonians with functions of Python, point by point."""

from __future__ import annotations

import numpy as np
import pytest

import coadjoint as co

WELL = (lambda y: 0.5 * y * y + 0.1 * y**4, lambda y: y + 0.4 * y**3, lambda y: 1 + 1.2 * y * y)


@pytest.mark.thinned(3)
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("order", [2, 3, 4, 5, 6])
def test_a_polynomial_as_functions_is_the_polynomial(order, sign):
    """Two ways to one number: brackets of polynomials, and of Taylor polynomials at the point."""
    units = np.eye(3, dtype=int)
    quartic = {tuple(2 * row): 0.5 for row in units.tolist() for row in [np.array(row)]}
    quartic |= {tuple(4 * np.array(row)): 0.1 for row in units.tolist()}
    quartic = {tuple(int(e) for e in key): value for key, value in quartic.items()}
    algebra = co.algebras.A3_7(1.5)
    functions = co.LiePoissonSystem(algebra, co.Separable(dict.fromkeys(range(3), WELL)), sign=sign)
    plain = co.LiePoissonSystem(algebra, co.Polynomial(quartic), sign=sign)
    x = np.array([[0.3, 0.5, -0.7], [1.0, -0.2, 0.4]])
    for method in (co.Splitting(order=1, parts="coordinates"), co.Splitting(order=4, parts="coordinates")):
        of_plain = co.modified_hamiltonian(plain, method, order)
        of_functions = co.modified_hamiltonian(functions, method, order)
        for h in (0.5, -0.5):
            expected = of_plain(x, h)
            assert of_functions(x, h) == pytest.approx(expected, rel=1e-9)
            assert order < 3 or method.order > 1 or not np.allclose(expected, plain.energy(x[0]))
        assert order < 3 or method.order > 1 or not np.allclose(of_plain(x, 0.5), of_plain(x, -0.5), rtol=1e-6)

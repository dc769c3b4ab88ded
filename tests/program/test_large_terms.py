"""Parts are chosen where terms leave float64 too, without a warning."""

import numpy as np
import pytest

import coadjoint as co


@pytest.mark.parametrize("size", [1e150, 1e300])
def test_terms_that_leave_float64_are_the_largest(size):
    top = co.LiePoissonSystem(
        co.algebras.e(3), co.Quadratic(np.diag([1, 5, 2, 0, 0, 0]), linear=[size, 0, 0, 0, 0, 1.5])
    )
    assert co.Splitting(order=4).describe(top)
    body = co.systems.paper_a37(masses=(1.0, size / 1e10, 0.01))
    assert co.Splitting().describe(body)

"""Which group elements a scheme refuses to carry."""

from __future__ import annotations

import numpy as np
import pytest

import coadjoint as co
from coadjoint.methods.protocol.attitude import check_attitude

GAUSS = (co.GaussLegendre(2), co.ModifiedGaussLegendre(1, freeze="gradient"))


def system(algebra):
    return co.LiePoissonSystem(algebra, co.Quadratic(np.linspace(1.0, 2.0, algebra.dim)))


@pytest.mark.parametrize("method", GAUSS, ids=repr)
def test_gauss_accepts_a_turned_copy_of_the_coadjoint_matrices_with_more_rows(method):
    """The sum of the coadjoint and the trivial representation, in another basis: T is found, not guessed."""
    so4 = co.algebras.so(4)
    D = np.zeros((6, 7, 7))
    D[:, :6, :6] = [so4.coadjoint(e) for e in np.eye(6)]
    turn = np.eye(7) + np.triu(np.full((7, 7), 0.5), 1)
    check_attitude(method, system(so4), np.linalg.inv(turn) @ D @ turn)


@pytest.mark.parametrize("method", GAUSS, ids=repr)
@pytest.mark.parametrize(
    ("algebra", "said"),
    [
        (co.algebras.so(4), "spatial momentum"),
        (co.algebras.so(5), "spatial momentum"),
        (co.algebras.sl(2), "spatial momentum"),
        (co.algebras.e(3), "leave the group"),
        (co.algebras.A3_7(2.0), "leave the group"),
    ],
    ids=repr,
)
def test_gauss_refuses_what_it_would_lose(method, algebra, said):
    with pytest.raises(ValueError, match=said):
        check_attitude(method, system(algebra), algebra.representation)


def test_no_algebra_no_group():
    J = co.PoissonSystem(lambda x: x[0] * np.array([[0.0, 1.0], [-1.0, 0.0]]), co.Quadratic([1.0, 2.0]))
    with pytest.raises(ValueError, match="has no Lie algebra and so no group element"):
        check_attitude(co.GaussLegendre(2), J, "coadjoint")

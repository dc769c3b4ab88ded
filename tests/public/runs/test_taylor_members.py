"""Ensembles of Taylor series: each member has the bits that it has alone, whatever becomes of its neighbours."""

import numpy as np
import pytest

import coadjoint as co
from drawn_matrices import full
from energies import polynomial

pytestmark = pytest.mark.thinned(6)

MEMBERS = 21  # two registers of eight and five alone, or five of four and one


def system_on(name, degree):
    """Return a system with a quadratic energy with a full matrix, or one of higher degree."""
    algebra = co.algebras.get(name)
    n = algebra.dim
    H = polynomial(n, degree, n) if degree > 2 else co.Quadratic(full(n, n), linear=np.linspace(-0.4, 0.4, n))
    return co.LiePoissonSystem(algebra, H, sign=-1)


def states(system, count=MEMBERS):
    x = np.random.default_rng(system.dim).normal(size=(count, system.dim))
    x *= 0.8 / np.linalg.norm(x, axis=1, keepdims=True)
    x[1, 0], x[2] = -0.0, 0.0  # zeros keep their signs, and a member may rest
    return x


def followed(*given, **options):
    """Return a run, or what there is of one in which a member fails."""
    try:
        return co.integrate(*given, **options)
    except co.IntegrationError as error:
        return error.partial


@pytest.mark.parametrize("name", ["so(3)", "A5,3", "so(5)"])
@pytest.mark.parametrize("degree", [2, 3])
def test_nothing_is_left_of_members_that_overflow(name, degree):
    """Rows of 3 to 10 coordinates end within a register; what overflows in one member must not stay behind them."""
    system = system_on(name, degree)
    x = 0.5 * states(system, 70)
    sizes = 10.0 ** np.linspace(2.0, 160.0, 35)
    x[::2] *= sizes[:, None]
    run, again = (followed(system, x, (0, 1), 0.0625, co.Taylor(8), watch=False) for _ in range(2))
    assert again.x.tobytes() == run.x.tobytes()
    for m in range(70):
        alone = followed(system, x[m], (0, 1), 0.0625, co.Taylor(8), watch=False).x
        assert np.array_equal(run.x[: len(alone), m], alone), m
        assert run.failed[m] == (len(alone) < len(run.x)) and not np.isfinite(run.x[len(alone) :, m]).any()
    assert run.failed[::2].sum() > 20 and not run.failed[1::2].all()

"""Ensembles of Taylor series: each member has the bits that it has alone, whatever becomes of its neighbours."""

import numpy as np
import pytest

import coadjoint as co
from energies import polynomial

pytestmark = pytest.mark.thinned(6)

# Where few coordinates act on the others, products are factored.
A = np.random.default_rng(7).integers(-3, 4, (5, 5)) / 4
ALGEBRAS = {name: co.algebras.get(name) for name in ("so(3)", "gl(2)", "A5,3", "e(3)", "su(3)", "so(5)")} | {
    "A3,7": co.algebras.A3_7(0.7),
    "2 on 5": co.LieAlgebra.from_brackets(
        7, {(5 + k, i): dict(enumerate(B[:, i])) for k, B in enumerate((A, A @ A)) for i in range(5)}
    ),
    "4 spins": co.algebras.copies(co.algebras.so(3), 4),
}
MEMBERS = 21  # two registers of eight and five alone, or five of four and one


def system_on(name, degree, sign=1):
    """Return a system with an energy of the degree; of degree 1 linear, and of degree 2 with a full matrix."""
    algebra = ALGEBRAS[name]
    n, rng = algebra.dim, np.random.default_rng([algebra.dim, degree])
    if degree > 2:
        return co.LiePoissonSystem(algebra, polynomial(n, degree, rng), sign=sign)
    B = rng.uniform(-0.3, 0.3, (n, n))
    M = (np.diag(np.linspace(0.6, 1.4, n)) + B + B.T) * (degree == 2)
    return co.LiePoissonSystem(algebra, co.Quadratic(M, linear=rng.uniform(-0.4, 0.4, n)), sign=sign)


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


@pytest.mark.thinned(24)
@pytest.mark.parametrize("name", ALGEBRAS)
@pytest.mark.parametrize("degree", [1, 2, 3, 4])
@pytest.mark.parametrize("projected", [True, False])
def test_members_have_the_bits_that_they_have_alone(name, degree, projected):
    for seed, order in enumerate((2, 5, 9, 16)):
        system = system_on(name, degree, (-1) ** seed)
        x = states(system)
        method, span = co.Taylor(order, projected), (0.0, 3.0 if seed < 2 else -3.0)
        run = followed(system, x, span, 0.25, method)
        shuffled = followed(system, x[::-1], span, 0.25, method, save_every=5, threads=2)
        assert shuffled.x[-1][::-1].tobytes() == run.x[-1].tobytes()
        for m in range(0, MEMBERS, 5):
            alone = followed(system, x[m], span, 0.25, method)
            kept = len(alone.x)
            assert run.failed[m] == (kept < len(run.x))
            assert alone.x.tobytes() == np.ascontiguousarray(run.x[:kept, m]).tobytes(), (m, order)
            assert np.array_equal(alone.energy, run.energy[:kept, m], equal_nan=True)


@pytest.mark.parametrize("name", ["so(3)", "e(3)", "su(3)", "A5,3"])
@pytest.mark.parametrize("degree", [2, 3])
@pytest.mark.parametrize("projected", [True, False])
def test_members_that_fail_leave_the_others_alone(name, degree, projected):
    """One that overflows at once and two that fail on the way; the others have their bits, and each says its step."""
    system = system_on(name, degree, -1)
    x = 0.5 * states(system)
    sound = followed(system, x, (0, 10), 0.25, co.Taylor(10, projected))
    wild = x.copy()
    wild[3] *= 1e200
    wild[8], wild[13] = x[4] * 80.0, x[5] * 180.0
    run = followed(system, wild, (0, 10), 0.25, co.Taylor(10, projected))
    assert run.failed[3]
    for m in range(MEMBERS):
        if m not in (3, 8, 13):
            assert run.failed[m] == sound.failed[m]
            assert np.array_equal(run.x[:, m], sound.x[:, m], equal_nan=True)
            continue
        alone = followed(system, wild[m], (0, 10), 0.25, co.Taylor(10, projected)).x
        assert run.failed[m] == (len(alone) < len(run.x))
        assert np.array_equal(run.x[: len(alone), m], alone)


@pytest.mark.parametrize("name", ["so(3)", "A5,3", "so(5)"])
@pytest.mark.parametrize("degree", [2, 3])
def test_nothing_is_left_of_members_that_overflow(name, degree):
    """Rows of 3 to 10 coordinates end within a register; what overflows in one member must not stay behind them."""
    system = system_on(name, degree, -1)
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

"""Members are computed several at a time: each has the bits that it has alone, whatever their number and size."""

import numpy as np
import pytest

import coadjoint as co
from matrix.results import assert_agree, attempted, numbers

pytestmark = pytest.mark.filterwarnings("ignore::coadjoint.LargeStepWarning")
TOP = co.systems.heavy_top()
X = np.array([1.0, -0.5, 1.5, 0.6, 0.0, 0.8])
MAGNITUDES = np.array(
    [1.0, 1e-300, 30.0, 1e3, 1e-8, 3.0, 1e4, 0.0, 1e6, 100.0, 1e-3, 10.0, 1e5, 300.0, 3e3, 1e-160, 0.3]
)
METHODS = [
    co.Splitting(order=2),
    co.Splitting(order=4, compensated=True),
    co.Splitting(order=2, rotation="rational"),
    co.Splitting(scheme="blanes_casas_murua6"),
    co.GaussLegendre(2),
    co.ModifiedGaussLegendre(2, freeze="gradient"),
    co.RadauEnergy(2),
    *map(co.Taylor, (2, 6)),
    co.Taylor(tolerance=1e-9),
    co.ReversibleSteps(co.GaussLegendre(2)),
]


@pytest.mark.parametrize("members", [2, 3, 4, 31, 32, 33, 67])
@pytest.mark.parametrize("method", METHODS[:6], ids=str)
def test_ensembles_of_any_number_of_members(method, members):
    states = X * (1.0 - 0.9 * np.arange(members)[:, None] / members)
    attitude = method.properties(TOP).attitude != "none" and "coadjoint"
    given = (0.0, 1.0), 0.0625, method
    together = co.integrate(TOP, states, *given, save_every=8, attitude=attitude)
    for m in {0, members // 2, members - 1}:
        assert_agree(
            numbers(together, m), numbers(co.integrate(TOP, states[m], *given, save_every=8, attitude=attitude))
        )


@pytest.mark.parametrize("method", METHODS, ids=str)
@pytest.mark.parametrize("g", [co.algebras.so(3), co.algebras.e(3), co.algebras.so(4)], ids=lambda g: g.name)
def test_members_of_every_magnitude(method, g):
    """Iterations end at round-off, by Newton's method, at their limit or fail, whatever the neighbours do."""
    rng = np.random.default_rng(5)
    B = rng.standard_normal((g.dim, g.dim))
    system = co.LiePoissonSystem(g, co.Quadratic(np.eye(g.dim) + (B + B.T) / (2 * np.sqrt(g.dim))))
    try:
        co.prepare(system, method, 0.3)
    except ValueError:  # the scheme does not serve the system
        return
    x0 = MAGNITUDES[:, None] * rng.standard_normal((len(MAGNITUDES), g.dim))
    x0 = x0[: 8 if method.own_steps else None]
    x0 = x0[np.abs(x0).max(axis=1) < (10 if method.own_steps else np.inf)]
    whole = attempted(system, x0, (0.0, 1.8), 0.3, method, threads=1)
    assert np.isfinite(whole.x[-1]).any()
    for part in (slice(None, None, -1), slice(0, 3), slice(0, 4)):
        other = attempted(system, x0[part], (0.0, 1.8), 0.3, method, threads=1)
        np.testing.assert_array_equal(other.x, whole.x[:, part])
    for m in range(len(x0)):
        assert_agree(
            numbers(attempted(system, x0[m], (0.0, 1.8), 0.3, method), followed=False),
            numbers(whole, m, followed=False),
        )

"""Large steps: group elements and compensated momenta stay at round-off for any angle."""

import numpy as np
import pytest

import coadjoint as co
from rounding import UNIT_ROUNDOFF as U

pytestmark = pytest.mark.thinned(3)

STEPS = 1000
ELLIPTIC = (1.0, 0.0, -1.0)


def systems():
    rng = np.random.default_rng(353)
    so3 = co.algebras.so(3)
    return {
        "one axis": co.LiePoissonSystem(so3, co.Quadratic([0.0, 0.0, 1.0])),
        "a body": co.LiePoissonSystem(so3, co.Quadratic([0.125, 0.0656, 1.2877]), -1),
        "so(4)": co.LiePoissonSystem(co.algebras.so(4), co.Quadratic(rng.uniform(0.5, 2, 6))),
        "su(3)": co.LiePoissonSystem(co.algebras.su(3), co.Quadratic(rng.uniform(0.5, 2, 8)), -1),
        # Two shears, up to a length of 2 a periodic map as well.
        "shears": co.LiePoissonSystem(co.algebras.sl(2), co.Quadratic(np.zeros(3), linear=ELLIPTIC)),
    }


@pytest.mark.thinned(6)
@pytest.mark.parametrize("sense", [1, -1])
@pytest.mark.parametrize("h", [0.3, 0.9, 1.2, 1.7, 3.1])
@pytest.mark.parametrize("name", list(systems()))
def test_large_steps_grow_only_round_off(name, h, sense):
    """Alone and in an ensemble; one rounding for each flow and step."""
    if name == "shears" and h > 2.0:
        pytest.skip("two shears are hyperbolic at this step")
    system = systems()[name]
    states = np.random.default_rng(4).standard_normal((9, system.dim))
    span, scheme = (0.0, sense * STEPS * h), co.Splitting(parts="coordinates", compensated=True)
    ensemble = co.integrate(system, states, span, h, scheme, attitude="coadjoint", save_every=STEPS)
    K, x = ensemble.attitude, ensemble.x
    spatial = np.einsum("kmij,kmj->kmi", K, x)
    size = np.linalg.norm(K[-1], axis=(1, 2)) * np.linalg.norm(x[-1], axis=1)
    bound = STEPS * (2 * system.dim + 2) * U
    assert np.max(np.linalg.norm(spatial[-1] - spatial[0], axis=1) / size) < bound
    for name_of, values in ensemble.casimirs.items():
        casimir = system.casimirs[name_of]
        for m in range(len(states)):
            scale = max(np.linalg.norm(casimir.gradient(state)) * np.linalg.norm(state) for state in x[:, m])
            assert abs(values[-1, m] - values[0, m]) < bound * scale
    alone = co.integrate(system, states[3], span, h, scheme, attitude="coadjoint", save_every=STEPS)
    assert np.array_equal(alone.attitude, K[:, 3]) and np.array_equal(alone.x, x[:, 3])


def processed_runs():
    """Runs at steps that are far too large: outputs of the processor overflow, and the kernel of the scheme goes on."""
    g, rng = co.algebras.get("A4,8"), np.random.default_rng(0)
    B = rng.standard_normal((g.dim, g.dim))
    system = co.LiePoissonSystem(g, co.Quadratic((B + B.T) / 4 + np.eye(g.dim)))
    x0 = rng.standard_normal((200, g.dim)) * np.geomspace(1.0, 60.0, 200)[:, None]
    return system, x0, (0.0, 1.2), 0.1, co.Splitting(scheme="blanes_casas_murua10")


@pytest.mark.filterwarnings("ignore::coadjoint.LargeStepWarning")
@pytest.mark.parametrize("attitude", [False, "coadjoint"])
@pytest.mark.parametrize("members", [200, 13])
def test_outputs_that_overflow_are_left_out(attitude, members):
    """Whether a state is saved or watched changes no other one."""
    system, x0, *given = processed_runs()
    x0 = x0[:: 200 // members]

    def run(start=x0, **options):
        try:
            return co.integrate(system, start, *given, attitude=attitude, threads=1, **options)
        except co.IntegrationError as error:
            return error.partial

    whole = run(watch=False)
    lost = ~np.isfinite(whole.x).all(axis=2)
    returns = (lost[:-1] & ~lost[1:]).any(axis=0)
    assert returns.any() or members < 200, "no output overflows alone"
    assert (lost == np.isnan(whole.x).any(axis=2)).all() and (lost == np.isnan(whole.energy)).all()
    assert (whole.failed == lost.any(axis=0)).all()
    watched = run(watch=True)
    np.testing.assert_array_equal(watched.x, whole.x)
    np.testing.assert_array_equal(watched.failed, whole.failed)
    if attitude:
        np.testing.assert_array_equal(watched.attitude, whole.attitude)
        assert (lost == np.isnan(whole.attitude).any(axis=(2, 3))).all()
    for save_every in (5, 7):
        for watch in (False, True):
            sparse = run(save_every=save_every, watch=watch)
            saved = [*range(0, 12, save_every), 12]
            np.testing.assert_array_equal(sparse.x, whole.x[saved])
            assert (sparse.failed == (lost[saved].any(axis=0) | lost[-1])).all()
    for m in [*np.flatnonzero(returns), 0, len(x0) - 1][:6]:
        for watch in (False, True):
            alone = run(x0[m], watch=watch)
            kept = len(alone.t)
            assert kept == (np.argmax(lost[:, m]) if lost[:, m].any() else 13)
            np.testing.assert_array_equal(alone.x, whole.x[:kept, m])
            sparse = run(x0[m], watch=watch, save_every=5)
            np.testing.assert_array_equal(sparse.x, whole.x[[0, 5, 10, 12], m][: len(sparse.t)])

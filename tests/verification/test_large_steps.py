"""Large steps: group elements and compensated momenta stay at round-off for any angle."""

import numpy as np
import pytest

import coadjoint as co

pytestmark = pytest.mark.thinned(3)

U = 2.0**-53
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


def test_two_shears_are_elliptic():
    generator = co.algebras.sl(2).coadjoint(np.array(ELLIPTIC))
    assert np.max(np.abs(np.linalg.eigvals(generator).real)) < 1e-7


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


def test_attitude_stays_orthogonal_at_large_steps():
    body = co.systems.rigid_body(inertia=(1, 2, 3))
    sol = co.integrate(body, (3.0, -5.0, 4.0), (0, 4000), 0.4, co.Splitting(), attitude=True, save_every=10_000)
    A = sol.attitude[-1]
    assert np.max(np.abs(A @ A.T - np.eye(3))) < 10_000 * 4 * U

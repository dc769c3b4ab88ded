"""Isospectral Gauss methods with several predicted stages: against NumPy, Casimirs, and resumed bits."""

import numpy as np
import pytest

import coadjoint as co
from served import state_of

H = 0.05
SYSTEMS = [
    co.systems.sphere_euler(N=9, rotation=0.3),
    co.systems.torus_euler(N=7),
    co.systems.reduced_mhd(N=5),
    co.systems.passive_scalar(N=6),
    co.systems.layered_qg(N=5, gamma=((2.0, -1.0), (-1.0, 1.0))),
]


@pytest.mark.parametrize("stages", [2, 3])
@pytest.mark.parametrize("system", SYSTEMS, ids=lambda system: system.name)
@pytest.mark.parametrize("h", [H, -H])
def test_predicted_stages_against_steps_in_numpy(system, stages, h):
    method, x0 = co.IsospectralGauss(stages), np.asarray(state_of(system))
    sol = co.integrate(system, x0, (0.5, 0.5 + 16 * h), abs(h), method)
    x = x0
    for k in range(16):
        x = method.step(system, x, 0.5 + k * h, h)
    assert np.abs(sol.x[-1] - x).max() <= 1e-13 * 16 * np.abs(x0).max()


def test_casimirs_over_many_steps_and_bits_of_resumed_runs(tmp_path):
    system, method = co.systems.sphere_euler(N=12), co.IsospectralGauss(2)
    W = np.asarray(state_of(system))
    sol = co.integrate(system, W, (0, 2000 * H), H, method, save_every=500)
    size = np.abs(system.spectrum(W)).max()
    assert np.abs(system.spectrum(sol.x[-1]) - system.spectrum(W)).max() <= 1e-13 * size
    path = tmp_path / "run.zarr"
    co.integrate(system, W, (0, 500 * H), H, method, save_every=500, archive=path)
    co.resume(path, 1000 * H)
    assert co.load(path).x[-1].tobytes() == sol.x[2].tobytes()


@pytest.mark.parametrize("stages", [1, 2, 3])
def test_a_member_that_fails_leaves_those_beside_and_after_it_alone(stages):
    system = co.systems.sphere_euler(N=5)
    noise = np.random.default_rng(63).normal(size=(2, 5, 5)) * (0.3 + 0.2j)
    calm, wild = system.algebra.projected(noise) * np.array([1.0, 1e4])[:, None, None]
    ready = co.prepare(system, co.IsospectralGauss(stages), 1.0, watch=False, threads=1)
    alone = ready.run(calm, (0, 2)).x
    for states in ([wild, calm], [calm, wild]):
        with pytest.raises(co.IntegrationError, match="1 of 2 members") as error:
            ready.run(np.array(states), (0, 2))
        member = [state is calm for state in states].index(True)
        assert np.array_equal(error.value.partial.x[:, member], alone)
    assert np.array_equal(ready.run(calm, (0, 2)).x, alone)

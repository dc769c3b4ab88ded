"""Three coordinates that move each other have stages in registers; in a crowd they are read from tables."""

import numpy as np
import pytest

import coadjoint as co

SYSTEMS = {
    "rigid body": co.systems.paper_rigid_body(),
    "other sign": co.systems.rigid_body(inertia=(1, 2, 3)),
    "with rotors": co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1.0, 0.5, 0.3], linear=[0.2, -0.1, 0.4])),
    "sl(2)": co.LiePoissonSystem(
        co.LieAlgebra([(0, 1, 2, -1.0), (1, 2, 0, 1.0), (2, 0, 1, 1.0)], dim=3), co.Quadratic([1, 2, 3])
    ),
    "full M": co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([[1, 0.1, 0], [0.1, 2, 0.2], [0, 0.2, 3]])),
}


@pytest.mark.parametrize("stages", [2, 3, 4, 7, 8, 11, 16, 17])
@pytest.mark.parametrize("name", SYSTEMS)
def test_one_trajectory_has_the_bits_of_a_crowd(name: str, stages: int) -> None:
    x0 = np.random.default_rng(stages).normal(size=(5, 3))
    x0[1, 2] = 0.0
    attitude = "coadjoint" if stages < 8 else False
    run = {"t_span": (0.0, 3.0), "step": 0.1, "method": co.GaussLegendre(stages), "attitude": attitude, "threads": 1}
    crowd = co.integrate(SYSTEMS[name], x0, **run)
    for member, start in enumerate(x0):
        alone = co.integrate(SYSTEMS[name], start, **run)
        assert alone.x.tobytes() == np.ascontiguousarray(crowd.x[:, member]).tobytes()
        if attitude:
            assert alone.attitude.tobytes() == np.ascontiguousarray(crowd.attitude[:, member]).tobytes()

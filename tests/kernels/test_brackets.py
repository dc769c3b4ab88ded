"""Small algebras have their stages in registers; in an ensemble they are read from tables."""

import numpy as np
import pytest

import coadjoint as co

ROTORS = {"linear": [0.2, -0.1, 0.4]}
WHOLE = np.diag(np.linspace(0.6, 1.6, 6)) + 0.1 * np.sin(np.add.outer(range(6), range(6)))
E3, SO4 = co.algebras.get("e(3)"), co.algebras.so(4)
SCALED = [(0, 1, 2, 0.7), (1, 2, 0, 1.3), (2, 0, 1, 0.9)]
SL2 = [(0, 1, 2, -1.0), (1, 2, 0, 1.0), (2, 0, 1, 1.0)]
SYSTEMS = {
    "rigid body": co.systems.paper_rigid_body(),
    "other sign": co.systems.rigid_body(inertia=(1, 2, 3)),
    "with rotors": co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1.0, 0.5, 0.3], **ROTORS)),
    "sl(2)": co.LiePoissonSystem(co.LieAlgebra(SL2, dim=3), co.Quadratic([1, 2, 3])),
    "scaled axes": co.LiePoissonSystem(co.LieAlgebra(SCALED, dim=3), co.Quadratic([1, 2, 3])),
    "full M": co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([[1, 0.1, 0.3], [0.1, 2, 0.2], [0.3, 0.2, 3]])),
    "few entries": co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([[1, 0.1, 0], [0.1, 2, 0.2], [0, 0.2, 3]])),
    "heavy top": co.LiePoissonSystem(E3, co.Quadratic([1.0, 0.8, 0.5, 0, 0, 0], linear=[0, 0, 0, 0.2, 0.1, 1.0])),
    "Kirchhoff": co.LiePoissonSystem(E3, co.Quadratic([1.0, 0.8, 0.5, 0.3, 0.7, 0.9]), sign=-1),
    "e(3), full M": co.LiePoissonSystem(E3, co.Quadratic(WHOLE), sign=-1),
    "so(4)": co.LiePoissonSystem(SO4, co.Quadratic(np.diag(WHOLE))),
    "so(4), full M": co.LiePoissonSystem(SO4, co.Quadratic(WHOLE), sign=-1),
}


@pytest.mark.thinned(6)
@pytest.mark.parametrize("stages", [2, 3, 4, 7, 8, 11, 16, 17])
@pytest.mark.parametrize("name", SYSTEMS)
def test_one_trajectory_has_the_bits_of_an_ensemble(name: str, stages: int) -> None:
    x0 = np.random.default_rng(stages).normal(size=(5, SYSTEMS[name].dim))
    x0[1, 2] = 0.0
    attitude = "coadjoint" if stages < 8 else False
    run = {"t_span": (0.0, 3.0), "step": 0.1, "method": co.GaussLegendre(stages), "attitude": attitude, "threads": 1}
    ensemble = co.integrate(SYSTEMS[name], x0, **run)
    for member, start in enumerate(x0):
        alone = co.integrate(SYSTEMS[name], start, **run)
        assert alone.x.tobytes() == np.ascontiguousarray(ensemble.x[:, member]).tobytes()
        if attitude:
            assert alone.attitude.tobytes() == np.ascontiguousarray(ensemble.attitude[:, member]).tobytes()

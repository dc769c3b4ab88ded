"""Members of an ensemble are computed side by side, and stages of a member alone: both have the same bits."""

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


@pytest.mark.thinned(8)
@pytest.mark.parametrize("stages", [2, 3, 4, 7, 8, 11, 16, 17])
@pytest.mark.parametrize("name", SYSTEMS)
def test_members_have_the_bits_that_they_have_alone(name, stages):
    """Energies of small algebras and of every form, by stages that fill blocks and do not."""
    x0 = np.random.default_rng(stages).normal(size=(5, SYSTEMS[name].dim))
    x0[1, 2] = 0.0
    attitude = "coadjoint" if stages < 8 else False
    run = {"t_span": (0.0, 3.0), "step": 0.1, "method": co.GaussLegendre(stages), "attitude": attitude, "threads": 1}
    ensemble = co.integrate(SYSTEMS[name], x0, **run)
    runs = [co.integrate(SYSTEMS[name], start, **run) for start in x0]
    for member, alone in enumerate(runs):
        assert np.array_equal(alone.x, ensemble.x[:, member]) and np.array_equal(
            alone.energy, ensemble.energy[:, member]
        )
        if attitude:
            assert np.array_equal(alone.attitude, ensemble.attitude[:, member])
    assert sum(alone.stats.iterations for alone in runs) == ensemble.stats.iterations
    assert sum(alone.stats.evaluations for alone in runs) == ensemble.stats.evaluations


MEMBERS = 35  # a whole block of lanes on every processor, and some that are left


def noncompact():
    """Members on noncompact orbits: at large steps some settle, some take Newton's method, some have no solution."""
    H = co.Hamiltonian(
        lambda x, t: 0.5 * x[0] * x[0] * (1.0 + np.sin(t)) + x[1] * x[2] + np.cos(2.0 * t) * x[1] * x[1],
        lambda x, t: np.array([x[0] * (1.0 + np.sin(t)), x[2] + 2.0 * np.cos(2.0 * t) * x[1], x[1]]),
    )
    x0 = np.array([1.0, 0.5, -0.25]) * (1 + 0.3 * np.random.default_rng(0).standard_normal((MEMBERS, 3)))
    return co.LiePoissonSystem(co.algebras.sl(2), H), x0


@pytest.mark.filterwarnings("ignore::coadjoint.LargeStepWarning")
@pytest.mark.parametrize("method", [co.GaussLegendre(1), co.GaussLegendre(3)], ids=repr)
def test_members_that_need_newton_or_fail_have_the_bits_that_they_have_alone(method):
    system, states = noncompact()
    with pytest.raises(co.IntegrationError) as raised:
        co.integrate(system, states, (0.0, 2.0), 0.25, method)
    whole = raised.value.partial
    assert 3 < np.count_nonzero(whole.failed) < MEMBERS - 3
    for m, x0 in enumerate(states):
        try:
            alone = co.integrate(system, x0, (0.0, 2.0), 0.25, method)
        except co.IntegrationError as error:
            assert whole.failed[m]
            alone = error.partial
        else:
            assert not whole.failed[m]
        count = len(alone.t)
        assert np.array_equal(alone.x, whole.x[:count, m]) and np.isnan(whole.x[count:, m]).all()


@pytest.mark.filterwarnings("ignore::coadjoint.LargeStepWarning")
@pytest.mark.parametrize(
    "method",
    [
        co.Splitting(order=4),
        co.GaussLegendre(3),
        co.ModifiedGaussLegendre(2),
        co.ModifiedGaussLegendre(2, freeze="gradient"),
        co.IteratedGaussLegendre(2),
        co.ExplicitRungeKutta("rk4"),
        co.Taylor(6),
        co.RadauEnergy(2),
    ],
    ids=repr,
)
@pytest.mark.parametrize(("kind", "h"), [("bodies", 0.1), ("bodies", 0.5), ("spirals", 0.05)])
def test_members_with_constants_of_their_own(method, kind, h):
    """Moments of inertia; or parameters of the bracket and the Casimir."""
    numbers = np.random.default_rng(4).uniform(0.5, 2.0, (MEMBERS, 3))
    bodies = [co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(1 / inertia)) for inertia in numbers]
    if kind == "spirals":
        spirals = [(co.algebras.get("A3,7", a=a), co.Quadratic([1.0, 2.0, 0.01 * a])) for a in numbers[:, 0]]
        bodies = [co.LiePoissonSystem(*spiral) for spiral in spirals]
    attitude = "coadjoint" if method.properties(bodies[0]).attitude != "none" else False
    states = np.array([1.0, 2.0, 0.5]) * (1 + 0.3 * np.random.default_rng(0).standard_normal((MEMBERS, 3)))
    whole = co.integrate(co.batch(bodies), states, (0.0, 10 * h), h, method, attitude=attitude)
    for m in range(0, MEMBERS, 3):
        alone = co.integrate(bodies[m], states[m], (0.0, 10 * h), h, method, attitude=attitude)
        assert np.array_equal(alone.x, whole.x[:, m]) and np.array_equal(alone.energy, whole.energy[:, m])
        assert attitude is False or np.array_equal(alone.attitude, whole.attitude[:, m])
        assert all(np.array_equal(values, whole.casimirs[name][:, m]) for name, values in alone.casimirs.items())


@pytest.mark.parametrize("n", [3, 4, 5])
@pytest.mark.parametrize("method", [co.Taylor(8), co.Taylor(3, projected=False), co.RadauEnergy(1)], ids=str)
def test_a_member_that_overflows_leaves_nothing_to_the_next(n, method):
    """Dimensions 3, 6 and 10 leave lanes of a row empty; a member after the failing one finds zeros there."""
    algebra = co.algebras.so(n)
    system = co.LiePoissonSystem(algebra, co.Quadratic(np.linspace(1.0, 2.0, algebra.dim)))
    calm = np.linspace(0.1, 1.0, algebra.dim)
    wild = 1e200 * np.roll(calm, 1)
    alone = co.integrate(system, calm, (0, 1), 0.1, method)
    for order in ([wild, calm], [calm, wild], [wild, calm, wild, calm]):
        with pytest.raises(co.IntegrationError) as raised:
            co.integrate(system, np.array(order), (0, 1), 0.1, method, threads=1)
        partial = raised.value.partial
        assert partial.failed.tolist() == [state is wild for state in order]
        for member in np.flatnonzero(~partial.failed):
            assert np.array_equal(partial.x[:, member], alone.x)
            assert np.array_equal(partial.energy[:, member], alone.energy)

"""Batches of systems: validation, solutions and their members."""

import numpy as np
import pytest

import coadjoint as co
from refusals import refused

X = (0.1, 1.0, 0.2)


def body(*inertia):
    return co.systems.rigid_body(inertia)


def spiral(a, M=(1.0, 2.0, 0.5)):
    return co.LiePoissonSystem(co.algebras.get("A3,7", a=a), co.Quadratic(M), name=f"spiral {a:g}")


def flat(dim=2, scale=1.0):
    J = np.zeros((dim, dim))
    J[0, 1], J[1, 0] = 1.0, -1.0
    return co.PoissonSystem(lambda x: J, co.Quadratic([scale] * dim), dim=dim, name="flat")


REFUSED = {
    "empty": (lambda: [], ValueError, "batch is empty"),
    "one system": (lambda: body(1, 2, 3), TypeError, "give a list of systems"),
    "no system": (lambda: [body(1, 2, 3), 5], TypeError, "member 1 of the batch is 5.*LiePoissonSystem"),
    "dimension": (
        lambda: [body(1, 2, 3), body(1, 2, 2.25), co.LiePoissonSystem(co.algebras.so(4), co.Quadratic(1.0))],
        ValueError,
        "member 2 .* dimension 6 .* 3",
    ),
    "kind": (
        lambda: [body(1, 2, 3), flat(3)],
        ValueError,
        "member 1 .* PoissonSystem",
    ),
    "sign": (
        lambda: [body(1, 2, 3), co.systems.paper_rigid_body()],
        ValueError,
        r"member 1 .* sign=\+1 .* -1",
    ),
    "the other sign": (
        lambda: [co.systems.paper_rigid_body(), body(1, 2, 3)],
        ValueError,
        r"member 1 .* sign=-1 .* \+1",
    ),
    "algebra": (
        lambda: [spiral(1.0), spiral(2.0), co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(1.0))],
        ValueError,
        r"member 2 .* algebra.*\[e1, e2\].* e3",
    ),
    "first": (lambda: [7, body(1, 2, 3)], TypeError, "member 0 of the batch is 7"),
    "fewer brackets": (
        lambda: [
            co.LiePoissonSystem(co.LieAlgebra.from_brackets(3, brackets), co.Quadratic(1.0), casimirs={})
            for brackets in ({(0, 1): {2: 1.0}, (0, 2): {1: 1.0}}, {(0, 1): {2: 1.0}})
        ],
        ValueError,
        r"member 1 .* algebra: only in member 0 has \[e1, e3\] a component along e2",
    ),
    "more brackets": (
        lambda: [
            co.LiePoissonSystem(co.LieAlgebra.from_brackets(3, brackets), co.Quadratic(1.0), casimirs={})
            for brackets in ({(0, 1): {2: 1.0}}, {(0, 1): {2: 1.0}, (0, 2): {1: 1.0}})
        ],
        ValueError,
        r"member 1 .* algebra: only in it has \[e1, e3\] a component along e2",
    ),
    "casimirs": (
        lambda: [body(1, 2, 3), co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(1.0), -1, casimirs={})],
        ValueError,
        r"member 1 .* Casimirs \[\] .*\|x\|\^2",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_invalid_batches_are_refused(case):
    systems, kind, message = REFUSED[case]
    with pytest.raises(kind, match=message) as refusal:
        co.batch(systems())
    assert "\n" not in str(refusal.value)


def test_forces_preserving_different_casimirs_are_refused():
    """Also if the forces have the same names."""

    def damped(*flags):
        forces = [co.forces.OwnForce(lambda x, t, tau: x, name="drag", keeps_casimirs=one) for one in flags]
        return body(1, 2, 3).with_forces(*forces)

    assert len(co.batch([damped(True, False), damped(True, False)])) == 2
    for other in (damped(True, True), damped(False, True), damped(False, False)):
        with refused(ValueError, "member 2", "forces", "Casimirs"):
            co.batch([damped(True, False), damped(True, False), other])
    for fewer in (damped(True), damped(True, False, False)):
        with refused(ValueError, "member 1", "drag, drag 2"):
            co.batch([damped(True, False), fewer])


def test_unsupported_member_is_named():
    split = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1.0, 2.0, 3.0]))
    coupled = co.LiePoissonSystem(co.algebras.so(3), co.Polynomial({(5, 1, 1): 1.0}))  # degree seven
    with refused(ValueError, "member 1", "Splitting"):
        co.integrate(co.batch([split, coupled]), X, (0, 1), 0.1, co.Splitting())


def test_representations_of_different_sizes_are_refused():
    so3 = co.algebras.so(3)
    larger = np.zeros((3, 4, 4))
    larger[:, :3, :3] = so3.representation
    batch = co.batch(
        [co.LiePoissonSystem(so3, co.Quadratic(M), representation=r) for M, r in ((1.0, None), (2.0, larger))]
    )
    with refused(ValueError, "member 1", "representation", "(3, 4, 4)"):
        co.integrate(batch, X, (0, 1), 0.1, attitude=True)
    assert co.integrate(batch, X, (0, 1), 0.1, attitude="coadjoint").attitude.shape == (11, 2, 3, 3)


def test_each_member_uses_its_own_casimirs():
    """The Casimir of A3,7 contains a: that of another member would drift at once."""
    systems = [spiral(a) for a in (0.5, 1.0, 3.0)]
    sol = co.integrate(co.batch(systems), X, (0, 5), 0.05, observe={"first": lambda x: x[0]})
    (name,) = systems[0].casimirs
    for m, system in enumerate(systems):
        casimir = system.casimirs[name]
        expected = [casimir(x) for x in sol.x[:, m]]
        # The function in Python and its compiled twin round a logarithm and an angle differently.
        wrapped = (sol.casimirs[name][:, m] - expected) / (casimir.period or np.inf)
        assert np.abs(wrapped - np.round(wrapped)).max() < 1e-12
        assert sol.drift()[name].members[m] < 1e-12 * len(sol.t)
    assert np.array_equal(sol.observed["first"], sol.x[..., 0])
    assert len(np.unique(sol.casimirs[name][0])) == 3


def test_batch_is_a_sequence():
    systems = [spiral(a) for a in (1.0, 1.5, 2.0)]
    batch = co.batch(iter(systems))
    assert len(batch) == 3 and list(batch) == systems and batch[1] is systems[1] and batch.dim == 3
    assert repr(batch) == "<batch of 3 (spiral 1, spiral 1.5, ...)>"


def test_angles_are_unwrapped_by_the_period_of_the_member():
    """A4,6 with different and with equal periods: x2 and x3 turn many times."""

    def system(a, b):
        g = co.algebras.get("A4,6", a=a, b=b)
        return co.LiePoissonSystem(g, co.Quadratic([0.0, 0.0, 0.0, 1.0], linear=[0.0, 0.0, 0.0, 1.0]))

    for constants in ([(0.5, 0.25)] * 3, [(0.5, 0.25), (0.25, 0.125), (0.125, 0.5), (0.5, 0.0)]):
        systems = [system(*pair) for pair in constants]
        x0 = np.array([1.0, 1.0, 0.5, 0.25])
        together = co.integrate(co.batch(systems[:3]), x0, (0.0, 16.0), 0.125)
        for m, own in enumerate(systems[:3]):
            alone = co.integrate(own, x0, (0.0, 16.0), 0.125)
            (name,) = (name for name in alone.casimirs if name.startswith("log|x1|"))
            assert np.array_equal(together.casimirs[name][:, m], alone.casimirs[name])
            # Not one whole turn is lost: the invariant stays, to rounding that grows with the time.
            assert np.ptp(alone.casimirs[name]) < 2.0**12 * 2.0**-53 * 128


@pytest.mark.parametrize(
    ("members", "found"),
    [
        (
            [body(1, 2, 3).with_forces(co.forces.LinearDamping(r)) for r in (0.1, 0.2, 0.1)],
            {"forces_0_rate": [0.1, 0.2, 0.1]},
        ),
        (
            [body(1, 2, 3).with_forces(co.forces.LinearDamping(0.1), co.forces.Torque((0, 0, n))) for n in (0.5, -1.0)],
            {"forces_1_torque_2": [0.5, -1.0]},
        ),
        (
            [
                co.systems.rigid_body(I).with_forces(co.forces.LinearDamping(r))
                for I, r in (((1, 2, 3), 1), ((1, 2, 2.5), 2))
            ],
            {"inertia_2": [3.0, 2.5], "forces_0_rate": [1.0, 2.0]},
        ),
    ],
)
def test_parameters_in_which_members_differ_are_coordinates_of_datasets(members, found):
    """Those of forces have the names that they have in sweeps of files."""
    batch = co.batch(members)
    x0 = [(1.0, 0.2, 0.1)] * len(members)
    coordinates = co.integrate(batch, x0, (0, 1), 0.5, co.Splitting(2)).to_xarray().coords
    swept = {str(name): values for name, values in coordinates.items() if str(name).startswith("swept_")}
    assert {name.removeprefix("swept_"): values.values.tolist() for name, values in swept.items()} == found
    assert all(values.dims == ("member",) for values in swept.values())

"""Forces change momenta: every registered force on every ready-made system, DOP853, layouts of one's own, refusals."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import coadjoint as co
from coadjoint.systems.description import description
from matrix.forces import force_on
from refusals import refused

F, S = co.forces, co.systems
OTHERS = {"X", "Y", "Z", "r", "z", "gamma", "q", "a"}
"""Names without numbers of axes, positions, directions and constants; q and r beside momenta and the constant z."""
ORDER = co.Splitting(order=6)


def momenta_of(system):
    """Which coordinates are momenta, by their names."""
    names = description(system.name)["coordinates"]
    found = [name.split("[")[0].rstrip("0123456789") for name in names]
    if system.name == "point_vortices":  # of places alone
        return np.zeros(system.dim, dtype=bool)
    others = OTHERS if "z" in found else OTHERS - {"q", "r"}
    return np.array([name not in others for name in found])


@pytest.mark.thinned(1)
@pytest.mark.parametrize("name", [name for name in S.names() if not S.get(name).has_matrices])
def test_every_force_keeps_what_is_no_momentum_or_is_refused(name):
    system = S.get(name)
    momenta, x, acting = momenta_of(system), 0.5 + 0.4 * np.cos(np.arange(system.dim)), set()
    declared = system.layout.get("coordinates", {})
    assert momenta.all() == all(kind == "momentum" for kind, _ in declared.values())
    # Sampled forces act on bodies with memories, below.
    forces = {kind: force_on(kind, system) for kind in F.names() if not getattr(F, kind).sampled}
    forces |= {"matrix": F.LinearDamping(0.1 * np.eye(system.dim)), "full": F.Torque(np.full(system.dim, 0.1))}
    for label, force in forces.items():
        try:
            forced = system.with_forces(force).forces[0]
        except (TypeError, ValueError):
            continue
        acting.add(label)
        moved = forced.flow(system, x.copy(), 0.0, 2.0**-6) != x
        allowed = momenta if forced.moves == ("momentum",) else True  # noise of Hamiltonians moves all as motions do
        assert not (moved & ~np.asarray(allowed)).any() and moved.any(), label
    if not momenta.any():
        assert not acting & {"LinearDamping", "HeatBath", "DoubleBracketDamping", "Torque", "full", "OwnForce"}
        return
    assert "LinearDamping" in acting and ("HeatBath" in acting) == ("DoubleBracketDamping" in acting)
    assert ("DoubleBracketDamping" in acting) == system.has_structure_constants
    others = {"full", "OwnForce", "matrix"}
    assert "Torque" in acting and (others <= acting if momenta.all() else not others & acting)
    for one in (F.Torque(0.1 * momenta), F.LinearDamping(0.1 * momenta), F.LinearDamping(np.diag(0.1 * momenta))):
        if system.frame_rate is None or np.ndim(one.parameters().get("rate", ())) < 2:
            system.with_forces(one)


def test_wheels_and_gyros_are_turned_by_their_motors_alone():
    """A damper in space damps momenta, of wheels as well, and keeps gimbals; laws keep the memories of each other."""
    wheels, gyros = 0.05 * np.eye(3), [[(1, 0, 0), (0, 1, 0)]]
    motors = F.ReactionWheels(F.Pointing(0.1, 0.2), 0.5)
    body = S.body(wheels=wheels, gyros=gyros).with_forces(F.LinearDamping(0.3), motors)
    x = body.state((0.6, 0, 0, 0.8), (0.1, 0.2, 0.3), wheel_speeds=(1, 2, 3), gimbal_angles=(0.4,))
    x[-3:] = 7.0
    y = body.forces[0].flow(body.unforced, x, 0.0, 1.0)
    momenta = [0, 1, 2, 12, 13, 14]
    np.testing.assert_allclose(y[momenta], np.exp(-0.3) * x[momenta], rtol=1e-15)
    np.testing.assert_array_equal(np.delete(y, momenta), np.delete(x, momenta))
    with refused(ValueError, "cos1", "angle", "momenta"):
        S.body(gyros=gyros).with_forces(F.OwnForce(lambda x, t, tau: x * np.exp(-tau * (np.arange(14) > 11))))
    with refused(ValueError, "held1", "memory"):
        body.with_forces(F.Torque(np.r_[np.zeros(len(x) - 3), 1.0, 0.0, 0.0]))


def by_dop853(system, x0, rates, span):
    """Return the end of the motion of the field without forces and of damping by rates."""

    def field(t, x):
        return system.vector_field(x, t) - rates * x

    return solve_ivp(field, span, x0, "DOP853", rtol=1e-12, atol=1e-14).y[:, -1]


BODY = S.body()
TURNED = BODY.state(Rotation.from_rotvec((0.3, 0.2, 0.1)), (0.1, 1.0, 0.2))
RUNS = {
    "a top": (S.heavy_top(), np.array([0.3, 0.2, 3.0, 0.6, 0.0, 0.8])),
    "a body": (BODY, TURNED),
    "a satellite": (S.satellite(), np.array([0.1, 0.2, 2.0, 0.0, 20.0, 0.0, 5.0, 0.1, 0.2, 1.0])),
    "particles": (S.toda(), np.array([-0.8, 0.1, -0.2, 0.9, 0.4, 0.35, 0.45])),
}


@pytest.mark.thinned(1)
@pytest.mark.parametrize("name", RUNS)
def test_damped_motions_by_dop853(name):
    """Their error is that of a scheme of order six, (h/2)^6."""
    system, x0 = RUNS[name]
    rates = 0.2 * momenta_of(system)
    sol = co.integrate(system.with_forces(F.LinearDamping(0.2)), x0, (0.0, 3.0), 1 / 32, ORDER)
    np.testing.assert_allclose(sol.x[-1], by_dop853(system, x0, rates, (0, 3)), rtol=0, atol=1e-9)


@pytest.mark.parametrize("unit", [1.0, 1e-7, 1e30])
def test_damping_in_any_unit_of_time_from_any_start_forward_and_back(unit):
    momenta = np.arange(12) < 3
    x0 = np.where(momenta, unit, 1.0) * np.stack([TURNED, BODY.state(angular_velocity=(1.0, 0.1, -0.2))])
    damped = BODY.with_forces(F.LinearDamping(0.2 * unit))
    start, end, h = -3.0 / unit, -1.0 / unit, 1 / 16 / unit
    sol = co.integrate(damped, x0, (start, end), h, ORDER)
    for k, own in enumerate(x0):
        wanted = by_dop853(BODY, np.where(momenta, own / unit, own), 0.2 * momenta, (-3, -1))
        np.testing.assert_allclose(np.where(momenta, sol.x[-1, k] / unit, sol.x[-1, k]), wanted, rtol=0, atol=1e-7)
    back = co.integrate(damped, sol.x[-1], (end, start), h, ORDER)
    scale = np.where(momenta, unit, 1.0)
    np.testing.assert_allclose(back.x[-1] / scale, x0 / scale, rtol=0, atol=1e-12)


def test_a_double_bracket_on_axes_is_friction_and_a_bath_has_its_temperature():
    """The torque is -2 alpha Omega, and the mean of L . Omega is that of three degrees of freedom, 3 kT."""
    damped = BODY.with_forces(F.DoubleBracketDamping(0.15))
    found = damped.vector_field(TURNED) - BODY.vector_field(TURNED)
    np.testing.assert_allclose(found[:3], -0.3 * BODY.angular_velocity(TURNED), rtol=1e-14)
    assert not found[3:].any()
    kT, members = 0.7, 300
    hot = BODY.with_forces(F.HeatBath(0.5, temperature=kT, seed=3))
    sol = co.integrate(hot, np.tile(TURNED, (members, 1)), (0, 8), 1 / 8, save_every=64)
    energies = np.einsum("mi,mi->m", BODY.angular_momentum(sol.x[-1]), BODY.angular_velocity(sol.x[-1]))
    assert energies.mean() == pytest.approx(3 * kT, abs=4 * np.sqrt(6 / members) * kT)
    A = BODY.attitudes(sol.x[-1])
    assert np.abs(np.einsum("mij,mkj->mik", A, A) - np.eye(3)).max() < 1e-12


def test_two_fields():
    """Damping acts on the vorticity; the field that it carries has forces of its own."""
    for system in (S.reduced_mhd(4), S.passive_scalar(5, "torus")):
        W = np.random.default_rng(1).standard_normal((2, *system.algebra.shape)) * (1 + 1j)
        x = system.to_vector(np.stack([system.algebra.projected(one) for one in W]))
        theta, vorticity = np.split(F.LinearDamping(0.3).flow(system, x, 0.0, 1.0), 2)
        np.testing.assert_array_equal(theta, np.split(x, 2)[0])
        np.testing.assert_allclose(vorticity, np.exp(-0.3) * np.split(x, 2)[1], rtol=1e-15)


def test_kinds_of_systems_of_ones_own(tmp_path):
    """They are stored in records, and decide what forces change."""
    e3, H = co.algebras.e(3), co.Quadratic([1.0, 0.5, 0.4, 0.0, 0.0, 0.0], linear=[0.0, 0, 0, 0.3, 0.2, 1.0])
    plain = co.LiePoissonSystem(e3, H, sign=-1, name="own top")
    names = [name for name in co.integrate(plain, np.ones(6), (0, 0.1), 0.1).to_xarray()["component"].values.tolist()]
    own = co.LiePoissonSystem(
        e3, H, sign=-1, name="own top", layout={"coordinates": dict.fromkeys(names[3:], "direction")}
    )
    x0, rates = RUNS["a top"][1], 0.2 * (np.arange(6) < 3)
    assert own.layout["coordinates"][names[4]] == ("direction", "")
    forced, all_of_them = (one.with_forces(F.LinearDamping(0.2)) for one in (own, plain))
    sol = co.integrate(forced, x0, (0, 1), 1 / 32, ORDER)
    np.testing.assert_allclose(sol.x[-1], by_dop853(plain, x0, rates, (0, 1)), rtol=0, atol=1e-9)
    np.testing.assert_allclose(all_of_them.vector_field(x0) - plain.vector_field(x0), -0.2 * x0, rtol=1e-14, atol=1e-16)
    sol.to_xarray().to_netcdf(tmp_path / "run.nc")
    loaded = co.load(tmp_path / "run.nc").system
    assert loaded.unforced.layout == own.layout
    np.testing.assert_array_equal(loaded.vector_field(x0), forced.vector_field(x0))
    for kinds, error, named in (
        ({"w": "axis"}, ValueError, ("coordinate", "w")),
        ({names[0]: "axle"}, ValueError, ("axle", "momentum")),
        ({names[0]: ("axis", 1)}, ValueError, (names[0], "unit")),
        (3, TypeError, ("coordinates", "3")),
    ):
        with refused(error, *named):
            co.LiePoissonSystem(e3, H, layout={"coordinates": kinds})


def test_refused_parameters_and_inputs():
    top, rod = S.heavy_top(), S.bodies([(1.0, 1.0, 0.0)], [1.0])
    for system, force, named in (
        (top, F.LinearDamping(0.1 * np.eye(6)), ("gamma1", "direction", "m1")),
        (top, F.Torque(lambda x, t: 0.1 * x), ("Torque", "gamma1")),
        (top, F.DoubleBracketDamping(0.1, np.ones(6)), ("metric", "gamma1")),
        (top, F.DoubleBracketDamping(0.1, np.eye(6)), ("metric", "gamma1")),
        (S.satellite(), F.OwnForce(lambda x, t, tau: x * np.exp(-tau), name="drag"), ("drag", "r1", "position")),
        (rod, F.HeatBath(0.1, temperature=1.0, seed=1), ("HeatBath", "rod")),
    ):
        with refused(ValueError, *named):
            system.with_forces(force)
    ready = co.prepare(top.with_forces(F.Torque(np.zeros(6))), step=0.1, inputs={"push": "Torque"})
    x0 = RUNS["a top"][1]
    ready.run(x0, (0, 1), push=(0.1, 0, 0.2, 0, 0, 0))
    with refused(ValueError, "push", "gamma2", "direction"):
        ready.run(x0, (0, 1), push=(0.1, 0, 0.2, 0, 0.1, 0))
    # A spring between momenta and directions, and a metric on directions, change momenta alone.
    spring = np.zeros((6, 6))
    spring[:3, 3:] = 0.3 * np.eye(3)
    top.with_forces(F.LinearDamping(spring), F.DoubleBracketDamping(0.1, (0, 0, 0, 1, 2, 3)))

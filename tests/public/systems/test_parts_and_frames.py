"""The same bodies in axes that are turned in them, and the same parts in another order: tensors are oblique, and
arguments that are one number or one for each part differ for all parts.
"""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import coadjoint as co
from rounding import UNIT_ROUNDOFF as U
from satellite_forces import AREAS, CENTRES, MATT, MIRROR, NORMALS, PERIOD, SPIN, TENSOR, TURNED, WHEELS

S, F = co.systems, co.forces
Q = Rotation.from_rotvec([[0.7, -0.4, 1.1], [-0.3, 0.9, 0.5]]).as_matrix()
MOMENTS = ((1.0, 2.0, 2.5), (0.4, 0.6, 0.8))
MASS, COUPLING = (1.5, 2.5, 2.0), np.array([[0.2, 0.05, 0.0], [-0.1, 0.3, 0.1], [0.0, 0.15, 0.1]])


def oblique(tensor, turn):
    """Return a tensor in turned axes, symmetric to the bit if it is."""
    tensor = np.diag(tensor) if np.ndim(tensor) == 1 else tensor
    found = turn.T @ tensor @ turn
    return 0.5 * (found + found.T) if np.array_equal(tensor, tensor.T) else found


def pair(order):
    """Return a maker of two bodies, each in axes of its own."""
    return lambda turn: S.gravitating_bodies(
        [oblique(one, R) for one, R in zip(MOMENTS, turn, strict=True)], (3.0, 1.5), 0.8, order
    )


# By system: the system of bodies whose axes are turned, the identity for none.
TURNED_SYSTEMS = {
    "rigid_body": lambda turn: S.rigid_body(oblique(MOMENTS[0], turn[0])),
    "body": lambda turn: S.body(oblique(MOMENTS[0], turn[0])),
    "gyrostat": lambda turn: S.gyrostat(oblique(MOMENTS[0], turn[0]), turn[0].T @ (0.25, 0.5, 0.75)),
    "heavy_top": lambda turn: S.heavy_top(oblique(MOMENTS[0], turn[0]), turn[0].T @ (0.75, 0.5, 1.0)),
    "kirchhoff_body": lambda turn: S.kirchhoff_body(
        oblique(MOMENTS[0], turn[0]), oblique(MASS, turn[0]), oblique(COUPLING, turn[0])
    ),
    "satellite_on_orbit": lambda turn: S.satellite_on_orbit(oblique(MOMENTS[0], turn[0]), 1.25),
    "satellite_on_orbit, ellipse": lambda turn: S.satellite_on_orbit(oblique(MOMENTS[0], turn[0]), 1.25, 0.3),
    "gravitating_bodies, 0": pair(0),
    "gravitating_bodies, 2": pair(2),
    "gravitating_bodies, 4": pair(4),
}
OTHERS = {  # bodies of moments or of sites alone, the potential of the user, planes of n dimensions, no frame of space
    "clebsch_body", "rigid_molecules", "bodies", "so_n_body", "matrix_body", "satellite", "toda", "toda_ring",
}  # fmt: skip


def test_every_system_with_an_inertia_is_turned_or_has_no_tensor():
    with_inertia = {name for name in S.names() if {"inertia", "inertias", "sites"} & {*(S.get(name).parameters or {})}}
    assert with_inertia == {name.partition(",")[0] for name in TURNED_SYSTEMS} | OTHERS


@pytest.mark.thinned(1)
@pytest.mark.parametrize("name", TURNED_SYSTEMS)
def test_a_body_in_turned_axes_has_the_same_energy_and_motion(name):
    """All numbers of a body but its position and momentum are vectors in its frame: momenta, and rows of attitudes."""
    straight, turned = TURNED_SYSTEMS[name]((np.eye(3), np.eye(3))), TURNED_SYSTEMS[name](Q)
    turn, two = np.eye(straight.dim), name.startswith("gravitating")
    for k in range(24 if two else straight.dim // 3 * 3):
        if k % 3 == 0:
            turn[k : k + 3, k : k + 3] = Q[k // 12 if two else 0].T
    x = np.cos(3.0 * np.arange(straight.dim))
    if two:
        A = Rotation.from_rotvec([[0.3, -0.2, 0.9], [1.1, 0.4, -0.5]])
        x = straight.state(
            [[-1.0, 0.5, 0.0], [2.0, 0.0, 0.5]], [[0.0, -0.25, 0.05], [0.1, 0.75, 0.0]], A, [SPIN, -SPIN]
        )
    energy, other = straight.hamiltonian, turned.hamiltonian
    at = (x, 0.7) if energy.timed else (x,)
    there = (turn @ x, *at[1:])
    slope, hessian = (turn @ energy.gradient(*at), turn @ energy.hessian(*at) @ turn.T)
    field = turn @ straight.vector_field(*at)
    # Some hundred products of turned numbers each.
    assert other.value(*there) == pytest.approx(energy.value(*at), rel=0, abs=256 * U * np.abs(slope).max())
    np.testing.assert_allclose(other.gradient(*there), slope, rtol=0, atol=256 * U * np.abs(slope).max())
    np.testing.assert_allclose(other.hessian(*there), hessian, rtol=0, atol=1024 * U * np.abs(hessian).max())
    np.testing.assert_allclose(turned.vector_field(*there), field, rtol=0, atol=1024 * U * np.abs(field).max())


SHARES = {"specular": MIRROR, "diffuse": MATT}
PLATES = {"areas": AREAS, "normals": NORMALS, "centres": CENTRES}
FACING = TURNED.apply(np.array([-0.2, 0.4, 0.8]) / np.sqrt(0.84))  # all three plates


@pytest.mark.parametrize("order", [(1, 0, 2), (2, 0, 1)])
def test_the_order_of_plates_is_free(order):
    """Of all arguments that differ from plate to plate, and of which each plate has an effect."""
    light = F.SolarPressure(0.02, FACING, **PLATES, **SHARES)
    air = F.Drag(0.2, FACING, **PLATES)
    for force in (light, air):
        own = {name: getattr(force, name) for name in (*PLATES, *SHARES) if hasattr(force, name)}

        def torque(arguments, force=force):
            system = S.body(TENSOR).with_forces(dataclasses.replace(force, **arguments))
            x = system.state(TURNED, SPIN)
            return (system.vector_field(x) - system.unforced.vector_field(x))[:3]

        whole = torque(own)
        moved = torque({name: tuple(values[k] for k in order) for name, values in own.items()})
        np.testing.assert_allclose(moved, whole, rtol=0, atol=32 * U)
        for name, values in own.items():
            for k in range(3 if name not in ("normals", "centres") else 0):
                other = torque({**own, name: tuple(0.5 * v if n == k else v for n, v in enumerate(values))})
                assert np.abs(other - whole).max() > 1e-5, (force.label, name, k)


def held(system, x):
    """Return the state at the end of a period in which the command of the only force is held."""
    return system.flows[0][1].flow(system, x, 0.0, PERIOD)


def test_limits_of_each_wheel():
    """By the formula of the page: the torques of smallest sum of squares, limited, until the momentum is."""
    torque, unit = np.array([0.3, -0.2, 0.25]), WHEELS / np.linalg.norm(WHEELS, axis=1)[:, None]
    motors = -np.linalg.pinv(unit.T) @ torque
    most, full = np.abs(motors) * (0.5, 2.0, 0.25, 0.75), np.array([1.0, 0.02, 0.01, 0.03])
    limited = np.clip(motors, -most, most)
    for max_torque, max_momentum in ((most, None), (None, full), (most, full)):
        wheels = F.ReactionWheels(F.Torque(torque), PERIOD, max_torque=max_torque, max_momentum=max_momentum)
        system = S.body(TENSOR, wheels=WHEELS).with_forces(wheels)
        wanted = PERIOD * (motors if max_torque is None else limited)
        wanted = wanted if max_momentum is None else np.clip(wanted, -full, full)
        np.testing.assert_allclose(held(system, system.state())[12:16], wanted, rtol=1e-13, atol=0)


def test_limits_about_each_axis():
    """Of a torque, and of pulses and their smallest impulses."""
    torque, most = np.array([0.3, -0.2, 0.25]), np.array([0.2, 0.5, 0.1])
    free = S.body((1.0, 1.0, 1.0), attitude=False)
    limited = free.with_forces(F.Sampled(F.Torque(torque), PERIOD, most))
    np.testing.assert_allclose(held(limited, limited.state())[:3], PERIOD * np.clip(torque, -most, most), rtol=1e-15)
    for least, fires in (((0.05, 0.11, 0.01), (1, 0, 1)), ((0.11, 0.05, 0.06), (0, 1, 0))):
        jets = free.with_forces(F.Thrusters(F.Torque(torque), PERIOD, most, least))
        wanted = PERIOD * np.clip(torque, -most, most) * fires
        np.testing.assert_allclose(held(jets, jets.state())[:3], wanted, rtol=1e-15)


def test_limits_of_a_law_about_each_axis():
    """Pointing also applied continuously."""
    most = np.array([0.02, 0.5, 0.01])
    law, limited = F.Pointing(0.5, 1.5), F.Pointing(0.5, 1.5, max_torque=most)
    free = S.body(TENSOR)
    x = free.state(TURNED, SPIN)
    whole, found = (free.with_forces(one).vector_field(x)[:3] - free.vector_field(x)[:3] for one in (law, limited))
    assert (np.abs(whole) > most).tolist() == [True, False, True]
    np.testing.assert_allclose(found, np.clip(whole, -most, most), rtol=0, atol=16 * U)

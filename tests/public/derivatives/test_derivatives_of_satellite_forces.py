"""Derivatives of runs with forces on a satellite, and sampled controllers, by all their parameters."""

import numpy as np
import pytest
from derivative_checks import assert_derivatives

import coadjoint as co
from long import long_where
from satellite_forces import CASES, STEP


@pytest.mark.thinned(30)
@pytest.mark.parametrize("name", long_where(["Sampled"], CASES))
def test_derivatives_by_parameters_of_forces(name):
    """Tangents, gradients and differences of whole runs, over two samples, where no limit is reached."""
    case = CASES[name]
    x0 = case.start
    x0[len(x0) - case.memory :] = 0.1  # a measured field that is zero counts as none
    gradient = assert_derivatives(case.build, co.Splitting(), x0, (0.0, 9 * STEP), STEP)
    label = name.partition(" ")[0]
    wanted = {
        "GravityGradient": {"mu", "position"} if case.stored else {"mu", "quadrupole"},
        "MagneticDipole": {"moment", "B"} if case.stored else {"moment"},
        "SolarPressure": {"pressure", "sun", "areas", "centres", "specular", "diffuse"},
        "Drag": {"density", "areas", "centres", "coefficient"},
        "Pointing": {"stiffness", "damping"},
        "BDot": {"gain"},
        "Magnetorquers": {"law.stiffness", "law.damping", "B"} if case.stored else {"law.gain"},
        "WheelFriction": {"viscous", "coulomb", "transition_speed"},
        "Sampled": {"law.stiffness", "law.damping"} if case.stored else set(),
    }.get(label, {"law.stiffness", "law.damping"})
    assert {"x0", "inertia", *(f"{label}.{one}" for one in wanted), *({"wheels"} & set(case.body))} <= set(gradient)


@pytest.mark.parametrize("turn", [*np.eye(4), *-np.eye(4)[:3]], ids=lambda turn: str(turn.astype(int).tolist()))
def test_pointing_by_quaternions_about_every_axis_by_half_a_turn(turn):
    """The slope by the stiffness where each component of the quaternion is the largest, of either sign."""

    def end(stiffness):
        law = co.forces.Pointing(stiffness, 1.5, error="quaternion", max_torque=0.9)
        return co.prepare(co.systems.body((1.0, 2.0, 2.5)).with_forces(law), co.Splitting(), 0.05)

    quaternion = (turn + 0.1) / np.linalg.norm(turn + 0.1)
    x0, h = end(0.5).system.state(quaternion, angular_velocity=(0.1, 0.2, 0.3)), 1e-5
    sol, pullback = end(0.5).vjp(x0, (0, 0.5))
    ends = [end(0.5 + s * h).run(x0, (0, 0.5)).x.sum() for s in (1, -1)]
    assert abs(pullback(np.ones_like(sol.x))["Pointing.stiffness"] - (ends[0] - ends[1]) / (2 * h)) < 1e-7

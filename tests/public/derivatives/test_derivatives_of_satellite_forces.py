"""Derivatives of runs with forces on a satellite, and sampled controllers, by all their parameters."""

from dataclasses import replace

import numpy as np
import pytest
from derivative_checks import assert_derivatives

import coadjoint as co
from long import long_where
from satellite_forces import CASES, LAW, PERIOD, PYRAMID, SHARE, SPIN, STEP, TENSOR, TURNED


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


LIMITED = {
    "Thrusters": (co.forces.Thrusters(LAW, PERIOD, 0.02), {}),
    "ControlMomentGyros": (
        co.forces.ControlMomentGyros(LAW, PERIOD, max_rate=0.02, regularization=SHARE),
        {"gyros": PYRAMID},
    ),
}


@pytest.mark.parametrize("name", LIMITED)
def test_actuators_at_their_limits_are_differentiated_behind_a_damping(name):
    """By the damping, the limit and the law, which moves one gimbal that has not reached it, and no thruster."""
    actuator, body = LIMITED[name]

    def build(changed):
        forces, own = [co.forces.LinearDamping(0.3), actuator], {}
        for key, value in changed.items():
            label, _, field = key.partition(".")
            if not field:
                own[key] = value
            elif field.startswith("law."):
                forces[1] = replace(forces[1], law=replace(forces[1].law, **{field[4:]: value}))
            else:
                k = label == name
                forces[k] = replace(forces[k], **{field: value})
        return co.systems.body(**{"inertia": TENSOR, **body, **own}).with_forces(*forces)

    gradient = assert_derivatives(build, co.Splitting(), build({}).state(TURNED, SPIN), (0.0, 9 * STEP), STEP)
    limit = "max_torque" if name == "Thrusters" else "max_rate"
    assert gradient["LinearDamping.rate"] != 0.0 and gradient[f"{name}.{limit}"] != 0.0
    assert np.any(gradient[f"{name}.law.stiffness"]) == np.any(gradient[f"{name}.law.damping"]) == (name != "Thrusters")

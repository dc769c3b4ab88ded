"""Derivatives of runs with forces on a satellite, and sampled controllers, by all their parameters."""

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

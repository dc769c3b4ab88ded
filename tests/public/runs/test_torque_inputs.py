"""Torques as inputs: a closed form, steppers, functions beside them, and refusals."""

import numpy as np
import pytest

import coadjoint as co
from refusals import refused

pytestmark = pytest.mark.thinned(3)

STEP, SPANS = 0.0625, ((0.0, 0.5), (0.5, 0.0))


@pytest.mark.parametrize("parts", ["auto", "free_body"])
def test_changing_thruster_matches_the_closed_form(parts):
    """A symmetric body with N about its axis: x3 is the integral of N, the phase that of x3 (1/2 - 1)."""
    body = co.systems.rigid_body(inertia=(1.0, 1.0, 2.0)).with_forces(co.forces.Torque((0.0, 0.0, 0.0)))
    ready = co.prepare(body, co.Splitting(parts=parts), 0.125, inputs={"thruster": "Torque"})
    x, spin, phase = np.array([0.5, -0.2, 0.8]), 0.8, 0.0
    start = x[0] + 1j * x[1]
    for k, N in enumerate((0.4, 0.0, -1.5, 0.75)):
        x = ready.run(x, (0.5 * k, 0.5 * k + 0.5), 4, thruster=(0.0, 0.0, N)).x[-1]
        phase += -0.5 * (0.5 * spin + N * 0.125)
        spin += 0.5 * N
    assert abs(x[2] - spin) < 64 * 2.0**-53
    assert abs(x[0] + 1j * x[1] - start * np.exp(-1j * phase)) < 64 * 2.0**-53
    assert np.array_equal(ready.run(x, (0, 1)).x, co.integrate(body, x, (0, 1), 0.125, ready.method).x)


def test_torque_inputs_beside_functions():
    whole = co.Hamiltonian(lambda x: x[0] ** 2 + x[1] ** 4, lambda x: np.array([2 * x[0], 4 * x[1] ** 3, 0.0]))
    drag = co.forces.OwnForce(lambda x, t, tau: x * np.exp(-0.1 * tau), name="drag")
    wave = co.forces.Torque(lambda t: np.array([0.0, np.sin(t), 0.1]))
    sl = co.LiePoissonSystem(co.algebras.sl(2), whole).with_forces(wave, co.forces.Torque((0.1, 0.0, 0.0)))
    x, N = np.array([0.4, -0.3, 0.5]), np.array([0.2, 0.7, -0.1])
    sol = co.prepare(sl, co.GaussLegendre(2), STEP, inputs={"N": "Torque 2"}).run(x, SPANS[0], N=N)
    changed = sl.unforced.with_forces(wave, co.forces.Torque(N))
    assert np.array_equal(sol.x, co.integrate(changed, x, SPANS[0], STEP, co.GaussLegendre(2)).x)
    with refused(TypeError, "Hamiltonian", "linear term"):
        co.prepare(sl, co.GaussLegendre(2), STEP, inputs={"N": "Torque 2", "field": (0,)})
    for label, kind in (("Torque", "Torque"), ("drag", "OwnForce")):
        with refused(TypeError, "inputs", f"'{label}'", f"{kind}(", "constant Torque"):
            co.prepare(sl.with_forces(drag), co.GaussLegendre(2), STEP, inputs={"N": label})


def test_wrong_torque_inputs_are_refused():
    body = co.systems.rigid_body((1, 2, 3))
    pushed = body.with_forces(co.forces.Torque((0, 0, 1)), co.forces.LinearDamping(0.1))
    given = [
        (ValueError, "unknown force 'Torqe'; did you mean 'Torque'", pushed, {"N": "Torqe"}),
        (ValueError, "'Torque' more than once", pushed, {"N": "Torque", "M": "Torque"}),
        (TypeError, "'LinearDamping' for N, which is 'LinearDamping", pushed, {"N": "LinearDamping"}),
        (TypeError, "give each torque a name", pushed, "Torque"),
        (ValueError, "'Torque' for N, and rigid_body has no forces", body, {"N": "Torque"}),
        (ValueError, "'t', which is reserved", pushed, {"t": "Torque"}),
    ]
    for kind, words, system, inputs in given:
        with pytest.raises(kind, match=words):
            co.prepare(system, None, 0.1, inputs=inputs)
    ready = co.prepare(pushed, None, 0.1, inputs={"N": "Torque"})
    for kind, words, torque in (
        (ValueError, r"N has the shape \(2,\).*\(3,\), or \(members, 3\)", (1, 2)),
        (ValueError, "N contains NaN or infinity", (0, np.inf, 0)),
        (TypeError, "N is 'full'", "full"),
    ):
        with pytest.raises(kind, match=words):
            ready.run((0.1, 1.0, 0.2), (0, 1), N=torque)
    with refused(ValueError, "one state"):
        co.stepper(pushed, co.Splitting(), 0.1, inputs={"N": "Torque"}).tangent((0.1, 1.0, 0.2), N=np.zeros((2, 3)))

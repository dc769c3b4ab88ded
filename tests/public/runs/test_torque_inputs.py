"""Torques as inputs: a closed form."""

import numpy as np
import pytest

import coadjoint as co

pytestmark = pytest.mark.thinned(3)


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

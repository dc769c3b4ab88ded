"""Questions that callers ask of any system: with forces, in a batch, of matrices, or user-defined."""

import numpy as np
import pytest

import coadjoint as co
from coadjoint.systems import protocol
from coadjoint.systems.coordinates import coordinate_names

BODY = co.systems.rigid_body(inertia=(1, 2, 3))
DAMPED = BODY.with_forces(co.forces.LinearDamping(0.1), co.forces.Torque((0, 0, 0.2)))
FLUID = co.systems.sphere_euler(N=3)


class OwnBody:
    """A class with the interface of `GeneralSystem` alone."""

    name, sign, representation = "own body", -1, None
    algebra, hamiltonian, casimirs = BODY.algebra, BODY.hamiltonian, BODY.casimirs
    dim = 3

    def vector_field(self, x, t=0.0):
        return BODY.vector_field(x, t)

    def energy(self, x, t=0.0):
        return BODY.energy(x, t)


def test_members():
    bodies = co.batch([co.systems.rigid_body(inertia=(1, 2, third)) for third in (2.5, 2.75, 3)])
    assert protocol.is_batch(bodies) and not protocol.is_batch(BODY)
    assert protocol.members_of(bodies) == bodies.systems and protocol.members_of(BODY) == (BODY,)
    assert [protocol.member_of(bodies, m) for m in range(3)] == list(bodies)
    assert protocol.member_of(BODY, 2) is BODY
    assert protocol.among(bodies, 1, 3).systems == bodies.systems[1:] and protocol.among(DAMPED, 1, 3) is DAMPED
    noisy = BODY.with_forces(co.forces.HeatBath(0.1, temperature=0.2, seed=1))
    assert [force.stream for _, force in protocol.forces_of(protocol.among(noisy, 2, 3))] == [2]


def test_forces():
    assert [label for label, _ in protocol.forces_of(DAMPED)] == ["LinearDamping", "Torque"]
    assert [force for _, force in protocol.forces_of(co.batch([DAMPED, DAMPED]))] == list(DAMPED.forces)
    assert protocol.unforced(DAMPED) is protocol.unforced(co.batch([DAMPED, DAMPED])) is BODY
    own = OwnBody()
    assert protocol.unforced(own) is own and protocol.forces_of(own) == protocol.forces_of(FLUID) == ()


def test_states():
    rows = np.arange(36.0).reshape(2, 18)
    assert np.array_equal(protocol.states_of(FLUID, rows), FLUID.from_vector(rows))
    assert np.array_equal(protocol.states_of(FLUID.in_numbers, rows), rows)
    assert np.array_equal(protocol.states_of(co.batch([DAMPED, DAMPED]), rows.reshape(2, 6, 3)), rows.reshape(2, 6, 3))
    own = OwnBody()
    own.dim, own.shape = 9, (3, 3)
    assert np.array_equal(protocol.states_of(own, rows.reshape(4, 9)), rows.reshape(4, 3, 3))
    assert protocol.coordinates_of(own) == tuple(f"x{i}" for i in range(1, 10)) and protocol.coordinates_of(FLUID) == ()
    assert not protocol.is_matrix_system(own) and protocol.is_matrix_system(FLUID.in_numbers)
    drag = FLUID.with_forces(co.forces.LinearDamping(0.1))
    assert protocol.unforced_matrix_system(drag) is protocol.unforced_matrix_system(FLUID) is FLUID
    assert protocol.unforced_matrix_system(own) is None and protocol.coordinates_of(drag) == ()


def test_attributes_of_own_systems_are_not_those_of_forces_and_batches():
    own = OwnBody()
    own.system, own.systems = "of units", ("SI", "CGS")
    assert protocol.coordinates_of(own) == coordinate_names(own) == ("x1", "x2", "x3")
    assert coordinate_names(co.batch([DAMPED, DAMPED])) == coordinate_names(BODY)


@pytest.mark.parametrize("method", [co.Splitting(order=4), co.GaussLegendre(2), co.Taylor(8)], ids=str)
@pytest.mark.parametrize("attitude", [False, "coadjoint"])
def test_structure_constants_suffice(method, attitude):
    """Schemes ask for structure constants, not for a class: the run of a user-defined system has the same bits."""
    own, known = (
        co.integrate(system, (0.1, 1.0, 0.1), (0, 5), 0.1, method, attitude=attitude) for system in (OwnBody(), BODY)
    )
    assert np.array_equal(own.x, known.x) and np.array_equal(own.energy, known.energy)
    assert attitude is False or np.array_equal(own.attitude, known.attitude)


def test_a_system_without_structure_constants_is_refused():
    own = OwnBody()
    own.algebra = None
    with pytest.raises(ValueError, match="Splitting needs a Lie algebra, which own body does not have"):
        co.integrate(own, (0.1, 1.0, 0.1), (0, 1), 0.1, co.Splitting())

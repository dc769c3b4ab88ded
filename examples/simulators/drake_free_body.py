"""A free body of Drake with the exact rotation: energy and angular momentum with it and without.

The body of a discrete ``MultibodyPlant`` turns by the exact motion of the free body, half a step before the update of
the plant and half a step after it. In between Drake applies forces and contacts: its gyroscopic term is canceled by an
applied spatial force, and its rotation is undone, so that the exact one replaces it. It needs ``pip install drake
coadjoint``; the figures of docs/simulators.md are those of Drake 1.51.
"""

import numpy as np
from pydrake.common.value import Value
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.math import SpatialForce, SpatialVelocity
from pydrake.multibody.plant import ExternallyAppliedSpatialForce, MultibodyPlant
from pydrake.multibody.tree import RotationalInertia, SpatialInertia

import coadjoint as co

STEP, MASS, CENTER = 0.001, 2.0, np.array([0.1, 0.2, -0.1])
AXES = RotationMatrix.MakeXRotation(0.5).matrix() @ RotationMatrix.MakeZRotation(0.9).matrix()
INERTIA = AXES @ np.diag([1.0, 1.5, 2.5]) @ AXES.T  # about the center of mass, in body axes
RATE = AXES @ np.array([6.0, 14.0, 5.0])  # angular velocity in body axes
VELOCITY = np.array([0.1, 0.2, 0.3])  # of the center of mass, in space
TURNS = 100


class Simulation:
    """A plant of one free body, with the exact rotation or with Drake's."""

    def __init__(self, exact, step=STEP):
        self.plant = MultibodyPlant(time_step=step)
        self.h = step
        self.plant.SetUseSampledOutputPorts(False)  # the update is then one of the discrete state
        inertia = RotationalInertia(*np.diag(INERTIA), INERTIA[0, 1], INERTIA[0, 2], INERTIA[1, 2])
        central = SpatialInertia.MakeFromCentralInertia(MASS, CENTER, inertia)
        self.body = self.plant.AddRigidBody("body", central)
        self.plant.mutable_gravity_field().set_gravity_vector(np.zeros(3))
        self.plant.Finalize()
        self.context, self.exact, self.torque = self.plant.CreateDefaultContext(), exact, np.zeros(3)
        self.half_step = co.stepper(co.systems.rigid_body(INERTIA), co.Splitting(parts="free_body"), step / 2)
        self.write(np.eye(3), RATE, np.zeros(3), VELOCITY)

    def read(self):
        """Return the attitude, the angular velocity in body axes, and position and velocity of the center of mass."""
        pose = self.plant.GetFreeBodyPose(self.context, self.body)
        motion = self.plant.EvalBodySpatialVelocityInWorld(self.context, self.body)
        A, w = pose.rotation().matrix(), motion.rotational()  # Drake's angular velocity is in space
        position, velocity = pose.translation() + A @ CENTER, motion.translational() + np.cross(w, A @ CENTER)
        return A, A.T @ w, position, velocity

    def write(self, A, w, position, velocity):
        """Store what `read` returns, as pose and velocity of the origin of the body."""
        pose = RigidTransform(RotationMatrix.ProjectToRotationMatrix(A), position - A @ CENTER)
        motion = SpatialVelocity(A @ w, velocity - A @ np.cross(w, CENTER))
        self.plant.SetFreeBodyPose(self.context, self.body, pose)
        self.plant.SetFreeBodySpatialVelocity(self.context, self.body, motion)

    def update(self):
        """Take the discrete step of the plant, with `torque` in space, and without the gyroscopic term if `exact`."""
        A, w, *_ = self.read()
        force = ExternallyAppliedSpatialForce()
        force.body_index, force.p_BoBq_B = self.body.index(), CENTER
        force.F_Bq_W = SpatialForce(self.torque, np.zeros(3))
        if self.exact:  # what Drake subtracts for the motion of the body
            gyroscopic, centripetal = np.cross(w, INERTIA @ w), MASS * np.cross(w, np.cross(w, CENTER))
            force.F_Bq_W = SpatialForce(self.torque + A @ gyroscopic, A @ centripetal)
        port = self.plant.get_applied_spatial_force_input_port()
        port.FixValue(self.context, Value[list[ExternallyAppliedSpatialForce]]([force]))
        self.context.SetDiscreteState(self.plant.EvalUniquePeriodicDiscreteUpdate(self.context))

    def turn(self):
        """Turn by half a step."""
        A, w, *center = self.read()
        before = INERTIA @ w
        momentum, A = self.half_step.both(before, A)
        self.write(A, w + np.linalg.solve(INERTIA, momentum - before), *center)

    def step(self):
        """Take a step."""
        if not self.exact:
            self.update()
            return
        self.turn()
        A, _, position, _ = self.read()
        self.update()
        # The new velocities belong to the attitude before the update, which has turned the body on.
        motion = self.plant.EvalBodySpatialVelocityInWorld(self.context, self.body)
        velocity = motion.translational() + np.cross(motion.rotational(), A @ CENTER)
        self.write(A, A.T @ motion.rotational(), position + self.h * velocity, velocity)
        self.turn()

    def energy_and_momentum(self):
        """Return the kinetic energy, and the angular momentum in space about the center of mass."""
        A, w, _, velocity = self.read()
        return (w @ INERTIA @ w + MASS * velocity @ velocity) / 2, A @ INERTIA @ w


def drift(exact, turns=TURNS):
    """Return the relative changes of energy and angular momentum in space over some turns at 1 kHz."""
    simulation = Simulation(exact)
    energy, momentum = simulation.energy_and_momentum()
    for _ in range(round(turns * 2 * np.pi / np.linalg.norm(RATE) / STEP)):
        simulation.step()
    energy1, momentum1 = simulation.energy_and_momentum()
    return energy1 / energy - 1, np.linalg.norm(momentum1 - momentum) / np.linalg.norm(momentum)


if __name__ == "__main__":
    print(f"Drake, {TURNS} turns at 1 kHz: relative change of energy and angular momentum in space")
    for name, exact in (("discrete plant", False), ("with exact rotation", True)):
        print(f"{name:22s} {{:+.1e}}  {{:.1e}}".format(*drift(exact)))

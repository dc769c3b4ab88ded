"""A satellite of Basilisk with the exact rotation: energy and angular momentum with it and without.

Basilisk moves the satellite on its orbit and computes the torques; the attitude turns by the exact motion of the free
body, half a step before the torque of the middle of the step is applied, and half a step after it. The rotation that
Basilisk has integrated is overwritten. It needs ``pip install bsk coadjoint``; the figures of docs/simulators.md are
those of Basilisk 2.12.
"""

import numpy as np
from Basilisk.simulation import GravityGradientEffector, spacecraft
from Basilisk.utilities import RigidBodyKinematics, SimulationBaseClass, macros, simIncludeGravBody

import coadjoint as co

STEP, TURNS = 0.2, 100
INERTIA = np.array([[900.0, 20.0, -30.0], [20.0, 800.0, 10.0], [-30.0, 10.0, 600.0]])  # in body axes
RATE, ATTITUDE = np.array([0.05, 0.3, 0.1]), np.array([0.1, 0.2, -0.3])  # in body axes; MRP, space to body
ORBIT = (7e6, 0.0, 0.0), (0.0, 7e3, 2.6e3)


class Simulation:
    """A satellite on its orbit, with the exact rotation or with Basilisk's."""

    def __init__(self, exact, step=STEP, gravity_gradient=False):
        self.exact, self.h, self.time = exact, step, 0
        self.scene = SimulationBaseClass.SimBaseClass()
        # Two periods of Basilisk are a step: the torque belongs to the middle.
        half = macros.sec2nano(step / 2)
        self.scene.CreateNewProcess("dynamics").addTask(self.scene.CreateNewTask("dynamics", half))
        self.satellite = spacecraft.Spacecraft()
        self.satellite.hub.mHub, self.satellite.hub.IHubPntBc_B = 750.0, INERTIA.tolist()
        self.satellite.hub.r_CN_NInit, self.satellite.hub.v_CN_NInit = ([[v] for v in one] for one in ORBIT)
        self.satellite.hub.sigma_BNInit, self.satellite.hub.omega_BN_BInit = (
            [[v] for v in one] for one in (ATTITUDE, RATE)
        )
        self.gravity = simIncludeGravBody.gravBodyFactory()
        earth = self.gravity.createEarth()
        earth.isCentralBody = True
        self.gravity.addBodiesTo(self.satellite)
        self.torque = None
        if gravity_gradient:
            self.torque = GravityGradientEffector.GravityGradientEffector()
            self.torque.addPlanetName(earth.planetName)
            self.satellite.addDynamicEffector(self.torque)
            self.scene.AddModelToTask("dynamics", self.torque)
        self.scene.AddModelToTask("dynamics", self.satellite)
        self.scene.InitializeSimulation()
        self.states = [self.satellite.dynManager.getStateObject(name) for name in ("hubSigma", "hubOmega")]
        self.half_step = co.stepper(co.systems.rigid_body(INERTIA), co.Splitting(parts="free_body"), step / 2)

    def read(self):
        """Return the attitude, from the body to space, and the angular momentum in body axes."""
        sigma, w = (np.array(state.getState()).ravel() for state in self.states)
        return RigidBodyKinematics.MRP2C(sigma).T, INERTIA @ w

    def write(self, A, momentum):
        """Store what `read` returns."""
        for state, value in zip(
            self.states, (RigidBodyKinematics.C2MRP(A.T), np.linalg.solve(INERTIA, momentum)), strict=True
        ):
            state.setState([[v] for v in value])

    def half_of_orbit(self):
        """Let Basilisk take half a step."""
        self.time += macros.sec2nano(self.h / 2)
        self.scene.ConfigureStopTime(self.time)
        self.scene.ExecuteSimulation()

    def step(self):
        """Take a step."""
        if not self.exact:
            self.half_of_orbit()
            self.half_of_orbit()
            return
        A, momentum = self.read()
        momentum, A = self.half_step.both(momentum, A)
        self.half_of_orbit()
        self.write(A, momentum)
        if self.torque is not None:
            self.torque.computeForceTorque(self.time * macros.NANO2SEC, self.h)
            momentum = momentum + self.h * np.array(self.torque.torqueExternalPntB_B).ravel()
        momentum, A = self.half_step.both(momentum, A)
        self.half_of_orbit()
        self.write(A, momentum)

    def energy_and_momentum(self):
        """Return the energy of the rotation, and the angular momentum in space."""
        A, momentum = self.read()
        return momentum @ np.linalg.solve(INERTIA, momentum) / 2, A @ momentum


def drift(exact, step=STEP, turns=TURNS):
    """Return the relative changes of energy and angular momentum in space over some turns."""
    simulation = Simulation(exact, step)
    energy, momentum = simulation.energy_and_momentum()
    for _ in range(round(turns * 2 * np.pi / np.linalg.norm(RATE) / step)):
        simulation.step()
    energy1, momentum1 = simulation.energy_and_momentum()
    return energy1 / energy - 1, np.linalg.norm(momentum1 - momentum) / np.linalg.norm(momentum)


if __name__ == "__main__":
    print(f"Basilisk, {TURNS} turns: relative change of energy and angular momentum in space")
    for step in (0.2, 1.0):
        for name, exact in (("Runge-Kutta of order 4", False), ("with exact rotation", True)):
            print(f"{name:22s}, step {step} s  {{:+.1e}}  {{:.1e}}".format(*drift(exact, step)))

"""Free bodies of MuJoCo with the exact rotation: energy and angular momentum with it and without.

Every body with a free joint, without children and armature, turns by the exact motion of the free body, half a step
before ``mj_step`` and half a step after it. In between MuJoCo applies forces, contacts and gravity: a callback cancels
the gyroscopic term of these bodies, and the rotation by ``mj_step`` is undone, so that the exact one replaces it. Other
bodies are left to MuJoCo. It needs ``pip install mujoco coadjoint``; the figures of docs/simulators.md are those of
MuJoCo 4.0.0.
"""

import mujoco
import numpy as np

import coadjoint as co

SCENE = """
<mujoco>
  <option timestep="0.001" gravity="0 0 0"/>
  <worldbody>
    <body euler="20 30 40">
      <freejoint/>
      <inertial pos="0.1 0.2 -0.1" mass="2" diaginertia="1 1.5 2.5" euler="30 50 70"/>
    </body>
  </worldbody>
</mujoco>"""
START = (0.1, 0.2, 0.3, 6.0, 14.0, 5.0)  # velocity of the origin in space, angular velocity in body axes
TURNS, RATE = 100, float(np.linalg.norm(START[3:]))


def matrix(quaternion):
    """Return the rotation of a quaternion (w, x, y, z)."""
    entries = np.zeros(9)
    mujoco.mju_quat2Mat(entries, quaternion)
    return entries.reshape(3, 3)


class FreeBody:
    """The exact rotation of a body about its center of mass, between the kicks by MuJoCo."""

    def __init__(self, model, body):
        joint = model.body_jntadr[body]
        self.place, self.dof = model.jnt_qposadr[joint], model.jnt_dofadr[joint]
        self.center, self.mass = model.body_ipos[body].copy(), model.body_mass[body]
        self.axes, self.moments = matrix(model.body_iquat[body]), model.body_inertia[body].copy()
        body_of_moments = co.systems.rigid_body(self.moments)
        self.half_step = co.stepper(body_of_moments, co.Splitting(parts="free_body"), model.opt.timestep / 2)

    def read(self, data):
        """Return the quaternion, the angular velocity in body axes, and position and velocity of the center of mass."""
        q, w = data.qpos[self.place + 3 : self.place + 7].copy(), data.qvel[self.dof + 3 : self.dof + 6].copy()
        A = matrix(q)
        position = data.qpos[self.place : self.place + 3] + A @ self.center
        return q, w, position, data.qvel[self.dof : self.dof + 3] + A @ np.cross(w, self.center)

    def write(self, data, q, w, position, velocity):
        """Store what `read` returns, as coordinates of the origin of the body."""
        A = matrix(q)
        data.qpos[self.place : self.place + 3] = position - A @ self.center
        data.qpos[self.place + 3 : self.place + 7] = q
        data.qvel[self.dof : self.dof + 3] = velocity - A @ np.cross(w, self.center)
        data.qvel[self.dof + 3 : self.dof + 6] = w

    def turn(self, data):
        """Turn by half a step, along the principal axes."""
        q, w, *center = self.read(data)
        before, turned = w @ self.axes, np.zeros(4)
        momentum, rotation = self.half_step.both(self.moments * before)
        # Only what changes goes to the principal axes and back: rounding of the whole would add up.
        w += self.axes @ (momentum / self.moments - before)
        mujoco.mju_mat2Quat(turned, rotation.ravel())
        turned[1:] = self.axes @ turned[1:]
        mujoco.mju_mulQuat(q, q.copy(), turned)
        mujoco.mju_normalize4(q)
        self.write(data, q, w, *center)

    def bias(self, data):
        """Return the force and the torque that MuJoCo subtracts for the motion of the body."""
        q, w, *_ = self.read(data)
        force = self.mass * np.cross(w, np.cross(w, self.center))
        gyroscopic = np.cross(w, self.axes @ (self.moments * (w @ self.axes)))
        return np.concatenate([matrix(q) @ force, np.cross(self.center, force) + gyroscopic])


class ExactRotation:
    """`mj_step` with the exact rotation of free bodies."""

    def __init__(self, model):
        if model.opt.integrator != mujoco.mjtIntegrator.mjINT_EULER:
            raise ValueError("the integrator must be Euler: others evaluate forces also within the step")
        passive = int(mujoco.mjtDisableBit.mjDSBL_SPRING) | int(mujoco.mjtDisableBit.mjDSBL_DAMPER)
        if model.opt.disableflags & passive == passive:
            raise ValueError("springs and dampers are both disabled: MuJoCo then skips the callback of passive forces")
        parents = set(model.body_parentid[1:])
        self.model, self.other = model, None
        self.bodies = [
            FreeBody(model, body)
            for body in range(1, model.nbody)
            if body not in parents
            and model.body_jntnum[body] == 1
            and model.jnt_type[model.body_jntadr[body]] == mujoco.mjtJoint.mjJNT_FREE
            and not model.dof_armature[model.body_dofadr[body] :][:6].any()
        ]

    def cancel(self, model, data):
        """Add to the passive forces what MuJoCo subtracts for the rotation of free bodies; a callback."""
        if self.other is not None:
            self.other(model, data)
        for body in self.bodies:
            data.qfrc_passive[body.dof : body.dof + 6] += body.bias(data)

    def step(self, data):
        """Take a step."""
        for body in self.bodies:
            body.turn(data)
        before = [body.read(data) for body in self.bodies]
        self.other = mujoco.get_mjcb_passive()  # the user's
        mujoco.set_mjcb_passive(self.cancel)
        try:
            mujoco.mj_step(self.model, data)
        finally:
            mujoco.set_mjcb_passive(self.other)
        for body, (q, _, position, _) in zip(self.bodies, before, strict=True):
            # The new velocities belong to the attitude before `mj_step`, which has turned the body on.
            w = data.qvel[body.dof + 3 : body.dof + 6].copy()
            velocity = data.qvel[body.dof : body.dof + 3] + matrix(q) @ np.cross(w, body.center)
            body.write(data, q, w, position + self.model.opt.timestep * velocity, velocity)
            body.turn(data)


def energy_and_momentum(model, data):
    """Return the kinetic energy, and the angular momentum in space about the center of mass."""
    mujoco.mj_forward(model, data)
    mujoco.mj_energyVel(model, data)
    mujoco.mj_subtreeVel(model, data)
    return data.energy[1], data.subtree_angmom[1].copy()


def drift(integrator, exact, turns=TURNS):
    """Return the relative changes of energy and angular momentum in space over some turns at 1 kHz."""
    model = mujoco.MjModel.from_xml_string(SCENE)
    model.opt.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{integrator.upper()}")
    data = mujoco.MjData(model)
    data.qvel[:] = START
    energy, momentum = energy_and_momentum(model, data)
    steps = round(turns * 2 * np.pi / RATE / model.opt.timestep)
    if exact:
        rotation = ExactRotation(model)
        for _ in range(steps):
            rotation.step(data)
    else:
        mujoco.mj_step(model, data, nstep=steps)
    energy1, momentum1 = energy_and_momentum(model, data)
    return energy1 / energy - 1, np.linalg.norm(momentum1 - momentum) / np.linalg.norm(momentum)


if __name__ == "__main__":
    print(
        f"MuJoCo {mujoco.__version__}, {TURNS} turns at 1 kHz: relative change of energy and angular momentum in space"
    )
    for name in ("Euler", "implicitfast", "implicit", "discrete", "RK4"):
        print(f"{name:22s} {{:+.1e}}  {{:.1e}}".format(*drift(name, exact=False)))
    print("{:22s} {:+.1e}  {:.1e}".format("with exact rotation", *drift("Euler", exact=True)))

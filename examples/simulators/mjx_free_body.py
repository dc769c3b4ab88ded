"""A free body of MJX with the exact rotation of `co.jax.free_body`: energy and angular momentum with it and without.

The body turns by the exact motion of the free body, half a step before ``mjx.step`` and half a step after it. In
between MJX applies forces: its gyroscopic term is canceled by an applied force, and its rotation is undone, so that the
exact one replaces it. All of it is one compiled function of JAX. It needs ``pip install mujoco mujoco-mjx
coadjoint[jax]``; the figures of docs/simulators.md are those of MJX 3.17 with MuJoCo 4.0.0, in float64.
"""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from mujoco import mjx

import coadjoint as co

jax.config.update("jax_enable_x64", True)
SCENE = """
<mujoco>
  <option timestep="0.001" gravity="0 0 0" integrator="{integrator}">
    <flag contact="disable" constraint="disable"/>
  </option>
  <worldbody>
    <body euler="20 30 40">
      <freejoint/>
      <inertial pos="0.1 0.2 -0.1" mass="2" diaginertia="1 1.5 2.5" euler="30 50 70"/>
      <geom size="0.1" contype="0" conaffinity="0"/>
    </body>
  </worldbody>
</mujoco>"""
START = (0.1, 0.2, 0.3, 6.0, 14.0, 5.0)  # velocity of the origin in space, angular velocity in body axes
TURNS, RATE, STEP = 100, float(np.linalg.norm(START[3:])), 0.001


def matrix(q):
    """Return the rotation of a quaternion (w, x, y, z)."""
    K = jnp.cross(jnp.eye(3), q[1:])
    return jnp.eye(3) + 2.0 * q[0] * K + 2.0 * K @ K


class ExactRotation:
    """`mjx.step` of a model of one free body, with the exact rotation."""

    def __init__(self, model):
        if model.opt.integrator != mujoco.mjtIntegrator.mjINT_EULER:
            raise ValueError("the integrator must be Euler: others evaluate forces also within the step")
        if (model.nbody, model.nv, model.njnt) != (2, 6, 1) or model.dof_armature.any():
            raise ValueError("the model must have one body, with a free joint without armature")
        axes = np.asarray(matrix(jnp.asarray(model.body_iquat[1])))
        self.inertia = axes @ np.diag(model.body_inertia[1]) @ axes.T  # in body axes
        self.inverse, self.center, self.mass = np.linalg.inv(self.inertia), model.body_ipos[1], model.body_mass[1]

    def turn(self, q, w, h):
        """Return attitude, quaternion and angular velocity in body axes after a time of the free body."""
        x0 = self.inertia @ w
        x1, r = co.jax.free_body(x0, jnp.eye(3), self.inertia, h)
        w = w + self.inverse @ (x1 - x0)
        # The quaternion of the rotation, by less than a right angle, in body axes.
        vector = jnp.array([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]])
        scalar = jnp.sqrt(1.0 + jnp.trace(r)) / 2.0
        p = jnp.append(scalar, vector / (4.0 * scalar))
        q = jnp.append(q[0] * p[0] - q[1:] @ p[1:], q[0] * p[1:] + p[0] * q[1:] + jnp.cross(q[1:], p[1:]))
        q = q / jnp.sqrt(q @ q)
        return matrix(q), q, w

    def step(self, model, data):
        """Return the data after a step, as `mjx.step`."""
        h, q, w = model.opt.timestep, data.qpos[3:7], data.qvel[3:6]
        A = matrix(q)
        position, velocity = data.qpos[:3] + A @ self.center, data.qvel[:3] + A @ jnp.cross(w, self.center)
        A, q, w = self.turn(q, w, h / 2)
        force = self.mass * jnp.cross(w, jnp.cross(w, self.center))
        torque = jnp.cross(self.center, force) + jnp.cross(w, self.inertia @ w)  # what MJX subtracts
        applied = data.qfrc_applied
        data = data.replace(
            qpos=data.qpos.at[:7].set(jnp.concatenate([position - A @ self.center, q])),
            qvel=data.qvel.at[:6].set(jnp.concatenate([velocity - A @ jnp.cross(w, self.center), w])),
            qfrc_applied=applied.at[:6].add(jnp.concatenate([A @ force, torque])),
        )
        data = mjx.step(model, data)
        # The new velocities belong to the attitude before `mjx.step`, which has turned the body on.
        w = data.qvel[3:6]
        velocity = data.qvel[:3] + A @ jnp.cross(w, self.center)
        position = position + h * velocity
        A, q, w = self.turn(q, w, h / 2)
        return data.replace(
            qpos=data.qpos.at[:7].set(jnp.concatenate([position - A @ self.center, q])),
            qvel=data.qvel.at[:6].set(jnp.concatenate([velocity - A @ jnp.cross(w, self.center), w])),
            qfrc_applied=applied,
        )


def energy_and_momentum(model, qpos, qvel):
    """Return the kinetic energy, and the angular momentum in space about the center of mass, by MuJoCo."""
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = qpos, qvel
    mujoco.mj_forward(model, data)
    mujoco.mj_energyVel(model, data)
    mujoco.mj_subtreeVel(model, data)
    return data.energy[1], data.subtree_angmom[1].copy()


def drift(integrator, exact, turns=TURNS):
    """Return the relative changes of energy and angular momentum in space over some turns at 1 kHz."""
    model = mujoco.MjModel.from_xml_string(SCENE.format(integrator=integrator))
    scene = mjx.put_model(model)
    step = ExactRotation(model).step if exact else mjx.step
    start = mjx.make_data(model)
    start = start.replace(qpos=jnp.asarray(model.qpos0), qvel=jnp.asarray(START))
    steps = round(turns * 2 * np.pi / RATE / STEP)
    end = jax.jit(lambda data: jax.lax.fori_loop(0, steps, lambda _, data: step(scene, data), data))(start)
    energy, momentum = energy_and_momentum(model, start.qpos, start.qvel)
    energy1, momentum1 = energy_and_momentum(model, end.qpos, end.qvel)
    return energy1 / energy - 1, np.linalg.norm(momentum1 - momentum) / np.linalg.norm(momentum)


if __name__ == "__main__":
    print(f"MJX, {TURNS} turns at 1 kHz: relative change of energy and angular momentum in space")
    for name in ("Euler", "implicitfast", "RK4"):
        print(f"{name:22s} {{:+.1e}}  {{:.1e}}".format(*drift(name, exact=False)))
    print("{:22s} {:+.1e}  {:.1e}".format("with exact rotation", *drift("Euler", exact=True)))

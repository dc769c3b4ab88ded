"""Programs in `examples/simulators/`, which give simulators the exact rotation of free bodies."""

import importlib
import runpy
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

EXAMPLES = Path(__file__).parents[3] / "examples" / "simulators"
TORQUE, TIME = np.array([3.0, -2.0, 1.0]), 0.5
KICKED = (0.02, 0.01)
"""A torque in space for a time, and the steps, whose errors must have the ratio of order two."""


@pytest.fixture(scope="class")
def example(request):
    """Yield the names of a program, if its packages are installed; JAX has its precision as before after it."""
    name, *packages = request.cls.PROGRAM
    for package in packages:
        pytest.importorskip(package)
    if "jax" not in packages:
        yield SimpleNamespace(**runpy.run_path(str(EXAMPLES / f"{name}.py")))
        return
    config = importlib.import_module("jax").config
    wide = config.jax_enable_x64
    yield SimpleNamespace(**runpy.run_path(str(EXAMPLES / f"{name}.py")))
    config.update("jax_enable_x64", wide)


def under_torque(inertia, A, w):
    """Return attitude and angular momentum in space after the torque, by SciPy."""

    def field(t, y):
        A, w = y[:9].reshape(3, 3), np.linalg.solve(inertia, y[9:])
        return np.append(np.cross(A, w).ravel(), np.cross(y[9:], w) + A.T @ TORQUE)

    y = solve_ivp(field, (0, TIME), np.append(A, inertia @ w), "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    return y[:9].reshape(3, 3), y[:9].reshape(3, 3) @ y[9:]


def has_order_two(ends, expected, *, below):
    errors = [max(abs(A - expected[0]).max(), abs(L - expected[1]).max()) for A, L in ends]
    assert errors[1] < below and 3.3 < errors[0] / errors[1] < 4.7, errors


def kept(drift, below=1e-12):
    return max(abs(change) for change in drift) < below


class TestMuJoCo:
    PROGRAM = "mujoco_free_bodies", "mujoco"

    def test_conserves(self, example):
        for integrator in ("Euler", "implicitfast"):
            assert not kept(example.drift(integrator, exact=False, turns=1), 1e-3)
        assert kept(example.drift("Euler", exact=True, turns=1))

    def test_torques_and_gravity(self, example):
        """The center of mass falls as by the symplectic Euler method, though it is not the origin of the body."""
        mujoco, gravity, ends = example.mujoco, np.array([0.0, 0.0, -9.81]), []

        def other_half(model, data):
            mujoco.mj_applyFT(model, data, np.zeros(3), TORQUE / 2, np.zeros(3), 1, data.qfrc_passive)

        for h in KICKED:
            model = mujoco.MjModel.from_xml_string(example.SCENE)
            model.opt.timestep, model.opt.gravity[:] = h, gravity
            data, exact = mujoco.MjData(model), example.ExactRotation(model)
            data.qvel[:], data.xfrc_applied[1, 3:] = example.START, TORQUE / 2
            (body,) = exact.bodies
            inertia = body.axes @ np.diag(body.moments) @ body.axes.T
            q, w, position, velocity = body.read(data)
            expected = under_torque(inertia, example.matrix(q), w)
            mujoco.set_mjcb_passive(other_half)  # a user's callback is called too, and stays
            try:
                for _ in range(round(TIME / h)):
                    exact.step(data)
                assert mujoco.get_mjcb_passive() is other_half
            finally:
                mujoco.set_mjcb_passive(None)
            q, w, *center = body.read(data)
            ends.append((example.matrix(q), example.matrix(q) @ inertia @ w))
            fall = position + TIME * velocity + TIME * (TIME + h) / 2 * gravity
            assert np.allclose(center, (fall, velocity + TIME * gravity), rtol=0, atol=1e-12)
        has_order_two(ends, expected, below=1e-3)

    def test_contacts_and_other_bodies(self, example):
        """A box comes to rest on a plane beside a pendulum and a body with a child, which move as by `mj_step`."""
        mujoco = example.mujoco
        others = """
            <body pos="0 5 2"><joint axis="0 1 0"/><geom size="0.1" pos="1 0 0"/></body>
            <body pos="0 -5 9">
              <freejoint/><geom size="0.1"/><body><joint/><geom size="0.1" pos="0 1 0"/></body>
            </body>"""
        box = """<geom type="plane" size="9 9 1"/>
            <body pos="0 0 0.5" euler="20 10 5"><freejoint/><geom type="box" size="0.1 0.2 0.3"/></body>"""
        scene = '<mujoco><option timestep="0.002"/><worldbody>{}</worldbody></mujoco>'
        both, alone = (mujoco.MjModel.from_xml_string(scene.format(one)) for one in (box + others, others))
        exact, data, plain = example.ExactRotation(both), mujoco.MjData(both), mujoco.MjData(alone)
        data.qvel[3:6] = 1.0, 2.0, 3.0
        assert [body.dof for body in exact.bodies] == [0]
        for n in range(1000):
            exact.step(data)
            mujoco.mj_step(alone, plain)
            if n == 100:
                assert np.allclose(data.qpos[7:], plain.qpos, rtol=0, atol=1e-12)
        assert abs(data.qvel[:6]).max() < 1e-2 and abs(data.qpos[2] - 0.1) < 1e-2

    def test_what_would_be_wrong_is_refused(self, example):
        """Forces within a step, and passive forces without the callback; an armature is left to MuJoCo."""
        mujoco = example.mujoco
        model = mujoco.MjModel.from_xml_string(example.SCENE)
        model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
        with pytest.raises(ValueError, match="Euler"):
            example.ExactRotation(model)
        model.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER
        assert len(example.ExactRotation(model).bodies) == 1
        flags = mujoco.mjtDisableBit
        model.opt.disableflags = int(flags.mjDSBL_SPRING) | int(flags.mjDSBL_DAMPER)
        with pytest.raises(ValueError, match="callback"):
            example.ExactRotation(model)
        model.opt.disableflags = int(flags.mjDSBL_SPRING)
        model.dof_armature[:] = 0.1
        assert not example.ExactRotation(model).bodies


@pytest.mark.long
class TestMJX:
    PROGRAM = "mjx_free_body", "jax", "mujoco", "mujoco.mjx"

    def test_torques(self, example):
        """Without them, energy and angular momentum are kept."""
        jax, mjx, ends = example.jax, example.mjx, []
        model = example.mujoco.MjModel.from_xml_string(example.SCENE.format(integrator="Euler"))
        exact = example.ExactRotation(model)
        run = jax.jit(lambda scene, d, n: jax.lax.fori_loop(0, n, lambda _, d: exact.step(scene, d), d))
        start = mjx.make_data(model).replace(qpos=model.qpos0, qvel=np.array(example.START))
        kicked = start.replace(xfrc_applied=start.xfrc_applied.at[1, 3:].set(TORQUE))
        for h in KICKED:
            model.opt.timestep = h
            scene, steps = mjx.put_model(model), round(TIME / h)
            free = run(scene, start, steps)
            before, after = (example.energy_and_momentum(model, d.qpos, d.qvel) for d in (start, free))
            assert np.allclose(np.hstack(after), np.hstack(before), rtol=1e-13, atol=1e-12)
            assert not free.qfrc_applied.any()
            end = run(scene, kicked, steps)
            A, w = np.asarray(example.matrix(end.qpos[3:])), np.asarray(end.qvel[3:])
            ends.append((A, A @ exact.inertia @ w))
        expected = under_torque(exact.inertia, np.asarray(example.matrix(start.qpos[3:])), np.array(example.START[3:]))
        has_order_two(ends, expected, below=1e-3)


class TestDrake:
    PROGRAM = "drake_free_body", "pydrake"

    def test_conserves(self, example):
        assert not kept(example.drift(exact=False, turns=1), 1e-3)
        assert kept(example.drift(exact=True, turns=1))

    def test_torques(self, example):
        ends = []
        for h in KICKED:
            simulation = example.Simulation(exact=True, step=h)
            simulation.torque = TORQUE
            A, w, *_ = simulation.read()
            expected = under_torque(example.INERTIA, A, w)
            for _ in range(round(TIME / h)):
                simulation.step()
            A, w, position, velocity = simulation.read()
            assert np.allclose(position, TIME * example.VELOCITY, rtol=0, atol=1e-12)
            assert np.allclose(velocity, example.VELOCITY, rtol=0, atol=1e-12)
            ends.append((A, A @ example.INERTIA @ w))
        has_order_two(ends, expected, below=1e-3)


class TestBasilisk:
    PROGRAM = "basilisk_satellite", "Basilisk"

    def test_conserves(self, example):
        assert not kept(example.drift(exact=False, step=1.0, turns=2), 1e-7)
        assert kept(example.drift(exact=True, step=1.0, turns=2))

    def test_gravity_gradient(self, example):
        """The motion of Basilisk with small steps, to the second order; and not that of a free body."""

        def end(exact, step, gravity_gradient=True):
            simulation = example.Simulation(exact, step, gravity_gradient)
            for _ in range(round(40 / step)):
                simulation.step()
            A, momentum = simulation.read()
            return A, A @ momentum

        expected = end(False, 0.02)
        has_order_two([end(True, h) for h in (0.4, 0.2)], expected, below=1e-6)
        assert abs(end(True, 0.4, gravity_gradient=False)[1] - expected[1]).max() > 1e-4

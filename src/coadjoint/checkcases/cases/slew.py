"""A slew by quaternion feedback that a computer samples, with limits of the torque."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from coadjoint.checkcases.attitudes import body_invariants, quaternions, state_columns
from coadjoint.checkcases.check_case import ATTITUDE, RATES, BodyModel, CheckCase, Columns
from coadjoint.checkcases.integration import IntegratedMotion
from coadjoint.checkcases.registry import checkcase
from coadjoint.methods.protocol.method import Method
from coadjoint.methods.splitting import Splitting
from coadjoint.runs.integrate import prepare
from coadjoint.systems.bodies.body import body
from coadjoint.systems.forces.torque import Torque

Floats = npt.NDArray[np.float64]

METHODS: tuple[Method, Method] = (Splitting(order=8, parts="free_body"), Splitting(order=6, parts="free_body"))
INERTIA = np.array([110.0, 140.0, 90.0])
STIFFNESS, DAMPING, LIMIT, PERIOD, END = 8.0, 45.0, 1.5, 0.25, 60.0
STEPS_PER_PERIOD = 2
AXIS, ANGLE = np.array([2.0, -1.0, 2.0]) / 3.0, 2.4  # of the attitude at the start
RATES_AT_START = np.array([0.01, -0.02, 0.03])


def command(t: float, q: Floats, w: Floats, inertia: Floats) -> Floats:
    """Return the torque that the computer commands at a quaternion and rates."""
    sign = np.where(q[0] < 0.0, -1.0, 1.0)
    return np.clip(-2.0 * STIFFNESS * sign * q[1:] - DAMPING * w, -LIMIT, LIMIT)


class SampledMotion(IntegratedMotion):
    """Runs from each sample of the computer to the next, with a constant torque."""

    def states(self, times: Floats, method: Method) -> Floats:
        """Return the states at times in any order, (k, 12)."""
        # `Sampled` takes schemes of order two; a constant torque permits any.
        ready = prepare(self.system, method, self.step, inputs={"torque": "Torque"}, watch=False)
        x = self.x0
        sample = np.floor(times / PERIOD * (1.0 + 1e-12)).astype(int)
        states = np.empty((len(times), len(x)))
        for k in range(sample.max() + 1):
            span, q = (k * PERIOD, (k + 1) * PERIOD), quaternions(Rotation.from_matrix(x[3:12].reshape(3, 3)))
            torque = command(span[0], q, x[:3] / INERTIA, np.diag(INERTIA))
            wanted = np.flatnonzero(sample == k)
            order = wanted[np.argsort(times[wanted], kind="stable")]
            between = order[times[order] > span[0] * (1.0 + 1e-12)]
            states[np.setdiff1d(order, between)] = x
            if len(between):
                states[between] = ready.run(x, span, t_eval=times[between], torque=torque).x
            x = ready.end(x, span, torque=torque)
        return states


def _columns(x: Floats, t: Floats) -> Columns:
    return state_columns(x[:, :3] / INERTIA, x)


@checkcase
def slew() -> CheckCase:
    """Return a slew by quaternion feedback that is sampled, with limits of the torque."""
    start = Rotation.from_rotvec(ANGLE * AXIS)

    moving = body(INERTIA).with_forces(Torque((0.0, 0.0, 0.0)))
    x0 = np.asarray(moving.state(start, angular_velocity=RATES_AT_START))
    motion = SampledMotion(moving, x0, PERIOD / STEPS_PER_PERIOD, METHODS, _columns)
    times = np.linspace(0.0, END, 241)
    q = quaternions(start)
    model = BodyModel(np.diag(INERTIA), RATES_AT_START, attitude=q, torque=command, period=PERIOD)
    return CheckCase(
        name="slew",
        title="a slew by sampled quaternion feedback with limits of the torque",
        statement=(
            "I w' = (I w) x w + u and q' = q (0, w)/2. At each multiple of the period a computer reads w and q, "
            "and the torque u, in the body frame, is held until the next: u = - stiffness 2 sign(qw) (qx, qy, qz) "
            "- damping w, each component limited to +- limit. The wanted attitude is that of space, at rest. At t "
            "= 0 the body is turned from space by the angle about the axis (2, -1, 2)/3."
        ),
        parameters={
            "inertia": (INERTIA, "kg m^2"),
            "stiffness": (STIFFNESS, "N m/rad"),
            "damping": (DAMPING, "N m s/rad"),
            "limit": (LIMIT, "N m"),
            "period": (PERIOD, "s"),
            "angle": (ANGLE, "rad"),
            "rates": (RATES_AT_START, "rad/s"),
            "end": (END, "s"),
        },
        quantities=(RATES, ATTITUDE),
        motion=motion,
        times=times,
        accuracy=1e-11,
        basis=(
            "this library, splittings of orders 8 and 6 with an exact free body between samples, and a Taylor "
            "series agree"
        ),
        source="B. Wie, P. M. Barba, Quaternion feedback for spacecraft large angle maneuvers, J. Guidance 8 (1985)",
        invariants=body_invariants(model),
        body=model,
    )

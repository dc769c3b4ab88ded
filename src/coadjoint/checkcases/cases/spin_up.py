"""Spin-up of a symmetric body by a constant torque."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from coadjoint.checkcases.attitudes import body_invariants, state_columns
from coadjoint.checkcases.check_case import ATTITUDE, RATES, BodyModel, CheckCase, Columns, sample_times
from coadjoint.checkcases.integration import IntegratedMotion
from coadjoint.checkcases.registry import checkcase
from coadjoint.methods.splitting import Splitting
from coadjoint.systems.bodies.body import body
from coadjoint.systems.bodies.inertia import read_vector
from coadjoint.systems.forces.torque import Torque
from coadjoint.validation import read_positive

METHODS = (Splitting(order=8, parts="free_body"), Splitting(order=6, parts="free_body"))
STEPS_PER_RADIAN = 4.0  # of the fastest rotation


@checkcase
def spin_up(
    transverse: float = 2.0,
    axial: float = 1.5,
    torque: npt.ArrayLike = (0.3, 0.0, 0.2),
    rates: npt.ArrayLike = (0.0, 0.0, 0.5),
    end: float = 30.0,
    samples: int = 301,
) -> CheckCase:
    """Return the spin-up of a symmetric body by a torque that is constant in the body frame.

    Parameters
    ----------
    transverse, axial : float
        Moments of inertia across the axis of symmetry and about it, kg m^2.
    torque : (3,)
        External torque in the body frame, N m.
    rates, end, samples
        As of `free_body`.
    """
    across, along = read_positive(transverse, "transverse"), read_positive(axial, "axial")
    moment, w, last = read_vector(torque, "torque"), read_vector(rates, "rates"), read_positive(end, "end")
    moments = np.array([across, across, along])
    fastest = float(np.linalg.norm(moments * w) + np.linalg.norm(moment) * last) / moments.min()
    moving = body(moments).with_forces(Torque(tuple(moment.tolist())))
    x0 = np.concatenate([moments * w, np.eye(3).ravel()])

    def columns(x: npt.NDArray[np.float64], t: npt.NDArray[np.float64]) -> Columns:
        return state_columns(x[:, :3] / moments, x)

    motion = IntegratedMotion(moving, x0, 1.0 / (STEPS_PER_RADIAN * fastest), METHODS, columns)
    model = BodyModel(
        np.diag(moments), w, torque=lambda t, q, w, inertia: np.multiply.outer(moment, np.ones(w.shape[1:]))
    )
    times = sample_times(last, samples)
    return CheckCase(
        name="spin_up",
        title="spin-up of a symmetric body by a constant torque",
        statement=(
            "I w' = (I w) x w + torque and q' = q (0, w)/2, with I = diag(transverse, transverse, axial) and a "
            "torque that is constant in the body frame. So wz = wz(0) + torque_z t/axial, and wx + i wy is an "
            "integral of a chirp, in terms of Fresnel integrals. At t = 0 q = (1, 0, 0, 0), from the body to space."
        ),
        parameters={
            "transverse": (across, "kg m^2"),
            "axial": (along, "kg m^2"),
            "torque": (moment, "N m"),
            "rates": (w, "rad/s"),
            "end": (last, "s"),
        },
        quantities=(RATES, ATTITUDE),
        motion=motion,
        times=times,
        accuracy=1e-11,
        basis=(
            "this library, splittings of orders 8 and 6 with an exact free body, and a Taylor series agree; so do "
            "the rates by Fresnel integrals"
        ),
        source=(
            "J. M. Longuski, Real solutions for the attitude motion of a self-excited rigid body, Acta "
            "Astronautica 25 (1991)"
        ),
        invariants=body_invariants(model),
        body=model,
    )

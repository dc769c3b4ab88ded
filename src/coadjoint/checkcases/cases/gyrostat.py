"""A body with a rotor along one principal axis."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from coadjoint.checkcases.attitudes import body_invariants
from coadjoint.checkcases.check_case import ATTITUDE, RATES, BodyModel, CheckCase, sample_times
from coadjoint.checkcases.registry import checkcase
from coadjoint.checkcases.rotating import with_axes
from coadjoint.systems.bodies.inertia import read_vector
from coadjoint.validation import read_number, read_positive

STEPS_PER_RADIAN = 20.0  # of the fastest rotation


@checkcase
def gyrostat(
    inertia: npt.ArrayLike = (10.0, 14.0, 20.0),
    rotor: float = 3.0,
    rates: npt.ArrayLike = (0.4, 0.0, 0.1),
    end: float = 60.0,
    samples: int = 301,
) -> CheckCase:
    """Return a body with a rotor along its third axis, whose relative momentum is constant.

    Parameters
    ----------
    inertia : (3,)
        Principal moments with the rotor locked, kg m^2.
    rotor : float
        Angular momentum of the rotor relative to the body, along the third axis, kg m^2/s.
    rates, end, samples
        As of `free_body`.
    """
    moments, w, last = read_vector(inertia, "inertia"), read_vector(rates, "rates"), read_positive(end, "end")
    k = np.array([0.0, 0.0, read_number(rotor, "rotor")])
    tensor = np.diag([read_positive(v, "inertia") for v in moments.tolist()])
    fastest = float(np.linalg.norm(moments * w + k) / moments.min() + np.linalg.norm(w))
    motion = with_axes(tensor, w, np.eye(3), 1.0 / (STEPS_PER_RADIAN * fastest or 1.0), rotors=k)
    times = sample_times(last, samples)
    model = BodyModel(tensor, w, rotors=k)
    return CheckCase(
        name="gyrostat",
        title="a body with a rotor along its third axis",
        statement=(
            "I w' = (I w + k) x w and q' = q (0, w)/2, with the momentum k = (0, 0, rotor) of a rotor relative to "
            "the body, which a motor keeps constant. w is the angular velocity of the body in the body frame. The "
            "momentum I w + k is constant in space. At t = 0 q = (1, 0, 0, 0), from the body to space."
        ),
        parameters={
            "inertia": (moments, "kg m^2"),
            "rotor": (k[2], "kg m^2/s"),
            "rates": (w, "rad/s"),
            "end": (last, "s"),
        },
        quantities=(RATES, ATTITUDE),
        motion=motion,
        times=times,
        accuracy=1e-11,
        basis="this library, Gauss-Legendre methods of orders 16 and 12, and a Taylor series agree",
        source="J. Wittenburg, Dynamics of Multibody Systems (2008), section 4.6",
        invariants=body_invariants(model),
        body=model,
    )

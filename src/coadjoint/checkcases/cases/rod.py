"""A rod without a moment about its axis."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from coadjoint.checkcases.attitudes import body_columns, body_invariants
from coadjoint.checkcases.check_case import ATTITUDE, RATES, BodyModel, CheckCase, Columns, sample_times
from coadjoint.checkcases.registry import checkcase
from coadjoint.systems.closed_forms.free_rigid_body import fixed_axis
from coadjoint.validation import read_number, read_positive


@checkcase
def rod(
    moment: float = 0.1, rate_y: float = 3.0, rate_z: float = -4.0, end: float = 20.0, samples: int = 201
) -> CheckCase:
    """Return a free thin rod along the first axis, whose moment about that axis is zero.

    Parameters
    ----------
    moment : float
        Moment of inertia across the rod, kg m^2.
    rate_y, rate_z : float
        Angular velocity at the start, in the body frame, rad/s; along the rod it is zero.
    end, samples
        As of `free_body`.
    """
    across, last = read_positive(moment, "moment"), read_positive(end, "end")
    w = np.array([0.0, read_number(rate_y, "rate_y"), read_number(rate_z, "rate_z")])

    def motion(t: np.ndarray) -> Columns:
        return body_columns(np.tile(w, (len(t), 1)), Rotation.from_matrix(fixed_axis(w, t)))

    body = BodyModel(np.diag([0.0, across, across]), w, is_free=True)
    return CheckCase(
        name="rod",
        title="a free thin rod, whose moment about its axis is zero",
        statement=(
            "The rod lies along the first axis of the body: I = diag(0, moment, moment), and wx = 0. It turns "
            "about the fixed angular momentum at a constant rate. A simulator that needs a positive tensor may "
            "take any small moment about the first axis, since wx stays 0. At t = 0 q = (1, 0, 0, 0), from the "
            "body to space."
        ),
        parameters={
            "moment": (across, "kg m^2"),
            "rate_y": (w[1], "rad/s"),
            "rate_z": (w[2], "rad/s"),
            "end": (last, "s"),
        },
        quantities=(RATES, ATTITUDE),
        motion=motion,
        times=sample_times(last, samples),
        accuracy=1e-12,
        basis="closed form, a rotation about a fixed axis",
        source="L. D. Landau, E. M. Lifshitz, Mechanics (1976), section 33",
        invariants=body_invariants(body),
        body=body,
    )

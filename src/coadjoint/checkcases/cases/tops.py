"""Heavy tops with a fixed point: Lagrange's and Kovalevskaya's."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from coadjoint.checkcases.altered_motions import cross, matrix_of
from coadjoint.checkcases.attitudes import body_invariants, quaternions
from coadjoint.checkcases.check_case import ATTITUDE, RATES, BodyModel, CheckCase, DerivedQuantity, sample_times
from coadjoint.checkcases.registry import checkcase
from coadjoint.checkcases.rotating import with_axes
from coadjoint.systems.bodies.inertia import read_vector
from coadjoint.validation import read_number, read_positive

Floats = npt.NDArray[np.float64]

STATEMENT = (
    "I w' = (I w) x w + weight * (A^T z) x centre and q' = q (0, w)/2, with the matrix A of the attitude q, from "
    "the body to space, the vertical z = (0, 0, 1) of space, upward, and the centre of mass, in the body frame "
    "from the fixed point. I is the tensor about the fixed point, and the weight is mass times gravity, downward. "
    "At t = 0 the body is turned from space about the first axis by the tilt."
)
STEPS_PER_RADIAN = 20.0  # of the fastest rotation that the energy permits


def top_case(
    name: str,
    title: str,
    moments: Floats,
    weight: float,
    centre: Floats,
    rates: npt.ArrayLike,
    tilt: float,
    end: float,
    samples: int,
    statement: str,
    source: str,
) -> CheckCase:
    """Return the case of a heavy top."""
    w, angle, last = read_vector(rates, "rates"), read_number(tilt, "tilt"), read_positive(end, "end")
    tensor, lever = np.diag(moments), read_positive(weight, "weight") * centre
    c, s = math.cos(angle), math.sin(angle)
    A = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    energy = 0.5 * float(moments @ w**2) + 2.0 * float(np.linalg.norm(lever))
    fastest = math.sqrt(2.0 * energy / moments.min())
    motion = with_axes(tensor, w, A, 1.0 / (STEPS_PER_RADIAN * fastest), lever=lever)

    def torque(t: float, q: Floats, rates: Floats, inertia: Floats) -> Floats:
        return cross(matrix_of(q)[2], lever)

    model = BodyModel(
        tensor,
        w,
        attitude=quaternions(Rotation.from_matrix(A)),
        torque=torque,
        potential=lambda matrices: matrices[:, 2] @ lever,
    )
    energy_of_body, in_space = body_invariants(model)
    invariants = (
        energy_of_body._replace(size=float(np.linalg.norm(lever))),
        DerivedQuantity(
            "vertical momentum",
            "kg m^2/s",
            lambda columns: in_space.function(columns)[:, 2],
            in_space.quantities,
            float(np.linalg.norm(moments * w)),
        ),
    )
    times = sample_times(last, samples)
    return CheckCase(
        name=name,
        title=title,
        statement=f"{STATEMENT} {statement}",
        parameters={
            "inertia": (moments, "kg m^2"),
            "weight": (float(weight), "N"),
            "centre": (centre, "m"),
            "rates": (w, "rad/s"),
            "tilt": (angle, "rad"),
            "end": (last, "s"),
        },
        quantities=(RATES, ATTITUDE),
        motion=motion,
        times=times,
        accuracy=1e-11,
        basis="this library, Gauss-Legendre methods of orders 16 and 12, and a Taylor series agree",
        source=source,
        invariants=invariants,
        body=model,
    )


@checkcase
def lagrange_top(
    equatorial: float = 0.002,
    axial: float = 0.0008,
    weight: float = 4.905,
    height: float = 0.05,
    rates: npt.ArrayLike = (0.0, 0.0, 60.0),
    tilt: float = 0.5,
    end: float = 3.0,
    samples: int = 301,
) -> CheckCase:
    """Return Lagrange's top: a symmetric top that precesses and nutates.

    Parameters
    ----------
    equatorial, axial : float
        Moments of inertia about the fixed point, across the axis of symmetry and about it, kg m^2.
    weight : float
        Mass times gravity, N.
    height : float
        Distance of the centre of mass from the fixed point, along the third axis, m.
    rates : (3,)
        Angular velocity at the start, in the body frame, rad/s.
    tilt : float
        Angle of the axis from the vertical at the start, rad.
    end, samples
        As of `free_body`.
    """
    across, along = read_positive(equatorial, "equatorial"), read_positive(axial, "axial")
    return top_case(
        "lagrange_top",
        "Lagrange's top, which precesses and nutates",
        np.array([across, across, along]),
        weight,
        np.array([0.0, 0.0, read_positive(height, "height")]),
        rates,
        tilt,
        end,
        samples,
        "The third axis is one of symmetry; wz, the energy and the vertical momentum are constant, and the tilt is an "
        "elliptic function.",
        "E. T. Whittaker, Analytical Dynamics (1937), section 71",
    )


@checkcase
def kovalevskaya_top(
    axial: float = 1.0,
    weight: float = 9.80665,
    distance: float = 0.2,
    rates: npt.ArrayLike = (0.5, -1.0, 2.0),
    tilt: float = 0.7,
    end: float = 10.0,
    samples: int = 301,
) -> CheckCase:
    """Return Kovalevskaya's top, whose equatorial moments are twice the axial one.

    Parameters
    ----------
    axial : float
        Moment of inertia about the third axis, through the fixed point, kg m^2; the other two are twice as large.
    weight : float
        Mass times gravity, N.
    distance : float
        Distance of the centre of mass from the fixed point, along the first axis, m.
    rates, tilt, end, samples
        As of `lagrange_top`.
    """
    along = read_positive(axial, "axial")
    return top_case(
        "kovalevskaya_top",
        "Kovalevskaya's top",
        np.array([2.0 * along, 2.0 * along, along]),
        weight,
        np.array([read_positive(distance, "distance"), 0.0, 0.0]),
        rates,
        tilt,
        end,
        samples,
        "Besides the energy and the vertical momentum |(wx + i wy)^2 - (weight distance/axial) (gx + i gy)|^2 is "
        "constant, with g = A^T z.",
        "S. Kovalevskaya, Sur le probleme de la rotation d'un corps solide autour d'un point fixe, Acta Math. 12 "
        "(1889)",
    )

"""Free bodies: three moments at any speed, and a tensor with products of inertia."""

from __future__ import annotations

import math
from functools import partial

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from coadjoint.checkcases.attitudes import as_tensor, body_invariants, free_columns, rotations_of, stacked
from coadjoint.checkcases.check_case import ATTITUDE, RATES, BodyModel, CheckCase, sample_times
from coadjoint.checkcases.registry import checkcase
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.systems.bodies.inertia import read_vector
from coadjoint.systems.bodies.rigid_body import rigid_body
from coadjoint.validation import read_positive

FREE = (
    "I w' = (I w) x w and q' = q (0, w)/2: no torque acts. I is the inertia tensor in the body frame, w the angular "
    "velocity in the body frame, and q the attitude, from the body to space. At t = 0 the axes of the body are those "
    "of space, q = (1, 0, 0, 0)."
)
CLOSED_FORM = "closed form, Jacobi's elliptic functions and an integral of the third kind, in interval arithmetic"
WHITTAKER = "E. T. Whittaker, Analytical Dynamics (1937), section 69"
LEAST_ACCURACY = 1e-12
ROUNDINGS = 20.0  # of float64 in the start, of which the error of the reference consists
PERTURBATION = 1e-8  # relative; far above rounding, and small enough to be multiplied by 10^5
PROBED_TIMES = 41


def free_case(
    name: str,
    title: str,
    inertia: npt.ArrayLike,
    rates: npt.ArrayLike,
    end: float,
    samples: int,
    source: str = WHITTAKER,
    principal_axes: npt.NDArray[np.float64] | None = None,
    **others: object,
) -> CheckCase:
    """Return the case of a free body, whose moments or tensor and rates are validated here."""
    start, last = read_vector(rates, "rates"), read_positive(end, "end")
    rigid_body(inertia)  # validates the inertia
    tensor = as_tensor(inertia)
    body = BodyModel(tensor, start, is_free=True, principal_axes=principal_axes)
    given = np.asarray(inertia, dtype=np.float64)
    times = sample_times(last, samples)
    fields = {
        "statement": FREE,
        "parameters": {"inertia": (given, "kg m^2"), "rates": (start, "rad/s"), "end": (last, "s")},
        "accuracy": accuracy_of(tensor, start, np.linspace(0.0, last, PROBED_TIMES)),
        "basis": CLOSED_FORM,
        "source": source,
        **others,
    }
    return CheckCase(
        name=name,
        title=title,
        quantities=(RATES, ATTITUDE),
        motion=partial(free_columns, tensor, start),
        times=times,
        invariants=body_invariants(body),
        body=body,
        **fields,  # type: ignore[arg-type]
    )


def accuracy_of(
    tensor: npt.NDArray[np.float64], rates: npt.NDArray[np.float64], times: npt.NDArray[np.float64]
) -> float:
    """Return a bound of the errors of a reference, a power of ten: rounding of the start, as the motion spreads it."""
    certain, growth = free_columns(tensor, rates, times), 0.0
    size = float(np.linalg.norm(rates))
    for k in range(3) if size else ():
        moved = free_columns(tensor, rates + PERTURBATION * size * np.eye(3)[k], times)
        turned = float((rotations_of(moved).inv() * rotations_of(certain)).magnitude().max())
        change = stacked(moved, RATES.columns) - stacked(certain, RATES.columns)
        growth = max(growth, turned, float(np.linalg.norm(change, axis=1).max()) / size)
    error = ROUNDINGS * UNIT_ROUNDOFF * growth / PERTURBATION
    return max(LEAST_ACCURACY, float(f"1e{math.ceil(math.log10(error))}") if error else 0.0)


@checkcase
def free_body(
    inertia: npt.ArrayLike = (1.0, 2.0, 2.5),
    rates: npt.ArrayLike = (1.0, 2.0, 0.5),
    end: float = 20.0,
    samples: int = 201,
) -> CheckCase:
    """Return a free body with three different moments of inertia, at any speed.

    Parameters
    ----------
    inertia : (3,) or (3, 3)
        Principal moments, or the tensor, kg m^2.
    rates : (3,)
        Angular velocity at the start, in the body frame, rad/s.
    end : float
        Last time, s.
    samples : int
        Count of times.
    """
    return free_case("free_body", "a free body of three different moments of inertia", inertia, rates, end, samples)


@checkcase
def free_body_products(
    moments: npt.ArrayLike = (1.0, 2.0, 2.5),
    rotation: npt.ArrayLike = (0.3, -0.5, 0.2),
    rates: npt.ArrayLike = (1.0, 2.0, 0.5),
    end: float = 20.0,
    samples: int = 201,
) -> CheckCase:
    """Return a free body whose tensor has products of inertia, of a stated sign.

    Parameters
    ----------
    moments : (3,)
        Principal moments, kg m^2.
    rotation : (3,)
        Rotation vector of R, which turns the axes of the body into the principal axes, rad.
    rates, end, samples
        As of `free_body`.
    """
    R = Rotation.from_rotvec(read_vector(rotation, "rotation")).as_matrix()
    principal = read_vector(moments, "moments")
    tensor = R @ (principal[:, None] * R.T)
    tensor = (tensor + tensor.T) / 2.0
    statement = (
        f"{FREE} The tensor is I = R diag(moments) R^T, with R the matrix of the rotation vector, whose columns are "
        "the principal axes in the body frame. Its elements off the diagonal are I_xy = - integral of x y dm, the "
        "negative products: I is the matrix that multiplies w."
    )
    parameters = {
        "moments": (principal, "kg m^2"),
        "rotation": (read_vector(rotation, "rotation"), "rad"),
        "rates": (read_vector(rates, "rates"), "rad/s"),
        "end": (float(end), "s"),
        "inertia": (tensor, "kg m^2"),
    }
    return free_case(
        "free_body_products",
        "a free body whose tensor has products of inertia",
        tensor,
        rates,
        end,
        samples,
        principal_axes=R,
        statement=statement,
        parameters=parameters,
    )

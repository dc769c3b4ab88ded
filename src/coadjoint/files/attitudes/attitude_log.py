"""Logs of attitudes: times, rotations and angular velocities, with the names of their frames."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from coadjoint.keyword_hints import suggest_keywords
from coadjoint.runs.results.solution import check_solution
from coadjoint.short_repr import short
from coadjoint.systems.orbits.epochs import Epoch
from coadjoint.validation import read_finite, read_title, set_fields

Floats = NDArray[np.float64]

UNIT = 1e-2
"""Deviation of the length of a quaternion from 1 that is taken for rounding, as of a log with three digits."""


@suggest_keywords
@dataclass(frozen=True, eq=False, repr=False)
class AttitudeLog:
    """Attitudes of a body at times, read from a file by `co.attitudes.read`, or of a solution.

    Parameters
    ----------
    t : (k,)
        Times in seconds, ascending.
    rotation : scipy.spatial.transform.Rotation, (k, 3, 3) or (k, 4)
        Attitudes from the body to space; numbers in rows of four are quaternions x, y, z, w.
    angular_velocity : (k, 3), optional
        In the body frame, in radians per second.
    frame : str
        Name of the frame of space, such as "J2000".
    body : str
        Name of the frame of the body.
    epoch : str, datetime.datetime or Epoch, optional
        Date at t = 0, in UTC if it is text.

    Raises
    ------
    ValueError, TypeError
        Times that do not ascend, other shapes, or numbers that are no rotations.

    Examples
    --------
    >>> import coadjoint as co
    >>> sat = co.systems.body((1.0, 2.0, 2.5))
    >>> sol = co.integrate(sat, sat.state(angular_velocity=(0.1, 0.2, 0.3)), (0, 10), 0.5)
    >>> co.attitudes.AttitudeLog.of(sol, frame="J2000", epoch="2026-03-01T00:00:00")
    <21 attitudes of SC_BODY_1 in J2000, t = 0 to 10, t = 0 at 2026-03-01T00:00:00 UTC>
    """

    t: Floats
    rotation: Any
    angular_velocity: Floats | None = None
    frame: str = ""
    body: str = "SC_BODY_1"
    epoch: Any = None

    def __post_init__(self) -> None:
        from coadjoint.systems.bodies.body_systems import read_attitudes

        times = read_finite(self.t, "t of a log")
        if times.ndim != 1 or not len(times) or not (np.diff(times) > 0.0).all():
            raise ValueError(f"t of a log is {short(times.tolist())}; give times that ascend, (k,)")
        matrices = read_attitudes(self.rotation, "rotation of a log", (), False)
        if matrices.shape != (len(times), 3, 3):
            raise ValueError(f"rotation of a log has the shape {matrices.shape}; t has {len(times)} times")
        omega = None
        if self.angular_velocity is not None:
            omega = read_finite(self.angular_velocity, "angular_velocity of a log")
            if omega.shape != (len(times), 3):
                raise ValueError(f"angular_velocity of a log has the shape {omega.shape}; give ({len(times)}, 3)")
        if self.frame:
            read_title(self.frame, "frame of a log")
        set_fields(
            self,
            t=times,
            rotation=rotations(matrices) if not hasattr(self.rotation, "as_quat") else self.rotation,
            angular_velocity=omega,
            body=read_title(self.body, "body of a log"),
            epoch=None if self.epoch is None else Epoch.read(self.epoch, "epoch of a log"),
        )

    def __repr__(self) -> str:
        space = f" in {self.frame}" if self.frame else ""
        dated = f", t = 0 at {self.epoch}" if self.epoch else ""
        return f"<{len(self.t)} attitudes of {self.body}{space}, t = {self.t[0]:g} to {self.t[-1]:g}{dated}>"

    @classmethod
    def of(cls, solution: Any, *, frame: str = "", body: str = "SC_BODY_1", epoch: Any = None) -> Self:
        """Return the attitudes and angular velocities of a solution of one body.

        Parameters
        ----------
        solution : Solution
            A run of one body with its attitude, and one member.
        frame, body : str
            Names of the frames of space and of the body.
        epoch : str, datetime.datetime or Epoch, optional
            Date at t = 0.

        Returns
        -------
        AttitudeLog

        Raises
        ------
        ValueError
            A solution of several members or bodies, or one without attitudes.
        """
        check_solution(solution)
        times, found = np.asarray(solution.t), solution.rotation
        if np.ndim(solution.x) != 2 or len(found) != len(times):
            raise ValueError(
                f"the solution has {len(found)} attitudes at {len(times)} times; give that of one member and one body"
            )
        order = slice(None, None, -1) if len(times) > 1 and times[1] < times[0] else slice(None)
        return cls(times[order], found[order], np.asarray(solution.angular_velocity)[order], frame, body, epoch)

    @property
    def t_span(self) -> tuple[float, float]:
        """First and last time."""
        return float(self.t[0]), float(self.t[-1])


def rotations(matrices: Floats) -> Any:
    """Return matrices as rotations of SciPy."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_matrix(matrices)


def rotations_of(quaternions: Floats, where: Any) -> Any:
    """Return quaternions x, y, z, w as rotations; ValueError with the place of one that is none."""
    from scipy.spatial.transform import Rotation

    lengths = np.sqrt((quaternions * quaternions).sum(axis=1))
    wrong = np.flatnonzero(~(np.abs(lengths - 1.0) <= UNIT))
    if len(wrong):
        k = int(wrong[0])
        raise ValueError(
            f"{where(k)}: {short(quaternions[k].tolist())} is no unit quaternion, its length is {lengths[k]:.4g}"
        )
    return Rotation.from_quat(quaternions)

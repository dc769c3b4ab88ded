"""Attributes of solutions of bodies: positions, velocities, rotations, angular velocities and momenta."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from numpy.typing import NDArray

from coadjoint.runs.results.solution_attributes import SolutionAttributes, member_count, members_text, missing_attitude
from coadjoint.validation import read_numbers

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

ORTHOGONALITY = 1e-6
"""Largest deviation from orthogonality of attitudes that are taken for rotations."""


class BodyMotion(SolutionAttributes):
    """Base class of `Solution` with the motion of bodies."""

    @property
    def positions(self) -> NDArray[np.float64]:
        """The positions of the centres of bodies in space.

        Returns
        -------
        ndarray, shape (times, k, 3) or (times, members, k, 3)

        Raises
        ------
        TypeError
            The system is not one of bodies with positions, such as `gravitating_bodies`.
        """
        return self._of_bodies("positions", "positions; take co.systems.bodies or gravitating_bodies")

    @property
    def velocities(self) -> NDArray[np.float64]:
        """The velocities of the centres of bodies in space.

        Returns
        -------
        ndarray, shape (times, k, 3) or (times, members, k, 3)

        Raises
        ------
        TypeError
            The system is not one of bodies with positions, such as `gravitating_bodies`.
        """
        return self._of_bodies("velocities", "velocities; take co.systems.bodies or gravitating_bodies")

    @property
    def angular_velocity(self) -> NDArray[np.float64]:
        """The angular velocity in the frame of the body, in radians per time.

        That of classical bodies and tops is the derivative of the energy by the momentum. For components in space take
        ``sol.in_space(sol.angular_velocity)``.

        Returns
        -------
        ndarray, shape (times, 3), (times, k, 3), or with an axis of members after the times

        Raises
        ------
        TypeError
            The system is not a body, such as `body` or `gravitating_bodies`.

        Examples
        --------
        >>> import coadjoint as co
        >>> body = co.systems.body((1.0, 2.0, 2.5))
        >>> x0 = body.state(angular_velocity=(0.0, 0.0, 90.0), degrees=True)
        >>> co.integrate(body, x0, (0, 1), 0.1).angular_velocity[-1].round(6)
        array([0.      , 0.      , 1.570796])
        """
        return self._of_bodies("angular_velocity", "angular velocity; take co.systems.body")

    @property
    def angular_momentum(self) -> NDArray[np.float64]:
        """The angular momentum about the centre of mass, in the frame of the body.

        For components in space take ``sol.in_space(sol.angular_momentum)``. That of classical bodies and tops is the
        first part of the state, and that of a fluid on a sphere its own.

        Returns
        -------
        ndarray, shape (times, 3), (times, k, 3), or with an axis of members after the times

        Raises
        ------
        TypeError
            The system is not a body, such as `body` or `gravitating_bodies`.
        """
        return self._of_bodies("angular_momentum", "angular momentum of bodies; take co.systems.body")

    @property
    def rotation(self) -> Rotation:
        """The attitude as rotations of SciPy, from the body to space: the group element, or its first block.

        Systems with attitudes in their states, such as `body`, have it in every run. For other bodies and tops it is
        the group element, or its first block, of runs with ``attitude=True``.

        Returns
        -------
        scipy.spatial.transform.Rotation
            One rotation for each saved time; for an ensemble one for each time and member, (times * members,), the
            members at the first time first; for k bodies one for each of them, the last axis, (times * k,).

        Raises
        ------
        TypeError
            The run has no attitude, or the attitude is not a rotation in three dimensions.
        ValueError
            Members have no attitude at some times.

        Examples
        --------
        >>> import coadjoint as co
        >>> body = co.systems.rigid_body(inertia=(1, 2, 3))
        >>> sol = co.integrate(body, (1.0, 0, 0), t_span=(0, 1), step=0.1, attitude=True)
        >>> sol.rotation[-1].as_rotvec().round(12)
        array([1., 0., 0.])
        """
        from scipy.spatial.transform import Rotation

        return Rotation.from_matrix(self._rotations().reshape(-1, 3, 3))

    def in_space(self, vectors: npt.ArrayLike) -> NDArray[np.float64]:
        """Return vectors in the frame of the body as components in space, by the attitude at the saved times.

        Parameters
        ----------
        vectors : (3,), or the shape of `angular_velocity`
            A direction fixed in the body, such as that of an instrument, or vectors at the saved times.

        Returns
        -------
        ndarray, shape (times, 3), (times, k, 3), or with an axis of members after the times

        Raises
        ------
        TypeError, ValueError
            As for `rotation`, and for vectors of another shape.

        Examples
        --------
        The angular momentum of a free body is constant in space:

        >>> import coadjoint as co
        >>> body = co.systems.rigid_body(inertia=(1, 2, 3))
        >>> sol = co.integrate(body, (1.0, 0.2, 0.5), t_span=(0, 1), step=0.1, attitude=True)
        >>> sol.in_space(sol.angular_momentum)[-1].round(12)
        array([1. , 0.2, 0.5])
        """
        A, v = self._rotations(), read_numbers(vectors, "vectors")
        if v.shape not in ((3,), A.shape[:-1]):
            raise ValueError(f"vectors has shape {v.shape}; give (3,) or {A.shape[:-1]}")
        return np.einsum("...ij,...j->...i", A, v)

    def _rotations(self) -> NDArray[np.float64]:
        """Return the attitudes from the body to space, (times, 3, 3), with axes of members and bodies inside."""
        if getattr(self.system.unforced, "has_attitude", False):
            A: Any = self._of_bodies("attitudes", "attitude")
        else:
            if self.carried is None:
                raise TypeError(f"no rotation is known: {missing_attitude(self)}")
            A = rotations_of(self.attitude) if self.carried == "representation" else None
            if A is None:
                carried = "coadjoint matrices" if self.carried == "coadjoint" else "group elements"
                raise TypeError(
                    f"the {carried} of {self.system.name} are no rotations in three dimensions; integrate a body or a "
                    "top with attitude=True"
                )
        members = member_count(self)  # type: ignore[arg-type]
        lost = ~np.isfinite(A.reshape(len(A), members, -1)).all(axis=(0, -1))
        if lost.any():
            raise ValueError(
                f"attitudes of {members_text(lost)} are missing at some times, since these have not run so "
                "far, have failed, or were ended by events; take Rotation.from_matrix of attitude[:, m] of the others"
            )
        return np.asarray(A)

    def _of_bodies(self, name: str, what: str) -> NDArray[np.float64]:
        """Return what the system of each member reads from its states, over times (and members)."""
        functions = [
            getattr(one.unforced, name, None) for one in (self.system if self.system.is_batch else (self.system,))
        ]
        if None in functions:
            raise TypeError(f"the states of {self.system.name} have no {what}")
        if not self.system.is_batch:
            return np.asarray(functions[0](self.x))  # type: ignore[misc]
        return np.stack([read(self.x[:, m]) for m, read in enumerate(functions)], axis=1)  # type: ignore[misc]


def rotations_of(attitude: Any) -> NDArray[np.float64] | None:
    """Return group elements (..., d, d), or their rotation block, as matrices (..., 3, 3); None if it is none."""
    d = attitude.shape[-1]
    if d not in (3, 4, 5) or np.iscomplexobj(attitude) or (d == 5 and np.any(np.abs(attitude[..., 1:, 0]) > 0.0)):
        return None
    A = np.asarray(attitude)[..., 1:4, 1:4] if d == 5 else np.asarray(attitude)[..., :3, :3]
    ends = np.stack([A[0], A[-1]])
    with np.errstate(all="ignore"):
        products = ends @ np.swapaxes(ends, -1, -2)
    finite = products[np.isfinite(products).all(axis=(-1, -2))]  # members that have failed are not tested
    return A if np.abs(finite - np.eye(3)).max(initial=0.0) < ORTHOGONALITY else None

"""Bodies and tops whose states begin with an angular momentum in the frame of the body: velocities and momenta."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from coadjoint.systems.bodies.body_states import read_states
from coadjoint.systems.energy_derivatives import gradients_at
from coadjoint.systems.forces.body_torque import velocity_map
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.validation import read_numbers

Floats = npt.NDArray[np.float64]


class ClassicalBody(LiePoissonSystem):
    """One body with its angular momentum as the first three coordinates, and an energy quadratic in it."""

    bodies: tuple[int, ...] = ()

    @property
    def _kind(self) -> type[LiePoissonSystem]:
        return LiePoissonSystem  # it only adds functions of the state

    def angular_momentum(self, x: npt.ArrayLike) -> Floats:
        """Return the angular momentum in the body frame: the first part of the state.

        Parameters
        ----------
        x : (..., dim)
            States.

        Returns
        -------
        ndarray, shape (..., 3)
        """
        return read_states(self, x)[..., :3]

    def angular_velocity(self, x: npt.ArrayLike) -> Floats:
        """Return the angular velocity in the body frame, the derivative of the energy by the momentum.

        Parameters
        ----------
        x : (..., dim)
            States.

        Returns
        -------
        ndarray, shape (..., 3)
            In radians per time.
        """
        states = read_states(self, x)
        gradients = gradients_at(self, states.reshape(1, -1, self.dim), np.zeros(1))
        return np.asarray(gradients[0, :, :3].reshape(*states.shape[:-1], 3))

    def momentum(self, angular_velocity: npt.ArrayLike) -> Floats:
        """Return the angular momentum in the body frame for an angular velocity in the body frame.

        Parameters
        ----------
        angular_velocity : (..., 3)
            In radians per time.

        Returns
        -------
        ndarray, of the same shape

        Raises
        ------
        TypeError
            The angular velocity also depends on other coordinates, as in a fluid.
        ValueError
            The wrong shape.

        Examples
        --------
        >>> import coadjoint as co
        >>> body = co.systems.gyrostat((1.0, 2.0, 2.5), rotors=(0.0, 0.0, 2.0))
        >>> body.momentum((1.0, 0.5, -0.4)).round(12)
        array([1., 1., 1.])
        """
        omega = read_numbers(angular_velocity, "angular_velocity")
        if omega.shape[-1:] != (3,):
            raise ValueError(f"angular_velocity has shape {omega.shape}; give (..., 3)")
        W, at_rest = velocity_map(self)
        if W[:, 3:].any():
            raise TypeError(
                f"the angular velocity of {self.name} depends on all coordinates, not on the angular momentum alone; "
                "give momenta in the state itself"
            )
        return np.asarray(np.einsum("ij,...j->...i", np.linalg.inv(W[:, :3]), omega - at_rest))

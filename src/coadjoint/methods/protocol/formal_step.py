"""Capability of schemes with a step that is known as a power series in exact numbers."""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from coadjoint.methods.protocol.method import Method
from coadjoint.systems.system_checks import System

if TYPE_CHECKING:
    from coadjoint.methods.formal.formal_numbers import FormalNumber


class FormalStep(Method):
    """A scheme with a step that is known as a power series in h."""

    @abstractmethod
    def formal_step(self, system: System, x: NDArray[Any], h: FormalNumber) -> NDArray[Any]:
        """Return one step as a power series in h whose coefficients are exact polynomials in the state.

        Parameters
        ----------
        system : LiePoissonSystem or PoissonSystem
            The system, with a polynomial vector field.
        x : (n,) array of FormalNumber
            The state.
        h : FormalNumber
            The step, or a multiple of it.

        Returns
        -------
        (n,) array of FormalNumber

        Raises
        ------
        TypeError
            The step is no power series for these parameters or this system.
        """

    @property
    def known_to(self) -> float:
        """Relative error of the coefficients of `formal_step`; 0 if they are exact."""
        return 0.0


def with_formal_step(method: Method) -> FormalStep:
    """Return a scheme as one with power series; raise TypeError if no way to compute them is known."""
    form = method.expanded
    if not isinstance(form, FormalStep):
        raise TypeError(f"a step of {method} is not known as a power series in exact numbers")
    return form

"""Step methods: schemes that are neither compositions of flows nor Runge-Kutta methods, and bring a compiled step."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from numpy.typing import NDArray

from coadjoint.methods.base import Method
from coadjoint.systems.kinds import System

UNDEFINED = 3
"""Status of a step that its scheme does not define; the scheme's `failures` says why."""


class Operations(NamedTuple):
    """What a step does: vectors of eight that it multiplies, operations that wait for the one before, and terms of
    invariants that it looks at after every correction, once where there is none.
    """

    vectors: float
    waiting: float
    looks: float


class StepMethod(Method):
    """A scheme with a step of its own, in its own files: NAME.cpp beside NAME.py, compiled, and read in NumPy.

    The C++ file derives from ``StepScheme`` of ``step_scheme.hpp``, which says what it is given.
    """

    @property
    @abstractmethod
    def compiled_step(self) -> str:
        """The name that the C++ file gives to the step, by ``STEP_SCHEME``."""

    @abstractmethod
    def constants(self) -> tuple[Sequence[int], Sequence[float]]:
        """Return the whole numbers and the coefficients that the compiled step reads.

        Returns
        -------
        integers, numbers : sequences
        """

    def restored(self, system: System) -> Mapping[str, Any] | None:
        """Return the invariants that the compiled step restores beside the energy; None is not the energy either.

        Parameters
        ----------
        system : LiePoissonSystem or PoissonSystem
            The system.

        Returns
        -------
        mapping or None
            Name -> `Polynomial` or `Quadratic`. The step remembers two numbers for each of them and for the energy.
        """
        return None

    def operations(self, system: System) -> Operations | None:
        """Return what a step does; None for a scheme that iterates, whose work is counted by its evaluations.

        Parameters
        ----------
        system : LiePoissonSystem or PoissonSystem
            The system.

        Returns
        -------
        Operations or None
        """
        return None

    @abstractmethod
    def step(self, system: System, x: Any, t: Any, h: Any) -> NDArray[Any]:
        """Return one step, read in NumPy for any number type.

        Parameters
        ----------
        system : LiePoissonSystem or PoissonSystem
            The system.
        x : (n,) array
            The state.
        t, h : number
            Time at the start, and length of the step.

        Returns
        -------
        (n,) array
        """

    @abstractmethod
    def tangent(self, system: System, x: Any, t: float, h: float) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return one step and its exact derivative.

        Parameters
        ----------
        system : LiePoissonSystem or PoissonSystem
            The system.
        x : (n,) array
            The state.
        t, h : float
            Time at the start, and length of the step.

        Returns
        -------
        x_new : (n,) array
            The step.
        P : (n, n) array
            Its derivative with respect to x.
        """

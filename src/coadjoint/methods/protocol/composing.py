"""Capability of schemes that can be composed with themselves, or with their adjoints."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence

from coadjoint.methods.protocol.method import Method


class Composable(Method):
    """A scheme with compositions of its own family."""

    @abstractmethod
    def composed(self, coefficients: Sequence[float]) -> Method:
        """Return the composition of this scheme with these fractions of its step, which `Composition` validates."""

    def symmetrized(self) -> Method:
        """Return half a step of this scheme followed by half a step of its adjoint."""
        raise _no_adjoint_error(self)


def composed(base: Method, coefficients: Sequence[float]) -> Method:
    """Return the composition of a scheme with these fractions of its step; raise TypeError if there is none."""
    if not isinstance(base, Composable):
        raise TypeError(f"{base} cannot be composed")
    return base.composed(coefficients)


def symmetrized(base: Method) -> Method:
    """Return half a step of a scheme followed by half a step of its adjoint: a symmetric scheme of even order.

    Raises TypeError if the adjoint is not known as a scheme.
    """
    if not isinstance(base, Composable):
        raise _no_adjoint_error(base)
    return base.symmetrized()


def _no_adjoint_error(base: Method) -> TypeError:
    return TypeError(f"the adjoint of {base} is not known as a scheme; take a splitting, or a Runge-Kutta tableau")

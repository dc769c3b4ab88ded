"""Explicit Lie-Poisson splitting: exact flows of commuting parts, composed (section 4 of Reich 1993)."""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from coadjoint.errors import unknown_name
from coadjoint.methods.base import FlowMethod, Properties, Sweep, System
from coadjoint.methods.splitting_schemes import DEFAULT_SCHEMES, SCHEMES
from coadjoint.systems.poisson import PoissonSystem


@dataclass(frozen=True)
class Splitting(FlowMethod):
    """Composition of the exact flows of commuting parts of the Hamiltonian: explicit, Poisson, all Casimirs kept.

    The first choice for long runs: each step costs a few rotations or shears, is a Poisson map to round-off, and keeps
    every Casimir and the spatial momentum of every representation. The energy is not kept but stays within
    O(step^order) for
    exponentially long times.

    Parameters
    ----------
    order : {1, 2, 4}
        1: one sweep X_1(h), ..., X_n(h) through the parts. 2: ``X1(h/2) ... Xn(h) ... X1(h/2)`` (Lemma 4.1).
        4: a symmetric composition of five steps of order 2 (Suzuki's).
    parts : "auto", "coordinates", or sequence of sequences of int
        ``"auto"``: commuting coordinates share a part, couplings inside a part are exact. ``"coordinates"``: the
        paper's, one coordinate each. Sets of coordinates are used as given, in that order. Where M is not diagonal and
        couples
        coordinates that do not commute, the parts are completed squares.
    compensated : bool, optional
        Compensated summation of the momentum; None is no. (The group element is always compensated.)
    rotation : {"exact"}
        Rotations by sine and cosine.
    scheme : str, optional
        A named scheme in place of `order`: ``"strang"``, ``"yoshida4"`` (the paper's fourth-order scheme),
        ``"suzuki4"``.
    adjoint : bool
        For order 1: the adjoint sweep X_n(h), ..., X_1(h).

    Raises
    ------
    ValueError
        If an order, scheme or choice does not exist.

    See Also
    --------
    GaussLegendre : For Hamiltonians that do not split; keeps quadratic invariants, the energy among them.

    References
    ----------
    S. Reich, Numerical integration of the generalized Euler equations, 1993, Lemmas 4.1 and 4.2.

    Examples
    --------
    >>> import coadjoint as co
    >>> body = co.systems.rigid_body(inertia=(1, 2, 3))
    >>> co.Splitting(order=4).properties(body)
    Properties(poisson=True, energy=False, casimirs='all', attitude='every representation')
    >>> sol = co.integrate(body, (1.0, 0.1, 0.5), t_span=(0, 10), step=0.1, method=co.Splitting(order=2))
    >>> sol.drift()["|x|^2"] < 1e-14
    True
    """

    order: int = 2
    parts: Any = "auto"
    compensated: bool | None = None
    rotation: str = "exact"
    scheme: str | None = None
    adjoint: bool = False

    def __post_init__(self) -> None:
        if self.scheme is not None:
            if self.scheme not in SCHEMES:
                raise unknown_name("splitting scheme", self.scheme, SCHEMES)
            if self.order not in (2, SCHEMES[self.scheme].order):
                raise ValueError(f"scheme {self.scheme!r} has order {SCHEMES[self.scheme].order}, not {self.order!r}")
            object.__setattr__(self, "order", SCHEMES[self.scheme].order)
        elif self.order != 1 and self.order not in DEFAULT_SCHEMES:
            raise ValueError(f"Splitting has the orders 1, 2 and 4, not {self.order!r}")
        if self.adjoint and self.order != 1:
            raise ValueError(f"adjoint=True is for order 1; order {self.order} is symmetric, its own adjoint")
        if self.rotation != "exact":
            raise unknown_name("rotation", str(self.rotation), ["exact"])
        if isinstance(self.parts, str):
            if self.parts not in ("auto", "coordinates"):
                raise unknown_name("choice of parts", self.parts, ["auto", "coordinates"])
        else:
            object.__setattr__(self, "parts", _sets_of_coordinates(self.parts))

    @property
    def explicit(self) -> bool:
        """Always true: no system of equations is solved."""
        return True

    @property
    def symmetric(self) -> bool:
        """Whether a step back undoes a step: every order but 1."""
        return self.order != 1

    def properties(self, system: System) -> Properties:
        """Return what splitting keeps: the Poisson bracket, every Casimir, the spatial momentum in every
        representation.

        Parameters
        ----------
        system : LiePoissonSystem
            The system.

        Returns
        -------
        Properties
            The same for every system that it serves.

        Raises
        ------
        ValueError
            For a system without a Lie algebra, whose split flows are not linear.
        """
        if isinstance(system, PoissonSystem):
            raise ValueError(
                f"Splitting needs a Lie algebra, which {system.name} does not have (its split flows are not linear); "
                "use GaussLegendre or ModifiedGaussLegendre"
            )
        return Properties(poisson=True, energy=False, casimirs="all", attitude="every representation")

    def sweeps(self, number: Callable[[Any], Any] = float) -> Sequence[Sweep]:
        """Return the sweeps of one step.

        Parameters
        ----------
        number : callable
            Number type of the coefficients.

        Returns
        -------
        list of Sweep
            First to last.
        """
        if self.order == 1:
            moment = 1 if self.adjoint else 0
            return [Sweep(not self.adjoint, number(1), number(moment))]
        half = [number(c) for c in SCHEMES[self.scheme or DEFAULT_SCHEMES[self.order]].half]
        return symmetric_sweeps([*half, *half[-2::-1]], number)


def _sets_of_coordinates(parts: Any) -> tuple[tuple[int, ...], ...]:
    try:
        return tuple(tuple(operator.index(i) for i in group) for group in parts)
    except TypeError:
        raise TypeError(
            f"parts is {parts!r}; it must be 'auto', 'coordinates', or sets of coordinates such as [[0, 1], [2]]"
        ) from None


def symmetric_sweeps(coefficients: Sequence[Any], number: Callable[[Any], Any]) -> list[Sweep]:
    """Return the sweeps of a composition of second-order steps, each with functions of time taken at its middle."""
    sweeps, passed = [], number(0)
    for coefficient in coefficients:
        half = coefficient / 2
        sweeps += [Sweep(True, half, passed + half), Sweep(False, half, passed + half)]
        passed = passed + coefficient
    return sweeps

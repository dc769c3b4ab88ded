"""Friction of fluids on sphere and torus, the same or another one for each scale."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from coadjoint.given import read_number
from coadjoint.systems.forces.on_modes import ModeRates, by_scale
from coadjoint.systems.matrices.mode_basis import ModeBasis, Numbers


@dataclass(frozen=True)
class Friction(ModeRates):
    """Friction that depends on the scale, for a fluid of matrices: ``W' = -rate(l) W`` on the degree l, solved exactly.

    Choose it for drag on large scales alone, or for a filter. Where all scales have the same rate `LinearDamping` takes
    less time, for `Viscosity` is a class of its own.

    Parameters
    ----------
    rate : float, or callable
        Rates, in inverse time, or a function of one number: of the degree l on the sphere, of the wave number |n| on
        the torus. A mode of rate zero is left alone to the last bit. A function is called once for each scale, and need
        not be compiled.
    layer : {"vorticity", "carried"}
        The field on which it acts; of one matrix the vorticity.

    Raises
    ------
    ValueError, TypeError
        No finite number, or a function of something else.

    Examples
    --------
    >>> import coadjoint as co
    >>> drag = co.forces.Friction(lambda l: 0.1 if l <= 3 else 0.0)
    >>> co.systems.sphere_euler(N=8).with_forces(drag).labels
    ('Friction',)
    """

    rate: float | Callable[[Any], Any]
    layer: str = "vorticity"

    def __post_init__(self) -> None:
        if not callable(self.rate):
            object.__setattr__(self, "rate", read_number(self.rate, "rate of Friction"))
        self.read_layer()

    def rates(self, modes: ModeBasis, d: int, numbers: Numbers) -> NDArray[Any]:
        return by_scale(self.rate, modes.scales(d, numbers), "rate of Friction")

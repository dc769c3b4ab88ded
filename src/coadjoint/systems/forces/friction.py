"""Scale-dependent friction of fluids on the sphere and the torus."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from coadjoint.systems.forces.mode_force import ModeRates, values_by_scale
from coadjoint.systems.matrices.mode_basis import ModeBasis, Numbers
from coadjoint.systems.user_functions import check_arguments
from coadjoint.validation import read_number


@dataclass(frozen=True)
class Friction(ModeRates):
    """Scale-dependent friction of a fluid of matrices: ``W' = -rate(l) W`` on the degree l, solved exactly.

    Choose it for drag on large scales only, or as a filter. If all scales have the same rate, `LinearDamping` is
    cheaper; for viscous damping use `Viscosity`.

    Parameters
    ----------
    rate : float, or callable
        Rate (1/time), or a function of one number: of the degree l on the sphere, of the wave number
        ``|n|`` on the torus.
        A mode of rate zero keeps its bits. A function is called once for each scale and is not compiled.
    layer : {"vorticity", "carried"}
        The field on which it acts; "vorticity" if the state is one matrix.

    Raises
    ------
    ValueError, TypeError
        `rate` is neither a finite number nor a function of one number.

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
        if callable(self.rate):
            check_arguments(self.rate, "rate of Friction", "scale")
        else:
            object.__setattr__(self, "rate", read_number(self.rate, "rate of Friction"))
        self.read_layer()

    def rates(self, modes: ModeBasis, d: int, numbers: Numbers) -> NDArray[Any]:
        return values_by_scale(self.rate, modes.scales(d, numbers), "rate of Friction")

"""The beta term of a fluid on the torus."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from coadjoint.systems.forces.mode_force import ModeRates, modes_of
from coadjoint.systems.matrices.mode_basis import ModeBasis, Numbers, Waves
from coadjoint.systems.matrices.torus_modes import representatives
from coadjoint.validation import read_number


@dataclass(frozen=True)
class BetaPlane(ModeRates):
    """The beta term of a fluid on the torus, ``omega' = ... - beta d psi/dx``: Rossby waves with the exact dispersion.

    The mode n rotates by ``w_n' = i beta n1/|n|^2 w_n``: a wave, exp(i (n1 x - n2 y - sigma t)), has the frequency
    ``sigma = -beta n1/|n|^2``, and travels to the west for a positive beta, with x eastward and y northward. Energy and
    enstrophy are preserved. The term is that of the continuous fluid: it derives from no Hamiltonian of the matrix
    model, breaks its bracket, and changes the other Casimirs, tr W^3 and so on. On the sphere the rotation of the frame
    has this effect within the model: ``sphere_euler(rotation=...)``.

    Parameters
    ----------
    beta : float
        Gradient of the Coriolis parameter (1/(length time)), of either sign.

    Raises
    ------
    ValueError, TypeError
        `beta` is not a finite number.

    References
    ----------
    P. B. Rhines, "Waves and turbulence on a beta-plane", J. Fluid Mech. 69 (1975) 417.

    Examples
    --------
    >>> import coadjoint as co
    >>> import numpy as np
    >>> s = co.systems.torus_euler(N=7)
    >>> moving = s.with_forces(co.forces.BetaPlane(2.0))
    >>> sol = co.integrate(
    ...     moving, s.from_modes({(1, 2): 1.0}), t_span=(0, 3), step=0.25, method=co.IsospectralGauss()
    ... )
    >>> bool(abs(s.modes(sol.x[-1])[1, 2] - np.exp(2j * 3 / 5)) < 1e-14)
    True
    """

    beta: float

    layer = "vorticity"

    def __post_init__(self) -> None:
        object.__setattr__(self, "beta", read_number(self.beta, "beta of BetaPlane"))

    def check(self, system: Any) -> None:
        if modes_of(system, self.label).kind != Waves.kind:
            raise ValueError(
                f"BetaPlane acts on a fluid on the torus, and {system.name} is one on the sphere; take "
                "sphere_euler(rotation=...)"
            )

    def rates(self, modes: ModeBasis, d: int, numbers: Numbers) -> NDArray[Any]:
        return -1j * self.beta * representatives(modes.N)[numbers] / modes.eigenvalues(d, numbers)

"""Viscosity of fluids on the sphere and the torus."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.systems.forces.mode_force import ModeRates
from coadjoint.systems.matrices.mode_basis import ModeBasis, Numbers
from coadjoint.validation import read_bool, read_integer, read_number

MAX_POWER = 32


@dataclass(frozen=True)
class Viscosity(ModeRates):
    """Viscosity or hyperviscosity of a fluid of matrices: ``W' = -nu A^power W`` with ``A = -Laplacian``.

    On the torus A is ``|n|^2`` on the mode n. On the sphere it is l(l + 1) - 2 on the degree l, the divergence of the
    rate of strain: a solid rotation has no strain and does not decay, so the angular momentum is preserved. With
    ``rotation=True``, and for a carried field (diffusion, resistivity), it is l(l + 1), and solid rotations decay. The
    flow is exact in every mode, for any rate.

    Parameters
    ----------
    nu : float
        Viscosity, not negative (length^2/time for ``power=1``); the unit of length is the radius of the sphere, or the
        side of the torus over 2 pi.
    power : int
        1 for viscosity, 2 to 32 for hyperviscosity.
    rotation : bool
        On the sphere: whether solid rotations decay as well.
    layer : {"vorticity", "carried"}
        The field on which it acts; "vorticity" if the state is one matrix.

    Raises
    ------
    ValueError, TypeError
        An argument has the wrong type or is out of range.

    References
    ----------
    D. G. Ebin, J. Marsden, "Groups of diffeomorphisms and the motion of an incompressible fluid", Ann. Math. 92 (1970)
    102; A. D. Gilbert, X. Riedinger, J. Thuburn, "Note on the form of the viscous term for two dimensional
    Navier-Stokes flows", Q. J. Mech. Appl. Math. 67 (2014) 205.

    Examples
    --------
    A field of the degree 2 decays by exp(-4 nu t):

    >>> import coadjoint as co
    >>> import numpy as np
    >>> s = co.systems.sphere_euler(N=6)
    >>> z = np.arange(6) - 2.5
    >>> W0 = 1j * np.diag(z**2 - np.mean(z**2))
    >>> sol = co.integrate(
    ...     s.with_forces(co.forces.Viscosity(0.01)), W0, t_span=(0, 10), step=0.5, method=co.IsospectralGauss()
    ... )
    >>> bool(np.abs(sol.x[-1] - np.exp(-0.4) * W0).max() < 1e-14)
    True
    """

    nu: float
    power: int = 1
    rotation: bool = False
    layer: str = "vorticity"

    def __post_init__(self) -> None:
        nu = read_number(self.nu, "nu of Viscosity")
        if nu < 0.0:
            raise ValueError(f"nu of Viscosity is {nu!r}; it must be zero or positive")
        object.__setattr__(self, "nu", nu)
        object.__setattr__(self, "power", read_integer(self.power, "power of Viscosity", 1, MAX_POWER))
        object.__setattr__(self, "rotation", read_bool(self.rotation, "rotation of Viscosity"))
        self.read_layer()

    def rates(self, modes: ModeBasis, d: int, numbers: Numbers) -> NDArray[Any]:
        offset = 2.0 if modes.kind == "HARMONICS" and not self.rotation and self.layer == "vorticity" else 0.0
        with np.errstate(over="ignore"):  # modes of infinite rate become zero
            return np.asarray(self.nu * (modes.eigenvalues(d, numbers) - offset) ** self.power)

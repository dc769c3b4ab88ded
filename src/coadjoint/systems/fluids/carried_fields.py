"""Quantized fluids with a second field that they carry: reduced magnetohydrodynamics, and a passive scalar."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.systems.fluids.sphere_euler import sphere_euler
from coadjoint.systems.fluids.torus_euler import torus_euler
from coadjoint.systems.gallery_entry import GalleryEntry, Picture
from coadjoint.systems.matrices.fluid_system import FluidSystem
from coadjoint.systems.matrices.two_layer_system import TwoLayerSystem
from coadjoint.systems.registry import ready_made
from coadjoint.validation import read_choice

SURFACES: dict[str, Callable[..., FluidSystem]] = {"sphere": sphere_euler, "torus": torus_euler}
PICTURES: dict[str, Any] = {
    "pictures": (Picture("vorticity", at=1.0), Picture("vorticity", part="carried", at=1.0), Picture("eigenvalues")),
    "components": Picture("energy by scale"),
}


def _two_vortices() -> npt.NDArray[np.complex128]:
    """Return the Orszag-Tang vortex: omega = cos x + cos y, Theta = cos y + cos(2 x)/2."""
    fluid = torus_euler(N=33)
    theta, W = (fluid.from_modes(modes) for modes in ({(0, 1): 0.5, (2, 0): 0.25}, {(1, 0): 0.5, (0, 1): 0.5}))
    return np.stack([theta, W])


@ready_made(
    gallery_entry=GalleryEntry(
        x0=_two_vortices,
        t_span=(0.0, 2.0),
        step=0.002,
        caption="The vortex of Orszag and Tang in a conducting fluid: vorticity and magnetic potential fold into each "
        "other, and sheets of vorticity grow where the field is bent. The spectrum of the potential is constant.",
        **PICTURES,
        parameters={"N": 33, "surface": "torus"},
        save_every=20,
        quantity="vorticity",
    )
)
def reduced_mhd(N: int = 17, surface: str = "sphere") -> TwoLayerSystem:
    """Return the equations of an ideal conducting fluid in two dimensions, as two matrices.

    ``W' = [P, W] + [J, Theta]``, ``Theta' = [P, Theta]`` with ``L P = -W`` and ``J = -L Theta``: W is the vorticity,
    Theta the magnetic potential, J the current. Alfven waves propagate along the magnetic field.

    Parameters
    ----------
    N : int
        Size of the matrices, as for `sphere_euler` and `torus_euler`.
    surface : {"sphere", "torus"}
        Surface of the fluid.

    Returns
    -------
    TwoLayerSystem
        States (2, N, N): Theta and W. Energy: the integral of ``(|u|^2 + |b|^2)/2`` over the surface,
        ``(tr(W* L^-1 W) + tr(Theta* L Theta))/2`` times `energy_unit`. Casimirs tr Theta^k and
        tr W Theta^k, of which k = 1 is the cross helicity.

    Notes
    -----
    K. Modin, M. Roop, "Spatio-temporal Lie-Poisson discretization for incompressible magnetohydrodynamics on the
    sphere" (2023); H. R. Strauss, Phys. Fluids 19 (1976) 134.

    Examples
    --------
    >>> s = reduced_mhd(N=7)
    >>> s.shape, list(s.casimirs)[:2]
    ((2, 7, 7), ['tr Theta^2', 'tr W Theta'])
    """
    return _with_second_field("reduced_mhd", N, surface, acts=True)


def _latitude_as_dye() -> npt.NDArray[np.complex128]:
    """Return a random flow on the sphere with a dye equal to the sine of the latitude."""
    fluid = sphere_euler(N=33)
    return np.stack([fluid.from_modes({(1, 0): 1.0}), fluid.random(seed=3)])


@ready_made(
    gallery_entry=GalleryEntry(
        x0=_latitude_as_dye,
        t_span=(0.0, 4.0),
        step=0.02,
        caption="A dye, at the start the sine of the latitude, is wound up by the vortices of a random flow on the "
        "sphere. Above, the vorticity, and below, the dye, at the end. The spectrum of the dye is constant.",
        **PICTURES,
        parameters={"N": 33},
        save_every=4,
        quantity="vorticity",
    )
)
def passive_scalar(N: int = 17, surface: str = "sphere") -> TwoLayerSystem:
    """Return an ideal fluid in two dimensions with a passive scalar, as two matrices.

    ``W' = [P, W]``, ``Theta' = [P, Theta]`` with ``L P = -W``: W is the vorticity, Theta the scalar, which does not
    affect the flow. All traces of products of W and Theta are preserved.

    Parameters
    ----------
    N : int
        Size of the matrices, as for `sphere_euler` and `torus_euler`.
    surface : {"sphere", "torus"}
        Surface of the fluid.

    Returns
    -------
    TwoLayerSystem
        States (2, N, N): Theta and W. Energy: the integral of ``|u|^2/2`` over the surface. Casimirs tr Theta^k,
        tr W Theta^k and tr W^k.

    Notes
    -----
    V. Zeitlin, "Finite-mode analogs of 2D ideal hydrodynamics", Physica D 49 (1991) 353.

    Examples
    --------
    >>> s = passive_scalar(N=7, surface="torus")
    >>> s.shape, "tr W^2" in s.casimirs
    ((2, 7, 7), True)
    """
    return _with_second_field("passive_scalar", N, surface, acts=False)


def _with_second_field(name: str, N: int, surface: str, acts: bool) -> TwoLayerSystem:
    """Return an ideal fluid with a second field that it carries, and that acts on it by its current or not at all."""
    ideal = SURFACES[read_choice(surface, "surface", SURFACES)](N)
    stream: Any = ideal.stream
    system = TwoLayerSystem(
        ideal.algebra,
        stream,
        stream.inverted() if acts else None,
        energy_sign=-1,
        name=name,
        parameters={"N": ideal.algebra.N, "surface": surface},
    )
    system._fluid, system.energy_unit = ideal, ideal.energy_unit
    return system

"""A quantized ideal fluid with a passive scalar, such as a dye."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from coadjoint.systems.fluids.reduced_mhd import ideal_fluid
from coadjoint.systems.fluids.sphere_euler import sphere_euler
from coadjoint.systems.gallery_entry import GalleryEntry, Picture
from coadjoint.systems.matrices.two_layer_system import TwoLayerSystem
from coadjoint.systems.registry import ready_made


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
        pictures=(
            Picture("vorticity", at=1.0),
            Picture("vorticity", part="carried", at=1.0),
            Picture("eigenvalues"),
        ),
        components=Picture("energy by scale"),
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
    ideal = ideal_fluid(N, surface)
    system = TwoLayerSystem(
        ideal.algebra,
        ideal.stream,  # type: ignore[arg-type]
        energy_sign=-1,
        name="passive_scalar",
        parameters={"N": ideal.algebra.N, "surface": surface},
    )
    system.energy_unit = ideal.energy_unit
    return system

"""An ideal fluid with a scalar that it carries, such as a dye, quantized."""

from __future__ import annotations

from coadjoint.systems.matrices.two_layer_system import TwoLayerSystem
from coadjoint.systems.ready_made import ready_made
from coadjoint.systems.reduced_mhd import ideal_fluid


@ready_made
def passive_scalar(N: int = 17, surface: str = "sphere") -> TwoLayerSystem:
    """Return an ideal fluid in two dimensions with a scalar that it carries, quantized.

    ``W' = [P, W]``, ``Theta' = [P, Theta]`` with ``L P = -W``: W is the vorticity, Theta the scalar, which does not act
    back. All traces of products of W and Theta are kept.

    Parameters
    ----------
    N : int
        Size of the matrices, as of `sphere_euler` and `torus_euler`.
    surface : {"sphere", "torus"}
        Where the fluid moves.

    Returns
    -------
    TwoLayerSystem
        States (2, N, N): Theta and W. Energy tr(W* L^-1 W)/2. Casimirs tr Theta^k, tr W Theta^k and tr W^k.

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
    return TwoLayerSystem(
        ideal.algebra,
        ideal.stream,  # type: ignore[arg-type]
        energy_sign=-1,
        name="passive_scalar",
        parameters={"N": ideal.algebra.N, "surface": surface},
    )

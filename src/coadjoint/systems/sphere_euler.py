"""Ideal fluids on the sphere, quantized: Zeitlin's model."""

from __future__ import annotations

from coadjoint.algebra.matrix_states import MatrixAlgebra
from coadjoint.given import read_whole
from coadjoint.systems.matrices.hoppe_yau import laplacian
from coadjoint.systems.matrices.matrix_system import MatrixSystem
from coadjoint.systems.matrices.streams import DiagonalSolve
from coadjoint.systems.ready_made import ready_made

LARGEST = 4096


@ready_made
def sphere_euler(N: int = 32) -> MatrixSystem:
    """Return the Euler equations of an ideal fluid on the sphere, quantized: ``W' = [P, W]``, ``L P = -W``.

    W is the vorticity, a matrix in su(N), and P the stream matrix, L the Laplacian of Hoppe and Yau. All traces of
    powers of W are kept, which stand for the integrals of powers of the vorticity.

    Parameters
    ----------
    N : int
        Size of the matrices, from 2 to 4096: spherical harmonics of the degrees l < N are resolved.

    Returns
    -------
    MatrixSystem
        Energy tr(W* L^-1 W)/2. Casimirs tr W^k.

    Notes
    -----
    V. Zeitlin, "Self-consistent finite-mode approximations for the hydrodynamics of an incompressible fluid on
    nonrotating and rotating spheres", Phys. Rev. Lett. 93, 264501 (2004); J. Hoppe and S.-T. Yau, Comm. Math. Phys.
    195, 67 (1998).

    Examples
    --------
    >>> s = sphere_euler(N=16)
    >>> s.shape, list(s.casimirs)[:2]
    ((16, 16), ['tr W^2', 'tr W^3'])
    """
    N = read_whole(N, "N", 2, LARGEST)
    return MatrixSystem(
        MatrixAlgebra("su", N),
        DiagonalSolve(*laplacian(N), factor=-1.0),
        energy_sign=-1,
        name="sphere_euler",
        parameters={"N": N},
    )

"""Validation of the group element that a scheme integrates with the momentum of a system."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.representation import intertwiner, invariant_form
from coadjoint.memory import check_available_memory


def check_attitude(kind: str, scheme: str, system: Any, representation: Any) -> None:
    """Raise ValueError if a scheme with this kind of `Properties.attitude` cannot preserve the group."""
    # Gauss methods preserve bilinear forms, and a spatial momentum bilinear in g and x: T rho_i = D_(e_i) T.
    if system.algebra is None:
        raise ValueError(f"{system.name} has no Lie algebra and so no group element; integrate it with attitude=False")
    if kind == "none":
        raise ValueError(
            f"{scheme} computes no group element; take Splitting, or GaussLegendre for the coadjoint matrix"
        )
    if kind != "coadjoint" or isinstance(representation, str):
        return
    rho = np.asarray(representation, dtype=np.float64)
    actions = coadjoint_matrices(system)
    if np.array_equal(rho, actions):
        return
    if invariant_form(rho) is None:
        raise ValueError(
            f"{scheme} would leave the group of this representation of {system.name}, which is not that of a "
            'bilinear form; take attitude="coadjoint", or Splitting'
        )
    if intertwiner(rho, actions) is None:
        raise ValueError(
            f"{scheme} would not keep the spatial momentum of {system.name}, which is not bilinear in this "
            'representation and the state; take attitude="coadjoint", or Splitting'
        )


def coadjoint_matrices(system: Any) -> NDArray[np.float64]:
    """Return the matrices D_(e_i), shape (n, n, n)."""
    check_available_memory(16 * system.dim**3, f"the coadjoint matrices of {system.name}, of dimension {system.dim},")
    return np.stack([system.algebra.coadjoint(unit) for unit in np.eye(system.dim)])

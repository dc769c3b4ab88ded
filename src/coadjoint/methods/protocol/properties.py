"""Declaration of what a scheme preserves to round-off, and the group elements that it admits."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from coadjoint.algebra.representation import intertwiner, invariant_form
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.memory import check_available_memory
from coadjoint.program.generators import given_matrices
from coadjoint.short_repr import short
from coadjoint.validation import read_bool, read_choice, read_list

KINDS_OF_CASIMIRS = ("all", "polynomial", "quadratic", "none")
KINDS_OF_ATTITUDE = ("every representation", "coadjoint", "group", "integrated", "none")
SHOWN_IF_SET = ("broken_by", "reversible")


@suggest_keywords
@dataclass(frozen=True)
class Properties:
    """What a scheme preserves to round-off on a given system.

    Parameters
    ----------
    poisson : bool
        Whether each step is a Poisson map.
    energy : bool
        Whether the energy is preserved.
    casimirs : str
        ``"all"``, ``"polynomial"`` (those that are polynomials), ``"quadratic"`` (of degree at most two) or ``"none"``.
    attitude : str
        Group elements that are preserved: ``"every representation"``; ``"coadjoint"``, and representations that are
        orthogonal for a fixed form and contain the coadjoint one; ``"group"``, which preserves the group of every
        representation, and the spatial momentum with the accuracy of the scheme; ``"integrated"``, as a differential
        equation, which preserves nothing; or ``"none"``.
    reversible : bool
        Whether steps whose length varies with the state are undone by steps backward.
    broken_by : tuple of str
        Forces of the system that break what the scheme preserves of the Hamiltonian part, as "energy: LinearDamping".

    Raises
    ------
    TypeError, ValueError
        A value is not one of these.
    """

    poisson: bool
    energy: bool
    casimirs: str
    attitude: str
    broken_by: tuple[str, ...] = ()
    reversible: bool = False

    def __repr__(self) -> str:
        shown = (field.name for field in fields(self) if field.name not in SHOWN_IF_SET or getattr(self, field.name))
        return f"Properties({', '.join(f'{name}={getattr(self, name)!r}' for name in shown)})"

    def __post_init__(self) -> None:
        for name in ("poisson", "energy", "reversible"):
            object.__setattr__(self, name, read_bool(getattr(self, name), name))
        broken = read_list(self.broken_by, "broken_by", "give a tuple of str")
        if not all(isinstance(entry, str) for entry in broken):
            raise TypeError(f"broken_by is {short(self.broken_by)}; give a tuple of str")
        object.__setattr__(self, "broken_by", broken)
        read_choice(self.casimirs, "kind of Casimirs", KINDS_OF_CASIMIRS)
        read_choice(self.attitude, "kind of attitude", KINDS_OF_ATTITUDE)


def check_attitude(kind: str, scheme: str, system: Any, representation: Any) -> None:
    """Raise ValueError if a scheme with this kind of `Properties.attitude` cannot preserve the group."""
    # Gauss methods preserve bilinear forms, and a spatial momentum bilinear in g and x: T rho_i = D_(e_i) T.
    if system.algebra is None:
        raise ValueError(f"{system.name} has no Lie algebra and so no group element; integrate it with attitude=False")
    if kind == "none":
        raise ValueError(
            f"{scheme} computes no group element; take Splitting, or GaussLegendre for the coadjoint matrix"
        )
    matrices = given_matrices(representation)
    if kind != "coadjoint" or matrices is None:
        return
    rho = np.asarray(matrices, dtype=np.float64)
    check_available_memory(16 * system.dim**3, f"the coadjoint matrices of {system.name}, of dimension {system.dim},")
    actions = np.stack([system.algebra.coadjoint(unit) for unit in np.eye(system.dim)])
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

"""The first term that a scheme adds to a polynomial Hamiltonian: what its error is made of."""

from __future__ import annotations

import numpy as np

from coadjoint.algebra.exact_polynomials import ExactPolynomials
from coadjoint.algebra.polynomial import Polynomial
from coadjoint.program.composition_logarithm import composition_logarithm, swept_exactly
from coadjoint.program.modified_series import Balls, ModifiedSeries
from coadjoint.program.part_polynomials import part_polynomials
from coadjoint.program.rational_pieces import rational_pieces
from coadjoint.program.sweep_logarithm import Commutators
from coadjoint.program.sweeps import Swept
from coadjoint.program.table import build_program
from coadjoint.systems.lie_poisson import LiePoissonSystem


def leading_term(system: LiePoissonSystem, method: Swept, order: int) -> Polynomial:
    """Return H_p of a scheme of order p: its step is the flow of H + h^p H_p + ...

    Parameters
    ----------
    system : LiePoissonSystem
        With a polynomial Hamiltonian.
    method : Swept
        The scheme.
    order : int
        Its order p.

    Returns
    -------
    Polynomial
    """
    program = build_program(system, method)
    parts, ring = program.parts, ExactPolynomials(system.algebra)
    sweeps, processor = swept_exactly(method)
    series = composition_logarithm(
        sweeps, processor, order + 1, order=order, parts=len(parts), rational=bool(np.any(program.frequency != 0))
    )
    pieces = part_polynomials(ring, parts)
    turned = rational_pieces(ring, parts, program.frequency, order + 1)
    flows = [{1: piece, **more} for piece, more in zip(pieces, turned, strict=True)]
    found = ModifiedSeries(Commutators(ring, system.sign), flows, order + 1).term(series, order + 1)
    return Polynomial(found.coefficients, dim=ring.dim) if isinstance(found, Balls) else ring.polynomial(found)

"""Terms of the modified Hamiltonian H + h^p H_p + ... of a scheme on a polynomial Hamiltonian."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from coadjoint.algebra.polynomials.exact_polynomials import Exact, ExactPolynomials
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.long_operations import warn_if_long
from coadjoint.program.modified_energy.bracket_cost import estimated_products
from coadjoint.program.modified_energy.composition_logarithm import Coordinates, composition_logarithm, exact_sweeps
from coadjoint.program.modified_energy.modified_series import Balls, ModifiedSeries
from coadjoint.program.modified_energy.sweep_logarithm import SECONDS_PER_PRODUCT, Commutators, check_products
from coadjoint.program.parts.part_polynomials import part_polynomials
from coadjoint.program.parts.rational_pieces import rational_pieces
from coadjoint.program.sweeps import Sweep, Swept
from coadjoint.program.table import Program, build_program
from coadjoint.systems.lie_poisson import LiePoissonSystem


class ModifiedTerms(NamedTuple):
    """Terms of a modified Hamiltonian, {power of h: polynomial}, nonzero ones only.

    The polynomials are in the coordinates, then the symbols of a ring. `radius` is the largest relative error of a
    coefficient before rounding to float64 (0 if exact), `neglected` a bound of the coefficients set to zero.
    """

    of_power: dict[int, Polynomial]
    radius: float
    neglected: float


def coordinates_of(program: Program, sweeps: list[Sweep], after: list[Sweep], highest: int, order: int) -> Coordinates:
    """Return the Lie series of a step by a program; for the arguments see `composition_logarithm`."""
    rational = bool(np.any(program.frequency != 0))
    return composition_logarithm(sweeps, after, highest, order=order, parts=len(program.parts), rational=rational)


def modified_terms(
    ring: ExactPolynomials,
    system: LiePoissonSystem,
    program: Program,
    coordinates: Coordinates,
    weights: Iterable[int],
    pieces: Sequence[Exact] | None = None,
) -> ModifiedTerms:
    """Return the terms of the given weights (>= 2); the power of h is the weight minus one.

    `pieces` are the polynomials of the parts, by default those of the program.
    """
    wanted = [weight for weight in weights if coordinates.of_weight[weight]]
    highest = max(wanted, default=1)
    if highest == 1:
        return ModifiedTerms({}, 0.0, coordinates.neglected)
    if pieces is None:
        check_cost(system, program, highest)
    own = part_polynomials(ring, program.parts) if pieces is None else pieces
    turned = rational_pieces(ring, program.parts, program.frequency, highest)
    flows = [{1: piece, **more} for piece, more in zip(own, turned, strict=True)]
    series = ModifiedSeries(Commutators(ring, system.sign), flows, highest)
    found: dict[int, Polynomial] = {}
    radius, neglected = 0.0, coordinates.neglected
    for weight in wanted:
        term = series.term(coordinates, weight)
        if isinstance(term, Balls):
            radius, neglected = max(radius, term.radius), max(neglected, term.neglected)
            polynomial = Polynomial(term.coefficients, dim=ring.dim + len(ring.symbols))
        else:
            polynomial = ring.with_symbols(term)
        if polynomial.monomials:
            found[weight - 1] = polynomial
    return ModifiedTerms(found, radius, neglected)


def check_cost(system: LiePoissonSystem, program: Program, highest: int) -> None:
    """Estimate the cost of the terms up to a weight: raise ValueError if it is too large, warn if slow."""
    count = estimated_products(system.algebra, program.parts, highest)
    check_products(count)
    warn_if_long("the modified Hamiltonian", SECONDS_PER_PRODUCT * count, "a lower order takes less")


def leading_term(system: LiePoissonSystem, method: Swept, order: int) -> Polynomial:
    """Return H_p of a scheme of order p, whose step is the flow of H + h^p H_p + ..."""
    program = build_program(system, method)
    coordinates = coordinates_of(program, *exact_sweeps(method), order + 1, order)
    found = modified_terms(ExactPolynomials(system.algebra), system, program, coordinates, [order + 1])
    return found.of_power.get(order, Polynomial({}, dim=system.dim))

"""Terms of the modified Hamiltonian of a scheme on a system, and its leading error term."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from coadjoint.algebra.polynomials.exact_polynomials import ExactPolynomials
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.algebra.polynomials.symbolic_polynomial import SymbolicPolynomial
from coadjoint.analysis.backward_error.symbols_of_hamiltonian import Symbols
from coadjoint.program.modified_energy.composition_logarithm import Coordinates
from coadjoint.program.modified_energy.modified_terms import check_cost, coordinates_of, modified_terms
from coadjoint.program.parts.part_polynomials import part_polynomials, with_hamiltonian_coefficients
from coadjoint.program.sweeps import Sweep
from coadjoint.program.table import Program
from coadjoint.systems.lie_poisson import LiePoissonSystem

MAX_POWER = 12
"""Largest power of h: above it, the words in the free algebra alone take minutes."""

Term = Polynomial | SymbolicPolynomial


class ErrorTerm(NamedTuple):
    """The leading error term h^power * term of a scheme.

    `power` is the order of the scheme, or None if H has a single part, whose flow is a step. The term is zero if the
    parts of a system commute more than in general.
    """

    power: int | None
    term: Term


class SchemeTerms:
    """The terms of a scheme on a system with a polynomial Hamiltonian, computed on request.

    `sweeps` and `after` are the sweeps of the kernel and of the processor, in exact numbers; `program` is the table of
    the splitting.
    """

    def __init__(
        self,
        system: LiePoissonSystem,
        program: Program,
        sweeps: list[Sweep],
        after: list[Sweep],
        order: int,
        symbols: Symbols,
    ) -> None:
        self._system, self._program, self.symbols = system, program, symbols
        self._sweeps, self._after, self._order = sweeps, after, order

    def kernel(self) -> SchemeTerms:
        """Return the terms of the kernel alone."""
        return SchemeTerms(self._system, self._program, self._sweeps, [], self._order, self.symbols)

    def below(self, order: int) -> tuple[dict[int, Term], float, float]:
        """Return the terms below h^order by power, their radius, and the bound on neglected coefficients."""
        terms, radius, neglected = self._terms(self._coordinates(order), range(2, order + 1))
        return {0: self.symbols.hamiltonian, **terms}, radius, neglected

    def error_term(self) -> ErrorTerm:
        """Return the term at the first power above h^0 that is non-zero for general systems."""
        if len(self._program.parts) > 1 or np.any(self._program.frequency != 0):
            for highest in range(min(self._order + 1, MAX_POWER + 1), MAX_POWER + 2):
                coordinates = self._coordinates(highest)
                weight = coordinates.leading
                if weight is not None:
                    terms, _, _ = self._terms(coordinates, [weight])
                    return ErrorTerm(weight - 1, terms.get(weight - 1, self.symbols.zero))
        return ErrorTerm(None, self.symbols.zero)

    def _coordinates(self, highest: int) -> Coordinates:
        return coordinates_of(self._program, self._sweeps, self._after, highest, self._order)

    def _terms(self, coordinates: Coordinates, weights: Iterable[int]) -> tuple[dict[int, Term], float, float]:
        wanted = [weight for weight in weights if coordinates.of_weight[weight]]
        ring = ExactPolynomials(self._system.algebra, tuple(self.symbols.values))
        pieces = None
        if (wanted or self.symbols.values) and not self._program.shift:
            if wanted:
                check_cost(self._system, self._program, max(wanted))
            parts = self._program.parts
            own, factors = part_polynomials(ring, parts), self.symbols.factors(ring)
            pieces = with_hamiltonian_coefficients(ring, parts, own, self.symbols.given, factors)
        found = modified_terms(ring, self._system, self._program, coordinates, wanted, pieces)
        terms = {power: self.symbols.written(term) for power, term in found.of_power.items()}
        return terms, found.radius, found.neglected

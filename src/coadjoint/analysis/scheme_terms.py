"""Which terms does a scheme add to a Hamiltonian, and which is the first? From its table and its sweeps."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from coadjoint.algebra.exact_polynomials import ExactPolynomials
from coadjoint.algebra.polynomial import Polynomial
from coadjoint.algebra.symbolic_polynomial import SymbolicPolynomial
from coadjoint.analysis.symbols_of_hamiltonian import Symbols
from coadjoint.program.composition_logarithm import Coordinates
from coadjoint.program.modified_terms import coordinates_of, modified_terms
from coadjoint.program.part_polynomials import part_polynomials, with_given_coefficients
from coadjoint.program.sweeps import Sweep
from coadjoint.program.table import Program
from coadjoint.systems.lie_poisson import LiePoissonSystem

HIGHEST = 12
"""Terms below h^12: beyond, the words in the free algebra alone take minutes."""

Term = Polynomial | SymbolicPolynomial


class ErrorTerm(NamedTuple):
    """The first term that a scheme adds to the Hamiltonian: h^power times a function.

    Parameters
    ----------
    power : int or None
        Of h: the order of the scheme. None where a step is the flow of H itself, of a single part.
    term : Polynomial or SymbolicPolynomial
        The function; it may be zero for a system whose parts commute more than they must.
    """

    power: int | None
    term: Term


class SchemeTerms:
    """The terms of a scheme on a system, each made when it is asked for.

    Parameters
    ----------
    system : LiePoissonSystem
        With a polynomial Hamiltonian.
    program : Program
        Its table.
    sweeps, after : list of Sweep
        Of the kernel, and of the processor, in exact numbers.
    order : int
        Of the scheme.
    symbols : Symbols
        What stands for coefficients of H.
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
        """Return that of the kernel alone."""
        return SchemeTerms(self._system, self._program, self._sweeps, [], self._order, self.symbols)

    def below(self, order: int) -> tuple[dict[int, Term], float, float]:
        """Return the terms below h^order by their powers, their radius, and what was neglected."""
        terms, radius, neglected = self._terms(self._coordinates(order), range(2, order + 1))
        return {0: self.symbols.hamiltonian, **terms}, radius, neglected

    def error_term(self) -> ErrorTerm:
        """Return the first term above h^0 that the scheme has whatever the system."""
        if len(self._program.parts) > 1 or np.any(self._program.frequency != 0):
            for highest in range(min(self._order + 1, HIGHEST + 1), HIGHEST + 2):
                coordinates = self._coordinates(highest)
                weight = coordinates.leading
                if weight is not None:
                    terms, _, _ = self._terms(coordinates, [weight])
                    return ErrorTerm(weight - 1, terms.get(weight - 1, self.symbols.zero))
        return ErrorTerm(None, self.symbols.zero)

    def _coordinates(self, highest: int) -> Coordinates:
        return coordinates_of(self._program, self._sweeps, self._after, highest, self._order)

    def _terms(self, coordinates: Coordinates, weights: Iterable[int]) -> tuple[dict[int, Term], float, float]:
        ring = ExactPolynomials(self._system.algebra, tuple(self.symbols.values))
        pieces = None
        if not self._program.shift:
            parts = self._program.parts
            own, factors = part_polynomials(ring, parts), self.symbols.factors(ring)
            pieces = with_given_coefficients(ring, parts, own, self.symbols.given, factors)
        found = modified_terms(ring, self._system, self._program, coordinates, weights, pieces)
        terms = {power: self.symbols.written(term) for power, term in found.of_power.items()}
        return terms, found.radius, found.neglected

"""Taylor polynomials at a point of the dual of an algebra, and their brackets up to a degree."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

from coadjoint.algebra.exact.numbers import rational
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.algebra.polynomials.exact_polynomials import Exact, ExactPolynomials


class JetPolynomials(ExactPolynomials):
    """The ring of polynomials in x - x0, truncated above a degree.

    The value at x0 of as many nested brackets depends on no higher derivatives.

    Examples
    --------
    >>> from coadjoint.algebra import catalogue
    >>> ring = JetPolynomials(catalogue.so(3), [0.0, 0.0, 5.0], 1)
    >>> x1, x2, x3 = ring.coordinates
    >>> ring.polynomial(ring.bracket(x1, x2)), ring.polynomial(ring.at_point(x3 * x3))
    (5 + x3, 25 + 10*x3)
    """

    def __init__(self, algebra: LieAlgebra, point: Sequence[float], degree: int) -> None:
        super().__init__(algebra)
        self._point = [rational(float(value)) for value in point]
        self._degree = degree

    def at_point(self, F: Exact) -> Exact:
        """Rewrite a polynomial in the coordinates as one in x - x0."""
        return self.reduced(F.compose(*(x + value for x, value in zip(self.coordinates, self._point, strict=True))))

    def reduced(self, F: Exact) -> Exact:
        if F.total_degree() <= self._degree:
            return F
        return self._context.from_dict({e: c for e, c in F.to_dict().items() if sum(e) <= self._degree})

    @cached_property
    def _entries(self) -> dict[tuple[int, int], Exact]:
        return {place: self.at_point(entry) for place, entry in super()._entries.items()}

"""Logarithm of one sweep through the parts: the product of their flows as one flow, with polynomial coefficients.

A function H stands for the derivation F -> sign {F, H} along its motion. Under the flows of H_1, then H_2, ... a
function F becomes exp(h H_1) exp(h H_2) ... F, with the first flow on the left. The commutator of the derivations of F
and G is the derivation of [F, G] = sign {G, F}.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction
from functools import cache
from math import comb, factorial
from operator import mul

from coadjoint.algebra.exact.numbers import rational
from coadjoint.algebra.polynomials.exact_polynomials import Exact, ExactPolynomials
from coadjoint.long_operations import note_progress
from coadjoint.memory import check_available_memory

MAX_PRODUCTS = 10**8
"""Largest number of products of monomials in all brackets: about 20 s, more with long numerators."""

WARN_PRODUCTS = MAX_PRODUCTS // 100
"""Number of products above which the remaining ones are estimated."""

SECONDS_PER_PRODUCT = 2e-7  # measured

BYTES_PER_MONOMIAL = 40  # exponents and a short fraction

Flow = Mapping[int, Exact]
"""Flow of sum_j h^j W_j with commuting W_j: j -> W_j. An exact flow has j = 1 alone."""


class Commutators:
    """The bracket [F, G] = sign {G, F} of polynomials; `sign` is that of x' = sign J(x) grad H(x)."""

    def __init__(self, ring: ExactPolynomials, sign: int) -> None:
        self.ring, self.sign = ring, sign
        self.spent = 0

    def __call__(self, F: Exact, G: Exact) -> Exact:
        """Return [F, G]."""
        return self.adjoint_operator(F)(G)

    def adjoint_operator(self, F: Exact) -> AdjointOperator:
        """Return the map G -> [F, G], for many G."""
        return AdjointOperator(self, [self.sign * entry for entry in self.ring.field(F)])

    def check_available_memory(self, count: int) -> None:
        """Count the products of monomials of a bracket; raise ValueError if the total or the memory is too large."""
        self.spent += count
        check_products(self.spent)
        note_progress("the brackets of a modified Hamiltonian")
        size = BYTES_PER_MONOMIAL + self.ring.dim + len(self.ring.symbols)
        check_available_memory(count * size, "a bracket in a modified Hamiltonian")

    def check_cost(self, lengths: Sequence[Sequence[int]], series: Sequence[Exact]) -> None:
        """Raise ValueError if brackets of fields of these `lengths` with a series are too many."""
        slopes = [[len(term.derivative(i)) for i in range(self.ring.dim)] for term in series if term != 0]
        expected = sum(sum(map(mul, field, slope)) for field in lengths for slope in slopes)
        check_products(self.spent + expected)


def check_products(count: float) -> None:
    """Raise ValueError if brackets have too many products of monomials."""
    if count > MAX_PRODUCTS:
        raise ValueError(
            f"the brackets of a modified Hamiltonian take {count:.0e} products of monomials or more, about "
            f"{SECONDS_PER_PRODUCT * count:.0e} s, and at most {MAX_PRODUCTS:.0e} are allowed; take a lower order or "
            "a system of fewer coordinates, or measure the energy error of a run"
        )


class AdjointOperator:
    """The derivation G -> [F, G] = sign {G, F} along the field sign J(x) grad F."""

    def __init__(self, commutators: Commutators, field: Sequence[Exact]) -> None:
        self._commutators, self._ring = commutators, commutators.ring
        self._moving = [(i, component) for i, component in enumerate(field) if component != 0]
        self.lengths = [len(component) for component in field]

    def __call__(self, G: Exact) -> Exact:
        """Return the bracket; raise ValueError if it is too large."""
        slopes = [G.derivative(i) for i, _ in self._moving]
        count = sum(len(slope) * len(component) for slope, (_, component) in zip(slopes, self._moving, strict=True))
        self._commutators.check_available_memory(count)
        products = (component * slope for slope, (_, component) in zip(slopes, self._moving, strict=True) if slope != 0)
        return self._ring.truncated(_sum_in_pairs(products, self._ring.zero))


def _sum_in_pairs(polynomials: Iterable[Exact], zero: Exact) -> Exact:
    """Add polynomials in pairs of like numbers of summands: one after the other, each sum would copy all before it."""
    sums: list[tuple[int, Exact]] = []
    for polynomial in polynomials:
        count, total = 1, polynomial
        while sums and sums[-1][0] == count:
            total = sums.pop()[1] + total
            count *= 2
        sums.append((count, total))
    total = zero
    for _, partial in reversed(sums):
        total += partial
    return total


def sweep_logarithm(commutators: Commutators, flows: Sequence[Flow], highest: int) -> list[Exact]:
    """Return Y_1, ..., Y_highest: the given flows, the first one first, are the flow of h Y_1 + h^2 Y_2 + ... With E(h)
    = exp(W(h)) ... for the flows in their order, R = E' E^-1 has a plain series, and Y = log E obeys Y' = sum_k B_k/k!
    ad_Y^k R, with the Bernoulli numbers B_k and B_1 = -1/2.
    """
    ring = commutators.ring
    R = [ring.zero] * highest
    lengths: list[list[list[int]]] | None = None
    for number, flow in enumerate(reversed(flows)):
        if lengths is None and commutators.spent > WARN_PRODUCTS:
            lengths = [
                [commutators.adjoint_operator(W).lengths for W in remaining.values()] for remaining in reversed(flows)
            ]
        if lengths is not None:
            commutators.check_cost([counts for remaining in lengths[number:] for counts in remaining], R[:-1])
        for j, W in flow.items():
            R = _transported(commutators.adjoint_operator(W), j, R)
        for j, W in flow.items():
            if j <= highest:
                R[j - 1] += j * W
    terms: list[Exact] = []
    adjoint_powers: list[list[Exact]] = []  # turned[k][q]: the h^q of ad_Y^k R
    for n in range(1, highest + 1):
        total = R[n - 1]
        for k in range(1, n):
            if len(adjoint_powers) < k:
                adjoint_powers.append([ring.zero] * k)
            previous = R if k == 1 else adjoint_powers[k - 2]
            sum_of_brackets = ring.zero
            for m in range(1, n - k + 1):
                factor = previous[n - 1 - m]
                if factor != 0 and terms[m - 1] != 0:
                    sum_of_brackets += commutators(terms[m - 1], factor)
            adjoint_powers[k - 1].append(sum_of_brackets)
            total += sum_of_brackets * rational(_bernoulli(k) / factorial(k))
        terms.append(total / n)
    return terms


def _transported(ad: AdjointOperator, j: int, series: list[Exact]) -> list[Exact]:
    """Return exp(h^j ad) of a series in h."""
    result, current = list(series), list(series)
    for m in range(1, len(series) // j + 1):
        current = [
            ad(current[k - j]) / m if k >= j and current[k - j] != 0 else 0 * series[0] for k in range(len(series))
        ]
        result = [a + b for a, b in zip(result, current, strict=True)]
    return result


@cache
def _bernoulli(k: int) -> Fraction:
    """Return B_k, with B_1 = -1/2."""
    if k == 0:
        return Fraction(1)
    return -sum((comb(k + 1, j) * _bernoulli(j) for j in range(k)), Fraction(0)) / (k + 1)

"""Composition of a symmetric scheme with itself, at fractions of the step (section 4 of Reich 1993)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from coadjoint.given import read_finite
from coadjoint.methods.base import FlowMethod, Method, Properties
from coadjoint.program.sweeps import Sweep
from coadjoint.systems.kinds import System
from coadjoint.wording import short

HIGHEST_ORDER = 12
LARGEST_SUM = 1000.0
MOST_SUBSTEPS = 1000


@dataclass(frozen=True)
class Composition(FlowMethod):
    """One step of the base at each fraction c_1 h, c_2 h, ... of the step: a higher order from a symmetric base.

    For your own coefficients, or for a base other than `Splitting` (Gauss-Legendre, say). What the base keeps, its
    composition keeps.

    Parameters
    ----------
    base : Method
        A symmetric scheme: `Splitting` of even order, or `GaussLegendre`.
    coefficients : sequence of float
        The fractions; they add up to 1. ``(c1, c2, c1)`` with 2 c1 + c2 = 1, 2 c1^3 + c2^3 = 0 gives order 4.

    Raises
    ------
    ValueError
        If the base is not symmetric, or the coefficients do not add up to 1.

    References
    ----------
    S. Reich 1993, section 4; H. Yoshida, Phys. Lett. A 150 (1990) 262.

    Examples
    --------
    >>> import coadjoint as co
    >>> c1 = 1 / (2 - 2 ** (1 / 3))
    >>> method = co.Composition(co.Splitting(order=2), (c1, 1 - 2 * c1, c1))
    >>> method.order, method.symmetric
    (4, True)
    """

    base: Method
    coefficients: tuple[float, ...]

    def __post_init__(self) -> None:
        if not isinstance(self.base, Method):
            raise TypeError(f"the base of a Composition is a scheme such as Splitting(order=2), not {short(self.base)}")
        object.__setattr__(self, "coefficients", _fractions_given(self.coefficients, self.base))
        if not self.base.symmetric:
            processed = isinstance(self.base, FlowMethod) and len(self.base.processor()) > 0
            raise ValueError(
                f"Composition needs a symmetric base, which {self.base} is not; "
                + (
                    "of a processed scheme P K P^-1 only the kernel K is; take a scheme without a processor"
                    if processed
                    else "of a first-order splitting take Splitting(order=2), its composition with its adjoint"
                )
            )
        if sum(map(abs, self.coefficients)) > LARGEST_SUM:
            raise ValueError(
                f"the absolute coefficients of a Composition add up to {sum(map(abs, self.coefficients)):.3g}; above "
                f"{LARGEST_SUM:g} rounding would undo the composition"
            )
        total = sum(self.coefficients)
        if abs(total - 1.0) > 4 * len(self.coefficients) * 2.0**-53 * sum(map(abs, self.coefficients)):
            raise ValueError(f"the coefficients of a Composition add up to 1, not to {total!r}")

    @property
    def order(self) -> int:
        """The order, from the order conditions in the free associative algebra."""
        return composition_order(self.coefficients, self.base.order)

    @property
    def explicit(self) -> bool:
        """As the base is."""
        return self.base.explicit

    @property
    def symmetric(self) -> bool:
        """Whether the coefficients are a palindrome."""
        return self.coefficients == self.coefficients[::-1]

    @property
    def parts(self) -> Any:
        """The parts of a splitting base."""
        return self.base.parts if isinstance(self.base, FlowMethod) else None

    @property
    def compensated(self) -> bool | None:
        """Whether a splitting base is compensated."""
        return getattr(self.base, "compensated", None)

    @property
    def rotation(self) -> str:
        """The rotations of a splitting base."""
        return self.base.rotation if isinstance(self.base, FlowMethod) else "exact"

    @property
    def fractions(self) -> tuple[float, ...]:
        """The fractions of the step of all substeps, compositions in the base multiplied out."""
        return tuple(c * f for c in self.coefficients for f in self.base.fractions)

    @property
    def innermost(self) -> Method:
        """The base that is not itself a composition."""
        return self.base.innermost

    def properties(self, system: System) -> Properties:
        """Return what the base keeps; a composition keeps the same.

        Parameters
        ----------
        system : LiePoissonSystem or PoissonSystem
            The system.

        Returns
        -------
        Properties
            Those of the base.
        """
        return self.base.properties(system)

    def sweeps(self, number: Callable[[Any], Any] = float) -> Sequence[Sweep]:
        """Return the sweeps of a splitting base, scaled and shifted.

        Parameters
        ----------
        number : callable
            Number type of the coefficients.

        Returns
        -------
        list of Sweep
            First to last.

        Raises
        ------
        TypeError
            If the base is not a splitting.
        """
        if not isinstance(self.base, FlowMethod):
            raise TypeError(f"{short(self.base)} is not made of flows")
        inner = self.base.sweeps(number)
        result, passed = [], number(0)
        for coefficient in map(number, self.coefficients):
            result += [
                Sweep(forward, coefficient * fraction, passed + coefficient * moment, turn)
                for forward, fraction, moment, turn in inner
            ]
            passed = passed + coefficient
        return result


def _fractions_given(coefficients: Any, base: Method) -> tuple[float, ...]:
    found = read_finite(coefficients, "coefficients")
    if found.ndim != 1:
        raise ValueError(f"coefficients has shape {found.shape}; give a sequence of numbers")
    if found.size * len(base.fractions) > MOST_SUBSTEPS:
        raise ValueError(
            f"a step of the Composition has {found.size * len(base.fractions)} substeps; there may be {MOST_SUBSTEPS}"
        )
    return tuple(found.tolist())


def composition_order(coefficients: Sequence[float], base_order: int) -> int:
    """Return the order of a composition of a symmetric map of even order.

    The base is exp(h Y_1 + h^(p+1) Y_(p+1) + h^(p+3) Y_(p+3) + ...) with free Y's; the product is compared with exp(h
    Y_1) word by word.

    Parameters
    ----------
    coefficients : sequence of float
        The fractions of the step.
    base_order : int
        Order p of the symmetric base.

    Returns
    -------
    int
        The order, at most 12 or that of the base.

    Examples
    --------
    >>> composition_order((0.5, 0.5), 2)
    2
    """
    highest = max(HIGHEST_ORDER, base_order)
    letters = [1, *range(base_order + 1, highest + 1, 2)]
    product: dict[tuple[int, ...], float] = {(): 1.0}
    for c in coefficients:
        product = _multiply(product, _exponential({(d,): c**d for d in letters}, highest), highest)
    exact = _exponential({(1,): 1.0}, highest)
    scale = max(1.0, max(map(abs, coefficients)))
    for order in range(base_order + 1, highest + 1):
        words = {word for word in product.keys() | exact.keys() if sum(word) == order}
        # Rounding of the coefficients themselves moves a condition by u times the sum of the terms in it.
        tolerance = 2.0**-53 * 8 * len(coefficients) * scale**order
        if any(abs(product.get(word, 0.0) - exact.get(word, 0.0)) > tolerance for word in words):
            return order - 1
    return highest


Series = dict[tuple[int, ...], float]


def _multiply(left: Series, right: Series, highest: int) -> Series:
    result: Series = {}
    for a, x in left.items():
        for b, y in right.items():
            if sum(a) + sum(b) <= highest:
                result[a + b] = result.get(a + b, 0.0) + x * y
    return result


def _exponential(exponent: Series, highest: int) -> Series:
    result: Series = {(): 1.0}
    power: Series = {(): 1.0}
    for k in range(1, highest + 1):
        power = {word: value / k for word, value in _multiply(power, exponent, highest).items()}
        for word, value in power.items():
            result[word] = result.get(word, 0.0) + value
    return result

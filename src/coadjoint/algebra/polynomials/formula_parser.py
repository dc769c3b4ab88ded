"""Recursive-descent parser of formulas: sums, products, powers, brackets and functions, evaluated during parsing.

Time is linear in the length of the text. Degrees, digits, expanded terms and bracket depth are bounded, so that a short
text cannot create large objects.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from fractions import Fraction
from typing import Any, ClassVar, NamedTuple

from coadjoint.algebra.exact.numbers import (
    MAX_DIGITS,
    NUMBER,
    Constant,
    checked,
    parse_number,
    quotient,
    too_large,
)
from coadjoint.algebra.invariants.logarithmic import LogarithmicSum
from coadjoint.algebra.polynomials.monomials import Exponents
from coadjoint.algebra.polynomials.polynomial import MAX_DEGREE, TOO_HIGH, Polynomial
from coadjoint.memory import check_available_memory
from coadjoint.short_repr import short

Number = int | Fraction
Formula = Number | Polynomial | LogarithmicSum

MAX_CHARACTERS = 10_000  # characters of a formula with brackets; expanded polynomials are not bounded
MAX_TERMS = 10_000
MAX_NESTING = 60
NESTING_MESSAGE = "has brackets or signs that are nested too deeply"

MAX_QUOTED = 60
MEMORY_CHECK_INTERVAL = 1024
BYTES_PER_TERM = 300
BYTES_PER_EXPONENT = 8

_TOKEN = re.compile(
    rf"\s*(?:(?P<number>{NUMBER})|(?P<name>[^\W\d]\w*)|(?P<sign>\*\*|[<>=!]=|[-+*/^(),<>]))|\s*(?P<end>\Z)"
)


def too_high(what: str, degree: int) -> ValueError:
    """Return the error for a degree beyond the range of float64."""
    return ValueError(f"{what} has the degree {short(degree)}; there are degrees up to {MAX_DEGREE}; {TOO_HIGH}")


def add_term(total: dict[Exponents, Constant], exponents: Exponents, coefficient: Constant) -> None:
    """Add a term to the monomials of a polynomial, in text order, and check the memory as they grow."""
    total[exponents] = checked(total[exponents] + coefficient) if exponents in total else coefficient
    if len(total) % MEMORY_CHECK_INTERVAL == 0:
        size = len(total) * (BYTES_PER_TERM + BYTES_PER_EXPONENT * len(exponents))
        what = f"a polynomial of {len(total)} terms or more in {len(exponents)} coordinates"
        check_available_memory(2 * size, what)


class Power(NamedTuple):
    """A power of one coordinate."""

    coordinate: int
    exponent: int


class Product:
    """A product during parsing: a number, powers of coordinates, and other factors."""

    def __init__(self, parser: FormulaParser) -> None:
        self.parser = parser
        self.number: Constant = 1
        self.exponents: list[int] | None = None
        self.degree = 0
        self.rest: Polynomial | LogarithmicSum | None = None

    def multiply(self, factor: Any) -> None:
        """Multiply by one more factor."""
        if isinstance(factor, Power):
            self.degree += factor.exponent
            self.parser.check_size(self.degree)
            if self.exponents is None:
                self.exponents = [0] * self.parser.dim
            self.exponents[factor.coordinate] += factor.exponent
        elif isinstance(factor, Polynomial | LogarithmicSum):
            self.rest = factor if self.rest is None else self._times(self.rest, factor)
        else:
            self.number = checked(self.number * factor)

    def divide(self, divisor: Any) -> None:
        """Divide the product so far."""
        divisor = self.parser.to_polynomial_value(divisor)
        if isinstance(divisor, int | float | Fraction):
            if divisor == 0:
                raise self.parser.division_by_zero()
            self.number = checked(quotient(self.number, divisor))
            return
        numerator = self.value()
        if not (isinstance(numerator, Polynomial) and isinstance(divisor, Polynomial)):
            raise self.parser.not_allowed(
                "has an unsupported division: a divisor must be a number, or a polynomial below a polynomial"
            )
        self.number, self.exponents, self.degree = 1, None, 0
        self.rest = LogarithmicSum.quotient(numerator, divisor)

    def value(self) -> Any:
        """Return the value of the product so far."""
        if self.exponents is not None:
            monomial = Polynomial({tuple(self.exponents): self.number})
            return monomial if self.rest is None else self._times(monomial, self.rest)
        return self.number if self.rest is None else self.rest * self.number

    def _times(self, left: Polynomial | LogarithmicSum, right: Polynomial | LogarithmicSum) -> Polynomial:
        if isinstance(left, LogarithmicSum) or isinstance(right, LogarithmicSum):
            raise self.parser.not_allowed(
                "multiplies a logarithm, an angle or a quotient by something other than a number"
            )
        self.parser.check_size(left.degree + right.degree, len(left.monomials) * len(right.monomials))
        return left * right


class FormulaParser:
    """Parser state: the text of a formula, its parameters, and the next token."""

    powers: ClassVar[tuple[str, ...]] = ("**",)
    max_characters: float = MAX_CHARACTERS
    notation_help = "write whole numbers, names and operations on them, such as a*x1**2 - log(x2)/3"

    def __init__(self, text: str, parameters: Mapping[str, Number], dim: int, letter: str) -> None:
        if len(text) > self.max_characters:
            raise ValueError(f"{short(text)} has {len(text)} letters; a formula has at most {self.max_characters}")
        self.text, self.parameters, self.dim, self.letter = text, parameters, dim, letter
        self._constant = (0,) * dim
        self._end = self._depth = 0
        self.next()

    def parse(self) -> Any:
        """Parse the whole text."""
        value = self.to_polynomial_value(self.sum())
        if self.token.lastgroup != "end":
            raise self.syntax_error()
        return value

    def to_polynomial_value(self, value: Any) -> Any:
        """Return a value, with the power of a coordinate converted to a polynomial."""
        if not isinstance(value, Power):
            return value
        product = Product(self)
        product.multiply(value)
        return product.value()

    def next(self) -> None:
        """Advance to the next token."""
        self._begin = self._end
        token = _TOKEN.match(self.text, self._begin)
        if token is None:
            raise self.syntax_error()
        self.token, self._end = token, token.end()

    def accept(self, *signs: str) -> str | None:
        """Consume and return the next sign if it is one of `signs`; otherwise return None."""
        sign = self.token["sign"] or self.token["name"]
        if sign not in signs:
            return None
        self.next()
        return sign

    def expect(self, sign: str) -> None:
        """Consume a required sign, or raise the syntax error."""
        if self.accept(sign) is None:
            raise self.syntax_error()

    def syntax_error(self) -> ValueError:
        """Return the syntax error at the next token."""
        rest = short(self.text[self._begin :].strip() or "its end", MAX_QUOTED)
        return ValueError(f"{short(self.text, MAX_QUOTED)} cannot be parsed from {rest} on; {self.notation_help}")

    def not_allowed(self, reason: str) -> ValueError:
        """Return the error for a well-formed formula that is not allowed."""
        return ValueError(f"{short(self.text, MAX_QUOTED)} {reason}")

    def division_by_zero(self) -> ValueError:
        """Return the error for a division by zero."""
        return self.not_allowed("divides by zero")

    def check_size(self, degree: int, terms: int = 0) -> None:
        """Raise an error if the expanded expression would be too large."""
        if degree > MAX_DEGREE:
            raise too_high(short(self.text, MAX_QUOTED), degree)
        if terms > MAX_TERMS:
            raise self.not_allowed(f"has about {short(terms)} terms when it is multiplied out, beyond {MAX_TERMS}")

    def sum(self) -> Any:
        """Parse a sum: a number, a polynomial, or a sum with logarithms."""
        total: dict[Exponents, Constant] = {}
        rest, numbers = None, True
        sign: str | None = self.accept("+", "-")
        while True:
            product = self._product()
            if sign == "-":
                product.number = -product.number
            if product.rest is not None:
                value = product.value()
                rest = value if rest is None else rest + value
            else:
                numbers = numbers and product.exponents is None
                add_term(total, tuple(product.exponents) if product.exponents else self._constant, product.number)
            sign = self.accept("+", "-")
            if sign is None:
                break
        if rest is None:
            return total[self._constant] if numbers else Polynomial(total, dim=self.dim)
        return rest + Polynomial(total, dim=self.dim) if total else rest

    def _product(self) -> Product:
        product = Product(self)
        product.multiply(self.factor())
        while (operation := self.accept("*", "/")) is not None:
            if operation == "*":
                product.multiply(self.factor())
            else:
                product.divide(self.divisor())
        return product

    def divisor(self) -> Any:
        """Parse the factor after "/"."""
        return self.factor()

    def factor(self) -> Any:
        """Parse a factor with its sign and power."""
        self._depth += 1
        if self._depth > MAX_NESTING:
            raise self.not_allowed(NESTING_MESSAGE)
        if self.accept("-") is not None:
            product = Product(self)
            product.multiply(-1)
            product.multiply(self.factor())
            value = product.value()
        else:
            value = self._atom()
            if self.accept(*self.powers) is not None:
                value = self._power_of(value, self.factor())
        self._depth -= 1
        return value

    def _atom(self) -> Any:
        if self.accept("(") is not None:
            value = self.sum()
            self.expect(")")
            return value
        name = self.token["name"]
        if name is None:
            return self.whole_number()
        index = self.coordinate(name)
        if index is None and name not in self.parameters and name not in ("log", "atan2"):
            raise self.not_allowed(f"has {short(name, MAX_QUOTED)}, which is not a known name; {self.notation_help}")
        self.next()
        if index is not None:
            return Power(index, 1)
        return self.parameters[name] if name in self.parameters else self._function(name)

    def whole_number(self) -> int:
        """Parse a whole number."""
        number = self.token["number"]
        if number is None or not number.isdecimal():
            raise self.syntax_error()
        self.next()
        return int(parse_number(number))

    def coordinate(self, name: str) -> int | None:
        """Return the index of a coordinate, or None if the name is not a coordinate."""
        letter, digits = name[:1], name[1:]
        if letter != self.letter or not digits.isdecimal():
            return None
        index = int(digits) if len(digits) <= MAX_DIGITS else 0
        if not 1 <= index <= self.dim:
            raise self.not_allowed(
                f"has the coordinate {letter}{digits[:20]}; there are {letter}1 to {letter}{self.dim}"
            )
        return index - 1

    def _function(self, name: str) -> LogarithmicSum:
        self.expect("(")
        forms = [self.to_polynomial_value(self.sum())]
        while self.accept(",") is not None:
            forms.append(self.to_polynomial_value(self.sum()))
        self.expect(")")
        if len(forms) != (1 if name == "log" else 2) or not all(isinstance(form, Polynomial) for form in forms):
            raise self.not_allowed(f"has {name} of something other than {'a polynomial' if name == 'log' else 'two'}")
        return LogarithmicSum.logarithm(*forms) if name == "log" else LogarithmicSum.angle(*forms)

    def _power_of(self, base: Any, power: Any) -> Any:
        """Return a whole power after checking its size."""
        power = self.to_polynomial_value(power)
        if not isinstance(power, int) or power < 0:
            raise self.not_allowed(f"has the power {short(power)}; powers are whole numbers from 0 up")
        if isinstance(base, LogarithmicSum):
            raise self.not_allowed("has a power of a logarithm, an angle or a quotient")
        if isinstance(base, Power):
            self.check_size(base.exponent * power)
            return Power(base.coordinate, base.exponent * power)
        if isinstance(base, Polynomial):
            self.check_size(base.degree * power)
            terms = len(base.monomials)
            self.check_size(0, math.comb(terms + power - 1, power) if terms > 1 and power < MAX_DEGREE else 1)
        elif abs(base) not in (0, 1) and power > MAX_DEGREE:
            raise too_large()
        value = base**power
        return value if isinstance(value, Polynomial) else checked(value)

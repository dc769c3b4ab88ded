"""Formulas with parameters, as the catalogue writes them: a strict reader; nothing is evaluated by Python."""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Mapping
from fractions import Fraction
from itertools import pairwise
from typing import Any, TypeVar

from coadjoint.algebra.logarithmic import LogarithmicSum
from coadjoint.algebra.polynomial import MOST_DEGREE, TOO_HIGH, Polynomial
from coadjoint.errors import in_one_line
from coadjoint.wording import short

Number = int | Fraction
Read = TypeVar("Read")
Formula = Number | Polynomial | LogarithmicSum

# A short text can stand for something that no machine can hold. So there are bounds for what a reader makes of it.
MOST_DIGITS = 400
TOO_LARGE = "is too large for float64, or has too many digits"
MOST_LETTERS = 10_000
NESTED = "has brackets or signs that are nested too deeply"
MOST_TERMS = 10_000

_COMPARISONS: dict[type[ast.cmpop], Callable[[Any, Any], bool]] = {
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
}


def read_formula(text: str, names: Mapping[str, Number | Polynomial]) -> Formula:
    """Return what a formula stands for, in exact arithmetic.

    Sums, products, quotients, whole powers (``**``) of whole numbers and names, and ``log(p)`` = log|p| and
    ``atan2(p, q)`` of polynomials.

    Parameters
    ----------
    text : str
    names : mapping of str to int, Fraction or Polynomial
        Values of the parameters, and the coordinates.

    Returns
    -------
    int, Fraction, Polynomial or LogarithmicSum

    Raises
    ------
    ValueError
        The text is not such a formula; or a degree, a number or the number of terms is too large.

    Examples
    --------
    >>> x = {f"x{i + 1}": Polynomial.variable(i, 2) for i in range(2)}
    >>> read_formula("(a + 1)*x1**2 - x2/2", x | {"a": 3})
    -(1/2)*x2 + 4*x1^2
    >>> read_formula("log(x1) - a*x2/x1", x | {"a": 3}).invariant().value([1.0, 2.0])
    -6.0
    """
    return _read(text, lambda tree: _value(tree, names, text))


def satisfied(text: str, parameters: Mapping[str, Number]) -> bool:
    """Say whether parameters satisfy a condition: comparisons joined by ``and`` or ``or``.

    Raises
    ------
    ValueError
        The text is not such a condition.

    Examples
    --------
    >>> satisfied("a != 0 and -1 < a <= 1", {"a": Fraction(1, 2)})
    True
    """
    return _read(text, lambda tree: _condition(tree, parameters, text))


def _read(text: str, meaning: Callable[[ast.expr], Read]) -> Read:
    tree = _parsed(text)
    try:
        return meaning(tree)
    except RecursionError:
        raise ValueError(f"{short(text)} {NESTED}") from None


def fits(value: float | Number) -> bool:
    """Say whether a number is finite in float64 and, where it is exact, has so many digits as one can work with.

    Examples
    --------
    >>> fits(10**308), fits(10**309), fits(float("inf")), fits(Fraction(1, 10**2000))
    (True, False, False, False)
    """
    try:
        return math.isfinite(value) and not (isinstance(value, Fraction) and value.denominator.bit_length() > 4096)
    except OverflowError:
        return False


def _parsed(text: str) -> ast.expr:
    if len(text) > MOST_LETTERS:
        raise ValueError(f"{short(text)} has {len(text)} letters; a formula has at most {MOST_LETTERS}")
    try:
        return ast.parse(text, mode="eval").body
    except SyntaxError as error:
        raise ValueError(f"{short(text)} is not a formula: {in_one_line(error.msg, 120)}") from None
    except (RecursionError, MemoryError):
        raise ValueError(f"{short(text)} {NESTED}") from None
    except ValueError as error:
        raise ValueError(f"{short(text)} is not a formula: {in_one_line(str(error), 120)}") from None


def _condition(node: ast.expr, parameters: Mapping[str, Number], text: str) -> bool:
    if isinstance(node, ast.BoolOp):
        holds = [_condition(part, parameters, text) for part in node.values]
        return all(holds) if isinstance(node.op, ast.And) else any(holds)
    if not isinstance(node, ast.Compare) or any(type(op) not in _COMPARISONS for op in node.ops):
        raise ValueError(f"{short(text)} must be comparisons of parameters, joined by 'and' or 'or'")
    sides = [_value(side, parameters, text) for side in (node.left, *node.comparators)]
    return all(_COMPARISONS[type(op)](*pair) for op, pair in zip(node.ops, pairwise(sides), strict=True))


def _value(node: ast.expr, names: Mapping[str, Number | Polynomial], text: str) -> Formula:
    if isinstance(node, ast.Constant) and type(node.value) is int:
        return _within(node.value, text)
    if isinstance(node, ast.Name) and node.id in names:
        return names[node.id]
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        return _product(-1, _value(node.operand, names, text), text)
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and not node.keywords:
        arguments = [_value(argument, names, text) for argument in node.args]
        forms = [argument for argument in arguments if isinstance(argument, Polynomial)]
        if node.func.id == "log" and len(forms) == len(arguments) == 1:
            return LogarithmicSum.logarithm(forms[0])
        if node.func.id == "atan2" and len(forms) == len(arguments) == 2:
            return LogarithmicSum.angle(forms[0], forms[1])
    if isinstance(node, ast.BinOp):
        left = _value(node.left, names, text)
        right = _value(node.right, names, text)
        if isinstance(node.op, ast.Add):
            return _sum(left, right, text)
        if isinstance(node.op, ast.Sub):
            return _sum(left, _product(-1, right, text), text)
        if isinstance(node.op, ast.Mult):
            return _product(left, right, text)
        if isinstance(node.op, ast.Div):
            if isinstance(right, Polynomial) and isinstance(left, Polynomial):
                return LogarithmicSum.quotient(left, right)
            if isinstance(right, int | Fraction):
                if right == 0:
                    raise ValueError(f"{short(text)} divides by zero")
                return _product(left, Fraction(1) / right, text)
        if isinstance(node.op, ast.Pow) and isinstance(right, int) and not isinstance(left, LogarithmicSum):
            return _power(left, right, text)
    raise ValueError(
        f"{short(ast.unparse(node))} in {short(text)} is not a number, a known name, or an operation on them"
    )


def _sum(left: Formula, right: Formula, text: str) -> Formula:
    if isinstance(left, LogarithmicSum) and isinstance(right, int | Fraction):
        return left + Polynomial({(0,) * left.dim: right})
    if isinstance(right, LogarithmicSum) and isinstance(left, int | Fraction):
        return _sum(right, left, text)
    total: Any = left
    return _within(total + right, text)


def _product(left: Formula, right: Formula, text: str) -> Formula:
    if isinstance(left, LogarithmicSum):
        left, right = right, left
    if isinstance(left, LogarithmicSum) or (isinstance(right, LogarithmicSum) and isinstance(left, Polynomial)):
        raise ValueError(f"{short(text)} multiplies a logarithm, an angle or a quotient by more than a number")
    if isinstance(left, Polynomial) and isinstance(right, Polynomial):
        _check_size(left.degree + right.degree, len(left.monomials) * len(right.monomials), text)
    product: Any = right
    return _within(product * left, text)


def _power(base: Number | Polynomial, power: int, text: str) -> Number | Polynomial:
    """Return a whole power, once it is known that it can be held."""
    if power < 0:
        raise ValueError(f"{short(text)} has the power {short(power)}; powers are whole numbers from 0 up")
    if isinstance(base, Polynomial):
        _check_size(base.degree * power, 0, text)
        terms = len(base.monomials)
        _check_size(0, math.comb(terms + power - 1, power) if terms > 1 and power < MOST_DEGREE else 1, text)
    elif abs(base) not in (0, 1) and power > MOST_DEGREE:
        raise ValueError(f"a number in {short(text)} {TOO_LARGE}")
    result: Any = base
    return _within(result**power, text)


def _check_size(degree: int, terms: int, text: str) -> None:
    if degree > MOST_DEGREE:
        raise ValueError(
            f"{short(text)} has the degree {short(degree)}; there are degrees up to {MOST_DEGREE}; {TOO_HIGH}"
        )
    if terms > MOST_TERMS:
        raise ValueError(f"{short(text)} has about {short(terms)} terms when it is multiplied out, beyond {MOST_TERMS}")


def _within(value: Any, text: str) -> Any:
    """Refuse a number that float64 does not hold."""
    if isinstance(value, int | Fraction) and not fits(value):
        raise ValueError(f"a number in {short(text)} {TOO_LARGE}")
    return value

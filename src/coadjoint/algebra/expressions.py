"""Formulas with parameters, as the catalogue writes them: a strict reader; nothing is evaluated by Python."""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Mapping
from fractions import Fraction
from itertools import pairwise
from typing import Any

from coadjoint.algebra.logarithmic import LogarithmicSum
from coadjoint.algebra.polynomial import Polynomial

Number = int | Fraction
Formula = Number | Polynomial | LogarithmicSum

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
        The text is not such a formula.

    Examples
    --------
    >>> x = {f"x{i + 1}": Polynomial.variable(i, 2) for i in range(2)}
    >>> read_formula("(a + 1)*x1**2 - x2/2", x | {"a": 3})
    -(1/2)*x2 + 4*x1^2
    >>> read_formula("log(x1) - a*x2/x1", x | {"a": 3}).invariant().value([1.0, 2.0])
    -6.0
    """
    return _value(_parsed(text), names, text)


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
    return _condition(_parsed(text), parameters, text)


def _parsed(text: str) -> ast.expr:
    try:
        return ast.parse(text, mode="eval").body
    except SyntaxError as error:
        raise ValueError(f"{text!r} is not a formula: {error.msg}") from None


def _condition(node: ast.expr, parameters: Mapping[str, Number], text: str) -> bool:
    if isinstance(node, ast.BoolOp):
        holds = [_condition(part, parameters, text) for part in node.values]
        return all(holds) if isinstance(node.op, ast.And) else any(holds)
    if not isinstance(node, ast.Compare) or any(type(op) not in _COMPARISONS for op in node.ops):
        raise ValueError(f"{text!r} must be comparisons of parameters, joined by 'and' or 'or'")
    sides = [_value(side, parameters, text) for side in (node.left, *node.comparators)]
    return all(_COMPARISONS[type(op)](*pair) for op, pair in zip(node.ops, pairwise(sides), strict=True))


def _value(node: ast.expr, names: Mapping[str, Number | Polynomial], text: str) -> Formula:
    if isinstance(node, ast.Constant) and type(node.value) is int:
        return node.value
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
            return _sum(left, right)
        if isinstance(node.op, ast.Sub):
            return _sum(left, _product(-1, right, text))
        if isinstance(node.op, ast.Mult):
            return _product(left, right, text)
        if isinstance(node.op, ast.Div):
            if isinstance(right, Polynomial) and isinstance(left, Polynomial):
                return LogarithmicSum.quotient(left, right)
            if isinstance(right, int | Fraction):
                return _product(left, Fraction(1) / right, text)
        if isinstance(node.op, ast.Pow) and isinstance(right, int) and not isinstance(left, LogarithmicSum):
            return left**right
    raise ValueError(f"{ast.unparse(node)!r} in {text!r} is not a number, a known name, or an operation on them")


def _sum(left: Formula, right: Formula) -> Formula:
    if isinstance(left, LogarithmicSum) and isinstance(right, int | Fraction):
        return left + Polynomial({(0,) * left.dim: right})
    if isinstance(right, LogarithmicSum) and isinstance(left, int | Fraction):
        return _sum(right, left)
    total: Any = left
    return total + right


def _product(left: Formula, right: Formula, text: str) -> Formula:
    if isinstance(left, LogarithmicSum):
        left, right = right, left
    if isinstance(left, LogarithmicSum) or (isinstance(right, LogarithmicSum) and isinstance(left, Polynomial)):
        raise ValueError(f"{text!r} multiplies a logarithm, an angle or a quotient by more than a number")
    product: Any = right
    return product * left

"""Formulas as text, parsed by Python's `ast` after a check of every token; nothing is executed."""
# Every name and number is a placeholder before `ast` parses the text; length, nesting and operations are bounded.

from __future__ import annotations

import ast
import math
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from coadjoint.algebra.exact.numbers import MAX_DIGITS, NUMBER, Constant, parse_number
from coadjoint.algebra.polynomials.monomials import (
    MAX_SHOWN_NAMES,
    coordinate_names,
    names_clash,
    numbers_by_name,
    read_coefficient,
)
from coadjoint.errors import in_one_line
from coadjoint.short_repr import short, short_rest
from coadjoint.validation import read_integer, read_list

MAX_CHARACTERS = 250_000
MAX_NESTING = 60
"""Of brackets, signs and powers inside each other."""
MAX_OPERATIONS = 1000
"""Of one term of a sum; a term may contain sums in brackets."""
NESTING_MESSAGE = "has brackets or signs that are nested too deeply"
TERMS_PARSED_AT_ONCE = 256  # summands; keeps sums of any length from nesting
MAX_QUOTED = 60  # letters of a formula in a message

NOTATION = "write numbers, coordinates, parameters and operations on them, such as 0.5*x1^2 - x2*(x3 + 1)/3"
FUNCTIONS: Mapping[str, tuple[str, str]] = {
    "sin": ("sin", "sin"),
    "cos": ("cos", "cos"),
    "tan": ("tan", "tan"),
    "atan": ("arctan", "atan"),
    "exp": ("exp", "exp"),
    "log": ("log", "log"),
    "sqrt": ("sqrt", "sqrt"),
    "sinh": ("sinh", "sinh"),
    "cosh": ("cosh", "cosh"),
    "tanh": ("tanh", "tanh"),
}
"""Function of formulas -> its names in NumPy and in python-flint."""

_WORD = r"[^\W\d]\w*(?:\[[\w, ]*\])?"
NAME = re.compile(_WORD)
_X = re.compile(r"x\d+")
_TOKEN = re.compile(
    rf"\s*(?:(?P<number>{NUMBER})|(?P<name>{_WORD})|(?P<sign>\*\*|[<>=!]=|[-+*/^(),<>]))|\s*(?P<end>\Z)"
)
_COMPARISONS = frozenset({"<", "<=", ">", ">=", "==", "!="})


class Monomial(NamedTuple):
    """A number times powers of coordinates; a number if there are none."""

    number: Constant
    powers: dict[int, int]

    @property
    def degree(self) -> int:
        return sum(self.powers.values())

    def __neg__(self) -> Monomial:
        return self._replace(number=-self.number)


def summands(node: ast.expr, sign: int = 1) -> Iterator[tuple[int, ast.expr]]:
    """Yield the signed terms of a sum in their order, without recursion."""
    stack = [(sign, node)]
    while stack:
        match stack.pop():
            case sign, ast.BinOp(left, ast.Add(), right):
                stack += [(sign, right), (sign, left)]
            case sign, ast.BinOp(left, ast.Sub(), right):
                stack += [(-sign, right), (sign, left)]
            case term:
                yield term


def factors(node: ast.expr) -> list[tuple[bool, ast.expr]]:
    """Return the factors of a product in their order, without recursion; True marks those that divide."""
    found = []
    while True:
        match node:
            case ast.BinOp(node, ast.Mult(), right):
                found.append((False, right))
            case ast.BinOp(node, ast.Div(), right):
                found.append((True, right))
            case _:
                return [(False, node), *reversed(found)]


class FormulaTree:
    """A parsed formula: signed terms, and numbers and coordinates by placeholder; with `conditions`, comparisons."""

    # The tokens are checked first: alternation of operands and operators, brackets, and bounds. `value_of` returns the
    # number or the coordinate of a name, or None; `notation` ends messages.

    def __init__(
        self,
        text: str,
        value_of: Callable[[str], Monomial | None],
        functions: Collection[str],
        notation: str,
        conditions: bool = False,
    ) -> None:
        if len(text) > MAX_CHARACTERS:
            raise ValueError(f"{short(text)} has {len(text)} letters; a formula has at most {MAX_CHARACTERS}")
        self.text, self._value_of, self._functions = text, value_of, functions
        self._notation, self._conditions = notation, conditions
        self.symbols: dict[str, Monomial] = {}
        self._placeholders: dict[str, str] = {}
        self._source: list[str] = []  # of the current term
        self._signs, self._sources = [1], list[str]()
        self._calls = list[bool]()  # for each open bracket, whether it is that of a function
        self._pending = [0]  # signs and powers that wait for their operand, for each open bracket
        self._nesting = self._operations = 0
        self._scan()
        self.terms: tuple[tuple[int, ast.expr], ...] = tuple(zip(self._signs, self._nodes(), strict=True))

    def refused(self, reason: str) -> ValueError:
        """Return the error for a formula that is not allowed."""
        return ValueError(f"{short(self.text, MAX_QUOTED)} {reason}")

    def _scan(self) -> None:
        operand_expected, is_function, end = True, False, 0
        while True:
            begin = end
            token = _TOKEN.match(self.text, begin)
            if token is None:
                raise self._syntax_error(begin)
            end, kind = token.end(), token.lastgroup
            word = token["name"]
            operator = token["sign"] if word is None or not self._conditions or word not in ("and", "or") else word
            if is_function and operator != "(":
                raise self._syntax_error(begin)
            if kind == "end":
                if operand_expected or self._calls:
                    raise self._syntax_error(begin)
                break
            if operator == "(":
                if not operand_expected:
                    raise self._syntax_error(begin)
                self._open(is_function)
                is_function = False
            elif operator is None:
                if not operand_expected:
                    raise self._syntax_error(begin)
                following = _TOKEN.match(self.text, end)
                is_function = word is not None and following is not None and following["sign"] == "("
                self._source.append(self._operand(token[kind or ""], is_function, word is not None))
                operand_expected = is_function
            elif operator in ("+", "-") and operand_expected:
                self._sign(operator)
            elif operand_expected or not self._operator(operator):
                raise self._syntax_error(begin)
            else:
                operand_expected = operator != ")"
        self._sources.append("".join(self._source))

    def _operand(self, token: str, is_function: bool, is_name: bool) -> str:
        """Return a known function itself, and a placeholder for any other name and for a number."""
        if is_function:
            if token not in self._functions:
                known = ", ".join(self._functions)
                known = f"the functions are {known}" if known else "there are no functions"
                raise self.refused(f"has the function {short(token, MAX_QUOTED)}; {known} here (a product has a *)")
            return token
        if token not in self._placeholders:
            value = self._value_of(token) if is_name else Monomial(parse_number(token), {})
            if value is None:
                raise self.refused(f"has {short(token, MAX_QUOTED)}, which is not a known name; {self._notation}")
            self._placeholders[token] = placeholder = f"_{len(self.symbols)}"
            self.symbols[placeholder] = value
        return self._placeholders[token]

    def _open(self, is_function: bool) -> None:
        self._source.append("(")
        self._calls.append(is_function)
        self._pending.append(0)
        self._nest()

    def _nest(self) -> None:
        self._nesting += 1
        if self._nesting > MAX_NESTING:
            raise self.refused(NESTING_MESSAGE)

    def _sign(self, sign: str) -> None:
        self._source.append(sign)
        self._pending[-1] += 1
        self._count()
        self._nest()

    def _operator(self, operator: str) -> bool:
        """Add an operator between operands, a comma or a closing bracket; return whether it is allowed here."""
        if operator in ("^", "**"):
            self._source.append("**")
            self._pending[-1] += 1
            self._nest()
        else:
            self._nesting -= self._pending[-1]
            self._pending[-1] = 0
            if operator == ")":
                if not self._calls:
                    return False
                self._calls.pop()
                self._pending.pop()
                self._nesting -= 1
                self._source.append(")")
                return True
            if operator == ",":
                if not (self._calls and self._calls[-1]):
                    return False
                self._source.append(",")
            elif operator in ("and", "or") or operator in _COMPARISONS:
                if not self._conditions or self._calls:
                    return False
                self._source.append(f" {operator} ")
            elif operator in ("+", "-") and not self._calls and not self._conditions:
                self._sources.append("".join(self._source))
                self._signs.append(-1 if operator == "-" else 1)
                self._source, self._operations = [], 0
                return True
            else:
                self._source.append(operator)
        self._count()
        return True

    def _count(self) -> None:
        self._operations += 1
        if self._operations > MAX_OPERATIONS:
            raise self.refused(f"has more than {MAX_OPERATIONS} operations in one term")

    def _nodes(self) -> Iterator[ast.expr]:
        for k in range(0, len(self._sources), TERMS_PARSED_AT_ONCE):
            source = f"({','.join(self._sources[k : k + TERMS_PARSED_AT_ONCE])},)"
            try:
                parsed = ast.parse(source, mode="eval").body
            except (RecursionError, MemoryError):
                raise self.refused(NESTING_MESSAGE) from None
            assert isinstance(parsed, ast.Tuple)
            yield from parsed.elts

    def _syntax_error(self, begin: int) -> ValueError:
        return self.refused(f"cannot be parsed {short_rest(self.text[begin:], MAX_QUOTED)}; {self._notation}")


def names_in(text: str, dim: int, names: Sequence[str] | None) -> Sequence[str] | None:
    """Return the names of the coordinates in a text: the given ones, or None if x1, x2, ... in it are their numbers."""
    if names is None:
        return None
    numbered, known = coordinate_names(dim), numbers_by_name(names, numbered=False)
    is_numbered = known.keys().isdisjoint(set(NAME.findall(text)).difference(numbered))
    return None if is_numbered and not names_clash(names, numbered) else names


def coordinates_and_parameters(
    text: str, dim: int, names: Sequence[str] | None, parameters: Mapping[str, Any] | None
) -> Callable[[str], Monomial | None]:
    """Return the function from the names in a formula to coordinates and numbers; ``pi`` has its usual value."""
    numbers = {} if parameters is None else read_parameters(parameters, names or ())
    numbered = names_and_parameters(text, dim, "x" if names is None else "", {"pi": math.pi} | numbers)
    places = {} if names is None else numbers_by_name(names, numbered=False)

    def value_of(name: str) -> Monomial:
        if name in places and name not in numbers:
            return Monomial(1, {places[name]: 1})
        value = numbered(name)
        if value is None:
            known = in_one_line(", ".join(names or coordinate_names(dim)), MAX_SHOWN_NAMES)
            others = f", and the parameters {in_one_line(', '.join(numbers), MAX_QUOTED)}" if numbers else ""
            raise ValueError(
                f"{short(text, MAX_QUOTED)} has {short(name, MAX_QUOTED)}, which is not a known name; the coordinates "
                f"are {known}{others}"
            )
        return value

    return value_of


def read_parameters(parameters: Mapping[str, Any], names: Sequence[str] = ()) -> dict[str, Constant]:
    """Validate parameters of formulas; a name must be one word, and no coordinate."""
    if not isinstance(parameters, Mapping):
        raise TypeError(f"parameters are {short(parameters)}; give a mapping from names to numbers")
    for name in parameters:
        if not isinstance(name, str) or NAME.fullmatch(name) is None:
            raise ValueError(f"a parameter is named {short(name)}; give a word of letters and digits")
        if name in names or _X.fullmatch(name):
            raise ValueError(f"the parameter {short(name)} has the name of a coordinate; give another one")
    return {name: read_coefficient(value, f"the parameter {name}") for name, value in parameters.items()}


def names_and_parameters(
    text: str, dim: int, letter: str, numbers: Mapping[str, Constant]
) -> Callable[[str], Monomial | None]:
    """Return the function from the names in a formula to numbers, and to coordinates: a letter and their number."""

    def value_of(name: str) -> Monomial | None:
        if not letter or name[:1] != letter or not name[1:].isdecimal():
            return Monomial(numbers[name], {}) if name in numbers else None
        index = int(name[1:]) if len(name) <= MAX_DIGITS else 0
        if not 1 <= index <= dim:
            raise ValueError(
                f"{short(text, MAX_QUOTED)} has the coordinate {name[:20]}; there are {letter}1 to {letter}{dim}"
            )
        return Monomial(1, {index - 1: 1})

    return value_of


def read_dimension(text: str, dim: int | None, basis: Sequence[str] | None) -> int:
    """Return the number of coordinates of a text, from `dim` or the names in `basis`."""
    if basis is None and dim is None:
        FormulaTree(text, lambda name: Monomial(1, {0: 1}), FUNCTIONS, NOTATION)  # may be no formula at all
        raise ValueError(f"{short(text)} does not determine the number of coordinates; give dim= or basis=")
    names = () if basis is None else read_list(basis, "basis", "give a list of names")
    if not all(isinstance(name, str) for name in names) or len(set(names)) < len(names):
        raise ValueError(f"basis is {short(basis)}; give different names, one for each coordinate")
    count = read_integer(dim if basis is None else len(names), "dim of a Polynomial")
    if dim is not None and count != dim:
        raise ValueError(f"dim is {short(dim)}, and basis has {count} names; give one of them")
    return count

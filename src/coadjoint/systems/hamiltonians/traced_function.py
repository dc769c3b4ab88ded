"""Derivatives of Python functions: operations are recorded, differentiated exactly, and written as new functions."""

from __future__ import annotations

import hashlib
import linecache
import math
import operator
import traceback
from collections.abc import Callable, Collection, Container, Iterable, Mapping, Sequence
from functools import lru_cache, partial
from textwrap import indent
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.invariants.sampled_checks import SAMPLE_TIME, evaluate, sample_points
from coadjoint.errors import in_one_line
from coadjoint.short_repr import short
from coadjoint.systems.hamiltonians.created_arrays import with_new_arrays
from coadjoint.systems.user_functions import OfConstants, first_difference, with_multiples, without_multiples
from coadjoint.validation import is_real

DERIVED_MODULE = "derived_by_coadjoint"
MAX_OPERATIONS = 2000
"""Recorded operations beyond which a function is refused; Numba compiles about 200 of them in a second."""
MAX_TUPLE = 512
"""Entries of an array that are written as one tuple; Numba takes no more than 1000."""

UNARY: dict[str, Callable[[Any, Any], Any]] = {
    "sin": lambda x, y: x.cos(),
    "cos": lambda x, y: -x.sin(),
    "tan": lambda x, y: 1 + y * y,
    "arcsin": lambda x, y: 1 / (1 - x * x).sqrt(),
    "arccos": lambda x, y: -1 / (1 - x * x).sqrt(),
    "arctan": lambda x, y: 1 / (1 + x * x),
    "sinh": lambda x, y: x.cosh(),
    "cosh": lambda x, y: x.sinh(),
    "tanh": lambda x, y: 1 - y * y,
    "arcsinh": lambda x, y: 1 / (x * x + 1).sqrt(),
    "arccosh": lambda x, y: 1 / (x * x - 1).sqrt(),
    "arctanh": lambda x, y: 1 / (1 - x * x),
    "exp": lambda x, y: y,
    "expm1": lambda x, y: x.exp(),
    "exp2": lambda x, y: y * math.log(2.0),
    "log": lambda x, y: 1 / x,
    "log1p": lambda x, y: 1 / (1 + x),
    "log2": lambda x, y: 1 / (x * math.log(2.0)),
    "log10": lambda x, y: 1 / (x * math.log(10.0)),
    "sqrt": lambda x, y: 0.5 / _nonzero(y),
    "cbrt": lambda x, y: 1 / (3 * y * y),
    "abs": lambda x, y: x.sign(),
    "sign": lambda x, y: 0,
    "floor": lambda x, y: 0,
}
"""NumPy function -> its derivative at x, where its value is y."""

BINARY: dict[str, tuple[str, Callable[..., tuple[Any, Any]]]] = {
    "add": ("({} + {})", lambda a, b, y: (1, 1)),
    "sub": ("({} - {})", lambda a, b, y: (1, -1)),
    "mul": ("({} * {})", lambda a, b, y: (b, a)),
    "div": ("({} / {})", lambda a, b, y: (1 / b, -y / b)),
    "pow": ("({} ** {})", lambda a, b, y: _slopes_of_power(a, b, y)),
    "arctan2": ("np.arctan2({}, {})", lambda a, b, y: _slopes_of_angle(a, b)),
    "hypot": ("np.hypot({}, {})", lambda a, b, y: (a / _nonzero(y), b / _nonzero(y))),
    "maximum": ("np.maximum({}, {})", lambda a, b, y: (0.5 + 0.5 * (a - b).sign(), 0.5 - 0.5 * (a - b).sign())),
    "minimum": ("np.minimum({}, {})", lambda a, b, y: (0.5 - 0.5 * (a - b).sign(), 0.5 + 0.5 * (a - b).sign())),
    "greater": ("(1.0 if {} > {} else 0.0)", lambda a, b, y: (0, 0)),
    "greater_equal": ("(1.0 if {} >= {} else 0.0)", lambda a, b, y: (0, 0)),
    "equal": ("(1.0 if {} == {} else 0.0)", lambda a, b, y: (0, 0)),
}
"""Operation -> its text, and its derivatives by both arguments, a and b, where its value is y."""

EVALUATED: dict[str, Callable[..., Any]] = {
    "add": operator.add,
    "sub": operator.sub,
    "mul": operator.mul,
    "div": operator.truediv,
    "pow": operator.pow,
    "neg": operator.neg,
}
"""Operations of numbers that have another name in NumPy."""


COMPARES = "it compares a coordinate or tests it, as `if`, np.where, np.maximum and np.sign do"


CONVERTS = "it converts a coordinate to a plain number, as functions of `math`, `float` and np.floor do"


class TracingError(TypeError):
    """A function does more with its argument than arithmetic and functions of NumPy."""


def _nonzero(divisor: Any) -> Any:
    """Return a divisor, 1 in place of 0 in functions that may have kinks, such as lengths of vectors."""
    return divisor + (divisor == 0.0) if constant_of(divisor) is None and divisor.graph.kinks else divisor


def _slopes_of_angle(a: Any, b: Any) -> tuple[Any, Any]:
    square = _nonzero(a * a + b * b)
    return b / square, -a / square


def _slopes_of_power(base: Any, exponent: Any, value: Any) -> tuple[Any, Any]:
    if constant_of(exponent) is not None and exponent < 1 and base.graph.kinks:
        return exponent * value / _nonzero(base), 0
    if constant_of(exponent) is not None:
        return exponent * (base ** (exponent - 1) if exponent != 1 else 1), 0
    slope = exponent * base ** (exponent - 1)
    return slope, value * (base.log() if constant_of(base) is None else math.log(base))


class Graph:
    """A function of (x) or (x, t), x of shape (n,): operations with their arguments, earlier entries, and a result."""

    # Variables and numbers are entries too. The variables come first, the time after the coordinates. A function of
    # constants too is that of other ones with the values of `fixed` entries, which depend on constants alone. Those
    # that vanish are numbers. Unless it `folds`, each number is an entry of its own, also 0 and 1 in sums and products,
    # so that functions with other numbers have the same operations; and it may have kinks, where the derivative is the
    # mean of those on both sides, and branches: conditions have the outcomes that are `decided`, and are false beyond.

    def __init__(self, n: int, timed: bool, constants: Sequence[float] = (), folds: bool = True) -> None:
        self.folds, self.kinks = folds, not folds
        self.decided: list[bool] = []
        self.conditions: list[int] = []  # entries that are tested
        self.operations: list[str] = []
        self.inputs: list[tuple[int, ...]] = []  # the arguments of each entry
        self.numbers: dict[int, int | float] = {}
        self._variables: dict[int, str] = {}
        self._places: dict[int, int] = {}  # of constants
        self.fixed: dict[int, Any] = {}
        self._known: dict[Any, int] = {}
        self.timed = timed
        self.variables = tuple(self.variable(f"x[{k}]") for k in range(n))
        self.time = self.variable("t") if timed else None
        self.constants = [self._constant(k, value) if value else 0.0 for k, value in enumerate(constants)]
        self.result: Any = 0

    def _add(self, operation: str, inputs: tuple[int, ...] = (), text: str = "") -> int:
        """Return the number of an entry; equal ones are recorded once."""
        key = operation, inputs, text
        if key not in self._known:
            recorded = len(self.operations) - len(self.numbers) - len(self.fixed)
            if operation != "number" and recorded >= MAX_OPERATIONS:
                raise TracingError(f"it takes more than {MAX_OPERATIONS} operations")
            self._known[key] = len(self.operations)
            self.operations.append(operation)
            self.inputs.append(inputs)
            if any(k in self.fixed for k in inputs) and all(k in self.fixed or k in self.numbers for k in inputs):
                self.fixed[self._known[key]] = self._evaluated(self._known[key], self.fixed)
        return self._known[key]

    def _constant(self, number: int, value: float) -> Traced:
        index = self._add("constant", text=str(number))
        self.fixed[index] = np.float64(value)
        self._places[index] = number
        return Traced(self, index)

    def _evaluated(self, index: int, fixed: Mapping[int, Any]) -> Any:
        values = [self.numbers[k] if k in self.numbers else fixed[k] for k in self.inputs[index]]
        name = self.operations[index]
        with np.errstate(all="ignore"):
            return (EVALUATED.get(name) or getattr(np, name))(*values)

    def fixed_at(self, constants: NDArray[np.float64]) -> dict[int, Any]:
        """Return the values of the `fixed` entries at other constants (k,), or (k, members), with the same zeros."""
        found: dict[int, Any] = {}
        for index in self.fixed:
            place = self._places.get(index)
            found[index] = self._evaluated(index, found) if place is None else constants[place]
        return found

    def variable(self, text: str) -> Traced:
        """Return a variable by its text in functions."""
        index = self._add("variable", text=text)
        self._variables[index] = text
        return Traced(self, index)

    def entry(self, argument: Any) -> int:
        """Return the number of the entry of a `Traced` one or of a number."""
        if constant_of(argument) is None:
            return int(argument.index)
        index = self._add("number", text=repr(argument) if self.folds else f"{argument!r} {len(self.operations)}")
        self.numbers[index] = argument
        return index

    def outcome(self, condition: Traced) -> bool:
        """Return the outcome of a condition, that of the next decision if it is not known."""
        if condition.index not in self.conditions:
            self.conditions.append(condition.index)
            if len(self.decided) < len(self.conditions):
                self.decided.append(False)
        return self.decided[self.conditions.index(condition.index)]

    def operand(self, value: Any) -> Any:
        """Return a result of a function as a `Traced` one or a number; TracingError for others."""
        return _operand(value)

    def at(self, index: int) -> Any:
        """Return an entry, the inverse of `entry`."""
        return self.numbers[index] if index in self.numbers else Traced(self, index)

    def record(self, operation: str, *arguments: Any) -> Traced:
        """Return the result of an operation."""
        return Traced(self, self._add(operation, tuple(map(self.entry, arguments))))

    def needed(self, ends: Iterable[int], known: Container[int] = ()) -> list[int]:
        """Return some entries and those that they depend on, in order; without known ones, and what only these need."""
        found, pending = set[int](), list(ends)
        while pending:
            index = pending.pop()
            if index not in found and index not in known:
                found.add(index)
                pending += self.inputs[index]
        return sorted(found)

    def gradient(self, result: Any, variables: Sequence[int], ends: Collection[int] = ()) -> list[Any]:
        """Return the derivatives of a result by entries, variables or numbers, in reverse.

        The entries `ends` count as independent.
        """
        last, wanted = self.entry(result), {*variables}
        slopes: dict[int, Any] = {last: 1}
        for index in range(last, -1, -1):
            inputs, slope = self.inputs[index], slopes.get(index, 0)
            if constant_of(slope) == 0 or not inputs or index in ends or index in self.fixed:
                continue
            for argument, factor in zip(inputs, self._slopes(index), strict=True):
                if argument in wanted or (argument not in self.numbers and argument not in self.fixed):
                    slopes[argument] = slopes.get(argument, 0) + slope * factor
        return [slopes.get(variable, 0) for variable in variables]

    def along(self, results: Sequence[Any], changes: Mapping[int, Any]) -> list[Any]:
        """Return the derivatives of results for changes of entries, variables or numbers, forward."""
        ends, found = [self.entry(result) for result in results], dict(changes)
        for index in self.needed(ends, changes):
            if not found.keys().isdisjoint(self.inputs[index]):
                pairs = zip(self.inputs[index], self._slopes(index), strict=True)
                found[index] = sum(factor * found[k] for k, factor in pairs if k in found)
        return [found.get(index, 0) for index in ends]

    def _slopes(self, index: int) -> tuple[Any, ...]:
        """Return the derivatives of an operation by its arguments."""
        operation, arguments = self.operations[index], [self.at(k) for k in self.inputs[index]]
        if operation == "neg":
            return (-1,)
        if operation in UNARY:
            return (UNARY[operation](arguments[0], Traced(self, index)),)
        return BINARY[operation][1](*arguments, Traced(self, index))

    def value(self) -> Callable[..., Any]:
        """Return the function itself, as a plain function of the recorded operations."""
        return self.function([self.result], "{0}")

    def derivatives(self) -> tuple[Callable[..., Any], Callable[..., Any], Callable[..., Any] | None]:
        """Return value, gradient and Hessian, which Numba compiles; no Hessian of more than `MAX_OPERATIONS`."""
        variables = [one.index for one in self.variables]
        n, slopes = len(variables), self.gradient(self.result, variables)
        value, gradient = self.value(), self.function(slopes, "{array}")
        try:
            lower = [self.gradient(slope, variables[: k + 1]) for k, slope in enumerate(slopes)]
        except TracingError:
            return value, gradient, None
        curvatures = [lower[max(i, j)][min(i, j)] for i in range(n) for j in range(n)]
        return value, gradient, self.function(curvatures, f"{{array}}.reshape(({n}, {n}))")

    def function(self, results: Sequence[Any], returned: str) -> Callable[..., Any]:
        """Return a function of (x) or (x, t) that computes results, in `returned` written as {0} or {array}."""
        # Floats are closed over, so that functions with others have the same text, and the same machine code.
        entries, names = [self.entry(result) for result in results], dict[int, str]()
        needed = (index for index in self.needed(entries, self.fixed) if index not in self.numbers)
        lines = [f"    v{index} = {self._text(index, names)}" for index in needed]
        texts = [self._operand(k, names) if k not in self.numbers else self._float(k, names) for k in entries]
        begins = range(0, len(texts), MAX_TUPLE)
        pieces = [f"np.array(({', '.join(texts[k : k + MAX_TUPLE])},))" for k in begins]
        array = pieces[0] if len(pieces) == 1 else f"np.concatenate(({', '.join(pieces)}))"
        heading = f"def derived(x{', t' if self.timed else ''}):"
        source = "\n".join([heading, *lines, f"    return {returned.format(*texts[:1], array=array)}", ""])
        if not self.fixed:
            return _defined(source, tuple(float(self.numbers[k]) for k in names))
        return self._defined_at(source, tuple(names), self.fixed)

    def _defined_at(
        self, source: str, names: tuple[int, ...], fixed: Mapping[int, Any], constants: Any = None
    ) -> Callable[..., Any]:
        """Return the function of a source text at constants with these values of the entries."""
        defined: Any = _defined(source, tuple(float(fixed[k] if k in fixed else self.numbers[k]) for k in names))

        def make(others: NDArray[np.float64]) -> Callable[..., Any]:
            return self._defined_at(source, names, self.fixed_at(others), others)

        defined.of_constants = OfConstants(make, constants, (source, names))
        return cast("Callable[..., Any]", defined)

    def _text(self, index: int, names: dict[int, str]) -> str:
        if index in self._variables:
            return self._variables[index]
        operation, inputs = self.operations[index], self.inputs[index]
        # Exponents stay in the text: roots and small powers have their own machine code.
        literal = self.numbers.keys() & {*inputs[1:]} if operation == "pow" else ()
        operands = [f"({self.numbers[k]!r})" if k in literal else self._operand(k, names) for k in inputs]
        if operation == "neg":
            return f"-{operands[0]}"
        return f"np.{operation}({operands[0]})" if operation in UNARY else BINARY[operation][0].format(*operands)

    def _operand(self, index: int, names: dict[int, str]) -> str:
        """Return an operand as it is written: an integer as it is, a float by its name."""
        if index in self.fixed:
            return names.setdefault(index, f"c{len(names)}")
        number = self.numbers.get(index)
        if number is None:
            return f"v{index}"
        return f"({number!r})" if isinstance(number, int) else self._float(index, names)

    def _float(self, index: int, names: dict[int, str]) -> str:
        """Return the name of a number, or the text of an integer as a float."""
        number = self.numbers[index]
        return repr(float(number)) if isinstance(number, int) else names.setdefault(index, f"c{len(names)}")


def _defined(source: str, constants: tuple[float, ...]) -> Callable[..., Any]:
    """Define the function of a source text, which `inspect` finds like that of any other function, and its floats."""
    function: Callable[..., Any] = _factory(source, len(constants))(*constants)
    function.__defined__ = source, constants  # type: ignore[attr-defined]
    return function


@lru_cache(maxsize=256)
def _factory(source: str, count: int) -> Callable[..., Any]:
    """Return the function of so many floats that defines the function of a source text."""
    arguments = ", ".join(f"c{k}" for k in range(count))
    text = f"def closed_over({arguments}):\n{indent(source, '    ')}    return derived\n"
    name = f"<derived {hashlib.blake2b(text.encode(), digest_size=8).hexdigest()}>"
    linecache.cache[name] = len(text), None, text.splitlines(keepends=True), name
    names: dict[str, Any] = {"np": np, "__name__": DERIVED_MODULE}
    exec(compile(text, name, "exec", dont_inherit=True), names)
    factory: Callable[..., Any] = names["closed_over"]
    return factory


def picklable_function(function: Any) -> Any:
    """Return a derived function, or a multiple of one, as a call with its source text; anything else unchanged."""
    inner, multiples = without_multiples(function)
    if getattr(inner, "__module__", None) != DERIVED_MODULE:
        return function
    return with_multiples(partial(_defined, *inner.__defined__), multiples)


def restored_function(function: Any) -> Any:
    """Return the function of `picklable_function`."""
    inner, multiples = without_multiples(function)
    return with_multiples(inner(), multiples) if getattr(inner, "func", None) is _defined else function


def picklable_state(instance: Any) -> dict[str, Any]:
    """Return the attributes of an object, with derived functions as their source text: its `__getstate__`."""
    return {name: picklable_function(value) for name, value in vars(instance).items()}


def restore_state(instance: Any, state: Mapping[str, Any]) -> None:
    """Set the attributes of `picklable_state`: the `__setstate__` of an object."""
    vars(instance).update({name: restored_function(value) for name, value in state.items()})


def _operand(value: Any) -> Any:
    """Return an operand of a recorded operation: a `Traced` one unchanged, a constant as an int or a float."""
    if isinstance(value, Traced):
        return value
    if not is_real(value):
        raise TracingError(f"it combines a coordinate with {short(value)}")
    number = int(value) if isinstance(value, int | np.integer) else float(value)
    if not math.isfinite(number):
        raise TracingError(f"it combines a coordinate with {number}")
    return number


def constant_of(argument: Any) -> Any:
    """Return an operand that is a number; None for a `Traced` one."""
    return None if isinstance(argument, Traced) else argument


def _folded(operation: str, a: Any, b: Any) -> Any:
    """Return a sum or product with 0 or 1 without an operation, or None."""
    if not all(one.graph.folds for one in (a, b) if constant_of(one) is None):
        return None
    left, right = constant_of(a), constant_of(b)
    if operation in ("add", "sub") and right == 0:
        return a
    if operation == "add" and left == 0:
        return b
    if operation == "mul":
        for number, other in ((left, b), (right, a)):
            if number in (0, 1, -1):
                return 0 if number == 0 else other if number == 1 else -other
    if operation == "div" and left == 0:
        return 0
    if operation in ("div", "pow") and right == 1:
        return a
    return None


def _beside_infinity(operation: str, finite: Traced, other: float, swapped: bool) -> Any:
    """Return the result of an operation of a law, whose coordinates are finite, and an infinite number."""
    if operation in ("maximum", "minimum"):
        return other if (other > 0.0) == (operation == "maximum") else finite
    if operation in ("add", "sub"):
        return -other if operation == "sub" and not swapped else other
    if operation in ("greater", "greater_equal", "equal"):
        return operation != "equal" and (other > 0.0) == swapped
    raise TracingError(f"it combines a coordinate with {other}")


def _binary(operation: str, swapped: bool = False) -> Callable[[Traced, Any], Any]:
    def apply(self: Traced, other: Any) -> Any:
        if isinstance(other, np.ndarray):
            if other.ndim:
                return NotImplemented
            other = other.item()
        if not self.graph.folds and is_real(other) and math.isinf(other):
            return _beside_infinity(operation, self, other, swapped)
        other = _operand(other)
        a, b = (other, self) if swapped else (self, other)
        folded = _folded(operation, a, b)
        return self.graph.record(operation, a, b) if folded is None else folded

    return apply


def _unary(operation: str) -> Callable[[Traced], Traced]:
    def apply(self: Traced) -> Traced:
        return self.graph.record(operation, self)

    return apply


def _with_kink(operation: str, refusal: str, swapped: bool = False) -> Callable[..., Any]:
    apply: Any = _unary(operation) if operation in UNARY else _binary(operation, swapped)

    def apply_to_law(self: Traced, *others: Any) -> Any:
        if not self.graph.kinks:
            raise TracingError(refusal)
        return apply(self, *others)

    return apply_to_law


def _refused(what: str) -> Callable[..., Any]:
    def refuse(self: Traced, *arguments: Any) -> Any:
        raise TracingError(what)

    return refuse


class Traced:
    """A number whose operations are recorded; NumPy applies its functions to such objects by their methods."""

    __slots__ = ("graph", "index")
    __hash__ = None  # type: ignore[assignment]

    def __init__(self, graph: Graph, index: int) -> None:
        self.graph, self.index = graph, index

    def conjugate(self) -> Traced:
        """Return the number itself, since it is real."""
        return self

    __pos__ = conjugate
    __neg__ = _unary("neg")
    __add__, __radd__ = _binary("add"), _binary("add", swapped=True)
    __sub__, __rsub__ = _binary("sub"), _binary("sub", swapped=True)
    __mul__, __rmul__ = _binary("mul"), _binary("mul", swapped=True)
    __truediv__, __rtruediv__ = _binary("div"), _binary("div", swapped=True)
    __pow__, __rpow__ = _binary("pow"), _binary("pow", swapped=True)
    arctan2, hypot = _binary("arctan2"), _binary("hypot")
    maximum, minimum = _with_kink("maximum", COMPARES), _with_kink("minimum", COMPARES)
    __abs__ = _with_kink("abs", "it takes an absolute value (abs, np.abs), which has a kink")
    __gt__, __lt__ = _with_kink("greater", COMPARES), _with_kink("greater", COMPARES, swapped=True)
    __ge__, __le__ = _with_kink("greater_equal", COMPARES), _with_kink("greater_equal", COMPARES, swapped=True)
    __eq__ = _with_kink("equal", COMPARES)  # type: ignore[assignment]
    __ne__ = _refused(COMPARES)  # type: ignore[assignment]
    __floor__ = _with_kink("floor", CONVERTS)

    def __bool__(self) -> bool:
        if not self.graph.kinks:
            raise TracingError(COMPARES)
        return self.graph.outcome(self)

    __float__ = __int__ = __complex__ = _refused(CONVERTS)


for _name in UNARY.keys() - {"abs", "floor"}:
    setattr(Traced, _name, _unary(_name))


def traced(
    function: Callable[..., Any],
    n: int,
    timed: bool,
    in_place: bool = False,
    constants: NDArray[np.float64] | None = None,
) -> Graph:
    """Record a function of (x) or (x, t), x (n,); TracingError if impossible; `in_place`, it may fill its arrays.

    With `constants` it is a function of (x, constants), recorded for all that are zero where these are.
    """
    graph, x = Graph(n, timed, () if constants is None else constants.tolist()), np.empty(n, dtype=object)
    x[:] = graph.variables
    if constants is not None:
        recorded, of_both = np.array(graph.constants, dtype=object), function

        def function(x: Any) -> Any:
            return of_both(x, recorded if x.dtype == object else constants)

    function = getattr(function, "py_func", function)
    called = with_new_arrays(function, lambda found: found.astype(object)) if in_place else function
    try:
        result = called(x, graph.time) if timed else called(x)
    except Exception as reason:
        kind = "" if isinstance(reason, TracingError) else f"{type(reason).__name__}: "
        raise TracingError(in_one_line(f"{kind}{reason}{_line_of(function, reason)}", 300)) from reason
    if isinstance(result, np.ndarray) and result.size == 1:
        result = result.item()
    graph.result = _operand(result)
    _compare(graph.value(), function, n, timed)
    return graph


def traced_with_arrays(function: Callable[..., Any], n: int, timed: bool) -> Graph:
    """Record a function as `traced`, which may fill arrays that it creates."""
    try:
        return traced(function, n, timed)
    except TracingError:  # only now, since arrays of objects have fewer functions
        return traced(function, n, timed, in_place=True)


def _line_of(function: Any, reason: Exception) -> str:
    """Return the line of a function of the user that raised, as the end of a message; empty if it is not known."""
    code = getattr(function, "__code__", None)
    if code is None or function.__module__.partition(".")[0] == "coadjoint":
        return ""
    frames = traceback.extract_tb(reason.__traceback__)
    lines = [one.line for one in frames if (one.filename, one.name) == (code.co_filename, code.co_name)]
    return f", in `{lines[-1]}`" if lines and lines[-1] else ""


def _compare(recorded: Callable[..., Any], function: Callable[..., Any], n: int, timed: bool) -> None:
    """Raise TracingError if the recorded operations have other values than the function, as where it tests types."""

    def value_of(one: Callable[..., Any], x: Any) -> Any:
        value = evaluate(one, x.copy(), timed)
        return math.nan if value is None or np.size(value) != 1 else np.reshape(value, ())

    for x in sample_points(n):
        difference = first_difference(lambda x, t: value_of(function, x), value_of(recorded, x), x, SAMPLE_TIME)
        if difference is not None:
            raise TracingError(f"it is another function where its operations are recorded, with {difference}")

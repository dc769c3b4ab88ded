"""Hamiltonians given by users: functions of JAX, formulas that are no polynomials, and consistency of classes."""

from __future__ import annotations

import ast
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.invariants.sampled_checks import SAMPLE_TIME, evaluate, sample_points
from coadjoint.algebra.polynomials.formula_tree import (
    FUNCTIONS,
    NOTATION,
    FormulaTree,
    coordinates_and_parameters,
    factors,
    read_parameters,
    summands,
)
from coadjoint.algebra.polynomials.formulas import Expansion
from coadjoint.errors import in_one_line
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.short_repr import short
from coadjoint.systems.hamiltonians.terms import built_in
from coadjoint.systems.hamiltonians.traced_function import TracingError, traced
from coadjoint.systems.user_functions import check_derivative

REQUIRED_ATTRIBUTES = ("dim", "timed", "bind", "value", "gradient", "hessian", "terms")
X64 = ', which JAX has with jax.config.update("jax_enable_x64", True)'


@dataclass(frozen=True)
class JaxFunction:
    """The derivative of some order, 0 to 2, of a function of JAX of (x), or of (x, t) if `timed`, in float64."""

    function: Callable[..., Any]
    order: int
    timed: bool

    called_in_python: ClassVar[bool] = True
    automatic: ClassVar[bool] = True

    @cached_property
    def compiled(self) -> Callable[..., Any]:
        """The derivative, compiled by JAX when it is first called."""
        import jax

        derivatives = (lambda f: f, jax.grad, jax.hessian)
        compiled: Callable[..., Any] = jax.jit(derivatives[self.order](self.function))
        return compiled

    def __call__(self, x: Any, t: float = 0.0) -> npt.NDArray[np.float64]:
        """Return the derivative at x and t; raise TypeError for numbers of another type than float64."""
        y = np.asarray(x)
        if y.dtype == object:  # of a recorded function
            raise TracingError("a function of JAX has no parts; Splitting takes co.jax.features, in co.jax.solution")
        if y.dtype != np.float64:
            raise TypeError(f"a function of JAX is given numbers of {y.dtype}; its derivatives are of float64 only")
        result = np.asarray(self.compiled(y, t) if self.timed else self.compiled(y))
        if result.dtype != np.float64:
            raise TypeError(f"the function of JAX returns numbers of {result.dtype}, not of float64{X64}")
        return result

    def __reduce__(self) -> tuple[Any, ...]:
        return JaxFunction, (self.function, self.order, self.timed)


def is_array_of_jax(value: Any) -> bool:
    """Return whether a value is an array of JAX, without importing JAX."""
    jax = sys.modules.get("jax")
    return jax is not None and isinstance(value, jax.Array)


def check_traceable(function: Callable[..., Any], n: int, timed: bool) -> None:
    """Raise TypeError if JAX cannot trace a function, or it does not return one number of float64."""
    import jax

    try:
        result = jax.eval_shape(function, *((np.zeros(n), 0.0) if timed else (np.zeros(n),)))
    except (jax.errors.JAXTypeError, jax.errors.JAXIndexError) as reason:
        raise TypeError(
            f"JAX cannot trace the Hamiltonian ({type(reason).__name__}: {in_one_line(str(reason), 160)}); compute "
            "with jax.numpy only"
        ) from reason
    except Exception as reason:
        raise TypeError(
            f"the Hamiltonian fails at a state of the shape ({n},) ({type(reason).__name__}: "
            f"{in_one_line(str(reason), 160)}); it takes one state of {n} coordinates, before params and time if any"
        ) from reason
    if result.shape != () or result.dtype != np.float64:
        raise TypeError(
            f"the Hamiltonian returns an array of JAX of {result.dtype} and shape {result.shape}; it must return one "
            f"number of float64{'' if jax.config.jax_enable_x64 else X64}"
        )


def value_at(tree: FormulaTree, x: Any) -> Any:
    """Return the value of a formula at x, by arithmetic and functions of NumPy; numbers in it are rounded first."""
    constants = Expansion(tree, 1)
    coordinates = {name: index for name, symbol in tree.symbols.items() for index in symbol.powers}

    def of(node: ast.expr) -> Any:
        if not any(isinstance(part, ast.Name) and part.id in coordinates for part in ast.walk(node)):
            constant = constants.of(node)
            return constant if isinstance(constant, int) else float(constant)
        match node:
            case ast.Name():
                return x[coordinates[node.id]]
            case ast.UnaryOp(op=ast.USub()):
                return -of(node.operand)
            case ast.UnaryOp():
                return of(node.operand)
            case ast.Call(func=ast.Name(id=name)):
                if len(node.args) != 1:
                    raise tree.refused(f"has {name} of {len(node.args)} arguments; it takes one")
                return getattr(np, FUNCTIONS[name][0])(of(node.args[0]))
            case ast.BinOp(op=ast.Pow()):
                return of(node.left) ** of(node.right)
            case ast.BinOp(op=ast.Add() | ast.Sub()):
                return total(summands(node))
        (_, first), *others = factors(node)
        product = of(first)
        for divides, factor in others:
            value = of(factor)
            if divides and isinstance(value, int | float) and value == 0:
                raise tree.refused("divides by zero")
            product = product / value if divides else product * value
        return product

    def total(signed: Iterable[tuple[int, ast.expr]]) -> Any:
        result: Any = 0
        for sign, node in signed:
            result = result + of(node) if sign > 0 else result - of(node)
        return result

    return total(tree.terms)


class ParsedFunction:
    """The function of x of a formula, such as ``"a*x1^2/2 + cos(x2)"``: its operations as a plain Python function."""

    def __init__(
        self, text: str, dim: int, names: Sequence[str] | None = None, parameters: Mapping[str, Any] | None = None
    ) -> None:
        self.text, self.dim = text, dim
        self.names = None if names is None else tuple(names)
        self.parameters = read_parameters(parameters or {})
        tree = FormulaTree(
            text, coordinates_and_parameters(text, dim, self.names, self.parameters), FUNCTIONS, NOTATION
        )
        try:
            recorded = traced(lambda x: value_at(tree, x), dim, timed=False)
        except TracingError as reason:
            if isinstance(reason.__cause__, ValueError):
                raise reason.__cause__ from None
            raise ValueError(f"{short(text)} cannot be evaluated: {reason}") from None
        self._function = recorded.value()

    def __call__(self, x: Any) -> Any:
        return self._function(x)

    @property
    def __name__(self) -> str:
        return self.text

    def __reduce__(self) -> tuple[Any, ...]:
        return ParsedFunction, (self.text, self.dim, self.names, self.parameters)

    def __repr__(self) -> str:
        return short(self.text)


def is_user_defined(H: Any) -> bool:
    """Return whether it is an object of a user-defined type."""
    return type(H).__module__.partition(".")[0] != __name__.partition(".")[0]


def check_user_hamiltonian(H: Any, n: int) -> None:
    """Raise an error if value, gradient, second derivatives and terms of a bound user-defined Hamiltonian disagree."""
    kind = type(H).__name__
    if getattr(H, "dim", None) != n:
        raise ValueError(f"bind({n}) of {kind} returned a Hamiltonian of dimension {short(getattr(H, 'dim', None))}")
    terms = H.terms()
    for term in terms:
        if not hasattr(term, "describe_to"):
            raise TypeError(
                f"{kind}.terms() holds {short(term)}; a term is a QuadraticTerm, PolynomialTerm or FunctionTerm"
            )
    value, gradient = (f"{kind}.{name}" for name in ("value", "gradient"))
    check_derivative(H.value, H.gradient, names=(value, gradient), shapes=((), (n,)), n=n, timed=H.timed)
    failures: list[Exception] = []
    evaluate(H.hessian, sample_points(n)[0], H.timed, failures=failures)
    if not any(isinstance(reason, TypeError) for reason in failures):  # second derivatives are known
        names = (gradient, f"{kind}.hessian")
        check_derivative(H.gradient, H.hessian, names=names, shapes=((n,), (n, n)), n=n, timed=H.timed)
    for x in sample_points(n):
        declared = evaluate(H.gradient, x, H.timed)
        if declared is None:
            continue
        total, size = np.zeros(n), 0.0
        for term in built_in(terms):
            part = np.zeros((1, 1, n))
            term.add_gradients(part, x[None, None], [SAMPLE_TIME])
            total += part[0, 0]
            size += float(np.max(np.abs(part), initial=0.0))
            if term.form is not None:
                size += float(np.max(np.abs(term.form.values), initial=0.0) * np.abs(x).sum())
        if not np.all(np.abs(total - declared) <= 2.0**10 * UNIT_ROUNDOFF * (size + np.abs(declared))):
            k = int(np.argmax(np.abs(total - declared)))
            raise ValueError(
                f"{kind}.terms() contradict {gradient}: component {k} is {total[k]:.6g} by the terms and "
                f"{float(declared[k]):.6g} by the gradient at a sample point; correct the one that is wrong"
            )

"""Python functions of formulas that are no polynomials; they are stored and pickled as their text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from coadjoint.algebra.polynomials.formula_tree import parse_tree
from coadjoint.algebra.polynomials.formulas import (
    FUNCTIONS,
    NOTATION,
    coordinates_and_parameters,
    read_parameters,
    value_at,
)
from coadjoint.short_repr import short
from coadjoint.systems.hamiltonians.traced_function import TracingError, traced


class ParsedFunction:
    """The function of x of a formula, such as ``"a*x1^2/2 + cos(x2)"``: its operations as a plain Python function.

    Examples
    --------
    >>> ParsedFunction("a*x1^2 + sqrt(x2)", 2, None, {"a": 3})([2.0, 4.0]).item()
    14.0
    """

    def __init__(
        self, text: str, dim: int, names: Sequence[str] | None = None, parameters: Mapping[str, Any] | None = None
    ) -> None:
        self.text, self.dim = text, dim
        self.names = None if names is None else tuple(names)
        self.parameters = read_parameters(parameters or {})
        tree = parse_tree(text, coordinates_and_parameters(text, dim, self.names, self.parameters), FUNCTIONS, NOTATION)
        try:
            recorded = traced(lambda x: value_at(tree, x), dim, timed=False)
        except TracingError as reason:
            if isinstance(reason.__cause__, ValueError):
                raise reason.__cause__ from None
            raise ValueError(f"{short(text)} cannot be evaluated: {reason}") from None
        self._function = recorded.value()

    def __call__(self, x: Any) -> Any:
        """Return the value at x."""
        return self._function(x)

    @property
    def __name__(self) -> str:
        """The text."""
        return self.text

    def __reduce__(self) -> tuple[Any, ...]:
        return ParsedFunction, (self.text, self.dim, self.names, self.parameters)

    def __repr__(self) -> str:
        return short(self.text)

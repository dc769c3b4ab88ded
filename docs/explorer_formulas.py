"""Numbers of the explorer as formulas of its sliders, made by the functions of the library that compute them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np
from explorer_systems import Shown

from coadjoint.systems.coefficients import Key, coefficients_in
from coadjoint.systems.registry import energy_of


class Formula:
    """A formula in reverse Polish notation, made by arithmetic in the order of its operations."""

    def __init__(self, text: str) -> None:
        self.text = text

    def __add__(self, other: Any) -> Formula:
        return self if _is(other, 0) else _joined(self, other, "+")

    def __radd__(self, other: Any) -> Formula:
        return self if _is(other, 0) else _joined(other, self, "+")

    def __sub__(self, other: Any) -> Formula:
        return self if _is(other, 0) else _joined(self, other, "-")

    def __rsub__(self, other: Any) -> Formula:
        return -self if _is(other, 0) else _joined(other, self, "-")

    def __mul__(self, other: Any) -> Any:
        return 0 if _is(other, 0) else self if _is(other, 1) else _joined(self, other, "*")

    def __rmul__(self, other: Any) -> Any:
        return 0 if _is(other, 0) else self if _is(other, 1) else _joined(other, self, "*")

    def __truediv__(self, other: Any) -> Formula:
        return _joined(self, other, "/")

    def __rtruediv__(self, other: Any) -> Any:
        return 0 if _is(other, 0) else _joined(other, self, "/")

    def __neg__(self) -> Formula:
        return _joined(-1, self, "*")


def _is(value: Any, number: int) -> bool:
    return not isinstance(value, Formula) and bool(value == number)


def _joined(first: Any, second: Any, operation: str) -> Formula:
    texts = (one.text if isinstance(one, Formula) else format(one, ".17g") for one in (first, second))
    return Formula(" ".join([*texts, operation]))


def evaluate(formula: str, values: Mapping[str, float]) -> float:
    """Evaluate a formula, operation by operation, as the page does."""
    stack: list[float] = []
    operations: dict[str, Callable[[float, float], float]] = {
        "+": lambda a, b: a + b,
        "-": lambda a, b: a - b,
        "*": lambda a, b: a * b,
        "/": lambda a, b: a / b,
    }
    for token in formula.split():
        if token in operations:
            second, first = stack.pop(), stack.pop()
            stack.append(operations[token](first, second))
        else:
            stack.append(float(values[token]) if token in values else float(token))
    (result,) = stack
    return result


def energy_formulas(shown: Shown) -> dict[Key, str]:
    """Return the coefficients of the energy that depend on the sliders, by the coordinates of their monomials.

    Those of a ready-made system are computed by the energy that it declares.
    """
    sliders = {slider.name: Formula(slider.name) for slider in shown.sliders}
    if not sliders:
        return {}
    if shown.energy:
        energy = _coefficients(eval(shown.energy, dict(sliders)))
    else:
        energy = eval(shown.code.format(**{name: name for name in sliders}), {"co": _library(shown), **sliders})
    return {key: value.text for key, value in energy.by_key().items() if isinstance(value, Formula)}


def _library(shown: Shown) -> Any:
    """Return what the code of a system calls, with functions that return the coefficients of the energy."""
    parameters = shown.build({slider.name: slider.value for slider in shown.sliders}).parameters

    def ready_made(name: str) -> Callable[..., Any]:
        def energy(**arguments: Any) -> Any:
            declared = energy_of(name)
            assert declared is not None
            given = {**parameters, **arguments}
            numbers = {one: np.array(given[one], dtype=object) for one in declared.parameters}
            return coefficients_in(declared.function(**numbers, **{one: given[one] for one in declared.others}))

        return energy

    names = shown.code.split("co.systems.")[1:]
    return SimpleNamespace(
        systems=SimpleNamespace(**{(name := one.partition("(")[0]): ready_made(name) for one in names}),
        LieAlgebra=lambda *_, **__: None,
        Quadratic=_coefficients,
        LiePoissonSystem=lambda _, energy: energy,
    )


def _coefficients(M: Any, linear: Any = ()) -> Any:
    return coefficients_in((np.array(M, dtype=object), np.array(linear, dtype=object)))

"""Consistency of user-defined classes of Hamiltonians: functions against terms."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.short_repr import short
from coadjoint.systems.hamiltonians.terms import FunctionTerm, PolynomialTerm, QuadraticTerm
from coadjoint.systems.user_functions import SAMPLE_TIME, check_derivative, evaluate, sample_points

REQUIRED_ATTRIBUTES = ("dim", "timed", "bind", "value", "gradient", "hessian", "terms")


def check_user_hamiltonian(H: Any, n: int) -> None:
    """Raise an error if value, gradient, second derivatives and terms of a bound user-defined Hamiltonian disagree.

    Compiled loops use the terms; Python code uses the functions.
    """
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
    if not isinstance(evaluate(H.hessian, sample_points(n)[0], H.timed), TypeError):
        names = (gradient, f"{kind}.hessian")
        check_derivative(H.gradient, H.hessian, names=names, shapes=((n,), (n, n)), n=n, timed=H.timed)
    for x in sample_points(n):
        declared = evaluate(H.gradient, x, H.timed)
        if isinstance(declared, Exception):
            continue
        term_gradient = _Gradient(x)
        for term in terms:
            term.describe_to(term_gradient)
        total, size = term_gradient.total, term_gradient.size
        if not np.all(np.abs(total - declared) <= 2.0**10 * UNIT_ROUNDOFF * (size + np.abs(declared))):
            k = int(np.argmax(np.abs(total - declared)))
            raise ValueError(
                f"{kind}.terms() contradict {gradient}: component {k} is {total[k]:.6g} by the terms and "
                f"{float(declared[k]):.6g} by the gradient at a sample point; correct the one that is wrong"
            )


class _Gradient:
    """The gradient of a sum of terms at a sample point, and the sum of absolute values for tolerances."""

    def __init__(self, x: npt.NDArray[np.float64]) -> None:
        self.x, self.total, self.size = x, np.zeros(len(x)), 0.0

    def _add(self, part: npt.NDArray[np.float64]) -> None:
        self.total += part
        self.size += float(np.max(np.abs(part), initial=0.0))

    def quadratic(self, term: QuadraticTerm) -> None:
        part = term.linear.astype(np.float64)
        np.add.at(part, term.rows, term.values * self.x[term.indices])
        self.size += float(np.max(np.abs(term.values), initial=0.0) * np.abs(self.x).sum())
        self._add(part)

    def polynomial(self, term: PolynomialTerm) -> None:
        self._add(np.asarray(term.polynomial.gradient(self.x), dtype=np.float64))

    def function(self, term: FunctionTerm) -> None:
        y, part = self.x[term.coordinates], np.zeros(len(self.x))
        values = term.gradient(y[0] if term.scalar else y, *((SAMPLE_TIME,) if term.timed else ()))
        np.add.at(part, term.coordinates, np.asarray(values, dtype=np.float64).reshape(len(y)))
        self._add(part)

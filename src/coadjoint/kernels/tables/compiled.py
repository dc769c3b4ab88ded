"""Tables with the compiled user functions that they call."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.functions.compiled_functions import (
    CompiledFunction,
    CompiledShares,
    FormulaFunction,
    Owners,
    PythonCallback,
    warn_slow_compilation,
)
from coadjoint.kernels.tables.structures import unrecorded
from coadjoint.program.sources import Sources
from coadjoint.systems.energy_derivatives import FunctionDerivative
from coadjoint.systems.hamiltonians.terms import FunctionTerm
from coadjoint.systems.user_functions import SumOfShares, forms_of, is_called_in_python

ORDERS = {"value": 0, "gradient": 1, "hessian": 2}


class CompiledTables(NamedTuple):
    """Tables for a compiled loop, compiled functions that must live as long, and their sources as in `CompiledLoop`."""

    tables: Any
    keepalive: tuple[Any, ...]
    sources: Callable[[], Sources] = unrecorded


def addresses_of(
    functions: Mapping[int, FunctionTerm], count: int, derivative: str, owner: str
) -> tuple[NDArray[np.int64], Owners]:
    """Compile a derivative of FUNCTION terms by number; return addresses (count,), 0 for others, and owners."""
    addresses = np.zeros(count, dtype=np.int64)
    keepalive: list[CompiledFunction | CompiledShares | FormulaFunction | PythonCallback] = []
    if not functions:
        return addresses, ()
    warn_slow_compilation(
        user_function
        for term in functions.values()
        if forms_of(user_function := getattr(term, derivative)) is None and not is_called_in_python(user_function)
    )
    for k, term in functions.items():
        function = getattr(term, derivative)
        if (forms := forms_of(function)) is not None:
            keepalive.append(FormulaFunction(forms))
            addresses[k] = keepalive[-1].address
            continue
        size = len(term.coordinates)
        results = size ** ORDERS[derivative]
        if is_called_in_python(function):
            keepalive.append(PythonCallback(function, size, results))
            addresses[k] = keepalive[-1].address
            continue
        shared = isinstance(function, SumOfShares)
        compiled = CompiledFunction(
            function.share if shared else function,
            size,
            results,
            scalar=term.scalar,
            flat=derivative != "value",
            timed=term.timed or shared,
            what=f"the {derivative} of {owner}",
        )
        keepalive.append(CompiledShares(compiled, function.shares, results) if shared else compiled)
        addresses[k] = keepalive[-1].address
    return addresses, tuple(keepalive)


def addresses_by_coefficients(functions: Sequence[FunctionDerivative], count: int) -> tuple[NDArray[np.int64], Owners]:
    """Compile the derivatives of functions by parameters, of the last of `count` terms; return them as above."""
    compiled = [
        CompiledFunction(
            one.gradient,
            len(one.coordinates),
            len(one.entries) * len(one.coordinates),
            scalar=False,
            flat=True,
            timed=False,
            what="the derivative of the energy by a parameter",
        )
        for one in functions
    ]
    addresses = np.zeros(count, dtype=np.int64)
    addresses[count - len(compiled) :] = [one.address for one in compiled]
    return addresses, tuple(compiled)

"""Tables with the compiled user functions that they call, and their pickling: functions are compiled again, and
addresses are replaced by those in the receiving process.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.functions.compiled_functions import (
    CompiledFunction,
    CompiledShares,
    FormulaFunction,
    Owner,
    Owners,
    PythonCallback,
    raised_by,
    warn_slow_compilation,
)
from coadjoint.kernels.tables.structures import structure_of_table, table_fields, unrecorded, with_arrays
from coadjoint.systems.user_functions import SumOfShares, forms_of, is_called_in_python

if TYPE_CHECKING:
    from coadjoint.program.sources import Sources
    from coadjoint.systems.energy_derivatives import FunctionDerivative
    from coadjoint.systems.hamiltonians.terms import FunctionTerm

ORDERS = {"value": 0, "gradient": 1, "hessian": 2}


LIBRARY_ADDRESSES: dict[int, tuple[Callable[[Any], int], Any]] = {}
"""Address, in tables, of a step or a BLAS routine -> function that finds it in any process, and its argument."""
FIELDS_OF_LIBRARY_ADDRESSES = ("step", "tables.whole")
"""Fields of integers that contain them."""


@dataclass(frozen=True)
class CompiledTables:
    """Tables for a compiled loop, objects that must live as long, and the sources of the constants. `referenced` are
    tables read by address, by its index among the integers of the step.
    """

    tables: Any
    keepalive: tuple[Any, ...] = ()
    sources: Callable[[], Sources] = unrecorded
    referenced: Mapping[int, Any] = field(default_factory=dict)

    def raised(self) -> BaseException | None:
        """Return and clear the exception that a function of the user raised in the loop, if any."""
        return raised_by(self.keepalive)

    @property
    def is_picklable(self) -> bool:
        """Whether all objects that the addresses point to can be rebuilt in another process."""
        return not self.referenced and all(isinstance(owner, Owner) for owner in self.keepalive)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle tables that are `is_picklable` with the objects at their addresses, without the sources."""
        owners = [(owner.address, owner) for owner in self.keepalive]
        numbers = {number for array in _addresses(self.tables).values() for number in array.ravel().tolist()}
        in_library = {address: LIBRARY_ADDRESSES[address] for address in numbers & LIBRARY_ADDRESSES.keys()}
        common = fields(CompiledTables)
        others = {one.name: getattr(self, one.name) for one in fields(self) if one not in common}
        return _restored, (type(self), self.tables, owners, in_library, others)


def _restored(
    kind: Any,
    tables: Any,
    owners: Sequence[tuple[int, Any]],
    in_library: Mapping[int, tuple[Callable[[Any], int], Any]],
    others: Mapping[str, Any],
) -> Any:
    """Return pickled tables with the addresses of this process; functions are compiled again, once."""
    moved = {address: owner.address for address, owner in owners}
    moved |= {address: find(of) for address, (find, of) in in_library.items()}
    if moved:
        arrays = {name: (array.ravel().tolist(), array.shape) for name, array in _addresses(tables).items()}
        relocated = {
            name: np.array([moved.get(number, number) for number in numbers], np.int64).reshape(shape)
            for name, (numbers, shape) in arrays.items()
        }
        tables = with_arrays(tables, relocated)
    return kind(tables, tuple(owner for _, owner in owners), **others)


def _addresses(tables: Any) -> dict[str, NDArray[np.int64]]:
    """Return the arrays of tables that contain addresses, by name."""
    kind: Any = type(tables)
    return {
        one.name: one.of(tables)
        for one in table_fields(structure_of_table(kind))
        if one.token == "addresses" or (one.token == "integers" and one.name in FIELDS_OF_LIBRARY_ADDRESSES)
    }


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

"""Tables as C structures, the compiled user functions that they call, and their pickling: functions are compiled
again, and addresses are replaced by those in the receiving process.
"""

from __future__ import annotations

import ctypes
import functools
import math
import struct
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import partial
from operator import attrgetter, itemgetter
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.sparse_sums import Floats, Integers
from coadjoint.algebra.invariants.invariant import Forms
from coadjoint.kernels.functions.compiled_functions import KernelFunction, compiled_function, python_callback
from coadjoint.kernels.interface import check_fields, kernel_interface, limit
from coadjoint.kernels.tables.convolutions import convolution_fields
from coadjoint.program.sources import CoefficientNumbers
from coadjoint.systems.lattices.dipoles import DipolarFunction
from coadjoint.systems.user_functions import (
    SumOfShares,
    forms_of,
    is_called_in_python,
    of_constants,
    without_multiples,
)

if TYPE_CHECKING:
    from coadjoint.program.sources import Sources
    from coadjoint.systems.energy_derivatives import FunctionDerivative
    from coadjoint.systems.hamiltonians.terms import FunctionTerm

# Types of fields in `source/boundary/tables.hpp`: numbers, or elements of arrays.
SCALARS: dict[str, Any] = {"integer": ctypes.c_int64, "number": ctypes.c_double, "flag": ctypes.c_int64}
ARRAYS: dict[str, Any] = {
    "bytes": np.dtype(np.uint8),
    "indices": np.dtype(np.uint32),
    "integers": np.dtype(np.int64),
    "addresses": np.dtype(np.int64),
    "numbers": np.dtype(np.float64),
    "constants": np.dtype(np.float64),
}
PER_MEMBER_TYPES = frozenset(("addresses", "constants"))
"""Types of arrays with one column per member if the constants of members differ."""

Tables = TypeVar("Tables", bound=tuple[Any, ...])


class NotWritable(ValueError):
    """The tables depend on numbers in a way that cannot be written into them; the message names the field."""


def unrecorded() -> Any:
    """Refuse to return the sources of tables."""
    raise NotWritable("its tables do not record where they are")


@functools.cache
def structures() -> dict[str, Any]:
    """Return the C structures of the tables by name."""
    by_name: dict[str, Any] = {}
    for name, listed in kernel_interface().tables.items():
        members = [
            (label, SCALARS.get(kind) or (ctypes.c_void_p if kind in ARRAYS else by_name[kind]))
            for kind, label in listed
        ]
        by_name[name] = type(name, (ctypes.Structure,), {"_fields_": members, "kinds": [kind for kind, _ in listed]})
    return by_name


@functools.cache
def structure_of_table(kind: Any) -> Any:
    """Return the C structure with the name and fields of a class of named tuples; raise ImportError if they differ."""
    check_fields(kind.__name__, getattr(kind, "_fields", ()))
    return structures()[kind.__name__]


class TableField(NamedTuple):
    """A number or an array of a table or of a nested one: its dotted name, its type, and its offset in bytes."""

    name: str
    token: str
    offset: int

    def of(self, tables: Any) -> Any:
        """Return the value in named tuples."""
        return attrgetter(self.name)(tables)


@functools.cache
def table_fields(structure: Any) -> tuple[TableField, ...]:
    """Return the fields of a C structure and of nested ones, in its order."""
    found: list[TableField] = []
    for (name, kind), token in zip(structure._fields_, structure.kinds, strict=True):
        offset = getattr(structure, name).offset
        if token in SCALARS or token in ARRAYS:
            found.append(TableField(name, token, offset))
        else:
            found += [TableField(f"{name}.{one.name}", one.token, offset + one.offset) for one in table_fields(kind)]
    return tuple(found)


def with_arrays(tables: Tables, arrays: Mapping[str, Any]) -> Tables:
    """Return tables with other arrays, by their dotted names."""
    named: Any = tables
    changed: dict[str, Any] = {}
    nested: dict[str, dict[str, Any]] = {}
    for name, array in arrays.items():
        outer, _, inner = name.partition(".")
        if inner:
            nested.setdefault(outer, {})[inner] = array
        else:
            changed[outer] = array
    changed |= {outer: with_arrays(getattr(named, outer), inner) for outer, inner in nested.items()}
    replaced: Tables = named._replace(**changed)
    return replaced


def as_structure(table: Any) -> Any:
    """Return a named tuple as the C structure of its name, which keeps arrays alive; a structure unchanged."""
    if isinstance(table, ctypes.Structure):
        return table
    table_class: Any = type(table)
    return _filled(structure_of_table(table_class), partial(getattr, table), table)


def filled(name: str, **fields: Any) -> Any:
    """Return the C structure of a name with these fields, for a table that Python does not read."""
    check_fields(name, fields)
    return _filled(structures()[name], fields.__getitem__, fields)


def _filled(kind: Any, value_of: Callable[[str], Any], source: Any) -> Any:
    numbers = []
    for (label, _), token in zip(kind._fields_, kind.kinds, strict=True):
        value = value_of(label)
        if token in ARRAYS:
            if value.dtype != ARRAYS[token] or not value.flags.c_contiguous:
                raise TypeError(f"{kind.__name__}.{label} is {value.dtype}, not a contiguous {ARRAYS[token]}")
            value = value.__array_interface__["data"][0]
        elif token not in SCALARS:
            value = as_structure(value)
        numbers.append(value)
    structure = kind(*numbers)
    structure.source = source
    return structure


@functools.cache
def packer(name: str, fields: tuple[str, ...]) -> Callable[..., bytes]:
    """Return a function from these fields of a table of numbers to its bytes, ten times faster than `filled`."""
    check_fields(name, fields)
    structure = structures()[name]
    names = tuple(label for label, _ in structure._fields_)
    pack = struct.Struct("=" + "".join("d" if token == "number" else "q" for token in structure.kinds)).pack
    if names == fields:
        return pack
    in_order = itemgetter(*map(fields.index, names))
    return lambda *numbers: pack(*in_order(numbers))


def address(array: Any) -> ctypes.c_void_p:
    """Return the address of the first element of a contiguous array."""
    return ctypes.c_void_p(array.ctypes.data)


def structure_of(tables: Any) -> Hashable:
    """Return everything in tables except their constants: members of equal structure can share one set of tables."""
    kind: Any = type(tables)
    return kind, *(_structure_of(one, one.of(tables)) for one in table_fields(structure_of_table(kind)))


def _structure_of(field: TableField, value: Any) -> Hashable:
    if field.token in SCALARS:
        scalar: Hashable = value
        return scalar
    if field.token not in PER_MEMBER_TYPES:
        return value.dtype.char, value.shape, value.tobytes()
    return value.shape if value.dtype == np.float64 else (value.shape, (value == 0).tobytes())


def stacked(members: Sequence[Tables]) -> Tables:
    """Stack tables of equal `structure_of`, a column of constants each, padded to a multiple of MOST_LANES."""
    kind: Any = type(members[0])
    varying = [one for one in table_fields(structure_of_table(kind)) if one.token in PER_MEMBER_TYPES]
    return with_arrays(
        members[0], {one.name: _stacked_columns([one.of(member) for member in members]) for one in varying}
    )


def _stacked_columns(columns: Sequence[Any]) -> Any:
    padding = -len(columns) % limit("MOST_LANES")
    return np.ascontiguousarray(np.pad(np.array(columns), ((0, padding), (0, 0)), mode="edge").T)


def formula_table(forms: Forms) -> KernelFunction:
    """Return a formula as a function that the kernels evaluate from its table, by the negative of the address."""
    table = as_structure(forms)
    return KernelFunction(-ctypes.addressof(table), table, lambda: (formula_table, (forms,)))


def share_table(share: KernelFunction, shares: int, results: int) -> KernelFunction:
    """Return a compiled `SumOfShares` as a table, by the negative of its address, which is made odd."""
    table = filled("SharedFunction", address=share.address, shares=shares, results=results)
    return KernelFunction(-ctypes.addressof(table) - 1, (table, share), lambda: (share_table, (share, shares, results)))


def convolution_table(function: DipolarFunction, factor: float) -> KernelFunction:
    """Return a multiple of a dipolar energy or its gradient as a table, by the negative of its address, minus 3."""
    fields, tensors = convolution_fields(function, factor)
    table = filled("CellConvolution", **fields)
    return KernelFunction(
        -ctypes.addressof(table) - 3, (table, tensors), lambda: (convolution_table, (function, factor))
    )


Owners = tuple[KernelFunction, ...]
"""Owners of the objects that addresses point to: they must live as long as the addresses are in use."""


def raised_by(owners: Iterable[Any]) -> BaseException | None:
    """Return and clear the exception that a function called in Python raised, if any."""
    return next((error for owner in owners if (error := getattr(owner, "raised", lambda: None)())), None)


ORDERS = {"value": 0, "gradient": 1, "hessian": 2}


LIBRARY_ADDRESSES: dict[int, tuple[Callable[[Any], int], Any]] = {}
"""Address, in tables, of a step or a BLAS routine -> function that finds it in any process, and its argument."""
FIELDS_OF_LIBRARY_ADDRESSES = ("step", "tables.whole")
"""Fields of integers that contain them."""


@dataclass(frozen=True)
class CompiledTables:
    """Tables of a compiled loop, objects kept alive, sources of constants.

    `referenced`: tables read by address, whose constants members may have `in_columns`.
    """

    tables: Any
    keepalive: tuple[Any, ...] = ()
    sources: Callable[[], Sources] = unrecorded
    referenced: Mapping[int, Any] = field(default_factory=dict)
    in_columns: bool = False

    def raised(self) -> BaseException | None:
        """Return and clear the exception that a function of the user raised in the loop, if any."""
        return raised_by(self.keepalive)

    @property
    def is_picklable(self) -> bool:
        """Whether all objects that the addresses point to can be rebuilt in another process."""
        return not self.referenced and all(getattr(owner, "remade", None) for owner in self.keepalive)

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
    keepalive: list[KernelFunction] = []
    if not functions:
        return addresses, ()
    for k, term in functions.items():
        keepalive.append(compiled_derivative(term, derivative, owner))
        addresses[k] = keepalive[-1].address
    return addresses, tuple(keepalive)


def compiled_derivative(term: FunctionTerm, derivative: str, owner: str) -> KernelFunction:
    """Compile a derivative of a term, or make a table of it."""
    function, size = getattr(term, derivative), len(term.coordinates)
    if (forms := forms_of(function)) is not None:
        return formula_table(forms)
    inner, multiples = without_multiples(function)
    if isinstance(inner, DipolarFunction) and inner.order < 2:
        return convolution_table(inner, math.prod(one.factor for one in multiples))
    results = size ** ORDERS[derivative]
    if is_called_in_python(function):
        return python_callback(function, size, results)
    shared = isinstance(function, SumOfShares)
    compiled = compiled_function(
        function.share if shared else function,
        size,
        results,
        scalar=term.scalar,
        flat=derivative != "value",
        timed=term.timed or shared,
        what=f"the {derivative} of {owner}",
    )
    return share_table(compiled, function.shares, results) if shared else compiled


NONE = np.zeros(0)


class FunctionRules(NamedTuple):
    """Addresses of functions that follow from constants, which are compiled once for all."""

    # Each rule: its position, the term and which of its functions, its constants, and where these are in `number`.
    # Functions live in `owners`, by position and constants; `kept` numbers are none of the sources.

    rules: Sequence[tuple[Integers, tuple[FunctionTerm, str, str, Floats, slice]]]
    number: Integers
    kept: NDArray[np.bool_]
    owners: dict[tuple[int, bytes], Any]

    @classmethod
    def of_functions(
        cls, functions: Mapping[int, FunctionTerm], derivative: str, owner: str, terms: Sequence[Any]
    ) -> FunctionRules:
        """Return the rules of those functions of a table that are functions of the constants of terms of an energy."""
        constants = CoefficientNumbers.of(terms).constants
        rules, numbers, start = [], [np.zeros(0, dtype=np.int64)], 0
        for k, term in functions.items():
            found = of_constants(getattr(term, derivative))
            number = next((n for t, n in constants.items() if found and terms[t].constants is found.constants), None)
            if found is not None and number is not None:
                own = slice(start, start + len(number))
                rules.append((np.array([k]), (term, derivative, owner, found.constants, own)))
                numbers.append(number)
                start = own.stop
        number = np.concatenate(numbers)
        return cls(rules, number, np.zeros(len(number), dtype=bool), {})

    def of(self, values: Floats) -> list[NDArray[np.float64]]:
        """Return the addresses in the bits of floats."""
        found = []
        for position, (term, derivative, owner, given, own) in self.rules:
            constants, chosen = given.copy(), ~self.kept[own]
            constants[chosen] = values[self.number[own][chosen]]
            key = int(position[0]), constants.tobytes()
            if key not in self.owners:
                function = getattr(term, derivative)
                first = key[0], b""
                if first not in self.owners:
                    self.owners[first] = compiled_derivative(term, derivative, owner)
                known, made = self.owners[first], function.of_constants.make(constants)
                # A function of an array of constants, which has no other numbers, has the same machine code.
                if (
                    callable(function.of_constants.key)
                    and getattr(known, "constants", NONE).tobytes() == given.tobytes()
                ):
                    self.owners[key] = known.with_constants(made, constants)
                else:
                    self.owners[key] = compiled_derivative(replace(term, **{derivative: made}), derivative, owner)
            found.append(np.array([self.owners[key].address]).view(np.float64))
        return found

    def among(self, sources: Integers, numbers: Integers) -> FunctionRules:
        chosen = np.isin(self.number, sources)
        renumbered = np.zeros(len(chosen), dtype=np.int64)
        renumbered[chosen] = numbers[np.searchsorted(sources, self.number[chosen])]
        rules = [one for one in self.rules if chosen[one[1][-1]].any()]
        return FunctionRules(rules, renumbered, ~chosen, self.owners)


def with_functions(
    sources: Sources, functions: Mapping[int, FunctionTerm], derivative: str, owner: str, terms: Sequence[Any]
) -> Sources:
    """Return the sources of a table with the rules of its functions, which have `addresses` beside their `terms`."""
    rules = FunctionRules.of_functions(functions, derivative, owner, terms)
    if not len(rules.number):
        return sources
    computed = dict(sources.computed)
    computed["terms.kind"] = np.setdiff1d(computed["terms.kind"], rules.number)
    return sources._replace(sums={**sources.sums, "addresses": rules}, computed=computed)


def addresses_by_coefficients(functions: Sequence[FunctionDerivative], count: int) -> tuple[NDArray[np.int64], Owners]:
    """Compile the derivatives of functions by parameters, of the last of `count` terms; return them as above."""
    compiled = [
        compiled_function(
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

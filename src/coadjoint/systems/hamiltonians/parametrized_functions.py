"""Functions of the state and of parameters that a run takes as an argument, such as the weights of a network."""

from __future__ import annotations

import inspect
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import numpy as np

from coadjoint.errors import in_one_line
from coadjoint.short_repr import short
from coadjoint.systems.user_functions import parameters_of_function, without_multiples
from coadjoint.validation import is_of_torch

NAME = "params"
"""The argument of a run with the parameters of its energy and forces."""


class ArrayLibrary(ABC):
    """A library of arrays, JAX or PyTorch: `module` has its functions of trees of parameters, with paths.

    `xp` has its functions that are called as those of NumPy, `vjp` and `jvp` are its derivatives.
    """

    library: str
    module: Any
    xp: Any
    float64_hint: str
    tree_hint: ClassVar[str] = ""
    vjp: Callable[..., Any]
    jvp: Callable[..., Any]
    expm: Callable[..., Any]

    @abstractmethod
    def array(self, name: str, value: Any, owner: str) -> Any:
        """Return a parameter as an array of float64; raise TypeError for other values."""

    def read(self, params: Any, owner: str) -> Any:
        """Return parameters as arrays of float64; `owner` names them in messages."""
        return self.module.tree_map_with_path(lambda path, one: self.array(self.name(path), one, owner), params)

    def read_like(self, known: Any, params: Any, source: str) -> Any:
        """Return params of a call as arrays; raise an error unless they have the structure and shapes of known ones."""
        found, tree = self.read(params, "the run"), self.module
        own, given = tree.tree_structure(known), tree.tree_structure(found)
        if own != given:
            needed = in_one_line(str(own), 160)
            raise ValueError(f"params have the structure {short(given)}; it must be {needed}, {source}{self.tree_hint}")
        for (path, mine), one in zip(tree.tree_leaves_with_path(known), tree.tree_leaves(found), strict=True):
            if mine.shape != one.shape:
                raise ValueError(
                    f"{self.name(path)} has the shape {tuple(one.shape)}; it must be {tuple(mine.shape)}, {source}"
                )
        return found

    def are_same(self, params: Any, others: Any) -> bool:
        """Return whether params have the same structure and numbers."""
        if self.module.tree_structure(params) != self.module.tree_structure(others):
            return False
        return all(map(np.array_equal, self.module.tree_leaves(params), self.module.tree_leaves(others)))

    def name(self, path: Any) -> str:
        return NAME + str(self.module.keystr(path))

    @abstractmethod
    def numbers(self, value: Any) -> Any:
        """Return numbers as an array of float64."""

    @abstractmethod
    def result(self, value: Any) -> Any:
        """Return what a function returned as an array, of its type."""

    @abstractmethod
    def set_at(self, x: Any, places: Any, values: Any) -> Any:
        """Return x with other values at places."""

    @abstractmethod
    def add_at(self, x: Any, places: Any, values: Any) -> Any:
        """Return x with values added at places, which may be repeated."""

    @abstractmethod
    def product(self, A: Any, B: Any) -> Any:
        """Return A B in full precision."""

    @abstractmethod
    def iterate(self, body: Callable[..., Any], carry: Any, rows: Sequence[Any]) -> Any:
        """Return ``body(carry, *row)``, applied for all rows of some arrays in turn."""

    @abstractmethod
    def fixed_point(self, prepare: Callable[..., Any], first: Any, *arguments: Any) -> Any:
        """Return z = prepare(*arguments)(z), a vector of the size of a first guess, with its derivatives."""

    @abstractmethod
    def normal_deviates(self, seed: int, stream: Any, moments: Any, part: int, count: int) -> Any:
        """Return deviates as `systems.forces.base.normal_deviates`, (count,) or (moments, count)."""

    @abstractmethod
    def type_of(self, function: Callable[..., Any], params: Any, n: int) -> tuple[tuple[int, ...], str]:
        """Return shape and type of the values of a function of params, a state (n,), and the time."""

    @abstractmethod
    def may_hide(self, function: Callable[..., Any], params: Any, n: int) -> bool:
        """Return whether derivatives of such a function may lack a part, as of a value that it detaches."""

    @abstractmethod
    def in_numpy(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """Return a function of arrays of the library as one of arrays of NumPy."""


class ParametrizedFunction:
    """The function of x, or of (x, t), at the params given, which are arrays of float64; `symbol` names it."""

    caller: ClassVar[str]
    symbol: ClassVar[str]
    what: ClassVar[str] = "the energy"
    trees: ClassVar[ArrayLibrary]
    counts: tuple[int, ...] = (2, 3)
    taken = "(x, params) or (x, params, t)"

    def __init__(self, function: Callable[..., Any], params: Any) -> None:
        self.function, self.params = function, self.trees.read(params, self.caller)
        arguments = self._arguments(function)
        self.__signature__ = inspect.Signature(arguments)
        self.__name__ = getattr(function, "__name__", type(function).__name__)

    def _arguments(self, function: Any) -> list[inspect.Parameter]:
        """Return the arguments at fixed params, which are the second one of the function."""
        library = self.trees.library
        if not callable(function) or is_of_torch(function):
            hint = "; a module of PyTorch is no such function" if is_of_torch(function) else ""
            raise TypeError(
                f"{self.caller} was given {short(function)}{hint}; give a function {self.symbol}{self.taken} of "
                f"{library}"
            )
        names = [one.name for one in parameters_of_function(function)]
        if names[:1] == ["params"] or len(names) not in self.counts:
            raise TypeError(
                f"{self.caller} was given a function of ({', '.join(names)}); it must be one of {self.taken}, in "
                "this order"
            )
        return [inspect.Parameter(name, inspect.Parameter.POSITIONAL_ONLY) for name in ("x", "t")[: len(names) - 1]]

    def __repr__(self) -> str:
        return f"{self.caller}({self.__name__})"

    def __call__(self, x: Any, *time: Any) -> Any:
        """Return the value at the params given."""
        return self.at(self.params, x, *time)

    def at(self, params: Any, x: Any, *time: Any) -> Any:
        """Return the value at other params."""
        return self.function(x, params, *time)

    def checked(self, params: Any) -> Any:
        """Return params of a call as arrays; raise an error if they have another structure or other shapes."""
        return self.trees.read_like(self.params, params, f"as given to {self.caller}")


class ParametrizedEnergy(ParametrizedFunction):
    """An energy H(x), or H(x, t), with params."""

    symbol = "H"

    def check_differentiable(self, start: Any, derivatives: Any) -> None:
        """Raise ValueError for derivatives, first and second ones by member, that are not finite at initial states."""
        for order, values in zip(("gradient", "second derivative"), derivatives, strict=True):
            wrong = np.argwhere(~np.isfinite(values))
            if len(wrong):
                member, k = wrong[0].tolist()
                of_member = f"[{member}]" if start.ndim > 1 else ""
                x = start.reshape(-1, start.shape[-1])[member].tolist()
                raise ValueError(
                    f"x0{of_member} is {short(x, 80)}, where a {order} of the energy given to {self.caller} is "
                    f"{values[member, k]}; give an energy that is differentiable twice there"
                )


class ParametrizedFeatures(ParametrizedEnergy):
    """The energy sum_k f(<a_k, x>, w_k) of directions a (features, n), and w with a first axis of features."""

    symbol, counts, taken = "f", (2,), "(y, params)"
    vmap: ClassVar[Callable[..., Any]]
    grad: ClassVar[Callable[..., Any]]

    def __init__(self, function: Callable[..., Any], params: Any) -> None:
        super().__init__(function, params)
        directions, own = self.params
        if directions.ndim != 2 or not len(directions):
            raise ValueError(f"directions have the shape {tuple(directions.shape)}; they must be (features, n)")
        for path, one in self.trees.module.tree_leaves_with_path(own):
            if one.shape[:1] != directions.shape[:1]:
                raise ValueError(
                    f"{self.trees.name(path)} has the shape {tuple(one.shape)}; its first axis must be that of the "
                    f"{len(directions)} features"
                )

    def at(self, params: Any, x: Any, *time: Any) -> Any:
        directions, own = params
        if directions.shape[1:] != x.shape:
            raise ValueError(f"directions have {directions.shape[1]} coordinates, and states {len(x)}")
        values = self.vmap(self.function)(directions @ x, own)
        if values.shape != directions.shape[:1] or str(values.dtype).rpartition(".")[2] != "float64":
            raise TypeError(
                f"the function given to {self.caller} returns {values.dtype} of the shape {tuple(values.shape[1:])}; "
                "it must return one number of float64"
            )
        return values.sum()

    def angle(self, y: Any, own: Any) -> Any:
        """Return the derivative of the function of a feature at y = <a, x>, constant along its flow."""
        return self.grad(self.function)(y, own)


def features_of(system: Any, kind: type[Any]) -> tuple[ParametrizedFeatures | None, float]:
    """Return the energy of features of which that of a system is a multiple, or None, and the factor."""
    first, *others = system.hamiltonian.terms()
    function, factor = function_of(first, kind)
    whole = isinstance(function, ParametrizedFeatures) and not others and len(first.coordinates) == system.dim
    return (function if whole else None), factor


def function_of(term: Any, kind: type[Any]) -> tuple[Any, float]:
    """Return the function that an object of this kind calls for the value of a term, or None, and its factor."""
    value, outer = without_multiples(getattr(term, "value", None))
    function, inner = without_multiples(value.function if isinstance(value, kind) else None)
    return function, math.prod(float(one.factor) for one in (*inner, *outer))


def function_with_params(system: Any, kind: type[Any], trees: ArrayLibrary) -> Any:
    """Return the energy or the function of a force of a system with params of a library, or None; all have the same."""
    functions = [function_of(term, kind)[0] for one in system.distinct for term in one.unforced.hamiltonian.terms()]
    functions += [getattr(force, "learned", None) for one in system.distinct for force in one.forces]
    found = [one for one in functions if isinstance(one, ParametrizedFunction) and one.trees is trees]
    if not found:
        return None
    first = found[0]
    for one in found[1:]:
        if not trees.are_same(first.params, one.params):
            raise TypeError(
                f"{system.name} has energies and forces of different params, of {first.caller} and {one.caller}; give "
                "all parameters of the run to each of them, in one tree"
            )
    return first

"""Forces with parameters that a run takes as an argument: torques, and damping on the orbit by a learned metric."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import IntegrationError, in_one_line
from coadjoint.systems.forces.base import Force, ForceReader
from coadjoint.systems.forces.orbit_flow import exponential, midpoint
from coadjoint.systems.forces.torque import StateTorque, is_on_bodies, places_of_torques, shapes_on
from coadjoint.systems.hamiltonians.parametrized_functions import ParametrizedFunction
from coadjoint.systems.user_functions import check_derivative


class ParametrizedTorque(ParametrizedFunction):
    """A torque N(x), or N(x, t), with params."""

    symbol, what = "N", "the torque"


class ParametrizedRoot(ParametrizedFunction):
    """A root L(x), or L(x, t), of a metric L L^T, with params."""

    symbol, what = "L", "the root of the metric"


class LearnedFunction:
    """The values of a function with params on the states of a system, (n,) of a torque; called in Python at its own."""

    called_in_python: ClassVar[bool] = True

    def __init__(self, learned: ParametrizedTorque | ParametrizedRoot, system: Any) -> None:
        self.learned, self.system, self.library = learned, system, learned.trees
        self.timed = len(learned.__signature__.parameters) > 1

    def raw(self, params: Any, x: Any, t: Any) -> Any:
        """Return what the function returns."""
        time = (self.library.numbers(t),) if self.timed else ()
        return self.library.result(self.learned.at(params, x, *time))

    def at(self, params: Any, x: Any, t: Any) -> Any:
        """Return the values, of torques on bodies as those of the state."""
        value = self.raw(params, x, t)
        if not is_on_bodies(tuple(value.shape), self.system):
            return value
        return self.library.set_at(self.library.xp.zeros_like(x), places_of_torques(self.system), value)

    @cached_property
    def _compiled(self) -> Callable[..., Any]:
        return self.library.in_numpy(lambda x, t: self.at(self.learned.params, x, t))

    def __call__(self, x: Any, t: float) -> NDArray[np.float64]:
        y = np.asarray(x)
        if y.dtype != np.float64:
            raise TypeError(
                f"a function of {self.library.library} is given numbers of {y.dtype}; its derivatives are of float64 "
                "only"
            )
        return np.asarray(self._compiled(y, t))

    def law(self) -> LearnedLaw:
        """Return its derivatives by the state."""
        return LearnedLaw(self)

    def shape(self) -> tuple[int, ...]:
        """Return the shape that the function returns; raise TypeError if it fails, or is not of float64."""
        learned, system = self.learned, self.system
        if system.has_matrices or not system.has_structure_constants:
            raise TypeError(f"{learned.caller} acts on systems of vectors on a Lie algebra, not on {system.name}")
        try:
            shape, kind = self.library.type_of(self.raw, learned.params, system.dim)
        except Exception as reason:
            raise TypeError(
                f"{self.library.library} cannot trace {learned.what} on states of {system.dim} numbers "
                f"({type(reason).__name__}: {in_one_line(str(reason), 160)}); compute with its functions only"
            ) from reason
        if kind != "float64":
            raise TypeError(f"{learned.what} returns numbers of {kind}, not of float64{self.library.float64_hint}")
        if self.library.may_hide(self.raw, learned.params, system.dim):
            self._check_slopes(shape)
        return shape

    def _check_slopes(self, shape: tuple[int, ...]) -> None:
        """Raise ValueError if values are random, or their automatic derivative by the state lacks a part."""
        library, params = self.library, self.learned.params
        weights = library.numbers(np.cos(np.arange(1.0, 1.0 + np.prod(shape, dtype=int))).reshape(shape))

        def weighted(x: Any, t: Any) -> Any:
            return (weights * self.raw(params, x, t)).sum()

        def slopes(x: Any, t: Any) -> Any:
            return library.vjp(lambda x: weighted(x, t), x)[1](library.numbers(1.0))[0]

        n, names = self.system.dim, (f"a sum of the components of {self.learned.what}", "gradient")
        derivative: Any = library.in_numpy(slopes)
        derivative.automatic = True
        check_derivative(library.in_numpy(weighted), derivative, names=names, shapes=((), (n,)), n=n, timed=True)


class LearnedLaw:
    """The derivatives of a torque as those of a `TracedLaw`, which has no numbers that change."""

    timed: ClassVar[bool] = True
    numbers: ClassVar[NDArray[np.float64]] = np.zeros(0)

    def __init__(self, torque: LearnedFunction) -> None:
        self._torque = torque

    def form(self) -> Any:
        """Return what does not change."""
        return None

    def derivatives(self, moving: Sequence[int]) -> list[Callable[..., Any]]:
        """Return the transposed derivative of (x, w), and the derivative of (x, v)."""
        torque = self._torque
        library, params = torque.library, torque.learned.params

        def pulled(x: Any, w: Any, t: Any) -> Any:
            return library.vjp(lambda x: torque.at(params, x, t), x)[1](w)[0]

        def pushed(x: Any, v: Any, t: Any) -> Any:
            return library.jvp(lambda x: torque.at(params, x, t), (x,), (v,))[1]

        return [LearnedDerivative(library.in_numpy(one), torque.system.dim) for one in (pulled, pushed)]


class LearnedDerivative:
    """A derivative of a torque at a state and a vector beside it, (2 n,), called in Python."""

    called_in_python: ClassVar[bool] = True

    def __init__(self, function: Callable[..., Any], n: int) -> None:
        self._function, self._n = function, n

    def __call__(self, y: Any, t: float) -> NDArray[np.float64]:
        return np.asarray(self._function(y[: self._n], y[self._n :], t))


class LearnedTorque(StateTorque):
    """The torque x' = N(x, params), or N(x, params, t), in the coordinates of the state or on bodies."""

    called_in_python: ClassVar[bool] = True
    uses_energy: ClassVar[bool] = False

    def __init__(self, learned: ParametrizedTorque) -> None:
        self.learned = learned

    def check(self, system: Any) -> None:
        shape = LearnedFunction(self.learned, system).shape()
        if shape != (system.dim,) and not is_on_bodies(shape, system):
            raise ValueError(f"the torque returns the shape {shape}; {system.name} needs {shapes_on(system)}")

    def on_state(self, system: Any) -> tuple[Callable[..., Any], str]:
        return LearnedFunction(self.learned, system), "x, t"


class LearnedDoubleBracket(Force):
    """Damping on the orbit, x' = J(x) L L^T J(x) grad H, with a root L(x, params) or L(x, params, t)."""

    called_in_python: ClassVar[bool] = True
    casimirs: ClassVar[bool] = True

    def __init__(self, learned: ParametrizedRoot) -> None:
        self.learned = learned

    def check(self, system: Any) -> None:
        shape, n = LearnedFunction(self.learned, system).shape(), system.dim
        if shape not in ((), (n,)) and not (len(shape) == 2 and shape[0] == n):
            raise ValueError(
                f"the root of the metric returns the shape {shape}; {system.name} needs a number, ({n},) or ({n}, k)"
            )

    def field(self, system: Any, x: NDArray[Any], t: Any) -> NDArray[Any]:
        v = LearnedFlow(self, system).direction(x, t)
        return np.asarray(system.sign * (system.algebra.structure_matrix(x) @ v))

    def flow(self, system: Any, x: NDArray[Any], t: Any, tau: Any) -> NDArray[Any]:
        return LearnedFlow(self, system)(x, t, tau)

    def describe_to(self, reader: ForceReader, system: Any) -> Any:
        return reader.flow(LearnedFlow(self, system))


class LearnedFlow:
    """The midpoint rule of a damping on the orbit: in NumPy at the params of the force, or of a library of arrays."""

    called_in_python: ClassVar[bool] = True

    def __init__(self, force: LearnedDoubleBracket, system: Any) -> None:
        self.root, self.system, self._caller = LearnedFunction(force.learned, system), system, force.learned.caller

    def direction(self, x: Any, t: Any) -> Any:
        """Return L L^T f, with the Hamiltonian part f of x'."""
        return _metric_times(self.root(x, t), self.system.vector_field(x, t))

    def direction_at(self, field: Any, numbers: Any, x: Any, t: Any) -> Any:
        """Return it for numbers of the energy with params, in arrays of the library."""
        return _metric_times(self.root.raw(numbers.params, x, t), field.at(numbers, x, t))

    def __call__(self, x: Any, t: Any, tau: Any) -> NDArray[Any]:
        found = midpoint(self.system, lambda y: tau * self.direction(y, t + 0.5 * tau), x)
        if found.direction is None:
            raise IntegrationError(
                f"the midpoint rule of {self._caller} did not converge; take a smaller step",
                step=1,
                time=float(t),
                residual=found.residual,
            )
        return exponential(self.system, found.direction, x)


def _metric_times(root: Any, f: Any) -> Any:
    return root @ (root.T @ f) if root.ndim == 2 else root * root * f

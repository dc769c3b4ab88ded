"""What forces on modes of a matrix have in common: each mode has a rate, or a noise, of its own."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.given import read_choice, read_number
from coadjoint.systems.forces.base import Force, ForceReader
from coadjoint.systems.matrices.mode_basis import LAYERS, ModeBasis, Numbers, mode_basis_of, place_of_layer

PerMode = list[NDArray[Any]]


def modes_of(system: Any, what: str) -> ModeBasis:
    """Return the modes of a system; refuse one that has none.

    Raises
    ------
    ValueError
        It has none.
    """
    found = mode_basis_of(system)
    if found is None:
        raise ValueError(
            f"{what} acts on the modes of a fluid, such as sphere_euler or torus_euler, which {system.name} does not "
            "have; take LinearDamping"
        )
    return found


def by_scale(given: float | Callable[[Any], Any], scales: NDArray[np.float64], what: str) -> NDArray[np.float64]:
    """Return a number for each mode: the given one, or that of a function of degrees or wave numbers.

    Raises
    ------
    ValueError, TypeError
        The function returns something else, or numbers that are not finite.
    """
    if not callable(given):
        return np.full(scales.shape, given)
    found = {scale: read_number(given(scale), f"{what} at {scale:g}") for scale in np.unique(scales).tolist()}
    return np.array([found[scale] for scale in scales.tolist()])


class OnLayer(Force):
    """A force on the modes of one field: on the vorticity, unless it says otherwise."""

    layer: str

    def read_layer(self) -> None:
        """Check which field it is."""
        object.__setattr__(self, "layer", read_choice(self.layer, f"layer of {self.label}", LAYERS))

    def place(self, system: Any) -> int:
        """Return where the field stands in a state."""
        return place_of_layer(system, self.layer)

    def matrix(self, system: Any, x: NDArray[Any]) -> NDArray[Any]:
        """Return the field of a state."""
        state = system.from_vector(x)
        return np.asarray(state if state.ndim == 2 else state[self.place(system)])

    def moved(self, system: Any, W: NDArray[Any]) -> NDArray[Any]:
        """Return the numbers of a state of which the field is this one, and others are zero."""
        state = np.zeros(system.shape, dtype=W.dtype)
        state[self.place(system) if state.ndim == 3 else ...] = W
        return np.asarray(system.to_vector(state))


class ModeRates(OnLayer):
    """A force under which every mode moves by itself, ``c' = -rate c``, exactly; a complex rate turns it.

    On a rotating sphere, whose state is the absolute vorticity, c is that of the relative one.
    """

    @abstractmethod
    def rates(self, modes: ModeBasis, d: int, numbers: Numbers) -> NDArray[Any]:
        """Return the rates of modes of a diagonal.

        Parameters
        ----------
        modes : ModeBasis
            The modes of the system.
        d : int
            The diagonal.
        numbers : (k,) array
            Those of the modes.

        Returns
        -------
        (k,) array
            Real or complex.
        """

    def check(self, system: Any) -> None:
        self._chosen(modes_of(system, self.label))
        self.place(system)

    def _chosen(self, modes: ModeBasis) -> tuple[list[Numbers], PerMode]:
        """Return the numbers of the modes that the force moves, and their rates, diagonal after diagonal."""
        numbers, rates = [], []
        for d in range(modes.diagonals):
            every = modes.numbers(d)
            found = self.rates(modes, d, every)
            numbers.append(every[found != 0.0])
            rates.append(found[found != 0.0])
        return numbers, rates

    def _acted(self, system: Any, x: NDArray[Any], factor: Callable[[NDArray[Any]], NDArray[Any]]) -> NDArray[Any]:
        modes = modes_of(system, self.label)
        chosen, rates = self._chosen(modes)
        W = self.matrix(system, x)
        still = self._still(system)
        W = W if still is None else W - still
        moved = [
            factor(rate) * modes.coefficients(W, d, numbers)
            for d, (numbers, rate) in enumerate(zip(chosen, rates, strict=True))
        ]
        return self.moved(system, modes.matrix(moved, chosen))

    def _still(self, system: Any) -> NDArray[Any] | None:
        """Return the state that is at rest in the frame, where that is not zero."""
        absolute = getattr(system, "absolute", None)
        if absolute is None or self.layer != "vorticity":
            return None
        still = np.asarray(absolute(np.zeros(system.algebra.shape)))
        return still if np.any(still) else None

    def field(self, system: Any, x: NDArray[Any], t: Any) -> NDArray[Any]:
        return self._acted(system, x, lambda rate: -rate)

    def flow(self, system: Any, x: NDArray[Any], t: Any, tau: Any) -> NDArray[Any]:
        return np.asarray(x + self._acted(system, x, lambda rate: np.expm1(-tau * rate)))

    def given_to(self, reader: ForceReader, system: Any) -> Any:
        modes = modes_of(system, self.label)
        still = self._still(system)
        aim = None if still is None else np.ascontiguousarray(still).view(np.float64).ravel()
        return reader.mode_rates(modes, *self._chosen(modes), aim, self.place(system))

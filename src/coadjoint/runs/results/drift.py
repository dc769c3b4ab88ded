"""Deviations of invariants over a run, and the sizes to which they are relative: sums of absolute terms."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.systems.evaluation import ignore_overflow
from coadjoint.systems.hamiltonians.hamiltonian import as_hamiltonian
from coadjoint.systems.hamiltonians.terms import built_in

Floats = NDArray[np.float64]

# A value below this fraction of the sum of its absolute terms is small by cancellation.
CANCELLATION = 2.0**-10
# Number of invariants whose terms are always summed; those of further ones only if their values are far smaller than
# others.
SUMMED_INVARIANTS = 64
# Numbers (2 MB) of the states whose terms are summed together; the values do not depend on it.
SUMMED_NUMBERS = 2**18


class Drift(float):
    """The largest deviation of an invariant from its initial value: a float with the deviations in detail.

    Attributes
    ----------
    scale : float or ndarray, shape (members,)
        The size of the invariant, to which all deviations are relative: the absolute initial value, or where its terms
        nearly cancel, the sum of their absolute values. It is 1 for absolute deviations, and where both are zero.
    absolute : float
        The largest absolute deviation.
    tenths : ndarray, shape (10,) or (members, 10)
        Largest deviation in each tenth of the run.
    members : ndarray or None
        For an ensemble, the largest deviation of each member; the float is the largest over all members that have run.
    initial : float or ndarray
        Initial value.
    """

    scale: Any
    absolute: float
    tenths: Floats
    members: Floats | None
    initial: Any
    _waiting: Any

    @ignore_overflow
    def __new__(cls, tenths: Floats, initial: Any, scale: Any = 1.0, waiting: Any = False) -> Drift:
        """Construct the drift from the absolute deviations in its tenths; members that wait to be run are NaN."""
        relative = tenths / np.asarray(scale)[..., None]
        counted = ~(np.asarray(waiting)[..., None] & np.isnan(relative))
        largest, absolute = (
            np.max(values, where=counted, initial=0.0) if counted.any() else np.nan for values in (relative, tenths)
        )
        drift = super().__new__(cls, largest)
        drift.absolute, drift.scale, drift._waiting = float(absolute), scale, waiting
        drift.tenths = relative
        drift.members = None if tenths.ndim == 1 else relative.max(axis=-1)
        drift.initial = initial
        return drift

    def __getnewargs__(self) -> tuple[Any, ...]:  # type: ignore[override]
        return self.tenths * np.asarray(self.scale)[..., None], self.initial, self.scale, self._waiting

    @property
    def growth(self) -> Any:
        """Ratio of the last tenth to the first: 1 for bounded error, 10 for linear growth, inf if the first is 0."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.divide(self.tenths[..., -1], self.tenths[..., 0])


@ignore_overflow
def scales_of_invariants(system: Any, x0: Any, initial: Mapping[str, Any]) -> dict[str, Any]:
    """Return the size of each invariant, a float or (members,); 1 where it is zero or not finite."""
    single = all(np.ndim(value) == 0 for value in initial.values())
    states = np.asarray(x0)[None] if single else np.asarray(x0)
    values = {name: np.abs(np.atleast_1d(value)).astype(np.float64) for name, value in initial.items()}
    largest = np.max(list(values.values()), axis=0)
    scales: dict[str, Any] = {}
    for number, (name, value) in enumerate(values.items()):
        # Each member by itself, so that it has the same size alone.
        summed = np.arange(len(value)) if number < SUMMED_INVARIANTS else np.flatnonzero(value < CANCELLATION * largest)
        size = value.copy()
        for members in _groups(system, summed, states[0].size) if system is not None else ():
            plain = system.of_member(int(members[0])).unforced
            invariant = plain.hamiltonian if name == "energy" else plain.casimirs.get(name)
            rows = states[members] if plain.has_matrices else states[members].reshape(len(members), -1)
            terms = sum_of_absolute_terms(invariant, rows)
            size[members] = np.where(value[members] < CANCELLATION * terms, terms, value[members])
        size[~(np.isfinite(size) & (size > 0.0))] = 1.0
        scales[name] = float(size[0]) if single else size
    return scales


def _groups(system: Any, members: NDArray[np.int64], numbers: int) -> list[NDArray[np.int64]]:
    """Return members of one system in groups whose terms are summed together."""
    length = max(1, SUMMED_NUMBERS // numbers)
    if system.is_batch:
        owners = system.owners[members]
        order = np.argsort(owners, kind="stable")
        of_systems = np.split(members[order], np.flatnonzero(np.diff(owners[order])) + 1)
    else:
        of_systems = [members]
    return [same[k : k + length] for same in of_systems for k in range(0, len(same), length)]


def sum_of_absolute_terms(invariant: Any, x: Floats) -> Floats:
    """Return the sums of absolute terms of an invariant at states (..., *shape); 0 for functions."""
    if hasattr(invariant, "sum_of_absolute_terms"):
        return np.asarray(invariant.sum_of_absolute_terms(x))
    if isinstance(invariant, Polynomial):
        invariant = as_hamiltonian(invariant, x.shape[-1])
    terms = invariant.terms() if hasattr(invariant, "terms") else ()
    if not terms:
        return np.zeros(())
    total = np.zeros(x.shape[:-1])
    for term in built_in(terms):
        total += term.sum_of_absolute_values(np.abs(x))
    return total

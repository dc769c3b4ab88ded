"""Quantities over a run: observed ones, invariants of matrices, and deviations of invariants with their sizes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.invariants.invariant import Invariant
from coadjoint.algebra.polynomials.monomials import check_names
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.errors import in_one_line, nearest
from coadjoint.kernels.tables.recording import values_along
from coadjoint.keyword_hints import vocabulary
from coadjoint.optional_packages import require_packages
from coadjoint.short_repr import compact, short
from coadjoint.systems.coordinates import coordinate_names
from coadjoint.systems.evaluation import ignore_overflow
from coadjoint.systems.hamiltonians.hamiltonian import as_hamiltonian, formula_of
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.hamiltonians.summable import PolynomialHamiltonian, Summable
from coadjoint.systems.hamiltonians.terms import built_in
from coadjoint.systems.system import System
from coadjoint.systems.user_functions import takes_time, with_time
from coadjoint.validation import read_number

if TYPE_CHECKING:
    import pandas as pd

    from coadjoint.kernels.tables.compiled import CompiledTables
    from coadjoint.systems.matrices.matrix_system import MatrixSystem

Floats = NDArray[np.float64]
Value = TypeVar("Value")


class NamedValues(dict[str, Value]):
    """Dictionary of quantities of a run, whose KeyError has the name that is meant, or the nearest one.

    >>> NamedValues({"energy": 0.0, "|x|^2": 1.0})["Energy"]
    Traceback (most recent call last):
    KeyError: "there is no 'Energy'; did you mean 'energy'?"
    """

    def __repr__(self) -> str:
        return f"{{{', '.join(f'{name!r}: {compact(value)}' for name, value in self.items())}}}"

    def __missing__(self, name: Any) -> Value:
        text = f"there is no {short(name)}"
        if not isinstance(name, str):
            raise KeyError(f"{text}; give a name: {', '.join(self)}")
        meant = vocabulary("attributes of solutions").get(name)
        near = "energy" if meant == "energy" and "energy" in self else nearest(name, self)
        raise KeyError(f"{text}; did you mean {near!r}?" if near else f"{text}; there are: {', '.join(self)}")


class Observed(NamedTuple):
    """Function of times (k,) and points (k, members, n) that returns the values (k, members) of quantities by name."""

    along: Callable[[Floats, Floats], dict[str, Floats]]
    formulas: Mapping[str, Any]
    """Those of the quantities that are no functions of Python."""


class ObservedValues(NamedValues[Floats]):
    """Observed quantities by name, with the formulas among them."""

    formulas: Mapping[str, Any] = MappingProxyType({})


# An energy below this fraction of the sum of its absolute terms is small by cancellation. That of a near-parabolic
# orbit, which determines its period, is larger. Casimirs have the size of their terms, as do their rounding errors.
CANCELLATION = 2.0**-6
# Number of invariants whose terms are always summed; those of further ones only if their values are far smaller than
# others.
SUMMED_INVARIANTS = 64
# Numbers (2 MB) of the states whose terms are summed together; the values do not depend on it.
SUMMED_NUMBERS = 2**18


def is_formula(quantity: Any) -> bool:
    """Whether a quantity is a formula or a Hamiltonian of the coordinates, not a plain function of the user."""
    return isinstance(quantity, Polynomial | Summable)


def is_text(quantity: Any) -> bool:
    """Whether a quantity is made of numbers and text alone: a polynomial, a quadratic form, a formula, or a sum."""
    summands = getattr(quantity, "summands", (quantity,))
    return all(isinstance(one, Polynomial | Quadratic | PolynomialHamiltonian) or formula_of(one) for one in summands)


def observed_quantities(system: System, observe: Mapping[str, Any], x0: Floats) -> Observed:
    """Return the function for quantities at saved points; those of the user are called once at x0 for validation."""
    from coadjoint.kernels.tables.invariants import watch_tables

    matrices = system.unforced if system.has_matrices else None
    if matrices is not None:
        _check_matrix_functions(matrices, observe)
    start: Any = x0 if matrices is None else matrices.states_of(x0)
    for name, quantity in observe.items():
        if matrices is None:
            check_names(quantity, coordinate_names(system), f"observe[{short(name)}]")
        value = _value_at(quantity, name, start.copy())
        if np.ndim(value) != 0 or np.asarray(value).dtype.kind not in "iuf":
            raise TypeError(
                f"observe[{short(name)}] returns {short(value)} at the start; it must return one real number"
            )
    if matrices is not None:
        return Observed(partial(_of_matrices, matrices, dict(observe)), {})
    wrapped = {
        name: quantity if is_formula(quantity) or isinstance(quantity, Invariant) else Invariant(quantity)
        for name, quantity in observe.items()
    }
    formulas = {name: quantity for name, quantity in observe.items() if is_text(quantity)}
    return Observed(partial(_along, watch_tables(system, wrapped), list(observe)), formulas)


def _along(watch: CompiledTables, names: Sequence[str], t: Floats, points: Floats) -> dict[str, Floats]:
    # The first invariant of a watch is the energy.
    out = np.empty((*points.shape[:2], len(names) + 1))
    values_along(watch.tables, points, t, out)
    return {name: out[..., i + 1] for i, name in enumerate(names)}


def _of_matrices(system: MatrixSystem, observe: Mapping[str, Any], t: Floats, points: Floats) -> dict[str, Floats]:
    """Evaluate Python functions of a matrix at all points; NaN for failed members."""
    found = {}
    for name, quantity in observe.items():
        function, values = with_time(quantity, name), np.full(points.shape[:2], np.nan)
        for k, m in np.argwhere(np.isfinite(points).all(axis=-1)).tolist():
            W = system.states_of(points[k, m, : system.dim].copy())
            values[k, m] = read_number(function(W, float(t[k])), f"what observe[{short(name)}] returns at t = {t[k]:g}")
        found[name] = values
    return found


def invariants_of_matrices(
    system: MatrixSystem, names: Sequence[str], work_integrals: Sequence[tuple[str, str]], states: Floats, t: float
) -> Floats:
    """Return energy and invariants of states (m, size), and with `work_integrals` the same minus the work of forces."""
    # States after a failure are NaN; user functions are not called on them.
    finite = np.isfinite(states[:, : system.dim]).all(axis=-1)
    result = np.full((len(states), len(names) * (2 if work_integrals else 1)), np.nan)
    W = system.from_vector(states[finite, : system.dim])
    with np.errstate(all="ignore"):
        values = [system.energy(W, t), *system.casimirs_at(W).values()]
    if work_integrals:
        # The work is that of the integrals in a state; the start has none.
        work = {name: np.zeros(len(W)) for name in names}
        for (_, name), column in zip(work_integrals, states[finite, system.dim :].T, strict=False):
            work[name] += column
        values += [value - work[name] for value, name in zip(values, names, strict=True)]
    result[finite] = np.stack(values, axis=-1)
    return result


def _check_matrix_functions(system: MatrixSystem, observe: Mapping[str, Any]) -> None:
    for name, quantity in observe.items():
        if is_formula(quantity):
            raise TypeError(
                f"observe[{short(name)}] is a function of coordinates, and the states of {system.name} are matrices; "
                "give a function of a matrix"
            )


def check_observe(observe: Any, system: Any) -> dict[str, Any]:
    """Validate `observe` and return a copy, with Hamiltonians bound to the dimension of the system."""
    if not isinstance(observe, Mapping) or not all(isinstance(name, str) for name in observe):
        raise TypeError(f"observe is {short(observe)}; it must map names to Polynomials or functions of x")
    for name, quantity in observe.items():
        if not callable(quantity):
            raise TypeError(
                f"observe[{short(name)}] is {short(quantity)}; it must be a Polynomial or a function, or a Quadratic"
            )
    free = (
        {}
        if not observe or system.has_matrices
        else {name: H for name, H in observe.items() if isinstance(H, Summable)}
    )
    return {**observe, **{name: as_hamiltonian(H, system.dim) for name, H in free.items()}}


def _value_at(quantity: Any, name: str, x0: Floats) -> Any:
    try:
        function = quantity.value if isinstance(quantity, Invariant) else quantity
        return 0.0 if is_formula(quantity) or takes_time(function, name) else quantity(x0)
    except (ArithmeticError, ValueError, OSError):
        return float("nan")
    except (IndexError, KeyError, TypeError, AttributeError) as reason:
        message = in_one_line(str(reason), 200)
        raise type(reason)(f"observe[{short(name)}] cannot be evaluated at the start: {message}") from None


class Drift(float):
    """The largest deviation of an invariant from its initial value: a float with the deviations in detail.

    Attributes
    ----------
    scale : float or ndarray, shape (members,)
        The size of the invariant, to which all deviations are relative: of a Casimir the sum of its absolute terms, of
        the energy the absolute initial value, or where its terms nearly cancel, the sum of their absolute values. So it
        is never far below that of other members. It is 1 for absolute deviations, and where both are zero.
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
        fraction = CANCELLATION if name == "energy" else 1.0
        summed = np.arange(len(value)) if number < SUMMED_INVARIANTS else np.flatnonzero(value < CANCELLATION * largest)
        size = value.copy()
        for members in _groups(system, summed, states[0].size) if system is not None else ():
            plain = system.of_member(int(members[0])).unforced
            invariant = plain.hamiltonian if name == "energy" else plain.casimirs.get(name)
            rows = states[members] if plain.has_matrices else states[members].reshape(len(members), -1)
            terms = sum_of_absolute_terms(invariant, rows)
            size[members] = np.where(value[members] < fraction * terms, terms, value[members])
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


def table_of(solution: Any) -> pd.DataFrame:
    """Return a solution as a table; see `Solution.to_pandas`."""
    require_packages("a table of a solution", "pandas")
    import pandas as pd

    system: Any = solution.system.of_member(0).unforced
    k, members = len(solution.t), None if solution.failed is None else len(solution.failed)
    shape = system.shape
    count = int(np.prod(shape))
    states = solution.x.reshape(k, -1, count)
    if system.has_matrices:
        names: Sequence[str] = ["W" + ",".join(str(i + 1) for i in entry) for entry in np.ndindex(*shape)]
    else:
        names = coordinate_names(system, count)
    columns: dict[str, Any] = {name: states[..., i] for i, name in enumerate(names)}
    observed = {name: np.asarray(values) for name, values in solution.observed.items()}
    numbers = {name: values for name, values in observed.items() if values.ndim == (1 if members is None else 2)}
    invariants = {"energy": solution.energy, **solution.casimirs}
    for what, series in (("invariant", invariants), ("observed", numbers)):
        for name, values in series.items():
            # Names of coordinates, invariants and observed quantities may be equal.
            columns[f"{what} {name}" if name in columns else name] = values.reshape(k, -1)
    if members is None:
        times = pd.Index(solution.t, name="time")
        return pd.DataFrame({name: values[:, 0] for name, values in columns.items()}, index=times)
    index = pd.MultiIndex.from_product([range(members), solution.t], names=["member", "time"])
    return pd.DataFrame({name: values.T.ravel() for name, values in columns.items()}, index=index)

"""Comparison of samples with a check-case: errors over time, a verdict, and a table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from coadjoint.checkcases.attitudes import rotations_of, stacked
from coadjoint.checkcases.check_case import SPAN_MARGIN, CheckCase, Columns, Quantity
from coadjoint.checkcases.diagnosis import diagnose
from coadjoint.checkcases.tables import assign_columns, columns_of_dataset, read_table
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.short_repr import short
from coadjoint.validation import read_path, read_positive

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Floats = npt.NDArray[np.float64]

ROWS = 9  # of the printed table
MIN_NORM = 1e-3  # of a quaternion; below, it is no attitude
NORM_TOLERANCE = 1e-6  # deviation of the norm of quaternions that is reported, above that of printed digits

LISTED_NAMES = 20  # of columns that are ignored
UNEXPLAINED = "none of the known mistakes explains this"
STEP_HINT = "; give the step of the simulator (--step), to compare the samples with common schemes of low order"


class Errors(NamedTuple):
    """Errors of a quantity or an invariant over time.

    Attributes
    ----------
    name, unit : str
        Name and unit of `absolute`.
    absolute : ndarray, shape (k,)
        Lengths of differences, or angles in radians.
    scale : float
        Largest size in the reference, by which relative errors are divided; 1 for an attitude.
    """

    name: str
    unit: str
    absolute: Floats
    scale: float

    @property
    def relative(self) -> Floats:
        """Errors divided by the scale."""
        return self.absolute / self.scale

    @property
    def largest(self) -> float:
        """Largest relative error."""
        return float(self.relative.max())


@suggest_keywords
@dataclass(frozen=True, eq=False)
class Comparison:
    """Errors of samples against a check-case; ``print`` shows a table and the diagnosis.

    `CheckCase.compare` makes it.

    Parameters
    ----------
    case : CheckCase
        The case.
    t : (k,)
        Times of the samples, s.
    errors : tuple of Errors
        Of each quantity that the samples have, and of each invariant that follows from them.
    tolerance : float
        Largest relative error that passes.
    diagnosis : tuple of str
        What the difference looks like; empty within the tolerance.
    notes : tuple of str
        Columns that were found under other names or converted, those that were ignored, and quantities that the
        samples lack.
    unexplained : str
        Sentence for a difference beyond the tolerance that no known mistake explains; otherwise empty.

    Examples
    --------
    >>> import coadjoint as co
    >>> case = co.checkcases.get("coning")
    >>> mine = case.reference()
    >>> mine |= {name: -mine[name] for name in ("qx", "qy", "qz")}
    >>> found = case.compare(mine)
    >>> found.passed, found.diagnosis
    (False, ('the quaternion is conjugated: it is the rotation from space to the body',))
    """

    case: CheckCase
    t: Floats
    errors: tuple[Errors, ...]
    tolerance: float
    diagnosis: tuple[str, ...]
    notes: tuple[str, ...]
    unexplained: str = ""

    @property
    def passed(self) -> bool:
        """Whether every error is within the tolerance."""
        return all(each.largest <= self.tolerance for each in self.errors)

    def __str__(self) -> str:
        """Return the verdict, a table of errors over time, and the diagnosis."""
        rows = np.unique(np.linspace(0, len(self.t) - 1, ROWS).round().astype(int))
        width = max(len(each.name) for each in self.errors) + 2
        heads = [f"{each.name:>{max(12, width)}}" for each in self.errors]
        lines = [f"{self.case.name}: {'within' if self.passed else 'BEYOND'} the tolerance of {self.tolerance:g}"]
        lines += [f"  {note}" for note in self.notes]
        lines += [
            "errors, relative to the largest value, or in rad for an attitude:",
            f"{'t [s]':>12}" + "".join(heads),
        ]
        for k in rows:
            cells = [f"{each.relative[k]:{max(12, width)}.3g}" for each in self.errors]
            lines.append(f"{self.t[k]:12.6g}" + "".join(cells))
        lines.append(f"{'largest':>12}" + "".join(f"{each.largest:{max(12, width)}.3g}" for each in self.errors))
        lines += [f"it looks like this: {sentence}" for sentence in self.diagnosis]
        lines += [self.unexplained] if self.unexplained else []
        return "\n".join(lines)

    def columns(self) -> Columns:
        """Return the relative errors over time, by the names of quantities, with the time ``"t"``.

        Returns
        -------
        dict

        Examples
        --------
        >>> import coadjoint as co
        >>> case = co.checkcases.get("rod")
        >>> sorted(case.compare(case.reference()).columns())
        ['attitude', 'energy', 'momentum in space', 'rates', 't']
        """
        return {"t": self.t, **{each.name: each.relative for each in self.errors}}

    def plot(self) -> Figure:
        """Plot the errors over time on a logarithmic axis.

        Returns
        -------
        matplotlib.figure.Figure

        Raises
        ------
        MissingPackageError
            Matplotlib is not installed.

        Examples
        --------
        >>> import coadjoint as co
        >>> case = co.checkcases.get("rod")
        >>> figure = case.compare(case.reference()).plot()
        """
        from coadjoint.checkcases.comparison_figure import draw_comparison

        return draw_comparison(self)


def compare(
    case: CheckCase,
    samples: Mapping[str, npt.ArrayLike] | str | Path,
    *,
    columns: Mapping[str, str] | str | None,
    tolerance: float,
    step: float | None,
) -> Comparison:
    """Compare samples with a case; see `CheckCase.compare`."""
    tolerance = read_positive(tolerance, "tolerance")
    if tolerance < case.accuracy:
        raise ValueError(
            f"tolerance is {tolerance:g}; the reference of {case.name} is known to {case.accuracy:g}: give more"
        )
    step = None if step is None else read_positive(step, "step")
    given: Any = samples
    is_table = hasattr(given, "keys")
    raw = _read_mapping(given) if is_table else read_table(read_path(given, "samples"))
    named = "" if is_table else f"{given}: "
    try:
        table, quantities, notes = _read_samples(case, raw, columns)
    except ValueError as error:
        raise ValueError(f"{named}{error}") from None
    reference = case.reference(table["t"])
    errors = tuple(errors_of(case, table, reference, quantities))
    passed = all(each.largest <= tolerance for each in errors)
    if passed:
        return Comparison(case, table["t"], errors, tolerance, (), tuple(notes))
    findings, has_mistake = diagnose(case, table, reference, quantities, tolerance, step)
    unexplained = "" if has_mistake else UNEXPLAINED
    if unexplained and step is None and case.body is not None:
        unexplained += STEP_HINT
    return Comparison(case, table["t"], errors, tolerance, tuple(findings), tuple(notes), unexplained)


def _read_mapping(samples: Any) -> Mapping[str, Any]:
    """Return columns by name of a mapping, a table of pandas, or a dataset of xarray."""
    if hasattr(samples, "data_vars"):
        return columns_of_dataset(samples, "samples")
    try:
        return {str(name): np.asarray(samples[name]) for name in samples}
    except (TypeError, KeyError, IndexError):
        raise TypeError(f"samples is {short(samples)}; give columns by name, or the name of a file") from None


def _read_samples(
    case: CheckCase, raw: Mapping[str, Any], given: Any
) -> tuple[Columns, tuple[Quantity, ...], list[str]]:
    """Validate samples: complete quantities, increasing times in the span, finite numbers, unit quaternions."""
    needed = {"t": "s", **{name: quantity.unit for quantity in case.quantities for name in quantity.columns}}
    found = assign_columns(raw, needed, given)
    notes = list(found.notes)
    lengths = {name: len(values) for name, values in found.items()}
    if len(set(lengths.values())) != 1:
        raise ValueError(f"the columns have different lengths: {lengths}")
    quantities, absent = [], []
    for quantity in case.quantities:
        missing = [name for name in quantity.columns if name not in found]
        if not missing:
            quantities.append(quantity)
        elif len(missing) < len(quantity.columns):
            raise ValueError(
                f"of {', '.join(quantity.columns)}, the table lacks {', '.join(missing)}; name them by "
                "columns= (--columns)"
            )
        else:
            absent.append(f"{quantity.name} ({', '.join(quantity.columns)})")
    unused = _listed(found.unused)
    if not quantities:
        names = ", ".join(name for name in needed if name != "t")
        raise ValueError(
            f"no columns of {names} found among {short(', '.join(raw))}; name them by columns= (--columns), such as "
            f"{case.quantities[0].columns[0]}=NAME"
        )
    if absent and found.unused and not found.is_chosen:
        raise ValueError(
            f"the samples lack {', '.join(absent)}, and have columns that are not recognized, {unused}; name the "
            f"columns of all quantities to compare by columns= (--columns), such as {quantities[0].columns[0]}=NAME, "
            "or remove the others"
        )
    if absent:
        notes.append(f"not compared, since the samples lack it: {', '.join(absent)}")
    if found.unused:
        notes.append(f"ignored columns of the samples: {unused}")
    for name, values in found.items():
        if not np.isfinite(values).all():
            row = int(np.argmin(np.isfinite(values)))
            raise ValueError(f"{name} is {values[row]} in sample {row + 1}; give finite numbers")
    t = found["t"]
    if len(t) < 2 or not (np.diff(t) > 0).all():
        row = int(np.argmin(np.diff(t) > 0)) if len(t) > 1 else 0
        raise ValueError(
            f"t is {short(t[row : row + 2].tolist())} from sample {row + 1} on; give two or more increasing times"
        )
    margin = SPAN_MARGIN * case.end
    if t[0] < -margin or t[-1] > case.end + margin:
        outside = t[0] if t[0] < -margin else t[-1]
        raise ValueError(
            f"t contains {outside:g} s, and the case runs from 0 to {case.end:g} s; leave other samples out, or "
            "give the unit of the times by columns= (--columns), such as t=NAME[ms]"
        )
    for quantity in quantities:
        if quantity.kind != "attitude":
            continue
        norms = np.linalg.norm(stacked(found, quantity.columns), axis=1)
        if norms.min() < MIN_NORM:
            raise ValueError(
                f"{', '.join(quantity.columns)} is no rotation in sample {int(norms.argmin()) + 1}: its norm is "
                f"{norms.min():g}"
            )
        off = float(np.abs(norms - 1.0).max())
        if off > NORM_TOLERANCE:
            notes.append(f"quaternions were normalized; their norms differ from 1 by up to {off:.2g}")
        for name in quantity.columns:
            found[name] = found[name] / norms
    return dict(found), tuple(quantities), notes


def _listed(names: tuple[str, ...]) -> str:
    """Return names in quotes, the first ones of many."""
    more = f" and {len(names) - LISTED_NAMES} more" if len(names) > LISTED_NAMES else ""
    return ", ".join(short(name) for name in names[:LISTED_NAMES]) + more


def errors_of(
    case: CheckCase, table: Mapping[str, Floats], reference: Mapping[str, Floats], quantities: tuple[Quantity, ...]
) -> list[Errors]:
    """Return the errors of quantities and of the invariants that follow from them."""
    errors = []
    for quantity in quantities:
        if quantity.kind == "attitude":
            between = rotations_of(table, quantity.columns).inv() * rotations_of(reference, quantity.columns)
            errors.append(Errors(quantity.name, "rad", np.asarray(between.magnitude()), 1.0))
        else:
            values, certain = stacked(table, quantity.columns), stacked(reference, quantity.columns)
            errors.append(_vector_errors(quantity.name, quantity.unit, values, certain))
    present = {quantity.name for quantity in quantities}
    for invariant in case.invariants:
        if present.issuperset(invariant.quantities):
            values, certain = invariant.function(table), invariant.function(reference)
            errors.append(_vector_errors(invariant.name, invariant.unit, values, certain, invariant.size))
    return errors


def _vector_errors(name: str, unit: str, values: Floats, certain: Floats, least: float = 0.0) -> Errors:
    differences, sizes = (np.abs(each.reshape(len(each), -1)) for each in (values - certain, certain))
    scale = max(float(np.linalg.norm(sizes, axis=1).max()), least)
    return Errors(name, unit, np.asarray(np.linalg.norm(differences, axis=1)), scale if scale > 0.0 else 1.0)


def observed_orders(comparisons: Sequence[Comparison], steps: Sequence[float]) -> dict[str, float]:
    """Return the order of a scheme from runs with several steps, for each quantity: the slope of a line through
    the logarithms of step and error, without errors at the accuracy of the reference.
    """
    orders = {}
    for name in (each.name for each in comparisons[0].errors):
        found = [{each.name: each.largest for each in comparison.errors}.get(name, 0.0) for comparison in comparisons]
        floor = 10.0 * comparisons[0].case.accuracy
        pairs = [(step, error) for step, error in zip(steps, found, strict=True) if error > floor]
        if len({step for step, _ in pairs}) > 1:
            h, e = np.log(np.array(pairs)).T
            orders[name] = float(np.polyfit(h, e, 1)[0])
    return orders

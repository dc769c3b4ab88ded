"""Data model of a check-case: statement, parameters, columns, reference motion and its accuracy."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from coadjoint.errors import in_one_line
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.validation import read_finite, read_integer

if TYPE_CHECKING:
    from coadjoint.checkcases.comparison import Comparison

Floats = npt.NDArray[np.float64]
Columns = dict[str, Floats]

DEFAULT_TOLERANCE = 1e-6
"""Largest relative error, and error of the attitude in radians, that passes by default: far above what the references
leave uncertain, and below what a simulator with a mistake reaches."""
SPAN_MARGIN = 1e-9  # relative; sums of steps end this much beyond the span


def sample_times(end: float, samples: Any) -> Floats:
    """Return times from 0 to the end, whose number is validated."""
    return np.linspace(0.0, end, read_integer(samples, "samples", 2, 1_000_000))


class Quantity(NamedTuple):
    """A group of columns that are compared together.

    Attributes
    ----------
    name : str
        Such as ``"rates"``.
    columns : tuple of str
        Names of its columns.
    unit : str
        SI unit of each column.
    kind : {"vector", "attitude"}
        An error of a vector is the length of the difference, relative to the largest length of the reference. An
        attitude is a unit quaternion, scalar first, from the body to space; its error is an angle in radians.
    meaning : str
        What the columns are, with their frame.
    """

    name: str
    columns: tuple[str, ...]
    unit: str
    kind: str
    meaning: str


class DerivedQuantity(NamedTuple):
    """A function of the columns whose error is reported, such as the energy.

    Attributes
    ----------
    name, unit : str
        Name and SI unit.
    function : callable
        From the columns, each (k,), to values (k,) or vectors (k, n).
    quantities : tuple of str
        Quantities that it needs.
    size : float
        Least size by which errors are divided: that of its terms, if they cancel.
    """

    name: str
    unit: str
    function: Callable[[Mapping[str, Floats]], Floats]
    quantities: tuple[str, ...]
    size: float = 0.0


@dataclass(frozen=True, eq=False)
class BodyModel:
    """The single body of a check-case, from which mistakes of its simulation are imitated.

    Parameters
    ----------
    inertia : (3, 3)
        Inertia tensor in the body frame, kg m^2.
    rates : (3,)
        Angular velocity at the start, in the body frame, rad/s.
    attitude : (4,)
        Unit quaternion at the start, scalar first, from the body to space.
    rotors : (3,)
        Angular momentum of rotors relative to the body, in the body frame, kg m^2/s.
    torque : callable, optional
        External torque in the body frame, N m, from the time, the quaternion, the rates and the inertia tensor; None
        without one. Components are the first axes, (4,), (3,) and (3, 3), and a further last axis is that of several
        motions.
    period : float, optional
        Time for which the torque is held by a computer that evaluates it at multiples, s.
    potential : callable, optional
        Potential energy, J, from attitude matrices (k, 3, 3).
    orbital_frame : callable, optional
        Angle of the orbital frame about the third axis of space, rad, and its rate, rad/s, from times (k,).
    principal_axes : (3, 3), optional
        Rotation R of the statement, if the tensor is given as ``R diag(moments) R^T``.
    is_free : bool
        Whether no torque acts and there are no rotors.

    Examples
    --------
    >>> import coadjoint as co
    >>> co.checkcases.get("free_body").body.inertia.diagonal()
    array([1. , 2. , 2.5])
    """

    inertia: Floats
    rates: Floats
    attitude: Floats = field(default_factory=lambda: np.array([1.0, 0.0, 0.0, 0.0]))
    rotors: Floats = field(default_factory=lambda: np.zeros(3))
    torque: Callable[[float, Floats, Floats, Floats], Floats] | None = None
    period: float | None = None
    potential: Callable[[Floats], Floats] | None = None
    orbital_frame: Callable[[Floats], tuple[Floats, Floats]] | None = None
    principal_axes: Floats | None = None
    is_free: bool = False


RATES = Quantity("rates", ("wx", "wy", "wz"), "rad/s", "vector", "angular velocity in inertial space, body frame")
ATTITUDE = Quantity(
    "attitude", ("qw", "qx", "qy", "qz"), "1", "attitude", "unit quaternion, scalar first, from the body to space"
)


@suggest_keywords
@dataclass(frozen=True, eq=False)
class CheckCase:
    """A problem with a certain answer, with which the output of any simulator can be compared.

    `get` makes those of the library. Choose `reference` for the motion at any times, `compare` for the errors of
    samples of your own and what they look like, and `write` for a file that others can read without this library.

    Parameters
    ----------
    name, title : str
        Name, and what it is in one line.
    statement : str
        Equations, start and conventions, in SI units.
    parameters : mapping
        From names to pairs of a value and its unit.
    quantities : tuple of Quantity
        Groups of columns besides the time ``t``, in seconds.
    motion : callable
        From times (k,) within the span to columns, each (k,).
    times : (k,)
        Sampled times, from zero, s.
    accuracy : float
        Bound of the errors of the reference, relative to the largest value of each quantity, or in radians.
    basis : str
        How the reference is known.
    source : str
        Literature.
    invariants : tuple of DerivedQuantity
        Energy, momenta and others whose errors are reported.
    body : BodyModel, optional
        The body, if the case is the rotation of one.
    results : mapping
        Further certain numbers, such as a period, from names to pairs of a value and its unit.
    published : mapping
        Published samples of simulators, by name, as columns.

    Raises
    ------
    ValueError
        Samples that cannot be compared, or times outside of the span.

    Examples
    --------
    >>> import coadjoint as co
    >>> case = co.checkcases.get("middle_axis_flip")
    >>> mine = case.reference([0.0, 1.0, 2.0])
    >>> case.compare(mine).passed
    True
    >>> print(case.compare(mine | {"wx": -mine["wx"]}).passed)
    False
    """

    name: str
    title: str
    statement: str
    parameters: Mapping[str, tuple[Any, str]]
    quantities: tuple[Quantity, ...]
    motion: Callable[[Floats], Columns]
    times: Floats
    accuracy: float
    basis: str
    source: str
    invariants: tuple[DerivedQuantity, ...] = ()
    body: BodyModel | None = None
    results: Mapping[str, tuple[Any, str]] = field(default_factory=dict)
    published: Mapping[str, Columns] = field(default_factory=dict)

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of all columns; the first is the time."""
        return ("t", *(column for quantity in self.quantities for column in quantity.columns))

    @property
    def end(self) -> float:
        """Last time for which the accuracy is stated, s."""
        return float(self.times[-1])

    def spread(self) -> float:
        """Return the difference of the references by schemes of two orders, which the accuracy bounds.

        Returns
        -------
        float
            Largest difference of the states at the sampled times, relative to the largest of each coordinate; 0 for a
            closed form, which is evaluated in one way.

        Examples
        --------
        >>> import coadjoint as co
        >>> case = co.checkcases.get("gyrostat", end=5.0)
        >>> 0.0 < case.spread() < case.accuracy
        True
        """
        spread = getattr(self.motion, "spread", None)
        return 0.0 if spread is None else float(spread(self.times))

    def reference(self, t: npt.ArrayLike | None = None) -> Columns:
        """Return the certain motion, by columns.

        Parameters
        ----------
        t : (k,), optional
            Times from zero to the end of the case, s, in any order; by default its sampled times.

        Returns
        -------
        dict
            From ``"t"`` and the names of columns to arrays (k,), in SI units.

        Raises
        ------
        ValueError
            Times outside of the span, or of another shape.

        Examples
        --------
        >>> import coadjoint as co
        >>> co.checkcases.get("coning").reference([0.0, 2.0])["wz"]
        array([6., 6.])
        """
        times = self.times if t is None else read_finite(t, "t")
        if times.ndim != 1 or not times.size:
            raise ValueError(f"t has shape {times.shape}; give one or several times, (k,)")
        margin = SPAN_MARGIN * self.end
        if times.min() < -margin or times.max() > self.end + margin:
            outside = times[(times < -margin) | (times > self.end + margin)][0]
            raise ValueError(
                f"t contains {outside:g} s; the reference of {self.name} is known from 0 to {self.end:g} s: "
                "leave other times out"
            )
        return {"t": np.array(times), **self.motion(np.clip(times, 0.0, self.end))}

    def compare(
        self,
        samples: Mapping[str, npt.ArrayLike] | str | Path,
        *,
        columns: Mapping[str, str] | str | None = None,
        tolerance: float = DEFAULT_TOLERANCE,
        step: float | None = None,
    ) -> Comparison:
        """Compare samples of a simulator with the certain motion.

        Parameters
        ----------
        samples : mapping, str or Path
            Columns by name, a table of pandas or a dataset of xarray; or a file: CSV, Parquet or NetCDF.
        columns : mapping or str, optional
            From columns of the case to those of the samples, with a unit in brackets unless it is the SI unit or
            the name ends with it, as ``clock_ms`` does: ``{"wx": "p[deg/s]"}`` or ``"wx=p[deg/s]"``.
            For a CSV file without a header, the names of its columns in their order. By default names are matched.
        tolerance : float
            Largest error that passes: relative for rates, energy and other vectors, in radians for the attitude.
        step : float, optional
            Step of the simulator, s, for a diagnosis of its scheme.

        Returns
        -------
        Comparison
            Errors over time, whether they are within the tolerance, and what the difference looks like.

        Raises
        ------
        TypeError, ValueError
            Columns that are missing, ambiguous or not finite, times outside of the span or not increasing, or a
            tolerance below the accuracy of the reference.

        Examples
        --------
        >>> import coadjoint as co
        >>> case = co.checkcases.get("free_body")
        >>> mine = case.reference()
        >>> degrees = mine | {name: 57.29577951308232 * mine[name] for name in ("wx", "wy", "wz")}
        >>> case.compare(degrees).diagnosis
        ('the rates are in degrees per second',)
        """
        from coadjoint.checkcases.comparison import compare

        return compare(self, samples, columns=columns, tolerance=tolerance, step=step)

    def write(self, path: str | Path) -> None:
        """Write statement and reference to a file, CSV or JSON, with the digits that are certain.

        Parameters
        ----------
        path : str or Path
            With the suffix ``.csv`` or ``.json``.

        Raises
        ------
        OutputError
            Another suffix, or a file that cannot be written.

        Examples
        --------
        >>> import tempfile, coadjoint as co
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     co.checkcases.get("rod").write(f"{folder}/rod.csv")
        ...     co.checkcases.get("rod").compare(f"{folder}/rod.csv", tolerance=1e-12).passed
        True
        """
        from coadjoint.checkcases.reference_files import write_reference

        write_reference(self, path)

    def __str__(self) -> str:
        """Return the description of the case."""
        lines = [f"{self.name}: {self.title}", "", self.statement, ""]
        lines += [
            f"  {key} = {_value_text(value)} {unit}".rstrip(" 1")
            if unit == "1"
            else f"  {key} = {_value_text(value)} {unit}"
            for key, (value, unit) in self.parameters.items()
        ]
        lines += [f"  result: {key} = {_value_text(value)} {unit}" for key, (value, unit) in self.results.items()]
        lines += ["", f"columns: t [s], from 0 to {self.end:g}, {len(self.times)} samples"]
        lines += [f"  {', '.join(q.columns)} [{q.unit}]: {q.meaning}" for q in self.quantities]
        lines += ["", f"known to {self.accuracy:.0e}: {self.basis}", f"source: {self.source}"]
        return "\n".join(lines)

    def __repr__(self) -> str:
        return in_one_line(f"CheckCase({self.name!r}, {self.title!r})")


def _value_text(value: Any) -> str:
    return str(np.asarray(value).tolist()).replace("[", "(").replace("]", ")")

"""Fits of initial states, initial attitudes and parameters to measured trajectories, by least squares."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.analysis.fit_problem import OUTPUTS, FitProblem, Quantities, attitude_weights
from coadjoint.errors import MAX_LISTED_NAMES, unknown_name
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.labels import MEMBERS, STATE_DIMENSIONS, by_labels
from coadjoint.long_operations import warn_caller, without_warnings
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.runs.derivatives.parametrized_run import ParametrizedRun
from coadjoint.runs.prepared_run import PreparedRun
from coadjoint.runs.results.quantities import check_observe
from coadjoint.runs.results.solution import Solution
from coadjoint.short_repr import short
from coadjoint.systems.coordinates import coordinate_names
from coadjoint.systems.parameters import Parameter, parameter_of, parameters_at, parameters_of, with_parameters
from coadjoint.validation import are_finite, read_numbers

Floats = NDArray[np.float64]
MUCH_BETTER, W_FIRST = (
    'the measured "attitude" are fitted much better ',
    "as quaternions w x y z, which were read as x y z w",
)
# What measured rotations may be instead, with the mend: whether their quaternions have w first, and their inverses.
READINGS = {
    (False, True): f"{MUCH_BETTER}by their inverses: they are rotations from space to the body; give their inverses, "
    'or read the log with direction="space to body"',
    (True, False): f"{MUCH_BETTER}{W_FIRST}; give Rotation.from_quat(q[:, [1, 2, 3, 0]])",
    (True, True): f"{MUCH_BETTER}{W_FIRST}, of rotations from space to the body; give "
    "Rotation.from_quat(q[:, [1, 2, 3, 0]]).inv()",
}
EARLY = 20  # evaluations after which large residuals have other readings tried, and of each; others take about ten
UNEXPLAINED = 0.01  # of the squares about the mean, and of those of the given reading, if sigma is wrong
CONTRADICTION = 2.9e-7  # probability of a sum of squares above which a warning is given: that of five deviations
SMALL_STEP = 1e-3  # of the one that leads to the minimum of a linear problem
MOST_EVALUATIONS = 50  # of runs of a fit of angular velocities instead of momenta
# Half the distance of the states between which the derivative of the energy is differentiated; exact for quadratics.
ENERGY_DISTANCE = 2.0**-10
# Singular values, relative to the largest, of unknowns that Jacobians with central differences do not determine.
BY_DIFFERENCES = 2.0**-26
# Largest field of a Casimir, relative to the field of other directions of H.
CASIMIR = 1e-6


@dataclass(frozen=True, eq=False, repr=False)
class Fit:
    """The result of `fit`.

    Parameters
    ----------
    values : dict
        The fitted "x0", "attitude0" and parameters by name, each complete.
    unknowns : tuple of (str, int)
        The name and the number of each unknown, in the order of `covariance`. Those of "attitude0" are coordinates xi
        of the algebra: the attitude is ``exp(xi) attitude0``, for a body a rotation about axes in space. Those of
        symmetric matrices are entries of the upper triangle, which move with their mirror images. Of several
        trajectories, the numbers of "x0" and "attitude0" go through the first member, then the second, and so on.
    covariance : ndarray, shape (p, p)
        Of the unknowns, for measurements with independent normal errors of the given `sigma`.
    residuals : ndarray
        Measured minus fitted values, divided by their standard deviations.
    degrees_of_freedom : int
        The measured numbers, of a group element its dimension (three for rotations), less the unknowns: the expected
        sum of squares of `residuals`.
    solution : Solution
        The fitted run.
    """

    values: dict[str, Floats]
    unknowns: tuple[tuple[str, int], ...]
    covariance: Floats
    residuals: Floats
    degrees_of_freedom: int
    solution: Solution

    def standard_deviation(self, name: str) -> Floats:
        """Return the standard deviations of a name in the shape of its value, 0 for entries that were not fitted.

        Those of "attitude0" are of its coordinates xi, in the shape of "x0".
        """
        chosen = [k for k, (of, _) in enumerate(self.unknowns) if of == name]
        if not chosen and name in self.values:
            fitted = ", ".join(dict.fromkeys(of for of, _ in self.unknowns))
            raise ValueError(f"{name} was not fitted, and has no standard deviation; fitted were: {fitted}")
        if not chosen:
            raise unknown_name("value of this fit", name, dict.fromkeys(of for of, _ in self.unknowns))
        found = np.zeros(self.values["x0" if name == "attitude0" else name].shape)
        entries = [self.unknowns[k][1] for k in chosen]
        found.reshape(-1)[entries] = np.sqrt(np.diag(self.covariance)[chosen])
        symmetric = name not in ("x0", "attitude0") and parameter_of(self.solution.system, name).symmetric
        return np.maximum(found, found.T) if symmetric else found

    def __repr__(self) -> str:
        names = ", ".join(dict.fromkeys(name for name, _ in self.unknowns))
        total = float(np.sum(self.residuals**2))
        text = f"{len(self.unknowns)} unknowns, sum of squares of the residuals {total:.4g}"
        return f"<fit of {names}: {text} for {self.degrees_of_freedom} degrees of freedom>"


@suggest_keywords
def fit(
    ready: PreparedRun,
    x0: Any,
    t_span: tuple[float, float],
    measured: Mapping[str, Any],
    unknown: Mapping[str, Any],
    save_every: int = 1,
    *,
    sigma: Mapping[str, Any],
    t_eval: Any = None,
    attitude: Any = None,
    observe: Mapping[str, Any] | None = None,
) -> Fit:
    """Fit the initial state, the initial attitude and parameters of a run to measurements, by least squares.

    The Jacobian is exact, by `PreparedRun.jvp`; the minimum is found by ``scipy.optimize.least_squares``. For other
    residuals or robust losses call that function with `jvp`; for many parameters use gradients by `PreparedRun.vjp`.

    Parameters
    ----------
    ready : PreparedRun
        The run, prepared with a step, for guessed parameters. It must have an attitude if attitudes are measured.
    x0, attitude
        Guesses of the initial state, shape (n,), and of the initial attitude, as in `PreparedRun.run`; for several
        trajectories, (members, n). They share the parameters and the times.
    t_span, save_every, t_eval
        As in `PreparedRun.run`; the measurements are those of the saved times.
    measured : mapping
        "x" of shape (k, n) or (k, members, n), "attitude" of shape (k, d, d) or (k, members, d, d), or rotations of
        SciPy, the "angular_velocity" or "angular_momentum" of a body in its own frame, such as gyroscopes measure, and
        "positions" and "velocities", as solutions have them, quantities of ``prepare(observe=...)``, (k,) or (k,
        members), and those of `observe`, (k, ...) or (k, members, ...), by name. Labelled "x" and "attitude", such as
        a table of pandas over the saved times, are used by their labels.
    unknown : mapping
        The names to fit, "x0", "attitude0" or names of ``ready.parameters``: True for all entries, or the numbers of
        the unknown ones (of an array of several axes, in C order). Entries of "x0" and "attitude0" are those of all
        members; a coordinate that must be 1 is none of them. An entry of a symmetric matrix, such as `M` of a
        `Quadratic`, and its mirror image are one unknown.
    sigma : mapping
        Standard deviations of the measured values by name: a number, or an array that broadcasts to their shape. Of
        attitudes those of the components of the rotation vector of the error, about axes of the body, in radians: a
        number, or one for each axis, (3,) or (k, 3); of other group elements, of its coordinates in the algebra.
    observe : mapping, optional
        Measured functions of one state by name, f(x) or f(x, t): each returns a number or an array of one shape, such
        as the components of a vector that a sensor measures. They are called in Python.

    Returns
    -------
    Fit
        With `values` by name, `covariance` of the `unknowns`, `standard_deviation` of a name, `residuals` and the
        `solution` at the minimum.

    Raises
    ------
    ValueError
        For unknown names and wrong shapes, for measurements that do not determine the unknowns, if the minimum is not
        found, or if the system permits no other values of the unknowns, as of coefficients that symmetry ties.
    TypeError
        For runs without derivatives, batches, or values that are not numbers.

    Warns
    -----
    UserWarning
        The sum of squares of the residuals is so large that `sigma` or the model is wrong: its probability is less than
        that of five standard deviations. Or the "x" of a body with three coordinates are its angular velocities: their
        likelihood as these is so much larger, for errors of any size.

    Notes
    -----
    Angular velocities, momenta and observed quantities are differentiated by central differences at the states, along
    the exact tangents of these.

    The residuals of attitudes are the entries of ``attitude - measured``, divided by ``sqrt(2) sigma`` (of translations
    by sigma), or with a sigma for each axis the coordinates of ``measured^-1 attitude - 1``. If an attitude is
    multiplied by a small rotation, the sum of their squares is that of the rotation vector divided by sigma. So the sum
    over a run has a chi-squared distribution of three degrees of freedom for each attitude, n for each state, less the
    unknowns.

    Examples
    --------
    >>> import coadjoint as co
    >>> body = co.systems.rigid_body(inertia=(1.0, 2.0, 2.5))
    >>> x0 = (1.0, 0.2, 0.5)
    >>> measured = {"x": co.integrate(body, x0, (0, 10), 0.05, co.Splitting(order=4)).x}
    >>> guess = co.prepare(co.systems.rigid_body(inertia=(1.1, 2.0, 2.4)), co.Splitting(order=4), step=0.05)
    >>> found = co.fit(guess, x0, (0, 10), measured, {"inertia": (0, 2)}, sigma={"x": 0.01})
    >>> found.values["inertia"].round(8).tolist()
    [1.0, 2.0, 2.5]

    The rates of a gyroscope:

    >>> rates = {"angular_velocity": measured["x"] / (1.0, 2.0, 2.5)}
    >>> found = co.fit(guess, x0, (0, 10), rates, {"inertia": (0, 2), "x0": True}, sigma={"angular_velocity": 0.01})
    >>> found.values["inertia"].round(6).tolist()
    [1.0, 2.0, 2.5]

    The first two components of a vector, here of the momentum:

    >>> observe, sigma = {"plane": lambda x: x[:2]}, {"plane": (0.01, 0.02)}
    >>> planes = {"plane": measured["x"][:, :2]}
    >>> found = co.fit(guess, x0, (0, 10), planes, {"inertia": (0, 2)}, sigma=sigma, observe=observe)
    >>> found.values["inertia"].round(6).tolist(), found.degrees_of_freedom
    ([1.0, 2.0, 2.5], 400)

    Several trajectories, as `identify` takes them:

    >>> starts = [(1.0, 0.2, 0.5), (0.1, 1.0, 0.4)]
    >>> measured = {"x": co.integrate(body, starts, (0, 10), 0.05, co.Splitting(order=4)).x}
    >>> co.fit(guess, starts, (0, 10), measured, {"inertia": (0, 2), "x0": True}, sigma={"x": 0.01})
    <fit of inertia, x0: 8 unknowns, sum of squares of the residuals ...>
    """
    for what, given in (("measured", measured), ("sigma", sigma)):
        if not isinstance(given, Mapping) or not (given or what == "sigma"):
            example = next(iter(measured), "x") if what == "sigma" else "x"
            raise TypeError(
                f"{what} is {short(given)}; give a mapping from names, such as {short(example)}, to "
                f"{'numbers' if what == 'measured' else 'standard deviations'}"
            )
    run = ParametrizedRun(ready, t_span, save_every, t_eval, "co.fit")
    problem = FitProblem.of(ready, x0, attitude, run, unknown)
    measured = {name: _as_saved(name, value, ready, run.saved_times) for name, value in measured.items()}
    observe = _read_observe(ready, {} if observe is None else observe)
    problem = problem.measuring(ready, measured, observe)
    weights = _weights(measured, sigma, problem, Quantities.names_of(ready, observe))
    targets = {name: read_numbers(measured[name], f"measured {name}") for name in weights}
    problem = problem._replace(weights=weights, targets=targets)
    count = len(problem.unknowns)
    first = problem.jacobian(np.zeros(count))
    _check_determined(first, problem, "at the guess")
    readings = _Readings(ready, x0, unknown, problem, observe)
    problem, end = _minimum(problem, first, watch=readings.watch)
    guess = problem
    with without_warnings():  # of values that may not be those returned
        # At a guess moved to the minimum, coordinates of the attitude are those of a small rotation.
        moved = problem.moved(end.x)
        problem = problem._replace(values=moved)
        if end.status <= 0:
            advice = readings.found(2.0 * float(end.cost)) or "give closer guesses"
            raise ValueError(f"the minimum was not found in {end.nfev} evaluations; {advice}")
        final, freedom = -problem.residuals_of(problem.outputs()), problem.degrees_of_freedom
        squares = float(final @ final)
        contradicts = _contradicts(squares, freedom)
        if contradicts:
            _check_permitted(guess, first, end.x)
        J = problem.jacobian(np.zeros(count))
        place = (
            f"at the point reached, where the sum of squares of the residuals is {squares:.4g} for {freedom} degrees "
            "of freedom, and which may be far from the minimum,"
        )
        reading = readings.found(squares) if contradicts else ""
        advice = reading or ("give a better guess, or omit" if contradicts else "omit")
        _check_determined(J, problem, place if contradicts else "at the minimum", advice)
        rates = _are_rates(ready, attitude, unknown, problem, observe)
    if rates:
        warn_caller(
            'the measured "x" are fitted much better as angular velocities than as momenta, whatever sigma is; name '
            'them "angular_velocity"',
            UserWarning,
        )
    elif contradicts:
        warn_caller(
            reading
            or (
                f"the residuals contradict sigma: the sum of their squares is {squares:.4g} for {freedom} degrees "
                "of freedom, where as many are expected; the errors are larger than sigma, the measured values are not "
                "those that they are named for, the model is wrong, or the guess is too far from the minimum, and the "
                "covariance holds for none of these"
            ),
            UserWarning,
        )
    scale = np.linalg.norm(J, axis=0)
    _, values, vectors = np.linalg.svd(J / scale, full_matrices=False)
    root = vectors.T / values / scale[:, None]
    parameters = {name: value for name, value in moved.items() if name not in ("x0", "attitude0")}
    if changed := {name: parameters[name] for name in problem.chosen if name in parameters}:
        with_parameters(ready.system, changed)  # with its warnings, such as of moments that no body has
    fitted = problem.run.prepared_at(parameters)
    solution = fitted.run(moved["x0"], t_span, save_every, t_eval=t_eval, attitude=moved.get("attitude0"))
    return Fit(moved, problem.unknowns, root @ root.T, final, freedom, solution)


def _are_rates(
    ready: PreparedRun, attitude: Any, unknown: Mapping[str, Any], fitted: FitProblem, observe: Mapping[str, Any]
) -> bool:
    """Test whether the measured momenta of a body are its angular velocities, whatever sigma is."""
    # For normal errors of any size, a ratio of likelihoods in favour of the wrong name exceeds 1 / p with a
    # probability of at most p.
    known, n, targets, x0 = Quantities.names_of(ready, observe), ready.system.dim, fitted.targets, fitted.values["x0"]
    if "x" not in targets or n != 3 or "angular_velocity" in targets or "angular_velocity" not in known:
        return False
    of_x = fitted.weights["x"] * targets["x"]

    def variance(name: str, start: Floats) -> float:
        """Return the mean square of the residuals for a name of "x"; NaN without a fit, or for half of the digits."""
        renamed, weights = (
            {name if key == "x" else key: one for key, one in values.items()} for values in (targets, fitted.weights)
        )
        try:
            problem = FitProblem.of(ready, start, attitude, fitted.run, {**unknown, "x0": True})
            tried = problem.measuring(ready, renamed, observe)._replace(weights=weights, targets=renamed)
        except (ArithmeticError, ValueError):
            return math.nan
        return _variance(tried) + UNIT_ROUNDOFF * float(np.mean(of_x**2))

    units = np.concatenate([np.zeros((1, n)), np.eye(n)])
    rates = Quantities(ready, ["angular_velocity"], np.zeros(1), x0, {})
    at = rates.values(units, fitted.values)["angular_velocity"]
    as_rates = variance(
        "angular_velocity", np.linalg.solve((at[1:] - at[0]).T, (targets["x"][0] - at[0])[..., None])[..., 0]
    )
    enough = as_rates * math.exp(-2.0 * math.log(CONTRADICTION) / targets["x"].size)
    residuals, freedom = fitted.residuals_of(fitted.outputs()), fitted.degrees_of_freedom
    if not (freedom > 0 and float(residuals @ residuals) / freedom > enough):
        return False
    return variance("x", x0) > enough


def _minimum(problem: FitProblem, first: Floats | None = None, **options: Any) -> tuple[FitProblem, Any]:
    """Minimize from the guess, with the Jacobian `first`, without warnings of trial points."""
    with without_warnings(), np.errstate(all="ignore"):
        first = problem.jacobian(np.zeros(len(problem.unknowns))) if first is None else first
        near, first = problem.near_attitudes(first, **options)
        return near, near.minimum(first, **options)


def _check_permitted(problem: FitProblem, first: Floats, moved: Floats) -> None:
    """Raise ValueError with the reason if the unknowns hardly moved, because a small step to the minimum is refused."""
    step = np.asarray(np.linalg.lstsq(first, -problem.residuals_of(problem.outputs()), rcond=None)[0], np.float64)
    step *= SMALL_STEP
    if np.linalg.norm(first @ moved) > np.linalg.norm(first @ step):
        return
    try:
        problem.outputs(step)
    except ValueError as error:
        raise ValueError(f"the unknowns cannot move from the guess: {error}") from None


def _variance(tried: FitProblem, evaluations: int = MOST_EVALUATIONS) -> float:
    """Return the mean square of the residuals at the minimum; NaN without a fit."""
    try:
        _, end = _minimum(tried, max_nfev=evaluations)
    except (ArithmeticError, ValueError, np.linalg.LinAlgError):
        return math.nan
    return 2.0 * float(end.cost) / tried.degrees_of_freedom if tried.degrees_of_freedom > 0 else math.nan


class _Readings:
    """Other readings of measured rotations, which are tried once: early in a fit that goes wrong, or at its end."""

    def __init__(
        self, ready: PreparedRun, x0: Any, unknown: Mapping[str, Any], problem: FitProblem, observe: Mapping[str, Any]
    ) -> None:
        self._arguments, self._problem, self._observe = (ready, x0, {**unknown, "attitude0": True}), problem, observe
        self._evaluations, self._least, self._found = 0, math.inf, None if self._are_rotations() else ""
        means = {name: target.mean(axis=0) for name, target in problem.targets.items()}
        spread = problem.residuals_of(
            {name: np.broadcast_to(means[name], problem.targets[name].shape) for name in means}
        )
        self._spread = float(spread @ spread)

    def _are_rotations(self) -> bool:
        return "attitude" in self._problem.targets and self._problem.targets["attitude"].shape[-1] == 3

    def watch(self, squares: float) -> None:
        """Raise ValueError if a fit has found nothing after some evaluations, and another reading fits."""
        self._evaluations, self._least = self._evaluations + 1, min(squares, self._least)
        if self._evaluations != EARLY or self._least <= UNEXPLAINED * self._spread:
            return
        if _contradicts(self._least, self._problem.degrees_of_freedom) and (reading := self.found(self._least)):
            raise ValueError(f"the minimum was not found in {EARLY} evaluations; {reading}")

    def found(self, squares: float) -> str:
        """Return the reading that fits where that given, with this sum of squares, does not; empty if there is none."""
        freedom = self._problem.degrees_of_freedom
        if self._found is None and freedom > 0:
            given = squares / freedom
            fitting = (text for key, text in READINGS.items() if self._fits(self._as_read(*key), given))
            self._found = next(fitting, "")
        return self._found or ""

    def _as_read(self, w_first: bool, inverse: bool) -> Floats | None:
        """Return the rotations in another reading; None if they are no rotations."""
        from scipy.spatial.transform import Rotation

        rotations = self._problem.targets["attitude"]
        if w_first:
            try:
                quaternions = Rotation.from_matrix(rotations.reshape(-1, 3, 3)).as_quat()
            except ValueError:
                return None
            rotations = Rotation.from_quat(quaternions[:, [1, 2, 3, 0]]).as_matrix().reshape(rotations.shape)
        return np.ascontiguousarray(np.swapaxes(rotations, -1, -2)) if inverse else rotations

    def _fits(self, rotations: Floats | None, given: float) -> bool:
        """Test whether rotations are fitted as sigma or their scatter permits, and much better than those given."""
        if rotations is None:
            return False
        variance, freedom = self._variance(rotations)
        # For normal errors of any size, a ratio of likelihoods in favour of the wrong reading exceeds 1 / p with a
        # probability of at most p, if one of both is right: so one of them must fit.
        enough = variance * math.exp(-2.0 * math.log(CONTRADICTION) / rotations.size)
        if math.isnan(variance) or _contradicts(variance * freedom, freedom):
            enough = max(enough, variance / UNEXPLAINED)
            if not variance * freedom <= UNEXPLAINED * self._spread:
                return False
        return given > enough and not self._variance(self._problem.targets["attitude"])[0] <= enough

    def _variance(self, rotations: Floats) -> tuple[float, int]:
        """Return the mean square of the residuals of a fit that begins at the first rotation, and its freedom."""
        ready, x0, unknown = self._arguments
        targets, weights = {**self._problem.targets, "attitude": rotations}, dict(self._problem.weights)
        if weights["attitude"].ndim > rotations.ndim:  # maps of errors of the given rotations: entries count alike
            alike = np.sqrt(np.sum(weights["attitude"] ** 2, axis=(-3, -2, -1)) / 3.0)
            weights["attitude"] = np.broadcast_to(alike[..., None, None], rotations.shape)
        try:
            problem = FitProblem.of(ready, x0, rotations[0], self._problem.run, unknown)
        except (TypeError, ValueError):  # of attitudes that are part of the states
            return math.nan, 0
        tried = problem.measuring(ready, targets, self._observe)._replace(weights=weights, targets=targets)
        return _variance(tried, EARLY), tried.degrees_of_freedom


def _as_saved(name: str, value: Any, ready: PreparedRun, times: Floats) -> Any:
    """Return rotations of SciPy as matrices, labelled states and attitudes in the order of a run, others unchanged."""
    if name == "attitude" and hasattr(value, "as_matrix"):
        return value.as_matrix()
    if name not in OUTPUTS:
        return value
    member = ("member",) if "member" in getattr(value, "dims", ()) else ()
    axes = ("time", *member, *STATE_DIMENSIONS[name == "attitude"])
    order = {"time": times.tolist(), "component": coordinate_names(ready.system), **MEMBERS}
    return by_labels(value, f"measured {name}", axes, order)


def _read_observe(ready: PreparedRun, observe: Any) -> dict[str, Any]:
    """Validate the functions of states that a fit observes."""
    found, known = check_observe(observe, ready.system), {*OUTPUTS, *Quantities.names_of(ready, {})}
    for name in found:
        if name in known:
            raise ValueError(f"observe has {short(name)}, which is measured without a function; give another name")
    return found


def _contradicts(squares: float, freedom: int) -> bool:
    """Test whether residuals with independent normal errors have such a sum of squares hardly ever."""
    from scipy.special import gammaincc

    return freedom > 0 and bool(gammaincc(0.5 * freedom, 0.5 * squares) < CONTRADICTION)


def _weights(
    measured: Mapping[str, Any], sigma: Mapping[str, Any], problem: FitProblem, quantities: tuple[str, ...]
) -> dict[str, Floats]:
    """Return the factors of the residuals; raise an error for measurements that do not match the run."""
    weights, outputs = {}, problem.outputs()
    for name, value in measured.items():
        if name not in outputs:
            raise unknown_name("measured value of this run", name, (*outputs, *quantities))
        array, shape = read_numbers(value, f"measured {name}"), outputs[name].shape
        if array.shape != shape:
            quaternions = name == "attitude" and array.shape == (*shape[:-2], 4)
            advice = "; give quaternions as rotations of SciPy, Rotation.from_quat(q) if their order is xyzw"
            raise ValueError(
                f"measured {name} has the shape {array.shape}; it must be {shape}{advice if quaternions else ''}"
            )
        if not are_finite(array):
            place = short(tuple(int(k) for k in np.argwhere(~np.isfinite(array))[0]))
            raise ValueError(
                f"measured {name} is NaN or infinite at {place}; give finite numbers, and for those that are missing a "
                "large sigma, of the shape of the measurements"
            )
        if name not in sigma:
            raise ValueError(f"sigma has no standard deviation of {name}; give one")
        deviation = read_numbers(sigma[name], f"sigma of {name}")
        if not (are_finite(deviation) and np.all(deviation > 0)):
            raise ValueError(f"sigma of {name} is {short(sigma[name])}; give positive numbers")
        try:
            weights[name] = (
                attitude_weights(deviation, array, problem.generators)
                if name == "attitude"
                else np.broadcast_to(1.0 / deviation, shape)
            )
        except ValueError:
            raise ValueError(f"sigma of {name} has the shape {deviation.shape}; it must broadcast to {shape}") from None
    return weights


def _check_determined(J: Floats, problem: FitProblem, place: str, advice: str = "omit") -> None:
    """Raise ValueError if the Jacobian at a place has directions without influence on the measurements."""
    from scipy.linalg import qr

    unknowns = problem.unknowns
    if len(J) < len(unknowns):
        raise ValueError(f"{len(J)} numbers were measured for {len(unknowns)} unknowns; measure more")
    scale = np.linalg.norm(J, axis=0)
    scaled = J / np.where(scale > 0, scale, 1.0)
    _, values, vectors = np.linalg.svd(scaled, full_matrices=False)
    exact = problem.quantities is None
    free = values <= (16 * max(J.shape) * UNIT_ROUNDOFF if exact else BY_DIFFERENCES) * values[0]
    if free.any():
        directions = np.abs(vectors[free] / np.where(scale > 0, scale, 1.0))
        involved = np.flatnonzero((directions > 1e-3 * directions.max(axis=1, keepdims=True)).any(axis=0))
        names = " and ".join(dict.fromkeys(unknowns[k][0] for k in involved))
        # Without the last columns of a pivoted factorization, the others are independent.
        order = qr(scaled, mode="r", pivoting=True)[1]
        omitted = ", ".join(problem.entry(*unknowns[k]) for k in sorted(order[-free.sum() :])[:MAX_LISTED_NAMES])
        reason = _casimirs_among(vectors[free] / np.where(scale > 0, scale, 1.0), problem)
        raise ValueError(
            f"{place} the measurements do not determine all unknown entries of {names}{reason}; {advice}"
            + f", for instance, {omitted}" * advice.endswith("omit")
        )


def _casimirs_among(directions: Floats, problem: FitProblem) -> str:
    """Return the number of directions without influence that change H by a Casimir, in words for a message."""
    system = problem.system.unforced
    x = np.random.default_rng(1).standard_normal((4, system.dim))
    of_energy = parameters_of(system)
    named = {name: problem.values[name] for name in problem.chosen if name in of_energy}
    parameters, rows = parameters_at(system, named), []
    for z in directions:
        moved, rest = problem.split(z, named)
        gradients = _energy_gradients(parameters, moved, x)
        fields = [system.structure_matrix(point) @ gradient for point, gradient in zip(x, gradients, strict=True)]
        rows.append(np.concatenate([np.ravel(fields), rest]) / np.abs(z).max())
    count = len(rows) - int(np.linalg.matrix_rank(np.array(rows), CASIMIR))
    if not count:
        return ""
    return f" (in {count} of {len(rows)} free directions H changes by a Casimir, which moves nothing)"


def _energy_gradients(parameters: Mapping[str, Parameter], directions: Mapping[str, Floats], x: Floats) -> Floats:
    """Return the gradients at states (points, n) of the derivative of the energy along directions of parameters."""
    n = x.shape[-1]
    shifted = x[:, None, None] + ENERGY_DISTANCE * np.array([np.eye(n), -np.eye(n)])
    along = np.zeros(shifted.shape[:-1])
    for name, direction in directions.items():
        along += parameters[name].energy().at(shifted) @ direction.ravel()
    return (along[:, 0] - along[:, 1]) / (2 * ENERGY_DISTANCE)

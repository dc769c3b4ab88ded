"""Choice of a scheme and a step for a given accuracy, by trial runs and counted work, without timing."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from coadjoint.choosing.candidates import Candidate, supported_candidates
from coadjoint.choosing.cost_model import StepPredictor
from coadjoint.choosing.fitting import Fit, confirmed, fit
from coadjoint.choosing.member_sample import sample_of
from coadjoint.choosing.pilot import Pilot
from coadjoint.choosing.roundoff import least_roundoff
from coadjoint.choosing.tolerances import extrapolated_fit, first_tolerance_trial, fit_of_tolerance
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.long_operations import long_operation
from coadjoint.methods.gauss_legendre import GaussLegendre
from coadjoint.methods.protocol.method import Method
from coadjoint.methods.registry import read_method
from coadjoint.methods.splitting import Splitting
from coadjoint.methods.taylor import Taylor
from coadjoint.runs.start import start_of
from coadjoint.runs.times import span_of
from coadjoint.short_repr import short
from coadjoint.systems.system_checks import System, check_vector_states
from coadjoint.validation import read_bool, read_list, read_number

# Safety factor of the target error; rounding alone may take at most half of the accuracy (ROUNDING_SHARE).
SAFETY = 3.0
MODERATE_ORDER = 8
# Accepted ratio of the error to its target.
ACCEPTED_RATIO = 2.0
ROUNDING_SHARE = 0.5
# Upper bound of the cost of variable steps, relative to their first trial.
TRIAL_COST_FACTOR = 1.5
# Smallest target of the error, which is used as a divisor.
MIN_GOAL = 2.0**-1000


# The first two series with a constant step predict the cost of the others; for other kinds the first scheme does.
SCHEMES: tuple[Method, ...] = (
    Taylor(tolerance=1e-9),
    *(Taylor(p) for p in (16, 8, 20, 12, 24, 14, 10, 6)),
    *(GaussLegendre(s) for s in (8, 6, 12, 10, 4, 3, 2)),
    *(Splitting(order=p) for p in (10, 8, 6, 4, 2)),
)
PROCESSED: tuple[Method, ...] = tuple(Splitting(scheme=f"blanes_casas_murua{p}") for p in (10, 8, 6))


@dataclass(frozen=True)
class Choice:
    """A scheme and a step for a wanted accuracy, with the expected error; its `str` gives the reason in one line.

    Parameters
    ----------
    method : Method
        The scheme.
    step : float
        The step, positive; it divides the span.
    accuracy : float
        The wanted error of the momentum at the end, relative to its largest size in the run.
    error : float
        The expected error, truncation and rounding together.
    roundoff : float
        The part of `error` that is rounding.
    cost : float
        Work of the whole run of one member, in units of one rotation in a flow (about 11 ns).
    others : tuple of Choice
        The other schemes considered, the cheapest first, without those abandoned early as too expensive.

    Examples
    --------
    >>> import coadjoint as co
    >>> choice = co.choose(co.systems.rigid_body(inertia=(1, 2, 3)), (1.0, 0.2, 0.5), (0, 100), 1e-6)
    >>> choice.error < 1e-6, abs(100 / choice.step - round(100 / choice.step)) < 1e-9
    (True, True)
    """

    method: Method
    step: float
    accuracy: float
    error: float
    roundoff: float
    cost: float
    others: tuple[Choice, ...] = field(default=(), repr=False)

    def __str__(self) -> str:
        said = (
            f"{self.method} with step {self.step:.6g}: expected error {self.error:.1e} for the wanted "
            f"{self.accuracy:.1e} ({self.roundoff:.1e} of it rounding), at the cost of {self.cost:.2g} rotations"
        )
        if not self.others:
            return said
        other = self.others[0]
        return f"{said}; next {other.method} at {other.cost / max(self.cost, 1e-300):.2g} times that"


@suggest_keywords
@long_operation("choose")
def choose(
    system: System,
    x0: Any,
    t_span: tuple[float, float],
    accuracy: float,
    *,
    attitude: Any = False,
    methods: Method | str | Mapping[str, Any] | Sequence[Method | str | Mapping[str, Any]] | None = None,
    processed: bool = False,
) -> Choice:
    """Choose the scheme and the step that reach a wanted accuracy with the least work.

    Operations are counted and no time is measured, so the same inputs give the same choice. Each scheme integrates from
    x0 over a window at the beginning of the span, and is compared with an accurate reference. Schemes that these trials
    predict to be more expensive are skipped. The error at other steps follows from the order. The error at the end of
    the span is extrapolated from its growth over a quarter, a half and the whole window; the growth is assumed to be at
    least linear, and at least quadratic for schemes that are neither symmetric nor Poisson maps. Rounding is estimated.
    The chosen step is run over the window once more, and corrected if the error is too large. Changes in the character
    of the motion after the window are not predicted.

    Parameters
    ----------
    system : LiePoissonSystem or PoissonSystem
        The system.
    x0 : array_like, shape (n,) or (members, n)
        Initial momentum. For an ensemble, the choice serves the worst of four members, which a coarse run selects.
    t_span : (float, float)
        Start and end; the end may be the smaller one.
    accuracy : float
        Wanted: abs(x_num(t_end) - x(t_end)) <= accuracy * max abs(x(t)). Between 0 and 1.
    attitude : bool, "coadjoint", or array_like
        Whether the run computes the group element, as in `integrate`. Schemes that cannot are excluded, and its work is
        counted. The accuracy is that of the momentum.
    methods : Method or sequence of Method, optional
        The schemes to choose from; with a single one, only its step is chosen. The default is Taylor series of order 6
        to 24 with a constant step or with steps of their own (whose `tolerance` is chosen), Gauss-Legendre methods of 2
        to 12 stages, and splittings of order 2 to 10. Among these only splittings are Poisson maps.
    processed : bool
        Include processed splittings in the default schemes; with `methods` they are listed there. The cost of their
        processor is not counted, so use this for runs with few saved points, ``watch=False`` and a large `save_every`.

    Returns
    -------
    Choice
        The scheme, the step, and the expected error.

    Raises
    ------
    ValueError, TypeError
        For wrong input; for an accuracy that no scheme reaches in float64 over the span (the message gives the smallest
        possible one); for a motion that cannot be computed.

    See Also
    --------
    integrate : With ``accuracy=`` it uses `choose`, and runs the result.

    Examples
    --------
    >>> import coadjoint as co
    >>> body = co.systems.rigid_body(inertia=(1, 2, 3))
    >>> co.choose(body, (1.0, 0.2, 0.5), (0, 100), 1e-9).method
    Taylor(order=...)
    >>> poisson = [co.Splitting(order=p) for p in (2, 4, 6, 8, 10)]
    >>> co.choose(body, (1.0, 0.2, 0.5), (0, 100), 1e-9, methods=poisson).method.properties(body).poisson
    True
    """
    check_vector_states(system, "give step= and method=, since the cost of a step of matrices is not known")
    wanted, processed = _checked(accuracy), read_bool(processed, "processed")
    if processed and methods is not None:
        raise TypeError(
            "choose was given methods and processed; processed=True adds to the default schemes: list processed "
            "splittings in methods, such as Splitting(scheme='blanes_casas_murua6')"
        )
    # Numbers overflow near a blow-up; the results are checked below.
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        return _chosen(system, x0, span_of(t_span), wanted, attitude, methods, processed)


def _chosen(
    system: System, x0: Any, span: tuple[float, float], wanted: float, attitude: Any, methods: Any, processed: bool
) -> Choice:
    t0, t1 = span
    momenta = start_of(system, GaussLegendre(2), x0, False).momenta
    candidates = supported_candidates(
        system, _schemes(methods, processed, system.dim), x0, attitude, strict=methods is not None
    )
    if t0 == t1:
        return Choice(candidates[0].method, 1.0, wanted, 0.0, 0.0, 0.0)
    pilot = Pilot(system, sample_of(system, momenta, t0, t1 - t0), t0, t1 - t0, wanted)
    if least_roundoff(pilot) >= ROUNDING_SHARE:
        raise _failed_everywhere(candidates, abs(t1 - t0))
    fits = _fits(pilot, candidates, wanted)
    if not fits:
        raise ValueError(
            f"no step of {_named(candidates)} reaches the accuracy {wanted:g} over the time {abs(t1 - t0):g} at "
            "an acceptable cost; ask for a larger error, or for a shorter time"
        )
    exact = [better for each in fits if (better := _with_acceptable_roundoff(each, wanted)) is not None]
    if not exact:
        raise _unreachable(fits, candidates, wanted, abs(t1 - t0))
    best, *others = _confirmed_cheapest(exact, wanted)
    return replace(_choice(best, wanted), others=tuple(_choice(each, wanted) for each in others))


def _checked(accuracy: Any) -> float:
    wanted = read_number(accuracy, "accuracy")
    if not 0.0 < wanted < 1.0:
        raise ValueError(f"accuracy is {wanted:g}; it must lie between 0 and 1, such as 1e-6")
    return wanted


def _schemes(methods: Any, processed: bool, dim: int) -> tuple[Method, ...]:
    if methods is None:
        known = (*SCHEMES, *PROCESSED) if processed else SCHEMES
        return tuple(each for each in known if dim <= each.largest)
    rule = "it must be one or more schemes such as Splitting(order=4)"
    one = isinstance(methods, Method | str | Mapping)
    given = tuple(
        read_method(each) if isinstance(each, str | Mapping) else each
        for each in ((methods,) if one else read_list(methods, "methods", rule))
    )
    wrong = [each for each in given if not isinstance(each, Method)]
    if wrong or not given:
        raise TypeError(f"methods contains {short(wrong[0]) if wrong else 'nothing'}; {rule}")
    return given


def _goal(candidate: Candidate, wanted: float) -> float:
    """Return the target of the truncation error: lower for high orders, whose errors vary more with the step."""
    if candidate.method.own_steps:
        return wanted / SAFETY
    return max(wanted / (SAFETY * max(1.0, candidate.method.order / MODERATE_ORDER) ** 2), MIN_GOAL)


def _fits(pilot: Pilot, candidates: Sequence[Candidate], wanted: float) -> list[Fit]:
    """Fit the schemes that may be the best; those with variable steps get a first trial, and are fitted last."""
    least = least_roundoff(pilot)
    goal_of = partial(_goal, wanted=wanted)
    long_operation = [each for each in candidates if not each.method.own_steps]
    looks = [(each, first_tolerance_trial(pilot, each, goal_of(each))) for each in candidates if each.method.own_steps]
    seen = [extrapolated_fit(look, goal_of(each)) for each, look in looks if look is not None]
    nearest = min(seen, key=lambda look: look.cost, default=None)
    foresight = StepPredictor(goal_of, nearest)
    # The first trial is not exact.
    own = math.inf if nearest is None else TRIAL_COST_FACTOR * nearest.cost
    found = list[Fit]()

    def sound() -> float:
        """Return the least cost among fits with acceptable rounding."""
        return min(
            (each.cost for each in found if _with_acceptable_roundoff(each, wanted) is not None), default=math.inf
        )

    while long_operation:
        candidate = long_operation.pop(0)
        # Fits with too much rounding do not exclude other schemes, but limit the cost of their trials.
        if foresight.cost_lower_bound(candidate) > min(own, sound()):
            continue
        limit = min([own, *(each.cost for each in found)])
        result = fit(pilot, candidate, goal_of(candidate), limit, foresight.predict_steps(candidate))
        if result is None:
            continue
        if foresight.add_fit(result):
            long_operation = foresight.cheapest_first(long_operation)
        if not result.abandoned:
            found.append(result)
            if ROUNDING_SHARE * wanted < result.roundoff <= least:
                # All other schemes have as much rounding.
                break
    for candidate, look in looks:
        result = fit_of_tolerance(pilot, candidate, goal_of(candidate), sound(), look)
        if result is not None:
            found.append(result)
    return found


def _confirmed_cheapest(exact: Sequence[Fit], wanted: float) -> list[Fit]:
    """Sort by cost with the first one confirmed; confirmation may increase its cost."""
    long_operation, confirmed_ones = sorted(exact, key=lambda each: each.cost), list[Fit]()
    while long_operation and (not confirmed_ones or long_operation[0].cost < min(each.cost for each in confirmed_ones)):
        first = long_operation.pop(0)
        goal = _goal(first.candidate, wanted)
        confirmed_ones.append(confirmed(first, goal, min(ACCEPTED_RATIO * goal, wanted * (1.0 - ROUNDING_SHARE))))
    confirmed_ones.sort(key=lambda each: each.cost)
    return [confirmed_ones[0], *sorted([*confirmed_ones[1:], *long_operation], key=lambda each: each.cost)]


def _with_acceptable_roundoff(found: Fit, wanted: float) -> Fit | None:
    """Return a fit with acceptable rounding, with compensated summation if necessary and left open; else None."""
    if found.roundoff <= ROUNDING_SHARE * wanted:
        return found
    compensated = found.candidate.compensated()
    if compensated is None:
        return None
    better = replace(found, candidate=compensated)
    return better if better.roundoff <= ROUNDING_SHARE * wanted else None


def _unreachable(fits: Sequence[Fit], candidates: Sequence[Candidate], wanted: float, time: float) -> ValueError:
    every = [*fits, *(replace(each, candidate=c) for each in fits if (c := each.candidate.compensated()) is not None)]
    reached = min(each.roundoff for each in every) / ROUNDING_SHARE
    if not reached < 1.0:
        return _failed_everywhere(candidates, time)
    return ValueError(
        f"accuracy {wanted:g} is below what float64 reaches with {_named(candidates)} over the time {time:g}; with "
        f"rounding, {_rounded_up(reached)} is the least; ask for that, or for a shorter time"
    )


def _failed_everywhere(candidates: Sequence[Candidate], time: float) -> ValueError:
    return ValueError(
        f"no accuracy is reached in float64 with {_named(candidates)} over the time {time:g}: small changes of the "
        "initial state grow until nothing of it is left; take a shorter time"
    )


def _rounded_up(value: float) -> str:
    """Format a number with two digits, rounded up."""
    unit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return f"{math.ceil(value / unit) * unit:.1e}"


def _named(candidates: Sequence[Candidate]) -> str:
    return str(candidates[0].method) if len(candidates) == 1 else "any scheme"


def _choice(found: Fit, wanted: float) -> Choice:
    span = abs(found.pilot.span)
    error = found.error + found.roundoff
    return Choice(found.candidate.method, span / found.steps, wanted, error, found.roundoff, found.cost)

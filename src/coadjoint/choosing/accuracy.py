"""Choice of a scheme and a step for a given accuracy, by trial runs and counted work.

`chosen` takes these steps in order; one that leaves no scheme raises an error that names a remedy.

1. Candidates: the given schemes, or those that `candidate_schemes` offers and that support system and attitude.
2. Pilot: a reference over a window at the start of the motion of at most four members, and its rounding; no accuracy is
   reached if this grows to half the size of the motion.
3. Families of schemes that differ only in order: trials at two steps are extrapolated by the order; two orders are
   tried, and then the one that they predict to be the cheapest.
4. Rounding of each fit: summed with compensation if that is needed and allowed; fits that round too much are dropped.
5. Confirmation: the cheapest fit is run over the window again and corrected, until it remains the cheapest.
6. Other members: if the chosen scheme has larger errors in members of the ensemble outside the pilot, its step is
   chosen again for a pilot of these.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from coadjoint.choosing.candidates import Candidate, sample_of, supported_candidates, unseen_sample
from coadjoint.choosing.families import families, fits_of_family
from coadjoint.choosing.fitting import ROUNDING_SHARE, StepFit, confirmed_fit, least_roundoff
from coadjoint.choosing.pilot import Pilot
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.long_operations import long_operation
from coadjoint.methods.protocol.method import Method
from coadjoint.methods.registry import candidate_schemes, read_method, reference_scheme
from coadjoint.runs.start import combined, start_of
from coadjoint.runs.times import span_of
from coadjoint.systems.batch import Batch
from coadjoint.systems.system import System
from coadjoint.systems.system_checks import check_system, check_vector_states
from coadjoint.validation import read_bool, read_list, read_number


@dataclass(frozen=True)
class Choice:
    """A scheme and a step for a required accuracy, with the expected error; its `str` gives the reason in one line.

    Parameters
    ----------
    method : Method
        The scheme.
    step : float
        The step, positive; it divides the span.
    accuracy : float
        The required error of each group of coordinates at the end, relative to its largest size in the run.
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
        text = (
            f"{self.method} with step {self.step:.6g}: expected error {self.error:.1e} for the wanted "
            f"{self.accuracy:.1e} ({self.roundoff:.1e} of it rounding), at the cost of {self.cost:.2g} rotations"
        )
        if not self.others:
            return text
        next_choice = self.others[0]
        return f"{text}; next {next_choice.method} at {next_choice.cost / max(self.cost, 1e-300):.2g} times that"


@suggest_keywords
@long_operation("choose")
def choose(
    system: System | Batch,
    x0: Any,
    t_span: tuple[float, float],
    accuracy: float,
    *,
    attitude: Any = False,
    methods: Method | str | Mapping[str, Any] | Sequence[Method | str | Mapping[str, Any]] | None = None,
    processed: bool = False,
) -> Choice:
    """Choose the scheme and the step that reach a required accuracy with the least work.

    Operations are counted, so the same inputs give the same choice. Each scheme is tried over a window at the beginning
    of the span, from x0, and compared with an accurate reference; the error at other steps follows from the order. Of
    schemes that differ only in their order, those that others predict to be more expensive are skipped. The error at
    the end of the span is extrapolated from its growth over a quarter, a half and the whole window; the growth is
    assumed to be at least linear, and at least quadratic for schemes that are neither symmetric nor Poisson maps.
    Rounding is estimated. The chosen step is run over the window once more, and corrected until the error expected at
    the end is a large part of the accuracy, or of a half of it if the span is longer than the window. Changes in the
    character of the motion after the window are not predicted.

    Parameters
    ----------
    system : LiePoissonSystem, PoissonSystem or Batch
        The system, or one for each member.
    x0 : array_like, shape (n,) or (members, n)
        Initial momentum. For an ensemble or a batch, the choice serves the worst of four members, which a coarse run
        selects; the step is chosen again if the chosen scheme has larger errors in others.
    t_span : (float, float)
        Start and end; the end may be the smaller one.
    accuracy : float
        Wanted: abs(x_num(t_end) - x(t_end)) <= accuracy * max abs(x(t)), for each group of coordinates with a unit of
        its own, as in ``error_estimate(by_group=True)``. Between 0 and 1.
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
    return chosen(system, x0, t_span, accuracy, attitude, methods, processed)


def chosen(
    system: System | Batch,
    x0: Any,
    t_span: tuple[float, float],
    accuracy: float,
    attitude: Any,
    methods: Any,
    processed: bool = False,
    share: float = 1.0,
) -> Choice:
    """Return the choice; the truncation error may take a `share` of the accuracy."""
    check_system(system)
    advice = "give step= and method=, since the cost of a step of matrices is not known"
    check_vector_states(system.of_member(0), advice)
    system, x0 = combined(system, x0)
    required, processed = _read_accuracy(accuracy), read_bool(processed, "processed")
    if processed and methods is not None:
        raise TypeError(
            "choose was given methods and processed; processed=True adds to the default schemes: list processed "
            "splittings in methods, such as Splitting(scheme='blanes_casas_murua6')"
        )
    t0, t1 = span_of(t_span)
    # Numbers overflow near a blow-up; the results are checked below.
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        momenta = start_of(system, reference_scheme(4), x0, False).momenta
        schemes = _schemes(methods, processed, system.dim)
        candidates = supported_candidates(system, schemes, x0, attitude, strict=methods is not None)
        if t0 == t1:
            return Choice(candidates[0].method, 1.0, required, 0.0, 0.0, 0.0)
        pilot = Pilot(*sample_of(system, momenta, t0, t1 - t0), t0, t1 - t0, required, share)
        best, *others = _fits_of_sample(pilot, candidates, required)
        choice = _choice_of_fit(best, required)
        if len(momenta) > len(pilot.momenta) and not choice.method.own_steps:
            unseen = unseen_sample(system, momenta, pilot, choice.method, choice.step)
            if unseen is not None:
                second, *_ = _fits_of_sample(Pilot(*unseen, t0, t1 - t0, required, share), [best.candidate], required)
                choice = min(choice, _choice_of_fit(second, required), key=lambda each: each.step)
    return replace(choice, others=tuple(_choice_of_fit(each, required) for each in others))


def _fits_of_sample(pilot: Pilot, candidates: Sequence[Candidate], required: float) -> list[StepFit]:
    """Return the fits for the members of a pilot, the cheapest first; raise ValueError if there are none."""
    least = least_roundoff(pilot)
    if least >= ROUNDING_SHARE:
        raise _none_reached(candidates, abs(pilot.span))
    fits = list[StepFit]()
    for family in families(candidates):
        fits += fits_of_family(pilot, family, required, _lowest_cost(fits, required))
        if any(ROUNDING_SHARE * required < each.roundoff <= least for each in fits):
            break  # all other schemes have as much rounding
    accurate = _fits_with_acceptable_roundoff(pilot, candidates, required, fits)
    return _confirmed_cheapest(pilot, candidates, accurate, required)


def _read_accuracy(accuracy: Any) -> float:
    required = read_number(accuracy, "accuracy")
    if not 0.0 < required < 1.0:
        raise ValueError(f"accuracy is {required:g}; it must lie between 0 and 1, such as 1e-6")
    return required


def _schemes(methods: Any, processed: bool, dim: int) -> tuple[Method, ...]:
    if methods is None:
        return tuple(each for each in candidate_schemes(processed) if dim <= each.largest)
    rule = "it must be one or more schemes such as Splitting(order=4)"
    single = isinstance(methods, Method | str | Mapping)
    given = (methods,) if single else read_list(methods, "methods", rule)
    schemes = tuple(read_method(each, "an entry of methods") for each in given)
    if not schemes:
        raise TypeError(f"methods contains nothing; {rule}")
    return schemes


def _lowest_cost(fits: Sequence[StepFit], required: float) -> float:
    """Return the least cost among fits with acceptable rounding."""
    return min((each.cost for each in fits if _with_acceptable_roundoff(each, required) is not None), default=math.inf)


def _fits_with_acceptable_roundoff(
    pilot: Pilot, candidates: Sequence[Candidate], required: float, fits: Sequence[StepFit]
) -> list[StepFit]:
    """Return the fits with acceptable rounding; raise ValueError if there are none."""
    time = abs(pilot.span)
    if not fits:
        raise ValueError(
            f"no step of {_scheme_text(candidates)} reaches the accuracy {required:g} over the time {time:g} at "
            "an acceptable cost; ask for a larger error, or for a shorter time"
        )
    accurate = [adjusted for each in fits if (adjusted := _with_acceptable_roundoff(each, required)) is not None]
    if not accurate:
        compensated = [(each, each.candidate.compensated()) for each in fits]
        adjusted_fits = [replace(each, candidate=candidate) for each, candidate in compensated if candidate is not None]
        reachable = min(each.roundoff for each in (*fits, *adjusted_fits)) / ROUNDING_SHARE
        raise _below_rounding(candidates, required, time, reachable)
    return accurate


def _confirmed_cheapest(
    pilot: Pilot, candidates: Sequence[Candidate], accurate: Sequence[StepFit], required: float
) -> list[StepFit]:
    """Sort by cost with the first one confirmed, which may increase its cost; raise ValueError if none is."""
    pending, confirmed_fits, failed = sorted(accurate, key=lambda each: each.cost), list[StepFit](), list[StepFit]()
    while pending and (not confirmed_fits or pending[0].cost < min(each.cost for each in confirmed_fits)):
        first = pending.pop(0)
        found = confirmed_fit(first, required)
        (confirmed_fits if found.error <= required else failed).append(found)
    if not confirmed_fits:
        raise _below_rounding(candidates, required, abs(pilot.span), min(each.error for each in failed))
    confirmed_fits.sort(key=lambda each: each.cost)
    return [confirmed_fits[0], *sorted([*confirmed_fits[1:], *pending], key=lambda each: each.cost)]


def _with_acceptable_roundoff(fitted: StepFit, required: float) -> StepFit | None:
    """Return a fit with acceptable rounding, by compensated summation if needed and allowed; else None."""
    if fitted.roundoff <= ROUNDING_SHARE * required:
        return fitted
    compensated = fitted.candidate.compensated()
    if compensated is None:
        return None
    adjusted = replace(fitted, candidate=compensated)
    return adjusted if adjusted.roundoff <= ROUNDING_SHARE * required else None


def _choice_of_fit(fitted: StepFit, required: float) -> Choice:
    span = abs(fitted.pilot.span)
    error = fitted.error + fitted.roundoff
    return Choice(fitted.candidate.method, span / fitted.steps, required, error, fitted.roundoff, fitted.cost)


def _below_rounding(candidates: Sequence[Candidate], accuracy: float, time: float, reachable: float) -> ValueError:
    """Return the error for an accuracy below the smallest one that rounding allows."""
    if not reachable < 1.0:
        return _none_reached(candidates, time)
    return ValueError(
        f"accuracy {accuracy:g} is below what float64 reaches with {_scheme_text(candidates)} over the time {time:g}; "
        f"with rounding, {rounded_up(reachable)} is the least; ask for that, or for a shorter time"
    )


def _none_reached(candidates: Sequence[Candidate], time: float) -> ValueError:
    """Return the error for a motion in which rounding grows to its size."""
    return ValueError(
        f"no accuracy is reached in float64 with {_scheme_text(candidates)} over the time {time:g}: small changes "
        "of the initial state grow to the size of the motion; take a shorter time"
    )


def rounded_up(value: float) -> str:
    """Format a number with two digits, rounded up."""
    unit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return f"{math.ceil(value / unit) * unit:.1e}"


def _scheme_text(candidates: Sequence[Candidate]) -> str:
    return str(candidates[0].method) if len(candidates) == 1 else "any scheme"

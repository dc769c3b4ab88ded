"""Lyapunov exponents of motions and ensembles, from the tangent map."""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.analysis.standard_errors import error_of_rate
from coadjoint.kernels.tables.derivatives import Frame, stretch_logarithms
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.long_operations import long_operation, note_progress
from coadjoint.memory import check_available_memory
from coadjoint.methods.protocol.method import Method
from coadjoint.methods.registry import default_scheme, read_method
from coadjoint.runs.loops.loops import loops_of_members
from coadjoint.runs.plan_and_state import Plan
from coadjoint.runs.run import Run
from coadjoint.runs.start import Start, start_of
from coadjoint.runs.times import Times, times_between, times_of
from coadjoint.short_repr import short
from coadjoint.systems.batch import Batch
from coadjoint.systems.system import System
from coadjoint.systems.system_checks import check_system, check_vector_states
from coadjoint.validation import read_integer, read_number

POINTS = 200  # default number of saved times
MAX_STEPS = 2**53  # of a run
NEARLY_DEPENDENT = 2.0**-26  # as in the compiled loop: half of the digits are lost
_warned_types: set[type] = set()


@dataclass(frozen=True, eq=False, repr=False)
class LyapunovExponents:
    """The Lyapunov exponents of a run, or of each member, per unit of time; `lyapunov` computes them.

    Parameters
    ----------
    t : ndarray, shape (points + 1,)
        The end of the transient, and the saved times after it.
    stretches : ndarray, shape (points + 1, k) or (points + 1, members, k)
        Logarithm of the factor by which each vector was stretched since the transient.
    dim : int
        The dimension of the system.
    by : str
        How the tangent was computed: "compiled", or in Python by "formula", "complex step" or "differences".
    transient : float
        Time of the transient before ``t[0]``.
    step_error : ndarray, shape (k,) or (members, k)
        Error of the exponents due to the step, from a run with twice the step until the middle of the counted time and
        the order of the scheme; NaN if that run fails. That of a tolerance is not included.
    """

    t: NDArray[np.float64]
    stretches: NDArray[np.float64]
    dim: int
    by: str
    transient: float = 0.0
    step_error: Any = 0.0

    def __repr__(self) -> str:
        if self.exponents.ndim > 1:
            largest = np.max(self.exponents, axis=1)
            return (
                f"<Lyapunov exponents of {len(largest)} members until t = {self.t[-1]:g}: the largest of each from "
                f"{np.min(largest):.4g} to {np.max(largest):.4g}>"
            )
        pairs = zip(self.exponents, self.uncertainty, strict=True)
        values = ", ".join(f"{value:.4g} +- {spread:.1g}" for value, spread in pairs)
        return f"<Lyapunov exponents until t = {self.t[-1]:g}: {values}>"

    @property
    def exponents(self) -> NDArray[np.float64]:
        """The estimates over the whole time, shape (k,) or (members, k); in the limit the largest comes first."""
        return np.asarray(self.history[-1])

    @property
    def history(self) -> NDArray[np.float64]:
        """The estimates up to each time t[1:], shape (points, k) or (points, members, k)."""
        return np.asarray(self.stretches[1:] / self._elapsed[1:])

    @property
    def uncertainty(self) -> NDArray[np.float64]:
        """Standard error of the estimates for infinite time, in the shape of `exponents`.

        Of chaotic motion, the standard error of the mean of the correlated growth rates between the saved times. Of
        regular motion, the distance of the estimate from its limit, if it falls as log(t)/t, by a fit to the stretches,
        and the error of that limit; at least that of vectors that grow like t, if noise may hide such a fall. At least
        the change of the estimate within the last half of the time. The `step_error` is added as an independent one.
        NaN if fewer than two times are saved.
        """
        count = len(self.t) - 1
        if count < 2:
            return np.full_like(self.exponents, np.nan)
        stretches, elapsed = self.stretches.reshape(count + 1, -1), self._elapsed.ravel()
        errors = [error_of_rate(column, elapsed, self.transient) for column in stretches.T]
        return np.hypot(np.reshape(errors, self.exponents.shape), self.step_error)

    @property
    def sum(self) -> NDArray[np.float64]:
        """The sum of the exponents. With all n it is the growth rate of volumes, zero on a unimodular algebra."""
        return np.asarray(np.sum(self.exponents, axis=-1))

    @property
    def pairing(self) -> NDArray[np.float64]:
        """Deviation of the exponents from pairs +L and -L, and zeros: the largest ``|L_i + L_(n+1-i)|`` when sorted.

        Zero in the limit for bounded motion on coadjoint orbits: a step is symplectic there, and each Casimir
        contributes a zero exponent. NaN if not all exponents were computed.
        """
        ordered = np.sort(self.exponents, axis=-1)
        deviation = np.max(np.abs(ordered + ordered[..., ::-1]), axis=-1)
        return np.asarray(deviation if ordered.shape[-1] == self.dim else np.full_like(deviation, np.nan))

    @property
    def _elapsed(self) -> NDArray[np.float64]:
        return np.asarray(np.abs(self.t - self.t[0]).reshape(-1, *(1,) * (self.stretches.ndim - 1)))


@suggest_keywords
@long_operation("lyapunov")
def lyapunov(
    system: System | Batch,
    x0: Any,
    t_span: tuple[float, float],
    step: float,
    method: Method | str | Mapping[str, Any] | None = None,
    *,
    exponents: int | None = None,
    renormalize_every: int = 10,
    transient: float = 0.0,
    save_every: int | None = None,
    threads: int | None = None,
) -> LyapunovExponents:
    """Return the Lyapunov exponents of a motion, or of each member of an ensemble, from the exact tangent map.

    Tangent vectors are integrated with the state in the compiled loop of flow and Runge-Kutta methods and their
    compositions, and are orthonormalized periodically; the state has the same bits as in `integrate`. For other schemes
    `stepper(...).tangent` is called in Python for each step, with a single warning. A second run, with twice the step
    until the middle of the counted time, gives the error of the step.

    Parameters
    ----------
    system : LiePoissonSystem, PoissonSystem or Batch
        The system. Its Hamiltonian must have second derivatives, and a `PoissonSystem` the derivative of J.
    x0 : array_like, shape (n,) or (members, n)
        Initial momentum, as in `integrate`.
    t_span : (float, float)
        Start and end, a whole number of steps. Backward in time the exponents are those of the reversed motion.
    step : float
        Size of a step, positive.
    method : Method, optional
        The scheme; None is the default of `integrate`.
    exponents : int, optional
        Number of exponents, the largest first; None is all n.
    renormalize_every : int
        Number of steps between orthonormalizations of the vectors.
    transient : float
        Initial time that is not counted, a whole number of steps, during which the vectors align.
    save_every : int, optional
        Number of counted steps between saved estimates; the last one is saved too. None gives about 200 saved times.
    threads : int, optional
        Threads for the members of an ensemble; None is one for each core.

    Returns
    -------
    LyapunovExponents
        Per unit of time, with their history, uncertainty, sum and pairing.

    Raises
    ------
    ValueError, TypeError
        For wrong input or a missing derivative, before the first step.
    IntegrationError
        A member failed as in `integrate`, or vectors grew too fast to stay linearly independent; `partial` has the
        exponents of the other members.

    Notes
    -----
    Benettin, Galgani, Giorgilli and Strelcyn, Meccanica 15 (1980), 9 and 21. The initial vectors are generic and the
    same in every run; k vectors are the first k of n.

    Examples
    --------
    The unstable axis of a free rigid body, whose exponents are known:

    >>> import coadjoint as co
    >>> body = co.systems.rigid_body(inertia=(1, 2, 3))
    >>> result = co.lyapunov(body, (0.0, 1.0, 0.0), t_span=(0, 200), step=0.05, transient=50)
    >>> rate = ((1 / 1 - 1 / 2) * (1 / 2 - 1 / 3)) ** 0.5
    >>> bool(abs(result.exponents - [rate, 0.0, -rate]).max() < 1e-3)
    True
    """
    check_system(system)
    scheme = default_scheme(system) if method is None else read_method(method)
    if system.has_matrices:
        check_vector_states(system, "Lyapunov exponents are available for states that are vectors")
    count = system.dim if exponents is None else read_integer(exponents, "exponents (None is all)", 1, system.dim)
    every = min(read_integer(renormalize_every, "renormalize_every", floats=True), MAX_STEPS)
    workers = None if threads is None else read_integer(threads, "threads (None is all cores)", floats=True)
    start = start_of(system, scheme, x0, False)
    times = _with_saved_steps(times_of(t_span, step, 1), transient, save_every, len(start.momenta) * count)
    frame = Frame(frame_of(count, system.dim), every)
    workers = min(len(start.momenta), workers or os.cpu_count() or 1)
    logarithms, by, run = stretching(system, scheme, times, start, frame, workers)
    stretches = logarithms - logarithms[0]
    if start.single:
        stretches = stretches[:, 0]
    half = Frame(frame.vectors, max(1, every // 2))
    errors = _errors_of_step(system, scheme, times, start, half, workers, logarithms)
    errors = errors[0] if start.single else errors
    skipped = abs(times.h) * float(times.saved[0])
    result = LyapunovExponents(times.at(times.saved), stretches, system.dim, by, skipped, errors)
    if run.failed_count:
        raise run.failure(result)
    if not np.all(np.isfinite(result.exponents)):
        raise ValueError(
            "the tangent vectors at the end of the run could no longer be distinguished; give a smaller "
            f"renormalize_every than {every}, or a smaller step"
        )
    return result


def _errors_of_step(
    system: System | Batch,
    method: Method,
    times: Times,
    start: Start,
    frame: Frame,
    workers: int,
    logarithms: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the errors of the exponents of each member by the step, from a run with twice the step, (members, k)."""
    saved = times.saved  # half of the time suffices: the error does not depend on it
    k = (len(saved) + 1) // 2
    k -= int(k > 1 and (saved[k] - saved[0]) % 2)
    first, last = int(saved[0]) // 2, int(saved[k]) // 2
    if first == last:
        return np.full(logarithms.shape[1:], np.nan)
    coarse = Times(times.t0, 2.0 * times.h, last, 1).with_saved_steps([first, last])
    (before, after), _, _ = stretching(system, method, coarse, start, frame, workers)
    rates = (after - before) / (2.0 * abs(times.h) * (last - first))
    finer = (logarithms[k] - logarithms[0]) / (abs(times.h) * (saved[k] - saved[0]))
    return np.asarray(np.abs(rates - finer) / (2.0**method.order - 1.0))


def _with_saved_steps(times: Times, transient: Any, save_every: Any, numbers_each: int) -> Times:
    """Return times that are saved at the end of the transient, and every few steps after it."""
    duration = read_number(transient, "transient")
    if duration < 0.0:
        raise ValueError(f"transient is {duration!r}; it must not be negative")
    first = times_between((0.0, duration), abs(times.h), 1).steps if duration else 0
    counted = times.steps - first
    if counted < 1:
        span = times.steps * abs(times.h)
        raise ValueError(f"transient is {duration!r} and the run lasts {span!r}; it must be shorter than the run")
    if save_every is None:
        every = max(1, counted // POINTS)
    else:
        every = read_integer(save_every, "save_every", floats=True)
    points = -(-counted // every) + 1
    check_available_memory(
        8 * 2 * points * (numbers_each + 2), f"the history of {short(points)} times", "give a larger save_every"
    )
    numbers = np.arange(first, times.steps, min(every, counted))
    return times.with_saved_steps(np.append(numbers, times.steps))


def frame_of(count: int, size: int) -> NDArray[np.float64]:
    """Return generic orthonormal vectors (count, size), the same on every machine."""
    # The finalizer of splitmix64, applied to a counter.
    with np.errstate(over="ignore"):
        mixed = np.arange(1, count * size + 1, dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15)
        for shift, factor in ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB), (31, 1)):
            mixed = (mixed ^ (mixed >> np.uint64(shift))) * np.uint64(factor)
    vectors = ((mixed >> np.uint64(11)).astype(np.float64) * 2.0**-53 - 0.5).reshape(count, size).T.copy()
    for _ in range(2):  # the second pass restores digits lost in the first
        if make_orthonormal(vectors) is None:
            raise AssertionError("the mixed bits are not independent")
    return np.ascontiguousarray(vectors.T)


def stretching(
    system: System | Batch, method: Method, times: Times, start: Start, frame: Frame, workers: int
) -> tuple[NDArray[np.float64], str, Run]:
    """Carry the orthonormal tangent vectors of `frame` along a run of every member.

    Return log stretching factors since the start (points, members, k), NaN after a failure, how tangents were computed,
    and the run.
    """
    systems = tuple(system) if system.is_batch else (system,)
    prepared = []
    for m, member in enumerate(systems):
        try:
            method.properties(member)
            prepared.append(method.tangent_loop(member, times.h, frame))
        except (TypeError, ValueError) as error:
            if not system.is_batch:
                raise
            raise type(error)(f"member {m} of the batch: {error}") from error
    compiled = [loop for loop in prepared if loop is not None]
    if len(compiled) < len(systems):
        return _step_by_step(system, systems, method, times, start, frame)
    loops = loops_of_members(systems, compiled)
    run = Run(Plan(system, method, loops, times, start.groups.shape, workers=workers), start)
    logarithms = np.full((times.points, len(start.momenta), len(frame.vectors)), np.nan)
    for point, number in enumerate(times.saved.tolist()):
        if number == 0:
            logarithms[point] = 0.0
            continue
        run.advance(until=number)
        note_progress(f"step {number} of {times.steps}", number / times.steps)
        running = run.state["status"] == 0
        logarithms[point, running] = stretch_logarithms(run.state["memory"][running], len(frame.vectors))
    return logarithms, "compiled", run


def _step_by_step(
    system: System | Batch, systems: Sequence[System], method: Method, times: Times, start: Start, frame: Frame
) -> tuple[NDArray[np.float64], str, Run]:
    """Take the steps in the loop of the scheme, then evaluate their tangents in Python."""
    _warn_once(type(method))
    every_step = times.with_saved_steps(np.arange(times.steps + 1))
    loops = loops_of_members(systems, [method.loop(member, times.h, None) for member in systems])
    run = Run(Plan(system, method, loops, every_step, start.groups.shape), start)
    run.advance()
    ends = np.where(run.state["status"] == 0, times.steps, run.state["step"] - 1)
    logarithms = np.full((times.points, len(start.momenta), len(frame.vectors)), np.nan)
    for m in range(len(start.momenta)):
        member = system.of_member(m)
        states = run.saved["x"][: int(ends[m]) + 1, m]
        failed = _follow(member, method, times, states, frame, logarithms[:, m])
        if failed:
            run.mark_failed(m, failed, "PARALLEL")
    by = method.tangent_by(systems[0], start.momenta[0], times.t0, times.h)
    return logarithms, by, run


def _follow(
    system: System, method: Method, times: Times, states: NDArray[Any], frame: Frame, logarithms: NDArray[np.float64]
) -> int:
    """Fill in the logarithms of one member; return the step after which vectors are dependent, or 0."""
    total, remainder = np.zeros(len(frame.vectors)), np.zeros(len(frame.vectors))
    vectors = frame.vectors.T.copy()
    saved = {number: point for point, number in enumerate(times.saved.tolist())}
    for k in range(len(states)):
        note_progress(f"step {k} of {len(states)}", k / len(states))
        if k:
            before = float(times.t0 + (k - 1) * times.h)
            vectors = method.tangent(system, states[k - 1], before, times.h)[1] @ vectors
        if k and k % frame.every == 0:
            lengths = make_orthonormal(vectors)
            if lengths is None:
                return k
            increment = np.log(lengths) + remainder
            remainder = increment - ((total + increment) - total)
            total = total + increment
        if k in saved:
            lengths = make_orthonormal(vectors.copy())
            logarithms[saved[k]] = np.nan if lengths is None else total + (remainder + np.log(lengths))
    return 0


def make_orthonormal(vectors: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Orthonormalize columns in place by modified Gram-Schmidt; return their lengths, None if they are dependent."""
    # cumsum adds in the order of the indices on every machine.
    lengths = np.sqrt(np.cumsum(vectors**2, axis=0)[-1])
    for r in range(vectors.shape[1]):
        vector = vectors[:, r]
        length = np.sqrt(np.cumsum(vector**2)[-1])
        if not (length > NEARLY_DEPENDENT * lengths[r] and np.isfinite(length)):
            return None
        lengths[r] = length
        vector /= length
        later = vectors[:, r + 1 :]
        later -= vector[:, None] * np.cumsum(vector[:, None] * later, axis=0)[-1]
    return np.asarray(lengths)


def _warn_once(scheme: type) -> None:
    if scheme in _warned_types:
        return
    _warned_types.add(scheme)
    warnings.warn(
        f"the tangents of {scheme.__name__} are computed in Python, about a hundred times slower than those of flow "
        "and Runge-Kutta methods, which are compiled",
        RuntimeWarning,
        stacklevel=2,
    )

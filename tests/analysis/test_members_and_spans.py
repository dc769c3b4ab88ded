"""Functions of runs: member by member, at any start time, backward, and on grids of saved times with an odd origin.

Free bodies have a symmetry that makes every answer known: x(t) is a motion if and only if -x(-t) is one, and a step by
-h from x is minus the step by h from -x, to the bit.
"""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pytest

import coadjoint as co
import coadjoint.analysis
from coadjoint.analysis.backward_error.modified_hamiltonian import modified_hamiltonian
from coadjoint.analysis.end_error import error_at_end
from coadjoint.analysis.line_drift import line_drift
from coadjoint.analysis.phase_drift import PhaseDrift
from coadjoint.analysis.round_off import RandomWalk, orthogonality, round_off, spatial_momentum
from coadjoint.analysis.signals import sampled
from coadjoint.runs.results.run_record import SOLUTION_FIELDS

INERTIAS = ((1.0, 2.0, 3.0), (1.0, 2.0, 2.5), (1.5, 2.0, 3.2))
STARTS = np.array([[1.0, 0.2, 0.5], [0.4, 0.1, 1.1], [1.3, -0.3, 0.2]])
T0, STEP, STEPS, EVERY = 7.3, 0.125, 1199, 3
"""The last saved point is off the grid of the others."""


@cache
def bodies() -> tuple[Any, ...]:
    return tuple(co.systems.rigid_body(inertia) for inertia in INERTIAS)


class Made(NamedTuple):
    """How a run is made: who moves, from where and when, and whether backward."""

    members: tuple[int, ...] = (0, 1, 2)
    single: bool = False
    t0: float = 0.0
    sense: float = 1.0
    attitude: bool | str = True
    scheme: str = "Splitting"


@cache
def run(made: Made) -> co.Solution:
    """Return a run; of one backward the start is taken with the other sign."""
    x0 = STARTS[list(made.members)] * made.sense
    systems = [bodies()[m] for m in made.members]
    system, x0 = (systems[0], x0[0]) if made.single else (co.batch(systems), x0)
    span = (made.t0, made.t0 + made.sense * STEPS * STEP)
    method = co.Splitting(order=1) if made.scheme == "first order" else co.Splitting()
    if made.scheme == "accuracy":  # of one system; of a batch it is refused
        return co.integrate(bodies()[0], x0, (made.t0, made.t0 + made.sense * 30.0), accuracy=1e-5)
    attitude = made.attitude
    return co.integrate(system, x0, span, STEP, method, save_every=EVERY, attitude=attitude, observe={"x3": third})


def third(x: Any) -> Any:
    return x[..., 2]


class Entry(NamedTuple):
    """A function of a run, and how a run is made for it.

    Parameters
    ----------
    call : callable
        The function.
    made : dict
        Options of `Made`.
    alone : bool
        Whether it takes one trajectory; others are for ensembles, and are compared by batches of one system.
    """

    call: Callable[[Any], Any]
    made: dict[str, Any] = {}  # noqa: RUF012
    alone: bool = True


TABLE: dict[str, dict[str, Entry]] = {
    "phase_drift.phase_drift": {
        "momentum": Entry(co.phase_drift),
        "attitude": Entry(lambda sol: co.phase_drift(sol, of="attitude")),
        "by a reference": Entry(lambda sol: co.phase_drift(sol, reference_of(sol)), {"attitude": False}),
        "attitude by a reference": Entry(lambda sol: co.phase_drift(sol, reference_of(sol, True), of="attitude")),
    },
    "line_drift.line_drift": {
        "first": Entry(lambda sol: line_drift(sol, 0.5, signal=third, width=100.0), {"attitude": False}),
    },
    "frequencies.frequencies": {
        "momentum": Entry(lambda sol: co.frequencies(sol, count=3)),
        "component": Entry(lambda sol: co.frequencies(sol, 1, count=2)),
        "attitude": Entry(lambda sol: co.frequencies(sol, "attitude", count=3)),
        "observed": Entry(lambda sol: co.frequencies(sol, "x3", count=2)),
        "function": Entry(lambda sol: co.frequencies(sol, third, count=2)),
    },
    "signals.sampled": {"momentum": Entry(sampled)},
    "end_error.error_at_end": {"at the end": Entry(lambda sol: error_at_end(sol)[0], {"scheme": "accuracy"})},
    "round_off.round_off": {"invariants": Entry(round_off, alone=False)},
    "round_off.orthogonality": {"attitude": Entry(orthogonality, alone=False)},
    "round_off.spatial_momentum": {"momentum": Entry(spatial_momentum, {"attitude": "coadjoint"}, alone=False)},
    "lyapunov.lyapunov": {"of the bodies": Entry(lambda sol: exponents_of(sol), {"attitude": False})},
}
ENTRIES = [(name, kind) for name, kinds in TABLE.items() for kind in kinds]
each_entry = pytest.mark.parametrize(("name", "kind"), ENTRIES, ids=[f"{name}-{kind}" for name, kind in ENTRIES])
# Functions with a span or a solution that is no run of a system, or none of the above.
ELSEWHERE: dict[str, str] = {
    "fit.fit": "tests/analysis/test_fit.py",
    "structure_factor.structure_factor": "tests/analysis/test_structure_factor.py",
    "autocorrelation.autocorrelation": "tests/analysis/test_autocorrelation.py, where members share one mean",
}


def reference_of(sol: co.Solution, attitude: bool = False) -> co.Solution:
    """Return the same run by a scheme of order 8."""
    whole = co.GaussLegendre(4) if not attitude else co.Splitting(order=8)
    given = {"save_every": EVERY, "attitude": True} if attitude else {}
    return co.integrate(sol.system, sol.x0, sol.asked_span, STEP, whole, **given)


def exponents_of(sol: co.Solution) -> Any:
    t0, t1 = sol.asked_span
    span = (t0, t0 + np.copysign(200 * STEP, t1 - t0))
    return co.lyapunov(sol.system, sol.x0, span, STEP, transient=10 * STEP, save_every=7)


def public_functions() -> dict[str, Any]:
    found = {}
    for info in pkgutil.iter_modules(coadjoint.analysis.__path__):
        module = importlib.import_module(f"coadjoint.analysis.{info.name}")
        for name, value in vars(module).items():
            if inspect.isfunction(value) and value.__module__ == module.__name__ and not name.startswith("_"):
                found[f"{info.name}.{name}"] = value
    return found


def test_every_function_of_a_run_is_in_the_table():
    takes = set()
    for name, function in public_functions().items():
        parameters = inspect.signature(function).parameters
        if any(p in parameters for p in ("solution", "run", "t_span", "given")):
            takes.add(name)
    assert takes == TABLE.keys() | ELSEWHERE.keys()


def close(found: Any, wanted: Any, rtol: float, where: str = "") -> None:
    """Compare results of any kind, field by field."""
    if is_dataclass(wanted) and not isinstance(wanted, type):
        derived = [name for name, value in vars(type(wanted)).items() if isinstance(value, property)]
        names = [field.name for field in fields(wanted)] + [name for name in derived if not name.startswith("_")]
        for name in names:
            close(getattr(found, name), getattr(wanted, name), rtol, f"{where}.{name}")
    elif hasattr(wanted, "_fields"):
        for name in wanted._fields:
            close(getattr(found, name), getattr(wanted, name), rtol, f"{where}.{name}")
    elif isinstance(wanted, dict):
        assert list(found) == list(wanted), where
        for name in wanted:
            close(found[name], wanted[name], rtol, f"{where}[{name}]")
    elif isinstance(wanted, str | bool | type(None)):
        assert found == wanted, where
    else:
        assert np.shape(found) == np.shape(wanted), where
        size = np.nanmax(np.abs(wanted), initial=0.0)
        np.testing.assert_allclose(found, wanted, rtol=0, atol=rtol * size, err_msg=where)


def member_of(result: Any, m: int) -> Any:
    """Return the result of one member of an ensemble."""
    if isinstance(result, list):
        return result[m]
    if isinstance(result, co.Frequencies):
        picked = {f.name: getattr(result, f.name) for f in fields(result)}
        return replace(result, **{n: v if n == "_real" else v[m] for n, v in picked.items()})
    if isinstance(result, co.LyapunovExponents):
        return replace(result, stretches=result.stretches[:, m])
    if hasattr(result, "channels"):
        return result._replace(values=result.values[m : m + 1], members=False)
    return np.asarray(result)[m : m + 1]


@pytest.mark.thinned(1)
@each_entry
def test_an_ensemble_is_its_members(name, kind):
    """To the bit, since the runs are."""
    entry = TABLE[name][kind]
    whole = entry.call(run(Made(t0=T0, **entry.made)))
    each = [entry.call(run(Made((m,), single=entry.alone, t0=T0, **entry.made))) for m in range(3)]
    if entry.alone:
        for m, alone in enumerate(each):
            if name == "end_error.error_at_end":
                # The ensemble has one step for all: its members alone are compared with the truth of that step.
                ends = run(Made(t0=T0, **entry.made))
                exact = bodies()[0].exact(STARTS[m], 30.0)
                error = np.linalg.norm(ends.x[-1, m] - exact) / np.linalg.norm(STARTS[m])
                assert 0.9 * error < whole[m] < 1.1 * error
                continue
            # Lines are found by products and least squares of BLAS and LAPACK, which no bit is promised of.
            rounded = name.startswith(("frequencies", "line"))
            found, wanted = member_of(whole, m), alone
            found, wanted = (skipped(found), skipped(wanted)) if rounded else (found, wanted)
            close(found, wanted, 1e-9 if rounded else 0.0, f"member {m}")
        return
    for key in [None] if isinstance(whole, RandomWalk) else list(whole):
        one, parts = (whole, each) if key is None else (whole[key], [walk[key] for walk in each])
        assert one.early == pytest.approx(np.sqrt(np.mean([part.early**2 for part in parts])), rel=1e-12)
        assert one.late == pytest.approx(np.sqrt(np.mean([part.late**2 for part in parts])), rel=1e-12)
        assert one.worst == max(part.worst for part in parts)


def at_another_time(result: Any, t0: float) -> Any:
    """Return a result with its times moved by t0."""
    if isinstance(result, PhaseDrift):
        return replace(result, t=result.t + t0, intercept=result.intercept - result.slope * t0)
    if isinstance(result, co.Frequencies):
        turned = np.exp(-1j * result.frequency * t0)
        a = result.amplitude * (turned if result.amplitude.ndim == 1 else turned[:, None])
        return replace(result, amplitude=a)
    if isinstance(result, co.LyapunovExponents) or hasattr(result, "channels"):
        return replace(result, t=result.t + t0) if is_dataclass(result) else result._replace(t=result.t + t0)
    return result


def skipped(found: Any) -> Any:
    """Return a result without what is the size of round-off: it differs where times are rounded in another way."""
    if isinstance(found, PhaseDrift):
        return replace(found, uncertainty=0.0, exponent=0.0)
    if isinstance(found, co.Frequencies):
        nothing = np.zeros_like(found.uncertainty)
        # Signals are of size one, and a mean of zero is zero to the rounding of that.
        return replace(found, uncertainty=nothing, diffusion=nothing, residual=0.0, mean=found.mean + 1.0)
    return found


@pytest.mark.thinned(1)
@each_entry
def test_a_start_at_another_time_changes_labels_alone(name, kind):
    entry = TABLE[name][kind]
    there, here = (entry.call(run(Made((1,), entry.alone, t0=t0, **entry.made))) for t0 in (T0, 0.0))
    # Times are rounded to 2^-53 of 160; an error of 1e-7 is the difference of states of size one.
    close(skipped(there), skipped(at_another_time(here, T0)), 1e-6 if name.endswith("error_at_end") else 1e-8)


def mirrored(result: Any) -> Any:
    """Return a result of -x(-t), from that of x(t)."""
    if isinstance(result, PhaseDrift):
        return replace(result, t=-result.t, lead=-result.lead, intercept=-result.intercept)
    if isinstance(result, co.Frequencies):
        return replace(result, amplitude=-result.amplitude.conj(), mean=-result.mean)
    if isinstance(result, co.LyapunovExponents):
        return replace(result, t=-result.t)
    if hasattr(result, "channels"):
        return result._replace(t=-result.t, values=-result.values)
    return result


@pytest.mark.thinned(1)
@each_entry
def test_a_backward_run_is_the_mirror_image(name, kind):
    entry = TABLE[name][kind]
    back, forth = (entry.call(run(Made((2,), entry.alone, sense=sense, **entry.made))) for sense in (-1.0, 1.0))
    wanted = mirrored(forth)
    if name == "frequencies.frequencies" and kind == "attitude":
        # The attitude is that of the forward run itself.
        wanted = replace(forth, amplitude=forth.amplitude.conj())
    if name == "round_off.spatial_momentum":
        wanted = replace(forth, bias=-forth.bias)
    # Deviations of a line that is known to 1e-7 are known to so much less.
    close(skipped(back), skipped(wanted), 1e-5 if name == "line_drift.line_drift" else 1e-8)
    if isinstance(back, co.LyapunovExponents):
        close(back.exponents, forth.exponents, 1e-8)
        close(back.uncertainty, forth.uncertainty, 1e-8)
    if isinstance(back, co.Frequencies):
        strong = np.abs(forth.diffusion) > 1e-3 * np.abs(forth.diffusion).max()
        np.testing.assert_allclose(back.diffusion[strong], forth.diffusion[strong], rtol=1e-2)
        np.testing.assert_allclose(back.uncertainty, forth.uncertainty, rtol=1e-2, atol=1e-14)


@pytest.mark.parametrize("t0", [0.0, T0])
def test_lines_are_those_of_the_arrays_and_rebuild_the_signal(t0):
    """On a grid of times that begins after the start of the run, whose last point is off the grid or not."""
    span = (t0, t0 + STEPS * STEP)
    grids = [{"save_every": EVERY}, {"t_eval": t0 + 3.1 + 0.37 * np.arange(380)}]
    for grid in grids:
        sol = co.integrate(bodies()[0], STARTS[0], span, STEP, **grid)
        even = len(sol.t) - (not np.isclose(sol.t[-1] - sol.t[-2], sol.t[1] - sol.t[0]))
        found, plain = co.frequencies(sol, count=4), co.frequencies(sol.t[:even], sol.x[:even], count=4)
        close(found, plain, 0.0)
        inner = slice(len(sol.t) // 4, 3 * len(sol.t) // 4)
        rest = np.abs(found(sol.t[inner]) - sol.x[inner]).max()
        assert rest < 0.02 * np.abs(sol.x).max(), "the sum of the lines is the signal at its own times"


@pytest.mark.parametrize("t0", [0.0, T0])
def test_leads_on_any_grid_are_those_on_the_steps(t0):
    span = (t0, t0 + STEPS * STEP)
    fine = co.integrate(bodies()[1], STARTS[1], span, STEP)
    some = co.integrate(bodies()[1], STARTS[1], span, STEP, t_eval=fine.t[35::11])

    def right(t: Any) -> Any:
        return bodies()[1].exact(STARTS[1], t - t0)

    one, other = (co.phase_drift(sol, right) for sol in (fine, some))
    assert np.array_equal(other.t, one.t[35::11])
    # Leads are iterated until they change by less than 2^-40 of the time.
    np.testing.assert_allclose(other.lead, one.lead[35::11], rtol=0, atol=2.0**-38 * 160.0)
    # Without a reference the start of the run is right, also if it is not saved.
    for sol, wanted in ((fine, one), (some, other)):
        close(co.phase_drift(sol), wanted, 1e-9)


@pytest.mark.parametrize("sense", [1.0, -1.0])
@pytest.mark.parametrize("scheme", ["Splitting", "first order"])
def test_modified_energies_of_a_batch_are_those_of_the_members(scheme, sense):
    made = {"scheme": scheme, "sense": sense, "t0": T0, "attitude": False}
    batch = run(Made(**made))
    found = batch.modified_energy(6)
    for m in range(3):
        alone = run(Made((m,), True, **made))
        np.testing.assert_array_equal(found[:, m], alone.modified_energy(6))
        H = modified_hamiltonian(bodies()[m], alone.method, 6)
        np.testing.assert_array_equal(found[:, m], H(alone.x, sense * STEP))
        # By the sixth power of the step the modified energy stays; the other sign of the step is seen.
        wander = np.ptp(found[:, m])
        assert wander < 0.05 * np.ptp(alone.energy)


def test_a_suggested_step_for_a_sample_is_the_least_of_its_states():
    body = bodies()[0]
    each = [co.suggest_step(body, co.Splitting(), x, 1e-5) for x in STARTS]
    assert co.suggest_step(body, co.Splitting(), STARTS, 1e-5) == min(each) < max(each)


# Attributes of a solution: the axis of members, or None for what belongs to the run as a whole.
AXES: dict[str, int | None] = {
    "x": 1, "x0": 0, "energy": 1, "casimirs": 1, "attitude": 1, "attitude0": 0, "observed": 1, "work": 1, "initial": 0,
    "failed": 0, "drift": 0, "balance": 0, "change": 0, "modified_energy": 1, "at": 1, "t": None, "t_eval": None,
    "t_span": None, "asked_span": None, "step": None, "save_every": None, "carried": None, "method": None,
    "watched": None, "incomplete": None,
}  # fmt: skip
OTHERS = {
    "system": "tests/runs/test_batch.py",
    "stats": "the sum over members, below",
    "events": "tests/runs/test_events.py",
    "choice": "test_error_at_end.py",
    "error_estimate": "test_error_at_end.py",
    "step_error": "tests/runs/test_step_error.py",
    "rotation": "tests/runs/test_conversions.py",
    "to_pandas": "tests/runs/test_conversions.py",
    "spectrum": "test_spectra_of_members_are_theirs",
    "to_xarray": "tests/files/test_members_read_back.py",
    "plot": "tests/public/pictures/test_pictures_over_time.py",
    "movie": "tests/public/pictures/test_pictures_over_time.py",
}


def value_of(sol: co.Solution, name: str) -> Any:
    found = getattr(sol, name)
    if name == "modified_energy":
        return found(4)
    if name == "at":
        state = found([T0 + 1.03, T0 + 40.0])
        return {key: value for key, value in state._asdict().items() if key != "t"}
    return found() if callable(found) else found


def picked(value: Any, axis: int, m: int) -> Any:
    if isinstance(value, co.runs.results.solution.Drift):
        return value.members[m], value.tenths[m], value.initial[m]
    if hasattr(value, "items"):
        return {key: picked(each, axis, m) for key, each in value.items()}
    return None if value is None else np.take(value, m, axis=axis)


def plain(value: Any) -> Any:
    if isinstance(value, co.runs.results.solution.Drift):
        return float(value), value.tenths, value.initial
    return {key: plain(each) for key, each in value.items()} if hasattr(value, "items") else value


def test_every_part_of_a_solution_is_in_the_table():
    public = {name for name in dir(co.Solution) if not name.startswith("_")}
    sol = co.integrate(bodies()[0], (1.0, 0.2, 0.1), (0.0, 1.0), 0.1)
    fields = {name for name in SOLUTION_FIELDS if name in sol.record}
    assert public | fields == AXES.keys() | OTHERS.keys()


@pytest.mark.parametrize("forced", [False, True])
def test_every_part_of_a_batch_is_that_of_its_members(forced):
    systems = [body.with_forces(co.forces.LinearDamping(0.01 * (m + 1))) for m, body in enumerate(bodies())]
    systems = systems if forced else list(bodies())
    given = {"save_every": 5, "attitude": True, "observe": {"x3": third}}
    whole = co.integrate(co.batch(systems), STARTS, (T0, T0 + 50.0), STEP, **given)
    steps = 0
    for m, system in enumerate(systems):
        alone = co.integrate(system, STARTS[m], (T0, T0 + 50.0), STEP, **given)
        steps += alone.stats.evaluations
        prepared = co.prepare(system, co.Splitting(), STEP, attitude=True, observe={"x3": third})
        again = prepared.run(STARTS[m], (T0, T0 + 50.0), save_every=5)
        for name, axis in AXES.items():
            if forced and name in ("drift", "modified_energy"):
                continue
            wanted = plain(value_of(alone, name))
            np.testing.assert_equal(plain(value_of(again, name)), wanted, err_msg=f"{name} of a prepared run")
            if name != "failed":
                found = value_of(whole, name) if axis is None else picked(value_of(whole, name), axis, m)
                np.testing.assert_equal(found, wanted, err_msg=f"{name} of member {m}")
    assert whole.stats.evaluations == steps


def test_spectra_of_members_are_theirs():
    rng, N = np.random.default_rng(4), 4
    system = co.MatrixSystem(co.MatrixAlgebra("gl", N), np.transpose)
    W = rng.normal(size=(3, N, N))
    batch = co.integrate(system, W, (T0, T0 + 0.5), 0.0625)
    for m in range(3):
        alone = co.integrate(system, W[m], (T0, T0 + 0.5), 0.0625)
        np.testing.assert_array_equal(batch.spectrum()[:, m], alone.spectrum())
        for k, state in enumerate(alone.x):
            np.testing.assert_allclose(np.poly(alone.spectrum()[k]), np.poly(state), rtol=0, atol=1e-11)

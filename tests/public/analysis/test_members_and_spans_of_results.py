"""Functions of runs: member by member, at any start time, and backward.

Free bodies have a symmetry that makes every answer known: x(t) is a motion if and only if -x(-t) is one, and a step by
-h from x is minus the step by h from -x, to the bit.
"""

from dataclasses import fields, is_dataclass, replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import coadjoint as co

STARTS = np.array([[1.0, 0.2, 0.5], [0.4, 0.1, 1.1], [1.3, -0.3, 0.2]])
ATTITUDES = Rotation.from_rotvec(STARTS).as_matrix()
T0, STEP, STEPS, EVERY = 7.3, 0.125, 1199, 3
"""The last saved point is off the grid of the others."""
INERTIAS = ((1.0, 2.0, 3.0), (1.0, 2.0, 2.5), (1.5, 2.0, 3.2))
BODIES = [co.systems.rigid_body(inertia) for inertia in INERTIAS]


@cache
def run(members=(0, 1, 2), single=False, t0=0.0, sense=1.0, attitude=True, scheme="Splitting"):
    """Return a run; of one backward the start is taken with the other sign."""
    x0 = STARTS[list(members)] * sense
    systems = [BODIES[m] for m in members]
    system, x0 = (systems[0], x0[0]) if single else (co.batch(systems), x0)
    span = (t0, t0 + sense * STEPS * STEP)
    method = co.Splitting(order=1) if scheme == "first order" else co.Splitting()
    if attitude is True:
        attitude = ATTITUDES[members[0] if single else list(members)]
    if scheme == "accuracy":  # of one system; of a batch it is refused
        return co.integrate(BODIES[0], x0, (t0, t0 + sense * 30.0), accuracy=1e-5)
    return co.integrate(system, x0, span, STEP, method, save_every=EVERY, attitude=attitude, observe={"x3": third})


def third(x):
    return x[..., 2]


def reference_of(sol, attitude=False):
    """Return the same run by a scheme of order 8."""
    whole = co.Splitting(order=8) if attitude else co.GaussLegendre(4)
    given = {"save_every": EVERY, "attitude": sol.attitude0} if attitude else {}
    return co.integrate(sol.system, sol.x0, sol.asked_span, STEP, whole, **given)


def exponents_of(sol):
    t0, t1 = sol.asked_span
    span = (t0, t0 + np.copysign(200 * STEP, t1 - t0))
    return co.lyapunov(sol.system, sol.x0, span, STEP, transient=10 * STEP, save_every=7)


analysis, moving = co.analysis, {"attitude": False}
TABLE = {
    "phase drift": (co.phase_drift, {}),
    "phase drift of the attitude": (lambda sol: co.phase_drift(sol, of="attitude"), {}),
    "phase drift by a reference": (lambda sol: co.phase_drift(sol, reference_of(sol)), moving),
    "attitude by a reference": (lambda sol: co.phase_drift(sol, reference_of(sol, True), of="attitude"), {}),
    "line drift": (lambda sol: analysis.line_drift(sol, 0.5, signal=third, width=100.0), moving),
    "frequencies": (lambda sol: co.frequencies(sol, count=3), {}),
    "frequencies of a component": (lambda sol: co.frequencies(sol, 1, count=2), {}),
    "frequencies of the attitude": (lambda sol: co.frequencies(sol, "attitude", count=3), {}),
    "frequencies of an observable": (lambda sol: co.frequencies(sol, "x3", count=2), {}),
    "frequencies of a function": (lambda sol: co.frequencies(sol, third, count=2), {}),
    "error at the end": (lambda sol: sol.error_estimate(), {"scheme": "accuracy"}),
    "exponents": (exponents_of, moving),
    # Of ensembles alone, compared by batches of one system.
    "round-off": (analysis.round_off, {}),
    "orthogonality": (analysis.orthogonality, {}),
    "spatial momentum": (analysis.spatial_momentum, {"attitude": "coadjoint"}),
}
"""A function of a run, and how the run is made for it."""
STATISTICS = ("round-off", "orthogonality", "spatial momentum")
each_entry = pytest.mark.parametrize("name", TABLE)


def close(found, wanted, rtol, where=""):
    """Compare results of any kind, field by field."""
    if is_dataclass(wanted) and not isinstance(wanted, type):
        derived = [name for name, value in vars(type(wanted)).items() if isinstance(value, property)]
        names = [field.name for field in fields(wanted)] + [name for name in derived if not name.startswith("_")]
        for name in names:
            close(getattr(found, name), getattr(wanted, name), rtol, f"{where}.{name}")
    elif isinstance(wanted, tuple):
        for number, (one, other) in enumerate(zip(found, wanted, strict=True)):
            close(one, other, rtol, f"{where}[{number}]")
    elif isinstance(wanted, dict):
        assert list(found) == list(wanted), where
        for name in wanted:
            close(found[name], wanted[name], rtol, f"{where}[{name}]")
    elif isinstance(wanted, str | bool | type(None)):
        assert found == wanted, where
    else:
        assert np.shape(found) == np.shape(wanted), where
        size = np.max(np.nan_to_num(np.abs(wanted)), initial=0.0)
        np.testing.assert_allclose(found, wanted, rtol=0, atol=rtol * size, err_msg=where)


def member_of(result, m):
    """Return the result of one member of an ensemble."""
    if isinstance(result, list):
        return result[m]
    if isinstance(result, co.Frequencies):
        picked = {f.name: getattr(result, f.name) for f in fields(result)}
        return replace(result, **{n: v if n == "_real" else v[m] for n, v in picked.items()})
    if isinstance(result, co.LyapunovExponents):
        return replace(result, stretches=result.stretches[:, m], step_error=result.step_error[m])
    return np.asarray(result)[m : m + 1]


@pytest.mark.thinned(2)
@each_entry
def test_an_ensemble_is_its_members(name):
    """To the bit, since the runs are."""
    call, made = TABLE[name]
    whole = call(run(t0=T0, **made))
    each = [call(run((m,), name not in STATISTICS, t0=T0, **made)) for m in range(3)]
    if name == "error at the end":
        # The ensemble has one step for all: its members alone are compared with the truth of that step.
        for m, x in enumerate(run(t0=T0, **made).x[-1]):
            error = np.linalg.norm(x - BODIES[0].exact(STARTS[m], 30.0)) / np.linalg.norm(STARTS[m])
            assert 0.9 * error < whole[m] < 1.1 * error
    elif name in STATISTICS:
        for key in whole if name == "round-off" else [None]:
            one, parts = (whole, each) if key is None else (whole[key], [walk[key] for walk in each])
            assert one.early == pytest.approx(np.sqrt(np.mean([part.early**2 for part in parts])), rel=1e-12)
            assert one.late == pytest.approx(np.sqrt(np.mean([part.late**2 for part in parts])), rel=1e-12)
            assert one.worst == max(part.worst for part in parts)
    else:
        for m, wanted in enumerate(each):
            found = member_of(whole, m)
            # Lines are found by products and least squares of BLAS and LAPACK, which no bit is promised of.
            rounded = name.startswith(("frequencies", "line"))
            found, wanted = (skipped(found), skipped(wanted)) if rounded else (found, wanted)
            close(found, wanted, 1e-9 if rounded else 0.0, f"member {m}")


def at_another_time(result, t0):
    """Return a result with its times moved by t0."""
    if isinstance(result, co.PhaseDrift):
        return replace(result, t=result.t + t0, intercept=result.intercept - result.slope * t0)
    if isinstance(result, co.Frequencies):
        turned = np.exp(-1j * result.frequency * t0)
        a = result.amplitude * (turned if result.amplitude.ndim == 1 else turned[:, None])
        return replace(result, amplitude=a)
    if isinstance(result, co.LyapunovExponents):
        return replace(result, t=result.t + t0)
    return result


def skipped(found):
    """Return a result without what is the size of round-off: it differs where times are rounded in another way."""
    if isinstance(found, co.PhaseDrift):
        return replace(found, uncertainty=0.0, exponent=0.0)
    if isinstance(found, co.Frequencies):
        nothing = np.zeros_like(found.uncertainty)
        # Signals are of size one, and a mean of zero is zero to the rounding of that.
        return replace(found, uncertainty=nothing, diffusion=nothing, residual=0.0, mean=found.mean + 1.0)
    return found


@pytest.mark.thinned(1)
@pytest.mark.parametrize("t0", [T0, -T0])
@each_entry
def test_a_start_at_another_time_changes_labels_alone(name, t0):
    call, made = TABLE[name]
    there, here = (call(run((1,), name not in STATISTICS, t0=start, **made)) for start in (t0, 0.0))
    # Times are rounded to 2^-53 of 160; an error of 1e-7 is the difference of states of size one.
    close(skipped(there), skipped(at_another_time(here, t0)), 1e-6 if name.startswith("error") else 1e-8)


def mirrored(result):
    """Return a result of -x(-t), from that of x(t)."""
    if isinstance(result, co.PhaseDrift):
        return replace(result, t=-result.t, lead=-result.lead, intercept=-result.intercept)
    if isinstance(result, co.Frequencies):
        return replace(result, amplitude=-result.amplitude.conj(), mean=-result.mean)
    if isinstance(result, co.LyapunovExponents):
        return replace(result, t=-result.t)
    return result


@pytest.mark.thinned(1)
@each_entry
def test_a_backward_run_is_the_mirror_image(name):
    call, made = TABLE[name]
    back, forth = (call(run((2,), name not in STATISTICS, sense=sense, **made)) for sense in (-1.0, 1.0))
    wanted = mirrored(forth)
    if name == "frequencies of the attitude":
        # The attitude is that of the forward run itself.
        wanted = replace(forth, amplitude=forth.amplitude.conj())
    if name == "spatial momentum":
        wanted = co.analysis.RandomWalk(forth.early, forth.late, forth.worst, -forth.bias)
    # Deviations of a line that is known to 1e-7 are known to so much less.
    close(skipped(back), skipped(wanted), 1e-5 if name == "line drift" else 1e-8)
    if isinstance(back, co.LyapunovExponents):
        close(back.exponents, forth.exponents, 1e-8)
        close(back.uncertainty, forth.uncertainty, 1e-8)
    if isinstance(back, co.Frequencies):
        strong = np.abs(forth.diffusion) > 1e-3 * np.abs(forth.diffusion).max()
        np.testing.assert_allclose(back.diffusion[strong], forth.diffusion[strong], rtol=1e-2)
        np.testing.assert_allclose(back.uncertainty, forth.uncertainty, rtol=1e-2, atol=1e-14)


@pytest.mark.parametrize("sense", [1.0, -1.0])
@pytest.mark.parametrize("scheme", ["Splitting", "first order"])
def test_modified_energies_of_a_batch_are_those_of_the_members(scheme, sense):
    made = {"scheme": scheme, "sense": sense, "t0": T0, "attitude": False}
    batch = run(**made)
    found = batch.modified_energy(6)
    for m in range(3):
        alone = run((m,), True, **made)
        np.testing.assert_array_equal(found[:, m], alone.modified_energy(6))
        H = co.modified_hamiltonian(BODIES[m], alone.method, 6)
        np.testing.assert_array_equal(found[:, m], H(alone.x, sense * STEP))
        # By the sixth power of the step the modified energy stays; the other sign of the step is seen.
        wander = np.ptp(found[:, m])
        assert wander < 0.05 * np.ptp(alone.energy)

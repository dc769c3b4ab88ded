"""The same inputs give the same bits in every way to run them; the interpreter agrees with compiled loops."""

import mpmath
import numpy as np
import pytest

import coadjoint as co

from .measures import U
from .schemes_under_test import pairs, schemes, witnesses
from .systems_under_test import all_cases

pytestmark = pytest.mark.thinned(6)

CHOSEN = (
    "A3,7, full",
    "e(3), heavy top",
    "so(4), full, another basis",
    "so(4), separable",
    "skew J, no Jacobi identity",
)
SOME = [p for p in pairs({name: all_cases()[name] for name in CHOSEN})]
SPAN, STEP, EVERY = (0.0, 1.5), 0.0625, 6


def attitude_of(method, system):
    kind = method.properties(system).attitude
    return False if kind == "none" else "coadjoint"


def ensemble_around(x0, members):
    return x0 * (1.0 - 0.05 * np.arange(members)[:, None])


@pytest.mark.thinned(11)
@pytest.mark.parametrize(("scheme", "case"), SOME)
def test_options_members_and_threads_do_not_change_bits(scheme, case):
    method, (system, x0, _) = schemes()[scheme], all_cases()[case]
    attitude = attitude_of(method, system)

    def run(x, **options):
        return co.integrate(system, x, SPAN, STEP, method, attitude=attitude, **options)

    every = run(x0, save_every=1, watch=True)
    ensemble = ensemble_around(x0, 7)
    together = run(ensemble, save_every=EVERY, watch=False, threads=1)
    others = [run(ensemble, save_every=EVERY, threads=count) for count in (2, 3)]
    # Members of an ensemble, alone and together, on any number of threads.
    for other in others:
        assert np.array_equal(together.x, other.x)
        assert attitude is False or np.array_equal(together.attitude, other.attitude)
    variants = [run(x0, save_every=EVERY, watch=watch) for watch in (True, False)]
    variants.append(run(x0, save_every=EVERY, progress=True))
    for one in variants:
        assert np.array_equal(one.x, every.x[::EVERY])
        assert np.array_equal(one.x, together.x[:, 0])
        if attitude:
            assert np.array_equal(one.attitude, every.attitude[::EVERY])
            assert np.array_equal(one.attitude, together.attitude[:, 0])
    alone = run(ensemble[5], save_every=24, watch=False)
    assert np.array_equal(alone.x[-1], together.x[-1, 5])
    without = co.integrate(system, x0, SPAN, STEP, method, save_every=EVERY)
    assert np.array_equal(without.x, together.x[:, 0])


@pytest.mark.parametrize(("scheme", "case"), SOME)
def test_stepper_equals_the_first_step_of_a_run(scheme, case):
    method, (system, x0, _) = schemes()[scheme], all_cases()[case]
    run = co.integrate(system, x0, (0.0, 2 * STEP), STEP, method)
    step = co.stepper(system, method, STEP)
    assert np.array_equal(step(x0), run.x[1])
    assert np.array_equal(step(x0), run.x[1])


def read_plainly(method, system, x, h, count, number=float):
    """Take steps by the interpreter, in any number type."""
    point = np.array([number(v) for v in x], dtype=object if number is not float else float)
    h = number(h)
    t = number(0)
    for _ in range(count):
        point, t = method.step(system, point, t, h), t + h
    return point


@pytest.mark.thinned(52)
@pytest.mark.parametrize(("scheme", "case"), pairs(all_cases()))
def test_interpreter_agrees_with_the_compiled_loop(scheme, case):
    method, (system, x0, _) = schemes()[scheme], all_cases()[case]
    count = 8
    run = co.integrate(system, x0, (0.0, count * STEP), STEP, method, save_every=count)
    plain = read_plainly(method, system, x0, STEP, count)
    # Both round each of `evaluations` n times; the motion of one unit of time amplifies by less than 16.
    bound = 16 * 4 * len(x0) * U * (run.stats.evaluations + count) * np.max(np.abs(run.x))
    assert np.max(np.abs(plain - run.x[-1])) <= bound


@pytest.mark.thinned(38)
@pytest.mark.parametrize("scheme", list(schemes()))
def test_compiled_loop_agrees_with_forty_digits(scheme):
    """On systems without Python functions, which can be evaluated in multiprecision."""
    method = schemes()[scheme]
    for system, x0, _ in witnesses(method, "A3,7, full", "e(3), heavy top"):
        if isinstance(system, co.MatrixSystem):
            continue  # the interpreter is in float64 for matrices
        with mpmath.workdps(40):
            exact = read_plainly(method, system, x0, 0.125, 2, mpmath.mpf)
        run = co.integrate(system, x0, (0.0, 0.25), 0.125, method)
        error = max(abs(float(a - mpmath.mpf(float(b)))) for a, b in zip(exact, run.x[-1], strict=True))
        assert error <= 4 * len(x0) * U * (run.stats.evaluations + 2) * np.max(np.abs(run.x)), (system.name, error)

"""Errors of runs at two steps, against what is exact, and what grows with which power of the step."""

import numpy as np

import coadjoint as co


def power(errors):
    """The power of the step with which an error grew, from the error at a step and at half of it."""
    return np.log2(errors[0] / errors[1])


def errors_at_two_steps(system, x0, time, step, method, exact):
    """The largest error at the end of the run, at the step and at half of it."""
    ends = [co.integrate(system, x0, (0.0, time), h, method).x[-1] for h in (step, step / 2)]
    return [float(np.abs(end - exact).max()) for end in ends]


def assert_order(system, x0, time, step, method, exact):
    """The slope of the error is the order of the scheme.

    The term after the leading one is of order + 1 at least, relative to it some multiple of the step: 0.15 of it.
    """
    errors = errors_at_two_steps(system, x0, time, step, method, exact)
    assert errors[1] > 1e-12, "the error is lost in rounding, and has no slope"
    assert abs(power(errors) - method.order) < 0.15


def wander(function, solution):
    """How far a function of the state goes from its first value along a run."""
    values = np.array([float(function(x)) for x in solution.x])
    return float(np.abs(values - values[0]).max())


def assert_bounded_by_order(function, system, x0, time, step, method):
    """An integral that the scheme does not keep wanders by h^order, and no further over a run that is twice as long."""
    far = [wander(function, co.integrate(system, x0, (0.0, time), h, method)) for h in (step, step / 2)]
    assert far[1] > 1e-12, "the integral is kept to rounding: nothing is measured"
    assert abs(power(far) - method.order) < 0.3

"""User functions: compiled to a fixed signature, no kernel compiled for them, what cannot be compiled refused."""

import ctypes
import math
import subprocess
import sys

import numpy as np
import pytest

import coadjoint as co
from coadjoint.kernels.functions.compiled_functions import CompiledFunction

CALL = ctypes.CFUNCTYPE(None, ctypes.POINTER(ctypes.c_double), ctypes.c_double, ctypes.POINTER(ctypes.c_double))


def compile_and_call(function, y, t=0.0, results=1, **how):
    how = {"scalar": False, "flat": False, "timed": False, **how}
    compiled = CompiledFunction(function, len(y), results, what="the test function", **how)
    arguments, out = (ctypes.c_double * len(y))(*y), (ctypes.c_double * (results + 1))()
    out[results] = -77.0
    CALL(compiled.address)(arguments, t, out)
    assert list(arguments) == list(y) and out[results] == -77.0
    return list(out)[:results]


def sum_of_squares(y):
    return y[0] * y[0] + y[1] * y[1]


@pytest.mark.long
def test_each_way_of_calling():
    assert compile_and_call(sum_of_squares, [3.0, 4.0]) == [25.0]
    assert compile_and_call(lambda y, t: y[0] * t, [3.0], 0.5, timed=True) == [1.5]
    assert compile_and_call(math.cosh, [0.0], scalar=True) == [1.0]
    assert compile_and_call(lambda y, t: y + t, [3.0], 0.5, scalar=True, timed=True) == [3.5]
    assert compile_and_call(lambda y: 2.0 * y, [1.0, 2.0, 3.0], results=3, flat=True) == [2.0, 4.0, 6.0]
    assert compile_and_call(lambda y, t: (y[1], t), [1.0, 2.0], 7.0, results=2, flat=True, timed=True) == [2.0, 7.0]
    matrix = compile_and_call(lambda y: np.outer(y, np.array([1.0, 10.0])), [1.0, 2.0], results=4, flat=True)
    assert matrix == [1.0, 10.0, 2.0, 20.0]


def test_a_whole_number_returned_is_a_number():
    assert compile_and_call(lambda y: 3, [1.0]) == [3.0]


def test_division_by_zero_follows_ieee():
    assert compile_and_call(lambda y: 1.0 / y[0], [0.0]) == [math.inf]


@pytest.mark.parametrize(
    "function",
    [
        lambda x: open(str(x[0])).read(),
        lambda x: x[0].no_such_attribute,
        lambda x: "text",
        lambda x: None * x[0],
    ],
    ids=["files", "attributes", "text", "nothing"],
)
def test_what_cannot_be_compiled_is_refused_in_one_line(function):
    with pytest.raises(TypeError, match=r"the test function cannot be compiled by Numba: .{10,}") as refusal:
        CompiledFunction(function, 1, 1, scalar=False, flat=False, timed=False, what="the test function")
    assert "\n" not in str(refusal.value) and len(str(refusal.value)) < 500


def test_the_refusal_of_a_run_names_the_function():
    body = co.systems.rigid_body((1, 2, 3))
    with pytest.raises(TypeError, match="the value of height cannot be compiled by Numba"):
        co.integrate(body, (1, 0, 0.5), (0, 1), 0.5, observe={"height": lambda x: open(str(x[0]))})


def systems_with_functions():
    for factor in (0.5, 0.75):

        def value(y, factor=factor):
            return factor * math.cosh(y)

        def slope(y, factor=factor):
            return factor * math.sinh(y)

        yield co.LiePoissonSystem(co.algebras.so(3), co.Separable({0: (value, slope), 2: (value, slope)}))
    for algebra in (co.algebras.e(3), co.algebras.sl(2), co.algebras.heisenberg(2)):
        yield co.LiePoissonSystem(algebra, co.Quadratic(np.eye(algebra.dim) + 0.1, linear=np.ones(algebra.dim)))
        yield co.LiePoissonSystem(algebra, co.Polynomial({(4, *[0] * (algebra.dim - 1)): 1.0}))


WITHOUT_FUNCTIONS = """
import sys
import coadjoint as co
body = co.systems.rigid_body((1, 2, 3))
for method in (co.Splitting(), co.GaussLegendre(2), co.RadauEnergy(2)):
    co.integrate(body, (0.8, 0.5, 0.6), (0, 0.5), 0.1, method)
print("numba" in sys.modules)
"""


@pytest.mark.long
def test_numba_is_loaded_for_functions_of_the_user_alone():
    done = subprocess.run([sys.executable, "-c", WITHOUT_FUNCTIONS], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def test_functions_of_the_standard_library_and_of_numpy_serve():
    s = co.LiePoissonSystem(co.algebras.sl(2), co.Separable({0: (math.cosh, math.sinh), 2: (np.cosh, np.sinh)}))
    own = (lambda y: math.cosh(y), lambda y: math.sinh(y))
    same = co.LiePoissonSystem(co.algebras.sl(2), co.Separable({0: own, 2: own}))
    ends = [co.integrate(each, (0.5, 0.25, -0.5), (0, 1), 0.25).x[-1] for each in (s, same)]
    assert np.abs(ends[0] - ends[1]).max() <= 64 * 2.0**-53


def test_functions_are_the_ones_given():
    """Two systems that differ in a captured number move differently: no compiled function is mixed up with another."""
    ends = [
        co.integrate(s, np.linspace(0.1, 0.6, s.dim), (0, 1), 0.1).x[-1] for s in list(systems_with_functions())[:2]
    ]
    assert np.abs(ends[0] - ends[1]).max() > 1e-3


def refuse_large(y):
    if y > 0.9:
        raise ValueError("outside the domain")
    return y


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_function_that_raises_stops_the_run():
    """What it raised cannot leave the compiled loop; the state must not go on with numbers that nobody computed."""
    H = co.Separable({0: (lambda y: 0.5 * y * y, refuse_large), 1: (lambda y: y * y, lambda y: 2 * y)})
    s = co.LiePoissonSystem(co.algebras.so(3), H)
    free = co.Separable({0: (lambda y: 0.5 * y * y, lambda y: y), 1: (lambda y: y * y, lambda y: 2 * y)})
    reference = co.integrate(co.LiePoissonSystem(co.algebras.so(3), free), (0.8, 0.5, 0.6), (0, 5), 0.1)
    crossing = int(np.argmax(reference.x[:, 0] > 0.9))
    assert crossing > 0
    with pytest.raises(co.IntegrationError) as failure:
        co.integrate(s, (0.8, 0.5, 0.6), (0, 5), 0.1)
    assert failure.value.step <= crossing + 1
    assert np.all(np.isfinite(failure.value.partial.x))
    assert np.array_equal(failure.value.partial.x, reference.x[: len(failure.value.partial.x)])


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_an_observable_that_raises_is_no_number():
    sol = co.integrate(co.systems.rigid_body((1, 2, 3)), (0.8, 0.5, 0.6), (0, 1), 0.1, observe={"x1": refuse_first})
    assert np.all(np.isnan(sol.observed["x1"][sol.x[:, 0] > 0.5]))


def refuse_first(x):
    if x[0] > 0.5:
        raise ValueError("outside the domain")
    return x[0]

"""Functions compiled to a fixed signature: ways of calling, reads beyond arrays, and what is compiled once."""

import ctypes
import math

import numpy as np
import pytest

from coadjoint.kernels.functions import compilation
from coadjoint.kernels.functions.compiled_functions import compiled_function
from coadjoint.kernels.tables import steps
from coadjoint.systems.user_functions import MultipleOf
from refusals import refused

pytestmark = pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
TABLE = np.array([0.5, -1.5])
CALL = ctypes.CFUNCTYPE(None, ctypes.POINTER(ctypes.c_double), ctypes.c_double, ctypes.POINTER(ctypes.c_double))


def compile_and_call(function, y, t=0.0, results=1, **how):
    how = {"scalar": False, "flat": False, "timed": False, **how}
    compiled = compiled_function(function, len(y), results, what="the test function", **how)
    arguments, out = (ctypes.c_double * len(y))(*y), (ctypes.c_double * (results + 1))()
    out[results] = -77.0
    CALL(compiled.address)(arguments, t, out)
    assert list(arguments) == list(y) and out[results] == -77.0
    return list(out)[:results]


def sum_of_squares(y):
    return y[0] * y[0] + y[1] * y[1]


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
    with refused(TypeError, "the test function", "Numba") as refusal:
        compiled_function(function, 1, 1, scalar=False, flat=False, timed=False, what="the test function")
    assert "\n" not in str(refusal.value) and len(str(refusal.value)) < 500


@pytest.mark.thinned(18)
@pytest.mark.parametrize("place", [3, 4, -4])
@pytest.mark.parametrize(
    ("function", "how"),
    [
        (lambda y, t: y[int(t)], {"timed": True}),
        (lambda y, t: y[int(t)] + y[::-1], {"timed": True, "flat": True, "results": 3}),
        (MultipleOf(lambda y, t: y[int(t)], 2.0, True), {"timed": True}),
        (lambda y: y[int(y[0])], {}),
        (lambda y: 2.0 * y + y[int(y[0])], {"flat": True, "results": 3}),
        (lambda y: TABLE[int(y)], {"scalar": True}),
    ],
    ids=["time", "array of time", "multiple", "state", "array of state", "global table"],
)
def test_every_way_of_calling_gives_no_number(function, how, place):
    """The numbers beside the array are finite: they are never the result."""
    how = {"scalar": False, "flat": False, "timed": False, "results": 1, **how}
    results = how.pop("results")
    compiled = compiled_function(function, 1 if how["scalar"] else 3, results, what="the test function", **how)
    numbers = (ctypes.c_double * 16)(*np.arange(16.0))
    start = ctypes.addressof(numbers) + 8 * 6  # six numbers before the array, and seven after it
    given, out = (ctypes.c_double * 3).from_address(start), (ctypes.c_double * 3)()
    for inside in (True, False):
        given[0] = float(1 if inside else place)
        CALL(compiled.address)(given, given[0], out)
        assert all(np.isfinite(out[k]) == inside for k in range(results))


def product(a, b):
    return a * b


def inner(y):
    return 2.0 * y


@pytest.fixture
def made(monkeypatch):
    """Nothing is compiled: each compilation is an object of its own, with its arguments."""

    class Made(tuple):
        address = 8

        __hash__, __eq__ = object.__hash__, object.__eq__

    for module, name in ((compilation, "_compiled"), (steps, "_adapted_stream"), (compilation, "_compiled_function")):
        monkeypatch.setattr(module, name, lambda *given: Made(given))
    monkeypatch.setattr(compilation, "_COMPILED", {})


def step_of(**given):
    found, reason = compilation.compiled_step(**given)
    assert reason == ""
    return found


CACHED = {
    "functions": (
        compilation.callback_of,
        {"function": product, "size": 3, "results": 3, "scalar": False, "flat": True, "timed": False, "what": "f"},
        [{"size": 2}, {"results": 9}, {"scalar": True}, {"flat": False}, {"timed": True}],
    ),
    "streams": (
        lambda **given: steps._compiled_stream(**given),
        {"function": product, "N": 3, "complex_entries": False, "timed": False, "traceless": ()},
        [{"N": 4}, {"complex_entries": True}, {"timed": True}]
        + [{"traceless": places} for places in (((0, 3),), ((0, 2),), ((0, 2), (2, 3)))],
    ),
    "steps": (
        step_of,
        {"function": product, "names": ("a", "b"), "values": (1, 2.0), "derivatives": False},
        [{"derivatives": True}, {"names": ("b", "a")}, {"values": (2, 2.0)}, {"values": (1.0, 2.0)}],
    ),
}


@pytest.mark.parametrize("kind", CACHED)
def test_each_way_of_calling_is_compiled_once(made, kind):
    make, base, others = CACHED[kind]
    calls = [base, *({**base, **other} for other in [*others, {"function": inner}])]
    found, again = [make(**call) for call in calls], [make(**call) for call in reversed(calls)]
    assert all(one is other for one, other in zip(found, reversed(again), strict=True))
    assert len({id(one) for one in found}) == len(calls)
    if "what" in base:
        assert make(**base) is make(**{**base, "what": "another name"})

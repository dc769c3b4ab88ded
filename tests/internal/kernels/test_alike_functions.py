"""Functions that are alike are compiled once; those that differ in anything are not; many are told of beforehand."""

import collections
import decimal
import functools
import math
import types
import warnings

import numpy as np
import pytest

import coadjoint as co
from coadjoint.kernels.functions.contents import compilation_key

numba = pytest.importorskip("numba")

from coadjoint.kernels.functions import callbacks, fresh_code, matrix_functions, numba_steps  # noqa: E402

SLOPE = 2.0


def times(a):
    return lambda y: a * np.cosh(y), lambda y: a * np.sinh(y)


def defaults(a):
    return lambda y, a=a: a * y


def inner(y):
    return SLOPE * y


def reads_another(y):
    return inner(y) + math.sin(y)


def with_module(**names):
    """Return a function whose module has some values."""
    return types.FunctionType(reads_another.__code__, {"math": math, "inner": inner, **names})


def test_what_is_alike():
    for one, other in (
        (times(2.0)[0], times(2.0)[0]),
        (defaults(0.5), defaults(0.5)),
        (times(np.arange(3.0))[0], times(np.arange(3.0))[0]),
        (with_module(), with_module()),
        (times((1, "a"))[0], times((1, "a"))[0]),
    ):
        assert (
            one is not other
            and compilation_key(one) == compilation_key(other)
            and hash(compilation_key(one)) == hash(compilation_key(other))
        )


class Holder:
    """An object that functions may read, with everything that it could differ in."""

    factor = 1.0

    def __init__(self, own):
        self.own = own

    def times(self, y):
        return self.own * y

    def plus(self, y):
        return self.own + y


class Slotted:
    __slots__ = ("first", "second")

    def __init__(self, first, second):
        self.first, self.second = first, second


class LongerSlotted(Slotted):
    __slots__ = "third"

    def __init__(self, first, second, third):
        super().__init__(first, second)
        self.third = third


class Number(float):
    """A number with an attribute."""


def numbered(value, label):
    found = Number(value)
    found.label = label
    return found


def kind_with(**names):
    return type("Kind", (Holder,), names)


def product_of(a, b, c=0.0):
    return a * b + c


def cached(a):
    return functools.lru_cache(maxsize=None)(lambda y: a * y)


def own_dataclass(value):
    return co.Splitting(order=value)


# Ways to make one object, each followed by calls whose results all differ.
VARIED = {
    "partial": (
        functools.partial,
        [(product_of,), (max,), (product_of, 1), (product_of, 2), (product_of, 1, 2), (product_of, 2, 1)],
    ),
    "keywords of partial": (
        lambda **given: functools.partial(product_of, **given),
        [{}, {"a": 1}, {"a": 2}, {"b": 1}, {"a": 1.0}, {"a": 1, "b": 2}, {"a": 2, "b": 1}],
    ),
    "keywords beside arguments": (
        lambda a, c: functools.partial(product_of, a, c=c),
        [(1, 1), (1, 2), (2, 1), (2, 2), (inner, 1), (times(1.0)[0], 1), (times(2.0)[0], 1)],
    ),
    "method": (lambda name, own: getattr(Holder(own), name), [("times", 1.0), ("times", 2.0), ("plus", 1.0)]),
    "method of a class": (
        lambda function: kind_with(f=classmethod(function)).f,
        [(inner,), (times(1.0)[0],), (times(2.0)[0],)],
    ),
    "static or class method": (
        lambda kind, a: kind_with(f=kind(times(a)[0])),
        [(staticmethod, 1.0), (staticmethod, 2.0), (classmethod, 1.0), (classmethod, 2.0)],
    ),
    "property": (
        lambda *functions: kind_with(f=property(*functions)),
        [(inner,), (product_of,), (inner, inner), (inner, product_of), (inner, None, inner), (inner, inner, inner)],
    ),
    "cached property": (lambda a: kind_with(f=functools.cached_property(times(a)[0])), [(1.0,), (2.0,)]),
    "bound method of a builtin": (
        lambda value, name: getattr(value, name),
        [({1: 2}, "get"), ({1: 3}, "get"), ({1: 2}, "pop"), ([1], "pop"), ((1.0, 2.0), "index"), ((1.0,), "index")],
    ),
    "cached function": (cached, [(1.0,), (2.0,)]),
    "object": (Holder, [(1.0,), (2.0,), (1,), ("1",), (None,)]),
    "class": (kind_with, [{}, {"factor": 2.0}, {"factor": 3.0}, {"other": 2.0}, {"times": inner}, {"plus": inner}]),
    "class of an object": (lambda **names: kind_with(**names)(1.0), [{}, {"factor": 2.0}, {"times": inner}]),
    "slots": (Slotted, [(1, 2), (2, 1), (1, 1), (2, 2)]),
    "slots of a base": (LongerSlotted, [(1, 2, 3), (2, 1, 3), (1, 2, 4), (3, 2, 1)]),
    "number with an attribute": (numbered, [(1.0, "a"), (2.0, "a"), (1.0, "b")]),
    "dataclass of the library": (own_dataclass, [(2,), (4,), (6,)]),
    "C type": (collections.deque, [((1, 2),), ((2, 1),), ((1, 2), 5), ((1, 2), 6), ((),)]),
    "decimal": (decimal.Decimal, [("1.0",), ("1.00",), ("2",)]),
    "range": (range, [(3,), (1, 3), (1, 3, 2), (4,)]),
    "polynomial": (
        lambda *terms: co.Polynomial(dict(terms)),
        [(((1, 0), 2.0),), (((0, 1), 2.0),), (((1, 0), 3.0),), (((1, 0), 2.0), ((0, 1), 2.0))],
    ),
    "defaults": (
        lambda defaults, keywords: with_defaults(defaults, keywords),
        [(None, None), ((1.0,), None), ((2.0,), None), (None, {"c": 1.0}), (None, {"c": 2.0}), ((1.0,), {"c": 1.0})],
    ),
    "attributes of a function": (
        lambda **names: with_attributes(names),
        [{}, {"a": 1}, {"a": 2}, {"b": 1}, {"a": 1, "b": 2}],
    ),
}


def with_defaults(defaults, keywords):
    def function(a, b=0.0, *, c=0.0):
        return a + b + c

    function.__defaults__, function.__kwdefaults__ = defaults, keywords
    return function


def with_attributes(names):
    def function(y):
        return y

    vars(function).update(names)
    return function


@pytest.mark.parametrize("name", VARIED)
def test_whatever_an_object_holds_is_in_its_key(name):
    """As itself, closed over, and inside of another object; made again it has the same key."""
    make, calls = VARIED[name]

    def made(call):
        return make(**call) if isinstance(call, dict) else make(*call)

    for around in (lambda value: value, lambda value: times(value)[0], lambda value: [Holder((value, 0.0))]):
        keys = [compilation_key(around(made(call))) for call in calls]
        assert all(isinstance(key, str) for key in keys)
        assert len(set(keys)) == len(calls)
        assert keys == [compilation_key(around(made(call))) for call in calls]


def with_local(y):
    z = inner(y)
    return y * z


DISPATCHERS = [{}, {"fastmath": True}, {"error_model": "numpy"}, {"locals": {"z": numba.float32}}]
CALLBACKS = [("f8(f8)", given) for given in DISPATCHERS] + [("f4(f4)", {})]


@pytest.mark.long
def test_options_of_compilation_are_in_the_key():
    """Fast arithmetic, division by zero, types of local variables and signatures, of dispatchers and callbacks."""
    inlined = types.FunctionType(with_local.__code__, {"inner": numba.njit(inner)})

    def keys():
        made = [inlined, *(numba.njit(**given)(inlined) for given in DISPATCHERS)]
        made += [numba.njit(signature)(inlined) for signature in ("f8(f8)", "f4(f4)")]
        made += [numba.njit(**DISPATCHERS[1])(inner), numba.cfunc("f8(f8)")(inner)]
        return [
            compilation_key(one)
            for one in (*made, *(numba.cfunc(signature, **given)(inlined) for signature, given in CALLBACKS))
        ]

    found = keys()
    assert len(set(found)) == len(found) and keys() == found


def test_a_value_that_is_met_again_is_another_than_an_equal_one():
    """[a, b] with a is b, and with a equal to b, can differ in what a function does to them."""
    one, other = Holder(1.0), Holder(1.0)
    assert compilation_key([one, one]) != compilation_key([one, other]) == compilation_key([other, one])
    assert compilation_key([one, other, one]) != compilation_key([one, other, other])


def spins(functions):
    count = len(functions)
    pairs = {3 * k: pair for k, pair in enumerate(functions)}
    return co.LiePoissonSystem(co.algebras.copies(co.algebras.so(3), count), co.Separable(pairs))


def test_one_text_at_many_sites_is_compiled_once(monkeypatch):
    compiled = []
    plain = callbacks._compiled
    monkeypatch.setattr(callbacks, "_compiled", lambda *given: (compiled.append(given), plain(*given))[1])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        system = spins([times(0.7251)] * 40 + [times(0.7251) for _ in range(40)])
        x = np.tile([0.3, 0.4, -0.2], 80)
        sol = co.integrate(system, x, (0.0, 0.5), 0.05, co.Splitting())
    assert len(compiled) == 2  # a value and a slope
    # Each spin turns about its axis, by a cosh(y)-slope that it keeps.
    angle = 0.5 * 0.7251 * np.sinh(0.3)
    sign = np.sign(system.vector_field(x)[1]) / np.sign(-x[2])
    c, d = np.cos(angle), sign * np.sin(angle)
    turned = np.array([0.3, 0.4 * c + 0.2 * d, -0.2 * c + 0.4 * d])
    np.testing.assert_allclose(sol.x[-1].reshape(80, 3), np.tile(turned, (80, 1)), rtol=0, atol=1e-14)


def test_a_module_that_has_changed_is_compiled_again():
    module = types.ModuleType("changing")
    exec("import numpy as np\nSLOPE = 2.0\ndef value(y): return SLOPE * y\ndef slope(y): return SLOPE", vars(module))

    def end():
        system = spins([(module.value, module.slope)])
        return co.integrate(system, [0.0, 1.0, 0.0], (0.0, 0.5), 0.5, co.Splitting()).x[-1, 2]

    first = end()
    module.SLOPE = 1.0
    assert abs(first) == pytest.approx(np.sin(1.0), abs=1e-15)
    assert abs(end()) == pytest.approx(np.sin(0.5), abs=1e-15)


@pytest.mark.long
def test_many_functions_are_told_of_beforehand(monkeypatch):
    monkeypatch.setattr(callbacks, "WARNING_COUNT", 4)
    system = spins([times(5.0 + k) for k in range(4)])
    with pytest.warns(UserWarning, match="4 different Python functions are compiled one by one, about 0 s in all"):
        co.prepare(system, co.Splitting(), 0.1)
    few = spins([times(50.0), times(51.0), times(52.0), times(52.0)])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        co.prepare(system, co.Splitting(), 0.2)  # they are known by now
        co.prepare(few, co.Splitting(), 0.2)


@pytest.mark.long
def test_what_is_kept_is_bounded(monkeypatch):
    monkeypatch.setattr(fresh_code, "_COMPILED", {})
    monkeypatch.setattr(fresh_code, "MAX_CACHED", 3)
    for k in range(5):
        co.prepare(spins([times(90.0 + k)]), co.Splitting(), 0.1)
    assert len(fresh_code._COMPILED) == 3


def product(a, b):
    return a * b


@pytest.fixture
def made(monkeypatch):
    """Nothing is compiled: each compilation is an object of its own, with its arguments."""

    class Made(tuple):
        address = 8

        __hash__, __eq__ = object.__hash__, object.__eq__

    for module, name in ((callbacks, "_compiled"), (matrix_functions, "_adapted"), (numba_steps, "_compiled")):
        monkeypatch.setattr(module, name, lambda *given: Made(given))
    monkeypatch.setattr(fresh_code, "_COMPILED", {})


def all_different(make, base, others):
    """Whether each call has a result of its own, and the same call the same result."""
    calls = [base, *({**base, **other} for other in others)]
    found = [make(**call) for call in calls]
    again = [make(**call) for call in reversed(calls)]
    assert all(one is other for one, other in zip(found, reversed(again), strict=True))
    assert len({id(one) for one in found}) == len(calls)


def test_functions_are_compiled_for_each_way_of_calling(made):
    base = {"function": product, "size": 3, "results": 3, "scalar": False, "flat": True, "timed": False, "what": "f"}
    others = [{"size": 2}, {"results": 9}, {"scalar": True}, {"flat": False}, {"timed": True}, {"function": inner}]
    all_different(callbacks.callback_of, base, others)
    assert callbacks.callback_of(**base) is callbacks.callback_of(**{**base, "what": "another name"})


def test_streams_are_compiled_for_each_kind_of_matrices(made):
    base = {"function": product, "N": 3, "complex_entries": False, "timed": False, "traceless": ()}
    others = [{"N": 4}, {"complex_entries": True}, {"timed": True}, {"traceless": ((0, 3),)}, {"function": inner}]
    others += [{"traceless": ((0, 2),)}, {"traceless": ((0, 2), (2, 3))}]
    all_different(matrix_functions._compiled, base, others)


def test_steps_are_compiled_for_each_scheme_and_kind_of_system(made):
    def compiled(**given):
        found, reason = numba_steps.compiled_step(**given)
        assert reason == ""
        return found

    base = {"function": product, "names": ("a", "b"), "values": (1, 2.0), "derivatives": False}
    others = [{"derivatives": True}, {"names": ("b", "a")}, {"values": (2, 2.0)}, {"values": (1.0, 2.0)}]
    all_different(compiled, base, [*others, {"function": inner}])

"""Keys and fingerprints of functions: whatever changes their meaning changes them, and nothing else does."""

import collections
import ctypes
import decimal
import functools
import math
import subprocess
import sys
import types
from pathlib import Path

import numba
import numpy as np
import pytest

import coadjoint as co
from coadjoint.files.archives.run_checks import fingerprint_of, same_fingerprint
from coadjoint.kernels.functions.contents import compilation_key, contents_of

SLOPE = 2.0


def times(a):
    return lambda y: a * np.cosh(y), lambda y: a * np.sinh(y)


def defaults(a):
    return lambda y, a=a: a * y


def inner(y):
    return SLOPE * y


class Holder:
    """An object that functions may read."""

    def __init__(self, own):
        self.own = own

    def times(self, y):
        return self.own * y


Named = collections.namedtuple("Named", ("first", "second"))


def product_of(a, b, c=0.0):
    return a * b + c


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
    "bound method of a builtin": (
        lambda value, name: getattr(value, name),
        [({1: 2}, "get"), ({1: 3}, "get"), ({1: 2}, "pop"), ([1], "pop"), ((1.0, 2.0), "index"), ((1.0,), "index")],
    ),
    "named tuple": (Named, [(1, 2), (2, 1), (1.0, 2)]),
    "dataclass of the library": (own_dataclass, [(2,), (4,), (6,)]),
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
}


def with_defaults(defaults, keywords):
    def function(a, b=0.0, *, c=0.0):
        return a + b + c

    function.__defaults__, function.__kwdefaults__ = defaults, keywords
    return function


@pytest.mark.thinned(1)
@pytest.mark.parametrize("name", VARIED)
def test_whatever_an_object_holds_is_in_its_key(name):
    """As itself, closed over, and inside of another object; made again it has the same key."""
    make, calls = VARIED[name]

    def made(call):
        return make(**call) if isinstance(call, dict) else make(*call)

    for around in (lambda value: value, lambda value: times(value)[0], lambda value: [{0: (value, 0.0)}]):
        keys = [compilation_key(around(made(call))) for call in calls]
        assert all(isinstance(key, str) for key in keys)
        assert len(set(keys)) == len(calls)
        assert keys == [compilation_key(around(made(call))) for call in calls]


def with_local(y):
    z = inner(y)
    return y * z


DISPATCHERS = [{}, {"fastmath": True}, {"error_model": "numpy"}, {"locals": {"z": numba.float32}}]


def test_options_of_compilation_are_in_the_key():
    """Fast arithmetic, division by zero, types of local variables and signatures."""
    inlined = types.FunctionType(with_local.__code__, {"inner": numba.njit(inner)})

    def keys():
        made = [inlined, *(numba.njit(**given)(inlined) for given in DISPATCHERS)]
        made += [numba.njit(signature)(inlined) for signature in ("f8(f8)", "f4(f4)")]
        return [compilation_key(one) for one in (*made, numba.njit(**DISPATCHERS[1])(inner))]

    found = keys()
    assert len(set(found)) == len(found) and keys() == found


def test_a_value_that_is_met_again_is_another_than_an_equal_one():
    """[a, b] with a is b, and with a equal to b, can differ in what a function does to them."""
    one, other = times(1.0)[0], times(1.0)[0]
    assert compilation_key([one, one]) != compilation_key([one, other]) == compilation_key([other, one])
    assert compilation_key([one, other, one]) != compilation_key([one, other, other])


# Every {k} is a place for an edit, given as (text, another text).
TEMPLATE = """
import functools, math
import numpy as np
{decorator}
def deepest(y, scale={0}):
    return scale * y {1} {2}
{decorator}
def helper(y):
    def inside(z):
        return z * {3}
    return inside(deepest(y)) + TABLE[1][{4}]
TABLE = ({5}, ({6}, -0.25, (1.0, 2.0)), "text")
ARRAY = np.array([0.5, {7}])
SETTINGS = {{"a": [1.0, {8}], "b": {{1, 2, {9}}}}}
factor = {10}
def shift(y):
    return y + {11}
def made(own):
    return lambda y: own * shift(y) * factor
machine = made({12})
def bound(power, y):
    return y ** power
partial = functools.partial(bound, {13})
def given(*, slope={14}):
    return lambda y: slope * y
lifted = given()
module = __import__("types").ModuleType("module")
module.constant = {15}
counts = {16}
def value(y, *, offset={17}):
    unused = y.real
    total = helper(y) + ARRAY[1] * SETTINGS["a"][1] + len(SETTINGS["b"])
    total += machine(y) + partial(y) + lifted(y) + module.constant + counts.size
    return total + offset + math.{18}(y) + [u * {19} for u in (y, y)][0]
"""
PLACES = [
    ("2.0", "2"),
    ("+", "-"),
    ("1.5", "1.25"),
    ("3.0", "-3.0"),
    ("0", "1"),
    ("0.0", "-0.0"),
    ("0.5", "0.75"),
    ("0.25", "0.2500000000000001"),
    ("1.0", "True"),
    ("3", "4"),
    ("1.5", "2.5"),
    ("0.125", "0.0"),
    ("1.0", "np.float64(1.0)"),
    ("2", "3"),
    ("0.5", "np.nan"),
    ("1e-3", "1e-4"),
    ("np.zeros(3)", "np.zeros((3, 1))"),
    ("1.0", "1"),
    ("sin", "cos"),
    ("0.5", "0.25"),
]


def made(edited=None, decorator="", text=TEMPLATE, name="made.py"):
    """Return the module of the template, with one of the edits."""
    chosen = [pair[k == edited] for k, pair in enumerate(PLACES)]
    module = types.ModuleType("user_functions_of_a_test")
    exec(compile(text.format(*chosen, decorator=decorator), name, "exec"), vars(module))
    return module


@pytest.mark.parametrize("decorator", ["", "__import__('numba').njit"])
def test_every_edit_is_noticed(decorator):
    if decorator:
        pytest.importorskip("numba")
    found = [contents_of(made(k, decorator).value) for k in (None, *range(len(PLACES)))]
    assert not any(unknown for _, unknown in found)
    assert len({digest for digest, _ in found}) == len(found)
    assert contents_of(made(None, decorator).value) == found[0]
    prints = [fingerprint_of({"value": made(k, decorator).value}) for k in (None, *range(len(PLACES)))]
    assert same_fingerprint(prints[0], fingerprint_of({"value": made(None, decorator).value}))
    assert not any(same_fingerprint(prints[0], one) for one in prints[1:])


def test_edits_without_a_meaning_are_not_noticed():
    plain = contents_of(made().value)
    moved = "# a comment\n\n\nfurther = 5\n" + TEMPLATE.replace("def helper(y):", "def helper(y):  # moved\n")
    assert contents_of(made(text=moved, name="elsewhere.py").value) == plain
    module = made()
    module.real = module.unread = 7.0  # an attribute that is named, and a global that is not
    assert contents_of(module.value) == plain


def test_attributes_that_only_an_inner_function_names_are_read():
    constants, user = types.ModuleType("constants_of_a_test"), types.ModuleType("user_functions_of_a_test")
    user.constants = constants
    exec("def value(x):\n    inner = lambda y: constants.rate * y\n    return inner(x[0])", vars(user))
    found = []
    for rate in (1.0, 2.0):
        constants.rate = rate
        found.append(contents_of(user.value))
    assert found[0][0] != found[1][0] and not any(unknown for _, unknown in found)


def test_numbers_that_are_equal_and_not_the_same():
    numbers = [1, 1.0, True, np.float64(1), np.float32(1), 1 + 0j, "1", b"1", 0.0, -0.0, math.nan, None, (), [], {}]
    numbers += [(1, 2), [1, 2], {1, 2}, frozenset((1, 2)), {1: 2, 3: 4}, {3: 4, 1: 2}, np.array(1), np.array([1])]
    numbers += [np.array([(1, 2)], dtype=[(name, "i4"), ("c", "i4")]) for name in "ab"]
    numbers += [np.ones((2, 3)).T, np.ones((3, 2))]
    assert len({contents_of(lambda number=number: number)[0] for number in numbers}) == len(numbers)


VECTORIZED = np.frompyfunc(inner, 1, 1)
HELD, OBJECTS = Holder(1.0), np.array([1, "a"], dtype=object)


def test_what_cannot_be_followed_is_named():
    library = ctypes.CDLL(None)
    for function in (
        lambda y: library.abs(y),
        lambda y: eval("y"),
        lambda y: open("file").read(),
        lambda y, queue=collections.deque([1.0]): queue[0] * y,
        lambda y: Holder(1.0).times(y),
        lambda y, held=HELD: held.times(y),
        Holder(1.0).times,
        functools.lru_cache(inner),
        lambda y: OBJECTS[0] * y,
        lambda y: VECTORIZED(y),
        numba.cfunc("f8(f8)")(lambda y: y),
        types.FunctionType(made().value.__code__, {**vars(made()), "helper": (one for one in ())}),
    ):
        assert contents_of(function)[1]
    assert not contents_of(lambda y: np.sin(y) + math.erf(y) + np.linalg.norm([y]) + len(np.fft.fft([y])))[1]


def test_structures_deeper_than_python_can_follow_are_named():
    chain, in_set = [], ()
    for _ in range(sys.getrecursionlimit()):
        chain, in_set = [chain], frozenset([in_set])
    for deep in (chain, {"a": 1.0, "b": chain}, in_set):
        assert "deep" in contents_of(lambda x, deep=deep: len(deep))[1][0]
    assert not contents_of(lambda x, near=[[[1.0]]]: len(near))[1]
    first, second = (fingerprint_of([chain, number]) for number in (1.0, 2.0))
    assert not same_fingerprint(first, second)


def test_functions_that_call_each_other():
    """A list that contains itself is named."""
    loop = [1.0]
    loop.append(loop)
    assert contents_of(lambda y: y * loop[0])[1]
    held = [1.0]

    def one(y):
        return other(y) + held[0]

    def other(y):
        return one(y) if y > 0 else 0.0

    before = contents_of(one)
    assert not before[1] and before == contents_of(one)
    held[0] = 2.0
    assert contents_of(one) != before


@pytest.mark.long
def test_every_process_has_the_same_digests():
    code = "from test_function_keys import contents_of, made; print(contents_of(made().value)[0])"
    here = contents_of(made().value)[0]
    for seed in ("1", "2"):
        environment = {"PYTHONHASHSEED": seed, "PYTHONPATH": f"{Path(co.__file__).parents[1]}:{Path(__file__).parent}"}
        done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
        assert done.stdout.strip() == here

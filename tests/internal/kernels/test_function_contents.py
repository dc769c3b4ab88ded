"""Random edits of functions: whatever changes their meaning is noticed, and nothing else is."""

import ctypes
import functools
import math
import random
import subprocess
import sys
import types
from pathlib import Path

import numpy as np
import pytest

import coadjoint as co
from coadjoint.files.records.fingerprints import fingerprint_of, same_fingerprint
from coadjoint.kernels.functions.contents import contents_of

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
class Base:
    factor = {10}
    def shift(self, y):
        return y + {11}
class Machine(Base):
    def __init__(self):
        self.own = {12}
    def __call__(self, y):
        return self.own * self.shift(y) * self.factor
machine = Machine()
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
    assert not any(one.unknown for one in found)
    assert len({one.digest for one in found}) == len(found)
    assert contents_of(made(None, decorator).value) == found[0]
    prints = [fingerprint_of({"value": made(k, decorator).value}) for k in (None, *range(len(PLACES)))]
    assert same_fingerprint(prints[0], fingerprint_of({"value": made(None, decorator).value}))
    assert not any(same_fingerprint(prints[0], one) for one in prints[1:])


def test_several_random_edits_in_place():
    draw, module = random.Random(5), made()
    edits = [
        lambda: module.ARRAY.__setitem__(0, draw.random()),
        lambda: module.SETTINGS["a"].append(draw.random()),
        lambda: module.SETTINGS["b"].add(draw.random()),
        lambda: setattr(module.machine, "own", draw.random()),
        lambda: setattr(module.Base, "factor", draw.random()),
        lambda: setattr(module.module, "constant", draw.random()),
        lambda: setattr(module.deepest, "__defaults__", (draw.random(),)),
        lambda: module.value.__kwdefaults__.__setitem__("offset", draw.random()),
        lambda: setattr(module, "partial", functools.partial(module.bound, draw.random())),
        lambda: setattr(module, "lifted", module.given(slope=draw.random())),
        lambda: setattr(module, "len", functools.partial(pow, draw.random())),
        lambda: setattr(module, "TABLE", (0.0, (draw.random(),), "text")),
    ]
    known = [contents_of(module.value).digest]
    for _ in range(2):
        draw.shuffle(edits)
        for edit in edits:
            edit()
            known.append(contents_of(module.value).digest)
    assert len(set(known)) == len(known)


def test_edits_without_a_meaning_are_not_noticed():
    plain = contents_of(made().value)
    moved = "# a comment\n\n\nfurther = 5\n" + TEMPLATE.replace("def helper(y):", "def helper(y):  # moved\n")
    assert contents_of(made(text=moved, name="elsewhere.py").value) == plain
    module = made()
    module.real = module.unread = 7.0  # an attribute that is named, and a global that is not
    assert contents_of(module.value) == plain


def test_numbers_that_are_equal_and_not_the_same():
    numbers = [1, 1.0, True, np.float64(1), np.float32(1), 1 + 0j, "1", b"1", 0.0, -0.0, math.nan, None, (), [], {}]
    numbers += [(1, 2), [1, 2], {1, 2}, frozenset((1, 2)), {1: 2, 3: 4}, {3: 4, 1: 2}, np.array(1), np.array([1])]
    numbers += [np.array([(1, 2)], dtype=[(name, "i4"), ("c", "i4")]) for name in "ab"]
    numbers += [np.array([1, "a"], dtype=object), np.array([1, "b"], dtype=object), np.ones((2, 3)).T, np.ones((3, 2))]
    assert len({contents_of(lambda number=number: number).digest for number in numbers}) == len(numbers)


def test_what_cannot_be_followed_is_named():
    library = ctypes.CDLL(None)
    for function in (
        lambda y: library.abs(y),
        lambda y: eval("y"),
        lambda y: open("file").read(),
        types.FunctionType(made().value.__code__, {**vars(made()), "helper": (one for one in ())}),
    ):
        assert contents_of(function).unknown
    assert not contents_of(lambda y: np.sin(y) + math.erf(y) + np.linalg.norm([y]) + len(np.fft.fft([y]))).unknown


def test_structures_that_contain_themselves():
    loop = [1.0]
    loop.append(loop)

    def one(y):
        return other(y) + loop[0]

    def other(y):
        return one(y) if y > 0 else 0.0

    before = contents_of(one)
    assert not before.unknown and before == contents_of(one)
    loop[0] = 2.0
    assert contents_of(one) != before


@pytest.mark.long
def test_every_process_has_the_same_digests():
    code = "from test_function_contents import contents_of, made; print(contents_of(made().value).digest)"
    here = contents_of(made().value).digest
    for seed in ("1", "2"):
        environment = {"PYTHONHASHSEED": seed, "PYTHONPATH": f"{Path(co.__file__).parents[1]}:{Path(__file__).parent}"}
        done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
        assert done.stdout.strip() == here


STALE = """
import numpy as np, numba
K, A = 2.0, np.ones(20_000)
@numba.njit
def deepest(y): return K * y
@numba.njit
def helper(y): return deepest(y) * A[0]
def value(y): return 0.5 * helper(y) * y
def slope(y): return helper(y)
"""


@pytest.mark.long
def test_machine_code_follows_every_edit_also_of_the_same_system():
    pytest.importorskip("numba")
    module = types.ModuleType("user_functions_of_a_test")
    exec(STALE, vars(module))
    system = co.LiePoissonSystem(co.algebras.so(3), co.Separable({0: (module.value, module.slope)}))

    def angle():
        end = co.integrate(system, [0.3, 1.0, 0.0], (0.0, 0.5), 0.5, co.Splitting()).x[-1]
        return abs(math.atan2(end[2], end[1]))

    def rate():
        return module.K * module.A[0] * 0.3 * 0.5

    assert module.helper(1.0) == 2.0  # has machine code of its own
    ready = co.prepare(system, co.Splitting(), 0.5)
    first = ready.run([0.3, 1.0, 0.0], (0.0, 0.5)).x[-1]
    for edit in (
        lambda: None,
        lambda: module.A.__setitem__(0, 3.0),
        lambda: setattr(module, "K", 1.0),
        lambda: exec("import numba\n@numba.njit\ndef deepest(y): return 0.5 * K * y", vars(module)),
    ):
        edit()
        expected = rate() * (0.5 if module.deepest.py_func(1.0) != module.K else 1.0)
        assert angle() == pytest.approx(expected, rel=1e-14)
    np.testing.assert_array_equal(ready.run([0.3, 1.0, 0.0], (0.0, 0.5)).x[-1], first)


@pytest.mark.long
def test_a_step_follows_what_it_reads():
    pytest.importorskip("numba")
    names = {"co": co}
    exec(
        "K = 1.0\n"
        "class Euler(co.methods.StepMethod):\n"
        "    order, explicit, symmetric = 1, True, False\n"
        "    def properties(self, system):\n"
        "        return co.methods.Properties(poisson=False, energy=False, casimirs='none', attitude='none')\n"
        "    def step(self, system, x, t, h):\n"
        "        return x + K * h * system.vector_field(x, t)\n",
        names,
    )
    body, x = co.systems.rigid_body(inertia=(1, 2, 3)), np.array([1.0, 0.5, 0.25])
    for names["K"] in (1.0, 0.5):
        end = co.integrate(body, x, (0.0, 0.125), 0.125, names["Euler"]()).x[-1]
        np.testing.assert_allclose(end, x + names["K"] * 0.125 * body.vector_field(x), rtol=0, atol=1e-15)


def test_what_cannot_be_followed_is_compiled_again_with_a_warning():
    pytest.importorskip("numba")
    library = ctypes.CDLL(None)
    library.labs.restype, library.labs.argtypes = ctypes.c_long, [ctypes.c_long]
    absolute = library.labs
    system = co.LiePoissonSystem(
        co.algebras.so(3), co.Separable({0: (lambda y: y * absolute(-1), lambda y: 1.0 * absolute(-1))})
    )
    with pytest.warns(UserWarning, match="compiled again whenever it is prepared"):
        co.prepare(system, co.Splitting(), 0.1)


def squares(x):
    return 0.5 * np.sum(np.arange(1.0, len(x) + 1.0) * x**2)


def slopes(x):
    return np.arange(1.0, len(x) + 1.0) * x


@pytest.mark.parametrize("order", [1, -1])
def test_one_function_serves_systems_of_several_dimensions(order):
    """As Hamiltonian, as invariant and as what is observed; the first use compiles it for one dimension alone."""
    algebras = [co.algebras.so(3), co.algebras.e(3), co.algebras.so(5)][::order]
    for g in algebras:
        x0 = np.linspace(0.1, 0.9, g.dim)
        plain = co.LiePoissonSystem(g, co.Quadratic(np.arange(1.0, g.dim + 1)))
        own = co.LiePoissonSystem(g, co.Hamiltonian(squares, slopes))
        wanted = co.integrate(plain, x0, (0, 1), 0.125, co.GaussLegendre(2))
        found = co.integrate(own, x0, (0, 1), 0.125, co.GaussLegendre(2), observe={"squares": squares})
        np.testing.assert_allclose(found.x, wanted.x, rtol=0, atol=1e-12)
        np.testing.assert_allclose(found.observed["squares"], wanted.energy, rtol=1e-12)

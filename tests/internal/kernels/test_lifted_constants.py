"""Floats that functions close over are data: others compile nothing, and the values are those of constants."""

import json
import pickle
import subprocess
import sys
import types
from contextlib import suppress
from dataclasses import replace

import numba
import numpy as np
import pytest

import coadjoint as co
from coadjoint.kernels.functions import compilation, contents, machine_code
from coadjoint.kernels.functions.compiled_functions import compiled_function
from coadjoint.kernels.tables.forces import _ForceTableBuilder
from matrix.forces import FIRST_FITTING, force_on

SIZE = 3
X, T = np.array([0.7, -1.3, 2.1]), 0.375
HELD = types.ModuleType("held_by_a_test")


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(compilation, "_COMPILED", {})
    monkeypatch.setattr(compilation, "_CONSTANT", {})


def values_of(function, timed=True):
    one = compiled_function(function, SIZE, SIZE, scalar=False, flat=True, timed=timed, what="the test function")
    return one.values(X, T, SIZE)


def scaled(a):
    @numba.njit(error_model="numpy")
    def product(y, by=a + 1.0):
        return a * y + by

    return product


def nested(a):
    inner, other = scaled(a), scaled(2.0 * a)

    @numba.njit(error_model="numpy")
    def both(y):
        return inner(y) - other(y) * a

    return both


def floats(a):
    return lambda x, t: np.array([a * x[0], x[1] / a + t, a ** x[2]])


def arrays(a):
    v, m = a * np.arange(1.0, 4.0), a * np.arange(9.0).reshape(3, 3)
    return lambda x, t: m[1] * x + m[:, 2] + v * t + m.sum() + v[-1]


def cubes(a):
    c = a + np.arange(24.0).reshape(2, 3, 4)
    return lambda x, t: c[1, :, 2] * x - c[0, 2, 1:] * t


def complex_numbers(a):
    z, w = a + 0.5j, a * np.arange(6.0).reshape(2, 3) + 1j * np.arange(3.0)
    return lambda x, t: (z * w[1] * x + w[0] * t).real - (z * x).imag


def tuples(a):
    w = (a, 2.0 * a, 0.5)
    return lambda x, t: np.array([w[0] * x[0], w[1] - x[1], w[2] + len(w)])


def defaults(a):
    return lambda x, t, b=a, c=2.0 * a: b * x + c


def numpy_floats(a):
    b = np.float64(a)
    return lambda x, t: b * x


def helpers(a):
    first, second = scaled(a), nested(a + 1.0)
    return lambda x, t: np.array([first(x[0]), second(x[1]), first(t) * a])


def loops(a):
    count, weights = 3, np.linspace(a, 1.0, 3)

    def looped(x, t):
        total = 0.0 * x
        for k in range(count):
            if x[k] > a:
                total[k] += weights[k] * x[k]
            else:
                total[k] -= weights[k]
        return total

    return looped


def lists(a):
    return lambda x, t: np.array([a * y for y in x])


def shared(a):
    """The same helper is called by two functions, of which one reads the array that the other reads."""
    v, helper = np.array([a, 1.0, -a]), scaled(a)

    @numba.njit(error_model="numpy")
    def other(y, k):
        return helper(y) * v[k]

    return lambda x, t: np.array([other(x[0], 0), helper(x[1]), v[2] * other(t, 1)])


def renamed(a):
    helper = scaled(a)

    def function(x, t):
        other = helper
        return other(x[0]) * x

    return function


LIFTED = [
    floats,
    arrays,
    cubes,
    complex_numbers,
    tuples,
    defaults,
    numpy_floats,
    helpers,
    loops,
    lists,
    shared,
    renamed,
]


def in_tuples(a):
    functions = (scaled(a), scaled(a))
    return lambda x, t: np.array([functions[0](x[0]), x[1], functions[1](t)])


def by_keyword(a):
    helper = scaled(a)
    return lambda x, t: np.array([helper(y=x[0]), helper(x[1], by=t), a])


def given_defaults(a):
    helper = scaled(a)
    return lambda x, t: np.array([helper(x[0], t), helper(x[1], a), helper(x[2])])


def star(a):
    return lambda *both: a * both[0] + both[1]


def integers(a):
    n = int(8 * a)
    return lambda x, t: n * x


def other_layouts(a):
    columns, single = np.asfortranarray(a * np.arange(9.0).reshape(3, 3)), np.array([a, 1.0, 2.0], dtype=np.float32)
    return lambda x, t: columns[:, 1] * x + single * t


def in_modules(a):
    HELD.helper = scaled(a)
    return lambda x, t: np.array([HELD.helper(x[0]), a, t])


COMPILED_IN = [in_tuples, by_keyword, given_defaults, star, integers, other_layouts, in_modules]


@pytest.mark.filterwarnings("ignore::numba.NumbaExperimentalFeatureWarning")
@pytest.mark.parametrize("make", [*LIFTED, *COMPILED_IN])
def test_other_constants_give_the_values_of_a_function_of_their_own(make, compiled):
    counts = []
    for a in (0.75, -0.5):
        function = make(a)
        assert np.array_equal(values_of(function), np.ravel(numba.njit(error_model="numpy")(function)(X, T)), True), a
        counts.append(len(compiled))
    assert (counts[0] == counts[-1]) == (make in LIFTED)
    if make in LIFTED:
        assert counts[0] == 1


def energy_on_so3(energy):
    system = co.LiePoissonSystem(co.algebras.so(3), energy)
    return co.integrate(system, X, (0, 0.5), 0.125, co.GaussLegendre(2)).x[-1]


def multiplied(factor):
    def gradient(x):
        return factor * np.array([2 * x[0] * x[1], x[0] ** 2, 0.0])

    return co.Hamiltonian(lambda x: factor * (x[0] ** 2 * x[1]), gradient)


def test_a_multiple_has_its_factor_as_data(compiled):
    energy, counts = multiplied(1.0), []
    for factor in (0.5, 0.3):
        assert np.abs(energy_on_so3(factor * energy) - energy_on_so3(multiplied(factor))).max() < 1e-15
        counts.append(len(compiled))
    assert counts[0] == counts[1]


def test_constants_are_those_of_the_time_at_which_a_function_was_compiled():
    v = np.array([1.0, 2.0, 3.0])
    one = compiled_function(lambda x: v * x, SIZE, SIZE, scalar=False, flat=True, timed=False, what="f")
    v[:] = 7.0
    assert np.array_equal(one.values(X, T, SIZE), [1.0, 2.0, 3.0] * X)
    assert np.array_equal(values_of(lambda x: v * x, timed=False), 7.0 * X)


OTHER_PROCESS = """
import json, sys, numba
import numpy as np
from coadjoint.kernels.functions.compiled_functions import compiled_function
calls = []
original = numba.cfunc
numba.cfunc = lambda *given, **options: calls.append(given) or original(*given, **options)
def made(a):
    @numba.njit
    def helper(y):
        return np.sin(a * y) ** a
    @numba.njit
    def raising(x):
        print("called", a, x)
        if x[0] < 0.0:
            raise ValueError("negative", x[0])
        return x + x[:2].repeat(2)[:3]
    m = a * np.eye(3)
    return lambda x, t: m @ raising(x) + np.linalg.solve(m + np.ones((3, 3)), x) + helper(t) + np.exp(x).reshape(3)
found = []
for a in json.loads(sys.argv[1]):
    one = compiled_function(made(a), 3, 3, scalar=False, flat=True, timed=True, what="f")
    found.append([one.values([x, 0.2, 0.3], 0.5, 3).tolist() for x in (0.1, -0.1)])
print(json.dumps([len(calls), found]))
"""


def in_another_process(*numbers):
    """Return what functions print, how many are compiled, and their values."""
    process = subprocess.run(
        [sys.executable, "-c", OTHER_PROCESS, json.dumps(numbers)],
        capture_output=True,
        text=True,
        timeout=300,
        check=True,
    )
    *printed, last = process.stdout.splitlines()
    return printed, *json.loads(last)


def test_another_process_compiles_nothing():
    """Memory of Numba's, products of BLAS, functions of the library of mathematics, and what functions raise and print,
    objects of a process, are found there.
    """
    (_, first, found), (printed, second, again) = in_another_process(0.5, 0.25), in_another_process(0.25, 0.5)
    assert (first, second) == (1, 0) and str(found) == str(again[::-1])
    states = [np.array([x, 0.2, 0.3]) for x in (0.1, -0.1)]
    assert printed == [f"called {a} {x}" for a in (0.25, 0.5) for x in states]
    assert all(np.isfinite(inside).all() and np.isnan(below).all() for inside, below in again)


def test_other_settings_damaged_files_and_folders_of_others_compile(tmp_path, monkeypatch, compiled):
    def is_compiled():
        """Whether a function is compiled by a process that has compiled none."""
        monkeypatch.setattr(compilation, "_COMPILED", {})
        before = len(compiled)
        assert np.array_equal(values_of(lambda x, t: 0.75 * x + t), 0.75 * X + T)
        return len(compiled) - before == 1

    assert is_compiled() and not is_compiled()
    (file,) = (tmp_path / "coadjoint").glob("*.function")
    content = file.read_bytes()
    with monkeypatch.context() as other:
        other.setattr(numba.config, "LOOP_VECTORIZE", 1 - numba.config.LOOP_VECTORIZE)
        assert is_compiled()
    assert not is_compiled()
    file.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    assert is_compiled()
    (tmp_path / "coadjoint").chmod(0o777)
    assert is_compiled()


@pytest.mark.parametrize(("size", "stored"), [(8, True), (200_000, False)])
def test_code_with_addresses_of_its_process_is_not_stored(size, stored):
    """Numba compiles the address of a large global array into machine code."""
    table = np.linspace(0.0, 1.0, size)

    def read(y, t, out, constants):
        out[0] = table[size - 1]

    callback = numba.cfunc(compilation.SIGNATURE)(read)
    assert (machine_code._content_of(callback) is not None) == stored


def test_code_that_needs_what_a_process_has_not_is_compiled():
    callback = numba.cfunc(compilation.SIGNATURE)(lambda y, t, out, constants: None)
    content = machine_code._content_of(callback)
    assert machine_code._loaded(content) is not None
    size = int.from_bytes(content[:8], "little")
    name, needed, constants = pickle.loads(content[8 : 8 + size])
    head = pickle.dumps((name, [*needed, "no_such_symbol_anywhere"], constants))
    assert machine_code._loaded(len(head).to_bytes(8, "little") + head + content[8 + size :]) is None


def functions_of_forces():
    """Yield two functions of each registered force that has one, at other numbers."""
    for number in (0, 1):
        for name in co.forces.names():
            plain = FIRST_FITTING[number]()
            with suppress(TypeError, ValueError):
                force = force_on(name, plain)
                found = []
                for factor in (1.0, 1.25):
                    changed = {
                        field: factor * getattr(force, field)
                        for field in force.__dataclass_fields__
                        if isinstance(getattr(force, field), float)
                    }
                    system = plain.with_forces(replace(force, **changed))
                    reader = _ForceTableBuilder(system.unforced, 0, 0, 2, compiles=False)
                    system.flows[0][1].describe_to(reader, system.unforced)
                    found.append(reader.called)
                if None not in found:
                    yield f"{name} {number}", found


def test_the_structure_of_functions_of_the_library_gives_their_digest(monkeypatch):
    monkeypatch.setattr(contents, "_DIGESTS", {})
    found = dict(functions_of_forces())
    assert len(found) > 8
    for name, pair in found.items():
        for function in pair:
            expected, quick = contents._lifted_contents(function), contents.lifted_contents(function)
            assert quick.digest == expected.digest, name
            assert quick.constants.tobytes() == expected.constants.tobytes(), name
            assert quick.places == expected.places, name
    # One of the library that calls one of the user has no entry: what that reads may change.
    assert 4 < len(contents._DIGESTS) <= len(found)


def test_functions_of_the_library_with_other_whole_numbers_have_other_digests():
    def made(n, closes_over):
        def by_default(x, n=n):
            return n * x[0]

        def by_closure(x):
            return n * x[0]

        found = by_closure if closes_over else by_default
        found.__module__ = contents.__name__
        return found

    for closes_over in (False, True):
        digests = [contents.lifted_contents(made(n, closes_over)).digest for n in (2, 3, 2)]
        assert digests[0] == digests[2] != digests[1]

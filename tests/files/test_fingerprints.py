"""Fingerprints of functions and systems: comparison across versions, and dependence on every part."""

import functools
import itertools

import numpy as np
import pytest

import coadjoint as co
from coadjoint.files.records.fingerprints import fingerprint_of, functions_in, same_fingerprint, system_contents
from coadjoint.systems.matrices.streams import Inverse, Weights
from coadjoint.systems.matrices.two_layer_system import TwoLayerSystem

NEW = {"python": "3.12", "code": "a", "text": "b", "contents": "c", "written": "d", "unknown": []}
OLD = {name: NEW[name] for name in ("python", "code", "text")}


@pytest.mark.parametrize(
    ("one", "other", "same"),
    [
        # One version of Python: the values that functions read.
        (NEW, NEW | {"code": "z", "text": "z", "written": "z"}, True),
        (NEW, NEW | {"contents": "z"}, False),
        # Two versions of Python: the source text, if there is one.
        (NEW, NEW | {"python": "3.13", "contents": "z", "code": "z", "text": "z"}, True),
        (NEW, NEW | {"python": "3.13", "written": "z"}, False),
        (NEW | {"written": None}, NEW | {"written": None, "python": "3.13"}, False),
        (NEW | {"written": None}, NEW | {"written": None}, True),
        # Earlier versions of the library stored the first digests only.
        (OLD, NEW | {"text": "z"}, True),
        (OLD, NEW | {"code": "z"}, False),
        (OLD, NEW | {"python": "3.13", "code": "z"}, True),
        (OLD, NEW | {"python": "3.13", "text": "z"}, False),
        (OLD | {"text": None}, NEW | {"python": "3.13", "text": None}, False),
        (OLD | {"text": None}, NEW | {"text": None}, True),
    ],
)
def test_comparison_of_fingerprints(one, other, same):
    assert same_fingerprint(one, other) == same and same_fingerprint(other, one) == same


def test_module_of_events_is_fixed():
    """Fingerprints contain the module of a class: a move of this one would refuse the events of stored runs."""
    assert co.Event.__module__ == "coadjoint.runs.events"


FACTOR, TABLE = 2.0, np.array([1.0, 2.0])


def helper(y):
    return 3.0 * y


def read_by_name(y):
    return FACTOR * y + TABLE[0] + helper(y)


def closed(a):
    return lambda y: a * y


def nested(y):
    def inside(z):
        return FACTOR * z

    return inside(y)


def with_defaults(y, a=1.0, *, b=2.0):
    return a * y + b


class Machine:
    def __init__(self, own):
        self.own = own

    def __call__(self, y):
        return self.own * y

    def method(self, y):
        return self.own + y

    @functools.cached_property
    def cached(self):
        return self.own


def earlier_fingerprint(value):
    found = fingerprint_of(value)
    return {name: found[name] for name in ("python", "code", "text")}


def same_by_code_and_text(one, other):
    """Return whether two values are equal by the code and by the text of earlier versions."""
    one, other = earlier_fingerprint(one), earlier_fingerprint(other)
    return same_fingerprint(one, other), same_fingerprint(one, other | {"python": "another"})


def doubled(y):
    return 2.0 * y


def tripled(y):
    return 3.0 * y


def sine(y):
    return np.sin(y)


def cosine(y):
    return np.cos(y)


def renamed(function):
    """Return a function with the name of another one, which has another text."""
    function.__name__ = "renamed"
    return function


VALUES = {
    "constants": (renamed(doubled), renamed(tripled)),
    "names": (renamed(sine), renamed(cosine)),
    "closures": (closed(1.0), closed(2.0)),
    "kinds of numbers": (closed(1.0), closed(1)),
    "arrays": (closed(np.zeros(2)), closed(np.zeros((2, 1)))),
    "kinds of arrays": (closed(np.zeros(2, np.float32)), closed(np.zeros(1))),
    "entries": (closed(np.array([1.0, 2.0, 3.0])), closed(np.array([1.0, 2.0, 4.0]))),
    "tables": (closed({"a": 1, "b": 2}), closed({"a": 2, "b": 1})),
    "sets": (closed({1, 2}), closed({1, 3})),
    "lists": (closed([1, [2, 3]]), closed([1, [3, 2]])),
    "partial arguments": (functools.partial(helper, 1.0), functools.partial(helper, 2.0)),
    "partial keywords": (functools.partial(helper, y=1.0), functools.partial(helper, y=2.0)),
    "objects": (Machine(1.0), Machine(2.0)),
    "methods": (Machine(1.0).method, Machine(2.0).method),
    "functions of libraries": (np.sin, np.cos),
    "polynomials": (co.Polynomial({(1, 0): 1}), co.Polynomial({(1, 0): 2})),
}


@pytest.mark.parametrize("kind", VALUES)
def test_earlier_fingerprints_distinguish_values(kind):
    one, other = VALUES[kind]
    assert same_by_code_and_text(one, one) == same_by_code_and_text(other, other) == (True, True)
    assert same_by_code_and_text(one, other) == (False, False)


@pytest.mark.parametrize("change", ["a number", "an array", "a function", "nested", "a default", "a keyword"])
def test_earlier_fingerprints_include_global_names(monkeypatch, change):
    read = {"nested": nested, "a default": with_defaults, "a keyword": with_defaults}.get(change, read_by_name)
    before = earlier_fingerprint(read)
    if change in ("a number", "nested"):
        monkeypatch.setitem(globals(), "FACTOR", 2.5)
    elif change == "an array":
        monkeypatch.setitem(globals(), "TABLE", np.array([1.0, 2.5]))
    elif change == "a function":
        monkeypatch.setitem(globals(), "helper", with_defaults)
    elif change == "a default":
        monkeypatch.setattr(with_defaults, "__defaults__", (1.5,))
    else:
        monkeypatch.setattr(with_defaults, "__kwdefaults__", {"b": 1.5})
    after = earlier_fingerprint(read)
    assert before["code"] != after["code"] and before["text"] != after["text"]


def test_cached_properties_are_ignored():
    machine = Machine(1.0)
    before = fingerprint_of(machine)
    assert machine.cached == 1.0
    after = fingerprint_of(machine)
    assert same_fingerprint(before, after) and before["code"] == after["code"] and before["text"] == after["text"]


def test_functions_without_source_have_no_text():
    names: dict = {}
    exec("def created(y):\n    return 2 * y", names)
    found = fingerprint_of(names["created"])
    assert found["text"] is None and found["written"] is None and found["code"]


def well(y):
    return 0.5 * y * y


def slope(y):
    return y


def steeper(y):
    return 1.5 * y


SO3, SL2 = co.algebras.so(3), co.algebras.sl(2)
FLUID, SPHERE = co.systems.torus_euler(3), co.systems.sphere_euler(3)


class OwnStream(Weights):
    """A stream of another package, which records do not contain."""


def layers(second):
    return TwoLayerSystem(SPHERE.algebra, SPHERE.stream, second)


def matrices(linear=None, energy_sign=1, stream=None):
    return co.MatrixSystem(FLUID.algebra, stream or FLUID.stream, linear, energy_sign=energy_sign)


def separable(hamiltonian, **kwargs):
    return co.LiePoissonSystem(SO3, hamiltonian, **{"name": "mine", **kwargs})


def bodies():
    return [co.systems.rigid_body((1, 2, c)) for c in (2.5, 3.0)]


def systems():
    """Yield systems that differ from each other in one part."""
    one = co.Separable({0: (well, slope)})
    square = {"C": co.Polynomial({(2, 0, 0): 1, (0, 2, 0): 1, (0, 0, 2): 1})}
    yield separable(one)
    yield separable(co.Separable({1: (well, slope)}))
    yield separable(co.Separable({0: (lambda y: 0.75 * y * y, steeper)}))
    yield separable(one, sign=-1)
    yield separable(one, name="yours")
    yield separable(one, casimirs=square)
    yield separable(one, casimirs={"C": 2 * square["C"]})
    yield separable(one, casimirs={"C": lambda x: x @ x})
    yield separable(one, casimirs={"C": lambda x: 2 * (x @ x)})
    yield co.LiePoissonSystem(SL2, one, name="mine")
    first, second = bodies()
    yield first
    yield second
    yield co.batch([first, first])
    yield co.batch([first, second])
    yield co.batch([second, first])
    yield first.with_forces(co.forces.LinearDamping(0.1))
    yield first.with_forces(co.forces.LinearDamping(0.2))
    yield first.with_forces(co.forces.DoubleBracketDamping(0.1))
    yield first.with_forces(co.forces.LinearDamping(0.1), co.forces.DoubleBracketDamping(0.1))
    yield second.with_forces(co.forces.LinearDamping(0.1))
    yield FLUID
    yield co.systems.torus_euler(5)
    yield matrices()
    yield matrices(linear=FLUID.random(seed=1))
    yield matrices(energy_sign=-1)
    yield layers(None)
    yield layers(SPHERE.stream)
    yield layers(Inverse(SPHERE.stream))
    yield layers(OwnStream(np.full((3, 3), 2.0)))
    yield layers(OwnStream(np.full((3, 3), 3.0)))


def test_fingerprints_depend_on_every_part():
    found = [fingerprint_of(system_contents(system)) for system in systems()]
    again = [fingerprint_of(system_contents(system)) for system in systems()]
    for (j, one), (k, other) in itertools.product(enumerate(found), enumerate(again)):
        # Functions are created anew for the second list.
        assert same_fingerprint(one, other) == (j == k), (j, k)


def test_names_of_unstored_functions():
    known = [functions_in(system) for system in systems()]
    hamiltonians = [["hamiltonian: well"]] * 2 + [["hamiltonian: <lambda>"]] + [["hamiltonian: well"]] * 7
    for k in (7, 8):
        hamiltonians[k] = [*hamiltonians[k], "casimir: C"]
    assert known == [*hamiltonians, *[[]] * (len(known) - 12), *[["stream: OwnStream"]] * 2]

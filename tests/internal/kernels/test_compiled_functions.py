"""Functions compiled to a fixed signature: what is refused, and what is compiled once."""

import pytest

from coadjoint.kernels.functions import compilation
from coadjoint.kernels.functions.compiled_functions import compiled_function
from coadjoint.kernels.tables import steps
from refusals import refused

pytestmark = pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")


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


def product(a, b):
    return a * b


def inner(y):
    return 2.0 * y


@pytest.fixture
def made(monkeypatch):
    """Nothing is compiled: each compilation is an object of its own, with its arguments."""

    class Made(tuple):
        @property
        def address(self):
            return id(self)

        __hash__, __eq__ = object.__hash__, object.__eq__

    for module, name in ((compilation, "_compiled"), (steps, "_adapted_stream"), (compilation, "_compiled_function")):
        monkeypatch.setattr(module, name, lambda *given: Made(given))
    monkeypatch.setattr(compilation, "stored_or_compiled", lambda key, compiled: compiled())
    monkeypatch.setattr(compilation, "_COMPILED", {})


def step_of(**given):
    found, reason = compilation.compiled_step(**given)
    assert reason == ""
    return found


CACHED = {
    "functions": (
        lambda **given: compilation.callback_of(**given)[0],
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
    assert [one.address for one in found] == [one.address for one in reversed(again)]
    assert len({one.address for one in found}) == len(calls)
    if "what" in base:
        assert make(**base) is make(**{**base, "what": "another name"})

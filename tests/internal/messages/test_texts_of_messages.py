"""Texts of messages: nearest names, one line of bounded length, and representations of any value."""

import inspect
import pickle
import re
from fractions import Fraction
from operator import attrgetter

import numpy as np
import pytest

import coadjoint as co
from coadjoint.errors import (
    MAX_LISTED_NAMES,
    MAX_MESSAGE_LENGTH,
    OneLineError,
    in_one_line,
    nearest,
    unknown_attribute,
    unknown_name,
)
from coadjoint.keyword_hints import vocabulary
from coadjoint.short_repr import short
from guards import bounded_work

NAMES = ["rigid_body", "heavy_top", "lagrange_top", "so(3)", "GaussLegendre", "Splitting", "toda", "spin_lattice"]


@pytest.mark.parametrize(
    ("name", "found"),
    [
        ("rigid_bodi", "rigid_body"),
        ("SO(3)", "so(3)"),
        ("RIGID_BODY", "rigid_body"),
        ("gausslegendre", "GaussLegendre"),
        ("Gauss", "GaussLegendre"),
        ("tops", "toda"),
        ("body", "rigid_body"),
        ("lattices", "spin_lattice"),
        ("agrange", "lagrange_top"),
        ("qqq", None),
        ("", None),
        ("s", None),
        ("rigid_body" * 10**5, "rigid_body"),
        ("x" * 10**6, None),
    ],
)
def test_nearest_name(name, found):
    with bounded_work():
        for known in (NAMES, NAMES[::-1]):
            assert nearest(name, known) == found
    assert nearest(name, []) is None


def test_the_shortest_name_or_one_equal_up_to_case_is_nearest():
    assert nearest("spin", ["a_spin_lattice", "spin_of_many", "the_spin"]) == "the_spin"
    assert nearest("spins", ["lattice_of_many_spin_vectors", "toda"]) == "lattice_of_many_spin_vectors", "a plural"
    assert nearest("splitting", ["Splitting", "splittings"]) == "Splitting", "equal up to case first"


FEW, MANY = [f"name{k}" for k in range(MAX_LISTED_NAMES)], [f"name{k:03}" for k in range(MAX_LISTED_NAMES + 1)]
MODULE = "co.a has no attribute "


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (unknown_name("kind", "zzz", FEW), f"unknown kind 'zzz'; there are: {', '.join(sorted(FEW))}"),
        (unknown_name("kind", "nme017", MANY), "unknown kind 'nme017'; did you mean 'name017'?"),
        (unknown_name("kind", 3, ["b", "a"]), "unknown kind 3; give a name, such as 'a'"),
        (unknown_attribute("co.a", "zzz", ["b", "c"]), f"{MODULE}'zzz'. It has: b, c"),
        (unknown_attribute("co.a", "__path__", ["b"]), f"{MODULE}'__path__'"),
        (unknown_attribute("co.a", "Splitting", ["b"]), f"{MODULE}'Splitting'; it is co.Splitting"),
        (unknown_attribute("coadjoint", "Splitting", ["b"]), "coadjoint has no attribute 'Splitting'. It has: b"),
        (
            unknown_attribute("co.a", "NAME001", MANY),
            f"{MODULE}'NAME001'; did you mean 'name001'? dir(co.a) lists what it has",
        ),
    ],
)
def test_unknown_names_are_listed_or_suggested(error, message):
    assert str(error) == message and type(error) is (AttributeError if "attribute" in message else type(error))
    suggested = str(unknown_name("kind", "zzz", MANY)).removeprefix("unknown kind 'zzz'; did you mean '")
    assert suggested.removesuffix("'?") in MANY


@pytest.mark.parametrize("limit", [20, 21, 60, 400, 401])
def test_long_messages_are_shortened_in_the_middle(limit):
    for size in (0, 1, limit - 1, limit, limit + 1, 2 * limit, 10 * limit, 10**5):
        text = "".join(chr(ord("a") + k % 26) for k in range(size))
        line = in_one_line(text, limit)
        assert len(line) <= limit
        if size <= limit:
            assert line == text
        else:
            head, tail = line.split(" ... ")
            assert text.startswith(head) and text.endswith(tail) and limit - 1 <= len(line)
            assert abs(len(head) - len(tail)) <= 1 and head and tail
    words = in_one_line("a bc def " * limit, limit)
    assert in_one_line(words, limit) == words and "  " not in words, "also blanks beside the omitted part"
    assert in_one_line(" a\n  b\t\rc\x1b[31m\0d\u2028e ", limit) == "a b c?[31m?d e"[:limit]
    with bounded_work():
        assert in_one_line("\x00" * 10**7 + "end", limit).endswith("?end")


def test_one_line_errors():
    error = OneLineError("a\nb " * 1000)
    assert len(str(error)) <= MAX_MESSAGE_LENGTH and "\n" not in str(error) and isinstance(error, ValueError)
    assert str(pickle.loads(pickle.dumps(error))) == str(error)


def test_what_hints_name_exists():
    known = {*inspect.signature(co.integrate).parameters, *inspect.signature(co.systems.rigid_body).parameters}
    for keyword, answer in vocabulary("arguments").items():
        name, equals, _ = answer.partition("=")
        assert keyword not in inspect.signature(co.integrate).parameters
        assert equals and name in known, keyword
    run = co.integrate(co.systems.rigid_body(), (1.0, 0.1, 0.2), (0, 0.5), 0.25)
    attributes, functions = vocabulary("attributes of solutions"), vocabulary("functions")
    for name, answer in attributes.items():
        first = re.split(r"[,( ]", answer)[0]
        assert (hasattr(type(run), first) or hasattr(run, first)) and not hasattr(run, name), answer
    arguments = vocabulary("arguments") | vocabulary("arguments elsewhere")
    for answer in {*functions.values(), *arguments.values(), *attributes.values()}:
        for name in re.findall(r"\bco\.([\w.]*\w)", answer):
            attrgetter(name)(co)  # an AttributeError has the name
        for name in re.findall(r"\bsol\.(\w+)", answer):
            assert hasattr(co.Solution, name), answer
    assert all("co." in answer for answer in functions.values())
    assert set(vocabulary("pictures").values()) <= set(co.plotting.kinds())


def represented(text):
    def show(self):
        if text is None:
            raise RuntimeError("no")
        return text

    return type("Object", (), {"__repr__": show})()


RAISES, NO_STRING = represented(None), represented(3)
ITSELF, DEEP = [], []
ITSELF.append(ITSELF)
for _ in range(100_000):
    DEEP = [DEEP]
HOSTILE = {
    "a long list": list(range(10**6)),
    "a long tuple of long strings": ("x" * 10**6,) * 1000,
    "a large dict": dict.fromkeys(range(10**5)),
    "a large set": set(range(10**5)),
    "a large frozenset": frozenset(range(10**5)),
    "a deep list": DEEP,
    "a list of itself": ITSELF,
    "a wide tree": [[[[list(range(1000))] * 1000] * 1000] * 1000] * 1000,
    "a large int": 10**100_000,
    "a negative one": -(10**4400),
    "a large fraction": Fraction(10**5000, 3),
    "large ints in a list": [10**100_000] * 3,
    "a large array": np.ones(10**6),
    "an array of many dimensions": np.ones((7,) * 7),
    "an array of objects": np.array([[10**5000, RAISES], [NO_STRING, list(range(10**6))]], dtype=object),
    "a masked array": np.ma.masked_array(np.ones(10**5)),
    "a masked array of objects": np.ma.masked_array(np.array([RAISES, 1], dtype=object)),
    "records": np.zeros(3, dtype=[(f"field {i}", float) for i in range(1000)]),
    "bytes": b"\0" * 10**6,
    "a bytearray": bytearray(10**6),
    "a repr that raises": RAISES,
    "such a class in a dict": {RAISES: [RAISES]},
    "a repr that is no string": NO_STRING,
    "a long repr": represented("x" * 10**6),
    "lines and a terminal code": represented("a\n  b\x1b[31m"),
    "a string of lines": "a\nb\x1b" * 1000,
}


@pytest.mark.parametrize("limit", [4, 20, 80, 200])
@pytest.mark.parametrize("name", HOSTILE)
def test_any_value_is_one_short_line(name, limit):
    with bounded_work():
        text = short(HOSTILE[name], limit)
    assert 0 < len(text) <= limit
    assert text.isprintable()


@pytest.mark.parametrize("limit", [4, 10, 80])
def test_representations_fill_the_limit(limit):
    """Strings, lists and integers around the limit: in full, or their beginning up to the limit."""
    for size in range(1, 2 * limit + 4):
        for value in ("x" * size, [7] * size, (1.5,) * size, 10 ** (size - 1), b"x" * size, dict.fromkeys(range(size))):
            text, expected = short(value, limit), repr(value)
            if isinstance(value, int) and size > limit - 2:
                assert text == expected or text.startswith("<int of about"[: limit - 3])
            elif len(expected) <= limit:
                assert text == expected
            else:
                assert text.endswith("...") and len(text) <= limit and expected.startswith(text[:-3])
    assert short(10**60) == repr(10**60) and short(2**500) == "<int of about 151 digits>"


def test_functions_have_no_addresses():
    def own(x):
        return x

    for value, shown in (
        (own, "the function own"),
        (lambda x: x, "a lambda"),
        (np.sin, "the function sin"),
        ([own, own, own], "[the function own, the function own, the function own]"),
        ([own] * 4, "4 functions"),
        ([own, own, own, 1], "[the function own, the function own, the function own, 1]"),
        ([(own, own)] * 4, "4 functions"),
        ([(own, 1)] * 4, "[(the function own, 1), (the function own, 1), (the function own, 1), (the fu..."),
        (dict.fromkeys(range(4), own), "4 functions"),
        ({1: own}, "{1: the function own}"),
        ([[], [], [], []], "[[], [], [], []]"),
        ([[[[[[[1]]]]]]], "[[[[[[[...]]]]]]]"),
        ([[[[[[[]]]]]]], "[[[[[[[]]]]]]]"),
    ):
        assert short(value) == shown

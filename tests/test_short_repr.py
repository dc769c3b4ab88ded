"""Short representations of values from the user: one line, in bounded time."""

import dataclasses
import functools
from fractions import Fraction

import numpy as np
import pytest

from coadjoint.short_repr import dataclass_repr, function_name, html_table, short
from guards import bounded_work


class Raises:
    def __repr__(self):
        raise RuntimeError("no")


class NoString:
    def __repr__(self):
        return 3


class Endless:
    def __repr__(self):
        return "x" * 10**6


class ManyLines:
    def __repr__(self):
        return "a\n  b\x1b[31m"


def deep(levels):
    nested = []
    for _ in range(levels):
        nested = [nested]
    return nested


def itself():
    endless = []
    endless.append(endless)
    return endless


HOSTILE = {
    "a long list": list(range(10**6)),
    "a long tuple of long strings": ("x" * 10**6,) * 1000,
    "a large dict": dict.fromkeys(range(10**5)),
    "a large set": set(range(10**5)),
    "a large frozenset": frozenset(range(10**5)),
    "a deep list": deep(100_000),
    "a list of itself": itself(),
    "a wide tree": [[[[list(range(1000))] * 1000] * 1000] * 1000] * 1000,
    "a large int": 10**100_000,
    "a negative one": -(10**4400),
    "a large fraction": Fraction(10**5000, 3),
    "large ints in a list": [10**100_000] * 3,
    "a large array": np.ones(10**6),
    "an array of many dimensions": np.ones((7,) * 7),
    "an array of objects": np.array([[10**5000, Raises()], [NoString(), list(range(10**6))]], dtype=object),
    "a masked array": np.ma.masked_array(np.ones(10**5)),
    "a masked array of objects": np.ma.masked_array(np.array([Raises(), 1], dtype=object)),
    "records": np.zeros(3, dtype=[(f"field {i}", float) for i in range(1000)]),
    "bytes": b"\0" * 10**6,
    "a bytearray": bytearray(10**6),
    "a repr that raises": Raises(),
    "such a class in a dict": {Raises(): [Raises()]},
    "a repr that is no string": NoString(),
    "a long repr": Endless(),
    "lines and a terminal code": ManyLines(),
    "a string of lines": "a\nb\x1b" * 1000,
}


@pytest.mark.parametrize("limit", [4, 20, 80, 200])
@pytest.mark.parametrize("name", HOSTILE)
def test_any_value_is_one_short_line(name, limit):
    with bounded_work():
        text = short(HOSTILE[name], limit)
    assert 0 < len(text) <= limit
    assert text.isprintable()


@pytest.mark.parametrize(
    "value",
    [None, True, 3, -(2**64), 0.1, 1 + 2j, "text", b"text", bytearray(b"a"), [], (), {}, set(), frozenset(), (1,),
     [1, "a", [2.0]], {"a": 1, (0, 1): {2: 3.0}}, {1}, frozenset({1}), Fraction(1, 3), np.float64(2.0),
     np.array([1.0, 2.0]), range(3), int],
)  # fmt: skip
def test_small_values_have_their_repr(value):
    assert short(value) == repr(value)


def test_object_arrays_show_their_entries():
    assert short(np.array(["1", 2], dtype=object)) == "array(['1', 2], dtype=object)"


def test_list_subclass_is_cut_as_a_list():
    class Own(list):
        pass

    assert short(Own(range(10**6)), 12) == "[0, 1, 2,..."


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


def test_tables_escape_text():
    table = html_table("<b>&", {"<i>": "<td>", "two": ("<1>", 2), "none": ()})
    assert table == (
        "<table><caption><b>&lt;b&gt;&amp;</b></caption><tr><th>&lt;i&gt;</th><td>&lt;td&gt;</td></tr>"
        "<tr><th>two</th><td>&lt;1&gt;</td><td>2</td></tr><tr><th>none</th></tr></table>"
    )


def test_hidden_fields_are_omitted():
    @dataclasses.dataclass(repr=False)
    class Own:
        first: object
        second: object = dataclasses.field(default=1, repr=False)
        third: object = "c"

    assert dataclass_repr(Own([abs] * 5)) == "Own(first=5 functions, third='c')"
    assert function_name(functools.partial(functools.partial(max, 1), 2)) == "partial of max"
    assert function_name(functools.partial(Own([]).__class__, 1)) == "partial of Own"
    assert function_name(Own([])) == "a Own"

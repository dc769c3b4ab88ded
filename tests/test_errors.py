"""Errors: pickling, suggestions of names, and one-line messages of bounded length."""

import copy
import pickle
import re
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
from coadjoint.files.configuration.construction import ConfigurationError
from coadjoint.keyword_hints import (
    ATTRIBUTES,
    FUNCTIONS,
    KEYWORDS,
    PICTURES,
    suggest_keywords,
    unknown_keyword,
)
from coadjoint.pictures.register import kinds
from guards import bounded_work


@pytest.mark.parametrize("again", [copy.copy, copy.deepcopy, lambda error: pickle.loads(pickle.dumps(error))])
def test_copies_of_errors_have_all_parts(again):
    """Worker processes send errors back."""
    H = co.Polynomial({(4, 0, 0): 1.0, (0, 4, 0): 2.0, (0, 0, 4): 3.0})
    system = co.LiePoissonSystem(co.algebras.so(3), H)
    with pytest.raises(co.IntegrationError) as failure:
        co.integrate(system, np.array([[1e160, 1e160, 1e160], [0.1, 0.2, 0.3]]), (0.5, 1.5), 0.125, co.GaussLegendre(2))
    error = failure.value
    found = again(error)
    assert type(found) is co.IntegrationError and str(found) == str(error)
    assert (found.step, found.time) == (error.step, error.time) and error.time >= 0.5
    np.testing.assert_array_equal(found.residual, error.residual)
    np.testing.assert_array_equal(found.partial.x, error.partial.x)
    np.testing.assert_array_equal(found.partial.t, error.partial.t)
    parts = {"step": 3, "time": -0.2, "residual": 1e-3, "partial": ("part", 2), "derivatives": (1.0, 3)}
    error = co.IntegrationError("no", **parts)
    assert vars(again(error)) == vars(error) == parts


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


def test_shortest_containing_name_is_nearest():
    assert nearest("spin", ["a_spin_lattice", "spin_of_many", "the_spin"]) == "the_spin"
    assert nearest("spins", ["lattice_of_many_spin_vectors", "toda"]) == "lattice_of_many_spin_vectors", "a plural"
    assert nearest("splitting", ["Splitting", "splittings"]) == "Splitting", "equal up to case first"


def test_unknown_names_are_listed_or_suggested():
    few, many = [f"name{k}" for k in range(MAX_LISTED_NAMES)], [f"name{k:03}" for k in range(MAX_LISTED_NAMES + 1)]
    assert str(unknown_name("kind", "zzz", few)) == f"unknown kind 'zzz'; there are: {', '.join(sorted(few))}"
    suggested = str(unknown_name("kind", "zzz", many)).removeprefix("unknown kind 'zzz'; did you mean '")
    assert suggested.removesuffix("'?") in many
    assert str(unknown_name("kind", "nme017", many)) == "unknown kind 'nme017'; did you mean 'name017'?"
    assert str(unknown_name("kind", 3, ["b", "a"])) == "unknown kind 3; give a name, such as 'a'"


def test_missing_attributes_of_modules():
    few, many = ["heavy_top", "toda"], [f"name{k:03}" for k in range(MAX_LISTED_NAMES + 1)]
    for module, name, known, message in (
        ("co.systems", "zzz", few, "co.systems has no attribute 'zzz'. It has: heavy_top, toda"),
        ("co.systems", "__path__", few, "co.systems has no attribute '__path__'"),
        ("co.systems", "Splitting", few, "co.systems has no attribute 'Splitting'; it is co.Splitting"),
        ("coadjoint", "Splitting", few, "coadjoint has no attribute 'Splitting'. It has: heavy_top, toda"),
        (
            "co.a",
            "NAME001",
            many,
            "co.a has no attribute 'NAME001'; did you mean 'name001'? dir(co.a) lists what it has",
        ),
    ):
        error = unknown_attribute(module, name, known)
        assert type(error) is AttributeError and str(error) == message


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


@pytest.mark.parametrize("kind", [OneLineError, ConfigurationError])
def test_one_line_errors(kind):
    error = kind("a\nb " * 1000)
    assert len(str(error)) <= MAX_MESSAGE_LENGTH and "\n" not in str(error) and isinstance(error, ValueError)
    assert str(pickle.loads(pickle.dumps(error))) == str(error)


def test_hints_for_foreign_keywords_exist():
    import inspect

    known = {*inspect.signature(co.integrate).parameters, *inspect.signature(co.systems.rigid_body).parameters}
    for keyword, answer in KEYWORDS.items():
        name, equals, _ = answer.partition("=")
        assert keyword not in inspect.signature(co.integrate).parameters
        assert not equals or " " in name or name in known, keyword
    run = co.integrate(co.systems.rigid_body(), (1.0, 0.1, 0.2), (0, 0.5), 0.25)
    for name, answer in ATTRIBUTES.items():
        first = answer.partition(",")[0].partition("(")[0].partition(" ")[0]
        assert hasattr(type(run), first) or hasattr(run, first), answer
        assert not hasattr(run, name), name


def test_functions_that_hints_name_exist():
    for answer in {*FUNCTIONS.values(), *KEYWORDS.values(), *ATTRIBUTES.values()}:
        for name in re.findall(r"\bco\.([\w.]*\w)", answer):
            attrgetter(name)(co)  # an AttributeError has the name
        for name in re.findall(r"\bsol\.(\w+)", answer):
            assert hasattr(co.Solution, name), answer
    assert all("co." in answer for answer in FUNCTIONS.values())
    assert set(PICTURES.values()) <= set(kinds())


def test_unknown_keyword_names_valid_arguments():
    assert str(unknown_keyword("run", "dt", ["x0", "dta"])) == "run has no dt; did you mean dta=?"
    assert str(unknown_keyword("run", "dt", ["x0", "step"])).startswith("run has no dt; give step=, the size of a step")
    assert str(unknown_keyword("run", "jac", ["x0"])).startswith("run has no jac; it needs none")
    assert str(unknown_keyword("run", "zzz", ["x0", "step"])) == "run has no zzz; it takes x0, step"


def test_too_many_positional_arguments():
    calls = []

    @suggest_keywords
    def run(x0, step=None, *, threads=None):
        calls.append((x0, step, threads))

    @suggest_keywords
    def one(inertia=None, *, name=None):
        calls.append(inertia)

    @suggest_keywords
    def any_number(*members):
        calls.append(members)

    run(1, 2, threads=3)
    any_number(1, 2, 3)
    assert calls == [(1, 2, 3), (1, 2, 3)]
    for call, message in (
        (lambda: run(1, 2, 3), "run was given 3 arguments, and takes x0, step, threads, those after step by name"),
        (lambda: one(1, 2), "one was given 2 arguments, and takes inertia, name, those after inertia by name"),
        (lambda: run(1, thread=3), "run has no thread; did you mean threads=?"),
        (lambda: any_number(1, members=2), None),
    ):
        with pytest.raises(TypeError) as refused:
            call()
        assert message is None or str(refused.value) == message
    assert len(calls) == 2 and run.__name__ == "run"

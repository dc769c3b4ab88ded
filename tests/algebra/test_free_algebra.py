"""The free associative algebra, and Lie elements in brackets of Lyndon words."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from coadjoint.algebra.exact.free_algebra import (
    expand_bracket,
    exponential,
    lie_coordinates,
    logarithm,
    lyndon_words,
    product,
    standard_factorization,
)


def letter(name, highest):
    return [{}, {(name,): Fraction(1)}, *({} for _ in range(highest - 1))]


def test_the_formula_of_baker_campbell_and_hausdorff():
    found = logarithm(product(exponential(letter("a", 4)), exponential(letter("b", 4))))
    weights = {"a": 1, "b": 1}
    coordinates = {}
    for weight in range(1, 5):
        own, rest = lie_coordinates(found[weight], lyndon_words(weights, weight))
        assert not any(rest.values())
        coordinates |= {"".join(word): value for word, value in own.items() if value}
    # a + b + [a,b]/2 + [a,[a,b]]/12 + [[a,b],b]/12 + [a,[[a,b],b]]/24
    twelfth = Fraction(1, 12)
    assert coordinates == {"a": 1, "b": 1, "ab": Fraction(1, 2), "aab": twelfth, "abb": twelfth, "aabb": twelfth / 2}


@pytest.mark.parametrize(
    ("weight", "count"), [(1, 1), (2, 1), (3, 2), (4, 3), (5, 6), (6, 9), (7, 18), (8, 30), (9, 56)]
)
def test_as_many_lyndon_words_as_the_free_lie_algebra_has_dimensions(weight, count):
    words = lyndon_words({k: k for k in range(1, weight + 1)}, weight)
    assert len(words) == count and words == sorted(words)
    for word in words:
        expanded = expand_bracket(word)
        assert expanded[word] == 1 and min(expanded) == word
        if len(word) > 1:
            left, right = standard_factorization(word)
            assert left + right == word and left < right


def test_logarithm_and_exponential_undo_each_other():
    random = np.random.default_rng(5)
    series = [{}, {}, {}, {}, {}]
    for weight in range(1, 5):
        for word in ("a" * weight, "b" * weight, "ab" * (weight // 2)):
            if len(word) == weight:
                series[weight][tuple(word)] = Fraction(int(random.integers(-9, 10)), 7)
    back = logarithm(exponential(series))
    for own, found in zip(series, back, strict=True):
        assert {w: v for w, v in found.items() if v} == {w: v for w, v in own.items() if v}


def test_what_is_no_lie_element_leaves_a_rest():
    _, rest = lie_coordinates({("a", "b"): 1, ("b", "a"): 1}, [("a", "b")])
    assert any(rest.values())

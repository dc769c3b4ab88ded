"""Truncated series in the free associative algebra on weighted letters: exponentials, logarithms, Lie elements."""
# A series is a list whose entry w maps the words of weight w to coefficients of any type with +, - and *.

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from typing import Any

Word = tuple[Any, ...]
Series = list[dict[Word, Any]]


def unit_series(highest: int) -> Series:
    """Return the series 1 truncated at a weight."""
    return [{(): 1}, *({} for _ in range(highest))]


def product(left: Series, right: Series) -> Series:
    """Return the product of two series, truncated at their common weight."""
    result: Series = [{} for _ in left]
    for i, left_words in enumerate(left):
        for j, right_words in enumerate(right[: len(left) - i]):
            target = result[i + j]
            for a, x in left_words.items():
                for b, y in right_words.items():
                    word = a + b
                    target[word] = target[word] + x * y if word in target else x * y
    return result


def exponential(exponent: Series) -> Series:
    """Return exp of a series without a constant term."""
    result = power = unit_series(len(exponent) - 1)
    for k in range(1, len(exponent)):
        power = _scaled(product(power, exponent), 1, k)
        result = add_series(result, power)
    return result


def logarithm(series: Series) -> Series:
    """Return log of a series with constant term 1."""
    rest = [{}, *series[1:]]
    result: Series = [{} for _ in series]
    power = unit_series(len(series) - 1)
    for k in range(1, len(series)):
        power = product(power, rest)
        result = add_series(result, _scaled(power, 1 if k % 2 else -1, k))
    return result


def _scaled(series: Series, numerator: int, denominator: int) -> Series:
    return [{word: numerator * value / denominator for word, value in words.items()} for words in series]


def add_series(left: Series, right: Series) -> Series:
    """Return the sum of two series."""
    result = [dict(words) for words in left]
    for target, addend in zip(result, right, strict=True):
        for word, value in addend.items():
            target[word] = target[word] + value if word in target else value
    return result


def lyndon_words(weights: Mapping[Any, int], weight: int) -> list[Word]:
    """Return the Lyndon words of a weight in ascending order; `weights` maps comparable letters to weights >= 1."""

    def words(left: int) -> Iterator[Word]:
        if left == 0:
            yield ()
        for letter in sorted(weights):
            if weights[letter] <= left:
                for rest in words(left - weights[letter]):
                    yield (letter, *rest)

    return [word for word in words(weight) if all(word < word[k:] for k in range(1, len(word)))]


def standard_factorization(word: Word) -> tuple[Word, Word]:
    """Return the standard factorization of a Lyndon word: the prefix, and the smallest proper suffix."""
    split = min(range(1, len(word)), key=lambda k: word[k:])
    return word[:split], word[split:]


@lru_cache(maxsize=4096)
def expand_bracket(word: Word) -> Mapping[Word, int]:
    """Expand the nested bracket of a Lyndon word: the word itself plus larger words."""
    if len(word) == 1:
        return {word: 1}
    result: dict[Word, int] = {}
    left, right = (expand_bracket(half) for half in standard_factorization(word))
    for a, x in left.items():
        for b, y in right.items():
            for joined, value in ((a + b, x * y), (b + a, -x * y)):
                result[joined] = result.get(joined, 0) + value
    return {joined: value for joined, value in result.items() if value}


def lie_coordinates(element: Mapping[Word, Any], words: Sequence[Word]) -> tuple[dict[Word, Any], dict[Word, Any]]:
    """Expand a Lie element of one weight in brackets of ascending Lyndon `words`: coordinates by word, and the rest."""
    rest = dict(element)
    coordinates = {}
    for word in words:
        if word in rest:
            coordinates[word] = value = rest[word]
            for expanded, factor in expand_bracket(word).items():
                rest[expanded] = rest.get(expanded, 0) - factor * value
            del rest[word]
    return coordinates, rest

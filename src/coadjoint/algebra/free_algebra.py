"""Products of exponentials without relations: the free associative algebra on weighted letters, and its Lie elements.

A series is a list: place w holds the words of weight w, each with its coefficient. Coefficients are numbers of any kind
that has +, - and *; the empty word stands for 1.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from typing import Any

Word = tuple[Any, ...]
Series = list[dict[Word, Any]]


def one(highest: int) -> Series:
    """Return the series 1, with places up to a weight.

    Examples
    --------
    >>> one(2)
    [{(): 1}, {}, {}]
    """
    return [{(): 1}, *({} for _ in range(highest))]


def product(left: Series, right: Series) -> Series:
    """Return the product of two series, up to the weight that both have.

    Examples
    --------
    >>> product([{(): 1}, {("a",): 2}, {}], [{(): 1}, {("b",): 3}, {}])
    [{(): 1}, {('b',): 3, ('a',): 2}, {('a', 'b'): 6}]
    """
    result: Series = [{} for _ in left]
    for i, some in enumerate(left):
        for j, others in enumerate(right[: len(left) - i]):
            found = result[i + j]
            for a, x in some.items():
                for b, y in others.items():
                    word = a + b
                    found[word] = found[word] + x * y if word in found else x * y
    return result


def exponential(exponent: Series) -> Series:
    """Return exp of a series without a constant.

    Examples
    --------
    >>> from fractions import Fraction
    >>> exponential([{}, {("a",): Fraction(1)}, {}])[2]
    {('a', 'a'): Fraction(1, 2)}
    """
    result = power = one(len(exponent) - 1)
    for k in range(1, len(exponent)):
        power = _scaled(product(power, exponent), 1, k)
        result = plus(result, power)
    return result


def logarithm(series: Series) -> Series:
    """Return log of a series whose constant is 1.

    Examples
    --------
    >>> from fractions import Fraction
    >>> a, b = ([{}, {(letter,): Fraction(1)}, {}] for letter in "ab")
    >>> logarithm(product(exponential(a), exponential(b)))[2][("b", "a")]
    Fraction(-1, 2)
    """
    rest = [{}, *series[1:]]
    result: Series = [{} for _ in series]
    power = one(len(series) - 1)
    for k in range(1, len(series)):
        power = product(power, rest)
        result = plus(result, _scaled(power, 1 if k % 2 else -1, k))
    return result


def _scaled(series: Series, above: int, below: int) -> Series:
    return [{word: above * value / below for word, value in some.items()} for some in series]


def plus(left: Series, right: Series) -> Series:
    """Return the sum of two series."""
    result = [dict(some) for some in left]
    for found, others in zip(result, right, strict=True):
        for word, value in others.items():
            found[word] = found[word] + value if word in found else value
    return result


def lyndon_words(weights: Mapping[Any, int], weight: int) -> list[Word]:
    """Return the Lyndon words of a weight, ascending: smaller than all their proper ends.

    Parameters
    ----------
    weights : mapping
        Letter -> its weight, at least 1; letters can be compared.
    weight : int
        Weight of the words.

    Examples
    --------
    >>> lyndon_words({1: 1, 2: 2, 3: 3}, 3)
    [(1, 2), (3,)]
    """

    def words(left: int) -> Iterator[Word]:
        if left == 0:
            yield ()
        for letter in sorted(weights):
            if weights[letter] <= left:
                for rest in words(left - weights[letter]):
                    yield (letter, *rest)

    return [word for word in words(weight) if all(word < word[k:] for k in range(1, len(word)))]


def factors(word: Word) -> tuple[Word, Word]:
    """Return the two Lyndon words of which a longer one is the bracket: its smallest proper end, and what is before it.

    Examples
    --------
    >>> factors((1, 1, 2)), factors((1, 2, 2))
    (((1,), (1, 2)), ((1, 2), (2,)))
    """
    place = min(range(1, len(word)), key=lambda k: word[k:])
    return word[:place], word[place:]


@lru_cache(maxsize=4096)
def bracketed(word: Word) -> Mapping[Word, int]:
    """Return the nested brackets of a Lyndon word, multiplied out. They hold the word itself, and larger ones.

    Examples
    --------
    >>> bracketed((1, 1, 2))
    {(1, 1, 2): 1, (1, 2, 1): -2, (2, 1, 1): 1}
    """
    if len(word) == 1:
        return {word: 1}
    result: dict[Word, int] = {}
    left, right = (bracketed(half) for half in factors(word))
    for a, x in left.items():
        for b, y in right.items():
            for joined, value in ((a + b, x * y), (b + a, -x * y)):
                result[joined] = result.get(joined, 0) + value
    return {joined: value for joined, value in result.items() if value}


def lie_coordinates(element: Mapping[Word, Any], words: Sequence[Word]) -> tuple[dict[Word, Any], dict[Word, Any]]:
    """Write a Lie element in brackets of Lyndon words.

    Parameters
    ----------
    element : mapping
        Word -> coefficient, all of one weight.
    words : sequence
        The Lyndon words of that weight, ascending.

    Returns
    -------
    coordinates : dict
        Lyndon word -> factor of its bracket.
    rest : dict
        What is left of the coefficients. For a Lie element it is zero up to rounding.

    Examples
    --------
    >>> lie_coordinates({(1, 2): 3, (2, 1): -3}, [(1, 2), (3,)])
    ({(1, 2): 3}, {(2, 1): 0})
    """
    rest = dict(element)
    found = {}
    for word in words:
        if word in rest:
            found[word] = value = rest[word]
            for other, factor in bracketed(word).items():
                rest[other] = rest.get(other, 0) - factor * value
            del rest[word]
    return found, rest

"""Options of runs as text, and sets of them in which every two values occur together."""

from __future__ import annotations

from itertools import combinations

import numpy as np

VALUES = {
    "members": ("one", "many", "batch"),
    "saved": ("every", "third", "times"),
    "direction": ("forward", "backward"),
    "start": ("zero", "later"),
    "attitude": ("none", "coadjoint", "own", "turned"),
    "forces": ("none", "one", "two", "noise"),
    "events": ("none", "plain", "terminal"),
    "watch": ("watched", "unwatched"),
    "observe": ("none", "functions"),
    "inputs": ("none", "linear", "torque"),
    "blocks": ("none", "here", "workers"),
    "step": ("given", "accuracy"),
    "output": ("plain", "corrected"),
}
BESIDE = "blocks", "step", "output"
"""What is checked by other runs than that of the case."""
NEUTRAL = {name: values[0] for name, values in VALUES.items()}
Options = dict[str, str]


def pairs_in(options: Options) -> set[frozenset]:
    """Return every two values of the options."""
    return {frozenset(pair) for pair in combinations(sorted(options.items()), 2)}


def every_pair() -> set[frozenset]:
    """Return every two values of different options."""
    single = [(name, value) for name, values in VALUES.items() for value in values]
    return {frozenset(pair) for pair in combinations(single, 2) if pair[0][0] != pair[1][0]}


def covering(rng: np.random.Generator, tries: int = 40) -> list[Options]:
    """Return options in which every two values occur together, drawn greedily."""
    left, found = every_pair(), []
    while left:
        missing = sorted(map(sorted, left))
        draws = [{name: str(rng.choice(values)) for name, values in VALUES.items()} for _ in range(tries)]
        # Two values that are still missing, so that each draw covers some.
        for draw in draws:
            draw.update(dict(missing[int(rng.integers(len(missing)))]))
        best = max(draws, key=lambda draw: len(pairs_in(draw) & left))
        left -= pairs_in(best)
        found.append(best)
    return found

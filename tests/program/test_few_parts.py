"""Few parts: on every catalogue algebra at most as many as sets of commuting coordinates are known to cover it."""

import numpy as np
import pytest

import coadjoint as co
from coadjoint.program.parts.decompose import decompose
from coadjoint.program.parts.split import split

# Number of sets of commuting coordinates, and parameters.
COVERS = {
    "A2,1": (2, {}),
    "A3,1": (2, {}),
    "A3,2": (2, {}),
    "A3,3": (2, {}),
    "A3,4": (2, {}),
    "A3,5": (2, {"a": 0.3333333333333333}),
    "A3,6": (2, {}),
    "A3,7": (2, {"a": 2.0}),
    "A3,8": (3, {}),
    "A3,9": (3, {}),
    "A4,1": (2, {}),
    "A4,2": (2, {"a": 3.0}),
    "A4,3": (2, {}),
    "A4,4": (2, {}),
    "A4,5": (2, {"a": 0.5, "b": -0.3333333333333333}),
    "A4,6": (2, {"a": 2.0, "b": 0.5}),
    "A4,7": (3, {}),
    "A4,8": (3, {}),
    "A4,9": (3, {"b": 0.5}),
    "A4,10": (3, {}),
    "A4,11": (3, {"a": 2.0}),
    "A4,12": (2, {}),
    "A5,1": (2, {}),
    "A5,2": (2, {}),
    "A5,3": (3, {}),
    "A5,4": (2, {}),
    "A5,5": (2, {}),
    "A5,6": (3, {}),
    "A5,7": (2, {"a": 0.5, "b": -0.3333333333333333, "c": 0.2}),
    "A5,8": (2, {"c": 0.5}),
    "A5,9": (2, {"b": 0.5, "c": -2.0}),
    "A5,10": (2, {}),
    "A5,11": (2, {"c": 0.5}),
    "A5,12": (2, {}),
    "A5,13": (2, {"a": 0.5, "p": 0.3333333333333333, "s": 2.0}),
    "A5,14": (2, {"p": 0.3333333333333333}),
    "A5,15": (2, {"a": 0.5}),
    "A5,16": (2, {"p": 0.3333333333333333, "s": 2.0}),
    "A5,17": (2, {"p": 0.3333333333333333, "q": -0.5, "s": 2.0}),
    "A5,18": (2, {"p": 0.3333333333333333}),
    "A5,19": (3, {"a": 3.0, "b": 0.5}),
    "A5,20": (3, {"a": 3.0}),
    "A5,21": (3, {}),
    "A5,22": (2, {}),
    "A5,23": (3, {"b": 0.5}),
    "A5,24": (3, {"eps": 1.0}),
    "A5,25": (3, {"p": 0.3333333333333333, "b": 0.5}),
    "A5,26": (3, {"p": 0.3333333333333333, "eps": 1.0}),
    "A5,27": (2, {}),
    "A5,28": (3, {"a": 3.0}),
    "A5,29": (3, {}),
    "A5,30": (3, {"a": 3.0}),
    "A5,31": (3, {}),
    "A5,32": (2, {"a": 3.0}),
    "A5,33": (2, {"a": 0.5, "b": 3.0}),
    "A5,34": (2, {"a": 0.5}),
    "A5,35": (2, {"a": 0.5, "b": 3.0}),
    "A5,36": (3, {}),
    "A5,37": (3, {}),
    "A5,38": (2, {}),
    "A5,39": (3, {}),
    "A5,40": (3, {}),
}


@pytest.mark.thinned(3)
@pytest.mark.parametrize("name", COVERS)
def test_as_few_parts_as_commuting_sets_that_cover_the_coordinates(name):
    count, parameters = COVERS[name]
    algebra = co.algebras.get(name, **parameters)
    system = co.LiePoissonSystem(algebra, co.Quadratic(np.linspace(1.0, 2.0, algebra.dim)))
    parts = split(system, "auto")
    assert len(parts) <= count
    assert len(decompose(system, "auto").parts) <= len(parts)
    covered = sorted(i for part in parts for form, _ in part.forms for i in form)
    assert covered == list(range(algebra.dim))
    for part in parts:
        chosen = [i for form, _ in part.forms for i in form]
        assert all(algebra.commuting(i, j) for i in chosen for j in chosen)

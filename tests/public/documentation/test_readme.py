"""Figures of the README, by its own lines."""

import doctest
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

README = Path(__file__).parents[3] / "README.md"


@pytest.fixture(scope="module")
def names():
    """Return what the lines of the README define, without the attitudes of its later sections."""
    text = README.read_text(encoding="utf-8").partition("## Your own algebra")[0]
    known: dict = {}
    found = {}
    for example in doctest.DocTestParser().get_examples(text):
        exec(compile(example.source, "README", "single"), known)
        found |= {(name, id(value)): value for name, value in known.items()}
    return {**known, "runs of sol": [value for (name, _), value in found.items() if name == "sol"]}


def test_the_attitude_after_ninety_minutes(names):
    tumbling, sol = names["tumbling"], names["runs of sol"][0]
    exact = tumbling.exact(names["x0"], 5400.0, attitude=names["q0"])[1]
    assert np.degrees((Rotation.from_matrix(exact).inv() * sol.rotation[-1]).magnitude()) < 1e-8


def test_lengths_of_spins_and_moments_of_vorticity(names):
    lengths = np.linalg.norm(names["runs of sol"][1].x.reshape(-1, 3), axis=1)
    assert abs(lengths - 1).max() < 1e-14
    assert max(drift for name, drift in names["fluid"].drift().items() if name != "energy") < 1e-13

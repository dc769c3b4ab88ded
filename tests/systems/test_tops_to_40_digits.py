"""Tops and bodies against solutions of 40 digits, with their fields, energies and integrals."""

import json
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from motions import U, assert_order, polynomial_of

import coadjoint as co

REFERENCE = json.loads((Path(__file__).parent / "tops_reference.json").read_text())["systems"]
SCALES = {
    ("kovalevskaya_top", "x1**"): 1,
    ("clebsch_body", "x1**"): 0.5,
    ("manakov_top", "-3*x"): 1,
    ("manakov_top", "-14*"): 2,
}


@pytest.mark.parametrize("name", REFERENCE)
def test_against_40_digits(name):
    given = REFERENCE[name]
    system = co.systems.get(name)
    x0 = [float(Fraction(v)) for v in given["x0"]]
    x = np.cos(np.arange(6.0))
    names = {f"x{i + 1}": v for i, v in enumerate(x)}
    field = [eval(text, {}, names) for text in given["vector_field"]]
    np.testing.assert_allclose(system.vector_field(x), field, rtol=0, atol=16 * U)
    assert system.energy(x) == pytest.approx(eval(given["hamiltonian"], {}, names), rel=16 * U)
    for value in given["values"][:2]:
        assert_order(system, x0, np.array(value["x"], dtype=float), float(value["t"]), 0.05)


@pytest.mark.parametrize(
    ("name", "own"), [("kovalevskaya_top", ["K"]), ("clebsch_body", ["F"]), ("manakov_top", ["X^2 a", "X^2 a^2"])]
)
def test_integrals_are_those_of_the_reference(name, own):
    system = co.systems.get(name)
    states = np.random.default_rng(3).uniform(-1.0, 1.0, (3, 6))
    assert list(system.integrals) == own
    for text, F in zip(REFERENCE[name]["integrals"], system.integrals.values(), strict=True):
        theirs = [eval(text, {}, {f"x{i + 1}": v for i, v in enumerate(x)}) for x in states]
        ours = [polynomial_of(F)(x) for x in states]
        factor = theirs[0] / ours[0]
        np.testing.assert_allclose(theirs, np.multiply(factor, ours), rtol=1e-13)
        assert abs(factor) == pytest.approx(SCALES[name, text[:4]], rel=1e-13)

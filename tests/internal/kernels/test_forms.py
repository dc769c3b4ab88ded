"""Logarithms, angles and quotients of polynomials: the kernels compute them, with the bits of their exact reading."""

import math
import types

import mpmath
import numpy as np
import pytest

import coadjoint as co
from coadjoint.algebra.invariants import logarithmic
from coadjoint.algebra.invariants.logarithmic import ANGLE, LOGARITHM, QUOTIENT, LogarithmicInvariant, LogarithmicSum
from coadjoint.kernels.functions.compiled_functions import CompiledFunction, FormulaFunction
from coadjoint.kernels.tables.invariants import invariants_table
from coadjoint.kernels.tables.recording import values_along
from long import long_between

# Every kind of term, several terms of a kind, products of coordinates and powers.
KNOWN = [
    ("A3,2", {}),
    ("A3,5", {"a": 0.5}),
    ("A3,7", {"a": 2.0}),
    ("A4,6", {"a": 2.0, "b": 0.5}),
    ("A5,18", {"p": 1.0}),
    ("A5,32", {"a": 0.75}),
]


def formulas():
    for name, parameters in KNOWN:
        for key, casimir in co.algebras.get(name, **parameters).casimirs_known.items():
            if isinstance(casimir, LogarithmicInvariant):
                yield pytest.param(casimir, id=f"{name} {key}")


def values(compiled, points):
    out = np.empty((len(points), 1, 1))
    values_along(compiled.tables, points[:, None], np.zeros(len(points)), out)
    return out[:, 0, 0]


def test_every_kind_is_tried():
    kinds = {term.kind for parameter in formulas() for term in parameter.values[0].formula.terms}
    assert kinds == {QUOTIENT, LOGARITHM, ANGLE}
    weights = {
        term.weight for parameter in formulas() for term in parameter.values[0].formula.terms if term.kind == LOGARITHM
    }
    assert weights > {1}


def rounded(function):
    """Return a function of floats that is rounded from 40 digits."""

    def called(*arguments):
        with mpmath.workdps(40):
            return float(function(*map(float, arguments)))

    return called


@pytest.mark.parametrize("casimir", list(formulas()))
def test_values_have_the_bits_of_the_reading(casimir, monkeypatch):
    """Both do the same operations in the same order, where the reading has correctly rounded functions."""
    functions = {"log": rounded(mpmath.log), "atan2": rounded(mpmath.atan2), "nan": math.nan}
    monkeypatch.setattr(logarithmic, "math", types.SimpleNamespace(**functions))
    n = casimir.formula.dim
    points = np.random.default_rng(5).normal(size=(100, n))
    # Some of the polynomials vanish there, and with them some of the formulas are undefined.
    points = np.concatenate([points, np.zeros((1, n)), *(points[:3] * (np.arange(n) != i) for i in range(n))])
    compiled = invariants_table([("it", casimir)], n)
    assert [type(kept) for kept in compiled.keepalive] == [FormulaFunction]
    read = np.array([casimir(point) for point in points])
    assert np.array_equal(values(compiled, points), read, equal_nan=True)
    assert np.isfinite(read[:100]).all() and math.isnan(read[100])


@pytest.mark.parametrize("casimir", long_between(3, formulas()))
def test_the_function_alone_compiled_by_numba_agrees_to_rounding(casimir):
    """Its logarithms and angles are those of the C library, each within a unit in the last place."""
    n = casimir.formula.dim
    points = np.random.default_rng(6).normal(size=(50, n))
    mine = invariants_table([("it", co.Invariant(casimir.value))], n)
    assert [type(kept) for kept in mine.keepalive] == [CompiledFunction]
    compiled = invariants_table([("it", casimir)], n)
    terms = casimir.formula.terms
    each = [[LogarithmicSum(n, (term,)).invariant()(point) for term in terms] for point in points]
    # A term is rounded when its function is computed, weighted and added, here and there.
    bound = 2.0**-52 * 4 * (len(terms) + 1) * np.abs(each).sum(axis=1)
    assert np.all(np.abs(values(mine, points) - values(compiled, points)) <= bound)


def test_members_with_formulas_of_their_own():
    """In a batch each member has another parameter in its formula, and the values that it has alone."""
    systems = [
        co.LiePoissonSystem(co.algebras.get("A3,7", a=a), co.Quadratic([1.0, 2.0, 0.01])) for a in (0.5, 2.0, 3.0)
    ]
    x0 = np.random.default_rng(7).uniform(0.5, 1.5, (3, 3))
    together = co.integrate(co.batch(systems), x0, (0.0, 2.0), 0.05, co.Splitting(order=2))
    for member, system in enumerate(systems):
        alone = co.integrate(system, x0[member], (0.0, 2.0), 0.05, co.Splitting(order=2))
        assert (together.casimirs["log C"][:, member] == alone.casimirs["log C"]).all()
        assert alone.drift()["log C"] < 1e-12

"""Tables of the kernels: formulas of invariants, and where inputs stand."""

import ctypes
import math
import types

import mpmath
import numpy as np
import pytest

import coadjoint as co
from coadjoint.algebra.invariants import invariant
from coadjoint.algebra.invariants.invariant import LogarithmicInvariant
from coadjoint.kernels.functions.compiled_functions import FormulaFunction
from coadjoint.kernels.interface import limit
from coadjoint.kernels.tables.inputs import InputsNotLocated, InputTables
from coadjoint.kernels.tables.invariants import invariants_table, watch_tables
from coadjoint.kernels.tables.recording import values_along
from drawn_matrices import full
from refusals import refused

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
    monkeypatch.setattr(invariant, "math", types.SimpleNamespace(**functions))
    n = casimir.formula.dim
    points = np.random.default_rng(5).normal(size=(100, n))
    # Some of the polynomials vanish there, and with them some of the formulas are undefined.
    points = np.concatenate([points, np.zeros((1, n)), *(points[:3] * (np.arange(n) != i) for i in range(n))])
    compiled = invariants_table([("it", casimir)], n)
    assert [type(kept) for kept in compiled.keepalive] == [FormulaFunction]
    read = np.array([casimir(point) for point in points])
    assert np.array_equal(values(compiled, points), read, equal_nan=True)
    assert np.isfinite(read[:100]).all() and math.isnan(read[100])


DRAWN = np.array([[0.3, 0.7, 0.11], [0.9, 0.2, 0.77]])


def made(method, *matrices, inputs=DRAWN):
    bodies = [
        co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(M, linear=linear))
        for M, linear in zip(matrices, DRAWN, strict=True)
    ]
    loops = tuple(method.loop(body, 0.1) for body in bodies)
    return InputTables(loops, tuple(watch_tables(body, {}).tables for body in bodies), tuple(inputs))


def test_lanes_beyond_the_last_member_read_the_last_member_again():
    linear = np.arange(15.0).reshape(5, 3)
    for method in (co.GaussLegendre(2), co.Splitting(order=2, parts="coordinates")):
        _, watch, columns = made(method, np.diag([1.0, 1.5, 2.0]), np.diag([1.0, 1.5, 2.0])).each(linear)
        assert columns == limit("MOST_LANES")
        numbers = np.ctypeslib.as_array((ctypes.c_double * (3 * columns)).from_address(watch.terms.offset))
        referenced = numbers.reshape(3, columns)
        assert np.array_equal(referenced[:, :5], linear.T)
        assert np.array_equal(referenced[:, 5:], np.repeat(linear[-1:].T, columns - 5, axis=1))


def test_what_is_no_input_is_refused_by_name():
    one, other = np.diag([1.0, 2.0, 3.0]), np.diag([1.0, 2.0, 3.5])
    with refused(InputsNotLocated, "field.terms.weight"):
        made(co.GaussLegendre(2), one, other)
    with refused(InputsNotLocated, "field.terms.offset"):
        made(co.GaussLegendre(2), one, one, inputs=DRAWN + 1.0)
    with refused(InputsNotLocated, "field.terms."):
        made(co.GaussLegendre(2), one, np.ones((3, 3)))


# Squares of up to 16 coupled coordinates are completed in exact numbers, of more in floats; so(4) also has uncoupled
# coordinates.
COUPLED = {
    "so(3)": (co.algebras.so(3), full(3, 3), 1),
    "A3,7": (co.algebras.get("A3,7", a=1.75), full(3, 5), -1),
    "e(3)": (co.algebras.e(3), full(6, 4), -1),
    "six so(3)": (co.algebras.copies(co.algebras.so(3), 6), full(18, 7), 1),
    "so(4)": (co.algebras.so(4), np.diag(np.linspace(0.5, 1.5, 6)) + 0.2 * np.eye(6)[[0, 1, 3, 2, 4, 5]], -1),
}


def coupled(name, linear):
    algebra, M, sign = COUPLED[name]
    return co.LiePoissonSystem(algebra, co.Quadratic(M, linear=linear), sign=sign)

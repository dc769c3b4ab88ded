"""Tables of the kernels: formulas of invariants, and where inputs stand."""

import ctypes
import math
import types
from dataclasses import replace

import mpmath
import numpy as np
import pytest

import coadjoint as co
from coadjoint.algebra.invariants import invariant
from coadjoint.algebra.invariants.invariant import LogarithmicInvariant
from coadjoint.kernels.interface import limit
from coadjoint.kernels.tables.compiled import NotWritable, unrecorded
from coadjoint.kernels.tables.invariants import invariants_table, watch_tables
from coadjoint.kernels.tables.recording import values_along
from coadjoint.kernels.tables.writable import WritableTables
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
    assert [kept.address < 0 for kept in compiled.keepalive] == [True]
    read = np.array([casimir(point) for point in points])
    assert np.array_equal(values(compiled, points), read, equal_nan=True)
    assert np.isfinite(read[:100]).all() and math.isnan(read[100])


LINEAR = np.array([0.3, 0.7, 0.11])


def made(method, M, sources=(0, 1, 2), values=LINEAR, tangled=()):
    """Return the tables of a body, for given values of some coefficients of its energy, the linear ones first."""
    body = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(M, linear=LINEAR))
    indices = {source: index for index, source in enumerate(sources)}
    return WritableTables(method.loop(body, 0.1), watch_tables(body, {}), indices, np.asarray(values), tangled)


def test_lanes_beyond_the_last_member_read_the_last_member_again():
    linear = np.arange(15.0).reshape(5, 3)
    for method in (co.GaussLegendre(2), co.Splitting(order=2, parts="coordinates")):
        _, watch, columns = made(method, np.diag([1.0, 1.5, 2.0])).each(linear)
        assert columns == limit("MOST_LANES")
        numbers = np.ctypeslib.as_array((ctypes.c_double * (3 * columns)).from_address(watch.terms.offset))
        referenced = numbers.reshape(3, columns)
        assert np.array_equal(referenced[:, :5], linear.T)
        assert np.array_equal(referenced[:, 5:], np.repeat(linear[-1:].T, columns - 5, axis=1))


def test_what_cannot_be_written_is_refused_by_name():
    diagonal, whole, apart = np.diag([1.0, 2.0, 3.0]), full(3, 3), co.Splitting(order=2, parts="coordinates")
    made(co.GaussLegendre(2), diagonal, (3, 4, 5), np.diag(diagonal))
    with refused(NotWritable, "field.terms.offset"):
        made(co.GaussLegendre(2), diagonal, values=LINEAR + 1.0)
    with refused(NotWritable, "field.terms.offset"):
        made(co.GaussLegendre(2), diagonal, (0, 1), LINEAR[:2], tangled=(2,))
    made(apart, whole)
    with refused(NotWritable, "terms.weight"):
        made(apart, whole, (3, 4), whole[0, :2])
    with refused(NotWritable, "terms.offset"):
        made(apart, whole, (0, 1), LINEAR[:2], tangled=(2,))
    with refused(NotWritable, "record"):
        loop = replace(co.GaussLegendre(2).loop(co.systems.rigid_body((1, 2, 3)), 0.1), sources=unrecorded)
        WritableTables(loop, watch_tables(co.systems.rigid_body((1, 2, 3)), {}), {}, np.zeros(0))

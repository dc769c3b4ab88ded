"""Tables of the kernels: constants of members that have inputs of their own."""

import ctypes

import numpy as np

import coadjoint as co
from coadjoint.kernels.interface import limit
from coadjoint.kernels.tables.invariants import watch_tables
from coadjoint.kernels.tables.writable import WritableTables

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

"""Where inputs stand in tables, and how they are written there."""

import ctypes

import numpy as np
import pytest

import coadjoint as co
from coadjoint.kernels.description import limit
from coadjoint.kernels.input_tables import InputTables, NotPlaced, fields_of
from coadjoint.kernels.structures import pointed
from coadjoint.kernels.tables import watch_tables

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
        assert columns == limit("LARGEST_CROWD")
        numbers = np.ctypeslib.as_array((ctypes.c_double * (3 * columns)).from_address(watch.terms.offset))
        held = numbers.reshape(3, columns)
        assert np.array_equal(held[:, :5], linear.T)
        assert np.array_equal(held[:, 5:], np.repeat(linear[-1:].T, columns - 5, axis=1))


def test_a_copy_is_the_table_but_for_the_inputs():
    M = np.diag([1.0, 2.0, 3.0])
    loop = co.GaussLegendre(2).loop(co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(M, linear=DRAWN[0])), 0.1)
    tables, _ = made(co.GaussLegendre(2), M, M).shared(np.array([5.0, 6.0, 7.0]))
    structure = pointed(loop.tables)
    numbers = {field.name: field.value for field in fields_of(loop.tables, type(structure))}
    assert numbers["field.terms.offset"].tolist() == DRAWN[0].tolist()
    found = (ctypes.c_double * 3).from_address(tables.field.terms.offset)
    assert list(found) == [5.0, 6.0, 7.0] and tables.stages == 2 and tables.field.size == 3


def test_what_is_no_input_is_refused_by_name():
    one, other = np.diag([1.0, 2.0, 3.0]), np.diag([1.0, 2.0, 3.5])
    with pytest.raises(NotPlaced, match=r"field\.terms\.weight that are neither inputs nor exact sums"):
        made(co.GaussLegendre(2), one, other)
    with pytest.raises(NotPlaced, match=r"field\.terms\.offset that are neither"):
        made(co.GaussLegendre(2), one, one, inputs=DRAWN + 1.0)
    with pytest.raises(NotPlaced, match=r"field\.terms\.\w+ that depend on them"):
        made(co.GaussLegendre(2), one, np.ones((3, 3)))

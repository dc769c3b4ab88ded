"""Where inputs stand in tables, and how they are written there."""

import ctypes

import numpy as np
import pytest

import coadjoint as co
from coadjoint.kernels.interface import limit
from coadjoint.kernels.tables.inputs import InputsNotLocated, InputTables, fields_of
from coadjoint.kernels.tables.invariants import watch_tables
from coadjoint.kernels.tables.structures import as_structure
from verification.systems_under_test import full_matrix

U = 2.0**-53
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


def test_a_copy_is_the_table_but_for_the_inputs():
    M = np.diag([1.0, 2.0, 3.0])
    loop = co.GaussLegendre(2).loop(co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(M, linear=DRAWN[0])), 0.1)
    tables, _ = made(co.GaussLegendre(2), M, M).shared(np.array([5.0, 6.0, 7.0]))
    structure = as_structure(loop.tables)
    numbers = {field.name: field.value for field in fields_of(loop.tables, type(structure))}
    assert numbers["field.terms.offset"].tolist() == DRAWN[0].tolist()
    found = (ctypes.c_double * 3).from_address(tables.field.terms.offset)
    assert list(found) == [5.0, 6.0, 7.0] and tables.stages == 2 and tables.field.size == 3


def test_what_is_no_input_is_refused_by_name():
    one, other = np.diag([1.0, 2.0, 3.0]), np.diag([1.0, 2.0, 3.5])
    with pytest.raises(InputsNotLocated, match=r"field\.terms\.weight that are neither inputs nor exact sums"):
        made(co.GaussLegendre(2), one, other)
    with pytest.raises(InputsNotLocated, match=r"field\.terms\.offset that are neither"):
        made(co.GaussLegendre(2), one, one, inputs=DRAWN + 1.0)
    with pytest.raises(InputsNotLocated, match=r"field\.terms\.\w+ that depend on them"):
        made(co.GaussLegendre(2), one, np.ones((3, 3)))


# Squares of up to 16 coupled coordinates are completed in exact numbers, of more in floats; so(4) also has uncoupled
# coordinates.
COUPLED = {
    "so(3)": (co.algebras.so(3), full_matrix(3, 3), 1),
    "A3,7": (co.algebras.get("A3,7", a=1.75), full_matrix(5, 3), -1),
    "e(3)": (co.algebras.e(3), full_matrix(4, 6), -1),
    "six so(3)": (co.algebras.copies(co.algebras.so(3), 6), full_matrix(7, 18), 1),
    "so(4)": (co.algebras.so(4), np.diag(np.linspace(0.5, 1.5, 6)) + 0.2 * np.eye(6)[[0, 1, 3, 2, 4, 5]], -1),
}


def coupled(name, linear):
    algebra, M, sign = COUPLED[name]
    return co.LiePoissonSystem(algebra, co.Quadratic(M, linear=linear), sign=sign)


def forms_of(parts, n):
    """Return the forms l_r of the angles as rows."""
    rows = np.zeros((len(parts.offset), n))
    owner = np.repeat(np.arange(len(rows)), np.diff(parts.forms.start))
    rows[owner, parts.forms.coordinate] = [float(value) for value in parts.forms.value]
    return rows


@pytest.mark.thinned(2)
@pytest.mark.parametrize("members", [1, 5, 33])
@pytest.mark.parametrize("name", list(COUPLED))
def test_the_squares_of_each_member_add_up_to_its_own_linear_term(name, members):
    """sum_r beta_r l_r = b for each member, and for one b of all members."""
    n, rng = COUPLED[name][0].dim, np.random.default_rng([21, members])
    drawn, linear = rng.uniform(0.1, 0.9, (2, n)), rng.uniform(-1.0, 1.0, (members, n))
    systems = [coupled(name, own) for own in drawn]
    loops = tuple(co.Splitting(order=2, parts="coordinates").loop(system, 0.1) for system in systems)
    tables = InputTables(loops, tuple(watch_tables(system, {}).tables for system in systems), tuple(drawn))
    forms = forms_of(loops[0].parts, n)
    assert np.any(np.count_nonzero(forms, axis=1) > 1), "the case must have coupled coordinates"

    def offsets(scheme, columns):
        count = len(forms) * columns
        return np.array((ctypes.c_double * count).from_address(scheme.terms.offset)).reshape(len(forms), columns)

    scheme, _, columns = tables.each(linear)
    found = offsets(scheme, columns)
    last = tables.shared(linear[-1])[0]
    # Each beta is rounded by the reduction, at most n sums of n products.
    for beta, b in [*zip(found.T, linear, strict=False), (offsets(last, 1)[:, 0], linear[-1])]:
        assert np.abs(forms.T @ beta - b).max() <= 2 * n * n * U * (np.abs(forms.T) @ np.abs(beta)).max()
    assert np.array_equal(found[:, members:], np.repeat(found[:, members - 1 : members], columns - members, axis=1))


@pytest.mark.thinned(5)
@pytest.mark.parametrize("method", [co.Splitting(order=4), co.Splitting(order=2, parts="coordinates")], ids=str)
@pytest.mark.parametrize("name", list(COUPLED))
def test_a_member_moves_as_a_system_of_its_own_with_its_linear_term(name, method):
    n, rng = COUPLED[name][0].dim, np.random.default_rng(22)
    x, linear = rng.uniform(0.3, 0.6, (5, n)), rng.uniform(-0.5, 0.5, (5, n))
    ready = co.prepare(coupled(name, rng.uniform(-0.5, 0.5, n)), method, 0.0625, inputs=True)
    for start in (2.0, -1.0):
        span = (start, start + 0.25)
        together = ready.run(x, span, linear=linear)
        for m in range(5):
            alone = co.integrate(coupled(name, linear[m]), x[m], span, 0.0625, ready.method)
            assert np.array_equal(together.x[:, m], alone.x) and np.array_equal(together.energy[:, m], alone.energy)

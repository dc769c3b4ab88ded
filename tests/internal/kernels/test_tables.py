"""Tables of the kernels: formulas of invariants, inputs, and stacks of members that differ in their constants."""

import ctypes
import math
import types

import mpmath
import numpy as np
import pytest

import coadjoint as co
from coadjoint.algebra.invariants import logarithmic
from coadjoint.algebra.invariants.logarithmic import LogarithmicInvariant
from coadjoint.kernels.functions.compiled_functions import FormulaFunction
from coadjoint.kernels.interface import limit
from coadjoint.kernels.tables.inputs import InputsNotLocated, InputTables
from coadjoint.kernels.tables.invariants import invariants_table, watch_tables
from coadjoint.kernels.tables.recording import values_along
from coadjoint.kernels.tables.structures import per_member_fields, stacked, structure_of
from coadjoint.runs.loops.batch_loops import groups_of
from drawn_matrices import full
from refusals import refused
from rounding import UNIT_ROUNDOFF as U

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


METHODS = [
    co.Splitting(order=4),
    co.GaussLegendre(2),
    co.ModifiedGaussLegendre(1, freeze="structure"),
    co.RadauEnergy(2),
    co.Taylor(6),
]


def members():
    algebras = [co.algebras.get("A3,7", a=a) for a in (1.0, 1.75, 2.5)]
    return [co.LiePoissonSystem(g, co.Quadratic([1.0, 2.0, 0.25 * (k + 1)])) for k, g in enumerate(algebras)]


def leaves(tables):
    for item in tables:
        if isinstance(item, tuple):
            yield from leaves(item)
        else:
            yield item


def picked(varied, member):
    """Return the tables of one member of a stack: its column of what varies."""

    def own(name, item):
        if isinstance(item, tuple):
            return picked(item, member)
        return item[:, member].copy() if name in per_member_fields(type(varied)) else item

    return varied._replace(**{name: own(name, item) for name, item in zip(varied._fields, varied, strict=True)})


def varies(one, stack):
    return isinstance(one, np.ndarray) and stack.shape != one.shape


@pytest.mark.parametrize("method", METHODS, ids=str)
@pytest.mark.parametrize("group", [None, "coadjoint"])
def test_picking_from_a_stack_gives_the_tables_of_the_member(method, group):
    if isinstance(method, co.RadauEnergy) and group:
        group = None
    tables = [method.loop(system, 0.1, group).tables for system in members()]
    assert len({structure_of(own) for own in tables}) == 1
    varied = stacked(tables)
    differing = 0
    for m, own in enumerate(tables):
        again = picked(varied, m)
        assert type(again) is type(own) and structure_of(again) == structure_of(own)
        for one, other, stack in zip(leaves(own), leaves(again), leaves(varied), strict=True):
            if not isinstance(one, np.ndarray):
                assert one == other
                continue
            assert one.dtype == other.dtype and one.tobytes() == other.tobytes()
            assert other.flags.c_contiguous
            if varies(one, stack):
                assert stack.shape == (*one.shape, limit("MOST_LANES")) and stack.flags.c_contiguous
                assert np.array_equal(
                    stack[:, len(tables) :], np.repeat(stack[:, [len(tables) - 1]], limit("MOST_LANES") - 3, axis=1)
                )
                differing += not np.array_equal(one, stack[..., 0])
    assert differing > 0


def test_structure_is_everything_but_constants():
    system = members()[0]
    two, four = (co.Splitting(order=order).loop(system, 0.1).tables for order in (2, 4))
    other = co.Splitting(order=2).loop(members()[1], 0.1).tables
    assert structure_of(two) == structure_of(other) and structure_of(two) != structure_of(four)
    # The coefficients of the scheme are the same for all members.
    assert structure_of(two) != structure_of(co.Splitting(order=2).loop(system, 0.2).tables)
    assert structure_of(two) != structure_of(two._replace(compensated=True))
    assert structure_of(two) != structure_of(two._replace(part=two.part + np.uint32(1)))


def test_groups_hold_members_of_one_structure():
    """A member of another order of parts, in the middle, has a group of its own."""
    inertias = [(1, 2, 3), (1, 2, 2.75), (3, 1, 2), (1, 2, 2.5)]
    systems = [co.systems.rigid_body(inertia) for inertia in inertias]
    prepared = [co.Splitting().loop(system, 0.1) for system in systems]
    watches = [watch_tables(system, system.casimirs).tables for system in systems]
    groups = groups_of(prepared, watches)
    assert sorted(m for group in groups for m in group.members.tolist()) == [0, 1, 2, 3]
    assert [0, 1, 3] in [group.members.tolist() for group in groups]
    for group in groups:
        for column, m in enumerate(group.members):
            for varied, own in ((group.tables, prepared[m].tables), (group.watch, watches[m])):
                for one, other in zip(leaves(picked(varied.source, column)), leaves(own), strict=True):
                    assert np.array_equal(one, other) if isinstance(one, np.ndarray) else one == other


# Numbers of a scheme and its step, which a batch has in common: the kernels read them by place alone.
COMMON = {"tau", "moment", "node", "scale", "mix", "out", "forecast", "fraction", "coefficients"}


def shared_numbers(stack, one):
    """Names of the float64 arrays that a stack has as a member alone has them."""
    for name, many, own in zip(stack._fields, stack, one, strict=True):
        if isinstance(own, tuple):
            yield from shared_numbers(many, own)
        elif isinstance(own, np.ndarray) and own.dtype == np.float64 and many.shape == own.shape:
            yield name


@pytest.mark.parametrize("method", METHODS, ids=str)
def test_all_constants_but_those_of_the_scheme_stand_by_member(method):
    """Also where members agree in them, as in the period of an angle: the kernels read a column for each."""
    tables = [method.loop(system, 0.1).tables for system in members()]
    assert COMMON.issuperset(shared_numbers(stacked(tables), tables[0]))
    watches = [watch_tables(system, system.casimirs).tables for system in members()]
    assert not list(shared_numbers(stacked(watches), watches[0]))

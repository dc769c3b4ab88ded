"""Members that differ in their constants alone: one set of tables, from which each gets its own back."""

import numpy as np
import pytest

import coadjoint as co
from coadjoint.kernels.interface import limit
from coadjoint.kernels.tables.invariants import watch_tables
from coadjoint.kernels.tables.structures import per_member_fields, stacked, structure_of
from coadjoint.runs.loops.batch_loops import groups_of

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

"""Runs by the compiled loops themselves: cut where one likes, with the constants of every member its own."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from coadjoint.kernels.arrays import Extent, Layout, NamedArrays
from coadjoint.kernels.loop import MemberBatch, StopFlag, scheme_memory
from coadjoint.kernels.tables.invariants import watch_tables
from coadjoint.kernels.tables.recording import schedule_of
from coadjoint.kernels.tables.runge_kutta import RUNGE_KUTTA_LOOP, runge_kutta_tables

STATE = ("momenta", "errors", "groups", "group_errors", "memory")
PADDING = 32  # no ensemble has more lanes on any processor


def begin(systems, method, x0, h, steps, representation=None, fractions=(1.0,)):
    """Return a batch of members that start at x0 (members, n), each with a system of its own or all with one, and what
    it is given: layout and schedule, blocks of arrays; and what these need to be kept alive.
    """
    found = [runge_kutta_tables(system, method, representation, fractions) for system in systems]
    watches = [watch_tables(system, system.casimirs) for system in systems]
    members, n = x0.shape
    d = found[0].tables.group.size
    memory = scheme_memory(RUNGE_KUTTA_LOOP, found[0].tables)
    layout = Layout(Extent(members, 2, n, d * d, 1 + len(systems[0].casimirs), memory))
    saved, state = NamedArrays(layout.saved), NamedArrays(layout.state)
    state["momenta"][:], state["groups"][:] = x0, np.eye(d).ravel()
    tables, watch, stride = found[0].tables, watches[0].tables, 0
    if len(systems) > 1:
        stride = len(systems) + PADDING
        tables = spread([each.tables for each in found])
        watch = spread([each.tables for each in watches])
    member_batch = MemberBatch(RUNGE_KUTTA_LOOP, tables, watch, 0, members, stride)
    return member_batch, (layout, schedule_of(0.0, h, steps, steps, True)), (saved, state), (found, watches)


def spread(tables):
    """Put the constants of several members side by side, the last one repeated to fill whole lanes."""
    first = tables[0]
    filled = {}
    for name in first._fields:
        values = [getattr(table, name) for table in tables]
        if name in ("field", "group", "terms"):
            filled[name] = spread(values)
        elif name in ("offset", "weight", "coefficient", "constant", "value", "quadratic", "period", "addresses"):
            side_by_side = np.stack([*values, *[values[-1]] * PADDING], axis=-1)
            filled[name] = np.ascontiguousarray(side_by_side.reshape(-1))
    return first._replace(**filled)


def run(systems, method, x0, h, steps, *, cuts=(), keep=None, **how):
    """Return the state at the end and what was saved; `keep` is called with the state between calls, and returns the
    one that the next call works with.
    """
    member_batch, given, (saved, state), alive = begin(systems, method, x0, h, steps, **how)
    for k0, k1 in pairwise([0, *cuts, steps]):
        member_batch.advance(*given, saved, state, k0, k1, StopFlag())
        if keep is not None:
            state = keep(state)
    assert alive
    return state, saved

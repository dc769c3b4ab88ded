"""Runs by the compiled loops themselves: cut where one likes, with the constants of every member its own."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from coadjoint.kernels import runge_kutta
from coadjoint.kernels.loop import take_steps
from coadjoint.kernels.runge_kutta_tables import runge_kutta_tables
from coadjoint.kernels.tables import watch_tables
from coadjoint.kernels.watching import Report, Saves, Schedule, record_start

PADDING = 32  # no crowd has more lanes on any processor


def begin(systems, method, x0, h, steps, representation=None, fractions=(1.0,)):
    """Return what a loop is given for members that start at x0 (members, n), each with a system of its own or all with
    one, and the state.
    """
    found = [runge_kutta_tables(system, method, representation, fractions) for system in systems]
    watches = [watch_tables(system, system.casimirs) for system in systems]
    members, n = x0.shape
    d = found[0].tables.group.size
    count = 1 + len(systems[0].casimirs)
    saves = Saves(
        members,
        np.zeros((2, members, n)),
        np.zeros((2, members, d * d)),
        np.zeros((2, members, count)),
        np.zeros((members, 10, count)),
        np.zeros((members, count)),
        np.zeros((members, count)),
    )
    schedule = Schedule(0.0, h, steps, steps, True)
    groups = np.tile(np.eye(d).ravel(), (members, 1))
    memory = np.full((members, runge_kutta.memory_of(found[0].tables)), np.nan)
    state = (x0.copy(), np.zeros((members, n)), groups, np.zeros((members, d * d)), memory)
    whole = [np.zeros(members, dtype=np.int64) for _ in range(4)]
    report = Report(whole[0], whole[1], np.zeros(members), whole[2], whole[3])
    record_start(watches[0].tables, saves, schedule, state)
    tables, watch, stride = found[0].tables, watches[0].tables, 0
    if len(systems) > 1:
        stride = len(systems) + PADDING
        tables = spread([each.tables for each in found])
        watch = spread([each.tables for each in watches])
    given = (tables, watch, saves, schedule, state)
    return given, report, stride, (found, watches)


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
    """Return the state at the end, the saved points and the report; `keep` is called with the state between calls."""
    given, report, stride, alive = begin(systems, method, x0, h, steps, **how)
    for k0, k1 in pairwise([0, *cuts, steps]):
        tables, watch, saves, schedule, state = given
        crew = np.array([0, len(x0)])
        take_steps("runge_kutta_advance", tables, watch, saves, schedule, state, crew, k0, k1, report, stride)
        if keep is not None:
            given = (tables, watch, saves, schedule, keep(state))
    assert alive
    return given[4], given[2], report

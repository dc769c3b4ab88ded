"""The program: which rows a scheme becomes, what is merged, and what must not be."""

import math

import numpy as np
import pytest

import coadjoint as co
from coadjoint.program.interpreter import Interpreter
from coadjoint.program.table import build_program


def sections(program):
    rows = program.rows
    ends = rows.section
    all_rows = list(zip(rows.part.tolist(), rows.coefficient.tolist(), rows.moment.tolist(), strict=True))
    return [all_rows[ends[k] : ends[k + 1]] for k in range(3)]


def top(sign=+1):
    return co.LiePoissonSystem(co.algebras.e(3), co.Quadratic([1.0, 0.5, 0.25, 2.0, 3.0, 4.0]), sign=sign)


DRIVEN = (lambda y, t: 0.5 * y * y * (2.0 + math.sin(t)), lambda y, t: y * (2.0 + math.sin(t)))
STEADY = (lambda y: 0.25 * y * y, lambda y: 0.5 * y)


def driven():
    return co.LiePoissonSystem(co.algebras.sl(2), co.Separable({0: DRIVEN, 1: STEADY, 2: STEADY}))


def test_second_order_merges_the_outer_halves_of_consecutive_steps():
    start, step, finish = sections(build_program(top(), co.Splitting(order=2)))
    assert [row[:2] for row in start] == [(0, 0.5), (1, 0.5), (2, 1.0), (1, 0.5)]
    assert [row[:2] for row in step] == [(0, 1.0), (1, 0.5), (2, 1.0), (1, 0.5)]
    assert [row[:2] for row in finish] == [(0, 0.5)]


@pytest.mark.parametrize("adjoint", [False, True])
def test_first_order_is_one_sweep(adjoint):
    start, step, finish = sections(build_program(top(), co.Splitting(order=1, adjoint=adjoint)))
    assert start == step and finish == []
    assert [row[0] for row in start] == ([2, 1, 0] if adjoint else [0, 1, 2])


def test_the_sign_is_in_the_coefficients():
    plus, minus = (build_program(top(sign), co.Splitting(order=4)).rows.coefficient for sign in (1, -1))
    assert np.array_equal(plus, -minus)


@pytest.mark.parametrize("method", [co.Splitting(order=2), co.Splitting(order=4), co.Splitting(scheme="yoshida4")])
def test_each_part_moves_for_one_step_in_all(method):
    """Fractions of the step add up to one, k u for k of them: over a step, and over start and finish together."""
    program = method.program(top())
    start, step, finish = sections(program)
    for rows in (start + finish, step):
        for part in range(3):
            own = [coefficient for p, coefficient, _ in rows if p == part]
            assert abs(sum(own) - 1.0) <= len(own) * 2.0**-53 * sum(map(abs, own))


def test_flows_at_different_times_are_not_merged():
    """Within one step the two halves of the first substep share its middle; the halves of consecutive steps do not."""
    start, step, finish = sections(build_program(driven(), co.Splitting(order=2, parts="coordinates")))
    assert finish == [] and start == step
    assert [(p, c, m) for p, c, m in step] == [
        (0, 0.5, 0.5),
        (1, 0.5, 0.5),
        (2, 1.0, 0.5),
        (1, 0.5, 0.5),
        (0, 0.5, 0.5),
    ]
    start, step, _ = sections(build_program(driven(), co.Splitting(scheme="suzuki4", parts="coordinates")))
    assert start == step
    assert [p for p, _, _ in step].count(0) == 10  # timed: two in each of five substeps
    assert [p for p, _, _ in step].count(2) == 5


def test_only_timed_parts_are_kept_apart():
    _, step, finish = sections(build_program(driven(), co.Splitting(order=2, parts=[[2], [1], [0]])))
    assert len(finish) == 1 and [row[0] for row in step] == [0, 1, 2, 1]


@pytest.mark.thinned(2)
@pytest.mark.parametrize("timed", [(3,), (4,), (5,), (3, 5), (0, 4)])
def test_a_part_is_timed_if_any_of_its_functions_is(timed):
    """The functions of p1, p2, p3 are one part, wherever the one of time stands among them."""
    kinds = {True: DRIVEN, False: STEADY}
    system = co.LiePoissonSystem(co.algebras.e(3), co.Separable({k: kinds[k in timed] for k in (0, 3, 4, 5)}))
    method = co.Splitting(order=2, parts=[[3, 4, 5], [0]])
    program = build_program(system, method)
    assert program.parts.timed.tolist() == [bool({3, 4, 5} & set(timed)), 0 in timed]
    # The flows of the first part at the end of a step and at the start of the next one are at different times.
    start, step, finish = sections(program)
    assert (finish == [] and start == step) and [part for part, _, _ in step] == [0, 1, 0]
    x0 = np.array([0.4, -0.3, 0.2, 0.9, 0.5, -0.7])
    x = x0
    for k in range(3):
        x = Interpreter(program).steps(x, 0.25, 1, 0.7 + 0.25 * k)
    whole = co.integrate(system, x0, (0.7, 1.45), 0.25, method).x[-1]
    assert np.abs(Interpreter(program).steps(x0, 0.25, 3, 0.7) - x).max() <= 64 * 2.0**-53
    assert np.abs(whole - x).max() <= 64 * 2.0**-53


def test_first_order_takes_time_at_its_start_and_the_adjoint_at_its_end():
    for adjoint, moment in ((False, 0.0), (True, 1.0)):
        start, _, _ = sections(build_program(driven(), co.Splitting(order=1, adjoint=adjoint)))
        assert {row[2] for row in start} == {moment}


def test_one_part_is_one_row():
    s = co.LiePoissonSystem(co.algebras.heisenberg(2), co.Quadratic([1.0, 2.0, 0, 0, 0]))
    for order in (1, 2, 4):
        start, step, finish = sections(build_program(s, co.Splitting(order=order)))
        assert len(start) + len(finish) >= 1 and len(step) == 1
        assert abs(step[0][1] - 1.0) <= 8 * 2.0**-53


@pytest.mark.long
def test_step_after_step_is_the_same_as_single_steps():
    """The merged table against one step at a time, each begun and finished: rounding of 50 steps of 5 flows."""
    for s in (top(), driven()):
        for order in (1, 2, 4):
            read = Interpreter(build_program(s, co.Splitting(order=order)))
            x = np.linspace(0.3, 1.1, s.dim)
            together, single = read.steps(x, 0.05, 50, t0=0.5), x
            for k in range(50):
                single = read.steps(single, 0.05, 1, t0=0.5 + k * 0.05)
            assert np.abs(together - single).max() <= 50 * 25 * 2.0**-53 * 8


def test_a_group_element_is_optional_and_acts_in_its_representation():
    assert build_program(top(), co.Splitting()).group is None
    assert build_program(top(), co.Splitting(), group="coadjoint").group.size == 6
    assert build_program(top(), co.Splitting(), group=top().representation).group.size == 4

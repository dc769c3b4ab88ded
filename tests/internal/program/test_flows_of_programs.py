"""The program: which rows a scheme becomes, its reading in any number type, and steps against dense matrices."""

import dataclasses
import math
from fractions import Fraction

import mpmath
import numpy as np
import pytest
from scipy.linalg import expm

import coadjoint as co
from coadjoint.program.interpreter import Interpreter
from coadjoint.program.numbers import array_of, convert, roundoff
from coadjoint.program.parts.decompose import decompose
from coadjoint.program.parts.second_order import part_derivatives
from coadjoint.program.table import build_program
from drawn_matrices import constants_of
from refusals import refused


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
def test_first_order_is_one_sweep_at_one_time(adjoint):
    """The time of its start; the adjoint takes that of its end."""
    for system, timed in ((top(), False), (driven(), True)):
        start, step, finish = sections(build_program(system, co.Splitting(order=1, adjoint=adjoint)))
        parts = [row[0] for row in start]
        assert start == step and finish == [] and parts == sorted(set(parts), reverse=adjoint)
        assert not timed or {row[2] for row in start} == {float(adjoint)}


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
    _, step, finish = sections(build_program(driven(), co.Splitting(order=2, parts=[[2], [1], [0]])))
    assert len(finish) == 1 and [row[0] for row in step] == [0, 1, 2, 1]  # only timed parts are kept apart


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


def test_a_tangent_needs_second_derivatives():
    s = co.LiePoissonSystem(co.algebras.sl(2), co.Separable({0: (math.cosh, math.sinh), 2: (math.cosh, math.sinh)}))
    read = Interpreter(build_program(s, co.Splitting()))
    with pytest.raises(TypeError, match="hessian"):
        read.steps(np.ones(3), 0.1, 1, tangent=np.eye(3))


def test_number_types_without_elementary_functions_are_refused():
    s = top()
    with refused(TypeError, "Fraction"):
        Interpreter(build_program(s, co.Splitting(), number=Fraction))


def test_roundoff_is_half_the_gap_above_one():
    assert roundoff(float) == 2.0**-53
    assert roundoff(Fraction) == 0
    with mpmath.workdps(40):
        assert roundoff(mpmath.mpf) == mpmath.mpf(2) ** -mpmath.mp.prec


@dataclasses.dataclass(frozen=True)
class SweepAndAdjoint(co.methods.FlowMethod):
    """A sweep over 0.1 h and its adjoint over 0.9 h, of one moment; in 53 bits the floats 0.1 and 0.9 add up to 1."""

    order, explicit, symmetric = 1, True, False

    def properties(self, system):
        return co.Splitting().properties(system)

    def sweeps(self, number=float):
        return [co.methods.Sweep(k == 0, number(c), number(0.5)) for k, c in enumerate((0.1, 0.9))]


@pytest.mark.thinned(3)
@pytest.mark.parametrize("scheme", [co.Splitting(scheme="suzuki4"), SweepAndAdjoint()], ids=str)
def test_steps_in_more_digits_do_not_use_the_numbers_of_fewer(scheme):
    """Coefficients of 50 digits, and sums of coefficients, against the sweeps one after the other."""
    s, sweep = top(), {k: co.Splitting(order=1, adjoint=not k) for k in (0, 1)}

    def step_of(method, h):
        return method.step(s, x, mpmath.mpf(0), h)

    x = np.array([mpmath.mpf(v) for v in np.linspace(-0.5, 0.75, s.dim)], dtype=object)
    step_of(scheme, mpmath.mpf(0.125))
    with mpmath.workdps(40):
        end = step_of(scheme, mpmath.mpf(0.125))
        for each in scheme.sweeps(mpmath.mpf):
            x = step_of(sweep[each.forward], each.coefficient * mpmath.mpf(0.125))
        assert max(abs(end - x)) < 1e-38


@pytest.mark.thinned(3)
@pytest.mark.parametrize("value", [0.1, 3, Fraction(1, 3), np.float64(0.1), np.int64(7)])
def test_values_reach_the_number_type_without_a_detour(value):
    with mpmath.workdps(40):
        exact = Fraction(value.item() if isinstance(value, np.generic) else value)
        got = convert(mpmath.mpf, value)
        assert abs(got - mpmath.mpf(exact.numerator) / exact.denominator) <= abs(got) * roundoff(mpmath.mpf)
        assert convert(mpmath.mpf, "0.1") != mpmath.mpf(0.1)
    assert convert(float, value) == float(exact)


def test_arrays_are_float64_or_objects():
    assert array_of(float, [Fraction(1, 4), 2]).dtype == np.float64
    exact = array_of(Fraction, np.array([0.5, 2.0]))
    assert exact.dtype == object and list(exact) == [Fraction(1, 2), Fraction(2)]


U = 2.0**-53
BASES = {
    "so(3)": co.algebras.so(3),
    "sl(2)": co.algebras.sl(2),
    "e(3)": co.algebras.e(3),
    "Heisenberg": co.algebras.heisenberg(1),
    "spiral": co.algebras.get("A3,7", a=0.5),
    "scaling": co.LieAlgebra([(0, 1, 1, -1.0), (0, 2, 2, 2.0), (0, 2, 1, 1.0)], dim=3),
}


def drawn_basis(rng, n):
    """A matrix of whole numbers with determinant one or minus one, times powers of two with signs."""
    lower, upper = rng.integers(-1, 2, (2, n, n))
    T = (np.tril(lower, -1) + np.eye(n)) @ (np.triu(upper, 1) + np.eye(n))
    return np.diag(rng.choice([-2.0, -1.0, -0.5, 0.5, 1.0, 2.0], n)) @ T


def of_one_pattern(name, rng):
    """Three copies of an algebra in one basis up to the sizes and signs of its elements."""
    algebra = BASES[name]
    if rng.random() < 0.6:
        algebra = co.algebras.change_of_basis(algebra, drawn_basis(rng, algebra.dim))
    scales = [np.diag(rng.choice([-3.0, -1.0, -0.5, 0.5, 1.0, 2.0], algebra.dim)) for _ in range(3)]
    if rng.random() < 0.5:
        scales = [np.eye(algebra.dim) * factor for factor in (1.0, -2.0, 0.5)]
    return co.algebras.direct_sum(*(co.algebras.change_of_basis(algebra, scale) for scale in scales))


def drawn_system(name, seed):
    rng = np.random.default_rng([seed, *map(ord, name)])
    algebra = of_one_pattern(name, rng)
    n = algebra.dim
    if seed % 2:  # one full matrix for all copies, with other linear terms
        A = np.triu(rng.integers(-4, 5, (n // 3, n // 3)) / 8.0)
        M = np.kron(np.eye(3), A + A.T - np.diag(np.diag(A) * rng.choice([1.0, 2.0])))
    else:
        A = np.triu(rng.integers(-4, 5, (n, n)) / 4.0 * (rng.random((n, n)) < 0.25))
        M = np.diag(rng.integers(-4, 5, n) / 4.0) + 0.25 * (A + A.T)
    linear = rng.integers(-2, 3, n) / 2.0 * (rng.random(n) < 0.5)
    system = co.LiePoissonSystem(algebra, co.Quadratic(M, linear=linear), sign=int(rng.choice([-1, 1])))
    return system, 0.5 * rng.uniform(-1, 1, n), float(rng.choice([-0.2, 0.2]))


def strang(count):
    """Pairs of a part and its fraction of a step of order two."""
    half = [(p, 0.5) for p in range(count)]
    return [*half, *half[::-1]]


def dense_step(system, parts, x, g, h):
    """A step on the momentum x and the group element g, in the coadjoint representation, and the amplification."""
    c, size = constants_of(system.algebra), 1.0
    for p, fraction in strang(len(parts)):
        slope = part_derivatives(parts, x[None])[0][p, 0]
        D = fraction * h * system.sign * np.einsum("ijk,j->ik", c, slope)  # D x = J(x) grad of the piece
        size *= np.linalg.norm(expm(np.abs(D)), np.inf)
        x, g = expm(D) @ x, g @ expm(-D)
    return x, g, size


def check_step(system, choice, x, h):
    """Compare a step in Python, with its group element, and the compiled one with dense matrices."""
    n, decomposition = system.dim, decompose(system, choice)
    parts = decomposition.parts
    # The pieces add up to the energy minus the Casimirs, up to a constant.
    pieces = part_derivatives(parts, x[None])[0].sum(axis=0)[0]
    casimirs = sum((factor * C.gradient(x) for C, factor in decomposition.shift), np.zeros(n))
    expected = system.hamiltonian.gradient(x) - casimirs
    assert np.abs(pieces - expected).max() <= 2.0**-40  # squares amplify rounding by at most some hundreds
    wanted, moved, size = dense_step(system, parts, x, np.eye(n), h)
    method = co.Splitting(order=2, parts=choice)
    end, group = Interpreter(build_program(system, method, group="coadjoint")).steps(x, h, 1, group=np.eye(n))
    # Rounding of each flow, amplified by all: n products in a sum, some dozens in the series of expm.
    tolerance = 64 * n * len(parts) * U * size
    assert np.abs(end - wanted).max() <= tolerance
    assert np.abs(group - moved).max() <= tolerance * size
    assert np.abs(co.stepper(system, method, h)(x) - wanted).max() <= tolerance


@pytest.mark.thinned(15)
@pytest.mark.parametrize(
    ("seed", "choice"), [(0, "coordinates"), (1, "coordinates"), (2, "coordinates"), (3, "auto"), (4, "auto")]
)
@pytest.mark.parametrize("name", BASES)
def test_a_step_is_that_of_dense_matrices(name, seed, choice):
    system, x, h = drawn_system(name, seed)
    check_step(system, choice, x, h)


@pytest.mark.parametrize("first", ["auto", "coordinates"])
def test_choices_and_linear_terms_of_one_pattern_in_turn(first):
    """Tables of equal forms are cached: neither the grouping of the forms nor the linear term may be that of another.

    In the algebra e1, e2 commute, so that the parts are {e1, e2}, {e3} or one each, with the same forms.
    """
    x = np.array([0.5, -0.25, 0.75])
    for factor in (1.0, 2.0):
        algebra = co.LieAlgebra([(0, 2, 0, factor), (0, 2, 1, -1.0), (1, 2, 0, 1.0), (1, 2, 1, factor)], dim=3)
        for linear in ([0.0, 0.0, 0.0], [0.5, 0.0, -1.0], [0.0, -2.0, 0.0]):
            for M in ([1.0, 0.5, -0.25], [0.0, 0.5, 1.0]):
                system = co.LiePoissonSystem(algebra, co.Quadratic(M, linear=linear))
                for choice in (first, {"auto": "coordinates", "coordinates": "auto"}[first]):
                    check_step(system, choice, x, 0.2)

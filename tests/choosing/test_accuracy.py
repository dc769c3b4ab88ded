"""Choice of scheme and step for an accuracy: reproducibility, description, refusals and cost model."""

import math

import numpy as np
import pytest

import coadjoint as co
from coadjoint.choosing.candidates import supported_candidates
from coadjoint.choosing.pilot import Growth, Pilot, Trial
from coadjoint.choosing.roundoff import roundoff
from coadjoint.methods.protocol.cost_model import FUNCTION_COST, MULTIPLICATION_COST, flow_work, iteration_work
from coadjoint.program.table import build_program

pytestmark = pytest.mark.sensitive

BODY = co.systems.rigid_body(inertia=(1, 2, 3))
X0 = (1.0, 0.2, 0.5)
SPAN = (0.0, 40.0)


def four():
    return co.LiePoissonSystem(co.algebras.so(4), co.Quadratic([1.0, 0.5, 0.3, 0.2, 0.7, 0.9]))


# Reproducibility


def test_choice_is_deterministic():
    first, second = (co.choose(co.systems.rigid_body(inertia=(1, 2, 3)), X0, SPAN, 1e-7) for _ in range(2))
    assert first == second and first.others == second.others


def test_options_of_the_run_do_not_change_the_choice():
    runs = [
        co.integrate(BODY, [X0, (0.1, 1.0, 0.1)], SPAN, accuracy=1e-7, **options)
        for options in ({}, {"watch": False}, {"save_every": 7}, {"threads": 1}, {"threads": 2})
    ]
    for run in runs[1:]:
        assert run.method == runs[0].method and run.step == runs[0].step
        assert np.array_equal(run.x[-1], runs[0].x[-1])


def test_run_uses_the_choice():
    choice = co.choose(BODY, X0, SPAN, 1e-7)
    run = co.integrate(BODY, X0, SPAN, accuracy=1e-7)
    assert (run.method, run.step) == (choice.method, choice.step)
    assert round(40.0 / choice.step) == run.stats.steps
    fixed = co.integrate(BODY, X0, SPAN, method=co.Splitting(order=4), accuracy=1e-7)
    assert fixed.method == co.Splitting(order=4)
    assert np.linalg.norm(fixed.x[-1] - BODY.exact(X0, 40.0)) <= 1e-7 * np.linalg.norm(X0)


# Description and special cases


def test_choice_text_is_one_line():
    choice = co.choose(BODY, X0, SPAN, 1e-7)
    text = str(choice)
    assert "\n" not in text and str(choice.method) in text and "wanted 1.0e-07" in text and "next" in text
    assert choice.roundoff < choice.error < choice.accuracy == 1e-7
    assert [each.cost for each in choice.others] == sorted(each.cost for each in choice.others)
    assert choice.cost <= choice.others[0].cost


def test_empty_span_and_state_at_rest():
    assert len(co.integrate(BODY, X0, (3, 3), accuracy=1e-6).t) == 1
    for x0 in ((0.0, 0.0, 0.0), (0.0, 0.0, 2.0)):
        run = co.integrate(BODY, x0, SPAN, accuracy=1e-6)
        assert np.array_equal(run.x[-1], x0)


def test_linear_flow_takes_one_step():
    spinning = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([0.0, 0.0, 0.0], linear=[0.0, 0.0, 1.0]))
    choice = co.choose(spinning, X0, SPAN, 1e-9)
    assert choice.step == 40.0 and isinstance(choice.method, co.Splitting)


def test_compensated_sums_where_rounding_requires_them():
    """Small steps of a low order over a long time: uncompensated, rounding alone would exceed the accuracy."""
    loose = co.choose(BODY, X0, (0, 400), 1e-6, methods=[co.Splitting(order=4), co.Splitting(order=6)])
    tight = co.choose(BODY, X0, (0, 400), 2e-12, methods=[co.Splitting(order=4), co.Splitting(order=6)])
    assert loose.method.compensated is None and tight.method.compensated is True
    run = co.integrate(BODY, X0, (0, 400), tight.step, tight.method, watch=False)
    assert np.linalg.norm(run.x[-1] - BODY.exact(X0, 400.0)) <= 2e-12 * np.linalg.norm(X0)


def test_schemes_without_the_attitude_are_left_out():
    """Gauss methods carry no rotation matrices of so(4), but splittings and Taylor series do."""
    x0 = np.linspace(0.2, 1.0, 6)
    unable = [co.GaussLegendre(4), co.GaussLegendre(8), co.RadauEnergy(2)]
    with pytest.raises(ValueError, match="spatial momentum"):
        co.choose(four(), x0, (0, 10), 1e-8, methods=unable, attitude=True)
    assert isinstance(co.choose(four(), x0, (0, 10), 1e-8, methods=unable).method, co.GaussLegendre)
    assert isinstance(co.choose(four(), x0, (0, 10), 1e-8, attitude=True).method, co.Taylor | co.Splitting)
    carried = co.integrate(BODY, X0, SPAN, accuracy=1e-8, attitude=True)
    assert np.linalg.norm(carried.attitude[-1] @ carried.x[-1] - X0) < 1e-8 * np.linalg.norm(X0)


def test_processed_splittings_cost_less():
    splittings = [co.Splitting(order=p) for p in (6, 8, 10)]
    processed = [co.Splitting(scheme=f"blanes_casas_murua{p}") for p in (6, 8, 10)]
    plain, both = (co.choose(BODY, X0, (0, 200), 1e-9, methods=each) for each in (splittings, splittings + processed))
    assert both.method in processed and both.cost < plain.cost
    every = co.choose(BODY, X0, (0, 200), 1e-9, processed=True)
    assert every.cost <= co.choose(BODY, X0, (0, 200), 1e-9).cost


# Refusals


def test_wrong_schemes_are_refused():
    with pytest.raises(TypeError, match=r"methods contains 3.*schemes"):
        co.choose(BODY, X0, SPAN, 1e-6, methods=[3])
    with pytest.raises(TypeError, match="methods contains nothing"):
        co.choose(BODY, X0, SPAN, 1e-6, methods=[])
    with pytest.raises(ValueError, match="Splitting needs a Lie algebra"):
        skew = co.PoissonSystem(lambda x: np.array([[0.0, x[0]], [-x[0], 0.0]]), co.Quadratic([1.0, 2.0]))
        co.choose(skew, (1.0, 0.5), SPAN, 1e-6, methods=co.Splitting())


def test_blow_up_names_its_time():
    """x1' = x1 x2, x2' = x1^2: the invariant x1^2 - x2^2 is negative, and x2 is a cotangent of time."""
    rising = co.LiePoissonSystem(
        co.LieAlgebra.from_brackets(2, {(0, 1): {0: 1.0}}), co.Quadratic([-1.0, 1.0]), name="rising"
    )
    assert co.choose(rising, (0.5, 0.9), (0, 1), 1e-6).error < 1e-6
    with pytest.raises(ValueError, match=r"rising.*t_span.*near t = 1"):
        co.choose(rising, (0.5, 0.9), (0, 10), 1e-6)


def test_chaotic_system_is_refused():
    full = co.LiePoissonSystem(co.algebras.so(4), co.Quadratic(np.diag(np.arange(1, 7.0)) + 0.3))
    with pytest.raises(ValueError, match="float64 with any scheme over the time 400"):
        co.choose(full, np.linspace(-1, 1, 6), (0, 400), 1e-3)


# Growth, costs and rounding


def test_growth_is_extrapolated():
    assert Growth(1.0, 1.0, 1.0).factor(1.0) == 1.0
    assert Growth(0.0, 0.0, 0.0).factor(100.0) == 1.0
    # A constant error is taken to grow linearly; quadratic growth is continued; a burst grows by its last power.
    assert Growth(1.0, 1.0, 1.0).factor(9.0) == 9.0
    assert Growth(1.0, 4.0, 16.0).factor(3.0) == pytest.approx(9.0)
    assert Growth(1.0, 2.0, 200.0).factor(2.0) == pytest.approx(200.0 ** (4 / 3))
    assert Growth(1.0, 1e3, 1e6).factor(1e6) == math.inf
    assert Growth(1.0, 1.0, 1.0).factor(9.0, 2.0) == 81.0
    assert Growth(1.0, 6.0, 36.0).factor(3.0, 2.0) == Growth(1.0, 6.0, 36.0).factor(3.0)


def test_growth_is_quadratic_where_no_integral_is_preserved():
    """Symmetric schemes and Poisson maps preserve integrals, and a projection does where the orbit is a curve."""
    top = co.LiePoissonSystem(
        co.algebras.e(3), co.Quadratic([1.0, 0.75, 0.5, 0, 0, 0], linear=[0, 0, 0, 0.125, 0, 0.25]), sign=-1
    )
    for system, x0, square in ((BODY, (1.0, 0.2, 0.5), []), (top, (0.5, 0.25, -0.5, 0.6, 0.0, 0.8), [co.Taylor(12)])):
        pilot = Pilot(system, np.array([x0]), 0.0, 1e4)
        alone = co.Taylor(12, projected=False)
        for method in (co.GaussLegendre(4), co.Splitting(order=4), co.Taylor(12), alone):
            (candidate,) = supported_candidates(system, [method], x0, False, strict=True)
            trial = Trial(100, Growth(0.25, 0.5, 1.0), 1.0, 1.0)
            power = 2 if method in square or method is alone else 1
            assert candidate.growth(pilot, trial) == pytest.approx(pilot.windows**power)


def test_cost_weights_match_measured_times():
    """A rotation takes 11 ns, eight stages in three dimensions 15 to 20, a step of a series of order 16 90 to 130."""
    program = build_program(BODY, co.Splitting(order=2))
    assert flow_work(program, False) == pytest.approx(2.0)
    assert 2.0 < flow_work(program, True) < 3.0
    assert 15 / 11 < iteration_work(BODY, 8.0, None) < 20 / 11
    assert 90 / 11 < co.Taylor(16).work(BODY).cost(1.0, 16.0) < 130 / 11
    assert iteration_work(BODY, 8.0, None) < iteration_work(BODY, 8.0, "coadjoint")
    assert iteration_work(BODY, 9.0, None) > 1.5 * iteration_work(BODY, 8.0, None)


def test_sparse_series_are_counted():
    """A step of these moments takes four of them: 320 ns, where 2.2 rotations would take 25."""
    beam = co.systems.vlasov_moments(4, "1/2*x20 + 1/8*x20^2 + 1/64*x40")
    program = build_program(beam, co.Splitting(order=2))
    assert 200 / 11 < flow_work(program, False) < 400 / 11


def test_compensation_is_counted():
    (plain,) = supported_candidates(BODY, [co.Splitting(order=2)], X0, False, strict=False)
    better = plain.compensated()
    assert better.method.compensated and better.work.cost(0.0, 0.0) == flow_work(better.method.program(BODY), True)
    assert better.work.cost(0.0, 0.0) > plain.work.cost(0.0, 0.0) == flow_work(plain.method.program(BODY), False)


def test_user_functions_are_counted():
    """The same energy as numbers and as functions: one call for each flow and each evaluation of the field."""
    numbers = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1.0, 0.5, 0.25]))
    functions = co.LiePoissonSystem(
        co.algebras.so(3),
        co.Separable(
            {i: (lambda y, m=m: 0.5 * m * y * y, lambda y, m=m: m * y) for i, m in enumerate((1.0, 0.5, 0.25))}
        ),
    )
    coordinates = co.Splitting(parts="coordinates")
    plain, called = (flow_work(build_program(system, coordinates), False) for system in (numbers, functions))
    flows = build_program(functions, coordinates).rows
    count = int(flows.section[2] - flows.section[1])
    assert called - plain == pytest.approx(
        count * (FUNCTION_COST - MULTIPLICATION_COST), abs=count * 2 * MULTIPLICATION_COST
    )
    apart = iteration_work(functions, 8.0, None) - iteration_work(numbers, 8.0, None)
    assert apart > 8.0 * 3 * FUNCTION_COST * 0.9


def test_rounding_model_is_accurate_within_a_factor():
    """Compensated against plain sums of the same steps differ by the rounding of the plain ones."""
    states = np.random.default_rng(2).standard_normal((8, 3))
    for span, step in ((100.0, 0.01), (400.0, 0.02)):
        plain, compensated = (
            co.integrate(BODY, states, (0, span), step, co.Splitting(order=4, compensated=c), watch=False).x[-1]
            for c in (False, True)
        )
        found = np.linalg.norm(plain - compensated, axis=1) / np.linalg.norm(states, axis=1)
        rows = build_program(BODY, co.Splitting(order=4)).rows.section
        pilot = Pilot(BODY, states, 0.0, span)
        expected = roundoff(pilot, round(span / step), int(rows[2] - rows[1]), False, pilot.windows)
        # Not below what is there, and above the root mean square by no more than it takes to be on the safe side.
        assert np.max(found) <= expected <= 50 * math.sqrt(np.mean(found**2))

"""What the rows of a certificate are made of: references, studies, noise, conditions, elements, directions."""

import math

import numpy as np
import pytest

import coadjoint as co
from coadjoint.analysis.certificates import attitude, invariants, step_map, subject
from coadjoint.analysis.certificates.certify import scheme_and_claims
from coadjoint.analysis.certificates.convergence import allowed_error
from coadjoint.analysis.certificates.invariants import size_of
from coadjoint.analysis.certificates.reference import Norm, motion, natural_time
from coadjoint.analysis.certificates.subject import Subject
from rounding import UNIT_ROUNDOFF as U

Properties = co.methods.Properties
BODY = co.systems.rigid_body(inertia=(1, 2, 3))
X0 = np.array([0.3, 1.0, 0.2])
RNG = np.random.default_rng(7)


@pytest.mark.parametrize(("speed", "rests"), [(32 * U, True), (128 * U, False)])
def test_a_state_rests_up_to_its_threshold(speed, rests):
    system = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(np.zeros(3), linear=(0.0, 0.0, speed)))
    assert (natural_time(system, np.array([1.0, 0.0, 0.0])) == 0.0) is rests


def subject_of(system, method, states, h, steps=32, **said):
    scheme, claims = scheme_and_claims(system, method, said.get("order"), said.get("properties"), said.get("symmetric"))
    states = np.atleast_2d(np.asarray(states, dtype=float))
    return Subject(system, scheme, h, states, steps, **claims)


@pytest.mark.thinned(2)
@pytest.mark.parametrize("h", [0.1, -0.1])
@pytest.mark.parametrize("place", [None, (1, 0), (9, 3), (-1, 1)])
def test_a_wrong_group_element_is_seen_at_any_time_of_any_member(place, h, monkeypatch):
    run_of = attitude._run

    def off(subject, kind, steps):
        run, elements, condition = run_of(subject, kind, steps)
        if place is not None and not (kind == "coadjoint" and untouched):
            elements = elements.copy()
            elements[place] += 1e-8 * np.outer([1.0, -2.0, 0.5], [0.3, 1.0, 2.0])
        return run, elements, condition

    monkeypatch.setattr(attitude, "_run", off)
    for untouched in (False, True):
        rows = {row.key: row for row in attitude.attitude_rows(subject_of(BODY, co.Splitting(), X0, h), None, 32)}
        assert list(rows) == ["spatial momentum", "group", "element"]
        for key, row in rows.items():
            fails = place is not None and not (key == "spatial momentum" and untouched)
            assert row.verdict == ("fails" if fails else "holds"), str(row)
            assert row.claimed and (row.value > row.bound) == fails


def test_the_element_of_a_growing_motion_is_seen_over_fewer_steps():
    """g grows like exp(t): its condition number limits the run, of one member as of another."""
    line = co.LieAlgebra.from_brackets(2, {(0, 1): {1: 1.0}})
    system = co.LiePoissonSystem(line, co.Quadratic(0.0, linear=[1.0, 0.0]))
    subject = subject_of(system, co.Splitting(), [[0.5, 0.3], [0.2, 0.1], [0.1, 0.2], [0.7, 0.1]], 0.25)
    run, g, condition = attitude._run(subject, "coadjoint", 256)
    assert condition <= attitude.MAX_CONDITION and 8 <= run.stats.steps < 256
    values = np.linalg.svd(g, compute_uv=False)
    assert condition == pytest.approx(np.max(values[..., 0] / values[..., -1]))
    longer = subject.run(subject.states, 0.25, 2 * run.stats.steps, attitude="coadjoint").attitude
    assert np.max(np.linalg.cond(longer)) > attitude.MAX_CONDITION


def test_the_size_of_an_invariant_is_before_cancellation():
    """|gradient| |x| and the sum of the absolute terms, for any signs of coefficients and coordinates."""
    rng = np.random.default_rng(8)
    for _ in range(5):
        x = rng.normal(size=3)
        M, b = rng.normal(size=(3, 3)), rng.normal(size=3)
        M, c = M + M.T, float(rng.normal())
        quadratic = co.Quadratic(M, linear=b, constant=c)
        slope = np.linalg.norm(M @ x + b) * np.linalg.norm(x)
        terms = np.abs(x) @ np.abs(M) @ np.abs(x) / 2 + np.abs(b) @ np.abs(x) + abs(c)
        assert size_of(quadratic, x, Norm()) == pytest.approx(terms + slope, rel=1e-12)
        cubic = co.Polynomial({(3, 0, 0): -2.0, (1, 1, 1): 3.0, (0, 1, 0): -1.0})
        slope = np.linalg.norm(cubic.gradient(x)) * np.linalg.norm(x)
        terms = 2.0 * abs(x[0]) ** 3 + 3.0 * abs(x[0] * x[1] * x[2]) + abs(x[1])
        assert size_of(cubic, x, Norm()) == pytest.approx(terms + slope, rel=1e-12)

        def function(y):
            return y[0] - 2.0 * y[1] * y[2]

        slope = np.linalg.norm([1.0, -2.0 * x[2], -2.0 * x[1]]) * np.linalg.norm(x)
        # Central differences of a quadratic function, by steps of 2^-17: to 1e-16 * 2^17 and some.
        assert size_of(function, x, Norm()) == pytest.approx(abs(function(x)) + slope, rel=1e-9)


def test_errors_that_are_allowed_follow_the_order_and_the_ratio_of_the_steps():
    """An error C h^p changes by (r^p - 1) times that of the smaller step; six times as much is allowed."""
    for order in (1, 2, 4):
        for ratio in (1.25, 2.0, 3.0):
            assert allowed_error(ratio**order - 1.0, ratio**-order) == pytest.approx(6.0)


@pytest.mark.parametrize("t", [3.0, -3.0, 0.25])
def test_a_reference_is_the_motion_of_every_state(t):
    states = np.array([[0.3, 1.0, 0.2], [1e-3, 2e-3, -1e-3], [2.0, -1.0, 0.5]])
    inertia = 1.0 / np.array([1.0, 2.0, 3.0])
    plain = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(inertia), sign=BODY.sign)
    exact = np.array([BODY.exact(x, t) for x in states])
    size = np.linalg.norm(exact)
    for system, by in ((BODY, "the closed form"), (plain, "DOP853 on the vector field")):
        found = motion(system, states, t)
        assert found.by == by and found.contradiction == ""
        assert np.linalg.norm(found.states - exact) <= (found.error + 64 * 2.0**-53) * size
        assert found.error < 1e-11
        np.testing.assert_array_equal(motion(system, states[::-1].copy(), t).states, found.states[::-1])
        there = motion(system, found.states, -t)
        assert np.linalg.norm(there.states - states) < 1e-11 * size
    assert np.array_equal(motion(plain, states, 0.0).states, states)


def test_the_natural_time_is_that_of_the_fastest_change():
    """Of a quadratic energy it is inverse to the size; at rest there is none; a turn may be faster than the speed."""
    for factor in (1e-3, 1.0, 1e3):
        assert natural_time(BODY, factor * X0) == pytest.approx(natural_time(BODY, X0) / factor, rel=1e-6)
    assert natural_time(BODY, np.array([0.0, 1.0, 0.0])) == natural_time(BODY, np.zeros(3)) == 0.0
    spinning = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(0.0, linear=[0.0, 0.0, 4.0]))
    # Close to the axis the speed is small, the turn is not.
    for x in ([1.0, 0.0, 0.0], [1e-3, 0.0, 1.0]):
        assert natural_time(spinning, np.array(x)) == pytest.approx(0.25, rel=1e-3)


@pytest.mark.parametrize("rough", [0, 1])
def test_a_single_jump_between_neighbours_is_noise(rough):
    """Neighbours are 2^-40 of the state apart; the second differences at a jump are the jump, and zero elsewhere."""
    states = np.array([[0.3, 1.0, 0.2], [0.5, -0.4, 3.0], [0.1, 0.2, 0.3], [0.7, 0.1, 0.2]])
    jump = np.array([3e-8, -4e-8, 0.0])
    first = states[rough, 0]
    middle = first + 4.5 * 2.0**-40 * math.cos(1.0) * np.linalg.norm(states[rough]) / math.sqrt(3.0)

    def step(x, h):
        after = x + h * BODY.vector_field(x)
        return after + jump if middle < x[0] < first + 1e-6 else after

    # The roundings of the others are 1e-15.
    assert subject_of(BODY, step, states, 0.1).noise == pytest.approx(5e-8 / math.sqrt(6.0), rel=1e-6)


@pytest.mark.parametrize("method", [co.Splitting(order=2), co.GaussLegendre(1)], ids=repr)
def test_the_condition_of_a_step_is_that_of_its_tangent(method):
    """At each state and step its own; central differences of 2^-17 leave 1e-10 of the third derivatives."""
    system = co.LiePoissonSystem(co.algebras.A3_7(1.5), co.Quadratic([1.0, 0.7, 0.4]))
    states = np.array([[0.7, -0.4, 0.5], [0.2, 0.9, -0.3]])
    subject = subject_of(system, method, states, 0.1)
    seen = set()
    for h in (0.1, -0.4, 0.4):
        for x in states:
            P = co.stepper(system, method, h).tangent(x)
            expected = np.linalg.norm(P) * np.linalg.norm(np.linalg.inv(P))
            assert subject.condition(x, h) == pytest.approx(expected, rel=1e-7)
            assert subject.condition(x, h) == subject.condition(x, h)
            seen.add(round(expected, 6))
    assert len(seen) > 3


@pytest.mark.parametrize("h", [0.5, -0.5])
def test_the_long_run_is_as_long_as_the_motion_allows(h):
    """A growing motion is cut where a state has grown 16 times, of whichever member."""
    line = co.LieAlgebra.from_brackets(2, {(0, 1): {1: 1.0}})
    system = co.LiePoissonSystem(line, co.Quadratic(0.0, linear=[math.copysign(1.0, -h), 0.0]))
    slow, fast = [30.0, 1e-3], [1e-3, 1.0]
    for states in ([fast, slow, slow, slow], [slow, slow, slow, fast]):
        subject = subject_of(system, co.Splitting(), states, h, steps=512)
        run, failure = invariants.long_run(subject)
        grown = np.linalg.norm(run.x, axis=-1) / np.linalg.norm(states, axis=1)
        assert failure is None and np.max(grown) <= 16.0
        more = subject.run(subject.states, h, 2 * run.stats.steps)
        assert np.max(np.linalg.norm(more.x[-1], axis=-1) / np.linalg.norm(states, axis=1)) > 16.0
        rows = invariants.invariant_rows(subject, run, failure, h)
        assert all("before a state has grown 16 times" in row.reason for row in rows)


def coupled(algebra):
    A = RNG.normal(size=(algebra.dim, algebra.dim))
    return co.LiePoissonSystem(algebra, co.Quadratic(A @ A.T / algebra.dim + np.eye(algebra.dim)))


class SaidToBePoisson(co.GaussLegendre):
    """A symmetric scheme that is no Poisson map."""

    def properties(self, system):
        return Properties(poisson=True, energy=False, casimirs="quadratic", attitude="none")


SYSTEMS = {name: coupled(co.algebras.get(name)) for name in ("sl(2)", "A5,3", "su(3)")}


@pytest.fixture
def dear(monkeypatch):
    """Every step is taken for one that takes long."""
    monkeypatch.setattr(subject, "EXPENSIVE_SECONDS", 0.0)


@pytest.mark.parametrize("name, h", [("sl(2)", 0.05), ("A5,3", -0.05)])
def test_dear_steps_have_the_verdicts_of_cheap_ones(name, h, dear, monkeypatch):
    system = SYSTEMS[name]
    x0 = RNG.normal(size=system.dim)
    for scheme in (co.Splitting(), co.GaussLegendre(2)):
        few = co.certify(system, scheme, x0, h, steps=64)
        along = few["poisson"].measured.endswith("by tangents along 4 directions there and back")
        assert along == bool(few["poisson"].value is not None)
        assert len(few.subject["states"]) == 2
        with monkeypatch.context() as patch:
            patch.setattr(subject, "EXPENSIVE_SECONDS", np.inf)
            all_of_it = co.certify(system, scheme, x0, h, steps=64)
        assert len(all_of_it.subject["states"]) == 4
        told = {row.key: row.verdict for row in few.table if row.claimed}
        assert told == {row.key: row.verdict for row in all_of_it.table if row.claimed} and few.passed


@pytest.mark.parametrize("name", ["sl(2)", "su(3)"])
def test_what_is_no_poisson_map_is_found_along_directions(name, dear):
    system = SYSTEMS[name]
    x0 = RNG.normal(size=system.dim)
    row = co.certify(system, SaidToBePoisson(1), x0, 0.1, steps=8)["poisson"]
    assert row.verdict == "fails" and row.value > 1e6 * row.bound


def test_the_defect_along_directions_is_about_that_of_the_matrices(dear):
    """P J - J(y) Q^T has 15^2 entries, whose mean square is estimated by 16 numbers: to a factor of 2, by 4 sigma."""
    system, scheme, h = coupled(co.algebras.su(4)), co.GaussLegendre(1), 0.2
    x = RNG.normal(size=system.dim)
    row = co.certify(system, SaidToBePoisson(1), x[None], h, steps=1)["poisson"]
    there, back = co.stepper(system, scheme, row.evidence.get("step", h)), co.stepper(system, scheme, -h)
    y = there(x)
    P, Q = there.tangent(x), back.tangent(y)
    defect = np.linalg.norm(P @ system.structure_matrix(x) - system.structure_matrix(y) @ Q.T)
    assert row.measured.startswith("defect")
    found, bound, _ = step_map._directional_defect(subject_of(system, scheme, x, h, 1), x, h)
    assert 0.5 * defect < found < 2.0 * defect and bound < 1e-6 * defect


@pytest.mark.long
def test_the_long_run_has_as_many_steps_as_take_seconds(monkeypatch):
    monkeypatch.setattr(subject, "SECONDS_PER_COST", 2e-5)  # a step of su(3) then counts as some milliseconds
    system = SYSTEMS["su(3)"]
    x0 = RNG.normal(size=system.dim)
    found = co.certify(system, co.Splitting(), x0, 0.05)
    steps = found.subject["steps"]
    assert 32 <= steps < 2000 and f"{steps} steps of 0.05 from 2 states" in found["run"].measured
    assert "steps=2000 would take about" in found["run"].reason
    with pytest.warns(co.LongWait, match="the long run of 5000 steps from 2 states takes about"):
        asked = co.certify(system, co.Splitting(), x0, 0.05, steps=5000)
    assert asked.subject["steps"] == 5000 and asked["run"].reason == ""


@pytest.mark.long
def test_matrices_that_would_be_too_large_are_not_needed_for_dear_steps(dear, monkeypatch):
    """Neither J nor P is made as a matrix; a lattice of more coordinates is not read flow by flow."""
    monkeypatch.setattr(step_map, "MAX_DENSE_DIM", 16)
    g = co.algebras.so(7)
    system = co.LiePoissonSystem(g, co.Quadratic(np.linspace(1.0, 2.0, g.dim)))
    monkeypatch.setattr(type(system), "structure_matrix", None)
    x0 = RNG.normal(size=g.dim) / np.sqrt(g.dim)
    found = co.certify(system, co.Splitting(), x0, 0.05, steps=4)
    assert [found[key].verdict for key in ("symmetry", "poisson")] == ["holds", "holds"]
    monkeypatch.setattr(step_map, "MAX_DIRECTIONAL_DIM", 20)
    assert co.certify(system, co.Splitting(), x0, 0.05, steps=4)["poisson"].verdict == "not decidable here"


def test_matrix_systems_are_seen_along_directions(dear):
    """Their J is a matrix of the system, not of an algebra with structure constants."""
    ball = co.systems.sphere_euler(4)
    found = co.certify(ball, co.IsospectralGauss(2), ball.random(seed=1), 0.02, steps=16)
    assert found["poisson"].measured.endswith("by tangents along 4 directions there and back")
    assert found["poisson"].verdict == "holds" and found.passed

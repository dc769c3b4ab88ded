"""The checks behind a certificate, one by one: each sees a defect in any state, at any time and in either direction."""

import functools
import json
import math

import numpy as np
import pytest

import coadjoint as co
from coadjoint.analysis.certificates.certificate import Certificate, Row
from coadjoint.analysis.certificates.claims import scheme_and_claims
from coadjoint.analysis.checks import attitude, convergence, invariants
from coadjoint.analysis.checks.convergence import allowed_error
from coadjoint.analysis.checks.invariants import size_of
from coadjoint.analysis.checks.poisson import poisson_row
from coadjoint.analysis.checks.reference import motion, natural_time
from coadjoint.analysis.checks.study import LARGE_ERROR, study
from coadjoint.analysis.checks.subject import STATE_SPACING, Subject
from coadjoint.analysis.checks.symmetry import symmetry_row
from coadjoint.analysis.fits import growth, slope_of_defects
from coadjoint.methods import Properties

BODY = co.systems.rigid_body(inertia=(1, 2, 3))
X0 = np.array([0.3, 1.0, 0.2])
EVERYTHING = Properties(poisson=True, energy=True, casimirs="all", attitude="none")


def subject_of(system, method, states, h, steps=32, **said):
    scheme, claims = scheme_and_claims(system, method, said.get("order"), said.get("properties"), said.get("symmetric"))
    states = np.atleast_2d(np.asarray(states, dtype=float))
    return Subject(system, scheme, claims, h, states, steps, compiled=isinstance(method, co.methods.Method))


# Every state of a sample counts


def turning(broken):
    """The exact flow of x1^2/2 on so(3), times 1 + h^4/10 where |x| > 1.2 if it is to be broken there."""

    def step(x, h):
        c, s = np.cos(h * x[0]), np.sin(h * x[0])
        factor = 1.0 + 0.1 * h**4 if broken and np.linalg.norm(np.real(x)) > 1.2 else 1.0
        return np.array([x[0], c * x[1] - s * x[2], s * x[1] + c * x[2]]) * factor

    return step


@pytest.mark.thinned(6)
@pytest.mark.parametrize("place", [0, 2, 4])
@pytest.mark.parametrize("h", [0.1, -0.1])
def test_a_defect_in_one_state_of_a_sample_fails_every_row(place, h):
    system = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1.0, 0.0, 0.0]))
    sample = np.tile([0.6, 0.5, -0.4], (5, 1)) * np.linspace(0.5, 1.0, 5)[:, None]
    sample[place] = [0.9, -0.8, 0.7]
    options = {"steps": 16, "order": 2, "symmetric": True, "properties": EVERYTHING}
    rows = ["symmetry", "poisson", "energy", "casimir |x|^2"]
    right = co.certify(system, turning(False), sample, h, **options)
    assert right.passed, str(right)
    wrong = co.certify(system, turning(True), sample, h, **options)
    assert set(rows) <= {row.key for row in wrong.failures}, str(wrong)
    # Its size is that of the one state: 2 h^4/10 |x| there and back.
    row = wrong["symmetry"]
    step = float(row.measured.split("at the step ")[1].split(",")[0])
    assert row.value == pytest.approx(0.2 * step**4 * np.linalg.norm(sample[place]), rel=0.05)
    assert wrong["energy"].evidence["deviations"].shape[1] == 5
    deviations = np.max(np.abs(wrong["energy"].evidence["deviations"]), axis=0)
    assert np.argmax(deviations) == place and np.delete(deviations, place).max() < 1e-12


@pytest.mark.thinned(8)
@pytest.mark.parametrize("h", [0.1, -0.1])
@pytest.mark.parametrize("method", [co.Splitting(), co.GaussLegendre(2), co.ExplicitRungeKutta("rk4"), turning(True)])
def test_bounds_do_not_depend_on_the_number_of_states(method, h, monkeypatch):
    """A sample with each state twice as often has the values, the bounds and the verdicts of the sample."""
    sample = np.array([X0, [0.9, -0.8, 0.7]])
    found = {}
    for times in (2, 4):
        subject = subject_of(BODY, method, np.tile(sample, (times, 1)), h, steps=64)
        run = invariants.long_run(subject)
        rows = [*invariants.invariant_rows(subject, run, 2.0 * h), symmetry_row(subject, 2.0 * h)]
        rows += [] if callable(method) else attitude.attitude_rows(subject, None, 64)
        found[times] = {row.key: row for row in [*rows, poisson_row(subject, 2.0 * h)]}
        # Without single steps, whose deviations are nearer to their bounds, the rows are those of the long run.
        with monkeypatch.context() as patch:
            patch.setattr(invariants, "_single_steps", lambda subject, coarse_step: [])
            rows = invariants.invariant_rows(subject, run, 2.0 * h)
        assert all("round-off of the run" in row.source for row in rows)
        found[times] |= {f"{row.key} over the run": row for row in rows}
    assert len(found[2]) >= 6
    for key, row in found[2].items():
        other = found[4][key]
        assert (other.verdict, other.measured) == (row.verdict, row.measured), key
        # Sums over members are rounded.
        assert other.value == pytest.approx(row.value, rel=1e-9) and other.bound == pytest.approx(row.bound, rel=1e-9)


@pytest.mark.thinned(4)
@pytest.mark.parametrize("h", [0.1, -0.1])
@pytest.mark.parametrize("at_the_given", [True, False])
def test_a_defect_at_the_given_step_or_at_larger_ones_alone_fails(at_the_given, h):
    """An exact step still follows the motion at larger steps than the given one, where rows look as well."""
    exact = turning(False)

    def step(x, length):
        given = abs(abs(float(length)) - abs(h)) < 1e-9
        wrong = given if at_the_given else abs(float(length)) > 2.0 * abs(h)
        return exact(x, length) * (1.0 + 1e-7 if wrong else 1.0)

    system = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1.0, 0.0, 0.0]))
    sample = np.outer([0.5, 1.0, 0.8, 0.7], [0.6, 0.5, -0.4])
    found = co.certify(system, step, sample, h, steps=16, order=2, symmetric=True, properties=EVERYTHING)
    wanted = {"symmetry", "poisson", "energy", "casimir |x|^2"}
    assert wanted <= {row.key for row in found.failures}, str(found)
    lengths = [float(found[key].measured.split("at the step ")[1].split(",")[0]) for key in ("symmetry", "poisson")]
    assert all((length == h) == at_the_given and length / h >= 1.0 for length in lengths)


@pytest.mark.thinned(4)
@pytest.mark.parametrize("h", [0.1, -0.1])
@pytest.mark.parametrize("method", [co.Splitting(), co.GaussLegendre(2)], ids=str)
def test_the_order_of_single_steps_is_one_less_than_the_power_of_their_errors(method, h):
    subject = subject_of(BODY, method, np.array([X0, [0.9, -0.8, 0.7]]), h)
    found = convergence._single_steps(subject, study(subject))
    assert found.value == pytest.approx(method.order, abs=0.3)
    for length, error in zip(found.steps, found.errors, strict=True):
        moved = [co.stepper(BODY, method, math.copysign(length, h))(x) for x in subject.states]
        off = np.linalg.norm(moved - np.array([BODY.exact(x, math.copysign(length, h)) for x in subject.states]))
        # The closed form is rounded, to less than the sixteenth of an error.
        assert error == pytest.approx(off / np.linalg.norm(subject.states), rel=0.1)


def test_a_reflection_must_reverse_the_motion_at_every_state():
    """With a force along the third axis it is one of the first coordinate, though x -> -x does so on that axis."""
    system = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1.0, 0.5, 0.25], linear=[0.0, 0.0, 0.5]))
    sample = [[0.0, 0.0, 1.0], [0.3, -0.5, 0.4], [0.2, 0.7, -0.1], [1.0, 0.1, 0.2]]
    for states in (sample, sample[::-1]):
        found = co.certify(system, co.Splitting(), states, 0.1, steps=8)["reversibility"]
        assert found.reason == "under the reflection (-, +, +)" and found.value <= found.bound
    full = np.array([[1.0, 0.2, 0.1], [0.2, 0.5, 0.3], [0.1, 0.3, 0.25]])
    turned = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(full, linear=[0.1, 0.2, 0.5]))
    found = co.certify(turned, co.Splitting(), sample, 0.1, steps=8)["reversibility"]
    assert found.verdict == "not applicable" and "no reflection was found" in found.reason


# Group elements


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


# Growth, slopes, sizes


@pytest.mark.parametrize("t0", [0.0, 50.0, -1000.0])
@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_growth_depends_on_the_time_since_the_start(t0, direction):
    since = np.linspace(0.0, 400.0, 257)
    for power, kind in ((0.0, "bounded"), (0.5, "like sqrt(t)"), (1.0, "linear"), (2.0, "like t^2.1")):
        deviations = since[:, None] ** power * np.array([1e-9, -3e-9, 0.0]) * (since[:, None] > 0)
        found = growth(t0 + direction * since, deviations)
        # The first window begins at 0, which lowers its mean: of t^2 by a third, for a slope that is higher by 0.1.
        assert found.kind == kind and power - 0.02 <= found.power <= power + 0.12
        assert np.all(np.diff(found.times) > 0) and found.times[-1] == pytest.approx(400.0 / math.sqrt(2.0))
        last = deviations[since > 200.0]
        assert found.sizes[-1] == pytest.approx(math.sqrt(np.mean(last**2)), rel=1e-12)
        scaled = growth(t0 + direction * since, 1e-6 * deviations[:, ::-1])
        assert scaled.power == pytest.approx(found.power, abs=1e-9)
    assert growth(t0 + direction * since[:3], deviations[:3]).kind == "undetermined"


@pytest.mark.parametrize("largest", [0.4, -0.4])
def test_the_slope_of_defects_is_over_steps_of_one_sign(largest):
    asked = []

    def look(h):
        asked.append(h)
        if len(asked) == 2:
            raise ValueError("no step of this length")
        return abs(h) ** 3 * 2.0, 1e-16

    found = slope_of_defects(largest, 6, look)
    np.testing.assert_allclose(asked, largest / 2.0 ** (np.arange(6) / 2), rtol=1e-14)
    np.testing.assert_allclose(found.steps, np.abs(np.delete(asked, 1)), rtol=1e-14)
    assert found.value == pytest.approx(3.0, abs=1e-9) and np.all(found.errors == 2.0 * found.steps**3)


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
        assert size_of(quadratic, x) == pytest.approx(terms + slope, rel=1e-12)
        cubic = co.Polynomial({(3, 0, 0): -2.0, (1, 1, 1): 3.0, (0, 1, 0): -1.0})
        slope = np.linalg.norm(cubic.gradient(x)) * np.linalg.norm(x)
        terms = 2.0 * abs(x[0]) ** 3 + 3.0 * abs(x[0] * x[1] * x[2]) + abs(x[1])
        assert size_of(cubic, x) == pytest.approx(terms + slope, rel=1e-12)

        def function(y):
            return y[0] - 2.0 * y[1] * y[2]

        slope = np.linalg.norm([1.0, -2.0 * x[2], -2.0 * x[1]]) * np.linalg.norm(x)
        # Central differences of a quadratic function, by steps of 2^-17: to 1e-16 * 2^17 and some.
        assert size_of(function, x) == pytest.approx(abs(function(x)) + slope, rel=1e-9)


def test_errors_that_are_allowed_follow_the_order_and_the_ratio_of_the_steps():
    """An error C h^p changes by (r^p - 1) times that of the smaller step; six times as much is allowed."""
    for order in (1, 2, 4):
        for ratio in (1.25, 2.0, 3.0):
            assert allowed_error(ratio**order - 1.0, ratio, order) == pytest.approx(6.0)
    assert allowed_error(1.0, 3.0, None) == allowed_error(1.0, 3.0, 1) == 3.0


# References, and studies of convergence


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


@pytest.mark.thinned(12)
@pytest.mark.parametrize("h", [0.1, -0.1, 1e-6, 5.0])
@pytest.mark.parametrize("method", [co.Splitting(order=2), co.GaussLegendre(2), co.Splitting(order=6)], ids=repr)
def test_a_study_has_the_errors_of_its_runs(method, h):
    sample = np.array([[0.3, 1.0, 0.2], [0.5, -0.4, 1.0], [-0.2, 0.1, 0.9], [1.0, 0.3, 0.2]])
    found = study(subject_of(BODY, method, sample, h))
    assert math.copysign(1.0, found.span) == math.copysign(1.0, h)
    exact = np.array([BODY.exact(x, found.span) for x in sample])
    size = np.linalg.norm(exact)
    assert found.counts == sorted(set(found.counts)) and len(found.counts) >= 3
    for count, step, end, error in zip(found.counts, found.steps, found.ends, found.errors, strict=True):
        assert step == pytest.approx(abs(found.span) / count)
        run = co.integrate(BODY, sample, (0.0, found.span), step, method, save_every=10**6, watch=False).x[-1]
        np.testing.assert_allclose(end, run, rtol=0.0, atol=1e-13)
        # Both references are accurate to some roundings.
        assert error == pytest.approx(np.linalg.norm(run - exact) / size, rel=1e-3, abs=1e-14)
    if found.given:
        assert found.span == pytest.approx(found.given * h) and found.given in found.counts
    else:
        assert h == 1e-6
    assert found.slope.value == pytest.approx(method.order, abs=0.3)
    coarse_step = found.coarse_step(h)
    assert coarse_step * h > 0.0 and abs(coarse_step) >= abs(h)
    if coarse_step != h:
        place = found.counts.index(round(found.span / coarse_step))
        assert found.errors[place] < LARGE_ERROR / 5 and all(error >= LARGE_ERROR / 5 for error in found.errors[:place])


# Subjects


@pytest.mark.parametrize("h", [0.1, -0.1])
def test_few_states_are_extended_along_the_motion(h):
    given = np.array([X0, 2.0 * X0])
    subject = subject_of(BODY, co.Splitting(), given, h)
    time = min(natural_time(BODY, x) for x in given)
    assert subject.time == time == subject_of(BODY, co.Splitting(), given[::-1], h).time
    assert np.array_equal(subject.states[:2], given) and len(subject.states) == 4
    for k, x in enumerate(subject.states[2:], 1):
        np.testing.assert_allclose(x, BODY.exact(X0, math.copysign(k * STATE_SPACING * time, h)), atol=1e-13)
    assert subject.span_time == min(natural_time(BODY, x) for x in subject.states)
    many = np.random.default_rng(3).normal(size=(11, 3))
    np.testing.assert_array_equal(subject_of(BODY, co.Splitting(), many, h).states, many[:8])


def test_rests_only_if_every_state_rests():
    rest, moving = [1.0, 0.0, 0.0], [0.3, 1.0, 0.2]
    for states, at_equilibrium in (([rest, [0.0, 0.0, 2.0]], True), ([rest, moving], False), ([moving, rest], False)):
        subject = subject_of(BODY, co.Splitting(), states, 0.1)
        assert subject.at_equilibrium == at_equilibrium
        assert subject.time == (0.1 if at_equilibrium else natural_time(BODY, np.array(moving)))


@pytest.mark.parametrize("digits", [6, 9, None])
@pytest.mark.parametrize("rough", [0, 1])
def test_the_noise_of_a_step_is_that_of_the_rougher_state(digits, rough):
    """Rounding to a multiple of 10^-d is uniform, with a deviation of 10^-d / sqrt(12) in each coordinate."""
    states = np.array([[0.3, 1.0, 0.2], [0.5, -0.4, 3.0], [0.1, 0.2, 0.3], [0.7, 0.1, 0.2]])
    marked = np.linalg.norm(states[rough])

    def step(x, h):
        after = x + h * BODY.vector_field(x)
        return np.round(after, digits) if digits and abs(np.linalg.norm(x) - marked) < 1e-6 else after

    noise = subject_of(BODY, step, states, 0.1).noise
    if digits is None:
        assert noise < 8 * 2.0**-53 * np.linalg.norm(states[1])
    else:
        # Neighbours are 1e-12 apart: all of them may be rounded to one number, or some up and some down.
        assert noise <= 4.0 * math.sqrt(3.0) * 10.0**-digits


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


def test_a_run_with_an_element_does_not_change_one_without():
    subject = subject_of(BODY, co.Splitting(), X0, 0.1)
    for _ in range(2):
        plain = subject.run(X0[None], 0.1, 4)
        assert plain.attitude is None
        for kind in (True, "coadjoint"):
            turned = subject.run(X0[None], 0.1, 4, attitude=kind)
            np.testing.assert_array_equal(turned.x, plain.x)
            once = co.integrate(BODY, X0[None], (0.0, 0.4), 0.1, co.Splitting(), save_every=4, attitude=kind)
            np.testing.assert_allclose(turned.attitude, once.attitude, atol=1e-14)
        back = subject.run(X0[None], -0.1, 4, t=0.4)
        assert back.t[0] == 0.4 and back.t[-1] == pytest.approx(0.0)
        watched = subject.run(X0[None], 0.1, 4, save_every=2, watch=True)
        assert len(watched.t) == 3 and len(plain.t) == 2
        # Watched runs know the drift at all steps, others at the saved points.
        every = subject.run(X0[None], 0.1, 150, save_every=1)
        for watch, energies in ((True, every.energy), (False, every.energy[::150])):
            found = subject.run(X0[None], 0.1, 150, watch=watch).drift(relative=False)["energy"]
            assert found == pytest.approx(np.max(np.abs(energies - energies[0])), abs=1e-15)


# The long run


@pytest.mark.parametrize("h", [0.5, -0.5])
def test_the_long_run_is_as_long_as_the_motion_allows(h):
    """A growing motion is cut where a state has grown 16 times, of whichever member."""
    line = co.LieAlgebra.from_brackets(2, {(0, 1): {1: 1.0}})
    system = co.LiePoissonSystem(line, co.Quadratic(0.0, linear=[math.copysign(1.0, -h), 0.0]))
    slow, fast = [30.0, 1e-3], [1e-3, 1.0]
    for states in ([fast, slow, slow, slow], [slow, slow, slow, fast]):
        subject = subject_of(system, co.Splitting(), states, h, steps=512)
        run = invariants.long_run(subject)
        grown = np.linalg.norm(run.solution.x, axis=-1) / np.linalg.norm(states, axis=1)
        assert not run.failed and np.max(grown) <= 16.0
        more = subject.run(subject.states, h, 2 * run.solution.stats.steps)
        assert np.max(np.linalg.norm(more.x[-1], axis=-1) / np.linalg.norm(states, axis=1)) > 16.0
        rows = invariants.invariant_rows(subject, run, h)
        assert all("before a state has grown 16 times" in row.reason for row in rows)


# Functions of the user


class Callable:
    def __call__(self, x, h):
        return x + h * BODY.vector_field(x)


@pytest.mark.parametrize(
    ("function", "timed"),
    [
        (lambda x, h: x, False),
        (lambda x, t, h: x, True),
        (lambda x, h, tolerance=1e-9: x, False),
        (lambda x, t, h, tolerance=1e-9: x, True),
        (functools.partial(lambda rate, x, h: x, 0.5), False),
        (functools.partial(lambda x, t, h: x, t=0.0), False),
        (Callable(), False),
        (np.add, False),
    ],
)
def test_a_function_of_three_needed_arguments_takes_the_time(function, timed):
    try:
        scheme, claims = scheme_and_claims(BODY, function, 3, None, False)
    except TypeError as refused:
        assert isinstance(function, functools.partial) and "takes" in str(refused)
        return
    assert scheme.timed == timed and (claims.order, claims.symmetric, claims.properties) == (3, False, None)


def test_schemes_with_steps_of_their_own_declare_no_order_of_the_step():
    _, claims = scheme_and_claims(BODY, co.Taylor(tolerance=1e-9), None, None, None)
    assert claims.order is None and claims.properties is not None
    _, claims = scheme_and_claims(BODY, co.Taylor(12), None, None, None)
    assert claims.order == 12


# Verdicts and records


@pytest.mark.parametrize("h", [0.1, -0.1])
def test_a_record_has_what_was_given_and_no_number_that_is_not_finite(h):
    rest = co.certify(BODY, co.Splitting(), (1.0, 0.0, 0.0), h, steps=8)
    numbers = {"one": np.float64(math.inf), "many": np.array([[1.0, -math.inf], [math.nan, 2.0]]), "none": []}
    row = Row("x", "x", "kept", "-", "fails", True, math.nan, np.float64(2.0), evidence=numbers)
    for found in (rest, Certificate((*rest.rows, row), rest.subject)):
        read = json.loads(found.to_json(), parse_constant=lambda name: pytest.fail(name))
        subject = read["subject"]
        assert subject["given"] == [[1.0, 0.0, 0.0]] == subject["states"][:1]
        assert subject["system"]["sign"] == BODY.sign and subject["system"]["dim"] == 3
        assert read["passed"] == found.passed is False
        assert [row["key"] for row in read["rows"]] == [row.key for row in found.rows]
        assert all(row["verdict"] == found[row["key"]].verdict for row in read["rows"])
    assert read["rows"][-1]["evidence"] == {"one": None, "many": [[1.0, None], [None, 2.0]], "none": []}
    assert (read["rows"][-1]["value"], read["rows"][-1]["bound"]) == (None, 2.0)
    assert (rest.subject["step"], rest.subject["steps"]) == (h, 8)


@pytest.mark.parametrize("size", [1e-80, 1e80])
def test_states_of_sizes_whose_products_leave_float64_are_refused(size):
    with pytest.raises(ValueError, match="choose units"):
        co.certify(BODY, co.Splitting(), [X0, -size * X0], 0.1) if size > 1 else co.certify(
            BODY, co.Splitting(), size * X0, 0.1
        )
    assert co.certify(BODY, co.Splitting(), [X0, 0.0 * X0], 0.1, steps=4)["poisson"].verdict == "holds"

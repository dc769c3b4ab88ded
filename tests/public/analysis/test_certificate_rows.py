"""Certificates: rows and verdicts, functions of the user, samples, units, thresholds."""

import functools
import json
import math
from contextlib import nullcontext

import mpmath
import numpy as np
import pytest

import coadjoint as co
from long import long_beyond
from refusals import refused
from rounding import UNIT_ROUNDOFF as U

Properties = co.methods.Properties
growth, fit_order = co.analysis.growth, co.analysis.fit_order

BODY = co.systems.rigid_body(inertia=(1, 2, 3))
X0 = np.array([0.3, 1.0, 0.2])
NOTHING = Properties(poisson=False, energy=False, casimirs="none", attitude="none")
SPLIT = Properties(poisson=True, energy=False, casimirs="all", attitude="none")
EVERYTHING = Properties(poisson=True, energy=True, casimirs="all", attitude="none")


def euler(x, h):
    return x + h * BODY.vector_field(x)


def certified(method=None, **options):
    return co.certify(BODY, co.Splitting() if method is None else method, X0, 0.1, **{"steps": 60, **options})


def test_rows_are_what_was_measured():
    found = certified()
    keys = ["order", "reference", "symmetry", "reversibility", "poisson", "energy", "casimir |x|^2"]
    keys += ["spatial momentum", "group", "element", "attitude", "run"]
    assert [row.key for row in found.table] == keys
    assert found.passed and found.declares and found.failures == ()
    # The order as a line through the errors of a closed form.
    order = found["order"]
    assert abs(order.value - 2.0) < 0.01 and "closed form" in found["reference"].measured
    h, e = np.array(order.evidence["steps"]), np.array(order.evidence["errors"])
    there = co.integrate(BODY, X0, (0, order.evidence["span"]), 0.1, save_every=10**6, watch=False).x[-1]
    far = np.linalg.norm(there - BODY.exact(X0, order.evidence["span"]))
    # The error at the given step is that of the four states, the first of which is this one.
    assert far <= 2.0 * np.linalg.norm(X0) * e[np.argmin(abs(h - 0.1))]
    assert found["symmetry"].value <= found["symmetry"].bound < 1e-12
    assert found["reversibility"].verdict == "kept though not declared"
    assert found["reversibility"].reason == "under the reflection (-, -, -)"
    assert found["energy"].verdict == "not kept, not declared"
    assert found["energy"].evidence["deviations"].shape[1] == len(found.subject["states"]) == 4
    with refused(KeyError, "did you mean 'energy'"):
        found["enregy"]
    assert all(found[row.key] is row for row in found.rows)
    for key in {row.key[:count] for row in found.rows for count in range(len(row.key))} - set(keys):
        with refused(KeyError, "unknown row"):
            found[key]


def test_it_is_written_for_readers_and_for_machines():
    found = certified()
    text = str(found)
    assert max(map(len, text.splitlines())) <= 130
    assert "passed: every declared property holds" in text and "64 u |P|^2 |J|" in text and "passed" in repr(found)
    read = json.loads(found.to_json())
    assert read == json.loads(json.dumps(found.to_mapping()))
    assert read["passed"] is True and read["schema"] == 1
    assert read["subject"]["versions"]["coadjoint"] == co.__version__
    assert read["subject"]["scheme"]["description"]["name"] == "Splitting"
    poisson = next(row for row in read["rows"] if row["key"] == "poisson")
    assert poisson["claimed"] and poisson["value"] <= poisson["bound"] and poisson["verdict"] == "holds"


@pytest.mark.parametrize("h", [0.1, -0.1])
def test_a_record_has_what_was_given_and_no_number_that_is_not_finite(h):
    """Of a state at rest, of which nothing can be told."""
    rest = co.certify(BODY, co.Splitting(), (1.0, 0.0, 0.0), h, steps=8)
    assert rest["order"].verdict == rest["reference"].verdict == "not decidable here" and not rest.passed
    assert "rests" in rest["order"].reason and "not decidable here" in str(rest).splitlines()[-1]
    read = json.loads(rest.to_json(), parse_constant=lambda name: pytest.fail(name))
    subject = read["subject"]
    assert subject["given"] == [[1.0, 0.0, 0.0]] == subject["states"][:1]
    assert subject["system"]["sign"] == BODY.sign and subject["system"]["dim"] == 3
    assert (rest.subject["step"], rest.subject["steps"], read["passed"]) == (h, 8, False)
    assert [(row["key"], row["verdict"]) for row in read["rows"]] == [(row.key, row.verdict) for row in rest.rows]
    assert co.certify(BODY, co.Splitting(), (1.0, 0.0, 0.0), h, steps=8).to_json() == rest.to_json()


def test_of_a_function_nothing_is_said():
    found = certified(euler)
    assert found.passed and not found.declares
    assert "nothing was declared" in str(found)
    assert abs(found["order"].value - 1.0) < 0.05 and found["order"].declared == "nothing"
    assert found["energy"].verdict == "not kept, not declared"
    assert found["attitude"].verdict == "not applicable"


@pytest.mark.long
def test_without_second_derivatives_the_step_itself_is_differentiated():
    """The compiled loop takes no complex numbers: differences, with their floor; a declared property is held to it."""
    H = co.Hamiltonian(lambda x: 0.5 * x[0] ** 2 + x[1] ** 2, lambda x: np.array([x[0], 2.0 * x[1], 0.0]))
    system = co.LiePoissonSystem(co.algebras.so(3), H)
    found = co.certify(system, co.GaussLegendre(2), X0, 0.1, steps=40)
    assert found.passed, str(found)
    assert found["poisson"].verdict == "not kept, not declared"


TURN = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1.0, 0.0, 0.0]))


def turning(broken=False):
    """The exact flow of x1^2/2 on so(3), times 1 + h^4/10 where |x| > 1.2 if it is to be broken there."""

    def step(x, h):
        cosine, sine = (mpmath.cos, mpmath.sin) if isinstance(x[0], mpmath.mpf) else (np.cos, np.sin)
        c, s = cosine(h * x[0]), sine(h * x[0])
        factor = 1.0 + 0.1 * h**4 if broken and np.linalg.norm(np.real(x)) > 1.2 else 1.0
        return np.array([x[0], c * x[1] - s * x[2], s * x[1] + c * x[2]]) * factor

    return step


STEPS = {
    "complex step": turning(),
    "multiprecision": lambda x, h: turning()([v if isinstance(v, mpmath.mpf) else float(v) for v in x], h),
    "differences": lambda x, h: turning()(np.array([float(v) for v in x]), float(h)),
}


@pytest.mark.parametrize("by", STEPS)
def test_the_tangent_of_a_function_is_as_exact_as_it_allows(by):
    found = co.certify(TURN, STEPS[by], X0, 0.1, steps=20, order=8, symmetric=True, properties=SPLIT)
    assert found.passed, str(found)
    assert f"tangent by {by}" in found["poisson"].measured
    exact = by != "differences"
    assert (found["poisson"].bound < 1e-10) == exact
    assert ("floor of differences" in found["poisson"].source) != exact


@pytest.mark.long
def test_a_run_that_fails_is_a_row():
    """rk4 with steps that are too large: the motion goes on, the run does not."""
    found = co.certify(BODY, co.ExplicitRungeKutta("rk4"), 10 * X0, 3.0, steps=100)
    assert found["run"].verdict == "fails" and "step" in found["run"].measured
    assert not found.passed


@pytest.mark.long
def test_a_motion_that_leaves_float64_is_no_fault_of_the_scheme():
    algebra = co.LieAlgebra.from_brackets(2, {(0, 1): {1: 1.0}})
    growing = co.LiePoissonSystem(algebra, co.Quadratic([0.0, 0.0], linear=[1.0, 0.0]), sign=-1)
    found = co.certify(growing, co.Splitting(), (1.0, 1.0), 1.0, steps=1000)
    assert found["run"].verdict == "not decidable here" and not found["run"].claimed
    assert "leave" in found["run"].reason or "independent code" in found["run"].reason


def test_an_exact_scheme_has_every_order():
    found = co.certify(TURN, co.Splitting(order=2), X0, 0.1, steps=40)
    assert found.passed, str(found)
    assert "no error above round-off" in found["order"].measured


@pytest.mark.parametrize("step", [1e-7, -1e-7, 20.0])
def test_tiny_and_huge_steps_end(step):
    found = co.certify(BODY, co.Splitting(order=2), X0, step, steps=40)
    assert found["order"].verdict == "holds", str(found)
    assert np.sign(found["order"].evidence["span"]) == np.sign(step)
    assert found["poisson"].verdict == found["casimir |x|^2"].verdict == "holds"


def test_a_wrong_closed_form_is_said():
    wrong = co.LiePoissonSystem(
        co.algebras.so(3), co.Quadratic([1.0, 0.5, 0.3]), exact=lambda x0, t, attitude: np.array(x0) * (1 + 1e-3 * t)
    )
    found = co.certify(wrong, co.Splitting(), X0, 0.1, steps=20)
    assert found.passed and "closed form" in found["reference"].reason
    assert "DOP853" in found["reference"].measured


def test_orders_know_how_sure_they_are():
    h = [0.4 / 2**k for k in range(6)]
    for p in (1, 2, 4, 8):
        found = fit_order(h, [x**p * (1 + 0.8 * x) for x in h], [1e-16] * 6)
        # The square of the next term, (0.8 h)^2 at the first three steps of those taken, is left.
        assert abs(found.order - p) <= found.uncertainty + 0.8**2 * found.steps[0] ** 2
        assert found.uncertainty < 0.1
    # A constant that is small at first: the slope at small steps falls, and its uncertainty tells.
    bent = fit_order(h, [x**4 + 1e-5 for x in h], [0.0] * 6)
    assert bent.order < 3 and bent.steepening < 0
    assert str(bent) == f"{bent.order:.2f} +- {bent.uncertainty:.2f}"


def test_orders_are_those_of_the_smallest_steps_above_round_off():
    h = [0.8 / 2**k for k in range(12)]
    # Beyond step 0.1 the errors are those of another order, and the last four are round-off.
    errors = [x**4 if x <= 0.1 else 0.1**3 * x for x in h]
    floors = [1e-3 * e if k < 8 else e for k, e in enumerate(errors)]
    shuffled = np.random.default_rng(3).permutation(12)
    found = fit_order(*([column[k] for k in shuffled] for column in (h, errors, floors)))
    assert found.steps.tolist() == h[3:8] and found.errors.tolist() == errors[3:8]
    assert abs(found.order - 4) < 1e-9 and found.dropped == 4


DRIVEN = co.systems.spin_lattice("chain", 2, field=lambda t: (np.cos(3.0 * t), np.sin(3.0 * t), 0.2))


@pytest.mark.parametrize(
    ("method", "step"), long_beyond(1, [(co.SphericalMidpoint(), -0.1), (co.GaussLegendre(2), 0.1)])
)
def test_schemes_of_a_driven_system_are_symmetric(method, step):
    found = co.certify(DRIVEN, method, (0.6, 0.0, 0.8, 0.0, 0.28, 0.96), step, steps=20)
    assert found["symmetry"].verdict == "holds"
    assert found["energy"].verdict == found["reversibility"].verdict == "not applicable"


@pytest.mark.thinned(2)
@pytest.mark.parametrize("step", [0.1, -0.1])
@pytest.mark.parametrize("method", [co.SphericalMidpoint(), co.Composition(co.SphericalMidpoint(), (0.7, -0.4, 0.7))])
def test_forces_on_a_driven_system_have_the_work_of_their_flows(method, step):
    """The energy is that at the time of each flow, before or after the step of the scheme."""
    damped = DRIVEN.with_forces(co.forces.LinearDamping(0.3), co.forces.DoubleBracketDamping(0.2))
    found = co.certify(damped, method, (0.6, 0.0, 0.8, 0.0, 0.28, 0.96), step, steps=8)
    works = [row for row in found.rows if row.key.startswith("work of")]
    assert [row.verdict for row in works] == ["holds"] * 2, str(found)


@pytest.mark.thinned(6)
@pytest.mark.parametrize("place", [0, 2, 4])
@pytest.mark.parametrize("h", [0.1, -0.1])
def test_a_defect_in_one_state_of_a_sample_fails_every_row(place, h):
    sample = np.tile([0.6, 0.5, -0.4], (5, 1)) * np.linspace(0.5, 1.0, 5)[:, None]
    sample[place] = [0.9, -0.8, 0.7]
    options = {"steps": 16, "order": 2, "symmetric": True, "properties": EVERYTHING}
    rows = ["symmetry", "poisson", "energy", "casimir |x|^2"]
    right = co.certify(TURN, turning(), sample, h, **options)
    assert right.passed, str(right)
    wrong = co.certify(TURN, turning(True), sample, h, **options)
    assert set(rows) <= {row.key for row in wrong.failures}, str(wrong)
    # Its size is that of the one state: 2 h^4/10 |x| there and back.
    row = wrong["symmetry"]
    step = float(row.measured.split("at the step ")[1].split(",")[0])
    assert row.value == pytest.approx(0.2 * step**4 * np.linalg.norm(sample[place]), rel=0.05)
    assert wrong["energy"].evidence["deviations"].shape[1] == 5
    deviations = np.max(np.abs(wrong["energy"].evidence["deviations"]), axis=0)
    assert np.argmax(deviations) == place and np.delete(deviations, place).max() < 1e-12


@pytest.mark.thinned(2)
@pytest.mark.parametrize("h", [0.1, -0.1])
@pytest.mark.parametrize("at_the_given", [True, False])
def test_a_defect_at_the_given_step_or_at_larger_ones_alone_fails(at_the_given, h):
    """An exact step still follows the motion at larger steps than the given one, where rows look as well."""
    exact = turning()

    def step(x, length):
        given = abs(abs(float(length)) - abs(h)) < 1e-9
        wrong = given if at_the_given else abs(float(length)) > 2.0 * abs(h)
        return exact(x, length) * (1.0 + 1e-7 if wrong else 1.0)

    sample = np.outer([0.5, 1.0, 0.8, 0.7], [0.6, 0.5, -0.4])
    found = co.certify(TURN, step, sample, h, steps=16, order=2, symmetric=True, properties=EVERYTHING)
    wanted = {"symmetry", "poisson", "energy", "casimir |x|^2"}
    assert wanted <= {row.key for row in found.failures}, str(found)
    lengths = [float(found[key].measured.split("at the step ")[1].split(",")[0]) for key in ("symmetry", "poisson")]
    assert all((length == h) == at_the_given and length / h >= 1.0 for length in lengths)


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


UNITS = [(2.0**30, 2.0**-10), (2.0**-30, 2.0**10)]
"""Units of momentum and time; powers of two round nothing."""


@functools.cache
def rows_of(name, method, momentum, time):
    """Rows of the energy (momentum/time) H(x/momentum), of a midpoint rule with relative errors of 1e-8 as well."""
    algebra = co.algebras.get(name)
    rng, n = np.random.default_rng(len(name)), algebra.dim
    M, linear, states = rng.normal(size=(n, n)), rng.normal(size=n) / 4, rng.normal(size=(4, n)) / 2
    system = co.LiePoissonSystem(algebra, co.Quadratic(M @ M.T / (n * momentum * time), linear=linear / time))

    def noisy(x, h):
        after = x + h * system.vector_field(x + h / 2 * system.vector_field(x))
        return after * (1.0 + 1e-8 * (np.frexp(after)[0] * 2.0**45 % 1.0))  # by the last bits of each coordinate

    said = {"order": 2, "properties": EVERYTHING, "symmetric": False} if method == "noisy" else {}
    scheme = {"Splitting": co.Splitting(parts="coordinates"), "Gauss": co.GaussLegendre(2), "noisy": noisy}[method]
    found = co.certify(system, scheme, momentum * states, time / 8, steps=4, **said)
    return {row.key: row for row in found.rows}


@pytest.mark.thinned(30)
@pytest.mark.parametrize("units", UNITS, ids=["large", "small"])
@pytest.mark.parametrize("method", ["Splitting", "Gauss", "noisy"])
@pytest.mark.parametrize("name", ["so(3)", "sl(2)", "e(2)", "so(4)", "heisenberg(1)"])
def test_units_change_no_verdict_and_scale_every_bound(name, method, units):
    """Elements and relative errors have no unit, invariants neither."""
    scaled, plain = rows_of(name, method, *units), rows_of(name, method, 1.0, 1.0)
    unit = dict.fromkeys(("symmetry", "reversibility", "poisson", "spatial momentum"), units[0])
    assert scaled.keys() == plain.keys() and {*unit} - {"spatial momentum"} <= plain.keys()
    for key, row in plain.items():
        assert scaled[key].verdict == row.verdict, f"{row}\n{scaled[key]}"
        if row.bound:
            # Another step or state may be the worst after rounding; a power of a unit too many is at least 2^10.
            assert 2.0**-5 < scaled[key].bound / (unit.get(key, 1.0) * row.bound) < 2.0**5, key


@pytest.mark.parametrize(
    "function",
    [
        lambda x, h: x + h * BODY.vector_field(x),
        lambda x, t, h: x + h * BODY.vector_field(x),
        lambda x, h, tolerance=1e-9: x + h * BODY.vector_field(x),
        lambda x, t, h, tolerance=1e-9: x + h * BODY.vector_field(x),
        functools.partial(lambda rate, x, h: x + rate * h * BODY.vector_field(x), 1.0),
    ],
)
def test_a_function_of_three_needed_arguments_takes_the_time(function):
    found = co.certify(BODY, function, X0, 0.1, steps=8, order=1, symmetric=False, properties=NOTHING)
    assert found.passed and abs(found["order"].value - 1.0) < 0.05


def test_schemes_with_steps_of_their_own_declare_no_order_of_the_step():
    assert co.certify(BODY, co.Taylor(tolerance=1e-9), X0, 0.5, steps=8)["order"].declared != "12"
    assert "12" in co.certify(BODY, co.Taylor(12), X0, 0.5, steps=8)["order"].declared


# Thresholds


TURNING = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic((0.0, 0.0, 1.0)), sign=1)


@functools.cache
def verdicts(size=0.0, speed=0.0, order=None, plain=False):
    """Verdicts on a step that is exact but for a factor of the state, and one of the speed.

    The speed may have an error of some order in h; a plain step takes no complex numbers.
    """

    def step(x, h):
        x = x.astype(float, casting="safe") if plain else x
        angle = x[2] * h * (1.0 + speed * (1.0 if order is None else abs(h) ** order))
        turn = np.array(
            [[np.cos(angle), -np.sin(angle), 0.0 * x[2]], [np.sin(angle), np.cos(angle), 0.0 * x[2]], [0, 0, 1]]
        )
        return (turn @ x) * (1.0 + size)

    found = co.certify(TURNING, step, (0.6, 0.0, 0.8), 0.125, properties=EVERYTHING, order=2, symmetric=True, steps=128)
    return {row.key: row.verdict for row in found.rows}


POISSON = 64 * U * (64 + 4) * 3 * 3
SIDES = [
    # (1 + off) R has a defect of off |J|; |P|^2 is 3, and evaluations are 64 + 4.
    ("poisson", {"size": 0.5 * POISSON}, {"size": 2.0 * POISSON}),
    # Of differences, the floor is 1e-9 |P|^2 |J|.
    ("poisson", {"size": 1.5e-9, "plain": True}, {"size": 6e-9, "plain": True}),
    # 2 off against 2 cond 12 u, where the condition of a turn is 3; what is seen of rounding is added.
    ("symmetry", {"size": 3 * U}, {"size": 64 * 12 * U}),
    # Over n steps |x|^2 grows by 2 n off, and its size is 3: 12 u of that for each, and what is seen of rounding.
    ("energy", {"size": 3 * U}, {"size": 128 * U}),
    ("casimir |x|^2", {"size": 3 * U}, {"size": 128 * U}),
    # After 1.25 radians: 16 times twice the error of the reference, an eighth of what two runs of it differ by.
    ("reference", {"speed": 1e-13}, {"speed": 4e-12}),
    # Declared is 2; a quarter is left for what the uncertainty of a slope does not contain.
    ("order", {"speed": 0.01, "order": 2.0 - 0.125}, {"speed": 0.01, "order": 2.0 - 0.5}),
]


@pytest.mark.parametrize(("row", "inside", "outside"), SIDES, ids=[row for row, *_ in SIDES])
def test_thresholds(row, inside, outside):
    assert verdicts(**inside)[row] == "holds" and verdicts(**outside)[row] == "fails"


@pytest.mark.parametrize(("off", "agrees"), [(0.5e-8, True), (2e-8, False)])
def test_a_closed_form_agrees_with_the_field_to_its_threshold(off, agrees):
    def exact(x, t, attitude=None):
        c, s = np.cos(x[2] * t), np.sin(x[2] * t)
        return np.array([c * x[0] - s * x[1], c * x[1] + s * x[0], x[2] + off * np.linalg.norm(x)])

    system = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic((0.0, 0.0, 1.0)), exact=exact)
    row = co.certify(system, co.GaussLegendre(2), (0.6, 0.0, 0.8), 0.1, steps=4)["reference"]
    assert ("closed form" in row.measured) is agrees


@pytest.mark.parametrize(("size", "accepted"), [(2e-75, True), (0.5e75, True), (0.5e-75, False), (2e75, False)])
def test_states_have_sizes_whose_products_fit(size, accepted):
    """The largest one counts."""
    for states in ((size, 0, 0), [(0, 0, 0), (size, 0, 0)]):
        with nullcontext() if accepted else refused(ValueError, "choose units"):
            co.certify(TURNING, co.GaussLegendre(1), states, 0.1, steps=1)

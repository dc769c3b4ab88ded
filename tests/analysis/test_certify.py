"""Certificates: their rows and verdicts, functions of the user, failing runs, what is refused."""

import json
import math

import mpmath
import numpy as np
import pytest

import coadjoint as co
from coadjoint.analysis.certificates.certificate import VERDICTS
from coadjoint.analysis.checks.invariants import keeps
from coadjoint.analysis.fits import growth, slope
from coadjoint.methods import Properties

BODY = co.systems.rigid_body(inertia=(1, 2, 3))
X0 = np.array([0.3, 1.0, 0.2])
NOTHING = Properties(poisson=False, energy=False, casimirs="none", attitude="none")
SPLIT = Properties(poisson=True, energy=False, casimirs="all", attitude="none")


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
    assert all(row.verdict in VERDICTS for row in found.rows)
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
    with pytest.raises(KeyError, match="did you mean 'energy'"):
        found["enregy"]
    assert all(found[row.key] is row for row in found.rows)
    for key in {row.key[:count] for row in found.rows for count in range(len(row.key))} - set(keys):
        with pytest.raises(KeyError, match="unknown row"):
            found[key]


def test_it_is_written_for_readers_and_for_machines():
    found = certified()
    text = str(found)
    assert max(map(len, text.splitlines())) <= 130
    assert "passed: every declared property holds" in text and "64 u |P|^2 |J|" in text
    assert "passed" in repr(found)
    read = json.loads(found.to_json())
    assert read == json.loads(json.dumps(found.to_mapping()))
    assert read["passed"] is True and read["schema"] == 1
    assert read["subject"]["versions"]["coadjoint"] == co.__version__
    assert read["subject"]["scheme"]["description"]["name"] == "Splitting"
    poisson = next(row for row in read["rows"] if row["key"] == "poisson")
    assert poisson["claimed"] and poisson["value"] <= poisson["bound"] and poisson["verdict"] == "holds"


def test_the_same_certificate_twice():
    assert certified().to_json() == certified().to_json()


def test_of_a_function_nothing_is_said():
    found = certified(euler)
    assert found.passed and not found.declares
    assert "nothing was declared" in str(found)
    assert abs(found["order"].value - 1.0) < 0.05 and found["order"].declared == "nothing"
    assert found["energy"].verdict == "not kept, not declared"
    assert found["attitude"].verdict == "not applicable"


def test_a_function_with_true_and_false_claims():
    assert certified(euler, order=1, symmetric=False, properties=NOTHING).passed
    assert [row.key for row in certified(euler, order=2).failures] == ["order"]
    assert [row.key for row in certified(euler, order=1, symmetric=True).failures] == ["symmetry"]
    assert [row.key for row in certified(euler, order=1, properties=SPLIT).failures] == ["poisson", "casimir |x|^2"]


def test_a_sample_is_taken_as_it_is():
    sample = np.random.default_rng(3).normal(size=(5, 3))
    found = co.certify(BODY, co.Splitting(), sample, 0.1, steps=40)
    assert found.passed and np.array_equal(found.subject["states"], sample)


@pytest.mark.long
def test_hamiltonians_that_depend_on_time_have_no_energy_row():
    timed = co.Hamiltonian(
        lambda x, t: 0.5 * x[0] ** 2 + x[1] ** 2 + math.sin(t) * x[2],
        lambda x, t: np.array([x[0], 2.0 * x[1], math.sin(t)]),
        lambda x, t: np.array([[1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 0.0]]),
    )
    system = co.LiePoissonSystem(co.algebras.so(3), timed)
    found = co.certify(system, co.GaussLegendre(2), X0, 0.1, steps=40)
    assert found.passed, str(found)
    assert found["energy"].verdict == found["reversibility"].verdict == "not applicable"

    def midpoint(x, t, h):
        y = x
        for _ in range(50):
            y = x + h * system.vector_field((x + y) / 2, t + h / 2)
        return y

    def at_the_start(x, t, h):
        y = x
        for _ in range(50):
            y = x + h * system.vector_field((x + y) / 2, t)
        return y

    quadratic = Properties(poisson=False, energy=False, casimirs="quadratic", attitude="none")
    right = co.certify(system, midpoint, X0, 0.1, steps=20, order=2, symmetric=True, properties=quadratic)
    assert right.passed, str(right)
    wrong = co.certify(system, at_the_start, X0, 0.1, steps=20, order=2, symmetric=True, properties=quadratic)
    assert {"order", "symmetry"} <= {row.key for row in wrong.failures}


@pytest.mark.long
def test_without_second_derivatives_the_step_itself_is_differentiated():
    """The compiled loop takes no complex numbers: differences, with their floor; a declared property is held to it."""
    H = co.Hamiltonian(lambda x: 0.5 * x[0] ** 2 + x[1] ** 2, lambda x: np.array([x[0], 2.0 * x[1], 0.0]))
    system = co.LiePoissonSystem(co.algebras.so(3), H)
    found = co.certify(system, co.GaussLegendre(2), X0, 0.1, steps=40)
    assert found.passed, str(found)
    assert found["poisson"].verdict == "not kept, not declared"


def shear(x, h):
    """The exact flow of x1^2/2 on so(3), the axis turned about: a Poisson map."""
    c, s = np.cos(h * x[0]), np.sin(h * x[0])
    return np.array([x[0], c * x[1] - s * x[2], s * x[1] + c * x[2]])


def in_many_digits(x, h):
    cosine, sine = (mpmath.cos, mpmath.sin) if isinstance(x[0], mpmath.mpf) else (math.cos, math.sin)
    c, s = cosine(h * x[0]), sine(h * x[0])
    return np.array([x[0], c * x[1] - s * x[2], s * x[1] + c * x[2]])


def in_floats(x, h):
    return shear(np.array([float(v) for v in x]), float(h))


@pytest.mark.parametrize(
    ("step", "by"), [(shear, "complex step"), (in_many_digits, "multiprecision"), (in_floats, "differences")]
)
def test_the_tangent_of_a_function_is_as_exact_as_it_allows(step, by):
    system = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1.0, 0.0, 0.0]))
    found = co.certify(system, step, X0, 0.1, steps=20, order=8, symmetric=True, properties=SPLIT)
    assert found.passed, str(found)
    assert f"tangent by {by}" in found["poisson"].measured
    exact = by != "differences"
    assert (found["poisson"].bound < 1e-10) == exact
    assert ("floor of differences" in found["poisson"].source) != exact


def test_differences_see_what_is_above_their_floor():
    system = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1.0, 0.0, 0.0]))
    found = co.certify(system, lambda x, h: in_floats(x, h) * (1 + 1e-6 * h), X0, 0.1, steps=20, properties=SPLIT)
    assert found["poisson"].verdict == "fails"


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


def test_what_rests_cannot_be_told():
    found = co.certify(BODY, co.Splitting(), (1.0, 0.0, 0.0), 0.1, steps=40)
    assert found["order"].verdict == found["reference"].verdict == "not decidable here"
    assert "rests" in found["order"].reason
    assert not found.passed and "not decidable here" in str(found).splitlines()[-1]


def test_an_exact_scheme_has_every_order():
    system = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1.0, 0.0, 0.0]))
    found = co.certify(system, co.Splitting(order=2), X0, 0.1, steps=40)
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


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"step": 0.0}, "must not be zero"),
        ({"steps": 0}, "steps"),
        ({"method": 3}, "must be a scheme"),
        ({"method": lambda x: x}, "takes 1 arguments"),
        ({"order": 2}, "declares its own"),
        ({"method": euler, "symmetric": 1}, "symmetric"),
        ({"method": euler, "properties": "all"}, "Properties"),
        (
            {"method": euler, "properties": Properties(True, False, "all", "coadjoint")},
            'give attitude="none"',
        ),
        ({"system": co.batch([BODY, BODY])}, "one system"),
    ],
)
def test_wrong_input_is_refused(options, said):
    given = {"system": BODY, "method": co.Splitting(), "x0": X0, "step": 0.1, **options}
    with pytest.raises((ValueError, TypeError), match=said):
        co.certify(given.pop("system"), given.pop("method"), given.pop("x0"), given.pop("step"), **given)


def test_a_scheme_that_cannot_serve_is_refused_by_name():
    system = co.PoissonSystem(lambda x: np.array([[0.0, x[0]], [-x[0], 0.0]]), co.Quadratic([1.0, 1.0]))
    with pytest.raises(ValueError, match="needs a Lie algebra"):
        co.certify(system, co.Splitting(), (1.0, 1.0), 0.1)


def test_growth_is_classified():
    t = np.linspace(0.0, 1000.0, 129)
    walks = np.cumsum(np.random.default_rng(5).normal(size=(129, 64)), axis=0)
    assert growth(t, walks - walks[0]).kind == "like sqrt(t)"
    assert growth(-t, 3e-9 * t[:, None]).kind == "linear"
    assert growth(t, np.sin(7.0 * t)[:, None]).kind == "bounded"
    assert growth(t, (t**2)[:, None]).kind == "like t^2.0"
    assert growth(t, np.zeros((129, 2))).kind == "none"


def test_slopes_know_how_sure_they_are():
    h = [0.4 / 2**k for k in range(6)]
    for p in (1, 2, 4, 8):
        found = slope(h, [x**p * (1 + 0.8 * x) for x in h], [1e-16] * 6)
        # The square of the next term, (0.8 h)^2 at the first three steps of those taken, is left.
        assert abs(found.value - p) <= found.uncertainty + 0.8**2 * found.steps[0] ** 2
        assert found.uncertainty < 0.1
    # A constant that is small at first: the slope at small steps falls, and its uncertainty tells.
    bent = slope(h, [x**4 + 1e-5 for x in h], [0.0] * 6)
    assert bent.value < 3 and bent.steepening < 0
    assert slope(h, [1e-15] * 6, [1e-15] * 6) is None


def test_slopes_are_those_of_the_smallest_steps_above_round_off():
    h = [0.8 / 2**k for k in range(12)]
    # Beyond step 0.1 the errors are those of another order, and the last four are round-off.
    errors = [x**4 if x <= 0.1 else 0.1**3 * x for x in h]
    floors = [1e-3 * e if k < 8 else e for k, e in enumerate(errors)]
    shuffled = np.random.default_rng(3).permutation(12)
    found = slope(*([column[k] for k in shuffled] for column in (h, errors, floors)))
    assert found.steps.tolist() == h[3:8] and found.errors.tolist() == errors[3:8]
    assert abs(found.value - 4) < 1e-9


@pytest.mark.thinned(6)
@pytest.mark.parametrize("method", [co.Splitting(order=4), co.GaussLegendre(2), co.SphericalMidpoint()], ids=repr)
@pytest.mark.parametrize("step", [0.1, -0.1])
def test_schemes_of_a_driven_system_are_symmetric(method, step):
    spins = co.systems.spin_lattice("chain", 2, field=lambda t: (np.cos(3.0 * t), np.sin(3.0 * t), 0.2))
    found = co.certify(spins, method, (0.6, 0.0, 0.8, 0.0, 0.28, 0.96), step, steps=20)
    assert found["symmetry"].verdict == "holds"


def test_what_a_kind_of_casimirs_keeps():
    quadratic, cubic = co.Polynomial({(2, 0): 1.0}), co.Polynomial({(3, 0): 1.0})
    function = co.Invariant(lambda x: x[0])
    kept = {
        kind: [keeps(Properties(False, False, kind, "none"), c) for c in (quadratic, cubic, function)]
        for kind in ("all", "polynomial", "quadratic", "none")
    }
    assert kept == {
        "all": [True, True, True],
        "polynomial": [True, True, False],
        "quadratic": [True, False, False],
        "none": [False, False, False],
    }

"""Steps that follow the motion and can be taken back: the map, what it keeps, its bits, and what is refused."""

import json

import numpy as np
import pytest

import coadjoint as co
from coadjoint.files.configuration.loading import load
from coadjoint.files.datasets.export import rebuild
from coadjoint.methods import registry
from coadjoint.methods.reversible_steps import speed_of
from coadjoint.rounding import UNIT_ROUNDOFF

TOP = co.LiePoissonSystem(
    co.algebras.e(3), co.Quadratic([1.0, 0.75, 0.5, 0, 0, 0], linear=[0, 0, 0, 0.25, 0, 1.0]), sign=-1, name="top"
)
BODY = co.systems.rigid_body(inertia=(1, 2, 3))
SOLVABLE = co.LiePoissonSystem(
    co.algebras.get("A4,7"), co.Quadratic([0.5, 1.0, 0.75, 0.25], linear=[0.1, 0.2, 0.0, 0.3]), name="solvable"
)
CURVED = co.PoissonSystem(
    lambda x: np.array([[0.0, x[2] * x[2], -x[1]], [-x[2] * x[2], 0.0, x[0]], [x[1], -x[0], 0.0]]),
    co.Quadratic([1.0, 2.0, 3.0]),
    name="curved",
)
POSITIVE = co.Polynomial({(0, 0, 0): 0.5, (2, 0, 0): 1.0, (0, 2, 0): 0.75})
CASES = {
    "flows of a top": (TOP, co.Splitting(order=2), None),
    "flows of order 4": (TOP, co.Splitting(order=4), None),
    "stages of a body, a speed given": (BODY, co.GaussLegendre(2), POSITIVE),
    "stages on a solvable algebra": (SOLVABLE, co.GaussLegendre(3), None),
    "Kahan's rational steps": (BODY, co.Kahan(), None),
    "a composition, a quadratic speed": (
        BODY,
        co.Composition(co.GaussLegendre(1), (1.3512071919596578, -1.7024143839193155, 1.3512071919596578)),
        co.Quadratic([2.0, 1.0, 1.0]),
    ),
    "no Lie algebra": (CURVED, co.GaussLegendre(2), POSITIVE),
}
STATES = np.random.default_rng(8).uniform(0.3, 1.0, (5, 6))


def start_of(system, member=0):
    return STATES[member, : system.dim]


def walked(system, method, x, steps, direction=1.0, rho=None):
    """Return the states between the steps, the lengths, and rho after the last: an independent reading."""
    speed, states, lengths = speed_of(system, method.speed), [np.array(x)], []
    for _ in range(steps):
        Q, rate = speed.at(states[-1])
        rho = Q + 0.5 * method.stride * direction * rate if rho is None else rho + method.stride * direction * rate
        lengths.append(direction * method.stride / rho)
        states.append(np.asarray(method.base.step(system, states[-1], 0.0, lengths[-1])))
    return np.array(states), np.array(lengths), rho


@pytest.mark.thinned(12)
@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_steps_can_be_taken_back(name, direction):
    """Back from the end with the rho of the last step: the same lengths and states in the other order."""
    system, base, speed = CASES[name]
    method = co.ReversibleSteps(base, 0.1, speed)
    forth, lengths, rho = walked(system, method, start_of(system), 60, direction)
    # The first step back has the rho of the last one forth, before what the state at the end adds.
    _, rate = speed_of(system, speed).at(forth[-1])
    back, returned, _ = walked(system, method, forth[-1], 60, -direction, rho + direction * method.stride * rate)
    size = np.abs(forth).max()
    # Each step rounds some ten numbers, and errors of a regular motion grow like time.
    assert np.abs(back[::-1] - forth).max() < 60 * 200 * UNIT_ROUNDOFF * size
    assert np.abs(returned[::-1] + lengths).max() < 60 * 200 * UNIT_ROUNDOFF * np.abs(lengths).max()
    assert np.ptp(np.abs(lengths)) > 0.01 * np.abs(lengths).max()


@pytest.mark.thinned(12)
@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("end", [3.0, -3.0])
def test_the_compiled_steps_are_those_of_the_reading(name, end):
    system, base, speed = CASES[name]
    method = co.ReversibleSteps(base, 0.125, speed)
    sol = co.integrate(system, start_of(system), (0.0, end), 0.25, method)
    assert sol.stats.steps == 12
    for k in (1, 5, 12):
        read = method.step(system, start_of(system), 0.0, sol.t[k])
        assert np.abs(sol.x[k] - read).max() < 1e4 * UNIT_ROUNDOFF * np.abs(sol.x).max()


@pytest.mark.parametrize("name", CASES)
def test_the_order_is_that_of_the_base_in_the_stride(name):
    system, base, speed = CASES[name]
    x0, errors = start_of(system), []
    exact = co.integrate(system, x0, (0.0, 4.0), 0.015625, co.GaussLegendre(6)).x[-1]
    strides = (0.2, 0.1, 0.05) if base.order < 5 else (0.4, 0.2)
    for stride in strides:
        found = co.integrate(system, x0, (0.0, 4.0), 4.0, co.ReversibleSteps(base, stride, speed)).x[-1]
        errors.append(np.linalg.norm(found - exact))
    slopes = np.log2(np.divide(errors[:-1], errors[1:]))
    # What the last, shorter, step takes off the sum of the local errors is a step of some forty.
    assert abs(slopes[-1] - base.order) < 0.35, slopes


@pytest.mark.parametrize("name", CASES)
def test_no_bit_depends_on_how_one_looks_or_on_company(name):
    system, base, speed = CASES[name]
    method, span = co.ReversibleSteps(base, 0.125, speed), (0.0, 6.0)
    states = STATES[:, : system.dim]
    whole = co.integrate(system, states, span, 0.125, method)
    assert np.array_equal(co.integrate(system, states, span, 0.125, method, save_every=8, watch=False).x, whole.x[::8])
    assert np.array_equal(co.integrate(system, states, span, 1.5, method, threads=2).x, whole.x[::12])
    for member in (0, 3):
        assert np.array_equal(co.integrate(system, states[member], span, 0.125, method).x, whole.x[:, member])


def test_the_group_element_goes_with_the_steps():
    for base in (co.Splitting(order=2), co.Splitting(order=4, parts="coordinates")):
        method = co.ReversibleSteps(base, 0.1)
        sol = co.integrate(TOP, start_of(TOP), (0.0, 20.0), 0.5, method, attitude="coadjoint")
        kept = np.einsum("kij,kj->ki", sol.attitude, sol.x)
        assert np.abs(kept - kept[0]).max() < 1e-12
        alone = co.integrate(TOP, start_of(TOP), (0.0, 20.0), 0.5, method)
        assert np.array_equal(alone.x, sol.x)


def falling():
    """A symmetric top whose axis starts near the vertical and falls: its spin about the axis cannot hold it."""
    system = co.LiePoissonSystem(
        co.algebras.e(3), co.Quadratic([1.0, 1.0, 0.25, 0, 0, 0], linear=[0, 0, 0, 0, 0, 4.0]), sign=-1, name="falling"
    )
    return system, np.array([1e-3, 0.0, 1.0, 0.02, 0.0, 1.0])


def test_casimirs_to_rounding_and_energy_without_drift():
    system, x0 = falling()
    method = co.ReversibleSteps(co.Splitting(order=2), 0.05)
    sol = co.integrate(system, x0, (0.0, 4000.0), 1.0, method)
    steps = sol.stats.evaluations
    assert steps > 10**5
    for name in sol.casimirs:
        # Each flow rounds, without a sign that it prefers.
        assert sol.drift()[name] < 64 * UNIT_ROUNDOFF * np.sqrt(steps) * np.abs(sol.x).max() ** 2
    energy = sol.drift()["energy"]
    assert energy < 0.02 and energy.growth < 1.5
    coarser = co.integrate(system, x0, (0.0, 400.0), 1.0, co.ReversibleSteps(co.Splitting(order=2), 0.1))
    assert 2.5 < coarser.drift()["energy"] / co.integrate(system, x0, (0.0, 400.0), 1.0, method).drift()["energy"] < 6.0


def test_what_it_says_of_itself():
    for base in (co.Splitting(order=4), co.GaussLegendre(2), co.Kahan()):
        said, alone = co.ReversibleSteps(base).properties(BODY), base.properties(BODY)
        assert said.reversible and not said.poisson and not alone.reversible
        assert (said.energy, said.casimirs, said.attitude) == (alone.energy, alone.casimirs, alone.attitude)
    assert "reversible=True" in repr(said) and "reversible" not in repr(alone)
    assert co.ReversibleSteps(co.Splitting(order=4)).own_steps


def test_a_speed_that_ends_is_a_failure_by_name():
    ending = co.Polynomial({(0, 0, 0): 0.05, (0, 0, 1): 1.0})
    with pytest.raises(co.IntegrationError, match="the speed of the motion fell to zero or below"):
        co.integrate(BODY, (1.0, 0.2, 0.3), (0.0, 40.0), 1.0, co.ReversibleSteps(co.Splitting(), 0.1, ending))


@pytest.mark.long
def test_steps_without_end_are_a_failure():
    """Of 1e-9 each more than 2^24 lie in one step of the run; shorter steps of the run have fewer."""
    with pytest.raises(co.IntegrationError, match=r"more than 2\^24 of its own steps would lie in one step"):
        co.integrate(BODY, (1.0, 0.2, 0.3), (0, 1), 1.0, co.ReversibleSteps(co.Splitting(order=2), 1e-9))
    shorter = co.integrate(BODY, (1.0, 0.2, 0.3), (0, 2e-3), 1e-3, co.ReversibleSteps(co.Splitting(order=2), 1e-9))
    there = BODY.exact((1.0, 0.2, 0.3), 2e-3)
    assert np.abs(shorter.x[-1] - there).max() < 1e-8


LINE = co.LieAlgebra.from_brackets(2, {(0, 1): {1: 1.0}})
STRIDE = 0.25


def growing(hamiltonian, end, power):
    """Return the number of own steps, as a power of two, of a run from (0, 1) over one step, and whether it ended.

    The speed of the steps is x2^power. Forward x2 grows: by `hamiltonian` x1 as exp(t), by x1 x2 as 1 / (1 - t).
    """
    system = co.LiePoissonSystem(LINE, hamiltonian)
    x0 = (0.0, 1.0)
    forward = float(np.sign(system.vector_field(np.array(x0))[1]))

    def taken(end, speed, stride=STRIDE):
        method = co.ReversibleSteps(co.Splitting(order=2), stride, co.Polynomial(speed))
        try:
            return co.integrate(system, x0, (0.0, end), abs(end), method).stats.evaluations, True
        except co.IntegrationError as error:
            assert error.step == 1 and "2^24 of its own steps would lie in one step" in str(error)
            return error.partial.stats.evaluations, False

    of_one_step = round(taken(forward * 0.5, {(0, 0): 1.0}, 2.0**-6)[0] / 32)
    evaluations, ended = taken(forward * end, {(0, power): 1.0})
    return np.log2(evaluations / of_one_step), ended


EXPONENTIAL, HYPERBOLIC = co.Polynomial({(1, 0): 1.0}), co.Polynomial({(1, 1): 1.0})


@pytest.mark.parametrize(("end", "power"), [(1.25, 2), (2.0, 2), (1e6, 2), (1.25, 3)])
def test_a_motion_to_infinity_is_given_up_early(end, power):
    """Steps of the length (1 - t)^power: each doubling brings a fixed part of what the doubling before has brought."""
    steps, ended = growing(HYPERBOLIC, end, power)
    assert not ended and steps == pytest.approx(15.0, abs=0.01)


def test_exponential_growth_is_followed_as_far_as_the_steps_reach():
    """Each doubling brings log 2: given up at 2^k where four times what is left is not enough, on both sides."""
    doubling = np.log(2.0)
    for k in (15, 16, 17):
        enough = np.log(2.0**k * STRIDE) + 4.0 * (24 - k) * doubling
        for end, power in ((enough + 0.3, k), (enough - 0.3, k + 1)):
            steps, ended = growing(EXPONENTIAL, end, 1)
            assert not ended and steps == pytest.approx(power, abs=0.01)
    steps, ended = growing(EXPONENTIAL, np.log(2.0**18 * STRIDE), 1)
    assert ended and steps == pytest.approx(18.0, abs=0.05)


def driven(y, t):
    return 0.5 * y * y + np.sin(t) * y


def driven_slope(y, t):
    return y + np.sin(t)


@pytest.mark.parametrize(
    "make, error, sentence",
    [
        (lambda: co.ReversibleSteps(co.ExplicitRungeKutta("rk4")), ValueError, "needs a symmetric base"),
        (lambda: co.ReversibleSteps(co.ReversibleSteps(co.Splitting())), ValueError, "already chooses its own steps"),
        (lambda: co.ReversibleSteps(co.GaussLegendre(2)).properties(CURVED), ValueError, "from a Lie algebra"),
        (
            lambda: co.ReversibleSteps(co.Splitting(), speed=POSITIVE).properties(TOP),
            ValueError,
            "a polynomial in 3 coordinates, and top has 6",
        ),
        (
            lambda: co.ReversibleSteps(co.Splitting()).properties(
                co.LiePoissonSystem(co.algebras.so(3), co.Separable({0: (driven, driven_slope)}))
            ),
            ValueError,
            "depends on time",
        ),
    ],
)
def test_what_is_refused(make, error, sentence):
    with pytest.raises(error, match=sentence):
        make()


def test_it_is_known_by_its_name_with_all_that_it_is_given():
    for speed in (None, POSITIVE, co.Quadratic([2.0, 1.0, 1.0], linear=[0.1, 0.0, 0.0], constant=3.0)):
        method = co.ReversibleSteps(co.GaussLegendre(2), 0.125, speed)
        again = registry.from_description(json.loads(json.dumps(registry.description_of(method))))
        assert again.base == method.base and again.stride == method.stride
        one, other = (co.integrate(BODY, start_of(BODY), (0, 8), 0.5, each) for each in (method, again))
        assert np.array_equal(one.x, other.x) and one.stats.evaluations == other.stats.evaluations
    assert co.methods.get("ReversibleSteps", base={"name": "Kahan"}) == co.ReversibleSteps(co.Kahan())
    with pytest.raises(ValueError, match="speed of ReversibleSteps is"):
        co.methods.get("ReversibleSteps", base={"name": "Kahan"}, speed=[[1.0, 2, 3]])


def test_a_file_and_a_dataset_run_it_again(tmp_path):
    path = tmp_path / "body.toml"
    path.write_text(
        '[system]\nname = "rigid_body"\nparameters = {inertia = [1, 2, 3]}\n[initial]\nx = [0.3, 0.5, 0.9]\n'
        '[method]\nname = "ReversibleSteps"\nstride = 0.2\nspeed = [[0.5, [0, 0, 0]], [1.0, [2, 0, 0]]]\n'
        'base = {name = "Splitting", order = 4}\n[run]\nt_span = [0, 4]\nstep = 0.5\n'
    )
    sol = load(path).integrate()
    speed = co.Polynomial({(0, 0, 0): 0.5, (2, 0, 0): 1.0})
    method = co.ReversibleSteps(co.Splitting(order=4), 0.2, speed)
    assert sol.method == method
    by_hand = co.integrate(BODY, (0.3, 0.5, 0.9), (0, 4), 0.5, method)
    assert np.array_equal(sol.x, by_hand.x)
    again = rebuild(sol.to_xarray())
    assert np.array_equal(again.x, sol.x) and again.method == method


@pytest.mark.parametrize("base", [co.Splitting(order=2), co.GaussLegendre(2)], ids=str)
def test_prepared_runs_batches_and_ensembles(base):
    method = co.ReversibleSteps(base, 0.1)
    states = np.random.default_rng(3).uniform(0.2, 1.0, (9, 3))
    bodies = co.batch([co.systems.rigid_body(inertia=(1.5, 2.0, 2.25 + 0.125 * k)) for k in range(9)])
    for end in (4.0, -4.0):
        batch = co.integrate(bodies, states, (0, end), 0.25, method, threads=2, attitude=True)
        ready = co.prepare(bodies, method, 0.25, attitude=True)
        ready.run(states[::-1], (0, end))
        assert np.array_equal(ready.run(states, (0, end)).x, batch.x)
        for m in (0, 4, 8):
            alone = co.integrate(bodies[m], states[m], (0, end), 0.25, method, attitude=True)
            assert np.array_equal(batch.x[:, m], alone.x) and np.array_equal(batch.attitude[:, m], alone.attitude)
            end_alone = co.prepare(bodies[m], method, 0.25).end(states[m], (0, end))
            assert np.array_equal(end_alone, alone.x[-1])
    ensemble = co.integrate(BODY, states, (0, 4), 0.25, method, threads=2)
    assert np.array_equal(ensemble.x[:, 5], co.integrate(BODY, states[5], (0, 4), 0.25, method).x)


@pytest.mark.parametrize("h", [0.75, -0.75])
def test_a_step_as_a_function(h):
    """The motion over a step and its derivative; it is that of a run of one step."""
    method, x = co.ReversibleSteps(co.Splitting(order=4), 0.1), start_of(BODY)
    step = co.stepper(BODY, method, h)
    run = co.integrate(BODY, x, (0, h), abs(h), method, attitude=True)
    assert np.array_equal(step(x), run.x[-1])
    P, e = step.tangent(x), 1e-5
    for direction in np.eye(3):
        ends = [step(x + k * e * direction) for k in (1, -1, 2, -2)]
        slope = (8 * (ends[0] - ends[1]) - (ends[2] - ends[3])) / (12 * e)
        # Rounding of states over the distance, and of the difference by e^4.
        assert np.max(np.abs(P @ direction - slope)) < 64 * UNIT_ROUNDOFF / e
    assert np.max(np.abs(P - np.eye(3))) > 0.1


@pytest.mark.long
def test_a_certificate_says_what_it_keeps():
    found = co.certify(BODY, co.ReversibleSteps(co.Splitting(order=2), 0.1), start_of(BODY), step=0.1, steps=50)
    assert found.passed
    assert found["casimir |x|^2"].verdict == "holds" == found["spatial momentum"].verdict
    assert found["poisson"].verdict == "not kept, not declared"


def test_it_refuses_what_depends_on_time():
    driven = co.LiePoissonSystem(
        co.algebras.so(3),
        co.Separable({0: (lambda y, t: y * np.sin(t), lambda y, t: np.sin(t))}),
        name="driven",
    )
    with pytest.raises(ValueError, match="depends on time; take"):
        co.integrate(driven, (1.0, 0.0, 0.2), (0, 1), 0.1, co.ReversibleSteps(co.Splitting(order=2)))

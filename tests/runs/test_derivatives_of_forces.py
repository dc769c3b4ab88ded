"""Derivatives of runs with forces and noise: adjoint to each other, and equal to differences of runs of order 8."""

import dataclasses

import numpy as np
import pytest

import coadjoint as co
from coadjoint.kernels.interface import limit
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.systems.forces.base import Force
from coadjoint.systems.forces.registry import FORCES
from coadjoint.systems.parameters import parameters_of, with_parameters
from coadjoint.systems.protocol import unforced
from verification.systems_under_test import full_matrix

pytestmark = pytest.mark.thinned(4)

F, H = co.forces, 0.0625
WEIGHTS = (4 / 5, -1 / 5, 4 / 105, -1 / 280)
DISTANCE = 2.0**-11
ADJOINT_ERROR = 2.0**10 * UNIT_ROUNDOFF
DIFFERENCE_ERROR = 2.0**10 * UNIT_ROUNDOFF / DISTANCE
# Functions of the user without complex numbers are differentiated with about nine digits.
FUNCTION_ERROR = 2.0**-30

WAVING_SQUARE = (
    lambda y, t: np.cos(3 * t) * y**2,
    lambda y, t: 2 * np.cos(3 * t) * y,
    lambda y, t: 2 * np.cos(3 * t) + 0 * y,
)
DRIVEN = co.LiePoissonSystem(
    co.algebras.so(3), co.Quadratic([1.0, 0.5, 0.4]) + co.Separable({0: WAVING_SQUARE}), name="driven"
)

ALGEBRAS = {
    "so(3)": (co.algebras.so(3), -1),
    "so(4)": (co.algebras.so(4), -1),
    "sl(2)": (co.algebras.sl(2), 1),
    "A3,7": (co.algebras.get("A3,7", a=1.75), 1),
    "A5,40": (co.algebras.get("A5,40"), -1),
}
SPANS = {
    "forward": ((0.5, 0.5 + 6 * H), {"save_every": 4}),
    "backward": ((-40.0, -40.0 - 4 * H), {"t_eval": -40.0 - H * np.array([0.0, 0.25, 1.0, 2.75, 4.0])}),
    "from inside": ((1.0, 1.0 + 3 * H), {"t_eval": 1.0 + H * np.array([0.5, 2.25])}),
}


def plain(name, full=True):
    algebra, sign = ALGEBRAS[name]
    n = algebra.dim
    M = full_matrix(n, n) if full else np.linspace(0.4, 1.2, n)
    return co.LiePoissonSystem(algebra, co.Quadratic(M, linear=np.linspace(-0.1, 0.2, n)), sign=sign)


def state(n):
    return 0.3 + 0.4 * np.cos(1.0 + np.arange(n))


def forces_of(kind, n):
    """Return forces of a kind for states of n numbers; two of a class have parameters of their own."""
    rng = np.random.default_rng(n)
    B = rng.uniform(-0.3, 0.3, (n, n))
    waving, u = np.linspace(0.1, 0.3, n), rng.uniform(-0.3, 0.3, n)
    return {
        "damping": (F.LinearDamping(0.3, u), F.LinearDamping(np.eye(n) * 0.2 + B), F.Torque(u), F.Torque(2 * u[::-1])),
        "functions": (
            F.Torque(lambda t: np.cos(t) * waving),
            F.Torque(lambda x, t: 0.3 * x * x[0] - t * 0.01 * waving),
            F.OwnForce(lambda x, t, tau: x * np.exp(-0.2 * tau), name="drag"),
        ),
        "orbit": (F.DoubleBracketDamping(0.2, np.linspace(0.5, 1.0, n)), F.LinearDamping(waving)),
        "noise": (F.HeatBath(0.3, B @ B.T + np.eye(n) if n == 3 else 0.8, 0.2, seed=5), F.DoubleBracketDamping(0.1)),
    }[kind]


def functional(sol, weights):
    total = np.sum(np.real(np.conj(weights["x"]) * sol.x)) + np.sum(weights["energy"] * sol.energy)
    return total if sol.attitude is None else total + np.sum(weights["attitude"] * sol.attitude)


def assert_derivatives_are_those_of_runs(system, method, x0, dx0, span, attitude=False, h=H, error=DIFFERENCE_ERROR):
    """Compare gradients, tangents and differences; parameters of added parts only for gradients and tangents."""
    rng, (ends, points) = np.random.default_rng(7), span
    ready = co.prepare(system, method, h, attitude=attitude)
    directions = {"x0": dx0}
    directions |= {name: rng.standard_normal(value.shape) for name, value in ready.parameters.items()}
    # Matrices of dampings along orbits stay symmetric.
    directions |= {k: v + v.T for k, v in directions.items() if k.endswith("metric") and v.ndim == 2}
    sol, pullback = ready.vjp(x0, ends, **points)
    expected = ready.run(x0, ends, **points)
    assert np.array_equal(sol.x, expected.x) and np.array_equal(sol.energy, expected.energy)
    weights = {"x": rng.standard_normal(sol.x.shape), "energy": rng.standard_normal(sol.energy.shape)}
    if sol.attitude is not None:
        assert np.array_equal(sol.attitude, expected.attitude)
        weights["attitude"] = rng.standard_normal(sol.attitude.shape)
    if np.iscomplexobj(sol.x) or hasattr(unforced(system), "from_vector"):
        weights["x"] = np.array([unforced(system).algebra.projected(one) for one in weights["x"]])
    gradient = pullback(**weights)
    assert set(gradient) - {"attitude0"} == set(directions)

    def compared(names):
        products = [np.real(np.conj(gradient[name]) * directions[name]) for name in names]
        return float(sum(np.sum(one) for one in products)), sum(np.sum(np.abs(one)) for one in products)

    backward, size = compared(directions)
    forward = functional(ready.jvp(x0, ends, directions, **points)[1], weights)
    assert abs(backward - forward) <= ADJOINT_ERROR * size
    same_map = [name for name in directions if gradient.rule.get(name) != "added part"]
    backward, size = compared(same_map)

    def moved(by):
        values = {name: ready.parameters[name] + by * directions[name] for name in same_map if name != "x0"}
        # Members keep the numbers of their noise.
        other = co.prepare(with_parameters(system, values), ready.method, h, attitude=attitude)
        return functional(other.run(x0 + by * dx0, ends, **points), weights)

    differences = sum(w * (moved(k * DISTANCE) - moved(-k * DISTANCE)) / DISTANCE for k, w in enumerate(WEIGHTS, 1))
    assert abs(backward - differences) <= error * size
    return gradient


SCHEMES = {
    "Splitting 4": (co.Splitting(order=4), "coadjoint"),
    "processed": (co.Splitting(scheme="blanes_casas_murua6"), "coadjoint"),
    "coordinates": (co.Splitting(parts="coordinates"), False),
    "Gauss": (co.GaussLegendre(2), "coadjoint"),
    "Kahan": (co.Kahan(), False),
    "Taylor": (co.Taylor(order=5), "coadjoint"),
    "commutator-free": (co.CommutatorFree(), "coadjoint"),
}
COMPILED = ("Splitting 4", "processed", "coordinates", "Gauss")
CASES = [
    (kind, scheme, name, span)
    for kind in ("damping", "functions", "orbit", "noise")
    for scheme in SCHEMES
    for name in ALGEBRAS
    for span in SPANS
    if kind != "noise" or span == "forward"
]


@pytest.mark.thinned(16)
@pytest.mark.parametrize(("kind", "scheme", "name", "span"), CASES)
def test_derivatives_of_runs_with_forces(kind, scheme, name, span):
    method, attitude = SCHEMES[scheme]
    # A step in Python for every entry of a full matrix would take long.
    base = plain(name, full=scheme in COMPILED)
    n = base.dim
    dx0 = np.random.default_rng(n).standard_normal(n)
    system = base.with_forces(*forces_of(kind, n))
    gradient = assert_derivatives_are_those_of_runs(system, method, state(n), dx0, SPANS[span], attitude)
    assert {"M", "linear"} <= set(gradient)


def test_torques_of_time_are_differentiated_at_their_times():
    """The second half flows of a step begin at its middle."""
    system = plain("sl(2)").with_forces(F.Torque(lambda x, t: -t * x), F.LinearDamping(0.2, 0.5))
    dx0 = np.array([0.3, -1.0, 0.5])
    for span in SPANS.values():
        assert_derivatives_are_those_of_runs(system, co.Splitting(), state(3), dx0, span)


def test_a_shifted_energy_turns_the_attitude_of_each_step():
    """A Casimir is subtracted from the energy of this body; its factor of the attitude begins anew in each step."""
    body = co.systems.rigid_body(inertia=(1.0, 2.0, 2.5))
    assert co.Splitting(order=4).program(body, group=body.representation).shift
    system = body.with_forces(F.LinearDamping(0.3, (0.1, 0.2, 0.3)), F.Torque((0.1, 0.2, 0.3)))
    for members in ((), (2,)):
        x0 = state(3) * np.ones((*members, 3))
        x0[..., 0] += 0.1 * np.arange(x0[..., 0].size).reshape(members)
        dx0 = np.random.default_rng(3).standard_normal(x0.shape)
        for span in ("forward", "backward"):
            assert_derivatives_are_those_of_runs(system, co.Splitting(order=4), x0, dx0, SPANS[span], True)


FLUIDS = {
    "sphere": (
        lambda: co.systems.sphere_euler(N=4, rotation=0.7),
        (F.Viscosity(0.05, rotation=True), F.Friction(0.1), F.RandomForcing(0.3, band=(2, 3), seed=1)),
    ),
    "torus": (lambda: co.systems.torus_euler(N=5), (F.BetaPlane(0.5), F.Friction(lambda n: 0.1 * n))),
    "body": (
        lambda: co.systems.matrix_body((1.0, 2.0, 3.0)),
        (F.LinearDamping(0.1), F.Torque(lambda W: -0.1 * W @ W @ W), F.OwnForce(lambda W, t, tau: W * np.exp(-tau))),
    ),
}


@pytest.mark.thinned(2)
@pytest.mark.parametrize("method", [co.IsospectralGauss(), co.CommutatorFree()], ids=str)
@pytest.mark.parametrize("name", FLUIDS)
def test_derivatives_of_matrices_with_forces(name, method):
    build, forces = FLUIDS[name]
    system, rng = build(), np.random.default_rng(2)
    x0, dx0 = (system.algebra.projected(system.from_vector(rng.standard_normal(system.dim))) for _ in range(2))
    # Functions of matrices take no complex steps.
    error = FUNCTION_ERROR if name == "body" else DIFFERENCE_ERROR
    gradient = assert_derivatives_are_those_of_runs(
        system.with_forces(*forces), method, 0.3 * x0, dx0, SPANS["forward"], error=error
    )
    outside = gradient["x0"] - system.algebra.projected(gradient["x0"])
    assert np.abs(outside).max() <= ADJOINT_ERROR * np.abs(gradient["x0"]).max()


def examples():
    """A force of every class, and a system on which it acts."""
    vector, torus = plain("so(4)"), co.systems.torus_euler(N=5)
    found = [(force, vector) for kind in ("damping", "functions", "orbit", "noise") for force in forces_of(kind, 6)]
    found += [(force, co.systems.sphere_euler(N=4, rotation=0.7)) for force in FLUIDS["sphere"][1]]
    found += [(force, DRIVEN) for force in forces_of("orbit", 3) + forces_of("noise", 3)]
    return found + [(F.BetaPlane(0.5), torus), (F.RandomForcing(0.3, band=(1, 2), seed=1), torus)]


def test_the_examples_contain_every_force():
    """A new class of forces fails here until it is differentiated too."""
    assert {type(force) for force, _ in examples()} == set(FORCES)


@pytest.mark.thinned(1)
@pytest.mark.parametrize(("force", "system"), examples(), ids=lambda one: getattr(one, "label", ""))
def test_tangents_of_flows_are_differences(force, system):
    """Along vectors of the algebra, if the state is a matrix."""
    rng, n = np.random.default_rng(5), system.dim
    x, v = rng.standard_normal((2, n)) * 0.4
    if hasattr(system, "from_vector"):
        x, v = (system.to_vector(system.algebra.projected(system.from_vector(one))) for one in (x, v))
    derivative = force.tangent(system, x, 0.75, 0.5)
    if derivative is None:
        assert isinstance(force, F.OwnForce) or callable(force.torque)
        return
    found = derivative @ v if np.ndim(derivative) == 2 else derivative * v

    def flow(by):
        return force.flow(system, x + by * v, 0.75, 0.5)

    distance = 2.0**-8
    expected = sum(w * (flow(k * distance) - flow(-k * distance)) / distance for k, w in enumerate(WEIGHTS, 1))
    np.testing.assert_allclose(found, expected, rtol=0, atol=2.0**7 * UNIT_ROUNDOFF / distance)


def test_members_of_an_ensemble_have_the_noise_of_their_numbers():
    """Each has the bits of a single run with its stream."""
    base, rng = plain("A3,7", full=False), np.random.default_rng(1)
    x0, directions = rng.uniform(0.2, 0.6, (3, 3)), rng.standard_normal((3, 3, 2))
    moving = {"HeatBath.temperature": np.array([0.5, 1.0]), "HeatBath.alpha": np.array([1.0, -0.3])}

    def run_from(stream):
        bath = F.HeatBath(0.3, temperature=0.2, seed=5, stream=stream)
        return co.prepare(base.with_forces(bath), co.Splitting(), H, attitude="coadjoint")

    sol, tangents = run_from(0).jvp(x0, (0.5, 0.75), {"x0": directions, **moving}, save_every=4)
    _, pullback = run_from(0).vjp(x0, (0.5, 0.75), save_every=4)
    weights = rng.standard_normal(sol.x.shape)
    of_attitude = rng.standard_normal(sol.attitude.shape)
    gradient, total = pullback(weights, attitude=of_attitude), 0.0
    for m in range(3):
        single, one = run_from(m).jvp(x0[m], (0.5, 0.75), {"x0": directions[m], **moving}, save_every=4)
        assert np.array_equal(single.x, sol.x[:, m])
        assert np.array_equal(one.x, tangents.x[:, m]) and np.array_equal(one.attitude, tangents.attitude[:, m])
        alone = run_from(m).vjp(x0[m], (0.5, 0.75), save_every=4)[1](weights[:, m], attitude=of_attitude[:, m])
        size = np.abs(alone["x0"]).max()
        np.testing.assert_allclose(gradient["x0"][m], alone["x0"], rtol=0, atol=2.0**5 * UNIT_ROUNDOFF * size)
        total = total + alone["HeatBath.temperature"]
    assert abs(total - gradient["HeatBath.temperature"]) <= 2.0**4 * UNIT_ROUNDOFF * abs(total) * 3


def test_members_beyond_those_of_one_loop_have_the_noise_of_their_numbers():
    """Derivatives are computed for as many members at a time as the loops have lanes."""
    base, last = plain("A5,40", full=False), limit("MOST_LANES") + 1
    x0 = np.random.default_rng(2).uniform(0.2, 0.6, (last + 1, 5))

    def run_from(stream):
        bath = F.HeatBath(0.3, temperature=0.2, seed=5, stream=stream)
        return co.prepare(base.with_forces(bath), co.Splitting(), H)

    moving, span = {"HeatBath.temperature": np.array(0.5)}, (0.5, 0.5 + 2 * H)
    sol, tangents = run_from(0).jvp(x0, span, moving)
    single, alone = run_from(last).jvp(x0[last], span, moving)
    assert np.array_equal(single.x, sol.x[:, last]) and np.array_equal(alone.x, tangents.x[:, last])
    weights = np.zeros_like(sol.x)
    weights[:, last] = 1.0
    found = run_from(0).vjp(x0, span)[1](weights)["HeatBath.temperature"]
    wanted = run_from(last).vjp(x0[last], span)[1](weights[:, last])["HeatBath.temperature"]
    assert abs(found - wanted) <= 2.0**5 * UNIT_ROUNDOFF * abs(wanted)


def test_members_of_a_batch_have_the_derivatives_of_single_runs():
    base, x0 = plain("sl(2)", full=False), state(3)
    systems = [base.with_forces(F.LinearDamping(rate), F.HeatBath(0.3, temperature=0.2, seed=5)) for rate in (0.1, 0.3)]
    ready = co.prepare(co.batch(systems), co.GaussLegendre(2), H)
    assert ready.parameters["LinearDamping.rate"].tolist() == [0.1, 0.3]
    sol, pullback = ready.vjp(x0, (0.5, 0.75), save_every=4)
    gradient = pullback(sol.x)
    for m, system in enumerate(systems):
        member = base.with_forces(system.forces[0], F.HeatBath(0.3, temperature=0.2, seed=5, stream=m))
        single, alone = co.prepare(member, co.GaussLegendre(2), H).vjp(x0, (0.5, 0.75), save_every=4)
        assert np.array_equal(sol.x[:, m], single.x)
        found = alone(single.x)
        assert all(np.array_equal(gradient[name][m], value) for name, value in found.items())


@pytest.mark.parametrize(
    "inputs", [{"jets": "Torque 2", "field": (2, 0)}, {"jets": "Torque"}, {"field": (0,)}], ids=str
)
@pytest.mark.parametrize("method", [co.Splitting(order=4), co.GaussLegendre(2), co.Kahan()], ids=str)
def test_derivatives_by_torques_and_fields(method, inputs):
    """A field changes the damping on the orbit too; a parameter changes at fixed inputs."""
    n, rng = 6, np.random.default_rng(8)
    torques = F.Torque(np.linspace(0.1, 0.2, n)), F.DoubleBracketDamping(0.2), F.Torque(np.linspace(-0.2, 0.1, n))
    system = plain("so(4)").with_forces(*torques)
    ready, step = co.prepare(system, method, H, inputs=inputs), co.stepper(system, method, -H, inputs=inputs)
    sizes = {name: n if isinstance(target, str) else len(target) for name, target in inputs.items()}
    u, du = ({name: rng.uniform(-0.3, 0.3, size) for name, size in sizes.items()} for _ in range(2))
    x0, dx0 = state(n), rng.standard_normal(n)
    sol, tangents = ready.jvp(x0, (0.5, 0.75), {"x0": dx0, "inputs": du}, **u)
    _, pullback = ready.vjp(x0, (0.5, 0.75), **u)
    weights = rng.standard_normal(sol.x.shape)
    gradient = pullback(weights, energy=sol.energy)
    backward = gradient["x0"] @ dx0 + sum(gradient["inputs"][name] @ du[name] for name in u)
    size = np.abs(gradient["x0"] * dx0).sum() + sum(np.abs(gradient["inputs"][k] * du[k]).sum() for k in u)
    forward = np.sum(weights * tangents.x) + sol.energy @ tangents.energy
    assert abs(backward - forward) <= ADJOINT_ERROR * size

    def moved(by):
        at = ready.run(x0 + by * dx0, (0.5, 0.75), **{name: u[name] + by * du[name] for name in u})
        return np.sum(weights * at.x) + sol.energy @ at.energy

    differences = sum(w * (moved(k * DISTANCE) - moved(-k * DISTANCE)) / DISTANCE for k, w in enumerate(WEIGHTS, 1))
    assert abs(backward - differences) <= DIFFERENCE_ERROR * size
    by_inputs = step.tangent_by_inputs(x0, 0.5, **u) @ np.concatenate([du[name] for name in u])
    after = [
        w * (step(x0, 0.5, **{name: u[name] + s * k * DISTANCE * du[name] for name in u})) * s / DISTANCE
        for k, w in enumerate(WEIGHTS, 1)
        for s in (1, -1)
    ]
    np.testing.assert_allclose(by_inputs, sum(after), rtol=0, atol=DIFFERENCE_ERROR)


def test_members_with_torques_of_their_own():
    system = plain("so(4)").with_forces(F.LinearDamping(0.1), F.Torque(np.zeros(6)))
    ready, rng = co.prepare(system, co.Splitting(), H, inputs={"jets": "Torque"}), np.random.default_rng(9)
    u, weights = rng.uniform(-0.3, 0.3, (2, 6)), rng.standard_normal((5, 2, 6))
    gradient = ready.vjp(state(6), (0.5, 0.75), jets=u)[1](weights)
    for m in range(2):
        alone = ready.vjp(state(6), (0.5, 0.75), jets=u[m])[1](weights[:, m])
        assert np.array_equal(gradient["inputs"]["jets"][m], alone["inputs"]["jets"])
        assert np.array_equal(gradient["x0"][m], alone["x0"])


def test_crossings_of_events_with_forces():
    """The time of a crossing by the rate of a damping is the difference of the times."""
    body, x0, options = co.systems.rigid_body(inertia=(1.0, 2.0, 2.5)), (1.0, 0.2, 0.5), {"attitude": True}
    event = co.Event("x2", terminal=True)

    def at(rate):
        return co.prepare(body.with_forces(F.LinearDamping(rate)), co.Splitting(order=4), 0.05, **options)

    _, tangents = at(0.1).jvp(x0, (0.5, 20.5), {"LinearDamping.rate": 1.0}, events=event)
    _, pullback = at(0.1).vjp(x0, (0.5, 20.5), events=event)
    times = [at(0.1 + by).run(x0, (0.5, 20.5), events=event).events.t[0] for by in (2.0**-12, -(2.0**-12))]
    assert abs(tangents.events["t"][0] - (times[0] - times[1]) * 2.0**11) <= 1e-4 * abs(tangents.events["t"][0])
    found = pullback(events={"t": [1.0]})["LinearDamping.rate"]
    assert abs(found - tangents.events["t"][0]) <= ADJOINT_ERROR * abs(found)


def test_entries_of_a_symmetric_matrix_of_rates_change_alone():
    """Rates need not be symmetric, unlike the metric of a damping along orbits."""
    rate = np.array([[0.3, 0.1, 0.05], [0.1, 0.2, -0.04], [0.05, -0.04, 0.25]])
    x0, span = (1.0, 0.2, 0.5), (0.5, 1.0)

    def at(rate):
        return co.prepare(plain("so(3)").with_forces(F.LinearDamping(rate)), co.Splitting(order=4), H)

    _, tangents = at(rate).jvp(x0, span, {"LinearDamping.rate": np.eye(9).reshape(3, 3, 9)})
    for k, unit in enumerate(DISTANCE * np.eye(9).reshape(9, 3, 3)):
        moved = [at(rate + by * unit).run(x0, span).x for by in (1, -1, 2, -2, 3, -3, 4, -4)]
        differences = sum(w * (moved[2 * j] - moved[2 * j + 1]) / DISTANCE for j, w in enumerate(WEIGHTS))
        np.testing.assert_allclose(tangents.x[..., k], differences, rtol=0, atol=DIFFERENCE_ERROR)


def test_parameters_of_forces_have_the_names_of_their_labels():
    """Whole numbers, bands and values at a limit of their domain are no parameters."""
    body = co.systems.rigid_body(inertia=(1.0, 2.0, 2.5))
    system = body.with_forces(F.LinearDamping(0.1), F.LinearDamping((0.1, 0.2, 0.3)), F.HeatBath(0.1, seed=1))
    assert {name: value.shape for name, value in co.prepare(system, None, H).parameters.items()} == {
        "inertia": (3,),
        "LinearDamping.rate": (),
        "LinearDamping.toward": (),
        "LinearDamping 2.rate": (3,),
        "LinearDamping 2.toward": (),
        "HeatBath.alpha": (),
        "HeatBath.metric": (),
    }
    sphere = co.systems.sphere_euler(N=3).with_forces(
        F.Viscosity(0.1, power=2), F.RandomForcing(0.5, band=(1, 2), seed=1)
    )
    found = co.prepare(sphere, co.IsospectralGauss(), H).parameters
    assert set(found) == {"rotation", "Viscosity.nu", "RandomForcing.energy_rate"}


@pytest.mark.thinned(1)
@pytest.mark.parametrize(
    ("method", "full", "rule"),
    [
        (co.Splitting(order=4), False, "exact"),
        (co.Splitting(order=4), True, "added part"),
        (co.Taylor(order=4), False, "differences"),
    ],
)
def test_rules_of_parameters_that_flows_of_forces_depend_on_are_differences(method, full, rule):
    """Others have the rule of the scheme without forces."""
    for damping, moves in ((F.LinearDamping(0.1), False), (F.DoubleBracketDamping(0.1), True)):
        ready = co.prepare(plain("so(3)", full).with_forces(damping), method, H)
        sol, pullback = ready.vjp(state(3), (0.0, 2 * H))
        found = pullback(np.ones(sol.x.shape)).rule
        own = {name: found[name] for name in ready.parameters if "." in name}
        assert own and set(own.values()) == {"differences"}
        assert found["M"] == ("differences" if moves and rule == "exact" else rule)
        directions = {name: np.ones(value.shape) for name, value in ready.parameters.items()}
        assert ready.jvp(state(3), (0.0, 2 * H), directions)[1].rule == found


class Spring(Force):
    """A force of the user without formula, parameters and complex numbers."""

    def check(self, system):
        pass

    def field(self, system, x, t):
        return -np.array([float(one) for one in x]) * 0.3

    def flow(self, system, x, t, tau):
        return np.array([float(one) for one in x]) * np.exp(-0.3 * tau)

    def describe_to(self, reader, system):
        return reader.damping(np.asarray(0.3), np.zeros(system.dim))


def test_a_force_of_the_user_without_formulas_is_differentiated_by_differences():
    base, dx0 = plain("so(3)"), np.array([0.3, -1.0, 0.5])
    assert_derivatives_are_those_of_runs(
        base.with_forces(Spring()), co.Splitting(order=4), state(3), dx0, SPANS["backward"], error=FUNCTION_ERROR
    )


@pytest.mark.parametrize("method", [co.Taylor(order=8, tolerance=1e-9), co.ReversibleSteps(co.Splitting(), 0.1)])
def test_own_steps_with_forces_are_refused_by_name(method):
    body = co.systems.rigid_body(inertia=(1.0, 2.0, 2.5)).with_forces(F.LinearDamping(0.1))
    with pytest.raises(TypeError, match=rf"{type(method).__name__}.* chooses its own steps, and with forces"):
        co.prepare(body, method, 0.5).vjp((1.0, 0.2, 0.5), (0.0, 1.0))


def test_steps_with_forces_are_not_undone():
    ready = co.prepare(plain("so(3)").with_forces(F.LinearDamping(0.1)), co.Splitting(), H)
    with pytest.raises(TypeError, match="no steps that can be undone"):
        ready.vjp(state(3), (0.0, 1.0), reverse="reversible")


@pytest.mark.thinned(1)
@pytest.mark.parametrize("algebra", [co.algebras.so(4), co.algebras.e(3), co.algebras.sl(2)], ids=str)
@pytest.mark.parametrize("metric", [0.8, "diagonal"])
def test_transposed_flows_of_heat_baths_are_those_of_their_matrices(algebra, metric):
    """Cotangents by sparse products, against the dense derivative and differences by the parameters."""
    n, rng = algebra.dim, np.random.default_rng(8)
    M = rng.standard_normal((n, n))
    plain = co.LiePoissonSystem(algebra, co.Quadratic(M + M.T, linear=rng.standard_normal(n)), sign=-1)
    diagonal = rng.uniform(0.5, 1.5, n) if metric == "diagonal" else metric
    x, row, t, tau = rng.standard_normal(n), rng.standard_normal(n), 0.25, 0.125
    for force in (co.forces.DoubleBracketDamping(0.1, diagonal), co.forces.HeatBath(0.1, diagonal, 0.2, seed=4)):
        flow = force.orbit_flow(plain, x, t, tau)
        np.testing.assert_allclose(flow.end, force.flow(plain, x, t, tau), rtol=1e-13, atol=1e-13)
        names = ["alpha", "metric", *(["temperature"] if force.random else [])]
        energy = parameters_of(plain)["M"].energy()
        before, found = flow.pull(row, {name: name for name in names} | {"M": energy})
        matrix = force.tangent(plain, x, t, tau)
        np.testing.assert_allclose(before, row @ matrix, rtol=1e-11, atol=1e-12)

        def value(plain=plain, force=force, **changes):
            return dataclasses.replace(force, **changes).flow(plain, x, t, tau) @ row

        h = 1e-6
        for name in names:
            center = np.asarray(getattr(force, name), dtype=float)
            steps = h * np.eye(center.size).reshape(center.size, *center.shape)
            differences = [
                (value(**{name: (center + step)[()]}) - value(**{name: (center - step)[()]})) / (2 * h)
                for step in steps
            ]
            np.testing.assert_allclose(found[name], differences, rtol=1e-6, atol=1e-8)
        other = [
            co.LiePoissonSystem(algebra, co.Quadratic(M + M.T + side * h * np.diag(np.arange(1.0, n + 1)),
                                linear=plain.hamiltonian.gradient(np.zeros(n))), sign=-1)
            for side in (1, -1)
        ]  # fmt: skip
        difference = (value(other[0]) - value(other[1])) / (2 * h)
        assert found["M"].reshape(n, n).diagonal() @ np.arange(1.0, n + 1) == pytest.approx(difference, rel=1e-6)


def test_gradients_of_heat_baths_need_no_matrices(monkeypatch):
    """Neither the dense derivative of a flow nor a flow of a moved system is computed for a lattice with a bath."""
    lattice = co.systems.spin_lattice("square", (4, 4), field=(0.0, 0.0, 0.3))
    bath = lattice.with_forces(co.forces.HeatBath(0.1, temperature=0.2, seed=1))
    x0 = np.random.default_rng(3).standard_normal((16, 3))
    x0 = (x0 / np.linalg.norm(x0, axis=1)[:, None]).ravel()
    for name in ("flow", "tangent"):
        monkeypatch.setattr(co.forces.HeatBath, name, lambda *_: pytest.fail("a dense flow"))
    sol, pull = co.prepare(bath, co.Splitting(), step=0.125).vjp(x0, (0, 1), 8)
    gradient = pull(np.ones_like(sol.x))
    assert np.isfinite(gradient["HeatBath.temperature"]) and np.isfinite(gradient["field"]).all()

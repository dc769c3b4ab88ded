"""Every registered force, and those of a user: field, flow, description, compiled flow and work agree."""

import dataclasses
from functools import partial

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import coadjoint as co
from drawn_matrices import full
from long import long_where
from matrix.forces import force_on
from refusals import refused
from satellite_forces import CASES, PYRAMID, SPIN, TENSOR, TURNED, WHEELS

F, S = co.forces, co.systems
T = 1.0  # a sample of all laws


def satellite():
    """Return a body with everything that forces act on, and a state."""
    body = S.body(TENSOR, wheels=WHEELS, gyros=PYRAMID)
    rotors = {"wheel_speeds": (1.0, -2.0, 0.5, 3.0), "gimbal_angles": (0.2, -0.3, 0.4, 0.1)}
    return body, body.state(TURNED, SPIN, **rotors)


def on(system):
    """Return a system and a drawn state, whose components are distinct and of both signs."""
    rng = np.random.default_rng(3)
    if system.has_matrices:
        shape = rng.normal(size=system.shape) + (1j * rng.normal(size=system.shape) if system.complex else 0.0)
        return system, system.to_vector(system.algebra.projected(0.5 * shape))
    x = rng.uniform(0.3, 0.9, system.dim) * rng.choice([-1.0, 1.0], system.dim)
    return system, x


def solvable():
    """Return a system with a full energy on an algebra whose Casimir is a logarithm."""
    H = co.Quadratic(full(3, 2), linear=(-0.3, 0.1, 0.4))
    return co.LiePoissonSystem(co.algebras.A3_7(0.7), H)


SYSTEMS = {
    "satellite": satellite,
    "in orbit": lambda: (one := S.satellite_on_orbit(TENSOR, 1.2, 0.3), one.state(TURNED, SPIN)),
    "rigid body": lambda: on(S.rigid_body(TENSOR)),
    "top": lambda: on(S.heavy_top(TENSOR, (0.3, -0.4, 0.8))),
    "A3,7": lambda: on(solvable()),
    "spins": lambda: on(S.spin_lattice("chain", 3, tensor=TENSOR / 3, field=(0.3, -0.2, 0.5))),
    "torus": lambda: on(S.torus_euler(N=3)),
    "sphere": lambda: on(S.sphere_euler(N=3, rotation=0.7)),
    "two fields": lambda: on(S.reduced_mhd(3)),
    "matrix body": lambda: on(S.matrix_body((1.0, 2.0, 3.0))),
}


def strong(x, t):
    """Return a torque of which errors of order ten are seen."""
    return 0.9 * np.sin(3.0 * t + 2.0 * x[::-1])


def of_time(t):
    return np.array([0.3 * np.sin(4.0 * t), 0.1, -0.2 * np.cos(3.0 * t)])


def beyond_the_examples(system):
    """Return forces with other parameters: oblique matrices, functions, layers, and those of `satellite_forces`."""
    n = system.dim
    return [
        *(case.force for case in CASES.values()),
        *(F.LinearDamping(rate, 0.3 * np.cos(np.arange(n))) for rate in (0.1 * full(n, 5), np.linspace(0.1, 0.3, n))),
        *(F.Torque(torque) for torque in (strong, of_time)),
        F.DoubleBracketDamping(0.1, np.linspace(0.5, 1.5, n)),
        F.DoubleBracketDamping(0.1 / n, full(n, 4) + n * np.eye(n)),
        F.HeatBath(0.1 / n, full(n, 4) + n * np.eye(n), 0.3, seed=5, stream=2),
        F.Friction(lambda scale: 0.1 * scale),
        *(F.Viscosity(0.01, power, True, "carried") for power in (1, 2)),
        F.RandomForcing(0.2, (1, 3), seed=4, stream=1),
        F.TransportNoise((1, 2), 0.4, (2.0, 1.0), seed=4, stream=1),
    ]


def acting_on(name):
    """Yield the forces that act on a system, with it and a state at which what is held is not zero."""
    system, x = SYSTEMS[name]()
    for force in (*(force_on(name, system) for name in F.names()), *beyond_the_examples(system)):
        try:
            forced = system.with_forces(force)
        except (TypeError, ValueError, AttributeError):
            continue
        held = 0.3 * np.cos(1.0 + np.arange(forced.dim - system.dim))
        yield forced, np.concatenate([x, held])


DURATIONS = 1.6 / 2.0 ** (0.5 * np.arange(10))


def check_flow(force, system, x, t, order, way):
    """Check the order of a flow against DOP853 on the field, or, above two, that it is undone by the flow back."""
    by_differences = isinstance(force, F.Sampled | F.OwnForce)
    durations = DURATIONS / 16 if force.sampled else DURATIONS  # before a pulse ends
    ends, y, done = [], x, 0.0
    for tau in durations[::-1]:
        span, field = (t + way * done, t + way * tau), partial(rate, force, system)
        y, done = solve_ivp(field, span, y, "DOP853", rtol=1e-13, atol=1e-15).y[:, -1], tau
        ends.insert(0, y)
    flows = [force.flow_of_order(system, x, t, way * tau, order) for tau in durations]
    errors, moved = (np.abs(np.subtract(flows, other)).max(axis=1) for other in (ends, [x]))
    floors = (2.0**-28 if by_differences else 2.0**-36) * moved + 1e-12 * np.abs(x).max()
    try:
        fitted = co.analysis.fit_order(durations, errors, floors)
    except ValueError:
        assert errors[-1] <= floors[-1], errors
        return
    # Slopes of order ten are those of three or four points above rounding, up to one below where a singularity is near,
    # as that of dry friction. Orders of the extrapolation are even: a column less has a slope of eight.
    if order > 2 and fitted.order < order - 1.0:
        back = [
            force.flow_of_order(system, y, t + way * tau, -way * tau, order)
            for y, tau in zip(flows, durations, strict=True)
        ]
        assert np.all(np.abs(np.subtract(back, x)).max(axis=1) <= floors), fitted
        order = 2
    assert order > 2 or fitted.order > 2.5, fitted


def rate(force, system, t, x):
    return force.field(system, x, t)


@pytest.mark.thinned(4)
@pytest.mark.parametrize("name", SYSTEMS)
def test_a_flow_is_that_of_its_field(name):
    """At orders two and ten, from a time other than zero, forward, and backward if the force acts backward."""
    for forced, x in acting_on(name):
        (force,), plain = forced.forces, forced.unforced
        for way in () if force.random else (1.0, -1.0) if force.reversible else (1.0,):
            for order in (2, 10) if force.reversible else (2,):
                check_flow(force, plain, x, T, order, way)


class Description:
    """Reader of the description of a force, which returns the form and its arguments."""

    def __getattr__(self, form):
        return lambda *arguments: (form, *arguments)


def described(force, system):
    """Return the function for the compiled loops, of (x, t) or (x, t, tau) on vectors, and which; None without one."""
    form, *arguments = force.describe_to(Description(), system)
    if form not in ("flow", "function"):
        return None

    def on_vectors(x, *times):
        given = {"x": system.from_vector(x) if system.has_matrices else x.copy(), "t": times[0], "tau": times[-1]}
        names = arguments[1] if form == "function" else "x, t, tau"
        value = arguments[0](*(given[one] for one in names.split(", ")))
        return system.to_vector(value) if system.has_matrices else value

    return form, on_vectors


@pytest.mark.thinned(1)
@pytest.mark.parametrize("name", SYSTEMS)
def test_compiled_loops_get_the_functions_of_the_flow(name):
    for forced, x in acting_on(name):
        (force,), plain = forced.forces, forced.unforced
        if found := described(force, plain):
            form, function = found
            for t, tau in ((T, 0.25), (-T, 0.125)):
                exact = force.flow(plain, x, t, tau) if form == "flow" else force.field(plain, x, t)
                # A flow has some hundred operations.
                np.testing.assert_allclose(function(x, t, tau), exact, rtol=0, atol=1e-13 * (1 + np.abs(x).max()))


def rows_of_forces(certificate):
    """Return the rows on forces."""
    return [row for row in certificate.rows if row.key.partition(" of ")[0] in ("flow", "compiled flow", "work")]


@pytest.mark.thinned(2)
@pytest.mark.parametrize("name", long_where(("in orbit", "two fields"), SYSTEMS))
def test_certificates_of_registered_forces(name):
    """Of those that the kernels have themselves, all on one system, with noise only forward."""
    system, x = SYSTEMS[name]()
    method = co.IsospectralGauss(1) if system.has_matrices else co.Splitting()
    forces = [one.forces[0] for one, _ in acting_on(name) if described(one.forces[0], one.unforced) is None]
    forces = [dataclasses.replace(force, seed=k) if force.random else force for k, force in enumerate(forces)]
    for h, acting in ((0.1, forces), (-0.1, [force for force in forces if force.reversible])):
        start = system.from_vector(x) if system.has_matrices else x
        rows = rows_of_forces(co.certify(system.with_forces(*acting), method, start, h, steps=2))
        assert len(rows) == 3 * len(acting)
        wrong = [str(row) for row in rows if row.verdict not in ("holds", "not applicable")]
        assert not wrong and sum(row.verdict != "holds" for row in rows) == sum(force.random for force in acting)


def drag(x, t, tau, k=0.4):
    """Return the flow of x' = -k |x| x."""
    return x / (1.0 + k * np.sqrt(np.sum(x * x)) * tau)


def slower_drag(x, t, tau):
    return drag(x, t, 0.5 * tau)


@dataclasses.dataclass(frozen=True)
class QuadraticDrag(F.Force):
    """The force of docs/extending.md, and its contradictions."""

    sign: float = -1.0
    speed: float = 1.0
    compiled: object = drag
    casimirs: bool = False

    def check(self, system):
        pass

    def field(self, system, x, t):
        return self.sign * 0.4 * np.sqrt(np.sum(x * x)) * x

    def flow(self, system, x, t, tau):
        return drag(x, t, self.speed * tau)

    def describe_to(self, reader, system):
        return reader.flow(self.compiled)


CONTRADICTIONS = {
    "none": (QuadraticDrag(), []),
    "field of the other sign": (QuadraticDrag(sign=1.0), ["flow"]),
    "flow of half the speed": (QuadraticDrag(speed=0.5), ["flow", "compiled flow", "work"]),
    "compiled flow of half the speed": (QuadraticDrag(compiled=slower_drag), ["compiled flow", "work"]),
    "Casimirs that change": (QuadraticDrag(casimirs=True), ["work"]),
}


@pytest.mark.thinned(1)
@pytest.mark.parametrize("which", CONTRADICTIONS)
def test_certificates_of_forces_of_a_user(which):
    force, wrong = CONTRADICTIONS[which]
    found = co.certify(S.rigid_body(TENSOR).with_forces(force), co.Splitting(), (0.5, -0.7, 0.4), 0.125, steps=8)
    assert [row.key for row in found.failures] == [f"{row} of QuadraticDrag" for row in wrong]
    assert found.subject["forces"] == [str(force)] and found.to_mapping()["passed"] == (not wrong)


def test_flows_of_order_two_that_are_not_symmetric_are_found_at_higher_orders():
    """A step of Heun's method as the flow: enough for order two."""

    def heun(x, t, tau):
        first = -0.4 * x * x * x
        middle = x + tau * first
        return x + 0.5 * tau * (first - 0.4 * middle * middle * middle)

    body = S.rigid_body(TENSOR).with_forces(F.OwnForce(heun, "heun"))
    for order, wrong in ((2, []), (4, ["flow of heun"])):
        found = co.certify(body, co.Splitting(order=order), (0.5, -0.7, 0.4), 0.25, steps=8)
        assert [row.key for row in found.failures] == wrong, str(found)


def test_certificates_of_functions_and_of_steps_that_no_force_takes_are_refused():
    body = S.rigid_body(TENSOR).with_forces(F.HeatBath(0.1, temperature=0.1, seed=1))
    x = (0.5, -0.7, 0.4)
    with refused(TypeError, "HeatBath", "function", ".unforced"):
        co.certify(body, lambda x, h: x, x, 0.1)
    for method, h in ((co.Splitting(), -0.1), (co.Splitting(order=4), 0.1)):
        with refused(ValueError, "HeatBath", "backward"):
            co.certify(body, method, x, h)

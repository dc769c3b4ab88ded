"""Systems with forces: closed forms, what forces keep and change, balances."""

import itertools
from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import coadjoint as co
from drawn_matrices import full
from refusals import refused
from rounding import UNIT_ROUNDOFF

AXES = co.systems.rigid_body(inertia=(1.0, 1.0, 2.0))
GAP = 1.0 / 2.0 - 1.0 / 1.0  # x1' = GAP x3 x2, x2' = -GAP x3 x1


def turned(x0, phase, shrunk=1.0):
    """The transverse momentum of a symmetric body after a phase, the integral of GAP x3."""
    z = (x0[0] + 1j * x0[1]) * np.exp(-1j * phase) * shrunk
    return z.real, z.imag


def positive(n, seed):
    B = np.random.default_rng(seed).uniform(-0.5, 0.5, (n, n))
    return B @ B.T + 0.1 * np.eye(n)


def on(algebra, sign, seed=0):
    n = algebra.dim
    return co.LiePoissonSystem(algebra, co.Quadratic(full(n, seed), linear=np.linspace(-0.3, 0.4, n)), sign=sign)


SYSTEMS = {
    "e(3)": on(co.algebras.e(3), -1),
    "so(4)": on(co.algebras.so(4), +1, 1),
    "A3,7": on(co.algebras.A3_7(0.7), +1, 2),
    "su(3)": on(co.algebras.su(3), -1, 3),
}


def state(n):
    return np.linspace(0.7, -0.5, n)


def fitted_order(run, exact, steps=(2**-4, 2**-5, 2**-6)):
    errors = [np.max(np.abs(run(h) - exact)) for h in steps]
    return np.polyfit(np.log2(steps), np.log2(errors), 1)[0]


def test_a_damped_symmetric_body():
    """x3 = x3(0) exp(-r3 t); the phase is the integral of GAP x3. Both signs of time; the axis is exact."""
    rates, x0 = (0.3, 0.3, 0.2), np.array([0.5, -0.2, 0.8])
    body = AXES.with_forces(co.forces.LinearDamping(rates))
    for end in (4.0, -2.0):
        phase = GAP * x0[2] * -np.expm1(-rates[2] * end) / rates[2]
        exact = [*turned(x0, phase, np.exp(-rates[0] * end)), x0[2] * np.exp(-rates[2] * end)]

        def run(h, end=end):
            return co.integrate(body, x0, (0, end), h, co.Splitting()).x[-1]

        assert abs(run(2**-4)[2] - exact[2]) < 256 * UNIT_ROUNDOFF
        assert abs(fitted_order(run, exact) - 2.0) < 0.05


@pytest.mark.parametrize("method", [co.Splitting(), co.GaussLegendre(3)], ids=str)
def test_torques_about_the_axis_of_a_symmetric_body(method):
    """Constant N: the phase grows by N t^2/2. Of time, cos(t): x3 by sin(t), to the quadrature."""
    x0, N, end = np.array([0.5, -0.2, 0.8]), 0.4, 3.0
    body = AXES.with_forces(co.forces.Torque((0.0, 0.0, N)))
    exact = [*turned(x0, GAP * (x0[2] * end + N * end**2 / 2)), x0[2] + N * end]
    # The phase of the splitting is that of the trapezoidal rule of x3, which is linear: exact.
    assert np.max(np.abs(co.integrate(body, x0, (0, end), 0.125, method).x[-1] - exact)) < 1e-10
    swung = AXES.with_forces(co.forces.Torque(lambda t: np.array([0.0, 0.0, np.cos(t)])))
    exact = [*turned(x0, GAP * (x0[2] * end + 1 - np.cos(end))), x0[2] + np.sin(end)]

    def run(h):
        return co.integrate(swung, x0, (0, end), h, method).x[-1]

    assert abs(run(0.125)[2] - exact[2]) < 1e-14
    assert abs(fitted_order(run, exact) - 2.0) < 0.05


def oscillating(y, t):
    return 0.5 * y * y * (1.0 + 0.5 * np.sin(3.0 * t))


def oscillating_slope(y, t):
    return y * (1.0 + 0.5 * np.sin(3.0 * t))


@pytest.mark.thinned(1)
@pytest.mark.parametrize("h", [0.125, -0.125])
@pytest.mark.parametrize("method", [co.Splitting(), co.GaussLegendre(2)], ids=str)
def test_accounts_of_driven_systems(method, h):
    """A force is credited with the change of H at fixed time, that of the start and that of the end of a step."""
    H = co.Separable(dict.fromkeys(range(3), (oscillating, oscillating_slope)))
    system = co.LiePoissonSystem(co.algebras.so(3), H, sign=-1)
    forces = [co.forces.LinearDamping((0.3, 0.1, 0.2)), co.forces.Torque((0.2, -0.1, 0.3))]
    x, t, steps = np.array([0.5, 0.8, -0.3]), 0.75, 8
    sol = co.integrate(system.with_forces(*forces), x, (t, t + steps * h), abs(h), method)
    labels, accounts = list(sol.work), np.zeros(2)
    for k in range(steps):
        now = t + k * h
        for order, start, fixed in (((0, 1), now, now), ((1, 0), now + h / 2, now + h)):
            for f in order:
                after = forces[f].flow(system, x, start, h / 2)
                accounts[f] += H.value(after, fixed) - H.value(x, fixed)
                x = after
            if fixed == now:
                x = method.step(system, x, now, h)
        np.testing.assert_allclose(sol.x[k + 1], x, rtol=0, atol=1e-14)
        np.testing.assert_allclose([sol.work[label]["energy"][k + 1] for label in labels], accounts, rtol=0, atol=1e-14)


@pytest.mark.parametrize(("alpha", "length", "sense"), [(0.1, 1.0, 1), (0.25, 2.0, -1)])
def test_one_spin_in_a_field(alpha, length, sense):
    """S_3 = s tanh(alpha B s t + artanh S_3(0)/s), and S precesses; S_3' = alpha B (s^2 - S_3^2)."""
    B, end = 1.5, 2.0
    x0 = length * np.array([0.6, 0.0, -0.8])
    H = co.Polynomial({(0, 0, 1): -B})
    spin = co.LiePoissonSystem(co.algebras.so(3), H, sign=sense).with_forces(co.forces.DoubleBracketDamping(alpha))
    for goal in (end, -0.5):
        along = length * np.tanh(alpha * B * length * goal + np.arctanh(x0[2] / length))
        # J(x) u = u x x: x' = -sense B e3 x x.
        angle = -sense * B * goal
        across = np.sqrt(length**2 - along**2)
        exact = [across * np.cos(angle), across * np.sin(angle), along]

        def run(h, goal=goal):
            return co.integrate(spin, x0, (0, goal), h, co.Splitting()).x[-1]

        assert abs(fitted_order(run, exact, (2**-4, 2**-5, 2**-6)) - 2.0) < 0.05
        assert np.max(np.abs(run(2**-9) - exact)) < 1e-5
        sol = co.integrate(spin, x0, (0, goal), 2**-6, co.Splitting())
        assert sol.balance(relative=False)["|x|^2"] < 64 * UNIT_ROUNDOFF * length**2
        assert sol.balance(relative=False)["energy"] < 64 * UNIT_ROUNDOFF * B * length
        assert abs(sol.work["DoubleBracketDamping"]["energy"][-1] + B * (sol.x[-1, 2] - x0[2])) < 1e-14


@cache
def breeze(n):
    """A torque of state and time, one for each dimension, so that it is compiled once."""
    wind = np.linspace(0.1, -0.2, n)
    return lambda x, t: wind * np.cos(t) - 0.05 * x * x


def forces_for(system):
    n = system.dim
    wind = np.linspace(0.1, -0.2, n)
    damping = 0.1 * full(n, 5) + 0.05 * np.triu(np.ones((n, n)), 1)
    return (
        co.forces.LinearDamping(damping, 0.2 * wind),
        co.forces.Torque(breeze(n)),
        co.forces.DoubleBracketDamping(0.2, positive(n, 4)),
    )


def test_the_balance_is_the_error_of_the_scheme():
    """Each force has its account; all changes together are the accounts and what the scheme itself adds."""
    system = SYSTEMS["e(3)"]
    forced = system.with_forces(*forces_for(system))
    for method, bound in ((co.GaussLegendre(4), 1e-13), (co.Taylor(12), 1e-13), (co.Splitting(), 1e-2)):
        sol = co.integrate(forced, state(6), (0, 4), 2**-5, method, save_every=8)
        changes = {"energy": sol.energy - sol.energy[0]} | {n: c - c[0] for n, c in sol.casimirs.items()}
        for name, change in changes.items():
            done = sum(of_force[name] for of_force in sol.work.values() if name in of_force)
            left = np.abs(change - done)
            assert np.max(left) <= sol.balance(relative=False)[name] + 1e-14 <= bound + 1e-14
            assert sol.balance(relative=False)[name].tenths.shape == (10,)
            assert abs(sol.change(relative=False)[name] - np.max(np.abs(change))) < 0.02
        # Each account is the integral of the power of its force, by Simpson's rule.
        powers = [forced.power(x, t) for x, t in zip(sol.x, sol.t, strict=True)]
        for label, of_force in sol.work.items():
            rates = np.array([power[label] for power in powers])
            spent = (rates[0] + rates[-1] + 4 * rates[1:-1:2].sum() + 2 * rates[2:-1:2].sum()) * 0.25 / 3
            assert abs(of_force["energy"][-1] - spent) < 2e-3 < 5e-3 < abs(spent)
        assert np.max(np.abs(changes["energy"])) > 0.03
    assert float(sol.balance(relative=False)["energy"]) > 1e-6, "the splitting has an error of the second order"
    halved = co.integrate(forced, state(6), (0, 4), 2**-6, co.Splitting()).balance(relative=False)["energy"]
    assert 1.7 < np.log2(sol.balance(relative=False)["energy"] / halved) < 2.3
    with refused(TypeError, "forces", "balance"):
        sol.drift(relative=False)


def turned_by_three(x, t, tau):
    c, s = np.cos(3 * tau), np.sin(3 * tau)
    return np.array([c * x[0] - s * x[1], s * x[0] + c * x[1], x[2]])


def test_balances_of_multivalued_casimirs():
    """log C of A3,7 jumps by periods as the angle turns; what a force does to it is unwrapped."""
    H = co.Quadratic([0.3, 0.2, 0.1], linear=[0.0, 0.0, 4.0])
    spiral = co.LiePoissonSystem(co.algebras.A3_7(0.7), H).with_forces(co.forces.LinearDamping((0.05, 0.05, 0.3)))
    sol = co.integrate(spiral, (0.6, 0.1, 0.4), (0, 6), 2**-6, co.Splitting())
    (name,) = sol.casimirs
    assert np.max(np.abs(np.diff(sol.casimirs[name]))) < 0.05
    # x1 and x2 shrink alike, so that the angle is left alone: log C loses 2 * 0.05 t.
    assert abs(sol.work["LinearDamping"][name][-1] + 0.1 * 6) < 1e-12
    assert sol.balance(relative=False)[name] < 1e-12
    # A force that turns x1 and x2 by 3 t, over the jump of the angle many times: log C loses 2 * 0.7 * 3 t.
    turning = co.forces.OwnForce(turned_by_three, name="turning")
    sol = co.integrate(spiral.unforced.with_forces(turning), (0.6, 0.1, 0.4), (0, 6), 2**-6, co.Splitting())
    assert abs(abs(sol.work["turning"][name][-1]) - 2 * 0.7 * 3 * 6) < 1e-12
    assert sol.balance(relative=False)[name] < 1e-12


@pytest.mark.parametrize("attitude", [True, "coadjoint"])
def test_the_attitude_goes_with_the_hamiltonian_part(attitude):
    """About its axis a body under a torque turns by the integral of x3/I3; rotations stay orthogonal."""
    body = co.systems.rigid_body(inertia=(1.0, 1.0, 1.5)).with_forces(co.forces.Torque((0.0, 0.0, 0.4)))
    sol = co.integrate(body, (0.0, 0.0, 0.5), (0, 5), 2**-5, co.Splitting(), attitude=attitude)
    angle = (0.5 * 5 + 0.4 * 12.5) / 1.5
    found = sol.attitude[-1]
    assert abs(found[0, 0] - np.cos(angle)) < 1e-13 and abs(abs(found[1, 0]) - abs(np.sin(angle))) < 1e-13
    tumbling = co.systems.rigid_body(inertia=(1, 2, 3)).with_forces(co.forces.LinearDamping(0.1))
    for method in (co.Splitting(), co.GaussLegendre(2), co.Taylor(12)):
        sol = co.integrate(tumbling, (0.6, 0.5, -0.3), (0, 20), 2**-5, method, attitude=attitude, save_every=64)
        errors = np.swapaxes(sol.attitude, 1, 2) @ sol.attitude - np.eye(3)
        assert np.max(np.abs(errors)) < 640 * 4 * UNIT_ROUNDOFF
        # The momentum in space only loses its length.
        space = np.einsum("kij,kj->ki", sol.attitude, sol.x)
        assert np.max(np.abs(space - np.exp(-0.1 * sol.t)[:, None] * space[0])) < 1e-13
        alone = co.integrate(tumbling, (0.6, 0.5, -0.3), (0, 20), 2**-5, method, save_every=64)
        assert np.max(np.abs(alone.x - sol.x)) < 1e-2
    with refused(ValueError, "group element"):
        co.integrate(tumbling, (0.6, 0.5, -0.3), (0, 1), 2**-5, co.RadauEnergy(2), attitude=attitude)


def test_what_is_broken_is_labelled():
    body = co.systems.rigid_body(inertia=(1, 2, 3))
    damped = body.with_forces(
        co.forces.LinearDamping(0.1), co.forces.LinearDamping(0.2), co.forces.DoubleBracketDamping(1)
    )
    assert damped.labels == ("LinearDamping", "LinearDamping 2", "DoubleBracketDamping")
    found = co.methods.Forced(co.Splitting()).properties(damped)
    assert (found.poisson, found.energy, found.casimirs) == (False, False, "none")
    assert found.broken_by == (
        "Poisson map: LinearDamping, LinearDamping 2, DoubleBracketDamping",
        "Casimirs: LinearDamping, LinearDamping 2",
    )
    assert [co.methods.Forced(co.Splitting(order=p)).order for p in (1, 2, 4, 10)] == [1, 2, 4, 10]
    spin = co.methods.Forced(co.GaussLegendre(2)).properties(body.with_forces(co.forces.DoubleBracketDamping(1)))
    assert spin.casimirs == "quadratic" and spin.broken_by == ("energy: DoubleBracketDamping",)


def test_forces_that_keep_the_energy_do_not_break_it():
    body, base = co.systems.rigid_body(inertia=(1, 2, 3)), co.GaussLegendre(2)
    kept = body.with_forces(co.forces.SelectiveDecay(0.1))
    found = co.methods.Forced(base).properties(kept)
    assert found.energy and found.broken_by == ("Poisson map: SelectiveDecay", "Casimirs: SelectiveDecay")[1:]
    sol = co.integrate(kept, (0.6, 0.5, -0.3), (0, 20), 2**-5, base, save_every=64)
    assert sol.change()["energy"] < 1e-13
    # A scheme that changes the energy changes it beside such forces too, and none of these is to blame.
    split = co.methods.Forced(co.Splitting()).properties(kept)
    assert not split.energy and not any(text.startswith("energy") for text in split.broken_by)
    lost = co.methods.Forced(base).properties(kept.with_forces(co.forces.LinearDamping(0.1)))
    assert not lost.energy and lost.broken_by[0] == "energy: LinearDamping"
    # The midpoint rule of the decay preserves no other energy than quadratic ones.
    cubic = co.LiePoissonSystem(co.algebras.so(3), co.Polynomial({(2, 0, 0): 1.0, (0, 0, 3): 0.2}))
    decaying = cubic.with_forces(co.forces.SelectiveDecay(0.1))
    assert not co.methods.Forced(co.RadauEnergy(2)).properties(decaying).energy
    fluid = co.systems.torus_qg(N=7, gamma=2.0, topography={(1, 0): 0.3}).with_forces(co.forces.BetaPlane(2.0))
    x = fluid.to_vector(fluid.random(seed=1))
    turned = fluid.forces[0].flow(fluid.unforced, x, 0.0, 0.7)
    assert np.abs(turned - x).max() > 0.1
    assert fluid.unforced.energy(turned) == pytest.approx(fluid.unforced.energy(x), rel=1e-14)
    assert fluid.forces[0].preserves_energy(fluid.unforced)


BODY, X0 = co.systems.rigid_body(inertia=(1, 2, 3)), (0.3, 0.4, 0.5)


@pytest.mark.thinned(1)
@pytest.mark.parametrize(
    ("force", "named"),
    [
        (co.forces.Torque(lambda t: np.array([0.0, 0.0, np.log(1.0 - t)])), ("step 9", "t = 1")),
        (co.forces.DoubleBracketDamping(1e6), ("step 1",)),
        (co.forces.DoubleBracketDamping(500.0), ("did not converge",)),
    ],
    ids=["undefined", "too strong", "slow"],
)
def test_failures_name_the_step(force, named):
    with refused(co.IntegrationError, *named):
        co.integrate(BODY.with_forces(force), (0.1, 0.2, 0.3), (0, 2), 0.125)


def test_a_damped_moment_is_a_spin_of_the_other_sign():
    """R. F. L. Evans et al., J. Phys.: Condens. Matter 26 (2014) 103202: m = (sech cos, sech sin, tanh) in a field."""
    a, B, t = 0.1, 2.0, 4.0
    lattice = co.systems.spin_lattice([], 1, field=(0.0, 0.0, -B / (1 + a * a)))
    damped = lattice.with_forces(co.forces.DoubleBracketDamping(a))
    m = -co.integrate(damped, (-1.0, 0.0, 0.0), (0.0, t), 1 / 256).x[-1]
    decay, angle = a * B * t / (1 + a * a), B * t / (1 + a * a)
    wanted = np.array([np.cos(angle) / np.cosh(decay), np.sin(angle) / np.cosh(decay), np.tanh(decay)])
    np.testing.assert_allclose(m, wanted, rtol=0, atol=1e-6)


def test_damping_keeps_positions_and_the_central_coordinate():
    """By DOP853; errors are estimated, and steps continue from where they are."""
    system = co.systems.satellite().with_forces(co.forces.LinearDamping(0.1))
    x0 = np.array([0.1, 0.2, 0.3, 0.0, 0.1, 0.0, 5.0, 0.0, 0.0, 1.0])
    sol = co.integrate(system, x0, (0.0, 1.0), 0.125)
    momenta = np.arange(10) < 6
    wanted = solve_ivp(
        lambda t, x: system.unforced.vector_field(x) - 0.1 * momenta * x, (0, 1), x0, "DOP853", rtol=1e-12, atol=1e-14
    ).y[:, -1]
    assert np.abs(sol.x[-1] - wanted).max() < 1e-3 and sol.x[-1, -1] == 1.0 and sol.step_error() < 0.01
    assert np.isfinite(sol.error_estimate())
    step, x = co.stepper(system, co.Splitting(), 0.125), x0
    for k in range(8):
        x = step(x, 0.125 * k)
    np.testing.assert_array_equal(x, sol.x[-1])
    x[-1] = np.exp(-0.1)
    with refused(ValueError, "satellite", "must be 1"):
        co.integrate(system, x, (0.0, 1.0), 0.125)


DRAG, SPRING = co.forces.LinearDamping(0.8), co.forces.Pointing(0.3, 0.7)
LAW = co.forces.Sampled(co.forces.Pointing(0.5, 1.5), period=0.5)


@pytest.mark.thinned(1)
@pytest.mark.parametrize("forces", list(itertools.permutations((DRAG, SPRING, LAW))))
def test_tangents_of_forces_in_any_order_are_differences_of_the_step(forces):
    """The flow of a law that is sampled comes first, wherever it stands; differences of steps of 2^-17 have 1e-10."""
    scheme, h, e = co.methods.Forced(co.Splitting(order=2)), 0.25, 2.0**-17
    system = co.systems.body((1.0, 2.0, 2.5)).with_forces(*forces)
    x = system.state([0.6, 0.0, 0.0, 0.8], angular_velocity=(0.1, 0.2, 0.3))
    along = np.random.default_rng(1).standard_normal((4, system.dim))
    for t in (0.0, h):
        ends = [[scheme.step(system, x + side * e * v, t, h) for side in (1, -1)] for v in along]
        x, derivative = scheme.tangent(system, x, t, h)
        assert np.abs(along @ derivative.T - [(one - other) / (2 * e) for one, other in ends]).max() < 1e-8


def grows(x, t, tau):
    return x * (1.0 + tau * x[0] ** 2)


def test_a_member_that_fails_leaves_the_others_as_they_are_alone():
    """Members with forces are taken together; each has the bits of a run alone, up to the step in which it fails."""
    system = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(1.0)).with_forces(
        co.forces.OwnForce(grows, backward=False)
    )
    starts = np.full((20, 3), 0.1)
    starts[7] = 50.0, 1.0, 1.0
    with pytest.raises(co.IntegrationError, match="member 7") as raised:
        co.integrate(system, starts, (0, 5), 0.1, co.Splitting())
    found = raised.value.partial.x
    alone = co.integrate(system, starts[0], (0, 5), 0.1, co.Splitting()).x
    assert np.array_equal(found[:, 0], alone) and np.array_equal(found[:, 19], alone)
    with pytest.raises(co.IntegrationError) as failed:
        co.integrate(system, starts[7], (0, 5), 0.1, co.Splitting())
    part = failed.value.partial.x
    assert np.array_equal(found[: len(part), 7], part, equal_nan=True)

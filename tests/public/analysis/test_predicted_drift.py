"""Predicted phase drifts against runs, orbit averages and fields with a known clock or turn; periods of motions."""

from contextlib import nullcontext

import numpy as np
import pytest
from scipy.special import ellipk

import coadjoint as co
from long import long_beyond
from refusals import refused

period = co.analysis.period

STATES = [(1.0, 0.2, 0.5), (0.2, 1.0, 0.3), (0.2, 0.3, 1.0)]  # around one axis, near the middle one, around the other
TENSOR = np.array([[1.3, 0.2, -0.1], [0.2, 1.9, 0.3], [-0.1, 0.3, 2.4]])
BODIES = {
    "1, 2, 3": co.systems.rigid_body((1.0, 2.0, 3.0)),
    "paper's sign": co.systems.paper_rigid_body((1.0, 0.5, 0.4)),
    "full tensor": co.systems.rigid_body(TENSOR),
}
STEPS = np.array([0.2, 0.15, 0.1])


def predicted(system, method, x0, step, **options):
    H = co.modified_hamiltonian(system, method, 4)
    return co.predicted_drift(system, x0, modified=H, step=step, **options)


@pytest.mark.parametrize(("name", "x0"), long_beyond(1, zip(BODIES, STATES, strict=True)))
def test_measured_minus_predicted_is_of_fourth_order(name, x0):
    system, parts = BODIES[name], "auto" if name == "full tensor" else "coordinates"
    method, differences, slopes = co.Splitting(order=2, parts=parts), [], []
    for step in STEPS:
        run = co.integrate(system, x0, (0.0, 4000 * step), step, method, save_every=5, attitude=True)
        measured, turned = co.phase_drift(run), co.phase_drift(run, of="attitude")
        found = predicted(system, method, x0, step, attitude=True)
        differences.append(abs(measured.slope - found.slope))
        slopes.append(measured.slope)
        # The next term is about (h |x| m)^2 of this one, and no state here has |x| m above 1.5.
        assert differences[-1] <= (1.5 * step) ** 2 * abs(measured.slope) + 4 * measured.uncertainty
        scale = abs(found.precession) + abs(found.slope)
        assert abs(turned.slope - found.precession) <= (1.5 * step) ** 2 * scale + 4 * turned.uncertainty
    order = np.polyfit(np.log(STEPS), np.log(np.abs(slopes)), 1)[0]
    assert order == pytest.approx(2.0, abs=0.1)
    if min(differences) > 20 * measured.uncertainty:
        assert np.polyfit(np.log(STEPS), np.log(differences), 1)[0] == pytest.approx(4.0, abs=0.4)


@pytest.mark.thinned(3)
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("x0", STATES)
def test_a_body_of_larger_energy_is_ahead_in_its_turn(x0, sign):
    """The motion of c H is that of H at c times the time, which turns about the momentum with 2 H / |x|."""
    H, x, c = co.Quadratic(TENSOR), np.array(x0), 1.001
    body = co.LiePoissonSystem(co.algebras.so(3), H, sign=sign)
    found = co.predicted_drift(body, x0, gradient=lambda x: c * (TENSOR @ x), attitude=True)
    # Periods have 13 digits, and so have turns.
    assert found.slope == pytest.approx(c - 1, rel=1e-9)
    assert found.precession == pytest.approx(-sign * (c - 1) * 2 * H.value(x) / np.linalg.norm(x), rel=1e-8)


@pytest.mark.long
def test_a_scheme_that_is_not_symmetric_goes_backward_by_another_field():
    """Lie and Trotter's splitting of order one; backward its H~ has -h."""
    system, x0, h = BODIES["1, 2, 3"], STATES[1], 0.02
    method = co.Splitting(order=1, parts="coordinates")
    ahead, behind = (predicted(system, method, x0, step) for step in (h, -h))
    for found, end in ((ahead, 400.0), (behind, -400.0)):
        drift = co.phase_drift(co.integrate(system, x0, (0.0, end), h, method, save_every=5))
        assert abs(drift.slope - found.slope) < 0.1 * abs(ahead.slope - behind.slope)


@pytest.mark.parametrize("x0", long_beyond(1, [pytest.param(x0, id=f"{x0}") for x0 in STATES]))
def test_the_orbit_average_says_the_same(x0):
    """P/P~ - 1 = h^2 (H2(x0) d(log w)/dE + I'(E) / P), by quadrature along the closed form on nearby energies."""
    system = BODIES["1, 2, 3"]
    start, method = np.array(x0), co.Splitting(order=2, parts="coordinates")
    h2 = co.modified_hamiltonian(system, method, 4).terms[2]

    def along(state):
        round_trip = period(system.vector_field, state).time
        orbit = system.exact(state, np.linspace(0.0, round_trip, 256, endpoint=False))
        return system.energy(state), round_trip, round_trip * float(np.mean(h2(orbit)))

    # Other energies on the same sphere: moved along the gradient's part in the sphere.
    tangent = system.hamiltonian.gradient(start)
    tangent -= tangent @ start / (start @ start) * start
    below, above = (start + sign * 2e-4 * tangent for sign in (-1.0, 1.0))
    (e0, p0, i0), (e1, p1, i1) = (along(s / np.linalg.norm(s) * np.linalg.norm(start)) for s in (below, above))
    _, p, _ = along(start)
    expected = -float(h2(start)) * (np.log(p1) - np.log(p0)) / (e1 - e0) + (i1 - i0) / (e1 - e0) / p
    found = [predicted(system, method, x0, h).slope / h**2 for h in (0.04, 0.02)]
    # The difference falls like h^2; two steps of it leave h^4, and the energies nearby have (2e-4)^2.
    assert (4 * found[1] - found[0]) / 3 == pytest.approx(expected, rel=1e-5)


@pytest.mark.long
def test_other_algebras():
    """On sl(2) orbits are closed where H is positive on a sheet of the hyperboloid; the reference is a run."""
    system = co.LiePoissonSystem(co.algebras.get("A3,8"), co.Quadratic([1.0, 0.4, 1.3]))
    x0, step, method = np.array([0.3, 0.8, 1.2]), 0.05, co.Splitting(order=2, parts="coordinates")
    right = co.integrate(system, x0, (0.0, 410.0), 0.01, co.GaussLegendre(6), save_every=5)
    measured = co.phase_drift(co.integrate(system, x0, (0.0, 400.0), step, method, save_every=4), right)
    assert measured.growth == "linear"
    slope = predicted(system, method, x0, step).slope
    assert measured.slope == pytest.approx(slope, rel=0.02, abs=4 * measured.uncertainty)


def test_gradient_field_and_hamiltonian_say_the_same():
    system, x0, h, method = BODIES["full tensor"], STATES[1], 0.1, co.Splitting(order=2)
    H = co.modified_hamiltonian(system, method, 4)
    slopes = [
        predicted(system, method, x0, h).slope,
        co.predicted_drift(system, x0, gradient=lambda x: H.gradient(x, h)).slope,
        co.predicted_drift(system, x0, field=lambda x: -system.structure_matrix(x) @ H.gradient(x, h)).slope,
    ]
    assert slopes == pytest.approx([slopes[0]] * 3, abs=1e-11)


@pytest.mark.thinned(2)
@pytest.mark.parametrize("x0", [*STATES, (1.0, 10.0, 1.0), (1e-3, 1.0, 1e-3)])
def test_periods_against_elliptic_integrals(x0):
    """Also near the separatrix, and near the unstable rotation."""
    system, m, x = BODIES["1, 2, 3"], 1.0 / np.array([1.0, 2.0, 3.0]), np.array(x0)
    length2, energy2 = x @ x, (m * x) @ x
    c, a = (0, 2) if energy2 > m[1] * length2 else (2, 0)
    rate = np.sqrt((m[1] - m[c]) * (m[a] * length2 - energy2))
    k2 = (m[a] - m[1]) * (energy2 - m[c] * length2) / ((m[1] - m[c]) * (m[a] * length2 - energy2))
    found = period(system.vector_field, x0)
    # Rounding moves the energy by some u, and the period by that over the distance to the separatrix.
    assert found.time == pytest.approx(4 * ellipk(k2) / rate, rel=1e-12 / min(1.0, abs(1 - k2)))
    assert found.misfit < 1e-10


def test_what_is_carried_along():
    """The integral of x1^2 over a circle, started at any of its points."""
    circle = period(lambda y: np.array([-3 * y[1], 3 * y[0], y[0] ** 2]), (0.6, 0.8), carried=[0.5])
    assert circle.time == pytest.approx(2 * np.pi / 3, rel=1e-12)
    assert circle.carried[0] == pytest.approx(0.5 + np.pi / 3, rel=1e-11)


@pytest.mark.parametrize(("off", "accepted"), [(0.5e-8, True), (2e-8, False)])
def test_an_orbit_returns_up_to_its_threshold(off, accepted):
    """A spiral that grows by pi off in a turn; the orbit is two wide."""
    growth = off / np.pi

    def spiral(y):
        return np.array([growth * y[0] - y[1], y[0] + growth * y[1]])

    with nullcontext() if accepted else refused(ValueError, "return"):
        assert period(spiral, (1.0, 0.0)).time == pytest.approx(2 * np.pi, rel=1e-9)


@pytest.mark.parametrize(("share", "rests"), [(0.5, True), (2.0, False)])
def test_a_state_beside_a_centre_rests_up_to_its_threshold(share, rests):
    """Turns about a point at the distance `speed`; the rate is the norm of the derivative of the field, sqrt(2)."""
    speed = share * 2.0**-40 * np.sqrt(2.0)

    def turning(y):
        return np.array([-y[1], y[0] - 1.0 + speed])

    with pytest.raises(ValueError) as caught:  # the orbit is too narrow to be followed
        period(turning, (1.0, 0.0))
    assert ("at rest" in str(caught.value)) is rests

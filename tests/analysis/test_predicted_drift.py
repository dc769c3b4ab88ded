"""Predicted phase drifts against runs, orbit averages and fields with a known clock or turn; periods of motions."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.special import ellipk

import coadjoint as co
from coadjoint.analysis import periods
from coadjoint.analysis.periods import period
from coadjoint.analysis.phase import phase_error
from coadjoint.analysis.phase_drift import drift_of_series
from coadjoint.analysis.predicted_drift import predicted_drift
from coadjoint.program.modified_energy.second_order import second_order_term
from coadjoint.program.parts.decompose import decompose
from coadjoint.systems.bodies.rigid_body import so3_body
from long import long_beyond

STATES = [(1.0, 0.2, 0.5), (0.2, 1.0, 0.3), (0.2, 0.3, 1.0)]  # around one axis, near the middle one, around the other
TENSOR = np.linalg.inv(np.array([[1.3, 0.2, -0.1], [0.2, 1.9, 0.3], [-0.1, 0.3, 2.4]]))
BODIES = {
    "1, 2, 3": so3_body(1.0 / np.array([1.0, 2.0, 3.0]), sign=-1, name="a", parameters={}),
    "paper's sign": so3_body(np.array([1.0, 0.5, 0.4]), sign=+1, name="b", parameters={}),
    "another order": so3_body(1.0 / np.array([2.0, 2.5, 1.0]), sign=-1, name="c", parameters={}),
    "full tensor": so3_body(TENSOR, sign=-1, name="d", parameters={}),
    "full tensor, paper's sign": so3_body(TENSOR[::-1, ::-1].copy(), sign=+1, name="e", parameters={}),
}
ROWS = np.eye(3, dtype=int)
STEPS = np.array([0.2, 0.15, 0.1])


def h2_of(system: co.LiePoissonSystem, parts: str) -> Callable[[np.ndarray], np.ndarray]:
    """Return H2 of Strang's splitting at points, shape (k, n)."""
    chosen = decompose(system, parts).parts
    return lambda points: second_order_term(system.algebra, chosen, np.atleast_2d(points))


def gradient_of(system: co.LiePoissonSystem, parts: str, step: float) -> Callable[[np.ndarray], np.ndarray]:
    """Return the gradient of H + h^2 H2; H2 is homogeneous of degree four, and its 15 values are its coefficients."""
    powers = np.array([(i, j, 4 - i - j) for i in range(5) for j in range(5 - i)])
    points = np.random.default_rng(0).normal(size=(60, 3))
    values = h2_of(system, parts)(points)
    coefficients = np.linalg.lstsq(np.prod(points[:, None] ** powers, axis=2), values, rcond=None)[0]

    def gradient(x: np.ndarray) -> np.ndarray:
        slopes = [np.prod(x ** np.maximum(powers - row, 0), axis=1) @ (coefficients * (powers @ row)) for row in ROWS]
        return system.hamiltonian.gradient(x) + step**2 * np.array(slopes)

    return gradient


# Each body, and each state on either side of the separatrix, twice at least.
CASES = [(name, STATES[k % len(STATES)]) for k, name in enumerate([*BODIES, *BODIES][: len(BODIES) + 1])]


@pytest.mark.long
@pytest.mark.parametrize(("name", "x0"), long_beyond(1, CASES))
def test_measured_minus_predicted_is_of_fourth_order(name: str, x0: tuple[float, ...]) -> None:
    system, parts = BODIES[name], "coordinates" if name in ("1, 2, 3", "paper's sign") else "auto"
    differences, slopes = [], []
    for step in STEPS:
        method = co.Splitting(order=2, parts=parts)
        run = co.integrate(system, x0, (0.0, 4000 * step), step, method, save_every=5, attitude=True)
        measured, turned = co.phase_drift(run), co.phase_drift(run, of="attitude")
        predicted = predicted_drift(system, x0, gradient=gradient_of(system, parts, step), attitude=True)
        differences.append(abs(measured.slope - predicted.slope))
        slopes.append(measured.slope)
        # The next term is about (h |x| m)^2 of this one, and no state here has |x| m above 1.5.
        assert differences[-1] <= (1.5 * step) ** 2 * abs(measured.slope) + 4 * measured.uncertainty
        scale = abs(predicted.precession) + abs(predicted.slope)
        assert abs(turned.slope - predicted.precession) <= (1.5 * step) ** 2 * scale + 4 * turned.uncertainty
    order = np.polyfit(np.log(STEPS), np.log(np.abs(slopes)), 1)[0]
    assert order == pytest.approx(2.0, abs=0.1)
    if min(differences) > 20 * measured.uncertainty:
        assert np.polyfit(np.log(STEPS), np.log(differences), 1)[0] == pytest.approx(4.0, abs=0.4)


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "x0", "attitude"), long_beyond(1, [("1, 2, 3", STATES[0], False), ("full tensor", STATES[2], True)])
)
def test_from_the_modified_hamiltonian(name: str, x0: tuple[float, ...], attitude: bool) -> None:
    """The same as from the H2 of brackets at points, and what the next term changes is h^4."""
    system, method, differences = BODIES[name], co.Splitting(order=2), []
    H4, H6 = (co.modified_hamiltonian(system, method, order) for order in (4, 6))
    for h in STEPS[::2]:
        found, better = (predicted_drift(system, x0, modified=H, step=h, attitude=attitude) for H in (H4, H6))
        own = predicted_drift(system, x0, gradient=gradient_of(system, "auto", h), attitude=attitude)
        assert found.slope == pytest.approx(own.slope, abs=1e-11)
        assert not attitude or found.precession == pytest.approx(own.precession, abs=1e-11)
        differences.append(abs(better.slope - found.slope))
    assert np.polyfit(np.log(STEPS[::2]), np.log(differences), 1)[0] == pytest.approx(4.0, abs=0.3)


@pytest.mark.long
@pytest.mark.parametrize("kind", long_beyond(1, ["field of the midpoint rule", "Hamiltonian", "field of a splitting"]))
@pytest.mark.parametrize("direction", long_beyond(1, [1, -1]))
def test_measured_minus_that_of_the_modified_hamiltonian_or_field_is_of_fourth_order(direction: int, kind: str) -> None:
    system, x0 = BODIES["1, 2, 3"], STATES[0]
    strang, midpoint = co.Splitting(order=2, parts="coordinates"), co.GaussLegendre(1)
    method = midpoint if kind == "field of the midpoint rule" else strang
    modify = co.modified_hamiltonian if kind == "Hamiltonian" else co.modified_field
    modified, differences = modify(system, method, order=4), []
    for h in STEPS:
        drift = co.phase_drift(co.integrate(system, x0, (0.0, direction * 1200.0), h, method, save_every=5))
        differences.append(abs(drift.slope - predicted_drift(system, x0, modified=modified, step=direction * h).slope))
        assert differences[-1] > 3 * drift.uncertainty
    assert np.polyfit(np.log(STEPS), np.log(differences), 1)[0] == pytest.approx(4.0, abs=0.1)


@pytest.mark.long
def test_a_scheme_that_is_not_symmetric_goes_backward_by_another_field() -> None:
    """Lie and Trotter's splitting of order one; backward its H~ has -h."""
    system, x0, h = BODIES["1, 2, 3"], STATES[1], 0.02
    method = co.Splitting(order=1, parts="coordinates")
    H = co.modified_hamiltonian(system, method, order=4)
    ahead, behind = (predicted_drift(system, x0, modified=H, step=step) for step in (h, -h))
    for predicted, end in ((ahead, 400.0), (behind, -400.0)):
        drift = co.phase_drift(co.integrate(system, x0, (0.0, end), h, method, save_every=5))
        assert abs(drift.slope - predicted.slope) < 0.1 * abs(ahead.slope - behind.slope)


@pytest.mark.long
@pytest.mark.parametrize("x0", STATES)
def test_the_orbit_average_says_the_same(x0: tuple[float, ...]) -> None:
    """P/P~ - 1 = h^2 (H2(x0) d(log w)/dE + I'(E) / P), by quadrature along the closed form on nearby energies."""
    system = BODIES["1, 2, 3"]
    start = np.array(x0)
    h2 = h2_of(system, "coordinates")

    def along(state: np.ndarray) -> tuple[float, float, float]:
        round_trip = period(system.vector_field, state).time
        orbit = system.exact(state, np.linspace(0.0, round_trip, 256, endpoint=False))
        return system.energy(state), round_trip, round_trip * float(np.mean(h2(orbit)))

    # Other energies on the same sphere: moved along the gradient's part in the sphere.
    tangent = system.hamiltonian.gradient(start)
    tangent -= tangent @ start / (start @ start) * start
    below, above = (start + sign * 2e-4 * tangent for sign in (-1.0, 1.0))
    (e0, p0, i0), (e1, p1, i1) = (along(s / np.linalg.norm(s) * np.linalg.norm(start)) for s in (below, above))
    _, p, _ = along(start)
    expected = -float(h2(start)[0]) * (np.log(p1) - np.log(p0)) / (e1 - e0) + (i1 - i0) / (e1 - e0) / p
    found = [
        predicted_drift(system, x0, gradient=gradient_of(system, "coordinates", h)).slope / h**2 for h in (0.04, 0.02)
    ]
    # The difference falls like h^2; two steps of it leave h^4, and the energies nearby have (2e-4)^2.
    assert (4 * found[1] - found[0]) / 3 == pytest.approx(expected, rel=1e-5)


@pytest.mark.long
def test_other_algebras() -> None:
    """On sl(2) orbits are closed where H is positive on a sheet of the hyperboloid; the reference is a run."""
    system = co.LiePoissonSystem(co.algebras.get("A3,8"), co.Quadratic([1.0, 0.4, 1.3]))
    x0 = np.array([0.3, 0.8, 1.2])
    step = 0.05
    right = co.integrate(system, x0, (0.0, 410.0), 0.01, co.GaussLegendre(6), save_every=5)
    run = co.integrate(system, x0, (0.0, 400.0), step, co.Splitting(order=2, parts="coordinates"), save_every=4)
    measured = drift_of_series(run.t, phase_error(system, x0, run.t, run.x, right))
    predicted = predicted_drift(system, x0, gradient=gradient_of(system, "coordinates", step))
    assert measured.growth == "linear"
    assert measured.slope == pytest.approx(predicted.slope, rel=0.02, abs=4 * measured.uncertainty)


def test_gradient_and_field_say_the_same() -> None:
    system, x0 = BODIES["full tensor"], STATES[1]
    gradient = gradient_of(system, "auto", 0.1)
    by_field = predicted_drift(system, x0, field=lambda x: -system.structure_matrix(x) @ gradient(x))
    assert by_field.slope == pytest.approx(predicted_drift(system, x0, gradient=gradient).slope, abs=1e-13)


@pytest.mark.thinned(2)
@pytest.mark.parametrize("x0", [*STATES, (1.0, 10.0, 1.0), (1e-3, 1.0, 1e-3)])
def test_periods_against_elliptic_integrals(x0: tuple[float, ...]) -> None:
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


def test_what_is_carried_along() -> None:
    """The integral of x1^2 over a circle, started at any of its points."""
    circle = period(lambda y: np.array([-3 * y[1], 3 * y[0], y[0] ** 2]), (0.6, 0.8), carried=[0.5])
    assert circle.time == pytest.approx(2 * np.pi / 3, rel=1e-12)
    assert circle.carried[0] == pytest.approx(0.5 + np.pi / 3, rel=1e-11)


@pytest.mark.long
def test_what_has_no_period_is_refused() -> None:
    body = BODIES["1, 2, 3"]
    with pytest.raises(ValueError, match="at rest"):
        period(body.vector_field, (0.0, 0.0, 1.0))
    with pytest.raises(ValueError, match="at rest"):
        period(BODIES["full tensor"].vector_field, np.linalg.eigh(TENSOR)[1][:, 0])
    spiral = co.systems.paper_a37()
    with pytest.raises(ValueError, match="not periodic"):
        period(spiral.vector_field, (1.0, 1.0, 1.0))
    body4 = co.LiePoissonSystem(co.algebras.so(4), co.Quadratic([1.0, 0.8, 0.55, 0.9, 0.35, 0.6]))
    with pytest.raises(ValueError, match="not periodic"):
        period(body4.vector_field, (0.9, -0.4, 0.7, 0.5, 1.1, -0.6))
    with pytest.raises(ValueError, match="diverges"):
        period(lambda x: np.array([x[0] ** 2]), [1.0])


def test_wrong_input_is_refused() -> None:
    body, spiral = BODIES["1, 2, 3"], co.systems.paper_a37()
    H, field = co.modified_hamiltonian(body, co.Splitting()), co.modified_field(body, co.Splitting(), 3)
    slope = body.hamiltonian.gradient
    for options, words in (
        ({}, "give exactly one of"),
        ({"gradient": slope, "field": body.vector_field}, "give exactly one of"),
        ({"modified": H, "step": 0.1, "field": body.vector_field}, "give exactly one of"),
        ({"field": 3.0}, r"function of \(x\)"),
        ({"field": body.vector_field, "attitude": True}, "give gradient"),
        ({"modified": field, "step": 0.1, "attitude": True}, "give gradient"),
        ({"modified": H}, "step is missing"),
        ({"gradient": slope, "step": 0.1}, "step is given without modified"),
    ):
        with pytest.raises(TypeError, match=words):
            predicted_drift(body, STATES[0], **options)
    with pytest.raises(ValueError, match="in 3 coordinates"):
        predicted_drift(co.LiePoissonSystem(co.algebras.so(4), co.Quadratic(1.0)), np.ones(6), modified=H, step=0.1)
    with pytest.raises(ValueError, match=r"must be \(3,\)"):
        predicted_drift(body, (1.0, 2.0), field=body.vector_field)
    with pytest.raises(TypeError, match="no attitude of a body"):
        predicted_drift(spiral, (1.0, 1.0, 1.0), gradient=spiral.hamiltonian.gradient, attitude=True)


def oscillators(frequencies: np.ndarray, power: float = 1.0):
    """Return the field of plane rotations by commensurate frequencies, in 2 k coordinates."""

    def field(x):
        pairs = x[: 2 * len(frequencies)].reshape(-1, 2)
        return power * (frequencies[:, None] * np.stack([-pairs[:, 1], pairs[:, 0]], axis=1)).ravel()

    return field


def drawn(seed, k):
    phases = np.random.default_rng(seed).uniform(0.0, 2 * np.pi, k)
    return np.stack([np.cos(phases), np.sin(phases)], axis=1).ravel()


@pytest.mark.parametrize(("frequencies", "scale", "rate"), [((1, 3), 1e6, 1e-3), ((2, 3), 1e-7, -40.0)])
def test_commensurate_oscillators(frequencies, scale, rate):
    """The plane is crossed several times before the return, and the fast ones take many stretches of integration."""
    x0 = scale * drawn(len(frequencies), len(frequencies))
    found = period(oscillators(np.array(frequencies, float), rate), x0)
    # The integration has 2.5e-14 of error in each step, some 60 of which make one turn of the fastest oscillator.
    tolerance = 2.5e-14 * 60 * sum(frequencies)
    assert found.time == pytest.approx(2 * np.pi / abs(rate), rel=tolerance)
    assert 0.0 <= found.misfit < 1e-8 and found.carried.shape == (0,)


def test_the_time_and_an_area_are_carried_over_all_stretches():
    frequencies, x0, begin = np.array([1.0, 6.0]), drawn(1, 2), [5.0, -3.0]
    turning = oscillators(frequencies)
    found = period(lambda y: np.concatenate([turning(y), [1.0, y[2] ** 2]]), x0, begin)
    assert found.carried == pytest.approx(np.array(begin) + [found.time, np.pi], abs=1e-10)


def test_what_is_no_state_is_refused():
    with pytest.raises(ValueError, match=r"must be one state, \(n,\)"):
        period(lambda x: x, [[1.0, 0.0]])
    with pytest.raises(ValueError, match=r"must be one state, \(n,\)"):
        period(lambda x: x, [])
    with pytest.raises(ValueError, match="it must be finite"):
        period(lambda x: x / 0.0, [1.0, 2.0])


QUICK = np.array([[3.0, 0.2, -0.1], [0.2, 1.0, 0.15], [-0.1, 0.15, 0.3]])  # of quick nutation: few steps make a period


@pytest.mark.parametrize(("sign", "x0"), [(-1, (0.3, 0.4, -2.0)), (1, (-20.0, 4.0, 7.0))])
def test_a_clock_and_a_turn_about_the_momentum(monkeypatch, sign, x0):
    """x' = s J(x) u, and g' = -s g D(u): the gradient u + c x moves x as before, and turns g by c |x| more.

    A clock that is fast by e takes the attitude along by e times its mean speed about the momentum, 2T/|x|.
    """
    monkeypatch.setattr(periods, "RELATIVE_TOLERANCE", 1e-10)
    body = so3_body(QUICK, sign=sign, name="body", parameters={})
    start, gradient = np.array(x0), body.hamiltonian.gradient
    size, c, e = np.linalg.norm(start), 0.02, 0.01
    turned = predicted_drift(body, x0, gradient=lambda x: gradient(x) + c * x, attitude=True)
    # With this tolerance periods and angles are known to some 1e-8; the speeds are of the size of |x|.
    assert turned.slope == pytest.approx(0.0, abs=1e-7)
    assert turned.precession == pytest.approx(-sign * c * size, abs=1e-7 * size)
    fast = predicted_drift(body, x0, gradient=lambda x: (1.0 + e) * gradient(x), attitude=True)
    assert fast.slope == pytest.approx(e, abs=1e-7)
    assert fast.precession == pytest.approx(-sign * e * (start @ gradient(start)) / size, abs=1e-7 * size)
    assert fast.period == pytest.approx((1.0 + e) * fast.modified_period, rel=1e-7)
    assert fast.period == pytest.approx(turned.period, rel=1e-7) == turned.modified_period


@pytest.mark.thinned(18)
@pytest.mark.parametrize("turn", [3.0, -3.0])
@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize("seed", range(3))
def test_less_than_half_a_turn_per_period_has_its_size_and_sense(monkeypatch, seed, sign, turn):
    """The gradient (1 + e) u + c x turns the attitude by c |x| + e x.u/|x| more, whatever the turn of one period is.

    Here c |x| is 3 radians in a period: with one of both signs the angles of the exact and the computed motion lie on
    either side of half a turn, unless the exact one is within 0.14 of whole turns.
    """
    monkeypatch.setattr(periods, "RELATIVE_TOLERANCE", 1e-10)
    rng = np.random.default_rng(seed)
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    body = so3_body(axes @ np.diag([3.0, 1.0, 0.3]) @ axes.T, sign=sign, name="body", parameters={})
    # Near the first or the last axis, where no separatrix is near.
    start = rng.uniform(0.5, 2.0) * axes @ np.array([(1.0, 0.3, 0.2), (0.2, 0.3, -1.0)][seed % 2])
    gradient, size, e = body.hamiltonian.gradient, np.linalg.norm(start), 1e-3
    own = periods.period(body.vector_field, start).time
    ahead = e * (start @ gradient(start)) / size
    c = (turn * (1.0 + e) / own) / size
    found = predicted_drift(body, start, gradient=lambda x: (1.0 + e) * gradient(x) + c * x, attitude=True)
    # Periods and angles are known to some 1e-8 of a turn.
    assert found.slope == pytest.approx(e, abs=1e-7)
    assert found.precession == pytest.approx(-sign * (c * size + ahead), abs=1e-6 / own)

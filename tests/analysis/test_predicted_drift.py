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


def test_a_field_of_rounding_errors_is_refused(monkeypatch) -> None:
    """The gradient of a Casimir gives J(x) x = 0 up to rounding, which has no motion to follow."""
    monkeypatch.setattr(periods, "MAX_EVALUATIONS", 2**14)
    with pytest.raises(ValueError, match="not smooth"):
        co.predicted_drift(BODIES["1, 2, 3"], (0.9, 0.31, 0.77), gradient=lambda x: x)


def test_evaluations_of_a_field_are_bounded(monkeypatch) -> None:
    """A circle takes the same number each time: with that limit it is found, with one less it is refused."""
    taken = [0]

    def circle(x):
        taken[0] += 1
        return np.array([x[1], -4.0 * x[0]])

    found = period(circle, (1.0, 0.0))
    counted = taken[0] - 4  # without the first value, two differences and the slope at the plane
    monkeypatch.setattr(periods, "MAX_EVALUATIONS", counted)
    assert period(circle, (1.0, 0.0)).time == found.time
    monkeypatch.setattr(periods, "MAX_EVALUATIONS", counted - 1)
    with pytest.raises(ValueError, match="not smooth"):
        period(circle, (1.0, 0.0))

"""Final states against references of 25 and more digits, which detect wrong speeds, signs and indices."""

import itertools
import json
from fractions import Fraction
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import coadjoint as co

pytestmark = pytest.mark.thinned(3)

HERE = Path(__file__).with_name("references")
SYSTEMS = {s["name"]: s for s in json.loads((HERE / "lie_poisson_systems.json").read_text())["systems"]}
BODIES = {c["name"]: c for c in json.loads((HERE / "rigid_body.json").read_text())["cases"]}


def numbers(values):
    return np.array([float(Fraction(v)) for v in values])


def system_of(given, sign):
    algebra = co.LieAlgebra([(i, j, k, float(Fraction(c))) for i, j, k, c in given["brackets"]], dim=given["dim"])
    H = co.Polynomial({tuple(exponents): Fraction(c) for exponents, c in given["hamiltonian"]})
    return co.LiePoissonSystem(algebra, H, sign=sign)


def states_at(system, x0, times, direction, steps, method):
    """Return the states at the times, run in the direction in the same number of steps for each unit of time."""
    end = direction * times[-1]
    run = co.integrate(system, x0, (0.0, end), 1.0 / steps, method, save_every=steps, watch=False)
    return run.x[list(times)]


def gauss(stages):
    return lambda *where: states_at(*where[:4], where[4] // (2 if stages == 6 else 4), co.GaussLegendre(stages))


def splitting_extrapolated(system, x0, times, direction, steps):
    """Order 4 at h, h/2, h/4 and h/8; symmetric, so that the error is in h^4, h^6, h^8: three extrapolations."""
    rows = [
        states_at(system, x0, times, direction, steps * 2**k, co.Splitting(order=4, compensated=True)) for k in range(4)
    ]
    for power in (4, 6, 8):
        rows = [fine + (fine - coarse) / (2.0**power - 1) for coarse, fine in itertools.pairwise(rows)]
    return rows[-1]


FAMILIES = {"GaussLegendre 6": gauss(6), "GaussLegendre 8": gauss(8), "Splitting 4": splitting_extrapolated}


def body(case, sign):
    return co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(numbers(case["inverse_inertia"])), sign=sign)


def amplification(case, t):
    """Return the growth of initial round-off: on the separatrix at the rate |x| sqrt((m1 - m2)(m2 - m3))."""
    if not case["name"].startswith("separatrix"):
        return 1.0
    m1, m2, m3 = numbers(case["inverse_inertia"])
    return float(np.exp(t * np.linalg.norm(numbers(case["x0"])) * np.sqrt((m1 - m2) * (m2 - m3))))


@pytest.mark.thinned(6)
@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("flipped", [False, True])
@pytest.mark.parametrize("name", [*SYSTEMS, *BODIES])
def test_final_states_match_references(name, flipped, family):
    """With the given sign, and with the other sign backward in time: the same motion."""
    if name in BODIES:
        case, system = BODIES[name], body(BODIES[name], 1 if flipped else -1)
    else:
        case = SYSTEMS[name]
        system = system_of(case, -case["sign"] if flipped else case["sign"])
    times = [state["t"] for state in case["states"]]
    steps = 64 if name == "paper_5_2" else 32
    found = FAMILIES[family](system, numbers(case["x0"]), times, -1 if flipped else 1, steps)
    for x, state in zip(found, case["states"], strict=True):
        exact = numbers(state["x"])
        error = np.max(np.abs(x - exact)) / np.max(np.abs(exact))
        assert error <= 1e-11 * amplification(case, state["t"]), (state["t"], error)


WITH_ATTITUDE = [name for name, case in BODIES.items() if "A" in case["states"][0]]
MOTIONS = [(n, key) for n in WITH_ATTITUDE for key in ("", "_backward") if f"A{key}" in BODIES[n]["states"][0]]


@pytest.mark.parametrize(
    ("method", "steps"), [(co.GaussLegendre(6), 32), (co.GaussLegendre(8), 16), (co.Splitting(order=4), 8192)]
)
@pytest.mark.parametrize(("name", "key"), MOTIONS)
def test_attitudes_match_references(name, key, method, steps):
    """In the body convention, and in the paper's, which is the same motion backward in time."""
    case = BODIES[name]
    times = [state["t"] for state in case["states"]]
    if isinstance(method, co.Splitting):
        times = [t for t in times if t <= 10]  # 8192 steps a unit of time
    system, options = body(case, 1 if key else -1), {"save_every": steps, "attitude": True, "watch": False}
    run = co.integrate(system, numbers(case["x0"]), (0.0, times[-1]), 1.0 / steps, method, **options)
    for t, state in zip(times, case["states"], strict=False):
        x, A = numbers(state[f"x{key}"]), np.array([numbers(row) for row in state[f"A{key}"]])
        assert np.max(np.abs(run.x[t] - x)) <= 1e-11 * np.max(np.abs(x)), t
        assert np.max(np.abs(run.attitude[t] - A)) <= 1e-11, t


# A check-case of NASA: a tumbling brick without damping.
STORED = Path(co.__file__).parent / "checkcases" / "cases" / "tumbling_brick.json"  # samples of the check-case
CASE = json.loads(STORED.read_text())
INERTIA = np.array([float(value) for value in CASE["inertia"]])
START = INERTIA * np.radians([float(value) for value in CASE["body_rates"]])
END = 30.0
BRICK = co.systems.rigid_body(inertia=INERTIA)
EARTH_RATE = 7.292115e-5  # rad/s, of WGS 84

SCHEMES = [co.Splitting(order=8), co.Splitting(parts="free_body"), co.GaussLegendre(5), co.Taylor(order=16)]


@cache
def published(simulator):
    """Return times, body rates (deg/s), and attitudes from the start; the frame of the angles turns with the Earth."""
    rows = np.array(CASE["simulators"][simulator])
    attitudes = [
        turn(2, longitude + EARTH_RATE * t) @ NORTH_EAST_DOWN @ turn(2, yaw) @ turn(1, pitch) @ turn(0, roll)
        for t, (yaw, pitch, roll, longitude) in zip(rows[:, 0], np.radians(rows[:, 4:]), strict=True)
    ]
    return rows[:, 0], rows[:, 1:4], attitudes[0].T @ np.array(attitudes)


NORTH_EAST_DOWN = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])  # at longitude and latitude zero


def turn(axis, angle):
    """Return the rotation by an angle about an axis."""
    hat = np.cross(np.eye(3), np.eye(3)[axis])
    return np.eye(3) + np.sin(angle) * hat + (1.0 - np.cos(angle)) * hat @ hat


def degrees_between(A, B):
    """Return the angle of A^T B, which is small, for stacks of rotations."""
    R = np.swapaxes(A, 1, 2) @ B
    axis = np.stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]])
    return np.degrees(np.linalg.norm(axis, axis=0) / 2.0)


@pytest.mark.thinned(1)
@pytest.mark.parametrize("simulator", ["01", "04"])
@pytest.mark.parametrize("method", SCHEMES, ids=str)
def test_two_published_simulators_have_the_same_motion(method, simulator):
    """The rates to 1e-9 deg/s and the attitude to 1e-8 deg, which are the digits that are published."""
    t, rates, attitudes = published(simulator)
    sol = co.integrate(BRICK, START, (0.0, END), 0.1, method, attitude=True, save_every=50)
    assert np.abs(sol.t - t).max() < 1e-12
    assert np.abs(np.degrees(sol.x / INERTIA) - rates).max() < 1e-9
    assert degrees_between(attitudes, sol.attitude).max() < 1e-8
    assert np.degrees(sol.x[-1] / INERTIA).round(8).tolist() == [12.61839078, -17.39747476, 31.11958889]


@pytest.mark.thinned(1)
@pytest.mark.parametrize(("simulator", "least", "most"), [("02", 5e-4, 2e-3), ("05", 2e-5, 1e-4), ("06", 1e-3, 5e-3)])
def test_the_other_three_differ_from_the_motion(simulator, least, most):
    """So much that a comparison with them would fail; the sixth is half a millisecond ahead."""
    t, rates, _ = published(simulator)
    off = np.abs(np.degrees(BRICK.exact(START, t) / INERTIA) - rates).max()
    assert least < off < most
    ahead = np.abs(np.degrees(BRICK.exact(START, t[1:] + 5e-4) / INERTIA) - rates[1:]).max()
    assert (ahead < 1e-6) == (simulator == "06")

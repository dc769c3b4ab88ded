"""The diagnosis of mistakes in the law of a body, each made in a simulation by DOP853 that shares no code."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import coadjoint as co

RATES, QUATERNION = ("wx", "wy", "wz"), ("qw", "qx", "qy", "qz")
SHORT = {
    "free_body": {"end": 6.0, "samples": 41},
    "free_body_products": {"end": 6.0, "samples": 41},
    "gyrostat": {"end": 20.0, "samples": 41},
    "spin_up": {"end": 6.0, "samples": 41},
    "lagrange_top": {"end": 0.4, "samples": 41},
    "kovalevskaya_top": {"end": 3.0, "samples": 41},
    "pitch_libration": {"end": 6000.0, "samples": 41},
    "eccentric_libration": {"end": 6000.0, "samples": 41},
}
ECCENTRIC = pytest.param("eccentric_libration", marks=pytest.mark.long)  # compiled by Numba, in some seconds


def value(case, name):
    return np.asarray(case.parameters[name][0], dtype=float)


def inertia_of(case):
    if case.name == "spin_up":
        return np.diag([value(case, "transverse"), value(case, "transverse"), value(case, "axial")])
    found = value(case, "inertia")
    return np.diag(found) if found.ndim == 1 else found


def anomaly(case, t):
    """Angle and rate of the orbital frame, and (a/r)^3."""
    n = value(case, "mean_motion")
    if case.name == "pitch_libration":
        return n * t, n + 0 * t, 1.0
    e, E = value(case, "eccentricity"), n * t
    for _ in range(30):
        E = E - (E - e * np.sin(E) - n * t) / (1 - e * np.cos(E))
    r = 1 - e * np.cos(E)
    f = 2 * np.arctan2(math.sqrt(1 + e) * np.sin(E / 2), math.sqrt(1 - e) * np.cos(E / 2))
    return f, n * math.sqrt(1 - e * e) / r**2, r**-3


def torque_of(case, inertia):
    """External torque in the body frame, from time, attitude and rates."""
    if case.name == "spin_up":
        return lambda t, A, w: value(case, "torque")
    if case.name.endswith("top"):
        return lambda t, A, w: value(case, "weight") * np.cross(A[2], value(case, "centre"))
    if case.name.endswith("libration"):

        def gradient(t, A, w):
            f, _, cube = anomaly(case, t)
            u = A.T @ [math.cos(f), math.sin(f), 0.0]
            return 3 * value(case, "mean_motion") ** 2 * cube * np.cross(u, inertia @ u)

        return gradient
    return lambda t, A, w: np.zeros(3)


def start_of(case):
    first = case.reference([0.0])
    return np.array([first[name][0] for name in (*RATES, *QUATERNION)])


def simulated(case, *, inertia=None, rotor=1.0, torque=lambda N, A: N, gyroscopic=1.0, order="q w", half=0.5, y0=None):
    """Samples of a simulator with another law; the right one if nothing is given."""
    I = inertia_of(case) if inertia is None else inertia
    external, k = torque_of(case, I), np.zeros(3)
    if case.name == "gyrostat":
        k[2] = rotor * value(case, "rotor")

    def field(t, y):
        w, q = y[:3], y[3:] / np.linalg.norm(y[3:])
        A = Rotation.from_quat(np.roll(q, -1)).as_matrix()
        a, v = q[0], q[1:]
        turned = np.cross(v, w) if order == "q w" else np.cross(w, v)
        moment = gyroscopic * np.cross(I @ w + k, w) + torque(external(t, A, w), A)
        return np.concatenate([np.linalg.solve(I, moment), [-half * (v @ w)], half * (a * w + turned)])

    y0 = start_of(case) if y0 is None else y0
    size = np.linalg.norm(y0[:3])
    atol = 1e-12 * np.array([size] * 3 + [1.0] * 4)
    y = solve_ivp(field, (0, case.end), y0, "DOP853", t_eval=case.times, rtol=1e-10, atol=atol).y
    y[3:] /= np.linalg.norm(y[3:], axis=0)
    return {"t": case.times, **dict(zip((*RATES, *QUATERNION), y, strict=True))}


def scaled_moment(case, k, factor):
    I = inertia_of(case).copy()
    I[k, k] *= factor
    return I


def exchange(N, A):
    return N[[1, 0, 2]]


def cycle(N, A):
    return N[[1, 2, 0]]


SPACE = "torque acts along the axes of space"
BODY = "torque acts along the axes of the body"
MISTAKES = [
    ("spin_up", {"torque": lambda N, A: A.T @ N}, SPACE),
    ("spin_up", {"torque": lambda N, A: A @ N}, BODY),
    ("spin_up", {"torque": exchange}, "axes of the torque are exchanged: x, y, z hold y, x, z"),
    ("spin_up", {"torque": cycle}, "axes of the torque are exchanged: x, y, z hold y, z, x"),
    ("spin_up", {"torque": lambda N, A: -N}, "torque has the opposite sign"),
    ("spin_up", {"torque": lambda N, A: 0 * N}, "torque is missing: the samples are the motion of the free body"),
    ("spin_up", {"torque": lambda N, A: 1.356 * N}, "torque is 1.356 times as large"),
    ("spin_up", {"gyroscopic": 0.0}, "gyroscopic torque w x I w is missing"),
    ("lagrange_top", {"torque": lambda N, A: A @ N}, BODY),
    ("lagrange_top", {"torque": lambda N, A: -N}, "torque has the opposite sign"),
    ("kovalevskaya_top", {"torque": lambda N, A: A @ N}, BODY),
    ("kovalevskaya_top", {"torque": lambda N, A: A.T @ N}, SPACE),
    ("kovalevskaya_top", {"torque": lambda N, A: 9.81 / 9.80665 * N}, "torque is 1.00034 times as large"),
    ("kovalevskaya_top", {"torque": lambda N, A: N[[1, 0, 2]]}, "x, y, z hold y, x, z"),
    ("pitch_libration", {"torque": lambda N, A: -N}, "torque has the opposite sign"),
    ("pitch_libration", {"torque": lambda N, A: N / 3}, "torque is a third of that of the case"),
    ("pitch_libration", {"torque": lambda N, A: N / 2}, "torque is half of that of the case"),
    ("gyrostat", {"rotor": 0.0}, "rotor is left out"),
    ("gyrostat", {"rotor": -1.0}, "momentum of the rotor has the opposite sign"),
    ("gyrostat", {"rotor": 0.9}, "momentum of the rotor is 0.9 times as large"),
]
MISTAKES += [
    (name, {"order": "w q"}, "multiplied in the wrong order, q' = (0, w) q/2")
    for name in ("free_body", "free_body_products", "gyrostat", "spin_up", "lagrange_top", "kovalevskaya_top")
]
MISTAKES += [(name, {"half": 1.0}, "half of q' = q (0, w)/2 is missing") for name in ("free_body", "pitch_libration")]
MOMENTS = [
    ("free_body", 0, 1.03),
    ("free_body", 1, 0.96),
    ("free_body", 2, 1.002),
    ("free_body_products", 1, 1.05),
    ("gyrostat", 2, 0.97),
    ("spin_up", 2, 1.1),
    pytest.param("lagrange_top", 1, 1.02, marks=pytest.mark.long),
    ("kovalevskaya_top", 0, 0.9),
]


def named_alone(case, mine, words):
    found = case.compare(mine)
    assert not found.passed and not found.unexplained, str(found)
    assert len(found.diagnosis) == 1 and words in found.diagnosis[0], found.diagnosis
    return found.diagnosis[0]


@pytest.mark.parametrize("name", [name for name in SHORT if name != "eccentric_libration"] + [ECCENTRIC])
def test_the_right_law_gives_no_mistake(name):
    case = co.checkcases.get(name, **SHORT[name])
    found = case.compare(simulated(case), tolerance=1e-7)
    assert found.passed and not found.diagnosis, str(found)


@pytest.mark.parametrize(
    ("name", "mistake", "words"), MISTAKES, ids=[f"{n}-{next(iter(m))}-{w[:24]}" for n, m, w in MISTAKES]
)
def test_each_mistake_of_a_law_is_named_alone(name, mistake, words):
    case = co.checkcases.get(name, **SHORT[name])
    named_alone(case, simulated(case, **mistake), words)


@pytest.mark.parametrize(("name", "axis", "factor"), MOMENTS)
def test_one_moment_is_named_with_its_size(name, axis, factor):
    case = co.checkcases.get(name, **SHORT[name])
    mine = simulated(case, inertia=scaled_moment(case, axis, factor))
    percent = f"{abs(factor - 1) * 100:.4g} % {'larger' if factor > 1 else 'smaller'}"
    moment = inertia_of(case)[axis, axis]
    words = f"moment of inertia about {'xyz'[axis]} is {percent}: {factor * moment:.6g}, not {moment:.6g} kg m^2"
    sentence = named_alone(case, mine, words)
    assert "or the" not in sentence


def test_a_moment_of_a_libration_is_named_with_what_has_the_same_motion():
    """In the plane of the orbit the ratio (I_y - I_x)/I_z alone acts."""
    case = co.checkcases.get("pitch_libration", **SHORT["pitch_libration"])
    mine = simulated(case, inertia=scaled_moment(case, 1, 1.05))
    sentence = named_alone(case, mine, "moment of inertia about y is 5 % larger: 126, not 120 kg m^2")
    assert "the torque is 1.15 times as large" in sentence and "these motions are the same" in sentence
    mine = simulated(case, torque=lambda N, A: -N)
    assert "the moments are exchanged: x, y, z have those of y, x, z" in case.compare(mine).diagnosis[0]


@pytest.mark.parametrize("name", ["pitch_libration", ECCENTRIC])
@pytest.mark.parametrize("kept", [RATES, QUATERNION, RATES + QUATERNION], ids=len)
def test_quantities_relative_to_the_orbital_frame_are_named(name, kept):
    """Rates, an attitude, or both."""
    case = co.checkcases.get(name, **SHORT[name])
    mine = simulated(case)
    angle, rate, _ = anomaly(case, mine["t"])
    attitude = Rotation.from_quat(np.column_stack([mine[name] for name in (*QUATERNION[1:], "qw")]))
    turned = (Rotation.from_rotvec(-angle[:, None] * [0, 0, 1]) * attitude).as_quat()
    moved = dict(zip((*QUATERNION[1:], "qw"), turned.T, strict=True)) | {"wz": mine["wz"] - rate}
    found = case.compare(mine | {name: moved[name] for name in kept if name in moved})
    expected = ["rates are relative to the orbital frame"] * ("wz" in kept)
    expected += ["attitude is relative to the orbital frame"] * ("qw" in kept)
    assert not found.unexplained and len(found.diagnosis) == len(expected)
    assert all(any(words in text for text in found.diagnosis) for words in expected), found.diagnosis


def slewed(case, *, inertia, sign=1.0, half=0.5):
    """Samples of a simulator of the slew, period by period."""
    y, rows = start_of(case), []
    K, D, limit, period = (value(case, name) for name in ("stiffness", "damping", "limit", "period"))
    for _ in range(40):
        rows.append(y)
        u = sign * np.clip(-2 * K * np.sign(y[3]) * y[4:] - D * y[:3], -limit, limit)

        def field(t, y, u=u):
            w, a, v = y[:3], y[3], y[4:]
            turned = [-half * (v @ w)], half * (a * w + np.cross(v, w))
            return np.concatenate([np.linalg.solve(inertia, np.cross(inertia @ w, w) + u), *turned])

        y = solve_ivp(field, (0, period), y, "DOP853", rtol=1e-10, atol=1e-13).y[:, -1]
    columns = dict(zip((*RATES, *QUATERNION), np.array(rows).T, strict=True))
    return {"t": period * np.arange(len(rows)), **columns}


@pytest.mark.parametrize(
    ("mistake", "words"),
    [
        ({}, ""),
        ({"sign": -1.0}, "torque has the opposite sign"),
        ({"half": 1.0}, "half of q' = q (0, w)/2 is missing"),
        pytest.param(
            {"inertia": np.diag([110.0, 147.0, 90.0])},
            "about y is 5 % larger: 147, not 140 kg m^2",
            marks=pytest.mark.long,
        ),
    ],
    ids=["right", "sign", "half", "moment"],
)
def test_mistakes_under_sampled_control_are_named(mistake, words):
    """The torque is computed from the samples of the altered motion, and held."""
    case = co.checkcases.get("slew")
    mine = slewed(case, **{"inertia": inertia_of(case)} | mistake)
    if words:
        named_alone(case, mine, words)
    else:
        assert case.compare(mine).passed


@pytest.mark.parametrize("size", [1e-7, 1e30])
def test_mistakes_of_laws_have_no_units(size):
    scaled = {"transverse": 2.0 * size, "axial": 1.5 * size, "torque": (0.3 * size, 0.0, 0.2 * size)}
    case = co.checkcases.get("spin_up", **SHORT["spin_up"], **scaled)
    named_alone(case, simulated(case, torque=lambda N, A: A.T @ N), SPACE)
    named_alone(case, simulated(case, inertia=scaled_moment(case, 2, 1.1)), "moment of inertia about z is 10 % larger")


@pytest.mark.parametrize("kept", [RATES, QUATERNION], ids=["rates", "attitude"])
def test_a_part_of_the_motion_is_enough_for_a_moment(kept):
    """Rates alone or attitudes alone, at times that begin after the start and are not evenly spaced."""
    case = co.checkcases.get("free_body", **SHORT["free_body"])
    mine = simulated(case, inertia=scaled_moment(case, 1, 1.04))
    rows = np.sort(np.random.default_rng(3).choice(np.arange(3, 41), 30, replace=False))
    named_alone(case, {name: mine[name][rows] for name in ("t", *kept)}, "moment of inertia about y is 4 % larger")


@pytest.mark.parametrize("mistake", ["scalar last", "conjugated", "degrees"])
def test_a_moment_is_found_beside_a_convention(mistake):
    """A moment that is wrong hides another mistake: it is found from the quantity that has none."""
    case = co.checkcases.get("free_body", **({} if mistake == "degrees" else {"end": 10.0, "samples": 41}))
    mine = simulated(case, inertia=scaled_moment(case, 1, 0.96))
    w, x, y, z = (mine[name] for name in QUATERNION)
    changes = {
        "scalar last": {"qw": x, "qx": y, "qy": z, "qz": w},
        "conjugated": {"qw": -w},
        "degrees": {name: np.degrees(mine[name]) for name in RATES},
    }
    found = case.compare(mine | changes[mistake])
    assert len(found.diagnosis) == 2 and not found.unexplained, found.diagnosis
    assert "the moment of inertia about y is 4 % smaller: 1.92, not 2 kg m^2" in found.diagnosis
    assert any(mistake in text.replace("its scalar", "scalar") for text in found.diagnosis), found.diagnosis


def test_a_moment_beside_another_law_explains_the_rates_alone():
    case = co.checkcases.get("free_body", end=10.0, samples=41)
    found = case.compare(simulated(case, inertia=scaled_moment(case, 1, 0.96), order="w q"))
    (text,) = found.diagnosis
    assert "about y is 4 % smaller" in text and text.endswith("this explains the rates alone"), text


def test_an_unrelated_motion_has_no_mistake_of_a_law():
    """One number that is fitted does not explain three moments and another start of a body with a torque."""
    case = co.checkcases.get("spin_up", **SHORT["spin_up"])
    y0 = start_of(case)
    y0[:3] = 0.3, -0.2, 0.9
    mine = simulated(case, inertia=np.diag([1.4, 2.4, 1.9]), torque=lambda N, A: N[[2, 0, 1]] * [1.3, -0.6, 0.8], y0=y0)
    mine = {name: values[1:] for name, values in mine.items()}
    found = case.compare(mine)
    assert found.diagnosis == () and found.unexplained, found.diagnosis


def test_rates_relative_to_the_orbital_frame_of_a_body_that_tumbles():
    """A free body is that of a case on an orbit too, and its axes are not those of the orbit."""
    case, n = co.checkcases.get("free_body", **SHORT["free_body"]), 0.7
    case = replace(case, body=replace(case.body, orbital_frame=lambda t: (n * t, n + 0 * t)))
    mine = case.reference()
    attitude = Rotation.from_quat(np.column_stack([mine[name] for name in (*QUATERNION[1:], "qw")]))
    moved = np.column_stack([mine[name] for name in RATES]) - attitude.inv().apply([0.0, 0.0, n])
    found = case.compare(mine | dict(zip(RATES, moved.T, strict=True)))
    assert not found.unexplained and len(found.diagnosis) == 1
    assert "rates are relative to the orbital frame" in found.diagnosis[0]

"""NASA's check-case of a tumbling brick without damping: published trajectories, the closed form, and 40 digits."""

import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import coadjoint as co

CASE = json.loads((Path(__file__).with_name("references") / "tumbling_brick.json").read_text(encoding="utf-8"))
INERTIA = np.array([float(value) for value in CASE["inertia"]])
START = INERTIA * np.radians([float(value) for value in CASE["body_rates"]])
END = 30.0
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


def body(inertia=INERTIA):
    return co.systems.rigid_body(inertia=inertia)


@pytest.mark.thinned(1)
@pytest.mark.parametrize("simulator", ["01", "04"])
@pytest.mark.parametrize("method", SCHEMES, ids=str)
def test_two_published_simulators_have_the_same_motion(method, simulator):
    """The rates to 1e-9 deg/s and the attitude to 1e-8 deg, which are the digits that are published."""
    t, rates, attitudes = published(simulator)
    sol = co.integrate(body(), START, (0.0, END), 0.1, method, attitude=True, save_every=50)
    assert np.abs(sol.t - t).max() < 1e-12
    assert np.abs(np.degrees(sol.x / INERTIA) - rates).max() < 1e-9
    assert degrees_between(attitudes, sol.attitude).max() < 1e-8
    assert np.degrees(sol.x[-1] / INERTIA).round(8).tolist() == [12.61839078, -17.39747476, 31.11958889]


@pytest.mark.parametrize(("simulator", "least", "most"), [("02", 5e-4, 2e-3), ("05", 2e-5, 1e-4), ("06", 1e-3, 5e-3)])
def test_the_other_three_differ_from_the_motion(simulator, least, most):
    """So much that a comparison with them would fail; the sixth is half a millisecond ahead."""
    t, rates, _ = published(simulator)
    off = np.abs(np.degrees(body().exact(START, t) / INERTIA) - rates).max()
    assert least < off < most
    ahead = np.abs(np.degrees(body().exact(START, t[1:] + 5e-4) / INERTIA) - rates[1:]).max()
    assert (ahead < 1e-6) == (simulator == "06")

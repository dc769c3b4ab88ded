"""The Maxwell-Bloch equations: against 40 digits, against the pendulum, and near the separatrix."""

import json
from pathlib import Path

import mpmath as mp
import numpy as np
import pytest
from two_steps import assert_order

import coadjoint as co
from coadjoint.algebra.polynomials.exact_polynomials import ExactPolynomials

REFERENCES = Path(__file__).parents[1] / "verification" / "references" / "lie_poisson_systems.json"
REFERENCE = next(s for s in json.loads(REFERENCES.read_text())["systems"] if s["name"] == "maxwell_bloch_real")
X0 = np.array([0.5, 0.6, 0.8])


def as_pendulum(coupling, x0, t):
    """theta' = E, E' = coupling R sin(theta) with Jacobi's functions of mpmath, in 40 digits; libration and rotation.

    phi = theta - pi hangs: phi'' = -w^2 sin(phi). From the bottom with phi' = 2 w k: sin(phi/2) = k sn(w t | k^2), or
    sn(w k t | 1/k^2). The time from the bottom to the start is an incomplete integral.
    """
    with mp.workdps(40):
        E, P, D = map(mp.mpf, x0)
        R, w = mp.hypot(P, D), mp.sqrt(coupling * mp.hypot(P, D))
        half = mp.atan2(-P, -D) / 2
        k2 = mp.sin(half) ** 2 + (E / (2 * w)) ** 2
        if k2 < 1:
            k = mp.sqrt(k2)
            am = mp.atan2(mp.sin(half) / k, E / (2 * w * k))
            u = mp.ellipf(am, k2) + w * t
            s, c, v = k * mp.ellipfun("sn", u, m=k2), mp.ellipfun("dn", u, m=k2), k * mp.ellipfun("cn", u, m=k2)
        else:
            k = mp.sqrt(k2) * mp.sign(E)
            u = mp.ellipf(half, 1 / k2) + w * k * t
            s, c, v = (mp.ellipfun(f, u, m=1 / k2) for f in ("sn", "cn", "dn"))
            v *= k
        return np.array([float(2 * w * v), float(-2 * R * s * c), float(-R * (c**2 - s**2))])


def test_field_energy_casimir_and_sign():
    system = co.systems.maxwell_bloch(2.5)
    E, P, D = X0
    np.testing.assert_allclose(system.vector_field(X0), [2.5 * P, E * D, -E * P], rtol=0, atol=1e-15)
    assert system.energy(X0) == pytest.approx(E**2 / 2 + 2.5 * D, rel=1e-15)
    assert system.sign == 1 and list(system.casimirs) == ["P^2 + D^2"]
    ring = ExactPolynomials(system.algebra)
    casimir = ring.from_polynomial(system.casimirs["P^2 + D^2"])
    assert all(ring.bracket(casimir, x) == ring.zero for x in ring.coordinates)


@pytest.mark.parametrize("k", range(len(REFERENCE["states"])))
def test_reference_in_40_digits(k):
    system, late = co.systems.maxwell_bloch(), REFERENCE["states"][k]
    wanted = np.array([float(v) for v in late["x"]])
    x0 = [float(eval(v, {"__builtins__": {}})) for v in REFERENCE["x0"]]
    np.testing.assert_allclose(x0, X0, rtol=1e-16)
    # 3/5 and 4/5 are rounded, and the phase goes with them: u t at most
    np.testing.assert_allclose(system.exact(X0, late["t"]), wanted, rtol=0, atol=4e-16 * (1 + late["t"]))
    if late["t"] <= 5:
        for method in (co.Splitting(order=2), co.Splitting(order=4), co.GaussLegendre(stages=2)):
            assert_order(system, X0, float(late["t"]), 0.1, method, wanted)


@pytest.mark.parametrize("seed", range(8))
def test_exact_is_the_pendulum(seed):
    rng = np.random.default_rng(seed)
    coupling, x0, t = rng.uniform(0.2, 3.0), rng.uniform(-2, 2, 3), rng.uniform(-20, 20)
    x0[0] *= 1 + 3 * (seed % 2)
    found = co.systems.maxwell_bloch(coupling).exact(x0, t)
    turns = abs(t) * (abs(x0[0]) / 2 + np.sqrt(coupling * np.hypot(x0[1], x0[2])))  # of the phase: rounding grows so
    np.testing.assert_allclose(found, as_pendulum(coupling, x0, t), rtol=0, atol=1e-15 * (4 + turns))


@pytest.mark.parametrize("gap", [1e-2, 1e-6, 1e-10, 1e-12, -1e-2, -1e-6, -1e-10, -1e-12])
def test_near_the_separatrix(gap):
    x0 = np.array([4.0 + gap, 0.0, -2.0])
    for t in (1.0, 10.0, 20.0):
        found = co.systems.maxwell_bloch(2.0).exact(x0, t)
        np.testing.assert_allclose(found, as_pendulum(2.0, x0, t), rtol=0, atol=1e-13)


def test_on_the_separatrix_and_at_rest():
    system, t = co.systems.maxwell_bloch(2.0), np.array([0.0, 0.5, 3.0])
    # w = 2: phi/2 has the sine tanh(2 t)
    s, c = np.tanh(2 * t), 1 / np.cosh(2 * t)
    for way in (1, -1):
        wanted = np.stack([way * 4 * c, -way * 4 * s * c, 2 * (s * s - c * c)], axis=1)
        np.testing.assert_allclose(system.exact([way * 4.0, 0.0, -2.0], t), wanted, rtol=0, atol=2e-15)
    for rest in ([0.0, 0.0, 2.0], [0.0, 0.0, -2.0], [3.0, 0.0, 0.0], [0.0, 0.0, 0.0]):
        np.testing.assert_array_equal(system.exact(rest, t), [rest] * 3)
    # an atom a little off the top: it falls as cosh(2 t)
    np.testing.assert_allclose(system.exact([0.0, 1e-9, 2.0], 1.0)[1], 1e-9 * np.cosh(2.0), rtol=0, atol=1e-15)


def test_the_state_at_time_zero_is_the_given_one():
    system = co.systems.maxwell_bloch(1.7)
    for x0 in np.random.default_rng(2).uniform(-2.0, 2.0, (10, 3)):
        np.testing.assert_array_equal(system.exact(x0, [0.3, 0.0, -0.0, -2.0])[1:3], [x0, x0])
        np.testing.assert_array_equal(system.exact(x0, 0.0), x0)


def test_the_group_element_turns_by_the_area_of_the_pulse():
    system = co.systems.maxwell_bloch(1.5)
    run = co.integrate(system, X0, (0.0, 6.0), 0.02, co.Splitting(order=4), attitude=True)
    theta = np.unwrap(np.arctan2(run.x[:, 1], run.x[:, 2]))
    area = theta - theta[0]
    turn = np.stack([[np.cos(area), -np.sin(area)], [np.sin(area), np.cos(area)]]).transpose(2, 0, 1)
    np.testing.assert_allclose(run.attitude[:, :2, :2], turn, rtol=0, atol=1e-13)


def test_overflow_of_the_closed_form_is_refused():
    with pytest.raises(ValueError, match="the closed form overflows"):
        co.systems.maxwell_bloch().exact([1e200, 1.0, 1.0], 1.0)

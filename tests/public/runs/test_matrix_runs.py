"""Runs of matrices: ensembles, threads, prepared runs, steppers, observed quantities and failures."""

import copy
import functools
import warnings
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import coadjoint as co
from long import long_where
from refusals import refused

pytestmark = pytest.mark.filterwarnings("ignore:the stream .* is called in Python:RuntimeWarning")


def state_of(system, seed=1):
    """Return a drawn matrix of the algebra of a system, of size one."""
    rng, shape = np.random.default_rng(seed), system.shape
    return system.algebra.projected(rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / shape[-1]


def states(system, count):
    return np.array([state_of(system, seed) for seed in range(count)])


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_drift_of_a_time_dependent_energy(way):
    system = co.MatrixSystem(co.MatrixAlgebra("gl", 3), lambda W, t: dict(P=(1.0 + t) * W)["P"].T)
    W = states(system, 2)
    sol = co.integrate(system, W, (2.0, 2.0 + way), 0.125, save_every=3)
    alone = co.integrate(system, W[1], (2.0, 2.0 + way), 0.125, save_every=3)
    for k, t in enumerate(sol.t):
        assert np.array_equal(sol.energy[k], system.energy(sol.x[k], float(t)))
    drift, off = sol.drift(relative=False)["energy"], sol.energy - sol.energy[0]
    assert (np.sign(off[1:]) == way).all() and np.array_equal(drift.members, np.abs(off).max(axis=0))
    assert np.array_equal(drift.initial, [system.energy(one, 2.0) for one in W])
    # Steps 3, 6 and 8 of 8 are in the tenths 2, 6 and 8.
    assert np.array_equal(drift.tenths[:, [2, 6, 8]], np.abs(off[1:]).T) and np.count_nonzero(drift.tenths) == 6
    assert alone.drift(relative=False)["energy"].tenths.tolist() == drift.tenths[1].tolist()


class TooLarge(Exception):
    """Raised by a function of the user."""


def watched_stream(limit):
    def stream(W):
        if np.abs(W).max() > limit and not np.isnan(W).any():
            raise TooLarge(f"beyond {limit}")
        return dict(P=W)["P"].T

    return stream


@pytest.mark.parametrize("threads", long_where([1], [1, 2]))
def test_exceptions_of_stream_functions_propagate(threads):
    # W' = [W^T, W] makes entries above the diagonal of a triangular matrix fall, and so others rise.
    system = co.MatrixSystem(co.MatrixAlgebra("gl", 3), watched_stream(2.0))
    W = np.array([[0.5, 1.9, 0.0], [0.0, -0.5, 1.9], [0.3, 0.0, 0.1]])
    with refused(TooLarge, "beyond 2"):
        co.integrate(system, [W, 0.1 * W], (0.0, 0.5), 0.05, threads=threads)
    calm = co.integrate(system, 0.1 * W, (0.0, 0.5), 0.05)
    assert np.isfinite(calm.x).all()


COEFFICIENTS = np.array([[1.0, 0.7, 0.2], [0.7, 0.5, 1.3], [0.2, 1.3, 0.4]])


def scaled(factor, W):
    return factor * COEFFICIENTS * W.T


class Hashed:
    def __call__(self, W):
        return scaled(0.5, W)

    def method(self, W):
        return scaled(0.5, W)


@dataclass
class Unhashed:
    """A dataclass that may change has no hash."""

    factor: float

    def __call__(self, W):
        return scaled(self.factor, W)


@dataclass(frozen=True)
class Deep:
    """It has a hash, and its field has none."""

    factors: list

    def __call__(self, W):
        return scaled(self.factors[0], W)


CALLABLES = {
    "Hashed": Hashed(),
    "method": Hashed().method,
    "partial": functools.partial(scaled, 0.5),
    "Unhashed": Unhashed(0.5),
    "Deep": Deep([0.5]),
}


@pytest.mark.thinned(5)
@pytest.mark.parametrize("name", CALLABLES)
@pytest.mark.parametrize("kind", ["gl", "so", "u"])
def test_callable_objects_as_streams(name, kind):
    """Each warns once, and the motion is that of W' = [P, W]."""
    algebra = co.MatrixAlgebra(kind, 3)
    rng = np.random.default_rng(7)
    W = 0.5 * algebra.projected(rng.standard_normal((3, 3)) + (1j * rng.standard_normal((3, 3)) if kind == "u" else 0))
    # Warnings are cached by the value of the function: a copy for each case.
    function = copy.deepcopy(CALLABLES[name])
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        runs = [co.MatrixSystem(algebra, function) for _ in range(2)]
        ends = [co.integrate(run, W, (0.0, 1.0), 0.125, co.IsospectralGauss(3)).x[-1] for run in runs]
    messages = [str(one.message) for one in caught if "is called in Python" in str(one.message)]
    assert len(messages) == 1 and messages[0].startswith(f"the stream {name} is called")
    assert "Numba type" in messages[0]

    def slope(t, y):
        now = y.reshape(3, 3)
        P = scaled(0.5, now)
        return (P @ now - now @ P).ravel()

    exact = solve_ivp(slope, (0.0, 1.0), W.ravel(), "DOP853", rtol=1e-12, atol=1e-14).y[:, -1].reshape(3, 3)
    assert np.array_equal(*ends)
    assert np.abs(ends[0] - exact).max() < 1e-7 and np.abs(exact - W).max() > 1e-3

"""As N grows, both models tend to the Euler equations in their own time, like 1/N^2."""

import numpy as np
import pytest
import spectral_euler

import coadjoint as co
from long import long_beyond

T = 0.5
METHOD = co.IsospectralGauss(3)  # its error is a power of the step times the stream, which grows with N


def check_powers(errors, sizes):
    """Each error is less than the one before by the square of the sizes, near enough where terms of 1/N^4 are left."""
    rates = np.diff(np.log(errors)) / np.diff(np.log(sizes))
    assert np.all(rates < -1.7) and abs(rates[-1] + 2) < 0.2, (errors, rates)


@pytest.mark.parametrize(("rotation", "sizes"), long_beyond(1, [(0.8, (8, 12, 18)), (0.0, (8, 16, 32))]))
def test_the_sphere(rotation, sizes):
    errors, wanted = [], None
    for N in sizes:
        s = co.systems.sphere_euler(N=N, rotation=rotation)
        W = s.random(2, degrees=(1, 3))
        if wanted is None:
            wanted = spectral_euler.Sphere(24, rotation).solve(s.mode_array(s.relative(W)), T, 25)[:7, :7]
            start = s.mode_array(s.relative(W))[:7, :7]
            assert np.abs(wanted - start).max() > 0.3  # it has moved by its own size
        found = s.mode_array(s.relative(co.integrate(s, W, (0, T), 1 / 32, METHOD, save_every=10**6).x[-1]))
        errors.append(np.abs(found[:7, :7] - wanted).max())
    check_powers(errors, sizes)


@pytest.mark.parametrize("sizes", long_beyond(1, [[13, 19, 27], [17, 33, 65]]))
def test_the_torus(sizes):
    errors = []
    for N in sizes:
        s = co.systems.torus_euler(N=N)
        W = s.from_modes({(1, 0): 0.6, (0, 1): -0.5j, (1, 1): 0.4 + 0.3j, (1, -1): 0.2})
        field = s.to_grid(W, (32, 32))
        wanted = spectral_euler.torus(field, 1.0, 25)
        assert np.abs(wanted - field).max() > 0.3
        found = s.to_grid(co.integrate(s, W, (0, 1), 1 / 32, METHOD, save_every=10**6).x[-1], (32, 32))
        errors.append(np.abs(np.fft.fft2(found - wanted)[:3, :3]).max() / 32**2)
    check_powers(errors, sizes)

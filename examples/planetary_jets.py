"""Jets of planetary turbulence whose amplitude falls with the latitude (docs/planets.md): N, "decaying" or "forced"."""

import sys
from pathlib import Path

import numpy as np

import coadjoint as co

BANDS = (0, 20, 40, 60)  # degrees of latitude
END, POINTS = 20.0, 40


def simulate(N, forced, lamb=None, archive=None):
    """Return a run, which an archive continues; a smaller N takes the largest `lamb` that it resolves."""
    lamb, rotation = (1000.0 if forced else 4000.0) if lamb is None else lamb, 1000.0 if forced else 200.0
    if archive and Path(archive).exists():
        return co.resume(archive)
    s = co.systems.sphere_qg(N=N, lamb=min(lamb, (N - 1.0) ** 2), rotation=rotation)
    damped = s.with_forces(co.forces.Viscosity(50.0 / N**8, power=4))
    if forced:
        band = (min(24, N // 3), min(28, N // 2))
        damped = damped.with_forces(co.forces.Friction(0.05), co.forces.RandomForcing(10.0, band, seed=2))
        x0 = s.absolute(np.zeros(s.shape))
    else:
        x0 = s.random(seed=1, degrees=(8, min(20, N // 2)), energy=2 * np.pi)  # the mean of |u|^2/2 is 1/2
    step = min(0.64 / N, 0.4 / abs(s.rossby_speed(1, 1)))  # the fastest wave turns by 0.4
    steps = POINTS * round(END / step / POINTS)
    return co.integrate(
        damped, x0, (0.0, END), END / steps, co.IsospectralGauss(), save_every=steps // POINTS, archive=archive
    )


def zonal_speed(sol):
    """Return latitudes in radians, and there the mean eastward speed of the second half of a run."""
    s = sol.system
    latitude, _ = s.grid()
    psi = s.to_grid(s.stream_of(sol.x[len(sol.t) // 2 :]), absolute=True)
    return latitude, -np.gradient(psi.mean(axis=(0, -1)), latitude)


def by_band(latitude, speed):
    """Return the root mean square of a zonal speed in bands of 20 degrees of latitude, of both hemispheres."""
    area, degrees = np.cos(latitude), np.abs(np.degrees(latitude))
    inside = [(degrees >= low) & (degrees < low + 20) for low in BANDS]
    return [float(np.sqrt(np.average(speed[band] ** 2, weights=area[band]))) for band in inside]


if __name__ == "__main__":
    sol = simulate(int(sys.argv[1]) if len(sys.argv) > 1 else 256, sys.argv[2:] == ["forced"])
    speeds = by_band(*zonal_speed(sol))
    assert speeds[0] > 1.5 * speeds[2], "the jets at the equator are the strongest"
    print("root mean square of the zonal jets by 20 degrees of latitude:", np.round(speeds, 3))

"""Jets of planetary turbulence whose amplitude falls with the latitude (docs/planets.md): N, "decaying" or "forced"."""

import sys

import numpy as np

import coadjoint as co

N = int(sys.argv[1]) if len(sys.argv) > 1 else 256
forced = sys.argv[2:] == ["forced"]
rotation, end, step = 200.0, 20.0, 0.32 / N
s = co.systems.sphere_qg(N=N, lamb=min(1000.0, (N - 1.0) ** 2), rotation=rotation)  # a radius of 1/32 at the poles
damped = s.with_forces(co.forces.Viscosity(50.0 / N**8, power=4))
x0 = s.random(seed=1, degrees=(8, min(20, N // 2)), energy=2 * np.pi)  # the mean of |u|^2/2 is 1/2
if forced:
    band = (min(30, N // 3), min(34, N // 2))
    damped = damped.with_forces(co.forces.Friction(0.05), co.forces.RandomForcing(1.0, band, seed=2))
    x0 = s.absolute(np.zeros(s.shape))
sol = co.integrate(
    damped, x0, (0.0, end), end / round(end / step), co.IsospectralGauss(), save_every=round(end / step / 20)
)

latitude, _ = s.grid()
psi = s.to_grid(s.stream_of(sol.x[len(sol.t) // 2 :]), absolute=True)
zonal = -np.gradient(psi.mean(axis=(0, -1)), latitude)  # the mean eastward speed of the second half
area, degrees = np.cos(latitude), np.abs(np.degrees(latitude))
bands = [(degrees >= low) & (degrees < low + 20) for low in (0, 20, 40)]
speeds = [float(np.sqrt(np.average(zonal[band] ** 2, weights=area[band]))) for band in bands]
assert speeds[0] > 1.5 * speeds[2], "the jets at the equator are the strongest"
print("root mean square of the zonal jets by 20 degrees of latitude:", np.round(speeds, 3))
if N > 64:
    Picture = co.plotting.Picture
    sol.plot([Picture("vorticity", part=part) for part in ("all", "potential", "stream")]).savefig("planetary_jets.png")

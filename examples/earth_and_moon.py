"""A hundred years of spins and orbits of the Earth and the Moon, in steps of a day (docs/two_asteroids.md)."""

import numpy as np
from scipy.spatial.transform import Rotation

import coadjoint as co

masses, radii = np.array([5.972e24, 7.346e22]), np.array([6.378e6, 1.7374e6])  # kg, m
(earth, moon), n = masses * radii**2, 2 * np.pi / (27.321661 * 86400)
shapes = [(0.3296 * earth, 0.3296 * earth, 0.3307 * earth), (0.39265 * moon, 0.39274 * moon, 0.39290 * moon)]
pair = co.systems.gravitating_bodies(shapes, masses, G=6.6743e-11)
r = np.outer([-masses[1], masses[0]], [1, 0, 0]) / masses.sum()
tilted = Rotation.from_euler("x", [[-23.44], [-1.54]], degrees=True)
x0 = pair.state(3.633e8 * r, 1076.0 * np.roll(r, 1, axis=1), tilted, [[0, 0, 7.2921e-5], [0, 0, n]])
steps = co.Splitting(order=4, parts="free_body", compensated=True)
sol = co.integrate(pair, x0, (0, 36500 * 86400), 86400, steps, save_every=365, observe=pair.integrals)
L = np.stack([sol.observed[f"total L{i}"] for i in (1, 2, 3)], axis=1)
moved = np.linalg.norm(L - L[0], axis=1).max() / np.linalg.norm(L[0])
assert moved < 1e-13
print(f"the total angular momentum has moved by {moved:.0e} of its size")

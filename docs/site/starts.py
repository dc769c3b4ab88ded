"""Initial states of gallery entries that are too long to be written out, as code for the pages of the systems."""

SPHERE = """\
k = np.arange({count})
height = 1 - (2 * k + 1) / {count}
angle = np.pi * (3 - np.sqrt(5)) * k  # turns by the golden angle: {count} points on a sphere
distance = np.sqrt(1 - height**2)
x0 = {factor}np.stack([distance * np.cos(angle), distance * np.sin(angle), height], axis=-1)"""

STARTS = {
    "bodies": """\
x0 = system.state(
    positions=[[0, 0, 0], [4, 0, 0]],
    angular_velocities=[[0.01, 0.5, 0.01], [1.0, 0.01, 0.2]],
)""",
    "gravitating_bodies": """\
masses = np.array([1.0, 0.01])
rate = np.sqrt(masses.sum() / 3.0**3)  # of a circle
r = 3.0 * np.array([-masses[1], masses[0]]) / masses.sum()
zero, c, s = np.zeros(2), np.cos(0.4), np.sin(0.4)
x0 = system.state(
    positions=np.stack([r, zero, zero], axis=1),
    velocities=np.stack([zero, rate * r, zero], axis=1),
    attitudes=[np.eye(3), [[c, -s, 0], [s, c, 0], [0, 0, 1]]],
    angular_velocities=[[0.01, 0, 1], [0, 0, rate]],
)""",
    "gyrostat": SPHERE.format(count=16, factor=""),
    "layered_qg": """\
jet = system.fluid.zonal_jet(band=(0.2, 1.2), perturbation=0.05)
x0 = system.absolute([jet, 0 * jet])""",
    "thermal_qg": """\
b = system.fluid.from_modes({(2, 0): -1.0, (1, 0): 0.3}, absolute=True)
small = system.fluid.relative(system.fluid.random(seed=2, degrees=(3, 8)))
x0 = system.absolute([b, 0.2 * small])""",
    "lorenz_1960": SPHERE.format(count=14, factor="") + " * (1, 1, 0.5**0.5)",
    "matrix_body": """\
x0 = np.zeros((5, 5))
x0[np.triu_indices(5, 1)] = np.cos(np.arange(10))
x0 -= x0.T""",
    "maxwell_bloch": """\
fields = [*np.linspace(0.4, 2.8, 9), -2.2, -2.5, -2.8]
x0 = [(field, 0, -1) for field in fields]  # all atoms in the ground state""",
    "paper_rigid_body": SPHERE.format(count=18, factor=""),
    "passive_scalar": """\
fluid = co.systems.sphere_euler(N=33)
latitude = fluid.from_modes({(1, 0): 1})
x0 = np.stack([latitude, fluid.random(seed=3)])""",
    "reduced_mhd": """\
fluid = co.systems.torus_euler(N=33)
potential = fluid.from_modes({(0, 1): 0.5, (2, 0): 0.25})
vorticity = fluid.from_modes({(1, 0): 0.5, (0, 1): 0.5})
x0 = np.stack([potential, vorticity])""",
    "rigid_molecules": """\
a, b = np.array([0.0756950, 0.0585882]) / np.hypot(0.0756950, 0.0585882)
c, s = np.cos(1.0), np.sin(1.0)
donor = [[a, 0, b], [0, 1, 0], [-b, 0, a]]  # a bond of the first molecule points to the second one
acceptor = [[0, -c, s], [1, 0, 0], [0, s, c]]
x0 = system.state(
    positions=[[-0.14, 0, 0], [0.14, 0, 0]],
    attitudes=[donor, acceptor],
    angular_velocities=[[2, 1, 0], [0, -1, 2]],
)""",
    "separable_cosh": SPHERE.format(count=16, factor="3 * "),
    "sphere_euler": "x0 = system.zonal_jet(band=(0.2, 1.2), perturbation=0.1)",
    "sphere_qg": "x0 = system.random(seed=3, degrees=(2, 8))",
    "spin_lattice": """\
x, y = np.indices((18, 18)) - 8.5
angle, tilt = np.pi / 2, 0
for center in (-3.5, 3.5):  # of a vortex, where spins point up
    angle = angle + np.arctan2(y, x - center)
    tilt = tilt + np.exp(-0.4 * ((x - center) ** 2 + y**2))
in_plane = np.sqrt(1 - np.minimum(tilt, 1) ** 2)
x0 = np.stack([in_plane * np.cos(angle), in_plane * np.sin(angle), tilt], axis=-1).ravel()""",
    "surface_qg": "x0 = system.random(seed=3, degrees=(2, 5))",
    "toda_ring": """\
a = 0.5 + 0.35 * np.exp(-0.25 * (np.arange(48) - 11.5) ** 2)
x0 = np.concatenate([np.zeros(48), a])""",
    "torus_euler": "x0 = system.zonal_jet(width=0.5, perturbation=0.1)",
    "torus_qg": "x0 = system.zonal_jet(width=0.5, perturbation=0.1)",
}
"""Lines that set `x0`, by the name of the system, which is `system`; tests compare it with the start of the entry."""

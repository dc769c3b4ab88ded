"""Rigid molecules: forces to many digits, DOP853 in quaternions, invariants, tables."""

import itertools

import mpmath as mp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import coadjoint as co
from long import long_beyond, long_where
from refusals import refused

S = co.systems
# Water that is turned and moved in its frame, a rod with a massless charge, and an atom.
SITES = [
    [(0.5, 0.0, 0.1), (0.55, 0.07, 0.14), (0.55, -0.07, 0.1)],
    [(0.0, 0.0, -0.05), (0.0, 0.0, 0.06), (0.0, 0.0, 0.02)],
    [(0.3, 0.2, 0.1)],
]
CHARGES = [(-0.8, 0.45, 0.15), (-0.4, -0.3, 0.9), (1.0,)]  # each molecule has a charge, whose shift is not cancelled
LJ = [[(0.6, 0.3), (0.1, 0.05), (0.1, 0.04)], [(0.3, 0.25), (0.2, 0.2), (0.0, 0.1)], [(0.4, 0.2)]]
MASSES = [(16.0, 1.0, 1.5), (14.0, 12.0, 0.0), (23.0,)]
MIXTURE = {"sites": SITES, "charges": CHARGES, "lj": LJ, "masses": MASSES, "count": (2, 2, 1)}
PLACES = [[0, 0, 0], [0.35, 0.05, 0.0], [0.1, 0.4, 0.1], [0.05, 0.1, 0.45], [-0.35, 0.1, 0.15]]
SPEEDS = [[0.1, 0.3, 0.0], [-0.2, 0.0, 0.1], [0.0, -0.1, 0.3], [0.4, 0.0, -0.1], [0.0, 0.1, 0.0]]
SPINS = [[2.0, -1.0, 3.0], [0.5, 4.0, -2.0], [1.0, 2.0, 0.0], [-3.0, 1.0, 0.0], [0.0, 0.0, 0.0]]
TURNED = Rotation.from_rotvec([[0.3, -0.2, 0.9], [1.1, 0.4, -0.5], [0.2, 2.0, 0.1], [-1.0, 0.3, 0.3], [0.0, 0.0, 1.0]])
SURROUNDINGS = {
    "droplet": {},
    "cutoff": {"cutoff": 0.5, "switch_from": 0.25, "mixing": "geometric"},
    "box": {"box": (0.9, 1.0, 1.1), "cutoff": 0.44, "switch_from": 0.3, "dielectric": 78.0, "coulomb": 100.0},
}
EXACT_BODIES = {"parts": "free_body"}


def mixture(name="droplet"):
    """Return five molecules of three kinds, and their state; across all sides of the box, if there is one."""
    system = S.rigid_molecules(**MIXTURE, **SURROUNDINGS[name])
    images = np.array([[0, 0, 0], [1, 1, 0], [0, 0, -1], [0, -2, 2], [-1, 0, 1]])
    places = np.array(PLACES) + images * np.array(SURROUNDINGS[name].get("box", (0, 0, 0)))
    return system, system.state(places, SPEEDS, TURNED, SPINS)


def energy_by_formula(q, name):
    """The documented energy of positions and attitudes, (5, 3, 4), to 50 digits."""
    order, given = [0, 0, 1, 1, 2], {"coulomb": 138.935458, "mixing": "", "box": None, **SURROUNDINGS[name]}
    cutoff, begin, eps = (mp.mpf(given.get(key, 1)) for key in ("cutoff", "switch_from", "dielectric"))
    k, sides = (eps - 1) / ((2 * eps + 1) * cutoff**3), given["box"]
    shift = 1 / cutoff + k * cutoff**2 if "cutoff" in given else 0
    places = [np.array([[mp.mpf(v) for v in b] for b in SITES[kind]]) for kind in order]
    masses = [np.array([mp.mpf(w) for w in MASSES[kind]]) for kind in order]
    ends = [
        (b - w @ b / sum(w)) @ q[m, :, :3].T + q[m, :, 3] for m, (b, w) in enumerate(zip(places, masses, strict=True))
    ]
    total = mp.mpf(0)
    for m, n in itertools.combinations(range(5), 2):
        d = q[m, :, 3] - q[n, :, 3]
        moved = (
            np.array([mp.mpf(side) * round(float(one) / side) for one, side in zip(d, sides, strict=True)])
            if sides
            else 0
        )
        distance, energy = mp.sqrt(sum((d - moved) ** 2)), 0
        for a, b in itertools.product(range(len(ends[m])), range(len(ends[n]))):
            s = mp.sqrt(sum((ends[m][a] - ends[n][b] - moved) ** 2))
            (e1, s1), (e2, s2) = (map(mp.mpf, LJ[order[i]][c]) for i, c in ((m, a), (n, b)))
            sixth = ((mp.sqrt(s1 * s2) if given["mixing"] == "geometric" else (s1 + s2) / 2) / s) ** 6
            charge = mp.mpf(given["coulomb"]) * CHARGES[order[m]][a] * CHARGES[order[n]][b]
            energy += charge * (1 / s + k * s**2 - shift) + 4 * mp.sqrt(e1 * e2) * (sixth**2 - sixth)
        x = min(max((distance - begin) / (cutoff - begin), 0), 1) if "cutoff" in given else 0
        total += (1 - 10 * x**3 + 15 * x**4 - 6 * x**5) * energy
    return total


@pytest.mark.parametrize("name", long_where(["droplet"], SURROUNDINGS))
def test_energies_and_forces_to_fifty_digits(name):
    """Sums of some hundred terms, the largest of them some hundred times the sum."""
    system, x = mixture(name)
    free = S.bodies([np.diag(one) if np.ndim(one) == 1 else one for one in inertias(system)], system.masses)
    potential = system.energy(x) - free.energy(x)
    slope = system.hamiltonian.gradient(x) - free.hamiltonian.gradient(x)
    with mp.workdps(50):
        q = np.concatenate([system.attitudes(x), system.positions(x)[..., None]], axis=-1)
        exact = np.array([mp.mpf(v) for v in q.ravel()])
        assert potential == pytest.approx(float(energy_by_formula(exact.reshape(5, 3, 4), name)), rel=1e-12)
        for k in range(60):
            ends = [exact.copy(), exact.copy()]
            h = mp.mpf("1e-16")
            ends[0][k], ends[1][k] = exact[k] + h, exact[k] - h
            right, left = (energy_by_formula(end.reshape(5, 3, 4), name) for end in ends)
            m, i, j = k // 12, k % 12 // 4, k % 4
            found = slope[75 + 3 * m + i] if j == 3 else slope[12 * m + 3 + 3 * i + j]
            assert found == pytest.approx(float((right - left) / (2 * h)), rel=1e-11, abs=1e-11 * np.abs(slope).max())


def test_forces_on_atoms_with_any_number_of_neighbours():
    """Molecule m has 19 - m later ones: each number from 1 to 19 once."""
    k = np.arange(20)
    r = np.stack([0.5 * (k % 3), 0.55 * (k // 3 % 3), 0.6 * (k // 9)], axis=1) + 0.05 * np.sin(7.0 * k)[:, None]
    charge, epsilon, sigma = 0.25, 0.5, 0.375
    system = S.rigid_molecules([(0, 0, 0)], [charge], [(epsilon, sigma)], [1.0], 20)
    free = S.bodies(np.zeros((20, 3)), np.ones(20))
    x = system.state(r)
    found = (system.hamiltonian.gradient(x) - free.hamiltonian.gradient(x))[-61:-1].reshape(20, 3)
    d = r[:, None] - r
    s = np.sqrt((d * d).sum(axis=-1)) + np.eye(20)
    slope = 138.935458 * charge**2 / -(s**2) + 24.0 * epsilon * (sigma**6 / s**7 - 2.0 * sigma**12 / s**13)
    wanted = (slope / s)[..., None] * d
    np.testing.assert_allclose(found, wanted.sum(axis=1), rtol=0, atol=64 * 2.0**-53 * np.abs(wanted).max())


def inertias(system):
    return [inertia.tensor for inertia in system.inertias]


@pytest.mark.parametrize("name", long_where(["droplet", "cutoff"], SURROUNDINGS))
@pytest.mark.thinned(1)
def test_motion_by_dop853_in_quaternions(name):
    system, x0 = mixture(name)
    tensors, m = np.array(inertias(system)), system.masses[:, None]
    moving = [np.linalg.pinv(tensor, rcond=1e-12) for tensor in tensors]

    def slope(t, y):
        r, p, L, q = (part.reshape(5, -1) for part in np.split(y, (15, 30, 45)))
        A, omega = Rotation.from_quat(q).as_matrix(), np.einsum("kij,kj->ki", moving, L)
        g = system.hamiltonian.gradient(np.r_[np.c_[L, A.reshape(5, 9)].ravel(), p.ravel(), r.ravel(), 1.0])
        G = g[:60].reshape(5, 4, 3)[:, 1:]
        torque = np.stack([np.cross(A[k], G[k]).sum(axis=0) for k in range(5)])  # of G, by turning the rows of A
        dq = 0.5 * np.c_[q[:, 3:] * omega + np.cross(q[:, :3], omega), -(q[:, :3] * omega).sum(axis=1)]
        return np.concatenate([(p / m).ravel(), -g[75:90], (np.cross(L, omega) + torque).ravel(), dq.ravel()])

    start = np.r_[np.ravel(system.positions(x0)), (m * SPEEDS).ravel(), x0[:60].reshape(5, 12)[:, :3].ravel()]
    y = solve_ivp(slope, (0, 0.1), np.r_[start, TURNED.as_quat().ravel()], "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    sol = co.integrate(system, x0, (0, 0.1), 0.00025, co.Splitting(order=6, **EXACT_BODIES))
    np.testing.assert_allclose(sol.positions[-1].ravel(), y[:15], rtol=0, atol=1e-9)
    turned = Rotation.from_quat(y[45:].reshape(5, 4)).as_matrix()
    np.testing.assert_allclose(system.attitudes(sol.x[-1]), turned, rtol=0, atol=1e-8)


@pytest.mark.parametrize("name", long_where(["droplet", "cutoff"], SURROUNDINGS))
def test_momentum_and_energy(name):
    """Totals to rounding, of sums over ten pairs in each of 400 steps; the energy to the order of the scheme."""
    system, x0 = mixture(name)
    runs = [co.integrate(system, x0, (0, 0.4), h, co.Splitting(order=4, **EXACT_BODIES)) for h in (0.002, 0.001)]
    assert np.log2(runs[0].drift()["energy"] / runs[1].drift()["energy"]) == pytest.approx(4, abs=1)
    x, p = runs[1].x, system.masses[:, None] * runs[1].velocities
    size = np.abs(p).max()
    assert np.abs(p.sum(axis=1) - p[0].sum(axis=0)).max() < 1e-12 * size
    turning = np.cross(runs[1].positions, p).sum(axis=1) + system.angular_momentum(x, frame="space").sum(axis=1)
    kept = np.abs(turning - turning[0]).max() < 1e-12 * size
    assert kept == (name != "box") and len(system.integrals) == (6 if kept else 3)
    assert np.abs(system.angular_momentum(x)[:, 2:4, 2]).max() < 1e-13 and not system.angular_momentum(x)[:, 4].any()
    for name, F in system.integrals.items():
        index = int(name[-1]) - 1
        assert F(x[-1]) == pytest.approx((turning if "L" in name else p.sum(axis=1))[-1][index], abs=1e-13 * size)


def test_derivatives_of_runs_by_the_state():
    """By exact second derivatives, within the switch, against differences of order six."""
    system, x0 = mixture("box")
    prepared, d = co.prepare(system, co.Splitting(order=2), 0.001), np.cos(np.arange(91.0)) * np.r_[np.ones(90), 0]
    _, tangents = prepared.jvp(x0, (0, 0.02), {"x0": d})

    def end(h):
        return prepared.run(x0 + h * d, (0, 0.02)).x[-1]

    h = 1e-4
    wanted = sum(w * (end(k * h) - end(-k * h)) for k, w in ((1, 45), (2, -9), (3, 1))) / (60 * h)
    np.testing.assert_allclose(tangents.x[-1], wanted, rtol=0, atol=1e-8 * np.abs(wanted).max())


def test_sites_masses_and_moments():
    """The frame of a molecule has the axes of its sites, and its centre of mass as the origin."""
    system, x = mixture()
    assert system.masses.tolist() == [18.5, 18.5, 26.0, 26.0, 23.0]
    sites, first = system.sites(x), 0
    assert sites.shape == (13, 3) and system.sites(np.stack([x, x])).shape == (2, 13, 3)
    for k, kind in enumerate([0, 0, 1, 1, 2]):
        b, w = np.array(SITES[kind]), np.array(MASSES[kind])
        mine = sites[first : first + len(b)]
        np.testing.assert_allclose(w @ mine / w.sum(), PLACES[k], atol=1e-15)
        np.testing.assert_allclose(mine - mine[0], (b - b[0]) @ TURNED[k].as_matrix().T, atol=1e-15)
        d = b - w @ b / w.sum()
        wanted = np.einsum("s,si,sj->ij", w, d, d)
        np.testing.assert_allclose(inertias(system)[k], np.trace(wanted) * np.eye(3) - wanted, rtol=0, atol=1e-15)
        first += len(b)
    water = S.rigid_molecules(count=3)
    assert len(water.masses) == 3 and water.sites(water.state(np.eye(3))).shape == (9, 3)


def test_molecules_outside_the_cutoff_are_free():
    """And the same in other images of a box; one molecule alone is free as well."""
    away = S.rigid_molecules(cutoff=0.5)
    x = away.state([[0, 0, 0], [0.51, 0, 0]])
    assert not away.vector_field(x)[:24].any()
    boxed = S.rigid_molecules(cutoff=0.5, box=1.5)
    inside, image = (boxed.state([[0, 0, 0], [at, 0.2, 0]]) for at in (0.3, -1.2))
    np.testing.assert_allclose(boxed.vector_field(image)[:24], boxed.vector_field(inside)[:24], rtol=1e-12, atol=1e-12)
    assert np.abs(boxed.vector_field(inside)[:24]).max() > 1
    alone = S.rigid_molecules(count=1)
    assert not alone.vector_field(alone.state([[1.0, 2.0, 3.0]])).any()


@pytest.mark.parametrize("axis", range(3))
def test_the_cutoff_is_at_most_half_of_the_smallest_side(axis):
    box = np.full(3, 3.0)
    box[axis] = 1.0
    assert S.rigid_molecules(box=box, cutoff=0.5).parameters["cutoff"] == 0.5
    with refused(ValueError, "cutoff is 0.6", "at most 0.5"):
        S.rigid_molecules(box=box, cutoff=0.6)


LINE = np.array([(0.0, 0.0, -0.116), (0.0, 0.0, 0.0), (0.0, 0.0, 0.116)])
CARBON_DIOXIDE = {
    "charges": (-0.33, 0.66, -0.33, 0.0), "lj": ((0.66, 0.3), (0.23, 0.28), (0.66, 0.3), (0.0, 0.0)),
    "masses": (15.999, 12.011, 15.999, 0.0),
}  # fmt: skip


@pytest.mark.parametrize(
    "beside", long_beyond(2, ["8 decimals", 1e-10, 0.0, 1e-160, 1e-16, 1e-8, "5 decimals"]), ids=str
)
def test_sites_on_a_line_up_to_rounding_are_a_rod(beside):
    """With a massless site; the motion of exact sites, to the rounding of the given ones."""
    sites, axis, rounding = np.vstack([LINE, [(0.0, 0.0, 0.05)]]), np.array((0.0, 0.0, 1.0)), 1e-7
    if isinstance(beside, str):
        axis = np.array((2.0, -1.0, 2.0)) / 3
        sites, rounding = np.round(sites[:, 2:] * axis, int(beside[0])), 10.0 ** (2 - int(beside[0]))
    else:
        sites[1, 0], sites[3, 1] = beside, beside
    spins = np.cross(axis, [(1.0, 2.0, 3.0), (3.0, 0.0, 1.0)])
    ends = []
    for places in (sites, np.array([-0.116, 0.0, 0.116, 0.05])[:, None] * axis):
        pair = S.rigid_molecules(sites=places, **CARBON_DIOXIDE)
        x0 = pair.state([[0, 0, 0], [0.4, 0.05, 0]], angular_velocities=spins)
        sol = co.integrate(pair, x0, (0.0, 0.1), 0.001, co.Splitting(parts="free_body"))
        ends.append(pair.sites(sol.x[-1]))
        assert sol.drift()["energy"] < 1e-3
    assert np.abs(ends[0] - ends[1]).max() < 10 * rounding


@pytest.mark.parametrize("beside", long_beyond(1, (1e-4, 1e-5)))
def test_sites_beside_a_line_are_a_stiff_body(beside):
    """A bent molecule turns about its axis in steps that resolve this motion."""
    sites = LINE.copy()
    sites[1, 0] = beside
    bent = {name: values[:3] for name, values in CARBON_DIOXIDE.items()}
    pair = S.rigid_molecules(sites=sites, **bent)
    x0 = pair.state([[0, 0, 0], [0.4, 0.05, 0]], angular_velocities=[[1.0, 2.0, 3.0], [3.0, 0.0, 1.0]])
    sol = co.integrate(pair, x0, (0.0, 0.01), 1e-4, co.Splitting(parts="free_body"))
    assert sol.drift()["energy"] < 1e-5

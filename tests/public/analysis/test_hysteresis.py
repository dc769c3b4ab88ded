"""Hysteresis loops, switching fields and barriers of spins against closed forms."""

import numpy as np
import pytest

import coadjoint as co
from refusals import refused

PARTICLE = co.spins.micromagnetic((1, 1, 1), (5e-9, 5e-9, 5e-9), Msat=8e5, Aex=0.0, Ku1=4e5)  # 2 K/M = 1 T


def swept(angle, largest=1.2, count=9):
    """Return fields to and fro at an angle to the easy axis."""
    values = np.concatenate([np.linspace(largest, -largest, count), np.linspace(-largest, largest, count)[1:]])
    return values[:, None] * [np.sin(angle), 0.0, np.cos(angle)]


@pytest.mark.parametrize("degrees", [5, 20, 45, 70])
def test_the_stoner_wohlfarth_astroid(degrees):
    angle = np.radians(degrees)
    loop = co.spins.hysteresis(PARTICLE, swept(angle), (0, 0, -1.0), tolerance=5e-4)
    switching = (np.cos(angle) ** (2 / 3) + np.sin(angle) ** (2 / 3)) ** -1.5
    assert len(loop.switching_fields) == 2
    assert np.abs(np.linalg.norm(loop.switching_fields, axis=1) - switching).max() < 1e-3
    assert np.allclose(loop.switching_fields[0], -loop.switching_fields[1], atol=1e-3)
    coercive = switching if degrees < 45 else 0.5 * np.sin(2 * angle)
    assert np.abs(np.linalg.norm(loop.coercive_fields, axis=1) - coercive).max() < 0.01
    # In each field the state is a minimum: cos of the angle to the axis solves the quartic of Stoner and Wohlfarth.
    h, m = loop.fields, loop.magnetization
    torque = np.cross(m, h + m * [0, 0, 1])
    assert np.abs(torque).max() < 1e-8


@pytest.mark.parametrize("length", [0.5, 3.0])
def test_spins_of_other_lengths_switch_in_proportion(length):
    """Anisotropy grows with the square of the length, and the energy in a field with the length."""
    fields = np.array([0.5, -0.9, -1.1])[:, None] * [0, 0, length]
    loop = co.spins.hysteresis(PARTICLE, fields, (0, 0, -length), tolerance=1e-3)
    assert np.abs(loop.switching_fields - [0, 0, -length]).max() < 2e-3 * length and len(loop.jumps) == 1
    assert np.allclose(np.linalg.norm(loop.x, axis=1), length) and abs(loop.magnetization[0, 2] - 1) < 1e-9
    for k in (0, -1):
        assert loop.energy[k] == pytest.approx(PARTICLE.field(loop.fields[k]).energy(loop.x[k]), rel=1e-12)


def test_coercive_fields_of_a_loop_from_remanence():
    """They are where the part along the largest field changes sign, also in a loop that starts at zero or across."""
    fields = swept(np.radians(20))
    known = co.spins.hysteresis(PARTICLE, fields, (0, 0, -1.0), tolerance=5e-4).coercive_fields
    for first in ((0.0, 0.0, 0.0), (0.1, 0.0, 0.0)):
        loop = co.spins.hysteresis(PARTICLE, [first, *fields], (0, 0, -1.0), tolerance=5e-4)
        assert len(known) == len(loop.coercive_fields) == 2
        assert np.allclose(loop.coercive_fields, known, atol=1e-3)


def test_a_loop_across_the_axis_has_no_jump():
    loop = co.spins.hysteresis(PARTICLE, swept(np.pi / 2, count=41), (0, 0, -1.0))
    inside = np.abs(loop.fields[:, 0]) < 0.999
    assert not len(loop.jumps) and np.allclose(loop.magnetization[inside, 0], loop.fields[inside, 0], atol=1e-6)


@pytest.mark.parametrize("unit", [1e-7, 1.0, 1e30])
def test_the_spin_flop_of_a_pair(unit):
    """Two opposite spins become unstable in the field sqrt(A (2 E + A)) along their axis, whatever the unit."""
    J, D = 1.0 * unit, 0.05 * unit
    pair = co.spins.crystal(lattice=(4, 4, 4, 90, 90, 90), sites={"A": [(0, 0, 0), (0.4, 0, 0)]}, space_group="P 1")
    model = co.systems.spins(pair, (1, 1, 1), periodic=False).exchange(pair.bonds(1.7)["1"], J)
    for site in (0, 1):
        model = model.single_ion(site, np.diag([0, 0, -D]))
    flop = np.sqrt(2 * D * (2 * J + 2 * D)) / 2  # g = 2: the energy of a field is -2 B . S
    fields = np.linspace(0, 1.5 * flop, 7)[:, None] * [0, 0, 1]
    loop = co.spins.hysteresis(model, fields, (0, 0, 1.0, 0, 0, -1))
    assert np.abs(loop.switching_fields[:, 2] / flop - 1).max() < 2e-3 and len(loop.jumps) == 1
    after = loop.x[-1].reshape(2, 3)
    assert np.allclose(after[:, 2], 2 * fields[-1, 2] / (2 * J - 2 * D), atol=1e-6)
    assert np.allclose(loop.energy[0], -J - 2 * D, rtol=1e-9)


def test_the_state_stays_in_its_valley():
    """Near the end of a shallow valley, in coarse steps."""
    angle = np.pi / 4
    fields = np.array([1.2, 0.0, -0.3, -0.45, -0.495])[:, None] * [np.sin(angle), 0, np.cos(angle)]
    loop = co.spins.hysteresis(PARTICLE, fields, (0, 0, -1.0))
    assert not len(loop.jumps) and loop.magnetization[-1, 2] > 0.5


def test_dipoles_and_repetition():
    """A pair of dipoles along x: K = 3/2 of the dipolar coupling between them and across; same seed, same bits."""
    m = co.spins.crystal(lattice=(1, 9, 9, 90, 90, 90), sites={"A": (0, 0, 0)})
    model = co.systems.spins(m, (2, 1, 1), g=1.0, periodic=False).dipolar()
    fields = np.array([1.0, -0.9, -1.1])[:, None] * [1, 0, 0]
    loops = [co.spins.hysteresis(model, fields, (1.0, 0, 0) * 2, seed=5, tolerance=0.01) for _ in range(2)]
    assert np.array_equal(loops[0].x, loops[1].x) and np.array_equal(loops[0].fields, loops[1].fields)
    last = model.field(loops[0].fields[-1])
    assert abs(loops[0].energy[-1] - last.energy(loops[0].x[-1])) < 1e-12
    # Opposite rotation needs no field energy: the mode with both spins turned in opposite senses softens at B = 1.
    assert np.abs(loops[0].switching_fields[0, 0] + 1.0) < 5e-3


def test_twisted_lattices_take_fields_along_their_axis():
    """A spiral in an easy plane closes to a cone of the pitch of the twist; a field across the axis is refused."""
    line = co.spins.crystal(lattice=(1, 2, 2, 90, 90, 90), sites={"A": (0, 0, 0)}, space_group="P 1")
    model = co.systems.spins(line, (4, 1, 1), g=1.0, twist=(0.8, 0, 0), axis=(0, 0, 1.0))
    model = model.exchange(line.bonds(1)["1"], -1.0).single_ion("A", np.diag([0, 0, 0.1]))
    turn = 0.2 * np.arange(4)
    x0 = np.stack([np.cos(turn), np.sin(turn), 0.1 + 0 * turn], axis=1)
    x0 /= np.linalg.norm(x0, axis=1, keepdims=True)
    loop = co.spins.hysteresis(model, [(0, 0, 0.01), (0, 0, 0.02)], x0.ravel())
    cosine = loop.fields[:, 2] / (2 * (0.1 - 1 + np.cos(0.2)))
    assert np.allclose(loop.magnetization[:, 2], cosine, atol=1e-6)
    for field in ((0.01, 0, 0), (0, 0.001, 0.01)):
        with refused(ValueError, "twist"):
            co.spins.hysteresis(model, [(0, 0, 0.01), field], x0.ravel())


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"model": co.systems.spin_lattice([], 1)}, "co.systems.spins"),
        ({"model": PARTICLE.with_forces(co.forces.Gilbert(0.1))}, "forces"),
        ({"fields": (0, 0, 1.0)}, "one field (3,) in each row"),
        ({"x0": (0, 0, 1.0, 0)}, "(4,)"),
        ({"tolerance": -1.0}, "tolerance"),
        ({"fields": [(0, 0, np.nan)]}, "finite"),
    ],
)
def test_loops_that_are_refused(given, words):
    good = {"model": PARTICLE, "fields": [(0, 0, 1.0)], "x0": (0, 0, -1.0)}
    with refused((TypeError, ValueError), words):
        co.spins.hysteresis(**good | given)


@pytest.mark.parametrize("unit", [1e-7, 1.0, 1e30])
@pytest.mark.parametrize("h", [0.0, 0.4])
def test_the_barrier_of_one_spin(unit, h):
    """Easy axis K, hard axis L, a field along the path: barrier K (1 - h)^2 and the frequency of the minimum."""
    K, L = 0.7 * unit, 0.5 * unit
    spin = co.systems.spin_lattice([], 1, on_site=(0, -L, K), field=(2 * K * h, 0, 0))
    path = co.spins.minimum_energy_path(spin, (0.6, 0, 0.8), (0, 0.6, -0.8))
    assert abs(path.barrier / (K * (1 - h) ** 2) - 1) < 1e-9
    assert np.allclose(path.saddle / np.linalg.norm(path.saddle), (np.sign(path.saddle[0]), 0, 0), atol=1e-6)
    # Two saddles at h = 0, of one rate each; omega^2 is the product of the stiffnesses in both planes.
    omega = 2 * np.sqrt(K * (1 - h**2) * (K + L))
    assert abs(path.attempt_frequency / (omega / (2 * np.pi)) - 1) < 1e-6
    assert abs(path.energy[0] - path.energy[-1]) < 1e-9 * unit and np.all(np.diff(path.distance) > 0)
    if not h:
        assert abs(path.distance[-1] - np.pi) < 0.02


def test_a_free_rotation_has_no_attempt_frequency():
    path = co.spins.minimum_energy_path(co.systems.spin_lattice([], 1, on_site=(0, 0, 1.0)), (0, 0, 1), (0, 0, -1))
    assert abs(path.barrier - 1) < 1e-9 and np.isnan(path.attempt_frequency)


@pytest.mark.parametrize("J", [0.05, 0.3, 2.0])
def test_the_barrier_of_a_pair(J):
    """Against the lowest pass between both minima on a grid of the angles in the easy plane."""
    from scipy.ndimage import label

    pair = co.systems.spin_lattice([(0, 1)], 2, exchange=J, on_site=(0, -1.0, 1.0))
    path = co.spins.minimum_energy_path(pair, (0, 0, 1.0) * 2, (0, 0, -1.0) * 2, images=11)
    a = np.linspace(-0.5, np.pi + 0.5, 721)
    energy = -J * np.cos(a[:, None] - a) - np.cos(a[:, None]) ** 2 - np.cos(a) ** 2
    ends = [tuple(np.abs(a - angle).argmin() for _ in range(2)) for angle in (0.0, np.pi)]
    low, high = energy[ends[0]], 0.0
    while high - low > 1e-7:
        level = 0.5 * (low + high)
        basins = label(energy <= level)[0]
        low, high = (low, level) if basins[ends[0]] == basins[ends[1]] else (level, high)
    assert abs(path.barrier - (high - energy[ends[0]])) < 1e-4
    if J == 2.0:  # both spins turn together, each by pi; the mode in which they turn apart is stiffer at the minimum
        together, apart, there = (2 * np.sqrt(a * b) for a, b in ((1, 2), (1 + J, 2 + J), (J - 1, J + 1)))
        assert abs(path.attempt_frequency / (together * apart / there / (2 * np.pi)) - 1) < 1e-6
        assert abs(path.distance[-1] - np.sqrt(2) * np.pi) < 0.03
    gradient = pair.vector_field(path.saddle)
    assert np.abs(gradient).max() < 1e-9


def test_paths_that_are_refused():
    spin = co.systems.spin_lattice([], 1, on_site=(0, -1.0, 1.0))
    good = {"system": spin, "start": (0, 0, 1.0), "end": (0, 0, -1.0)}
    for given, words in [
        ({"end": (0.2, 0, 0.98)}, "other lengths"),
        ({"end": (0.6, 0, 0.8)}, "same state"),
        ({"start": (0, 1.0)}, "(2,)"),
        ({"images": 3}, "images"),
        ({"system": co.systems.rigid_body((1, 2, 3)).with_forces(co.forces.Gilbert(0.1))}, "forces"),
        ({"system": co.systems.heavy_top(), "start": np.ones(6), "end": np.ones(6)}, "not made of spins"),
    ]:
        with refused((TypeError, ValueError), words):
            co.spins.minimum_energy_path(**good | given)

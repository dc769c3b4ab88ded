"""Skyrmion numbers of lattices in the plane: windings, integers on periodic lattices, solid angles of open ones."""

import numpy as np
import pytest

import coadjoint as co
from refusals import refused

OBLIQUE = co.spins.crystal(
    lattice=[(1.0, 0.2, 0.1), (0.6, 1.3, -0.4), (0.3, 0.1, 5.0)],
    sites={"A": [(0.1, 0.2, 0.3)], "B": [(0.5, 0.4, 0.3)], "C": [(0.8, 0.9, 0.3)]},
    space_group="P 1",
)


SITES = {  # of a cell, in units of its edges
    "square": [(0, 0)],
    "triangular": [(0, 0)],
    "honeycomb": [(0, 0), (1 / 3, 1 / 3)],
    "kagome": [(0, 0), (1 / 2, 0), (0, 1 / 2)],
}


def lattices(periodic):
    """Yield lattices in the plane with the places of their sites in units of the cell."""
    cells = np.stack(np.indices((9, 11)), axis=-1).reshape(-1, 1, 2)
    for name, sites in SITES.items():
        yield co.systems.spin_lattice(name, (9, 11), periodic=periodic), (cells + sites).reshape(-1, 2), (9, 11)
    flags = (*periodic, False) if isinstance(periodic, tuple) else periodic
    model = co.systems.spins(OBLIQUE, (10, 9, 1), periodic=flags)
    yield model, (model.cells + OBLIQUE.positions[model.sites])[:, :2], (10, 9)


def whirl(places, sizes, turns):
    """Return spins up at the edge and down in the middle, with azimuths that turn so many times about it."""
    u, v = np.moveaxis(places - (np.array(sizes) - 1) / 2, -1, 0)
    azimuth, radius = np.arctan2(v, u), np.hypot(u / sizes[0], v / sizes[1])
    tilt = np.pi * np.clip(1 - radius / 0.4, 0, 1)
    angle = turns * azimuth + 0.3
    return np.stack([np.sin(tilt) * np.cos(angle), np.sin(tilt) * np.sin(angle), np.cos(tilt)], axis=-1)


@pytest.mark.parametrize("periodic", [True, (False, True), False])
@pytest.mark.parametrize("turns", [1, -1, 2])
def test_a_whirl_counts_its_turns(periodic, turns):
    for model, places, sizes in lattices(periodic):
        assert co.spins.skyrmion_number(model, whirl(places, sizes, turns).ravel()) == -turns


def test_periodic_lattices_have_integers_whatever_the_state():
    rng = np.random.default_rng(4)
    for model, _, _ in lattices(True):
        x = rng.normal(size=(5, 2, model.dim)) * rng.uniform(0.1, 3)
        Q = co.spins.skyrmion_number(model, x)
        assert Q.shape == (5, 2) and np.array_equal(Q, np.rint(Q)) and np.abs(Q).max() > 1
        assert np.array_equal(co.spins.skyrmion_number(model, -x), -Q)
        assert np.array_equal(co.spins.skyrmion_number(model, x[0]), Q[0])


def test_an_open_patch_has_its_solid_angle():
    """Directions from the centre of a cube to the points of a face: 4 pi/6. Straight lines become great circles."""
    model = co.systems.spin_lattice("square", (7, 5))
    face = np.stack([*np.meshgrid(np.linspace(-1, 1, 7), np.linspace(-1, 1, 5), indexing="ij"), np.ones((7, 5))], -1)
    assert abs(co.spins.skyrmion_number(model, face.ravel()) - 1 / 6) < 1e-14
    assert abs(co.spins.skyrmion_number(model, (face * [1, 1, -1]).ravel()) + 1 / 6) < 1e-14


def test_layers_and_holes():
    square = co.spins.crystal(lattice=(1, 1, 1, 90, 90, 90), sites={"Fe": (0, 0, 0)}, space_group="P 1")
    model = co.systems.spins(square, (12, 11, 3))
    places = np.stack(np.indices((12, 11)), axis=-1)
    layers = np.stack([whirl(places, (12, 11), turns) for turns in (1, 0, -2)], axis=2)
    assert co.spins.skyrmion_number(model, layers.ravel()).tolist() == [-1, 0, 2]
    assert co.spins.skyrmion_number(model, np.stack([layers.ravel()] * 2)).shape == (2, 3)
    flat = co.systems.spins(square, (12, 11, 1))
    x = whirl(places, (12, 11), 1).reshape(-1, 3)
    holes = flat.vacancies(0.1, seed=3)
    kept = holes.cells[:, 0] * 11 + holes.cells[:, 1]
    without = np.zeros_like(x)
    without[kept] = x[kept]
    Q = co.spins.skyrmion_number(holes, x[kept].ravel())
    assert Q == co.spins.skyrmion_number(flat, without.ravel()) and -1 < Q < -0.2


def test_a_mesh_of_cells_of_any_proportion():
    """Cells 40 times as long as wide."""
    model = co.spins.micromagnetic((16, 13, 1), (2e-9, 8e-8, 1e-9), Msat=8e5, Aex=1e-11, periodic=(True, True, False))
    x = whirl(np.stack(np.indices((16, 13)), axis=-1), (16, 13), 1)
    assert co.spins.skyrmion_number(model, x.ravel()) == -1


def test_what_is_no_lattice_in_the_plane():
    square = co.systems.spin_lattice("square", (3, 3))
    buckled = co.spins.crystal(lattice=(1, 1, 5, 90, 90, 120), sites={"A": (0, 0, 0.1), "B": (1 / 3, 2 / 3, 0.2)})
    for model in (
        co.systems.rigid_body((1, 2, 3)),
        co.systems.spin_lattice("cubic", (3, 3, 3)),
        co.systems.spin_lattice("chain", 9),
        co.systems.spin_lattice([(0, 1)], 9),
        "square",
    ):
        with refused(TypeError, "no lattice in the plane"):
            co.spins.skyrmion_number(model, np.ones(27))
    with refused(ValueError, "heights"):
        co.spins.skyrmion_number(co.systems.spins(buckled, (3, 3, 1)), np.ones(54))
    with refused(ValueError, "27 numbers"):
        co.spins.skyrmion_number(square, np.ones(24))

"""Lattices of spins, and fields on squares and spheres, read back from their artists."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from drawn_runs import T0, Picture, axes_of, made, shown
from matplotlib.quiver import Quiver

import coadjoint as co
from refusals import refused


def test_spins_stand_on_their_sites_and_point_as_they_do():
    lattice = co.systems.spin_lattice("square", (3, 4), tensor=(1.0, 1.0, 0.5))
    x0 = np.random.default_rng(4).normal(size=36)
    run = co.integrate(lattice, x0, (0.0, 1.0), 0.1)
    for at, seen, (u, v, out) in [(0.0, "plane", (0, 1, 2)), (1.0, "side", (0, 2, 1)), (0.5, "plane", (0, 1, 2))]:
        axes = shown(run, Picture("spins", at=at, seen=seen))
        (arrows,) = (drawn for drawn in axes.collections if isinstance(drawn, Quiver))
        S = run.x[round(10 * at)].reshape(-1, 3)
        S = S / np.linalg.norm(S, axis=1).max()
        np.testing.assert_array_equal(arrows.XY, [(i, j) for i in range(3) for j in range(4)])
        np.testing.assert_allclose(np.stack([arrows.U, arrows.V, arrows.get_array()], axis=-1), S[:, [u, v, out]])
        assert f"$t$ = {run.t[round(10 * at)]:g}" in axes.get_title()
        assert axes.get_aspect() == 1.0


def places_of(lattice, shape):
    """Return where the spins of a lattice are drawn."""
    system = co.systems.spin_lattice(lattice, shape)
    return axes_of(made(np.tile([0.6, 0.0, 0.8], (2, system.dim // 3)), system), "spins").collections[0].XY


@pytest.mark.parametrize("lattice", ["square", "triangular", "honeycomb", "kagome"])
def test_neighbours_are_neighbours_in_the_picture(lattice):
    """Bonds, by the exchange of neighbours in the energy, are the shortest distances."""
    system = co.systems.spin_lattice(lattice, (3, 4), periodic=False)
    places, count = places_of(lattice, (3, 4)), system.dim // 3
    H = system.hamiltonian.hessian(np.zeros(system.dim))
    bonds = np.triu(np.abs(H[::3, ::3]) > 0.0, 1)
    between = np.linalg.norm(places[:, None] - places, axis=-1) + 9.0 * np.eye(count)
    np.testing.assert_allclose(between[bonds], 1.0, rtol=1e-14)
    assert np.count_nonzero(np.triu(between < 1.2)) == np.count_nonzero(bonds)


def test_spins_of_space_and_of_any_graph():
    cubic = co.systems.spin_lattice("cubic", (2, 2, 2))
    with refused(co.plotting.CannotShow, "three-dimensional"):
        shown(co.integrate(cubic, np.ones(24), (0.0, 0.1), 0.1), "spins")
    for lattice, count in (("ring", 12), ([(0, 1), (1, 3), (2, 3)], 4), ("ring", 24)):
        x, y = places_of(lattice, count).T
        turn = np.arctan2(x, y) % (2.0 * np.pi)
        # From the top, clockwise, with neighbours about a unit apart; small ones on a circle of radius 1.
        np.testing.assert_allclose(np.hypot(x, y), max(1.0, count / 6.0), rtol=1e-14)
        np.testing.assert_allclose(turn[1:], 2.0 * np.pi * np.arange(1, count) / count, rtol=1e-13)
    body = co.integrate(co.systems.rigid_body((1, 2, 3)), (0.1, 1.0, 0.2), (0.0, 1.0), 0.1)
    assert isinstance(shown(body, "spins").collections[0], Quiver), "one spin of any system"
    with refused(co.plotting.CannotShow, "8"):
        shown(co.integrate(co.systems.toda_ring(4), np.ones(8), (0.0, 1.0), 0.1), "spins")


def test_a_function_on_the_sphere_is_seen_where_it_is():
    """f(n) = x . n + n1 n2 n3, once as a grid, once in the directions of the pixels."""
    rows, columns = 91, 180
    latitude, longitude = np.linspace(-np.pi / 2, np.pi / 2, rows)[:, None], 2.0 * np.pi * np.arange(columns) / columns
    n = np.stack(
        [np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude) + 0 * longitude]
    )

    def f(x, n):
        return np.tensordot(x, n, axes=1) + n[0] * n[1] * n[2]

    run = co.integrate(co.systems.rigid_body((1, 2, 3)), (0.4, -0.3, 0.8), (0.0, 2.0), 0.1)
    for view in ((0.0, 0.0), (35.0, 22.0), (-130.0, -60.0)):
        picture = Picture("sphere field", values=lambda body, x: f(x, n), at=0.5, view=view)
        axes = shown(run, picture)
        (image,) = axes.images
        seen = np.asarray(image.get_array().filled(np.nan))
        edge = np.linspace(-1.0, 1.0, len(seen))
        around, above = np.radians(view)
        towards = np.array([np.cos(above) * np.cos(around), np.cos(above) * np.sin(around), np.sin(above)])
        right = np.array([-np.sin(around), np.cos(around), 0.0])
        up = np.cross(towards, right)
        for i, j in [(150, 150), (40, 160), (200, 80), (150, 290)]:
            across, high = edge[j], edge[i]
            direction = across * right + high * up + np.sqrt(1.0 - across**2 - high**2) * towards
            # bilinear: an eighth of the squares of the cells, 2 degrees, times second derivatives below 4
            assert seen[i, j] == pytest.approx(f(run.x[10], direction), abs=2 * np.radians(2.0) ** 2 / 8 * 4)
        assert np.isnan(seen[0, 0]) and axes.get_aspect() == 1.0
        # start, end and this time share one scale of colours
        assert image.get_clim()[1] == max(np.abs(f(run.x[k], n)).max() for k in (0, 10, 20))


def test_a_field_by_its_values():
    run = co.integrate(co.systems.rigid_body((1, 2, 3)), (0.4, -0.3, 0.8), (0.0, 2.0), 0.1)
    grid = np.add.outer(np.arange(4.0), 10.0 * np.arange(3.0))
    given = {"width": lambda body: 6.0, "label": "heat"}
    axes = shown(run, Picture("field", values=lambda body, x: x[0] * grid, at=1.0, **given))
    assert axes.get_title() == "heat at $t$ = 2" and axes.get_xlim() == (0.0, 6.0) and axes.get_ylim() == (0.0, 6.0)
    with refused(TypeError, "modes"):
        shown(run, Picture("field", **given))


@pytest.mark.parametrize("given", ["modes", "values"])
def test_a_field_stands_along_its_axes_in_one_scale(given):
    """f = x1 X + x2 Y^2 - 3 x3 X: its bands along Y = 0 and along X = 0 are known."""
    s = np.linspace(0.0, 1.0, 11)
    x = np.stack([1.0 - 3.0 * s, 0.25 * s, 0.1 * s], axis=-1)
    edge = np.linspace(0.0, 2.0, 161)
    X, Y = np.meshgrid(edge, edge)
    f = lambda x: (x[0] - 3.0 * x[2]) * X + x[1] * Y**2  # noqa: E731
    options: dict[str, Any] = {"modes": lambda body, X, Y: [X, Y**2, -3.0 * X]}
    if given == "values":
        options = {"values": lambda body, x: f(x)}
    axes = axes_of(made(x), "field", width=lambda body: 2.0, at=0.5, label="w", **options)
    (bands,) = axes.collections
    largest = 2.0 * 2.0 + 0.25 * 4.0 + 0.1 * 6.0 if given == "modes" else max(np.abs(f(x[k])).max() for k in (0, 5, 10))
    np.testing.assert_allclose(bands.levels, np.linspace(-largest, largest, 21), rtol=0, atol=1e-12)
    for low, high, path in zip(bands.levels[:-1], bands.levels[1:], bands.get_paths(), strict=True):
        if len(path.vertices):
            right, up = path.vertices.T
            own = (x[5, 0] - 3.0 * x[5, 2]) * right + x[5, 1] * up**2
            # Interpolation in cells of 2 / 160 is wrong by an eighth of the square times the second derivative.
            assert low - 1e-4 <= own.min() and own.max() <= high + 1e-4
    assert axes.get_title() == f"w at $t$ = {T0 + 0.05:.4g}" and axes.get_xlim() == axes.get_ylim() == (0.0, 2.0)


def test_bonds_of_a_crystal():
    """Each bond between sites of the closed cell is a line of the colour of its class, seen from a direction."""
    pytest.importorskip("gemmi")
    sites = {"Cs": (0, 0, 0), "Cl": (0.5, 0.5, 0.5)}
    salt = co.spins.crystal(lattice=(2, 2, 2, 90, 90, 90), sites=sites, space_group="P m -3 m")
    bonds = salt.bonds(max_distance=2.0)
    assert [bond.multiplicity for bond in bonds] == [8, 3, 3]
    (axes,) = co.plotting.draw_bonds(salt, bonds, view=(0, 0)).axes
    names = [text.get_text() for text in axes.get_legend().get_texts()]
    assert names == ["1: Cs-Cl, 1.732", "2a: Cs-Cs, 2", "2b: Cl-Cl, 2", "Cs", "Cl"]
    lines = [line for line in axes.lines if len(line.get_xdata()) == 2]
    by_colour = {}
    for line in lines:
        by_colour.setdefault((line.get_color(), line.get_alpha()), []).append(line)
    # The edges of the cell; from its centre to its corners; its edges again; and the centre to three neighbours.
    assert sorted(map(len, by_colour.values())) == [3, 8, 12, 12]
    assert len([line for line in axes.lines if len(line.get_xdata()) == 1]) == 8 + 1 + 3
    # From the first axis, the second points to the right and the third up.
    ends = {text.get_text(): text.get_position() for text in axes.texts}
    assert ends["b"][0] > 2 and abs(ends["b"][1]) < 1e-9 and ends["c"][1] > 2 and abs(ends["c"][0]) < 1e-9
    (fewer,) = co.plotting.draw_bonds(salt, bonds[:1]).axes
    assert [text.get_text() for text in fewer.get_legend().get_texts()] == ["1: Cs-Cl, 1.732", "Cs", "Cl"]
    for view in ((1, 2, 3), "side"):
        with refused((ValueError, TypeError), "view"):
            co.plotting.draw_bonds(salt, bonds, view=view)
    other = co.spins.crystal(lattice=(2, 2, 2, 90, 90, 90), sites={"Cs": (0, 0, 0)}, space_group="P m -3 m")
    for crystal, wrong, words in (
        (other, bonds, ("another crystal",)),
        (salt, [1], ("bond", "1")),
        (salt, 2, ("bonds", "2")),
        ("salt", bonds, ("crystal", "salt")),
    ):
        with refused((ValueError, TypeError), *words):
            co.plotting.draw_bonds(crystal, wrong)

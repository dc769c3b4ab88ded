"""Each kind of picture shows what it says, by its numbers."""

import numpy as np
import pytest
from matplotlib.collections import PolyCollection, QuadMesh
from matplotlib.figure import Figure
from matplotlib.quiver import Quiver

import coadjoint as co
from coadjoint.pictures.globe import Globe
from coadjoint.pictures.register import CannotShow, kinds
from coadjoint.pictures.sites import places_of_sites
from coadjoint.systems.lattices import CELLS, graph
from coadjoint.systems.telling import Picture


def shown(run, picture):
    """Return the axes of one picture, without the time that a layout takes."""
    figure = Figure()
    found = kinds()[picture if isinstance(picture, str) else picture.kind]
    axes = figure.add_subplot(projection=found.projection)
    run.plot([picture], axes=axes)
    return axes


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


@pytest.mark.parametrize("lattice", [name for name in CELLS if name != "cubic"])
def test_neighbours_are_neighbours_in_the_picture(lattice):
    shape = (5,) * len(CELLS[lattice].bonds[0][2])
    count, edges = graph(lattice, shape, False)
    places = places_of_sites(lattice, shape, count)
    assert places.shape == (count, 2)
    between = np.linalg.norm(places[:, None] - places, axis=-1) + 9.0 * np.eye(count)
    np.testing.assert_allclose(between[edges[:, 0], edges[:, 1]], 1.0, rtol=1e-14)
    # and no others are: bonds are the shortest distances
    assert np.count_nonzero(np.triu(between < 1.2)) == len(edges)


def test_spins_of_space_and_of_any_graph():
    with pytest.raises(CannotShow, match="fills space"):
        places_of_sites("cubic", (2, 2, 2), 8)
    ring = places_of_sites("ring", 12, 12)
    assert np.ptp(np.linalg.norm(ring - np.roll(ring, 1, axis=0), axis=1)) < 1e-14
    body = co.integrate(co.systems.rigid_body((1, 2, 3)), (0.1, 1.0, 0.2), (0.0, 1.0), 0.1)
    assert isinstance(shown(body, "spins").collections[0], Quiver), "one spin of any system"
    with pytest.raises(CannotShow, match="8 coordinates"):
        shown(co.integrate(co.systems.toda_ring(4), np.ones(8), (0.0, 1.0), 0.1), "spins")


def test_ellipses_have_the_moments():
    beam = co.systems.vlasov_moments(2, "1/2*x20 + 0.1*x20^2")
    run = co.integrate(beam, (1.0, 0.3, 0.5), (0.0, 3.0), 0.05)
    axes = shown(run, Picture("phase ellipse", moments=("x20", "x11", "x02"), times=4, until=0.5))
    curves = [np.array(line.get_data()).T for line in axes.lines[1:]]
    assert len(curves) == 4
    for curve, k in zip(curves, (0, 10, 20, 30), strict=True):
        qq, qp, pp = run.x[k]
        level = np.einsum("ki,ij,kj->k", curve, np.linalg.inv([[qq, qp], [qp, pp]]), curve)
        np.testing.assert_allclose(level, 1.0, rtol=1e-12)
    with pytest.raises(TypeError, match="moments, or a function"):
        shown(run, Picture("phase ellipse"))
    with pytest.raises(CannotShow, match="the state has 3"):
        shown(run, Picture("phase ellipse", moments=(0, 1, 7)))


def test_lumps_are_drawn_where_they_are():
    lumps = co.systems.decorated_particles(weights=(1.0, 2.0), pair=(0.0,))
    x0 = (-1.0, 0.5, 0.4, 1.0, 1.0, 0.02, 0.0, 0.04, 0.06, 0.0, 0.02)
    run = co.integrate(lumps, x0, (0.0, 2.0), 0.05)
    axes = run.plot().axes[2]
    # a thin line of the centre and 7 ellipses for each of both
    assert len(axes.lines) == 2 * 8
    centre, first = axes.lines[8], np.array(axes.lines[9].get_data())
    np.testing.assert_allclose(centre.get_data(), [run.x[:, 1], run.x[:, 3] / 2.0])
    np.testing.assert_allclose(first[:, :-1].mean(axis=1), [0.5, 0.5], atol=1e-14)
    assert np.ptp(first[0]) == pytest.approx(2.0 * np.sqrt(0.06 / 2.0), rel=1e-12)


def test_the_path_in_space_is_the_integral_of_the_velocity():
    body = co.systems.kirchhoff_body()
    run = co.integrate(body, (0.5, 1.5, 1.0, 0.8, 0.1, 0.1), (0.0, 4.0), 0.01, co.Splitting(order=4), attitude=True)
    axes = shown(run, Picture("path in space", axis=1))
    path = np.array(axes.lines[0].get_data_3d()).T
    v = run.x[:, 3:] / np.array(body.parameters["mass"])
    speed = np.einsum("kij,kj->ki", run.attitude[:, :3, :3], v)
    # Simpson's rule: h^4 / 180 times the span and a fourth derivative, here below 100
    end = 0.01 / 3.0 * (speed[0] + speed[-1] + 4.0 * speed[1:-1:2].sum(axis=0) + 2.0 * speed[2:-1:2].sum(axis=0))
    np.testing.assert_allclose(path[-1] - path[0], end, atol=0.01**4 / 180.0 * 4.0 * 100.0 + 1e-8)
    np.testing.assert_array_equal(path, run.attitude[:, :3, 3])
    strokes = np.array(axes.lines[1].get_data_3d()).T.reshape(-1, 3, 3)
    along = strokes[:, 1] - strokes[:, 0]
    np.testing.assert_allclose(along[0] / np.linalg.norm(along[0]), run.attitude[0, :3, 1], atol=1e-12)


def test_what_travels_is_seen_at_its_site_and_time():
    ring = co.systems.toda_ring(8)
    x0 = np.concatenate([np.zeros(8), 0.5 + 0.4 * (np.arange(8) == 2)])
    run = co.integrate(ring, x0, (0.0, 4.0), 0.1)
    axes = run.plot().axes[2]
    (mesh,) = (drawn for drawn in axes.collections if isinstance(drawn, QuadMesh))
    np.testing.assert_array_equal(mesh.get_array(), run.x[:, 8:])
    corners = mesh.get_coordinates()
    assert corners[0, :, 0].tolist() == [i + 0.5 for i in range(9)]
    np.testing.assert_allclose(corners[:, 0, 1], 0.1 * np.arange(42) - 0.05, rtol=0, atol=1e-12)


def test_a_cyclic_portrait_leaves_and_enters():
    light = co.systems.maxwell_bloch()
    run = co.integrate(light, (2.5, 0.0, -1.0), (0.0, 10.0), 0.05, co.GaussLegendre(4))
    (line, start) = run.plot().axes[2].lines
    angle, field = line.get_data()
    assert np.nanmax(np.abs(angle)) <= np.pi and np.count_nonzero(np.isnan(angle)) > 1
    assert np.nanmax(np.abs(np.diff(angle))) < 0.2, "no line goes across"
    # theta' = E from the stable equilibrium, by the equations of the pendulum
    assert np.nanargmax(np.diff(angle[:5]) > 0) == 0
    np.testing.assert_allclose(
        field[~np.isnan(angle)] ** 2 / 2 - np.cos(angle[~np.isnan(angle)]), 2.5**2 / 2 - 1, atol=1e-5
    )
    assert start.get_data()[0][0] == 0.0


def test_many_casimirs_are_the_worst_and_a_band():
    lattice = co.systems.spin_lattice("chain", 9, tensor=(1.0, 0.7, 0.5))
    run = co.integrate(
        lattice, np.random.default_rng(1).normal(size=27), (0.0, 20.0), 0.1, co.ExplicitRungeKutta("rk4")
    )
    axes = shown(run, "drift")
    worst = sorted((-np.abs(v - v[0]).max(), name) for name, v in run.casimirs.items())[:4]
    assert len(axes.lines) == 5
    peaks = sorted(-np.nanmax(line.get_ydata()) for line in axes.lines[1:])
    assert peaks == [size for size, _ in worst]
    (band,) = (drawn for drawn in axes.collections if isinstance(drawn, PolyCollection))
    assert band.get_label() == "all 9 Casimirs"
    heights = band.get_paths()[0].vertices[:, 1]
    every = np.abs(np.stack([v - v[0] for v in run.casimirs.values()]))
    assert (heights.min(), heights.max()) == (every[every > 0].min(), every.max())


def test_a_driven_energy_changes_and_does_not_drift():
    def value(x, t):
        return x[0] * np.cos(t) + 0.5 * x[2] ** 2

    def slope(x, t):
        return np.array([np.cos(t), 0.0, x[2]])

    def curvature(x, t):
        return np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 1.0]])

    driven = co.LiePoissonSystem(co.algebras.so(3), co.Hamiltonian(value, slope, curvature))
    axes = shown(co.integrate(driven, (0.2, 0.5, 1.0), (0.0, 5.0), 0.1, co.GaussLegendre(2)), "drift")
    assert axes.get_title().startswith("change of the driven energy")
    assert axes.get_legend().get_texts()[0].get_text() == "$H$, driven"


def test_observed_quantities_are_drawn():
    top = co.systems.lagrange_top()
    run = co.integrate(top, (0.1, 0.0, 2.0, 0.6, 0.0, 0.8), (0.0, 2.0), 0.1, observe=top.integrals)
    axes = run.plot().axes[2]
    assert axes.get_ylabel() == "observed quantity"
    np.testing.assert_array_equal(axes.lines[0].get_ydata(), run.observed["m3"])


def test_both_vectors_of_so4_keep_their_lengths():
    body = co.systems.so_n_body((1.0, 2.0, 4.0, 5.0))
    run = co.integrate(body, np.random.default_rng(3).normal(size=6), (0.0, 5.0), 0.05)
    from coadjoint.systems.manakov_integrals import halves_of_so4

    for sign in (1.0, -1.0):
        sizes = np.linalg.norm(run.x @ np.array(halves_of_so4(sign)).T, axis=1)
        np.testing.assert_allclose(sizes, sizes[0], rtol=1e-12)


def test_a_globe_shows_the_near_side_strong_and_the_far_side_faint():
    axes = Figure().add_subplot()
    globe = Globe(axes, ("x", "y", "z"), view=(0.0, 0.0))
    before = len(axes.lines)
    turn = np.linspace(0.0, 2.0 * np.pi, 400)
    globe.path(np.stack([np.cos(turn), np.sin(turn), 0.0 * turn], axis=-1), "C0", joined=True)
    near, far = axes.lines[before:]
    assert near.get_alpha() > 3.0 * far.get_alpha()
    # seen along x, what is near has cos > 0
    drawn = ~np.isnan(near.get_xdata())
    assert np.all(np.cos(turn[drawn]) > -0.02) and np.all(np.cos(turn[~np.isnan(far.get_xdata())]) < 0.02)
    np.testing.assert_allclose(near.get_xdata()[drawn], np.sin(turn[drawn]), atol=1e-12)
    globe.mark(np.array([-1.0, 0.0, 0.0]), "C1")
    assert axes.lines[-1].get_markerfacecolor() == "white"

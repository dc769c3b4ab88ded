"""Each kind of picture shows what it says, by its numbers."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest
from drawn_runs import shown
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.quiver import Quiver

import coadjoint as co
from coadjoint.pictures.globe import Globe
from coadjoint.pictures.kinds import body as module
from coadjoint.pictures.kinds.spins import site_positions, sites_of_row
from coadjoint.pictures.plot_data import PlottedRun
from coadjoint.pictures.register import CannotShow, kinds
from coadjoint.systems.gallery_entry import Picture
from coadjoint.systems.lattices.neighbours import CELLS, graph
from coadjoint.systems.registry import gallery_entry_of


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
    places = site_positions(lattice, shape, count)
    assert places.shape == (count, 2)
    between = np.linalg.norm(places[:, None] - places, axis=-1) + 9.0 * np.eye(count)
    np.testing.assert_allclose(between[edges[:, 0], edges[:, 1]], 1.0, rtol=1e-14)
    # and no others are: bonds are the shortest distances
    assert np.count_nonzero(np.triu(between < 1.2)) == len(edges)


@pytest.mark.parametrize("field", ["driven", "for each site"])
def test_a_lattice_is_drawn_as_it_is_where_its_parameters_are_not_kept(field, monkeypatch):
    """A picture of a square lattice must not show a ring."""
    monkeypatch.setattr(sys.modules["coadjoint.systems.lattices.spin_lattice"], "MAX_STORED_VALUES", 10)
    given = (lambda t: (0.0, np.sin(t), 0.5)) if field == "driven" else 0.1 * np.ones((12, 3))
    lattice = co.systems.spin_lattice("square", (3, 4), field=given)
    assert lattice.parameters is None and lattice.layout == {"lattice": "square", "shape": (3, 4)}
    run = co.integrate(lattice, np.tile([0.6, 0.0, 0.8], 12), (0.0, 0.5), 0.1)
    axes = shown(run, "spins")
    assert np.array_equal(axes.collections[0].XY, site_positions("square", (3, 4), 12))
    assert "circle" not in axes.get_title()


@pytest.mark.long
def test_spins_without_a_lattice_say_that_it_is_not_known():
    spins = co.LiePoissonSystem(co.algebras.copies(co.algebras.so(3), 4), co.Quadratic(np.arange(1.0, 13.0)))
    run = co.integrate(spins, np.tile([0.6, 0.0, 0.8], 4), (0.0, 0.5), 0.1)
    assert shown(run, "spins").get_title().endswith("on a circle, since the lattice is not known")
    graph = co.systems.spin_lattice([(0, 1), (1, 3), (2, 3)], 4, field=lambda t: (0.0, np.sin(t), 0.5))
    assert "circle" not in shown(co.integrate(graph, np.tile([0.6, 0.0, 0.8], 4), (0, 0.5), 0.1), "spins").get_title()


def test_spins_of_space_and_of_any_graph():
    with pytest.raises(CannotShow, match="three-dimensional"):
        site_positions("cubic", (2, 2, 2), 8)
    ring = site_positions("ring", 12, 12)
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
    worst = sorted((-(np.abs(v - v[0]) / abs(v[0])).max(), name) for name, v in run.casimirs.items())[:4]
    assert len(axes.lines) == 5
    peaks = sorted(-np.nanmax(line.get_ydata()) for line in axes.lines[1:])
    assert peaks == [size for size, _ in worst]
    (band,) = (drawn for drawn in axes.collections if isinstance(drawn, PolyCollection))
    assert band.get_label() == "all 9 Casimirs"
    heights = band.get_paths()[0].vertices[:, 1]
    every = np.abs(np.stack([(v - v[0]) / abs(v[0]) for v in run.casimirs.values()]))
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


def test_with_forces_invariants_change_and_what_their_work_leaves_is_the_error():
    """A damped body: x' = x cross Omega - c x, in closed form where it spins about an axis."""
    t = np.linspace(0.0, 4.0, 81)
    body = co.systems.rigid_body((1, 2, 3))
    x = np.array([0.0, 0.0, 2.0]) * np.exp(-0.25 * t)[:, None]
    errors = {"energy": 1e-9 * t**2, "|x|^2": -1e-12 * t}
    exact = {"energy": x[:, 2] ** 2 / 6.0, "|x|^2": x[:, 2] ** 2}
    system = body.with_forces(co.forces.LinearDamping(0.25))
    halves = [{name: part * (values - values[0]) for name, values in exact.items()} for part in (0.75, 0.25)]
    run = SimpleNamespace(
        incomplete=None,
        t=t,
        x=x,
        x0=x[0],
        system=system,
        failed=None,
        initial={name: values[0] for name, values in exact.items()},
        energy=exact["energy"] + errors["energy"],
        casimirs={"|x|^2": exact["|x|^2"] + errors["|x|^2"]},
        work={"damping": halves[0], "damping 2": halves[1]},
    )
    drawn = PlottedRun(run)
    assert drawn.gallery_entry is gallery_entry_of("rigid_body") and drawn.dense
    axes = Figure().add_subplot()
    kinds()["drift"].prepare(drawn)(axes)
    assert "change of the energy $H$ and the Casimirs" in axes.get_title() and "drift" not in axes.get_title()
    change, left, _, casimir_left = axes.lines
    assert (change.get_linestyle(), left.get_linestyle()) == ("-", ":")
    energy, casimir = exact["energy"][0], exact["|x|^2"][0]
    np.testing.assert_allclose(change.get_ydata()[1:], np.abs(exact["energy"] / energy - 1)[1:], rtol=1e-6)
    np.testing.assert_allclose(left.get_ydata()[1:], errors["energy"][1:] / energy, rtol=0, atol=2e-15)
    np.testing.assert_allclose(casimir_left.get_ydata()[1:], -errors["|x|^2"][1:] / casimir, rtol=0, atol=2e-15)
    space = Figure().add_subplot(projection="3d")
    kinds()["coadjoint orbit"].prepare(drawn)(space)
    assert "at its start" in space.get_title()


def test_a_section_has_the_crossings():
    body = co.systems.rigid_body(inertia=(1, 2, 3))
    x0 = [(0.1, 1.0, 0.1), (0.2, 1.0, 0.1)]
    run = co.integrate(body, x0, (0.0, 60.0), 0.125, events=[co.Event("x2"), co.Event("x1", name="other")])
    axes = shown(run, Picture("section", event="x2", components=("x3", "x1")))
    assert axes.get_xlabel() == "$x_{3}$" and axes.get_ylabel() == "$x_{1}$"
    for m, line in enumerate(axes.lines):
        own = run.events["x2"].of(m).x
        np.testing.assert_array_equal(np.transpose([line.get_xdata(), line.get_ydata()]), own[:, [2, 0]])
    for seen, options in ((run, {"event": "x9"}), (co.integrate(body, x0, (0.0, 1.0), 0.125), {})):
        with pytest.raises(CannotShow):
            seen.plot([Picture("section", **options)])


def test_observed_quantities_are_drawn():
    top = co.systems.lagrange_top()
    run = co.integrate(top, (0.1, 0.0, 2.0, 0.6, 0.0, 0.8), (0.0, 2.0), 0.1, observe=top.integrals)
    axes = run.plot().axes[2]
    assert axes.get_ylabel() == "observed quantity"
    np.testing.assert_array_equal(axes.lines[0].get_ydata(), run.observed["m3"])


def test_both_vectors_of_so4_keep_their_lengths():
    body = co.systems.so_n_body((1.0, 2.0, 4.0, 5.0))
    run = co.integrate(body, np.random.default_rng(3).normal(size=6), (0.0, 5.0), 0.05)
    from coadjoint.systems.closed_forms.manakov_integrals import halves_of_so4

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


def test_the_vorticity_is_that_of_the_waves_and_moves_by_its_equation():
    """w_t = -u . grad w, kept to the waves: by finite differences on the plane, not by the bracket."""
    triad = co.systems.fluid_triad(first=(1.0, 0.0), second=(0.0, 2.0))
    run = co.integrate(triad, (0.4, 0.9, -0.3), (0.0, 1.0), 0.125)
    gallery_entry = gallery_entry_of("fluid_triad").pictures[0].options
    edge = 2.0 * np.pi * np.arange(64) / 64
    waves = gallery_entry["modes"](triad, *np.meshgrid(edge, edge))
    assert gallery_entry["width"](triad) == pytest.approx(4.0 * np.pi)
    x = run.x[-1]
    w = np.tensordot(x, waves, axes=1)
    # stream function: w = Laplace psi, each wave divided by -k^2; u = (-psi_y, psi_x)
    psi = -np.tensordot(x / np.array([1.0, 4.0, 5.0]), waves, axes=1)

    def slopes(f):
        k = np.fft.fftfreq(64, 1 / 64)
        hat = np.fft.fft2(f)
        return np.fft.ifft2(1j * k * hat).real, np.fft.ifft2(1j * k[:, None] * hat).real

    (w_x, w_y), (psi_x, psi_y) = slopes(w), slopes(psi)
    rate = psi_y * w_x - psi_x * w_y
    kept = [2.0 * np.mean(rate * wave) for wave in waves]
    np.testing.assert_allclose(kept, triad.vector_field(x), atol=1e-12)
    axes = shown(run, Picture("field", **gallery_entry))
    assert axes.get_title() == "vorticity at $t$ = 0" and axes.get_aspect() == 1.0
    other = co.integrate(co.systems.toda(2), np.ones(3), (0, 1), 0.5)
    with pytest.raises(CannotShow, match="1 modes"):
        shown(other, Picture("field", modes=lambda system, X, Y: [X], width=lambda system: 1.0))


def test_the_error_is_the_distance_from_the_closed_form():
    body = co.systems.rigid_body((1, 2, 3))
    starts = np.array([(1.0, 0.2, 0.5), (0.1, -1.0, 0.3)])
    run = co.integrate(body, starts, (2.0, -4.0), 0.1)
    axes = shown(run, "error")
    assert len(axes.lines) == 2 and axes.get_yscale() == "log"
    for m, line in enumerate(axes.lines):
        exact = np.array([body.exact(starts[m], t - 2.0) for t in run.t])
        wanted = np.linalg.norm(run.x[:, m] - exact, axis=1) / np.linalg.norm(starts[m])
        np.testing.assert_allclose(line.get_ydata()[1:], wanted[1:], atol=1e-13)
        assert not line.get_ydata()[0] > 1e-15 and wanted[-1] > 1e-6
    for other in (co.systems.heavy_top(), co.batch([body, co.systems.rigid_body((1, 2, 2.5))])):
        with pytest.raises(CannotShow, match="no closed form is known for"):
            shown(co.integrate(other, np.ones(other.dim), (0.0, 1.0), 0.1), "error")


def test_a_run_of_no_step_and_functions_that_are_not_finite():
    moments = co.systems.vlasov_moments(2, "1/2*x20")
    axes = shown(co.integrate(moments, (1.0, 0.3, 0.5), (0.0, 0.0), 0.1), Picture("phase ellipse", moments=(0, 1, 2)))
    assert len(axes.lines) == 2
    lattice = co.systems.toda(3)
    run = co.integrate(lattice, (0.1, 0.2, 0.3, 0.0, 0.5), (0.0, 1.0), 0.1)  # a_1 = 0: the first two are far apart
    assert len(run.plot().axes[2].lines) == 3


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
    with pytest.raises(TypeError, match="modes, or a function"):
        shown(run, Picture("field", **given))


@pytest.mark.parametrize("count", [31, 50, 100])
def test_long_chains_are_read_like_text(count):
    """Sites run to the right, and each row continues in the next one below."""
    places = site_positions("chain", count, count)
    row = int(np.count_nonzero(places[:, 1] == places[0, 1]))
    assert 1 < row < count and sites_of_row("chain", count) == row
    ends = np.arange(1, count) % row == 0
    steps = np.diff(places, axis=0)
    np.testing.assert_allclose(steps[~ends], np.tile([1.0, 0.0], (np.count_nonzero(~ends), 1)), rtol=0, atol=1e-14)
    assert np.all(steps[ends, 1] < -1.0) and np.all(places[1:][ends, 0] == places[0, 0])
    assert np.array_equal(site_positions("chain", 30, 30), np.stack([np.arange(30.0), np.zeros(30)], axis=-1))


@pytest.mark.parametrize("count", [1, 5, 6, 24])
def test_rings_and_graphs_stand_on_a_circle_with_neighbours_a_unit_apart(count):
    """From the top, clockwise; small ones on a circle of radius 1."""
    x, y = site_positions(None, None, count).T
    radius = max(1.0, count / 6.0)
    turn = np.arctan2(x, y) % (2.0 * np.pi)
    np.testing.assert_allclose(np.hypot(x, y), radius, rtol=1e-14)
    np.testing.assert_allclose(turn[1:], 2.0 * np.pi * np.arange(1, count) / count, rtol=1e-13)
    assert (x[0], y[0]) == (0.0, radius)


@pytest.mark.parametrize("sides", [(1.0, 2.0, 3.0), (3.0, 1.0, 2.0)])
def test_the_box_of_a_body_has_its_moments_of_inertia(sides):
    """A box with half sides a, b, c has the moments b^2 + c^2, ... over its mass / 3; seen along an axis."""
    squares = np.square(sides)
    box = co.systems.rigid_body(squares.sum() - squares)
    run = co.integrate(box, (0.3, 1.0, 0.2), (0.0, 1.0), 0.1, attitude=True)
    for view, across, up in (((0.0, 0.0), 1, 2), ((90.0, 0.0), 0, 2), ((-90.0, 90.0), 0, 1)):
        axes = shown(run, Picture("body", at=0.0, view=view))
        faces = next(part for part in axes.collections if isinstance(part, PolyCollection)).get_paths()
        extent = np.ptp(np.concatenate([face.vertices for face in faces]), axis=0)
        assert extent[0] / extent[1] == pytest.approx(sides[across] / sides[up])


@pytest.mark.parametrize("view", [(30.0, 20.0), (-140.0, -35.0)])
def test_the_box_turns_with_the_body_in_every_frame(view):
    """Its corners are those of the box in the attitude of the time; nearer faces are those seen, lit from one side."""
    sides = np.array([1.0, 2.0, 3.0])
    box = co.systems.rigid_body((sides**2).sum() - sides**2)
    starts = np.array([(0.3, 1.0, 0.2), (2.0, 0.3, -1.0)])
    run = co.integrate(box, starts, (7.3, 10.3), 0.1, attitude=True)
    axes = Figure().add_subplot()
    globe = Globe(Figure().add_subplot(), ("", "", ""), view)
    update = kinds()["body"].prepare(PlottedRun(run, [1]), at=1.0, view=view, axis=1)(axes)
    half = module.BOX_SIZE * sides / np.linalg.norm(sides)
    light = module.DIRECTION_OF_LIGHT
    for k in (len(run.t) - 1, 12, 0, 5):
        update(k)
        A = run.attitude[k, 1]
        normals = np.concatenate([A.T, -A.T])
        seen = normals[(normals @ globe.frame.T)[:, 2] > 0]
        faces = next(part for part in axes.collections if isinstance(part, PolyCollection))
        found = {tuple(np.round(face.vertices[:4].mean(axis=0), 9)) for face in faces.get_paths()}
        extents = np.abs(seen @ A) @ half
        assert found == {tuple(np.round(globe.project(n * d)[0], 9)) for n, d in zip(seen, extents, strict=True)}
        signs = np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1).T
        corners = globe.project((signs * half) @ A.T)[0]
        for face, colour in zip(faces.get_paths(), faces.get_facecolor(), strict=True):
            gaps = np.linalg.norm(face.vertices[:4, None] - corners, axis=-1)
            assert np.all(gaps.min(axis=1) < 1e-12) and len(set(gaps.argmin(axis=1))) == 4
            n = seen[np.argmin([np.linalg.norm(globe.project(n * d)[0] - face.vertices[:4].mean(axis=0))
                                for n, d in zip(seen, extents, strict=True)])]  # fmt: skip
            brightness = 0.55 + 0.45 * max(0.0, globe.frame @ n @ light)
            np.testing.assert_allclose(colour[:3], brightness * module.BOX_COLOUR, rtol=1e-12)
        shaft, tip = axes.lines[-1].get_xydata(), globe.project(A[:, 1])[0]
        np.testing.assert_allclose(shaft, [[0.0, 0.0], tip], atol=1e-12)

"""Pictures of fluids show the field that the matrix stands for, at the right place, with the right sign."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from drawn_runs import SENSES, T0, Picture, axes_of, colour, data, made, partial, shown

import coadjoint as co
from long import long_beyond
from refusals import refused


@pytest.fixture(scope="module")
def ball():
    s = co.systems.sphere_euler(N=16)
    return co.integrate(s, s.random(3, degrees=(2, 6)), (0.0, 2.0), 0.02, co.IsospectralGauss(), save_every=10)


@pytest.fixture(scope="module")
def square():
    s = co.systems.torus_euler(N=15)
    W = s.from_modes({(1, 2): 0.5, (2, 0): 0.3j, (0, 1): -0.2})
    return co.integrate(s, W, (0.0, 1.0), 0.05, co.IsospectralGauss())


def test_the_torus_is_shown_with_x_to_the_right_and_y_up(square):
    axes = shown(square, Picture("vorticity", at=0.0))
    (image,) = axes.get_images()
    pixels = image.get_array()
    side = pixels.shape[0] - 1
    x = 2 * np.pi * np.arange(side + 1) / side
    X, Y = np.meshgrid(x, x)
    # sum of w exp(i (n1 x - n2 y)) and conjugates
    wanted = np.cos(X - 2 * Y) - 0.6 * np.sin(2 * X) - 0.4 * np.cos(Y)
    np.testing.assert_allclose(pixels, wanted, atol=1e-13)
    assert axes.get_xlabel() == "$x$" and image.get_extent() == [0.0, 2 * np.pi, 0.0, 2 * np.pi]


def test_colours_are_shared_and_symmetric_and_may_be_limited(ball):
    grid = (129, 256)
    largest = max(np.abs(ball.system.to_grid(ball.x[k], grid)).max() for k in (0, -1))
    for at in (0.0, 1.0):
        (image,) = shown(ball, Picture("vorticity", at=at)).get_images()
        assert image.get_clim() == pytest.approx((-largest, largest), rel=1e-12)
    (image,) = shown(ball, Picture("vorticity", limit=0.5)).get_images()
    assert image.get_clim() == (-0.5, 0.5) and image.colorbar.extend == "both"
    assert image.colorbar.ax.get_ylabel() == "vorticity"


@pytest.mark.parametrize("name", ["sphere_euler", "planet", "torus_euler"])
def test_parts_add_up_and_the_large_one_is_steady(name):
    """The large part is that of the relative vorticity that commutes with the stream matrix."""
    s = co.systems.sphere_euler(N=9, rotation=2.0) if name == "planet" else co.systems.get(name, N=9)
    W = s.random(3, degrees=(2, 4))
    run, arrays = made(np.stack([W, W]), s), {}
    for part in ("all", "large", "small", "stream"):
        arrays[part] = shown(run, "vorticity", part=part).get_images()[0].get_array()
    np.testing.assert_allclose(arrays["large"] + arrays["small"], arrays["all"], atol=1e-13)
    P, relative = s.stream_of(W), s.relative(W)
    values, V = np.linalg.eigh(1j * P)
    large = sum(np.outer(v, v.conj()) @ relative @ np.outer(v, v.conj()) for v in V.T)
    assert np.diff(values).min() > 1e-6 * np.abs(values).max(), "projections on single vectors"
    for part, matrix in (("all", relative), ("large", large), ("stream", P)):
        if name == "torus_euler":
            wanted = s.to_grid(matrix, (128, 128), absolute=True).T
            np.testing.assert_allclose(arrays[part][:-1, :-1], wanted, atol=1e-13 * np.abs(wanted).max())
        else:
            longitudes = arrays[part].shape[1]
            largest = np.abs(s.to_grid(matrix, (longitudes // 2 + 1, longitudes), absolute=True)).max()
            assert np.abs(np.ma.filled(arrays[part], 0.0)).max() == pytest.approx(largest, rel=0.02)
    assert np.vdot(P, large).real == pytest.approx(np.vdot(P, relative).real, rel=1e-12)


@pytest.mark.parametrize("projection", ["mollweide", "outside"])
@pytest.mark.parametrize("centre", [(0.0, 0.0), (70.0, 0.0), (-110.0, 50.0)])
def test_maps_show_the_vorticity_of_their_places(projection, centre):
    """A field of degree one is linear in the direction: a . n, with north up and east to the right of the centre."""
    s = co.systems.sphere_euler(N=8)
    W = s.random(1, degrees=(1, 1))
    grid = s.to_grid(W, (3, 4))  # latitudes 90, 0, -90 degrees, longitudes 0, 90, 180, 270
    a = np.array([grid[1, 0], grid[1, 1], grid[0, 0]])
    axes = shown(made(np.stack([W, W]), s), "vorticity", projection=projection, centre=centre)
    pixels = axes.get_images()[0].get_array()
    rows, columns = pixels.shape
    y, x = (2 * np.arange(rows)[:, None] + 1) / rows - 1, (2 * np.arange(columns) + 1) / columns - 1
    with np.errstate(invalid="ignore"):
        if projection == "outside":
            right, up, towards = x, y, np.sqrt(1 - x**2 - y**2)
        else:
            latitude = np.arcsin((2 * np.arcsin(y) + np.sin(2 * np.arcsin(y))) / np.pi)
            longitude = np.where(np.hypot(x, y) < 1, np.pi * x / np.sqrt(1 - y**2), np.nan)
            up, flat = np.sin(latitude), np.cos(latitude)
            right, towards = flat * np.sin(longitude), flat * np.cos(longitude)
    around, above = np.radians(centre)
    middle = np.array([np.cos(above) * np.cos(around), np.cos(above) * np.sin(around), np.sin(above)])
    east = np.array([-np.sin(around), np.cos(around), 0.0])
    wanted = towards * (a @ middle) + right * (a @ east) + up * (a @ np.cross(middle, east))
    found = np.ma.filled(pixels, np.nan)
    both = np.isfinite(wanted) & np.isfinite(found)
    assert both.sum() > 0.98 * np.isfinite(wanted).sum()
    # Bilinear between points of a grid: an eighth of the squares of its cells, and a table of Mollweide's angle.
    assert np.abs(wanted - found)[both].max() < 1e-3 * np.abs(a).max()


def test_the_stream_function_has_the_sign_of_minus_the_vorticity():
    s = co.systems.sphere_euler(N=8)
    W = s.from_modes({(3, 2): 0.7 - 0.2j})
    run = co.integrate(s, W, (0.0, 0.1), 0.05, co.IsospectralGauss())
    omega, psi = (
        shown(run, Picture("vorticity", at=0.0, part=part)).get_images()[0].get_array() for part in ("all", "stream")
    )
    np.testing.assert_allclose(psi, -omega / 12.0, atol=1e-14)


def test_eigenvalues_and_relative_drift(ball):
    axes = shown(ball, "eigenvalues")
    spectrum = ball.system.spectrum(ball.x[0])
    np.testing.assert_allclose(axes.lines[0].get_ydata(), spectrum / np.abs(spectrum).max(), rtol=1e-13)
    moved = float(axes.get_title().partition("moved by ")[2].partition(" ")[0])
    assert moved < 1e-13
    axes = shown(ball, "drift")
    assert axes.get_ylabel() == "relative deviation from start"
    lines = {line.get_label(): np.nanmax(line.get_ydata()) for line in axes.lines}
    cube = np.abs(ball.casimirs["tr W^3"] - ball.casimirs["tr W^3"][0]).max()
    cube /= ball.drift()["tr W^3"].scale
    assert lines[r"$\mathrm{tr}\,W^3$"] == pytest.approx(cube, rel=1e-6, abs=0.0) and 0.0 < cube < 1e-13
    assert lines["$H$"] == pytest.approx(np.abs(ball.energy / ball.energy[0] - 1).max())


@pytest.mark.long
def test_a_run_is_drawn_in_pairs_of_low_pictures(ball):
    figure = ball.plot()
    panels = [axes for axes in figure.axes if axes.get_label() != "<colorbar>"]
    titles = [axes.get_title().partition(":")[0].partition(",")[0] for axes in panels]
    first, last = (f"vorticity at $t$ = {t:.4g}" for t in ball.t_span)
    assert titles[1:] == ["energy by scale", first, last, "spectra of energy and enstrophy", "spectrum of $W$"]
    figure.draw_without_rendering()
    left = [axes.get_position().x0 for axes in panels]
    assert left[0] == left[1] < left[2] < left[4] and left[4] == pytest.approx(left[5], abs=0.05)
    assert panels[2].get_position().y0 > panels[3].get_position().y1


def test_matrices_of_ones_own_show_their_eigenvalues():
    a = np.array([1.0, 2.0, 3.0, 4.0])
    body = co.MatrixSystem(co.MatrixAlgebra("so", 4), co.systems.Weights(1 / np.add.outer(a, a)), name="body of mine")
    W = body.algebra.projected(np.arange(16.0).reshape(4, 4))
    run = co.integrate(body, W, (0.0, 1.0), 0.05, co.IsospectralGauss())
    titles = [axes.get_title() for axes in run.plot().axes]
    assert titles[-1].startswith("spectrum of $W$") and "components" in titles[1]
    with refused(co.plotting.CannotShow, "body of mine", "vorticity"):
        run.plot("vorticity")


@pytest.mark.parametrize("name", ["reduced_mhd", "passive_scalar"])
def test_a_second_field_is_shown_beside_the_vorticity(name):
    fluid = co.systems.torus_euler(N=9)
    theta, W = fluid.from_modes({(1, 1): 0.5j}), fluid.random(2, degrees=(1, 2))
    s = co.systems.get(name, N=9, surface="torus")
    run = co.integrate(s, np.stack([theta, W]), (0.0, 0.5), 0.05, co.IsospectralGauss())
    (carried,) = shown(run, Picture("vorticity", at=0.0, part="carried")).get_images()
    np.testing.assert_allclose(carried.get_array()[:-1, :-1], fluid.to_grid(theta, (128, 128)).T, atol=1e-14)
    (image,) = shown(run, Picture("vorticity")).get_images()
    np.testing.assert_allclose(image.get_array()[:-1, :-1], fluid.to_grid(run.x[-1, 1], (128, 128)).T, atol=1e-13)
    axes = shown(run, "eigenvalues")
    values = np.linalg.eigvalsh(-1j * theta)
    np.testing.assert_allclose(axes.lines[0].get_ydata(), values / np.abs(values).max(), atol=1e-14)
    assert r"\Theta" in axes.get_title() and float(axes.get_title().split("by ")[1].split()[0]) < 1e-13
    axes = shown(run, "drift")
    mixed = run.casimirs["tr W Theta"]
    size = np.linalg.norm(theta) * np.linalg.norm(W)
    assert axes.get_ylabel() == "relative deviation from start"
    assert np.abs(mixed - mixed[0]).max() / size < 1e-13
    for line in axes.lines:
        if not line.get_label().startswith("$H"):
            assert np.nanmax(line.get_ydata(), initial=0.0) < 1e-13


def test_complex_spectra_are_drawn_in_the_plane():
    s = co.MatrixSystem(co.MatrixAlgebra("gl", 3), co.systems.Weights(np.full((3, 3), 0.5) + np.eye(3)), name="of gl")
    W = np.array([[0.0, 1.0, 0.2], [-1.0, 0.1, 0.0], [0.3, 0.0, 0.5]])
    run = co.integrate(s, W, (0.0, 0.5), 0.05, co.IsospectralGauss())
    axes = shown(run, "eigenvalues")
    values = np.linalg.eigvals(W)
    drawn = axes.lines[0].get_xdata() + 1j * axes.lines[0].get_ydata()
    np.testing.assert_allclose(np.sort_complex(drawn), np.sort_complex(values) / np.abs(values).max(), atol=1e-12)
    assert "imaginary" in axes.get_ylabel()


def test_what_is_no_fluid_is_refused_by_name(ball):
    body = co.integrate(co.systems.rigid_body((1, 2, 3)), (0.1, 1.0, 0.2), (0.0, 1.0), 0.1)
    for kind in ("vorticity", "field spectra", "energy by scale"):
        with refused(co.plotting.CannotShow, "rigid_body", "vorticity"):
            body.plot(kind)
    with refused(co.plotting.CannotShow, "rigid_body", "matrix"):
        body.plot("eigenvalues")
    for options, said in [
        ({"part": "lage"}, "did you mean 'large'"),
        ({"projection": "molweide"}, "did you mean 'mollweide'"),
        ({"part": "carried"}, "carries no second field"),
        ({"limit": 0.0}, "limit"),
        ({"centre": (0.0, np.nan)}, "latitude of centre"),
    ]:
        with refused(ValueError, said):
            ball.plot([Picture("vorticity", **options)])


@pytest.mark.parametrize("size", long_beyond(1, [0.0, 0.3]))
def test_small_matrices_rest_and_backward_spans_are_drawn(size):
    for s in (co.systems.sphere_euler(N=2, rotation=0.5), co.systems.torus_euler(N=3)):
        run = co.integrate(s, size * s.random(1, degrees=(1, 1)), (0.2, 0.0), 0.1, co.IsospectralGauss())
        for kind in ("drift", "energy by scale", "field spectra", "eigenvalues"):
            shown(run, kind).figure.draw_without_rendering()
        assert [shown(run, Picture("vorticity", at=at)).get_title() for at in (0.0, 1.0)] == [
            "vorticity at $t$ = 0.2",
            "vorticity at $t$ = 0",
        ]


def test_spectra_of_matrices_over_the_part_of_the_eigenvalues_below():
    fluid = co.systems.torus_euler(5)
    W = np.stack([fluid.random(seed, degrees=(1, 2)) for seed in (1, 2, 3)])
    axes = axes_of(made(W, fluid), "eigenvalues", at=0.5)
    size = np.abs(fluid.spectrum(W[0])).max()
    for line, k in zip(axes.lines, (0, 1), strict=True):
        np.testing.assert_allclose(data(line), [(np.arange(5) + 0.5) / 5, fluid.spectrum(W[k]) / size], atol=1e-14)
    moved = np.abs(fluid.spectrum(W[1]) - fluid.spectrum(W[0])).max() / size
    assert axes.get_title() == f"spectrum of $W$: moved by {moved:.1e} of the largest"
    again = axes_of(made(W[:, None] * [[[[1.0]], [[2.0]]]], fluid), "eigenvalues", [1], at=0.5)
    np.testing.assert_allclose(data(again.lines[1]), data(axes.lines[1]), atol=1e-14)


def test_the_six_scales_with_the_largest_share_at_any_time_are_drawn():
    fluid = co.systems.sphere_euler(12)
    # Two scales have a share at all times, six others a larger one at one time, of another size each.
    always = fluid.random(4, degrees=(2, 3))
    parts = [fluid.random(1, degrees=(k, k + 1)) for k in (9, 4, 6)]
    W = np.stack(
        [
            c * (part / fluid.energy(part) ** 0.5 + 0.6 * always / fluid.energy(always) ** 0.5)
            for c, part in zip((0.1, 1.0, 3.0), parts, strict=True)
        ]
    )
    axes = axes_of(made(W, fluid, np.array([T0, T0 - 1.0, T0 - 5.0])), "energy by scale")
    energies = np.array([fluid.energy_spectrum(w)[1] for w in W])
    shares = energies / energies.sum(axis=1)[:, None]
    largest, means, sizes = (
        np.sort(np.argsort(-values)[:6]) for values in (shares.max(axis=0), shares.mean(axis=0), energies.max(axis=0))
    )
    assert largest.tolist() != means.tolist() and largest.tolist() != sizes.tolist()
    assert [line.get_label() for line in axes.lines] == [f"$l = {i + 1}$" for i in largest]
    for line, i in zip(axes.lines, largest, strict=True):
        np.testing.assert_allclose(data(line), [[T0, T0 - 1.0, T0 - 5.0], shares[:, i]], rtol=1e-12, atol=1e-15)
    assert axes.get_ylim()[0] == 0.0


def test_circles_of_latitude_and_meridians_of_a_map():
    fluid = co.systems.sphere_euler(5)
    W = fluid.random(1, degrees=(1, 2))
    axes = axes_of(made(np.stack([W, W]), fluid), "vorticity", projection="outside", centre=(30.0, 0.0))
    edge, *lines = axes.lines
    np.testing.assert_allclose(np.hypot(*edge.get_data()), 1.0, atol=1e-12)
    for line, latitude in zip(lines[:5], (-60, -30, 0, 30, 60), strict=True):
        x, y = data(line)
        np.testing.assert_allclose(y[np.isfinite(y)], np.sin(np.radians(latitude)), atol=1e-12)
        assert np.nanmax(np.abs(x)) == pytest.approx(np.cos(np.radians(latitude)), rel=1e-3)
    for line, longitude in zip(lines[5:], (-180, -120, -60, 0, 60, 120), strict=True):
        x, y = data(line)
        known = np.isfinite(x)
        away = np.radians(longitude - 30.0)
        assert known.any() == bool(np.cos(away) > 1e-9) or abs(np.cos(away)) < 1e-9
        np.testing.assert_allclose(x[known], np.sin(away) * np.sqrt(1.0 - y[known] ** 2), atol=1e-7)
    wide = axes_of(made(np.stack([W, W]), fluid), "vorticity").lines[0]
    np.testing.assert_allclose(np.max(wide.get_data(), axis=1), [2.0, 1.0])


@pytest.mark.parametrize("bad", [0, 1])
def test_fluids_whose_first_member_fails_have_no_spectrum_at_the_end(bad):
    fluid = co.systems.torus_euler(5)
    W = [fluid.random(1, degrees=(1, 2)), fluid.random(2, degrees=(1, 2))]
    W[bad] = 1e5 * W[bad]
    run = partial(fluid, np.stack(W), (T0, T0 + 1.0), 0.1)
    assert run.failed[bad]
    titles = [axes.get_title() for axes in run.plot(["energy by scale", Picture("vorticity", at=1.0)]).axes]
    assert "energy by scale of member 0" in titles and f"vorticity of member 0 at $t$ = {run.t[-1]:.4g}" in titles
    known = np.isfinite(run.x[:, 0]).all(axis=(1, 2))
    for line in axes_of(run, "energy by scale").lines:
        np.testing.assert_array_equal(np.isfinite(line.get_ydata()), known)
    (image,) = axes_of(run, "vorticity", at=1.0).images
    assert np.isfinite(np.ma.filled(image.get_array(), np.nan)).all() == (bad == 1)
    assert np.isfinite(image.get_clim()).all() and image.get_clim()[1] > 0.0
    assert len(axes_of(run, "eigenvalues", at=0.0).lines) == 2
    if bad == 0:
        with refused(co.plotting.CannotShow, "8.3"):
            axes_of(run, "eigenvalues")
    else:
        assert len(axes_of(run, "eigenvalues").lines) == 2


@functools.cache
def fluid(surface: str, sense: float = 1.0) -> co.Solution:
    system = co.systems.sphere_euler(7) if surface == "sphere" else co.systems.torus_euler(7)
    rng = np.random.default_rng(5)
    W = system.algebra.projected(rng.normal(size=(7, 7)) + 1j * rng.normal(size=(7, 7)))
    return co.integrate(system, 2.0 * W, (T0, T0 + sense * 2.0), 0.0625, save_every=3)


@pytest.mark.thinned(1)
@pytest.mark.parametrize("sense", SENSES)
@pytest.mark.parametrize("surface", ["sphere", "torus"])
def test_spectra_and_shares_are_those_of_their_times(surface, sense):
    run = fluid(surface, sense)
    system, k = run.system, int(np.argmin(np.abs(run.t - run.t[[0, -1]].mean())))
    axes = shown(run, Picture("field spectra", at=0.5))
    for place, spectrum in enumerate((system.energy_spectrum, system.enstrophy_spectrum)):
        lines = {line.get_linestyle(): line for line in axes.lines if line.get_color() == colour(place)}
        for style, j in (("--", 0), ("-", k)):
            scales, values = (np.asarray(part, dtype=np.float64) for part in spectrum(run.x[j]))
            np.testing.assert_array_equal(data(lines[style]), [scales, np.where(values > 0.0, values, np.nan)])
            assert lines[style].get_label().endswith(f"$t$ = {run.t[j]:.4g}")
    drawn = np.concatenate([line.get_ydata() for line in axes.lines])
    drawn = drawn[drawn > 1e-8 * np.nanmax(drawn)]
    np.testing.assert_allclose(axes.get_ylim(), [drawn.min() / 2, 3 * drawn.max()], rtol=1e-12)
    shares = shown(run, "energy by scale")
    scales = np.asarray(system.energy_spectrum(run.x[0])[0])
    energies = np.array([system.energy_spectrum(x)[1] for x in run.x])
    for line in shares.lines:
        assert line.get_label().startswith("$l" if surface == "sphere" else "$|n|")
        scale = float(line.get_label().strip("$").split("=")[1])
        own = energies[:, np.flatnonzero(np.isclose(scales, scale))[0]] / energies.sum(axis=1)
        np.testing.assert_allclose(data(line), [run.t, own], rtol=1e-12)

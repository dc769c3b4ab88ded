"""Pictures of fluids show the field that the matrix stands for, at the right place, with the right sign."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from drawn_runs import SENSES, T0, Picture, colour, data, made, shown

import coadjoint as co
from refusals import refused


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


def test_spectra_of_a_thermal_flow_are_those_of_its_potential_vorticity():
    s = co.systems.thermal_qg(7, 2.0, surface="torus")
    x0 = s.from_potential([s.fluid.random(seed=k, degrees=(1, 3)) for k in (1, 2)])
    run = co.integrate(s, x0, (0, 1), 0.25)
    axes = shown(run, Picture("field spectra", at=0.5))
    first = next(line for line in axes.lines if line.get_color() == colour(0) and line.get_linestyle() == "--")
    scales, values = s.fluid.energy_spectrum(s.potential(run.x[0])[1])
    np.testing.assert_array_equal(data(first), [scales, np.where(values > 0.0, values, np.nan)])


def test_the_fields_of_a_quasi_geostrophic_flow_are_shown_by_their_names():
    s = co.systems.torus_qg(9, 2.0, {(1, 2): 0.5})
    W = s.random(3, degrees=(2, 4))
    run = made(np.stack([W, W]), s)
    for part, matrix in (("all", s.relative(W)), ("potential", W), ("stream", s.stream_of(W))):
        axes = shown(run, "vorticity", part=part)
        wanted = s.to_grid(matrix, (128, 128), absolute=True).T
        np.testing.assert_allclose(axes.get_images()[0].get_array()[:-1, :-1], wanted, atol=1e-12)
    assert "potential vorticity" in shown(run, "vorticity", part="potential").get_title()
    surface = co.systems.surface_qg(9, "torus")
    assert "buoyancy" in shown(made(np.stack([W, W]), surface), "vorticity").get_title()
    with refused(ValueError, "surface_qg", "potential vorticity"):
        shown(made(np.stack([W, W]), surface), "vorticity", part="potential")

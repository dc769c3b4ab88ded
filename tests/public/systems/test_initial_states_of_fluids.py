"""Initial states of fluids: spectra, circulations, shapes, files; on sphere and torus, and on the rotating sphere."""

import pickle

import numpy as np
import pytest

import coadjoint as co
from refusals import refused

SPHERE, TORUS = co.systems.sphere_euler(N=24), co.systems.torus_euler(N=25)
TURNING = co.systems.sphere_euler(N=24, rotation=0.7)
FLUIDS = [SPHERE, TURNING, TORUS]
IDS = ["sphere", "rotating sphere", "torus"]
fluids = pytest.mark.parametrize("s", FLUIDS, ids=IDS)


def integral(s, field):
    """Return the integral over the surface of a field at the points of a grid, with the poles on the sphere."""
    if s is TORUS:
        return field.mean() * s.area
    degree_zero = field.mean(axis=1)
    theta = np.pi / 2 - s.grid((len(field), 4))[0]
    k = np.arange(0, len(field) - 1, 2)
    # Clenshaw and Curtis: the integrals of cos(k theta) sin(theta) are 2/(1 - k^2), k even
    coefficients = np.linalg.solve(np.cos(np.outer(theta, np.arange(len(theta)))), degree_zero)
    return 2 * np.pi * np.sum(coefficients[k] * 2 / (1.0 - k**2))


@pytest.mark.thinned(4)
@fluids
@pytest.mark.parametrize("lead", [(0,), (1,), (2, 3), (2, 0)])
def test_stacks_of_any_size(s, lead):
    """Spectra, fields, modes, energies and invariants of several states, and of none, as of each alone."""
    W = np.zeros((*lead, *s.shape), dtype=complex)
    for seed, place in enumerate(np.ndindex(lead)):
        W[place] = s.random(seed, degrees=(1, 5))
    integrals = {**s.casimirs, **s.integrals}
    parts = {
        "energy spectrum": lambda W: s.energy_spectrum(W)[1],
        "enstrophy spectrum": lambda W: s.enstrophy_spectrum(W)[1],
        "field": lambda W: s.to_grid(W, (8, 9), absolute=True),
        "back": lambda W: s.from_grid(s.to_grid(W, absolute=False), absolute=False),
        "modes": lambda W: s.from_modes(s.mode_array(W, absolute=True), absolute=False),
        "motion": s.vector_field,
        "spectrum": s.spectrum,
        "energy": s.energy,
        **integrals,
    }
    for name, part in parts.items():
        found, one = part(W), np.asarray(part(s.random(1)))
        assert np.shape(found) == (*lead, *one.shape), name
        for place in np.ndindex(lead):
            alone = part(W[place])
            # Sums of N^2 products, in another order.
            np.testing.assert_allclose(found[place], alone, rtol=0, atol=1e-11 * max(1, np.abs(alone).max()))


@fluids
@pytest.mark.parametrize("degrees", [(1, 4), (3, 6), (5, 5), (2, 9)])
def test_a_listed_spectrum_is_counted_from_the_degree_zero(s, degrees):
    """Also with entries beyond the last degree, and zeros; the energy is that of the list, or the given one."""
    first, last = degrees
    listed = np.array([7.0, 3.0, 0.5, 2.0, 0.0, 4.0, 1.5, 0.25, 5.0, 1.0, 9.0])
    wanted = np.where((np.arange(11) >= first) & (np.arange(11) <= last), listed, 0.0)[1:]
    for energy, scale in ((None, 1.0), (2.5, 2.5 / wanted.sum())):
        found = s.energy_spectrum(s.random(7, spectrum=listed, degrees=degrees, energy=energy))[1]
        np.testing.assert_allclose(found[:10], scale * wanted, rtol=0, atol=1e-12)
        assert np.abs(found[10:]).max(initial=0.0) < 1e-12
    by_function = s.random(7, spectrum=lambda l: listed[l.astype(int)], degrees=degrees, enstrophy=0.75)
    assert s.enstrophy_spectrum(by_function)[1].sum() == pytest.approx(0.75, rel=1e-12)
    spectra = [s.energy_spectrum(W)[1] for W in (by_function, s.random(7, spectrum=listed, degrees=degrees))]
    np.testing.assert_allclose(*(spectrum / spectrum.sum() for spectrum in spectra), rtol=0, atol=1e-12)


@pytest.mark.parametrize("make", [co.systems.sphere_euler, co.systems.torus_euler])
@pytest.mark.parametrize("N", [3, 5, 9, 31])
def test_a_random_field_has_equal_shares_of_enstrophy_by_default(make, N):
    """Of the degrees 2 to 10, or as far as N resolves; the number of modes of a degree is its share."""
    s = make(N=N)
    degree, enstrophy = s.enstrophy_spectrum(s.random(3))
    last = min(10, N - 1 if make is co.systems.sphere_euler else N // 2)
    first = min(2, last)
    if make is co.systems.sphere_euler:
        count = 2 * degree + 1
    else:
        n = np.arange(-(N // 2), N // 2 + 1)
        count = np.bincount(np.rint(np.hypot(n[:, None], n)).astype(int).ravel())[1:]
    wanted = np.where((degree >= first) & (degree <= last), count, 0.0)
    np.testing.assert_allclose(enstrophy, wanted / wanted.sum() * s.area / 2, rtol=0, atol=1e-12 * s.area)


@fluids
def test_fields_about_several_points_add_up_in_any_order(s):
    places = np.array([(0.5, 1.0), (-0.9, 4.0), (0.2, 2.5), (1.1, 5.5)])
    strengths, sizes = np.array([2.0, -0.5, 1.25, 0.75]), np.array([0.5, 0.35, 0.5, 0.7])
    makers = (
        lambda k: s.blobs(places[k], strengths[k], sizes[k]),
        lambda k: s.patches(places[k], sizes[k], strengths[k]),
        lambda k: s.patches(places[k], sizes[k], strengths[k], edge=0.3),
    )
    for make in makers:
        whole = s.relative(make(np.arange(4)))
        single = sum(s.relative(make(np.array([k]))) for k in range(4))
        # Places on the sphere are good to 3e-13.
        assert np.abs(whole - single).max() < 1e-11 * np.abs(whole).max()
        assert np.abs(s.relative(make(np.array([2, 0, 3, 1]))) - whole).max() < 1e-11 * np.abs(whole).max()
        assert np.abs(s.relative(make(np.array([0]))) - s.relative(make(np.array([2])))).max() > 0.1


@fluids
def test_spectra_are_integrals(s):
    """Of the square of the vorticity on a grid that is fine enough, and of the square of the velocity by -psi omega."""
    W = s.random(2, degrees=(1, 6))
    shape = (64, 64)
    omega, psi = (s.to_grid(A, shape, absolute=True) for A in (s.relative(W), s.stream(s.relative(W))))
    assert s.enstrophy_spectrum(W)[1].sum() == pytest.approx(integral(s, omega**2) / 2, rel=1e-12)
    assert s.energy_spectrum(W)[1].sum() == pytest.approx(-integral(s, psi * omega) / 2, rel=1e-12)
    assert integral(s, omega**2) == pytest.approx(s.area, rel=1e-12)
    degree, enstrophy = s.enstrophy_spectrum(np.stack([W, W])[:, None])
    assert enstrophy.shape == (2, 1, len(degree)) and degree[0] == 1
    np.testing.assert_allclose(enstrophy[1, 0], s.enstrophy_spectrum(W)[1], rtol=0, atol=1e-13)


@pytest.mark.parametrize(
    ("small", "large"), [(SPHERE, co.systems.sphere_euler(N=40)), (TORUS, co.systems.torus_euler(N=41))], ids=IDS[::2]
)
def test_one_seed_is_one_field_for_every_size(small, large):
    shape = (20, 30)
    few, many = (s.to_grid(s.random(5, degrees=(1, 9)), shape) for s in (small, large))
    assert np.abs(few - many).max() < 1e-11 * np.abs(many).max()


def gaussian(s, place, width, points):
    first, second = points
    if s is TORUS:
        turns = 2 * np.pi * np.arange(-2, 3)
        square = [((x[:, None] - at + turns) ** 2) for x, at in ((first, place[0]), (second, place[1]))]
        along, across = (np.exp(-q / (2 * width**2)).sum(axis=1) for q in square)
        return along[:, None] * across / (2 * np.pi * width**2) - 1 / s.area
    # the heat kernel of the sphere to its second order, with the time width^2/2 (Minakshisundaram and Pleijel)
    cosine = np.sin(first)[:, None] * np.sin(place[0]) + np.cos(first)[:, None] * np.cos(place[0]) * np.cos(
        second - place[1]
    )
    r, t = np.maximum(np.arccos(np.clip(cosine, -1, 1)), 1e-6), width**2 / 2
    second_order = 1 + t / 4 + t * (1 - r / np.tan(r)) / (4 * r**2)
    kernel = np.sqrt(r / np.sin(r)) * second_order * np.exp(-(r**2) / (4 * t)) / (4 * np.pi * t)
    return np.where(r < 3, kernel, 0.0) - 1 / s.area


@fluids
def test_blobs_are_gaussians_with_their_circulation(s):
    places, width = np.array([(0.5, 1.0), (-0.9, 4.0)]), 0.35
    W = s.relative(s.blobs(places, [2.0, -0.5], width))
    points = s.grid((60, 80))
    wanted = 2.0 * gaussian(s, places[0], width, points) - 0.5 * gaussian(s, places[1], width, points)
    found = s.to_grid(W, (60, 80))
    # further terms of the kernel are t^2/15 of it where they are largest; the cut series misses exp(-(12.5 width)^2/2)
    near = width**4 / 60 * 1.1 + 2 * np.exp(-((12.5 * width) ** 2) / 2)
    assert np.abs(found - wanted).max() < near * np.abs(wanted).max()
    assert abs(integral(s, s.to_grid(W, (64, 64)))) < 1e-12


@fluids
def test_patches_have_their_value_inside(s):
    radius, origin = 0.9, (0.0, 0.0) if s is TORUS else (np.pi / 2, 0.0)
    field = s.to_grid(s.relative(s.patches([origin], radius, 1.5)), (81, 100))
    mean = 1.5 * (np.pi * radius**2 if s is TORUS else 2 * np.pi * (1 - np.cos(radius))) / s.area
    # two and a half standard deviations from the edge a Gaussian has 0.6 percent left, and as much is cut off
    first, _ = s.grid((81, 100))
    away = np.minimum(first, 2 * np.pi - first) if s is TORUS else np.pi / 2 - first
    line, edge = field[:, 0], np.pi / s.resolved_degree
    assert np.abs(line[away < radius - 2.5 * edge] + mean - 1.5).max() < 0.03
    assert np.abs(line[away > radius + 2.5 * edge] + mean).max() < 0.03
    sharp = s.to_grid(s.relative(s.patches([origin], radius, 1.5, edge=0.0)), (81, 100))
    assert np.ptp(sharp) > 1.55 and np.ptp(field) < 1.53


def test_the_jet_of_the_sphere_and_its_bump():
    """The velocity is minus the slope of the stream function; motions of fluids have the jets of the torus."""
    s, band = co.systems.sphere_euler(N=96), (-0.5, 0.3)
    plain = s.zonal_jet(2.0, band=band, longitude=6.0, perturbation=0.0)
    north = s.grid((801, 3))[0]
    speed = -np.gradient(s.to_grid(s.stream(plain), (801, 3))[:, 0], north)
    assert speed.max() == pytest.approx(2.0, rel=5e-3) and north[np.argmax(speed)] == pytest.approx(-0.1, abs=0.02)
    assert np.abs(speed[(north < -0.6) | (north > 0.4)]).max() < 0.025
    bump = s.to_grid(s.zonal_jet(2.0, band=band, longitude=6.0, perturbation=0.1) - plain)
    latitude, longitude = s.grid()
    i, j = np.unravel_index(np.argmax(bump), bump.shape)
    assert latitude[i] == pytest.approx(-0.1, abs=0.02) and longitude[j] == pytest.approx(6.0, abs=0.02)
    assert bump.max() == pytest.approx(0.1 * 2.0 / 0.4, rel=0.03)


@pytest.mark.parametrize("band", [(-0.5, 0.3), (-1.4, -0.6), (0.6, 1.4)], ids=str)
def test_the_shape_of_the_bump_on_a_jet(band):
    """Gaussian along and across, of widths 1/3 and 1/15, times the cosine of the latitude over that of the jet."""
    s, middle = co.systems.sphere_euler(N=96), sum(band) / 2
    bump = s.to_grid(
        s.zonal_jet(2.0, band=band, longitude=3.0, perturbation=0.1) - s.zonal_jet(2.0, band=band, perturbation=0)
    )
    latitude, east = s.grid()
    across = np.cos(latitude) / np.cos(middle) * np.exp(-((15 * (latitude - middle)) ** 2))
    wanted = 0.1 * 2.0 / 0.4 * across[:, None] * np.exp(-((3 * (east - 3.0)) ** 2))
    # The mean is removed, and so are degrees from 96 on, about exp(-(96 / 30)^2) of it.
    np.testing.assert_allclose(bump - bump[:, 0].mean(), wanted, rtol=0, atol=1e-3 * wanted.max())


@pytest.mark.parametrize("longitude", [0.1, 3.0, 6.2, -1.0, 20.0])
@pytest.mark.parametrize("name", ["zonal_jet", "rossby_haurwitz"])
def test_a_longitude_turns_the_state(name, longitude):
    s = co.systems.sphere_euler(N=32, rotation=0.5)
    first, turned = (s.mode_array(getattr(s, name)(longitude=east), absolute=True) for east in (0.0, longitude))
    wanted = first * np.exp(-1j * np.arange(32) * longitude)
    np.testing.assert_allclose(turned, wanted, rtol=0, atol=1e-13 * np.abs(first).max())
    assert np.abs(turned - first).max() > 1e-6 * np.abs(first).max()


@fluids
def test_states_in_files_of_numpy(s, tmp_path):
    W = s.random(8)
    objects, pickled = tmp_path / "objects.npy", tmp_path / "pickled.npy"
    np.save(objects, W.astype(object), allow_pickle=True)
    pickled.write_bytes(pickle.dumps(W))
    for file in (objects, pickled):
        with refused(ValueError, file.name):
            s.from_file(file)
    np.save(tmp_path / "state.npy", W)
    np.testing.assert_array_equal(s.from_file(tmp_path / "state.npy"), s.algebra.read(W))
    np.save(tmp_path / "field.npy", s.to_grid(s.relative(W), (40, 70)))
    assert np.abs(s.from_file(str(tmp_path / "field.npy")) - W).max() < 1e-12 * np.abs(W).max()


def in_netcdf(folder, variables, axes):
    """Return a file of NetCDF."""
    import xarray

    xarray.Dataset(variables, axes).to_netcdf(folder / "field.nc", engine="h5netcdf")
    return folder / "field.nc"


@pytest.mark.thinned(2)
@pytest.mark.parametrize("ways", [(1, 1), (1, -1), (-1, 1), (-1, -1)])
def test_fields_of_the_torus_in_netcdf(ways, tmp_path):
    """From other places than zero along both axes, in either direction, in radians or degrees."""
    W = TORUS.random(10)
    x, y = TORUS.grid((32, 40))
    across, along = (slice(None, None, way) for way in ways)
    field = np.roll(TORUS.to_grid(W, (32, 40)), (-8, 5), axis=(0, 1))[across, along]
    x, y = (x + np.pi / 2)[across], (y - 5 * y[1])[along]
    axes = {"x": x, "y": ("y", np.degrees(y), {"units": "degrees" if ways[0] > 0 else "degree"})}
    file = in_netcdf(tmp_path, {"w": (("y", "x"), field.T)}, axes)
    assert np.abs(TORUS.from_file(file) - W).max() < 1e-12 * np.abs(W).max()


@fluids
def test_a_patch_without_an_edge_is_a_truncated_series(s):
    """The modes of patches are those of points times a profile; an edge smooths each mode by its eigenvalue."""
    place, radius = [(0.4, -2.0)], 0.7
    sharp, smooth = (s.mode_array(s.relative(s.patches(place, radius, 1.5, edge=edge))) for edge in (0, 0.2))
    size = np.abs(sharp).max()
    np.testing.assert_allclose(smooth, sharp * np.exp(-s.eigenvalues * 0.02), rtol=0, atol=1e-11 * size)
    usual = s.mode_array(s.relative(s.patches(place, radius, 1.5)))
    edge = np.pi / s.resolved_degree
    np.testing.assert_allclose(usual, sharp * np.exp(-s.eigenvalues * edge**2 / 2), rtol=0, atol=1e-11 * size)
    turned = s.mode_array(s.relative(s.patches([(0.4, -2.0 + 2 * np.pi)], radius, 1.5, edge=0)))
    np.testing.assert_allclose(turned, sharp, rtol=0, atol=1e-10 * size)


@pytest.mark.parametrize("points", ["clenshaw-curtis", "fejer", "gauss-legendre"])
def test_fields_in_netcdf_in_any_order(points, tmp_path):
    W = TURNING.random(9)
    latitude, longitude = TURNING.grid((30, 60), points)
    latitude, longitude = latitude[::-1], (longitude - np.pi / 3)[::-1]
    field = TURNING.to_grid(TURNING.relative(W), (30, 60), points)[::-1]
    field = np.roll(field, 10, axis=1)[:, ::-1]
    file = in_netcdf(
        tmp_path,
        {"vo": (("time", "longitude", "lat"), np.stack([0 * field.T, field.T])), "top": ("lat", latitude)},
        {
            "lat": ("lat", np.degrees(latitude).astype(np.float32), {"units": "degrees_north"}),
            "longitude": ("longitude", longitude, {"units": "radian"}),
        },
    )
    assert np.abs(TURNING.from_file(file, select={"time": -1}) - W).max() < 1e-11 * np.abs(W).max()
    for given, named in (({}, "time"), ({"variable": "vx"}, "vx"), ({"select": {"level": 0}}, "level")):
        with refused(ValueError, named):
            TURNING.from_file(file, **given)

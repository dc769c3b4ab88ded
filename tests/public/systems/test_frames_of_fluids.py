"""Vorticity relative to a rotating sphere, and fields by their coordinates: there and back through every pair."""

import itertools
import warnings
from functools import partial

import numpy as np
import pytest

import coadjoint as co
from refusals import refused

xarray = pytest.importorskip("xarray")
OMEGA = 5.25
SPHERE, TORUS = co.systems.sphere_euler(N=12, rotation=OMEGA), co.systems.torus_euler(N=9)
STATES = {
    "random": SPHERE.random(1, degrees=(1, 6)),
    "blobs": SPHERE.blobs([(0.3, 1.0)], 2.0, 0.5),
    "patches": SPHERE.patches([(-0.4, 3.0)], 0.7, 1.5),
    "zonal_jet": SPHERE.zonal_jet(),
    "rossby_haurwitz": SPHERE.rossby_haurwitz(5, 4),
}
ROUNDED = 1e-12  # sums of some N^2 = 144 products, several times


def dataset_of(W):
    return co.integrate(SPHERE, W, (0, 1e-3), 1e-3, co.IsospectralGauss()).to_xarray().isel(time=0)


def through_netcdf(W, folder):
    dataset_of(W).to_netcdf(folder / "run.nc", engine="h5netcdf")
    return SPHERE.from_file(folder / "run.nc")


def through_numpy(W, folder, *absolute):
    np.save(folder / "field.npy", SPHERE.to_grid(W, absolute=bool(absolute)))
    return SPHERE.from_file(folder / "field.npy", **dict.fromkeys(("absolute",) * len(absolute), True))


def both(write, read):
    def there_and_back(W, _, absolute):
        return read(write(W, absolute=absolute), absolute=absolute)

    name = f"{write.__name__} and {read.__name__}"
    return {f"{name}, {absolute}": partial(there_and_back, absolute=absolute) for absolute in (False, True)}


PAIRS = {
    **both(SPHERE.to_grid, SPHERE.from_grid),
    **both(SPHERE.modes, SPHERE.from_modes),
    **both(SPHERE.mode_array, SPHERE.from_modes),
    "relative": lambda W, _: SPHERE.absolute(SPHERE.relative(W)),
    "a dataset": lambda W, _: SPHERE.from_grid(dataset_of(W).vorticity, absolute=False),
    "a file of a run": through_netcdf,
    "an array": through_numpy,
    "an absolute array": lambda W, folder: through_numpy(W, folder, True),
}


@pytest.mark.parametrize("pair", PAIRS)
@pytest.mark.parametrize("state", STATES)
def test_there_and_back_on_a_rotating_sphere(state, pair, tmp_path):
    W = STATES[state]
    assert np.abs(PAIRS[pair](W, tmp_path) - W).max() < ROUNDED * np.abs(W).max()


def wave(latitude, longitude):
    """Return the relative vorticity of `rossby_haurwitz(5, 4)`, whose harmonic is sin(latitude) cos(latitude)^4."""
    harmonic = np.sin(latitude) * np.cos(latitude) ** 4 * np.cos(4 * longitude)
    x, weights = np.polynomial.legendre.leggauss(12)
    return 2 * np.sin(latitude) + harmonic / np.sqrt(weights @ (x**2 * (1 - x**2) ** 4) / 4)


def test_a_given_field_has_the_energy_and_the_phase_speed_of_its_closed_form():
    """Solid rotation has the energy 4 pi/3, a wave of mean square one 2 pi/(l(l + 1)); it turns by 1 - 2 (1 + O)/30."""
    latitude, longitude = SPHERE.grid()
    W = SPHERE.from_grid(wave(latitude[:, None], longitude), absolute=False)
    assert np.abs(W - STATES["rossby_haurwitz"]).max() < ROUNDED * np.abs(W).max()
    energy = 4 * np.pi / 3 + 2 * np.pi / 30
    assert SPHERE.energy(W) == pytest.approx(energy, rel=1e-12)
    assert SPHERE.energy_spectrum(W)[1].sum() == pytest.approx(energy, rel=1e-12)
    sol = co.integrate(SPHERE, W, (0, 0.25), 1 / 128, co.IsospectralGauss(2), save_every=32)
    speed = 1 - 2 * (1 + OMEGA) / 30
    wanted = wave(latitude[:, None], longitude - speed * 0.25)
    # Order 4: (h |P|)^4 with |P| of some 6 times the stream function, about 1.
    np.testing.assert_allclose(SPHERE.to_grid(sol.x[-1], absolute=False), wanted, rtol=0, atol=1e-4)
    assert np.abs(wave(latitude[:, None], longitude - 0.25) - wanted).max() > 0.1


def test_the_frame_is_subtracted_once():
    """A relative vorticity is known as one, also after sums and products by numbers, and is no state."""
    W = STATES["blobs"]
    relative = SPHERE.relative(W)
    wanted = SPHERE.to_grid(W, absolute=True) - 2 * OMEGA * np.sin(SPHERE.grid()[0])[:, None]
    size = np.abs(wanted).max() + 2 * OMEGA
    sums = 2.0 * relative - relative, -(-1.0 * relative), relative + SPHERE.planetary
    for given in (W, relative, SPHERE.relative(relative), *sums):
        np.testing.assert_allclose(SPHERE.to_grid(given, absolute=False), wanted, rtol=0, atol=ROUNDED * size)
        for spectrum in (SPHERE.energy_spectrum, SPHERE.enstrophy_spectrum):
            np.testing.assert_allclose(spectrum(given)[1], spectrum(W)[1], rtol=0, atol=ROUNDED * size**2)
        assert SPHERE.energy(given) == pytest.approx(SPHERE.energy(W), rel=1e-12)
    assert SPHERE.to_grid(relative).shape == wanted.shape, "without a warning"
    several = np.stack([W, 2.0 * W])
    each = SPHERE.relative(several)
    for given in (several, np.stack([*each]), np.concatenate([each[:1], each[1:]]), np.where(True, each, each)):
        spectra, alone = SPHERE.enstrophy_spectrum(given)[1], SPHERE.enstrophy_spectrum(several)[1]
        np.testing.assert_allclose(spectra, alone, rtol=0, atol=4 * ROUNDED * size**2)
    mean = np.average(np.stack([*each]), axis=0, weights=[1.0, 3.0])
    np.testing.assert_allclose(
        SPHERE.to_grid(mean), SPHERE.to_grid(1.75 * W, absolute=False), rtol=0, atol=4 * ROUNDED * size
    )
    # With the frame it is none: the enstrophy of the frame is 2/3 of that of its largest value.
    frame = SPHERE.enstrophy_spectrum(relative - relative + SPHERE.planetary, absolute=True)[1].sum()
    assert frame == pytest.approx(2 * np.pi / 3 * (2 * OMEGA) ** 2, rel=1e-12)
    absolute = SPHERE.enstrophy_spectrum(W, absolute=True)[1].sum()
    assert absolute == pytest.approx(np.vdot(W, W).real / SPHERE.scale**2 / 2, rel=1e-12)
    for run in (lambda *start: co.integrate(SPHERE, *start, 0.1), co.prepare(SPHERE, step=0.1).run):
        with refused(ValueError, "x0", "relative", "absolute"):
            run(relative, (0, 1))
    for function in (SPHERE.vector_field, SPHERE.stream_of, SPHERE.angular_momentum, partial(SPHERE.exact, t=1.0)):
        with refused(ValueError, "relative", "absolute"):
            function(relative)


def test_a_changed_default_warns_once():
    calls = {
        "from_modes": lambda **frame: SPHERE.from_modes({(1, 0): 1.0}, **frame),
        "from_grid": lambda **frame: SPHERE.from_grid(np.zeros((5, 8)), **frame),
        **{name: lambda name=name, **frame: getattr(SPHERE, name)(STATES["blobs"], **frame)
           for name in ("to_grid", "modes", "mode_array")},
    }  # fmt: skip
    still = co.systems.sphere_euler(N=5)
    for name, function in calls.items():
        with warnings.catch_warnings(record=True) as noticed:
            warnings.simplefilter("always")
            warnings.simplefilter("ignore", co.LongWait)  # of a busy machine
            function(absolute=True)
            function(absolute=False)
            still.to_grid(np.zeros((5, 5)))
            assert not noticed
            function()
            function()
        (only,) = noticed
        assert name in str(only.message) and "absolute=True" in str(only.message) and only.filename == __file__
    for wrong in (1, "yes", 0.5):
        for s in (SPHERE, TORUS):
            with refused(TypeError, "absolute"):
                s.to_grid(np.zeros(s.shape), absolute=wrong)


@pytest.mark.filterwarnings("error::FutureWarning")
@pytest.mark.parametrize("path", ["dataset", "loaded", "member", "carried", "relative", "absolute"])
def test_an_array_that_names_its_vorticity_is_read_by_it_without_a_warning(path, tmp_path):
    planet, W = co.systems.sphere_euler(N=12, rotation=OMEGA), STATES["blobs"]
    if path == "carried":
        both = np.stack([W, STATES["random"]])
        field = co.integrate(co.systems.passive_scalar(12), both, (0, 1e-3), 1e-3).to_xarray().carried
    elif path in ("relative", "absolute"):
        field = on_sphere()
        field.attrs["standard_name"] = f"atmosphere_{path}_vorticity"
        W = planet.from_grid(field.to_numpy(), absolute=path == "absolute")
        field = field.expand_dims("time")
    else:
        start = np.stack([W, STATES["random"]]) if path == "member" else W
        sol = co.integrate(planet, start, (0, 1e-3), 1e-3)
        if path == "loaded":
            sol.to_xarray().to_netcdf(tmp_path / "run.nc", engine="h5netcdf")
        field = (co.load(tmp_path / "run.nc").to_xarray() if path == "loaded" else sol.to_xarray()).vorticity
        field = field.isel(member=0) if path == "member" else field
    assert np.abs(planet.from_grid(field.isel(time=0)) - W).max() < ROUNDED * np.abs(W).max()


def on_sphere(points="clenshaw-curtis", shape=(16, 30), first=0.0):
    latitude, longitude = SPHERE.grid(shape, points)
    longitude = longitude + first
    values = wave(latitude[:, None], longitude)
    coordinates = {
        "latitude": ("latitude", np.degrees(latitude), {"units": "degrees_north"}),
        "longitude": ("longitude", np.degrees(longitude), {"units": "degrees_east"}),
    }
    return xarray.DataArray(values, coordinates, ("latitude", "longitude"))


def in_radians(field, units):
    axes = {axis: (axis, np.radians(field[axis].values), units) for axis in field.dims}
    return field.assign_coords(axes)


def bare(field):
    """Drop the units."""
    return field.assign_coords({axis: field[axis].values for axis in field.dims})


def named(field, **names):
    return field.rename(names)


def by_standard_name(field):
    renamed = named(bare(field), latitude="rows", longitude="columns")
    for axis, name in (("rows", "latitude"), ("columns", "longitude")):
        renamed[axis].attrs["standard_name"] = name
    return renamed


def beside(field):
    """Return a field over rows and columns, whose latitudes and longitudes are not its indices."""
    axes = {"lat": ("y", field.latitude.values), "lon": ("x", field.longitude.values)}
    return xarray.DataArray(field.values, axes, ("y", "x"))


FIELDS = {
    "as written": on_sphere,
    "from south to north": lambda: on_sphere()[::-1],
    "westward": lambda: on_sphere()[:, ::-1],
    "longitude first": lambda: on_sphere().transpose(),
    "from -180": lambda: on_sphere(first=-np.pi),
    "-180 in the middle": lambda: on_sphere().assign_coords(longitude=(on_sphere().longitude + 180) % 360 - 180),
    "beside the poles": lambda: on_sphere("fejer"),
    "nodes of Gauss": lambda: on_sphere("gauss-legendre")[::-1],
    "radians": lambda: in_radians(on_sphere(), {"units": "radian"}),
    "radians without units": lambda: in_radians(on_sphere(first=1.0), {}),
    "degrees without units": lambda: bare(on_sphere("fejer", first=-np.pi)),
    "three rows without units": lambda: bare(on_sphere("gauss-legendre", (12, 30))),
    "other names": lambda: named(on_sphere(), latitude="lat", longitude="Lon").transpose(),
    "standard names": lambda: by_standard_name(on_sphere()).transpose(),
    "names of units": lambda: named(on_sphere(), latitude="j", longitude="i"),
    "beside the indices": lambda: beside(on_sphere()),
    "float32": lambda: on_sphere().astype(np.float32).assign_coords(latitude=on_sphere().latitude.astype(np.float32)),
}


@pytest.mark.thinned(1)
@pytest.mark.parametrize("name", FIELDS)
def test_a_field_is_read_by_its_coordinates(name, tmp_path):
    """From an array and from a file, alone and at several times."""
    field, wanted = FIELDS[name](), STATES["rossby_haurwitz"]
    atol = (1e-5 if name == "float32" else ROUNDED) * np.abs(wanted).max()
    np.testing.assert_allclose(SPHERE.from_grid(field, absolute=False), wanted, rtol=0, atol=atol)
    several = xarray.concat([field, 2.0 * field], "time").transpose(..., "time")
    found = SPHERE.from_grid(several, absolute=True)
    planet = SPHERE.planetary
    np.testing.assert_allclose(found, np.stack([wanted - planet, 2.0 * (wanted - planet)]), rtol=0, atol=2 * atol)
    several.to_dataset(name="vo").to_netcdf(tmp_path / "field.nc", engine="h5netcdf")
    read = SPHERE.from_file(tmp_path / "field.nc", select={"time": 0})
    np.testing.assert_allclose(read, wanted, rtol=0, atol=atol)


def test_coordinates_and_arguments_are_not_mixed():
    for given in ({"points": "fejer"}, {"longitude": 0.5}):
        with refused(ValueError, "coordinates", "omit"):
            SPHERE.from_grid(on_sphere(), **given, absolute=False)
    with refused(TypeError, "to_numpy"):
        SPHERE.from_grid(on_sphere().to_pandas(), absolute=False)


def on_torus(names, units, shift=0.0):
    x, y = (axis + shift for axis in TORUS.grid((16, 10)))
    values = np.cos(2 * x)[:, None] * np.sin(y) + np.sin(x)[:, None]
    factor = 180 / np.pi if units in ("degrees", None) else 1.0
    attributes = {} if units is None else {"units": units}
    axes = {name: (name, values * factor, attributes) for name, values in zip(names, (x, y), strict=True)}
    return xarray.DataArray(values, axes, names)


@pytest.mark.parametrize("names", [("x", "y"), ("eastward", "northward")])
@pytest.mark.parametrize(("units", "shift"), [*itertools.product(("radian", "degrees", None, "1"), (0.0, 1.0))])
def test_fields_of_the_torus_by_their_coordinates(names, units, shift):
    wanted = TORUS.from_modes({(2, 1): 0.25j, (2, -1): -0.25j, (1, 0): -0.5j})
    field = on_torus(names, units, shift)
    for given in (field, field[::-1], field.transpose()[::-1, ::-1], field.roll({names[0]: 3}, roll_coords=True)):
        np.testing.assert_allclose(TORUS.from_grid(given), wanted, rtol=0, atol=ROUNDED)
    with refused(ValueError, "2 pi"):
        TORUS.from_grid(field[:9])


def test_datasets_of_runs_on_the_torus_are_read(tmp_path):
    """Of one run, of an ensemble, and of two fields, whose variable is given."""
    W, theta = TORUS.random(1, degrees=(1, 3)), TORUS.random(2, degrees=(1, 3))
    mhd = co.systems.reduced_mhd(9, "torus")
    for system, x0, select in ((TORUS, np.stack([theta, W]), {"member": 1}), (mhd, np.stack([theta, W]), {})):
        sol = co.integrate(system, x0, (0, 0.1), 0.1, co.IsospectralGauss())
        sol.to_xarray().to_netcdf(tmp_path / f"{system.name}.nc", engine="h5netcdf")
        read = TORUS.from_file(tmp_path / f"{system.name}.nc", variable="vorticity", select={"time": -1, **select})
        np.testing.assert_allclose(read, sol.x[-1, 1], rtol=0, atol=ROUNDED * np.abs(W).max())
    with refused(ValueError, "carried", "vorticity", "variable="):
        TORUS.from_file(tmp_path / "reduced_mhd.nc", select={"time": 0})

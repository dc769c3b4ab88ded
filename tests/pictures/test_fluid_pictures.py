"""Pictures of fluids show the field that the matrix stands for, at the right place, with the right sign."""

import numpy as np
import pytest
from drawn_runs import shown

import coadjoint as co
from coadjoint.pictures.fluids import part_on_grid
from coadjoint.pictures.gallery import SCENES, Scene, decaying_turbulence, piece
from coadjoint.pictures.plot_data import PlottedRun
from coadjoint.pictures.projections import PROJECTIONS, unit_vectors
from coadjoint.pictures.register import CannotShow, kinds
from coadjoint.systems.gallery_entry import Picture
from coadjoint.systems.matrices.fluid_system import large_scales
from long import long_beyond


@pytest.fixture(scope="module")
def ball():
    s = co.systems.sphere_euler(N=16)
    return co.integrate(s, s.random(3, degrees=(2, 6)), (0.0, 2.0), 0.02, co.IsospectralGauss(), save_every=10)


@pytest.fixture(scope="module")
def square():
    s = co.systems.torus_euler(N=15)
    W = s.from_modes({(1, 2): 0.5, (2, 0): 0.3j, (0, 1): -0.2})
    return co.integrate(s, W, (0.0, 1.0), 0.05, co.IsospectralGauss())


@pytest.mark.parametrize("name", PROJECTIONS)
def test_maps_are_inverted_and_keep_areas(name):
    rng = np.random.default_rng(1)
    map_ = PROJECTIONS[name]
    longitude = rng.uniform(-3.0, 3.0, 400) / (1 if map_.half_width == 2.0 else 2)
    latitude = rng.uniform(-1.4, 1.4, 400)
    x, y = map_.project(longitude, latitude)
    assert ((x / map_.half_width) ** 2 + y**2).max() < 1.0
    east, north = map_.unproject(x, y)
    # the table of Mollweide's angle is linear between 4001 points: (pi / 4000)^2 / 8 times second derivatives below 20
    np.testing.assert_allclose([east, north], [longitude, latitude], atol=2e-6)
    if name == "outside":
        np.testing.assert_allclose([x, y], [np.cos(latitude) * np.sin(longitude), np.sin(latitude)], atol=1e-15)
        return
    h = 1e-5
    along, up = (
        (np.array(map_.unproject(x + a, y + b)) - np.array(map_.unproject(x - a, y - b))) / (2 * h)
        for a, b in ((h, 0), (0, h))
    )
    # 4 pi of the sphere over 2 pi of the ellipse; central differences err by h^2 times third derivatives
    area = (along[0] * up[1] - along[1] * up[0]) * np.cos(north)
    np.testing.assert_allclose(area, 2.0, atol=1e-4)


@pytest.mark.parametrize("name", PROJECTIONS)
@pytest.mark.parametrize("centre", [(0.0, 0.0), (70.0, 0.0), (-110.0, 50.0)])
def test_the_middle_of_a_map_is_its_centre_with_north_up_and_east_to_the_right(name, centre):
    map_ = PROJECTIONS[name]
    towards = map_.directions(400, centre)
    rows, columns = towards.shape[:2]
    assert columns == 400 and rows == 400 / map_.half_width
    middle = unit_vectors(*np.radians(centre))
    around = towards[rows // 2 - 1 : rows // 2 + 1, columns // 2 - 1 : columns // 2 + 1].mean(axis=(0, 1))
    assert np.linalg.norm(around - middle) < 0.01
    east = np.cross([0.0, 0.0, 1.0], middle)
    east /= np.linalg.norm(east)
    step_right = towards[rows // 2, columns // 2 + 9] - towards[rows // 2, columns // 2 - 9]
    step_up = towards[rows // 2 + 9, columns // 2] - towards[rows // 2 - 9, columns // 2]
    assert step_right @ east > 0.99 * np.linalg.norm(step_right) > 0.0
    assert step_up @ np.cross(middle, east) > 0.99 * np.linalg.norm(step_up) > 0.0
    assert np.isnan(towards[0, 0]).all()


@pytest.mark.parametrize(
    ("name", "centre"), [("mollweide", (0.0, 0.0)), ("hammer", (40.0, 20.0)), ("outside", (9, 80))]
)
def test_a_map_shows_the_field_of_the_matrix(name, centre):
    s = co.systems.sphere_euler(N=16)
    # of coordinates of the sphere: x y + 2 z, real harmonics of the degrees 2 and 1
    f = lambda n: n[..., 0] * n[..., 1] + 2.0 * n[..., 2]  # noqa: E731
    latitude, longitude = s.grid()
    W = s.from_grid(f(unit_vectors(*np.meshgrid(longitude, latitude))))
    run = co.integrate(s, W, (0.0, 0.02), 0.01, co.IsospectralGauss())
    axes = shown(run, Picture("vorticity", at=0.0, projection=name, centre=centre))
    (image,) = axes.get_images()
    pixels = np.ma.filled(image.get_array(), np.nan)
    towards = PROJECTIONS[name].directions(pixels.shape[1], centre)
    # bilinear on cells of 180/128 degrees: an eighth of the squares of the sides, times second derivatives below 4
    error = 2 * np.radians(180 / 128) ** 2 / 8 * 4
    np.testing.assert_allclose(pixels, f(towards), atol=error)
    assert image.origin == "lower" and axes.get_aspect() == 1.0
    low, high = image.get_clim()
    assert low == -high and high == pytest.approx(np.nanmax(np.abs(f(towards))), rel=0.05)


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


def test_parts_add_up_and_the_large_one_is_steady(ball):
    arrays = {}
    for part in ("all", "large", "small", "stream"):
        (image,) = shown(ball, Picture("vorticity", part=part)).get_images()
        arrays[part] = image.get_array()
    np.testing.assert_allclose(arrays["large"] + arrays["small"], arrays["all"], atol=1e-13)
    s, W = ball.system, ball.x[-1]
    P = s.stream_of(W)
    large = large_scales(P, W)
    size = np.linalg.norm(P) * np.linalg.norm(W)
    assert np.linalg.norm(P @ large - large @ P) < 1e-13 * size < np.linalg.norm(P @ W - W @ P)
    np.testing.assert_allclose(large_scales(P, large), large, atol=1e-12 * np.abs(W).max())
    # an orthogonal projection, to matrices of the algebra
    assert abs(np.vdot(large, W - large)) < 1e-12 * np.vdot(W, W).real
    s.algebra.read(large)
    # energy sees the large scales alone: <P, W> = <P, large>
    assert np.vdot(P, large).real == pytest.approx(np.vdot(P, W).real, rel=1e-12)


def test_the_stream_function_has_the_sign_of_minus_the_vorticity():
    s = co.systems.sphere_euler(N=8)
    W = s.from_modes({(3, 2): 0.7 - 0.2j})
    run = co.integrate(s, W, (0.0, 0.1), 0.05, co.IsospectralGauss())
    omega, psi = (
        shown(run, Picture("vorticity", at=0.0, part=part)).get_images()[0].get_array() for part in ("all", "stream")
    )
    np.testing.assert_allclose(psi, -omega / 12.0, atol=1e-14)


@pytest.mark.parametrize("rotation", [0.0, 2.0])
def test_on_a_planet_the_relative_vorticity_is_shown(rotation):
    s = co.systems.sphere_euler(N=12, rotation=rotation)
    W = s.random(2, degrees=(2, 4))
    run = co.integrate(s, W, (0.0, 0.1), 0.05, co.IsospectralGauss())
    (image,) = shown(run, Picture("vorticity", at=0.0)).get_images()
    still = co.systems.sphere_euler(N=12)
    seen = co.integrate(still, still.random(2, degrees=(2, 4)), (0.0, 0.1), 0.05, co.IsospectralGauss())
    (other,) = shown(seen, Picture("vorticity", at=0.0)).get_images()
    np.testing.assert_allclose(image.get_array(), other.get_array(), atol=1e-13)


@pytest.mark.parametrize("kind", ["ball", "planet", "square", "two fields"])
def test_large_scales_are_the_relative_vorticity_along_the_projections_of_its_stream_matrix(kind):
    if kind in ("ball", "planet"):
        still = co.systems.sphere_euler(N=8)
        fluid = co.systems.sphere_euler(N=8, rotation=2.0) if kind == "planet" else still
        seen, state = still.random(5, degrees=(1, 4)), fluid.random(5, degrees=(1, 4))
    else:
        still = fluid = co.systems.torus_euler(N=7)
        seen = state = fluid.random(5, degrees=(1, 3))
        state = state if kind == "square" else np.stack([fluid.random(6, degrees=(1, 2)), state])
    shape = (17, 32) if kind in ("ball", "planet") else (16, 16)
    P = still.stream_of(seen)
    values, V = np.linalg.eigh(1j * P)
    assert np.diff(values).min() > 1e-3 * np.abs(values).max(), "projections on single vectors"
    large = sum(np.outer(v, v.conj()) @ seen @ np.outer(v, v.conj()) for v in V.T)
    wanted = {"all": seen, "large": large, "small": seen - large, "stream": P}
    for part, matrix in wanted.items():
        found = part_on_grid(fluid, state, part, shape)
        np.testing.assert_allclose(found, still.to_grid(matrix, shape), atol=1e-11 * np.abs(found).max())
    if kind == "two fields":
        carried = part_on_grid(fluid, state, "carried", shape)
        np.testing.assert_allclose(carried, still.to_grid(state[0], shape), atol=1e-13)


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
    from coadjoint.systems.matrices.streams import Weights

    a = np.array([1.0, 2.0, 3.0, 4.0])
    body = co.MatrixSystem(co.MatrixAlgebra("so", 4), Weights(1 / np.add.outer(a, a)), name="body of mine")
    W = body.algebra.projected(np.arange(16.0).reshape(4, 4))
    run = co.integrate(body, W, (0.0, 1.0), 0.05, co.IsospectralGauss())
    titles = [axes.get_title() for axes in run.plot().axes]
    assert titles[-1].startswith("spectrum of $W$") and "components" in titles[1]
    with pytest.raises(CannotShow, match="body of mine has no vorticity"):
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
    from coadjoint.systems.matrices.streams import Weights

    s = co.MatrixSystem(co.MatrixAlgebra("gl", 3), Weights(np.full((3, 3), 0.5) + np.eye(3)), name="of gl")
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
        with pytest.raises(CannotShow, match="rigid_body has no vorticity"):
            body.plot(kind)
    with pytest.raises(CannotShow, match="rigid_body is not a matrix"):
        body.plot("eigenvalues")
    for options, said in [
        ({"part": "lage"}, "did you mean 'large'"),
        ({"projection": "molweide"}, "did you mean 'mollweide'"),
        ({"part": "carried"}, "carries no second field"),
        ({"limit": 0.0}, "limit"),
        ({"centre": (0.0, np.nan)}, "latitude of centre"),
    ]:
        with pytest.raises(ValueError, match=said):
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


def test_large_ensembles_of_matrices_are_not_copied(ball):
    drawn = PlottedRun(ball)
    assert np.shares_memory(drawn.x, ball.x)
    assert drawn.state(3).shape == (16, 16) and np.array_equal(drawn.state(3), ball.x[3])


def test_decaying_turbulence_is_drawn_when_it_is_named(monkeypatch):
    scene = SCENES["decaying_turbulence"]
    short = Scene(lambda: decaying_turbulence(N=12, end=2.0, step=0.1), scene.pictures, scene.summary, scene.caption)
    monkeypatch.setitem(SCENES, "decaying_turbulence", short)
    made = piece("decaying_turbulence")
    panels = [axes for axes in made.figure.axes if axes.get_label() != "<colorbar>"]
    assert [axes.get_title() for axes in panels] == [
        f"vorticity{part} at $t$ = {t}" for t in (0, 0, 2) for part in ("", ", large scales")
    ]
    assert made.run.startswith("sphere_euler(N=12") and made.run.endswith(" s")
    assert all(kinds()[picture.kind].low for picture in scene.pictures)
    # the field is that of the picture in the documentation for every N: one seed, the degrees 3 to 8, mean square 1
    run = decaying_turbulence(N=12, end=0.1, step=0.1)
    l, enstrophy = run.system.enstrophy_spectrum(run.x[0])
    assert l[enstrophy > 1e-20].tolist() == list(range(3, 9))
    assert enstrophy.sum() == pytest.approx(2 * np.pi, rel=1e-12)

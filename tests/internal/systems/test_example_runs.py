"""Example runs of ready-made systems: initial states, names of coordinates, and the functions drawn over time."""

import numpy as np
import pytest

import coadjoint as co
from coadjoint.methods.registry import suggested_scheme
from coadjoint.systems.coordinates import coordinate_names
from coadjoint.systems.gallery_entry import GalleryEntry, Picture, points_on_sphere
from coadjoint.systems.registry import gallery_entry_of, ready_made
from refusals import refused


def example(name):
    """Return the system of an example run and its declaration."""
    gallery_entry = gallery_entry_of(name)
    return co.systems.get(name, **gallery_entry.parameters), gallery_entry


@pytest.mark.thinned(3)
@pytest.mark.parametrize("name", co.systems.names())
def test_starts_names_and_pictures_fit_the_system(name):
    system, gallery_entry = example(name)
    shape = getattr(system, "shape", (system.dim,))
    start = gallery_entry.start()
    assert start.shape[-len(shape) :] == shape and start.ndim - len(shape) in (0, 1)
    assert np.isfinite(start).all() and gallery_entry.start() is not start
    names = gallery_entry.names(system.dim)
    assert len(set(names)) == len(names) and len(names) in (0, system.dim)
    assert gallery_entry.names(system.dim + 1) == () or callable(gallery_entry.coordinates)
    assert len(shape) > 1 or not names or coordinate_names(system, system.dim) == names
    step, attitude, pictures = gallery_entry.step, gallery_entry.attitude, list(gallery_entry.pictures)
    assert 0.0 < step < gallery_entry.t_span[1] - gallery_entry.t_span[0]
    run = co.integrate(system, start, (0.0, 4.0 * step), step, suggested_scheme(system), attitude=attitude)
    assert not pictures or run.plot(pictures).axes  # plot() leaves out what it cannot draw


@pytest.mark.parametrize(("count", "radius"), [(1, 1.0), (5, 2.0), (16, 0.5), (300, 1.0)])
def test_points_over_a_sphere(count, radius):
    """Each lies in a ring of equal area of its own, and no two are close."""
    points = points_on_sphere(count, radius)
    assert points.shape == (count, 3)
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), radius, rtol=1e-15 * 8)
    rings = np.floor((radius - points[:, 2]) / (2 * radius) * count).astype(int)
    assert rings.tolist() == list(range(count))
    if count > 1:
        apart = np.linalg.norm(points[:, None] - points, axis=2) + 9 * radius * np.eye(count)
        # Points on a square grid are sqrt(4 pi / count) apart; those of the spiral at least 0.85 of it.
        assert apart.min() > 0.85 * radius * np.sqrt(4 * np.pi / count)
        assert np.abs(points[:, :2].mean(axis=0)).max() < radius / count**0.5


def test_a_satellite_librates_on_a_circle():
    system, gallery_entry = example("satellite")
    x = gallery_entry.start()
    (pitch,) = gallery_entry.components.options["functions"].values()
    L, p, r = x[:3], x[3:6], x[6:9]
    mass, gravity = system.parameters["mass"], system.parameters["gravity"]
    assert np.linalg.norm(r) == pytest.approx(5.0) and abs(r @ p) < 1e-15 * 5.0 * np.linalg.norm(p)
    assert (p @ p) / mass**2 == pytest.approx(gravity / 5.0)
    # The body turns with the orbit: the radius, seen from the body, moves by the small spin out of the plane only.
    field = system.vector_field(x)
    assert np.abs(field[6:8]).max() < 1e-15 and 0.0 < abs(field[8]) < 0.05 and L[0] == 0.005 and x[9] == 1.0
    angles = np.radians([[-40.0, 10.0], [100.0, -170.0]])
    states = np.zeros((2, 2, 10))
    states[..., 6], states[..., 7] = 3.0 * np.cos(angles), 3.0 * np.sin(angles)
    np.testing.assert_allclose(pitch(states), np.degrees(angles), rtol=1e-15 * 8)
    assert pitch(x) == pytest.approx(-40.0)


def test_the_tipping_angle_changes_by_the_field():
    system, gallery_entry = example("maxwell_bloch")
    tipping = gallery_entry.pictures[0].options["across"]
    starts = gallery_entry.start()
    assert starts.shape == (12, 3) and not starts[:, 1].any() and (starts[:, 2] == -1.0).all()
    assert (np.diff(starts[:9, 0]) > 0.0).all() and (starts[:9, 0] > 0.0).all() and (starts[9:, 0] < 0.0).all()
    # Above 2 sqrt(coupling R) the field turns all the way round.
    assert starts[0, 0] < 2.0 < starts[8, 0] and starts[9:, 0].max() < -2.0
    np.testing.assert_array_equal(tipping(starts), 0.0)
    h = 2.0**-17  # the error of the central difference is about h^2, 6e-11, and u / h, 1.5e-11
    for x in np.array([[0.7, 0.6, -0.8], [-1.2, -0.5, 0.3], [0.4, 0.0, -1.0]]):
        before, after = system.exact(x, [-h, h])
        assert (tipping(after) - tipping(before)) / (2 * h) == pytest.approx(x[0], abs=1e-9)


@pytest.mark.parametrize(("v", "w"), [(0.4, -1.5), (5.5, -5.5), (7.0, 1.0), (-7.0, -1.0)])
@pytest.mark.parametrize("factor", [1.0, 2.5, -0.5])
def test_roots_drawn_for_the_riccati_equation(v, w, factor):
    """Both real roots that are below 6 in size, and nothing for others."""
    functions = gallery_entry_of("riccati").components.options["functions"]
    assert list(functions) == ["v", "w"]
    found = np.array([f(factor * np.array([1.0, (v + w) / 2, -v * w])) for f in functions.values()])
    wanted = sorted(root for root in (v, w) if abs(root) < 6.0)
    np.testing.assert_allclose(np.sort(found[np.isfinite(found)]), wanted, rtol=1e-14)
    assert np.isnan(functions["v"](np.array([[1.0, 0.3, -0.34], [1.0, 0.0, -4.0]]))).all()


def test_waves_of_an_oblique_triad():
    """k1 + k2 + k3 = 0; the width is twice the longest wavelength, whichever wave has it."""
    options = gallery_entry_of("fluid_triad").pictures[0].options
    X, Y = np.random.default_rng(5).uniform(-4.0, 4.0, (2, 6, 7))
    k1, k2, k3 = np.array([[1.0, 0.75], [0.5, -2.0], [-1.5, 1.25]])
    for first, second in ((k1, k2), (k2, k3), (k3, k1)):
        triad = co.systems.fluid_triad(first, second)
        waves = options["modes"](triad, X, Y)
        for wave, k in zip(waves, (first, second, -first - second), strict=True):
            np.testing.assert_allclose(wave, np.cos(k[0] * X + k[1] * Y), rtol=0, atol=1e-14)
        assert options["width"](triad) == pytest.approx(2 * 2 * np.pi / 1.25)


@pytest.mark.parametrize("count", [1, 2, 3, 6])
def test_positions_and_widths_of_at_most_four_particles(count):
    chosen = gallery_entry_of("decorated_particles").components.options["chosen"](5 * count + 1)
    system = co.systems.decorated_particles(np.ones(count))
    names = [coordinate_names(system, system.dim)[k] for k in chosen]
    shown = min(count, 4)
    assert names[:shown] == [f"q{k + 1}" for k in range(count)][:shown]
    assert len(names) == 2 * shown and all(name.startswith("x20") for name in names[shown:])
    assert len(set(names)) == len(names)


GIVEN = {"x0": (1.0, 0.0, 0.0), "t_span": (0.0, 1.0), "step": 0.1, "caption": "It moves."}


def test_declarations_are_validated():
    whole = GalleryEntry(**GIVEN | {"t_span": [np.float32(0.5), 2], "coordinates": ["a", "b"], "x0": lambda: [1j, 2.0]})
    assert whole.t_span == (0.5, 2.0) and type(whole.t_span[1]) is float
    assert whole.names(2) == ("a", "b") and whole.names(3) == ()
    np.testing.assert_array_equal(whole.start(), [1j, 2.0])
    for wrong, named in (
        ({"t_span": (0.0, "1")}, "t_span is '1'"),
        ({"step": 0.0}, "step is 0.0"),
        ({"pictures": [Picture("drift"), "error"]}, "'error'"),
        ({"caption": ""}, "caption is ''"),
    ):
        with refused((TypeError, ValueError), named):
            GalleryEntry(**GIVEN | wrong)
    with refused(ValueError, "x0[1] is nan"):
        GalleryEntry(**GIVEN | {"x0": (1.0, np.nan)}).start()
    with refused(TypeError, "kind of a picture", "3"):
        Picture(3)
    with refused(TypeError, "gallery_entry is (1, 2)"):
        ready_made(gallery_entry=(1, 2))
    assert gallery_entry_of("none of them") is None

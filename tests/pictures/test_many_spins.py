"""Lattices of too many spins for arrows: an image of the nearest spins, read back by its colours."""

import colorsys

import numpy as np
import pytest
from drawn_runs import T0, made
from matplotlib.figure import Figure

import coadjoint as co
from coadjoint.pictures.kinds import spins as module
from coadjoint.pictures.plot_data import PlottedRun
from coadjoint.pictures.register import kinds


def colour_of(S, flat, out):
    """The hue of two components and the lightness of the third, by another implementation."""
    u, v, w = S[flat[0]], S[flat[1]], S[out]
    return colorsys.hls_to_rgb(np.arctan2(v, u) / (2 * np.pi) % 1.0, 0.5 + 0.5 * w, module.SATURATION)


@pytest.mark.parametrize("seen, flat, out", [("plane", (0, 1), 2), ("side", (0, 2), 1)])
@pytest.mark.parametrize("lattice, shape", [("square", (4, 6)), ("kagome", (3, 2))])
def test_pixels_have_the_colours_of_the_nearest_spins(lattice, shape, seen, flat, out, monkeypatch):
    monkeypatch.setattr(module, "MAX_ARROWS", 10)
    system = co.systems.spin_lattice(lattice, shape)
    t = T0 + 0.1 * np.arange(3)
    x = np.random.default_rng(8).normal(size=(3, 2, system.dim))
    axes = Figure().add_subplot()
    drawn = PlottedRun(made(t, x, system), [1])
    update = kinds()["spins"].prepare(drawn, at=0.5, seen=seen)(axes)
    (picture,) = axes.images
    places = module.site_positions(lattice, shape, system.dim // 3)
    left, right, bottom, top = picture.get_extent()
    # The size is that at the time of the picture, also in a movie.
    size = np.linalg.norm(x[1, 1].reshape(-1, 3), axis=1).max()
    for k in (1, 2, 0):
        if k != 1:
            update(k)
        assert axes.get_title() == f"spins of member 1 at $t$ = {t[k]:g}"
        pixels = np.asarray(picture.get_array(), dtype=np.float64)
        assert max(pixels.shape) == module.PIXELS + 1 or max(pixels.shape) == module.PIXELS
        for place, S in zip(places, x[k, 1].reshape(-1, 3) / size, strict=True):
            column = int((place[0] - left) / (right - left) * pixels.shape[1])
            row = int((place[1] - bottom) / (top - bottom) * pixels.shape[0])
            wanted = colour_of(np.array([S[flat[0]], S[flat[1]], np.clip(S[out], -1, 1)]), (0, 1), 2)
            np.testing.assert_allclose(pixels[row, column], wanted, rtol=0, atol=1e-6)
        assert picture.origin == "lower"
    if lattice == "kagome":  # there is no site in the middle of a hexagon, and none beyond the corners
        assert np.all(pixels[0, -1] == 1.0)
    # The key shows the colours of directions on the disc, the third component towards the viewer.
    (key,) = axes.child_axes
    assert (key.get_xlabel(), key.get_ylabel()) == (f"$S_{flat[0] + 1}$", f"$S_{flat[1] + 1}$")
    disc = np.asarray(key.images[0].get_array(), dtype=np.float64)
    edge = np.linspace(-1.0, 1.0, 101)
    for row, column in ((50, 80), (80, 50), (20, 50), (70, 30)):
        u, v = edge[column], edge[row]
        wanted = colour_of((u, v, (1 - u**2 - v**2) ** 0.5), (0, 1), 2)
        np.testing.assert_allclose(disc[row, column], wanted, rtol=0, atol=1e-6)
    assert key.images[0].origin == "lower" and np.all(disc[0, 0] == 1.0)
    assert [text.get_text() for text in axes.texts] == [f"white: $S_{out + 1}$ up\nblack: down"]

"""Example runs of ready-made systems: initial states, names of coordinates, and the functions drawn over time."""

import numpy as np
import pytest

import coadjoint as co
from coadjoint.methods.registry import suggested_scheme
from coadjoint.systems.coordinates import coordinate_names
from coadjoint.systems.gallery_entry import GalleryEntry, Picture
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

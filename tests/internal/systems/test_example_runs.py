"""Declarations of example runs of ready-made systems."""

import numpy as np

from coadjoint.systems.gallery_entry import GalleryEntry, Picture
from coadjoint.systems.registry import gallery_entry_of, ready_made
from refusals import refused

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
